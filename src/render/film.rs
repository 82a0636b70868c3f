//! The film: what is known of each pixel after some random samples, and when that is enough.
//!
//! Mean and sum of squared deviations are updated sample by sample (Welford; Knuth, The Art of Computer Programming 2, 4.2.2 (15), (16)),
//!
//! `m ← m + (x − m)/n,   M ← M + (x − m_before)(x − m)`
//!
//! and two sets of samples merge as (Chan, Golub & LeVeque 1983 (1.5))
//!
//! `m = m_a + δ n_b/n,   M = M_a + M_b + δ² n_a n_b/n,   δ = m_b − m_a`.
//!
//! The variance of a pixel's mean is `M/(n(n − 1))`. A separable Gaussian pixel filter is applied to the estimate (Kroes et al.
//! 2012, rendering pipeline): it is linear, so that filtering every pass and then averaging gives the same picture.

use std::time::Duration;

use rayon::prelude::*;

use crate::frame::Layer;

/// Samples of one pixel.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Moments {
    /// Number of samples.
    pub count: u32,
    /// Mean of premultiplied RGBA.
    pub mean: [f32; 4],
    /// Sum of squared deviations from the mean of R, G, B.
    pub squares: [f32; 3],
}

impl Moments {
    /// One more sample, premultiplied RGBA.
    #[inline]
    pub fn add(&mut self, sample: [f32; 4]) {
        self.count += 1;
        let part = 1.0 / self.count as f32;
        let before = self.mean;
        self.mean = std::array::from_fn(|c| before[c] + (sample[c] - before[c]) * part);
        self.squares = std::array::from_fn(|c| self.squares[c] + (sample[c] - before[c]) * (sample[c] - self.mean[c]));
    }

    /// All samples of another set.
    #[inline]
    pub fn merge(&mut self, other: &Moments) {
        if other.count == 0 {
            return;
        }
        let (a, b) = (self.count as f32, other.count as f32);
        let part = b / (a + b);
        let delta: [f32; 4] = std::array::from_fn(|c| other.mean[c] - self.mean[c]);
        self.mean = std::array::from_fn(|c| self.mean[c] + delta[c] * part);
        self.squares = std::array::from_fn(|c| self.squares[c] + other.squares[c] + delta[c] * delta[c] * (a * part));
        self.count += other.count;
    }

    /// Variance of the mean of R, G, B, estimated from the samples; 0 for fewer than two.
    #[inline]
    pub fn variance(&self) -> [f32; 3] {
        let n = self.count as f32;
        let scale = if self.count < 2 { 0.0 } else { 1.0 / (n * (n - 1.0)) };
        self.squares.map(|m| (m * scale).max(0.0))
    }
}

/// Samples of all pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct Film {
    /// Width and height in pixels.
    pub size: [usize; 2],
    /// `width·height` pixels, row 0 on top.
    pub pixels: Vec<Moments>,
}

/// What a film shows: radiance, and how uncertain it is.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// Width and height in pixels.
    pub size: [usize; 2],
    /// Scene-linear radiance, premultiplied by coverage, RGBA.
    pub pixels: Vec<[f32; 4]>,
    /// Variance of R, G, B of each pixel: of the mean, not of a sample.
    pub variance: Vec<[f32; 3]>,
}

impl Film {
    /// A film without samples.
    pub fn new(size: [usize; 2]) -> Self {
        Film { size, pixels: vec![Moments::default(); size[0] * size[1]] }
    }

    /// One more sample for every pixel, premultiplied RGBA.
    pub fn add(&mut self, samples: &[[f32; 4]]) {
        assert_eq!(samples.len(), self.pixels.len(), "a sample for each pixel");
        self.pixels.par_iter_mut().zip(samples).with_min_len(4096).for_each(|(pixel, sample)| pixel.add(*sample));
    }

    /// All samples of another set of moments for every pixel.
    pub fn merge(&mut self, others: &[Moments]) {
        assert_eq!(others.len(), self.pixels.len(), "moments for each pixel");
        self.pixels.par_iter_mut().zip(others).with_min_len(4096).for_each(|(pixel, other)| pixel.merge(other));
    }

    /// Fewest samples of a pixel.
    pub fn samples(&self) -> u32 {
        self.pixels.iter().map(|p| p.count).min().unwrap_or(0)
    }

