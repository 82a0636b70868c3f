//! Linear combinations, inner products and largest values of whole volumes, in chunks whose results are put together in the
//! same order whatever the number of threads.

use rayon::prelude::*;

use super::host;
use super::simd::dispatch;
use crate::device::Buffer;

/// Values worked on at a time: a few arrays of this length fit in a second-level cache.
const CHUNK: usize = crate::device::RUN;

/// Sums run in this many lanes.
const LANES: usize = 16;

/// reads volumes → writes `Σ weight·volume`.
pub(crate) fn combine(terms: &[(&Buffer, f32)], out: &mut [f32]) {
    out.par_chunks_mut(CHUNK).enumerate().for_each(|(n, out)| combine_chunk(terms, n * CHUNK, out));
}

/// reads two volumes → returns the parts of their inner product.
pub(crate) fn dot_parts(a: &[f32], b: &[f32]) -> Vec<f64> {
    a.par_chunks(CHUNK).zip(b.par_chunks(CHUNK)).map(|(a, b)| dot_chunk(a, b)).collect()
}

/// reads two volumes → returns the largest `|a − b|`.
pub(crate) fn distance(a: &[f32], b: &[f32]) -> f32 {
    let chunks = a.par_chunks(CHUNK).zip(b.par_chunks(CHUNK));
    chunks.map(|(a, b)| distance_chunk(a, b)).reduce(|| 0.0, f32::max)
}

/// reads two volumes → returns the largest `a/b` where b > 0.
pub(crate) fn largest_ratio(a: &[f32], b: &[f32]) -> f32 {
    let chunks = a.par_chunks(CHUNK).zip(b.par_chunks(CHUNK));
    chunks.map(|(a, b)| ratio_chunk(a, b)).reduce(|| 0.0, f32::max)
}

dispatch! {
    fn combine_chunk(terms: &[(&Buffer, f32)], start: usize, out: &mut [f32]) = combine_body;
}

#[inline(always)]
fn combine_body(terms: &[(&Buffer, f32)], start: usize, out: &mut [f32]) {
    let values = |n: usize| &host(terms[n].0)[start..][..out.len()];
    match terms {
        [] => out.fill(0.0),
        [(_, 1.0)] => out.copy_from_slice(values(0)),
        [(_, weight), rest @ ..] => {
            let first = values(0);
            out.iter_mut().zip(first).for_each(|(o, v)| *o = weight * v);
            for (buffer, weight) in rest {
                let values = &host(buffer)[start..][..out.len()];
                out.iter_mut().zip(values).for_each(|(o, v)| *o += weight * v);
            }
        }
    }
}

dispatch! {
    fn dot_chunk(a: &[f32], b: &[f32]) -> f64 = dot_body;
}

#[inline(always)]
fn dot_body(a: &[f32], b: &[f32]) -> f64 {
    let mut sums = [0.0f64; LANES];
    for (a, b) in a.chunks(LANES).zip(b.chunks(LANES)) {
        for ((s, a), b) in sums.iter_mut().zip(a).zip(b) {
            *s += f64::from(*a) * f64::from(*b);
        }
    }
    sums.iter().sum()
}

dispatch! {
    fn distance_chunk(a: &[f32], b: &[f32]) -> f32 = distance_body;
}

#[inline(always)]
fn distance_body(a: &[f32], b: &[f32]) -> f32 {
    let mut most = [0.0f32; LANES];
    for (a, b) in a.chunks(LANES).zip(b.chunks(LANES)) {
        for ((m, a), b) in most.iter_mut().zip(a).zip(b) {
            *m = m.max((a - b).abs());
        }
    }
    most.into_iter().fold(0.0, f32::max)
}

dispatch! {
    fn ratio_chunk(a: &[f32], b: &[f32]) -> f32 = ratio_body;
}

#[inline(always)]
fn ratio_body(a: &[f32], b: &[f32]) -> f32 {
    let mut most = [0.0f32; LANES];
    for (a, b) in a.chunks(LANES).zip(b.chunks(LANES)) {
        for ((m, a), b) in most.iter_mut().zip(a).zip(b) {
            *m = m.max(if *b > 0.0 { a / b } else { 0.0 });
        }
    }
    most.into_iter().fold(0.0, f32::max)
}
