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
