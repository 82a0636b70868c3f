//! Uneven axes brought to even ones.
//!
//! Along an uneven axis the values v_i at x_i make the piecewise linear f with f(x_i) = v_i, constant beyond the outermost two;
//! the value of an even cell [a, b] is `∫ f dx / (b − a)`: interpolation where even cells are small beside the file's, an average
//! that keeps the integral of f where they are large. Axes are treated one after another.
//!
//! A cell at least half of whose weight falls on holes is a hole; the weight of the others is brought to 1.

use std::sync::Arc;

use rayon::prelude::*;

use super::coords::Along;
use super::values::{by_slabs, narrowed};
use crate::error::Result;
use crate::field::{Field, HOLE};
use crate::grid::{Grid, Region};

/// An axis that is uneven, or runs backwards.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Line {
    /// Positions of the values, rising.
    centres: Vec<f64>,
    /// Where the first cell begins and the last one ends.
    ends: [f64; 2],
    /// The file has them falling.
    falling: bool,
    /// Evenly spaced: only turned round.
    even: bool,
}

impl Line {
    /// `None` when the coordinates are too few or not strictly rising or falling.
    pub fn new(along: Along, even: bool) -> Option<Line> {
        let Along { mut centres, faces } = along;
        let falling = centres.first()? > centres.last()?;
        if falling {
            centres.reverse();
        }
        if centres.len() < 2 || !centres.windows(2).all(|w| w[0] < w[1]) {
            return None;
        }
        let n = centres.len();
        // Without faces the outermost cells reach as far out as half the way to their neighbours.
        let (mut lo, mut hi) = (1.5 * centres[0] - 0.5 * centres[1], 1.5 * centres[n - 1] - 0.5 * centres[n - 2]);
        if let Some([first, .., last]) = faces.as_deref().filter(|f| f.len() == n + 1) {
            (lo, hi) = (first.min(*last), first.max(*last));
        }
        Some(Line { ends: [lo.min(centres[0]), hi.max(centres[n - 1])], centres, falling, even })
    }

    /// The same axis with other lengths: the file's first value stays, everything else is `factor` times as far from it.
    fn scaled(&self, factor: f64) -> Line {
        let first = if self.falling { self.centres[self.centres.len() - 1] } else { self.centres[0] };
        let place = |x: &f64| first + factor * (x - first);
        let (centres, ends) = (self.centres.iter().map(place).collect(), self.ends.each_ref().map(place));
        Line { centres, ends, ..self.clone() }
    }

    /// Even values that the axis is brought to: as fine as the closest of the file's, but at most twice as many.
    pub fn count(&self) -> usize {
        let n = self.centres.len();
        if self.even {
            return n;
        }
        let least = self.centres.windows(2).map(|w| w[1] - w[0]).fold(f64::INFINITY, f64::min);
        ((self.ends[1] - self.ends[0]) / least - 1e-6).ceil().clamp(n as f64, 2.0 * n as f64) as usize
    }

    fn spacing(&self) -> f64 {
        let n = self.centres.len();
        if self.even {
            return (self.centres[n - 1] - self.centres[0]) / (n - 1) as f64;
        }
        (self.ends[1] - self.ends[0]) / self.count() as f64
    }

    /// Position of the first even value.
    fn origin(&self) -> f64 {
        if self.even { self.centres[0] } else { self.ends[0] + 0.5 * self.spacing() }
    }

    /// What each even value takes from the file's.
    fn taps(&self) -> Vec<Taps> {
        let (n, h) = (self.centres.len(), self.spacing());
        let all: Vec<Taps> = if self.even {
            (0..n).map(|i| Taps { first: i, weights: vec![1.0] }).collect()
        } else {
            (0..self.count())
                .map(|j| self.cell(self.ends[0] + j as f64 * h, self.ends[0] + (j + 1) as f64 * h))
                .collect()
        };
        if !self.falling {
            return all;
        }
        let turn = |taps: Taps| {
            let first = n - taps.first - taps.weights.len();
            Taps { first, weights: taps.weights.into_iter().rev().collect() }
        };
        all.into_iter().map(turn).collect()
    }

