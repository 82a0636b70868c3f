//! VTKHDF: the illuminated volume of all steps in one file, which ParaView opens.
//!
//! Temporal ImageData, version 2.2 of the format: `/VTKHDF/PointData/fluence` is (t, z, y, x, rgb) in f32, `Steps/Values`
//! holds physical time (the step number where time is not known) and `/step` the simulation's step numbers. While there
//! is one step only, the array is (z, y, x, rgb): VTK 9.7 takes a file with `NSteps` = 1 for one without time.
//!
//! The file grows as `light.partial.vtkhdf` and is flushed after each step: a run that is killed leaves what it did.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use hdf5::types::FixedAscii;
use hdf5::{Dataset, Extent, Group, H5Type};
use ndarray::{Axis, s};

use super::template::Template;
use super::{IlluminatedVolume, Output, Sink, SinkOptions};
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::whole::{folder_of, partial_name, reserve};

/// Writes all steps into one file.
pub(super) struct VtkHdf {
    path: PathBuf,
    software: String,
    series: Option<Series>,
}

impl VtkHdf {
    pub(super) fn new(template: Template, options: SinkOptions) -> Self {
        VtkHdf { path: template.text().into(), software: options.software, series: None }
    }

    fn partial(&self) -> PathBuf {
        partial_name(&self.path)
    }

    fn failed(&self, e: hdf5::Error) -> Error {
        Error::format(
            self.partial(),
            format!("HDF5: {e}"),
            "a folder with room for more, or a smaller light.resolution",
        )
    }
}

impl Sink for VtkHdf {
    fn write(&mut self, output: &Output) -> Result<()> {
        let Some(light) = &output.light else { return Ok(()) };
        let partial = self.partial();
        if self.series.is_none() {
            let folder = folder_of(&partial);
            std::fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, e))?;
            let series = Series::create(&partial, &light.grid, &self.software).map_err(|e| self.failed(e))?;
            self.series = Some(series);
        }
        let series = self.series.as_mut().expect("made above");
        if light.grid != series.grid {
            let found = format!("the light grid of step {} is {:?} after {:?}", output.step, light.grid, series.grid);
            return Err(Error::format(&self.path, found, "raw volumes: --out light_{step:06}.raw"));
        }
        reserve(&partial, series.file.size(), (12 * light.grid.len() + Series::SLACK) as u64)?;
        let time = output.time.unwrap_or(output.step as f64);
        let written = series.write(output.step, time, light);
        written.map_err(|e| self.failed(e))
    }

    fn wants_layers(&self) -> bool {
        false
    }

    fn finish(&mut self) -> Result<()> {
        let Some(series) = self.series.take() else { return Ok(()) };
        let steps = series.steps.len();
        drop(series);
        // A disk that filled up in spite of the reserve shows when what is on it is read again.
        let partial = self.partial();
        match steps_in(&partial) {
            Ok(found) if found == steps && steps > 0 => {
                std::fs::rename(&partial, &self.path).map_err(|e| Error::io(&self.path, e))
            }
            Ok(found) => Err(Error::format(partial, format!("{found} of {steps} steps are whole"), "")),
            Err(e) => Err(self.failed(e)),
        }
    }

    fn wants_light(&self) -> bool {
        true
    }

    fn wants_frames(&self) -> bool {
        false
    }
}

/// The array, whose rank depends on whether there is a second step.
enum Fluence {
    /// Nothing yet, or one volume as (z, y, x, rgb), kept for when the second comes.
    Still(Option<Arc<IlluminatedVolume>>),
    /// (t, z, y, x, rgb).
    Temporal(Dataset),
}

/// The datasets of an open file.
struct Series {
    file: hdf5::File,
    grid: Grid,
    points: Group,
    fluence: Fluence,
    values: Dataset,
    offsets: Dataset,
    numbers: Dataset,
    count: hdf5::Attribute,
    /// Step numbers in the order of the file.
    steps: Vec<u64>,
}

impl Series {
    /// Bytes of a chunk at most, where a slice is not larger. Each is one call, so that a source that waits for the lock of
    /// the HDF5 library gets its turn in between.
    const CHUNK: usize = 4 << 20;
    /// Bytes of a volume up to which it is compressed: gzip 1 with shuffle takes 10 ms per MB (96³ smoke: to a twentieth),
    /// too long for a step of a large one.
    const COMPRESSED: usize = 32 << 20;
    /// Bytes that a step may need for what is not its values.
    const SLACK: usize = 64 << 10;

