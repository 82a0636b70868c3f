//! A compressed step of 256³ against h5py's single thread on the same file: gloaming unpacks chunks on all cores,
//! outside of HDF5's lock.

use std::path::Path;
use std::process::Command;
use std::time::Instant;

use gloaming::source::{self, SourceSpec};
use rand::{RngExt, SeedableRng};

const N: usize = 256;
const RUNS: usize = 5;

/// Reads the dataset as often as we do, prints the best time.
const H5PY: &str = "
import h5py, numpy as np, sys, time
best = 1e9
for _ in range(int(sys.argv[2])):
    with h5py.File(sys.argv[1]) as f:
        begun = time.perf_counter()
        values = f['q'][...]
        best = min(best, time.perf_counter() - begun)
print(best)
";

fn main() {
    let folder = tempfile::tempdir().expect("a folder");
    let values = smoke();
    for (name, chunk, shuffle) in [
        ("gzip 4, chunks of 64³", [64; 3], false),
        ("gzip 4 and shuffle, chunks of 64³", [64; 3], true),
        ("gzip 4 and shuffle, chunks of 16×32×32", [16, 32, 32], true),
        ("gzip 4 and shuffle, chunks of one plane", [1, N, N], true),
    ] {
        let path = folder.path().join("step.h5");
        write(&path, &values, chunk, shuffle);
        let packed = std::fs::metadata(&path).expect("a length").len();
        let spec = SourceSpec { series: vec![path.display().to_string()], ..Default::default() };
        let mut read = vec![0.0f32; N * N * N];
        let ours = best(|| {
            // Opened anew each time: nothing is kept from one run to the next.
            let step = source::open(&spec).expect("the file").timestep(0).expect("the step");
            step.field.read(step.grid.region(), &mut read).expect("values");
        });
        assert!(read == values, "other values than were written");
        let plain = best(|| {
            let dataset = hdf5::File::open(&path).expect("the file").dataset("q").expect("the dataset");
            drop(dataset.read_raw::<f32>().expect("values"));
        });
        let rate = |seconds: f64| 4e-6 * values.len() as f64 / seconds;
        print!(
            "{name} ({:.0} MB): {:.0} ms, {:.0} MB/s; HDF5 on one thread {:.0} ms, {:.1} ×",
            packed as f64 * 1e-6,
            ours * 1e3,
            rate(ours),
            plain * 1e3,
            plain / ours
        );
        match h5py(&path) {
            Some(seconds) => println!("; h5py {:.0} ms, {:.1} ×", seconds * 1e3, seconds / ours),
            None => println!("; no h5py (GLOAMING_PYTHON names a Python that has it)"),
        }
    }
}

fn best(mut run: impl FnMut()) -> f64 {
    let timed = |_| {
        let begun = Instant::now();
        run();
        begun.elapsed().as_secs_f64()
    };
    (0..RUNS).map(timed).fold(f64::INFINITY, f64::min)
}

fn h5py(path: &Path) -> Option<f64> {
    let python = std::env::var_os("GLOAMING_PYTHON").unwrap_or("python3".into());
    let output = Command::new(python).args(["-c", H5PY]).arg(path).arg(RUNS.to_string()).output().ok()?;
    String::from_utf8(output.stdout).ok()?.trim().parse().ok()
}

/// Billows that fill half of the box, with the noise of a solver's single precision.
fn smoke() -> Vec<f32> {
    let mut random = rand_xorshift::XorShiftRng::seed_from_u64(7);
    let at = |i: usize| i as f32 / N as f32;
    let mut value = |i: usize, j: usize, k: usize| {
        let (x, y, z) = (at(i), at(j), at(k));
        let billow = (9.0 * x + 4.0 * (7.0 * z).sin()).sin() * (11.0 * y).cos() * (5.0 * z).sin();
        if billow > 0.0 { billow * (1.0 + 1e-3 * random.random::<f32>()) } else { 0.0 }
    };
    (0..N * N * N).map(|v| value(v % N, v / N % N, v / N / N)).collect()
}

fn write(path: &Path, values: &[f32], chunk: [usize; 3], shuffle: bool) {
    let file = hdf5::File::create(path).expect("the file");
    let mut builder = file.new_dataset::<f32>().shape((N, N, N)).chunk((chunk[0], chunk[1], chunk[2]));
    if shuffle {
        builder = builder.shuffle();
    }
    builder.deflate(4).create("q").expect("the dataset").write_raw(values).expect("values");
}
