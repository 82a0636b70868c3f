//! Ray casting through data lit by light volumes: `L = ∫ T σ_t [ω ΣTerms + j/σ_t] ds`, see [`March`].
//!
//! Tiles of 16² pixels run in parallel; inside a tile, packets of neighbouring rays advance together, one ray a lane
//! (16 lanes of AVX-512, 8 of AVX2). Every lane computes what it would alone, so a picture holds the same bits on every
//! instruction set, for any number of threads, and with or without [`March::majorant`].

mod empty;
mod kernel;
mod lanes;
mod plan;

use rayon::prelude::*;

use self::kernel::{TILE, Tile, tile};
use self::lanes::Array;
use self::plan::Plan;
use crate::device::March;
use crate::device::cpu::simd::{self, Level};
use crate::frame::Frame;

/// Casts the rays of `frame` on the threads of the current rayon pool with the best instruction set. See [`March`].
pub fn march(march: &March, frame: &mut Frame) {
    let Some(plan) = Plan::new(march, frame.size) else { return frame.pixels.fill([0.0; 4]) };
    // A volume that 32-bit indices cannot address is marched without gathers.
    let level = if plan.reach > i32::MAX as usize { Level::Portable } else { simd::level() };
    tiles(&plan, frame, at_level(level));
}

/// The scalar twin of [`march()`]: one ray after another in plain f32 code, with the same skipping and the same tiles,
/// compiled for the same instruction set.
pub fn march_scalar(march: &March, frame: &mut Frame) {
    let Some(plan) = Plan::new(march, frame.size) else { return frame.pixels.fill([0.0; 4]) };
    let kernel: Kernel = match simd::level() {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: `simd::level` has asked the processor.
        Level::Avx512 | Level::Avx2 => |plan, first, out| unsafe { x86::scalar(plan, first, out) },
        _ => tile::<Array<1>>,
    };
    tiles(&plan, frame, kernel);
}

type Kernel = fn(&Plan, [usize; 2], &mut Tile);

/// The kernel for `level`, which the processor must have.
fn at_level(level: Level) -> Kernel {
    match level {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the caller got the level from `simd::level`, which has asked the processor.
        Level::Avx512 => |plan, first, out| unsafe { x86::avx512(plan, first, out) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        Level::Avx2 => |plan, first, out| unsafe { x86::avx2(plan, first, out) },
        _ => tile::<Array<4>>,
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::kernel::{Tile, tile};
    use super::lanes::{Array, Avx2, Avx512};
    use super::plan::Plan;

    #[target_feature(enable = "avx512f,avx512vl,avx512bw,avx512dq,avx2,bmi2,lzcnt,popcnt")]
    pub(super) fn avx512(plan: &Plan, first: [usize; 2], out: &mut Tile) {
        tile::<Avx512>(plan, first, out);
    }

    #[target_feature(enable = "avx2,bmi2,lzcnt,popcnt")]
    pub(super) fn avx2(plan: &Plan, first: [usize; 2], out: &mut Tile) {
        tile::<Avx2>(plan, first, out);
    }

    #[target_feature(enable = "avx2,bmi2,lzcnt,popcnt")]
    pub(super) fn scalar(plan: &Plan, first: [usize; 2], out: &mut Tile) {
        tile::<Array<1>>(plan, first, out);
    }
}

/// Fills the frame tile by tile.
fn tiles(plan: &Plan, frame: &mut Frame, kernel: Kernel) {
    let [width, height] = frame.size;
    let across = width.div_ceil(TILE);
    let mut tiles = vec![[[0.0; 4]; TILE * TILE]; across * height.div_ceil(TILE)];
    tiles.par_iter_mut().enumerate().for_each(|(i, tile)| kernel(plan, [i % across * TILE, i / across * TILE], tile));
    frame.pixels.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        for (x, pixels) in row.chunks_mut(TILE).enumerate() {
            let tile = &tiles[y / TILE * across + x];
            pixels.copy_from_slice(&tile[y % TILE * TILE..][..pixels.len()]);
        }
    });
}

#[cfg(test)]
mod tests;
