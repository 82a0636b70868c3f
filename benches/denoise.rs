//! Time of the denoisers on a picture of 1280 × 720 pixels, and what they leave of the error of a synthetic noisy picture.
//!
//! `cargo bench --bench denoise`

use std::time::Instant;

use gloaming::frame::Display;
use gloaming::render::denoise::{Guides, guided, knn};
use gloaming::render::film::{Estimate, Film};

const SIZE: [usize; 2] = [1280, 720];

/// Soft shading, texture, and the edge of a ball.
fn truth(i: usize) -> f32 {
    let (x, y) = ((i % SIZE[0]) as f32 - 640.0, (i / SIZE[0]) as f32 - 360.0);
    let r = x.hypot(y) / 300.0;
    if r < 1.0 { 0.2 + 0.6 * (1.0 - r * r).sqrt() + 0.1 * (0.05 * x).sin() * (0.07 * y).cos() } else { 0.02 }
}

fn main() {
    let count = SIZE[0] * SIZE[1];
    let mut film = Film::new(SIZE);
    let mut state = 1u32;
    let mut random = || {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        state as f32 / u32::MAX as f32
    };
    // Half of the paths find light.
    for _ in 0..16 {
        let pass: Vec<[f32; 4]> = (0..count)
            .map(|i| {
                let mut sample = || if random() < 0.5 { 2.0 * truth(i) } else { 0.0 };
                [sample(), sample(), sample(), 1.0]
            })
            .collect();
        film.add(&pass);
    }
    let estimate = film.estimate();
    let rmse = |pixels: &[[f32; 4]]| {
        let square = |(i, p): (usize, &[f32; 4])| (0..3).map(|c| f64::from(p[c] - truth(i)).powi(2)).sum::<f64>();
        (pixels.iter().enumerate().map(square).sum::<f64>() / (3 * count) as f64).sqrt()
    };
    let guides = Guides { albedo: &vec![[0.5; 3]; count], normal: &vec![[0.0; 3]; count], depth: &vec![1.0; count] };
    println!("noisy      RMSE {:.5}", rmse(&estimate.pixels));
    let run = |name: &str, work: &dyn Fn(&Estimate) -> Vec<[f32; 4]>| {
        let mut least = f64::INFINITY;
        let mut pixels = vec![];
        for _ in 0..3 {
            let begun = Instant::now();
            pixels = work(&estimate);
            least = least.min(begun.elapsed().as_secs_f64());
        }
        println!("{name:10} RMSE {:.5}   {:.2} s", rmse(&pixels), least);
    };
    run("filter 0.5", &|e| e.filtered(0.5).pixels);
    run("knn", &|e| knn(e, &Display::default()));
    run("guided", &|e| guided(e, &guides));
}
