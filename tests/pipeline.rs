//! A whole series through the pipeline: what comes out, what is said of what was lost, and that warm is as good as cold.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use gloaming::device::cpu::Cpu;
use gloaming::field::{Dense, Field, Timestep};
use gloaming::insitu::InSitu;
use gloaming::pipeline::{self, Job, Summary};
use gloaming::scene::Scene;
use gloaming::session::Session;
use gloaming::source::{self, Series, SeriesInfo, SourceSpec};
use gloaming::{Error, Grid, Region, Result};

const SMOKE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/smoke.h5");

fn scene(extra: &[&str]) -> Scene {
    let mut sets =
        vec!["render.size=[96, 64]".to_string(), "light.resolution=0.25".into(), "light.directions=8".into()];
    sets.extend(extra.iter().map(|s| s.to_string()));
    Scene::load(None, &sets).unwrap()
}

fn job(series: Box<dyn Series>, indices: Vec<usize>, scene: Scene, out: &Path) -> Job {
    let at = |name: &str| out.join(name).to_str().unwrap().to_string();
    Job {
        series,
        indices,
        scene,
        device: Arc::new(Cpu::new(2).unwrap()),
        outputs: vec![at("f_{step:06}.png"), at("f_{step:06}.exr")],
        ledger: Some(out.join("ledger.csv")),
        follow: None,
        resume: false,
        keep: 1 << 20,
        light_state: None,
    }
}

fn run(job: Job) -> Result<Summary> {
    pipeline::run(job, &AtomicBool::new(false), &mut |_| ())
}

/// Steps that are done: the pass for the range tells of its own progress.
fn lit(progress: &pipeline::Progress) -> usize {
    if progress.stage == pipeline::Stage::Light { progress.finished } else { 0 }
}

fn smoke() -> Box<dyn Series> {
    source::open(&SourceSpec { series: vec![SMOKE.into()], ..Default::default() }).unwrap()
}

#[test]
fn a_series_becomes_frames_and_a_ledger() {
    let out = tempfile::tempdir().unwrap();
    let summary = run(job(smoke(), vec![30, 31, 32], scene(&[]), out.path())).unwrap();
    assert_eq!((summary.done, summary.lost.len(), summary.interrupted), (3, 0, false));
    for step in 30..33 {
        assert!(out.path().join(format!("f_{step:06}.png")).exists(), "frame of step {step}");
        assert!(out.path().join(format!("f_{step:06}.exr")).exists(), "frame of step {step}");
    }
    let ledger = std::fs::read_to_string(out.path().join("ledger.csv")).unwrap();
    assert_eq!(ledger.lines().count(), 4, "a header and three rows:\n{ledger}");
    let starts: Vec<&str> = summary.rows.iter().map(|r| &r.start[..]).collect();
    assert_eq!(starts, ["cold", "warm", "warm"]);
    assert!(summary.rows.iter().all(|r| r.certified_error <= f64::from(1e-3f32)), "{:?}", summary.rows);
}

/// validation.md 17 through the whole session: the light and the pictures of a warm run are a cold run's, to the bit for
/// direct light at tolerance 0.
#[test]
fn warm_is_cold_to_the_bit_at_tolerance_zero() {
    let light = |warm: &str| {
        let scene = scene(&["light.tolerance=0", "light.scattering=false", warm]);
        let mut session = Session::new(Arc::new(Cpu::new(2).unwrap()), scene, Some([0.0, 1.0]), true).unwrap();
        let series = smoke();
        let outputs: Vec<_> = (20..24).map(|i| session.advance(series.timestep(i).unwrap()).unwrap()).collect();
        outputs.into_iter().map(|o| (o.light.unwrap(), o.frames[0].frame.clone(), o.row)).collect::<Vec<_>>()
    };
    let (warm, cold) = (light("light.warm=true"), light("light.warm=false"));
    let (mut swept, mut all) = (0, 0);
    for (step, (w, c)) in warm.iter().zip(&cold).enumerate() {
        assert!(w.0 == c.0 && w.1 == c.1, "step {step} differs");
        assert_eq!(c.2.bricks_active, c.2.bricks_total);
        if step > 0 {
            (swept, all) = (swept + w.2.bricks_active, all + w.2.bricks_total);
        }
    }
    assert!(swept < all, "nothing was ever skipped: {swept} of {all}");
}

/// Steps in memory, some of which cannot be read.
struct Faulty {
    info: SeriesInfo,
    broken: Vec<usize>,
}

