//! Lights with a surface in whole pictures, and what denoisers make of noise: path tracing against itself and against ray casting.

use std::sync::Arc;

use glam::DVec3;
use gloaming::Grid;
use gloaming::compare::{difference, z_test};
use gloaming::device::cpu::Cpu;
use gloaming::field::{Dense, Timestep};
use gloaming::frame::Frame;
use gloaming::scene::Scene;
use gloaming::session::Session;

/// The unit cube round the origin.
fn cube(n: usize) -> Grid {
    Grid { spacing: [1.0 / n as f64; 3], origin: [0.5 / n as f64 - 0.5; 3], ..Grid::new([n; 3]) }
}

/// The picture that a renderer makes of a scene with values of a position.
fn picture(kind: &str, text: &str, n: usize, value: impl Fn(DVec3) -> f64) -> Frame {
    let common = "field.range = [0.0, 1.0]\npathtrace.filter = 0.0\ntransfer.colormap = \"white\"";
    let text = format!("{common}\nrender.kind = \"{kind}\"\n{text}");
    let scene = Scene::parse(&text, "test", &[]).unwrap();
    let mut session = Session::new(Arc::new(Cpu::new(0).unwrap()), scene, None, false).unwrap();
    let grid = cube(n);
    let at =
        |i: usize| DVec3::new((i % n) as f64, (i / n % n) as f64, (i / (n * n)) as f64) / n as f64 + grid.origin[0];
    let values = (0..grid.len()).map(|i| value(at(i)) as f32).collect();
    let field = Arc::new(Dense::new(grid.size, values));
    session.advance(Timestep { step: 0, time: None, grid, field }).unwrap().frames.remove(0).frame
}

/// A soft ball.
fn ball(p: DVec3) -> f64 {
    (1.0 - p.length_squared() / 0.2).max(0.0)
}

fn variance(a: &Frame, b: &Frame) -> Vec<[f32; 3]> {
    let of = |f: &Frame| f.layer("variance").unwrap().values.as_chunks::<3>().0.to_vec();
    of(a).iter().zip(of(b)).map(|(a, b)| std::array::from_fn(|c| a[c] + b[c])).collect()
}

#[test]
fn a_visible_light_has_its_radiance_in_the_picture_and_covers_nothing() {
    let lamp = |visible: bool| {
        picture(
            "pathtrace",
            &format!(
                "render.size = [31, 31]\nrender.samples = 2\n\
                 [[lights]]\nkind = \"rectangle\"\nposition = [0, 1, 0]\ndirection = [0, -1, 0]\nsize = [0.5, 0.25]\n\
                 color = [1, 2, 3]\nintensity = 2\nvisible = {visible}\n\
                 [[cameras]]\nposition = [0, -2, 0]\ntarget = [0, 0, 0]\nfov = 36.86989765"
            ),
            4,
            |_| 0.0,
        )
    };
    assert!(lamp(false).pixels.iter().all(|p| *p == [0.0; 4]));
    let seen = lamp(true);
    // From 3 away 2 world lengths fill 31 pixels: 7.75 pixels across, 3.9 down.
    for (i, p) in seen.pixels.iter().enumerate() {
        let away = [(i % 31) as f64 - 15.0, (i / 31) as f64 - 15.0].map(|d| d.abs() * 2.0 / 31.0);
        let outside = [away[0] - 0.25, away[1] - 0.125];
        if outside.iter().all(|d| *d < -0.033) {
            assert_eq!(*p, [2.0, 4.0, 6.0, 0.0]);
        } else if outside.iter().any(|d| *d > 0.033) {
            assert_eq!(*p, [0.0; 4]);
        }
    }
}

