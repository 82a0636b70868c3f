//! What of a light reaches a voxel: `out = ρ · cone(x) · 1/r²`, see [`Spread`].

use rayon::prelude::*;

use super::simd::dispatch;
use crate::device::convection::Spread;

/// reads ρ → writes it as the light spreads.
pub(crate) fn spread(size: [usize; 3], spread: &Spread, rho: &[f32], out: &mut [f32]) {
    let [nx, ny, nz] = size;
    out[..nx * ny * nz].par_chunks_exact_mut(nx).enumerate().with_min_len(16).for_each(|(row, out)| {
        spread_row(spread, [row % ny, row / ny], &rho[row * nx..][..nx], out);
    });
}

dispatch! {
    fn spread_row(spread: &Spread, at: [usize; 2], rho: &[f32], out: &mut [f32]) = spread_body;
}

#[inline(always)]
fn spread_body(spread: &Spread, [j, k]: [usize; 2], rho: &[f32], out: &mut [f32]) {
    let Spread { position, spacing, axis, inner, outer, nearest } = *spread;
    let (y, z) = ((j as f32 - position[1]) * spacing[1], (k as f32 - position[2]) * spacing[2]);
    for (i, (out, rho)) in out.iter_mut().zip(rho).enumerate() {
        let x = (i as u32 as f32 - position[0]) * spacing[0];
        let square = x * x + y * y + z * z;
        let cos = (x * axis[0] + y * axis[1] + z * axis[2]) / square.sqrt().max(f32::MIN_POSITIVE);
        let t = ((cos - outer) / (inner - outer)).clamp(0.0, 1.0);
        let falloff = if nearest > 0.0 { 1.0 / square.max(nearest) } else { 1.0 };
        *out = rho * falloff * (t * t * (3.0 - 2.0 * t));
    }
}
