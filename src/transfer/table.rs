//! Tabulated transfer functions, and what can be seen in a range of values.

use super::graded::Graded;

/// A transfer function, tabulated: entry `i` of `n` stands for the normalised value `i/(n−1)`; in between it is linear, and
/// values outside 0..1 are clamped.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// Data value that maps to 0.
    pub lo: f32,
    /// Data value that maps to 1.
    pub hi: f32,
    /// Extinction σ_t per world length, of the colour channel that dims most.
    pub extinction: Vec<f32>,
    /// Factor on it per channel, 0..1, the largest 1.
    pub chromatic: [f32; 3],
    /// Single-scattering albedo ω per channel.
    pub albedo: Vec<[f32; 3]>,
    /// Emitted radiance per world length and channel; empty when nothing glows.
    pub emission: Vec<[f32; 3]>,
    /// The same for each gradient magnitude, where that matters: the columns above bound it then.
    pub graded: Option<Graded>,
    /// Whether samples take the mean over all values between those at the ends of their interval, as if the values in
    /// between were there in even shares (pre-integration), instead of that in the middle.
    pub preintegrated: bool,
}

/// Optical properties at a value and a gradient magnitude.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Optics {
    /// Extinction per world length.
    pub extinction: f32,
    /// Single-scattering albedo per channel.
    pub albedo: [f32; 3],
    /// Emitted radiance per world length and channel.
    pub emission: [f32; 3],
}

impl Default for Table {
    /// Nothing to see.
    fn default() -> Self {
        Table {
            lo: 0.0,
            hi: 1.0,
            extinction: vec![0.0; Table::ENTRIES],
            chromatic: [1.0; 3],
            albedo: vec![[0.0; 3]; Table::ENTRIES],
            emission: vec![],
            graded: None,
            preintegrated: false,
        }
    }
}

impl Table {
    /// Entries of every table.
    pub const ENTRIES: usize = 1024;

    /// The normalised value of a data value, clamped to 0..1.
    pub fn normalise(&self, value: f32) -> f32 {
        ((value - self.lo) * self.scale()).clamp(0.0, 1.0)
    }

    /// `1/(hi − lo)`, 0 when the range is a point.
    pub fn scale(&self) -> f32 {
        if self.hi > self.lo { 1.0 / (self.hi - self.lo) } else { 0.0 }
    }

    /// Columns as kernels read them, row after row: extinction, albedo and emission.
    pub fn columns(&self) -> (&[f32], &[[f32; 3]], &[[f32; 3]]) {
        match &self.graded {
            Some(graded) => (&graded.extinction, &graded.albedo, &graded.emission),
            None => (&self.extinction, &self.albedo, &self.emission),
        }
    }

    /// What a data value that is no hole looks like where its gradient has this magnitude (data values per world length; of
    /// no account for one-dimensional tables).
    pub fn look_up(&self, value: f32, gradient: f32) -> Optics {
        let (extinction, albedo, emission) = self.columns();
        let width = self.extinction.len();
        let place = |at: f32, n: usize| {
            let first = (at as usize).min(n.saturating_sub(2));
            (first, (first + 1).min(n - 1), at - first as f32)
        };
        let (i, right, u) = place(self.normalise(value) * (width - 1) as f32, width);
        let rows = extinction.len() / width;
        let row = self.graded.as_ref().map_or(0.0, |g| (gradient * g.scale()).clamp(0.0, (rows - 1) as f32));
        let (j, below, v) = place(row, rows);
        let mix = |of: &dyn Fn(usize) -> f32| {
            let along = |j: usize| of(j * width + i) * (1.0 - u) + of(j * width + right) * u;
            let (a, b) = (along(j), along(below));
            a + v * (b - a)
        };
        Optics {
            extinction: mix(&|e| extinction[e]),
            albedo: std::array::from_fn(|c| mix(&|e| albedo[e][c])),
            emission: std::array::from_fn(|c| mix(&|e| emission.get(e).map_or(0.0, |v| v[c]))),
        }
    }

    /// The extinction of a data value that is no hole, as kernels read it.
    pub fn extinction_of(&self, value: f32) -> f32 {
        let last = self.extinction.len() - 1;
        let at = self.normalise(value) * last as f32;
        let i = (at as usize).min(last.saturating_sub(1));
        self.extinction[i] + (at - i as f32) * (self.extinction[(i + 1).min(last)] - self.extinction[i])
    }

