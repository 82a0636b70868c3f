//! A box of a grid as a volume of its own, and back: `out[p] = values[start + p]`.

use rayon::prelude::*;

use crate::grid::Region;

/// Rows that are worth a task.
const ROWS: usize = 256;

/// reads values → writes those of the region.
pub(crate) fn crop([nx, ny, _]: [usize; 3], values: &[f32], region: Region, out: &mut [f32]) {
    let Region { start: [x, y, z], size: [width, height, _] } = region;
    if region.is_empty() {
        return;
    }
    out[..region.len()].par_chunks_exact_mut(width).enumerate().with_min_len(ROWS).for_each(|(row, out)| {
        let from = ((z + row / height) * ny + y + row % height) * nx + x;
        out.copy_from_slice(&values[from..][..width]);
    });
}

/// reads the values of the region → writes them where they belong and 0 elsewhere.
pub(crate) fn embed(region: Region, values: &[f32], [nx, ny, nz]: [usize; 3], out: &mut [f32]) {
    let (Region { start, size: [width, height, _] }, end) = (region, region.end());
    out[..nx * ny * nz].par_chunks_exact_mut(nx).enumerate().with_min_len(ROWS).for_each(|(row, out)| {
        let (j, k) = (row % ny, row / ny);
        if !(start[1]..end[1]).contains(&j) || !(start[2]..end[2]).contains(&k) {
            out.fill(0.0);
            return;
        }
        let from = ((k - start[2]) * height + j - start[1]) * width;
        out[..start[0]].fill(0.0);
        out[start[0]..end[0]].copy_from_slice(&values[from..][..width]);
        out[end[0]..].fill(0.0);
    });
}
