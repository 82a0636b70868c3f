//! Histograms to design transfer functions by (GPU Gems 39; Kindlmann & Durkin 1998): how often each value occurs, and each pair
//! of value and gradient magnitude, over the steps of a series.
//!
//! Gradient magnitudes are those that two-dimensional transfer functions look up ([`crate::device::Device::gradient`]), on the
//! same axis: 1 is `transfer.steepest` ranges of the values per voxel.

use serde::Serialize;

use crate::device::cpu;
use crate::field::HOLE;
use crate::grid::Grid;

mod plot;

pub use plot::plot;

/// Counts over values, and over values and gradient magnitudes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Histogram {
    /// Values at the outer edges of the first and the last bin.
    pub range: [f64; 2],
    /// Gradient magnitude at the upper edge of the last bin, in ranges of the values per voxel (mean spacing).
    pub steepest: f64,
    /// Bins of values and of gradient magnitudes.
    pub bins: [usize; 2],
    /// How many values are in each bin.
    pub values: Vec<u64>,
    /// How many are in each bin of both: all values of the least gradients first.
    pub joint: Vec<u64>,
    /// Values below and above the range; in no bin.
    pub outside: [u64; 2],
    /// Values whose gradient is beyond the last bin; in it.
    pub steeper: u64,
    /// Values that are not finite, or filled.
    pub holes: u64,
    /// Steps that were counted.
    pub steps: u64,
}

impl Histogram {
    /// No counts yet.
    pub fn new(range: [f64; 2], steepest: f64, bins: [usize; 2]) -> Self {
        Histogram {
            range,
            steepest,
            bins,
            values: vec![0; bins[0]],
            joint: vec![0; bins[0] * bins[1]],
            outside: [0; 2],
            steeper: 0,
            holes: 0,
            steps: 0,
        }
    }

    /// Counts the values of a step, holes marked.
    pub fn add(&mut self, grid: &Grid, values: &[f32]) {
        let mut gradients = vec![0.0; grid.len()];
        cpu::gradient::gradient(grid, values, &mut gradients);
        let [lo, hi] = self.range;
        let span = hi - lo;
        // Gradient magnitudes in ranges per voxel, and of those in bins.
        let per_voxel = if span > 0.0 { grid.mean_spacing() / span } else { 0.0 };
        let [columns, rows] = self.bins;
        for (&value, &gradient) in values.iter().zip(&gradients) {
            let at = f64::from(value);
            if value < HOLE {
                self.holes += 1;
            } else if at < lo || at > hi {
                self.outside[usize::from(at > hi)] += 1;
            } else {
                let share = if span > 0.0 { (at - lo) / span } else { 0.0 };
                let column = ((share * columns as f64) as usize).min(columns - 1);
                let steepness = f64::from(gradient) * per_voxel / self.steepest;
                self.steeper += u64::from(steepness > 1.0);
                let row = ((steepness * rows as f64) as usize).min(rows - 1);
                self.values[column] += 1;
                self.joint[row * columns + column] += 1;
            }
        }
        self.steps += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::EMPTY;

    #[test]
    fn a_ramp_fills_all_bins_of_values_and_one_of_gradients() {
        let grid = Grid { size: [64, 4, 4], spacing: [0.5; 3], origin: [0.0; 3] };
        let mut values: Vec<f32> = (0..grid.len()).map(|i| 10.0 + (i % 64) as f32 / 63.0).collect();
        let mut histogram = Histogram::new([10.0, 11.0], 0.05, [16, 10]);
        histogram.add(&grid, &values);
        assert_eq!(histogram.values.iter().sum::<u64>(), 1024);
        assert!(histogram.values.iter().all(|n| *n == 64));
        // 1/63 of the range per voxel is at 0.317 of 0.05; half of it at the ends.
        let row = |r: usize| histogram.joint[r * 16..][..16].iter().sum::<u64>();
        assert_eq!((row(3), row(1)), (62 * 16, 2 * 16));
        // Holes and what is outside are told apart.
        values[0] = EMPTY;
        values[1] = 9.0;
        values[2] = 12.0;
        histogram.add(&grid, &values);
        assert_eq!((histogram.holes, histogram.outside, histogram.steps), (1, [1, 1], 2));
        assert_eq!(histogram.joint.iter().sum::<u64>(), 2045);
        assert!(histogram.steeper > 0, "beside the values outside");
    }

    #[test]
    fn a_constant_field_is_one_bin() {
        let grid = Grid::new([4; 3]);
        let mut histogram = Histogram::new([2.0, 2.0], 0.25, [8, 8]);
        histogram.add(&grid, &[2.0; 64]);
        assert_eq!((histogram.values[0], histogram.joint[0]), (64, 64));
    }
}
