//! Direct light by short characteristics with a cubic foot: Catmull–Rom over 4×4 voxels of the previous layer, clamped to
//! the four nearest values, so that no new extremes appear; σ at the foot stays bilinear. A cubic foot reaches downstream
//! voxels of the previous layer, so whole layers are swept one after another, rows in parallel.

use rayon::prelude::*;
use std::cell::RefCell;

use super::characteristic::Axes;
use super::shared::Shared;
use super::simd::{dispatch, exp, transpose};
use crate::device::Sweep;

/// Voxels of padding round a plane: a foot reaches at most 1 + 2 voxels away.
const PAD: usize = 3;
/// Layers that are gathered at once: enough for whole cache lines when the layers run along x.
const SLAB: usize = 16;

/// Weights and position of the foot along one lateral axis: it lies after voxel `at` relative to a voxel's own index.
struct Foot {
    at: isize,
    cubic: [f32; 4],
    linear: [f32; 2],
}

impl Foot {
    fn new(offset: f32) -> Self {
        let position = -offset;
        let at = position.floor();
        let f = position - at;
        let cubic = [
            -0.5 * f + f * f - 0.5 * f * f * f,
            1.0 - 2.5 * f * f + 1.5 * f * f * f,
            0.5 * f + 2.0 * f * f - 1.5 * f * f * f,
            -0.5 * f * f + 0.5 * f * f * f,
        ];
        Foot { at: at as isize, cubic, linear: [1.0 - f, f] }
    }
}

/// Padded planes: the layer before a slab, then the slab's layers in order of travel.
#[derive(Default)]
struct Slab {
    key: [usize; 2],
    rho: Vec<f32>,
    sigma: Vec<f32>,
}

impl Slab {
    /// Room for planes of `rows`×`cols`; the padding is what lies outside the grid.
    fn fit(&mut self, rows: usize, cols: usize) {
        if self.key != [rows, cols] {
            let len = (SLAB + 1) * (rows + 2 * PAD) * (cols + 2 * PAD);
            *self = Slab { key: [rows, cols], rho: vec![1.0; len], sigma: vec![0.0; len] };
        }
    }
}

thread_local! {
    static SLABS: RefCell<Slab> = RefCell::default();
}

/// reads σ → writes ρ everywhere.
pub(crate) fn sweep(axes: &Axes, sweep: &Sweep, sigma: &[f32], rho: Shared) {
    SLABS.with_borrow_mut(|slab| sweep_slabs(axes, sweep, sigma, rho, slab));
}