    /// The data value nearest to `value` that has this extinction; the one whose extinction is nearest, where none has it.
    pub fn nearest_with(&self, extinction: f32, value: f32) -> f32 {
        let last = self.extinction.len() - 1;
        let at = self.normalise(value) * last as f32;
        // Where a segment of the table takes on the extinction, nearest to `at`.
        let within = |i: usize| {
            let (a, b) = (self.extinction[i], self.extinction[i + 1]);
            let inside = a.min(b) <= extinction && extinction <= a.max(b);
            inside.then(
                || if a == b { at.clamp(i as f32, (i + 1) as f32) } else { i as f32 + (extinction - a) / (b - a) },
            )
        };
        let own = (at as usize).min(last.saturating_sub(1));
        let mut best: Option<f32> = None;
        for away in 0..last {
            // No segment farther away can be nearer.
            if best.is_some_and(|b| (b - at).abs() < away as f32 - 1.0) {
                break;
            }
            let sides = [own.checked_sub(away), Some(own + away).filter(|&i| i < last)];
            for found in sides.into_iter().flatten().filter_map(within) {
                if best.is_none_or(|b| (found - at).abs() < (b - at).abs()) {
                    best = Some(found);
                }
            }
        }
        let entry = best.unwrap_or_else(|| {
            let off = |i: &usize| (self.extinction[*i] - extinction).abs();
            (0..=last).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(0) as f32
        });
        self.lo + entry / last.max(1) as f32 * (self.hi - self.lo)
    }

    /// The albedo, when it is the same for every value.
    pub fn constant_albedo(&self) -> Option<[f32; 3]> {
        let (_, albedo, _) = self.columns();
        albedo.iter().all(|a| *a == albedo[0]).then(|| albedo[0])
    }

    /// True when extinction and albedo are the same in all channels for every value.
    pub fn gray(&self) -> bool {
        self.chromatic == [1.0; 3] && self.columns().1.iter().all(|a| a[0] == a[1] && a[1] == a[2])
    }

    /// For each range of data values `[lo, hi]`, the largest extinction or emission (per world length, any channel) of any
    /// value in it; an empty range (`lo > hi`) has 0.
    ///
    /// The bound holds for the table as kernels read it, linear between entries, and is 0 only where nothing can be seen.
    /// Constant time per range.
    pub fn majorants(&self, ranges: &[[f32; 2]]) -> Vec<f32> {
        let last = self.extinction.len() - 1;
        let peaks = Peaks::new((0..=last).map(|i| self.visibility(i)).collect());
        let at = |value: f32| self.normalise(value) * last as f32;
        let majorant = |&[lo, hi]: &[f32; 2]| match lo <= hi {
            true => peaks.max(at(lo).floor() as usize, (at(hi).ceil() as usize).min(last)),
            false => 0.0,
        };
        ranges.iter().map(majorant).collect()
    }

    /// For each range of data values the largest extinction of any value in it, as [`Table::majorants`] bounds both. `gradients`
    /// are the ranges of gradient magnitudes in the same places, for a two-dimensional table: of its rows only those count.
    pub fn densest(&self, ranges: &[[f32; 2]], gradients: Option<&[[f32; 2]]>) -> Vec<f32> {
        let last = self.extinction.len() - 1;
        let entries = |[lo, hi]: [f32; 2]| {
            let at = |value: f32| self.normalise(value) * last as f32;
            (at(lo).floor() as usize, (at(hi).ceil() as usize).min(last))
        };
        let Some((graded, gradients)) = self.graded.as_ref().zip(gradients) else {
            let peaks = Peaks::new(self.extinction.clone());
            let most = |&[lo, hi]: &[f32; 2]| {
                let (first, last) = entries([lo, hi.max(lo)]);
                if lo <= hi { peaks.max(first, last) } else { 0.0 }
            };
            return ranges.iter().map(most).collect();
        };
        let rows: Vec<Peaks> = graded.extinction.chunks(last + 1).map(|row| Peaks::new(row.to_vec())).collect();
        let bottom = rows.len() - 1;
        let most = |(&[lo, hi], &[flat, steep]): (&[f32; 2], &[f32; 2])| {
            if !(lo <= hi && flat <= steep) {
                return 0.0;
            }
            let (first, last) = entries([lo, hi]);
            let at = |gradient: f32| (gradient * graded.scale()).clamp(0.0, bottom as f32);
            let (above, below) = (at(flat).floor() as usize, (at(steep).ceil() as usize).min(bottom));
            rows[above..=below].iter().fold(0.0f32, |most, row| most.max(row.max(first, last)))
        };
        ranges.iter().zip(gradients).map(most).collect()
    }

