//! Denoisers: a picture of few samples made to look like one of many, at the price of a bias that no number of samples takes away.
//! They run after sampling, on what the film knows, on the threads of the rayon pool that they are called in.

use rayon::prelude::*;

use super::film::Estimate;
use crate::frame::Display;
use crate::scene::Denoise;

mod guided;
mod knn;

pub use guided::guided;
pub use knn::knn;

/// What else is known of each pixel, `width·height` values each: means over the pixel's samples of what their paths met first, 0 for
/// those that met nothing.
#[derive(Debug, Clone, Copy)]
pub struct Guides<'a> {
    /// Single-scattering albedo, R, G, B.
    pub albedo: &'a [[f32; 3]],
    /// Normal in world space; shorter where the samples' normals differ.
    pub normal: &'a [[f32; 3]],
    /// World length along the ray.
    pub depth: &'a [f32],
}

/// The picture that is shown of an estimate: denoised as `how` says, and through the Gaussian pixel filter of standard deviation
/// `filter` ([`Estimate::filtered`]). The variance stays that of the samples through the pixel filter.
///
/// The pixel filter comes first for [`Denoise::Knn`], as published, and last for [`Denoise::Guided`], which wants pixels whose noise is
/// independent.
pub fn finished(estimate: &Estimate, guides: &Guides, how: Denoise, filter: f32, display: &Display) -> Estimate {
    let filtered = estimate.filtered(filter);
    match how {
        Denoise::None => filtered,
        Denoise::Knn => Estimate { pixels: knn(&filtered, display), ..filtered },
        Denoise::Guided => {
            let denoised = Estimate { pixels: guided(estimate, guides), ..estimate.clone() };
            Estimate { pixels: denoised.filtered(filter).pixels, ..filtered }
        }
    }
}

/// `row(y, out)` for all rows of a picture, on all threads.
fn rows([width, height]: [usize; 2], row: impl Fn(usize, &mut [[f32; 4]]) + Sync) -> Vec<[f32; 4]> {
    let mut out = vec![[0.0; 4]; width * height];
    out.par_chunks_mut(width.max(1)).enumerate().for_each(|(y, out)| row(y, out));
    out
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_xorshift::XorShiftRng;

    use super::*;

    pub const SIZE: [usize; 2] = [56, 40];
    const COUNT: usize = SIZE[0] * SIZE[1];

    /// A picture, `truth` of (x, y), with even noise of standard deviation `sigma(truth)` whose variance is known.
    pub fn noisy(truth: impl Fn(usize, usize) -> f32, sigma: impl Fn(f32) -> f32, seed: u64) -> Estimate {
        let mut rng = XorShiftRng::seed_from_u64(seed);
        let exact: Vec<f32> = (0..COUNT).map(|i| truth(i % SIZE[0], i / SIZE[0])).collect();
        let pixels = exact
            .iter()
            .map(|v| {
                let mut noise = || v + sigma(*v) * 12f32.sqrt() * (rng.random::<f32>() - 0.5);
                [noise(), noise(), noise(), 1.0]
            })
            .collect();
        Estimate { size: SIZE, pixels, variance: exact.iter().map(|v| [sigma(*v).powi(2); 3]).collect() }
    }

    pub fn rmse(pixels: &[[f32; 4]], truth: impl Fn(usize, usize) -> f32) -> f64 {
        let square = |(i, p): (usize, &[f32; 4])| {
            p[..3].iter().map(|v| f64::from(v - truth(i % SIZE[0], i / SIZE[0])).powi(2)).sum::<f64>()
        };
        (pixels.iter().enumerate().map(square).sum::<f64>() / (3 * pixels.len()) as f64).sqrt()
    }

    pub fn mean(pixels: &[[f32; 4]]) -> f64 {
        pixels.iter().map(|p| f64::from(p[0] + p[1] + p[2]) / 3.0).sum::<f64>() / pixels.len() as f64
    }

    /// Guides that tell nothing, or by `edge` what is left and right of column 28.
    pub fn with_guides<T>(edge: bool, run: impl FnOnce(&Guides) -> T) -> T {
        let left = |i: usize| if edge && i % SIZE[0] < 28 { 0.2 } else { 0.8 };
        let albedo: Vec<[f32; 3]> = (0..COUNT).map(|i| [left(i); 3]).collect();
        run(&Guides { albedo: &albedo, normal: &vec![[0.0, 0.0, 1.0]; COUNT], depth: &vec![5.0; COUNT] })
    }

    /// A disk of a bright ramp before a dim one: edges and shading.
    fn scene(x: usize, y: usize) -> f32 {
        let (x, y) = (x as f32, y as f32);
        if (x - 26.0).powi(2) + (y - 19.0).powi(2) < 150.0 { 0.5 + 0.01 * x } else { 0.1 + 0.002 * y }
    }

    #[test]
    fn without_noise_nothing_changes() {
        let clean = noisy(scene, |_| 0.0, 1);
        let even = noisy(|_, _| 0.4, |_| 0.1, 1);
        let even = Estimate { pixels: vec![[0.4, 0.4, 0.4, 1.0]; COUNT], ..even };
        with_guides(false, |guides| {
            for how in [Denoise::None, Denoise::Knn, Denoise::Guided] {
                let same = finished(&clean, guides, how, 0.0, &Display::default());
                assert!(rmse(&same.pixels, scene) < 1e-6, "{how:?}");
                let same = finished(&even, guides, how, 0.0, &Display::default());
                assert!(rmse(&same.pixels, |_, _| 0.4) < 1e-6, "an even picture of known noise, {how:?}");
            }
        });
    }

    #[test]
    fn pictures_come_nearer_to_the_truth_and_keep_their_light() {
        // Noise as of photons: its variance is proportional to the light.
        let picture = noisy(scene, |v| 0.12 * v.sqrt(), 2);
        let before = rmse(&picture.pixels, scene);
        with_guides(false, |guides| {
            for (how, factor) in [(Denoise::Knn, 0.6), (Denoise::Guided, 0.35)] {
                let after = finished(&picture, guides, how, 0.0, &Display::default());
                let left = rmse(&after.pixels, scene) / before;
                assert!(left < factor, "{how:?}: {left}");
                let kept = mean(&after.pixels) / mean(&picture.pixels);
                // Against the noisy picture's own mean, so that nothing but the filter moves it.
                assert!((kept - 1.0).abs() < 0.005, "{how:?}: {kept} of the light");
                assert_eq!(after.variance, picture.variance);
            }
        });
    }

    #[test]
    fn a_denoised_picture_does_not_depend_on_threads() {
        let picture = noisy(scene, |_| 0.1, 3);
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| with_guides(true, |guides| [knn(&picture, &Display::default()), guided(&picture, guides)]))
        };
        assert_eq!(run(1), run(3));
    }
}
