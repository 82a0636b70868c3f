//! What bricks hold and how much it changed since the step before.

use rayon::prelude::*;

use super::simd::dispatch;
use crate::field::HOLE;
use crate::grid::{BrickLayout, Region};

/// reads data values → smallest and largest of each brick with a halo of one, holes left out.
pub(crate) fn brick_range(layout: &BrickLayout, field: &[f32]) -> Vec<[f32; 2]> {
    (0..layout.len())
        .into_par_iter()
        .with_min_len(16)
        .map(|b| range(layout.size, layout.region(b).grown(1, layout.size), field))
        .collect()
}

dispatch! {
    fn range(size: [usize; 3], region: Region, field: &[f32]) -> [f32; 2] = range_body;
}

#[inline(always)]
fn range_body(size: [usize; 3], region: Region, field: &[f32]) -> [f32; 2] {
    const LANES: usize = 8;
    let (mut lo, mut hi) = ([f32::INFINITY; LANES], [f32::NEG_INFINITY; LANES]);
    let mut one = |lane: usize, v: f32| {
        let filled = v >= HOLE;
        let (low, high) = (if filled { v } else { f32::INFINITY }, if filled { v } else { f32::NEG_INFINITY });
        lo[lane] = if low < lo[lane] { low } else { lo[lane] };
        hi[lane] = if high > hi[lane] { high } else { hi[lane] };
    };
    for k in region.start[2]..region.end()[2] {
        for j in region.start[1]..region.end()[1] {
            let row = &field[(k * size[1] + j) * size[0] + region.start[0]..][..region.size[0]];
            let (body, tail) = row.as_chunks::<LANES>();
            for chunk in body {
                (0..LANES).for_each(|lane| one(lane, chunk[lane]));
            }
            tail.iter().enumerate().for_each(|(lane, &v)| one(lane, v));
        }
    }
    [lo.into_iter().fold(f32::INFINITY, f32::min), hi.into_iter().fold(f32::NEG_INFINITY, f32::max)]
}

/// reads σ now and before → per brick and dominant axis `Σ_layers max|Δσ|` (light.md, d_sig), bounding the change of
/// optical depth per unit spacing along any path through the brick: inner layers count fully, the halo layer half.
pub(crate) fn change(layout: &BrickLayout, now: &[f32], before: &[f32]) -> Vec<[f32; 3]> {
    (0..layout.len())
        .into_par_iter()
        .map(|b| {
            let own = layout.region(b);
            let grown = own.grown(1, layout.size);
            let mut layers = [vec![0.0; grown.size[0]], vec![0.0; grown.size[1]], vec![0.0; grown.size[2]]];
            let [x, y, z] = &mut layers;
            layer_changes(layout.size, grown, now, before, x, y, z);
            std::array::from_fn(|a| {
                let skip = own.start[a] - grown.start[a];
                let inner: f32 = layers[a][skip..skip + own.size[a]].iter().sum();
                let outer =
                    layers[a][..skip].iter().chain(&layers[a][skip + own.size[a]..]).fold(0.0f32, |m, &v| m.max(v));
                inner + 0.5 * outer
            })
        })
        .collect()
}

dispatch! {
    fn layer_changes(size: [usize; 3], region: Region, now: &[f32], before: &[f32], x: &mut [f32], y: &mut [f32], z: &mut [f32]) = layer_changes_body;
}

#[inline(always)]
fn layer_changes_body(
    size: [usize; 3],
    region: Region,
    now: &[f32],
    before: &[f32],
    x: &mut [f32],
    y: &mut [f32],
    z: &mut [f32],
) {
    let n = region.size[0];
    for (k, z) in z.iter_mut().enumerate() {
        for (j, y) in y.iter_mut().enumerate() {
            let at = ((region.start[2] + k) * size[1] + region.start[1] + j) * size[0] + region.start[0];
            let (now, before) = (&now[at..at + n], &before[at..at + n]);
            let mut row = [0.0f32; 8];
            for ((x, now), before) in x.chunks_mut(8).zip(now.chunks(8)).zip(before.chunks(8)) {
                for i in 0..x.len() {
                    let d = (now[i] - before[i]).abs();
                    x[i] = if d > x[i] { d } else { x[i] };
                    row[i] = if d > row[i] { d } else { row[i] };
                }
            }
            let most = row.into_iter().fold(0.0, f32::max);
            *y = y.max(most);
            *z = z.max(most);
        }
    }
}
