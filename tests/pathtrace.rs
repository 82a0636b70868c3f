//! Path tracing: physics with known answers, invariances, and agreement with everything else that makes pictures.

use std::sync::Arc;

use glam::Vec3;
use gloaming::Grid;
use gloaming::camera::{Camera, Lens};
use gloaming::device::cpu::Cpu;
use gloaming::device::cpu::trace::{aperture, reflects};
use gloaming::device::emitter::{Emitter, Shape};
use gloaming::device::{Device, Phase, Sampling, Surface, Tally, Trace};
use gloaming::field::{Dense, Timestep};
use gloaming::frame::Frame;
use gloaming::grid::BrickLayout;
use gloaming::medium::Medium;
use gloaming::scene::Scene;
use gloaming::session::Session;
use gloaming::transfer::{Graded, Table, TransferFunction};

fn grid(n: usize) -> Grid {
    // Of about unit size, anisotropic, away from the origin.
    Grid { size: [n, n, n], spacing: [1.0 / n as f64, 1.1 / n as f64, 0.9 / n as f64], origin: [3.0, -7.0, 11.0] }
}

/// Values from normalised positions in the box, 0..1 along each axis.
fn values(grid: &Grid, f: impl Fn(Vec3) -> f32) -> Vec<f32> {
    let [nx, ny, nz] = grid.size;
    let at = |i: usize, n: usize| (i as f32 + 0.5) / n as f32;
    let mut out = Vec::with_capacity(grid.len());
    for k in 0..nz {
        for j in 0..ny {
            for i in 0..nx {
                out.push(f(Vec3::new(at(i, nx), at(j, ny), at(k, nz))));
            }
        }
    }
    out
}

/// A soft ball with a bump, transparent at the border.
fn blob(p: Vec3) -> f32 {
    let ball = |c: Vec3, r: f32| (1.0 - (p - c).length_squared() / (r * r)).max(0.0);
    (ball(Vec3::new(0.5, 0.45, 0.5), 0.38) + 0.7 * ball(Vec3::new(0.62, 0.6, 0.66), 0.25)).min(1.0)
}

/// The picture of a scene of `values`, by way of a session.
fn picture(text: &str, grid: Grid, values: Vec<f32>) -> Frame {
    let scene = Scene::parse(&format!("field.range = [0.0, 1.0]\n{text}"), "test", &[]).unwrap();
    let mut session = Session::new(Arc::new(Cpu::new(0).unwrap()), scene, None, false).unwrap();
    let field = Arc::new(Dense::new(grid.size, values));
    session.advance(Timestep { step: 0, time: None, grid, field }).unwrap().frames.remove(0).frame
}

/// Mean over pixels of a channel of radiance (3 for coverage), and of its standard error.
fn mean(frame: &Frame, channel: usize) -> (f64, f64) {
    let n = frame.pixels.len() as f64;
    let mean = frame.pixels.iter().map(|p| f64::from(p[channel])).sum::<f64>() / n;
    let variance = match channel {
        3 => {
            let samples = &frame.layer("samples").unwrap().values;
            let of = |(p, s): (&[f32; 4], &f32)| f64::from(p[3] * (1.0 - p[3]) / s);
            frame.pixels.iter().zip(samples).map(of).sum::<f64>()
        }
        _ => frame.layer("variance").unwrap().values.iter().skip(channel).step_by(3).map(|v| f64::from(*v)).sum(),
    };
    (mean, variance.sqrt() / n)
}

/// Root mean square error of radiance against a traced picture, relative to that picture's; its noise is taken out.
fn rmse(a: &Frame, truth: &Frame) -> f64 {
    let channels = a.pixels.iter().zip(&truth.pixels).flat_map(|(a, t)| (0..3).map(|c| (a[c], t[c])));
    let (error, square) = channels.fold((0.0, 0.0), |(error, square), (a, t)| {
        let (a, t) = (f64::from(a), f64::from(t));
        (error + (a - t) * (a - t), square + t * t)
    });
    let noise: f64 = truth.layer("variance").unwrap().values.iter().map(|v| f64::from(*v)).sum();
    ((error - noise).max(0.0) / square).sqrt()
}

const SMALL: &str = "render.kind = \"pathtrace\"\nrender.size = [24, 20]\npathtrace.filter = 0.0\n";

/// validation.md 8: where nothing absorbs, a medium in uniform light cannot be seen. A path that finds its light by scattering alone
/// brings home exactly what is all around; with light samples that holds in the mean.
#[test]
fn white_furnace() {
    let furnace = |more: &str| {
        let text = format!(
            "{SMALL}transfer.colormap = \"white\"\ntransfer.albedo = 1.0\ntransfer.extinction = 9.0\n\
             transfer.anisotropy = 0.4\n{more}\n[[lights]]\nkind = \"environment\"\nintensity = 2.0"
        );
        picture(&text, grid(12), values(&grid(12), blob))
    };
    for more in ["", "transfer.chromatic = [1.0, 0.5, 0.25]", "pathtrace.phase = \"schlick\""] {
        let frame = furnace(&format!("{more}\npathtrace.sampling = \"scattering\"\nrender.samples = 16"));
        // Where channels dim differently a pixel's coverage is their mean.
        let seen: Vec<f32> = (frame.pixels.iter()).map(|p| (p[0] + p[1] + p[2]) / 3.0 + 2.0 * (1.0 - p[3])).collect();
        if more.contains("chromatic") {
            let average = seen.iter().map(|v| f64::from(*v)).sum::<f64>() / seen.len() as f64;
            let (_, error) = mean(&frame, 0);
            assert!((average - 2.0).abs() < 4.0 * error, "{average} ± {error}");
        } else {
            assert!(seen.iter().all(|v| (v - 2.0).abs() < 1e-4), "{more} {seen:?}");
        }
    }
    for sampling in ["both", "lights"] {
        let frame = furnace(&format!("pathtrace.sampling = \"{sampling}\"\nrender.samples = 64"));
        let ((light, error), (coverage, _)) = (mean(&frame, 1), mean(&frame, 3));
        // Radiance is 2 where the medium is met, so that radiance and coverage are nearly the same noise: this bound is a wide one.
        assert!((light + 2.0 * (1.0 - coverage) - 2.0).abs() < 4.0 * error, "{sampling}: {light} {coverage} ± {error}");
        assert!(error < 0.01, "{error}");
    }
}

