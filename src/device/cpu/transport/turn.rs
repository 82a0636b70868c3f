//! Layers perpendicular to x as contiguous rows, and back.

use std::ops::Range;

use super::{BLOCK, Band, Job, WIDTH};

/// Values between layers of `rows` rows: one line more than they take, because a block of layers is written and read across
/// and must not fall into one set of a cache.
pub(super) fn layer_stride(rows: usize, padded: usize) -> usize {
    rows * padded + WIDTH
}

/// Copies the block's layers into rows along y: (field, layer, row, column).
#[inline(always)]
pub(super) fn turn_in(job: &Job, held: &Range<usize>, turned: &mut [f32]) {
    let ([nx, ny, _], padded) = (job.size, job.padded());
    let (layer, span) = (layer_stride(held.len(), padded), job.span());
    for (f, field) in job.fields.iter().enumerate() {
        let slots = &mut turned[f * BLOCK * layer..][..BLOCK * layer];
        for (r, z) in held.clone().enumerate() {
            let plane = &field[z * ny * nx..][..ny * nx];
            for (b, lines) in plane.chunks(WIDTH * nx).enumerate() {
                for x in span.clone() {
                    let slot = job.layer(x) - job.layers.start;
                    let into = &mut slots[slot * layer + r * padded + b * WIDTH..][..WIDTH];
                    into.iter_mut().zip(lines.chunks_exact(nx)).for_each(|(value, line)| *value = line[x]);
                }
            }
        }
    }
}

/// Adds (part, layer, row, column) to φ and J.
#[inline(always)]
pub(super) fn turn_out(job: &Job, band: &mut Band, sums: &[f32]) {
    let ([nx, ny, _], padded, height, span) = (job.size, job.padded(), band.rows.len(), job.span());
    for (part, into) in band.sums.iter_mut().enumerate() {
        let layer = layer_stride(height, padded);
        let from = &sums[part * BLOCK * layer..][..BLOCK * layer];
        for (r, plane) in into[0].chunks_exact_mut(ny * nx).enumerate() {
            for (b, lines) in plane.chunks_mut(WIDTH * nx).enumerate() {
                for (y, line) in lines.chunks_exact_mut(nx).enumerate() {
                    for x in span.clone() {
                        let value = from[(job.layer(x) - job.layers.start) * layer + r * padded + b * WIDTH + y];
                        line[x] = if job.first { value } else { line[x] + value };
                    }
                }
            }
        }
    }
}
