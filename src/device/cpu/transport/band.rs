//! A band of rows through a block of layers, all lanes of a batch.

use std::cell::RefCell;

use super::super::simd::dispatch;
use super::aligned::Aligned;
use super::rows::{Across, Depth, Step, across, largest, step, towards};
use super::turn::{layer_stride, turn_in, turn_out};
use super::{BLOCK, Band, Job, WIDTH, pitch, stride};

/// A thread's working memory. Rows are padded to a multiple of [`WIDTH`].
#[derive(Default)]
struct Scratch {
    /// Radiance of the layer before and of this one: (row, lane, column), `BLOCK` rows beyond the band on both sides.
    radiance: [Aligned; 2],
    /// S towards each lane, likewise, where it depends on direction.
    emitted: [Aligned; 2],
    feet: Vec<FootRows>,
    /// Largest σ of each row that is held, in the layer before and in this one.
    densest: [Vec<f32>; 2],
    /// For each row that is held and each lane, likewise: true where no light is.
    dark: [Vec<bool>; 2],
    /// Rows of the lane at work.
    up: Aligned,
    emitted_up: Across,
    /// S of a row whose length is no multiple of [`WIDTH`].
    isotropic: Aligned,
    /// φ and J of a row.
    row: Aligned,
    /// Layers of the fields perpendicular to x: (field, layer, row, column), see [`layer_stride`].
    turned: Aligned,
    /// φ and J of such layers: (part, layer, row, column).
    sums: Aligned,
    /// A row of all layers of a block, transposed back: (column, layer).
    columns: Aligned,
}

/// Rows that the lanes of a foot share.
#[derive(Default)]
struct FootRows {
    steps: Depth,
    /// Half the step times σ here and at the feet, and S at the feet.
    depth: Aligned,
    depth_up: Across,
    emitted_up: Across,
}