struct Broken;

impl Field for Broken {
    fn read(&self, _: Region, _: &mut [f32]) -> Result<()> {
        Err(Error::format("run/plt_00007.h5:/density", "the file ends after 4096 of 110592 bytes", "copy it again"))
    }
}

impl Faulty {
    fn boxed(broken: &[usize]) -> Box<dyn Series> {
        Box::new(Faulty { info: smoke().info().clone(), broken: broken.to_vec() })
    }
}

impl Series for Faulty {
    fn info(&self) -> &SeriesInfo {
        &self.info
    }

    fn timestep(&self, index: usize) -> Result<Timestep> {
        let grid = Grid::new([24, 20, 22]);
        let field: Arc<dyn Field> = if self.broken.contains(&index) {
            Arc::new(Broken)
        } else {
            let values =
                (0..grid.len()).map(|i| if i % 1000 == 7 { f32::NAN } else { (i % 24) as f32 / 24.0 }).collect();
            Arc::new(Dense::new(grid.size, values))
        };
        Ok(Timestep { step: index as u64, time: Some(index as f64), grid, field })
    }
}

#[test]
fn a_step_that_cannot_be_read_is_a_stated_loss() {
    let out = tempfile::tempdir().unwrap();
    let summary = run(job(Faulty::boxed(&[1]), vec![0, 1, 2], scene(&[]), out.path())).unwrap();
    assert_eq!(summary.done, 2);
    assert_eq!(summary.lost.len(), 1);
    let (step, why) = &summary.lost[0];
    assert!(*step == 1 && why.contains("plt_00007.h5") && why.contains("copy it again"), "{why}");
    assert!(std::fs::read_to_string(out.path().join("ledger.csv")).unwrap().contains("plt_00007"));
    assert!(!out.path().join("f_000001.png").exists());
}

#[test]
fn holes_are_counted_and_leave_finite_pictures() {
    let out = tempfile::tempdir().unwrap();
    let summary = run(job(Faulty::boxed(&[]), vec![0, 1], scene(&[]), out.path())).unwrap();
    assert_eq!(summary.rows[0].holes, (24 * 20 * 22 - 7_usize).div_ceil(1000) as u64);
    let mut session = Session::new(Arc::new(Cpu::new(1).unwrap()), scene(&[]), None, true).unwrap();
    let output = session.advance(Faulty::boxed(&[]).timestep(0).unwrap()).unwrap();
    assert!(output.frames[0].frame.pixels.iter().flatten().all(|v| v.is_finite()));
    assert!(output.light.unwrap().fluence.iter().flatten().all(|v| v.is_finite()));
}

#[test]
fn a_series_without_a_readable_step_fails_with_the_reason() {
    let out = tempfile::tempdir().unwrap();
    let error = run(job(Faulty::boxed(&[0, 1]), vec![0, 1], scene(&[]), out.path())).unwrap_err().to_string();
    assert!(error.contains("plt_00007.h5"), "{error}");
}

/// A bug in a reader is an error, not a series that ends early.
#[test]
fn a_reader_that_dies_is_an_error() {
    struct Dies(SeriesInfo);
    impl Series for Dies {
        fn info(&self) -> &SeriesInfo {
            &self.0
        }
        fn timestep(&self, index: usize) -> Result<Timestep> {
            assert!(index != 1, "a bug in a reader");
            Faulty::boxed(&[]).timestep(index)
        }
    }
    let out = tempfile::tempdir().unwrap();
    let mut scene = scene(&[]);
    scene.field.range = gloaming::scene::RangeKey::Fixed([0.0, 1.0]);
    let error = run(job(Box::new(Dies(smoke().info().clone())), vec![0, 1, 2], scene, out.path())).unwrap_err();
    assert!(
        matches!(&error, Error::Bug(why) if why.contains("step 1") && why.contains("a bug in a reader")),
        "{error}"
    );
    assert!(out.path().join("f_000000.png").exists(), "what was done before stays");
}