/// A homogeneous medium of optical depth τ along the view has coverage `1 − e^(−τ)`; one that absorbs and glows at one temperature
/// shines with that share of its black body.
#[test]
fn beer_lambert_and_isothermal_emission() {
    let g = Grid { size: [8, 8, 8], spacing: [0.25; 3], origin: [0.125; 3] };
    // From far away, through the middle of a cube of edge 2 and depth τ.
    for (tau, from) in [(0.3f64, -3000), (2.0, -3000), (2.0, 3000)] {
        let opacity = 1.0 - (-tau / 2.0 * 0.25).exp();
        // Radiance 1.5 per optical depth; the reference length is a voxel.
        let glow = 1.5 * tau / 2.0 * 0.25;
        let text = format!(
            "{SMALL}render.samples = 256\ntransfer.colormap = \"white\"\ntransfer.albedo = 0.0\n\
             transfer.opacity = [[0.0, {opacity}]]\ntransfer.emission = [[0.0, {glow}]]\n\
             [[lights]]\nintensity = 5.0\n[[cameras]]\nposition = [1.0, {from}, 1.0]\ntarget = [1.0, 0.0, 1.0]\nfov = 1.0\nzoom = 40.0"
        );
        let frame = picture(&text, g, vec![0.7; g.len()]);
        let (coverage, error) = mean(&frame, 3);
        let expected = 1.0 - (-tau).exp();
        assert!((coverage - expected).abs() < 4.0 * error, "{coverage} ± {error}, not {expected}");
        let (light, error) = mean(&frame, 0);
        assert!((light - 1.5 * expected).abs() < 4.0 * error, "{light} ± {error}, not {}", 1.5 * expected);
        assert!(error < 0.01);
    }
}

/// The parts of a call of `Device::trace`.
struct Stage {
    device: Cpu,
    medium: Medium,
    majorant: Vec<f32>,
    emitters: Vec<Emitter>,
    camera: Camera,
}

impl Stage {
    fn new(n: usize, threads: usize) -> Self {
        let g = grid(n);
        let device = Cpu::new(threads).unwrap();
        let scene = Scene::parse("transfer.extinction = 12.0", "test", &[]).unwrap();
        let table = TransferFunction::new(&scene.transfer).unwrap().table([0.0, 1.0], g.mean_spacing());
        let mut medium = Medium::new(&device, g, table.clone()).unwrap();
        let field = Arc::new(Dense::new(g.size, values(&g, blob)));
        medium.take(&device, &Timestep { step: 0, time: None, grid: g, field }).unwrap();
        medium.classify(table);
        let sun =
            Emitter { axis: Vec3::new(0.6, 0.0, -0.8), share: 0.5, ..Emitter::new(Shape::Distant, [3.0, 2.0, 1.0]) };
        let sky = Emitter { share: 0.5, ..Emitter::new(Shape::Environment, [0.2, 0.3, 0.4]) };
        let camera = Camera::framed(&Default::default(), &g, 1.0, 0).unwrap();
        Stage { majorant: medium.majorant.clone(), emitters: vec![sun, sky], device, medium, camera }
    }

    fn trace(&self) -> Trace<'_> {
        Trace {
            grid: &self.medium.grid,
            field: &self.medium.field,
            gradient: self.medium.gradient.as_ref(),
            table: &self.medium.table,
            surface: None,
            bricks: self.medium.bricks,
            majorant: &self.majorant,
            emitters: &self.emitters,
            images: &[],
            camera: &self.camera,
            focus: 1.0,
            clips: &[],
            meshes: None,
            phase: Phase::HenyeyGreenstein(0.3),
            sampling: Sampling::Both,
            depth: 20,
            seed: 1,
            samples: 0..8,
        }
    }
}

const SIZE: [usize; 2] = [20, 16];

fn tallies(device: &Cpu, traces: &[Trace]) -> Vec<Tally> {
    let mut tallies = vec![Tally::default(); SIZE[0] * SIZE[1]];
    for trace in traces {
        assert_eq!(device.trace(trace, SIZE, &mut tallies).unwrap().exceeded, 0);
    }
    tallies
}

/// A sample is the same in whichever call and thread; another seed has others.
#[test]
fn samples_do_not_depend_on_calls_and_threads() {
    let stage = Stage::new(16, 1);
    let whole = tallies(&stage.device, &[stage.trace()]);
    let parts = [0..3, 3..4, 4..8].map(|samples| Trace { samples, ..stage.trace() });
    assert_eq!(tallies(&stage.device, &parts), whole);
    let three = Stage::new(16, 3);
    assert_eq!(tallies(&three.device, &[three.trace()]), whole);
    let other = tallies(&stage.device, &[Trace { seed: 2, ..stage.trace() }]);
    assert_ne!(other, whole);
}

