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
//! number of threads. How deep the steps of a row are at most decides by which formula they are taken; without extinction there is
//! nothing but the interpolation, and where no light has come to either, not even that. Layers perpendicular to x are transposed on the way in and out, a cache line of x at a time.
//!
//! Ordinates that cross planes of z downwards come first, those that cross them upwards second, never both in a batch: so a
//! grid may be passed slab by slab, each of the two ways once, and every sum is the same to the bit. What a slab leaves to the
//! next is the radiance of its last plane, its *face*.

use std::ops::Range;

use rayon::prelude::*;

use super::host;
use super::simd::dispatch;
use aligned::Aligned;

use crate::device::{Ordinate, Passage, Sweep, Transport};
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
    /// What every thread has room for: values of its layers, of a row and of turned layers.
    room: [usize; 3],
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

/// Ordinates of the same dominant axis and direction of travel along it and along z.
struct Batch {
    axis: usize,
    ascending: bool,
    /// Across z.
    upward: bool,
    lanes: Vec<Lane>,
    feet: Vec<Foot>,
}

/// Row and column axes of layers perpendicular to `axis`; columns are contiguous in memory, except for x.
fn lateral(axis: usize) -> (usize, usize) {
    [(2, 1), (2, 0), (1, 0)][axis]
}

/// Those that cross planes of z upwards, or the others.
fn batches(grid: &Grid, ordinates: &[Ordinate], upward: bool) -> Vec<Batch> {
    let mut all: Vec<Batch> = Vec::new();
    for key in 0..6 {
        let (axis, ascending) = (key / 2, key % 2 == 0);
        let (row, col) = lateral(axis);
        let mut open: Option<Batch> = None;
        for o in ordinates {
            let sweep = Sweep::new(grid, o.direction, false);
            let d = sweep.direction;
            if sweep.axis() != axis || (d[axis] >= 0.0) != ascending || sweep.ascending()[2] != upward {
                continue;
            }
            let batch = open.get_or_insert_with(|| Batch { axis, ascending, upward, lanes: vec![], feet: vec![] });
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
    /// Radiance of the first plane of z the way the batch travels, where that is given: see [`Job::outer`].
    given: Option<&'a [f32]>,
    /// True when the sums hold nothing yet.
    first: bool,
}

impl Job<'_> {
    /// Where row `j` of layer `l` is in the first and in the last plane of z the way the batch travels, if it is: a face holds
    /// (row, lane, column) of layers perpendicular to z, else (layer in the order of travel, lane, column).
    fn outer(&self, l: usize, j: usize) -> [Option<usize>; 2] {
        if self.batch.axis == 2 {
            return [(l == 0).then_some(j), (l + 1 == self.size[2]).then_some(j)];
        }
        let ends = [0, self.rows() - 1];
        let [first, last] = if self.batch.upward { ends } else { [ends[1], ends[0]] };
        [(j == first).then_some(l), (j == last).then_some(l)]
    }

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
    /// Its part of the face that is carried on, from [`Job::outer`] number `face_start` on; empty where there is none.
    face: &'a mut [f32],
    face_start: usize,
}

/// reads σ, S → writes φ and J; returns the largest change of φ and the largest φ.
pub(super) fn transport(
    t: &Transport,
    kept: &mut Kept,
    phi: &mut [f32],
    current: Option<[&mut [f32]; 3]>,
) -> (f32, f32) {
    let voxels = t.grid.len();
    if voxels == 0 {
        return (0.0, 0.0);
    }
    let mut sum = std::mem::take(&mut kept.sum);
    sum.resize(voxels, 0.0);
    let mut sums: Vec<&mut [f32]> = vec![&mut sum];
    sums.extend(current.into_iter().flatten().map(|c| &mut c[..voxels]));
    for ascending in [false, true] {
        let passage = Passage { ascending, given: false, added: ascending };
        pass(t, &passage, kept, (&[], &mut []), &mut sums);
    }
    let extremes = settle(sums[0], &mut phi[..voxels]);
    kept.sum = sum;
    extremes
}

/// reads σ, S, radiance of the slab before → writes radiance of the last plane, adds to φ and J.
pub(super) fn transport_slab(
    t: &Transport,
    passage: &Passage,
    kept: &mut Kept,
    faces: (&[f32], &mut [f32]),
    phi: &mut [f32],
    current: Option<[&mut [f32]; 3]>,
) {
    let voxels = t.grid.len();
    let mut sums: Vec<&mut [f32]> = vec![&mut phi[..voxels]];
    sums.extend(current.into_iter().flatten().map(|c| &mut c[..voxels]));
    pass(t, passage, kept, faces, &mut sums);
}

/// The ordinates that cross planes of z one way.
fn pass(
    t: &Transport,
    passage: &Passage,
    kept: &mut Kept,
    (mut entry, mut exit): (&[f32], &mut [f32]),
    sums: &mut [&mut [f32]],
) {
    let (voxels, plane) = (t.grid.len(), t.grid.size[0] * t.grid.size[1]);
    let mut fields = vec![&host(t.sigma)[..voxels], &host(t.source)[..voxels]];
    fields.extend(t.gradient.iter().flatten().map(|g| &host(g)[..voxels]));
    let batches = batches(t.grid, t.ordinates, passage.ascending);
    if batches.is_empty() && !passage.added {
        sums.iter_mut().for_each(|s| s.fill(0.0));
    }
    for (n, batch) in batches.iter().enumerate() {
        let given = passage.given.then(|| entry.split_off(..batch.lanes.len() * plane).expect("a face of every lane"));
        let carried = match exit.is_empty() {
            true => &mut [][..],
            false => exit.split_off_mut(..batch.lanes.len() * plane).expect("a face of every lane"),
        };
        let job = Job {
            batch,
            size: t.grid.size,
            fields: &fields,
            layers: 0..0,
            entry: &[],
            given,
            first: n == 0 && !passage.added,
        };
        run(job, sums, kept, carried);
    }
}

/// All layers of a batch, block by block.
fn run(job: Job, sums: &mut [&mut [f32]], kept: &mut Kept, face: &mut [f32]) {
    let Kept { entry, exit, room, .. } = kept;
    let batch = job.batch;
    let (layers, rows, cols, plane) = (job.size[batch.axis], job.rows(), job.cols(), job.size[0] * job.size[1]);
    let pitch = pitch(batch, job.fields.len(), cols);
    entry.grow(rows * pitch);
    exit.grow(rows * pitch);
    let (height, deep) = (height(rows, pitch), batch.lanes.len() * cols);
    // All threads at once: which of them takes which band is up to chance, and so were when they take memory.
    let held = (height + 2 * BLOCK).min(rows);
    let (fields, turned) = (job.fields.len(), if batch.axis == 0 { held * job.padded() } else { 0 });
    let wanted = [fields * held * pitch, job.padded(), fields * turned];
    if (0..3).any(|n| wanted[n] > room[n]) {
        *room = std::array::from_fn(|n| room[n].max(wanted[n]));
        rayon::broadcast(|_| band::reserve(&job, height, held, sums.len()));
    }
    for start in (0..layers).step_by(BLOCK) {
        let job = Job { layers: start..(start + BLOCK).min(layers), entry: &entry[..rows * pitch], ..job };
        let exits = exit[..rows * pitch].chunks_mut(height * pitch);
        let mut bands: Vec<Band> = exits
            .enumerate()
            .map(|(b, exit)| Band {
                rows: b * height..((b + 1) * height).min(rows),
                sums: sums.iter().map(|_| Vec::with_capacity(BLOCK)).collect(),
                exit,
                face: &mut [],
                face_start: 0,
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
        if batch.axis != 2 {
            let last = if batch.upward { bands.last_mut() } else { bands.first_mut() };
            if let Some(band) = last.filter(|_| !face.is_empty()) {
                (band.face, band.face_start) = (&mut face[start * deep..job.layers.end * deep], start);
            }
        } else if job.layers.end == layers {
            for (band, face) in bands.iter_mut().zip(face.chunks_mut(height * deep)) {
                (band.face, band.face_start) = (face, band.rows.start);
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
    rows.div_ceil(bands).max((BLOCK / 2).min(rows))
}

/// Values of a whole volume that are worked on at a time.
const CHUNK: usize = 1 << 14;

/// Moves the sum into φ; returns the largest change and the largest value.
fn settle(sum: &[f32], phi: &mut [f32]) -> (f32, f32) {
    let chunks = phi.par_chunks_mut(CHUNK).zip(sum.par_chunks(CHUNK));
    let settled = chunks.map(|(phi, sum)| {
        let extremes = extremes_of_chunk(sum, phi);
        phi.copy_from_slice(sum);
        extremes
    });
    settled.reduce(|| (0.0, 0.0), |a, b| (a.0.max(b.0), a.1.max(b.1)))
}

/// The largest change of φ, and its largest new value.
pub(crate) fn extremes(now: &[f32], before: &[f32]) -> (f32, f32) {
    let chunks = now.par_chunks(CHUNK).zip(before.par_chunks(CHUNK));
    chunks
        .map(|(now, before)| extremes_of_chunk(now, before))
        .reduce(|| (0.0, 0.0), |a, b| (a.0.max(b.0), a.1.max(b.1)))
}

dispatch! {
    fn extremes_of_chunk(now: &[f32], before: &[f32]) -> (f32, f32) = extremes_body;
}

#[inline(always)]
fn extremes_body(now: &[f32], before: &[f32]) -> (f32, f32) {
    let mut change = [0.0f32; WIDTH];
    let mut peak = [0.0f32; WIDTH];
    for (now, before) in now.chunks(WIDTH).zip(before.chunks(WIDTH)) {
        for (((n, b), c), m) in now.iter().zip(before).zip(&mut change).zip(&mut peak) {
            *c = c.max((*n - *b).abs());
            *m = m.max(*n);
        }
    }
    let most = |v: [f32; WIDTH]| v.into_iter().fold(0.0, f32::max);
    (most(change), most(peak))
}
