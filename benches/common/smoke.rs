//! Smoke at any size.

use gloaming::grid::Grid;
use rayon::prelude::*;

/// Step 40 of the smoke, trilinear on n³ voxels, in the same box.
pub fn smoke(edge: usize) -> gloaming::Result<(Grid, Vec<f32>)> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/smoke.h5");
    let read = || -> hdf5::Result<ndarray::Array3<f32>> {
        hdf5::File::open(path)?.dataset("density")?.read_slice(ndarray::s![40, .., .., ..])
    };
    let coarse = read().map_err(|e| gloaming::Error::format(path, e.to_string(), "git lfs pull"))?;
    let n = coarse.shape()[0];
    let at = |i: usize| -> (usize, f32) {
        let x = ((i as f32 + 0.5) * n as f32 / edge as f32 - 0.5).clamp(0.0, (n - 1) as f32);
        let cell = (x as usize).min(n - 2);
        (cell, x - cell as f32)
    };
    let mut fine = vec![0.0; edge * edge * edge];
    fine.par_chunks_mut(edge * edge).enumerate().for_each(|(k, slice)| {
        let (z, fz) = at(k);
        for (j, row) in slice.chunks_mut(edge).enumerate() {
            let (y, fy) = at(j);
            for (i, v) in row.iter_mut().enumerate() {
                let (x, fx) = at(i);
                let mut sum = 0.0;
                for corner in 0..8 {
                    let [dx, dy, dz] = [corner & 1, corner >> 1 & 1, corner >> 2];
                    let weight = |d: usize, f: f32| if d == 1 { f } else { 1.0 - f };
                    sum += weight(dx, fx) * weight(dy, fy) * weight(dz, fz) * coarse[[z + dz, y + dy, x + dx]];
                }
                *v = sum;
            }
        }
    });
    Ok((Grid::new([n; 3]).resized([edge; 3]), fine))
}
