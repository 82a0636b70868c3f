//! Direct light from a point by short characteristics (light.md, direct light: six pyramids with perspective feet):
//!
//! `ρ(x) = ρ(foot) · exp(−σ(foot)·(½Δs − δ) − σ(x)·½Δs)`, `Δs = r/|q_a|`, `r = |x − P|`, q the offset from the light in voxels,
//! a its longest axis
//!
//! The foot of a voxel lies in the layer before it on the way from the light, at lateral offset −q_b/|q_a|, so far along b and
//! c: f = |q_b|/|q_a|. The four voxels round it are farther from the light, by δ in the mean, than it is: to second order
//! `δ = ½ Σ_b f(1 − f)·∂²r/∂b²` with `∂²r/∂b² = Δx_b²·(1 − (q_b Δx_b/r)²)/r_foot`. Left out, a homogeneous medium would
//! dim too much, by a part that falls with the spacing only as Δx·ln(1/Δx). δ is held below ½Δs, so that light never grows.
//!
//! Voxels within two voxels of the light along every axis take the integral of trilinear σ along their ray instead.
//!
//! A foot never needs a voxel farther from the light along any axis, except that the two columns next to the light's plane
//! need each other in the layer before. A brick that ends at that plane solves the neighbour's column too (its *ghost*), so
//! that no two bricks wait for each other and the result does not depend on where bricks end.

use std::cell::RefCell;

use super::fronts::front_by_front;
use super::shared::Shared;
use super::simd::{dispatch, exp};

use crate::device::{Edge, PointSweep};
use crate::grid::{BrickLayout, Region};

/// reads σ, ρ upstream → writes ρ of the listed bricks; returns the largest change on each brick's downstream faces.
pub(crate) fn sweep_point(
    sweep: &PointSweep,
    layout: &BrickLayout,
    sigma: &[f32],
    rho: &mut [f32],
    fronts: &[&[u32]],
) -> Vec<f32> {
    let held = sweep.held(layout, fronts);
    assert!(sigma.len() >= held && rho.len() >= held && layout.size == sweep.size, "buffers must hold the bricks");
    let rho = Shared::new(rho);
    let compare = fronts.iter().map(|front| front.len()).sum::<usize>() < layout.len();
    let mut changes = front_by_front(layout, fronts, |region| {
        SCRATCH.with_borrow_mut(|scratch| brick(sweep, region, sigma, rho, scratch, compare))
    });
    if !compare {
        changes.fill(f32::INFINITY);
    }
    changes
}

