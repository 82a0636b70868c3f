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
//! the threads on one kind. Each passes the grid slab by slab, as thick as a second-level cache holds, all batches through one slab
//! before the next: what a slab leaves to the next is the radiance that leaves its last plane, its *face*. A grid that is handed over
//! slab by slab goes the same way, and every sum is the same to the bit.

use std::ops::Range;

use rayon::prelude::*;

use super::host;
use super::simd::dispatch;
use aligned::Aligned;
use batch::{Batch, batches, lateral};

use crate::device::{Passage, Transport};

mod aligned;
mod band;
mod batch;
mod rows;
mod turn;

/// Layers between joins: one cache line of values along x.
const BLOCK: usize = 16;

/// Values that are worked on together; rows in working memory are padded to a multiple of them.
const WIDTH: usize = 16;

/// Bytes that the fields and sums of a slab may take.
const SLAB: usize = 3 << 20;

/// Memory that outlives a pass, so that passes do not allocate.
#[derive(Default)]
pub(super) struct Kept {
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
    /// σ, S and its gradient of a slab with x slowest, and φ and J.
    turned: [Vec<Vec<f32>>; 2],
    /// Of each batch.
    carried: Vec<Carried>,
}

/// Radiance that leaves what a batch has passed.
#[derive(Default)]
struct Carried {
    /// The layer before a block, and the last of it: (row, lane, column).
    entry: Aligned,
    exit: Aligned,
    /// The last plane of the slab before, the way the batch travels, and of this one, for layers that cross it: (layer in the order of
    /// travel, lane, column).
    faces: [Vec<f32>; 2],
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
    /// Radiance that leaves the layer before the block: (row, lane, column). Empty before the first one.
    entry: &'a [f32],
    /// Radiance that leaves the row before the first one the way the batch travels: (layer, lane, column). Empty where that is
    /// the inflow.
    before: &'a [f32],
    /// True when the sums hold nothing yet.
    first: bool,
}

impl Job<'_> {
    /// True for the last row the way the batch travels, where that is across z.
    #[inline(always)]
    fn is_last(&self, j: usize) -> bool {
        j == if self.batch.upward { self.rows() - 1 } else { 0 }
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
    /// What leaves the last row, for the layers of the block; empty where there is none.
    face: &'a mut [f32],
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
    let threads = rayon::current_num_threads().div_ceil(2);
    kept.fit(t, fields.len(), &ways, parts, threads);
    let [down, up] = &mut kept.halves;
    let pass = |half: &mut Half, ways: &[Batch]| {
        let mut sums = std::mem::take(&mut half.sums);
        let mut into: Vec<&mut [f32]> = sums.iter_mut().take(parts).map(|s| &mut s[..voxels]).collect();
        pass(t.grid.size, &fields, 0..t.grid.size[2], ways, half, threads, (None, &mut []), &mut into);
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
    let threads = rayon::current_num_threads();
    kept.fit(t, fields.len(), std::slice::from_ref(&ways), sums.len(), threads);
    let half = &mut kept.halves[0];
    // The slab before has summed the plane that is given.
    let deep = t.grid.size[2];
    let planes = match (passage.given, passage.ascending) {
        (false, _) => 0..deep,
        (true, true) => 1..deep,
        (true, false) => 0..deep - 1,
    };
    let faces = (passage.given.then_some(faces.0), faces.1);
    if !passage.added {
        pass(t.grid.size, &fields, planes, &ways, half, threads, faces, &mut sums);
        return;
    }
    let mut own = std::mem::take(&mut half.sums);
    let mut into: Vec<&mut [f32]> = own.iter_mut().take(sums.len()).map(|s| &mut s[..voxels]).collect();
    pass(t.grid.size, &fields, planes, &ways, half, threads, faces, &mut into);
    for (sum, own) in sums.iter_mut().zip(&own) {
        let chunks = sum.par_chunks_mut(CHUNK).zip(own.par_chunks(CHUNK));
        chunks.for_each(|(sum, own)| sum.iter_mut().zip(own).for_each(|(s, o)| *s += o));
    }
    half.sums = own;
}

/// σ, S and its gradient.
fn fields<'a>(t: &Transport<'a>) -> Vec<&'a [f32]> {
    let voxels = t.grid.len();
    let gradient = t.gradient.into_iter().flatten();
    [t.sigma, t.source].into_iter().chain(gradient).map(|f| &host(f)[..voxels]).collect()
}

