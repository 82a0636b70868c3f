//! Coefficients of the medium continued past its edges:
//!
//! `out = FAINT · Σ values/Σ σ` over the 26 neighbours where σ = 0 and Σ σ > 0, else `out = values`.

use rayon::prelude::*;

use super::simd::dispatch;
use crate::device::FAINT;

/// reads σ, values → writes values continued past the edges of σ.
pub(crate) fn extend(size: [usize; 3], sigma: &[f32], values: &[f32], out: &mut [f32]) {
    let [nx, ny, nz] = size;
    out[..nx * ny * nz].par_chunks_exact_mut(nx).enumerate().with_min_len(64).for_each_init(
        || vec![0.0; 2 * (nx + 2)],
        |sums, (row, out)| {
            let here = row * nx..(row + 1) * nx;
            out.copy_from_slice(&values[here.clone()]);
            if full(&sigma[here.clone()]) {
                return;
            }
            let (j, k) = (row % ny, row / ny);
            sums.fill(0.0);
            for k in k.saturating_sub(1)..(k + 2).min(nz) {
                for j in j.saturating_sub(1)..(j + 2).min(ny) {
                    let from = (k * ny + j) * nx;
                    add(&sigma[from..][..nx], &values[from..][..nx], sums);
                }
            }
            fill(&sigma[here], sums, out);
        },
    );
}

dispatch! {
    fn full(sigma: &[f32]) -> bool = full_body;
}

#[inline(always)]
fn full_body(sigma: &[f32]) -> bool {
    sigma.iter().fold(f32::INFINITY, |m, s| m.min(*s)) > 0.0
}

dispatch! {
    fn add(sigma: &[f32], values: &[f32], sums: &mut [f32]) = add_body;
}

#[inline(always)]
fn add_body(sigma: &[f32], values: &[f32], sums: &mut [f32]) {
    let n = sigma.len();
    let (extinction, coefficient) = sums.split_at_mut(n + 2);
    extinction[1..=n].iter_mut().zip(sigma).for_each(|(s, v)| *s += v);
    coefficient[1..=n].iter_mut().zip(values).for_each(|(s, v)| *s += v);
}

dispatch! {
    fn fill(sigma: &[f32], sums: &[f32], out: &mut [f32]) = fill_body;
}

#[inline(always)]
fn fill_body(sigma: &[f32], sums: &[f32], out: &mut [f32]) {
    let n = out.len();
    let (extinction, coefficient) = sums.split_at(n + 2);
    let three = |v: &[f32], i: usize| v[i] + v[i + 1] + v[i + 2];
    let sigma = &sigma[..n];
    for i in 0..n {
        let around = three(extinction, i);
        let value = FAINT * (three(coefficient, i) / around);
        out[i] = if sigma[i] > 0.0 || around <= 0.0 { out[i] } else { value };
    }
}