/// validation.md 10: bricks with majorants of their own, one brick for all, and looser majorants show the same in the mean; one that
/// is too low is noticed.
#[test]
fn majorants_change_the_noise_alone_and_low_ones_are_noticed() {
    let stage = Stage::new(16, 0);
    let light = |tallies: &[Tally]| {
        let (mut sum, mut variance) = (0.0, 0.0);
        for t in tallies {
            let (n, mean) = (f64::from(t.samples), t.radiance[1] / f64::from(t.samples));
            sum += mean;
            variance += (t.squares[1] / n - mean * mean) / (n - 1.0);
        }
        (sum, variance)
    };
    let (bricks, own) = light(&tallies(&stage.device, &[Trace { samples: 0..4800, ..stage.trace() }]));
    let one = BrickLayout::new([16; 3], 16);
    let most = stage.majorant.iter().fold(0.0f32, |m, v| m.max(*v));
    let (global, other) =
        light(&tallies(&stage.device, &[Trace { bricks: one, majorant: &[most], samples: 0..4800, ..stage.trace() }]));
    assert!((bricks - global).abs() < 4.0 * (own + other).sqrt(), "{bricks} {global} ± {}", (own + other).sqrt());
    let loose: Vec<f32> = stage.majorant.iter().map(|m| 2.5 * m).collect();
    let (loose, other) =
        light(&tallies(&stage.device, &[Trace { majorant: &loose, samples: 0..4800, ..stage.trace() }]));
    assert!((bricks - loose).abs() < 4.0 * (own + other).sqrt(), "{bricks} {loose}");
    assert!(4.0 * (own + other).sqrt() < 0.05 * bricks, "the bound would see a twentieth");

    let low: Vec<f32> = stage.majorant.iter().map(|m| 0.5 * m).collect();
    let mut tallies = vec![Tally::default(); SIZE[0] * SIZE[1]];
    let traced = stage.device.trace(&Trace { majorant: &low, ..stage.trace() }, SIZE, &mut tallies).unwrap();
    assert!(traced.exceeded > 0);
}

/// validation.md 12: light samples, scattering and both find the same light, for scattered light and for surfaces.
#[test]
fn all_ways_to_find_light_have_the_same_mean() {
    for scattering in ["phase", "hybrid"] {
        let frame = |sampling: &str| {
            let text = format!(
                "{SMALL}render.samples = 200\ntransfer.colormap = \"white\"\ntransfer.extinction = 12.0\ntransfer.anisotropy = 0.5\n\
                 pathtrace.sampling = \"{sampling}\"\npathtrace.scattering = \"{scattering}\"\n\
                 [[lights]]\nsoftness = 50.0\n[[lights]]\nkind = \"environment\"\ncolor = [0.5, 0.7, 1.0]\nintensity = 0.5"
            );
            picture(&text, grid(16), values(&grid(16), blob))
        };
        let frames = ["both", "lights", "scattering"].map(frame);
        for c in 0..3 {
            let [both, lights, scattering] = frames.each_ref().map(|f| mean(f, c));
            for other in [lights, scattering] {
                let error = both.1.hypot(other.1);
                assert!((both.0 - other.0).abs() < 4.0 * error, "{scattering:?} {c}: {both:?} {other:?}");
                assert!(error < 0.04 * both.0, "the bound would see a sixth: {error} of {}", both.0);
            }
            assert!(
                both.1 < 1.05 * lights.1.min(scattering.1),
                "together no noisier than the better: {both:?} {lights:?}"
            );
        }
    }
}

/// validation.md 12: the probability of a surface is the paper's. Surfaces that are black take that share of the light away.
#[test]
fn surfaces_are_as_probable_as_published() {
    let columns = [[1.0, 1.0, 0.5, 1.5]];
    let surface = |factor| Surface { factor, columns: &columns, reference: 0.5 };
    let expected = |f: f64| (1.0 - (-1.5f64).exp()) * (1.0 - (-25.0 * f.powi(3) * 0.2).exp());
    for f in [0.0f32, 0.25, 0.5, 1.0] {
        let p = reflects(&surface(Some(f)), 3.0, 0.2);
        assert!((f64::from(p) - expected(f.into())).abs() < 1e-6, "{f}: {p}");
    }
    assert_eq!(reflects(&surface(None), 3.0, 0.2), 1.0);

    let scene = |scattering: &str| {
        let text = format!(
            "{SMALL}render.samples = 2000\npathtrace.depth = 1\ntransfer.colormap = \"white\"\ntransfer.opacity = [[0.0, 0.3]]\n\
             transfer.reference = 2.0\ntransfer.diffuse = [[0.0, 0.0]]\ntransfer.specular = [[0.0, 0.0]]\n\
             pathtrace.scattering = \"{scattering}\"\npathtrace.gradient_factor = 1.0\n\
             [[lights]]\ndirection = [0, 1, 0]\n[[cameras]]\nposition = [4.5, -500, 4.5]\nfov = 2"
        );
        // A ramp along x, 0.1 from voxel to voxel, lit and seen along y.
        picture(&text, Grid::new([10; 3]), values(&Grid::new([10; 3]), |p| p.x))
    };
    let (phase, hybrid) = (mean(&scene("phase"), 0), mean(&scene("hybrid"), 0));
    // Central differences with positions clamped to the outermost values.
    let slope = |x: f64| 0.05 * ((x + 1.0).min(9.0) - (x - 1.0).max(0.0));
    let at = |i: usize| -0.5 + (f64::from(i as u32) + 0.5) / 100.0;
    let lost: f64 = (0..1000).map(|i| 0.3 * (1.0 - (-25.0 * slope(at(i))).exp()) / 1000.0).sum();
    // Some 280 000 paths each that meet something.
    assert!((hybrid.0 / phase.0 - (1.0 - lost)).abs() < 0.01, "{} {}", hybrid.0 / phase.0, 1.0 - lost);
    assert_eq!(mean(&scene("brdf"), 0).0, 0.0);
}