impl Kept {
    /// Makes room for passes of these batches, with so many threads for those that cross z one way.
    fn fit(&mut self, t: &Transport, fields: usize, ways: &[Vec<Batch>], parts: usize, threads: usize) {
        let size = t.grid.size;
        let deep = planes_at_once(size, fields + parts, threads);
        let mut wanted = [0, 0, fields];
        for (half, way) in self.halves.iter_mut().zip(ways) {
            resize(&mut half.sums, parts, t.grid.len());
            if way.iter().any(|b| b.axis == 0) {
                let len = size[0] * turn::layer([size[0], size[1], deep]);
                resize(&mut half.turned[0], fields, len);
                resize(&mut half.turned[1], parts, len);
            }
            half.carried.resize_with(half.carried.len().max(way.len()), Carried::default);
            for (batch, carried) in way.iter().zip(&mut half.carried) {
                let [rows, cols] = batch.layer(size, deep);
                carried.entry.grow(rows * batch.pitch(cols));
                carried.exit.grow(rows * batch.pitch(cols));
                let face = if batch.axis == 2 { 0 } else { size[0] * size[1] * batch.lanes.len() };
                carried.faces.iter_mut().for_each(|f| f.resize(face, 0.0));
                let held = (height(rows, batch.pitch(cols), threads) + 2 * BLOCK).min(rows);
                wanted = [wanted[0].max(batch.lanes.len() * held * stride(cols)), wanted[1].max(cols), fields];
            }
        }
        // All threads at once: which of them takes which band is up to chance, and so were when they take memory.
        if (0..3).any(|n| wanted[n] > self.room[n]) {
            self.room = std::array::from_fn(|n| self.room[n].max(wanted[n]));
            rayon::broadcast(|_| band::reserve(self.room));
        }
    }
}

/// Planes of a slab: what a cache holds of `volumes` volumes, and no fewer than keep the threads busy.
fn planes_at_once([nx, ny, nz]: [usize; 3], volumes: usize, threads: usize) -> usize {
    let fitting = (SLAB / (4 * volumes * nx * ny)).next_multiple_of(8);
    let busy = if threads > 1 { 2 * BLOCK * threads } else { 8 };
    fitting.max(busy).min(nz)
}

/// Makes at least `count` volumes of `len` values.
fn resize(volumes: &mut Vec<Vec<f32>>, count: usize, len: usize) {
    volumes.resize_with(volumes.len().max(count), Vec::new);
    volumes[..count].iter_mut().for_each(|v| v.resize(len, 0.0));
}

/// Batches of ordinates that cross planes of z the same way, through some planes. `faces`: what is given before the first plane the way
/// they travel, and what they leave; a plane for each lane, see [`Carried`].
#[allow(clippy::too_many_arguments)]
fn pass(
    [nx, ny, nz]: [usize; 3],
    fields: &[&[f32]],
    planes: Range<usize>,
    batches: &[Batch],
    half: &mut Half,
    threads: usize,
    (mut given, mut left): (Option<&[f32]>, &mut [f32]),
    sums: &mut [&mut [f32]],
) {
    let plane = nx * ny;
    if batches.is_empty() {
        sums.iter_mut().for_each(|s| s.fill(0.0));
        return;
    }
    let Half { turned: [turned, turned_sums], carried, .. } = half;
    for (batch, carried) in batches.iter().zip(&mut *carried) {
        if let Some(given) = &mut given {
            let face = given.split_off(..batch.lanes.len() * plane).expect("a face of every lane");
            carried.take(batch, batch.layer([nx, ny, nz], 1)[1], face);
        }
    }
    let upward = batches[0].upward;
    let across_x = batches.iter().take_while(|b| b.axis == 0).count();
    let deep = planes_at_once([nx, ny, nz], fields.len() + sums.len(), threads);
    for done in (0..planes.len()).step_by(deep) {
        let deep = deep.min(planes.len() - done);
        let start = if upward { planes.start + done } else { planes.end - done - deep };
        let (size, held) = ([nx, ny, deep], start * plane..(start + deep) * plane);
        let fields: Vec<&[f32]> = fields.iter().map(|f| &f[held.clone()]).collect();
        let mut sums: Vec<&mut [f32]> = sums.iter_mut().map(|s| &mut s[held.clone()]).collect();
        let (first, room) = (done == 0 && given.is_none(), nx * turn::layer(size));
        if across_x > 0 {
            turned.iter_mut().zip(&fields).for_each(|(turned, field)| turn::turn(size, field, &mut turned[..room]));
        }
        let turned: Vec<&[f32]> = turned.iter().take(fields.len()).map(|f| &f[..]).collect();
        let mut turned_sums: Vec<&mut [f32]> = turned_sums.iter_mut().take(sums.len()).map(|s| &mut s[..]).collect();
        for (n, (batch, carried)) in batches.iter().zip(&mut *carried).enumerate() {
            let is_turned = batch.axis == 0;
            let job = Job {
                batch,
                size,
                fields: if is_turned { &turned } else { &fields },
                strides: [[turn::layer(size), ny], [nx, plane], [plane, nx]][batch.axis],
                layers: 0..0,
                entry: &[],
                before: &[],
                first: n == 0,
            };
            run(job, if is_turned { &mut turned_sums } else { &mut sums }, carried, first, threads);
            if n + 1 == across_x {
                for (turned, sum) in turned_sums.iter().zip(&mut sums) {
                    turn::turn_back(size, turned, sum);
                }
            }
        }
    }
    if left.is_empty() {
        return;
    }
    for (batch, carried) in batches.iter().zip(&*carried) {
        let face = left.split_off_mut(..batch.lanes.len() * plane).expect("a face of every lane");
        carried.leave(batch, batch.layer([nx, ny, nz], 1)[1], face);
    }
}

