//! Direct light whose dominant axis is x. Memory runs along the layers, so nothing could be vectorised as it lies: a cache
//! line's worth of layers of one row of z is turned (layers first, columns along y), swept in the first-level cache, and turned
//! back. Of the upstream row only what it gives the feet of this one is kept, `w₂ρ + w₃ρ_beside` and the same of σ, and
//! replaced in passing by what this row gives the next.

use super::characteristic::{Axes, LINE, Scratch, first_line, weights};
use super::shared::Shared;
use super::simd::{dispatch, exp, prefetch, transpose};
use crate::device::Sweep;
use crate::grid::Region;

/// Layers of one row in cache: (layers + 1) × columns with the upstream column before or behind, the upstream layer first.
#[derive(Clone, Copy)]
struct Turned {
    cols: usize,
    pitch: usize,
    ascending: bool,
    /// Where the upstream column is; the row's own begin at [`LINE`].
    halo: usize,
    /// Grid index of the upstream layer and of the upstream column, where they exist.
    layer_before: Option<usize>,
    col_before: Option<usize>,
}

/// Layers that are turned together.
#[derive(Clone, Copy)]
struct Chunk {
    /// First layer along x, in the order of memory.
    start: usize,
    layers: usize,
    /// Layers of the region before these, in the order of travel.
    before: usize,
}

impl Turned {
    fn new(axes: &Axes, size: [usize; 3], region: &Region) -> Self {
        let cols = region.size[1];
        let forward = axes.col_offset >= 0.0;
        let before = |ascending: bool, axis: usize| {
            if ascending {
                region.start[axis].checked_sub(1)
            } else {
                Some(region.end()[axis]).filter(|&i| i < size[axis])
            }
        };
        Turned {
            cols,
            pitch: cols + 2 * LINE,
            ascending: axes.ascending,
            halo: if forward { LINE - 1 } else { LINE + cols },
            layer_before: before(axes.ascending, 0),
            col_before: before(forward, 1),
        }
    }

    /// Values of a chunk.
    fn len(&self) -> usize {
        (LINE + 1) * self.pitch
    }

    /// Turned layer of the `i`-th voxel of a chunk along x.
    fn layer_of(&self, chunk: Chunk, i: usize) -> usize {
        if self.ascending { i + 1 } else { chunk.layers - i }
    }

    /// From the turned layer of a voxel to that of the next along x.
    fn step(&self) -> isize {
        if self.ascending { self.pitch as isize } else { -(self.pitch as isize) }
    }

