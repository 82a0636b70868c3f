//! Irradiance of a lamp per unit of radiant intensity: `E(x) = ρ(x) · t²(3 − 2t)/max(r, R)²`, t the cone's edge, see [`Lamp`].

use std::ops::Range;

use glam::Vec3;
use rayon::prelude::*;

use super::simd::dispatch;
use crate::device::{Falloff, Lamp};
use crate::grid::Grid;

/// reads ρ → writes E.
pub(crate) fn irradiate(lamp: &Lamp, grid: &Grid, planes: Range<usize>, rho: &[f32], out: &mut [f32]) {
    let [nx, ny, _] = grid.size;
    let falloff = lamp.on(grid, Lamp::PARTS);
    let rows = out[..nx * ny * planes.len()].par_chunks_exact_mut(nx).zip(rho.par_chunks_exact(nx));
    let at = |n: usize| [n % ny, planes.start + n / ny];
    rows.enumerate().with_min_len(16).for_each(|(n, (out, rho))| row(&falloff, at(n), rho, out));
}

dispatch! {
    fn row(falloff: &Falloff, at: [usize; 2], rho: &[f32], out: &mut [f32]) = row_body;
}

#[inline(always)]
fn row_body(falloff: &Falloff, [j, k]: [usize; 2], rho: &[f32], out: &mut [f32]) {
    let Falloff { position: p, spacing: h, floor, axis, outer, slope, cosine } = *falloff;
    let (y, z) = ((j as f32 - p.y) * h.y, (k as f32 - p.z) * h.z);
    let (rest, along) = (y * y + z * z, y * axis.y + z * axis.z);
    for (i, (o, rho)) in out.iter_mut().zip(rho).enumerate() {
        let x = (i as i32 as f32 - p.x) * h.x;
        let square = x * x + rest;
        let r = if square > 1e-30 { square.sqrt() } else { 1e-15 };
        let t = ((x * axis.x + along) / r - outer) * slope;
        let t = t.clamp(0.0, 1.0);
        *o = rho * (shape(t, cosine) / if square > floor { square } else { floor });
    }
    let near = |at: usize, p: f32| (at as f32 - p).abs() <= Lamp::NEAR;
    if near(j, p.y) && near(k, p.z) {
        let first = ((p.x - Lamp::NEAR).ceil().max(0.0) as usize).min(out.len());
        for (i, o) in out.iter_mut().enumerate().skip(first).take_while(|(i, _)| *i as f32 <= p.x + Lamp::NEAR) {
            *o = rho[i] * mean(falloff, [i, j, k]);
        }
    }
}

/// Share of the light at t of a cone's edge.
#[inline(always)]
pub(super) fn shape(t: f32, cosine: f32) -> f32 {
    let smooth = t * t * (3.0 - 2.0 * t);
    smooth + cosine * (t - smooth)
}

/// Mean falloff of a voxel's 4³ points.
fn mean(falloff: &Falloff, at: [usize; 3]) -> f32 {
    let Falloff { position, spacing, floor, axis, outer, slope, cosine } = *falloff;
    let parts = Lamp::PARTS;
    let mut sum = 0.0;
    for n in 0..parts.pow(3) {
        let part = [n % parts, n / parts % parts, n / (parts * parts)];
        let x = Vec3::from(std::array::from_fn(|a| at[a] as f32 + (part[a] as f32 + 0.5) / parts as f32 - 0.5));
        let d = (x - position) * spacing;
        let square = d.length_squared();
        let t = ((d.dot(axis) / square.max(1e-30).sqrt() - outer) * slope).clamp(0.0, 1.0);
        sum += shape(t, cosine) / square.max(floor);
    }
    sum / parts.pow(3) as f32
}
