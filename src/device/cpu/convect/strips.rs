//! Layer by layer along the light (Zhang & Ma 2013, section 5.4), each layer in strips of rows: a strip iterates (16), all its
//! voxels at once, with the layer before and the strip upstream of it done. A task takes one band of strips through a block of
//! layers; tasks on a diagonal are independent.

use std::cell::RefCell;

use rayon::prelude::*;

use super::kept_row;
use crate::device::convection::{Convected, Convection, Layers, Rays, Start};
use crate::device::cpu::shared::Shared;
use crate::device::cpu::simd::dispatch;

/// Layers of a task: one cache line of values along x.
const BLOCK: usize = 16;

/// Where strips lie in memory, upstream first.
#[derive(Clone, Copy)]
struct Axes {
    /// Values along columns, rows and layers.
    size: [usize; 3],
    stride: [usize; 3],
    forward: [bool; 3],
    /// |d| along columns, rows, layers.
    way: [f32; 3],
}

impl Axes {
    fn new(convection: &Convection, way: [f32; 3]) -> Self {
        let axes = convection.axes();
        let [nx, ny, _] = convection.size;
        let stride = [1, nx, nx * ny];
        Axes {
            size: axes.map(|a| convection.size[a]),
            stride: axes.map(|a| stride[a]),
            forward: axes.map(|a| way[a] >= 0.0),
            way: axes.map(|a| way[a].abs()),
        }
    }

    /// Index in memory of column 0 of the row and layer that light reaches as number `row` and `layer`.
    fn at(&self, row: usize, layer: usize) -> usize {
        let index = |a: usize, n: usize| if self.forward[a] { n } else { self.size[a] - 1 - n };
        index(1, row) * self.stride[1] + index(2, layer) * self.stride[2]
    }
}

/// Working memory of a task: strips of `rows + 1` rows, the first being the row upstream, each padded by one value on both
/// sides for what enters along columns.
#[derive(Default)]
struct Strips {
    kept: Vec<f32>,
    layer_before: Vec<f32>,
    now: Vec<f32>,
    next: Vec<f32>,
    earlier: [Vec<f32>; 2],
    guess: Vec<f32>,
}

thread_local! {
    static STRIPS: RefCell<Strips> = RefCell::default();
}

/// Weights of (16) and where the neighbour along columns lies in a padded row.
struct Stencil {
    own: f32,
    column: f32,
    row: f32,
    layer: f32,
    side: usize,
}

/// reads σ, ρ of an earlier solve → writes ρ after the iterations that `pass` asks for.
pub(crate) fn convect(
    convection: &Convection,
    pass: Layers,
    sigma: &[f32],
    before: &[f32],
    rho: &mut [f32],
) -> Convected {
    let Rays::Parallel { way } = convection.rays else { panic!("layers are of parallel light") };
    let voxels: usize = convection.size.iter().product();
    assert!(sigma.len() >= voxels && rho.len() >= voxels && before.len() >= voxels, "buffers must hold the grid");
    let axes = Axes::new(convection, way);
    let [layers, bands] = convection.strips();
    let blocks = layers.div_ceil(BLOCK);
    let rho = Shared::new(rho);
    let mut errors = vec![0.0f32; layers * bands];
    let errors = Shared::new(&mut errors);
    let run = |band: usize, block: usize| {
        STRIPS.with_borrow_mut(|strips| {
            task(convection, &axes, pass, [band, block], sigma, [Shared::reading(before), rho], errors, strips)
        })
    };
    let together = |a: Convected, b: Convected| Convected {
        error: a.error.max(b.error),
        iterations: a.iterations.max(b.iterations),
        updates: a.updates + b.updates,
    };
    let mut all = Convected::default();
    for diagonal in 0..bands + blocks - 1 {
        let first = diagonal.saturating_sub(blocks - 1);
        let last = diagonal.min(bands - 1);
        let done = match last == first {
            true => run(first, diagonal - first),
            false => (first..last + 1)
                .into_par_iter()
                .with_max_len(1)
                .map(|band| run(band, diagonal - band))
                .reduce(Convected::default, together),
        };
        all = together(all, done);
    }
    all
}

dispatch! {
    fn task(convection: &Convection, axes: &Axes, pass: Layers, at: [usize; 2], sigma: &[f32], light: [Shared; 2], errors: Shared, strips: &mut Strips) -> Convected = task_body;
}