/// A panic while a step is lit names the step; what was done before is closed and stays.
#[test]
fn a_panic_while_a_step_is_lit_is_an_error_that_names_the_step() {
    struct Wrong(SeriesInfo);
    impl Series for Wrong {
        fn info(&self) -> &SeriesInfo {
            &self.0
        }
        fn timestep(&self, index: usize) -> Result<Timestep> {
            let step = Faulty::boxed(&[]).timestep(index)?;
            // A field that is not what its grid says is a bug of a source's, found where its values are taken in.
            let size = if index == 1 { [3, 3, 3] } else { step.grid.size };
            Ok(Timestep { field: Arc::new(Dense::new(size, vec![0.5; size.iter().product()])), ..step })
        }
    }
    let out = tempfile::tempdir().unwrap();
    let mut scene = scene(&[]);
    scene.field.range = gloaming::scene::RangeKey::Fixed([0.0, 1.0]);
    let mut job = job(Box::new(Wrong(smoke().info().clone())), vec![0, 1, 2], scene, out.path());
    job.outputs.push(out.path().join("m.mp4").to_str().unwrap().into());
    let error = run(job).unwrap_err();
    assert!(matches!(&error, Error::Bug(why) if why.contains("step 1")), "{error}");
    assert!(out.path().join("f_000000.png").exists(), "what was done before stays");
    assert_eq!(&std::fs::read(out.path().join("m.mp4")).unwrap()[4..8], b"ftyp", "the movie is closed");
}

/// Kept by the pass for the range or read again: the same pictures.
#[test]
fn steps_that_the_pass_for_the_range_kept_are_read_once() {
    struct Counted(Box<dyn Series>, Arc<std::sync::atomic::AtomicUsize>);
    impl Series for Counted {
        fn info(&self) -> &SeriesInfo {
            self.0.info()
        }
        fn timestep(&self, index: usize) -> Result<Timestep> {
            self.1.fetch_add(1, Ordering::Relaxed);
            self.0.timestep(index)
        }
    }
    let pictures = [(0, 6), (1 << 20, 3), (100_000, 4)].map(|(keep, reads)| {
        let (out, count) = (tempfile::tempdir().unwrap(), Arc::default());
        let series = Counted(Faulty::boxed(&[]), Arc::clone(&count));
        let passed = std::sync::atomic::AtomicUsize::new(0);
        let job = Job { keep, ..job(Box::new(series), vec![0, 1, 2], scene(&["light.scattering=false"]), out.path()) };
        let seen = &mut |p: pipeline::Progress| {
            passed.fetch_add(usize::from(p.stage == pipeline::Stage::Range), Ordering::Relaxed);
        };
        pipeline::run(job, &AtomicBool::new(false), seen).unwrap();
        assert_eq!((count.load(Ordering::Relaxed), passed.into_inner()), (reads, 3), "keep = {keep}");
        gloaming::sink::exr::read(&out.path().join("f_000002.exr")).unwrap().pixels
    });
    assert!(pictures[0] == pictures[1] && pictures[1] == pictures[2]);
}

/// A run that is taken up again does what is left, and its camera in orbit stands where it would have stood.
#[test]
fn a_resumed_run_does_what_is_left() {
    let whole = tempfile::tempdir().unwrap();
    let sets = ["field.range=[0.0, 1.0]", "light.tolerance=0", "light.scattering=false", "cameras.0.orbit=20"];
    run(job(smoke(), (30..38).collect(), scene(&sets), whole.path())).unwrap();
    let out = tempfile::tempdir().unwrap();
    let job = |resume| Job { resume, ..job(smoke(), (30..38).collect(), scene(&sets), out.path()) };
    let stop = AtomicBool::new(false);
    pipeline::run(job(false), &stop, &mut |p| stop.store(lit(&p) >= 2, Ordering::Relaxed)).unwrap();
    let first = |name: &str| std::fs::metadata(out.path().join(name)).unwrap().modified().unwrap();
    let before = first("f_000030.exr");
    let rows = |folder: &Path| gloaming::ledger::read(&folder.join("ledger.csv")).unwrap();
    let done = rows(out.path()).len();
    assert!((2..7).contains(&done), "the run was stopped after {done} steps");
    // One of a step's two files is missing; a file that no row of the ledger knows is not trusted.
    std::fs::remove_file(out.path().join("f_000031.png")).unwrap();
    for name in ["f_000037.png", "f_000037.exr"] {
        std::fs::write(out.path().join(name), b"half").unwrap();
    }
    let summary = run(job(true)).unwrap();
    assert_eq!((summary.skipped, summary.done, summary.rows[0].step), (done - 1, 9 - done, 31));
    assert_eq!(first("f_000030.exr"), before);
    for step in 30..38 {
        let read = |folder: &Path| gloaming::sink::exr::read(&folder.join(format!("f_{step:06}.exr"))).unwrap().pixels;
        assert!(read(out.path()) == read(whole.path()), "step {step}");
    }
    let mut steps: Vec<u64> = rows(out.path()).iter().map(|row| row.step).collect();
    steps.sort();
    assert_eq!(steps, (30..38).collect::<Vec<_>>());
    let summary = run(job(true)).unwrap();
    assert_eq!((summary.skipped, summary.done, summary.interrupted), (8, 0, false));
    // The description of all raw volumes lists those of the run before, too.
    let with_raw = |resume, indices: &[usize]| {
        let raw = out.path().join("l_{step:03}.raw").to_str().unwrap().to_string();
        let mut with_raw = Job { outputs: vec![raw], indices: indices.to_vec(), ..job(resume) };
        with_raw.ledger = None;
        run(with_raw).unwrap()
    };
    with_raw(false, &[30, 31]);
    let summary = with_raw(true, &[30, 31, 32]);
    assert_eq!((summary.skipped, summary.done), (2, 1));
    let all = out.path().join("l.xmf").to_str().unwrap().to_string();
    let listed =
        source::open(&SourceSpec { series: vec![all], component: Some("x".into()), ..Default::default() }).unwrap();
    assert_eq!(listed.info().steps.len(), 3);
    assert!((0..3).all(|i| listed.timestep(i).is_ok()));
    // A movie is written anew, all of it.
    let mut with_movie = job(true);
    with_movie.outputs.push(out.path().join("m.mp4").to_str().unwrap().into());
    let summary = run(with_movie).unwrap();
    assert_eq!((summary.skipped, summary.done), (0, 8));
}

