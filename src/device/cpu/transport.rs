//! Transport along discrete ordinates (light.md, first-collision-source ordinates) by step characteristics: a voxel is a step
//! of uniform extinction and source function (Lathrop 1969). With τ = σΔs
//!
//! `I_out = I_in + A(S − I_in)`, `A = 1 − e^−τ`; mean over the voxel `Ī = I_in + B(S − I_in)`, `B = 1 − A/τ`,
//!
//! and I_in is what left the layer before, bilinear at the foot; outside the grid it is the inflow. φ and J sum Ī, so that what
//! leaves voxels is what enters them and what they emit less what they absorb, to rounding; written this way a constant radiance stays
//! constant to the bit.
//!
//! Ordinates that share dominant axis, direction of travel and length of a step form a batch: σ and S are read once for all of
//! them, A and B found once, and φ is updated once. Only the layer before is kept of I. A thread works on a band of rows for a block
//! of layers and computes the rows beside its band that it needs again, so one join serves many layers and the result does not
//! depend on the number of threads. How deep the steps of some rows are at most decides by which formula A and B are found; without
//! extinction there is nothing but the interpolation, and where no light has come to either, not even that. For layers perpendicular
//! to x the volumes are turned.
//!
//! Ordinates that cross planes of z downwards and those that cross them upwards never share a batch and are summed apart, each half of
//! the threads on one kind: so a grid may be passed slab by slab, each of the two ways once, and every sum is the same to the bit.
//! What a slab leaves to the next is the radiance that leaves its last plane, its *face*.

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
    /// σ, S and its gradient with x slowest.
    turned: Vec<Vec<f32>>,
    /// Of the ordinates that cross z downwards, and of those that cross it upwards.
    halves: [Half; 2],
    /// What every thread has room for: lanes' rows with their surroundings, the longest row, and fields.
    room: [usize; 3],
}

/// What the ordinates that cross z one way need.
#[derive(Default)]
struct Half {
    /// φ and J.
    sums: Vec<Vec<f32>>,
    /// The same with x slowest.
    turned: Vec<Vec<f32>>,
    entry: Aligned,
    exit: Aligned,
}

/// One ordinate as its batch needs it. Its feet lie in the layer before, at `t_row` of the way to row `row + step_row` and at
/// `t_col` of the way to the column before (`ascending`) or the next.
struct Lane {
    weight: f32,
    inflow: f32,
    omega: [f32; 3],
    step_row: isize,
    t_row: f32,
    ascending: bool,
    t_col: f32,
}

/// Ordinates of the same dominant axis, direction of travel along it and along z, and length of a step.
struct Batch {
    axis: usize,
    ascending: bool,
    /// Across z.
    upward: bool,
    /// World length between layers.
    length: f32,
    lanes: Vec<Lane>,
}

impl Batch {
    /// Values between rows of all lanes.
    fn pitch(&self, cols: usize) -> usize {
        self.lanes.len() * stride(cols)
    }
}

/// Row and column axes of layers perpendicular to `axis`; columns are contiguous in memory, for x in what is turned.
fn lateral(axis: usize) -> (usize, usize) {
    [(2, 1), (2, 0), (1, 0)][axis]
}

/// Those that cross planes of z upwards, or the others.
fn batches(grid: &Grid, ordinates: &[Ordinate], upward: bool) -> Vec<Batch> {
    let mut all: Vec<Batch> = Vec::new();
    for key in 0..6 {
        let (axis, ascending) = (key / 2, key % 2 == 0);
        let (row, col) = lateral(axis);
        let first = all.len();
        for o in ordinates {
            let sweep = Sweep::new(grid, o.direction, false);
            let d = sweep.direction;
            if sweep.axis() != axis || (d[axis] >= 0.0) != ascending || sweep.ascending()[2] != upward {
                continue;
            }
            let offset = |a: usize| (d[a] / d[axis]).abs().min(1.0);
            let lane = Lane {
                weight: o.weight,
                inflow: o.inflow,
                omega: o.direction.to_array(),
                step_row: if d[row] >= 0.0 { -1 } else { 1 },
                t_row: offset(row),
                ascending: d[col] >= 0.0,
                t_col: offset(col),
            };
            // Symmetric directions differ by rounding.
            let fits = |b: &&mut Batch| (b.length - sweep.length).abs() <= 4e-7 * b.length && b.lanes.len() < LANES;
            match all[first..].iter_mut().find(fits) {
                Some(batch) => batch.lanes.push(lane),
                None => all.push(Batch { axis, ascending, upward, length: sweep.length, lanes: vec![lane] }),
            }
        }
    }
    all
}