#[inline(always)]
fn task_body(
    convection: &Convection,
    axes: &Axes,
    Layers { iterations, tolerance, start }: Layers,
    [band, block]: [usize; 2],
    sigma: &[f32],
    [before, rho]: [Shared; 2],
    errors: Shared,
    strips: &mut Strips,
) -> Convected {
    let [columns, all_rows, layers] = axes.size;
    let bands = all_rows.div_ceil(Convection::STRIP);
    let first_row = band * Convection::STRIP;
    let rows = Convection::STRIP.min(all_rows - first_row);
    let width = columns + 2;
    let gain = convection.gain();
    let deepest = (layers + bands - 1) as f32;
    let Strips { kept, layer_before, now, next, earlier, guess } = strips;
    for buffer in [&mut *layer_before, now, next, guess].into_iter().chain(&mut *earlier) {
        buffer.clear();
        buffer.resize((rows + 1) * width, 1.0);
    }
    kept.resize(rows * columns, 0.0);
    let s = axes.way[0] + axes.way[1] + axes.way[2];
    let stencil = Stencil {
        own: 1.0 - 0.5 * s,
        column: 0.5 * axes.way[0],
        row: 0.5 * axes.way[1],
        layer: 0.5 * axes.way[2],
        side: if axes.forward[0] { 0 } else { 2 },
    };

    // Copies rows `from..rows` of a layer into a strip; row 0 of the strip is the row upstream of the band.
    let load = |values: Shared, layer: usize, from: usize, strip: &mut [f32]| {
        for r in from..=rows {
            let Some(row) = (first_row + r).checked_sub(1) else { continue };
            let into = &mut strip[r * width + 1..][..columns];
            read(values, axes.at(row, layer), axes.stride[0], into);
        }
    };
    let first_layer = block * BLOCK;
    if first_layer > 0 {
        load(rho, first_layer - 1, 1, layer_before);
    }
    let guesses = start == Start::Best;
    if guesses && first_layer > 0 {
        load(before, first_layer - 1, 0, &mut earlier[0]);
    }
    let mut done = Convected::default();
    for layer in first_layer..(first_layer + BLOCK).min(layers) {
        for r in 0..rows {
            let at = axes.at(first_row + r, layer);
            let out = &mut kept[r * columns..][..columns];
            if axes.stride[0] == 1 {
                kept_row(convection.opacity, s, &sigma[at..][..columns], out);
            } else {
                let gathered = &mut next[width + 1..][..columns];
                read(Shared::reading(sigma), at, axes.stride[0], gathered);
                kept_row(convection.opacity, s, gathered, out);
            }
        }
        // The row upstream, in both buffers of the iteration; outside the grid it is 1.
        if first_row > 0 {
            read(rho, axes.at(first_row - 1, layer), axes.stride[0], &mut now[1..][..columns]);
        } else {
            now[..width].fill(1.0);
        }
        next[..width].copy_from_slice(&now[..width]);
        let body = width..(rows + 1) * width;
        match start {
            Start::Zero => now[body].chunks_exact_mut(width).for_each(|r| r[1..=columns].fill(0.0)),
            Start::Upstream => now[body.clone()].copy_from_slice(&layer_before[body]),
            Start::Best => {
                load(before, layer, 0, &mut earlier[1]);
                let middle = rows / 2;
                // Rows `middle − 1` and `middle` of each guess, as the strip holds them.
                let part = middle * width..(middle + 2).min(rows + 1) * width;
                let r = (middle + 1).min(rows);
                let mut best = (f32::INFINITY, 0);
                for number in 0..3 {
                    fill_guess(number, part.clone(), layer_before, earlier, guess);
                    if middle == 0 {
                        guess[..width].copy_from_slice(&now[..width]);
                    }
                    let residual = relax_row(
                        &stencil,
                        &kept[(r - 1) * columns..][..columns],
                        &guess[(r - 1) * width..][..2 * width],
                        &layer_before[r * width + 1..][..columns],
                        &mut next[r * width..][..width],
                    );
                    done.updates += columns as u64;
                    if residual < best.0 {
                        best = (residual, number);
                    }
                }
                fill_guess(best.1, body.clone(), layer_before, earlier, guess);
                now[body.clone()].copy_from_slice(&guess[body]);
                earlier.swap(0, 1);
            }
        }

        let error_at = |band: usize, layer: usize| errors.get(layer * bands + band);
        let mut upstream = 0.0f32;
        if band > 0 {
            upstream = upstream.max(error_at(band - 1, layer));
        }
        if layer > 0 {
            upstream = upstream.max(error_at(band, layer - 1));
        }
        let share = tolerance * (layer + band + 1) as f32 / deepest;
        let mut taken = 0;
        let mut change = f32::INFINITY;
        while taken < iterations && (taken == 0 || upstream + gain * change > share) {
            change = 0.0;
            for r in 1..=rows {
                let row = relax_row(
                    &stencil,
                    &kept[(r - 1) * columns..][..columns],
                    &now[(r - 1) * width..][..2 * width],
                    &layer_before[r * width + 1..][..columns],
                    &mut next[r * width..][..width],
                );
                change = if row > change { row } else { change };
            }
            std::mem::swap(now, next);
            taken += 1;
        }
        for r in 1..=rows {
            write(&now[r * width + 1..][..columns], rho, axes.at(first_row + r - 1, layer), axes.stride[0]);
        }
        std::mem::swap(now, layer_before);
        let error = upstream + gain * change;
        // SAFETY: this task alone writes this strip's error.
        unsafe { errors.row(layer * bands + band, 1)[0] = error };
        done.error = done.error.max(error);
        done.iterations = done.iterations.max(taken);
        done.updates += u64::from(taken) * (rows * columns) as u64;
    }
    done
}

