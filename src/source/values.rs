//! What a step's values are made of: stored arrays, and the few ways in which several make one field.

use std::path::PathBuf;
use std::sync::Arc;

use super::{h5, raw};
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
    /// Mesh blocks and where they sit in the whole.
    Blocks(Vec<(Region, Values)>),
    /// The same value everywhere.
    Constant(f64),
    /// Each value repeated along x, y, z: a coarse block on a fine grid.
    Repeated(Box<Values>, [usize; 3]),
    /// A step whose file could not be placed: what was found, and what would help.
    Broken(PathBuf, String, String),
}

impl Values {
    /// One part as it is, or the length of the vector that several make.
    pub fn of(mut parts: Vec<Values>) -> Values {
        if parts.len() == 1 { parts.swap_remove(0) } else { Values::Magnitude(parts) }
    }

    /// Opens the values, which must fill a grid of `size`.
    pub fn open(&self, size: [usize; 3], opened: &h5::Opened) -> Result<Arc<dyn Field>> {
        Ok(match self {
            Values::Hdf5(slab) => Arc::new(slab.open(size, opened)?),
            Values::Raw(slab) => Arc::new(slab.open(size)?),
            Values::Magnitude(parts) => {
                Arc::new(Magnitude(parts.iter().map(|p| p.open(size, opened)).collect::<Result<_>>()?))
            }
            Values::Blocks(blocks) => {
                let open = |(r, v): &(Region, Values)| Ok((*r, v.open(r.size, opened)?));
                Arc::new(Blocks(blocks.iter().map(open).collect::<Result<_>>()?))
            }
            Values::Constant(value) => Arc::new(Constant(*value)),
            Values::Repeated(values, times) => {
                let coarse = std::array::from_fn(|a| size[a].div_ceil(times[a]));
                Arc::new(Repeated { coarse: values.open(coarse, opened)?, times: *times })
            }
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

impl Field for Magnitude {
    fn read(&self, region: Region, out: &mut [f32]) -> Result<()> {
        let mut wide = vec![0.0; out.len()];
        self.read_f64(region, &mut wide)?;
        out.iter_mut().zip(wide).for_each(|(o, v)| *o = v as f32);
        Ok(())
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

/// A field cut into blocks; what no block covers is NaN.
struct Blocks(Vec<(Region, Arc<dyn Field>)>);

impl Blocks {
    fn gather<T: Copy>(
        &self,
        region: Region,
        out: &mut [T],
        hole: T,
        read: impl Fn(&dyn Field, Region, &mut [T]) -> Result<()>,
    ) -> Result<()> {
        out.fill(hole);
        let mut part = Vec::new();
        for (place, field) in &self.0 {
            let start: [usize; 3] = std::array::from_fn(|a| place.start[a].max(region.start[a]));
            let end: [usize; 3] = std::array::from_fn(|a| place.end()[a].min(region.end()[a]));
            if (0..3).any(|a| start[a] >= end[a]) {
                continue;
            }
            let size: [usize; 3] = std::array::from_fn(|a| end[a] - start[a]);
            let inside = Region { start: std::array::from_fn(|a| start[a] - place.start[a]), size };
            part.clear();
            part.resize(inside.len(), hole);
            read(field.as_ref(), inside, &mut part)?;
            for (row, values) in part.chunks_exact(size[0]).enumerate() {
                let j = start[1] - region.start[1] + row % size[1];
                let k = start[2] - region.start[2] + row / size[1];
                let at = (k * region.size[1] + j) * region.size[0] + start[0] - region.start[0];
                out[at..at + size[0]].copy_from_slice(values);
            }
        }
        Ok(())
    }
}

impl Field for Blocks {
    fn read(&self, region: Region, out: &mut [f32]) -> Result<()> {
        self.gather(region, out, f32::NAN, |f, r, o| f.read(r, o))
    }

    fn read_f64(&self, region: Region, out: &mut [f64]) -> Result<()> {
        self.gather(region, out, f64::NAN, |f, r, o| f.read_f64(r, o))
    }
}

/// Piecewise constant: value (i, j, k) is the coarse one at (i, j, k) / times.
struct Repeated {
    coarse: Arc<dyn Field>,
    times: [usize; 3],
}

impl Repeated {
    fn spread<T: Copy>(
        &self,
        region: Region,
        out: &mut [T],
        hole: T,
        read: impl Fn(&dyn Field, Region, &mut [T]) -> Result<()>,
    ) -> Result<()> {
        let start: [usize; 3] = std::array::from_fn(|a| region.start[a] / self.times[a]);
        let size = std::array::from_fn(|a| (region.end()[a] - 1) / self.times[a] + 1 - start[a]);
        let under = Region { start, size };
        let mut coarse = vec![hole; under.len()];
        read(self.coarse.as_ref(), under, &mut coarse)?;
        let at = |i: usize, a: usize| (region.start[a] + i) / self.times[a] - start[a];
        for (row, out) in out.chunks_exact_mut(region.size[0]).enumerate() {
            let (j, k) = (at(row % region.size[1], 1), at(row / region.size[1], 2));
            let from = (k * size[1] + j) * size[0];
            out.iter_mut().enumerate().for_each(|(i, o)| *o = coarse[from + at(i, 0)]);
        }
        Ok(())
    }
}

impl Field for Repeated {
    fn read(&self, region: Region, out: &mut [f32]) -> Result<()> {
        self.spread(region, out, f32::NAN, |f, r, o| f.read(r, o))
    }

    fn read_f64(&self, region: Region, out: &mut [f64]) -> Result<()> {
        self.spread(region, out, f64::NAN, |f, r, o| f.read_f64(r, o))
    }
}