/// A gathered brick with room for one voxel round it.
#[derive(Default)]
struct Scratch {
    axes: [Axis; 3],
    sigma: Vec<f32>,
    rho: Vec<f32>,
    /// A row: what attenuates, and the two parts of the foot.
    line: [Vec<f32>; 3],
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// One axis of a brick. Local index 0 is the voxel before the brick.
#[derive(Default)]
struct Axis {
    /// Grid index of local index 0.
    start: i32,
    /// Local indices that are solved: the brick's own and a ghost.
    first: usize,
    end: usize,
    /// Local index of the layer that other bricks have solved, if there is one.
    up: Option<usize>,
    /// The first local index at or beyond the light, which may lie outside the brick.
    split: usize,
    /// Distance from the light in voxels, and the same where it moves the foot.
    distance: Vec<f32>,
    lateral: Vec<f32>,
    /// Square of the world distance, and of the spacing.
    square: Vec<f32>,
    unit: f32,
    /// Layer counted from the light.
    layer: Vec<i32>,
    /// Local indices to be solved, nearest layers first; the second of a pair is the same layer's other side.
    order: Vec<(usize, Option<usize>)>,
}

impl Axis {
    fn set(&mut self, sweep: &PointSweep, axis: usize, region: &Region) {
        let (start, len) = (region.start[axis] as i32, region.size[axis]);
        let n = sweep.size[axis] as i32;
        let [low, high] = sweep.edges(axis, start, start + len as i32);
        self.start = start - 1;
        self.first = if low == Edge::Ghost { 0 } else { 1 };
        self.end = if high == Edge::Ghost { len + 2 } else { len + 1 };
        self.up = if low == Edge::Upstream { Some(0) } else { (high == Edge::Upstream).then_some(len + 1) };
        self.unit = sweep.spacing[axis] * sweep.spacing[axis];
        self.split = (sweep.cell[axis] - self.start).clamp(0, len as i32 + 2) as usize;
        let Axis { distance, lateral, square, layer, order, .. } = self;
        [&mut *distance, &mut *lateral, &mut *square].into_iter().for_each(Vec::clear);
        layer.clear();
        for i in start - 1..start + len as i32 + 1 {
            let q = sweep.offset(axis, i).abs();
            let k = sweep.layer(axis, i);
            let beside = if i >= sweep.cell[axis] { i - 1 } else { i + 1 };
            distance.push(q);
            // Beyond the light the medium goes on as it is, where the grid ends there.
            lateral.push(if k == 0 && !(0..n).contains(&beside) { 0.0 } else { q });
            square.push((q * sweep.spacing[axis]) * (q * sweep.spacing[axis]));
            layer.push(k);
        }
        order.clear();
        order.extend((self.first..self.end).map(|i| (i, None)));
        order.sort_unstable_by_key(|(i, _)| layer[*i]);
        order.dedup_by(|later, kept| {
            let same = layer[later.0] == layer[kept.0];
            if same {
                kept.1 = Some(later.0);
            }
            same
        });
    }

