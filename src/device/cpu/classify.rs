//! Optical properties on a light grid: the mean, over the data voxels under a light voxel, of a property *after* the
//! transfer function (light.md: downsample mean extinction), so that a shadow does not depend on the light grid.

use rayon::prelude::*;

use super::simd::dispatch;
use crate::device::Optic;
use crate::field::HOLE;
use crate::grid::Slab;
use crate::transfer::Table;

/// reads data values → writes a property on a grid of the same box.
pub(crate) fn classify(optic: Optic, table: &Table, data: &Slab, field: &[f32], light: &Slab, out: &mut [f32]) {
    let curve = optic.curve(table);
    let (lo, scale) = (table.lo, table.scale());
    let nx = data.size[0];
    mean(data, light, out, |row, values| look_up(&field[row * nx..][..nx], &curve, lo, scale, values));
}

/// reads data values and their gradient magnitudes → writes a property of a two-dimensional table.
pub(crate) fn classify_graded(
    optic: Optic,
    table: &Table,
    data: &Slab,
    [field, gradient]: [&[f32]; 2],
    light: &Slab,
    out: &mut [f32],
) {
    let curve = optic.curve(table);
    let (lo, scale) = (table.lo, table.scale());
    let steep = table.graded.as_ref().map_or(0.0, |graded| graded.scale());
    let nx = data.size[0];
    mean(data, light, out, |row, out| {
        let values = field[row * nx..][..nx].iter().zip(&gradient[row * nx..][..nx]);
        for (o, (&v, &g)) in out.iter_mut().zip(values) {
            let t = ((v - lo) * scale).clamp(0.0, 1.0) * (Table::ENTRIES - 1) as f32;
            let i = (t as usize).min(Table::ENTRIES - 2);
            let r = (g * steep).clamp(0.0, (curve.len() / Table::ENTRIES - 1) as f32);
            let j = (r as usize).min(curve.len() / Table::ENTRIES - 2);
            let along = |j: usize| {
                let row = &curve[j * Table::ENTRIES + i..];
                row[0] + (t - i as f32) * (row[1] - row[0])
            };
            let (a, b) = (along(j), along(j + 1));
            *o = if v < HOLE { 0.0 } else { a + (r - j as f32) * (b - a) };
        }
    });
}

/// reads values → writes their mean on a coarser (or equal) grid of the same box.
pub(crate) fn restrict(fine: &Slab, values: &[f32], coarse: &Slab, out: &mut [f32]) {
    let nx = fine.size[0];
    mean(fine, coarse, out, |row, out| out.copy_from_slice(&values[row * nx..][..nx]));
}

dispatch! {
    fn look_up(values: &[f32], curve: &[f32], lo: f32, scale: f32, out: &mut [f32]) = look_up_body;
}

#[inline(always)]
fn look_up_body(values: &[f32], curve: &[f32], lo: f32, scale: f32, out: &mut [f32]) {
    let curve: &[f32; Table::ENTRIES] = curve.try_into().expect("a full table");
    let last = (Table::ENTRIES - 1) as f32;
    for (o, &v) in out.iter_mut().zip(values) {
        let t = ((v - lo) * scale).clamp(0.0, 1.0) * last;
        let i = (t as i32 as usize).min(Table::ENTRIES - 2);
        let sigma = curve[i] + (t - i as f32) * (curve[i + 1] - curve[i]);
        *o = if v < HOLE { 0.0 } else { sigma };
    }
}

/// The fine voxels under coarse voxel `i` along one axis, with the fraction of each that it covers.
fn cover(fine: usize, coarse: usize, i: usize) -> impl Iterator<Item = (usize, f32)> {
    let (lo, hi) = (i * fine, (i + 1) * fine); // in units of 1/coarse fine voxels
    (lo / coarse..hi.div_ceil(coarse)).map(move |j| {
        let part = hi.min((j + 1) * coarse) - lo.max(j * coarse);
        (j, part as f32 / fine as f32)
    })
}

/// Box mean of rows that `read` provides, row number `k·ny + j` of the fine slab.
fn mean(fine: &Slab, coarse: &Slab, out: &mut [f32], read: impl Fn(usize, &mut [f32]) + Sync) {
    let (first, under) = (coarse.planes.start, coarse.under(fine.size[2]));
    assert!(fine.planes.start <= under.start && under.end <= fine.planes.end, "the slab under the coarse one");
    let (above, len) = (fine.planes.start, coarse.len());
    let (fine, coarse) = (fine.size, coarse.size);
    let [nx, ny, nz] = coarse;
    let columns: Vec<Vec<(usize, f32)>> = (0..nx).map(|i| cover(fine[0], nx, i).collect()).collect();
    let halves = fine[0] == 2 * nx;
    out[..len].par_chunks_exact_mut(nx).enumerate().with_min_len(16).for_each_init(
        || (vec![0.0f32; fine[0]], vec![0.0f32; fine[0]]),
        |(row, sum), (index, out)| {
            let (j, k) = (index % ny, first + index / ny);
            if fine == coarse {
                return read((k - above) * ny + j, out);
            }
            sum.fill(0.0);
            for (z, wz) in cover(fine[2], nz, k) {
                for (y, wy) in cover(fine[1], ny, j) {
                    read((z - above) * fine[1] + y, row);
                    sum.iter_mut().zip(row.iter()).for_each(|(s, v)| *s += wz * wy * v);
                }
            }
            if fine[0] == nx {
                out.copy_from_slice(sum);
            } else if halves {
                out.iter_mut().zip(sum.chunks_exact(2)).for_each(|(o, s)| *o = 0.5 * (s[0] + s[1]));
            } else {
                for (o, column) in out.iter_mut().zip(&columns) {
                    *o = column.iter().map(|&(x, w)| w * sum[x]).sum();
                }
            }
        },
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// A mean keeps the integral, whatever the sizes: what leaves no light behind on one grid leaves none on another.
        #[test]
        fn restriction_keeps_the_mean(nx in 1usize..20, ny in 1usize..20, nz in 1usize..20, seed in 0u32..1000,
                                      cx in 1usize..20, cy in 1usize..20, cz in 1usize..20) {
            let coarse = [cx.min(nx), cy.min(ny), cz.min(nz)];
            let values: Vec<f32> = (0..nx * ny * nz).map(|i| ((i as u32).wrapping_mul(2_654_435_761).wrapping_add(seed) >> 8) as f32 / 16_777_216.0).collect();
            let mut out = vec![0.0; coarse.iter().product()];
            restrict(&Slab::whole([nx, ny, nz]), &values, &Slab::whole(coarse), &mut out);
            let mean = |v: &[f32]| v.iter().map(|&v| f64::from(v)).sum::<f64>() / v.len() as f64;
            prop_assert!((mean(&values) - mean(&out)).abs() < 1e-5);
        }
    }
}
