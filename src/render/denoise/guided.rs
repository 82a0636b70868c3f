//! Non-local means with known noise, held by guides (Rousselle, Knaus & Zwicker 2012, section 5; Rousselle, Manzi & Zwicker 2013, section 4).
//!
//! A pixel p becomes the mean over a window of 15² pixels q with weights `exp(−max(0, D_c, D_f))`. Colours are compared over patches of
//! 3² pixels and three channels, less what noise alone makes them differ:
//!
//! `D_c = mean[ ((c_p − c_q)² − (V_p + V_q)) / (ε + k²(V_p + V_q)) ]`,  k = 0.7
//!
//! and guides (albedo, normal, depth, each on a range of about 1) pixel by pixel,
//!
//! `D_f = max over guides of |f_p − f_q|² / (k_f² max(τ, |∇f_p|², |∇f_q|²))`,  k_f = 0.6, τ = 0.001
//!
//! so that a guide that is noisy itself, and so has large gradients throughout, holds less. V is the mean variance of 3² pixels: a
//! pixel's own estimate is low wherever the pixel is, and would make it dim. The papers take off V_p + min(V_p, V_q), with patches of 7²
//! and k = 0.45: as bright pixels are the noisier ones, dim ones then take nothing from them and up to 5 % of the light is lost; taken
//! off evenly it is kept to 0.1 %. Smaller patches left a third less error at edges of synthetic pictures, and an eighth more in shading.

use rayon::prelude::*;

use super::Guides;
use crate::device::cpu::simd::exp;
use crate::render::film::Estimate;

/// Half the window and half the patch, in pixels.
const WINDOW: usize = 7;
const PATCH: usize = 1;
const PAD: usize = WINDOW + PATCH;
const K: f32 = 0.7;
const K_GUIDE: f32 = 0.6;
const TAU: f32 = 1e-3;
/// Rows that a thread takes at a time.
const BAND: usize = 16;

/// Values of a picture in planes, each with a border of [`PAD`] pixels like the outermost ones.
struct Planes {
    size: [usize; 2],
    stride: usize,
    colour: [Vec<f32>; 3],
    variance: [Vec<f32>; 3],
    guides: Vec<Guide>,
    /// ε
    least: f32,
}

/// One guide: its channels, and `1/(k_f² max(τ, |∇f|²))`.
struct Guide {
    channels: Vec<Vec<f32>>,
    hold: Vec<f32>,
}

/// The estimate's pixels, denoised.
pub fn guided(estimate: &Estimate, guides: &Guides) -> Vec<[f32; 4]> {
    let [width, _] = estimate.size;
    let planes = Planes::new(estimate, guides);
    let mut out = vec![[0.0; 4]; estimate.pixels.len()];
    let bands = out.par_chunks_mut((BAND * width).max(1)).enumerate();
    bands.for_each(|(n, out)| planes.band(n * BAND, &estimate.pixels, out));
    out
}

impl Planes {
    fn new(estimate: &Estimate, guides: &Guides) -> Self {
        let size = estimate.size;
        let padded = |values: &[f32]| pad(size, values);
        let channel = |values: &[[f32; 3]], c: usize| values.iter().map(|v| v[c]).collect::<Vec<f32>>();
        let colour = std::array::from_fn(|c| padded(&estimate.pixels.iter().map(|p| p[c]).collect::<Vec<_>>()));
        let variance = std::array::from_fn(|c| padded(&smooth(size, &channel(&estimate.variance, c))));
        let square: f64 = estimate.pixels.iter().flat_map(|p| &p[..3]).map(|v| f64::from(v * v)).sum();
        let vector = |values: &[[f32; 3]]| guide(size, (0..3).map(|c| channel(values, c)).collect(), 1.0);
        let farthest = guides.depth.iter().fold(0.0f32, |m, d| m.max(*d));
        let nearest = guides.depth.iter().filter(|d| **d > 0.0).fold(farthest, |m, d| m.min(*d));
        let range = if farthest > nearest { farthest - nearest } else { farthest.max(f32::MIN_POSITIVE) };
        Planes {
            size,
            stride: size[0] + 2 * PAD,
            colour,
            variance,
            guides: vec![vector(guides.albedo), vector(guides.normal), guide(size, vec![guides.depth.to_vec()], range)],
            least: (1e-6 * square / (3 * estimate.pixels.len().max(1)) as f64) as f32 + f32::MIN_POSITIVE,
        }
    }

