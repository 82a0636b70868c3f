//! A step of a short characteristic: the voxel's foot in the layer before, and what the medium between takes away. See
//! [`super::sweep`].

use super::simd::exp;
use crate::device::Sweep;

/// Values in a cache line.
pub(super) const LINE: usize = 16;

/// Axes of a sweep: layers along the dominant axis, rows and columns across it (columns contiguous where possible), and
/// the lateral offset of the foot, in voxels per layer.
#[derive(Clone, Copy)]
pub(super) struct Axes {
    pub(super) layer: usize,
    pub(super) row: usize,
    pub(super) col: usize,
    pub(super) ascending: bool,
    pub(super) row_offset: f32,
    pub(super) col_offset: f32,
}

impl Axes {
    pub(super) fn new(sweep: &Sweep) -> Self {
        let layer = sweep.axis();
        let (row, col) = [(2, 1), (2, 0), (1, 0)][layer];
        let d = sweep.direction;
        let per_layer = |a: usize| (d[a] / d[layer].abs()).clamp(-1.0, 1.0);
        Axes { layer, row, col, ascending: d[layer] >= 0.0, row_offset: per_layer(row), col_offset: per_layer(col) }
    }
}

/// Bilinear weights of the foot: own row and column, upstream column, upstream row, both.
#[inline(always)]
pub(super) fn weights(axes: &Axes) -> [f32; 4] {
    let (r, c) = (axes.row_offset.abs(), axes.col_offset.abs());
    [(1.0 - r) * (1.0 - c), (1.0 - r) * c, r * (1.0 - c), r * c]
}

/// The first layer: half a voxel inside the box.
#[inline(always)]
pub(super) fn first_line(sigma: &[f32], half: f32, out: &mut [f32]) {
    out.iter_mut().zip(sigma).for_each(|(o, s)| *o = exp(half * s));
}

/// Two planes of a gathered brick: the layer before and the one in hand.
#[derive(Default)]
pub(super) struct Scratch {
    pub(super) sigma: Vec<f32>,
    pub(super) rho: Vec<f32>,
}

impl Scratch {
    /// Room for `len` values of each.
    pub(super) fn fit(&mut self, len: usize) {
        if self.sigma.len() < len {
            self.sigma.resize(len, 0.0);
            self.rho.resize(len, 0.0);
        }
    }
}

/// One row of a layer. A function of its own, so that the compiler knows that nothing overlaps.
#[inline(always)]
pub(super) fn line(rho: [&[f32]; 4], sigma_up: [&[f32]; 4], sigma: &[f32], w: [f32; 4], half: f32, out: &mut [f32]) {
    let n = out.len();
    let ([a, b, c, d], [sa, sb, sc, sd]) = (rho.map(|v| &v[..n]), sigma_up.map(|v| &v[..n]));
    let sigma = &sigma[..n];
    for i in 0..n {
        let rho_foot = (w[0] * a[i] + w[1] * b[i]) + (w[2] * c[i] + w[3] * d[i]);
        let sigma_foot = (w[0] * sa[i] + w[1] * sb[i]) + (w[2] * sc[i] + w[3] * sd[i]);
        out[i] = rho_foot * exp(half * (sigma_foot + sigma[i]));
    }
}