impl Carried {
    /// Takes up a face: (row, lane, column) of layers perpendicular to z, else (layer in the order of travel, lane, column).
    fn take(&mut self, batch: &Batch, cols: usize, face: &[f32]) {
        if batch.axis != 2 {
            self.faces[0].copy_from_slice(face);
            return;
        }
        for (row, from) in self.entry.chunks_exact_mut(stride(cols)).zip(face.chunks_exact(cols)) {
            row[..cols].copy_from_slice(from);
        }
    }

    /// Hands it over.
    fn leave(&self, batch: &Batch, cols: usize, face: &mut [f32]) {
        if batch.axis != 2 {
            face.copy_from_slice(&self.faces[0]);
            return;
        }
        for (row, into) in self.entry.chunks_exact(stride(cols)).zip(face.chunks_exact_mut(cols)) {
            into.copy_from_slice(&row[..cols]);
        }
    }
}

/// All layers of a batch in a slab, block by block. `first`: nothing but the inflow comes from the slab before.
fn run(job: Job, sums: &mut [&mut [f32]], carried: &mut Carried, first: bool, threads: usize) {
    let (batch, axis) = (job.batch, job.batch.axis);
    let (layers, rows, cols) = (job.size[axis], job.rows(), job.cols());
    let (pitch, deep) = (batch.pitch(cols), batch.lanes.len() * cols);
    let height = height(rows, pitch, threads);
    let Carried { entry, exit, faces: [before, after] } = carried;
    for start in (0..layers).step_by(BLOCK) {
        let entered = start > 0 || axis == 2 && !first;
        let job = Job {
            layers: start..(start + BLOCK).min(layers),
            entry: if entered { &entry[..rows * pitch] } else { &[] },
            before: if first { &[] } else { &before[..] },
            ..job
        };
        let exits = exit[..rows * pitch].chunks_mut(height * pitch);
        let mut bands: Vec<Band> = exits
            .enumerate()
            .map(|(b, exit)| Band {
                rows: b * height..((b + 1) * height).min(rows),
                sums: sums.iter().map(|_| Vec::with_capacity(BLOCK)).collect(),
                exit,
                face: &mut [],
            })
            .collect();
        for (part, sum) in sums.iter_mut().enumerate() {
            if axis == 1 {
                let rows = sum.chunks_mut(height * job.strides[1]);
                bands.iter_mut().zip(rows).for_each(|(b, s)| b.sums[part].push(s));
            } else {
                let (span, layer) = (job.span(), job.strides[0]);
                for layer in sum[span.start * layer..span.end * layer].chunks_mut(layer) {
                    bands.iter_mut().zip(layer.chunks_mut(height * cols)).for_each(|(b, s)| b.sums[part].push(s));
                }
            }
        }
        if axis != 2 {
            let last = if batch.upward { bands.last_mut() } else { bands.first_mut() };
            last.expect("a band").face = &mut after[start * deep..job.layers.end * deep];
        }
        bands.into_par_iter().with_max_len(1).for_each(|mut band| band::run(&job, &mut band));
        std::mem::swap(entry, exit);
    }
    std::mem::swap(before, after);
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