/// What every band of a batch reads.
struct Job<'a> {
    batch: &'a Batch,
    size: [usize; 3],
    /// σ, S and, where scattering is anisotropic, the three components of the gradient of S.
    fields: &'a [&'a [f32]],
    /// Values between layers and between rows of them.
    strides: [usize; 2],
    /// Layers of this block, counted in the order of travel.
    layers: Range<usize>,
    /// Radiance that leaves the layer before the block: (row, lane, column).
    entry: &'a [f32],
    /// Radiance of the first plane of z the way the batch travels, where that is given: see [`Job::outer`].
    given: Option<&'a [f32]>,
    /// True when the sums hold nothing yet.
    first: bool,
}

impl Job<'_> {
    /// Where row `j` of layer `l` is in the first and in the last plane of z the way the batch travels, if it is: a face holds
    /// (row, lane, column) of layers perpendicular to z, else (layer in the order of travel, lane, column).
    #[inline(always)]
    fn outer(&self, l: usize, j: usize) -> [Option<usize>; 2] {
        if self.batch.axis == 2 {
            return [(l == 0).then_some(j), (l + 1 == self.size[2]).then_some(j)];
        }
        let ends = [0, self.rows() - 1];
        let [first, last] = if self.batch.upward { ends } else { [ends[1], ends[0]] };
        [(j == first).then_some(l), (j == last).then_some(l)]
    }

    #[inline(always)]
    fn rows(&self) -> usize {
        self.size[lateral(self.batch.axis).0]
    }
    #[inline(always)]
    fn cols(&self) -> usize {
        self.size[lateral(self.batch.axis).1]
    }
    /// Index along the axis of the layer with number `l` in the order of travel.
    #[inline(always)]
    fn layer(&self, l: usize) -> usize {
        if self.batch.ascending { l } else { self.size[self.batch.axis] - 1 - l }
    }
    /// Which slice of a band's sums the row with number `j` of the band in layer `l` is in, and where.
    #[inline(always)]
    fn place(&self, l: usize, j: usize) -> (usize, usize) {
        match self.batch.axis {
            1 => (0, j * self.strides[1] + self.layer(l) * self.strides[0]),
            _ => (self.layer(l) - self.span().start, j * self.cols()),
        }
    }
    /// The layers of the block in the order of memory.
    #[inline(always)]
    fn span(&self) -> Range<usize> {
        let ends = [self.layer(self.layers.start), self.layer(self.layers.end - 1)];
        ends[0].min(ends[1])..ends[0].max(ends[1]) + 1
    }
}

/// A band of rows: what it writes.
struct Band<'a> {
    rows: Range<usize>,
    /// φ, or φ and J: where layers are contiguous one slice for each layer of the block in the order of memory, else one
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
    let mut current: Vec<&mut [f32]> = current.into_iter().flatten().map(|c| &mut c[..voxels]).collect();
    let parts = 1 + current.len();
    let (fields, ways) = (fields(t), [false, true].map(|upward| batches(t.grid, t.ordinates, upward)));
    kept.fit(t, &fields, &ways, parts, Passing::Both);
    let Kept { turned, halves: [down, up], .. } = kept;
    let pass = |half: &mut Half, ways: &[Batch]| {
        let mut sums = std::mem::take(&mut half.sums);
        let mut into: Vec<&mut [f32]> = sums.iter_mut().take(parts).map(|s| &mut s[..voxels]).collect();
        pass(t, (&fields, turned), ways, Passing::Both, half, (&[], &mut []), &mut into);
        half.sums = sums;
    };
    rayon::join(|| pass(down, &ways[0]), || pass(up, &ways[1]));
    for (n, current) in current.iter_mut().enumerate() {
        settle(&down.sums[n + 1], &up.sums[n + 1], current);
    }
    settle(&down.sums[0], &up.sums[0], &mut phi[..voxels])
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
    let (fields, ways) = (fields(t), batches(t.grid, t.ordinates, passage.ascending));
    let passing = Passing::Slab { given: passage.given };
    kept.fit(t, &fields, std::slice::from_ref(&ways), sums.len(), passing);
    let Kept { turned, halves: [half, _], .. } = kept;
    if !passage.added {
        pass(t, (&fields, turned), &ways, passing, half, faces, &mut sums);
        return;
    }
    let mut own = std::mem::take(&mut half.sums);
    let mut into: Vec<&mut [f32]> = own.iter_mut().take(sums.len()).map(|s| &mut s[..voxels]).collect();
    pass(t, (&fields, turned), &ways, passing, half, faces, &mut into);
    for (sum, own) in sums.iter_mut().zip(&own) {
        let chunks = sum.par_chunks_mut(CHUNK).zip(own.par_chunks(CHUNK));
        chunks.for_each(|(sum, own)| sum.iter_mut().zip(own).for_each(|(s, o)| *s += o));
    }
    half.sums = own;
}

