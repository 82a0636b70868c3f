//! Layers perpendicular to x as contiguous rows, and back.

use std::ops::Range;

use super::super::simd::transpose;
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
    let at = |x: usize| job.layer(x) - job.layers.start;
    for (f, field) in job.fields.iter().enumerate() {
        let slots = &mut turned[f * BLOCK * layer..][..BLOCK * layer];
        for (r, z) in held.clone().enumerate() {
            let plane = &field[z * ny * nx..][..ny * nx];
            let (start, step) = (at(span.start) * layer + r * padded, if job.batch.ascending { 1 } else { -1 });
            assert!(start + ny <= slots.len() && at(span.end - 1) * layer + r * padded + ny <= slots.len());
            // SAFETY: the lines of the plane hold `span`, which lies in the grid; slots and rows lie in `slots`, as just seen
            // for the first and the last layer, and `slots` overlaps no field.
            unsafe {
                let (from, to) = (plane.as_ptr().add(span.start), slots.as_mut_ptr().add(start));
                transpose(from, nx as isize, ny, span.len(), to, step * layer as isize);
            }
        }
    }
}

/// Adds (part, layer, row, column) to φ and J.
#[inline(always)]
pub(super) fn turn_out(job: &Job, band: &mut Band, sums: &[f32], columns: &mut [f32]) {
    let ([nx, ny, _], padded, height, span) = (job.size, job.padded(), band.rows.len(), job.span());
    let at = |x: usize| job.layer(x) - job.layers.start;
    for (part, into) in band.sums.iter_mut().enumerate() {
        let layer = layer_stride(height, padded);
        let from = &sums[part * BLOCK * layer..][..BLOCK * layer];
        for (r, plane) in into[0].chunks_exact_mut(ny * nx).enumerate() {
            let (start, step) = (at(span.start) * layer + r * padded, if job.batch.ascending { 1 } else { -1 });
            let columns = &mut columns[..ny * WIDTH];
            assert!(start + ny <= from.len() && at(span.end - 1) * layer + r * padded + ny <= from.len());
            // SAFETY: slots and rows lie in `from`, as just seen for the first and the last layer; `columns` holds a block
            // of layers for each of ny lines.
            unsafe {
                let (from, to) = (from.as_ptr().add(start), columns.as_mut_ptr());
                transpose(from, step * layer as isize, span.len(), ny, to, WIDTH as isize);
            }
            for (line, values) in plane.chunks_exact_mut(nx).zip(columns.chunks_exact(WIDTH)) {
                let (line, values) = (&mut line[span.clone()], &values[..span.len()]);
                if job.first {
                    line.copy_from_slice(values);
                } else {
                    line.iter_mut().zip(values).for_each(|(s, v)| *s += v);
                }
            }
        }
    }
}
