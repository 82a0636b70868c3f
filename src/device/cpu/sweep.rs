//! Direct light by short characteristics (light.md; Zhang & Ma 2013 solve the same problem by upwind convection, eq. 16):
//!
//! `ρ(x) = ρ(foot) · exp(−½(σ(foot) + σ(x))·Δs)`
//!
//! The foot of a voxel lies in the previous layer perpendicular to the dominant axis, at lateral offset −u_b/|u_a|. A brick
//! and its upstream halo are gathered into cache with the layers first and in the order of travel, swept there, and the
//! result written back; gathering turns x-dominant light into contiguous rows too.

use rayon::prelude::*;
use std::cell::RefCell;

use super::simd::{dispatch, exp, prefetch, transpose};
use crate::device::Sweep;
use crate::grid::{BrickLayout, Region};

/// Values in a cache line.
const LINE: usize = 16;

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
    fn new(sweep: &Sweep) -> Self {
        let layer = sweep.axis();
        let (row, col) = [(2, 1), (2, 0), (1, 0)][layer];
        let d = sweep.direction;
        let per_layer = |a: usize| (d[a] / d[layer].abs()).clamp(-1.0, 1.0);
        Axes { layer, row, col, ascending: d[layer] >= 0.0, row_offset: per_layer(row), col_offset: per_layer(col) }
    }
}

/// Values shared between threads that write disjoint parts of them.
#[derive(Clone, Copy)]
pub(super) struct Shared(*mut f32, usize);
// SAFETY: only `row` gives access, and its callers vouch that nobody else writes those values.
unsafe impl Send for Shared {}
// SAFETY: as above.
unsafe impl Sync for Shared {}

impl Shared {
    pub(super) fn new(values: &mut [f32]) -> Self {
        Shared(values.as_mut_ptr(), values.len())
    }

    /// `n` values from `at` on.
    ///
    /// # Safety
    /// No other thread reads or writes them while the slice lives, and no other slice of them lives in this thread.
    #[inline(always)]
    #[allow(clippy::mut_from_ref)]
    pub(super) unsafe fn row<'a>(self, at: usize, n: usize) -> &'a mut [f32] {
        self.check(at, n);
        // SAFETY: in bounds; the caller vouches for the rest.
        unsafe { std::slice::from_raw_parts_mut(self.0.add(at), n) }
    }

    /// Panics unless `n` values from `at` on exist.
    #[inline(always)]
    pub(super) fn check(self, at: usize, n: usize) {
        assert!(at + n <= self.1, "a row beyond the grid");
    }

    /// Address of a value.
    #[inline(always)]
    pub(super) fn at(self, at: usize) -> *mut f32 {
        self.0.wrapping_add(at)
    }
}

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
        super::sweep_cubic::sweep(&axes, sweep, sigma, shared);
        return vec![f32::INFINITY; listed];
    }
    if listed == layout.len() {
        whole(&axes, sweep, sigma, shared);
        return vec![f32::INFINITY; listed];
    }
    let mut changes = Vec::with_capacity(listed);
    for front in fronts {
        let one = |&b: &u32| {
            SCRATCH
                .with_borrow_mut(|scratch| brick(&axes, sweep, layout.region(b as usize), sigma, shared, scratch, true))
        };
        if front.len() == 1 {
            changes.push(one(&front[0]));
        } else {
            changes.par_extend(front.par_iter().with_max_len(1).map(one));
        }
    }
    changes
}

