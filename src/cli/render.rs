//! `gloaming render`: lights a series and writes what was asked for.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use clap::{Args, ValueEnum};
use gloaming::memory;
use gloaming::pipeline::{self, Job, Summary};
use gloaming::scene::{ComponentKey, Scene};
use gloaming::source::{self, SourceSpec};
use indicatif::{HumanDuration, MultiProgress};

use super::Done;
use super::parse::{self, Steps};
use super::progress::Report;
use super::series::SeriesArgs;

/// Light a series and write movies, frames or the illuminated volume
#[derive(Args)]
#[command(
    args_override_self = true,
    after_help = "\
Examples:
  gloaming render run/plt_*.h5 --out movie.mp4
  gloaming render run.h5 --field temperature --scene scene.toml --out frames/{step:06}.png
  gloaming render run.h5:/density --axes tzyx --steps 100..200:2 --size 1920x1080 --out a.mp4
  gloaming render dump_*.raw --raw dims=96x96x96,dtype=f64le --out movie.mp4
  gloaming render run.h5 --steps 7..8 --set light.directions=128 --out step7.exr

Exit status: 0 done; 1 failed; 2 wrong usage; 3 done with losses (steps that could not be read or
lit, or an interruption). Ctrl-C finishes the step in hand and closes the files; a second one stops
at once."
)]
pub struct RenderArgs {
    #[command(flatten)]
    series: SeriesArgs,
    /// What to write, by extension; may repeat. {step:06} numbers files, {camera} names them
    #[arg(short, long, required = true, value_name = "PATH")]
    out: Vec<String>,
    /// Scene file (TOML): field, transfer function, lights, cameras
    #[arg(long, value_name = "FILE")]
    scene: Option<PathBuf>,
    /// Step numbers A <= step < B, and of them every S-th
    #[arg(long, value_name = "A..B[:S]")]
    steps: Option<Steps>,
    /// Size of the frames in pixels
    #[arg(long, value_name = "WxH", value_parser = parse::pixels)]
    size: Option<[usize; 2]>,
    /// Frames per second of movies
    #[arg(long, value_name = "N")]
    fps: Option<f64>,
    /// Seconds of movie for a unit of the series' time; else each step gets one frame
    #[arg(long, value_name = "S")]
    seconds_per_time_unit: Option<f64>,
    /// Where to compute: auto (a hardware GPU if there is one, else the CPU), cpu, gpu, or part of an adapter's name
    #[arg(long, default_value = "auto", value_name = "auto|cpu|gpu|NAME")]
    device: String,
    /// Bound on the working set, such as 512MiB or 2G; larger volumes are lit and rendered a slab at a time, light that does not
    /// fit going to a file in TMPDIR. Else what the machine has available
    #[arg(long, value_name = "SIZE", value_parser = parse::bytes)]
    memory: Option<u64>,
    /// How light travels
    #[arg(long)]
    model: Option<Model>,
    /// Largest certified error of the light, relative to the brightest light; 0 is bitwise the cold result
    #[arg(long, value_name = "X", allow_negative_numbers = true)]
    tolerance: Option<f64>,
    /// Solve each step from scratch
    #[arg(long)]
    cold: bool,
    /// One row a step of what was done and what it cost (.csv or .json)
    #[arg(long, value_name = "FILE")]
    ledger: Option<PathBuf>,
    /// Override a key of the scene, such as light.directions=8 or lights.0.intensity=5; may repeat
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,
}

/// `light.model`
#[derive(Clone, Copy, ValueEnum)]
enum Model {
    /// Short characteristics and discrete ordinates
    Physical,
    /// Convection and diffusion as Zhang & Ma published them
    Paper,
}