#[test]
fn an_empty_selection_names_the_way_out() {
    let out = tempfile::tempdir().unwrap();
    let error = run(job(smoke(), vec![], scene(&[]), out.path())).unwrap_err().to_string();
    assert!(error.contains("48") && error.contains("gloaming info"), "{error}");
}

/// A target that disappears half-way ends the run with the sink's error and does not hang; frames done stay.
#[test]
fn a_failing_sink_ends_the_run() {
    let out = tempfile::tempdir().unwrap();
    let frames = out.path().join("frames");
    let mut job = job(smoke(), (0..40).collect(), scene(&[]), out.path());
    job.outputs = vec![frames.join("f_{step:06}.png").to_str().unwrap().into()];
    let frames_in = frames.clone();
    let error = pipeline::run(job, &AtomicBool::new(false), &mut |p| {
        if lit(&p) == 3 {
            std::fs::rename(&frames_in, frames_in.with_extension("moved")).unwrap();
            std::fs::write(&frames_in, "in the way").unwrap();
        }
    })
    .unwrap_err();
    assert!(matches!(error, Error::Io { .. }), "{error}");
    assert!(frames.with_extension("moved").join("f_000002.png").exists());
}

#[test]
fn stopping_keeps_what_is_done() {
    let out = tempfile::tempdir().unwrap();
    let stop = AtomicBool::new(false);
    let mut job = job(smoke(), (0..40).collect(), scene(&[]), out.path());
    job.outputs.push(out.path().join("movie.mp4").to_str().unwrap().into());
    let summary = pipeline::run(job, &stop, &mut |p| stop.store(lit(&p) >= 2, Ordering::Relaxed)).unwrap();
    assert!(summary.interrupted && summary.done >= 2 && summary.done < 40, "{} done", summary.done);
    assert!(out.path().join("movie.mp4").exists());
    assert!(out.path().join(format!("f_{:06}.png", summary.done - 1)).exists());
}

/// Steps pushed by a running simulation give the same pictures as the same steps from a file.
#[test]
fn pushed_steps_equal_read_steps() {
    let (a, b) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let fixed = &["field.range=[0.0, 1.0]"];
    run(job(smoke(), vec![10, 11, 12], scene(fixed), a.path())).unwrap();
    let target = b.path().join("f_{step:06}.png").to_str().unwrap().to_string();
    let mut scene = scene(fixed);
    scene.insitu.outputs = vec![target];
    let session = InSitu::with(scene).device(Arc::new(Cpu::new(2).unwrap())).open().unwrap();
    let series = smoke();
    for i in [10, 11, 12] {
        session.push_owned(series.timestep(i).unwrap()).unwrap();
    }
    assert_eq!(session.close().unwrap().lit, 3);
    for step in 10..13 {
        let name = format!("f_{step:06}.png");
        assert_eq!(
            std::fs::read(a.path().join(&name)).unwrap(),
            std::fs::read(b.path().join(&name)).unwrap(),
            "{name}"
        );
    }
}