    /// The chunks of a region in the order of travel: cache lines, where rows of memory begin `phase` values into one.
    fn chunk(&self, region: &Region, phase: usize, before: usize) -> Option<Chunk> {
        let (start, end) = (region.start[0], region.end()[0]);
        if before == region.size[0] {
            return None;
        }
        let range = if self.ascending {
            let from = start + before;
            from..((from + phase) / LINE * LINE + LINE - phase).min(end)
        } else {
            let to = end - before;
            ((to + phase - 1) / LINE * LINE).saturating_sub(phase).max(start)..to
        };
        Some(Chunk { start: range.start, layers: range.len(), before })
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
    let Turned { pitch, cols, .. } = turned;
    let (feet, len) = (region.size[0] * cols, turned.len());
    scratch.fit(len + feet);
    let (s_now, s_feet) = scratch.sigma[..len + feet].split_at_mut(len);
    let (r_now, r_feet) = scratch.rho[..len + feet].split_at_mut(len);
    let from_sigma = Shared::reading(sigma);
    let phase = rho.at(0).addr() / size_of::<f32>() % LINE;
    let forward = axes.row_offset >= 0.0;
    let z_of = |row: usize| if forward { region.start[2] + row } else { region.end()[2] - 1 - row };
    let before = if forward { region.start[2].checked_sub(1) } else { Some(region.end()[2]).filter(|&z| z < size[2]) };
    let (weights, half) = (weights(axes), -0.5 * sweep.length);
    let beside = if turned.halo < LINE { LINE - 1 } else { LINE + 1 };
    match before {
        Some(z) => {
            let mut done = 0;
            while let Some(chunk) = turned.chunk(&region, phase, done) {
                gather(&turned, size, &region, chunk, z, s_now, 0.0, true, from_sigma);
                gather(&turned, size, &region, chunk, z, r_now, 1.0, true, rho);
                for l in 0..chunk.layers {
                    let (own, next) = (l * pitch + LINE, l * pitch + beside);
                    let at = (done + l) * cols;
                    lend(&s_now[own..][..cols], &s_now[next..][..cols], weights, &mut s_feet[at..][..cols]);
                    lend(&r_now[own..][..cols], &r_now[next..][..cols], weights, &mut r_feet[at..][..cols]);
                }
                done += chunk.layers;
                carry(&turned, chunk, s_now);
                carry(&turned, chunk, r_now);
            }
        }
        None => {
            s_feet.fill(0.0);
            r_feet.fill(weights[2] + weights[3]);
        }
    }
    let mut change = 0.0f32;
    for row in 0..region.size[2] {
        let z = z_of(row);
        let last = row + 1 == region.size[2];
        let mut done = 0;
        while let Some(chunk) = turned.chunk(&region, phase, done) {
            gather(&turned, size, &region, chunk, z, s_now, 0.0, true, from_sigma);
            gather(&turned, size, &region, chunk, z, r_now, 1.0, false, rho);
            for l in 1..=chunk.layers {
                let (at, foot) = (l * pitch, (l - 1) * pitch);
                let (upstream, rest) = r_now.split_at_mut(at);
                let (sigma, out) = (&s_now[at + LINE..][..cols], &mut rest[LINE..][..cols]);
                let layer = done + l - 1;
                if !last {
                    ask(size, &region, z_of(row + 1), layer, from_sigma);
                    ask(size, &region, z_of(row + 1), layer, rho);
                }
                if layer == 0 && turned.layer_before.is_none() {
                    first_line(sigma, half, out);
                    continue;
                }
                line(
                    [&upstream[foot + LINE..][..cols], &upstream[foot + beside..][..cols]],
                    [&s_now[foot + LINE..][..cols], &s_now[foot + beside..][..cols]],
                    &mut r_feet[layer * cols..][..cols],
                    &mut s_feet[layer * cols..][..cols],
                    sigma,
                    weights,
                    half,
                    out,
                );
            }
            let base = chunk.start + region.start[1] * size[0] + z * size[0] * size[1];
            if compare {
                let end = done + chunk.layers == region.size[0];
                change = change.max(difference(&turned, chunk, size, base, r_now, rho, last, end));
            }
            scatter(&turned, chunk, size, base, r_now, rho);
            done += chunk.layers;
            carry(&turned, chunk, s_now);
            carry(&turned, chunk, r_now);
        }
    }
    change
}

/// What a row gives the feet of the next: `w₂·own + w₃·beside`.
#[inline(always)]
fn lend(own: &[f32], beside: &[f32], w: [f32; 4], out: &mut [f32]) {
    let n = out.len();
    let (own, beside) = (&own[..n], &beside[..n]);
    for i in 0..n {
        out[i] = w[2] * own[i] + w[3] * beside[i];
    }
}

/// One row of a layer, in the order of [`super::characteristic::line`] so that its bits are the same; `rho_feet` and `sigma_feet` hold
/// what the upstream row gives and then what this one does.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn line(
    [a, b]: [&[f32]; 2],
    [sa, sb]: [&[f32]; 2],
    rho_feet: &mut [f32],
    sigma_feet: &mut [f32],
    sigma: &[f32],
    w: [f32; 4],
    half: f32,
    out: &mut [f32],
) {
    let n = out.len();
    let (a, b, sa, sb, sigma) = (&a[..n], &b[..n], &sa[..n], &sb[..n], &sigma[..n]);
    let (rho_feet, sigma_feet) = (&mut rho_feet[..n], &mut sigma_feet[..n]);
    for i in 0..n {
        let rho_foot = (w[0] * a[i] + w[1] * b[i]) + rho_feet[i];
        let sigma_foot = (w[0] * sa[i] + w[1] * sb[i]) + sigma_feet[i];
        rho_feet[i] = w[2] * a[i] + w[3] * b[i];
        sigma_feet[i] = w[2] * sa[i] + w[3] * sb[i];
        out[i] = rho_foot * exp(half * (sigma_foot + sigma[i]));
    }
}

