//! Lighting a step takes no memory that the steps before did not take: everything volume-sized is used again.

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use gloaming::Grid;
use gloaming::device::cpu::Cpu;
use gloaming::field::{Dense, Timestep};
use gloaming::light::ordinates::Scattered;
use gloaming::light::{LightSolver, LightVolume};
use gloaming::lights;
use gloaming::medium::Medium;
use gloaming::scene::Scene;
use gloaming::transfer::TransferFunction;

/// Counts what it hands out.
struct Counting;

static TAKEN: AtomicUsize = AtomicUsize::new(0);
static LARGEST: AtomicUsize = AtomicUsize::new(0);
/// Bytes held in pieces of at least a sixteenth of the smallest volume.
static HELD: AtomicUsize = AtomicUsize::new(0);
const PIECE: usize = VOLUME / 16;
/// Bytes of a volume of scattered light.
const VOLUME: usize = 4 * (N / 2) * (N / 2) * (N / 2);

// SAFETY: it hands on to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        TAKEN.fetch_add(layout.size(), Relaxed);
        LARGEST.fetch_max(layout.size(), Relaxed);
        if layout.size() >= PIECE {
            HELD.fetch_add(layout.size(), Relaxed);
        }
        // SAFETY: the caller's promise is handed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        if layout.size() >= PIECE {
            HELD.fetch_sub(layout.size(), Relaxed);
        }
        // SAFETY: as above.
        unsafe { System.dealloc(at, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

const N: usize = 64;

fn step(t: usize) -> Timestep {
    let grid = Grid::new([N; 3]);
    let ball = |i: usize| {
        let p = [i % N, i / N % N, i / (N * N)].map(|v| v as f32);
        let r = ((p[0] - 30.0 - t as f32).powi(2) + (p[1] - 28.0).powi(2) + (p[2] - 33.0).powi(2)).sqrt();
        (1.0 - r / 20.0).max(0.0)
    };
    let field = Arc::new(Dense::new(grid.size, (0..grid.len()).map(ball).collect()));
    Timestep { step: t as u64, time: None, grid, field }
}

/// Every kind of light and of medium, with and without what needs most memory. The smallest volume, of scattered light, has 131 072 bytes; what
/// is taken are lists of bricks, and the table of the transfer function.
#[test]
fn a_step_takes_no_volume_that_was_not_there() {
    let cpu = Cpu::new(2).unwrap();
    for more in [
        &["light.scattering=false", "lights.0.intensity=3"][..],
        &["transfer.colormap=white", "transfer.albedo=0.9", "lights.0.intensity=3"],
        &["transfer.anisotropy=0.5"],
        &["light.tolerance=0", "light.directions=8", "transfer.albedo=0.3"],
        &["transfer.albedo=0.999", "transfer.colormap=white", "light.directions=8"],
    ] {
        let common = ["light.resolution=0.5", "transfer.opacity=[[0.0, 0.0], [1.0, 0.2]]"];
        let sets: Vec<String> = common.iter().chain(more).map(|s| s.to_string()).collect();
        let scene = Scene::load(None, &sets).unwrap();
        let steps: Vec<Timestep> = (0..5).map(step).collect();
        let (grid, lights) = (steps[0].grid, lights::resolve(&scene).unwrap());
        let transfer = TransferFunction::new(&scene.transfer).unwrap();
        let mut medium = Medium::new(&cpu, grid, transfer.table([0.0, 1.0], 1.0)).unwrap();
        medium.remember(&cpu).unwrap();
        let before = HELD.load(Relaxed);
        let mut solver = LightSolver::new(&cpu, &scene, &grid).unwrap();
        let mut light = LightVolume::default();
        for (n, step) in steps.iter().enumerate() {
            TAKEN.store(0, Relaxed);
            LARGEST.store(0, Relaxed);
            medium.take(&cpu, step).unwrap();
            medium.classify(transfer.table([0.0, 1.0], 1.0));
            solver.solve(&cpu, &medium, &lights, &mut light).unwrap();
            let (taken, largest) = (TAKEN.load(Relaxed), LARGEST.load(Relaxed));
            println!("{more:?}, step {n}: {taken} bytes, {largest} at once");
            // The second step is the first warm one, and Anderson's mixing may go deeper than before in the third.
            if n > 2 {
                assert!(largest < 40_000, "{more:?}, step {n}: {largest} bytes at once");
            }
        }
        // What is said to be held is, at most: extinction now and before and each light's ρ on the data's grid, then the volumes of
        // scattered light; sums and bands of rows of a pass are the
        // device's, some volumes on so small a grid.
        let held = (HELD.load(Relaxed) - before) as f64 / VOLUME as f64;
        let distant = lights.iter().filter(|l| matches!(l, lights::Light::Distant { .. })).count();
        let scattered = if scene.light.scattering {
            let gray = more.contains(&"transfer.colormap=white") && scene.lights.len() == 1;
            Scattered::volumes(if gray { 1 } else { 3 }, distant, false, scene.transfer.anisotropy)
        } else {
            0
        };
        // And what the next step's values are read into.
        let said = (8 * (2 + distant + 1) + scattered) as f64;
        println!("{more:?}: {held:.1} volumes of scattered light held, {said} said");
        assert!(held <= said + 7.0, "{more:?}: {held} volumes held, {said} said");
        assert!(held >= 0.5 * said, "{more:?}: {held} volumes held, {said} said");
    }
}