    /// Mean standard error of the pixels over their mean radiance, R, G, B alike: 0 for a film that is black throughout, infinite
    /// while a pixel has fewer than two samples.
    pub fn error(&self) -> f64 {
        if self.samples() < 2 {
            return f64::INFINITY;
        }
        let sums = |p: &Moments| {
            let error: f32 = p.variance().map(f32::sqrt).iter().sum();
            [f64::from(error), f64::from(p.mean[0] + p.mean[1] + p.mean[2])]
        };
        // Row by row, so that the sum does not depend on the number of threads.
        let rows = self
            .pixels
            .par_chunks(self.size[0].max(1))
            .map(|row| row.iter().map(sums).fold([0.0; 2], |[e, m], [error, mean]| [e + error, m + mean]));
        let rows: Vec<[f64; 2]> = rows.collect();
        let [error, mean] = rows.iter().fold([0.0; 2], |[e, m], [error, mean]| [e + error, m + mean]);
        if error == 0.0 { 0.0 } else { error / mean }
    }

    /// The picture and its variance as they are.
    pub fn estimate(&self) -> Estimate {
        Estimate {
            size: self.size,
            pixels: self.pixels.iter().map(|p| p.mean).collect(),
            variance: self.pixels.iter().map(Moments::variance).collect(),
        }
    }

    /// The layer `samples` of a picture: samples of each pixel.
    pub fn layer(&self) -> Layer {
        let values = self.pixels.iter().map(|p| p.count as f32).collect();
        Layer { name: "samples".into(), channels: "V".into(), values }
    }
}

impl Estimate {
    /// The picture through a Gaussian pixel filter of standard deviation `sigma` in pixels, cut off at three; 0 leaves it.
    ///
    /// The variance of a weighted mean of independent pixels is `Σw²V`: that of each pixel is right afterwards, but neighbours
    /// are no longer independent. At the border the weights within the picture sum to 1.
    pub fn filtered(&self, sigma: f32) -> Estimate {
        if sigma <= 0.0 {
            return self.clone();
        }
        let radius = (3.0 * sigma).ceil() as usize;
        let weights: Vec<f32> = (0..=radius).map(|d| (-0.5 * (d as f32 / sigma).powi(2)).exp()).collect();
        let squares: Vec<f32> = weights.iter().map(|w| w * w).collect();
        let norm = |at: usize, n: usize| 1.0 / window(at, radius, n).map(|i| weights[i.abs_diff(at)]).sum::<f32>();
        let [across, down] = self.size.map(|n| (0..n).map(|at| norm(at, n)).collect::<Vec<_>>());
        let square = |norms: &[f32]| norms.iter().map(|n| n * n).collect::<Vec<_>>();
        Estimate {
            size: self.size,
            pixels: convolve(self.size, &self.pixels, &weights, [&across, &down]),
            variance: convolve(self.size, &self.variance, &squares, [&square(&across), &square(&down)]),
        }
    }

    /// The layer `variance` of a picture: that of each pixel's R, G, B.
    pub fn layer(&self) -> Layer {
        Layer { name: "variance".into(), channels: "RGB".into(), values: self.variance.as_flattened().to_vec() }
    }
}

/// Indices within `radius` of `at` and below `n`.
fn window(at: usize, radius: usize, n: usize) -> std::ops::Range<usize> {
    at.saturating_sub(radius)..(at + radius + 1).min(n)
}

/// Weighted sums along rows, then along columns; `weights` by distance, each sum times its norm.
fn convolve<const N: usize>(
    [width, height]: [usize; 2],
    values: &[[f32; N]],
    weights: &[f32],
    [across, down]: [&[f32]; 2],
) -> Vec<[f32; N]> {
    let radius = weights.len() - 1;
    let sum = |range: std::ops::Range<usize>, at: usize, norm: f32, value: &dyn Fn(usize) -> [f32; N]| {
        let mut sum = [0.0; N];
        for i in range {
            let (w, v) = (weights[i.abs_diff(at)], value(i));
            (0..N).for_each(|c| sum[c] += w * v[c]);
        }
        sum.map(|s| s * norm)
    };
    let mut along = vec![[0.0; N]; values.len()];
    along.par_chunks_mut(width.max(1)).zip(values.par_chunks(width.max(1))).for_each(|(out, row)| {
        for (x, out) in out.iter_mut().enumerate() {
            *out = sum(window(x, radius, width), x, across[x], &|i| row[i]);
        }
    });
    let mut out = vec![[0.0; N]; values.len()];
    out.par_chunks_mut(width.max(1)).enumerate().for_each(|(y, out)| {
        for (x, out) in out.iter_mut().enumerate() {
            *out = sum(window(y, radius, height), y, down[y], &|j| along[j * width + x]);
        }
    });
    out
}