#[test]
fn no_gradient_factor_is_the_phase_function_alone() {
    let frame = |more: &str| {
        let text = format!("{SMALL}render.samples = 4\ntransfer.extinction = 12.0\n{more}");
        picture(&text, grid(12), values(&grid(12), blob)).pixels
    };
    let hybrid = "pathtrace.scattering = \"hybrid\"\npathtrace.gradient_factor";
    assert_eq!(frame(&format!("{hybrid} = 0.0")), frame(""));
    assert_ne!(frame(&format!("{hybrid} = 1.0")), frame(""));
}

/// The fast path and this one show the same: single scattering, and all orders of it, of a distant light and of an environment.
#[test]
fn ray_casting_with_the_light_volume_agrees() {
    for (albedo, more, bound) in [
        (0.0, "transfer.emission = [[0.0, 0.0], [1.0, 0.4]]", 0.03),
        (0.5, "light.scattering = false", 0.03),
        (0.5, "", 0.05),
        (0.9, "", 0.08),
    ] {
        let scene = |kind: &str| {
            let text = format!(
                "render.kind = \"{kind}\"\nrender.size = [32, 32]\nrender.step = 0.2\nrender.samples = 512\npathtrace.filter = 0.0\n\
                 transfer.colormap = \"white\"\ntransfer.albedo = {albedo}\ntransfer.extinction = 8.0\nlight.resolution = 1.0\n{more}\n\
                 [[lights]]\ndirection = [0.5, 0.7, -0.6]\nintensity = 4.0"
            );
            picture(&text, grid(24), values(&grid(24), blob))
        };
        let (fast, truth) = (scene("raycast"), scene("pathtrace"));
        let error = rmse(&fast, &truth);
        assert!(error < bound, "albedo {albedo} {more}: {error}");
    }
}

/// The error falls as the square root of the number of samples, or faster where samples are spread evenly.
#[test]
fn noise_falls_with_the_square_root_of_samples() {
    let frame = |samples: usize, seed: u32| {
        let text = format!("{SMALL}render.samples = {samples}\npathtrace.seed = {seed}\ntransfer.extinction = 12.0");
        picture(&text, grid(12), values(&grid(12), blob))
    };
    let truth = frame(2048, 1);
    let [few, many] = [16, 256].map(|n| rmse(&frame(n, 2), &truth));
    let slope = (many / few).log(16.0);
    assert!((-0.75..-0.42).contains(&slope), "{few} {many}: n^{slope}");
    // What the film says of its own error is right to a third: samples that are spread evenly are better than they know.
    let frame = frame(64, 3);
    let truth_of = |p: &[f32; 4], t: &[f32; 4]| f64::from(p[0] - t[0]).powi(2);
    let error: f64 = frame.pixels.iter().zip(&truth.pixels).map(|(p, t)| truth_of(p, t)).sum();
    let claimed: f64 = frame.layer("variance").unwrap().values.iter().step_by(3).map(|v| f64::from(*v)).sum();
    assert!((0.45..1.2).contains(&(error / claimed)), "{error} {claimed}");
}

/// Points of a polygon are inside it and even; a circle too.
#[test]
fn apertures_are_even() {
    let r = [0.754_877_7, 0.569_840_3];
    for blades in [0, 3, 5, 8] {
        let lens = Lens { blades, ..Lens::PINHOLE };
        let (mut middle, mut second, n) = ([0.0f64; 2], 0.0f64, 1 << 14);
        for i in 0..n {
            let [x, y] = aperture(lens, r.map(|r| (0.5 + r * f64::from(i)).fract() as f32)).map(f64::from);
            if blades > 0 {
                // The sides lie at cos(π/blades) from the middle.
                let inner = (std::f64::consts::PI / f64::from(blades)).cos();
                for side in 0..blades {
                    let angle = std::f64::consts::TAU * (f64::from(side) + 0.5) / f64::from(blades);
                    assert!(x * angle.sin() + y * angle.cos() <= inner + 1e-6, "{blades}: {x} {y}");
                }
            }
            middle = [middle[0] + x / f64::from(n), middle[1] + y / f64::from(n)];
            second += (x * x + y * y) / f64::from(n);
        }
        // A regular polygon's mean square distance from its middle is (2 + cos(2π/n))/6 of its circle's radius squared.
        let cosine = if blades == 0 { 1.0 } else { (std::f64::consts::TAU / f64::from(blades)).cos() };
        let expected = (2.0 + cosine) / 6.0;
        assert!(
            middle.iter().all(|m| m.abs() < 5e-3) && (second - expected).abs() < 5e-3,
            "{blades}: {middle:?} {second}"
        );
    }
}

/// A thin sheet facing the camera is sharp in focus, and blurred by aperture · |1 − z/focus| elsewhere. Without a distance the
/// camera focuses on it.
#[test]
fn a_lens_is_sharp_in_focus_alone() {
    // A bright bar in the middle of a thin slab that faces the camera.
    let g = Grid { size: [32, 1, 32], spacing: [0.1, 0.1, 0.1], origin: [-1.55, 0.0, -1.55] };
    let bar = values(&g, |p| if (p.x - 0.5).abs() < 0.1 { 1.0 } else { 0.0 });
    let frame = |lens: &str| {
        let text = format!(
            "{SMALL}render.samples = 128\npathtrace.depth = 1\ntransfer.colormap = \"white\"\n\
             transfer.opacity = [[0.0, 0.0], [0.5, 0.9], [1.0, 0.9]]\n\
             [[lights]]\ndirection = [0, 1, 0]\n[[cameras]]\nposition = [0, -4, 0]\ntarget = [0, 0, 0]\nfov = 40\n{lens}"
        );
        picture(&text, g, bar.clone())
    };
    // Width of the bar on the middle row: twice the mean distance of its light from the middle, in pixels.
    let width = |frame: &Frame| {
        let row = &frame.pixels[10 * 24..11 * 24];
        let total: f32 = row.iter().map(|p| p[3]).sum();
        row.iter().enumerate().map(|(x, p)| (x as f32 - 11.5).abs() * p[3]).sum::<f32>() / total * 2.0
    };
    let sharp = width(&frame(""));
    let focused = width(&frame("aperture = 0.8\nfocus = 4.0"));
    let found = width(&frame("aperture = 0.8"));
    let near = width(&frame("aperture = 0.8\nfocus = 2.0\nblades = 6"));
    assert!((focused - sharp).abs() < 0.1 && (found - sharp).abs() < 0.15, "{sharp} {focused} {found}");
    assert!(near > sharp + 0.5, "{sharp} {near}");
}

