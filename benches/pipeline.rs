//! A movie against its slowest stage: reading, lighting and rendering, and writing overlap, so a series should cost hardly more
//! than the stage that takes longest.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use gloaming::device::cpu::Cpu;
use gloaming::pipeline::{self, Job};
use gloaming::scene::Scene;
use gloaming::source::{self, SourceSpec};

fn main() {
    let out = tempfile::tempdir().expect("a folder");
    let smoke = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/smoke.h5");
    // The range is given, so that the pass that finds it does not count as overlap lost.
    for (name, sets) in [
        ("defaults, 1280×720", vec![]),
        ("direct light only, 640×360", vec!["light.scattering=false", "render.size=[640, 360]"]),
    ] {
        let sets: Vec<String> = sets.into_iter().chain(["field.range=[0.0, 1.0]"]).map(String::from).collect();
        let series = source::open(&SourceSpec { series: vec![smoke.into()], ..Default::default() }).expect("smoke.h5");
        let job = Job {
            indices: (0..series.info().steps.len()).collect(),
            series,
            scene: Scene::load(None, &sets).expect("scene"),
            device: Arc::new(Cpu::new(0).expect("threads")),
            outputs: vec![out.path().join("movie.mp4").to_str().expect("a name").into()],
            ledger: None,
            follow: None,
            resume: false,
            keep: 0,
            light_state: None,
        };
        let begun = Instant::now();
        let rows = pipeline::run(job, &AtomicBool::new(false), &mut |_| ()).expect("run").rows;
        let wall = begun.elapsed().as_secs_f64() * 1e3;
        let read: f64 = rows.iter().map(|r| r.read_ms).sum();
        let solve: f64 = rows.iter().map(|r| r.classify_ms + r.light_ms + r.render_ms).sum();
        let write: f64 = rows.iter().map(|r| r.write_ms).sum();
        let slowest = read.max(solve).max(write);
        println!(
            "{name}: {} steps, read {read:.0} ms, light and render {solve:.0} ms, write {write:.0} ms; wall {wall:.0} ms, {:.2} × the slowest stage",
            rows.len(),
            wall / slowest
        );
    }
}
