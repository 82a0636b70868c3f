//! Transport along discrete ordinates (light.md, first-collision-source ordinates; short characteristics with a source
//! function linear along the step, Kunasz & Auer 1988, eq. 7–9):
//!
//! `I = I_up + (1 − e^−τ)(S_up − I_up) + w₀(S − S_up)`, `w₀ = 1 − (1 − e^−τ)/τ`, `τ = ½(σ_up + σ)Δs`,
//!
//! which is `I_up e^−τ + w₀ S + w₁ S_up` written so that a constant radiance stays constant to the bit. Outside the grid
//! σ = 0 and I = S = the inflow.
//!
//! Ordinates that share dominant axis and direction of travel form a batch: σ and S are read once for all of them, and φ is
//! updated once. Only the layer before is kept of I. A thread works on a band of rows for a block of layers and computes
//! the rows beside its band that it needs again, so one join serves many layers and the result does not depend on the
//! number of threads. Layers perpendicular to x are transposed on the way in and out, a cache line of x at a time.

use std::ops::Range;

use rayon::prelude::*;

use super::host;
use super::simd::dispatch;
use aligned::Aligned;

use crate::device::{Ordinate, Sweep, Transport};
use crate::grid::Grid;

mod aligned;
mod band;
mod rows;
mod turn;

/// Layers between joins: one cache line of values along x.
const BLOCK: usize = 16;

/// Values that are worked on together; rows in working memory are padded to a multiple of them.
const WIDTH: usize = 16;

/// Ordinates of a batch at most: their layers and those of σ and S should stay in a second-level cache.
const LANES: usize = 8;

/// Memory that outlives a pass, so that passes do not allocate.
#[derive(Default)]
pub(super) struct Kept {
    sum: Vec<f32>,
    entry: Aligned,
    exit: Aligned,
}

/// One ordinate as its batch needs it. Across columns its feet lie towards the column before (`ascending`) or the next.
struct Lane {
    weight: f32,
    inflow: f32,
    omega: [f32; 3],
    ascending: bool,
    foot: usize,
}

/// Where feet lie, as far as lanes have it in common: in the layer before, at `t_row` of the way to row `row + step_row` and
/// at `t_col` of the way to a neighbouring column.
#[derive(PartialEq)]
struct Foot {
    step_row: isize,
    t_row: f32,
    t_col: f32,
    /// Half the world length between layers.
    half: f32,
    inflow: f32,
}

/// Ordinates of the same dominant axis and direction of travel along it.
struct Batch {
    axis: usize,
    ascending: bool,
    lanes: Vec<Lane>,
    feet: Vec<Foot>,
}

/// Row and column axes of layers perpendicular to `axis`; columns are contiguous in memory, except for x.
fn lateral(axis: usize) -> (usize, usize) {
    [(2, 1), (2, 0), (1, 0)][axis]
}

fn batches(grid: &Grid, ordinates: &[Ordinate]) -> Vec<Batch> {
    let mut all: Vec<Batch> = Vec::new();
    for key in 0..6 {
        let (axis, ascending) = (key / 2, key % 2 == 0);
        let (row, col) = lateral(axis);
        let mut open: Option<Batch> = None;
        for o in ordinates {
            let sweep = Sweep::new(grid, o.direction, false);
            let d = sweep.direction;
            if sweep.axis() != axis || (d[axis] >= 0.0) != ascending {
                continue;
            }
            let batch = open.get_or_insert_with(|| Batch { axis, ascending, lanes: vec![], feet: vec![] });
            let offset = |a: usize| (d[a] / d[axis]).abs().min(1.0);
            let foot = Foot {
                step_row: if d[row] >= 0.0 { -1 } else { 1 },
                t_row: offset(row),
                t_col: offset(col),
                half: 0.5 * sweep.length,
                inflow: o.inflow,
            };
            let foot = batch.feet.iter().position(|f| *f == foot).unwrap_or_else(|| {
                batch.feet.push(foot);
                batch.feet.len() - 1
            });
            batch.lanes.push(Lane {
                weight: o.weight,
                inflow: o.inflow,
                omega: o.direction.to_array(),
                ascending: d[col] >= 0.0,
                foot,
            });
            if batch.lanes.len() == LANES {
                all.extend(open.take());
            }
        }
        all.extend(open);
    }
    all
}