    /// The rows from `first` on.
    fn band(&self, first: usize, pixels: &[[f32; 4]], out: &mut [[f32; 4]]) {
        let [width, height] = self.size;
        let rows = out.len() / width;
        let wide = width + 2 * PATCH;
        let (mut apart, mut sums) = (vec![0.0f32; wide], vec![0.0f32; (rows + 2 * PATCH) * width]);
        let (mut exponent, mut total) = (vec![0.0f32; width], vec![0.0f32; out.len()]);
        let reach = WINDOW as isize;
        for (dy, dx) in (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dy, dx))) {
            for (row, sums) in sums.chunks_exact_mut(width).enumerate() {
                let p = (first + row + PAD - PATCH) * self.stride + PAD - PATCH;
                self.distance(p, p.wrapping_add_signed(dy * self.stride as isize + dx), &mut apart);
                for (x, sum) in sums.iter_mut().enumerate() {
                    *sum = apart[x..x + 2 * PATCH + 1].iter().sum();
                }
            }
            // Pixels with a neighbour inside the picture.
            let across = (-dx).max(0) as usize..width - (dx.max(0) as usize).min(width);
            for row in 0..rows {
                let Some(y) = (first + row).checked_add_signed(dy).filter(|y| *y < height) else { continue };
                if across.is_empty() {
                    continue;
                }
                let scale = 1.0 / (3 * (2 * PATCH + 1).pow(2)) as f32;
                let exponent = &mut exponent[across.clone()];
                exponent.fill(0.0);
                for patch in 0..2 * PATCH + 1 {
                    let sums = &sums[(row + patch) * width..][across.clone()];
                    exponent.iter_mut().zip(sums).for_each(|(e, s)| *e += s * scale);
                }
                let p = (first + row + PAD) * self.stride + PAD + across.start;
                let q = p.wrapping_add_signed(dy * self.stride as isize + dx);
                self.guides.iter().for_each(|guide| guide.hold(p, q, exponent));
                exponent.iter_mut().for_each(|e| *e = exp(-e.max(0.0)));
                let from = &pixels[y * width + (across.start as isize + dx) as usize..];
                let outs = out[row * width..][across.clone()].iter_mut().zip(&mut total[row * width..][across.clone()]);
                for ((out, total), (w, pixel)) in outs.zip(exponent.iter().zip(from)) {
                    *total += w;
                    *out = std::array::from_fn(|c| out[c] + w * pixel[c]);
                }
            }
        }
        out.iter_mut().zip(total).for_each(|(out, total)| *out = out.map(|v| v / total));
    }

    /// Distances of the colours of a row of pixels from `p` and of one from `q`, summed over channels.
    fn distance(&self, p: usize, q: usize, out: &mut [f32]) {
        out.fill(0.0);
        let n = out.len();
        for (colour, variance) in self.colour.iter().zip(&self.variance) {
            let (cp, cq) = (&colour[p..][..n], &colour[q..][..n]);
            let (vp, vq) = (&variance[p..][..n], &variance[q..][..n]);
            for i in 0..n {
                let (apart, noise) = (cp[i] - cq[i], vp[i] + vq[i]);
                out[i] += (apart * apart - noise) / (self.least + K * K * noise);
            }
        }
    }
}

impl Guide {
    /// Raises the exponents of a row of pixels from `p` and of one from `q` to what this guide says.
    fn hold(&self, p: usize, q: usize, exponent: &mut [f32]) {
        let n = exponent.len();
        let (hp, hq) = (&self.hold[p..][..n], &self.hold[q..][..n]);
        for (i, e) in exponent.iter_mut().enumerate() {
            let mut square = 0.0;
            for channel in &self.channels {
                let apart = channel[p + i] - channel[q + i];
                square += apart * apart;
            }
            *e = e.max(square * hp[i].min(hq[i]));
        }
    }
}

/// A guide over `range`.
fn guide(size: [usize; 2], channels: Vec<Vec<f32>>, range: f32) -> Guide {
    let [width, height] = size;
    let channels: Vec<Vec<f32>> = channels
        .into_iter()
        .map(|c| c.into_iter().map(|v| if v.is_finite() { v / range } else { 0.0 }).collect())
        .collect();
    let gradient = |i: usize| {
        let (x, y) = (i % width, i / width);
        let [left, right] = [x.saturating_sub(1), (x + 1).min(width - 1)];
        let [above, below] = [y.saturating_sub(1), (y + 1).min(height - 1)];
        let square = |c: &Vec<f32>| {
            let (dx, dy) = (c[y * width + right] - c[y * width + left], c[below * width + x] - c[above * width + x]);
            0.25 * (dx * dx + dy * dy)
        };
        channels.iter().map(square).sum::<f32>()
    };
    let gradients: Vec<f32> = (0..width * height).map(gradient).collect();
    let hold: Vec<f32> = smooth(size, &gradients).iter().map(|g| 1.0 / (K_GUIDE * K_GUIDE * g.max(TAU))).collect();
    Guide { channels: channels.iter().map(|c| pad(size, c)).collect(), hold: pad(size, &hold) }
}

