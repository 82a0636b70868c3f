//! A series that grows while it is read: a thread writes as a simulation does, and every step comes out once and whole.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::sleep;
use std::time::Duration;

use gloaming::source::SourceSpec;
use gloaming::source::follow::{Following, Patience};

fn patience(idle: u64) -> Patience {
    let ms = Duration::from_millis;
    Patience { idle: ms(idle), settled: ms(400), poll: ms(20) }
}

fn all(numbers: &[u64]) -> Vec<usize> {
    (0..numbers.len()).collect()
}

/// The value of every cell of a step.
fn value(step: u64) -> f32 {
    step as f32 + 0.5
}

/// Follows until the end; number and outcome of each step, whose cells must all have its value.
fn follow(spec: SourceSpec, patience: Patience, end: Option<u64>) -> Vec<(u64, Result<(), String>)> {
    let stop = AtomicBool::new(false);
    let (found, mut following) = Following::open(spec, patience, Box::new(all), end, &stop).unwrap();
    assert_eq!(found.info().grid.size, [6, 5, 4]);
    drop(found);
    let mut taken = Vec::new();
    while let Some((step, opened)) = following.next(&stop) {
        let read = opened.and_then(|t| {
            let mut values = vec![0.0; t.grid.len()];
            t.field.read(t.grid.region(), &mut values).map(|()| values)
        });
        let read = read.map(|values| assert!(values.iter().all(|v| *v == value(step)), "step {step}: {values:?}"));
        taken.push((step, read.map_err(|e| e.to_string())));
    }
    taken
}

fn spec(series: &Path) -> SourceSpec {
    SourceSpec { series: vec![series.display().to_string()], ..Default::default() }
}

fn bytes(step: u64) -> Vec<u8> {
    (0..120).flat_map(|_| value(step).to_le_bytes()).collect()
}

fn raw(folder: &Path) -> SourceSpec {
    SourceSpec { raw: Some("dims=6x5x4,dtype=f32le".into()), ..spec(&folder.join("a_{step}.raw")) }
}

fn write(path: PathBuf, step: u64) {
    // In pieces, as a slow disk has it: half a file is no step.
    let bytes = bytes(step);
    std::fs::write(&path, &bytes[..200]).unwrap();
    sleep(Duration::from_millis(60));
    std::fs::write(&path, &bytes).unwrap();
}

#[test]
fn files_are_taken_as_they_appear() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path().to_owned();
    let writer = std::thread::spawn(move || {
        for step in [8, 9, 10, 11] {
            sleep(Duration::from_millis(80));
            write(at.join(format!("a_{step}.raw")), step);
        }
    });
    let taken = follow(raw(folder.path()), patience(60_000), Some(12));
    writer.join().unwrap();
    assert_eq!(taken, [8, 9, 10, 11].map(|step| (step, Ok(()))));
}

#[test]
fn a_marker_completes_a_step_and_the_end_is_not_waited_for() {
    let folder = tempfile::tempdir().unwrap();
    let slow = Patience { settled: Duration::from_secs(60), ..patience(60_000) };
    let at = folder.path().to_owned();
    let writer = std::thread::spawn(move || {
        for step in 0..3 {
            std::fs::write(at.join(format!("a_{step}.raw")), bytes(step)).unwrap();
            let marker = if step == 1 { "a_1.done".into() } else { format!("a_{step}.raw.done") };
            std::fs::write(at.join(marker), b"").unwrap();
        }
    });
    let begun = std::time::Instant::now();
    let taken = follow(raw(folder.path()), slow, Some(3));
    writer.join().unwrap();
    assert_eq!(taken, [0, 1, 2].map(|step| (step, Ok(()))));
    assert!(begun.elapsed().as_secs() < 15, "neither for the file to settle nor for the timeout");
}