/// Thin, dense, empty and single-voxel volumes, and volumes with holes, give finite pictures.
#[test]
fn odd_volumes_give_finite_pictures() {
    let nan = |p: Vec3| {
        if p.x < 0.3 {
            f32::NAN
        } else if p.y > 0.8 {
            f32::INFINITY
        } else {
            p.z
        }
    };
    let cases: [(&str, [usize; 3], Vec<f32>); 5] = [
        ("thin", [9, 1, 5], vec![0.5; 45]),
        ("dense", [4, 4, 4], vec![1.0; 64]),
        ("empty", [4, 4, 4], vec![0.0; 64]),
        ("voxel", [1, 1, 1], vec![1.0]),
        ("holes", [7, 6, 5], values(&Grid::new([7, 6, 5]), nan)),
    ];
    for (name, size, values) in cases {
        for more in ["", "pathtrace.scattering = \"hybrid\"\ntransfer.emission = [[0.0, 0.0], [1.0, 1.0]]"] {
            let text = format!("{SMALL}render.samples = 8\ntransfer.opacity = [[0.0, 0.0], [1.0, 1.0]]\n{more}");
            let frame = picture(&text, Grid::new(size), values.clone());
            assert!(frame.pixels.iter().flatten().all(|v| v.is_finite() && *v >= 0.0), "{name}");
            let seen = frame.pixels.iter().any(|p| p[3] > 0.0);
            assert_eq!(seen, name != "empty", "{name}");
            assert!(frame.layers.iter().all(|l| l.values.iter().all(|v| v.is_finite())), "{name}");
        }
    }
}

/// Sampling stops at the error that was asked for, and says how many samples it took.
#[test]
fn sampling_stops_at_the_error_that_was_asked_for() {
    let frame = |stop: &str| {
        let text = format!("{SMALL}{stop}\ntransfer.extinction = 12.0\n[[lights]]\nkind = \"environment\"");
        picture(&text, grid(8), values(&grid(8), blob))
    };
    let samples = |f: &Frame| f.layer("samples").unwrap().values[0];
    let (rough, fine) = (
        frame("render.target_error = 0.2\nrender.samples = 5000"),
        frame("render.target_error = 0.05\nrender.samples = 5000"),
    );
    assert!(samples(&rough) < samples(&fine) && samples(&fine) < 5000.0);
    assert_eq!(samples(&frame("render.target_error = 1e-9\nrender.samples = 20")), 20.0);
    let ratio = samples(&fine) / samples(&rough);
    assert!((8.0..32.0).contains(&ratio), "a fourth of the error takes sixteen times the samples: {ratio}");
}

/// A table is bounded where it is read: the majorants of a table without emission are its extinction alone.
#[test]
fn what_glows_is_looked_for_and_no_more() {
    let stage = Stage::new(16, 0);
    let glowing = Table { emission: vec![[50.0; 3]; 1024], ..stage.medium.table.clone() };
    // Where nothing dims, light gathers along the ray: 50 per length through a box about a length deep.
    let clear = Table { extinction: vec![0.0; 1024], ..glowing };
    let majorant = vec![4.0; stage.majorant.len()];
    let trace = Trace { table: &clear, majorant: &majorant, samples: 0..64, depth: 1, ..stage.trace() };
    let mut tally = vec![Tally::default(); 1];
    let middle = Camera { tan: 1e-6, ..stage.camera };
    stage.device.trace(&Trace { camera: &middle, samples: 0..4000, ..trace }, [1, 1], &mut tally).unwrap();
    let (lo, hi) = stage.medium.grid.bounds();
    // The chord through the middle of the box.
    let half: Vec<f64> = (0..3).map(|a| 0.5 * (hi[a] - lo[a]) / f64::from(middle.forward[a]).abs()).collect();
    let chord = 2.0 * half.iter().fold(f64::INFINITY, |m, h| m.min(*h));
    let (mean, n) = (tally[0].radiance[0] / 4000.0, 4000.0f64);
    let error = ((tally[0].squares[0] / n - mean * mean) / n).sqrt();
    assert!((mean - 50.0 * chord).abs() < 4.0 * error, "{mean} ± {error}, not {}", 50.0 * chord);
    assert_eq!(tally[0].coverage, 0.0);
}

