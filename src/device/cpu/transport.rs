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

use std::cell::RefCell;
use std::ops::Range;

use rayon::prelude::*;

use super::host;
use super::simd::{dispatch, exp};
use crate::device::{Ordinate, Sweep, Transport};
use crate::grid::Grid;

/// Layers between joins: one cache line of values along x. 8 and 32 were 3–10 % slower at 128³ on 2 threads.
const BLOCK: usize = 16;

/// Ordinates of a batch at most: their layers and those of σ and S should stay in a second-level cache.
const LANES: usize = 8;

/// Memory that outlives a pass, so that passes do not allocate.
#[derive(Default)]
pub(super) struct Kept {
    sum: Vec<f32>,
    entry: Vec<f32>,
    exit: Vec<f32>,
}

/// One ordinate as its batch needs it. The foot of voxel (row, column) is in the layer before, at `t_row` of the way to row
/// `row + step_row` and `t_col` of the way to the next column (the one before where `col` is 0, after where it is 2).
struct Lane {
    step_row: isize,
    t_row: f32,
    col: usize,
    t_col: f32,
    half: f32,
    weight: f32,
    inflow: f32,
    omega: [f32; 3],
    foot: usize,
}

/// Interpolation across rows, shared by the lanes that have it in common.
#[derive(PartialEq)]
struct Foot {
    step_row: isize,
    t_row: f32,
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
            let foot = Foot { step_row: if d[row] >= 0.0 { -1 } else { 1 }, t_row: offset(row), inflow: o.inflow };
            let (step_row, t_row) = (foot.step_row, foot.t_row);
            let foot = batch.feet.iter().position(|f| *f == foot).unwrap_or_else(|| {
                batch.feet.push(foot);
                batch.feet.len() - 1
            });
            batch.lanes.push(Lane {
                step_row,
                t_row,
                col: if d[col] >= 0.0 { 0 } else { 2 },
                t_col: offset(col),
                half: 0.5 * sweep.length,
                weight: o.weight,
                inflow: o.inflow,
                omega: o.direction.to_array(),
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
    /// Radiance of the layer before the block: (row, lane, column).
    entry: &'a [f32],
    /// True when the sums hold nothing yet.
    first: bool,
}

impl Job<'_> {
    fn rows(&self) -> usize {
        self.size[lateral(self.batch.axis).0]
    }
    fn cols(&self) -> usize {
        self.size[lateral(self.batch.axis).1]
    }
    /// Index along the axis of the layer with number `l` in the order of travel.
    fn layer(&self, l: usize) -> usize {
        if self.batch.ascending { l } else { self.size[self.batch.axis] - 1 - l }
    }
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

/// A thread's working memory.
#[derive(Default)]
struct Scratch {
    /// Radiance of the layer before and of this one: (row, lane, column), `BLOCK` rows beyond the band on both sides.
    radiance: [Vec<f32>; 2],
    /// S towards each lane, likewise, where it depends on direction.
    emitted: [Vec<f32>; 2],
    /// Rows at the feet of a lane, then of every [`Foot`]: one value of padding on both sides.
    up: Vec<f32>,
    lane_emitted_up: Vec<f32>,
    sigma_up: Vec<f32>,
    emitted_up: Vec<f32>,
    /// φ and J of a row.
    row: Vec<f32>,
    /// Transposed layers of the fields: (field, layer, row, column), the layer before the block first.
    turned: Vec<f32>,
    /// φ and J before they are transposed back: (part, layer, row, column).
    sums: Vec<f32>,
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
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
    for (n, batch) in batches.iter().enumerate() {
        run(batch, size, &fields, n == 0, &mut sums, entry, exit);
    }
    settle(sums[0], &mut phi[..voxels])
}

/// All layers of a batch, block by block.
fn run(
    batch: &Batch,
    size: [usize; 3],
    fields: &[&[f32]],
    first: bool,
    sums: &mut [&mut [f32]],
    entry: &mut Vec<f32>,
    exit: &mut Vec<f32>,
) {
    let (row_axis, col_axis) = lateral(batch.axis);
    let (layers, rows, cols) = (size[batch.axis], size[row_axis], size[col_axis]);
    let pitch = batch.lanes.len() * cols;
    entry.resize(entry.len().max(rows * pitch), 0.0);
    exit.resize(exit.len().max(rows * pitch), 0.0);
    let height = height(rows, pitch);
    for start in (0..layers).step_by(BLOCK) {
        let block = start..(start + BLOCK).min(layers);
        let job = Job { batch, size, fields, layers: block, entry: &entry[..rows * pitch], first };
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
            let plane = size[0] * size[1];
            if batch.axis == 2 {
                let ends = [job.layer(job.layers.start), job.layer(job.layers.end - 1)];
                let (lo, hi) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
                for layer in sum[lo * plane..(hi + 1) * plane].chunks_mut(plane) {
                    bands.iter_mut().zip(layer.chunks_mut(height * cols)).for_each(|(b, s)| b.sums[part].push(s));
                }
            } else {
                bands.iter_mut().zip(sum.chunks_mut(height * plane)).for_each(|(b, s)| b.sums[part].push(s));
            }
        }
        bands.into_par_iter().with_max_len(1).for_each(|mut band| {
            SCRATCH.with_borrow_mut(|scratch| block_of_band(&job, &mut band, scratch));
        });
        std::mem::swap(entry, exit);
    }
}

/// Rows of a band: as few bands as give every thread the same number, their radiance within half a megabyte.
fn height(rows: usize, pitch: usize) -> usize {
    let fitting = ((1 << 19) / (8 * pitch)).max(BLOCK);
    let threads = rayon::current_num_threads();
    let bands = rows.div_ceil(fitting).next_multiple_of(threads);
    rows.div_ceil(bands).max(BLOCK.min(rows))
}

/// Moves the sum into φ; returns the largest change and the largest value.
fn settle(sum: &[f32], phi: &mut [f32]) -> (f32, f32) {
    const CHUNK: usize = 1 << 14;
    phi.par_chunks_mut(CHUNK)
        .zip(sum.par_chunks(CHUNK))
        .map(|(phi, sum)| settle_chunk(sum, phi))
        .reduce(|| (0.0, 0.0), |a, b| (a.0.max(b.0), a.1.max(b.1)))
}

dispatch! {
    fn settle_chunk(sum: &[f32], phi: &mut [f32]) -> (f32, f32) = settle_chunk_body;
}

#[inline(always)]
fn settle_chunk_body(sum: &[f32], phi: &mut [f32]) -> (f32, f32) {
    let mut change = [0.0f32; 16];
    let mut peak = [0.0f32; 16];
    for (phi, sum) in phi.chunks_mut(16).zip(sum.chunks(16)) {
        for (((p, s), c), m) in phi.iter_mut().zip(sum).zip(&mut change).zip(&mut peak) {
            *c = c.max((*s - *p).abs());
            *m = m.max(*s);
            *p = *s;
        }
    }
    let largest = |v: [f32; 16]| v.into_iter().fold(0.0, f32::max);
    (largest(change), largest(peak))
}

dispatch! {
    fn block_of_band(job: &Job, band: &mut Band, scratch: &mut Scratch) = block_body;
}

#[inline(always)]
fn block_body(job: &Job, band: &mut Band, scratch: &mut Scratch) {
    let (rows, cols, lanes) = (job.rows(), job.cols(), &job.batch.lanes[..]);
    let (pitch, parts) = (lanes.len() * cols, band.sums.len());
    let height = band.rows.len();
    // Rows that the scratch holds, and where row j is in it.
    let held = band.rows.start.saturating_sub(BLOCK)..(band.rows.end + BLOCK).min(rows);
    let at = |j: usize| (j - held.start) * pitch;
    scratch.fit(job, height, held.len(), parts);
    let Scratch { radiance, emitted, up, lane_emitted_up, sigma_up, emitted_up, row, turned, sums } = scratch;
    let [mut before, mut now] = radiance.each_mut().map(|p| &mut p[..held.len() * pitch]);
    let [mut emitted_before, mut emitted_now] = emitted.each_mut().map(|p| &mut p[..]);
    let across_x = job.batch.axis == 0;
    if across_x {
        turn_in(job, &held, turned);
    }
    let turned = &turned[..];
    let field = |f: usize, l: usize, j: usize| -> &[f32] {
        if across_x {
            let slot = f * (BLOCK + 1) + l + 1 - job.layers.start;
            &turned[(slot * held.len() + j - held.start) * cols..][..cols]
        } else {
            let (layer, plane) = (job.layer(l), job.size[0] * job.size[1]);
            let start = if job.batch.axis == 1 { j * plane + layer * cols } else { layer * plane + j * cols };
            &job.fields[f][start..][..cols]
        }
    };
    if job.layers.start > 0 {
        before.copy_from_slice(&job.entry[held.start * pitch..held.end * pitch]);
        if job.linear() {
            for j in held.clone() {
                for (n, lane) in lanes.iter().enumerate() {
                    let from = std::array::from_fn(|f| field(f + 1, job.layers.start - 1, j));
                    towards(&lane.omega, from, &mut emitted_before[at(j) + n * cols..][..cols]);
                }
            }
        }
    }
    let end = job.layers.end;
    for l in job.layers.clone() {
        let reach = end - 1 - l;
        for j in band.rows.start.saturating_sub(reach)..(band.rows.end + reach).min(rows) {
            let own = band.rows.contains(&j);
            let (sigma, isotropic) = (field(0, l, j), field(1, l, j));
            let beside = |step: isize| j.checked_add_signed(step).filter(|&b| b < rows);
            for (n, foot) in job.batch.feet.iter().enumerate() {
                let sigma_up = &mut sigma_up[n * (cols + 2)..][..cols + 2];
                let emitted_up = &mut emitted_up[n * (cols + 2)..][..cols + 2];
                if l == 0 {
                    sigma_up.fill(0.0);
                    emitted_up[1..=cols].copy_from_slice(isotropic);
                    continue;
                }
                let next = beside(foot.step_row);
                across(field(0, l - 1, j), next.map(|b| field(0, l - 1, b)), foot.t_row, 0.0, sigma_up);
                if !job.linear() {
                    let next = next.map(|b| field(1, l - 1, b));
                    across(field(1, l - 1, j), next, foot.t_row, foot.inflow, emitted_up);
                }
            }
            let row = &mut row[..parts * cols];
            row.fill(0.0);
            for (n, lane) in lanes.iter().enumerate() {
                let here = at(j) + n * cols;
                let source: &[f32] = if job.linear() {
                    let into = &mut emitted_now[here..][..cols];
                    towards(&lane.omega, std::array::from_fn(|f| field(f + 1, l, j)), into);
                    into
                } else {
                    isotropic
                };
                // A band's neighbour rows are needed only on the side the light comes from.
                if !own && (lane.step_row < 0) != (j < band.rows.start) {
                    continue;
                }
                let next = beside(lane.step_row).map(|b| at(b) + n * cols);
                let mut t_col = lane.t_col;
                let emitted_up: &[f32] = if l == 0 {
                    // Half a voxel inside the box: S is what it is here, σ outside is 0 (set above).
                    up.fill(lane.inflow);
                    t_col = 0.0;
                    lane_emitted_up[1..=cols].copy_from_slice(source);
                    lane_emitted_up
                } else {
                    let beyond = next.map(|b| &before[b..][..cols]);
                    across(&before[here..][..cols], beyond, lane.t_row, lane.inflow, up);
                    if job.linear() {
                        let beyond = next.map(|b| &emitted_before[b..][..cols]);
                        across(&emitted_before[here..][..cols], beyond, lane.t_row, lane.inflow, lane_emitted_up);
                        lane_emitted_up
                    } else {
                        &emitted_up[lane.foot * (cols + 2)..][..cols + 2]
                    }
                };
                let sigma_up = &sigma_up[lane.foot * (cols + 2)..][..cols + 2];
                let out = &mut now[here..][..cols];
                characteristic(lane, t_col, [&*up, sigma_up, emitted_up], sigma, source, out);
                if own {
                    accumulate(lane, out, row);
                }
            }
            if own {
                let (l, j) = (l - job.layers.start, j - band.rows.start);
                for (part, values) in row.chunks_exact(cols).enumerate() {
                    if across_x {
                        sums[((part * BLOCK + l) * height + j) * cols..][..cols].copy_from_slice(values);
                        continue;
                    }
                    let into = &mut band.sums[part];
                    let sum = if job.batch.axis == 1 {
                        &mut into[0][j * job.size[0] * job.size[1] + job.layer(l + job.layers.start) * cols..][..cols]
                    } else {
                        let ascending = job.batch.ascending;
                        let slice = if ascending { l } else { job.layers.len() - 1 - l };
                        &mut into[slice][j * cols..][..cols]
                    };
                    if job.first {
                        sum.copy_from_slice(values);
                    } else {
                        sum.iter_mut().zip(values).for_each(|(s, v)| *s += v);
                    }
                }
            }
        }
        std::mem::swap(&mut before, &mut now);
        std::mem::swap(&mut emitted_before, &mut emitted_now);
    }
    let own = at(band.rows.start)..at(band.rows.end);
    band.exit.copy_from_slice(&before[own]);
    if across_x {
        turn_out(job, band, sums);
    }
}

impl Scratch {
    /// Makes room for a band of `height` rows of which `held` are kept with their surroundings.
    fn fit(&mut self, job: &Job, height: usize, held: usize, parts: usize) {
        let (cols, lanes, feet) = (job.cols(), job.batch.lanes.len(), job.batch.feet.len());
        let grow = |v: &mut Vec<f32>, len: usize| {
            if v.len() < len {
                v.resize(len, 0.0);
            }
        };
        self.radiance.iter_mut().for_each(|v| grow(v, held * lanes * cols));
        if job.linear() {
            self.emitted.iter_mut().for_each(|v| grow(v, held * lanes * cols));
        }
        for v in [&mut self.up, &mut self.lane_emitted_up] {
            v.clear();
            v.resize(cols + 2, 0.0);
        }
        grow(&mut self.sigma_up, feet * (cols + 2));
        grow(&mut self.emitted_up, feet * (cols + 2));
        grow(&mut self.row, parts * cols);
        if job.batch.axis == 0 {
            grow(&mut self.turned, job.fields.len() * (BLOCK + 1) * held * cols);
            grow(&mut self.sums, parts * BLOCK * height * cols);
        }
    }
}

/// S towards a direction from its isotropic part and its gradient.
#[inline(always)]
fn towards(omega: &[f32; 3], [s, x, y, z]: [&[f32]; 4], out: &mut [f32]) {
    let n = out.len();
    let (s, x, y, z) = (&s[..n], &x[..n], &y[..n], &z[..n]);
    for i in 0..n {
        out[i] = (s[i] + (omega[0] * x[i] + omega[1] * y[i] + omega[2] * z[i])).max(0.0);
    }
}

/// A row interpolated towards the next one (`outside` where there is none), with `outside` on both ends.
#[inline(always)]
fn across(here: &[f32], next: Option<&[f32]>, t: f32, outside: f32, out: &mut [f32]) {
    let n = here.len();
    out[0] = outside;
    out[n + 1] = outside;
    let out = &mut out[1..=n];
    match next {
        Some(next) => {
            let next = &next[..n];
            for i in 0..n {
                out[i] = here[i] + t * (next[i] - here[i]);
            }
        }
        None => {
            for i in 0..n {
                out[i] = here[i] + t * (outside - here[i]);
            }
        }
    }
}

/// One row of one lane: `up` holds I, σ and S at the feet, interpolated across rows.
#[inline(always)]
fn characteristic(lane: &Lane, t: f32, up: [&[f32]; 3], sigma: &[f32], source: &[f32], out: &mut [f32]) {
    let n = out.len();
    let [(i0, i1), (sigma0, sigma1), (s0, s1)] = up.map(|row| (&row[1..=n], &row[lane.col..lane.col + n]));
    let (sigma, source) = (&sigma[..n], &source[..n]);
    for i in 0..n {
        let intensity = i0[i] + t * (i1[i] - i0[i]);
        let sigma_up = sigma0[i] + t * (sigma1[i] - sigma0[i]);
        let s_up = s0[i] + t * (s1[i] - s0[i]);
        let (absorbed, w0) = weights(lane.half * (sigma_up + sigma[i]));
        out[i] = intensity + absorbed * (s_up - intensity) + w0 * (source[i] - s_up);
    }
}

/// `1 − e^−τ` and `w₀ = 1 − (1 − e^−τ)/τ`; the latter by its series where the difference would cancel.
#[inline(always)]
fn weights(tau: f32) -> (f32, f32) {
    let absorbed = 1.0 - exp(-tau);
    let thick = 1.0 - absorbed / tau;
    let series = tau * (0.5 - tau * (1.0 / 6.0 - tau * (1.0 / 24.0 - tau * (1.0 / 120.0 - tau * (1.0 / 720.0)))));
    let thin = tau < 0.125;
    (if thin { tau * (1.0 - series) } else { absorbed }, if thin { series } else { thick })
}

/// Adds a row of radiance to φ and, where wanted, J.
#[inline(always)]
fn accumulate(lane: &Lane, radiance: &[f32], row: &mut [f32]) {
    let n = radiance.len();
    for (part, sum) in row.chunks_exact_mut(n).enumerate() {
        let weight = if part == 0 { lane.weight } else { lane.weight * lane.omega[part - 1] };
        for i in 0..n {
            sum[i] += weight * radiance[i];
        }
    }
}

/// Copies the block's layers perpendicular to x into contiguous rows. What was the last layer becomes the first.
#[inline(always)]
fn turn_in(job: &Job, held: &Range<usize>, turned: &mut [f32]) {
    let ([nx, ny, _], cols) = (job.size, job.cols());
    let layer = held.len() * cols;
    for (f, field) in job.fields.iter().enumerate() {
        let slots = &mut turned[f * (BLOCK + 1) * layer..][..(BLOCK + 1) * layer];
        let from = if job.layers.start == 0 { job.layers.start } else { job.layers.start - 1 };
        let first = from + 1 - job.layers.start;
        for (r, z) in held.clone().enumerate() {
            for y in 0..ny {
                let line = &field[(z * ny + y) * nx..][..nx];
                for (slot, l) in (first..).zip(from..job.layers.end) {
                    slots[slot * layer + r * cols + y] = line[job.layer(l)];
                }
            }
        }
    }
}

/// Adds the block's layers perpendicular to x to φ and J.
#[inline(always)]
fn turn_out(job: &Job, band: &mut Band, sums: &[f32]) {
    let ([nx, ny, _], cols, height) = (job.size, job.cols(), band.rows.len());
    for (part, into) in band.sums.iter_mut().enumerate() {
        let from = &sums[part * BLOCK * height * cols..][..BLOCK * height * cols];
        for r in 0..height {
            for y in 0..ny {
                let line = &mut into[0][(r * ny + y) * nx..][..nx];
                for l in job.layers.clone() {
                    let value = from[((l - job.layers.start) * height + r) * cols + y];
                    let x = job.layer(l);
                    line[x] = if job.first { value } else { line[x] + value };
                }
            }
        }
    }
}
