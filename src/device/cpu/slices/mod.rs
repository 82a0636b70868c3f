//! Half-angle slicing on image-aligned slabs: see [`crate::device::slices`].
//!
//! Light and eye take turns, a few slabs each: bands of texels, then bands of pixels, run in parallel. A packet of
//! neighbouring rays advances together, one ray a lane, so that the bits are the same on every instruction set and for any
//! number of threads.

mod kernel;
mod plan;

use std::ops::Range;

use rayon::prelude::*;

use self::kernel::{TILE, Texels};
use self::plan::{Plan, Shine};
use super::march::lanes::Array;
use super::simd::{self, Level};
use crate::device::Ray;
use crate::device::slices::{BATCH, Beam, Slices, pixels};

/// One pass over the slices, on top of what `rays` hold: a ray for each pixel of the picture. See [`Slices`].
pub fn slice(slices: &Slices, rays: &mut [Ray]) {
    slice_watched(slices, rays, |_, _| ());
}

/// The same, showing the whole light buffer behind each batch of slabs, row by row, each channel after the other.
fn slice_watched(slices: &Slices, rays: &mut [Ray], mut watch: impl FnMut(Range<usize>, &[f32])) {
    assert_eq!(rays.len(), slices.picture[0] * slices.picture[1], "a ray for each pixel");
    if slices.grid.is_empty() || rays.is_empty() {
        return;
    }
    let plan = Plan::new(slices);
    let level = if plan.matter.reach > i32::MAX as usize { Level::Portable } else { simd::level() };
    let kernels = at_level(level);
    let texels = plan.shine.as_ref().map(|s| Texels { size: s.size, channels: s.factors.len() });
    let len = texels.map_or(0, |t| t.len());
    let mut front = slices.beam.as_ref().zip(texels).map_or(vec![], |(beam, t)| beginning(beam, t));
    let (mut next, mut layers) = (vec![0.0; len], vec![0.0; BATCH * len]);
    for first in (0..slices.slicing.count).step_by(BATCH) {
        let slabs = first..(first + BATCH).min(slices.slicing.count);
        if let (Some(shine), Some(texels)) = (&plan.shine, texels) {
            // A blurred slab needs its neighbours' light of the slab before.
            let each = if shine.blur > 0.0 { 1 } else { BATCH };
            for (k, i) in slabs.clone().enumerate().step_by(each) {
                let band = TILE * texels.row();
                let part = i..(i + each).min(slabs.end);
                (next.par_chunks_mut(band).zip(layers.par_chunks_mut(BATCH * band))).enumerate().for_each(
                    |(b, (next, layers))| {
                        (kernels.light)((&plan, shine), &part, b, &front, next, &mut layers[k * texels.row()..]);
                    },
                );
                std::mem::swap(&mut front, &mut next);
            }
            watch(slabs.clone(), &front);
        }
        eye(&kernels, slices, &plan, &slabs, &layers, rays);
    }
}

/// The light buffer before the first slice.
fn beginning(beam: &Beam, texels: Texels) -> Vec<f32> {
    let Some(start) = beam.start else { return vec![1.0; texels.len()] };
    let mut front = vec![0.0; texels.len()];
    for (row, of) in front.chunks_mut(texels.row()).zip(start.chunks(texels.size[0])) {
        for (c, line) in row.chunks_mut(texels.size[0]).enumerate() {
            line.iter_mut().zip(of).for_each(|(value, texel)| *value = texel[c]);
        }
    }
    front
}

/// Carries all rays that meet slabs through them.
fn eye(kernels: &Kernels, slices: &Slices, plan: &Plan, slabs: &Range<usize>, layers: &[f32], rays: &mut [Ray]) {
    let slicing = &slices.slicing;
    let planes = [slabs.start, slabs.end].map(|i| slicing.first + i as f64 * slicing.spacing);
    let seen = pixels(slices.eye.extent(slices.grid, slicing.axis, planes), slices.picture);
    let window: [[usize; 2]; 2] = slices.window;
    let of = |a: usize| [seen[a][0].max(window[a][0]), seen[a][1].min(window[a][1])];
    let ([left, right], [top, bottom]) = (of(0), of(1));
    if left >= right || top >= bottom {
        return;
    }
    let width = slices.picture[0];
    rays.par_chunks_mut(TILE * width).enumerate().for_each(|(j, band)| {
        if (j + 1) * TILE > top && j * TILE < bottom {
            for x in (left / TILE * TILE..right).step_by(TILE) {
                (kernels.eye)(plan, slabs, layers, [x, j * TILE], window, band);
            }
        }
    });
}

type Light = fn((&Plan, &Shine), &Range<usize>, usize, &[f32], &mut [f32], &mut [f32]);
type Eye = fn(&Plan, &Range<usize>, &[f32], [usize; 2], [[usize; 2]; 2], &mut [Ray]);

/// The kernels of an instruction set.
struct Kernels {
    light: Light,
    eye: Eye,
}

/// The kernels for `level`, which the processor must have.
fn at_level(level: Level) -> Kernels {
    match level {
        #[cfg(target_arch = "x86_64")]
        Level::Avx512 => Kernels {
            // SAFETY: the caller got the level from `simd::level`, which has asked the processor; so below.
            light: |p, s, b, f, n, l| unsafe { x86::light_512(p, s, b, f, n, l) },
            // SAFETY: as above.
            eye: |p, s, l, f, w, b| unsafe { x86::eye_512(p, s, l, f, w, b) },
        },
        #[cfg(target_arch = "x86_64")]
        Level::Avx2 => Kernels {
            // SAFETY: as above.
            light: |p, s, b, f, n, l| unsafe { x86::light_256(p, s, b, f, n, l) },
            // SAFETY: as above.
            eye: |p, s, l, f, w, b| unsafe { x86::eye_256(p, s, l, f, w, b) },
        },
        _ => Kernels { light: kernel::light::<Array<4>>, eye: kernel::eye::<Array<4>> },
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::ops::Range;

    use super::super::march::lanes::{Avx2, Avx512};
    use super::kernel::{eye, light};
    use super::plan::{Plan, Shine};
    use crate::device::Ray;

    macro_rules! compiled {
        ($features:literal, $lanes:ty, $light:ident, $eye:ident) => {
            #[target_feature(enable = $features)]
            pub(super) fn $light(
                plan: (&Plan, &Shine),
                slabs: &Range<usize>,
                band: usize,
                front: &[f32],
                next: &mut [f32],
                layers: &mut [f32],
            ) {
                light::<$lanes>(plan, slabs, band, front, next, layers);
            }

            #[target_feature(enable = $features)]
            pub(super) fn $eye(
                plan: &Plan,
                slabs: &Range<usize>,
                layers: &[f32],
                first: [usize; 2],
                window: [[usize; 2]; 2],
                band: &mut [Ray],
            ) {
                eye::<$lanes>(plan, slabs, layers, first, window, band);
            }
        };
    }
    compiled!("avx512f,avx512vl,avx512bw,avx512dq,avx2,bmi2,lzcnt,popcnt", Avx512, light_512, eye_512);
    compiled!("avx2,bmi2,lzcnt,popcnt", Avx2, light_256, eye_256);
}

#[cfg(test)]
mod tests;
