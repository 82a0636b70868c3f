//! Illuminated volumes are read back by VTK's own readers.

use std::path::Path;
use std::process::Command;
use std::sync::Arc;

use gloaming::Grid;
use gloaming::ledger::LedgerRow;
use gloaming::scene::Scene;
use gloaming::sink::{self, IlluminatedVolume, Output, Sink, SinkOptions};

const GRID: Grid = Grid { size: [7, 5, 4], spacing: [0.5, 1.0, 2.0], origin: [3.0, -1.0, 0.25] };

/// Values that differ in every voxel, channel and step.
fn light(grid: Grid, seed: u32) -> IlluminatedVolume {
    let value = |i: usize, c: usize| (3 * i + c) as f32 * 0.1 + seed as f32 * 1000.0;
    IlluminatedVolume { grid, fluence: (0..grid.len()).map(|i| std::array::from_fn(|c| value(i, c))).collect() }
}

fn output(step: u64, time: Option<f64>, light: IlluminatedVolume) -> Output {
    Output { step, time, range: [0.0, 1.0], frames: vec![], light: Some(Arc::new(light)), row: LedgerRow::default() }
}

fn open(folder: &Path, name: &str) -> Box<dyn Sink> {
    let sink = sink::open(folder.join(name).to_str().unwrap(), &SinkOptions::from(&Scene::default())).unwrap();
    assert!(sink.wants_light() && !sink.wants_frames());
    sink
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> =
        std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// What VTK reads: its description, and all values.
fn with_vtk(file: &Path) -> (serde_json::Value, Vec<f32>) {
    let values = tempfile::NamedTempFile::new().unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/read_with_vtk.py");
    let run = Command::new("python3").args([&script, file]).arg("fluence").arg(values.path()).output();
    let run = run.expect("python3 is needed to read files with VTK: install it, then pip install vtk numpy");
    let said = String::from_utf8_lossy(&run.stderr);
    assert!(run.status.success(), "{said}");
    assert!(!said.contains("ERR|"), "{said}");
    let bytes = std::fs::read(values.path()).unwrap();
    let values = bytes.chunks_exact(4).map(|b| f32::from_ne_bytes(b.try_into().unwrap())).collect();
    (serde_json::from_slice(&run.stdout).unwrap(), values)
}

fn check_geometry(said: &serde_json::Value) {
    for step in said["steps"].as_array().unwrap() {
        assert_eq!(step["kind"], "vtkImageData");
        assert_eq!(step["size"], serde_json::json!([7, 5, 4]));
        assert_eq!(step["spacing"], serde_json::json!([0.5, 1.0, 2.0]));
        assert_eq!(step["origin"], serde_json::json!([3.0, -1.0, 0.25]));
        assert_eq!((&step["components"], &step["type"]), (&3.into(), &"float".into()));
    }
}

fn flat(volumes: &[IlluminatedVolume]) -> Vec<f32> {
    volumes.iter().flat_map(|v| v.fluence.iter().flatten().copied()).collect()
}

#[test]
fn vtk_reads_the_illuminated_volume_of_every_step() {
    let folder = tempfile::tempdir().unwrap();
    let mut sink = open(folder.path(), "out/light.vtkhdf");
    let out = folder.path().join("out");
    for (n, step) in [3u64, 9, 12].into_iter().enumerate() {
        sink.write(&output(step, Some(0.1 * step as f64), light(GRID, n as u32))).unwrap();
        assert_eq!(names(&out), ["light.partial.vtkhdf"]);
    }
    // A step done again takes the place of the one before.
    sink.write(&output(9, Some(0.95), light(GRID, 7))).unwrap();
    sink.finish().unwrap();
    assert_eq!(names(&out), ["light.vtkhdf"]);

    let (said, values) = with_vtk(&out.join("light.vtkhdf"));
    assert_eq!(said["times"], serde_json::json!([0.1 * 3.0, 0.95, 0.1 * 12.0]));
    check_geometry(&said);
    assert_eq!(values, flat(&[light(GRID, 0), light(GRID, 7), light(GRID, 2)]));

    let file = hdf5::File::open(out.join("light.vtkhdf")).unwrap();
    assert_eq!(file.dataset("step").unwrap().read_raw::<u64>().unwrap(), [3, 9, 12]);
}

/// A volume of several chunks, the last one thinner.
#[test]
fn large_volumes_come_back_too() {
    let folder = tempfile::tempdir().unwrap();
    let grid = Grid::new([130, 120, 50]);
    let mut sink = open(folder.path(), "light.vtkhdf");
    for step in 0..3 {
        sink.write(&output(step, None, light(grid, step as u32))).unwrap();
    }
    sink.finish().unwrap();
    let (_, values) = with_vtk(&folder.path().join("light.vtkhdf"));
    assert!(values == flat(&[light(grid, 0), light(grid, 1), light(grid, 2)]));
}

#[test]
fn a_killed_run_leaves_the_steps_it_did() {
    let folder = tempfile::tempdir().unwrap();
    let mut sink = open(folder.path(), "light.vtkhdf");
    for step in 0..2 {
        sink.write(&output(step, None, light(GRID, step as u32))).unwrap();
    }
    // The state on disk, while the file is still open.
    std::fs::copy(folder.path().join("light.partial.vtkhdf"), folder.path().join("copy.vtkhdf")).unwrap();
    let (said, values) = with_vtk(&folder.path().join("copy.vtkhdf"));
    assert_eq!(said["times"], serde_json::json!([0.0, 1.0]));
    assert_eq!(values, flat(&[light(GRID, 0), light(GRID, 1)]));
    drop(sink);
    assert_eq!(names(folder.path()), ["copy.vtkhdf", "light.partial.vtkhdf"]);
}

#[test]
fn another_grid_part_way_is_refused_and_the_steps_before_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let mut sink = open(folder.path(), "light.vtkhdf");
    sink.write(&output(1, None, light(GRID, 1))).unwrap();
    let other = Grid::new([7, 5, 5]);
    let message = sink.write(&output(2, None, light(other, 2))).unwrap_err().to_string();
    assert!(message.contains("step 2") && message.contains("light_{step:06}.raw"), "{message}");
    sink.finish().unwrap();
    assert_eq!(with_vtk(&folder.path().join("light.vtkhdf")).1, flat(&[light(GRID, 1)]));
}

