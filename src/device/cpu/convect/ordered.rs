//! The fixed point in one pass: `ρ = T/s · Σ|d_a| ρ_a`, every voxel after its upstream neighbours. Boxes of a front are independent.

use rayon::prelude::*;

use super::{Row, entering, entering_row, transmitted, ways, with_row};
use crate::device::convection::{Convection, Opacity};
use crate::device::cpu::simd::dispatch;
use crate::device::cpu::sweep::Shared;
use crate::grid::Region;

/// reads σ → writes ρ.
pub(crate) fn convect(convection: &Convection, sigma: &[f32], rho: &mut [f32]) {
    let shared = Shared::new(rho);
    for front in convection.fronts(Convection::EDGE) {
        let solve = |region: &Region| {
            with_row(region.size[0], |row| solve_box(convection, *region, sigma, shared, row));
        };
        match &front[..] {
            [one] => solve(one),
            many => many.par_iter().with_max_len(1).for_each(solve),
        }
    }
}

dispatch! {
    fn solve_box(convection: &Convection, region: Region, sigma: &[f32], rho: Shared, row: &mut Row) = solve_body;
}

#[inline(always)]
fn solve_body(convection: &Convection, region: Region, sigma: &[f32], rho: Shared, row: &mut Row) {
    let Convection { size, rays, opacity } = convection;
    let centre = convection.centre();
    let above: [bool; 3] = std::array::from_fn(|a| region.start[a] as i32 >= centre[a]);
    let (n, i) = (region.size[0], region.start[0]);
    // Index along an axis, the one upstream of it if there is one in the grid, and the face between the two.
    let place = |a: usize, l: usize| {
        let at = if above[a] { region.start[a] + l } else { region.end()[a] - 1 - l };
        let upstream = if above[a] { at.checked_sub(1) } else { Some(at + 1).filter(|u| *u < size[a]) };
        // The centre's own has no upstream: what would be read has no weight and may not be solved yet.
        let upstream = upstream.filter(|_| at as i32 != centre[a]);
        (at, upstream, if above[a] { at as f32 - 0.5 } else { at as f32 + 0.5 })
    };
    for lz in 0..region.size[2] {
        let (k, up_z, face_z) = place(2, lz);
        for ly in 0..region.size[1] {
            let (j, up_y, face_y) = place(1, ly);
            ways(rays, [i, j, k], n, row);
            let at = |j: usize, k: usize| (k * size[1] + j) * size[0] + i;
            let [_, outside_y, outside_z] = &mut row.upstream;
            let y: &[f32] = match up_y {
                Some(j) => rho.read(at(j, k), n),
                None => {
                    entering_row(rays, i, [face_y, k as f32], &mut outside_y[..n]);
                    &outside_y[..n]
                }
            };
            let z: &[f32] = match up_z {
                Some(k) => rho.read(at(j, k), n),
                None => {
                    entering_row(rays, i, [j as f32, face_z], &mut outside_z[..n]);
                    &outside_z[..n]
                }
            };
            let sigma = &sigma[at(j, k)..][..n];
            let [dx, dy, dz] = row.way.each_ref().map(|d| &d[..n]);
            let (factor, constant) = (&mut row.factor[..n], &mut row.constant[..n]);
            let mut fill = |opacity: Opacity| {
                for l in 0..n {
                    let part = transmitted(opacity, dx[l] + dy[l] + dz[l], sigma[l]);
                    let fixed = row.fixed[l];
                    factor[l] = if fixed < 0.0 { part * dx[l] } else { 0.0 };
                    constant[l] = if fixed < 0.0 { part * (dy[l] * y[l] + dz[l] * z[l]) } else { fixed };
                }
            };
            match *opacity {
                Opacity::Calibrated { length } => fill(Opacity::Calibrated { length }),
                Opacity::Literal { length } => fill(Opacity::Literal { length }),
            }
            // SAFETY: a row of this box, which nobody else reads or writes on this front.
            let out = unsafe { rho.row(at(j, k), n) };
            if factor.iter().fold(0.0f32, |m, f| m.max(*f)) == 0.0 {
                out.copy_from_slice(constant);
                continue;
            }
            let (first, up_x, face_x) = place(0, 0);
            let mut value = match up_x {
                Some(x) => rho.get(at(j, k) + x - i),
                None => entering(rays, [face_x, j as f32, k as f32]),
            };
            let mut one = |l: usize| {
                value = factor[l] * value + constant[l];
                out[l] = value;
            };
            if first == i { (0..n).for_each(&mut one) } else { (0..n).rev().for_each(&mut one) }
        }
    }
}
