//! Reads whatever a file of the given bytes offers. Only panics, hangs and runaway memory are findings.

use std::path::PathBuf;
use std::sync::OnceLock;

use gloaming::source::{SourceSpec, open};

/// Values that are read at most: the parsers are what is tested.
const MOST: usize = 1 << 14;

/// The file that every run writes anew, in memory where the system has such a place.
pub fn place(name: &str) -> PathBuf {
    static FOLDER: OnceLock<tempfile::TempDir> = OnceLock::new();
    let new = || tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).expect("a folder");
    FOLDER.get_or_init(new).path().join(name)
}

/// Opens `bytes` as a file called `name` and reads its first steps.
pub fn read(name: &str, bytes: &[u8], raw: Option<&str>) {
    let path = place(name);
    std::fs::write(&path, bytes).expect("the file is written");
    let spec = SourceSpec {
        series: vec![path.display().to_string()],
        raw: raw.map(String::from),
        ..SourceSpec::default()
    };
    let Ok(series) = open(&spec) else { return };
    for index in 0..series.info().steps.len().min(2) {
        let Ok(step) = series.timestep(index) else { continue };
        if step.grid.len() <= MOST {
            let _ = step.field.read_f64(step.grid.region(), &mut vec![0.0; step.grid.len()]);
        }
    }
}
