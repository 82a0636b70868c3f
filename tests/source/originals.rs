//! Files written by the software whose formats they are, against figures that NumPy worked out: `originals.py` makes both.

use std::process::Command;

use gloaming::source::{SourceSpec, open, statistics, statistics_of};
use serde_json::Value;

use super::{complaint, data, own, says, spec};

/// A Python with the packages of `originals.py`: `./x test` puts one first.
fn write_all(folder: &std::path::Path) {
    let python = std::env::var_os("GLOAMING_PYTHON").unwrap_or("python3".into());
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/source/originals.py");
    let run = Command::new(&python).arg(script).arg(folder).output();
    let run = run.expect("python3 is needed to write the files: ./x test installs what it needs");
    let said = String::from_utf8_lossy(&run.stderr);
    assert!(run.status.success(), "./x test makes a Python with what this needs; {python:?} says\n{said}");
}

/// The number of a case, to `within` of its size, or of 1e-12 where it is 0.
fn close(is: f64, was: &Value, within: f64) -> bool {
    let was = was.as_f64().unwrap();
    (is - was).abs() <= within * was.abs() + 1e-12
}

fn three(value: &Value) -> Vec<&Value> {
    value.as_array().unwrap().iter().collect()
}

fn agrees(folder: &std::path::Path, case: &Value) {
    let text = |key: &str| case[key].as_str().map(String::from);
    let asked = SourceSpec {
        field: text("field"),
        component: text("component"),
        axes: text("axes"),
        ..spec(folder.join(text("file").unwrap()))
    };
    let name = format!("{} {:?} {:?}", asked.series[0], asked.field, asked.component);
    let within = case["close"].as_f64().unwrap_or(1e-6);
    let series = open(&asked).unwrap_or_else(|e| panic!("{name}: {e}"));
    let info = series.info();
    assert_eq!(info.layout, text("layout").unwrap(), "{name}");
    assert_eq!(
        info.grid.size.to_vec(),
        three(&case["size"]).iter().map(|n| n.as_u64().unwrap() as usize).collect::<Vec<_>>()
    );
    for (is, was) in [(info.grid.spacing, &case["spacing"]), (info.grid.origin, &case["origin"])] {
        assert!(is.iter().zip(three(was)).all(|(a, b)| close(*a, b, within)), "{name}: {is:?}, not {was}");
    }
    for (is, key) in [(&info.units, "units"), (&info.time_units, "time_units")] {
        assert!(text(key).is_none_or(|was| *is == was), "{name}: {key} {is:?}");
    }
    let warned: Vec<&str> = case["warns"].as_array().unwrap().iter().map(|w| w.as_str().unwrap()).collect();
    says(&info.warnings.join("\n"), &warned);
    let steps = case["steps"].as_array().unwrap();
    assert_eq!(info.steps.len(), steps.len(), "{name}");
    for (index, was) in steps.iter().enumerate() {
        let native = series.native(index).unwrap();
        assert_eq!(native.step.step, was["step"].as_u64().unwrap(), "{name}");
        match native.step.time {
            None => assert!(was["time"].is_null(), "{name}: no time, not {}", was["time"]),
            Some(t) => assert!(close(t, &was["time"], 1e-6), "{name}: time {t}, not {}", was["time"]),
        }
        let found = statistics_of(&native.pieces).unwrap();
        for (is, key) in [(found.min, "min"), (found.max, "max"), (found.mean, "mean"), (found.std, "std")] {
            assert!(close(is, &was[key], within), "{name} step {index}: {key} {is}, not {}", was[key]);
        }
        assert_eq!(found.valid as u64, was["valid"].as_u64().unwrap(), "{name}");
        let [nx, ny, nz] = native.step.grid.size;
        let probe = own(series.as_ref(), index)[native.step.grid.index([nx / 5, 2 * ny / 5, 7 * nz / 10])];
        assert!(if was["probe"].is_null() { probe.is_nan() } else { close(probe, &was["probe"], within) }, "{name}");
        // What is shown is finite, and inside of the range, wherever it is not a hole.
        let shown = statistics(&series.timestep(index).unwrap()).unwrap();
        let reach = 1e-9 * (found.max - found.min);
        assert!(
            shown.valid > 0 && shown.min >= found.min - reach && shown.max <= found.max + reach,
            "{name}: {shown:?}"
        );
    }
}

#[test]
fn files_of_other_software_agree_with_numpy() {
    let folder = tempfile::tempdir().unwrap();
    write_all(folder.path());
    let cases = std::fs::read_to_string(folder.path().join("expected.json")).unwrap();
    let cases: Vec<Value> = serde_json::from_str(&cases).unwrap();
    assert!(cases.len() > 30, "{} cases", cases.len());
    cases.iter().for_each(|case| agrees(folder.path(), case));
    let refused = |name: &str| complaint(&spec(folder.path().join(name)), None);
    says(&refused("classic.nc"), &["classic.nc", "classic format", "nccopy -k nc4"]);
    says(&refused("bzip2.nrrd"), &["bzip2.nrrd", "`bzip2`", "unu save -e raw"]);
    says(&refused("tetra.xdmf"), &["tetra.xdmf", "3DCoRectMesh"]);
    says(&refused("tetra.vtu"), &["tetra.vtu", "UnstructuredGrid", "Resample To Image"]);
    says(&refused("tetra.vtk"), &["tetra.vtk", "UNSTRUCTURED_GRID", "Resample To Image"]);
}

/// yt's own writer of the Grid Data Format: `1 + 2x + 3y + 5z` in g/cm³ on 8×4×4 cells of 0.5 cm, and 1000 more on a finer
/// patch over the unit cube at (1, 0, 0).
#[test]
fn a_grid_data_format_file_of_yt() {
    let series = open(&spec(data("yt.gdf"))).unwrap();
    let info = series.info();
    assert_eq!(
        (info.layout.as_str(), info.field.as_str(), info.units.as_str()),
        ("Grid Data Format", "density", "g/cm**3")
    );
    assert_eq!((info.grid.size, info.grid.spacing, info.grid.origin), ([16, 8, 8], [0.25; 3], [0.125; 3]));
    assert_eq!((info.grid.units.as_str(), info.steps[0].time), ("cm", Some(2.5)));
    let step = series.timestep(0).unwrap();
    let mut values = vec![0.0; step.grid.len()];
    step.field.read_f64(step.grid.region(), &mut values).unwrap();
    for (n, v) in values.iter().enumerate() {
        let at = [n % 16, n / 16 % 8, n / 128];
        let fine = (4..8).contains(&at[0]) && at[1] < 4 && at[2] < 4;
        let x = at.map(|i| if fine { 0.25 * (i as f64 + 0.5) } else { 0.5 * ((i / 2) as f64 + 0.5) });
        let wanted = 1.0 + 2.0 * x[0] + 3.0 * x[1] + 5.0 * x[2] + if fine { 1000.0 } else { 0.0 };
        assert!((v - wanted).abs() < 1e-9, "{v}, not {wanted} at {at:?}");
    }
}
