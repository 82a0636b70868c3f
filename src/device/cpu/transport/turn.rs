//! Layers perpendicular to x as contiguous rows, and back.

use std::ops::Range;

use super::{BLOCK, Band, Job, WIDTH};

type Tile = [[f32; WIDTH]; WIDTH];

#[inline(always)]
fn transposed(tile: &Tile) -> Tile {
    std::array::from_fn(|i| std::array::from_fn(|j| tile[j][i]))
}

/// Copies the block's layers, and the one before them, into rows along y: (field, layer, row, column).
#[inline(always)]
pub(super) fn turn_in(job: &Job, held: &Range<usize>, turned: &mut [f32]) {
    let ([nx, ny, _], padded) = (job.size, job.padded());
    let (layer, span) = (held.len() * padded, job.span());
    for (f, field) in job.fields.iter().enumerate() {
        let slots = &mut turned[f * (BLOCK + 1) * layer..][..(BLOCK + 1) * layer];
        for (r, z) in held.clone().enumerate() {
            let plane = &field[z * ny * nx..][..ny * nx];
            if job.layers.start > 0 {
                let x = job.layer(job.layers.start - 1);
                let into = &mut slots[r * padded..][..ny];
                into.iter_mut().zip(plane.chunks_exact(nx)).for_each(|(o, line)| *o = line[x]);
            }
            for (b, lines) in plane.chunks(WIDTH * nx).enumerate() {
                let mut tile = Tile::default();
                for (t, line) in tile.iter_mut().zip(lines.chunks_exact(nx)) {
                    t[..span.len()].copy_from_slice(&line[span.clone()]);
                }
                for (t, x) in transposed(&tile).iter().zip(span.clone()) {
                    let slot = job.layer(x) + 1 - job.layers.start;
                    slots[slot * layer + r * padded + b * WIDTH..][..WIDTH].copy_from_slice(t);
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
        let from = &sums[part * BLOCK * height * padded..][..BLOCK * height * padded];
        for (r, plane) in into[0].chunks_exact_mut(ny * nx).enumerate() {
            for (b, lines) in plane.chunks_mut(WIDTH * nx).enumerate() {
                let mut tile = Tile::default();
                for (t, x) in tile.iter_mut().zip(span.clone()) {
                    let slot = job.layer(x) - job.layers.start;
                    t.copy_from_slice(&from[(slot * height + r) * padded + b * WIDTH..][..WIDTH]);
                }
                for (t, line) in transposed(&tile).iter().zip(lines.chunks_exact_mut(nx)) {
                    let line = &mut line[span.clone()];
                    if job.first {
                        line.copy_from_slice(&t[..span.len()]);
                    } else {
                        line.iter_mut().zip(t).for_each(|(s, v)| *s += v);
                    }
                }
            }
        }
    }
}
