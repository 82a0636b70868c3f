//! How far a picture is from a reference: what `gloaming compare` prints, and what tests of pictures assert.
//!
//! Over all pixels and the channels R, G, B, scene-linear as stored; alpha is not compared:
//!
//! - `rmse = √mean((a − b)²)`, `relative_rmse = rmse/mean(b)`, `psnr = 20 log₁₀(max(b)/rmse)` in dB;
//! - `relative_mse = mean((a − b)²/(b² + ε))` with `ε = (mean(b)/10)²` (Rousselle et al. 2011, with their ε made relative):
//!   what is dark counts as much as what is bright;
//! - `ssim`, the mean of `(2μ_aμ_b + C₁)(2σ_ab + C₂)/((μ_a² + μ_b² + C₁)(σ_a² + σ_b² + C₂))` over all windows that lie within the
//!   picture (Wang et al. 2004 (13)), Gaussian windows of 11² pixels with σ = 1.5, C₁ = 0.01² and C₂ = 0.03². Their luminance is what
//!   a display would show: `Y = 0.2126 R + 0.7152 G + 0.0722 B` over its 99th percentile among the lit pixels of b, clipped to 0..1,
//!   through the sRGB curve. So it does not depend on the unit of radiance, nor on a few bright pixels.
//!
//! A Monte Carlo picture is compared by [`z_test`]: `z = (a − b)/√V` with V the variance of the difference, normal with unit
//! variance where the two agree in the mean.

use serde::Serialize;

use crate::error::{Error, Result};
use crate::frame::{Frame, srgb_encode};

/// Window of the structural similarity along an edge, in pixels, and its standard deviation.
const WINDOW: usize = 11;
const SIGMA: f64 = 1.5;
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// What is measured; `None` where it is no finite number.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Difference {
    /// Root mean square of the difference.
    pub rmse: f64,
    /// The same over the mean of the reference.
    pub relative_rmse: Option<f64>,
    /// Mean square of the difference relative to the reference, value by value.
    pub relative_mse: Option<f64>,
    /// Largest difference.
    pub max: f64,
    /// Largest value of the reference over `rmse`, dB.
    pub psnr: Option<f64>,
    /// Structural similarity, −1 to 1; 1 for equal pictures. `None` for pictures smaller than a window, and a black reference.
    pub ssim: Option<f64>,
    /// Mean of the picture.
    pub mean_a: f64,
    /// Mean of the reference.
    pub mean_b: f64,
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

/// Measures picture `a` against reference `b`.
///
/// # Errors
/// [`Error::Unsupported`] for pictures of two sizes, and for values that are not finite.
pub fn difference(a: &Frame, b: &Frame) -> Result<Difference> {
    comparable(a, b)?;
    let count = (3 * a.pixels.len()) as f64;
    let mean = |frame: &Frame| rgb(frame).sum::<f64>() / count;
    let (mean_a, mean_b) = (mean(a), mean(b));
    let rmse = (rgb(a).zip(rgb(b)).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / count).sqrt();
    let least = (0.1 * mean_b).powi(2);
    let relative: f64 = rgb(a).zip(rgb(b)).map(|(a, b)| (a - b).powi(2) / (b * b + least)).sum();
    let finite = |v: f64| v.is_finite().then_some(v);
    Ok(Difference {
        rmse,
        relative_rmse: finite(rmse / mean_b),
        relative_mse: finite(relative / count),
        max: rgb(a).zip(rgb(b)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max),
        psnr: finite(20.0 * (rgb(b).fold(0.0, f64::max) / rmse).log10()),
        ssim: similarity(a, b),
        mean_a,
        mean_b,
        width: a.size[0],
        height: a.size[1],
    })
}

/// For each pixel the largest difference over the channels.
///
/// # Errors
/// Those of [`difference`].
pub fn distances(a: &Frame, b: &Frame) -> Result<Vec<f32>> {
    comparable(a, b)?;
    let apart = |(a, b): (&[f32; 4], &[f32; 4])| (0..3).map(|c| (a[c] - b[c]).abs()).fold(0.0, f32::max);
    Ok(a.pixels.iter().zip(&b.pixels).map(apart).collect())
}

