//! `gloaming histogram`: how often values occur, and with which gradients, to design a transfer function by.

use std::io::Write;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use anyhow::{Context as _, bail};
use clap::Args;
use gloaming::grid::Slab;
use gloaming::histogram::{Histogram, plot};
use gloaming::scene::{RangeKey, Scene};
use gloaming::transfer::TransferFunction;
use gloaming::{field, pipeline, source};

use super::Done;
use super::parse::Steps;
use super::render::spec;
use super::series::SeriesArgs;

/// Count how often values occur, and with which gradients; drawn with the transfer function on top
#[derive(Args)]
#[command(
    args_override_self = true,
    after_help = "\
Examples:
  gloaming histogram run.h5 --out histogram.png
  gloaming histogram run/plt_*.h5 --scene scene.toml --steps 0..100:10 --out h.png --out h.json
  gloaming histogram run.h5 --set transfer.steepest=0.1 --out h.png"
)]
pub struct HistogramArgs {
    #[command(flatten)]
    series: SeriesArgs,
    /// A picture (.png), or counts for programs (.json; - prints them); may repeat
    #[arg(short, long, required = true, value_name = "FILE")]
    out: Vec<PathBuf>,
    /// Scene file (TOML): field, range and transfer function
    #[arg(long, value_name = "FILE")]
    scene: Option<PathBuf>,
    /// Step numbers A <= step < B, and of them every S-th
    #[arg(long, value_name = "A..B[:S]")]
    steps: Option<Steps>,
    /// Bins of values and of gradient magnitudes
    #[arg(long, value_name = "N,M", default_value = "256,128", value_parser = bins)]
    bins: [usize; 2],
    /// Override a key of the scene; may repeat
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,
}

fn bins(text: &str) -> Result<[usize; 2], String> {
    let allowed = || "two integers from 2 to 4096, such as 256,128".to_string();
    let parts: Vec<usize> =
        text.split(',').map(|p| p.trim().parse()).collect::<Result<_, _>>().map_err(|_| allowed())?;
    match parts[..] {
        [n, m] if (2..=4096).contains(&n) && (2..=4096).contains(&m) => Ok([n, m]),
        _ => Err(allowed()),
    }
}

/// Runs the command.
pub fn run(args: HistogramArgs) -> anyhow::Result<Done> {
    for path in &args.out {
        let known = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png") || e.eq_ignore_ascii_case("json"));
        if !known && path.as_os_str() != "-" {
            bail!("--out {}: allowed are .png and .json, and - for JSON on stdout", path.display());
        }
    }
    let scene = Scene::load(args.scene.as_deref(), &args.sets)?;
    let transfer = TransferFunction::new(&scene.transfer)?;
    let series = source::open(&spec(args.series, &scene))?;
    let info = series.info();
    let indices = match args.steps {
        Some(steps) => steps.select(info.steps.iter().map(|s| s.step)),
        None => (0..info.steps.len()).collect(),
    };
    if indices.is_empty() {
        bail!("no step of the series is in --steps");
    }
    let range = match scene.field.range {
        RangeKey::Fixed(range) => range,
        // Counts of several steps share their bins.
        RangeKey::Over(_) => {
            let mut over_series = scene.clone();
            over_series.field.range = RangeKey::default();
            pipeline::series_range(&*series, &indices, &over_series, &AtomicBool::new(false))?.unwrap_or([0.0, 1.0])
        }
    };
    let mut histogram = Histogram::new(range, scene.transfer.steepest, args.bins);
    let mut lost = false;
    let mut values = Vec::new();
    for &index in &indices {
        let counted = series.timestep(index).and_then(|step| {
            values.resize(step.grid.len(), 0.0);
            field::read_planes(&*step.field, &Slab::whole(step.grid.size), &mut values, false)?;
            histogram.add(&step.grid, &values);
            Ok(())
        });
        if let Err(e) = counted {
            tracing::warn!("step {} is not counted: {e}", info.steps[index].step);
            lost = true;
        }
    }
    if histogram.steps == 0 {
        bail!("no step could be read");
    }
    for path in &args.out {
        let context = || format!("writing {}", path.display());
        if path.as_os_str() == "-" {
            let mut out = std::io::stdout().lock();
            serde_json::to_writer(&mut out, &histogram)?;
            writeln!(out)?;
        } else if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png")) {
            let title = format!("{}, {} steps", info.field, histogram.steps);
            plot(&histogram, &scene.transfer, &transfer, &title).save(path).with_context(context)?;
        } else {
            std::fs::write(path, serde_json::to_vec(&histogram)?).with_context(context)?;
        }
    }
    Ok(if lost { Done::WithLosses } else { Done::Whole })
}
