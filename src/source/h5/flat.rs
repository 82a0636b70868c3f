//! Boxes of values that follow one another in a dataset of one axis, each with x fastest.

use std::path::PathBuf;
use std::sync::Arc;

use hdf5::H5Type;

use super::slab::{Held, read_error};
use super::{Opened, Packing, Slab};
use crate::error::{Error, Result};
use crate::field::Field;
use crate::grid::Region;
use crate::source::shape_text;

/// A box of values in a dataset of one axis.
#[derive(Debug, Clone)]
pub(crate) struct Flat {
    pub file: PathBuf,
    pub dataset: String,
    /// First number of the box.
    pub offset: usize,
    /// Stored values along x, y, z, ghost cells included.
    pub stored: [usize; 3],
    /// Ghost cells before the first value along each axis.
    pub ghosts: [usize; 3],
}

impl Flat {
    /// Opens the dataset and checks that it holds the box.
    pub fn open(&self, size: [usize; 3], opened: &Opened) -> Result<FlatField> {
        let axis = Slab {
            file: self.file.clone(),
            dataset: self.dataset.clone(),
            rank: 1,
            space: [0; 3],
            fixed: Vec::new(),
            start: [0; 3],
            whole: false,
            packing: Packing::default(),
        };
        let held = opened.dataset(&self.file, &self.dataset, &axis)?;
        let shape = held.dataset.shape();
        let inside = (0..3).all(|a| self.ghosts[a].checked_add(size[a]).is_some_and(|end| end <= self.stored[a]));
        let end =
            self.stored.iter().try_fold(1usize, |n, &l| n.checked_mul(l)).and_then(|n| n.checked_add(self.offset));
        if shape.len() != 1 || !inside || end.is_none_or(|end| end > shape[0]) {
            let found = format!(
                "a box of {} values from number {} on does not fit into {} numbers",
                shape_text(&self.stored),
                self.offset,
                shape_text(&shape)
            );
            return Err(Error::format(self.name(), found, "the complete file"));
        }
        Ok(FlatField { held, flat: self.clone() })
    }

    fn name(&self) -> String {
        format!("{}:{}", self.file.display(), self.dataset)
    }
}

/// An open [`Flat`].
pub(crate) struct FlatField {
    held: Arc<Held>,
    flat: Flat,
}

impl FlatField {
    /// Reads what lies between the first and the last value of a region in one piece.
    fn read_as<T: H5Type + Copy>(&self, region: Region, out: &mut [T]) -> Result<()> {
        if region.is_empty() {
            return Ok(());
        }
        let Flat { stored: [nx, ny, _], ghosts, offset, .. } = self.flat;
        let at = |i: usize, j: usize, k: usize| {
            let [x, y, z] = [i + ghosts[0], j + ghosts[1], k + ghosts[2]];
            offset + (z * ny + y) * nx + x
        };
        let ([i, j, k], [ei, ej, ek]) = (region.start, region.end());
        let first = at(i, j, k);
        let read = self.held.dataset.read_slice_1d::<T, _>(first..at(ei - 1, ej - 1, ek - 1) + 1);
        let read = read.map_err(|e| read_error(&self.flat.name(), &self.held.dataset, &e))?;
        let values = read.as_slice().unwrap_or_default();
        for (row, out) in out.chunks_exact_mut(region.size[0]).enumerate() {
            let from = at(i, j + row % region.size[1], k + row / region.size[1]) - first;
            out.copy_from_slice(&values[from..from + region.size[0]]);
        }
        Ok(())
    }
}

impl Field for FlatField {
    fn read(&self, region: Region, out: &mut [f32]) -> Result<()> {
        self.read_as(region, out)
    }

    fn read_f64(&self, region: Region, out: &mut [f64]) -> Result<()> {
        self.read_as(region, out)
    }
}