#[test]
fn what_stays_damaged_is_lost_and_the_others_come() {
    let folder = tempfile::tempdir().unwrap();
    for step in 0..3 {
        let bytes = bytes(step);
        let length = if step == 1 { 300 } else { bytes.len() };
        std::fs::write(folder.path().join(format!("a_{step}.raw")), &bytes[..length]).unwrap();
    }
    let taken = follow(raw(folder.path()), patience(60_000), Some(3));
    assert_eq!(taken.iter().map(|(step, _)| *step).collect::<Vec<_>>(), [0, 1, 2]);
    assert!(taken[0].1.is_ok() && taken[2].1.is_ok());
    let why = taken[1].1.as_ref().unwrap_err();
    assert!(why.contains("step 1") && why.contains("a_1.raw") && why.contains("300"), "{why}");
}

/// Groups in one file, which takes the place of the one before each time.
#[test]
fn groups_are_taken_as_they_are_added() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.h5");
    let (at, next) = (path.clone(), folder.path().join("next.tmp"));
    let add = move |last: u64| {
        let file = hdf5::File::create(&next).unwrap();
        for step in 0..=last {
            let group = file.create_group(&format!("step_{step}")).unwrap();
            let dataset = group.new_dataset::<f32>().shape((4, 5, 6)).chunk((2, 5, 6)).deflate(1).create("q").unwrap();
            dataset.write_raw(&[value(step); 120]).unwrap();
        }
        drop(file);
        std::fs::rename(&next, &at).unwrap();
    };
    add(0);
    let writer = std::thread::spawn(move || {
        for last in 1..4 {
            sleep(Duration::from_millis(120));
            add(last);
        }
    });
    let taken = follow(spec(&path), patience(60_000), Some(4));
    writer.join().unwrap();
    assert_eq!(taken, [0, 1, 2, 3].map(|step| (step, Ok(()))));
}

/// A dataset that another process extends through SWMR, which it holds open all the while. Needs `GLOAMING_PYTHON`, as
/// `./x test` sets it.
#[test]
fn a_dataset_is_read_while_it_grows_through_swmr() {
    let Some(python) = std::env::var_os("GLOAMING_PYTHON") else { return };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("swmr.h5");
    let script = "
import h5py, numpy as np, sys, time
f = h5py.File(sys.argv[1], 'w', libver=('v110', 'v110'))
q = f.create_dataset('q', (0, 4, 5, 6), 'f4', maxshape=(None, 4, 5, 6), chunks=(1, 4, 5, 6), compression='gzip')
f.swmr_mode = True
for step in range(5):
    q.resize(step + 1, 0)
    q[step] = step + 0.5
    q.flush()
    time.sleep(0.2)
time.sleep(1)
";
    let mut writer = std::process::Command::new(python).args(["-c", script]).arg(&path).spawn().unwrap();
    let taken = follow(spec(&path), patience(60_000), Some(5));
    assert!(writer.wait().unwrap().success());
    assert_eq!(taken, [0, 1, 2, 3, 4].map(|step| (step, Ok(()))));
}

#[test]
fn nothing_at_all_is_an_error_and_a_stop_ends_the_wait() {
    let folder = tempfile::tempdir().unwrap();
    let stop = AtomicBool::new(false);
    let why = Following::open(raw(folder.path()), patience(200), Box::new(all), None, &stop).err().unwrap().to_string();
    assert!(why.contains("no file matches"), "{why}");

    std::fs::write(folder.path().join("a_1.raw"), bytes(1)).unwrap();
    let stop = Arc::new(AtomicBool::new(false));
    let (_, mut following) = Following::open(raw(folder.path()), patience(60_000), Box::new(all), None, &stop).unwrap();
    assert_eq!(following.next(&stop).map(|(step, _)| step), Some(1));
    let stopper = stop.clone();
    let thread = std::thread::spawn(move || {
        sleep(Duration::from_millis(100));
        stopper.store(true, Ordering::Relaxed);
    });
    assert!(following.next(&stop).is_none());
    thread.join().unwrap();
}
