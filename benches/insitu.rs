//! What a running simulation pays: how long a push holds it against a plain copy, and how much longer it takes in all when
//! it has a core of its own.
//!
//! Run it on two cores: `taskset -c 0,1 cargo bench --bench insitu`. Gloaming keeps to core 1, the solver to whatever the system
//! gives it.

use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

use gloaming::field::Timestep;
use gloaming::insitu::{InSitu, Strided};
use gloaming::scene::Scene;
use gloaming::sink::{Output, Sink};

/// Takes everything and keeps nothing.
struct Nowhere;

impl Sink for Nowhere {
    fn write(&mut self, _: &Output) -> gloaming::Result<()> {
        Ok(())
    }
    fn finish(&mut self) -> gloaming::Result<()> {
        Ok(())
    }
}

const N: usize = 128;

fn scene(sets: &[&str]) -> Scene {
    let sets: Vec<String> = ["field.range=[0.0, 1.0]", "insitu.device=cpu", "insitu.threads=1"]
        .iter()
        .chain(sets)
        .map(|s| s.to_string())
        .collect();
    Scene::load(None, &sets).expect("scene")
}

fn plume(step: usize) -> Vec<f32> {
    let half = N as f32 / 2.0;
    let at = |i: usize| (i % N) as f32 / half - 1.0;
    (0..N * N * N)
        .map(|i| {
            let (x, y, z) = (at(i) - 0.3 * (0.05 * step as f32).sin(), at(i / N), at(i / N / N));
            (1.0 - 2.0 * (x * x + y * y + 0.5 * z * z)).max(0.0)
        })
        .collect()
}

fn median(times: &mut [f64]) -> f64 {
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

/// Time held by a push of 128³ f32 against a plain copy of as many bytes, taken in turns, with room in the queue.
fn held() {
    let lit = InSitu::with(scene(&["light.scattering=false", "render.size=[64, 48]"])).sink(Box::new(Nowhere));
    let lit = lit.open().expect("a session");
    let values = plume(0);
    let mut kept = vec![0.0f32; values.len()];
    let (mut copies, mut pushes, mut given) = (vec![], vec![], vec![]);
    for step in 0..60 {
        lit.flush().expect("flush");
        let begun = Instant::now();
        kept.copy_from_slice(black_box(&values));
        black_box(&kept);
        let copied = begun.elapsed();
        let begun = Instant::now();
        lit.push(2 * step, None, &Strided::of(&values, [N; 3])).expect("push");
        let pushed = begun.elapsed();
        let block = Strided::owned(values.clone(), [N; 3]);
        let (grid, field) = (block.grid(), Arc::new(block));
        let begun = Instant::now();
        lit.push_owned(Timestep { step: 2 * step + 1, time: None, grid, field }).expect("push");
        let gave = begun.elapsed();
        // In the first steps the session's memory is new.
        if step >= 4 {
            copies.push(copied.as_secs_f64());
            pushes.push(pushed.as_secs_f64());
            given.push(gave.as_secs_f64());
        }
    }
    let stats = lit.close().expect("close");
    let (copy, push, give) = (median(&mut copies), median(&mut pushes), median(&mut given));
    println!(
        "held by a push of {N}³ f32: {:.3} ms, a plain copy {:.3} ms, ratio {:.3}; given away: {:.4} ms; bytes copied per push: {}",
        1e3 * push,
        1e3 * copy,
        push / copy,
        1e3 * give,
        stats.bytes / 60
    );
}

/// Total time of a simulation whose step takes as long as lighting does, with gloaming and without.
fn overlap() {
    const STEPS: u64 = 24;
    let core: &[&str] = &["insitu.cores=[1]", "light.resolution=0.25", "render.size=[320, 240]"];
    let session = || InSitu::with(scene(core)).sink(Box::new(Nowhere)).open().expect("a session");
    let fields: Vec<Vec<f32>> = (0..STEPS as usize).map(plume).collect();
    let lit = session();
    let mut begun = Instant::now();
    for (step, values) in (0..).zip(&fields) {
        lit.push(step, None, &Strided::of(values, [N; 3])).expect("push");
        if step == 3 {
            lit.flush().expect("flush");
            begun = Instant::now();
        }
    }
    lit.flush().expect("flush");
    let a_step = begun.elapsed() / (STEPS as u32 - 4);
    drop(lit);
    // Work is counted by rounds, not by the clock: a solver that is slowed down must take longer.
    let rounds = {
        let begun = Instant::now();
        let mut rounds = 0u64;
        while begun.elapsed() < a_step {
            work(1);
            rounds += 1;
        }
        rounds
    };
    let begun = Instant::now();
    (0..STEPS).for_each(|_| work(rounds));
    let without = begun.elapsed();
    let lit = session();
    let begun = Instant::now();
    for (step, values) in (0..).zip(&fields) {
        work(rounds);
        lit.push(step, None, &Strided::of(values, [N; 3])).expect("push");
    }
    let stats = lit.close().expect("close");
    let with = begun.elapsed();
    println!(
        "{STEPS} steps of {:.0} ms, lighting takes {:.0} ms: {:.2} s with gloaming, {:.2} s without, ratio {:.3}; {} lit",
        1e3 * without.as_secs_f64() / STEPS as f64,
        1e3 * a_step.as_secs_f64(),
        with.as_secs_f64(),
        without.as_secs_f64(),
        with.as_secs_f64() / without.as_secs_f64(),
        stats.lit
    );
}

/// About a tenth of a millisecond of arithmetic in a core's own cache.
fn work(rounds: u64) {
    let mut block = [0.5f32; 4096];
    for _ in 0..rounds * 64 {
        for v in &mut block {
            *v = 3.7 * *v * (1.0 - *v);
        }
        black_box(&mut block);
    }
}

fn main() {
    held();
    overlap();
}
