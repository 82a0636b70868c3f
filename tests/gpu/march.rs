//! Ray casting.

use gloaming::BrickLayout;
use gloaming::camera::Camera;
use gloaming::device::{Behind, Clip, ClipShape, Cone, Lamp, March, Phong, Term, Weight};
use gloaming::field::EMPTY;
use gloaming::frame::Frame;

use super::*;

/// Two blobs in empty space, one with a hole.
fn blobs(size: [usize; 3]) -> Vec<f32> {
    let grid = Grid::new(size);
    let mut field = vec![0.0; grid.len()];
    for (i, value) in field.iter_mut().enumerate() {
        let at = Vec3::new((i % size[0]) as f32, (i / size[0] % size[1]) as f32, (i / (size[0] * size[1])) as f32);
        let (a, b) = (at.distance(Vec3::new(12.0, 20.0, 14.0)), at.distance(Vec3::new(28.0, 50.0, 40.0)));
        *value = if a < 2.5 { EMPTY } else { (1.1 - a / 9.0).max(1.0 - b / 7.0).max(0.0) };
    }
    field
}

/// Renders the blobs with and without skipping; both pictures of a device must be the same to the bit.
fn picture(d: &dyn Device, camera: &Camera, weights: &[(Weight, bool)], phong: Option<Phong>) -> Vec<[f32; 4]> {
    let (grid, field) = (anisotropic(), blobs(ODD));
    let coarse = grid.resized([18, 32, 25]);
    let bricks = BrickLayout::new(ODD, 8);
    let field = upload(d, &field);
    let ranges = d.brick_range(&bricks, &field).unwrap();
    let majorant: Vec<f32> = ranges.iter().map(|r| if r[1] > table().lo { 1.0 } else { 0.0 }).collect();
    assert!(majorant.contains(&0.0) && majorant.contains(&1.0));
    let volumes: Vec<(Buffer, &Grid)> = (40..)
        .zip(weights)
        .map(|(seed, (_, fine))| if *fine { (seed, &grid) } else { (seed, &coarse) })
        .map(|(seed, grid)| (upload(d, &noise(seed, grid.len())), grid))
        .collect();
    let terms: Vec<Term> = volumes
        .iter()
        .zip(weights)
        .map(|((values, grid), (weight, _))| Term { values, grid, weight: *weight })
        .collect();
    let [skipping, plain] = [&majorant[..], &[]].map(|majorant| {
        let mut frame = Frame::new([61, 43]);
        let table = table();
        let grid = &grid;
        d.march(
            &March {
                grid,
                field: &field,
                gradient: None,
                table: &table,
                bricks,
                majorant,
                terms: &terms,
                phong,
                camera,
                clips: &[],
                step: 0.011,
            },
            &mut frame,
        )
        .unwrap();
        frame.pixels
    });
    assert_eq!(skipping, plain, "skipping empty bricks moves a sample on {}", d.name());
    skipping
}

fn cameras() -> [Camera; 3] {
    let centre = Vec3::new(1.37, -1.52, 1.25);
    let from = |eye: Vec3| Camera::look_at(eye, centre, Vec3::Z, 40.0);
    [from(Vec3::new(2.6, -4.0, 2.0)), from(Vec3::new(1.1, -1.8, 0.6)), from(Vec3::new(-2.0, -1.52, 1.25))]
}

fn phase(direction: [f32; 3], g: f32) -> Weight {
    Weight::Phase { direction: Vec3::from(direction).normalize(), irradiance: [3.0, 2.0, 1.0], g }
}

#[test]
fn marches_agree() {
    let cone = Cone { axis: Vec3::new(0.1, 0.2, 0.9).normalize(), outer: -0.2, inner: 0.5, cosine: false };
    let lamp = Lamp { position: glam::DVec3::new(1.3, -1.4, 1.0), radius: 0.03, cone: Some(cone) };
    let patch = Lamp { cone: Some(Cone::facing(Vec3::new(0.6, 0.0, 0.8))), ..lamp };
    let weights = [
        (Weight::Uniform([0.2, 0.1, 0.3]), false),
        (phase([0.3, -0.5, -0.8], 0.6), true),
        (Weight::Current { axis: 1, weight: [0.3, 0.2, -0.4] }, false),
        (Weight::Lamp { lamp, intensity: [0.02, 0.03, 0.01], g: 0.3 }, true),
        (Weight::Lamp { lamp: patch, intensity: [0.01, 0.02, 0.02], g: -0.2 }, true),
    ];
    let towards_light = Vec3::new(-0.3, 0.5, 0.8).normalize();
    let phong = Phong { towards_light, ambient: 0.3, diffuse: 0.7, specular: 0.4, shininess: 20.0 };
    for (camera, phong) in cameras().iter().zip([None, Some(phong), None]) {
        for weights in [&weights[..], &[]] {
            let [want, got] = both(|d| picture(d, camera, weights, phong));
            assert!(want.iter().any(|p| p[3] > 0.5));
            assert_close(want.as_flattened(), got.as_flattened(), 2e-5, &format!("{camera:?}"));
        }
    }
}

/// More light volumes than a kernel binds: the smaller ones are copied together.
#[test]
fn many_lights_agree() {
    let mut weights: Vec<(Weight, bool)> =
        (0..9).map(|i| (Weight::Current { axis: i % 3, weight: [0.1 * i as f32, 0.2, 0.3] }, i == 4)).collect();
    weights.push((phase([1.0, 0.0, 0.0], -0.3), true));
    weights.push((Weight::Uniform([0.5, 0.4, 0.3]), false));
    let [want, got] = both(|d| picture(d, &cameras()[0], &weights, None));
    assert_close(want.as_flattened(), got.as_flattened(), 2e-5, "11 lights");
}

