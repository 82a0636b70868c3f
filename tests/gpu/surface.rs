//! Isosurfaces: hits, occlusion, beauty, subsurface scattering and the light volume at hits.

use gloaming::BrickLayout;
use gloaming::camera::Camera;
use gloaming::device::surface::{
    Attenuation, Beauty, Environment, Estimator, Filtered, Hit, Map, Occlusion, Samples, Subsurface, Surface, Surfaces,
    distances,
};
use gloaming::device::{Clip, ClipShape, Cone, Lamp, Term, Weight};
use gloaming::field::EMPTY;

use super::*;

const VALUES: [f32; 2] = [0.35, 0.7];
const PICTURE: [usize; 2] = [61, 43];

/// Two smooth blobs, one with a hole.
fn blobs() -> Vec<f32> {
    let grid = Grid::new(ODD);
    (0..grid.len())
        .map(|i| {
            let at = Vec3::new((i % ODD[0]) as f32, (i / ODD[0] % ODD[1]) as f32, (i / (ODD[0] * ODD[1])) as f32);
            let (a, b) = (at.distance(Vec3::new(14.0, 22.0, 16.0)), at.distance(Vec3::new(25.0, 45.0, 35.0)));
            if a < 2.5 { EMPTY } else { (1.2 - a / 12.0).max(1.1 - b / 10.0).max(0.0) }
        })
        .collect()
}

fn solids() -> Vec<Surface> {
    let surface = |value, opacity, transmission| Surface {
        value,
        diffuse: [0.7, 0.5, 0.3],
        specular: 0.2,
        exponent: 20.0,
        exponent_gradient: 0.1,
        opacity,
        transmission,
        spread: 15.0,
        ior: 1.4,
    };
    vec![surface(VALUES[0], 0.4, 0.3), surface(VALUES[1], 1.0, 0.1)]
}

/// Runs on both devices with everything in place.
fn with<T>(
    hits: &[Hit],
    skips: bool,
    clips: &[Clip],
    run: impl Fn(&dyn Device, &Surfaces, &Buffer, &[Hit]) -> T,
) -> [T; 2] {
    let grid = anisotropic();
    let bricks = BrickLayout::new(ODD, 8);
    let solids = solids();
    let camera = Camera::look_at(Vec3::new(2.6, -4.0, 2.0), Vec3::new(1.37, -1.52, 1.25), Vec3::Z, 19.0);
    both(|d| {
        let field = upload(d, &blobs());
        let empty = distances(&bricks, &d.brick_range(&bricks, &field).unwrap(), &VALUES);
        assert!(empty.contains(&0.0) && empty.iter().any(|v| *v > 0.0));
        let surfaces = Surfaces {
            grid: &grid,
            field: &field,
            bricks,
            empty: if skips { &empty } else { &[] },
            surfaces: &solids,
            clips,
            step: 0.01,
            camera: &camera,
            picture: PICTURE,
        };
        let sky = |at: glam::Vec2| {
            let way = Map::direction((at + 0.5) / 32.0).normalize();
            Vec3::new(1.0 + 0.5 * way.x, 1.5 - 0.5 * way.y, 1.2 + 0.8 * way.z)
        };
        run(d, &surfaces, &upload(d, &Map::tabulate(32, sky)), hits)
    })
}

/// A plane across both blobs, and a box out of one of them.
fn cuts() -> [Clip; 2] {
    [
        Clip { shape: ClipShape::Plane { normal: Vec3::new(-0.9, 0.1, 0.2), offset: -13.3 }, invert: false },
        Clip { shape: ClipShape::Box { low: Vec3::splat(9.4), high: Vec3::new(14.2, 21.7, 40.0) }, invert: true },
    ]
}

fn rays() -> Vec<Hit> {
    (0..(PICTURE[0] * PICTURE[1]) as u32).map(Hit::ray).collect()
}

/// Hits of the CPU, so that what is compared begins at the same places.
fn found() -> Vec<Hit> {
    let [mut hits, _] = with(&rays(), true, &[], |d, s, _, hits| {
        let mut hits = hits.to_vec();
        d.surface_hits(s, &mut hits).unwrap();
        hits
    });
    hits.retain(|h| h.surface != Hit::NONE);
    hits
}

#[test]
fn surface_hits_agree() {
    for (skips, clips) in [(true, &[][..]), (false, &[]), (true, &cuts())] {
        let [want, got] = with(&rays(), skips, clips, |d, s, _, hits| {
            let mut hits = hits.to_vec();
            let mut all = Vec::new();
            for _ in 0..3 {
                d.surface_hits(s, &mut hits).unwrap();
                all.push(hits.clone());
            }
            all
        });
        let (mut met, mut apart) = (0, 0);
        for (want, got) in want.iter().flatten().zip(got.iter().flatten()) {
            met += usize::from(want.surface != Hit::NONE);
            // A ray that grazes a surface may meet it on one device only.
            if want.surface != got.surface {
                apart += 1;
                continue;
            }
            if want.surface != Hit::NONE {
                let steep = (Vec3::from(want.normal) - Vec3::from(got.normal)).length();
                let off = (Vec3::from(want.position) - Vec3::from(got.position)).length();
                apart +=
                    usize::from(off > 2e-3 || steep > 2e-3 || (want.slope - got.slope).abs() > 2e-3 * want.slope.abs());
                assert_eq!(want.pixel, got.pixel);
            }
        }
        assert!(met > 800 && apart * 200 < met, "{apart} of {met} differ");
    }
}

const ESTIMATORS: [Estimator; 2] = [Estimator::Normalised, Estimator::Paper];