    /// `1/(b − a) ∫_a^b φ_i dx` of the hat functions φ_i on the centres.
    fn cell(&self, a: f64, b: f64) -> Taps {
        let c = &self.centres;
        let last = c.len() - 1;
        // Segments that [a, b] meets run from `first` to `past`.
        let first = c.partition_point(|x| *x <= a).saturating_sub(1);
        let past = c.partition_point(|x| *x < b).min(last);
        let mut weights = vec![0.0; past.max(first) - first + 1];
        weights[0] += (b.min(c[0]) - a).max(0.0);
        for i in first..past {
            let (p, q) = (a.max(c[i]), b.min(c[i + 1]));
            if q > p {
                let right = (q - p) * (0.5 * (p + q) - c[i]) / (c[i + 1] - c[i]);
                weights[i - first] += q - p - right;
                weights[i + 1 - first] += right;
            }
        }
        if let Some(w) = weights.last_mut() {
            *w += (b - a.max(c[last])).max(0.0);
        }
        let sum: f64 = weights.iter().sum();
        weights.iter_mut().for_each(|w| *w /= sum);
        Taps { first, weights }
    }
}

/// What one even value takes from the file's: `weights` from the `first` on, in the file's order.
#[derive(Debug, Clone, PartialEq)]
struct Taps {
    first: usize,
    weights: Vec<f64>,
}

/// The axes of a grid that are not even and rising.
#[derive(Debug, PartialEq)]
pub(crate) struct Stretch {
    /// Along x, y, z.
    pub lines: [Option<Line>; 3],
}

impl Stretch {
    /// The same axes with other mean spacings.
    pub fn scaled(&self, factors: [f64; 3]) -> Stretch {
        let lines = std::array::from_fn(|a| self.lines[a].as_ref().map(|line| line.scaled(factors[a])));
        Stretch { lines }
    }

    /// The even grid that a file's own one is brought to.
    pub fn grid(&self, own: &Grid) -> Grid {
        let mut grid = *own;
        for (a, line) in self.lines.iter().enumerate() {
            if let Some(line) = line {
                (grid.size[a], grid.spacing[a], grid.origin[a]) = (line.count(), line.spacing(), line.origin());
            }
        }
        grid
    }

    /// A field on the file's own grid, brought to the even one.
    pub fn field(&self, own: Arc<dyn Field>) -> Resampled {
        Resampled { own, taps: self.lines.each_ref().map(|line| line.as_ref().map(Line::taps)) }
    }
}

/// A field brought to an even grid.
pub(crate) struct Resampled {
    own: Arc<dyn Field>,
    taps: [Option<Vec<Taps>>; 3],
}

/// Values of the file in hand at a time: 64 MiB of value and weight.
const SLAB: usize = 4 << 20;

impl Resampled {
    /// The values of the file that a region needs.
    fn under(&self, region: Region) -> Region {
        let (mut start, mut size) = (region.start, region.size);
        for a in 0..3 {
            if let Some(taps) = &self.taps[a] {
                let taps = &taps[region.start[a]..region.end()[a]];
                start[a] = taps.iter().map(|t| t.first).min().unwrap_or(0);
                size[a] = taps.iter().map(|t| t.first + t.weights.len()).max().unwrap_or(0) - start[a];
            }
        }
        Region { start, size }
    }

    fn slab(&self, region: Region, out: &mut [f64]) -> Result<()> {
        let under = self.under(region);
        let mut values = vec![0.0; under.len()];
        self.own.read_f64(under, &mut values)?;
        let hole = |v: f64| !(v >= f64::from(HOLE) && v <= f64::from(f32::MAX));
        let mut held: Vec<[f64; 2]> = values.iter().map(|&v| if hole(v) { [0.0; 2] } else { [v, 1.0] }).collect();
        let mut size = under.size;
        for a in 0..3 {
            if let Some(taps) = &self.taps[a] {
                held = along(&held, size, a, under.start[a], &taps[region.start[a]..region.end()[a]]);
                size[a] = region.size[a];
            }
        }
        out.iter_mut().zip(&held).for_each(|(o, [v, w])| *o = if *w >= 0.5 { v / w } else { f64::NAN });
        Ok(())
    }
}

