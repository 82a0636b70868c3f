//! Half-angle slices, and what looks up two-dimensional and pre-integrated tables.

use glam::DVec3;
use gloaming::BrickLayout;
use gloaming::camera::Camera;
use gloaming::device::slices::{Beam, Projection, Slices, Slicing};
use gloaming::device::{Clip, ClipShape, Cone, Lamp, March, Optic, Phong, Ray, Term, Weight};
use gloaming::frame::Frame;
use gloaming::transfer::Graded;

use super::*;

/// Smooth values with a hole and empty space.
fn values(grid: &Grid) -> Vec<f32> {
    let [nx, ny, _] = grid.size;
    let at = |i: usize| Vec3::new((i % nx) as f32, (i / nx % ny) as f32, (i / (nx * ny)) as f32);
    let blob = |p: Vec3, c: Vec3, r: f32| (1.0 - p.distance(c) / r).max(0.0);
    (0..grid.len())
        .map(|i| {
            let p = at(i);
            let inside = blob(p, Vec3::new(10.0, 12.0, 9.0), 9.0).max(blob(p, Vec3::new(17.0, 20.0, 14.0), 7.0));
            if p.distance(Vec3::new(9.0, 11.0, 9.0)) < 1.5 { gloaming::field::EMPTY } else { inside }
        })
        .collect()
}

fn grid() -> Grid {
    Grid { size: [23, 28, 19], spacing: [0.02, 0.015, 0.03], origin: [1.0, -2.0, 0.5] }
}

/// Rows that dim and redden with the gradient.
fn graded() -> Table {
    let plain = table();
    let rows = 8;
    let row = |j: usize| j as f32 / (rows - 1) as f32;
    let each = |f: &dyn Fn(usize, usize) -> [f32; 3]| -> Vec<[f32; 3]> {
        (0..rows * Table::ENTRIES).map(|e| f(e % Table::ENTRIES, e / Table::ENTRIES)).collect()
    };
    let graded = Graded {
        steepest: 9.0,
        extinction: (0..rows * Table::ENTRIES)
            .map(|e| plain.extinction[e % Table::ENTRIES] * row(e / Table::ENTRIES))
            .collect(),
        albedo: each(&|i, j| plain.albedo[i].map(|a| a * (1.0 - 0.5 * row(j)))),
        emission: each(&|i, j| plain.emission[i].map(|e| e * row(j))),
    };
    Table { graded: Some(graded), ..plain }
}

