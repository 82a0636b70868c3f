//! Direct light whose dominant axis is x. Memory runs along the layers, so nothing could be vectorised as it lies: a row of z is
//! turned in cache (layers first, columns along y), swept, and turned back, while memory is read and written in long
//! runs. A row needs only itself and the upstream row, so two of each are kept.

use super::simd::{dispatch, prefetch, publish, transpose};
use super::sweep::{Axes, LINE, Scratch, Shared, first_line, line, weights};
use crate::device::Sweep;
use crate::grid::Region;

/// A turned row: (layers + 1) × (columns + 1), the upstream layer first, the upstream column first or last.
#[derive(Clone, Copy)]
struct Turned {
    layers: usize,
    cols: usize,
    pitch: usize,
    ascending: bool,
    /// Where the row's own columns begin, and where the upstream column is.
    body: usize,
    halo: usize,
    /// Grid index of the upstream layer and of the upstream column, where they exist.
    layer_before: Option<usize>,
    col_before: Option<usize>,
}

impl Turned {
    fn new(axes: &Axes, size: [usize; 3], region: &Region) -> Self {
        let (layers, cols) = (region.size[0], region.size[1]);
        let forward = axes.col_offset >= 0.0;
        let before = |ascending: bool, axis: usize| {
            if ascending {
                region.start[axis].checked_sub(1)
            } else {
                Some(region.end()[axis]).filter(|&i| i < size[axis])
            }
        };
        Turned {
            layers,
            cols,
            pitch: cols + 1,
            ascending: axes.ascending,
            body: usize::from(forward),
            halo: if forward { 0 } else { cols },
            layer_before: before(axes.ascending, 0),
            col_before: before(forward, 1),
        }
    }

    /// Turned layer of the region's `i`-th voxel along x.
    fn layer_of(&self, i: usize) -> usize {
        if self.ascending { i + 1 } else { self.layers - i }
    }

    fn step(&self) -> isize {
        if self.ascending { self.pitch as isize } else { -(self.pitch as isize) }
    }
}

dispatch! {
    /// reads σ, ρ upstream → writes ρ of a region; returns the largest change on its downstream faces if `compare`, else 0.
    pub(super) fn region_along_x(axes: &Axes, sweep: &Sweep, region: Region, sigma: &[f32], rho: Shared, scratch: &mut Scratch, compare: bool) -> f32 = region_body;
}

#[inline(always)]
fn region_body(
    axes: &Axes,
    sweep: &Sweep,
    region: Region,
    sigma: &[f32],
    rho: Shared,
    scratch: &mut Scratch,
    compare: bool,
) -> f32 {
    let size = sweep.size;
    let turned = Turned::new(axes, size, &region);
    let len = (turned.layers + 1) * turned.pitch;
    scratch.fit(2 * len);
    let (mut s_up, mut s_now) = scratch.sigma[..2 * len].split_at_mut(len);
    let (mut r_up, mut r_now) = scratch.rho[..2 * len].split_at_mut(len);
    let sigma = Shared::reading(sigma);
    let forward = axes.row_offset >= 0.0;
    let z_of = |row: usize| if forward { region.start[2] + row } else { region.end()[2] - 1 - row };
    let before = if forward { region.start[2].checked_sub(1) } else { Some(region.end()[2]).filter(|&z| z < size[2]) };
    match before {
        Some(z) => {
            gather(&turned, size, &region, z, Some(z_of(0)), s_up, 0.0, true, sigma);
            gather(&turned, size, &region, z, None, r_up, 1.0, true, rho);
        }
        None => {
            s_up.fill(0.0);
            r_up.fill(1.0);
        }
    }
    let (weights, half) = (weights(axes), -0.5 * sweep.length);
    let (here, up, pitch, cols) = (turned.body, 1 - turned.body, turned.pitch, turned.cols);
    let mut change = 0.0f32;
    for row in 0..region.size[2] {
        let last = row + 1 == region.size[2];
        let ahead = (!last).then(|| z_of(row + 1));
        gather(&turned, size, &region, z_of(row), ahead, s_now, 0.0, true, sigma);
        gather(&turned, size, &region, z_of(row), None, r_now, 1.0, false, rho);
        for l in 1..=turned.layers {
            let at = l * pitch;
            let sigma = &s_now[at + here..][..cols];
            let (done, rest) = r_now.split_at_mut(at);
            let out = &mut rest[here..][..cols];
            if l == 1 && turned.layer_before.is_none() {
                first_line(sigma, half, out);
                continue;
            }
            let at = at - pitch;
            line(
                [
                    &done[at + here..][..cols],
                    &done[at + up..][..cols],
                    &r_up[at + here..][..cols],
                    &r_up[at + up..][..cols],
                ],
                [
                    &s_now[at + here..][..cols],
                    &s_now[at + up..][..cols],
                    &s_up[at + here..][..cols],
                    &s_up[at + up..][..cols],
                ],
                sigma,
                weights,
                half,
                out,
            );
        }
        let base = region.start[0] + region.start[1] * size[0] + z_of(row) * size[0] * size[1];
        if compare {
            change = change.max(difference(&turned, size, base, r_now, rho, last));
        }
        let below = ahead.map(|z| region.start[0] + region.start[1] * size[0] + z * size[0] * size[1]);
        scatter(&turned, size, base, below.filter(|_| compare), r_now, rho);
        std::mem::swap(&mut s_up, &mut s_now);
        std::mem::swap(&mut r_up, &mut r_now);
    }
    publish();
    change
}

