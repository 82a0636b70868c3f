//! Direct light by short characteristics (light.md; Zhang & Ma 2013 solve the same problem by upwind convection, eq. 16):
//!
//! `ρ(x) = ρ(foot) · exp(−½(σ(foot) + σ(x))·Δs)`
//!
//! The foot of a voxel lies in the previous layer perpendicular to the dominant axis, at lateral offset −u_b/|u_a|. A brick
//! and its upstream halo are gathered into cache with the layers first and in the order of travel, swept there, and the
//! result written back; gathering turns x-dominant light into contiguous rows too.

use rayon::prelude::*;
use std::cell::RefCell;

use super::simd::{dispatch, exp};
use crate::device::Sweep;
use crate::grid::{BrickLayout, Region};

/// Axes of a sweep: layers along the dominant axis, rows and columns across it (columns contiguous where possible), and
/// the lateral offset of the foot, in voxels per layer.
#[derive(Clone, Copy)]
struct Axes {
    layer: usize,
    row: usize,
    col: usize,
    ascending: bool,
    row_offset: f32,
    col_offset: f32,
}

impl Axes {
    fn new(sweep: &Sweep) -> Self {
        let layer = sweep.axis();
        let (row, col) = [(2, 1), (2, 0), (1, 0)][layer];
        let d = sweep.direction;
        let per_layer = |a: usize| (d[a] / d[layer].abs()).clamp(-1.0, 1.0);
        Axes { layer, row, col, ascending: d[layer] >= 0.0, row_offset: per_layer(row), col_offset: per_layer(col) }
    }
}

/// The solution, shared between the threads of a front.
#[derive(Clone, Copy)]
struct Shared(*mut f32, usize);
// SAFETY: bricks of one front write disjoint voxels and read only voxels of earlier fronts, which nobody writes.
unsafe impl Send for Shared {}
// SAFETY: as above.
unsafe impl Sync for Shared {}

/// reads σ, ρ upstream → writes ρ of the listed bricks; returns the largest change on each brick's downstream faces.
pub(crate) fn sweep(
    sweep: &Sweep,
    layout: &BrickLayout,
    sigma: &[f32],
    rho: &mut [f32],
    fronts: &[&[u32]],
) -> Vec<f32> {
    let voxels: usize = sweep.size.iter().product();
    assert!(sigma.len() >= voxels && rho.len() >= voxels && layout.size == sweep.size, "buffers must hold the grid");
    if sweep.cubic {
        return super::sweep_cubic::sweep(sweep, layout, sigma, rho, fronts);
    }
    let axes = Axes::new(sweep);
    let shared = Shared(rho.as_mut_ptr(), rho.len());
    let mut changes = Vec::with_capacity(fronts.iter().map(|f| f.len()).sum());
    for front in fronts {
        let one = |&b: &u32| {
            SCRATCH.with_borrow_mut(|scratch| brick(&axes, sweep, layout.region(b as usize), sigma, shared, scratch))
        };
        if front.len() == 1 {
            changes.push(one(&front[0]));
        } else {
            changes.par_extend(front.par_iter().with_max_len(1).map(one));
        }
    }
    changes
}

