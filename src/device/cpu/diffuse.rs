//! Diffusion with one coefficient for the whole volume and mirrors as walls (Zhang & Ma 2013, (23)), exact in time: a
//! separable convolution `out(i) = w₀ v(i) + Σ w_n (v(i−n) + v(i+n))` along each axis, indices reflected at the faces
//! (−1 is 0).
//!
//! In place and with two passes over memory: planes are convolved along x and y while they are in cache, then columns of
//! planes along z through a ring of the planes that are still needed.

use std::cell::RefCell;

use rayon::prelude::*;

use super::shared::Shared;
use super::simd::{dispatch, prefetch};

/// Values of a column of planes: the ring for a usual kernel (17 planes) fits into a first-level cache; 256 and 2048 were slower.
const COLUMN: usize = 512;

/// Values whose sums are held in registers.
const BLOCK: usize = 64;

/// Values of a cache line.
const LINE: usize = 16;

#[derive(Default)]
struct Scratch {
    plane: Vec<f32>,
    row: Vec<f32>,
    pairs: Vec<[usize; 2]>,
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// values → values convolved with `weights` along x, y, z; each starts with the middle of a symmetric kernel.
pub(crate) fn diffuse(size: [usize; 3], weights: [&[f32]; 3], values: &mut [f32]) {
    let [nx, ny, nz] = size;
    let plane = nx * ny;
    let values = &mut values[..plane * nz];
    if weights[0].len() > 1 || weights[1].len() > 1 {
        values.par_chunks_exact_mut(plane).with_min_len(8).for_each(|values| {
            SCRATCH.with_borrow_mut(|scratch| in_plane([nx, ny], weights[0], weights[1], values, scratch));
        });
    }
    if weights[2].len() > 1 {
        let shared = Shared::new(values);
        (0..plane.div_ceil(COLUMN)).into_par_iter().for_each(|c| {
            let column = c * COLUMN..((c + 1) * COLUMN).min(plane);
            SCRATCH.with_borrow_mut(|scratch| across(plane, nz, column, weights[2], shared, scratch));
        });
    }
}

/// Index i of an axis of n values with mirrors at its ends.
#[inline(always)]
pub(crate) fn reflect(i: isize, n: usize) -> usize {
    let period = 2 * n as isize;
    let i = i.rem_euclid(period);
    (if i < n as isize { i } else { period - 1 - i }) as usize
}

dispatch! {
    fn in_plane(size: [usize; 2], x: &[f32], y: &[f32], values: &mut [f32], scratch: &mut Scratch) = in_plane_body;
}

#[inline(always)]
fn in_plane_body([nx, ny]: [usize; 2], x: &[f32], y: &[f32], values: &mut [f32], scratch: &mut Scratch) {
    let Scratch { plane, row, pairs } = scratch;
    plane.resize(nx * ny, 0.0);
    let radius = x.len() - 1;
    row.resize(nx + 2 * radius, 0.0);
    pairs.clear();
    pairs.extend((1..=radius).map(|n| [radius - n, radius + n]));
    for (values, out) in values.chunks_exact(nx).zip(plane.chunks_exact_mut(nx)) {
        row[radius..radius + nx].copy_from_slice(values);
        for n in 1..=radius {
            row[radius - n] = values[reflect(-(n as isize), nx)];
            row[radius + nx - 1 + n] = values[reflect((nx - 1 + n) as isize, nx)];
        }
        convolve(row, radius, pairs, x, out);
    }
    for j in 0..ny {
        pairs.clear();
        let at = |j: isize| reflect(j, ny) * nx;
        pairs.extend((1..y.len() as isize).map(|n| [at(j as isize - n), at(j as isize + n)]));
        // The plane after this one: memory would rest while rows are convolved.
        fetch(values.as_ptr().wrapping_add(nx * ny + j * nx), nx);
        convolve(plane, j * nx, pairs, y, &mut values[j * nx..][..nx]);
    }
}

dispatch! {
    fn across(plane: usize, nz: usize, column: std::ops::Range<usize>, weights: &[f32], values: Shared, scratch: &mut Scratch) = across_body;
}

#[inline(always)]
fn across_body(
    plane: usize,
    nz: usize,
    column: std::ops::Range<usize>,
    weights: &[f32],
    values: Shared,
    scratch: &mut Scratch,
) {
    let Scratch { plane: ring, pairs, .. } = scratch;
    let radius = weights.len() - 1;
    let width = column.len();
    // A reflected index within the reach of a plane is one of the planes within that reach.
    let slots = nz.min(2 * radius + 1);
    ring.resize((slots * width).max(ring.len()), 0.0);
    let mut held = 0;
    for k in 0..nz {
        while held < nz && held <= k + radius {
            ring[held % slots * width..][..width].copy_from_slice(values.read(held * plane + column.start, width));
            held += 1;
        }
        // The next plane's part lies in another page of memory, where no stream is seen.
        if held < nz {
            fetch(values.at(held * plane + column.start), width);
        }
        let slot = |k: isize| reflect(k, nz) % slots * width;
        pairs.clear();
        pairs.extend((1..weights.len() as isize).map(|n| [slot(k as isize - n), slot(k as isize + n)]));
        // SAFETY: this thread alone has this column.
        let out = unsafe { values.row(k * plane + column.start, width) };
        convolve(ring, slot(k as isize), pairs, weights, out);
    }
}

/// Asks for `n` values that are wanted soon.
#[inline(always)]
fn fetch(at: *const f32, n: usize) {
    for line in (0..n).step_by(LINE) {
        prefetch(at.wrapping_add(line));
    }
}

/// `out[l] = w₀·from[at + l] + Σ w_n·(from[pair 0 + l] + from[pair 1 + l])`.
#[inline(always)]
fn convolve(from: &[f32], at: usize, pairs: &[[usize; 2]], weights: &[f32], out: &mut [f32]) {
    let n = out.len();
    let (blocks, rest) = out.as_chunks_mut::<BLOCK>();
    let reach = n.saturating_sub(rest.len());
    for (b, out) in blocks.iter_mut().enumerate() {
        let part = |start: usize| from[start + b * BLOCK..].first_chunk::<BLOCK>().expect("within the volume");
        let middle = part(at);
        let mut sum = [0.0f32; BLOCK];
        for l in 0..BLOCK {
            sum[l] = weights[0] * middle[l];
        }
        for ([low, high], w) in pairs.iter().zip(&weights[1..]) {
            let (low, high) = (part(*low), part(*high));
            for l in 0..BLOCK {
                sum[l] += w * (low[l] + high[l]);
            }
        }
        *out = sum;
    }
    for (l, out) in rest.iter_mut().enumerate() {
        let l = reach + l;
        let mut sum = weights[0] * from[at + l];
        for ([low, high], w) in pairs.iter().zip(&weights[1..]) {
            sum += w * (from[low + l] + from[high + l]);
        }
        *out = sum;
    }
}
