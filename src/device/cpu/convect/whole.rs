//! One iteration (16) of all voxels at once.

use rayon::prelude::*;

use super::{Row, entering, entering_row, kept, largest_change, ways, with_row};
use crate::device::convection::{Convection, Opacity};
use crate::device::cpu::simd::dispatch;

/// reads σ, ρ → writes ρ after one iteration; returns the largest change.
pub(crate) fn convect(convection: &Convection, sigma: &[f32], before: &[f32], rho: &mut [f32]) -> f32 {
    let [nx, ny, nz] = convection.size;
    let rows = rho[..nx * ny * nz].par_chunks_exact_mut(nx).enumerate().with_min_len(16);
    rows.map(|(index, out)| with_row(nx, |row| iterate(convection, [index % ny, index / ny], sigma, before, out, row)))
        .reduce(|| 0.0, f32::max)
}

dispatch! {
    fn iterate(convection: &Convection, at: [usize; 2], sigma: &[f32], before: &[f32], out: &mut [f32], row: &mut Row) -> f32 = iterate_body;
}

#[inline(always)]
fn iterate_body(
    convection: &Convection,
    [j, k]: [usize; 2],
    sigma: &[f32],
    before: &[f32],
    out: &mut [f32],
    row: &mut Row,
) -> f32 {
    let Convection { size, rays, opacity } = convection;
    let n = size[0];
    let centre = convection.centre();
    ways(rays, [0, j, k], n, row);
    let line = |j: usize, k: usize| &before[(k * size[1] + j) * n..][..n];
    let upstream = |a: usize, at: usize| {
        let above = at as i32 >= centre[a];
        let up = if above { at.checked_sub(1) } else { Some(at + 1).filter(|u| *u < size[a]) };
        (up, if above { at as f32 - 0.5 } else { at as f32 + 0.5 })
    };
    let [x, y, z] = row.upstream.each_mut().map(|u| &mut u[..n]);
    let here = line(j, k);
    // Above the centre the value before, below it the value after; the centre's own has no weight.
    let split = centre[0].clamp(0, n as i32) as usize;
    if split < n {
        x[split] = match split.checked_sub(1) {
            Some(up) => here[up],
            None => entering(rays, [-0.5, j as f32, k as f32]),
        };
        x[split + 1..].copy_from_slice(&here[split..n - 1]);
    }
    if split > 0 {
        x[..split - 1].copy_from_slice(&here[1..split]);
        x[split - 1] = if split < n { here[split] } else { entering(rays, [n as f32 - 0.5, j as f32, k as f32]) };
    }
    match upstream(1, j) {
        (Some(j), _) => y.copy_from_slice(line(j, k)),
        (None, face) => entering_row(rays, 0, [face, k as f32], y),
    }
    match upstream(2, k) {
        (Some(k), _) => z.copy_from_slice(line(j, k)),
        (None, face) => entering_row(rays, 0, [j as f32, face], z),
    }
    let sigma = &sigma[(k * size[1] + j) * n..][..n];
    let [dx, dy, dz] = row.way.each_ref().map(|d| &d[..n]);
    let fixed = &row.fixed[..n];
    let out = &mut out[..n];
    let mut fill = |opacity: Opacity| {
        for l in 0..n {
            let s = dx[l] + dy[l] + dz[l];
            let moved = dx[l] * x[l] + dy[l] * y[l] + dz[l] * z[l];
            let value = kept(opacity, s, sigma[l]) * ((1.0 - 0.5 * s) * here[l] + 0.5 * moved);
            out[l] = if fixed[l] < 0.0 { value } else { fixed[l] };
        }
    };
    match *opacity {
        Opacity::Calibrated { length } => fill(Opacity::Calibrated { length }),
        Opacity::Literal { length } => fill(Opacity::Literal { length }),
    }
    largest_change(here, out)
}