/// Resamples one axis of (z, y, x) pairs of value·weight and weight; `start` is the file's index of the first along it.
fn along(held: &[[f64; 2]], size: [usize; 3], axis: usize, start: usize, taps: &[Taps]) -> Vec<[f64; 2]> {
    let stride = [1, size[0], size[0] * size[1]][axis];
    let mut to = size;
    to[axis] = taps.len();
    let row = to[0];
    let mut out = vec![[0.0; 2]; to.iter().product()];
    out.par_chunks_mut(row).enumerate().for_each(|(n, out)| {
        let (j, k) = (n % to[1], n / to[1]);
        for (i, o) in out.iter_mut().enumerate() {
            let at = [i, j, k];
            let Taps { first, weights } = &taps[at[axis]];
            let mut from = at;
            from[axis] = first - start;
            let from = (from[2] * size[1] + from[1]) * size[0] + from[0];
            for (t, w) in weights.iter().enumerate() {
                let [v, valid] = held[from + t * stride];
                *o = [o[0] + w * v, o[1] + w * valid];
            }
        }
    });
    out
}

impl Field for Resampled {
    fn read(&self, region: Region, out: &mut [f32]) -> Result<()> {
        narrowed(self, region, out)
    }

    fn read_f64(&self, region: Region, out: &mut [f64]) -> Result<()> {
        by_slabs(region, SLAB, out, |slab, out| self.slab(slab, out))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Reads a function of the index.
    struct Made<F>([usize; 3], F);

    impl<F: Fn(usize, usize, usize) -> f64 + Send + Sync> Field for Made<F> {
        fn read(&self, _: Region, _: &mut [f32]) -> Result<()> {
            unreachable!("resampling reads f64")
        }

        fn read_f64(&self, region: Region, out: &mut [f64]) -> Result<()> {
            assert!((0..3).all(|a| region.end()[a] <= self.0[a]), "{region:?} lies outside");
            for (n, o) in out.iter_mut().enumerate() {
                let (i, j, k) =
                    (n % region.size[0], n / region.size[0] % region.size[1], n / (region.size[0] * region.size[1]));
                *o = (self.1)(region.start[0] + i, region.start[1] + j, region.start[2] + k);
            }
            Ok(())
        }
    }

    fn chebyshev(n: usize) -> Vec<f64> {
        (0..n).map(|i| -(std::f64::consts::PI * (i as f64 + 0.5) / n as f64).cos()).collect()
    }

    fn whole(stretch: &Stretch, own: Grid, f: impl Fn(usize, usize, usize) -> f64 + Send + Sync + 'static) -> Vec<f64> {
        let grid = stretch.grid(&own);
        let field = stretch.field(Arc::new(Made(own.size, f)));
        let mut out = vec![0.0; grid.len()];
        field.read_f64(grid.region(), &mut out).unwrap();
        out
    }

    fn line(centres: &[f64]) -> Line {
        Line::new(Along::points(centres), false).unwrap()
    }

    #[test]
    fn a_linear_field_stays_linear_inside() {
        let at = chebyshev(24);
        let stretch = Stretch { lines: [None, None, Some(line(&at))] };
        let own = Grid::new([2, 3, 24]);
        let grid = stretch.grid(&own);
        let found = whole(&stretch, own, {
            let at = at.clone();
            move |i, j, k| 3.0 * at[k] + 10.0 * i as f64 - j as f64
        });
        for k in 0..grid.size[2] {
            let z = grid.origin[2] + k as f64 * grid.spacing[2];
            // The interpolant is flat beyond the outermost centres: the cells there are not linear.
            if z - grid.spacing[2] < at[0] || z + grid.spacing[2] > at[23] {
                continue;
            }
            for (i, j) in [(0, 0), (1, 2)] {
                let wanted = 3.0 * z + 10.0 * i as f64 - j as f64;
                let is = found[grid.index([i, j, k])];
                assert!((is - wanted).abs() < 1e-12, "{is}, not {wanted} at {k}");
            }
        }
    }

    #[test]
    fn falling_axes_are_turned_round_without_change() {
        let at: Vec<f64> = (0..5).map(|i| 10.0 - i as f64).collect();
        let stretch = Stretch { lines: [Line::new(Along::points(&at), true), None, None] };
        let own = Grid::new([5, 2, 1]);
        let grid = stretch.grid(&own);
        assert_eq!((grid.size, grid.origin[0], grid.spacing[0]), ([5, 2, 1], 6.0, 1.0));
        let found = whole(&stretch, own, |i, j, _| (i + 10 * j) as f64);
        assert_eq!(found, [4.0, 3.0, 2.0, 1.0, 0.0, 14.0, 13.0, 12.0, 11.0, 10.0]);
    }

    #[test]
    fn holes_stay_holes_and_do_not_bleed() {
        let at = [0.0, 1.0, 2.0, 4.0, 8.0, 16.0];
        let stretch = Stretch { lines: [Some(line(&at)), None, None] };
        let own = Grid::new([6, 1, 1]);
        let grid = stretch.grid(&own);
        let found = whole(&stretch, own, |i, _, _| if i >= 4 { f64::NAN } else { 7.0 });
        for (n, v) in found.iter().enumerate() {
            let x = grid.origin[0] + n as f64 * grid.spacing[0];
            // Between 4 (a value) and 8 (a hole) the border lies half-way.
            assert_eq!(v.is_nan(), x > 6.0, "{v} at {x}");
            assert!(v.is_nan() || (v - 7.0).abs() < 1e-12);
        }
    }

    proptest! {
        /// The integral of the interpolant is kept, whatever the spacing; a constant stays what it is.
        #[test]
        fn integrals_and_constants_are_kept(steps in proptest::collection::vec(0.05f64..3.0, 2..30), falling: bool) {
            let mut at: Vec<f64> = steps.iter().scan(0.0, |x, d| { *x += d; Some(*x) }).collect();
            let values: Vec<f64> = (0..at.len()).map(|i| ((i * 7919) % 13) as f64 - 3.0).collect();
            let n = at.len();
            let ends = [1.5 * at[0] - 0.5 * at[1], 1.5 * at[n - 1] - 0.5 * at[n - 2]];
            let trapezia: f64 = (1..n).map(|i| 0.5 * (values[i] + values[i - 1]) * (at[i] - at[i - 1])).sum();
            let wanted = trapezia + values[0] * (at[0] - ends[0]) + values[n - 1] * (ends[1] - at[n - 1]);
            let mut stored = values;
            if falling {
                at.reverse();
                stored.reverse();
            }
            let stretch = Stretch { lines: [None, Some(line(&at)), None] };
            let own = Grid::new([1, n, 1]);
            let h = stretch.grid(&own).spacing[1];
            let found: f64 = whole(&stretch, own, move |_, j, _| stored[j]).iter().map(|v| v * h).sum();
            prop_assert!((found - wanted).abs() < 1e-9 * (1.0 + wanted.abs()), "{} is not {}", found, wanted);
            let ones = whole(&stretch, own, |_, _, _| 1.0);
            prop_assert!(ones.iter().all(|v| (v - 1.0).abs() < 1e-12));
        }

        /// Any region is that part of the whole.
        #[test]
        fn regions_are_parts_of_the_whole(x0 in 0usize..6, nx in 1usize..6, z0 in 0usize..5, nz in 1usize..5) {
            let (x, z) = ([0.0, 1.0, 3.0, 4.0, 8.0, 9.0], [5.0, 3.0, 2.5, 0.0]);
            let stretch = Stretch { lines: [Some(line(&x)), None, Some(line(&z))] };
            let own = Grid::new([6, 2, 4]);
            let grid = stretch.grid(&own);
            let f = |i: usize, j: usize, k: usize| (i * i + 3 * j + 7 * k * k) as f64;
            let all = whole(&stretch, own, f);
            let region = Region { start: [x0, 0, z0.min(grid.size[2] - 1)], size: [nx, 2, 1] };
            let region = Region { size: [nx.min(grid.size[0] - x0), 2, nz.min(grid.size[2] - region.start[2])], ..region };
            let mut part = vec![0.0f32; region.len()];
            stretch.field(Arc::new(Made(own.size, f))).read(region, &mut part).unwrap();
            for (n, v) in part.iter().enumerate() {
                let at = [n % region.size[0], n / region.size[0] % 2, n / (2 * region.size[0])];
                let at = std::array::from_fn(|a| region.start[a] + at[a]);
                prop_assert_eq!(*v, all[grid.index(at)] as f32);
            }
        }
    }
}