/// Lights close to the medium, where neither way to find them is good everywhere.
#[test]
fn the_light_of_surfaces_does_not_depend_on_how_it_is_found() {
    for light in [
        "kind = \"rectangle\"\nposition = [0.3, -0.2, 0.7]\ndirection = [-0.2, 0.1, -1]\nsize = [1.0, 0.6]\ntexture = \"checker\"\nsecond_color = [0, 0, 3]\ntwo_sided = true",
        "kind = \"ring\"\nposition = [0, 0, -0.6]\ndirection = [0.1, 0, 1]\nradius = 0.6\ninner_radius = 0.3",
        "kind = \"box\"\nposition = [0.8, 0.1, 0.2]\nsize = [0.5, 0.4, 0.6]\nup = [0.3, 0, 1]\ntexture = \"gradient\"",
        "kind = \"sphere\"\nposition = [-0.6, -0.4, 0.3]\nradius = 0.25\ntexture = \"checker\"\ntiles = [4, 2]",
    ] {
        let frame = |(sampling, samples): (&str, usize)| {
            picture(
                "pathtrace",
                &format!(
                    "render.size = [20, 20]\nrender.samples = {samples}\ntransfer.extinction = 8\ntransfer.anisotropy = 0.5\n\
                     pathtrace.sampling = \"{sampling}\"\n[[lights]]\nintensity = 5\n{light}"
                ),
                12,
                ball,
            )
        };
        // Scattering alone rarely finds small lights.
        let [both, lights, scattering] = [("both", 128), ("lights", 128), ("scattering", 1024)].map(frame);
        for other in [&lights, &scattering] {
            let variance = variance(other, &both);
            let z = z_test(other, &both, &variance).unwrap();
            // The three channels of a sample go together: a standard error of the mean is at most √3 of what is taken for it.
            assert!(z.mean.abs() < 4.0 * 3f64.sqrt(), "{light}: {z:?}");
            let error = variance.as_flattened().iter().map(|v| f64::from(*v)).sum::<f64>().sqrt() / 1200.0;
            let mean = difference(other, &both).unwrap().mean_b;
            assert!(error < 0.04 * mean && mean > 0.005, "{light}: the bound would not see much: {error} of {mean}");
        }
    }
}

/// For the light volume points stand for a surface.
#[test]
fn points_light_as_the_surface_does() {
    for light in [
        "kind = \"disk\"\nposition = [0.4, -0.5, 1.2]\ndirection = [-0.3, 0.4, -1]\nradius = 0.3",
        "kind = \"sphere\"\nposition = [-0.3, -0.2, 1.3]\nradius = 0.25",
        "kind = \"box\"\nposition = [1.3, -0.4, 0.3]\nsize = [0.3, 0.3, 0.3]",
    ] {
        let frame = |kind: &str| {
            picture(
                kind,
                &format!(
                    "render.size = [20, 20]\nrender.samples = 512\nrender.step = 0.25\n\
                     transfer.extinction = 6\nlight.scattering = false\n[[lights]]\nintensity = 20\nsamples = 19\n{light}"
                ),
                24,
                ball,
            )
        };
        let (fast, truth) = (frame("raycast"), frame("pathtrace"));
        let found = difference(&fast, &truth).unwrap();
        assert!((found.mean_a / found.mean_b - 1.0).abs() < 0.02, "{light}: {found:?}");
        // What noise does not explain, over the root mean square of the picture.
        let noise = truth.layer("variance").unwrap().values.iter().map(|v| f64::from(*v)).sum::<f64>() / 1200.0;
        let light_squared = truth.pixels.iter().flat_map(|p| &p[..3]).map(|v| f64::from(v * v)).sum::<f64>() / 1200.0;
        let beyond = ((found.rmse.powi(2) - noise).max(0.0) / light_squared).sqrt();
        assert!(beyond < 0.05, "{light}: {beyond} beyond noise, {found:?}");
    }
}

#[test]
fn denoisers_bring_few_samples_nearer_to_the_converged_picture() {
    let frame = |samples: usize, seed: usize, denoise: &str| {
        picture(
            "pathtrace",
            &format!(
                "render.size = [40, 40]\nrender.samples = {samples}\npathtrace.seed = {seed}\npathtrace.denoise = \"{denoise}\"\n\
                 transfer.extinction = 12\n\
                 [[lights]]\nkind = \"disk\"\nposition = [0.4, -0.5, 1.2]\ndirection = [-0.3, 0.4, -1]\nradius = 0.3\nintensity = 20"
            ),
            16,
            ball,
        )
    };
    let truth = frame(768, 9, "none");
    let against = |frame: &Frame| difference(frame, &truth).unwrap();
    let noisy = against(&frame(12, 1, "none"));
    for (denoise, factor) in [("knn", 0.85), ("guided", 0.7)] {
        let found = against(&frame(12, 1, denoise));
        assert!(found.rmse < factor * noisy.rmse, "{denoise}: {} of {}", found.rmse, noisy.rmse);
        assert!((found.mean_a / noisy.mean_a - 1.0).abs() < 0.02, "{denoise}: {found:?}");
        // The published one knows one noise for all pixels and draws light over the rim into the dark.
        assert!(denoise == "knn" || found.ssim.unwrap() > noisy.ssim.unwrap(), "{denoise}: {found:?} {noisy:?}");
    }
}
