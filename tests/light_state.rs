//! Light kept in a file: a run that goes on where another ended makes the same frames as one that was never interrupted.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use gloaming::device::cpu::Cpu;
use gloaming::light_state::LightState;
use gloaming::pipeline::{self, Job, Summary};
use gloaming::scene::Scene;
use gloaming::session::Session;
use gloaming::source::{self, Series, SourceSpec};
use gloaming::{Error, Result};

fn series() -> Box<dyn Series> {
    let smoke = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/smoke.h5");
    source::open(&SourceSpec { series: vec![smoke.into()], ..Default::default() }).unwrap()
}

fn session(sets: &[&str]) -> Session {
    let common =
        ["render.size=[32, 24]", "light.resolution=0.25", "light.direct_resolution=0.25", "light.directions=8"];
    let sets: Vec<String> = common.iter().chain(sets).map(|s| s.to_string()).collect();
    Session::new(Arc::new(Cpu::new(2).unwrap()), Scene::load(None, &sets).unwrap(), None, false).unwrap()
}

/// Pixels' bits of some steps, and how each started.
fn run(session: &mut Session, steps: std::ops::Range<usize>) -> Vec<(Vec<u32>, String)> {
    let series = series();
    steps
        .map(|i| {
            let output = session.advance(series.timestep(i).unwrap()).unwrap();
            let bits = output.frames[0].frame.pixels.as_flattened().iter().map(|v| v.to_bits()).collect();
            (bits, output.row.start)
        })
        .collect()
}

/// Six steps at once, and three, a file, and three more: the same to the bit, whatever the tolerance; all kinds of unknowns, a camera
/// that orbits and a range that grows.
#[test]
fn a_run_goes_on_as_if_it_had_never_ended() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("new/light.h5");
    for sets in [
        &["light.tolerance=0"][..],
        &["light.tolerance=1e-3", "cameras.0.orbit=5"],
        &["light.tolerance=1e-3", "transfer.anisotropy=0.6", "transfer.albedo=0.995", "transfer.colormap=white"],
        &["light.scattering=false", "light.tolerance=1e-2"],
    ] {
        let whole = run(&mut session(sets), 20..26);
        let mut first = session(sets);
        let mut parts = run(&mut first, 20..23);
        first.light_state().unwrap().write(&path).unwrap();
        drop(first);
        let mut second = session(sets);
        second.start_from(LightState::read(&path).unwrap());
        parts.extend(run(&mut second, 23..26));
        assert_eq!(parts[3].1, "warm", "{sets:?}");
        for (n, (part, whole)) in parts.iter().zip(&whole).enumerate() {
            assert!(part == whole, "{sets:?}: step {n} differs");
        }
    }
    assert_eq!(std::fs::read_dir(path.parent().unwrap()).unwrap().count(), 1, "nothing else is left in the folder");
}

#[test]
fn light_that_does_not_fit_is_a_cold_start() {
    let mut first = session(&["light.tolerance=1e-3"]);
    assert!(first.light_state().is_err(), "nothing is lit yet");
    run(&mut first, 20..21);
    let kept = first.light_state().unwrap();
    for sets in [&["light.resolution=0.5"][..], &["lights.0.direction=[0, 0, -1]"], &["transfer.anisotropy=0.3"]] {
        let mut other = session(sets);
        other.start_from(kept.clone());
        assert_eq!(run(&mut other, 21..22)[0].1, "cold", "{sets:?}");
    }
    // Volumes that are gone, or of another size.
    for damage in [|k: &mut LightState| k.volumes.truncate(1), |k: &mut LightState| k.volumes[0].1.truncate(9)] {
        let mut damaged = kept.clone();
        damage(&mut damaged);
        let mut other = session(&["light.tolerance=1e-3"]);
        other.start_from(damaged);
        assert_eq!(run(&mut other, 21..22), run(&mut session(&["light.tolerance=1e-3"]), 21..22));
    }
    // Another tolerance and another transfer function are no obstacle.
    let mut other = session(&["light.tolerance=1e-2", "transfer.opacity=[[0.0, 0.0], [1.0, 0.3]]"]);
    other.start_from(kept);
    assert_eq!(run(&mut other, 21..22)[0].1, "warm");
}

#[test]
fn files_that_are_something_else_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("text.h5"), "not HDF5").unwrap();
    hdf5::File::create(at("other.h5")).unwrap();
    let mut first = session(&[]);
    run(&mut first, 20..21);
    first.light_state().unwrap().write(&at("cut.h5")).unwrap();
    let bytes = std::fs::read(at("cut.h5")).unwrap();
    std::fs::write(at("cut.h5"), &bytes[..bytes.len() / 2]).unwrap();
    for name in ["text.h5", "other.h5", "cut.h5"] {
        match LightState::read(&at(name)) {
            Err(e @ Error::Format { .. }) => assert!(e.to_string().contains("--light-state"), "{e}"),
            other => panic!("{name}: {other:?}"),
        }
    }
    assert!(matches!(LightState::read(&at("none.h5")), Err(Error::Io { .. })));
}

fn job(steps: std::ops::Range<usize>, out: &Path) -> Job {
    let sets = [
        "render.size=[48, 32]",
        "light.resolution=0.25",
        "light.direct_resolution=0.25",
        "light.directions=8",
        "field.range=[0, 1]",
    ];
    let sets: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
    Job {
        series: series(),
        indices: steps.collect(),
        scene: Scene::load(None, &sets).unwrap(),
        device: Arc::new(Cpu::new(2).unwrap()),
        outputs: vec![out.join("{step:02}.exr").to_str().unwrap().into()],
        ledger: None,
        follow: None,
        resume: false,
        keep: 0,
        light_state: Some(out.join("light.h5")),
    }
}

fn drive(job: Job) -> Result<Summary> {
    pipeline::run(job, &AtomicBool::new(false), &mut |_| ())
}

#[test]
fn a_pipeline_leaves_its_light_for_the_next() {
    let folder = tempfile::tempdir().unwrap();
    let first = drive(job(20..22, folder.path())).unwrap();
    assert_eq!(first.rows[0].start, "cold");
    assert_eq!(LightState::read(&folder.path().join("light.h5")).unwrap().about.steps, 2);
    let second = drive(job(22..24, folder.path())).unwrap();
    assert!(second.rows.iter().all(|r| r.start == "warm"));
    assert_eq!(LightState::read(&folder.path().join("light.h5")).unwrap().about.steps, 4);
    let mut paper = job(22..24, folder.path());
    paper.scene.light.model = gloaming::scene::Model::Paper;
    assert!(drive(paper).unwrap_err().to_string().contains("paper"));
}