/// Values and gradient magnitudes: bricks are bounded by what both of them reach there, and by no more than that.
#[test]
fn two_dimensional_tables_are_bounded_brick_by_brick() {
    let mut stage = Stage::new(48, 0);
    // Dense where it is steep, at any value; a fog of high values.
    let regions = "transfer.steepest = 0.15\ntransfer.regions = [{ gradient = [0.4, 1.0], opacity = 0.7 }, \
                   { value = [0.5, 1.0], opacity = 0.1, shape = \"triangle\" }]";
    let scene = Scene::parse(regions, "test", &[]).unwrap();
    let g = stage.medium.grid;
    let table = TransferFunction::new(&scene.transfer).unwrap().table([0.0, 1.0], g.mean_spacing());
    let mut medium = Medium::new(&stage.device, g, table.clone()).unwrap();
    let field = Arc::new(Dense::new(g.size, values(&g, blob)));
    medium.take(&stage.device, &Timestep { step: 0, time: None, grid: g, field }).unwrap();
    medium.classify(table.clone());
    stage.medium = medium;
    let steepness = stage.device.brick_range(&stage.medium.bricks, stage.medium.gradient.as_ref().unwrap()).unwrap();
    stage.majorant = table.densest(&stage.medium.ranges, Some(&steepness));
    let sum = |of: &[f32]| of.iter().sum::<f32>();
    assert!(sum(&stage.majorant) < 0.7 * sum(&stage.medium.majorant), "tighter than over all gradients");

    // Every collision looks whether its extinction is above the bound.
    let traced = |majorant: &[f32]| {
        let mut tallies = vec![Tally::default(); SIZE[0] * SIZE[1]];
        let trace = Trace { majorant, samples: 0..200, ..stage.trace() };
        stage.device.trace(&trace, SIZE, &mut tallies).unwrap().exceeded
    };
    assert_eq!(traced(&stage.majorant), 0);
    let low: Vec<f32> = stage.majorant.iter().map(|m| 0.7 * m).collect();
    assert!(traced(&low) > 0);
}

/// A two-dimensional table whose rows are alike is the one-dimensional one; pre-integration is of rays that march, and no point of a
/// path knows of it.
#[test]
fn gradients_that_do_not_matter_and_preintegration_change_nothing() {
    let mut stage = Stage::new(16, 0);
    let plain = tallies(&stage.device, &[stage.trace()]);
    let table = stage.medium.table.clone();
    let steepest = 3.0;
    let rows = |of: &[[f32; 3]]| of.repeat(7);
    let graded =
        Graded { steepest, extinction: table.extinction.repeat(7), albedo: rows(&table.albedo), emission: vec![] };
    let mut gradient = stage.device.alloc(stage.medium.grid.len()).unwrap();
    stage.device.gradient(&stage.medium.grid, &stage.medium.field, &mut gradient).unwrap();
    let steepness = stage.device.brick_range(&stage.medium.bricks, &gradient).unwrap();
    assert!(steepness.iter().any(|s| s[1] > 0.5 * steepest), "rows are reached");
    stage.medium.gradient = Some(gradient);
    stage.medium.table = Table { graded: Some(graded), ..table.clone() };
    assert_eq!(stage.medium.table.densest(&stage.medium.ranges, Some(&steepness)), stage.majorant);
    assert_eq!(tallies(&stage.device, &[stage.trace()]), plain);

    stage.medium.table = Table { preintegrated: true, ..table };
    assert_eq!(tallies(&stage.device, &[stage.trace()]), plain);
    let frame = |more: &str| {
        let text = format!("{SMALL}render.samples = 2\ntransfer.extinction = 12.0\n{more}");
        picture(&text, grid(12), values(&grid(12), blob)).pixels
    };
    assert_eq!(frame("transfer.preintegrated = true"), frame(""));
}

/// Ray casting shows the same of values and gradients: of many rays a pixel, since it looks through a point alone.
#[test]
fn ray_casting_agrees_on_values_and_gradients() {
    let scene = |kind: &str, edge: usize, steepest: f64| {
        let text = format!(
            "render.kind = \"{kind}\"\nrender.size = [{edge}, {edge}]\nrender.step = 0.2\nrender.samples = 256\npathtrace.filter = 0.0\n\
             transfer.steepest = {steepest}\nlight.scattering = false\nlight.resolution = 1.0\n\
             [[transfer.regions]]\nvalue = [0.1, 0.9]\ngradient = [0.2, 0.8]\nedge = 1.0\nopacity = 0.2\ncolor = [1.0, 0.8, 0.6]\nemission = 0.02\n\
             [[lights]]\ndirection = [0.5, 0.7, -0.6]\nintensity = 4.0"
        );
        picture(&text, grid(24), values(&grid(24), blob))
    };
    let fine = scene("raycast", 128, 0.2);
    let mut fast = Frame::new([32, 32]);
    for (n, p) in fine.pixels.iter().enumerate() {
        let to = &mut fast.pixels[n / 512 * 32 + n % 128 / 4];
        (0..4).for_each(|c| to[c] += p[c] / 16.0);
    }
    let error = rmse(&fast, &scene("pathtrace", 32, 0.2));
    assert!(error < 0.05, "{error}");
    let steeper = rmse(&fast, &scene("pathtrace", 32, 0.4));
    assert!(steeper > 0.2, "gradients count: {steeper}");
}

/// A file of squares of edge 1 about points, facing up, or of a cube of edge 1 about the origin.
fn mesh(folder: &tempfile::TempDir, name: &str, squares: &[[f64; 3]]) -> String {
    let path = folder.path().join(name);
    let corner = |[x, y, z]: [f64; 3]| format!("v {x} {y} {z}\n");
    let text = match squares {
        [] => {
            let corners: String =
                (0..8).map(|i| corner([0, 1, 2].map(|a| if i >> a & 1 == 1 { 0.5 } else { -0.5 }))).collect();
            corners + "f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6\n"
        }
        squares => (squares.iter().enumerate())
            .map(|(n, [x, y, z])| {
                let at = |dx: f64, dy: f64| corner([x + dx, y + dy, *z]);
                let face = [1, 2, 3, 4].map(|i| (4 * n + i).to_string()).join(" ");
                at(-0.5, -0.5) + &at(0.5, -0.5) + &at(0.5, 0.5) + &at(-0.5, 0.5) + &format!("f {face}\n")
            })
            .collect(),
    };
    std::fs::write(&path, text).unwrap();
    format!("[[meshes]]\npath = \"{}\"\n", path.display())
}

