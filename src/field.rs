//! Fields readable by region, and timesteps.

use std::ops::Range;
use std::sync::Arc;

use crate::error::Result;
use crate::grid::{Grid, Region, Slab};

/// Values below this are holes: no data, hence transparent. Non-finite and fill values become [`EMPTY`] when a step is
/// taken in, so that no NaN reaches a kernel; any interpolation that touches a hole stays below this bound.
pub const HOLE: f32 = -1e30;
/// The value that marks a hole.
pub const EMPTY: f32 = -1e38;

/// Replaces what is not finite, and fill values below [`HOLE`], by [`EMPTY`]; returns how many there were.
pub fn mark_holes(values: &mut [f32]) -> u64 {
    let mut holes = 0;
    // Without branches, in pieces whose count fits 32 bits, so that it is compiled for several values at a time.
    for part in values.chunks_mut(1 << 16) {
        let mut here = 0u32;
        for v in part {
            // Also false for NaN.
            let filled = *v >= HOLE && *v <= f32::MAX;
            *v = if filled { *v } else { EMPTY };
            here += u32::from(!filled);
        }
        holes += u64::from(here);
    }
    holes
}

/// Bytes read from a source at a time where not all is kept, so that what its library holds meanwhile stays small.
const PIECE: usize = 8 << 20;

/// Reads the planes of `slab`, a few at a time, with holes marked; returns the number of holes. Where none are known to be there
/// (`clean`) nobody looks for them.
pub fn read_planes(field: &dyn Field, slab: &Slab, out: &mut [f32], clean: bool) -> Result<u64> {
    read_rows(field, slab, 0..slab.size[1], out, clean)
}

/// The same for some rows of each plane; the others keep what they held, or get what means nothing.
pub(crate) fn read_rows(
    field: &dyn Field,
    slab: &Slab,
    rows: Range<usize>,
    out: &mut [f32],
    clean: bool,
) -> Result<u64> {
    let (nx, plane) = (slab.size[0], slab.plane());
    let (each, mut holes, mut rest) = (nx * rows.len(), 0, out);
    for mut region in slab.region().slabs(PIECE / 4) {
        let (out, after) = rest.split_at_mut(region.len());
        rest = after;
        (region.start[1], region.size[1]) = (rows.start, rows.len());
        let values = &mut out[..region.len()];
        field.read(region, values)?;
        if !clean {
            holes += mark_holes(values);
        }
        if each < plane {
            // The last plane first: each goes to where nothing lies that is still to be moved.
            let planes = (0..region.size[2]).rev();
            planes.for_each(|p| out.copy_within(p * each..(p + 1) * each, p * plane + rows.start * nx));
        }
    }
    Ok(holes)
}

/// A scalar field on a uniform grid, readable by region, so that nothing forces a whole volume into memory.
pub trait Field: Send + Sync {
    /// Reads `region` into `out` in (z, y, x) order, x fastest; `out.len() == region.len()`. Values are as the file has
    /// them (physical units after packing), converted to f32; NaN and infinities are passed on.
    fn read(&self, region: Region, out: &mut [f32]) -> Result<()>;

    /// True when reading costs no more than a copy.
    fn is_resident(&self) -> bool {
        false
    }

    /// The same in f64, for statistics. The default goes through f32.
    fn read_f64(&self, region: Region, out: &mut [f64]) -> Result<()> {
        let mut narrow = vec![0.0; out.len()];
        self.read(region, &mut narrow)?;
        out.iter_mut().zip(narrow).for_each(|(o, v)| *o = f64::from(v));
        Ok(())
    }
}

/// One step of a series.
#[derive(Clone)]
pub struct Timestep {
    /// The simulation's own step number.
    pub step: u64,
    /// Physical time; `None` where neither the file nor a setting tells.
    pub time: Option<f64>,
    /// Where the values sit.
    pub grid: Grid,
    /// The values.
    pub field: Arc<dyn Field>,
}

/// A field that is already in memory, in (z, y, x) order.
pub struct Dense {
    size: [usize; 3],
    values: Vec<f32>,
}

impl Dense {
    /// Wraps `values`, which must number `nx·ny·nz`.
    pub fn new(size: [usize; 3], values: Vec<f32>) -> Self {
        assert_eq!(values.len(), size.iter().product::<usize>(), "values must fill the grid");
        Dense { size, values }
    }
}

impl Field for Dense {
    fn is_resident(&self) -> bool {
        true
    }

    fn read(&self, region: Region, out: &mut [f32]) -> Result<()> {
        if region.start == [0; 3] && region.size == self.size {
            out.copy_from_slice(&self.values);
            return Ok(());
        }
        let [nx, ny, _] = self.size;
        for (row, out) in out.chunks_exact_mut(region.size[0]).enumerate() {
            let (j, k) = (region.start[1] + row % region.size[1], region.start[2] + row / region.size[1]);
            let at = (k * ny + j) * nx + region.start[0];
            out.copy_from_slice(&self.values[at..at + region.size[0]]);
        }
        Ok(())
    }
}
