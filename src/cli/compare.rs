//! `gloaming compare`: how far two EXR frames are apart, see [`gloaming::compare`].

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use clap::Args;
use gloaming::compare::{Difference, ZTest, difference, distances, z_test};
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
  gloaming compare noisy.exr converged.exr --variance

All figures are over R, G and B, scene-linear. relative rmse is rmse/mean(B); relative mse is the mean of (a - b)^2/(b^2 + e) with
e = (mean(B)/10)^2; psnr refers to the largest value of B. ssim is the structural similarity of what a display shows of the
luminance (Wang et al. 2004), 1 for equal pictures.")]
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
    /// Compare the layers of that name (albedo, normal, depth, ...) and not the pictures
    #[arg(long, value_name = "NAME", conflicts_with = "variance")]
    layer: Option<String>,
    /// Test whether the two differ by noise alone, by the layers `variance` of the files
    #[arg(long)]
    variance: bool,
}

/// What is said: names are a contract.
#[derive(Serialize)]
struct Said {
    #[serde(flatten)]
    difference: Difference,
    #[serde(skip_serializing_if = "Option::is_none")]
    z_test: Option<ZTest>,
}

/// Prints the difference.
pub fn run(args: &CompareArgs) -> anyhow::Result<()> {
    let files = || format!("{} and {}", args.a.display(), args.b.display());
    let (a, b) = (exr::read(&args.a)?, exr::read(&args.b)?);
    let variance = args.variance.then(|| variance_of_difference(&a, &b)).transpose().with_context(files)?;
    let (a, b) = match &args.layer {
        Some(name) => (of_layer(a, name, &args.a)?, of_layer(b, name, &args.b)?),
        None => (a, b),
    };
    let difference = difference(&a, &b).with_context(files)?;
    let z_test = variance.map(|v| z_test(&a, &b, &v)).transpose().with_context(files)?;
    if let Some(path) = &args.diff {
        picture(a.size, &distances(&a, &b)?).save(path).with_context(|| path.display().to_string())?;
    }
    let mut out = std::io::stdout().lock();
    if args.json {
        serde_json::to_writer(&mut out, &Said { difference, z_test })?;
        writeln!(out)?;
        return Ok(());
    }
    let or_none = |v: Option<f64>, unit: &str| v.map_or("-".to_string(), |v| format!("{v:.6}{unit}"));
    writeln!(out, "rmse           {:.6e}", difference.rmse)?;
    writeln!(out, "relative rmse  {}", or_none(difference.relative_rmse, ""))?;
    writeln!(out, "relative mse   {}", or_none(difference.relative_mse, ""))?;
    writeln!(out, "max            {:.6e}", difference.max)?;
    writeln!(out, "psnr           {}", or_none(difference.psnr, " dB"))?;
    writeln!(out, "ssim           {}", or_none(difference.ssim, ""))?;
    writeln!(out, "mean           {:.6e} against {:.6e}", difference.mean_a, difference.mean_b)?;
    if let Some(z) = z_test {
        let spread = (2.0 / z.values.max(1) as f64).sqrt();
        writeln!(out, "z of the mean  {:+.3} standard errors", z.mean)?;
        writeln!(out, "mean of z²     {:.4}, of {} values (1 ± {spread:.4} for noise alone)", z.mean_square, z.values)?;
        writeln!(
            out,
            "beyond 3       {:.3} % (0.270 % for noise alone), largest {:.2}",
            100.0 * z.beyond_3,
            z.largest
        )?;
        writeln!(out, "without noise  {} values differ", z.certain_differences)?;
    }
    Ok(())
}

/// The sum of the pixels' variances that the files state.
fn variance_of_difference(a: &Frame, b: &Frame) -> anyhow::Result<Vec<[f32; 3]>> {
    let stated: Vec<_> = [a, b].into_iter().filter_map(|frame| frame.layer("variance")).collect();
    if stated.is_empty() {
        bail!("neither has a layer `variance`, which pictures of render.kind = \"pathtrace\" have");
    }
    let mut sum = vec![[0.0; 3]; a.pixels.len()];
    for layer in stated {
        if layer.channels.len() != 3 || layer.values.len() != 3 * sum.len() {
            bail!("a layer `variance` with the channels {} is not that of an RGB picture", layer.channels);
        }
        for (sum, v) in sum.iter_mut().zip(layer.values.as_chunks::<3>().0) {
            *sum = std::array::from_fn(|c| sum[c] + v[c]);
        }
    }
    Ok(sum)
}

/// A layer as a picture.
fn of_layer(frame: Frame, name: &str, path: &Path) -> anyhow::Result<Frame> {
    let Some(layer) = frame.layer(name) else {
        let known: Vec<_> = frame.layers.iter().map(|l| l.name.as_str()).collect();
        bail!(
            "{}: no layer `{name}`; it has {}",
            path.display(),
            if known.is_empty() { "none".into() } else { known.join(", ") }
        );
    };
    // Whatever is single is gray.
    let order = match layer.channels.len() {
        1 => [0; 3],
        3 | 4 => [0, 1, 2],
        _ => bail!("{}: layer `{name}` has the channels {}; allowed: one, or three", path.display(), layer.channels),
    };
    let pixels =
        layer.values.chunks_exact(layer.channels.len()).map(|v| order.map(|c| v[c])).map(|[r, g, b]| [r, g, b, 1.0]);
    let mut picture = Frame::new(frame.size);
    picture.pixels = pixels.collect();
    Ok(picture)
}

/// Distances as colours of the default map.
fn picture([width, height]: [usize; 2], distances: &[f32]) -> image::RgbImage {
    let colors = TransferFunction::new(&Default::default()).expect("the default scene is valid").colors();
    let largest = distances.iter().fold(0.0f32, |m, d| m.max(*d));
    image::RgbImage::from_fn(width as u32, height as u32, |x, y| {
        let apart = distances[y as usize * width + x as usize];
        let share = if largest > 0.0 { apart / largest } else { 0.0 };
        image::Rgb(colors[(255.0 * share).round() as usize].map(|c| (255.0 * c).round() as u8))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_difference_is_brightest_where_it_is_largest() {
        let sums: Vec<u32> =
            picture([3, 1], &[0.0, 0.1, 0.4]).pixels().map(|p| p.0.iter().map(|c| u32::from(*c)).sum()).collect();
        assert!(sums[0] < 10 && sums[0] < sums[1] && sums[1] < sums[2], "{sums:?}");
    }
}