impl Scratch {
    /// Makes room for a band of `height` rows of which `held` are kept with their surroundings.
    fn fit(&mut self, job: &Job, height: usize, held: usize, parts: usize) {
        let padded = job.padded();
        let planes = held * pitch(job.batch, job.fields.len(), job.cols());
        self.radiance.iter_mut().for_each(|v| v.grow(planes));
        if job.linear() {
            self.emitted.iter_mut().for_each(|v| v.grow(planes));
        }
        self.densest.iter_mut().for_each(|v| v.resize(held, 0.0));
        self.dark.iter_mut().for_each(|v| v.resize(held * job.batch.lanes.len(), false));
        self.feet.resize_with(self.feet.len().max(job.batch.feet.len()), FootRows::default);
        for foot in &mut self.feet {
            foot.depth.grow(padded);
            foot.depth_up.fit(padded);
            foot.emitted_up.fit(padded);
        }
        self.up.grow(padded + 2 * WIDTH);
        self.emitted_up.fit(padded);
        self.isotropic.grow(padded);
        self.row.grow(parts * padded);
        if job.batch.axis == 0 {
            self.turned.grow(job.fields.len() * BLOCK * layer_stride(held, padded));
            self.sums.grow(parts * BLOCK * layer_stride(height, padded));
            self.columns.grow(WIDTH * padded);
        }
    }
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// Makes room in this thread for bands of up to `height` rows, `held` with their surroundings.
pub(super) fn reserve(job: &Job, height: usize, held: usize, parts: usize) {
    SCRATCH.with_borrow_mut(|scratch| scratch.fit(job, height, held, parts));
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
    let (rows, cols, padded, lanes) = (job.rows(), job.cols(), job.padded(), &job.batch.lanes[..]);
    let (stride, parts, height) = (stride(cols), band.sums.len(), band.rows.len());
    let pitch = pitch(job.batch, job.fields.len(), cols);
    // Rows that the scratch holds, and where row j is in it.
    let held = band.rows.start.saturating_sub(BLOCK)..(band.rows.end + BLOCK).min(rows);
    let at = |j: usize| (j - held.start) * pitch;
    scratch.fit(job, height, held.len(), parts);
    let Scratch { radiance, emitted, feet, densest, dark, up, emitted_up, isotropic, row, turned, sums, columns } =
        scratch;
    let [mut before, mut now] = radiance.each_mut().map(|p| &mut p[..held.len() * pitch]);
    let [mut emitted_before, mut emitted_now] = emitted.each_mut().map(|p| &mut p[..]);
    let [mut densest_before, mut densest_now] = densest.each_mut().map(|p| &mut p[..]);
    let [mut dark_before, mut dark_now] = dark.each_mut().map(|p| &mut p[..]);
    let across_x = job.batch.axis == 0;
    if across_x {
        turn_in(job, &held, turned);
    }
    let turned = &turned[..];
    let field = |f: usize, l: usize, j: usize| -> &[f32] {
        if across_x {
            if l < job.layers.start {
                return &job.entry[j * pitch + (lanes.len() + f) * stride..][..cols];
            }
            let slot = f * BLOCK + l - job.layers.start;
            return &turned[slot * layer_stride(held.len(), padded) + (j - held.start) * padded..][..cols];
        }
        let (layer, plane) = (job.layer(l), job.size[0] * job.size[1]);
        let start = if job.batch.axis == 1 { j * plane + layer * cols } else { layer * plane + j * cols };
        &job.fields[f][start..][..cols]
    };
    if job.layers.start > 0 {
        before.copy_from_slice(&job.entry[held.start * pitch..held.end * pitch]);
        for j in held.clone() {
            densest_before[j - held.start] = largest(field(0, job.layers.start - 1, j));
            for n in 0..lanes.len() {
                let radiance = &before[at(j) + n * stride..][..cols];
                dark_before[(j - held.start) * lanes.len() + n] = largest(radiance) == 0.0;
            }
        }
        if job.linear() {
            for j in held.clone() {
                for (n, lane) in lanes.iter().enumerate() {
                    let from = std::array::from_fn(|f| field(f + 1, job.layers.start - 1, j));
                    towards(&lane.omega, from, &mut emitted_before[at(j) + n * stride..]);
                }
            }
        }
    }
    let row = &mut row[..parts * padded];
    for l in job.layers.clone() {
        let reach = job.layers.end - 1 - l;
        for j in band.rows.start.saturating_sub(reach)..(band.rows.end + reach).min(rows) {
            let own = band.rows.contains(&j);
            let [first, last] = job.outer(l, j);
            let held_row = j - held.start;
            densest_now[held_row] = largest(field(0, l, j));
            if let (Some(given), Some(outer)) = (job.given, first) {
                for (n, lane) in lanes.iter().enumerate() {
                    let here = at(j) + n * stride;
                    dark_now[held_row * lanes.len() + n] = false;
                    now[here..][..cols].copy_from_slice(&given[(outer * lanes.len() + n) * cols..][..cols]);
                    if job.linear() {
                        let from = std::array::from_fn(|f| field(f + 1, l, j));
                        towards(&lane.omega, from, &mut emitted_now[here..]);
                    }
                }
                if own {
                    // The slab before has summed this plane.
                    row.fill(0.0);
                    deposit(job, band, (l, j), row, sums);
                }
                continue;
            }
            let beside = |step: isize| j.checked_add_signed(step).filter(|&b| b < rows);
            // A neighbouring band's rows are needed only by lanes that come from its side.
            let needed = |step: isize| own || (step < 0) == (j < band.rows.start);
            for (foot, rows) in job.batch.feet.iter().zip(&mut *feet) {
                if !needed(foot.step_row) {
                    continue;
                }
                let next = beside(foot.step_row);
                let above = match (l, next) {
                    (0, _) => 0.0,
                    (_, None) => densest_before[held_row],
                    (_, Some(b)) => densest_before[held_row].max(densest_before[b - held.start]),
                };
                rows.steps = Depth::of(foot.half * (densest_now[held_row] + above));
                if rows.steps == Depth::Empty {
                    continue;
                }
                let sigma = field(0, l, j);
                rows.depth.iter_mut().zip(sigma).for_each(|(d, s)| *d = foot.half * s);
                if l == 0 {
                    // Half a voxel inside the box: no σ at the feet and the S of the voxel itself.
                    rows.depth_up.clear();
                } else {
                    rows.depth_up.between(foot, foot.half, field(0, l - 1, j), next.map(|b| field(0, l - 1, b)), 0.0);
                    if !job.linear() {
                        let next = next.map(|b| field(1, l - 1, b));
                        rows.emitted_up.between(foot, 1.0, field(1, l - 1, j), next, foot.inflow);
                    }
                }
            }
            let isotropic: &[f32] = if cols == padded {
                field(1, l, j)
            } else {
                isotropic[..cols].copy_from_slice(field(1, l, j));
                &isotropic[..padded]
            };
            row.fill(0.0);
            for (n, lane) in lanes.iter().enumerate() {
                let here = at(j) + n * stride;
                if job.linear() {
                    let from = std::array::from_fn(|f| field(f + 1, l, j));
                    towards(&lane.omega, from, &mut emitted_now[here..]);
                }
                let (foot, shared) = (&job.batch.feet[lane.foot], &feet[lane.foot]);
                if !needed(foot.step_row) {
                    continue;
                }
                let empty = shared.steps == Depth::Empty;
                let next = beside(foot.step_row);
                let was_dark = |j: usize| dark_before[(j - held.start) * lanes.len() + n];
                let unlit = l == 0 || was_dark(j) && next.is_none_or(was_dark);
                let dark = empty && lane.inflow == 0.0 && unlit;
                dark_now[held_row * lanes.len() + n] = dark;
                if dark {
                    now[here..][..padded].fill(0.0);
                    continue;
                }
                let emitted = if job.linear() { &emitted_now[here..][..padded] } else { isotropic };
                let next = next.map(|b| at(b) + n * stride);
                let t_col = if l == 0 {
                    up[..padded + 2 * WIDTH].fill(lane.inflow);
                    emitted_up.here(emitted);
                    0.0
                } else {
                    across(
                        &before[here..][..padded],
                        next.map(|b| &before[b..][..padded]),
                        foot.t_row,
                        1.0,
                        lane.inflow,
                        up,
                    );
                    up[WIDTH + cols] = lane.inflow;
                    if job.linear() && !empty {
                        let next = next.map(|b| &emitted_before[b..][..cols]);
                        emitted_up.between(foot, 1.0, &emitted_before[here..][..cols], next, lane.inflow);
                    }
                    foot.t_col
                };
                let own_up = job.linear() || l == 0;
                let reads = Step {
                    lane,
                    up,
                    t_col,
                    depth: &shared.depth,
                    depth_up: &shared.depth_up,
                    emitted,
                    emitted_up: if own_up { emitted_up } else { &shared.emitted_up },
                };
                step(&reads, shared.steps, &mut now[here..][..padded], row);
            }
            if own {
                deposit(job, band, (l, j), row, sums);
            }
            if let Some(outer) = last.filter(|_| own && !band.face.is_empty()) {
                for n in 0..lanes.len() {
                    let into = &mut band.face[((outer - band.face_start) * lanes.len() + n) * cols..][..cols];
                    into.copy_from_slice(&now[at(j) + n * stride..][..cols]);
                }
            }
        }
        std::mem::swap(&mut before, &mut now);
        std::mem::swap(&mut emitted_before, &mut emitted_now);
        std::mem::swap(&mut densest_before, &mut densest_now);
        std::mem::swap(&mut dark_before, &mut dark_now);
    }
    band.exit.copy_from_slice(&before[at(band.rows.start)..at(band.rows.end)]);
    if across_x {
        for (j, row) in band.rows.clone().zip(band.exit.chunks_exact_mut(pitch)) {
            for (f, into) in row[lanes.len() * stride..].chunks_exact_mut(stride).enumerate() {
                into[..cols].copy_from_slice(field(f, job.layers.end - 1, j));
            }
        }
        turn_out(job, band, sums, columns);
    }
}

/// Adds a row of φ and J to the sums.
#[inline(always)]
fn deposit(job: &Job, band: &mut Band, (l, j): (usize, usize), row: &[f32], sums: &mut [f32]) {
    let (cols, padded, height) = (job.cols(), job.padded(), band.rows.len());
    let j = j - band.rows.start;
    for (part, values) in row.chunks_exact(padded).enumerate() {
        let into = &mut band.sums[part];
        let sum = match job.batch.axis {
            0 => {
                let slot = part * BLOCK + l - job.layers.start;
                sums[slot * layer_stride(height, padded) + j * padded..][..padded].copy_from_slice(values);
                continue;
            }
            1 => &mut into[0][j * job.size[0] * job.size[1] + job.layer(l) * cols..][..cols],
            _ => &mut into[job.layer(l) - job.span().start][j * cols..][..cols],
        };
        if job.first {
            sum.copy_from_slice(&values[..cols]);
        } else {
            sum.iter_mut().zip(values).for_each(|(s, v)| *s += v);
        }
    }
}
