//! Filters of HDF5, on files that h5py and hdf5plugin wrote; values are told bit by bit.

use std::process::Command;

use gloaming::Region;
use gloaming::field::Field;
use gloaming::source::open;

use super::{complaint, data, says, spec};

/// What `write_filters.py` writes.
fn told(x: usize, y: usize, z: usize) -> f64 {
    (x * x + 31 * y + 977 * z) as f64
}

/// Reads `regions` of every dataset of a file that `write_filters.py` wrote.
fn check(path: &str, regions: &[Region]) {
    let file = hdf5::File::open(path).unwrap();
    let names: Vec<String> = file.member_names().unwrap().into_iter().filter(|n| n != "zfp").collect();
    drop(file);
    assert!(names.len() > 70, "{names:?}");
    for name in names {
        let step = open(&spec(format!("{path}:/{name}"))).unwrap().timestep(0).unwrap();
        for region in regions {
            same(&name, &*step.field, *region);
        }
    }
}

fn same(name: &str, field: &dyn Field, region: Region) {
    let mut read = vec![0.0; region.len()];
    field.read_f64(region, &mut read).unwrap_or_else(|why| panic!("{name}: {why}"));
    let mut narrow = vec![0.0f32; region.len()];
    field.read(region, &mut narrow).unwrap();
    let ([i, j, k], [nx, ny, _]) = (region.start, region.size);
    for (n, (wide, narrow)) in read.iter().zip(&narrow).enumerate() {
        let (x, y, z) = (i + n % nx, j + n / nx % ny, k + n / nx / ny);
        let should = match name {
            "zeros" => 0.0,
            "nan" => f64::NAN,
            "absent" => 7.0,
            n if n.ends_with("i2") => f64::from(told(x, y, z) as i64 as i16),
            _ => told(x, y, z),
        };
        let same = *wide == should || wide.is_nan() && should.is_nan();
        assert!(same, "{name} at ({x}, {y}, {z}): {wide} instead of {should}");
        assert_eq!(narrow.to_bits(), (*wide as f32).to_bits(), "{name} at ({x}, {y}, {z})");
    }
}

#[test]
fn every_filter_gives_the_values_back() {
    let path = data("filters.h5");
    // Parts of chunks too, from one step, in turns.
    let regions = [([0; 3], [9, 8, 7]), ([3, 2, 1], [5, 6, 5]), ([8, 7, 6], [1, 1, 1])];
    check(&path, &regions.map(|(start, size)| Region { start, size }));
}

/// The same on chunks large enough for the blocks and streams inside of them; written when `GLOAMING_PYTHON` has
/// hdf5plugin, which `./x test` sees to.
#[test]
fn filters_of_large_chunks_give_the_values_back() {
    let Some(python) = std::env::var_os("GLOAMING_PYTHON") else { return };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("large.h5");
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/source/write_filters.py");
    let wrote = Command::new(python).arg(script).arg(&path).args(["93", "58", "41", "v108"]).status().unwrap();
    assert!(wrote.success(), "{script} needs h5py and hdf5plugin");
    check(path.to_str().unwrap(), &[Region { start: [0; 3], size: [93, 58, 41] }]);
}

#[test]
fn a_filter_that_is_not_read_is_named() {
    let message = complaint(&spec(data("filters.h5:/zfp")), Some(0));
    says(&message, &["filters.h5:/zfp", "filter 32013 (ZFP)", "HDF5_PLUGIN_PATH", "h5repack"]);
}

/// Reading brick by brick unpacks each chunk, but gives what reading at once gives; a damaged chunk costs only what
/// meets it.
#[test]
fn a_damaged_chunk_is_named_and_costs_only_the_regions_that_meet_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("damaged.h5");
    let file = hdf5::File::create(&path).unwrap();
    let values: Vec<f32> = (0..16 * 16 * 16).map(|i| ((i * 7919) % 1009) as f32).collect();
    let dataset = file.new_dataset::<f32>().shape((16, 16, 16)).chunk((8, 8, 8)).deflate(4).create("q").unwrap();
    dataset.write_raw(&values).unwrap();
    let chunk = (0..8).filter_map(|i| dataset.chunk_info(i)).find(|c| c.offset == [8, 0, 8]).unwrap();
    drop((dataset, file));
    let mut bytes = std::fs::read(&path).unwrap();
    bytes[chunk.addr as usize + chunk.size as usize / 2..][..8].fill(0xff);
    std::fs::write(&path, bytes).unwrap();
    let message = complaint(&spec(&path), Some(0));
    says(&message, &["damaged.h5:/q", "the chunk at (8, 0, 8)", "deflate"]);
    let step = open(&spec(&path)).unwrap().timestep(0).unwrap();
    for (n, damaged) in [(0, false), (1, false), (4, false), (5, true), (6, false)] {
        let start = [n % 2 * 8, n / 2 % 2 * 8, n / 4 * 8];
        let mut read = vec![0.0; 512];
        let outcome = step.field.read(Region { start, size: [8; 3] }, &mut read);
        assert_eq!(outcome.is_err(), damaged, "{start:?}");
        let should = |i: usize| values[((start[2] + i / 64) * 16 + start[1] + i / 8 % 8) * 16 + start[0] + i % 8];
        assert!(damaged || (0..512).all(|i| read[i] == should(i)), "{start:?}");
    }
}
