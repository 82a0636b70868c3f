//! Gradient magnitude by central differences, edges repeated: `∂v/∂x ≈ (v(x+1) − v(x−1))/2Δx` (GPU Gems 39 (2)).

use rayon::prelude::*;

use crate::field::HOLE;
use crate::grid::Grid;

/// reads data values → writes gradient magnitudes, data values per world length.
pub(crate) fn gradient(grid: &Grid, field: &[f32], out: &mut [f32]) {
    let [nx, ny, nz] = grid.size;
    let scale = grid.spacing.map(|s| (0.5 / s) as f32);
    out[..grid.len()].par_chunks_exact_mut(nx).enumerate().with_min_len(16).for_each(|(row, out)| {
        let (j, k) = (row % ny, row / ny);
        let line = |j: usize, k: usize| &field[(k * ny + j) * nx..][..nx];
        let own = line(j, k);
        let [north, south] = [line(j.saturating_sub(1), k), line((j + 1).min(ny - 1), k)];
        let [below, above] = [line(j, k.saturating_sub(1)), line(j, (k + 1).min(nz - 1))];
        for (i, out) in out.iter_mut().enumerate() {
            let value = own[i];
            let slope = |low: f32, high: f32, scale: f32| {
                let known = |v: f32| if v < HOLE { value } else { v };
                (known(high) - known(low)) * scale
            };
            let x = slope(own[i.saturating_sub(1)], own[(i + 1).min(nx - 1)], scale[0]);
            let (y, z) = (slope(north[i], south[i], scale[1]), slope(below[i], above[i], scale[2]));
            *out = if value < HOLE { 0.0 } else { (x * x + y * y + z * z).sqrt() };
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::EMPTY;

    #[test]
    fn ramps_have_their_slope_halved_at_the_edges_and_beside_holes() {
        let grid = Grid { size: [5, 4, 3], spacing: [0.5, 2.0, 1.0], origin: [0.0; 3] };
        let at = |n: usize| [n % 5, n / 5 % 4, n / 20].map(|i| i as f32);
        let mut field: Vec<f32> = (0..grid.len()).map(|n| 3.0 * at(n)[0] - 2.0 * at(n)[1] + 0.5 * at(n)[2]).collect();
        field[2 + 5 + 20] = EMPTY;
        let mut out = vec![0.0; grid.len()];
        gradient(&grid, &field, &mut out);
        let index = |x: usize, y: usize, z: usize| x + 5 * y + 20 * z;
        assert_eq!(out[index(2, 1, 1)], 0.0);
        assert!((out[index(3, 2, 1)] - (36.0f32 + 1.0 + 0.25).sqrt()).abs() < 1e-5);
        assert!((out[index(0, 2, 1)] - (9.0f32 + 1.0 + 0.25).sqrt()).abs() < 1e-5, "at the edge");
        assert!((out[index(3, 1, 1)] - (9.0f32 + 1.0 + 0.25).sqrt()).abs() < 1e-5, "beside the hole");
    }
}