/// The whole grid, when nothing is to be skipped: blocks as long as the grid's columns, so that memory is read in long rows.
/// Bit for bit what the bricks give. Blocks on a diagonal of (layer, row) are independent.
fn whole(axes: &Axes, sweep: &Sweep, sigma: &[f32], rho: Shared) {
    // Along x the block is transposed in cache: fewer rows of it fit.
    let (depth, breadth) = if axes.layer == 0 { (32, 8) } else { (32, 16) };
    let size = sweep.size;
    let (layers, rows) = (size[axes.layer].div_ceil(depth), size[axes.row].div_ceil(breadth));
    for diagonal in 0..layers + rows - 1 {
        let first = diagonal.saturating_sub(rows - 1);
        (first..layers.min(diagonal + 1)).into_par_iter().with_max_len(1).for_each(|l| {
            let r = diagonal - l;
            let mut region = Region { start: [0; 3], size };
            let mut cut = |axis: usize, n: usize, count: usize, part: usize, ascending: bool| {
                let part = if ascending { part } else { count - 1 - part };
                region.start[axis] = part * n;
                region.size[axis] = n.min(size[axis] - part * n);
            };
            cut(axes.layer, depth, layers, l, axes.ascending);
            cut(axes.row, breadth, rows, r, axes.row_offset >= 0.0);
            if axes.layer == 0 {
                SCRATCH.with_borrow_mut(|scratch| brick(axes, sweep, region, sigma, rho, scratch, false));
            } else {
                CONSTANT.with_borrow_mut(|constant| {
                    if constant.0.len() < size[0] {
                        *constant = (vec![1.0; size[0]], vec![0.0; size[0]]);
                    }
                    block(axes, sweep, region, sigma, rho, constant)
                });
            }
        });
    }
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
    // SAFETY: rows of the layer before, written by this block or by blocks of earlier diagonals.
    let read = |at: usize| unsafe {
        debug_assert!(at + n <= rho.1);
        std::slice::from_raw_parts(rho.0.add(at), n)
    };
    // SAFETY: a row of this block, read and written by nobody else on this diagonal and not part of the layer before.
    let write = |at: usize| unsafe {
        debug_assert!(at + n <= rho.1);
        std::slice::from_raw_parts_mut(rho.0.add(at), n)
    };
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

/// Bilinear weights of the foot: own row and column, upstream column, upstream row, both.
#[inline(always)]
fn weights(axes: &Axes) -> [f32; 4] {
    let (r, c) = (axes.row_offset.abs(), axes.col_offset.abs());
    [(1.0 - r) * (1.0 - c), (1.0 - r) * c, r * (1.0 - c), r * c]
}

/// The first layer: half a voxel inside the box.
#[inline(always)]
fn first_line(sigma: &[f32], half: f32, out: &mut [f32]) {
    out.iter_mut().zip(sigma).for_each(|(o, s)| *o = exp(half * s));
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
        let (start, l) = (r.start[axes.layer] as isize, l as isize);
        if axes.ascending { start + l - 1 } else { start + self.layers as isize - l }
    }
    fn row_at(&self, r: &Region, axes: &Axes, row: usize) -> isize {
        let (start, row) = (r.start[axes.row] as isize, row as isize);
        if self.row_forward { start + row - 1 } else { start + self.rows as isize - row }
    }
    /// Local layer of the brick's `i`-th voxel along the layer axis.
    fn layer_of(&self, axes: &Axes, i: usize) -> usize {
        if axes.ascending { i + 1 } else { self.layers - i }
    }
}

dispatch! {
    fn brick(axes: &Axes, sweep: &Sweep, region: Region, sigma: &[f32], rho: Shared, scratch: &mut Scratch, compare: bool) -> f32 = brick_body;
}

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
    let sigma = Shared(sigma.as_ptr().cast_mut(), sigma.len());
    gather(axes, sweep.size, &region, &local, s, 0.0, true, sigma);
    gather(axes, sweep.size, &region, &local, r, 1.0, false, rho);

    let first = local.layer_at(&region, axes, 0);
    let outside = first < 0 || first as usize >= sweep.size[axes.layer];
    march_layers(axes, sweep.length, &local, outside, s, r);
    scatter(axes, sweep.size, &region, &local, r, rho, compare)
}

