//! Ray casting through data lit by light volumes: `L = ∫ T σ_t [ω ΣTerms + j/σ_t] ds`, see [`March`].
//!
//! Tiles of 16² pixels run in parallel; inside a tile, packets of neighbouring rays advance together, one ray a lane
//! (16 lanes of AVX-512, 8 of AVX2). Every lane computes what it would alone, so a picture holds the same bits on every
//! instruction set, for any number of threads, and with or without [`March::majorant`].

mod empty;
pub(super) mod kernel;
pub(super) mod lanes;
pub(super) mod plan;

use std::sync::Arc;

use rayon::prelude::*;

use self::empty::Distances;
use self::kernel::{TILE, Tile, Waiting, tile};
use self::lanes::Array;
use self::plan::Plan;
use crate::device::cpu::simd::{self, Level};
use crate::device::{March, Part, Ray, Rays};
use crate::frame::Frame;
use crate::grid::BrickLayout;

/// Casts the rays of `frame` on the threads of the current rayon pool with the best instruction set. See [`March`].
pub fn march(march: &March, frame: &mut Frame) {
    let Some(plan) = Plan::new(march, None, frame.size) else { return frame.pixels.fill([0.0; 4]) };
    frame.pixels = cast(&plan, at_level(level(&plan)));
}

/// The same for the listed tiles only; see [`March::TILE`].
pub fn march_tiles(march: &March, list: &[u32], frame: &mut Frame) {
    let ([across, down], [width, height]) = (March::tiles(frame.size), frame.size);
    assert!(list.iter().all(|t| (*t as usize) < across * down), "a tile outside the picture");
    let mut tiles = vec![Tile::FRESH; list.len()];
    let corner = |tile: u32| [tile as usize % across * TILE, tile as usize / across * TILE];
    if let Some(plan) = Plan::new(march, None, frame.size) {
        let kernel = at_level(level(&plan));
        tiles.par_iter_mut().zip(list).with_max_len(1).for_each(|(rays, tile)| kernel(&plan, corner(*tile), rays));
    }
    for (rays, tile) in tiles.iter().zip(list) {
        let [x, y] = corner(*tile);
        let cut = TILE.min(width - x);
        for (row, rays) in (y..(y + TILE).min(height)).zip(rays.rays.chunks(TILE)) {
            let pixels = &mut frame.pixels[row * width + x..][..cut];
            pixels.iter_mut().zip(rays).for_each(|(pixel, ray)| *pixel = ray.pixel());
        }
    }
}

/// What is known of rays between two slabs.
#[derive(Default)]
pub struct Known {
    /// Empty space, once it was looked for.
    empty: Option<Option<Arc<Distances>>>,
    /// For each block of each tile, see [`Tile::waiting`].
    waiting: Vec<Waiting>,
}

/// Carries rays through a slab: those blocks of pixels of which some ray waits there. See
/// [`Device::march_slab`](crate::device::Device::march_slab).
pub fn march_slab(march: &March, part: &Part, rays: &mut Rays) {
    let Known { empty, waiting } = &mut rays.known;
    let empty = empty.get_or_insert_with(|| Distances::new(&march.bricks, march.majorant).map(Arc::new));
    if let Some(plan) = Plan::new(march, Some((part, empty.clone())), rays.picture) {
        waiting.resize(March::tiles(rays.picture).into_iter().product(), Tile::FRESH.waiting);
        tiles(&plan, &mut rays.each, waiting, at_level(level(&plan)));
    }
}

/// For each brick the distance in bricks to the nearest in which something is, see `Distances`; 0 everywhere where nothing can be
/// skipped.
pub(crate) fn distances(bricks: &BrickLayout, something: &[f32]) -> Vec<f32> {
    Distances::new(bricks, something).map_or_else(|| vec![0.0; bricks.len()], |d| d.values)
}

/// A volume that 32-bit indices cannot address is marched without gathers.
fn level(plan: &Plan) -> Level {
    if plan.matter.reach > i32::MAX as usize { Level::Portable } else { simd::level() }
}

/// The scalar twin of [`march()`]: one ray after another in plain f32 code, with the same skipping and the same tiles,
/// compiled for the same instruction set.
pub fn march_scalar(march: &March, frame: &mut Frame) {
    let Some(plan) = Plan::new(march, None, frame.size) else { return frame.pixels.fill([0.0; 4]) };
    let kernel: Kernel = match simd::level() {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: `simd::level` has asked the processor.
        Level::Avx512 | Level::Avx2 => |plan, first, out| unsafe { x86::scalar(plan, first, out) },
        _ => tile::<Array<1>>,
    };
    frame.pixels = cast(&plan, kernel);
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

/// The pixels of rays cast from the eye to their end.
fn cast(plan: &Plan, kernel: Kernel) -> Vec<[f32; 4]> {
    let mut rays = vec![Ray::FRESH; plan.picture[0] * plan.picture[1]];
    let mut waiting = vec![Tile::FRESH.waiting; March::tiles(plan.picture).into_iter().product()];
    tiles(plan, &mut rays, &mut waiting, kernel);
    rays.par_iter().with_min_len(1 << 12).map(Ray::pixel).collect()
}

/// Carries rays on, a band of tiles at a time; tiles of which no ray waits in the plan's window are left alone.
fn tiles(plan: &Plan, rays: &mut [Ray], waiting: &mut [Waiting], kernel: Kernel) {
    let width = plan.picture[0];
    let bands = rays.par_chunks_mut(TILE * width).zip(waiting.par_chunks_mut(width.div_ceil(TILE)));
    bands.enumerate().for_each(|(j, (band, waiting))| {
        let meets = |column: &usize| waiting[*column].iter().any(|cells| plan.meets(*cells));
        let columns: Vec<usize> = (0..waiting.len()).filter(meets).collect();
        let tiles: Vec<Tile> = columns
            .par_iter()
            .with_max_len(1)
            .map(|&column| {
                let x = column * TILE;
                let mut tile = Tile { waiting: waiting[column], ..Tile::FRESH };
                for (row, tile) in band.chunks(width).zip(tile.rays.chunks_mut(TILE)) {
                    let row = &row[x..width.min(x + TILE)];
                    tile[..row.len()].copy_from_slice(row);
                }
                kernel(plan, [x, j * TILE], &mut tile);
                tile
            })
            .collect();
        for (&column, tile) in columns.iter().zip(&tiles) {
            let x = column * TILE;
            waiting[column] = tile.waiting;
            for (row, tile) in band.chunks_mut(width).zip(tile.rays.chunks(TILE)) {
                let row = &mut row[x..width.min(x + TILE)];
                row.copy_from_slice(&tile[..row.len()]);
            }
        }
    });
}

#[cfg(test)]
mod tests;
