//! A band of rows through a block of layers, all lanes of a batch.

use std::cell::RefCell;
use std::ops::Range;

use super::super::simd::{dispatch, prefetch};
use super::aligned::Aligned;
use super::batch::{LANES, Lane};
use super::rows::{Depth, Feet, average, blend, cross, cross_towards, largest, optics, pass_on};
use super::{BLOCK, Band, Job, WIDTH, stride};

/// A thread's working memory.
#[derive(Default)]
struct Scratch {
    /// Radiance that leaves the voxels of the latest layer: (lane, row, column). Rows of the inflow are on both sides of those that are
    /// held, and a row ends with values of the inflow. In lanes whose feet lie towards the row before, each layer is written a row
    /// further down, over what is not needed again.
    radiance: Aligned,
    /// For each group and lane, true where no light is.
    dark: Vec<bool>,
    /// Rows of a group. S and its gradient:
    fields: Aligned,
    /// See [`optics`].
    absorbed: Aligned,
    short: Aligned,
    /// Radiance interpolated across rows.
    feet: Aligned,
    /// φ and J.
    sum: Aligned,
}

/// Rows that are worked on together: what they need stays in a first-level cache.
fn group_rows(cols: usize) -> usize {
    match cols {
        0..=32 => 32,
        33..=96 => 16,
        _ => 8,
    }
}

/// Values between rows, one at least of which lies between them: groups are whole numbers of four vectors.
fn pitch(cols: usize) -> usize {
    (cols + 1).next_multiple_of(4 * WIDTH / group_rows(cols))
}

/// Values of a lane's radiance where `held` rows are held: as many rows before them as layers are written, and one more.
fn extent(held: usize, cols: usize) -> usize {
    (held + BLOCK + 2).next_multiple_of(8) * pitch(cols)
}