/// What every band of a batch reads.
struct Job<'a> {
    batch: &'a Batch,
    size: [usize; 3],
    /// σ, S and, where scattering is anisotropic, the three components of the gradient of S.
    fields: &'a [&'a [f32]],
    /// Layers of this block, counted in the order of travel.
    layers: Range<usize>,
    /// Radiance of the layer before the block: (row, lane, column). For layers perpendicular to x the layer's fields follow
    /// the lanes, for they would be costly to gather again.
    entry: &'a [f32],
    /// True when the sums hold nothing yet.
    first: bool,
    /// True when no step is deeper than [`rows::THIN`].
    thin: bool,
}

impl Job<'_> {
    fn rows(&self) -> usize {
        self.size[lateral(self.batch.axis).0]
    }
    fn cols(&self) -> usize {
        self.size[lateral(self.batch.axis).1]
    }
    /// Length of a row with its padding.
    fn padded(&self) -> usize {
        self.cols().next_multiple_of(WIDTH)
    }
    /// Index along the axis of the layer with number `l` in the order of travel.
    fn layer(&self, l: usize) -> usize {
        if self.batch.ascending { l } else { self.size[self.batch.axis] - 1 - l }
    }
    /// The layers of the block in the order of memory.
    fn span(&self) -> Range<usize> {
        let ends = [self.layer(self.layers.start), self.layer(self.layers.end - 1)];
        ends[0].min(ends[1])..ends[0].max(ends[1]) + 1
    }
    /// True when S depends on direction.
    fn linear(&self) -> bool {
        self.fields.len() > 2
    }
}

/// A band of rows: what it writes.
struct Band<'a> {
    rows: Range<usize>,
    /// φ, or φ and J: for layers perpendicular to z one slice for each layer of the block in the order of memory, else one
    /// slice that holds the band's rows of all layers.
    sums: Vec<Vec<&'a mut [f32]>>,
    exit: &'a mut [f32],
}

/// reads σ, S → writes φ and J; returns the largest change of φ and the largest φ.
pub(crate) fn transport(
    t: &Transport,
    kept: &mut Kept,
    phi: &mut [f32],
    current: Option<[&mut [f32]; 3]>,
) -> (f32, f32) {
    let (size, voxels) = (t.grid.size, t.grid.len());
    if voxels == 0 {
        return (0.0, 0.0);
    }
    let mut fields = vec![&host(t.sigma)[..voxels], &host(t.source)[..voxels]];
    fields.extend(t.gradient.iter().flatten().map(|g| &host(g)[..voxels]));
    let Kept { sum, entry, exit } = kept;
    sum.resize(voxels, 0.0);
    let mut sums: Vec<&mut [f32]> = vec![sum];
    sums.extend(current.into_iter().flatten().map(|c| &mut c[..voxels]));
    let batches = batches(t.grid, t.ordinates);
    if batches.is_empty() {
        sums.iter_mut().for_each(|s| s.fill(0.0));
    }
    let densest = fields[0].par_chunks(CHUNK).map(largest).reduce(|| 0.0, f32::max);
    for (n, batch) in batches.iter().enumerate() {
        let half = batch.feet.iter().fold(0.0f32, |m, f| m.max(f.half));
        let thin = 2.0 * half * densest <= rows::THIN;
        run(batch, size, &fields, (n == 0, thin), &mut sums, entry, exit);
    }
    settle(sums[0], &mut phi[..voxels])
}