/// Mean over hits, and how many differ by more than `tolerance` of the largest: decisions at edges may fall either way.
fn compare(want: &[f32], got: &[f32], tolerance: f32, what: &str) {
    let largest = want.iter().fold(0.0f32, |m, v| m.max(v.abs()));
    let apart =
        want.iter().zip(got).filter(|(w, g)| (*w - *g).is_nan() || (*w - *g).abs() > tolerance * largest).count();
    assert!(largest > 0.0 && apart * 100 <= want.len(), "{what}: {apart} of {} differ", want.len());
    let mean = |v: &[f32]| v.iter().map(|v| f64::from(*v)).sum::<f64>() / v.len() as f64;
    let (a, b) = (mean(want), mean(got));
    assert!((a - b).abs() <= 1e-3 * a.abs().max(1e-3 * f64::from(largest)), "{what}: means {a} and {b}");
}

#[test]
fn surface_occlusion_agrees() {
    let hits = found();
    assert!(hits.len() > 300);
    for (estimator, clips) in [(ESTIMATORS[0], &[][..]), (ESTIMATORS[1], &[]), (ESTIMATORS[0], &cuts())] {
        let occlusion = Occlusion { radius: 0.4, steps: 12, estimator, seed: 5 };
        let [want, got] = with(&hits, true, clips, |d, s, _, hits| {
            let mut sums = vec![[0.0; 4]; hits.len()];
            for part in [Samples { first: 0, end: 7 }, Samples { first: 7, end: 24 }] {
                d.surface_occlusion(s, &occlusion, part, hits, &mut sums).unwrap();
            }
            sums
        });
        let escaped = || want.iter().map(|s| s[3]);
        assert!(
            escaped().fold(f32::MAX, f32::min) < escaped().fold(0.0, f32::max),
            "some hits are more open than others"
        );
        compare(want.as_flattened(), got.as_flattened(), 1e-3, &format!("{estimator:?}"));
    }
}

#[test]
fn surface_beauty_agrees() {
    let hits = found();
    let map = Map { first: 0, edge: 32 };
    let filtered = Filtered { irradiance: map, reflections: vec![map; 2] };
    let bent: Vec<[f32; 4]> = noise(3, 4 * hits.len()).as_chunks::<4>().0.to_vec();
    for (filtered, bent) in [(None, &[][..]), (None, &bent[..]), (Some(&filtered), &[][..])] {
        for estimator in ESTIMATORS {
            let [want, got] = with(&hits, true, &[], |d, s, texels, hits| {
                let environment = Environment { texels, radiance: map, filtered };
                let part = |first, end| Samples { first, end };
                let beauty =
                    Beauty { environment, diffuse: part(0, 9), specular: part(2, 20), bent, estimator, seed: 1 };
                let mut sums = vec![[[0.0; 3]; 2]; hits.len()];
                d.surface_beauty(s, &beauty, hits, &mut sums).unwrap();
                sums
            });
            compare(
                want.as_flattened().as_flattened(),
                got.as_flattened().as_flattened(),
                1e-3,
                &format!("{estimator:?}"),
            );
        }
    }
}

#[test]
fn surface_subsurface_agrees() {
    let hits = found();
    let table = table();
    for (estimator, fast, refracts, by, clips) in [
        (Estimator::Normalised, false, true, None, &[][..]),
        (Estimator::Paper, true, false, None, &[]),
        (Estimator::Normalised, false, false, Some(&table), &[]),
        (Estimator::Normalised, false, false, None, &cuts()),
        (Estimator::Normalised, true, false, Some(&table), &cuts()),
    ] {
        let [want, got] = with(&hits, true, clips, |d, s, texels, hits| {
            let environment = Environment { texels, radiance: Map { first: 0, edge: 32 }, filtered: None };
            let of = Subsurface {
                environment,
                primary: Samples { first: 0, end: 3 },
                secondary: 3,
                fast,
                refracts,
                attenuation: Attenuation { rate: [0.5, 1.0, 2.0], table: by },
                estimator,
                seed: 2,
            };
            let mut sums = vec![[0.0; 3]; hits.len()];
            d.surface_subsurface(s, &of, hits, &mut sums).unwrap();
            sums
        });
        compare(want.as_flattened(), got.as_flattened(), 2e-3, &format!("{estimator:?} {fast} {refracts}"));
    }
}

#[test]
fn surface_light_agrees() {
    let hits = found();
    let coarse = anisotropic().resized([18, 32, 25]);
    let values = noise(8, coarse.len());
    let cone = Cone { axis: Vec3::new(0.1, 0.2, 0.9).normalize(), outer: -0.2, inner: 0.5, cosine: false };
    let lamp = Lamp { position: glam::DVec3::new(1.3, -3.4, 1.0), radius: 0.03, cone: Some(cone) };
    let weights = [
        Weight::Uniform([0.2, 0.1, 0.3]),
        Weight::Phase { direction: Vec3::new(-0.3, 0.8, -0.5).normalize(), irradiance: [3.0, 2.0, 1.0], g: 0.5 },
        Weight::Lamp { lamp, intensity: [2.0, 3.0, 1.0], g: 0.3 },
    ];
    for weight in weights {
        let [want, got] = with(&hits, true, &[], |d, s, _, hits| {
            let term = Term { values: &upload(d, &values), grid: &coarse, weight };
            let mut sums = vec![[[0.5; 3]; 2]; hits.len()];
            d.surface_light(s, &term, hits, &mut sums).unwrap();
            sums
        });
        let [want, got] = [&want, &got].map(|s| s.as_flattened().as_flattened().to_vec());
        assert_close(&want, &got, 2e-4, &format!("{weight:?}"));
    }
}