/// A list of tiles gives the pixels of the whole picture there, and touches no other.
#[test]
fn listed_tiles_are_those_of_the_whole_picture() {
    for d in [cpu() as &dyn Device, gpu()] {
        let (grid, field) = (anisotropic(), upload(d, &blobs(ODD)));
        let values = upload(d, &noise(40, grid.len()));
        let terms = [Term { values: &values, grid: &grid, weight: phase([0.3, -0.5, -0.8], 0.6) }];
        let table = table();
        let march = March {
            grid: &grid,
            field: &field,
            gradient: None,
            table: &table,
            bricks: BrickLayout::new(ODD, 8),
            majorant: &[],
            terms: &terms,
            phong: None,
            camera: &cameras()[0],
            clips: &[],
            step: 0.011,
        };
        let size = [61, 43];
        let mut whole = Frame::new(size);
        d.march(&march, &mut whole).unwrap();
        let mut some = Frame { pixels: vec![[-1.0; 4]; 61 * 43], ..Frame::new(size) };
        let list = [1u32, 5, 6, 11];
        d.march_tiles(&march, &list, &mut some).unwrap();
        for (i, (got, want)) in some.pixels.iter().zip(&whole.pixels).enumerate() {
            let tile = (i / 61 / March::TILE * March::tiles(size)[0] + i % 61 / March::TILE) as u32;
            assert_eq!(*got, if list.contains(&tile) { *want } else { [-1.0; 4] }, "pixel {i} on {}", d.name());
        }
        let before = some.clone();
        d.march_tiles(&march, &[], &mut some).unwrap();
        assert_eq!(some, before);
    }
}

/// Rays that end at something opaque, before the volume, in it, behind it, or nowhere: the same pixels, and where there is nothing those
/// of the whole picture to the bit.
#[test]
fn rays_end_alike() {
    let size = [61, 43];
    let behind: Vec<Behind> = noise(77, 61 * 43)
        .into_iter()
        .enumerate()
        .map(|(i, v)| if i % 3 == 0 { Behind::NOTHING } else { Behind { end: 0.5 + 6.0 * v, radiance: [v, 1.0, 2.0] } })
        .collect();
    let [want, got] = both(|d| {
        let (grid, field) = (anisotropic(), upload(d, &blobs(ODD)));
        let values = upload(d, &noise(40, grid.len()));
        let terms = [Term { values: &values, grid: &grid, weight: phase([0.3, -0.5, -0.8], 0.6) }];
        let table = table();
        let march = March {
            grid: &grid,
            field: &field,
            gradient: None,
            table: &table,
            bricks: BrickLayout::new(ODD, 8),
            majorant: &[],
            terms: &terms,
            phong: None,
            camera: &cameras()[0],
            clips: &[],
            step: 0.011,
        };
        let (mut whole, mut ends) = (Frame::new(size), Frame::new(size));
        d.march(&march, &mut whole).unwrap();
        d.march_before(&march, &behind, &mut ends).unwrap();
        for (i, (end, whole)) in ends.pixels.iter().zip(&whole.pixels).enumerate() {
            if i % 3 == 0 {
                assert_eq!(end, whole, "pixel {i} on {}", d.name());
            } else {
                assert_eq!(end[3], 1.0);
            }
        }
        ends.pixels
    });
    assert_close(want.as_flattened(), got.as_flattened(), 2e-5, "rays that end");
}

/// Samples that lie right on a cut may fall to either side of it; no others differ.
#[test]
fn cuts_agree() {
    let clips = [
        Clip { shape: ClipShape::Plane { normal: Vec3::new(1.0, -0.4, 0.2), offset: 6.5 }, invert: false },
        Clip { shape: ClipShape::Box { low: Vec3::splat(f32::NEG_INFINITY), high: Vec3::splat(35.0) }, invert: true },
    ];
    let (grid, table, bricks) = (anisotropic(), table(), BrickLayout::new(ODD, 8));
    let cast = |d: &dyn Device, clips: &[Clip]| {
        let field = upload(d, &blobs(ODD));
        let values = upload(d, &vec![1.0; grid.len()]);
        let terms = [Term { values: &values, grid: &grid, weight: Weight::Uniform([0.5; 3]) }];
        let camera = &cameras()[0];
        let march = March {
            grid: &grid,
            field: &field,
            gradient: None,
            table: &table,
            bricks,
            majorant: &[],
            terms: &terms,
            phong: None,
            camera,
            clips,
            step: 0.011,
        };
        let mut frame = Frame::new([61, 43]);
        d.march(&march, &mut frame).unwrap();
        frame.pixels
    };
    let [want, got] = both(|d| cast(d, &clips));
    let apart = want.iter().zip(&got).filter(|(w, g)| (w[3] - g[3]).abs() > 1e-3).count();
    assert!(apart * 50 < want.len(), "{apart} pixels differ");
    let whole = cast(cpu(), &[]);
    let covered = |pixels: &[[f32; 4]]| pixels.iter().map(|p| p[3]).sum::<f32>();
    assert!(covered(&want) > 0.05 * covered(&whole) && covered(&want) < 0.95 * covered(&whole));
}
