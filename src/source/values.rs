//! What a step's values are made of: stored arrays, and the few ways in which several make one field.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::{h5, mesh, raw};
use crate::error::{Error, Result};
use crate::field::Field;
use crate::grid::Region;

/// The values of a step that has been found but not opened.
#[derive(Clone)]
pub(crate) enum Values {
    /// Part of an HDF5 dataset.
    Hdf5(h5::Slab),
    /// Part of a headerless file.
    Raw(raw::Slab),
    /// The length of a vector, from its components.
    Magnitude(Vec<Values>),
    /// A run of numbers in an HDF5 dataset of one axis.
    Flat(h5::Flat),
    /// Patches of a mesh, brought to one level.
    Mesh(mesh::OnLevel),
    /// The same value everywhere.
    Constant(f64),
    /// A step whose file could not be placed: what was found, and what would help.
    Broken(PathBuf, String, String),
}

impl Values {
    /// One part as it is, or the length of the vector that several make.
    pub fn of(mut parts: Vec<Values>) -> Values {
        if parts.len() == 1 { parts.swap_remove(0) } else { Values::Magnitude(parts) }
    }

    /// The file that holds the values, or the first of them.
    pub fn file(&self) -> Option<&Path> {
        match self {
            Values::Hdf5(slab) => Some(&slab.file),
            Values::Raw(slab) => Some(slab.bytes.path()),
            Values::Magnitude(parts) => parts.first()?.file(),
            Values::Flat(flat) => Some(&flat.file),
            Values::Mesh(mesh) => mesh.file(),
            Values::Constant(_) => None,
            Values::Broken(path, ..) => Some(path),
        }
    }

    /// Opens the values, which must fill a grid of `size`.
    pub fn open(&self, size: [usize; 3], opened: &Arc<h5::Opened>) -> Result<Arc<dyn Field>> {
        Ok(match self {
            Values::Hdf5(slab) => Arc::new(slab.open(size, opened)?),
            Values::Raw(slab) => Arc::new(slab.open(size)?),
            Values::Magnitude(parts) => {
                Arc::new(Magnitude(parts.iter().map(|p| p.open(size, opened)).collect::<Result<_>>()?))
            }
            Values::Flat(flat) => Arc::new(flat.open(size, opened)?),
            Values::Mesh(mesh) => Arc::new(mesh.open(opened)),
            Values::Constant(value) => Arc::new(Constant(*value)),
            Values::Broken(path, found, remedy) => return Err(Error::format(path, found, remedy)),
        })
    }
}

/// One value everywhere.
struct Constant(f64);

impl Field for Constant {
    fn read(&self, _: Region, out: &mut [f32]) -> Result<()> {
        out.fill(self.0 as f32);
        Ok(())
    }

    fn read_f64(&self, _: Region, out: &mut [f64]) -> Result<()> {
        out.fill(self.0);
        Ok(())
    }
}

/// √(Σ component²).
struct Magnitude(Vec<Arc<dyn Field>>);

/// Fills `out` with the values of a region a few planes at a time: `read` is given slabs of at most `most` values.
pub(super) fn by_slabs<T>(
    region: Region,
    most: usize,
    mut out: &mut [T],
    mut read: impl FnMut(Region, &mut [T]) -> Result<()>,
) -> Result<()> {
    for slab in region.slabs(most) {
        let (here, rest) = out.split_at_mut(slab.len());
        read(slab, here)?;
        out = rest;
    }
    Ok(())
}

/// Reads a field that works in f64 into f32, a few planes at a time.
pub(super) fn narrowed(field: &dyn Field, region: Region, out: &mut [f32]) -> Result<()> {
    let mut wide = Vec::new();
    by_slabs(region, 16 << 20, out, |slab, out| {
        wide.resize(out.len(), 0.0);
        field.read_f64(slab, &mut wide)?;
        out.iter_mut().zip(&wide).for_each(|(o, v)| *o = *v as f32);
        Ok(())
    })
}

impl Field for Magnitude {
    fn read(&self, region: Region, out: &mut [f32]) -> Result<()> {
        narrowed(self, region, out)
    }

    fn read_f64(&self, region: Region, out: &mut [f64]) -> Result<()> {
        let mut part = vec![0.0; out.len()];
        out.fill(0.0);
        for component in &self.0 {
            component.read_f64(region, &mut part)?;
            out.iter_mut().zip(&part).for_each(|(o, v)| *o += v * v);
        }
        out.iter_mut().for_each(|o| *o = o.sqrt());
        Ok(())
    }
}
