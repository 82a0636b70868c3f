//! Direct light by short characteristics with a cubic foot: Catmull–Rom over 4×4 voxels of the previous layer, clamped to
//! the four nearest values, so that no new extremes appear; σ at the foot stays bilinear. A cubic foot reaches downstream
//! voxels of the previous layer, so whole layers are swept one after another, rows in parallel.

use rayon::prelude::*;

use super::simd::{dispatch, exp};
use crate::device::Sweep;
use crate::grid::BrickLayout;

/// Voxels of padding round a plane: a foot reaches at most 1 + 2 voxels away.
const PAD: usize = 3;

/// Weights and position of the foot along one lateral axis: it lies `frac` after voxel `at` relative to a voxel's own index.
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

/// A padded layer of ρ and σ.
struct Plane {
    rho: Vec<f32>,
    sigma: Vec<f32>,
}

/// reads σ → writes ρ everywhere; returns per listed brick the largest change of ρ in it.
pub(crate) fn sweep(
    sweep: &Sweep,
    layout: &BrickLayout,
    sigma: &[f32],
    rho: &mut [f32],
    fronts: &[&[u32]],
) -> Vec<f32> {
    let d = sweep.direction;
    let layer_axis = sweep.axis();
    let (row_axis, col_axis) = [(2, 1), (2, 0), (1, 0)][layer_axis];
    let stride = [1, sweep.size[0], sweep.size[0] * sweep.size[1]];
    let (layers, rows, cols) = (sweep.size[layer_axis], sweep.size[row_axis], sweep.size[col_axis]);
    let offset = |a: usize| (d[a] / d[layer_axis].abs()).clamp(-1.0, 1.0);
    let feet = [Foot::new(offset(row_axis)), Foot::new(offset(col_axis))];
    let pitch = cols + 2 * PAD;
    let blank = || Plane { rho: vec![1.0; (rows + 2 * PAD) * pitch], sigma: vec![0.0; (rows + 2 * PAD) * pitch] };
    let (mut before, mut now) = (blank(), blank());
    let mut changed = vec![0.0f32; layout.len()];
    let counts = layout.counts();
    for l in 0..layers {
        let layer = if d[layer_axis] >= 0.0 { l } else { layers - 1 - l };
        let base = layer * stride[layer_axis];
        let (inner_rho, inner_sigma) = (&mut now.rho[PAD * pitch..][..rows * pitch], &mut now.sigma[PAD * pitch..]);
        inner_rho.par_chunks_exact_mut(pitch).zip(inner_sigma.par_chunks_mut(pitch)).enumerate().for_each(
            |(row, (out, s))| {
                let from = base + row * stride[row_axis];
                for (c, s) in s[PAD..PAD + cols].iter_mut().enumerate() {
                    *s = sigma[from + c * stride[col_axis]];
                }
                let out = &mut out[PAD..PAD + cols];
                if l == 0 {
                    out.iter_mut().zip(&s[PAD..]).for_each(|(o, s)| *o = exp(-0.5 * sweep.length * s));
                } else {
                    line(&before, &feet, pitch, row, &s[PAD..PAD + cols], sweep.length, out);
                }
            },
        );
        for row in 0..rows {
            let from = base + row * stride[row_axis];
            let new = &now.rho[(row + PAD) * pitch + PAD..][..cols];
            for (first, new) in new.chunks(layout.edge).enumerate().map(|(i, n)| (i * layout.edge, n)) {
                let mut coords = [0; 3];
                coords[layer_axis] = layer / layout.edge;
                coords[row_axis] = row / layout.edge;
                coords[col_axis] = first / layout.edge;
                let brick = (coords[2] * counts[1] + coords[1]) * counts[0] + coords[0];
                let mut change = changed[brick];
                for (i, &n) in new.iter().enumerate() {
                    let old = &mut rho[from + (first + i) * stride[col_axis]];
                    change = change.max((n - *old).abs());
                    *old = n;
                }
                changed[brick] = change;
            }
        }
        std::mem::swap(&mut before, &mut now);
    }
    fronts.iter().flat_map(|f| f.iter()).map(|&b| changed[b as usize]).collect()
}

dispatch! {
    fn line(before: &Plane, feet: &[Foot; 2], pitch: usize, row: usize, sigma: &[f32], length: f32, out: &mut [f32]) = line_body;
}

#[inline(always)]
fn line_body(before: &Plane, feet: &[Foot; 2], pitch: usize, row: usize, sigma: &[f32], length: f32, out: &mut [f32]) {
    let cols = out.len();
    let [fr, fc] = feet;
    // Row and column of the first of the four taps, padding included.
    let row0 = ((row + PAD) as isize + fr.at - 1) as usize;
    let col0 = (PAD as isize + fc.at - 1) as usize;
    let rho: [&[f32]; 4] = std::array::from_fn(|r| &before.rho[(row0 + r) * pitch + col0..][..cols + 3]);
    let sig: [&[f32]; 2] = std::array::from_fn(|r| &before.sigma[(row0 + 1 + r) * pitch + col0 + 1..][..cols + 1]);
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