fn sweep_slabs(axes: &Axes, sweep: &Sweep, sigma: &[f32], rho: Shared, slab: &mut Slab) {
    let size = sweep.size;
    let stride = [1, size[0], size[0] * size[1]];
    let (layers, rows, cols) = (size[axes.layer], size[axes.row], size[axes.col]);
    let feet = [Foot::new(axes.row_offset), Foot::new(axes.col_offset)];
    let pitch = cols + 2 * PAD;
    let plane = (rows + 2 * PAD) * pitch;
    slab.fit(rows, cols);
    let inner = |l: usize, row: usize| l * plane + (row + PAD) * pitch + PAD;
    let step = if axes.ascending { stride[axes.layer] as isize } else { -(stride[axes.layer] as isize) };

    for first in (0..layers).step_by(SLAB) {
        let deep = SLAB.min(layers - first);
        // Grid index of the slab's first layer in order of travel, and of its lowest.
        let start = if axes.ascending { first } else { layers - 1 - first };
        let lowest = if axes.ascending { start } else { start + 1 - deep };
        let padded = Shared::new(&mut slab.sigma);
        (0..rows).into_par_iter().with_min_len(8).for_each(|row| {
            let base = row * stride[axes.row];
            // SAFETY: each row of the planes is written by one thread, inside its padding; σ is only read.
            unsafe {
                if axes.col == 0 {
                    for l in 0..deep {
                        let from = (base + start * stride[axes.layer]).wrapping_add_signed(l as isize * step);
                        padded.row(inner(l + 1, row), cols).copy_from_slice(&sigma[from..from + cols]);
                    }
                } else {
                    let from = &sigma[base + lowest..][..(cols - 1) * stride[1] + deep];
                    padded.check(inner(1, row), (deep - 1) * plane + cols);
                    let to = padded.at(inner(1, row));
                    let (to, step) = if axes.ascending {
                        (to, plane as isize)
                    } else {
                        (to.add((deep - 1) * plane), -(plane as isize))
                    };
                    transpose(from.as_ptr(), stride[1] as isize, cols, deep, to, step);
                }
            }
        });
        for l in 1..=deep {
            let (before, now) = slab.rho.split_at_mut(l * plane);
            let before = &before[(l - 1) * plane..];
            let s_before = &slab.sigma[(l - 1) * plane..l * plane];
            let s_now = &slab.sigma[l * plane..];
            let now = &mut now[PAD * pitch..(PAD + rows) * pitch];
            now.par_chunks_exact_mut(pitch).enumerate().with_min_len(8).for_each(|(row, out)| {
                let sigma = &s_now[(row + PAD) * pitch + PAD..][..cols];
                let out = &mut out[PAD..PAD + cols];
                if first + l == 1 {
                    out.iter_mut().zip(sigma).for_each(|(o, s)| *o = exp(-0.5 * sweep.length * s));
                } else {
                    line(before, s_before, &feet, pitch, row, sigma, sweep.length, out);
                }
            });
        }
        let done = &slab.rho;
        (0..rows).into_par_iter().with_min_len(8).for_each(|row| {
            let base = row * stride[axes.row];
            // SAFETY: each row of the grid is written by one thread.
            unsafe {
                if axes.col == 0 {
                    for l in 0..deep {
                        let to = (base + start * stride[axes.layer]).wrapping_add_signed(l as isize * step);
                        rho.row(to, cols).copy_from_slice(&done[inner(l + 1, row)..][..cols]);
                    }
                } else {
                    let from = done[inner(1, row)..][..(deep - 1) * plane + cols].as_ptr();
                    let (from, step) = if axes.ascending {
                        (from, plane as isize)
                    } else {
                        (from.add((deep - 1) * plane), -(plane as isize))
                    };
                    rho.check(base + lowest + (cols - 1) * stride[1], deep);
                    transpose(from, step, deep, cols, rho.at(base + lowest), stride[1] as isize);
                }
            }
        });
        // The slab's last layer is the one before the next slab.
        slab.rho.copy_within(deep * plane..(deep + 1) * plane, 0);
        slab.sigma.copy_within(deep * plane..(deep + 1) * plane, 0);
    }
}

dispatch! {
    fn line(before: &[f32], s_before: &[f32], feet: &[Foot; 2], pitch: usize, row: usize, sigma: &[f32], length: f32, out: &mut [f32]) = line_body;
}

#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn line_body(
    before: &[f32],
    s_before: &[f32],
    feet: &[Foot; 2],
    pitch: usize,
    row: usize,
    sigma: &[f32],
    length: f32,
    out: &mut [f32],
) {
    let cols = out.len();
    let [fr, fc] = feet;
    // Row and column of the first of the four taps, padding included.
    let row0 = ((row + PAD) as isize + fr.at - 1) as usize;
    let col0 = (PAD as isize + fc.at - 1) as usize;
    let rho: [&[f32]; 4] = std::array::from_fn(|r| &before[(row0 + r) * pitch + col0..][..cols + 3]);
    let sig: [&[f32]; 2] = std::array::from_fn(|r| &s_before[(row0 + 1 + r) * pitch + col0 + 1..][..cols + 1]);
    for i in 0..cols {
        let mut foot = 0.0;
        for (r, rho) in rho.iter().enumerate() {
            let across = (fc.cubic[0] * rho[i] + fc.cubic[1] * rho[i + 1])
                + (fc.cubic[2] * rho[i + 2] + fc.cubic[3] * rho[i + 3]);
            foot += fr.cubic[r] * across;
        }
        let (a, b, c, d) = (rho[1][i + 1], rho[1][i + 2], rho[2][i + 1], rho[2][i + 2]);
        let min = |x: f32, y: f32| if x < y { x } else { y };
        let max = |x: f32, y: f32| if x > y { x } else { y };
        let (lo, hi) = (min(min(a, b), min(c, d)), max(max(a, b), max(c, d)));
        let foot = min(max(foot, lo), hi);
        let sigma_foot = fr.linear[0] * (fc.linear[0] * sig[0][i] + fc.linear[1] * sig[0][i + 1])
            + fr.linear[1] * (fc.linear[0] * sig[1][i] + fc.linear[1] * sig[1][i + 1]);
        out[i] = foot * exp(-0.5 * length * (sigma_foot + sigma[i]));
    }
}