/// A brick with its upstream halo, layers first in order of travel: (layers + 1) × (rows + 1) × (columns + 1).
#[derive(Default)]
struct Scratch {
    sigma: Vec<f32>,
    rho: Vec<f32>,
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// Where a gathered brick's voxels are: layer 0 is the upstream halo, row 0 the upstream row, and the upstream column
/// stands first or last so that a row is copied in the order of memory.
#[derive(Clone, Copy)]
struct Local {
    layers: usize,
    rows: usize,
    cols: usize,
    row_forward: bool,
    col_forward: bool,
}

impl Local {
    fn pitch(&self) -> usize {
        self.cols + 1
    }
    fn plane(&self) -> usize {
        (self.rows + 1) * self.pitch()
    }
    /// Grid index along the layer axis of local layer `l`, −1 or beyond the grid for a halo outside.
    fn layer_at(&self, r: &Region, axes: &Axes, l: usize) -> isize {
        let start = r.start[axes.layer] as isize;
        if axes.ascending { start + l as isize - 1 } else { start + (self.layers - l) as isize }
    }
    fn row_at(&self, r: &Region, axes: &Axes, row: usize) -> isize {
        let start = r.start[axes.row] as isize;
        if self.row_forward { start + row as isize - 1 } else { start + (self.rows - row) as isize }
    }
}

dispatch! {
    fn brick(axes: &Axes, sweep: &Sweep, region: Region, sigma: &[f32], rho: Shared, scratch: &mut Scratch) -> f32 = brick_body;
}

#[inline(always)]
fn brick_body(axes: &Axes, sweep: &Sweep, region: Region, sigma: &[f32], rho: Shared, scratch: &mut Scratch) -> f32 {
    let local = Local {
        layers: region.size[axes.layer],
        rows: region.size[axes.row],
        cols: region.size[axes.col],
        row_forward: axes.row_offset >= 0.0,
        col_forward: axes.col_offset >= 0.0,
    };
    let need = (local.layers + 1) * local.plane();
    if scratch.sigma.len() < need {
        scratch.sigma.resize(need, 0.0);
        scratch.rho.resize(need, 0.0);
    }
    let (s, r) = (&mut scratch.sigma[..need], &mut scratch.rho[..need]);
    // SAFETY: only the halo is read through this slice, which belongs to bricks of earlier fronts; no other thread
    // writes those voxels while it lives.
    let upstream = |at: usize, n: usize| unsafe {
        debug_assert!(at + n <= rho.1);
        std::slice::from_raw_parts(rho.0.add(at), n)
    };
    gather(axes, sweep.size, &region, &local, s, 0.0, true, |at, n| &sigma[at..at + n]);
    gather(axes, sweep.size, &region, &local, r, 1.0, false, upstream);

    let first = local.layer_at(&region, axes, 0);
    let outside = first < 0 || first as usize >= sweep.size[axes.layer];
    march_layers(axes, sweep.length, &local, outside, s, r);
    scatter(axes, sweep.size, &region, &local, r, rho)
}

/// Copies a brick and its halo out of a grid; `fill` stands outside the grid. With `inside` false only the halo is copied.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn gather<'a>(
    axes: &Axes,
    size: [usize; 3],
    region: &Region,
    local: &Local,
    out: &mut [f32],
    fill: f32,
    inside: bool,
    read: impl Fn(usize, usize) -> &'a [f32],
) {
    let stride = [1, size[0], size[0] * size[1]];
    let (pitch, plane) = (local.pitch(), local.plane());
    let col_start = region.start[axes.col];
    // First grid column of a local row, and where the columns of the grid begin in it.
    let halo_col = if local.col_forward { col_start.checked_sub(1) } else { Some(col_start + local.cols) };
    let halo_col = halo_col.filter(|&c| c < size[axes.col]);
    let body = usize::from(local.col_forward);
    let halo_slot = if local.col_forward { 0 } else { local.cols };
    let on_grid = |at: isize, n: usize| (at >= 0 && (at as usize) < n).then_some(at as usize);

    if axes.col == 0 {
        for l in 0..=local.layers {
            let layer = on_grid(local.layer_at(region, axes, l), size[axes.layer]);
            for row in 0..=local.rows {
                let out = &mut out[l * plane + row * pitch..][..pitch];
                let at = layer.zip(on_grid(local.row_at(region, axes, row), size[axes.row]));
                let Some((layer, grid_row)) = at else {
                    out.fill(fill);
                    continue;
                };
                let base = layer * stride[axes.layer] + grid_row * stride[axes.row];
                if inside || l == 0 || row == 0 {
                    out[body..body + local.cols].copy_from_slice(read(base + col_start, local.cols));
                }
                out[halo_slot] = halo_col.map_or(fill, |c| read(base + c, 1)[0]);
            }
        }
        return;
    }
    // x-dominant: memory rows run along the layers; columns are y, rows are z.
    let x_start = region.start[0];
    let halo_x = on_grid(local.layer_at(region, axes, 0), size[0]);
    for row in 0..=local.rows {
        let Some(z) = on_grid(local.row_at(region, axes, row), size[2]) else {
            for l in 0..=local.layers {
                out[l * plane + row * pitch..][..pitch].fill(fill);
            }
            continue;
        };
        let out = &mut out[row * pitch..];
        let column = |slot: usize, y: Option<usize>, out: &mut [f32], deep: bool| {
            let Some(y) = y else {
                (0..=local.layers).for_each(|l| out[l * plane + slot] = fill);
                return;
            };
            let base = z * stride[2] + y * stride[1];
            out[slot] = halo_x.map_or(fill, |x| read(base + x, 1)[0]);
            if deep {
                let line = read(base + x_start, local.layers);
                for (i, &v) in line.iter().enumerate() {
                    let l = if axes.ascending { i + 1 } else { local.layers - i };
                    out[l * plane + slot] = v;
                }
            }
        };
        column(halo_slot, halo_col, out, true);
        let deep = inside || row == 0;
        let blocks = if deep { local.cols / 8 * 8 } else { 0 };
        for c in (0..blocks).step_by(8) {
            for i in (0..local.layers / 8 * 8).step_by(8) {
                let tile: [[f32; 8]; 8] = std::array::from_fn(|c8| {
                    let base = z * stride[2] + (col_start + c + c8) * stride[1] + x_start + i;
                    read(base, 8).try_into().expect("8 values")
                });
                for i8 in 0..8 {
                    let l = if axes.ascending { i + i8 + 1 } else { local.layers - i - i8 };
                    let line: [f32; 8] = std::array::from_fn(|c8| tile[c8][i8]);
                    out[l * plane + body + c..][..8].copy_from_slice(&line);
                }
            }
            for c8 in 0..8 {
                let base = z * stride[2] + (col_start + c + c8) * stride[1];
                out[body + c + c8] = halo_x.map_or(fill, |x| read(base + x, 1)[0]);
                for i in local.layers / 8 * 8..local.layers {
                    let l = if axes.ascending { i + 1 } else { local.layers - i };
                    out[l * plane + body + c + c8] = read(base + x_start + i, 1)[0];
                }
            }
        }
        for c in blocks..local.cols {
            column(body + c, Some(col_start + c), out, deep);
        }
    }
}

