//! Upwind convection (Zhang & Ma 2013, (16)–(20)): `ρ' = (1 − σ_a)(ρ − ½Σ_a |d_a| (ρ − ρ_a))`, ρ_a the upstream neighbour along
//! axis a, and its fixed point `ρ = T/s · Σ|d_a| ρ_a`, `T = (1 − σ_a)s/(s + σ_a(2 − s))`, `s = Σ|d_a|`.
//!
//! Three ways to the same fixed point: `strips` iterates layer by layer, `whole` all voxels at once, and `ordered` visits every
//! voxel once, after its upstream neighbours.

use std::cell::RefCell;

use super::simd::{dispatch, exp};
use crate::device::convection::{Opacity, Rays};

pub(super) mod ordered;
pub(super) mod strips;
pub(super) mod whole;

/// Coefficients of a row of voxels along x.
#[derive(Default)]
struct Row {
    /// |d| along x, y, z.
    way: [Vec<f32>; 3],
    /// G where voxels are never updated, negative elsewhere.
    fixed: Vec<f32>,
    /// What the kernel makes of them.
    factor: Vec<f32>,
    constant: Vec<f32>,
    /// Upstream values from outside the grid, or moved into place.
    upstream: [Vec<f32>; 3],
}

impl Row {
    fn resize(&mut self, n: usize) {
        let all = self.way.iter_mut().chain(&mut self.upstream);
        for row in all.chain([&mut self.fixed, &mut self.factor, &mut self.constant]) {
            row.resize(n, 0.0);
        }
    }
}

thread_local! {
    static ROW: RefCell<Row> = RefCell::default();
}

/// Runs with this thread's row of at least `n` values.
fn with_row<T>(n: usize, run: impl FnOnce(&mut Row) -> T) -> T {
    ROW.with_borrow_mut(|row| {
        row.resize(n);
        run(row)
    })
}

/// Fills `way` and `fixed` for voxels from (i, j, k) on.
#[inline(always)]
fn ways(rays: &Rays, [i, j, k]: [usize; 3], n: usize, row: &mut Row) {
    match *rays {
        Rays::Parallel { way } => {
            for (out, d) in row.way.iter_mut().zip(way) {
                out[..n].fill(d.abs());
            }
            row.fixed[..n].fill(-1.0);
        }
        Rays::Central { position, spacing, ball, falloff } => {
            let [dx, dy, dz] = &mut row.way;
            let (dx, dy, dz, fixed) = (&mut dx[..n], &mut dy[..n], &mut dz[..n], &mut row.fixed[..n]);
            let (oy, oz) = (j as f32 - position[1], k as f32 - position[2]);
            let (y, z) = (oy * spacing[1], oz * spacing[2]);
            for l in 0..n {
                let ox = (i + l) as u32 as f32 - position[0];
                let x = ox * spacing[0];
                let square = x * x + y * y + z * z;
                let r = square.sqrt();
                let along = |o: f32, x: f32, spacing: f32| if o.abs() > 0.5 { x.abs() / (r * spacing) } else { 0.0 };
                dx[l] = along(ox, x, spacing[0]);
                dy[l] = along(oy, y, spacing[1]);
                dz[l] = along(oz, z, spacing[2]);
                let g = exp(-square * falloff);
                fixed[l] = if r < ball { g } else { -1.0 };
            }
        }
    }
}

/// What enters at a row of voxels, `face` being half a voxel off along the axis that light enters by; one value.
#[inline(always)]
fn entering(rays: &Rays, at: [f32; 3]) -> f32 {
    match *rays {
        Rays::Parallel { .. } => 1.0,
        Rays::Central { position, spacing, falloff, .. } => {
            let square: f32 = (0..3).map(|a| ((at[a] - position[a]) * spacing[a]).powi(2)).sum();
            exp(-square * falloff)
        }
    }
}

/// A row of what enters through a face across y or z.
#[inline(always)]
fn entering_row(rays: &Rays, i: usize, [y, z]: [f32; 2], out: &mut [f32]) {
    for (l, out) in out.iter_mut().enumerate() {
        *out = entering(rays, [(i + l) as u32 as f32, y, z]);
    }
}

/// `T/s` for each σ_t; 1 where nothing moves at all, so that it stays finite.
#[inline(always)]
fn transmitted(opacity: Opacity, s: f32, sigma: f32) -> f32 {
    let s = if s > 0.0 { s } else { 1.0 };
    match opacity {
        Opacity::Calibrated { length } => {
            let per = 1.0 / s;
            exp(-(length * sigma) * per) * per
        }
        Opacity::Literal { length } => {
            let keep = exp(-(length * sigma));
            keep / (s + (1.0 - keep) * (2.0 - s))
        }
    }
}

/// `1 − σ_a` for each σ_t.
#[inline(always)]
fn kept(opacity: Opacity, s: f32, sigma: f32) -> f32 {
    match opacity {
        Opacity::Calibrated { length } => {
            let s = if s > 0.0 { s } else { 1.0 };
            let t = exp(-(length * sigma) * (1.0 / s));
            2.0 * t / (s + t * (2.0 - s))
        }
        Opacity::Literal { length } => exp(-(length * sigma)),
    }
}

/// Largest difference of two rows, in lanes.
#[inline(always)]
fn largest_change(a: &[f32], b: &[f32]) -> f32 {
    let mut most = [0.0f32; 16];
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<16>(), b.as_chunks::<16>());
    for (a, b) in a.iter().zip(b) {
        for lane in 0..16 {
            let change = (a[lane] - b[lane]).abs();
            most[lane] = if change > most[lane] { change } else { most[lane] };
        }
    }
    let rest = a_rest.iter().zip(b_rest).map(|(a, b)| (a - b).abs());
    most.into_iter().chain(rest).fold(0.0, f32::max)
}

dispatch! {
    /// `1 − σ_a` of a row where the way is the same everywhere.
    fn kept_row(opacity: Opacity, s: f32, sigma: &[f32], out: &mut [f32]) = kept_row_body;
}

#[inline(always)]
fn kept_row_body(opacity: Opacity, s: f32, sigma: &[f32], out: &mut [f32]) {
    match opacity {
        Opacity::Calibrated { length } => {
            let opacity = Opacity::Calibrated { length };
            out.iter_mut().zip(sigma).for_each(|(o, v)| *o = kept(opacity, s, *v));
        }
        Opacity::Literal { length } => {
            let opacity = Opacity::Literal { length };
            out.iter_mut().zip(sigma).for_each(|(o, v)| *o = kept(opacity, s, *v));
        }
    }
}