    /// Extinction or emission of an entry, whichever is larger.
    fn visibility(&self, entry: usize) -> f32 {
        let emission = self.emission.get(entry).copied().unwrap_or_default();
        emission.into_iter().fold(self.extinction[entry], f32::max)
    }
}

/// Maxima of runs of entries: level `l` holds the maximum of the `2^l` entries from each one on.
struct Peaks(Vec<Vec<f32>>);

impl Peaks {
    fn new(values: Vec<f32>) -> Self {
        let mut levels = vec![values];
        while let Some(below) = levels.last().filter(|l| l.len() > 1) {
            let reach = 1 << (levels.len() - 1);
            if below.len() <= reach {
                break;
            }
            levels.push(below.iter().zip(&below[reach..]).map(|(a, b)| a.max(*b)).collect());
        }
        Peaks(levels)
    }

    /// The largest of entries `first..=last`.
    fn max(&self, first: usize, last: usize) -> f32 {
        let level = (last - first + 1).ilog2() as usize;
        self.0[level][first].max(self.0[level][last + 1 - (1 << level)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A table with gaps: about half of its entries can be seen.
    fn table(seeds: &[u8], lo: f32, hi: f32) -> Table {
        let entry = |seed: &u8| if *seed < 128 { 0.0 } else { f32::from(*seed) - 127.0 };
        let extinction: Vec<f32> = seeds.iter().map(entry).collect();
        let emission = seeds.iter().rev().map(|s| [0.0, if *s > 250 { 300.0 } else { 0.0 }, 0.0]).collect();
        let albedo = vec![[1.0; 3]; seeds.len()];
        Table { lo, hi, albedo, extinction, emission, ..Default::default() }
    }

    /// What a kernel reads at a data value.
    fn seen(table: &Table, value: f32) -> f32 {
        let x = table.normalise(value) * (table.extinction.len() - 1) as f32;
        let i = (x as usize).min(table.extinction.len() - 2);
        let t = x - i as f32;
        let lerp = |a: f32, b: f32| a * (1.0 - t) + b * t;
        let emission = lerp(table.emission[i][1], table.emission[i + 1][1]);
        lerp(table.extinction[i], table.extinction[i + 1]).max(emission)
    }

    proptest! {
        /// No value in a range is more visible than the range's majorant, the majorant is reached by a value or by a
        /// neighbouring entry, and it is 0 only where nothing can be seen.
        #[test]
        fn majorants_bound_every_value_in_their_range(
            seeds in prop::collection::vec(any::<u8>(), 2..40),
            a in -0.2f32..1.2, width in 0.0f32..0.6, lo in -5.0f32..5.0, span in 0.1f32..100.0,
        ) {
            let table = table(&seeds, lo, lo + span);
            let last = seeds.len() - 1;
            let range = [lo + a * span, lo + (a + width) * span];
            let majorant = table.majorants(&[range])[0];
            let mut reached = 0.0f32;
            for i in 0..=1000 {
                let value = range[0] + (range[1] - range[0]) * (i as f32 / 1000.0);
                if value <= range[1] {
                    reached = reached.max(seen(&table, value));
                    prop_assert!(seen(&table, value) <= majorant * (1.0 + 1e-6), "{value}: {majorant}");
                }
            }
            let entries = |v: f32| table.normalise(v) * last as f32;
            let (first, end) = (entries(range[0]).floor() as usize, entries(range[1]).ceil() as usize);
            let brute = (first..=end.min(last)).map(|i| table.visibility(i)).fold(0.0, f32::max);
            prop_assert_eq!(majorant, brute);
            // Entries of the table differ by at least 1, so a visible majorant shows inside the range unless it only
            // touches the visible entry's neighbour.
            prop_assert!(majorant > 0.0 || reached == 0.0);
        }
    }

    #[test]
    fn ranges_that_are_empty_or_outside_are_bounded_too() {
        let table = table(&[0, 0, 200, 0, 130], 0.0, 4.0);
        let inf = f32::INFINITY;
        let ranges =
            [[inf, -inf], [0.0, 1.0], [0.0, 1.5], [2.0, 2.0], [3.0, 3.0], [9.0, 10.0], [-9.0, -8.0], [-9.0, 9.0]];
        assert_eq!(table.majorants(&ranges), [0.0, 0.0, 73.0, 73.0, 0.0, 3.0, 0.0, 73.0]);
    }

    #[test]
    fn a_range_of_values_that_is_a_point_reads_the_first_entry() {
        let table = table(&[200, 0], 1.0, 1.0);
        assert_eq!(table.majorants(&[[1.0, 1.0], [-3.0, 8.0]]), [73.0, 73.0]);
    }
}
