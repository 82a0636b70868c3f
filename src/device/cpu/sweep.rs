//! Direct light by short characteristics (light.md; Zhang & Ma 2013 solve the same problem by upwind convection, eq. 16):
//!
//! `ρ(x) = ρ(foot) · exp(−½(σ(foot) + σ(x))·Δs)`
//!
//! The foot of a voxel lies in the previous layer perpendicular to the dominant axis, at lateral offset −u_b/|u_a|. A brick
//! and its upstream halo are gathered into cache with the layers first and in the order of travel, swept there, and the
//! result written back; gathering turns x-dominant light into contiguous rows too.

use rayon::prelude::*;
use std::cell::RefCell;

use super::characteristic::{Axes, LINE, Scratch, first_line, line, weights};
use super::fronts::front_by_front;
use super::shared::Shared;
use super::simd::{dispatch, prefetch};
use super::sweep_x::region_along_x;
use crate::device::Sweep;
use crate::grid::{BrickLayout, Region};

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
    let axes = Axes::new(sweep);
    let shared = Shared::new(rho);
    let listed = fronts.iter().map(|f| f.len()).sum();
    if sweep.cubic {
        assert!(!sweep.given, "a cubic foot needs the whole grid");
        super::sweep_cubic::sweep(&axes, sweep, sigma, shared);
        return vec![f32::INFINITY; listed];
    }
    if listed == layout.len() {
        whole(&axes, sweep, sigma, shared);
        return vec![f32::INFINITY; listed];
    }
    let solve = if axes.layer == 0 { region_along_x } else { brick };
    front_by_front(layout, fronts, |region| {
        SCRATCH.with_borrow_mut(|scratch| solve(&axes, sweep, region, sigma, shared, scratch, true))
    })
}

/// The whole grid, when nothing is to be skipped: blocks long in memory, so that it is read in long runs. Bit for bit what the
/// bricks give. Blocks on a diagonal are independent.
fn whole(axes: &Axes, sweep: &Sweep, sigma: &[f32], rho: Shared) {
    let size = sweep.size;
    let along = [axes.layer, axes.row, axes.col];
    let forward = [axes.ascending, axes.row_offset >= 0.0, axes.col_offset >= 0.0];
    let swept = swept(sweep);
    // Layers, rows, columns of a block. Along x memory runs with the layers, else with the columns.
    let block = if axes.layer == 0 { [256, 32, 64] } else { [32, 16, size[0]] };
    let counts: [usize; 3] = std::array::from_fn(|a| swept.size[along[a]].div_ceil(block[a]));
    for diagonal in 0..counts.iter().sum::<usize>() - 2 {
        let blocks: Vec<[usize; 3]> = (0..counts[0] * counts[1])
            .map(|i| [i % counts[0], i / counts[0]])
            .filter_map(|[l, r]| Some([l, r, diagonal.checked_sub(l + r)?]))
            .filter(|b| b[2] < counts[2])
            .collect();
        blocks.par_iter().with_max_len(1).for_each(|at| {
            let mut region = Region { start: [0; 3], size };
            for a in 0..3 {
                let part = if forward[a] { at[a] } else { counts[a] - 1 - at[a] };
                region.start[along[a]] = swept.start[along[a]] + part * block[a];
                region.size[along[a]] = block[a].min(swept.size[along[a]] - part * block[a]);
            }
            if axes.layer == 0 {
                SCRATCH.with_borrow_mut(|scratch| region_along_x(axes, sweep, region, sigma, rho, scratch, false));
                return;
            }
            CONSTANT.with_borrow_mut(|constant| {
                if constant.0.len() < size[0] {
                    *constant = (vec![1.0; size[0]], vec![0.0; size[0]]);
                }
                self::block(axes, sweep, region, sigma, rho, constant)
            });
        });
    }
}

/// What is swept of a grid: all but a given plane.
fn swept(sweep: &Sweep) -> Region {
    let (mut start, mut size) = ([0; 3], sweep.size);
    if sweep.given {
        size[2] -= 1;
        start[2] = usize::from(sweep.ascending()[2]);
    }
    Region { start, size }
}

thread_local! {
    /// A row of ρ and of σ outside the grid.
    static CONSTANT: RefCell<(Vec<f32>, Vec<f32>)> = RefCell::default();
}

dispatch! {
    fn block(axes: &Axes, sweep: &Sweep, region: Region, sigma: &[f32], rho: Shared, outside: &(Vec<f32>, Vec<f32>)) = block_body;
}