#[test]
fn raw_volumes_are_described_for_each_step_and_for_the_series() {
    let folder = tempfile::tempdir().unwrap();
    let mut sink = open(folder.path(), "out/light_{step:04}.raw");
    let out = folder.path().join("out");
    for (n, step) in [3u64, 9, 12].into_iter().enumerate() {
        sink.write(&output(step, Some(0.1 * step as f64), light(GRID, n as u32))).unwrap();
    }
    sink.write(&output(12, Some(1.25), light(GRID, 5))).unwrap();
    sink.finish().unwrap();
    let names_of = |step: u32| [format!("light_{step:04}.raw"), format!("light_{step:04}.xmf")];
    let expected = [vec!["light.xmf".to_string()], [3, 9, 12].map(names_of).concat()].concat();
    assert_eq!(names(&out), expected);
    assert!(sink.paths(9).iter().all(|p| p.exists()));

    let bytes: Vec<u8> = flat(&[light(GRID, 1)]).iter().flat_map(|v| v.to_le_bytes()).collect();
    assert_eq!(std::fs::read(out.join("light_0009.raw")).unwrap(), bytes);

    let (said, values) = with_vtk(&out.join("light.xmf"));
    assert_eq!(said["times"], serde_json::json!([0.1 * 3.0, 0.1 * 9.0, 1.25]));
    check_geometry(&said);
    assert_eq!(values, flat(&[light(GRID, 0), light(GRID, 1), light(GRID, 5)]));

    let (said, values) = with_vtk(&out.join("light_0009.xmf"));
    check_geometry(&said);
    assert_eq!(values, flat(&[light(GRID, 1)]));
}

/// With file sizes limited (as with a full disk) the error names the file, and the steps that fitted are kept. The test
/// runs itself under the limit.
#[test]
fn a_full_disk_keeps_the_steps_that_fitted() {
    const FOLDER: &str = "GLOAMING_TEST_LIMITED_FOLDER";
    let grid = Grid::new([16, 16, 16]);
    if let Ok(folder) = std::env::var(FOLDER) {
        let mut sink = open(Path::new(&folder), "light.vtkhdf");
        let failed = (0..500).find_map(|n| sink.write(&output(n, None, light(grid, n as u32))).err().map(|e| (n, e)));
        let (n, e) = failed.expect("a full disk");
        assert!(n >= 2 && e.to_string().contains("light.partial.vtkhdf"), "{n}: {e}");
        sink.finish().unwrap();
        std::fs::write(Path::new(&folder).join("steps"), n.to_string()).unwrap();
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let run = Command::new("bash")
        .args(["-c", r#"trap "" XFSZ; ulimit -f 220; exec "$@""#, "limited"])
        .arg(std::env::current_exe().unwrap())
        .args(["--exact", "a_full_disk_keeps_the_steps_that_fitted", "--nocapture"])
        .env(FOLDER, folder.path())
        .output()
        .unwrap();
    assert!(run.status.success(), "{}{}", String::from_utf8_lossy(&run.stdout), String::from_utf8_lossy(&run.stderr));
    assert_eq!(names(folder.path()), ["light.vtkhdf", "steps"]);
    let steps: u32 = std::fs::read_to_string(folder.path().join("steps")).unwrap().parse().unwrap();
    let (said, values) = with_vtk(&folder.path().join("light.vtkhdf"));
    assert_eq!(said["times"].as_array().unwrap().len(), steps as usize);
    assert_eq!(values, flat(&(0..steps).map(|n| light(grid, n)).collect::<Vec<_>>()));
}
