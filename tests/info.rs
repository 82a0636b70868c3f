//! `gloaming info`, as programs read it.
//!
//! Apart from the tests of the readers: a child process inherits the locks of HDF5 files that other tests are writing.

use std::process::{Command, Output};

use serde_json::{Value, json};

fn data(name: &str) -> String {
    format!("{}/tests/data/{name}", env!("CARGO_MANIFEST_DIR"))
}

fn info(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_gloaming")).arg("info").args(arguments).output().unwrap()
}

fn report(arguments: &[&str]) -> Value {
    let out = info(arguments);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    serde_json::from_slice(&out.stdout).unwrap()
}

#[test]
fn json_has_every_key_and_the_known_figures() {
    let file = data("oceananigans_thermal_bubble.nc");
    let told = report(&[&file, "--field", "T", "--stats", "--probe", "3,6,11", "--json"]);
    assert_eq!(told["layout"], "netCDF-4");
    assert_eq!(told["series"], json!([file]));
    assert_eq!(told["field"], "T");
    assert_eq!(
        told["candidates"][0],
        json!({ "name": "S", "shape": [2, 16, 16, 16], "dtype": "f64le", "kind": "scalar" })
    );
    let grid = json!({ "size": [16, 16, 16], "spacing": [6.25, 6.25, 6.25], "origin": [3.125, 3.125, -96.875], "units": "m", "centering": "node" });
    assert_eq!(told["grid"], grid);
    assert_eq!(told["warnings"], json!([]));
    let step = &told["steps"][1];
    assert_eq!((&step["step"], &step["time"], &step["valid"]), (&json!(1), &json!(60.0), &json!(4096)));
    // The second step's line in STATS.tsv.
    for (key, known) in
        [("min", 9.85), ("max", 9.86), ("mean", 9.85177979), ("std", 0.0036556095), ("probe", 9.85892357)]
    {
        let found = step[key].as_f64().unwrap();
        assert!((found - known).abs() <= 1e-6 * known, "{key} is {found}, not {known}");
    }
}

#[test]
fn settings_override_what_the_file_says_and_metadata_alone_reads_no_values() {
    let file = data("meep_ez.h5");
    let told =
        report(&[&file, "--axes", "xyzt", "--spacing", "0.5,1,2", "--origin", "1,2,3", "--time-step", "0.5", "--json"]);
    assert_eq!(told["grid"]["spacing"], json!([0.5, 1.0, 2.0]));
    assert_eq!(told["grid"]["origin"], json!([1.0, 2.0, 3.0]));
    assert_eq!(told["steps"].as_array().unwrap().len(), 40);
    assert_eq!(told["steps"][3]["time"], 1.5);
    assert_eq!(told["steps"][3]["min"], Value::Null);
}

#[test]
fn failures_say_why_on_stderr_and_leave_stdout_empty() {
    for (arguments, thing) in [
        (vec![data("oceananigans_thermal_bubble.nc")], "5 fields could be meant"),
        (vec![data("smoke.h5"), "--probe".into(), "96,0,0".into()], "outside of the grid of 96×96×96"),
        (vec![data("nowhere.h5")], "no such file"),
    ] {
        let out = info(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
        let told = String::from_utf8_lossy(&out.stderr);
        assert_eq!(out.status.code(), Some(1), "{told}");
        assert!(told.contains(thing) && out.stdout.is_empty(), "{told}");
    }
}