/// A white mesh in a cloud in even light cannot be seen either: every way that ends at it goes on.
#[test]
fn white_furnace_with_a_mesh() {
    let folder = tempfile::tempdir().unwrap();
    let cube = mesh(&folder, "cube.obj", &[]);
    let furnace = |more: &str| {
        let text = format!(
            "{SMALL}transfer.colormap = \"white\"\ntransfer.albedo = 1.0\ntransfer.extinction = 5.0\n{more}\n\
             [[lights]]\nkind = \"environment\"\nintensity = 2.0\n\
             {cube}color = [1, 1, 1]\nscale = 0.4\nrotate = [20, 30, 40]\nposition = [3.5, -6.5, 11.5]"
        );
        picture(&text, grid(12), values(&grid(12), blob))
    };
    let frame = furnace("pathtrace.sampling = \"scattering\"\nrender.samples = 16");
    assert!(frame.pixels.iter().filter(|p| p[3] == 1.0).count() > 20, "the cube is opaque");
    for p in &frame.pixels {
        let seen = p[0] + 2.0 * (1.0 - p[3]);
        assert!((seen - 2.0).abs() < 1e-4, "{seen}");
    }
    let frame = furnace("render.samples = 64");
    let ((light, error), (coverage, _)) = (mean(&frame, 1), mean(&frame, 3));
    assert!((light + 2.0 * (1.0 - coverage) - 2.0).abs() < 4.0 * error, "{light} {coverage} ± {error}");
    assert!(error < 0.01, "{error}");
}

/// `L = ρ/π · E cos θ`, dimmed on the way to the surface and on the way back; nothing where another surface is in the way of the
/// light; ρ times the light all around in even light, however it is found.
#[test]
fn meshes_throw_light_back_and_cast_shadows() {
    let folder = tempfile::tempdir().unwrap();
    let g = Grid { size: [16; 3], spacing: [1.0 / 16.0; 3], origin: [1.0 / 32.0; 3] };
    let floor = mesh(&folder, "floor.obj", &[[0.5, 0.5, 0.3]]);
    let shown = |value: f32, more: &str| {
        let text = format!(
            "render.kind = \"pathtrace\"\nlight.scattering = false\nrender.size = [5, 5]\npathtrace.filter = 0.0\ntransfer.colormap = \"white\"\n\
             transfer.extinction = 2.0\ntransfer.albedo = 0.0\n{more}\n\
             [[cameras]]\nposition = [0.5, 0.5, 6]\ntarget = [0.5, 0.5, 0]\nup = [0, 1, 0]\nfov = 1\n{floor}color = [0.5, 0.25, 1.0]"
        );
        picture(&text, g, vec![value; g.len()])
    };
    let sun = |direction: &str| format!("render.samples = 4\n[[lights]]\nintensity = 3\ndirection = {direction}");
    for (direction, cosine) in [("[0, 0, -1]", 1.0), ("[0.6, 0, -0.8]", 0.8), ("[0, 0, 1]", 0.0)] {
        for p in &shown(0.0, &sun(direction)).pixels {
            for (c, share) in [0.5, 0.25, 1.0].into_iter().enumerate() {
                let wanted = share * 3.0 * cosine / std::f32::consts::PI;
                assert!((p[c] - wanted).abs() <= 1e-4 * wanted, "{p:?} {wanted}");
            }
            assert_eq!(p[3], 1.0);
        }
    }
    // A light from aside meets the roof first, which the camera passes.
    let roof = mesh(&folder, "roof.obj", &[[0.0, 0.0, 0.0]]);
    let roof = format!("\n{roof}scale = 0.2\nposition = [0.2, 0.5, 0.7]");
    assert!(shown(0.0, &(sun("[0.6, 0, -0.8]") + &roof)).pixels.iter().all(|p| p[..3] == [0.0; 3] && p[3] == 1.0));
    assert!(shown(0.0, &(sun("[-0.6, 0, -0.8]") + &roof)).pixels.iter().all(|p| p[0] > 0.3));
    // Light that the floor throws against the roof comes back.
    let all = format!("pathtrace.depth = 5\n{}{roof}", sun("[0.6, 0, -0.8]").replace("= 4", "= 4000"));
    let (light, error) = mean(&shown(0.0, &all), 2);
    assert!(light > 4.0 * error && light < 0.05, "{light} ± {error}");

    let dim = shown(1.0, &sun("[0, 0, -1]").replace("= 4", "= 4000"));
    let ((light, error), wanted) = (mean(&dim, 2), 3.0 / std::f64::consts::PI * (-2.0f64 * 1.4).exp());
    assert!((light - wanted).abs() < 4.0 * error && error < 0.02 * wanted, "{light} ± {error}, not {wanted}");

    for sampling in ["both", "lights", "scattering"] {
        let sky = "[[lights]]\nkind = \"environment\"\nintensity = 2";
        let even = shown(0.0, &format!("render.samples = 400\npathtrace.sampling = \"{sampling}\"\n{sky}"));
        let (light, error) = mean(&even, 0);
        assert!((light - 1.0).abs() < 4.0 * error + 1e-5 && error < 0.02, "{sampling}: {light} ± {error}");
    }
}

