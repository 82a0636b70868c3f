//! Series from files: figures against known numbers, layouts, and files as they come from outside.

mod filters;
mod generic;
mod headed;
mod known;
mod layouts;
mod malformed;
mod metadata;
mod originals;
mod properties;
mod raw;
mod refined;
mod uneven;

use std::path::{Path, PathBuf};

use gloaming::grid::Region;
use gloaming::source::{Series, SourceSpec, open};
use hdf5::{File, Group, H5Type};
use ndarray::{Array3, ArrayD, IxDyn};

/// A file in tests/data.
fn data(name: &str) -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name).display().to_string()
}

fn spec(series: impl Into<PathBuf>) -> SourceSpec {
    SourceSpec { series: vec![series.into().display().to_string()], ..SourceSpec::default() }
}

/// Lengths along x, y, z of the volumes written here: all different, so that swapped axes show.
const SIZE: [usize; 3] = [5, 4, 3];

/// The value written at (x, y, z) of a step and component: every digit tells one index.
fn value(step: usize, component: usize, [x, y, z]: [usize; 3]) -> f64 {
    (x + 10 * y + 100 * z + 1000 * component + 10_000 * step) as f64
}

/// An array whose axes are spelled by `axes`, slowest first, `steps` steps and `components` components long.
fn array(axes: &str, steps: usize, components: usize) -> ArrayD<f64> {
    let length = |axis: char| match axis {
        'x' => SIZE[0],
        'y' => SIZE[1],
        'z' => SIZE[2],
        't' => steps,
        _ => components,
    };
    let shape: Vec<usize> = axes.chars().map(length).collect();
    ArrayD::from_shape_fn(IxDyn(&shape), |index| {
        let at = |axis: char| axes.find(axis).map_or(0, |place| index[place]);
        value(at('t'), at('c'), [at('x'), at('y'), at('z')])
    })
}

/// The same for one step in (z, y, x) order.
fn volume(step: usize) -> Array3<f64> {
    Array3::from_shape_fn((SIZE[2], SIZE[1], SIZE[0]), |(z, y, x)| value(step, 0, [x, y, z]))
}

fn write<T: H5Type>(group: &Group, name: &str, values: &ArrayD<T>) -> hdf5::Dataset {
    group.new_dataset_builder().with_data(values.view()).create(name).unwrap()
}

fn attribute(at: &hdf5::Location, name: &str, values: &[f64]) {
    match values {
        [one] => at.new_attr::<f64>().create(name).unwrap().write_scalar(one).unwrap(),
        _ => at.new_attr::<f64>().shape([values.len()]).create(name).unwrap().write(values).unwrap(),
    }
}

fn text_attribute(at: &hdf5::Location, name: &str, text: &str) {
    let text: hdf5::types::VarLenUnicode = text.parse().unwrap();
    at.new_attr::<hdf5::types::VarLenUnicode>().create(name).unwrap().write_scalar(&text).unwrap();
}

fn create(folder: &tempfile::TempDir, name: &str) -> (PathBuf, File) {
    let path = folder.path().join(name);
    let file = File::create(&path).unwrap();
    (path, file)
}

/// All values of a step, in f64.
fn all(series: &dyn Series, index: usize) -> Vec<f64> {
    let step = series.timestep(index).unwrap();
    let mut values = vec![0.0; step.grid.len()];
    step.field.read_f64(step.grid.region(), &mut values).unwrap();
    values
}

/// The same on the file's own grid, before uneven axes are resampled.
fn own(series: &dyn Series, index: usize) -> Vec<f64> {
    let step = series.native(index).unwrap().step;
    let mut values = vec![0.0; step.grid.len()];
    step.field.read_f64(step.grid.region(), &mut values).unwrap();
    values
}

/// What opening, or opening the `step`-th step and reading it, says is wrong.
fn complaint(spec: &SourceSpec, step: Option<usize>) -> String {
    let series = match (open(spec), step) {
        (Err(why), None) => return why.to_string(),
        (Err(why), Some(_)) => panic!("the series should open: {why}"),
        (Ok(series), _) => series,
    };
    let step = series.timestep(step.expect("the series should not open")).and_then(|step| {
        let mut values = vec![0.0; step.grid.len()];
        step.field.read(Region { start: [0; 3], size: step.grid.size }, &mut values)
    });
    step.expect_err("the step should not be readable").to_string()
}

/// Asserts that a message says all of these things.
fn says(message: &str, things: &[&str]) {
    for thing in things {
        assert!(message.contains(thing), "`{thing}` is not in: {message}");
    }
}
