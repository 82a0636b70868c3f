//! Volumes with x slowest, (x, z, y), so that layers perpendicular to x are contiguous; and back.

use rayon::prelude::*;

use super::super::shared::Shared;
use super::super::simd::{dispatch, prefetch, transpose};
use super::WIDTH;

/// Values between layers: one line more than they take, for a block of layers is written and read across and must not fall into
/// one set of a cache.
pub(super) fn layer([_, ny, nz]: [usize; 3]) -> usize {
    nz * ny + WIDTH
}

/// Layers that share the cache lines of x.
fn blocks(nx: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..nx).step_by(WIDTH).map(move |x| (x, WIDTH.min(nx - x)))
}

/// Planes that are turned together: they stay in a second-level cache, and what is written of a layer is one piece.
const PLANES: usize = 8;

/// Rows ahead of those at work whose cache lines are asked for: each is a memory access of its own.
const AHEAD: usize = 3 * WIDTH;

/// Asks for the values from `x` on in some rows of a plane, as far as there are such.
#[inline(always)]
fn ask_for(plane: &[f32], nx: usize, x: usize, rows: std::ops::Range<usize>) {
    for row in rows {
        if let Some(value) = plane.get(row * nx + x) {
            prefetch(value);
        }
    }
}

/// Copies (z, y, x) to (x, z, y).
pub(super) fn turn(size: [usize; 3], from: &[f32], to: &mut [f32]) {
    let to = Shared::new(to);
    let planes = from.par_chunks(PLANES * size[0] * size[1]);
    planes.enumerate().for_each(|(n, planes)| turn_planes(size, n * PLANES, planes, to));
}

/// Copies (x, z, y) to (z, y, x).
pub(super) fn turn_back(size: [usize; 3], from: &[f32], to: &mut [f32]) {
    let planes = to.par_chunks_mut(PLANES * size[0] * size[1]);
    planes.enumerate().for_each(|(n, planes)| turn_planes_back(size, n * PLANES, from, planes));
}

dispatch! {
    fn turn_planes(size: [usize; 3], start: usize, planes: &[f32], to: Shared) = turn_planes_body;
}

#[inline(always)]
fn turn_planes_body(size: [usize; 3], start: usize, planes: &[f32], to: Shared) {
    let ([nx, ny, _], layer) = (size, layer(size));
    for (x, layers) in blocks(nx) {
        for (z, plane) in planes.chunks_exact(nx * ny).enumerate() {
            for y in (0..ny).step_by(WIDTH) {
                let (rows, at) = (WIDTH.min(ny - y), x * layer + (start + z) * ny + y);
                to.check(at + (layers - 1) * layer, rows);
                ask_for(&planes[z * nx * ny..], nx, x, y + AHEAD..y + AHEAD + WIDTH);
                // SAFETY: the block lies in the plane, and in `to` as just seen for its last layer; planes of different z go to
                // different places, which are not in `planes`.
                unsafe {
                    transpose(plane[y * nx + x..].as_ptr(), nx as isize, rows, layers, to.at(at), layer as isize)
                };
            }
        }
    }
}

dispatch! {
    fn turn_planes_back(size: [usize; 3], start: usize, from: &[f32], planes: &mut [f32]) = turn_planes_back_body;
}

#[inline(always)]
fn turn_planes_back_body(size: [usize; 3], start: usize, from: &[f32], planes: &mut [f32]) {
    let ([nx, ny, _], layer) = (size, layer(size));
    let mut block = [0.0; WIDTH * WIDTH];
    for (x, layers) in blocks(nx) {
        for (z, plane) in planes.chunks_exact_mut(nx * ny).enumerate() {
            for y in (0..ny).step_by(WIDTH) {
                let (rows, at) = (WIDTH.min(ny - y), x * layer + (start + z) * ny + y);
                assert!(at + (layers - 1) * layer + rows <= from.len());
                ask_for(plane, nx, x, y + AHEAD..y + AHEAD + WIDTH);
                // SAFETY: the block lies in `from`, as just seen for its last layer.
                unsafe {
                    transpose(from[at..].as_ptr(), layer as isize, layers, rows, block.as_mut_ptr(), WIDTH as isize);
                }
                for (line, values) in plane[y * nx..].chunks_mut(nx).zip(block.chunks_exact(WIDTH)).take(rows) {
                    line[x..x + layers].copy_from_slice(&values[..layers]);
                }
            }
        }
    }
}
