//! Exact replay of paths: where nothing that a tile's paths depended on has changed since the step before, its estimate is kept.
//!
//! A path depends on the bricks that it flies through: on their bounds, on how far it is from them to anything, and, where it
//! collides, on values there and one value farther, for gradients. The same numbers are drawn in every step, so that tracing such a
//! path again would find the same, to the bit.

use crate::device::{Device, March, Tally, Trace, bricks_ahead};
use crate::error::Result;
use crate::medium::Medium;

/// The paths of a picture.
pub struct Paths {
    tallies: Vec<Tally>,
    /// For each tile a bit for each brick that its paths depended on.
    touched: Vec<u64>,
    /// Bricks that rays may cross at once, for each brick.
    ahead: Vec<u8>,
    majorant: Vec<f32>,
    focus: f32,
}

/// What a step's paths have found.
pub(super) struct Replayed {
    pub tallies: Vec<Tally>,
    /// Collisions at which extinction was above its bound.
    pub exceeded: u64,
    /// Tiles that were kept.
    pub kept: usize,
}

/// Traces the paths of a picture of `size`, but for those tiles of `paths`, of the step before, that nothing has happened to;
/// `paths` are those of this step then.
pub(super) fn replay(
    device: &dyn Device,
    medium: &Medium,
    trace: &Trace,
    size: [usize; 2],
    paths: &mut Option<Paths>,
) -> Result<Replayed> {
    let all = March::tiles(size).iter().product::<usize>();
    let words = trace.bricks.len().div_ceil(64);
    let ahead = bricks_ahead(&trace.bricks, trace.majorant);
    let before = paths.take().filter(|p| p.tallies.len() == size[0] * size[1] && p.focus == trace.focus);
    let changed = if before.is_some() { medium.looks_changed(device, true)? } else { None };
    let (mut tallies, mut touched, tiles): (_, _, Vec<u32>) = match before.zip(changed) {
        Some((before, mut changed)) => {
            // Far from what has changed rays cross empty bricks in other leaps.
            for (b, changed) in changed.iter_mut().enumerate() {
                *changed |= before.ahead[b] != ahead[b] || before.majorant[b] != trace.majorant[b];
            }
            let changed = bits(&changed);
            let meets = |tile: &u32| {
                let touched = &before.touched[*tile as usize * words..][..words];
                touched.iter().zip(&changed).any(|(t, c)| t & c != 0)
            };
            let tiles = (0..all as u32).filter(meets).collect();
            (before.tallies, before.touched, tiles)
        }
        None => (vec![Tally::default(); size[0] * size[1]], vec![0; all * words], (0..all as u32).collect()),
    };
    for rows in tiles.iter().map(|tile| March::rows(*tile, size)) {
        rows.for_each(|row| tallies[row].fill(Tally::default()));
    }
    let mut again = vec![0; tiles.len() * words];
    let exceeded = device.trace_tiles(trace, &tiles, size, &mut tallies, &mut again)?.exceeded;
    for (tile, bits) in tiles.iter().zip(again.chunks(words)) {
        touched[*tile as usize * words..][..words].copy_from_slice(bits);
    }
    let kept = all - tiles.len();
    let majorant = trace.majorant.to_vec();
    *paths = Some(Paths { tallies: tallies.clone(), touched, ahead, majorant, focus: trace.focus });
    Ok(Replayed { tallies, exceeded, kept })
}

/// A bit for each.
fn bits(of: &[bool]) -> Vec<u64> {
    let word = |of: &[bool]| of.iter().enumerate().fold(0, |word, (i, set)| word | u64::from(*set) << i);
    of.chunks(64).map(word).collect()
}