/// When a picture is good enough: what comes first of what is set.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stop {
    /// Samples of each pixel at most.
    pub samples: u32,
    /// Time that sampling may take; at least one sample is taken.
    pub budget: Option<Duration>,
    /// [`Film::error`] that is small enough; looked at from [`Stop::TRUSTED`] samples on.
    pub error: Option<f64>,
}

impl Stop {
    /// Samples below which an estimated error is not believed: it is itself a random number, of a relative standard deviation
    /// of about `1/√(2n)` for a pixel.
    pub const TRUSTED: u32 = 8;

    /// How many more samples to take for each pixel before asking again, at most `batch` and never past the limits; 0 when the
    /// picture is done. `spent` is the time that the film's samples took.
    ///
    /// Without a budget the answer depends on the film alone, so that pictures are the same on any machine.
    pub fn more(&self, film: &Film, spent: Duration, batch: u32) -> u32 {
        let taken = film.samples();
        let mut more = self.samples.saturating_sub(taken).min(batch);
        if let (Some(target), true) = (self.error, taken >= 2) {
            let error = film.error();
            if error <= target && taken >= Self::TRUSTED.min(self.samples) {
                return 0;
            }
            // The error falls as n^−½; half of what is missing, as the estimate is rough.
            let needed = f64::from(taken) * (error / target).powi(2);
            let missing =
                (0.5 * (needed - f64::from(taken))).ceil().max(f64::from(Self::TRUSTED.saturating_sub(taken)));
            more = more.min(missing.clamp(1.0, f64::from(u32::MAX)) as u32);
        }
        if let (Some(budget), true) = (self.budget, taken > 0) {
            let left = budget.saturating_sub(spent);
            if left.is_zero() {
                return 0;
            }
            let rate = f64::from(taken) / spent.as_secs_f64().max(1e-9);
            more = more.min((left.as_secs_f64() * rate).floor().min(f64::from(u32::MAX)) as u32);
        } else if self.budget.is_some() {
            // The first sample tells how long one takes.
            more = more.min(1);
        }
        more
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_xorshift::XorShiftRng;

    use super::*;

    fn samples(seed: u64, n: usize) -> Vec<[f32; 4]> {
        let mut rng = XorShiftRng::seed_from_u64(seed);
        // A mean far above the deviations is where sums of squares would fail.
        (0..n).map(|_| std::array::from_fn(|c| 1000.0 + c as f32 + rng.random::<f32>())).collect()
    }

    /// Mean and variance of the mean in f64.
    fn exact(samples: &[[f32; 4]]) -> ([f64; 3], [f64; 3]) {
        let n = samples.len() as f64;
        let mean: [f64; 3] = std::array::from_fn(|c| samples.iter().map(|s| f64::from(s[c])).sum::<f64>() / n);
        let variance = std::array::from_fn(|c| {
            samples.iter().map(|s| (f64::from(s[c]) - mean[c]).powi(2)).sum::<f64>() / (n * (n - 1.0))
        });
        (mean, variance)
    }

    #[test]
    fn moments_are_those_of_the_samples_however_they_are_batched() {
        let samples = samples(1, 1000);
        let (mean, variance) = exact(&samples);
        for batches in [vec![1000], vec![1; 1000], vec![3, 997], vec![500, 0, 250, 250], vec![10; 100]] {
            let (mut all, mut at) = (Moments::default(), 0);
            for n in batches {
                let mut batch = Moments::default();
                samples[at..at + n].iter().for_each(|s| batch.add(*s));
                all.merge(&batch);
                at += n;
            }
            assert_eq!(all.count, 1000);
            for c in 0..3 {
                // A thousand roundings at 1000 in f32, at worst all one way: 6e-5 each; at random √1000 of them.
                assert!((f64::from(all.mean[c]) - mean[c]).abs() < 2e-3, "{:?} {mean:?}", all.mean);
                assert!(
                    (f64::from(all.variance()[c]) / variance[c] - 1.0).abs() < 2e-2,
                    "{:?} {variance:?}",
                    all.variance()
                );
            }
        }
        assert_eq!(Moments::default().variance(), [0.0; 3]);
    }

    fn noisy(size: [usize; 2], passes: u32, seed: u64) -> Film {
        let mut rng = XorShiftRng::seed_from_u64(seed);
        let mut film = Film::new(size);
        for _ in 0..passes {
            let pass: Vec<[f32; 4]> =
                film.pixels.iter().map(|_| std::array::from_fn(|_| 0.5 + rng.random::<f32>())).collect();
            film.add(&pass);
        }
        film
    }

    #[test]
    fn the_error_is_the_standard_error_and_falls_as_the_root_of_samples() {
        // Uniform noise of width 1 about 1: 1/√12 for a sample.
        for n in [16u32, 64, 256] {
            let error = noisy([40, 30], n, 3).error();
            let exact = 1.0 / 12f64.sqrt() / f64::from(n).sqrt();
            // The root of an estimated variance is low by about 1/(4n) relative (less here: uniform noise).
            assert!((error / exact - 1.0).abs() < 0.02, "{n}: {error} {exact}");
        }
        assert_eq!(Film::new([2, 2]).error(), f64::INFINITY);
        let mut black = Film::new([2, 2]);
        (0..2).for_each(|_| black.add(&[[0.0; 4]; 4]));
        assert_eq!(black.error(), 0.0);
    }

    #[test]
    fn filtering_the_estimate_is_filtering_every_pass_and_its_variance_is_that_of_the_mean() {
        let (size, sigma) = ([24, 18], 0.8);
        let mut rng = XorShiftRng::seed_from_u64(11);
        let (mut after, mut before) = (Film::new(size), Film::new(size));
        for _ in 0..400 {
            let pass: Vec<[f32; 4]> = (0..size[0] * size[1]).map(|_| [rng.random(), rng.random(), 0.5, 1.0]).collect();
            after.add(&pass);
            let one = Estimate { size, variance: vec![[0.0; 3]; pass.len()], pixels: pass };
            before.add(&one.filtered(sigma).pixels);
        }
        let (filtered, passes) = (after.estimate().filtered(sigma), before.estimate());
        let mut ratio = 0.0;
        for i in 0..size[0] * size[1] {
            for c in 0..4 {
                assert!((filtered.pixels[i][c] - passes.pixels[i][c]).abs() < 1e-5);
            }
            ratio += f64::from(filtered.variance[i][0] / passes.variance[i][0]) / (size[0] * size[1]) as f64;
        }
        // Variances from 400 samples are within 5 % each; the mean of 432 of them far nearer.
        assert!((ratio - 1.0).abs() < 0.02, "{ratio}");
    }

    #[test]
    fn the_filter_keeps_even_pictures_and_the_light_of_a_point() {
        let size = [21, 15];
        let even = Estimate { size, pixels: vec![[0.3, 2.0, 0.0, 1.0]; 315], variance: vec![[0.0; 3]; 315] };
        for p in even.filtered(1.5).pixels {
            assert!((p[0] - 0.3).abs() < 1e-6 && (p[1] - 2.0).abs() < 1e-5 && p[2] == 0.0);
        }
        let mut point = Estimate { pixels: vec![[0.0; 4]; 315], ..even.clone() };
        point.pixels[7 * 21 + 10] = [1.0; 4];
        let spread = point.filtered(1.0);
        assert!((spread.pixels.iter().map(|p| p[0]).sum::<f32>() - 1.0).abs() < 1e-5);
        // Half as high where exp(−d²/2) says so.
        let ratio = spread.pixels[7 * 21 + 12][0] / spread.pixels[7 * 21 + 10][0];
        assert!((ratio - (-2.0f32).exp()).abs() < 1e-5, "{ratio}");
        assert_eq!(even.filtered(0.0), even);
    }

    #[test]
    fn sampling_stops_at_the_first_limit() {
        let film = |n| noisy([16, 16], n, 5);
        let stop = Stop { samples: 100, budget: None, error: None };
        let spent = Duration::from_secs(1);
        assert_eq!([0, 90, 100, 101].map(|n| stop.more(&film(n), spent, 16)), [16, 10, 0, 0]);
        // 1/√12/√n ≤ 0.05 from n = 34 on.
        let stop = Stop { error: Some(0.05), ..stop };
        assert_eq!(stop.more(&film(40), spent, 16), 0);
        let more = stop.more(&film(16), spent, 64);
        assert!((8..=10).contains(&more), "half of the 18 that are missing: {more}");
        // What looks good after three samples is looked at again.
        assert!(Stop { error: Some(0.5), ..stop }.more(&film(3), spent, 16) > 0);
        // Ten samples took a second: five more fit into half of one.
        let stop = Stop { budget: Some(Duration::from_millis(1500)), error: None, ..stop };
        assert_eq!(stop.more(&film(10), spent, 64), 5);
        assert_eq!(stop.more(&film(10), Duration::from_millis(1501), 64), 0);
        assert_eq!(stop.more(&film(0), Duration::ZERO, 64), 1, "one sample at least, and first");
    }
}
