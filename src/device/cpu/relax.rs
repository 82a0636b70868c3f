//! Implicit diffusion (Zhang & Ma 2013, (23)), one backward-Euler step: `v − Σ_a κ_a (v_a⁻ − 2v + v_a⁺) = rhs`, neighbours outside
//! being the voxel itself. Red-black Gauss–Seidel, residual, and the correction of a finer grid by a coarser one.

use rayon::prelude::*;

use super::shared::Shared;
use super::simd::dispatch;
use crate::grid::Slab;

/// rhs, v → v relaxed where i + j + k has the parity of `colour`.
pub(crate) fn relax(size: [usize; 3], coupling: [f32; 3], rhs: &[f32], values: &mut [f32], colour: usize) {
    let nz = size[2];
    assert!(rhs.len() >= size.iter().product() && values.len() >= size.iter().product(), "buffers must hold the grid");
    let shared = Shared::new(values);
    // Every other plane, so that no plane is written while its neighbour reads it.
    for start in 0..2 {
        (start..nz).into_par_iter().filter(|k| k % 2 == start).for_each_init(Vec::new, |row, k| {
            relax_plane(size, coupling, k, rhs, shared, colour, row);
        });
    }
}

dispatch! {
    fn relax_plane(size: [usize; 3], coupling: [f32; 3], k: usize, rhs: &[f32], values: Shared, colour: usize, row: &mut Vec<f32>) = relax_body;
}

#[inline(always)]
fn relax_body(
    size: [usize; 3],
    coupling: [f32; 3],
    k: usize,
    rhs: &[f32],
    values: Shared,
    colour: usize,
    row: &mut Vec<f32>,
) {
    let [nx, ny, nz] = size;
    row.resize(nx + 2, 0.0);
    let at = |j: usize, k: usize| (k * ny + j) * nx;
    let sum = 1.0 + 2.0 * (coupling[0] + coupling[1] + coupling[2]);
    for j in 0..ny {
        let here = values.read(at(j, k), nx);
        row[1..=nx].copy_from_slice(here);
        let mut weight = sum;
        let mut beside = |inside: bool, coupling: f32, j: usize, k: usize| {
            if inside {
                (values.read(at(j, k), nx), coupling)
            } else {
                weight -= coupling;
                (here, 0.0)
            }
        };
        let (south, ws) = beside(j > 0, coupling[1], j.saturating_sub(1), k);
        let (north, wn) = beside(j + 1 < ny, coupling[1], (j + 1).min(ny - 1), k);
        let (below, wb) = beside(k > 0, coupling[2], j, k.saturating_sub(1));
        let (above, wa) = beside(k + 1 < nz, coupling[2], j, (k + 1).min(nz - 1));
        let rhs = &rhs[at(j, k)..][..nx];
        let value = |i: usize, wx: [f32; 2], weight: f32| {
            let across = wx[0] * row[i] + wx[1] * row[i + 2];
            let around = ws * south[i] + wn * north[i] + (wb * below[i] + wa * above[i]);
            (rhs[i] + (across + around)) / weight
        };
        let inner = [coupling[0]; 2];
        // What changes is put together beside the row: neighbours read it.
        let mut ends = [row[1], row[nx]];
        for (end, i) in [(0, 0), (1, nx - 1)] {
            let wx = [if i > 0 { coupling[0] } else { 0.0 }, if i + 1 < nx { coupling[0] } else { 0.0 }];
            if (i + j + k) % 2 == colour {
                ends[end] = value(i, wx, weight - (2.0 * coupling[0] - wx[0] - wx[1]));
            }
        }
        let first = (j + k + colour) % 2;
        // SAFETY: this task alone writes this plane in this half, and nobody reads it.
        let out = unsafe { std::slice::from_raw_parts_mut(values.at(at(j, k)), nx) };
        for i in 1..nx.saturating_sub(1) {
            let new = value(i, inner, weight);
            out[i] = if i % 2 == first { new } else { row[i + 1] };
        }
        out[0] = ends[0];
        out[nx - 1] = ends[1];
    }
}