/// The equation itself, over a gathered brick.
#[inline(always)]
fn march_layers(axes: &Axes, length: f32, local: &Local, outside: bool, s: &[f32], r: &mut [f32]) {
    let (pitch, plane, cols) = (local.pitch(), local.plane(), local.cols);
    let (wr, wc) = (axes.row_offset.abs(), axes.col_offset.abs());
    let (w00, w01, w10, w11) = ((1.0 - wr) * (1.0 - wc), (1.0 - wr) * wc, wr * (1.0 - wc), wr * wc);
    let here = usize::from(local.col_forward);
    let up = 1 - here;
    let half = -0.5 * length;
    for l in 1..=local.layers {
        let (done, rest) = r.split_at_mut(l * plane);
        let (before, s_before) = (&done[(l - 1) * plane..], &s[(l - 1) * plane..l * plane]);
        let s_now = &s[l * plane..][..plane];
        for row in 1..=local.rows {
            let at = row * pitch;
            let out = &mut rest[at + here..][..cols];
            let sigma = &s_now[at + here..][..cols];
            if outside && l == 1 {
                for c in 0..cols {
                    out[c] = exp(half * sigma[c]);
                }
                continue;
            }
            let (a, b) = (&before[at + here..][..cols], &before[at + up..][..cols]);
            let (c, d) = (&before[at - pitch + here..][..cols], &before[at - pitch + up..][..cols]);
            let (sa, sb) = (&s_before[at + here..][..cols], &s_before[at + up..][..cols]);
            let (sc, sd) = (&s_before[at - pitch + here..][..cols], &s_before[at - pitch + up..][..cols]);
            for i in 0..cols {
                let rho_foot = (w00 * a[i] + w01 * b[i]) + (w10 * c[i] + w11 * d[i]);
                let sigma_foot = (w00 * sa[i] + w01 * sb[i]) + (w10 * sc[i] + w11 * sd[i]);
                out[i] = rho_foot * exp(half * (sigma_foot + sigma[i]));
            }
        }
    }
}