impl Scratch {
    /// Makes room for lanes of `held` rows in all with their surroundings, rows of up to `cols` values, and so many fields.
    fn fit(&mut self, [held, cols, fields]: [usize; 3]) {
        // Whatever the shape of a batch: rows beyond those that are held, for each lane.
        self.radiance.grow(held + LANES * (BLOCK + 10) * pitch(cols));
        self.dark.resize(self.dark.len().max(held / WIDTH + LANES), false);
        let group = (0..=cols).map(|c| group_rows(c) * pitch(c)).max().unwrap_or(0);
        self.fields.grow((fields - 1) * group);
        self.sum.grow(4 * group);
        [&mut self.absorbed, &mut self.short].into_iter().for_each(|v| v.grow(group));
        self.feet.grow(group + 2 * WIDTH);
    }
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// Makes room in this thread, see [`Kept`](super::Kept).
pub(super) fn reserve(room: [usize; 3]) {
    SCRATCH.with_borrow_mut(|scratch| scratch.fit(room));
}

/// reads the layer before the block, σ, S → writes the last layer of the block, φ, J.
pub(super) fn run(job: &Job, band: &mut Band) {
    SCRATCH.with_borrow_mut(|scratch| block_of_band(job, band, scratch));
}

dispatch! {
    fn block_of_band(job: &Job, band: &mut Band, scratch: &mut Scratch) = block_body;
}

#[inline(always)]
fn block_body(job: &Job, band: &mut Band, scratch: &mut Scratch) {
    let (rows, cols, lanes) = (job.rows(), job.cols(), &job.batch.lanes[..]);
    let (fields, parts) = (job.fields.len(), band.sums.len());
    // S that depends on direction goes with J.
    let isotropic = fields == 2 && parts == 1;
    let summed_parts = if isotropic { 1 } else { 4 };
    let (pitch, tall) = (pitch(cols), group_rows(cols));
    // Rows that the scratch holds, and where they are in it after `done` layers.
    let held = band.rows.start.saturating_sub(BLOCK)..(band.rows.end + BLOCK).min(rows);
    let (front, extent) = (BLOCK + 1, extent(held.len(), cols));
    let at = |j: usize, lane: &Lane, done: usize| {
        (front + j - held.start - if lane.step_row < 0 { done } else { 0 }) * pitch
    };
    let Scratch { radiance, dark, fields: group, absorbed, short, feet, sum } = scratch;
    let field =
        |f: usize, l: usize, j: usize| &job.fields[f][job.layer(l) * job.strides[0] + j * job.strides[1]..][..cols];
    enter(job, &held, front * pitch, radiance, dark);
    let groups = held.len().div_ceil(tall);
    let summed: f32 = lanes.iter().map(|lane| lane.weight).sum();
    for (done, l) in job.layers.clone().enumerate() {
        let reach = job.layers.end - 1 - l;
        let (low, high) = (band.rows.start.saturating_sub(reach), (band.rows.end + reach).min(rows));
        if l > 0 && !job.before.is_empty() {
            for (n, (lane, radiance)) in lanes.iter().zip(radiance.chunks_exact_mut(extent)).enumerate() {
                let row = at(if lane.step_row < 0 { held.start } else { held.end }, lane, done);
                let row = if lane.step_row < 0 { row - pitch } else { row };
                radiance[row..][..cols].copy_from_slice(&job.before[((l - 1) * lanes.len() + n) * cols..][..cols]);
            }
        }
        for g in (low - held.start) / tall..(high - held.start).div_ceil(tall) {
            let start = held.start + g * tall;
            let range = start.max(low)..(start + tall).min(high);
            let own = range.start.max(band.rows.start)..range.end.min(band.rows.end);
            let n = range.len() * pitch;
            ask_for_next(job, band, (l, range.end), (low, high), tall);
            for f in 1..fields {
                let into = group[(f - 1) * tall * pitch..].chunks_exact_mut(pitch);
                for (row, j) in into.zip(range.clone()) {
                    lay(field(f, l, j), 0.0, row);
                }
            }
            let [s, x, y, z] =
                std::array::from_fn(|f| if f + 1 < fields { &group[f * tall * pitch..][..n] } else { &[][..] });
            let first = job.layer(l) * job.strides[0] + range.start * job.strides[1];
            let densest = largest(&job.fields[0][first..], job.strides[1], range.len(), cols);
            let depth = Depth::of(job.batch.length * densest);
            let ways = absorbed.chunks_exact_mut(pitch).zip(short.chunks_exact_mut(pitch));
            for ((absorbed, short), j) in ways.zip(range.clone()) {
                optics(depth, job.batch.length, field(0, l, j), &mut absorbed[..cols], &mut short[..cols]);
            }
            // Between rows all is absorbed.
            absorbed[..n].chunks_exact_mut(pitch).for_each(|row| row[cols..].fill(1.0));
            let (absorbed, short) = (&absorbed[..n], &short[..n]);
            sum[..summed_parts * tall * pitch].fill(0.0);
            for (n_lane, (lane, radiance)) in lanes.iter().zip(radiance.chunks_exact_mut(extent)).enumerate() {
                // A neighbouring band's rows are needed only by lanes that come from its side.
                let needed = !own.is_empty() || (lane.step_row < 0) == (range.start < band.rows.start);
                if !needed {
                    continue;
                }
                if depth == Depth::Empty && lane.inflow == 0.0 {
                    let was_dark = |g: usize| match g < groups {
                        true => dark[g * lanes.len() + n_lane],
                        false => job.before.is_empty(),
                    };
                    if was_dark(g) && was_dark(g.wrapping_add_signed(lane.step_row)) {
                        continue;
                    }
                }
                dark[g * lanes.len() + n_lane] = false;
                let (here, there) = (at(range.start, lane, done), at(range.start, lane, done + 1));
                let beside = here.wrapping_add_signed(lane.step_row * pitch as isize);
                blend(&radiance[here..][..n], &radiance[beside..][..n], lane.t_row, &mut feet[WIDTH..][..n]);
                feet[WIDTH - 1] = lane.inflow;
                feet[WIDTH + n] = lane.inflow;
                let beside = &feet[if lane.ascending { WIDTH - 1 } else { WIDTH + 1 }..][..n];
                let feet = Feet { here: &feet[WIDTH..][..n], beside, t: lane.t_col };
                let exit = &mut radiance[there..][..n];
                if isotropic {
                    let sum = &mut sum[..n];
                    match depth {
                        Depth::Empty => pass_on(feet, lane.weight, exit, sum),
                        _ => cross(feet, absorbed, s, lane.weight, exit, sum),
                    }
                } else {
                    let (omega, source) = if fields == 2 { ([0.0; 3], [s; 4]) } else { (lane.omega, [s, x, y, z]) };
                    let [wx, wy, wz] = lane.omega.map(|o| lane.weight * o);
                    let [phi, jx, jy, jz] = sums_of(sum, tall * pitch);
                    let optics = [absorbed, short];
                    cross_towards(feet, optics, omega, source, exit, [lane.weight, wx, wy, wz], phi, jx, jy, jz);
                }
                if lane.inflow != 0.0 || depth == Depth::Empty {
                    exit.chunks_exact_mut(pitch).for_each(|row| row[cols..].fill(lane.inflow));
                }
            }
            if isotropic && depth != Depth::Empty {
                average(short, s, summed, &mut sum[..n]);
            }
            for j in own {
                let row = (j - range.start) * pitch;
                deposit(job, band, (l, j), |part| &sum[part * tall * pitch + row..][..cols]);
                if !band.face.is_empty() && job.is_last(j) {
                    for (n, (lane, radiance)) in lanes.iter().zip(radiance.chunks_exact(extent)).enumerate() {
                        let into = &mut band.face[(done * lanes.len() + n) * cols..][..cols];
                        into.copy_from_slice(&radiance[at(j, lane, done + 1)..][..cols]);
                    }
                }
            }
        }
    }
    let stride = stride(cols);
    for (j, row) in band.rows.clone().zip(band.exit.chunks_exact_mut(lanes.len() * stride)) {
        for ((lane, into), radiance) in
            lanes.iter().zip(row.chunks_exact_mut(stride)).zip(radiance.chunks_exact(extent))
        {
            into[..cols].copy_from_slice(&radiance[at(j, lane, job.layers.len())..][..cols]);
        }
    }
}

/// Asks for the values that the next group needs: rows from `next` on, or the first ones of the next layer.
#[inline(always)]
fn ask_for_next(job: &Job, band: &Band, (l, next): (usize, usize), (low, high): (usize, usize), tall: usize) {
    let (l, start) = if next < high { (l, next) } else { (l + 1, low) };
    if l == job.layers.end {
        return;
    }
    for j in start..(start + tall).min(high) {
        let at = job.layer(l) * job.strides[0] + j * job.strides[1];
        for field in job.fields {
            let row = &field[at..][..job.cols()];
            for at in (0..row.len()).step_by(WIDTH) {
                prefetch(&row[at]);
            }
        }
        if !job.first && band.rows.contains(&j) {
            let (part, at) = job.place(l, j - band.rows.start);
            for sums in &band.sums {
                let row = &sums[part][at..][..job.cols()];
                for at in (0..row.len()).step_by(WIDTH) {
                    prefetch(&row[at]);
                }
            }
        }
    }
}

/// Rows of φ and J.
#[inline(always)]
fn sums_of(sum: &mut [f32], len: usize) -> [&mut [f32]; 4] {
    let (phi, j) = sum.split_at_mut(len);
    let (jx, j) = j.split_at_mut(len);
    let (jy, jz) = j.split_at_mut(len);
    [phi, jx, jy, jz]
}

/// Copies a row into a longer one, whose end is filled.
#[inline(always)]
fn lay(row: &[f32], end: f32, into: &mut [f32]) {
    into[..row.len()].copy_from_slice(row);
    into[row.len()..].fill(end);
}

/// Takes up the radiance of the layer before the block, with the inflow around it.
#[inline(always)]
fn enter(job: &Job, held: &Range<usize>, front: usize, radiance: &mut [f32], dark: &mut [bool]) {
    let (cols, lanes, pitch, stride) = (job.cols(), &job.batch.lanes[..], pitch(job.cols()), stride(job.cols()));
    let (extent, tall) = (extent(held.len(), cols), group_rows(cols));
    for (n, (lane, radiance)) in lanes.iter().zip(radiance.chunks_exact_mut(extent)).enumerate() {
        let (before, rows) = radiance.split_at_mut(front);
        let (rows, after) = rows.split_at_mut(held.len() * pitch);
        // The other side is not looked at.
        if lane.step_row < 0 { before } else { after }.fill(lane.inflow);
        if !job.entry.is_empty() {
            for (j, row) in held.clone().zip(rows.chunks_exact_mut(pitch)) {
                lay(&job.entry[(j * lanes.len() + n) * stride..][..cols], lane.inflow, row);
            }
        } else {
            rows.fill(lane.inflow);
        }
        for (g, group) in rows.chunks(tall * pitch).enumerate() {
            dark[g * lanes.len() + n] = group.iter().all(|v| *v == 0.0);
        }
    }
}

/// Adds a row of φ and J to the sums.
#[inline(always)]
fn deposit<'a>(job: &Job, band: &mut Band, (l, j): (usize, usize), row: impl Fn(usize) -> &'a [f32]) {
    let (part, at) = job.place(l, j - band.rows.start);
    for (n, sums) in band.sums.iter_mut().enumerate() {
        let (sum, values) = (&mut sums[part][at..][..job.cols()], row(n));
        if job.first {
            sum.copy_from_slice(values);
        } else {
            sum.iter_mut().zip(values).for_each(|(s, v)| *s += v);
        }
    }
}
