//! Figures of a step in f64, over values that are finite: count, extremes, mean and standard deviation.
//!
//! A step is read slab by slab; slabs are joined by the pairwise update of Chan, Golub & LeVeque, "Algorithms for
//! computing the sample variance" (1983), eq. 2.1, so that a small contrast on a large offset keeps its digits.

use std::sync::Arc;

use crate::error::Result;
use crate::field::{Field, Timestep};
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

/// Part of a step as the file has it: an array of cells, some of which a finer part covers.
pub struct Piece {
    /// Values along x, y, z.
    pub size: [usize; 3],
    /// The values.
    pub field: Arc<dyn Field>,
    /// Cells that do not count, because a finer piece tells them.
    pub covered: Vec<Region>,
}

/// Reads a step in native precision and sums it up.
///
/// # Errors
/// Whatever reading the field reports.
pub fn statistics(step: &Timestep) -> Result<Statistics> {
    statistics_of(&[Piece { size: step.grid.size, field: step.field.clone(), covered: Vec::new() }])
}

/// Reads pieces in native precision and sums them up, each uncovered cell once.
///
/// # Errors
/// Whatever reading a field reports.
pub fn statistics_of(pieces: &[Piece]) -> Result<Statistics> {
    let mut all = Statistics { min: f64::INFINITY, max: f64::NEG_INFINITY, mean: 0.0, std: 0.0, valid: 0, total: 0 };
    let mut squares = 0.0;
    let mut values = Vec::new();
    for piece in pieces {
        for region in (Region { start: [0; 3], size: piece.size }).slabs(SLAB) {
            values.clear();
            values.resize(region.len(), 0.0);
            piece.field.read_f64(region, &mut values)?;
            if !piece.covered.is_empty() {
                keep_uncovered(&mut values, region, &piece.covered);
            }
            all.total += values.len();
            all.add(&values, &mut squares);
        }
    }
    (all.mean, all.std) = match all.valid {
        0 => (f64::NAN, f64::NAN),
        n => (all.mean, (squares / n as f64).sqrt()),
    };
    Ok(all)
}

impl Statistics {
    /// Joins the figures of more values to these; `squares` are the squared distances from the mean so far.
    fn add(&mut self, values: &[f64], squares: &mut f64) {
        let valid = || values.iter().copied().filter(|v| v.is_finite());
        let count = valid().count();
        if count == 0 {
            return;
        }
        (self.min, self.max) = valid().fold((self.min, self.max), |(lo, hi), v| (lo.min(v), hi.max(v)));
        let mean = valid().sum::<f64>() / count as f64;
        let apart = mean - self.mean;
        let (before, here, both) = (self.valid as f64, count as f64, (self.valid + count) as f64);
        *squares += valid().map(|v| (v - mean).powi(2)).sum::<f64>() + apart * apart * before * here / both;
        self.mean += apart * here / both;
        self.valid += count;
    }
}

/// Leaves of a region's values those that no covered region holds.
fn keep_uncovered(values: &mut Vec<f64>, region: Region, covered: &[Region]) {
    let mut keep = vec![true; values.len()];
    for cover in covered {
        let start: [usize; 3] = std::array::from_fn(|a| cover.start[a].max(region.start[a]));
        let end: [usize; 3] = std::array::from_fn(|a| cover.end()[a].min(region.end()[a]));
        if (0..3).any(|a| start[a] >= end[a]) {
            continue;
        }
        for k in start[2]..end[2] {
            for j in start[1]..end[1] {
                let row = ((k - region.start[2]) * region.size[1] + j - region.start[1]) * region.size[0];
                keep[row + start[0] - region.start[0]..row + end[0] - region.start[0]].fill(false);
            }
        }
    }
    let mut keep = keep.into_iter();
    values.retain(|_| keep.next().unwrap_or(true));
}

#[cfg(test)]
mod tests {
    use super::*;
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