/// Turns row `z` of a grid, with the upstream layer and column; `fill` stands outside the grid. With `inside` false only these
/// two are copied. Asks for the same part of row `ahead` meanwhile.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn gather(
    turned: &Turned,
    size: [usize; 3],
    region: &Region,
    z: usize,
    ahead: Option<usize>,
    out: &mut [f32],
    fill: f32,
    inside: bool,
    from: Shared,
) {
    let row = z * size[0] * size[1];
    let (x, y, pitch) = (region.start[0], region.start[1], turned.pitch);
    let column = |y: usize| row + y * size[0];
    for c in 0..turned.cols {
        out[turned.body + c] = turned.layer_before.map_or(fill, |x| from.get(column(y + c) + x));
    }
    match turned.col_before {
        None => (0..=turned.layers).for_each(|l| out[l * pitch + turned.halo] = fill),
        Some(y) => {
            out[turned.halo] = turned.layer_before.map_or(fill, |x| from.get(column(y) + x));
            for i in 0..turned.layers {
                out[turned.layer_of(i) * pitch + turned.halo] = from.get(column(y) + x + i);
            }
        }
    }
    if !inside {
        return;
    }
    from.check(column(y + turned.cols - 1) + x, turned.layers);
    let to = &mut out[turned.body..turned.layers * pitch + turned.body + turned.cols];
    for c in (0..turned.cols).step_by(4) {
        let n = 4.min(turned.cols - c);
        if let Some(ahead) = ahead {
            ask(from, ahead * size[0] * size[1] + (y + c) * size[0] + x, n, size[0], turned.layers);
        }
        // SAFETY: the last address read was checked; `to` holds layers 1..=layers and `cols` columns.
        unsafe {
            let to = to.as_mut_ptr().add(turned.layer_of(0) * pitch + c);
            transpose(from.at(column(y + c) + x), size[0] as isize, n, turned.layers, to, turned.step(), false);
        }
    }
}

/// Turns a row back into the grid at `base`, and asks for the part of the grid at `ahead`; without one, it writes past the caches.
#[inline(always)]
fn scatter(turned: &Turned, size: [usize; 3], base: usize, ahead: Option<usize>, row: &[f32], rho: Shared) {
    let (pitch, layers) = (turned.pitch, turned.layers);
    let from = &row[turned.body..layers * pitch + turned.body + turned.cols];
    rho.check(base + (turned.cols - 1) * size[0], layers);
    for c in (0..turned.cols).step_by(4) {
        let n = 4.min(turned.cols - c);
        if let Some(ahead) = ahead {
            ask(rho, ahead + c * size[0], n, size[0], layers);
        }
        // SAFETY: `from` holds layers 1..=layers; the last address written was checked, and the voxels are this region's.
        unsafe {
            let from = from.as_ptr().add(turned.layer_of(0) * pitch + c);
            transpose(from, turned.step(), layers, n, rho.at(base + c * size[0]), size[0] as isize, ahead.is_none());
        }
    }
}

/// Largest difference between a turned row and the grid on the region's downstream faces: the last layer, the last column, and
/// all of the last row.
#[inline(always)]
fn difference(turned: &Turned, size: [usize; 3], base: usize, row: &[f32], rho: Shared, last: bool) -> f32 {
    let last_col = if turned.halo == 0 { turned.cols - 1 } else { 0 };
    let last_x = if turned.ascending { turned.layers - 1 } else { 0 };
    let mut change = 0.0f32;
    for c in 0..turned.cols {
        let mut one = |i: usize| {
            let new = row[turned.layer_of(i) * turned.pitch + turned.body + c];
            change = change.max((new - rho.get(base + c * size[0] + i)).abs());
        };
        if last || c == last_col {
            (0..turned.layers).for_each(&mut one);
        } else {
            one(last_x);
        }
    }
    change
}

/// Asks for `n` rows of `len` values, a stride apart.
#[inline(always)]
fn ask(values: Shared, at: usize, n: usize, stride: usize, len: usize) {
    for row in 0..n {
        (0..len).step_by(LINE).for_each(|i| prefetch(values.at(at + row * stride + i)));
    }
}