fn tables() -> [(&'static str, Table); 3] {
    [
        ("plain", Table { chromatic: [1.0, 0.6, 0.3], ..table() }),
        ("graded", graded()),
        ("pre-integrated", Table { preintegrated: true, ..table() }),
    ]
}

fn gradient(d: &dyn Device, grid: &Grid, field: &Buffer) -> Buffer {
    let mut out = d.alloc(grid.len()).unwrap();
    d.gradient(grid, field, &mut out).unwrap();
    out
}

#[test]
fn slices_agree() {
    let grid = grid();
    let centre = Vec3::new(1.22, -1.8, 0.77);
    let camera = Camera::look_at(Vec3::new(2.2, -3.2, 1.3), centre, Vec3::Z, 30.0);
    let cone = Cone { axis: Vec3::new(0.9, 0.3, -0.1).normalize(), outer: 0.8, inner: 0.95, cosine: false };
    let lamp = Lamp { position: DVec3::new(0.4, -2.0, 0.9), radius: 0.0, cone: Some(cone) };
    let start: Vec<[f32; 3]> = (0..48 * 32).map(|i| [1.0, 0.5 + 0.5 * ((i % 7) as f32 / 7.0), 0.3]).collect();
    let stop = |i: usize| if i % 48 < 12 { [0.5 + 0.004 * (i / 48) as f32, 1.1] } else { [f32::INFINITY; 2] };
    let met: Vec<[f32; 2]> = (0..48 * 32).map(stop).collect();
    let cuts = [
        Clip { shape: ClipShape::Plane { normal: Vec3::new(0.7, 0.2, -0.1), offset: 4.3 }, invert: false },
        Clip { shape: ClipShape::Box { low: Vec3::splat(11.2), high: Vec3::splat(16.7) }, invert: true },
    ];
    let beam = |parallel: bool, blur| Beam {
        weight: if parallel {
            Weight::Phase { direction: Vec3::X, irradiance: [3.0, 2.0, 1.0], g: 0.4 }
        } else {
            Weight::Lamp { lamp, intensity: [2.0, 1.0, 1.0], g: 0.2 }
        },
        view: Projection {
            origin: DVec3::new(0.4, -1.8, 0.8),
            forward: DVec3::X,
            right: DVec3::Y * 0.4,
            down: DVec3::Z * -0.5,
            parallel,
        },
        size: [48, 32],
        inner: if parallel { [f64::INFINITY; 2] } else { [0.9, 0.7] },
        start: if blur > 0.0 { Some(&start[..]) } else { None },
        opaque: if blur > 0.0 { &met[..] } else { &[] },
        attenuation: if blur > 0.0 { [0.9, 0.5, 0.2] } else { [1.0; 3] },
        blur,
    };
    let phong = Phong { towards_light: Vec3::NEG_X, ambient: 0.3, diffuse: 0.7, specular: 0.4, shininess: 20.0 };
    for (case, (name, table)) in tables().iter().enumerate() {
        for (under, beam) in [(true, Some(beam(true, 0.0))), (false, Some(beam(false, 0.002))), (true, None)] {
            let [want, got] = both(|d| {
                let field = upload(d, &values(&grid));
                let gradient = gradient(d, &grid, &field);
                let bricks = BrickLayout::new(grid.size, 8);
                let majorant = table.majorants(&d.brick_range(&bricks, &field).unwrap());
                let axis = if under { DVec3::new(0.6, 0.7, -0.3) } else { DVec3::new(0.8, -0.5, 0.2) };
                let end = |n: usize| if n.is_multiple_of(3) { 1.7 + 0.01 * (n % 45) as f32 } else { f32::MAX };
                let mut rays: Vec<Ray> = (0..45 * 37).map(|n| Ray { end: end(n), ..Ray::FRESH }).collect();
                let slices = Slices {
                    grid: &grid,
                    field: &field,
                    gradient: Some(&gradient),
                    table,
                    bricks,
                    // Pre-integration reads beyond its brick.
                    majorant: if table.preintegrated { &[] } else { &majorant },
                    slicing: Slicing::new(&grid, axis.normalize(), 0.009),
                    under,
                    eye: Projection::of(&camera, [45, 37]),
                    picture: [45, 37],
                    window: [[4, 45], [0, 36]],
                    unshadowed: &[Weight::Uniform([0.2, 0.3, 0.4]), Weight::Lamp { lamp, intensity: [0.1; 3], g: 0.0 }],
                    beam,
                    glows: under,
                    phong: (case == 0).then_some(phong),
                    clips: if under { &cuts } else { &[] },
                };
                d.slice(&slices, &mut rays).unwrap();
                rays.iter().flat_map(Ray::pixel).collect::<Vec<f32>>()
            });
            assert!(want.iter().skip(3).step_by(4).any(|a| *a > 0.05), "{name}: something is seen");
            // Positions differ in the last place, and with them values on steep slopes.
            assert_close(&want, &got, 1e-4, &format!("{name}, under {under}"));
        }
    }
}

#[test]
fn gradients_and_graded_properties_agree() {
    let (grid, table) = (grid(), graded());
    let [want, got] = both(|d| {
        let field = upload(d, &values(&grid));
        let gradient = gradient(d, &grid, &field);
        let mut all = download(d, &gradient);
        for (optic, size) in [(Optic::Extinction, grid.size), (Optic::Scattering { channel: 1 }, [11, 14, 10])] {
            let mut out = d.alloc(size.iter().product()).unwrap();
            d.classify_graded(optic, &table, (grid.size, &field, &gradient), size, &mut out).unwrap();
            all.extend(download(d, &out));
        }
        all
    });
    assert_close(&want, &got, 2e-6, "gradients");
    assert!(want[grid.len()..].iter().any(|s| *s > 1.0));
}

#[test]
fn marches_by_every_kind_of_table_agree() {
    let grid = grid();
    let camera = Camera::look_at(Vec3::new(2.2, -3.2, 1.3), Vec3::new(1.22, -1.8, 0.77), Vec3::Z, 30.0);
    for (name, table) in tables() {
        let [want, got] = both(|d| {
            let field = upload(d, &values(&grid));
            let gradient = gradient(d, &grid, &field);
            let light = upload(d, &noise(3, grid.len()));
            let terms = [Term { values: &light, grid: &grid, weight: Weight::Uniform([0.3, 0.2, 0.1]) }];
            let mut frame = Frame::new([45, 37]);
            let march = March {
                grid: &grid,
                field: &field,
                gradient: Some(&gradient),
                table: &table,
                bricks: BrickLayout::new(grid.size, 8),
                majorant: &[],
                terms: &terms,
                phong: None,
                clips: &[],
                camera: &camera,
                step: 0.011,
            };
            d.march(&march, &mut frame).unwrap();
            frame.pixels.concat()
        });
        assert_close(&want, &got, 1e-4, name);
    }
}
