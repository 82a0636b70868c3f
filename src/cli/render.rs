//! `gloaming render`: lights a series and writes what was asked for.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use clap::{Args, ValueEnum};
use gloaming::pipeline::{self, Job, Summary};
use gloaming::scene::{ComponentKey, Scene};
use gloaming::source::follow::{Following, Patience};
use gloaming::source::{self, SourceSpec};
use gloaming::{memory, preview};
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
  gloaming render 'run/plt_{step:05}.h5' --follow --idle-timeout 10min --out movie.mp4
  gloaming render run.h5 --out frames/{step:06}.png --ledger ledger.csv --resume

--follow takes a step when a later one exists, when FILE.done stands beside its file, or when its
file has not changed for 2 s; HDF5 files that are being written are read through SWMR. Where neither
the scene nor the file gives the range of values, it grows with the steps: field.range=[lo, hi] holds
it. --resume skips the steps whose files all exist and, with --ledger, have a row there; a movie or a
.vtkhdf takes all steps into one file and is written anew, every step lit again.

Exit status: 0 done; 1 failed; 2 wrong usage; 3 done with losses (steps that could not be read or
lit, or an interruption). --follow ends with 0 after the last step of --steps or when nothing came
for the idle timeout, with 1 when no step came at all. Ctrl-C finishes the step in hand and closes
the files; a second one stops at once."
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
    /// Show means over blocks of voxels, small enough to fit into --memory (or that the machine has); pictures say so
    #[arg(long)]
    preview: bool,
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
    /// Light steps as they appear while the simulation runs
    #[arg(long)]
    follow: bool,
    /// Ends --follow when nothing has changed for so long, such as 90s, 10min, 2h
    #[arg(long, value_name = "T", default_value = "5min", value_parser = parse::duration, requires = "follow")]
    idle_timeout: Duration,
    /// Skip steps that an earlier run has done
    #[arg(long)]
    resume: bool,
    /// Keep the light in FILE (HDF5) at the end, and start from it where it is there: a run that goes on where another ended
    /// starts warm. Light of another grid or other settings is not used, and replaced
    #[arg(long, value_name = "FILE")]
    light_state: Option<PathBuf>,
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

/// Bytes of steps that the pass for the range keeps, as long as `--memory` leaves room.
const KEEP: u64 = 256 << 20;

/// Runs the command.
pub fn run(args: RenderArgs, quiet: bool, bars: MultiProgress) -> anyhow::Result<Done> {
    let mut scene = args.scene()?;
    let stop = stop_on_interrupt()?;
    let RenderArgs {
        series,
        out,
        steps,
        device,
        memory: budget,
        preview,
        ledger,
        light_state,
        follow,
        idle_timeout,
        resume,
        ..
    } = args;
    let budget = budget.or_else(memory::available);
    let spec = SourceSpec { memory: budget, ..spec(series, &scene) };
    let (series, follow) = if follow {
        let patience = Patience { idle: idle_timeout, ..Default::default() };
        if !quiet {
            eprintln!("following {}; nothing new for {} ends it", spec.series.join(" "), HumanDuration(idle_timeout));
        }
        let select = Box::new(move |numbers: &[u64]| selected(steps, numbers));
        let (series, following) = Following::open(spec, patience, select, steps.and_then(Steps::end), &stop)?;
        (series, Some(following))
    } else {
        (source::open(&spec)?, None)
    };
    let info = series.info();
    info.warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
    let numbers: Vec<u64> = info.steps.iter().map(|s| s.step).collect();
    let indices = if follow.is_some() { Vec::new() } else { selected(steps, &numbers) };
    if indices.is_empty() && follow.is_none() {
        let (first, last) = (numbers.iter().min().unwrap_or(&0), numbers.iter().max().unwrap_or(&0));
        anyhow::bail!("--steps selects none of the {} steps, which are numbered {first} to {last}", numbers.len());
    }
    if preview {
        scene.render.preview = memory::preview(&scene, &series.grid(), budget)?;
    }
    let device = gloaming::device::open(&device, 0)?;
    let grid = series.grid();
    let grid = grid.resized(preview::size(grid.size, scene.render.preview));
    let device = match budget {
        Some(budget) => memory::fit(device, &scene, &grid, budget, &scratch_folder(&out[0]))?,
        None => device,
    };
    let room = budget.map_or(Ok(KEEP), |b| {
        memory::working_set(&scene, &grid).map(|needed| b.saturating_sub(needed + source::decoded(budget)))
    })?;
    let keep = room.min(KEEP);
    let total = follow.is_none().then_some(indices.len());
    let count = total.map_or("growing".into(), |n| format!("{n} steps"));
    tracing::info!("{}, {count} of `{}` on {}", info.layout, info.field, device.name());

    let job = Job { series, indices, scene, device, outputs: out.clone(), ledger, light_state, follow, resume, keep };
    let report = Report::new(total, quiet, &bars);
    let summary = pipeline::run(job, &stop, &mut |step| report.step(&step));
    let took = report.finish();
    let summary = summary?;
    if !quiet {
        let before = if summary.skipped > 0 { format!(", {} done before", summary.skipped) } else { String::new() };
        eprintln!("{} steps in {}{before}: {}", summary.done, HumanDuration(took), out.join(", "));
    }
    if summary.done + summary.skipped + summary.lost.len() == 0 && total.is_none() && !summary.interrupted {
        anyhow::bail!("no step came: the series opens, but none of its steps was complete or wanted");
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

/// Indices of the steps that `--steps` takes.
fn selected(steps: Option<Steps>, numbers: &[u64]) -> Vec<usize> {
    steps.map_or_else(|| (0..numbers.len()).collect(), |steps| steps.select(numbers.iter().copied()))
}

/// Says what was lost.
fn losses(summary: &Summary, total: Option<usize>) -> Done {
    for (step, why) in &summary.lost {
        eprintln!("step {step} lost: {why}");
    }
    if summary.interrupted {
        let of = total.map(|n| format!(" of {}", n - summary.skipped)).unwrap_or_default();
        eprintln!("interrupted: {}{of} steps done", summary.done);
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