/// rhs, v → r = rhs − A v; returns the largest |r|.
pub(crate) fn residual(size: [usize; 3], coupling: [f32; 3], rhs: &[f32], values: &[f32], out: &mut [f32]) -> f32 {
    let [nx, ny, nz] = size;
    out[..nx * ny * nz]
        .par_chunks_exact_mut(nx)
        .enumerate()
        .with_min_len(16)
        .map(|(row, out)| residual_row(size, coupling, [row % ny, row / ny], rhs, values, out))
        .reduce(|| 0.0, f32::max)
}

dispatch! {
    fn residual_row(size: [usize; 3], coupling: [f32; 3], at: [usize; 2], rhs: &[f32], values: &[f32], out: &mut [f32]) -> f32 = residual_body;
}

#[inline(always)]
fn residual_body(
    [nx, ny, nz]: [usize; 3],
    coupling: [f32; 3],
    [j, k]: [usize; 2],
    rhs: &[f32],
    values: &[f32],
    out: &mut [f32],
) -> f32 {
    let line = |j: usize, k: usize| &values[(k * ny + j) * nx..][..nx];
    let here = line(j, k);
    let (south, north) = (line(j.saturating_sub(1), k), line((j + 1).min(ny - 1), k));
    let (below, above) = (line(j, k.saturating_sub(1)), line(j, (k + 1).min(nz - 1)));
    let rhs = &rhs[(k * ny + j) * nx..][..nx];
    let mut most = 0.0f32;
    for i in 0..nx {
        let v = here[i];
        let x = (v - here[i.saturating_sub(1)]) + (v - here[(i + 1).min(nx - 1)]);
        let y = (v - south[i]) + (v - north[i]);
        let z = (v - below[i]) + (v - above[i]);
        let r = rhs[i] - (v + (coupling[0] * x + coupling[1] * y + coupling[2] * z));
        out[i] = r;
        most = if r.abs() > most { r.abs() } else { most };
    }
    most
}

/// Adds a coarser grid of the same box to a finer one, trilinear between its values and constant beyond the outermost.
pub(crate) fn prolong(from: &Slab, values: &[f32], to: &Slab, into: &mut [f32]) {
    let (coarse, [nx, ny, nz]) = (from.size, to.size);
    let columns: Vec<_> = (0..nx).map(|i| between(i, nx, coarse[0])).collect();
    let rows = into[..to.len()].par_chunks_exact_mut(nx).enumerate().with_min_len(16);
    rows.for_each_init(
        || vec![0.0f32; coarse[0]],
        |across, (row, into)| {
            let (y, z) = (between(row % ny, ny, coarse[1]), between(to.planes.start + row / ny, nz, coarse[2]));
            let line =
                |y: usize, z: usize| &values[((z - from.planes.start) * coarse[1] + y) * coarse[0]..][..coarse[0]];
            let (near, far) = ((line(y.0, z.0), line(y.1, z.0)), (line(y.0, z.1), line(y.1, z.1)));
            for (i, value) in across.iter_mut().enumerate() {
                let low = near.0[i] + y.2 * (near.1[i] - near.0[i]);
                let high = far.0[i] + y.2 * (far.1[i] - far.0[i]);
                *value = low + z.2 * (high - low);
            }
            for (into, x) in into.iter_mut().zip(&columns) {
                *into += across[x.0] + x.2 * (across[x.1] - across[x.0]);
            }
        },
    );
}

/// The two coarse values beside fine value i of n, and how far it is from the first to the second.
pub(crate) fn between(i: usize, n: usize, coarse: usize) -> (usize, usize, f32) {
    let at = ((i as f32 + 0.5) * coarse as f32 / n as f32 - 0.5).clamp(0.0, (coarse - 1) as f32);
    let low = at as usize;
    (low, (low + 1).min(coarse - 1), at - low as f32)
}