    /// Local index one voxel nearer to the light.
    #[inline(always)]
    fn toward(&self, i: usize) -> usize {
        if i >= self.split { i.wrapping_sub(1) } else { i + 1 }
    }
}

dispatch! {
    fn brick(sweep: &PointSweep, region: Region, sigma: &[f32], rho: Shared, scratch: &mut Scratch, compare: bool) -> f32 = brick_body;
}

#[inline(always)]
fn brick_body(
    sweep: &PointSweep,
    region: Region,
    sigma: &[f32],
    rho: Shared,
    scratch: &mut Scratch,
    compare: bool,
) -> f32 {
    let size = region.size.map(|n| n + 2);
    let len = size.iter().product();
    let Scratch { axes, sigma: s, rho: r, line } = scratch;
    for (a, axis) in axes.iter_mut().enumerate() {
        axis.set(sweep, a, &region);
    }
    s.clear();
    s.resize(len, 0.0);
    r.clear();
    r.resize(len, 1.0);
    line.iter_mut().for_each(|l| l.resize(size[0].max(l.len()), 0.0));
    gather(sweep, axes, size, sigma, rho, s, r);

    let [x, y, z] = &*axes;
    let rows = [size[0], size[0] * size[1]];
    for &(z0, z1) in &z.order {
        for &(y0, y1) in &y.order {
            let (ky, kz) = (y.layer[y0], z.layer[z0]);
            let members = [Some((y0, z0)), y1.map(|y1| (y1, z0)), z1.map(|z1| (y0, z1)), y1.zip(z1)];
            if ky == 0 || kz == 0 || (ky <= 1 && kz <= 1) {
                // These rows need each other, or lie beside the light.
                for &(x0, x1) in &x.order {
                    for (j, k) in members.into_iter().flatten() {
                        for i in [Some(x0), x1].into_iter().flatten() {
                            let at = i + j * rows[0] + k * rows[1];
                            let near = x.layer[i] <= 1 && ky <= 1 && kz <= 1;
                            r[at] = if near {
                                let p = [(x, i), (y, j), (z, k)].map(|(axis, i)| axis.start + i as i32);
                                exp(-integral(sweep, sigma, p))
                            } else {
                                voxel(axes, [i, j, k], rows, s, r)
                            };
                        }
                    }
                }
            } else {
                for (j, k) in members.into_iter().flatten() {
                    row(axes, [j, k], rows, s, r, line);
                }
            }
        }
    }
    scatter(sweep, &region, size, r, rho, compare)
}

/// Copies σ, and what other bricks have solved of ρ, out of the grid.
#[inline(always)]
fn gather(
    sweep: &PointSweep,
    axes: &[Axis; 3],
    size: [usize; 3],
    sigma: &[f32],
    rho: Shared,
    s: &mut [f32],
    r: &mut [f32],
) {
    let [x, y, z] = axes;
    let n = sweep.size;
    // What is read along an axis: solved here, or upstream; never beyond the grid.
    let span = |axis: &Axis, n: usize| {
        let first = axis.up.map_or(axis.first, |u| u.min(axis.first));
        let end = axis.up.map_or(axis.end, |u| (u + 1).max(axis.end));
        let low = usize::from(axis.start + (first as i32) < 0);
        let high = usize::from(axis.start + end as i32 > n as i32);
        first + low..end - high
    };
    let (columns, x_up) = (span(x, n[0]), x.up.filter(|u| span(x, n[0]).contains(u)));
    for k in span(z, n[2]) {
        for j in span(y, n[1]) {
            let plane = (z.start + k as i32) as usize - sweep.plane;
            let global = (plane * n[1] + (y.start + j as i32) as usize) * n[0];
            let from = global + (x.start + columns.start as i32) as usize;
            let local = (k * size[1] + j) * size[0];
            let count = columns.len();
            s[local + columns.start..][..count].copy_from_slice(&sigma[from..from + count]);
            if y.up == Some(j) || z.up == Some(k) {
                // SAFETY: ρ of earlier fronts, which nobody writes now.
                let row = unsafe { rho.row(from, count) };
                r[local + columns.start..][..count].copy_from_slice(row);
            } else if let Some(u) = x_up {
                r[local + u] = rho.get(global + (x.start + u as i32) as usize);
            }
        }
    }
}

/// Writes the brick's own voxels back; returns the largest change on its downstream faces if `compare`, else 0.
#[inline(always)]
fn scatter(sweep: &PointSweep, region: &Region, size: [usize; 3], r: &[f32], rho: Shared, compare: bool) -> f32 {
    let n = sweep.size;
    let (start, end) = (region.start, region.end());
    // Light leaves a brick through a face unless the light is beyond it.
    let leaves: [[bool; 2]; 3] =
        std::array::from_fn(|a| [start[a] as i32 <= sweep.cell[a], end[a] as i32 > sweep.cell[a]]);
    let face = |a: usize, i: usize| (i == start[a] && leaves[a][0]) || (i + 1 == end[a] && leaves[a][1]);
    let mut change = 0.0f32;
    for k in start[2]..end[2] {
        for j in start[1]..end[1] {
            let new = &r[((k - start[2] + 1) * size[1] + j - start[1] + 1) * size[0] + 1..][..region.size[0]];
            // SAFETY: voxels of this brick, which no other thread reads or writes during this front.
            let old = unsafe { rho.row(((k - sweep.plane) * n[1] + j) * n[0] + start[0], region.size[0]) };
            if compare {
                if face(2, k) || face(1, j) {
                    change = new.iter().zip(old.iter()).fold(change, |m, (n, o)| m.max((n - o).abs()));
                } else {
                    let ends = [(0, leaves[0][0]), (region.size[0] - 1, leaves[0][1])];
                    change = ends.iter().filter(|e| e.1).fold(change, |m, e| m.max((new[e.0] - old[e.0]).abs()));
                }
            }
            old.copy_from_slice(new);
        }
    }
    change
}

/// One voxel, whichever axis is the longest; the lower one where two are equal.
#[inline(always)]
fn voxel(axes: &[Axis; 3], p: [usize; 3], rows: [usize; 2], s: &[f32], r: &[f32]) -> f32 {
    let q: [f32; 3] = std::array::from_fn(|a| axes[a].distance[p[a]]);
    let (a, b, c) = if q[0] >= q[1] && q[0] >= q[2] {
        (0, 1, 2)
    } else if q[1] >= q[2] {
        (1, 0, 2)
    } else {
        (2, 0, 1)
    };
    let inverse = 1.0 / q[a];
    let along = axes[0].square[p[0]] + (axes[1].square[p[1]] + axes[2].square[p[2]]);
    let f = [b, c].map(|l| (axes[l].lateral[p[l]] * inverse).min(1.0));
    let (unit, square) = ([b, c].map(|l| axes[l].unit), [b, c].map(|l| axes[l].square[p[l]]));
    let [at_foot, here] = steps(along, inverse, f, unit, square);
    let stride = [1, rows[0], rows[1]];
    let index = |p: [usize; 3]| p[0] + p[1] * stride[1] + p[2] * stride[2];
    let mut corners = [p; 4];
    for (n, corner) in corners.iter_mut().enumerate() {
        corner[a] = axes[a].toward(p[a]);
        for (bit, l) in [b, c].into_iter().enumerate() {
            // A foot that does not move reads its own column, also where there is no other.
            if n >> bit & 1 == 1 && f[bit] > 0.0 {
                corner[l] = axes[l].toward(p[l]);
            }
        }
    }
    let corners = corners.map(index);
    let w = [(1.0 - f[0]) * (1.0 - f[1]), f[0] * (1.0 - f[1]), (1.0 - f[0]) * f[1], f[0] * f[1]];
    let foot =
        |v: &[f32]| (w[0] * v[corners[0]] + w[1] * v[corners[1]]) + (w[2] * v[corners[2]] + w[3] * v[corners[3]]);
    foot(r) * exp(-(at_foot * foot(s) + here * s[index(p)]))
}

/// Lengths that σ at the foot and σ here are multiplied by: ½Δs − δ and ½Δs.
#[inline(always)]
fn steps(along: f32, inverse: f32, f: [f32; 2], unit: [f32; 2], square: [f32; 2]) -> [f32; 2] {
    let r = along.sqrt();
    let half = 0.5 * r * inverse;
    let bend =
        f[0] * (1.0 - f[0]) * unit[0] * (along - square[0]) + f[1] * (1.0 - f[1]) * unit[1] * (along - square[1]);
    let at_foot = half - 0.5 * bend / (along * r * (1.0 - inverse));
    [if at_foot > 0.0 { at_foot } else { 0.0 }, half]
}

/// One row of voxels along x that needs only itself and rows already solved.
#[inline(always)]
fn row(axes: &[Axis; 3], [j, k]: [usize; 2], rows: [usize; 2], s: &[f32], r: &mut [f32], line: &mut [Vec<f32>; 3]) {
    let [x, y, z] = axes;
    let (qy, qz) = (y.distance[j], z.distance[k]);
    let rest = y.square[j] + z.square[k];
    let (up_y, up_z) = (y.toward(j), z.toward(k));
    let at = |j: usize, k: usize| j * rows[0] + k * rows[1];
    let here = at(j, k);
    // Where y or z is the longest axis: rows of the layer before, which are solved.
    let reach = qy.max(qz);
    let split = x.split.clamp(x.first, x.end);
    let from = x.first + x.distance[x.first..split].partition_point(|q| *q >= reach);
    let to = split + x.distance[split..x.end].partition_point(|q| *q < reach);
    let (straight, across, lateral, other) = if qy >= qz {
        (at(up_y, k), at(up_y, up_z), z.lateral[k], (z.unit, z.square[k]))
    } else {
        (at(j, up_z), at(up_y, up_z), y.lateral[j], (y.unit, y.square[j]))
    };
    let inverse = 1.0 / reach;
    let side = (lateral * inverse).min(1.0);
    let [out, near, own] = line;
    for (range, toward) in [(from..split, 1), (split..to, -1)] {
        if range.is_empty() {
            continue;
        }
        let beside = (range.start as isize + toward) as usize;
        let n = range.len();
        let feet = [straight + range.start, straight + beside, across + range.start, across + beside];
        layered(
            feet.map(|i| &r[i..i + n]),
            feet.map(|i| &s[i..i + n]),
            &s[here + range.start..][..n],
            [&x.lateral[range.clone()], &x.square[range.clone()]],
            [inverse, side, rest],
            [x.unit, other.0, other.1],
            &mut out[..n],
        );
        r[here + range.start..][..n].copy_from_slice(&out[..n]);
    }
    // Where x is: all but the voxel before it in the row is solved.
    for (range, toward) in [(x.first..from, 1), (to..x.end, -1)] {
        if range.is_empty() {
            continue;
        }
        let beside = (range.start as isize + toward) as usize;
        let n = range.len();
        let feet = [here + beside, at(up_y, k) + beside, at(j, up_z) + beside, at(up_y, up_z) + beside];
        along_row(
            feet.map(|i| &r[i..i + n]),
            feet.map(|i| &s[i..i + n]),
            &s[here + range.start..][..n],
            [&x.distance[range.clone()], &x.square[range.clone()]],
            [y.lateral[j], z.lateral[k], rest],
            [(y.unit, y.square[j]), (z.unit, z.square[k])],
            [&mut out[..n], &mut near[..n], &mut own[..n]],
        );
        let r = &mut r[here..][..x.end.max(x.up.map_or(0, |u| u + 1))];
        if toward < 0 {
            let mut before = r[range.start - 1];
            for (i, at) in range.enumerate() {
                before = out[i] * (own[i] * before + near[i]);
                r[at] = before;
            }
        } else {
            let mut before = r[range.end];
            for (i, at) in range.enumerate().rev() {
                before = out[i] * (own[i] * before + near[i]);
                r[at] = before;
            }
        }
    }
}

/// Voxels whose layer before is another row. `feet`: straight, beside along x, across, both.
#[inline(always)]
fn layered(
    rho: [&[f32]; 4],
    sigma_up: [&[f32]; 4],
    sigma: &[f32],
    [lateral, square]: [&[f32]; 2],
    [inverse, side, rest]: [f32; 3],
    [unit, unit_side, square_side]: [f32; 3],
    out: &mut [f32],
) {
    let n = out.len();
    let ([a, b, c, d], [sa, sb, sc, sd]) = (rho.map(|v| &v[..n]), sigma_up.map(|v| &v[..n]));
    let (sigma, lateral, square) = (&sigma[..n], &lateral[..n], &square[..n]);
    for i in 0..n {
        let f = lateral[i] * inverse;
        let f = if f < 1.0 { f } else { 1.0 };
        let [at_foot, here] = steps(square[i] + rest, inverse, [f, side], [unit, unit_side], [square[i], square_side]);
        let rho_foot = (1.0 - side) * ((1.0 - f) * a[i] + f * b[i]) + side * ((1.0 - f) * c[i] + f * d[i]);
        let sigma_foot = (1.0 - side) * ((1.0 - f) * sa[i] + f * sb[i]) + side * ((1.0 - f) * sc[i] + f * sd[i]);
        out[i] = rho_foot * exp(-(at_foot * sigma_foot + here * sigma[i]));
    }
}

/// Voxels whose layer before is in the same row: what attenuates, the part of the foot in other rows, and the weight of
/// the part in this one.
#[inline(always)]
fn along_row(
    rho: [&[f32]; 4],
    sigma_up: [&[f32]; 4],
    sigma: &[f32],
    [distance, square]: [&[f32]; 2],
    [lateral_y, lateral_z, rest]: [f32; 3],
    [(unit_y, square_y), (unit_z, square_z)]: [(f32, f32); 2],
    [out, near, own]: [&mut [f32]; 3],
) {
    let n = out.len();
    let ([_, b, c, d], [sa, sb, sc, sd]) = (rho.map(|v| &v[..n]), sigma_up.map(|v| &v[..n]));
    let (sigma, distance, square) = (&sigma[..n], &distance[..n], &square[..n]);
    let (near, own) = (&mut near[..n], &mut own[..n]);
    for i in 0..n {
        let inverse = 1.0 / distance[i];
        let (fy, fz) = (lateral_y * inverse, lateral_z * inverse);
        let (fy, fz) = (if fy < 1.0 { fy } else { 1.0 }, if fz < 1.0 { fz } else { 1.0 });
        let [at_foot, here] = steps(square[i] + rest, inverse, [fy, fz], [unit_y, unit_z], [square_y, square_z]);
        let w = [(1.0 - fy) * (1.0 - fz), fy * (1.0 - fz), (1.0 - fy) * fz, fy * fz];
        let sigma_foot = (w[0] * sa[i] + w[1] * sb[i]) + (w[2] * sc[i] + w[3] * sd[i]);
        out[i] = exp(-(at_foot * sigma_foot + here * sigma[i]));
        near[i] = w[1] * b[i] + (w[2] * c[i] + w[3] * d[i]);
        own[i] = w[0];
    }
}

/// Optical depth from the light to voxel `p`, at most two voxels away along each axis: exact for trilinear σ, which is cubic
/// along a line between planes of voxels, so that Simpson's rule has no error there. Clamped in the rim, 0 outside the box.
fn integral(sweep: &PointSweep, sigma: &[f32], p: [i32; 3]) -> f32 {
    let n = sweep.size;
    let d: [f32; 3] = std::array::from_fn(|a| sweep.offset(a, p[a]));
    // Fractions of the way where the ray enters the box, and where it passes a plane of voxels.
    let mut enter = 0.0f32;
    for a in 0..3 {
        let (q, beyond) = (d[a].abs(), if d[a] > 0.0 { p[a] } else { n[a] as i32 - 1 - p[a] });
        // The wall is `beyond + ½` back from the voxel.
        let wall = beyond as f32 + 0.5;
        if q > wall {
            enter = enter.max(1.0 - wall / q);
        }
    }
    let mut at = [1.0f32; 3];
    for a in 0..3 {
        let q = d[a].abs();
        if q > 1.0 {
            at[a] = (1.0 - 1.0 / q).max(enter);
        }
    }
    at.sort_unstable_by(f32::total_cmp);
    let value = |t: f32| {
        let mut first = [0usize; 3];
        let mut f = [0.0f32; 3];
        for a in 0..3 {
            let last = n[a] as f32 - 1.0;
            let x = (p[a] as f32 - (1.0 - t) * d[a]).max(0.0).min(last);
            let i = (x as usize).min(n[a].saturating_sub(2));
            first[a] = i;
            f[a] = x - i as f32;
        }
        let mut sum = 0.0;
        for corner in 0..8 {
            let mut weight = 1.0;
            let mut i = first;
            for a in 0..3 {
                if corner >> a & 1 == 1 {
                    weight *= f[a];
                    i[a] = (i[a] + 1).min(n[a] - 1);
                } else {
                    weight *= 1.0 - f[a];
                }
            }
            sum += weight * sigma[((i[2] - sweep.plane) * n[1] + i[1]) * n[0] + i[0]];
        }
        sum
    };
    let mut depth = 0.0;
    let mut from = enter;
    for to in [at[0], at[1], at[2], 1.0] {
        if to > from {
            depth += (to - from) * (1.0 / 6.0) * (value(from) + 4.0 * value(0.5 * (from + to)) + value(to));
            from = to;
        }
    }
    let length: f32 = (0..3).map(|a| (d[a] * sweep.spacing[a]) * (d[a] * sweep.spacing[a])).sum();
    depth * length.sqrt()
}