fn comparable(a: &Frame, b: &Frame) -> Result<()> {
    if a.size != b.size {
        let [[aw, ah], [bw, bh]] = [a.size, b.size];
        return Err(Error::Unsupported(format!("comparing pictures whose sizes differ: {aw}x{ah} and {bw}x{bh}")));
    }
    match rgb(a).zip(rgb(b)).filter(|(a, b)| !a.is_finite() || !b.is_finite()).count() {
        0 => Ok(()),
        odd => {
            Err(Error::Unsupported(format!("comparing pictures of which {odd} values are not finite: no figure holds")))
        }
    }
}

/// Values of the channels that are compared.
fn rgb(frame: &Frame) -> impl Iterator<Item = f64> {
    frame.pixels.iter().flat_map(|p| [p[0], p[1], p[2]]).map(f64::from)
}

fn luminance(p: &[f32; 4]) -> f64 {
    0.2126 * f64::from(p[0]) + 0.7152 * f64::from(p[1]) + 0.0722 * f64::from(p[2])
}

/// What a display shows of a picture: luminance over `white`, clipped, on the sRGB curve.
fn shown(frame: &Frame, white: f64) -> Vec<f64> {
    frame.pixels.iter().map(|p| srgb_encode((luminance(p) / white).clamp(0.0, 1.0))).collect()
}

fn similarity(a: &Frame, b: &Frame) -> Option<f64> {
    let size = a.size;
    if size.iter().any(|n| *n < WINDOW) {
        return None;
    }
    let mut lit: Vec<f64> = b.pixels.iter().map(luminance).filter(|y| *y > 0.0).collect();
    let at = (0.99 * lit.len() as f64) as usize;
    let white = match lit.len() {
        0 => return None,
        _ => *lit.select_nth_unstable_by(at, f64::total_cmp).1,
    };
    let (a, b) = (shown(a, white), shown(b, white));
    let times = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).collect::<Vec<_>>();
    let [mean_a, mean_b] = [&a, &b].map(|x| windows(size, x));
    let [aa, bb, ab] = [(&a, &a), (&b, &b), (&a, &b)].map(|(x, y)| windows(size, &times(x, y)));
    let at = |i: usize| {
        let (ma, mb) = (mean_a[i], mean_b[i]);
        let (va, vb, cov) = (aa[i] - ma * ma, bb[i] - mb * mb, ab[i] - ma * mb);
        (2.0 * ma * mb + C1) * (2.0 * cov + C2) / ((ma * ma + mb * mb + C1) * (va + vb + C2))
    };
    Some((0..mean_a.len()).map(at).sum::<f64>() / mean_a.len() as f64)
}

/// Gaussian mean over each window that lies within the picture.
fn windows([width, height]: [usize; 2], values: &[f64]) -> Vec<f64> {
    let weight = |i: usize| (-(i as f64 - (WINDOW / 2) as f64).powi(2) / (2.0 * SIGMA * SIGMA)).exp();
    let total: f64 = (0..WINDOW).map(weight).sum();
    let weights: [f64; WINDOW] = std::array::from_fn(|i| weight(i) / total);
    let mean = |of: &dyn Fn(usize) -> f64| (0..WINDOW).map(|i| weights[i] * of(i)).sum::<f64>();
    let (columns, lines) = (width - WINDOW + 1, height - WINDOW + 1);
    let along: Vec<f64> =
        values.chunks_exact(width).flat_map(|row| (0..columns).map(move |x| mean(&|i| row[x + i]))).collect();
    (0..columns * lines).map(|n| mean(&|i| along[n + i * columns])).collect()
}

/// What [`z_test`] finds over all values of known variance, three a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ZTest {
    /// Values whose difference has a variance above 0.
    pub values: usize,
    /// Values without variance that differ all the same: 0 where the two agree.
    pub certain_differences: usize,
    /// z of the pictures' means, `Σ(a − b)/√ΣV`: bias far below the noise of a pixel shows here.
    pub mean: f64,
    /// Mean of z²: 1 where the two agree in the mean and the variances are right, within `√(2/values)` for normal errors.
    pub mean_square: f64,
    /// Share of the values with |z| above 3: 0.0027 for normal errors.
    pub beyond_3: f64,
    /// Largest |z|.
    pub largest: f64,
}