/// A block whose columns are whole rows of memory, swept in place.
#[inline(always)]
fn block_body(axes: &Axes, sweep: &Sweep, region: Region, sigma: &[f32], rho: Shared, outside: &(Vec<f32>, Vec<f32>)) {
    let size = sweep.size;
    let stride = [1, size[0], size[0] * size[1]];
    let n = size[0];
    let (ones, zeros) = (&outside.0[..n], &outside.1[..n]);
    let weights = weights(axes);
    let half = -0.5 * sweep.length;
    let (forward, row_forward) = (axes.col_offset >= 0.0, axes.row_offset >= 0.0);
    // Rows of the layer before, written by this block or by blocks of earlier diagonals.
    let read = |at: usize| rho.read(at, n);
    // SAFETY: a row of this block, read and written by nobody else on this diagonal and not part of the layer before.
    let write = |at: usize| unsafe { rho.row(at, n) };
    for l in 0..region.size[axes.layer] {
        let layer = if axes.ascending { region.start[axes.layer] + l } else { region.end()[axes.layer] - 1 - l };
        let before =
            if axes.ascending { layer.checked_sub(1) } else { Some(layer + 1).filter(|&l| l < size[axes.layer]) };
        for row in region.start[axes.row]..region.end()[axes.row] {
            let base = layer * stride[axes.layer] + row * stride[axes.row];
            let out = write(base);
            let sigma_here = &sigma[base..base + n];
            let Some(before) = before else {
                first_line(sigma_here, half, out);
                continue;
            };
            let up = if row_forward { row.checked_sub(1) } else { Some(row + 1).filter(|&r| r < size[axes.row]) };
            let at = before * stride[axes.layer] + row * stride[axes.row];
            let (a, sa) = (read(at), &sigma[at..at + n]);
            let (c, sc) = up.map_or((ones, zeros), |up| {
                let at = before * stride[axes.layer] + up * stride[axes.row];
                (read(at), &sigma[at..at + n])
            });
            // The column upstream of the first one lies outside the grid.
            let (edge, inner, shifted) = if forward { (0, 1..n, 0..n - 1) } else { (n - 1, 0..n - 1, 1..n) };
            line(
                [&a[inner.clone()], &a[shifted.clone()], &c[inner.clone()], &c[shifted.clone()]],
                [&sa[inner.clone()], &sa[shifted.clone()], &sc[inner.clone()], &sc[shifted]],
                &sigma_here[inner.clone()],
                weights,
                half,
                &mut out[inner],
            );
            let e = edge..edge + 1;
            line(
                [&a[e.clone()], &ones[..1], &c[e.clone()], &ones[..1]],
                [&sa[e.clone()], &zeros[..1], &sc[e.clone()], &zeros[..1]],
                &sigma_here[e.clone()],
                weights,
                half,
                &mut out[e],
            );
        }
    }
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// A plane of a brick with its upstream halo, (rows + 1) × (columns + 1): row 0 is the upstream row, and the upstream column
/// stands first or last so that a row is copied in the order of memory.
#[derive(Clone, Copy)]
struct Local {
    rows: usize,
    cols: usize,
    pitch: usize,
    row_forward: bool,
    /// Where the plane's own columns begin, and where the upstream column is.
    body: usize,
    halo: usize,
    /// Grid column of the upstream column, where it exists.
    col_before: Option<usize>,
}

impl Local {
    fn new(axes: &Axes, size: [usize; 3], region: &Region) -> Self {
        let cols = region.size[axes.col];
        let forward = axes.col_offset >= 0.0;
        let start = region.start[axes.col];
        Local {
            rows: region.size[axes.row],
            cols,
            pitch: cols + 1,
            row_forward: axes.row_offset >= 0.0,
            body: usize::from(forward),
            halo: if forward { 0 } else { cols },
            col_before: if forward { start.checked_sub(1) } else { Some(start + cols).filter(|&c| c < size[axes.col]) },
        }
    }

    /// Grid index of a local row; `None` for an upstream row outside the grid.
    fn row_at(&self, axes: &Axes, size: [usize; 3], region: &Region, row: usize) -> Option<usize> {
        let start = region.start[axes.row];
        if self.row_forward {
            (start + row).checked_sub(1)
        } else {
            Some(start + self.rows - row).filter(|&r| r < size[axes.row])
        }
    }
}

dispatch! {
    fn brick(axes: &Axes, sweep: &Sweep, region: Region, sigma: &[f32], rho: Shared, scratch: &mut Scratch, compare: bool) -> f32 = brick_body;
}

/// Sweeps a brick whose columns run along x; returns the largest change on its downstream faces if `compare`, else 0.
#[inline(always)]
fn brick_body(
    axes: &Axes,
    sweep: &Sweep,
    region: Region,
    sigma: &[f32],
    rho: Shared,
    scratch: &mut Scratch,
    compare: bool,
) -> f32 {
    let size = sweep.size;
    let local = Local::new(axes, size, &region);
    let plane = (local.rows + 1) * local.pitch;
    scratch.fit(2 * plane);
    let (mut s_up, mut s_now) = scratch.sigma[..2 * plane].split_at_mut(plane);
    let (mut r_up, mut r_now) = scratch.rho[..2 * plane].split_at_mut(plane);
    let from_sigma = Shared::reading(sigma);
    let layers = region.size[axes.layer];
    let start = region.start[axes.layer];
    let layer_of = |l: usize| if axes.ascending { start + l } else { start + layers - 1 - l };
    let before =
        if axes.ascending { start.checked_sub(1) } else { Some(start + layers).filter(|&l| l < size[axes.layer]) };
    if let Some(layer) = before {
        gather(axes, size, &region, &local, layer, s_up, 0.0, true, from_sigma);
        gather(axes, size, &region, &local, layer, r_up, 1.0, true, rho);
    }
    let (weights, half) = (weights(axes), -0.5 * sweep.length);
    let (here, up, pitch, cols) = (local.body, 1 - local.body, local.pitch, local.cols);
    let mut change = 0.0f32;
    for l in 0..layers {
        gather(axes, size, &region, &local, layer_of(l), s_now, 0.0, true, from_sigma);
        gather(axes, size, &region, &local, layer_of(l), r_now, 1.0, false, rho);
        for row in 1..=local.rows {
            if l + 1 < layers {
                ask(axes, size, &region, &local, layer_of(l + 1), row, from_sigma);
                ask(axes, size, &region, &local, layer_of(l + 1), row, rho);
            }
            let at = row * pitch;
            let (out, sigma) = (&mut r_now[at + here..][..cols], &s_now[at + here..][..cols]);
            if l == 0 && before.is_none() {
                first_line(sigma, half, out);
                continue;
            }
            let feet = [at + here, at + up, at - pitch + here, at - pitch + up];
            line(feet.map(|i| &r_up[i..][..cols]), feet.map(|i| &s_up[i..][..cols]), sigma, weights, half, out);
        }
        change = change.max(scatter(axes, size, &region, &local, layer_of(l), r_now, rho, compare, l + 1 == layers));
        std::mem::swap(&mut s_up, &mut s_now);
        std::mem::swap(&mut r_up, &mut r_now);
    }
    change
}

/// Asks for a row of a layer of a brick.
#[inline(always)]
fn ask(axes: &Axes, size: [usize; 3], region: &Region, local: &Local, layer: usize, row: usize, values: Shared) {
    let stride = [1, size[0], size[0] * size[1]];
    if let Some(row) = local.row_at(axes, size, region, row) {
        let at = layer * stride[axes.layer] + row * stride[axes.row];
        (0..local.cols).step_by(LINE).for_each(|i| prefetch(values.at(at + region.start[axes.col] + i)));
        local.col_before.inspect(|c| prefetch(values.at(at + c)));
    }
}

/// Copies a layer of a brick and its halo out of a grid; `fill` stands outside the grid. With `inside` false only the halo.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn gather(
    axes: &Axes,
    size: [usize; 3],
    region: &Region,
    local: &Local,
    layer: usize,
    out: &mut [f32],
    fill: f32,
    inside: bool,
    from: Shared,
) {
    let stride = [1, size[0], size[0] * size[1]];
    for (row, out) in out.chunks_exact_mut(local.pitch).enumerate() {
        let Some(grid_row) = local.row_at(axes, size, region, row) else {
            out.fill(fill);
            continue;
        };
        let base = layer * stride[axes.layer] + grid_row * stride[axes.row];
        if inside || row == 0 {
            // SAFETY: σ, which nobody writes, or ρ of earlier fronts, which nobody writes now.
            let row = unsafe { from.row(base + region.start[axes.col], local.cols) };
            out[local.body..local.body + local.cols].copy_from_slice(row);
        }
        out[local.halo] = local.col_before.map_or(fill, |c| from.get(base + c));
    }
}

/// Writes a swept layer back; returns the largest change on the brick's downstream faces if `compare`, else 0: all of the last
/// layer, the last row, the last column.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn scatter(
    axes: &Axes,
    size: [usize; 3],
    region: &Region,
    local: &Local,
    layer: usize,
    plane: &[f32],
    rho: Shared,
    compare: bool,
    last: bool,
) -> f32 {
    let stride = [1, size[0], size[0] * size[1]];
    let last_col = if local.halo == 0 { local.cols - 1 } else { 0 };
    let mut change = 0.0f32;
    for row in 1..=local.rows {
        let Some(grid_row) = local.row_at(axes, size, region, row) else { continue };
        let new = &plane[row * local.pitch + local.body..][..local.cols];
        let base = layer * stride[axes.layer] + grid_row * stride[axes.row] + region.start[axes.col];
        // SAFETY: voxels of this brick, which no other thread reads or writes during this front.
        let old = unsafe { rho.row(base, local.cols) };
        if compare && (last || row == local.rows) {
            change = new.iter().zip(old.iter()).fold(change, |m, (n, o)| m.max((n - o).abs()));
        } else if compare {
            change = change.max((new[last_col] - old[last_col]).abs());
        }
        old.copy_from_slice(new);
    }
    change
}
