//! Figures of a step in f64, over values that are finite: count, extremes, mean and standard deviation.
//!
//! A step is read slab by slab; slabs are joined by the pairwise update of Chan, Golub & LeVeque, "Algorithms for
//! computing the sample variance" (1983), eq. 2.1, so that a small contrast on a large offset keeps its digits.

use crate::error::Result;
use crate::field::Timestep;
use crate::grid::Region;

/// Figures over the valid (finite, unfilled) values of a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Statistics {
    /// Least valid value; +∞ when none is valid.
    pub min: f64,
    /// Greatest valid value; −∞ when none is valid.
    pub max: f64,
    /// Mean of the valid values; NaN when none is valid.
    pub mean: f64,
    /// Standard deviation (of the population) of the valid values.
    pub std: f64,
    /// Number of valid values.
    pub valid: usize,
    /// Number of all values.
    pub total: usize,
}

/// Values in one slab: 128 MiB of f64.
const SLAB: usize = 16 << 20;

/// Reads a step in native precision and sums it up.
///
/// # Errors
/// Whatever reading the field reports.
pub fn statistics(step: &Timestep) -> Result<Statistics> {
    let [nx, ny, nz] = step.grid.size;
    let thickness = (SLAB / (nx * ny).max(1)).clamp(1, nz.max(1));
    let mut all = Statistics { min: f64::INFINITY, max: f64::NEG_INFINITY, mean: 0.0, std: 0.0, valid: 0, total: 0 };
    let mut squares = 0.0;
    let mut values = Vec::new();
    for start in (0..nz).step_by(thickness) {
        let region = Region { start: [0, 0, start], size: [nx, ny, thickness.min(nz - start)] };
        values.resize(region.len(), 0.0);
        step.field.read_f64(region, &mut values)?;
        all.total += values.len();
        let valid = || values.iter().copied().filter(|v| v.is_finite());
        let count = valid().count();
        if count == 0 {
            continue;
        }
        let (min, max) = valid().fold((all.min, all.max), |(lo, hi), v| (lo.min(v), hi.max(v)));
        (all.min, all.max) = (min, max);
        let mean = valid().sum::<f64>() / count as f64;
        let apart = mean - all.mean;
        let (before, here, both) = (all.valid as f64, count as f64, (all.valid + count) as f64);
        squares += valid().map(|v| (v - mean).powi(2)).sum::<f64>() + apart * apart * before * here / both;
        all.mean += apart * here / both;
        all.valid += count;
    }
    (all.mean, all.std) = match all.valid {
        0 => (f64::NAN, f64::NAN),
        n => (all.mean, (squares / n as f64).sqrt()),
    };
    Ok(all)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::field::Field;
    use crate::grid::Grid;

    /// 1e8 + z, and NaN where x is 0: slabs with different means.
    struct Ramp;

    impl Field for Ramp {
        fn read(&self, _: Region, _: &mut [f32]) -> Result<()> {
            unreachable!("statistics read in f64")
        }

        fn read_f64(&self, region: Region, out: &mut [f64]) -> Result<()> {
            let plane = region.size[0] * region.size[1];
            for (i, o) in out.iter_mut().enumerate() {
                let z = region.start[2] + i / plane;
                *o = if i % region.size[0] == 0 { f64::NAN } else { 1e8 + z as f64 };
            }
            Ok(())
        }
    }

    #[test]
    fn slabs_join_to_the_figures_of_the_whole() {
        // 4096² values a plane make one plane a slab; the variance of 0, 1, 2 is 2/3.
        let grid = Grid::new([4096, 4096, 3]);
        let found = statistics(&Timestep { step: 0, time: None, grid, field: Arc::new(Ramp) }).unwrap();
        assert_eq!((found.min, found.max, found.valid), (1e8, 1e8 + 2.0, 4095 * 4096 * 3));
        assert!((found.mean - 1e8 - 1.0).abs() < 1e-6, "{found:?}");
        assert!((found.std - (2.0f64 / 3.0).sqrt()).abs() < 1e-9, "{found:?}");
    }
}