/// Whether `a` and `b` are the same up to noise, given the `variance` of their difference per pixel and channel: of two estimates
/// the sum of the variances of both pixels' means, such as the layer `variance` of a picture holds.
///
/// Values are taken to be independent; where a pixel filter has mixed them `mean` is off, the other figures are not.
///
/// # Errors
/// Those of [`difference`]; [`Error::Unsupported`] for variances of another size, negative or not finite.
pub fn z_test(a: &Frame, b: &Frame, variance: &[[f32; 3]]) -> Result<ZTest> {
    comparable(a, b)?;
    let wrong = variance.iter().flatten().filter(|v| !(**v >= 0.0 && v.is_finite())).count();
    if variance.len() != a.pixels.len() || wrong > 0 {
        let (found, pixels) = (variance.len(), a.pixels.len());
        return Err(Error::Unsupported(format!(
            "{found} variances for {pixels} pixels, of which {wrong} values are negative or not finite"
        )));
    }
    let mut test =
        ZTest { values: 0, certain_differences: 0, mean: 0.0, mean_square: 0.0, beyond_3: 0.0, largest: 0.0 };
    let (mut sum, mut total) = (0.0, 0.0);
    for ((a, b), v) in rgb(a).zip(rgb(b)).zip(variance.iter().flatten().copied().map(f64::from)) {
        if v > 0.0 {
            let z = (a - b) / v.sqrt();
            test.values += 1;
            (sum, total) = (sum + a - b, total + v);
            test.mean_square += z * z;
            test.beyond_3 += if z.abs() > 3.0 { 1.0 } else { 0.0 };
            test.largest = test.largest.max(z.abs());
        } else if a != b {
            test.certain_differences += 1;
        }
    }
    if test.values > 0 {
        test.mean = sum / total.sqrt();
        test.mean_square /= test.values as f64;
        test.beyond_3 /= test.values as f64;
    }
    Ok(test)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_xorshift::XorShiftRng;

    use super::*;

    fn frame(size: [usize; 2], pixel: impl FnMut(usize) -> [f32; 4]) -> Frame {
        let mut frame = Frame::new(size);
        frame.pixels = (0..size[0] * size[1]).map(pixel).collect();
        frame
    }

    fn row(pixels: &[[f32; 4]]) -> Frame {
        frame([pixels.len(), 1], |i| pixels[i])
    }

    #[test]
    fn figures_follow_their_definitions() {
        let b = row(&[[1.0, 2.0, 3.0, 0.5], [0.0, 0.0, 6.0, 1.0]]);
        let a = row(&[[1.0, 2.0, 3.0, 0.9], [0.0, 0.0, 3.0, 0.0]]);
        let d = difference(&a, &b).unwrap();
        let rmse = (9.0f64 / 6.0).sqrt();
        assert!((d.rmse - rmse).abs() < 1e-12 && (d.relative_rmse.unwrap() - rmse / 2.0).abs() < 1e-12);
        assert_eq!((d.max, d.mean_a, d.mean_b), (3.0, 1.5, 2.0));
        assert!((d.psnr.unwrap() - 20.0 * (6.0 / rmse).log10()).abs() < 1e-12);
        // The one value that differs, 3 of 6, over 6² + (2/10)².
        assert!((d.relative_mse.unwrap() - 9.0 / 36.04 / 6.0).abs() < 1e-12);
        assert_eq!(distances(&a, &b).unwrap(), [0.0, 3.0]);
    }

    #[test]
    fn equal_and_black_frames_have_no_ratio() {
        let b = row(&[[0.0; 4]]);
        let d = difference(&b, &b).unwrap();
        assert_eq!((d.rmse, d.relative_rmse, d.relative_mse, d.psnr, d.ssim), (0.0, None, None, None, None));
        let lit = row(&[[0.5; 4]]);
        assert_eq!(difference(&lit, &lit).unwrap().relative_rmse, Some(0.0));
    }

    #[test]
    fn sizes_that_differ_and_values_that_are_no_numbers_are_refused() {
        let (one, two) = (row(&[[0.0; 4]]), row(&[[0.0; 4]; 2]));
        assert!(difference(&one, &two).unwrap_err().to_string().contains("1x1 and 2x1"));
        let odd = row(&[[f32::NAN, 0.0, 0.0, 1.0]]);
        assert!(difference(&one, &odd).unwrap_err().to_string().contains("1 values are not finite"));
        assert!(z_test(&one, &one, &[]).is_err() && z_test(&one, &one, &[[-1.0; 3]]).is_err());
    }

    /// A 24² picture of waves.
    fn waves(scale: f32, ripple: impl Fn(usize) -> f32) -> Frame {
        frame([24, 24], |i| {
            let v = 0.5 + 0.4 * (0.7 * (i % 24) as f32).sin() * (0.3 * (i / 24) as f32).cos();
            [scale * (v + ripple(i)); 4]
        })
    }

    #[test]
    fn similarity_of_even_pictures_has_a_closed_form() {
        // Without structure only the first factor is left, of sRGB-encoded luminances 1 and s(½).
        let (a, b) = (frame([16, 13], |_| [1.0; 4]), frame([16, 13], |_| [2.0; 4]));
        let half = srgb_encode(0.5);
        let exact = (2.0 * half + C1) / (1.0 + half * half + C1);
        assert!((difference(&a, &b).unwrap().ssim.unwrap() - exact).abs() < 1e-12);
        assert_eq!(
            difference(&row(&[[1.0; 4]; 40]), &row(&[[1.0; 4]; 40])).unwrap().ssim,
            None,
            "smaller than a window"
        );
    }

    #[test]
    fn similarity_sees_structure_and_not_the_unit() {
        let even = |_: usize| 0.0;
        let noise = |i: usize| if (i * 7919) % 13 < 6 { 0.08 } else { -0.07 };
        let ssim = |a: &Frame, b: &Frame| difference(a, b).unwrap().ssim.unwrap();
        let reference = waves(1.0, even);
        assert!((ssim(&reference, &reference) - 1.0).abs() < 1e-12);
        let noisy = ssim(&waves(1.0, noise), &reference);
        assert!(noisy < 0.9, "{noisy}");
        assert!((ssim(&waves(100.0, noise), &waves(100.0, even)) - noisy).abs() < 1e-5, "in another unit");
        // An offset of the same rmse leaves the structure.
        let rmse = difference(&waves(1.0, noise), &reference).unwrap().rmse as f32;
        assert!(ssim(&waves(1.0, |_| rmse), &reference) > noisy + 0.05);
        // What stands on its head is not similar.
        assert!(ssim(&waves(1.0, |i| 1.0 - 2.0 * reference.pixels[i][0]), &reference) < 0.3);
    }

    #[test]
    fn a_z_test_tells_noise_from_bias() {
        let mut rng = XorShiftRng::seed_from_u64(7);
        let n = 128;
        // Uniform noise of standard deviation 0.1 · (1 + x/n): the variance differs from pixel to pixel.
        let sigma = |i: usize| 0.1 * (1.0 + (i % n) as f32 / n as f32);
        let reference = frame([n, n], |_| [1.0; 4]);
        let mut estimate = |bias: f32| {
            frame([n, n], |i| {
                let mut noise = || 12f32.sqrt() * sigma(i) * (rng.random::<f32>() - 0.5);
                [1.0 + bias + noise(), 1.0 + bias + noise(), 1.0 + bias + noise(), 0.0]
            })
        };
        let variance: Vec<_> = (0..n * n).map(|i| [sigma(i) * sigma(i); 3]).collect();
        let fair = z_test(&estimate(0.0), &reference, &variance).unwrap();
        // z² of uniform noise has the variance 0.8: five standard errors.
        assert!((fair.mean_square - 1.0).abs() < 5.0 * (0.8 / fair.values as f64).sqrt(), "{fair:?}");
        assert!(fair.mean.abs() < 4.0 && fair.values == 3 * n * n && fair.beyond_3 == 0.0, "{fair:?}");
        // A bias of a thirtieth of a pixel's noise is seen in the mean alone.
        let biased = z_test(&estimate(0.005), &reference, &variance).unwrap();
        assert!(biased.mean > 5.0 && biased.mean_square < 1.05, "{biased:?}");
        // Variances that are too small, by half.
        let bold: Vec<_> = variance.iter().map(|v| v.map(|v| 0.5 * v)).collect();
        assert!(z_test(&estimate(0.0), &reference, &bold).unwrap().mean_square > 1.9);
        let certain = z_test(&estimate(0.0), &reference, &vec![[0.0; 3]; n * n]).unwrap();
        assert!(certain.values == 0 && certain.certain_differences > 3 * n * n - 10);
    }
}
