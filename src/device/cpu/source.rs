//! Source function of scattered light (light.md, first-collision-source ordinates):
//!
//! `S(Ω) = [σ_s*/4π · (φ + ΣE_l + 3g* Ω·(J + ΣE_l u_l)) + emission] / σ*`, 0 where σ* = 0.

use glam::DVec3;
use rayon::prelude::*;

use super::host;
use super::simd::dispatch;
use crate::device::{SourceTerm, Travel};
use crate::grid::Grid;

/// Values worked on at a time: a few arrays of this length fit in a first-level cache.
const CHUNK: usize = 1 << 11;

/// reads optics, first-collision light, φ, J → writes the isotropic part of S and its gradient.
pub(crate) fn source(term: &SourceTerm, source: &mut [f32], gradient: Option<[&mut [f32]; 3]>) {
    match (gradient, term.current) {
        (Some([x, y, z]), Some(_)) => source
            .par_chunks_mut(CHUNK)
            .zip(x.par_chunks_mut(CHUNK).zip(y.par_chunks_mut(CHUNK)).zip(z.par_chunks_mut(CHUNK)))
            .enumerate()
            .for_each(|(n, (s, ((x, y), z)))| chunk(term, n * CHUNK, s, Some([x, y, z]))),
        _ => source.par_chunks_mut(CHUNK).enumerate().for_each(|(n, s)| chunk(term, n * CHUNK, s, None)),
    }
}

dispatch! {
    fn chunk(term: &SourceTerm, start: usize, source: &mut [f32], gradient: Option<[&mut [f32]; 3]>) = chunk_body;
}

#[inline(always)]
fn chunk_body(term: &SourceTerm, start: usize, source: &mut [f32], gradient: Option<[&mut [f32]; 3]>) {
    let n = source.len();
    let values = |buffer| &host(buffer)[start..][..n];
    let (sigma, scattering) = (values(term.sigma), values(term.scattering));
    sum(source, values(term.phi), term.first.iter().map(|&(e, irradiance, _)| (values(e), irradiance)));
    match term.emission.map(values) {
        Some(emission) => {
            for i in 0..n {
                source[i] = divided(scattering[i] * PER_SPHERE * source[i] + emission[i], sigma[i]);
            }
        }
        None => scatter(source, scattering, PER_SPHERE, sigma),
    }
    if let (Some(gradient), Some((current, weight))) = (gradient, term.current) {
        for (axis, out) in gradient.into_iter().enumerate() {
            let light = term.first.iter().filter_map(|&(e, irradiance, travel)| match travel {
                Travel::Along(u) => Some((values(e), irradiance * u[axis])),
                Travel::From(_) => None,
            });
            sum(out, values(current[axis]), light);
            for &(e, irradiance, travel) in term.first {
                if let Travel::From(position) = travel {
                    let [nx, ny, _] = term.grid.size;
                    spread(term.grid, position, axis, start + nx * ny * term.plane, (values(e), irradiance), out);
                }
            }
            scatter(out, scattering, PER_SPHERE * weight, sigma);
        }
    }
}

/// `out += irradiance·e·u` with u the component along `axis` of the way from `position`.
#[inline(always)]
fn spread(
    grid: &Grid,
    position: DVec3,
    axis: usize,
    start: usize,
    (fluence, irradiance): (&[f32], f32),
    out: &mut [f32],
) {
    let [nx, ny, _] = grid.size;
    let h = DVec3::from(grid.spacing);
    let p = ((position - DVec3::from(grid.origin)) / h).as_vec3();
    let (h, near) = (h.as_vec3(), grid.mean_spacing() as f32);
    let mut done = 0;
    while done < out.len() {
        // The rest of a row.
        let at = start + done;
        let (first, row) = (at % nx, at / nx);
        let n = (nx - first).min(out.len() - done);
        let (y, z) = (((row % ny) as f32 - p.y) * h.y, ((row / ny) as f32 - p.z) * h.z);
        let rest = y * y + z * z;
        let (out, fluence) = (&mut out[done..done + n], &fluence[done..done + n]);
        let part = [0.0, y, z][axis];
        let scale = if axis == 0 { 1.0 } else { 0.0 };
        for i in 0..n {
            let x = ((first + i) as i32 as f32 - p.x) * h.x;
            let r = (x * x + rest).sqrt();
            let r = if r > near { r } else { near };
            out[i] += irradiance * fluence[i] * ((part + scale * x) / r);
        }
        done += n;
    }
}

const PER_SPHERE: f32 = (0.25 * std::f64::consts::FRAC_1_PI) as f32;

/// `out = base + Σ weight·values`.
#[inline(always)]
fn sum<'a>(out: &mut [f32], base: &[f32], terms: impl Iterator<Item = (&'a [f32], f32)>) {
    out.copy_from_slice(base);
    for (values, weight) in terms {
        out.iter_mut().zip(values).for_each(|(o, v)| *o += weight * v);
    }
}

#[inline(always)]
fn scatter(out: &mut [f32], scattering: &[f32], factor: f32, sigma: &[f32]) {
    let n = out.len();
    let (scattering, sigma) = (&scattering[..n], &sigma[..n]);
    for i in 0..n {
        out[i] = divided(scattering[i] * factor * out[i], sigma[i]);
    }
}

#[inline(always)]
fn divided(value: f32, sigma: f32) -> f32 {
    if sigma > 0.0 { value / sigma } else { 0.0 }
}