/// All layers of a batch, block by block.
fn run(
    batch: &Batch,
    size: [usize; 3],
    fields: &[&[f32]],
    (first, thin): (bool, bool),
    sums: &mut [&mut [f32]],
    entry: &mut Aligned,
    exit: &mut Aligned,
) {
    let (row_axis, col_axis) = lateral(batch.axis);
    let (layers, rows, cols, plane) = (size[batch.axis], size[row_axis], size[col_axis], size[0] * size[1]);
    let pitch = pitch(batch, fields.len(), cols);
    entry.grow(rows * pitch);
    exit.grow(rows * pitch);
    let height = height(rows, pitch);
    for start in (0..layers).step_by(BLOCK) {
        let block = start..(start + BLOCK).min(layers);
        let job = Job { batch, size, fields, layers: block, entry: &entry[..rows * pitch], first, thin };
        let exits = exit[..rows * pitch].chunks_mut(height * pitch);
        let mut bands: Vec<Band> = exits
            .enumerate()
            .map(|(b, exit)| Band {
                rows: b * height..((b + 1) * height).min(rows),
                sums: sums.iter().map(|_| Vec::with_capacity(BLOCK)).collect(),
                exit,
            })
            .collect();
        for (part, sum) in sums.iter_mut().enumerate() {
            if batch.axis == 2 {
                let span = job.span();
                for layer in sum[span.start * plane..span.end * plane].chunks_mut(plane) {
                    bands.iter_mut().zip(layer.chunks_mut(height * cols)).for_each(|(b, s)| b.sums[part].push(s));
                }
            } else {
                bands.iter_mut().zip(sum.chunks_mut(height * plane)).for_each(|(b, s)| b.sums[part].push(s));
            }
        }
        bands.into_par_iter().with_max_len(1).for_each(|mut band| band::run(&job, &mut band));
        std::mem::swap(entry, exit);
    }
}

/// Values between rows of neighbouring lanes: one line more than a row, so that rows of several lanes and layers do not all
/// fall into the same set of a cache.
fn stride(cols: usize) -> usize {
    cols.next_multiple_of(WIDTH) + WIDTH
}

/// Values between rows of all lanes.
fn pitch(batch: &Batch, fields: usize, cols: usize) -> usize {
    (batch.lanes.len() + if batch.axis == 0 { fields } else { 0 }) * stride(cols)
}

/// Rows of a band: as few bands as give every thread the same number, with their radiance within a megabyte.
fn height(rows: usize, pitch: usize) -> usize {
    let fitting = ((1 << 20) / (8 * pitch)).max(BLOCK);
    let threads = rayon::current_num_threads();
    let bands = rows.div_ceil(fitting).next_multiple_of(threads);
    rows.div_ceil(bands).max(BLOCK.min(rows))
}

/// Values of a whole volume that are worked on at a time.
const CHUNK: usize = 1 << 14;

/// Moves the sum into φ; returns the largest change and the largest value.
fn settle(sum: &[f32], phi: &mut [f32]) -> (f32, f32) {
    phi.par_chunks_mut(CHUNK)
        .zip(sum.par_chunks(CHUNK))
        .map(|(phi, sum)| settle_chunk(sum, phi))
        .reduce(|| (0.0, 0.0), |a, b| (a.0.max(b.0), a.1.max(b.1)))
}

dispatch! {
    fn settle_chunk(sum: &[f32], phi: &mut [f32]) -> (f32, f32) = settle_body;
}

#[inline(always)]
fn settle_body(sum: &[f32], phi: &mut [f32]) -> (f32, f32) {
    let mut change = [0.0f32; WIDTH];
    let mut peak = [0.0f32; WIDTH];
    for (phi, sum) in phi.chunks_mut(WIDTH).zip(sum.chunks(WIDTH)) {
        for (((p, s), c), m) in phi.iter_mut().zip(sum).zip(&mut change).zip(&mut peak) {
            *c = c.max((*s - *p).abs());
            *m = m.max(*s);
            *p = *s;
        }
    }
    let most = |v: [f32; WIDTH]| v.into_iter().fold(0.0, f32::max);
    (most(change), most(peak))
}

dispatch! {
    fn largest(values: &[f32]) -> f32 = largest_body;
}

#[inline(always)]
fn largest_body(values: &[f32]) -> f32 {
    let mut most = [0.0f32; WIDTH];
    for values in values.chunks(WIDTH) {
        most.iter_mut().zip(values).for_each(|(m, v)| *m = m.max(*v));
    }
    most.into_iter().fold(0.0, f32::max)
}
