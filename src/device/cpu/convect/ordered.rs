//! The fixed point in one pass: `ρ = T/s · Σ|d_a| ρ_a`, every voxel after its upstream neighbours. Boxes of a front are independent.

use rayon::prelude::*;

use super::{Row, entering, entering_row, largest_change, transmitted, ways, with_row};
use crate::device::convection::{Convection, Opacity};
use crate::device::cpu::fronts::front_by_front;
use crate::device::cpu::shared::Shared;
use crate::device::cpu::simd::dispatch;
use crate::grid::{BrickLayout, Region};

/// reads σ, ρ upstream → writes ρ of the listed bricks; returns the largest change on each brick's downstream faces.
pub(crate) fn convect(
    convection: &Convection,
    layout: &BrickLayout,
    sigma: &[f32],
    rho: &mut [f32],
    fronts: &[&[u32]],
) -> Vec<f32> {
    let voxels: usize = convection.size.iter().product();
    assert!(
        sigma.len() >= voxels && rho.len() >= voxels && layout.size == convection.size,
        "buffers must hold the grid"
    );
    let shared = Shared::new(rho);
    let listed: usize = fronts.iter().map(|f| f.len()).sum();
    if listed == layout.len() {
        whole(convection, sigma, shared);
        return vec![f32::INFINITY; listed];
    }
    front_by_front(layout, fronts, |region| solve(convection, region, sigma, shared, true))
}

/// The whole grid: boxes of whole rows, of which those on a diagonal are independent. Bit for bit what the bricks give.
fn whole(convection: &Convection, sigma: &[f32], rho: Shared) {
    const EDGE: usize = 16;
    let [nx, ny, nz] = convection.size;
    // Bricks of a grid that is one brick wide along x.
    let flat = BrickLayout::new([1, ny, nz], EDGE);
    for front in (Convection { size: [1, ny, nz], ..*convection }).fronts(&flat) {
        front.par_iter().with_max_len(1).for_each(|&b| {
            let mut region = flat.region(b as usize);
            region.size[0] = nx;
            solve(convection, region, sigma, rho, false);
        });
    }
}

/// Solves a region part by part.
fn solve(convection: &Convection, region: Region, sigma: &[f32], rho: Shared, watch: bool) -> f32 {
    with_row(region.size[0], |row| {
        let solve = |part| solve_box(convection, part, sigma, rho, row, watch);
        convection.parts(region).into_iter().map(solve).fold(0.0, f32::max)
    })
}

dispatch! {
    fn solve_box(convection: &Convection, region: Region, sigma: &[f32], rho: Shared, row: &mut Row, watch: bool) -> f32 = solve_body;
}

#[inline(always)]
fn solve_body(convection: &Convection, region: Region, sigma: &[f32], rho: Shared, row: &mut Row, watch: bool) -> f32 {
    let mut most = 0.0f32;
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
            let [earlier, outside_y, outside_z] = &mut row.upstream;
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
            let (factor, constant, fixed) = (&mut row.factor[..n], &mut row.constant[..n], &row.fixed[..n]);
            let (y, z) = (&y[..n], &z[..n]);
            coefficients(*opacity, [dx, dy, dz], sigma, constant);
            split([dx, dy, dz], fixed, [y, z], factor, constant);
            // SAFETY: a row of this box, which nobody else reads or writes on this front.
            let out = unsafe { rho.row(at(j, k), n) };
            // The last row along y or z is a face that light leaves by; of the others only the end is.
            let face = ly + 1 == region.size[1] || lz + 1 == region.size[2];
            let end = if above[0] { n - 1 } else { 0 };
            let watched = if face { 0..n } else { end..end + 1 };
            if watch {
                earlier[watched.clone()].copy_from_slice(&out[watched.clone()]);
            }
            let mut compare = |out: &[f32]| {
                if watch {
                    most = most.max(largest_change(&out[watched.clone()], &earlier[watched.clone()]));
                }
            };
            if factor.iter().all(|f| *f == 0.0) {
                out.copy_from_slice(constant);
                compare(out);
                continue;
            }
            let (first, up_x, face_x) = place(0, 0);
            let value = match up_x {
                Some(x) => rho.get(at(j, k) + x - i),
                None => entering(rays, [face_x, j as f32, k as f32]),
            };
            let cells = out.iter_mut().zip(factor.iter().zip(constant.iter()));
            let step = |value: f32, (out, (factor, constant)): (&mut f32, (&f32, &f32))| {
                *out = factor * value + constant;
                *out
            };
            if first == i {
                cells.fold(value, step)
            } else {
                cells.rev().fold(value, step)
            };
            compare(out);
        }
    }
    most
}

/// `T/s` of a row.
#[inline(always)]
fn coefficients(opacity: Opacity, [dx, dy, dz]: [&[f32]; 3], sigma: &[f32], out: &mut [f32]) {
    let n = out.len();
    let (dx, dy, dz, sigma) = (&dx[..n], &dy[..n], &dz[..n], &sigma[..n]);
    let mut fill = |opacity: Opacity| {
        for l in 0..n {
            out[l] = transmitted(opacity, dx[l] + dy[l] + dz[l], sigma[l]);
        }
    };
    match opacity {
        Opacity::Calibrated { length } => fill(Opacity::Calibrated { length }),
        Opacity::Literal { length } => fill(Opacity::Literal { length }),
    }
}

/// `T/s` in `constant` → what is passed on along x, and what comes from y and z; what is fixed passes nothing on.
#[inline(always)]
fn split([dx, dy, dz]: [&[f32]; 3], fixed: &[f32], [y, z]: [&[f32]; 2], factor: &mut [f32], constant: &mut [f32]) {
    let n = constant.len();
    let (dx, dy, dz, fixed, y, z) = (&dx[..n], &dy[..n], &dz[..n], &fixed[..n], &y[..n], &z[..n]);
    let factor = &mut factor[..n];
    for l in 0..n {
        factor[l] = if fixed[l] < 0.0 { constant[l] * dx[l] } else { 0.0 };
    }
    for l in 0..n {
        let across = constant[l] * (dy[l] * y[l] + dz[l] * z[l]);
        constant[l] = if fixed[l] < 0.0 { across } else { fixed[l] };
    }
}
