//! `gloaming demo`: the smoke example with gloaming in its output loop, and what the warm start saved.

use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};

use clap::Args;
use gloaming::device::cpu::Cpu;
use gloaming::ledger::{self, LedgerRow};
use gloaming::savings;
use gloaming::scene::RangeKey;
use gloaming::source::{self, SourceSpec};
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::Done;

#[path = "../../examples/smoke/coupling.rs"]
mod coupling;
#[path = "../../examples/smoke/simulation/mod.rs"]
mod simulation;

/// Run the built-in smoke simulation, lit while it runs
#[derive(Args)]
#[command(after_help = "\
Examples:
  gloaming demo
  gloaming demo --out smoke --size 128 --steps 240")]
pub struct DemoArgs {
    /// Directory for the movie, the frames and everything else
    #[arg(long, value_name = "DIR", default_value = "demo")]
    out: PathBuf,
    /// Cells along the width of the box; it is half as high again
    #[arg(long, value_name = "N", default_value_t = 72, value_parser = clap::value_parser!(u16).range(8..=1024))]
    size: u16,
    /// Steps to simulate, 24 a second
    #[arg(long, value_name = "N", default_value_t = 96, value_parser = clap::value_parser!(u32).range(1..))]
    steps: u32,
}

/// Runs the simulation and says where everything is.
pub fn run(args: &DemoArgs, quiet: bool, bars: &MultiProgress) -> anyhow::Result<Done> {
    let steps = args.steps as usize;
    let progress = Progress::new(steps, quiet, bars);
    let stats = coupling::run(&args.out, args.size.into(), steps, |done| progress.step(done))?;
    progress.finish();
    let mut told = told(&args.out, &ledger::read(&args.out.join("ledger.csv"))?);
    told += &measured(&args.out, &progress_bar(quiet, bars))?;
    std::io::stdout().lock().write_all(told.as_bytes())?;
    Ok(if stats.lost == 0 { Done::Whole } else { Done::WithLosses })
}

/// Steps at the end of the series that are lit once more, cold and warm, for the report.
const MEASURED: usize = 16;

/// Lights the last steps of the series cold and warm, and writes the report.
fn measured(out: &Path, bar: &ProgressBar) -> anyhow::Result<String> {
    let scene = coupling::scene()?;
    let series = out.join("series.h5").display().to_string();
    let series = source::open(&SourceSpec { series: vec![series], ..Default::default() })?;
    let count = series.info().steps.len();
    let indices: Vec<usize> = (count.saturating_sub(MEASURED)..count).collect();
    let range = match scene.field.range {
        RangeKey::Fixed(range) => range,
        RangeKey::Over(_) => [0.0, 1.0],
    };
    let found = savings::measure(&Cpu::new(0)?, &*series, &indices, &scene, range, &mut |_| bar.inc(1))?;
    bar.finish_and_clear();
    savings::write_html(std::slice::from_ref(&found), &out.join("savings.html"))?;
    Ok(format!(
        "  the last {} steps lit both ways, cold / warm: time {:.2}, voxel updates {:.2}, iterations {:.2}\n",
        found.steps.len(),
        found.ratio.seconds,
        found.ratio.voxel_updates,
        found.ratio.iterations
    ))
}

/// A bar for the measurement, on a terminal.
fn progress_bar(quiet: bool, bars: &MultiProgress) -> ProgressBar {
    if quiet || !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{bar:24.cyan} {pos}/{len} steps measured, cold and warm");
    bars.add(ProgressBar::new(MEASURED as u64).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar())))
}

/// How far the simulation is: a bar on a terminal, now and then a line elsewhere.
struct Progress {
    bar: Option<ProgressBar>,
    quiet: bool,
    steps: usize,
}

impl Progress {
    fn new(steps: usize, quiet: bool, bars: &MultiProgress) -> Self {
        let shown = !quiet && std::io::stderr().is_terminal();
        let bar = shown.then(|| {
            let style = ProgressStyle::with_template("{bar:24.cyan} {pos}/{len} steps simulated  {per_sec}  ETA {eta}");
            let bar = ProgressBar::with_draw_target(Some(steps as u64), ProgressDrawTarget::hidden());
            bars.add(bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar())))
        });
        Progress { bar, quiet, steps }
    }

    fn step(&self, done: usize) {
        match &self.bar {
            Some(bar) => bar.set_position(done as u64),
            None if self.quiet => {}
            None if done.is_multiple_of(10) || done == self.steps => {
                eprintln!("{done}/{} steps simulated", self.steps);
            }
            None => {}
        }
    }

    fn finish(self) {
        if let Some(bar) = self.bar {
            bar.finish_and_clear();
        }
    }
}

/// Where everything is, and what the warm start saved.
fn told(out: &Path, rows: &[LedgerRow]) -> String {
    let files = [
        ("movie.mp4", format!("{} frames", rows.iter().filter(|r| r.lost.is_empty()).count())),
        ("frames", "the same frames as PNG".into()),
        ("series.h5", format!("what the simulation wrote; gloaming info {}", out.join("series.h5").display())),
        ("light.vtkhdf", "the illuminated volume, for ParaView".into()),
        ("ledger.csv", "what every step cost".into()),
        ("savings.html", "cold against warm, step by step".into()),
    ];
    let name = |file: &str| out.join(file).display().to_string();
    let width = files.iter().map(|(file, _)| name(file).len()).max().unwrap_or(0);
    let mut told: String = files.iter().map(|(file, what)| format!("{:width$}  {what}\n", name(file))).collect();
    told += &saved(rows);
    told
}

/// What the warm start saved, as far as a run without its cold twin can tell.
fn saved(rows: &[LedgerRow]) -> String {
    let warm: Vec<&LedgerRow> = rows.iter().filter(|r| r.start == "warm").collect();
    if warm.is_empty() {
        return "\nNo step started from the light of the one before.\n".into();
    }
    let count = warm.len();
    let mut said = format!("\nWarm start, {count} steps:\n");
    let (active, total): (u64, u64) = warm.iter().fold((0, 0), |(a, t), r| (a + r.bricks_active, t + r.bricks_total));
    if total > 0 {
        let percent = 100.0 * (total - active) as f64 / total as f64;
        said += &format!("  direct light: {percent:.0} % of the bricks skipped ({} of {total})\n", total - active);
    }
    let mean = warm.iter().map(|r| r.iterations).sum::<u64>() as f64 / count as f64;
    if let Some(cold) = rows.iter().find(|r| r.start == "cold" && r.iterations > 0) {
        let (step, iterations) = (cold.step, cold.iterations);
        said += &format!("  scattered light: {mean:.1} iterations a step; step {step}, cold, took {iterations}\n");
    }
    let error = warm.iter().map(|r| r.certified_error).fold(0.0, f64::max);
    said += &format!("  certified error at most {error:.1e} of the brightest light\n");
    said
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn savings_are_those_of_the_warm_steps() {
        let row = |start: &str, iterations, bricks_active| LedgerRow {
            start: start.into(),
            iterations,
            bricks_active,
            bricks_total: 10,
            certified_error: 5e-4,
            ..Default::default()
        };
        let said = saved(&[row("cold", 9, 10), row("warm", 4, 3), row("warm", 5, 1)]);
        assert!(said.contains("80 % of the bricks skipped (16 of 20)"), "{said}");
        assert!(said.contains("4.5 iterations a step; step 0, cold, took 9"), "{said}");
        assert!(said.contains("at most 5.0e-4"), "{said}");
        assert!(saved(&[row("cold", 9, 10)]).contains("No step"));
    }
}
