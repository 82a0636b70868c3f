//! Bricks in the order in which light reaches them.

use rayon::prelude::*;

use crate::grid::{BrickLayout, Region};

/// Solves bricks front by front; those of one front do not depend on each other. Returns what `solve` says of each, in order.
pub(in crate::device::cpu) fn front_by_front(
    layout: &BrickLayout,
    fronts: &[&[u32]],
    solve: impl Fn(Region) -> f32 + Sync,
) -> Vec<f32> {
    let one = |b: &u32| solve(layout.region(*b as usize));
    let mut changes = Vec::with_capacity(fronts.iter().map(|front| front.len()).sum());
    for front in fronts {
        match front {
            [b] => changes.push(one(b)),
            many => changes.par_extend(many.par_iter().with_max_len(1).map(one)),
        }
    }
    changes
}
