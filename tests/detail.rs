//! Procedural detail in whole runs: what lights the medium and what is seen of it are the same, on every device.

use std::sync::Arc;

use gloaming::detail::Detail;
use gloaming::device::Device;
use gloaming::device::cpu::Cpu;
use gloaming::device::paged::Paged;
use gloaming::field::{Dense, Timestep};
use gloaming::scene::Scene;
use gloaming::session::Session;
use gloaming::{Grid, memory};

const SIZE: [usize; 3] = [20, 16, 18];

fn step(number: u64) -> Timestep {
    let grid = Grid { size: SIZE, spacing: [0.5, 0.4, 0.6], origin: [1.0, -2.0, 3.0] };
    let value = |n: usize| {
        let p = [n % SIZE[0], n / SIZE[0] % SIZE[1], n / (SIZE[0] * SIZE[1])];
        let d2: f32 = (0..3).map(|a| (p[a] as f32 / SIZE[a] as f32 - 0.5).powi(2)).sum();
        (1.0 - 2.5 * d2.sqrt()).max(0.0)
    };
    let values = (0..grid.len()).map(value).collect();
    Timestep { step: number, time: Some(number as f64), grid, field: Arc::new(Dense::new(SIZE, values)) }
}

fn scene(sets: &[&str]) -> Scene {
    let common = [
        "render.size=[40, 30]",
        "field.range=[0, 1]",
        "light.directions=8",
        "light.tolerance=0",
        "transfer.opacity=[[0.0, 0.0], [1.0, 0.5]]",
    ];
    let sets: Vec<String> = common.iter().chain(sets).map(|s| s.to_string()).collect();
    Scene::load(None, &sets).unwrap()
}

const NOISE: [&str; 4] = ["noise.amplitude=0.5", "noise.warp=0.7", "noise.scale=5", "noise.drift=[0.3, 0, 0.1]"];

fn cpu() -> Arc<dyn Device> {
    Arc::new(Cpu::new(2).unwrap())
}

fn bits(session: &mut Session, steps: impl Iterator<Item = Timestep>) -> Vec<Vec<u32>> {
    let frame = |step| {
        session.advance(step).unwrap().frames[0].frame.pixels.as_flattened().iter().map(|v| v.to_bits()).collect()
    };
    steps.map(frame).collect()
}

/// A run with noise is a run of data that have it, on the finer grid: light, shadows and rays see one and the same medium.
#[test]
fn a_run_with_noise_is_a_run_of_noisy_data() {
    let noisy = scene(&NOISE);
    let detail = Detail::new(&noisy.noise).unwrap();
    let with = bits(&mut Session::new(cpu(), noisy, None, false).unwrap(), (0..3).map(step));
    // Lengths in voxels are twice as many on the finer grid.
    let plain = scene(&["transfer.reference=2"]);
    let data = (0..3).map(|n| {
        let fine = detail.apply(&step(n));
        let mut values = vec![0.0; fine.grid.len()];
        fine.field.read(fine.grid.region(), &mut values).unwrap();
        Timestep { field: Arc::new(Dense::new(fine.grid.size, values)), ..fine }
    });
    assert!(with == bits(&mut Session::new(cpu(), plain, None, false).unwrap(), data));
    let smooth = bits(&mut Session::new(cpu(), scene(&[]), None, false).unwrap(), (0..3).map(step));
    assert!(with[0] != smooth[0] && with[0] != with[1], "the noise is there, and moves");
}

/// Without amplitude and warp nothing happens, to the bit, whatever else the keys say.
#[test]
fn no_noise_is_no_change() {
    let none = ["noise.amplitude=0", "noise.warp=0", "noise.refine=3", "noise.seed=9"];
    let [plain, with] = [&[][..], &none]
        .map(|sets| bits(&mut Session::new(cpu(), scene(sets), None, false).unwrap(), (0..2).map(step)));
    assert!(plain == with);
}

/// Every field is looked up at the same shifted places, which ramps tell: there a field without curvature between its values is known.
#[test]
fn lookups_are_where_ramps_say_they_are() {
    let of = |field: &dyn Fn([f32; 3]) -> f32, seed: u32| {
        let seed = format!("noise.seed={seed}");
        let detail = Detail::new(&scene(&["noise.warp=0.8", "noise.scale=6", "noise.refine=2", &seed]).noise).unwrap();
        let at = |n: usize| [n % SIZE[0], n / SIZE[0] % SIZE[1], n / (SIZE[0] * SIZE[1])].map(|i| i as f32);
        let values = (0..SIZE.iter().product()).map(|n| field(at(n))).collect();
        let fine = detail.apply(&Timestep { field: Arc::new(Dense::new(SIZE, values)), ..step(2) });
        let mut out = vec![0.0; fine.grid.len()];
        fine.field.read(fine.grid.region(), &mut out).unwrap();
        out
    };
    let [x, y, z] = [0, 1, 2].map(|a| of(&move |p| p[a], 4));
    let mixed = |[x, y, z]: [f32; 3]| 2.0 * x - y + 0.5 * z + 0.1 * x * y - 0.2 * y * z;
    let looked_up = of(&mixed, 4);
    let mut moved = 0.0f32;
    for (n, value) in looked_up.iter().enumerate() {
        let wanted = mixed([x[n], y[n], z[n]]);
        assert!((value - wanted).abs() < 1e-4 * (1.0 + wanted.abs()), "{value} at voxel {n}, not {wanted}");
        moved = moved.max((x[n] - ((n % 40) as f32 + 0.5) * 0.5 + 0.5).abs());
    }
    // The noise is cut off at three standard deviations of 0.8 voxels.
    assert!((1.0..2.41).contains(&moved), "{moved}");
    assert!(of(&mixed, 4) == looked_up && of(&mixed, 5) != looked_up, "noise is its seed's");
}

/// A slab at a time, the same to the bit; what it takes is known beforehand.
#[test]
fn noise_is_the_same_where_memory_is_small() {
    let noisy = scene(&[&NOISE[..], &["light.scattering=false", "light.direct_resolution=0.5"]].concat());
    let grid = step(0).grid;
    assert!(
        memory::working_set(&noisy, &grid).unwrap()
            > 4 * memory::working_set(&scene(&["light.scattering=false"]), &grid).unwrap()
    );
    let least = memory::smallest(&noisy, &grid).unwrap();
    let paged: Arc<dyn Device> = Arc::new(Paged::new(cpu(), 2 * least, &std::env::temp_dir()));
    let whole = bits(&mut Session::new(cpu(), noisy.clone(), None, false).unwrap(), (0..2).map(step));
    assert!(whole == bits(&mut Session::new(paged, noisy, None, false).unwrap(), (0..2).map(step)));
}

#[test]
fn what_noise_may_say_is_refused_by_key() {
    for (set, key) in [
        ("noise.amplitude=-1", "noise.amplitude"),
        ("noise.octaves=0", "noise.octaves"),
        ("noise.refine=9", "noise.refine"),
        ("noise.scale=0", "noise.scale"),
        ("noise.gain=2", "noise.gain"),
        ("noise.warp=65", "noise.warp"),
        ("noise.octave=3", "octaves"),
    ] {
        let why = Scene::load(None, &[set.to_string()]).and_then(|s| s.validate()).unwrap_err().to_string();
        assert!(why.contains(key), "{set}: {why}");
    }
}