/// Writes a swept brick back; returns the largest change on its downstream faces.
#[inline(always)]
fn scatter(axes: &Axes, size: [usize; 3], region: &Region, local: &Local, r: &[f32], rho: Shared) -> f32 {
    let stride = [1, size[0], size[0] * size[1]];
    let (pitch, plane) = (local.pitch(), local.plane());
    let body = usize::from(local.col_forward);
    let last_col = if local.col_forward { local.cols - 1 } else { 0 };
    let mut change = 0.0f32;
    // SAFETY: the voxels of this brick, which no other thread reads or writes during this front.
    let own = |at: usize, n: usize| unsafe {
        debug_assert!(at + n <= rho.1);
        std::slice::from_raw_parts_mut(rho.0.add(at), n)
    };
    if axes.col == 0 {
        for l in 1..=local.layers {
            let layer = local.layer_at(region, axes, l) as usize;
            for row in 1..=local.rows {
                let grid_row = local.row_at(region, axes, row) as usize;
                let new = &r[l * plane + row * pitch + body..][..local.cols];
                let base = layer * stride[axes.layer] + grid_row * stride[axes.row] + region.start[0];
                let old = own(base, local.cols);
                if l == local.layers || row == local.rows {
                    change = new.iter().zip(old.iter()).fold(change, |m, (n, o)| m.max((n - o).abs()));
                } else {
                    change = change.max((new[last_col] - old[last_col]).abs());
                }
                old.copy_from_slice(new);
            }
        }
        return change;
    }
    let (y_start, x_start) = (region.start[1], region.start[0]);
    let last_x = if axes.ascending { local.layers - 1 } else { 0 };
    for row in 1..=local.rows {
        let z = local.row_at(region, axes, row) as usize;
        let r = &r[row * pitch + body..];
        let layer_of = |i: usize| if axes.ascending { i + 1 } else { local.layers - i };
        let face = |c: usize| row == local.rows || c == last_col;
        let full = local.layers / 8 * 8;
        for c in 0..local.cols {
            let old = own(z * stride[2] + (y_start + c) * stride[1] + x_start, local.layers);
            if face(c) {
                for (i, o) in old.iter().enumerate() {
                    change = change.max((r[layer_of(i) * plane + c] - o).abs());
                }
            } else {
                change = change.max((r[local.layers * plane + c] - old[last_x]).abs());
            }
            for i in full..local.layers {
                old[i] = r[layer_of(i) * plane + c];
            }
            if c >= local.cols / 8 * 8 {
                for i in 0..full {
                    old[i] = r[layer_of(i) * plane + c];
                }
            }
        }
        for c in (0..local.cols / 8 * 8).step_by(8) {
            for i in (0..full).step_by(8) {
                let tile: [[f32; 8]; 8] =
                    std::array::from_fn(|i8| r[layer_of(i + i8) * plane + c..][..8].try_into().expect("8 values"));
                for c8 in 0..8 {
                    let line: [f32; 8] = std::array::from_fn(|i8| tile[i8][c8]);
                    own(z * stride[2] + (y_start + c + c8) * stride[1] + x_start + i, 8).copy_from_slice(&line);
                }
            }
        }
    }
    change
}