/// A ball at rest, one that drifts within a corner, and nothing between.
fn drifting(t: u64) -> Timestep {
    let grid = Grid::new([48; 3]);
    let ball = |p: Vec3, c: Vec3, r: f32| (1.0 - (p - c).length_squared() / (r * r)).max(0.0);
    let value = |p: Vec3| {
        let still = ball(p, Vec3::new(0.7, 0.35, 0.7), 0.25);
        still + ball(p, Vec3::new(0.15 + 0.005 * t as f32, 0.7, 0.15), 0.09)
    };
    let field = Arc::new(Dense::new(grid.size, values(&grid, value)));
    Timestep { step: t, time: None, grid, field }
}

/// Tiles whose paths met nothing new keep their estimate: to the bit what tracing them again finds, with all its layers.
#[test]
fn what_is_replayed_is_the_same_to_the_bit() {
    let single = "light.scattering = false\nrender.samples = 3";
    let regions = "[[transfer.regions]]\ngradient = [0.05, 1.0]\nopacity = 0.5";
    for (more, lists, still_share) in [
        (single, "", 0.3),
        ("light.scattering = false\nrender.samples = 3\ntransfer.steepest = 0.1", regions, 0.3),
        (&format!("{single}\ntransfer.emission = [[0.0, 0.0], [1.0, 0.2]]"), "[[cameras]]\naperture = 2.0", 0.3),
        // Light that is scattered more than once goes everywhere.
        ("pathtrace.scattering = \"hybrid\"\nrender.samples = 2", "", 0.0),
    ] {
        let session = |replay: bool| {
            let text = format!(
                "field.range = [0.0, 1.0]\nrender.kind = \"pathtrace\"\nrender.size = [90, 75]\npathtrace.replay = {replay}\n{more}\n\
                 [[lights]]\ndirection = [0.3, 1.0, -0.4]\n{lists}"
            );
            let scene = Scene::parse(&text, "test", &[]).unwrap();
            Session::new(Arc::new(Cpu::new(0).unwrap()), scene, None, false).unwrap()
        };
        let (mut replayed, mut anew) = (session(true), session(false));
        // A step that changes nothing, and a ball that leaves its bricks for empty ones.
        for (n, t) in [0, 1, 1, 2, 12].into_iter().enumerate() {
            let (got, want) = (replayed.advance(drifting(t)).unwrap(), anew.advance(drifting(t)).unwrap());
            let (frame, truth) = (&got.frames[0].frame, &want.frames[0].frame);
            assert!(frame.pixels == truth.pixels && frame.layers == truth.layers, "step {t} of {more}");
            assert_eq!(want.row.tiles_reused, 0);
            let share = got.row.tiles_reused as f64 / got.row.tiles_total as f64;
            match n {
                0 => assert_eq!(share, 0.0, "the first step"),
                2 => assert_eq!(share, 1.0, "nothing has changed"),
                _ => assert!(share >= still_share && share < 1.0, "{share} of step {t} of {more}"),
            }
        }
    }
    let budget = Scene::parse("pathtrace.replay = true\nrender.budget_ms = 5", "test", &[]).unwrap_err();
    assert!(budget.to_string().contains("pathtrace.replay"), "{budget}");
}

/// A cut takes away what is behind it, exactly, with its shadows; a cut and its inverse make the whole. Ray casting cuts the same.
#[test]
fn cuts_are_exact_and_cast_no_shadow() {
    let frame = |kind: &str, clip: &str| {
        let text = format!(
            "render.kind = \"{kind}\"\nrender.size = [32, 32]\nrender.samples = 400\nrender.step = 0.1\npathtrace.filter = 0.0\n\
             transfer.colormap = \"white\"\ntransfer.opacity = [[0.0, 0.02]]\ntransfer.albedo = 0.5\nlight.scattering = false\n\
             [[lights]]\ndirection = [1, 0, 0]\n{clip}"
        );
        picture(&text, Grid::new([16; 3]), vec![0.5; 16 * 16 * 16])
    };
    // The half of the cube towards the light, cut obliquely, between two planes of voxels.
    let plane = "[[clip]]\nkind = \"plane\"\npoint = [7.3, 7.3, 7.3]\nnormal = [1, 0.3, -0.2]";
    let [cut, rest, whole] =
        [plane.into(), format!("{plane}\ninvert = true"), String::new()].map(|c| frame("raycast", &c));
    for ((a, b), w) in cut.pixels.iter().zip(&rest.pixels).zip(&whole.pixels) {
        // Transmittances multiply; a sample is a tenth of a voxel.
        assert!(((1.0 - a[3]) * (1.0 - b[3]) - (1.0 - w[3])).abs() < 4e-3, "{a:?} {b:?} {w:?}");
    }
    assert!(mean_coverage(&cut) > 0.3 * mean_coverage(&whole) && mean_coverage(&cut) < 0.8 * mean_coverage(&whole));
    // Lit from −x, what is kept is as bright as a body that begins there: nothing that was cut away dims it.
    let traced = frame("pathtrace", plane);
    let error = rmse(&cut, &traced);
    assert!(error < 0.05, "{error}");
    let bright = |f: &Frame| f.pixels.iter().map(|p| p[0]).sum::<f32>() / f.pixels.iter().map(|p| p[3]).sum::<f32>();
    assert!(bright(&cut) > 1.05 * bright(&whole), "{} {}", bright(&cut), bright(&whole));

    let block = "[[clip]]\nmin = [4, 4, 4]\nmax = [11, 11, 11]\ninvert = true";
    let error = rmse(&frame("raycast", block), &frame("pathtrace", block));
    assert!(error < 0.05, "{error}");
}

fn mean_coverage(frame: &Frame) -> f32 {
    frame.pixels.iter().map(|p| p[3]).sum::<f32>() / frame.pixels.len() as f32
}