impl RenderArgs {
    /// The scene file with everything that overrides it.
    fn scene(&self) -> gloaming::Result<Scene> {
        let mut sets = self.sets.clone();
        if let Some([w, h]) = self.size {
            sets.push(format!("render.size=[{w}, {h}]"));
        }
        match self.model {
            Some(Model::Physical) => sets.push("light.model=physical".into()),
            Some(Model::Paper) => sets.push("light.model=paper".into()),
            None => {}
        }
        sets.extend(self.tolerance.map(|t| format!("light.tolerance={t:?}")));
        sets.extend(self.fps.map(|fps| format!("movie.fps={fps:?}")));
        sets.extend(self.seconds_per_time_unit.map(|s| format!("movie.seconds_per_time_unit={s:?}")));
        if self.cold {
            sets.push("light.warm=false".into());
        }
        Scene::load(self.scene.as_deref(), &sets)
    }
}

/// What to open: the scene names the field and the level where the command line does not, and picks the component.
pub fn spec(args: SeriesArgs, scene: &Scene) -> SourceSpec {
    let mut spec = args.spec();
    spec.field = spec.field.or_else(|| scene.field.name.clone());
    spec.level = spec.level.or(scene.field.level);
    spec.component = Some(match &scene.field.component {
        ComponentKey::Index(i) => i.to_string(),
        ComponentKey::Name(name) => name.clone(),
    });
    spec
}

/// Runs the command.
pub fn run(args: RenderArgs, quiet: bool, bars: MultiProgress) -> anyhow::Result<Done> {
    let scene = args.scene()?;
    let RenderArgs { series, out, steps, device, memory: budget, ledger, .. } = args;
    let series = source::open(&spec(series, &scene))?;
    let info = series.info();
    info.warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
    let numbers = || info.steps.iter().map(|s| s.step);
    let indices = match steps {
        Some(steps) => steps.select(numbers()),
        None => (0..info.steps.len()).collect(),
    };
    if indices.is_empty() {
        let (first, last) = (numbers().min().unwrap_or(0), numbers().max().unwrap_or(0));
        anyhow::bail!("--steps selects none of the {} steps, which are numbered {first} to {last}", info.steps.len());
    }
    let device = gloaming::device::open(&device, 0)?;
    let device = match budget.or_else(memory::available) {
        Some(budget) => memory::fit(device, &scene, &series.grid(), budget, &scratch_folder(&out[0]))?,
        None => device,
    };
    tracing::info!("{}, {} steps of `{}` on {}", info.layout, indices.len(), info.field, device.name());

    let total = indices.len();
    let job = Job { series, indices, scene, device, outputs: out.clone(), ledger };
    let stop = stop_on_interrupt()?;
    let report = Report::new(total, quiet, &bars);
    let summary = pipeline::run(job, &stop, &mut |step| report.step(step.finished, total, step.row));
    let took = report.finish();
    let summary = summary?;
    if !quiet {
        eprintln!("{} steps in {}: {}", summary.done, HumanDuration(took), out.join(", "));
    }
    Ok(losses(&summary, total))
}

/// Where light goes that does not fit in memory: TMPDIR where it is set, else beside the output. The usual folder for temporary
/// files is often in memory itself.
fn scratch_folder(out: &str) -> PathBuf {
    if std::env::var_os("TMPDIR").is_some() {
        return std::env::temp_dir();
    }
    let beside = std::path::absolute(out).ok().and_then(|p| p.parent().map(PathBuf::from));
    beside.filter(|folder| folder.is_dir()).unwrap_or_else(std::env::temp_dir)
}

/// Says what was lost.
fn losses(summary: &Summary, total: usize) -> Done {
    for (step, why) in &summary.lost {
        eprintln!("step {step} lost: {why}");
    }
    if summary.interrupted {
        eprintln!("interrupted: {} of {total} steps done", summary.done);
    }
    if summary.lost.is_empty() && !summary.interrupted { Done::Whole } else { Done::WithLosses }
}

/// A flag that the first Ctrl-C (or termination signal) sets; the second ends the process.
fn stop_on_interrupt() -> anyhow::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    ctrlc::set_handler(move || {
        if flag.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
        eprintln!("\ninterrupted: finishing the step in hand and closing the files; once more to stop at once");
    })?;
    Ok(stop)
}
