//! The simulation's own output: one HDF5 file that grows by a step at a time.
//!
//! `/density` (time, z, y, x) f4, one step a chunk, shuffled and gzipped, with the attributes `spacing`, `origin` (x, y, z)
//! and `units`; `/time` (time) f8.

use std::path::Path;

use anyhow::{Context, Result};

/// An HDF5 series being written.
pub struct Series {
    file: hdf5::File,
    density: hdf5::Dataset,
    time: hdf5::Dataset,
    size: [usize; 3],
}

impl Series {
    /// Creates the file, replacing one that is there. `size` counts values along x, y, z; `spacing` is their distance and
    /// the first value sits half of it inside the box.
    pub fn create(path: &Path, size: [usize; 3], spacing: f64) -> Result<Self> {
        let file = hdf5::File::create(path).with_context(|| format!("cannot create {}", path.display()))?;
        let [nx, ny, nz] = size;
        let density = file
            .new_dataset::<f32>()
            .shape((0.., nz, ny, nx))
            .chunk((1, nz, ny, nx))
            .shuffle()
            .deflate(4)
            .create("density")?;
        density.new_attr::<f64>().shape(3).create("spacing")?.write(&[spacing; 3])?;
        density.new_attr::<f64>().shape(3).create("origin")?.write(&[0.5 * spacing; 3])?;
        let units: hdf5::types::VarLenUnicode = "1".parse()?;
        density.new_attr::<hdf5::types::VarLenUnicode>().create("units")?.write_scalar(&units)?;
        let time = file.new_dataset::<f64>().shape(0..).chunk(64).create("time")?;
        Ok(Series { file, density, time, size })
    }

    /// Appends a step: values in (z, y, x) order.
    pub fn append(&mut self, time: f64, values: &[f32]) -> Result<()> {
        let [nx, ny, nz] = self.size;
        let steps = self.time.shape()[0];
        let values = ndarray::ArrayView::from_shape((nz, ny, nx), values)?;
        self.density.resize((steps + 1, nz, ny, nx))?;
        self.density.write_slice(&values, (steps, .., .., ..))?;
        self.time.resize(steps + 1)?;
        self.time.write_slice(&[time], steps..steps + 1)?;
        self.file.flush()?;
        Ok(())
    }
}
