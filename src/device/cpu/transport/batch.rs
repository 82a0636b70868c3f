//! Which ordinates pass together.

use super::stride;
use crate::device::{Ordinate, Sweep};
use crate::grid::Grid;

/// Ordinates of a batch at most: their layers and those of σ and S should stay in a second-level cache.
pub(super) const LANES: usize = 8;

/// One ordinate as its batch needs it. Its feet lie in the layer before, at `t_row` of the way to row `row + step_row` and at
/// `t_col` of the way to the column before (`ascending`) or the next.
pub(super) struct Lane {
    pub weight: f32,
    pub inflow: f32,
    pub omega: [f32; 3],
    pub step_row: isize,
    pub t_row: f32,
    pub ascending: bool,
    pub t_col: f32,
}

/// Ordinates of the same dominant axis, direction of travel along it and along z, and length of a step.
pub(super) struct Batch {
    pub axis: usize,
    pub ascending: bool,
    /// Across z.
    pub upward: bool,
    /// World length between layers.
    pub length: f32,
    pub lanes: Vec<Lane>,
}

impl Batch {
    /// Rows and columns of its layers in a slab of so many planes.
    pub fn layer(&self, size: [usize; 3], deep: usize) -> [usize; 2] {
        let (row, col) = lateral(self.axis);
        [if row == 2 { deep } else { size[row] }, size[col]]
    }

    /// Values between rows of all lanes.
    pub fn pitch(&self, cols: usize) -> usize {
        self.lanes.len() * stride(cols)
    }
}

/// Row and column axes of layers perpendicular to `axis`; columns are contiguous in memory, for x in what is turned.
pub(super) fn lateral(axis: usize) -> (usize, usize) {
    [(2, 1), (2, 0), (1, 0)][axis]
}

/// Those that cross planes of z upwards, or the others.
pub(super) fn batches(grid: &Grid, ordinates: &[Ordinate], upward: bool) -> Vec<Batch> {
    let mut all: Vec<Batch> = Vec::new();
    for key in 0..6 {
        let (axis, ascending) = (key / 2, key % 2 == 0);
        let (row, col) = lateral(axis);
        let first = all.len();
        for o in ordinates {
            let sweep = Sweep::new(grid, o.direction, false);
            let d = sweep.direction;
            if sweep.axis() != axis || (d[axis] >= 0.0) != ascending || sweep.ascending()[2] != upward {
                continue;
            }
            let offset = |a: usize| (d[a] / d[axis]).abs().min(1.0);
            let lane = Lane {
                weight: o.weight,
                inflow: o.inflow,
                omega: o.direction.to_array(),
                step_row: if d[row] >= 0.0 { -1 } else { 1 },
                t_row: offset(row),
                ascending: d[col] >= 0.0,
                t_col: offset(col),
            };
            // Symmetric directions differ by rounding.
            let fits = |b: &&mut Batch| (b.length - sweep.length).abs() <= 4e-7 * b.length && b.lanes.len() < LANES;
            match all[first..].iter_mut().find(fits) {
                Some(batch) => batch.lanes.push(lane),
                None => all.push(Batch { axis, ascending, upward, length: sweep.length, lanes: vec![lane] }),
            }
        }
    }
    all
}
