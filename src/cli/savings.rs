//! `gloaming savings`: what the warm start saves on a series.

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use clap::Args;
use gloaming::savings::{Ratio, Savings};
use gloaming::scene::{RangeKey, Scene};
use gloaming::{pipeline, savings, source};
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};

use super::Done;
use super::parse::Steps;
use super::render::spec;
use super::series::SeriesArgs;

/// Measure what the warm start saves: each step lit cold and warm in one process, and held against a tight solve
#[derive(Args)]
#[command(
    args_override_self = true,
    after_help = "\
Examples:
  gloaming savings run/plt_*.h5 --out report.html
  gloaming savings run.h5 --scene scene.toml --set light.tolerance=1e-2 --json
  gloaming savings run.h5 --steps 100..120 --set light.scattering=false

Ratios are cold / warm: below 1 the warm start loses, and is said to."
)]
pub struct SavingsArgs {
    #[command(flatten)]
    series: SeriesArgs,
    /// Scene file (TOML)
    #[arg(long, value_name = "FILE")]
    scene: Option<PathBuf>,
    /// Step numbers A <= step < B, and of them every S-th
    #[arg(long, value_name = "A..B[:S]")]
    steps: Option<Steps>,
    /// Where to compute: auto, cpu, gpu, or part of an adapter's name
    #[arg(long, default_value = "auto", value_name = "auto|cpu|gpu|NAME")]
    device: String,
    /// Measure each light model, and direct light alone, instead of what the scene says
    #[arg(long)]
    each: bool,
    /// A report with plots, one HTML file
    #[arg(short, long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// JSON for programs; with --each a list
    #[arg(long)]
    json: bool,
    /// Override a key of the scene; may repeat
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,
}

/// Runs the command.
pub fn run(args: SavingsArgs, quiet: bool, bars: &MultiProgress) -> anyhow::Result<Done> {
    let scene = Scene::load(args.scene.as_deref(), &args.sets)?;
    let series = source::open(&spec(args.series, &scene))?;
    let info = series.info();
    let indices = match args.steps {
        Some(steps) => steps.select(info.steps.iter().map(|s| s.step)),
        None => (0..info.steps.len()).collect(),
    };
    let device = gloaming::device::open(&args.device, 0)?;
    let range = match scene.field.range {
        RangeKey::Fixed(range) => range,
        RangeKey::Over(_) => {
            let mut over_series = scene.clone();
            over_series.field.range = RangeKey::default();
            pipeline::series_range(&*series, &indices, &over_series, &AtomicBool::new(false))?.unwrap_or([0.0, 1.0])
        }
    };
    let scenes = if args.each { savings::each_model(&scene) } else { vec![scene] };
    let total = indices.len() * scenes.len();
    let bar = if quiet { ProgressBar::hidden() } else { bars.add(ProgressBar::new(total as u64)) };
    bar.set_style(ProgressStyle::with_template("{bar:30} {pos}/{len} steps, ETA {eta} {msg}")?);
    let measure = |scene: &Scene| {
        savings::measure(&*device, &*series, &indices, scene, range, &mut |step| {
            bar.inc(1);
            bar.set_message(format!("step {}: cold/warm time {:.2}", step.step, step.ratio.seconds));
        })
    };
    let found: Vec<Savings> = scenes.iter().map(measure).collect::<gloaming::Result<_>>()?;
    bar.finish_and_clear();
    if let Some(path) = &args.out {
        savings::write_html(&found, path)?;
    }
    match (&found[..], args.json) {
        ([one], true) if !args.each => println!("{}", serde_json::to_string_pretty(one)?),
        (all, true) => println!("{}", serde_json::to_string_pretty(all)?),
        (all, false) => all.iter().for_each(say),
    }
    Ok(Done::Whole)
}

fn say(found: &Savings) {
    let Ratio { seconds, voxel_updates, iterations, bricks_active, .. } = found.ratio;
    println!(
        "{}, {} steps, cold / warm: time {seconds:.2}, voxel updates {voxel_updates:.2}, iterations {iterations:.2}, bricks swept \
         {bricks_active:.2}",
        found.what,
        found.steps.len()
    );
    println!(
        "errors of the warm light: certified {:.1e}, true {:.1e} (tolerance {:e})",
        found.warm.certified_error, found.warm.true_error, found.tolerance
    );
}
