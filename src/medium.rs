//! The medium of one step: data values on the device, the transfer function that gives them optics, and what each brick
//! holds, so that empty space is never marched.

use crate::device::{Buffer, Device};
use crate::error::{Error, Result};
use crate::field::{EMPTY, HOLE, Timestep};
use crate::grid::{BrickLayout, Grid};
use crate::transfer::Table;

/// Classified data of one step. Its memory is used again for the next.
pub struct Medium {
    /// Where the values sit.
    pub grid: Grid,
    /// The values; holes are [`EMPTY`].
    pub field: Buffer,
    /// Values to optics.
    pub table: Table,
    /// Bricks for empty-space skipping.
    pub bricks: BrickLayout,
    /// Smallest and largest value of each brick with a halo of one.
    pub ranges: Vec<[f32; 2]>,
    /// Largest extinction or emission in each brick; 0 where nothing can be seen.
    pub majorant: Vec<f32>,
    host: Vec<f32>,
}

impl Medium {
    /// Edge of the bricks that rays skip: small, since smoke is thin and a skipped brick saves 8 samples of each ray.
    pub const EDGE: usize = 8;

    /// Allocates room for steps on `grid`.
    pub fn new(device: &dyn Device, grid: Grid, table: Table) -> Result<Self> {
        let bricks = BrickLayout::new(grid.size, Self::EDGE);
        Ok(Medium {
            field: device.alloc(grid.len())?,
            ranges: vec![],
            majorant: vec![],
            host: Vec::new(),
            grid,
            table,
            bricks,
        })
    }

    /// Takes in the values of a step: reads them, marks what is not finite as holes, hands them to the device and finds each
    /// brick's range. Returns the number of holes and the range of the other values (`None` when there are none).
    pub fn take(&mut self, device: &dyn Device, step: &Timestep) -> Result<(u64, Option<[f32; 2]>)> {
        if step.grid != self.grid {
            return Err(Error::Unsupported(format!(
                "step {} is on a grid of {:?} with spacing {:?}, the steps before on {:?} with spacing {:?}",
                step.step, step.grid.size, step.grid.spacing, self.grid.size, self.grid.spacing
            )));
        }
        self.host.resize(self.grid.len(), 0.0);
        step.field.read(self.grid.region(), &mut self.host)?;
        let holes = mark_holes(&mut self.host);
        self.host = device.exchange(std::mem::take(&mut self.host), &mut self.field)?;
        self.ranges = device.brick_range(&self.bricks, &self.field)?;
        let (lo, hi) =
            self.ranges.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), r| (l.min(r[0]), h.max(r[1])));
        Ok((holes, (lo <= hi).then_some([lo, hi])))
    }

    /// Sets the transfer function and finds which bricks can be seen at all.
    pub fn classify(&mut self, table: Table) {
        self.table = table;
        self.majorant = self.table.majorants(&self.ranges);
    }
}

/// Replaces what is not finite, and fill values below [`HOLE`], by [`EMPTY`]; returns how many there were.
pub fn mark_holes(values: &mut [f32]) -> u64 {
    let mut holes = 0;
    for v in values {
        // Also false for NaN.
        if !(*v >= HOLE && *v <= f32::MAX) {
            *v = EMPTY;
            holes += 1;
        }
    }
    holes
}
