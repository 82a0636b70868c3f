//! `gloaming compare`: how far two EXR frames are apart.
//!
//! Over all pixels and the channels R, G, B, scene-linear as stored: `rmse = √mean((a − b)²)`,
//! `relative_rmse = rmse/mean(b)`, `psnr = 20 log₁₀(max(b)/rmse)` in dB. Alpha is not compared.

use std::io::Write;
use std::path::PathBuf;

use anyhow::{Context as _, bail};
use clap::Args;
use gloaming::frame::Frame;
use gloaming::sink::exr;
use gloaming::transfer::TransferFunction;
use serde::Serialize;

/// Measure how far an EXR frame is from a reference
#[derive(Args)]
#[command(after_help = "\
Examples:
  gloaming compare frame.exr reference.exr
  gloaming compare frame.exr reference.exr --json
  gloaming compare frame.exr reference.exr --diff difference.png

All figures are over R, G and B, scene-linear; relative_rmse = rmse/mean(B), psnr refers to the largest value of B.")]
pub struct CompareArgs {
    /// The frame
    #[arg(value_name = "A.exr")]
    a: PathBuf,
    /// The reference
    #[arg(value_name = "B.exr")]
    b: PathBuf,
    /// JSON for programs
    #[arg(long)]
    json: bool,
    /// Write a picture of the difference: black where there is none, brightest where it is largest
    #[arg(long, value_name = "OUT.png")]
    diff: Option<PathBuf>,
}

/// What is measured; `None` where it is not a finite number.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
struct Difference {
    rmse: f64,
    relative_rmse: Option<f64>,
    max: f64,
    psnr: Option<f64>,
    mean_a: f64,
    mean_b: f64,
    width: usize,
    height: usize,
}

/// Prints the difference.
pub fn run(args: &CompareArgs) -> anyhow::Result<()> {
    let (a, b) = (exr::read(&args.a)?, exr::read(&args.b)?);
    let difference = measure(&a, &b).with_context(|| format!("{} and {}", args.a.display(), args.b.display()))?;
    if let Some(path) = &args.diff {
        picture(&a, &b, difference.max).save(path).with_context(|| path.display().to_string())?;
    }
    let mut out = std::io::stdout().lock();
    if args.json {
        serde_json::to_writer(&mut out, &difference)?;
        writeln!(out)?;
        return Ok(());
    }
    let or_none = |v: Option<f64>, unit: &str| v.map_or("-".to_string(), |v| format!("{v:.6}{unit}"));
    writeln!(out, "rmse           {:.6e}", difference.rmse)?;
    writeln!(out, "relative rmse  {}", or_none(difference.relative_rmse, ""))?;
    writeln!(out, "max            {:.6e}", difference.max)?;
    writeln!(out, "psnr           {}", or_none(difference.psnr, " dB"))?;
    writeln!(out, "mean           {:.6e} against {:.6e}", difference.mean_a, difference.mean_b)?;
    Ok(())
}

/// Values of the channels that are compared.
fn rgb(frame: &Frame) -> impl Iterator<Item = f64> {
    frame.pixels.iter().flat_map(|p| [p[0], p[1], p[2]]).map(f64::from)
}

fn measure(a: &Frame, b: &Frame) -> anyhow::Result<Difference> {
    if a.size != b.size {
        bail!("sizes differ: {}x{} and {}x{}", a.size[0], a.size[1], b.size[0], b.size[1]);
    }
    let odd = rgb(a).zip(rgb(b)).filter(|(a, b)| !a.is_finite() || !b.is_finite()).count();
    if odd > 0 {
        bail!("{odd} values are not finite, which no figure describes");
    }
    let count = (3 * a.pixels.len()) as f64;
    let mean = |frame: &Frame| rgb(frame).sum::<f64>() / count;
    let square: f64 = rgb(a).zip(rgb(b)).map(|(a, b)| (a - b) * (a - b)).sum();
    let rmse = (square / count).sqrt();
    let (mean_a, mean_b) = (mean(a), mean(b));
    let finite = |v: f64| v.is_finite().then_some(v);
    Ok(Difference {
        rmse,
        relative_rmse: finite(rmse / mean_b),
        max: rgb(a).zip(rgb(b)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max),
        psnr: finite(20.0 * (rgb(b).fold(0.0, f64::max) / rmse).log10()),
        mean_a,
        mean_b,
        width: a.size[0],
        height: a.size[1],
    })
}

/// The largest difference over the channels, as colours of the default map.
fn picture(a: &Frame, b: &Frame, largest: f64) -> image::RgbImage {
    let colors = TransferFunction::new(&Default::default()).expect("the default scene is valid").colors();
    let [width, height] = a.size;
    image::RgbImage::from_fn(width as u32, height as u32, |x, y| {
        let at = y as usize * width + x as usize;
        let (a, b) = (a.pixels[at], b.pixels[at]);
        let apart = (0..3).map(|c| f64::from(a[c] - b[c]).abs()).fold(0.0, f64::max);
        let share = if largest > 0.0 { apart / largest } else { 0.0 };
        image::Rgb(colors[(255.0 * share).round() as usize].map(|c| (255.0 * c).round() as u8))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(pixels: &[[f32; 4]]) -> Frame {
        Frame { pixels: pixels.to_vec(), ..Frame::new([pixels.len(), 1]) }
    }

    #[test]
    fn figures_follow_their_definitions() {
        let b = frame(&[[1.0, 2.0, 3.0, 0.5], [0.0, 0.0, 6.0, 1.0]]);
        let a = frame(&[[1.0, 2.0, 3.0, 0.9], [0.0, 0.0, 3.0, 0.0]]);
        let d = measure(&a, &b).unwrap();
        let rmse = (9.0f64 / 6.0).sqrt();
        assert!((d.rmse - rmse).abs() < 1e-12 && (d.relative_rmse.unwrap() - rmse / 2.0).abs() < 1e-12);
        assert_eq!((d.max, d.mean_a, d.mean_b), (3.0, 1.5, 2.0));
        assert!((d.psnr.unwrap() - 20.0 * (6.0 / rmse).log10()).abs() < 1e-12);
    }

    #[test]
    fn equal_and_black_frames_have_no_ratio() {
        let b = frame(&[[0.0; 4]]);
        let d = measure(&b, &b).unwrap();
        assert_eq!((d.rmse, d.relative_rmse, d.psnr), (0.0, None, None));
        let lit = frame(&[[0.5; 4]]);
        assert_eq!(measure(&lit, &lit).unwrap().relative_rmse, Some(0.0));
    }

    #[test]
    fn sizes_that_differ_and_values_that_are_no_numbers_are_refused() {
        let (one, two) = (frame(&[[0.0; 4]]), frame(&[[0.0; 4]; 2]));
        assert!(measure(&one, &two).unwrap_err().to_string().contains("1x1 and 2x1"));
        let odd = frame(&[[f32::NAN, 0.0, 0.0, 1.0]]);
        assert!(measure(&one, &odd).unwrap_err().to_string().contains("1 values are not finite"));
    }

    #[test]
    fn the_difference_is_brightest_where_it_is_largest() {
        let a = frame(&[[0.0; 4], [0.1, 0.0, 0.0, 0.0], [0.0, 0.0, 0.4, 0.0]]);
        let sums: Vec<u32> = picture(&a, &frame(&[[0.0; 4]; 3]), 0.4)
            .pixels()
            .map(|p| p.0.iter().map(|c| u32::from(*c)).sum())
            .collect();
        assert!(sums[0] < 10 && sums[0] < sums[1] && sums[1] < sums[2], "{sums:?}");
    }
}
