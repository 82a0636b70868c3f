//! Non-local means with known noise, held by guides (Rousselle, Knaus & Zwicker 2012, section 5; Rousselle, Manzi & Zwicker 2013, section 4).
//!
//! A pixel p becomes the mean over a window of 15² pixels q with weights `exp(−max(0, D_colour, D_albedo, D_normal, D_depth))`. Each D
//! compares patches of 3² pixels and all channels of one quantity f, less what noise alone makes them differ:
//!
//! `D = mean[ ((f_p − f_q)² − (V_p + V_q)) / (ε + k²(V_p + V_q)) ]`,  k = 0.7
//!
//! Of colours V is the mean variance of 3² pixels: a pixel's own estimate is low wherever the pixel is, and would make it dim. Of guides,
//! on a range of about 1 with ε = 0.01, it is found in their own picture: the mean of the smaller half of `⅘(f − mean of four
//! neighbours)²` in 7² pixels, times 7, which is the variance of normal noise whatever edges there are (of χ² with one degree of freedom
//! the half below its median has the mean 1/7).
//!
//! The papers take off V_p + min(V_p, V_q), with patches of 7² and k = 0.45: as bright pixels are the noisier ones, dim ones then take
//! nothing from them and up to 5 % of the light is lost; taken off evenly it is kept to 0.5 %. Smaller patches left a third less error at
//! edges of synthetic pictures, and an eighth more in shading. In smoke the guides are as noisy as colours are: held by their gradients,
//! as published, they kept the noise as well (a tenth more error than without guides; as here a tenth less).

use rayon::prelude::*;

use super::Guides;
use crate::device::cpu::simd::exp;
use crate::render::film::Estimate;

/// Half the window and half the patch, in pixels.
const WINDOW: usize = 7;
const PATCH: usize = 1;
const PAD: usize = WINDOW + PATCH;
const K: f32 = 0.7;
/// ε of guides.
const LEAST: f32 = 0.01;
/// Rows that a thread takes at a time.
const BAND: usize = 16;

/// What pixels are compared by, in planes that have a border of [`PAD`] pixels like the outermost ones.
struct Planes {
    size: [usize; 2],
    stride: usize,
    quantities: Vec<Quantity>,
}

/// Colour, or a guide: values and variance of each channel.
struct Quantity {
    channels: Vec<[Vec<f32>; 2]>,
    /// ε
    least: f32,
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
        let channel = |values: &[[f32; 3]], c: usize| values.iter().map(|v| v[c]).collect::<Vec<f32>>();
        let seen = |c: usize| estimate.pixels.iter().map(|p| p[c]).collect::<Vec<f32>>();
        let square: f64 = estimate.pixels.iter().flat_map(|p| &p[..3]).map(|v| f64::from(v * v)).sum();
        let colour = Quantity {
            channels: (0..3)
                .map(|c| [pad(size, &seen(c)), pad(size, &smooth(size, &channel(&estimate.variance, c)))])
                .collect(),
            least: (1e-6 * square / (3 * estimate.pixels.len().max(1)) as f64) as f32 + f32::MIN_POSITIVE,
        };
        let farthest = guides.depth.iter().filter(|d| d.is_finite()).fold(0.0f32, |m, d| m.max(*d));
        let nearest = guides.depth.iter().filter(|d| **d > 0.0).fold(farthest, |m, d| m.min(*d));
        let range = if farthest > nearest { farthest - nearest } else { farthest.max(f32::MIN_POSITIVE) };
        let depth = guides.depth.iter().map(|d| if d.is_finite() { d / range } else { 0.0 }).collect();
        let vector = |values: &[[f32; 3]]| guide(size, (0..3).map(|c| channel(values, c)).collect());
        Planes {
            size,
            stride: size[0] + 2 * PAD,
            quantities: vec![colour, vector(guides.albedo), vector(guides.normal), guide(size, vec![depth])],
        }
    }

    /// The rows from `first` on.
    fn band(&self, first: usize, pixels: &[[f32; 4]], out: &mut [[f32; 4]]) {
        let [width, height] = self.size;
        let rows = out.len() / width;
        let (mut apart, mut sums) = (vec![0.0f32; width + 2 * PATCH], vec![0.0f32; (rows + 2 * PATCH) * width]);
        let (mut exponents, mut total) = (vec![0.0f32; out.len()], vec![0.0f32; out.len()]);
        let reach = WINDOW as isize;
        for (dy, dx) in (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dy, dx))) {
            let to = dy * self.stride as isize + dx;
            exponents.fill(0.0);
            for quantity in &self.quantities {
                for (row, sums) in sums.chunks_exact_mut(width).enumerate() {
                    let p = (first + row + PAD - PATCH) * self.stride + PAD - PATCH;
                    quantity.distance(p, p.wrapping_add_signed(to), &mut apart);
                    for (x, sum) in sums.iter_mut().enumerate() {
                        *sum = apart[x..x + 2 * PATCH + 1].iter().sum();
                    }
                }
                let scale = 1.0 / (quantity.channels.len() * (2 * PATCH + 1).pow(2)) as f32;
                for (row, exponents) in exponents.chunks_exact_mut(width).enumerate() {
                    let patch: [&[f32]; 2 * PATCH + 1] = std::array::from_fn(|n| &sums[(row + n) * width..][..width]);
                    for (x, exponent) in exponents.iter_mut().enumerate() {
                        let sum: f32 = patch.iter().map(|line| line[x]).sum();
                        *exponent = exponent.max(sum * scale);
                    }
                }
            }
            // Pixels with a neighbour inside the picture.
            let across = (-dx).max(0) as usize..width.saturating_sub(dx.max(0) as usize);
            for row in 0..rows {
                let Some(y) = (first + row).checked_add_signed(dy).filter(|y| *y < height) else { continue };
                if across.is_empty() {
                    continue;
                }
                let weights = &mut exponents[row * width..][across.clone()];
                weights.iter_mut().for_each(|e| *e = exp(-*e));
                let from = &pixels[y * width + (across.start as isize + dx) as usize..];
                let outs = out[row * width..][across.clone()].iter_mut().zip(&mut total[row * width..][across.clone()]);
                for ((out, total), (w, pixel)) in outs.zip(weights.iter().zip(from)) {
                    *total += w;
                    *out = std::array::from_fn(|c| out[c] + w * pixel[c]);
                }
            }
        }
        out.iter_mut().zip(total).for_each(|(out, total)| *out = out.map(|v| v / total));
    }
}