/// Means of 3² pixels, of those within the picture.
fn smooth([width, height]: [usize; 2], values: &[f32]) -> Vec<f32> {
    let around = |at: usize, n: usize| at.saturating_sub(1)..(at + 2).min(n);
    let at = |i: usize| {
        let (x, y) = (around(i % width, width), around(i / width, height));
        let count = (x.len() * y.len()) as f32;
        y.flat_map(|y| x.clone().map(move |x| y * width + x)).map(|i| values[i]).sum::<f32>() / count
    };
    (0..values.len()).map(at).collect()
}

/// A plane with its border.
fn pad([width, height]: [usize; 2], values: &[f32]) -> Vec<f32> {
    let inside = |at: usize, n: usize| at.saturating_sub(PAD).min(n - 1);
    let rows = (0..height + 2 * PAD).map(|y| &values[inside(y, height) * width..][..width]);
    rows.flat_map(|row| (0..width + 2 * PAD).map(move |x| row[inside(x, width)])).collect()
}

#[cfg(test)]
mod tests {
    use super::super::tests::{SIZE, noisy, rmse, with_guides};
    use super::*;

    #[test]
    fn even_noise_falls_nearly_to_that_of_the_whole_window() {
        let even = |_: usize, _: usize| 0.5;
        let picture = noisy(even, |_| 0.2, 5);
        let denoised = with_guides(false, |guides| guided(&picture, guides));
        let inside = |pixels: &[[f32; 4]]| -> Vec<[f32; 4]> {
            let deep =
                |i: &usize| (8..SIZE[0] - 8).contains(&(i % SIZE[0])) && (8..SIZE[1] - 8).contains(&(i / SIZE[0]));
            (0..pixels.len()).filter(deep).map(|i| pixels[i]).collect()
        };
        let factor = (rmse(&inside(&denoised), even) / rmse(&inside(&picture.pixels), even)).powi(2);
        // All 225 weights alike would give 1/225. D_c is a mean of 27 values about 0, each of them (u² − 2V)/0.98 V, with u² of mean
        // 2V and standard deviation 2.4 V for uniform noise: its standard deviation is 0.46, so that half of the weights are 1 and
        // the others exp(−0.37) in the mean. That and patches that overlap cost less than as much again.
        assert!((1.0 / 225.0..2.0 / 225.0).contains(&factor), "1/{}", 1.0 / factor);
    }

    #[test]
    fn an_edge_that_only_guides_know_stays() {
        // A step of half the noise's deviation: too little for colours to tell.
        let edge = |x: usize, _: usize| if x < 28 { 0.5 } else { 0.6 };
        let picture = noisy(edge, |_| 0.2, 7);
        let step = |known: bool| {
            let denoised = with_guides(known, |guides| guided(&picture, guides));
            let column =
                |x: usize| (0..SIZE[1]).map(|y| f64::from(denoised[y * SIZE[0] + x][1])).sum::<f64>() / SIZE[1] as f64;
            column(28) - column(27)
        };
        // 7 columns of 40 pixels on each side: 0.2·√(2/280) = 0.017 of noise.
        assert!((step(true) - 0.1).abs() < 0.05, "{}", step(true));
        assert!(step(false) < 0.05, "without guides it is gone: {}", step(false));
    }

    #[test]
    fn a_firefly_is_spread_and_not_lost() {
        let mut picture = noisy(|_, _| 0.5, |_| 0.05, 8);
        let at = 20 * SIZE[0] + 25;
        // One bright sample among 16: the pixel's mean and its standard error are alike.
        picture.pixels[at] = [10.0, 10.0, 10.0, 1.0];
        picture.variance[at] = [100.0; 3];
        let denoised = with_guides(false, |guides| guided(&picture, guides));
        assert!(denoised[at][0] < 2.0, "{}", denoised[at][0]);
        let light = |pixels: &[[f32; 4]]| pixels.iter().map(|p| f64::from(p[0])).sum::<f64>();
        let (before, after) = (light(&picture.pixels), light(&denoised));
        assert!((after / before - 1.0).abs() < 0.01, "{before} {after}");
    }

    #[test]
    fn pictures_smaller_than_the_window_are_fine() {
        for size in [[1, 1], [3, 2], [1, 20]] {
            let n = size[0] * size[1];
            let estimate = Estimate { size, pixels: vec![[0.5; 4]; n], variance: vec![[0.1; 3]; n] };
            let guides =
                Guides { albedo: &vec![[0.0; 3]; n], normal: &vec![[0.0; 3]; n], depth: &vec![f32::INFINITY; n] };
            assert!(guided(&estimate, &guides).iter().flatten().all(|v| (v - 0.5).abs() < 1e-6));
        }
    }
}