/// What passes at a time.
#[derive(Clone, Copy, PartialEq)]
enum Passing {
    /// All ordinates through the whole grid.
    Both,
    /// Those that cross z one way, through a slab; the radiance that comes into it may be given.
    Slab { given: bool },
}

impl Passing {
    /// Threads that ordinates which cross z one way have to themselves.
    fn threads(self) -> usize {
        let all = rayon::current_num_threads();
        if self == Passing::Both { all.div_ceil(2) } else { all }
    }
}

/// σ, S and its gradient.
fn fields<'a>(t: &Transport<'a>) -> Vec<&'a [f32]> {
    let voxels = t.grid.len();
    let gradient = t.gradient.into_iter().flatten();
    [t.sigma, t.source].into_iter().chain(gradient).map(|f| &host(f)[..voxels]).collect()
}

impl Kept {
    /// Turns the fields, if there are ordinates that need it, and makes room.
    fn fit(&mut self, t: &Transport, fields: &[&[f32]], ways: &[Vec<Batch>], parts: usize, passing: Passing) {
        let (size, voxels) = (t.grid.size, t.grid.len());
        if ways.iter().flatten().any(|b| b.axis == 0) {
            let len = size[0] * turn::layer(size);
            resize(&mut self.turned, fields.len(), len);
            self.halves[..ways.len()].iter_mut().for_each(|half| resize(&mut half.turned, parts, len));
            for (turned, field) in self.turned.iter_mut().zip(fields) {
                turn::turn(size, field, turned);
            }
        }
        self.halves[..ways.len()].iter_mut().for_each(|half| resize(&mut half.sums, parts, voxels));
        let mut wanted = [0, 0, fields.len()];
        for batch in ways.iter().flatten() {
            let (row, col) = lateral(batch.axis);
            let [rows, cols] = [size[row], size[col]];
            let held = (height(rows, batch.pitch(cols), passing.threads()) + 2 * BLOCK).min(rows);
            wanted = [wanted[0].max(batch.lanes.len() * held * stride(cols)), wanted[1].max(cols), wanted[2]];
        }
        // All threads at once: which of them takes which band is up to chance, and so were when they take memory.
        if (0..3).any(|n| wanted[n] > self.room[n]) {
            self.room = std::array::from_fn(|n| self.room[n].max(wanted[n]));
            rayon::broadcast(|_| band::reserve(self.room));
        }
    }
}

/// Makes at least `count` volumes of `len` values.
fn resize(volumes: &mut Vec<Vec<f32>>, count: usize, len: usize) {
    volumes.resize_with(volumes.len().max(count), Vec::new);
    volumes[..count].iter_mut().for_each(|v| v.resize(len, 0.0));
}