impl Quantity {
    /// Distances of a row of pixels from `p` and of one from `q`, summed over channels.
    fn distance(&self, p: usize, q: usize, out: &mut [f32]) {
        out.fill(0.0);
        let n = out.len();
        for [values, variance] in &self.channels {
            let (fp, fq) = (&values[p..][..n], &values[q..][..n]);
            let (vp, vq) = (&variance[p..][..n], &variance[q..][..n]);
            for i in 0..n {
                let (apart, noise) = (fp[i] - fq[i], vp[i] + vq[i]);
                out[i] += (apart * apart - noise) / (self.least + K * K * noise);
            }
        }
    }
}

fn guide(size: [usize; 2], channels: Vec<Vec<f32>>) -> Quantity {
    let channels = channels.iter().map(|values| [pad(size, values), pad(size, &noise(size, values))]).collect();
    Quantity { channels, least: LEAST }
}

/// Variance of the noise of a picture, from the picture itself.
fn noise([width, height]: [usize; 2], values: &[f32]) -> Vec<f32> {
    let at = |x: isize, y: isize| {
        values[y.clamp(0, height as isize - 1) as usize * width + x.clamp(0, width as isize - 1) as usize]
    };
    let residual = |i: usize| {
        let (x, y) = ((i % width) as isize, (i / width) as isize);
        let around = at(x - 1, y) + at(x + 1, y) + at(x, y - 1) + at(x, y + 1);
        0.8 * (at(x, y) - 0.25 * around).powi(2)
    };
    let residuals: Vec<f32> = (0..values.len()).into_par_iter().with_min_len(4096).map(residual).collect();
    let half = |i: usize| {
        let (x, y) = (i % width, i / width);
        let (columns, lines) = (x.saturating_sub(3)..(x + 4).min(width), y.saturating_sub(3)..(y + 4).min(height));
        let mut near = [0.0f32; 49];
        let mut count = 0;
        for line in lines {
            for r in &residuals[line * width..][columns.clone()] {
                near[count] = *r;
                count += 1;
            }
        }
        let near = &mut near[..count];
        let small = count.div_ceil(2);
        near.select_nth_unstable_by(small - 1, f32::total_cmp);
        7.0 * near[..small].iter().sum::<f32>() / small as f32
    };
    (0..values.len()).into_par_iter().with_min_len(1024).map(half).collect()
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
            let side = |columns: std::ops::Range<usize>| {
                let pixels = (0..SIZE[1]).flat_map(|y| columns.clone().map(move |x| y * SIZE[0] + x));
                pixels.map(|i| f64::from(denoised[i][1])).sum::<f64>() / (4 * SIZE[1]) as f64
            };
            side(28..32) - side(24..28)
        };
        // Pixels beside the edge have but those of their own column to go with; noise of the mean of 160 pixels is 0.022 at most.
        assert!((step(true) - 0.1).abs() < 0.05, "{}", step(true));
        // A window of 15 spreads the step to 4/15 between the middles of four columns.
        assert!(step(false) < 0.05, "without guides it is gone: {}", step(false));
    }

    #[test]
    fn the_noise_of_a_guide_is_found_beside_its_edges() {
        let step = |x: usize, y: usize| if x < 28 { 0.2 } else { 0.8 } + 0.002 * y as f32;
        // Sums of twelve uniform numbers are nearly normal, as means over a pixel's samples are.
        let parts: Vec<_> = (0..4).map(|seed| noisy(|_, _| 0.0, |_| 0.05, 10 + seed)).collect();
        let noise_of = |i: usize| parts.iter().map(|p| p.pixels[i][0] + p.pixels[i][1] + p.pixels[i][2]).sum::<f32>();
        let scale = 1.0 / 12f32.sqrt();
        let values: Vec<f32> =
            (0..SIZE[0] * SIZE[1]).map(|i| step(i % SIZE[0], i / SIZE[0]) + scale * noise_of(i)).collect();
        let found = noise(SIZE, &values);
        let mean = found.iter().sum::<f32>() / found.len() as f32;
        // Windows that hold both columns of the edge take the smaller 25 of 35 others: 2.3 times as much, in a ninth of the pixels.
        assert!((0.8..1.5).contains(&(mean / 0.0025)), "{mean}");
        assert!(found.iter().all(|v| *v < 0.02), "an edge of 0.6 is no noise");
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