/// Copies a brick and its halo out of a grid; `fill` stands outside the grid. With `inside` false only the halo is copied.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn gather(
    axes: &Axes,
    size: [usize; 3],
    region: &Region,
    local: &Local,
    out: &mut [f32],
    fill: f32,
    inside: bool,
    from: Shared,
) {
    let stride = [1, size[0], size[0] * size[1]];
    // SAFETY: σ, which nobody writes, or the halo of ρ, which belongs to earlier fronts and is written by nobody now.
    let read = |at: usize, n: usize| unsafe {
        debug_assert!(at + n <= from.1);
        std::slice::from_raw_parts(from.0.cast_const().add(at), n)
    };
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
                let ahead = on_grid(local.layer_at(region, axes, l + 1), size[axes.layer]);
                if let Some((layer, row)) = ahead.zip(on_grid(local.row_at(region, axes, row), size[axes.row])) {
                    let at = layer * stride[axes.layer] + row * stride[axes.row] + col_start;
                    (0..local.cols).step_by(LINE).for_each(|i| prefetch(from.0, at + i));
                    halo_col.inspect(|c| prefetch(from.0, at - col_start + c));
                }
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
        if let Some(z) = on_grid(local.row_at(region, axes, row + 1), size[2]) {
            for y in col_start..col_start + local.cols {
                let at = z * stride[2] + y * stride[1] + x_start;
                (0..local.layers).step_by(LINE).for_each(|i| prefetch(from.0, at + i));
            }
        }
        let out = &mut out[row * pitch..];
        // The upstream layer, and the upstream column with all its layers.
        for c in 0..local.cols {
            out[body + c] = halo_x.map_or(fill, |x| read(z * stride[2] + (col_start + c) * stride[1] + x, 1)[0]);
        }
        match halo_col {
            None => (0..=local.layers).for_each(|l| out[l * plane + halo_slot] = fill),
            Some(y) => {
                let base = z * stride[2] + y * stride[1];
                out[halo_slot] = halo_x.map_or(fill, |x| read(base + x, 1)[0]);
                for (i, &v) in read(base + x_start, local.layers).iter().enumerate() {
                    out[local.layer_of(axes, i) * plane + halo_slot] = v;
                }
            }
        }
        if inside || row == 0 {
            let base = z * stride[2] + col_start * stride[1] + x_start;
            let to = &mut out[body..(local.layers) * plane + body + local.cols];
            let first = local.layer_of(axes, 0) * plane;
            let step = if axes.ascending { plane as isize } else { -(plane as isize) };
            assert!(base + (local.cols - 1) * stride[1] + local.layers <= from.1);
            // SAFETY: `to` holds layers 1..=layers of this row, `first` and `step` stay within; `from` was checked.
            unsafe {
                let to = to.as_mut_ptr().add(first);
                transpose(from.0.add(base), stride[1] as isize, local.cols, local.layers, to, step);
            }
        }
    }
}

/// The equation itself, over a gathered brick.
#[inline(always)]
fn march_layers(axes: &Axes, length: f32, local: &Local, outside: bool, s: &[f32], r: &mut [f32]) {
    let (pitch, plane, cols) = (local.pitch(), local.plane(), local.cols);
    let weights = weights(axes);
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
                first_line(sigma, half, out);
                continue;
            }
            line(
                [at + here, at + up, at - pitch + here, at - pitch + up].map(|i| &before[i..][..cols]),
                [at + here, at + up, at - pitch + here, at - pitch + up].map(|i| &s_before[i..][..cols]),
                sigma,
                weights,
                half,
                out,
            );
        }
    }
}

/// One row of a layer. A function of its own, so that the compiler knows that nothing overlaps.
#[inline(always)]
fn line(rho: [&[f32]; 4], sigma_up: [&[f32]; 4], sigma: &[f32], w: [f32; 4], half: f32, out: &mut [f32]) {
    let n = out.len();
    let ([a, b, c, d], [sa, sb, sc, sd]) = (rho.map(|v| &v[..n]), sigma_up.map(|v| &v[..n]));
    let sigma = &sigma[..n];
    for i in 0..n {
        let rho_foot = (w[0] * a[i] + w[1] * b[i]) + (w[2] * c[i] + w[3] * d[i]);
        let sigma_foot = (w[0] * sa[i] + w[1] * sb[i]) + (w[2] * sc[i] + w[3] * sd[i]);
        out[i] = rho_foot * exp(half * (sigma_foot + sigma[i]));
    }
}

/// Writes a swept brick back; returns the largest change on its downstream faces.
#[inline(always)]
fn scatter(
    axes: &Axes,
    size: [usize; 3],
    region: &Region,
    local: &Local,
    r: &[f32],
    rho: Shared,
    compare: bool,
) -> f32 {
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
        if compare {
            for c in 0..local.cols {
                let old = own(z * stride[2] + (y_start + c) * stride[1] + x_start, local.layers);
                if row == local.rows || c == last_col {
                    for (i, o) in old.iter().enumerate() {
                        change = change.max((r[local.layer_of(axes, i) * plane + c] - o).abs());
                    }
                } else {
                    change = change.max((r[local.layers * plane + c] - old[last_x]).abs());
                }
            }
        }
        let base = z * stride[2] + y_start * stride[1] + x_start;
        let step = if axes.ascending { plane as isize } else { -(plane as isize) };
        assert!(base + (local.cols - 1) * stride[1] + local.layers <= rho.1);
        let from = &r[..local.layers * plane + local.cols];
        // SAFETY: `from` holds all layers of this row; the rows written are this brick's own, as `own` says.
        unsafe {
            let from = from.as_ptr().add(local.layer_of(axes, 0) * plane);
            transpose(from, step, local.layers, local.cols, rho.0.add(base), stride[1] as isize);
        }
    }
    change
}
