//! The denoiser of Kroes et al. 2012 (interactivity): a mean over the neighbours in a window of 13², each by how alike it looks,
//!
//! `w = exp(−(0.05 |Δc|² + d²/169))`
//!
//! with Δc the distance of two colours as displayed (tone-mapped, on the sRGB curve) and d their distance in pixels. The paper's strength
//! is driven by the mean running variance; here Δc is counted in mean standard errors of what is displayed, so that 0.05 tells noise from
//! edges at any number of samples, and the filter fades as samples come in. What is averaged is radiance; what a display clips is compared
//! as the curve goes on, so that a lamp's light stays in the lamp.

use rayon::prelude::*;

use super::rows;
use crate::device::cpu::simd::exp;
use crate::frame::Display;
use crate::render::film::Estimate;

/// Pixels on each side of the middle one.
const RADIUS: usize = 6;
const AREA: f32 = 169.0;
const COLOUR: f32 = 0.05;

/// The estimate's pixels, denoised for a display.
pub fn knn(estimate: &Estimate, display: &Display) -> Vec<[f32; 4]> {
    let [width, height] = estimate.size;
    let seen = |p: &[f32; 4]| std::array::from_fn(|c| display.shown(p[c] + (1.0 - p[3]) * display.background[c]));
    let shown: Vec<[f32; 3]> = estimate.pixels.par_iter().with_min_len(4096).map(seen).collect();
    let Some(error) = error(estimate, display) else { return estimate.pixels.clone() };
    let scale = COLOUR / error;
    rows(estimate.size, |y, out| {
        for (x, out) in out.iter_mut().enumerate() {
            let here = shown[y * width + x];
            let (mut sum, mut total) = ([0.0; 4], 0.0);
            for j in y.saturating_sub(RADIUS)..(y + RADIUS + 1).min(height) {
                for i in x.saturating_sub(RADIUS)..(x + RADIUS + 1).min(width) {
                    let there = shown[j * width + i];
                    let apart: f32 = (0..3).map(|c| (there[c] - here[c]).powi(2)).sum();
                    let square = (i.abs_diff(x).pow(2) + j.abs_diff(y).pow(2)) as f32;
                    let w = exp(-(scale * apart + square / AREA));
                    let pixel = estimate.pixels[j * width + i];
                    (0..4).for_each(|c| sum[c] += w * pixel[c]);
                    total += w;
                }
            }
            *out = sum.map(|s| s / total);
        }
    })
}

/// Mean variance of a displayed channel over the pixels that have noise; `None` without any.
fn error(estimate: &Estimate, display: &Display) -> Option<f32> {
    let of = |i: usize| -> f64 {
        let (p, v) = (estimate.pixels[i], estimate.variance[i]);
        let spread = |c: usize| {
            let (at, sigma) = (p[c] + (1.0 - p[3]) * display.background[c], v[c].sqrt());
            let half = 0.5 * (display.shown(at + sigma) - display.shown(at - sigma));
            f64::from(half * half)
        };
        (0..3).map(spread).sum::<f64>() / 3.0
    };
    let noisy: Vec<f64> = (0..estimate.pixels.len()).map(of).filter(|v| *v > 0.0).collect();
    (!noisy.is_empty()).then(|| (noisy.iter().sum::<f64>() / noisy.len() as f64) as f32)
}

#[cfg(test)]
mod tests {
    use super::super::tests::{SIZE, noisy, rmse};
    use super::*;
    use crate::scene::Tonemap;

    /// What is displayed is the radiance.
    const LINEAR: Display = Display { background: [0.0; 3], exposure: 1.0, tonemap: Tonemap::None };

    #[test]
    fn even_noise_falls_as_computed() {
        let even = |_: usize, _: usize| 0.5;
        let picture = noisy(even, |_| 0.02, 5);
        let factor = (rmse(&knn(&picture, &LINEAR), even) / rmse(&picture.pixels, even)).powi(2);
        // Among many neighbours of Gaussian noise, the colour's weight keeps 0.1/1.1 of the pixel's own deviation; its own weight of
        // 1/Σw comes on top. Neighbours add Σw²/(Σw)², narrowed to 1/1.1.
        let all = || (-6i32..=6).flat_map(|i| (-6i32..=6).map(move |j| (-f64::from(i * i + j * j) / 169.0).exp()));
        let like = (1.0f64 / 1.1).powf(1.5);
        let (total, squares) =
            (all().sum::<f64>() * like, all().map(|w| w * w).sum::<f64>() * (1.0f64 / 1.2).powf(1.5));
        let own = 0.1 / 1.1 + (1.0 / total) * (1.0 - 0.1 / 1.1);
        let expected = own * own + squares / (total * total) / 1.2;
        // Uniform noise has shorter tails, and windows at the border are smaller.
        assert!((0.7..1.4).contains(&(factor / expected)), "{factor} for {expected}");
    }

    #[test]
    fn edges_far_above_the_noise_stay_and_it_fades_with_the_noise() {
        let edge = |x: usize, _: usize| if x < SIZE[0] / 2 { 0.2 } else { 0.8 };
        for sigma in [0.04, 0.01, 0.0025] {
            let denoised = knn(&noisy(edge, |_| sigma, 6), &LINEAR);
            // 0.05 · 3 · (0.6/0.04)² = 34 in the exponent.
            assert!(rmse(&denoised, edge) < 0.25 * f64::from(sigma), "{sigma}: {}", rmse(&denoised, edge));
        }
    }
}