/// Batches of ordinates that cross planes of z the same way. `fields`: as they are, and turned.
fn pass(
    t: &Transport,
    (fields, turned): (&[&[f32]], &[Vec<f32>]),
    batches: &[Batch],
    passing: Passing,
    half: &mut Half,
    (mut entry, mut exit): (&[f32], &mut [f32]),
    sums: &mut [&mut [f32]],
) {
    let [nx, ny, _] = t.grid.size;
    let plane = nx * ny;
    let turned_fields: Vec<&[f32]> = turned.iter().take(fields.len()).map(|f| &f[..]).collect();
    let mut turned_sums: Vec<&mut [f32]> = half.turned.iter_mut().take(sums.len()).map(|s| &mut s[..]).collect();
    if batches.is_empty() {
        sums.iter_mut().for_each(|s| s.fill(0.0));
    }
    let across_x = batches.iter().take_while(|b| b.axis == 0).count();
    for (n, batch) in batches.iter().enumerate() {
        let given = passing == Passing::Slab { given: true };
        let given = given.then(|| entry.split_off(..batch.lanes.len() * plane).expect("a face of every lane"));
        let carried = match exit.is_empty() {
            true => &mut [][..],
            false => exit.split_off_mut(..batch.lanes.len() * plane).expect("a face of every lane"),
        };
        let is_turned = batch.axis == 0;
        let job = Job {
            batch,
            size: t.grid.size,
            fields: if is_turned { &turned_fields } else { fields },
            strides: [[turn::layer(t.grid.size), ny], [nx, plane], [plane, nx]][batch.axis],
            layers: 0..0,
            entry: &[],
            given,
            first: n == 0,
        };
        let room = (&mut half.entry, &mut half.exit, passing.threads());
        match is_turned {
            true => run(job, &mut turned_sums, room, carried),
            false => run(job, sums, room, carried),
        }
        if n + 1 == across_x {
            for (turned, sum) in turned_sums.iter().zip(&mut *sums) {
                turn::turn_back(t.grid.size, turned, sum);
            }
        }
    }
}

/// All layers of a batch, block by block.
fn run(
    job: Job,
    sums: &mut [&mut [f32]],
    (entry, exit, threads): (&mut Aligned, &mut Aligned, usize),
    face: &mut [f32],
) {
    let batch = job.batch;
    let (layers, rows, cols) = (job.size[batch.axis], job.rows(), job.cols());
    let pitch = batch.pitch(cols);
    entry.grow(rows * pitch);
    exit.grow(rows * pitch);
    let (height, deep) = (height(rows, pitch, threads), batch.lanes.len() * cols);
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
            if batch.axis == 1 {
                let rows = sum.chunks_mut(height * job.strides[1]);
                bands.iter_mut().zip(rows).for_each(|(b, s)| b.sums[part].push(s));
            } else {
                let (span, layer) = (job.span(), job.strides[0]);
                for layer in sum[span.start * layer..span.end * layer].chunks_mut(layer) {
                    bands.iter_mut().zip(layer.chunks_mut(height * cols)).for_each(|(b, s)| b.sums[part].push(s));
                }
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
        std::mem::swap(&mut *entry, &mut *exit);
    }
}

/// Values between rows of neighbouring lanes: one line more than a row, so that rows of several lanes and layers do not all
/// fall into the same set of a cache.
fn stride(cols: usize) -> usize {
    cols.next_multiple_of(WIDTH) + WIDTH
}

/// Rows of a band: as few bands as give every thread the same number, with their radiance within a megabyte.
fn height(rows: usize, pitch: usize, threads: usize) -> usize {
    let fitting = ((1 << 20) / (4 * pitch)).max(BLOCK);
    let bands = rows.div_ceil(fitting).next_multiple_of(threads);
    rows.div_ceil(bands).max((BLOCK / 2).min(rows))
}

/// Values of a whole volume that are worked on at a time.
const CHUNK: usize = 1 << 14;

/// Moves the two sums into φ or a part of J; returns the largest change and the largest value.
fn settle(down: &[f32], up: &[f32], phi: &mut [f32]) -> (f32, f32) {
    let chunks = phi.par_chunks_mut(CHUNK).zip(down.par_chunks(CHUNK).zip(up.par_chunks(CHUNK)));
    let settled = chunks.map(|(phi, (down, up))| settle_chunk(down, up, phi));
    settled.reduce(|| (0.0, 0.0), |a, b| (a.0.max(b.0), a.1.max(b.1)))
}

dispatch! {
    fn settle_chunk(down: &[f32], up: &[f32], phi: &mut [f32]) -> (f32, f32) = settle_body;
}

#[inline(always)]
fn settle_body(down: &[f32], up: &[f32], phi: &mut [f32]) -> (f32, f32) {
    let mut change = [0.0f32; WIDTH];
    let mut peak = [0.0f32; WIDTH];
    for ((phi, down), up) in phi.chunks_mut(WIDTH).zip(down.chunks(WIDTH)).zip(up.chunks(WIDTH)) {
        for ((((p, d), u), c), m) in phi.iter_mut().zip(down).zip(up).zip(&mut change).zip(&mut peak) {
            let now = d + u;
            *c = c.max((now - *p).abs());
            *m = m.max(now);
            *p = now;
        }
    }
    let most = |v: [f32; WIDTH]| v.into_iter().fold(0.0, f32::max);
    (most(change), most(peak))
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