/// Asks for a part of row `z`, one for each layer of a region, in the order of memory so that the hardware sees a stream. Asking for
/// σ and ρ one row ahead is worth a third of the time; asking in the order of the chunks, or writing past the caches, is not.
#[inline(always)]
fn ask(size: [usize; 3], region: &Region, z: usize, part: usize, values: Shared) {
    let ([x, y, _], [layers, cols, _]) = (region.start, region.size);
    let lines = layers.div_ceil(LINE);
    for line in part * cols * lines / layers..(part + 1) * cols * lines / layers {
        prefetch(values.at((z * size[1] + y + line / lines) * size[0] + x + line % lines * LINE));
    }
}

/// Makes the last layer of a chunk the upstream layer of the next.
#[inline(always)]
fn carry(turned: &Turned, chunk: Chunk, values: &mut [f32]) {
    let at = chunk.layers * turned.pitch;
    values.copy_within(at..at + turned.pitch, 0);
}

/// Turns a chunk of row `z` of a grid, with the upstream column and, for the first chunk, the upstream layer; `fill` stands
/// outside the grid. With `inside` false only these two are copied.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn gather(
    turned: &Turned,
    size: [usize; 3],
    region: &Region,
    chunk: Chunk,
    z: usize,
    out: &mut [f32],
    fill: f32,
    inside: bool,
    from: Shared,
) {
    let row = z * size[0] * size[1];
    let (x, y, pitch) = (chunk.start, region.start[1], turned.pitch);
    let column = |y: usize| row + y * size[0];
    if chunk.before == 0 {
        for c in 0..turned.cols {
            out[LINE + c] = turned.layer_before.map_or(fill, |x| from.get(column(y + c) + x));
        }
        out[turned.halo] = match (turned.col_before, turned.layer_before) {
            (Some(y), Some(x)) => from.get(column(y) + x),
            _ => fill,
        };
    }
    for i in 0..chunk.layers {
        out[turned.layer_of(chunk, i) * pitch + turned.halo] =
            turned.col_before.map_or(fill, |y| from.get(column(y) + x + i));
    }
    if !inside {
        return;
    }
    from.check(column(y + turned.cols - 1) + x, chunk.layers);
    let to = &mut out[LINE..][..chunk.layers * pitch + turned.cols];
    for c in (0..turned.cols).step_by(LINE) {
        let n = LINE.min(turned.cols - c);
        // SAFETY: the last address read was checked; `to` holds layers 1..=layers and `cols` columns.
        unsafe {
            let to = to.as_mut_ptr().add(turned.layer_of(chunk, 0) * pitch + c);
            transpose(from.at(column(y + c) + x), size[0] as isize, n, chunk.layers, to, turned.step());
        }
    }
}

/// Turns a chunk back into the grid at `base`.
#[inline(always)]
fn scatter(turned: &Turned, chunk: Chunk, size: [usize; 3], base: usize, values: &[f32], rho: Shared) {
    let (pitch, layers) = (turned.pitch, chunk.layers);
    let from = &values[LINE..][..layers * pitch + turned.cols];
    rho.check(base + (turned.cols - 1) * size[0], layers);
    for c in (0..turned.cols).step_by(LINE) {
        let n = LINE.min(turned.cols - c);
        // SAFETY: `from` holds layers 1..=layers; the last address written was checked, and the voxels are this region's.
        unsafe {
            let from = from.as_ptr().add(turned.layer_of(chunk, 0) * pitch + c);
            transpose(from, turned.step(), layers, n, rho.at(base + c * size[0]), size[0] as isize);
        }
    }
}

/// Largest difference between a chunk and the grid on the region's downstream faces: the last layer if the chunk is the `end` of
/// the region, the last column, and all of the last row.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn difference(
    turned: &Turned,
    chunk: Chunk,
    size: [usize; 3],
    base: usize,
    values: &[f32],
    rho: Shared,
    last: bool,
    end: bool,
) -> f32 {
    let last_col = if turned.halo < LINE { turned.cols - 1 } else { 0 };
    let last_x = if turned.ascending { chunk.layers - 1 } else { 0 };
    let mut change = 0.0f32;
    for c in 0..turned.cols {
        let mut one = |i: usize| {
            let new = values[turned.layer_of(chunk, i) * turned.pitch + LINE + c];
            change = change.max((new - rho.get(base + c * size[0] + i)).abs());
        };
        if last || c == last_col {
            (0..chunk.layers).for_each(&mut one);
        } else if end {
            one(last_x);
        }
    }
    change
}