/// Guess `number` of a part of a strip: the layer before, the earlier light of this layer, or that moved by the change of the
/// layer before.
#[inline(always)]
fn fill_guess(
    number: u32,
    part: std::ops::Range<usize>,
    layer_before: &[f32],
    [then_before, then]: &[Vec<f32>; 2],
    out: &mut [f32],
) {
    let out = &mut out[part.clone()];
    let (before, then_before, then) = (&layer_before[part.clone()], &then_before[part.clone()], &then[part]);
    match number {
        0 => out.copy_from_slice(before),
        1 => out.copy_from_slice(then),
        _ => {
            for l in 0..out.len() {
                out[l] = (then[l] + (before[l] - then_before[l])).clamp(0.0, 1.0);
            }
        }
    }
}

/// One row of (16). `rows` holds the row upstream and the row itself, padded; returns the largest change.
#[inline(always)]
fn relax_row(stencil: &Stencil, kept: &[f32], rows: &[f32], before: &[f32], out: &mut [f32]) -> f32 {
    let Stencil { own, column, row, layer, side } = *stencil;
    let width = out.len();
    let n = width - 2;
    let (upstream, here) = rows.split_at(width);
    let beside = &here[side..][..n];
    let (upstream, here, out) = (&upstream[1..][..n], &here[1..][..n], &mut out[1..][..n]);
    let (kept, before) = (&kept[..n], &before[..n]);
    let mut most = [0.0f32; 16];
    let one = |l: usize| kept[l] * (own * here[l] + column * beside[l] + (row * upstream[l] + layer * before[l]));
    let whole = n / 16 * 16;
    for start in (0..whole).step_by(16) {
        for lane in 0..16 {
            let value = one(start + lane);
            let change = (value - here[start + lane]).abs();
            most[lane] = if change > most[lane] { change } else { most[lane] };
            out[start + lane] = value;
        }
    }
    for l in whole..n {
        let value = one(l);
        most[0] = most[0].max((value - here[l]).abs());
        out[l] = value;
    }
    most.into_iter().fold(0.0, f32::max)
}

/// Reads a row of columns.
#[inline(always)]
fn read(values: Shared, at: usize, stride: usize, out: &mut [f32]) {
    if stride == 1 {
        out.copy_from_slice(values.read(at, out.len()));
    } else {
        for (n, out) in out.iter_mut().enumerate() {
            *out = values.get(at + n * stride);
        }
    }
}

/// Writes a row of columns.
#[inline(always)]
fn write(row: &[f32], values: Shared, at: usize, stride: usize) {
    if stride == 1 {
        // SAFETY: a row of this task, which nobody else reads or writes on this diagonal.
        unsafe { values.row(at, row.len()) }.copy_from_slice(row);
    } else {
        for (n, value) in row.iter().enumerate() {
            // SAFETY: as above.
            unsafe { values.row(at + n * stride, 1)[0] = *value };
        }
    }
}