    fn create(path: &Path, grid: &Grid, software: &str) -> hdf5::Result<Self> {
        let file = hdf5::File::create(path)?;
        let root = file.create_group("VTKHDF")?;
        attribute(&root, "Version", &[2i64, 2])?;
        let kind = FixedAscii::<9>::from_ascii("ImageData").expect("nine letters");
        root.new_attr::<FixedAscii<9>>().create("Type")?.write_scalar(&kind)?;
        let [nx, ny, nz] = grid.size;
        attribute(&root, "WholeExtent", &[0, nx as i64 - 1, 0, ny as i64 - 1, 0, nz as i64 - 1])?;
        attribute(&root, "Origin", &grid.origin)?;
        attribute(&root, "Spacing", &grid.spacing)?;
        attribute(&root, "Direction", &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])?;
        let points = root.create_group("PointData")?;
        let steps = root.create_group("Steps")?;
        let count = steps.new_attr::<i64>().create("NSteps")?;
        count.write_scalar(&0i64)?;
        let values = growing::<f64>(&steps, "Values")?;
        let offsets = growing::<i64>(&steps.create_group("PointDataOffsets")?, "fluence")?;
        let numbers = growing::<u64>(&file, "step")?;
        let software: hdf5::types::VarLenUnicode = software.parse().unwrap_or_default();
        file.new_attr::<hdf5::types::VarLenUnicode>().create("software")?.write_scalar(&software)?;
        let fluence = Fluence::Still(None);
        Ok(Series { file, grid: *grid, points, fluence, values, offsets, numbers, count, steps: vec![] })
    }

    fn write(&mut self, step: u64, time: f64, light: &Arc<IlluminatedVolume>) -> hdf5::Result<()> {
        let at = self.steps.iter().position(|&s| s == step).unwrap_or(self.steps.len());
        let steps = self.steps.len().max(at + 1);
        self.put(at, steps, light)?;
        for dataset in [&self.values, &self.offsets, &self.numbers] {
            dataset.resize(steps)?;
        }
        self.values.write_slice(&[time], s![at..at + 1])?;
        self.offsets.write_slice(&[at as i64], s![at..at + 1])?;
        self.numbers.write_slice(&[step], s![at..at + 1])?;
        // Readers count on this many steps: last.
        self.count.write_scalar(&(steps as i64))?;
        self.file.flush()?;
        if at == self.steps.len() {
            self.steps.push(step);
        }
        Ok(())
    }

    /// Slices of a chunk.
    fn slab(&self) -> usize {
        let [nx, ny, nz] = self.grid.size;
        (Self::CHUNK / (12 * nx * ny)).clamp(1, nz)
    }

    /// Writes the volume of step `at` of `steps`.
    fn put(&mut self, at: usize, steps: usize, light: &Arc<IlluminatedVolume>) -> hdf5::Result<()> {
        let [nx, ny, nz] = self.grid.size;
        if let Fluence::Still(before) = &mut self.fluence {
            let before = before.take();
            if before.is_some() {
                self.points.unlink("fluence")?;
            }
            if steps == 1 {
                let dataset = self.points.new_dataset::<f32>().shape((nz, ny, nx, 3)).create("fluence")?;
                dataset.write_raw(values_of(light))?;
                self.fluence = Fluence::Still(Some(light.clone()));
                return Ok(());
            }
            let dims = [nz, ny, nx, 3].map(Extent::fixed);
            let shape = [&[Extent::resizable(steps)], &dims[..]].concat();
            let mut builder = self.points.new_dataset::<f32>().chunk((1, self.slab(), ny, nx, 3));
            if 12 * self.grid.len() <= Self::COMPRESSED {
                builder = builder.shuffle().deflate(1);
            }
            self.fluence = Fluence::Temporal(builder.shape(shape).create("fluence")?);
            self.put(0, steps, &before.expect("the first of two steps"))?;
        }
        if let Fluence::Temporal(dataset) = &self.fluence {
            dataset.resize((steps, nz, ny, nx, 3))?;
            let volume = ndarray::ArrayView4::from_shape((nz, ny, nx, 3), values_of(light));
            let volume = volume.map_err(|e| hdf5::Error::Internal(e.to_string()))?;
            for (n, slab) in volume.axis_chunks_iter(Axis(0), self.slab()).enumerate() {
                let from = n * self.slab();
                dataset.write_slice(slab, s![at, from..from + slab.len_of(Axis(0)), .., .., ..])?;
            }
        }
        Ok(())
    }
}

fn values_of(light: &IlluminatedVolume) -> &[f32] {
    bytemuck::cast_slice(&light.fluence)
}

fn attribute<T: H5Type, const N: usize>(group: &Group, name: &str, values: &[T; N]) -> hdf5::Result<()> {
    group.new_attr::<T>().shape(N).create(name)?.write_raw(values)
}

fn growing<T: H5Type>(group: &Group, name: &str) -> hdf5::Result<Dataset> {
    group.new_dataset::<T>().chunk(1024).shape(Extent::resizable(0)).create(name)
}

/// Steps whose fluence can be read in a closed file.
fn steps_in(path: &Path) -> hdf5::Result<usize> {
    let file = hdf5::File::open(path)?;
    let steps: i64 = file.group("VTKHDF/Steps")?.attr("NSteps")?.read_scalar()?;
    let fluence = file.dataset("VTKHDF/PointData/fluence")?;
    match (fluence.shape().as_slice(), steps) {
        (_, 0) => {}
        (&[_, z, y, x, _], _) => {
            fluence.read_slice::<f32, _, ndarray::Ix1>(s![steps as usize - 1, z - 1, y - 1, x - 1, ..])?;
        }
        _ => {
            fluence.read_raw::<f32>()?;
        }
    }
    Ok(steps as usize)
}
