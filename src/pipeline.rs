//! A whole series: reading ∥ lighting and rendering ∥ writing, on bounded channels.
//!
//! One thread reads ahead, the calling thread lights and renders, one thread writes. A step that cannot be read is lost:
//! stated on stderr and in the ledger, and the rest goes on. A sink or a device that fails, and a bug of ours, end the run
//! with an error, after everything already finished is closed properly.

mod range;
mod resume;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use crossbeam_channel::{Receiver, Sender, bounded};

use crate::device::Device;
use crate::error::{Error, Result, guarded};
use crate::field::{Dense, Timestep};
use crate::ledger::{Ledger, LedgerRow};
use crate::light_state::LightState;
use crate::preview::Preview;
use crate::scene::{RangeKey, Scene};
use crate::session::{Session, cameras};
use crate::sink::{self, Output, Sink, SinkOptions};
use crate::source::Series;
use crate::source::follow::Following;
use crate::transfer::TransferFunction;

/// Steps that may wait between two stages: one in hand and one ready is enough to overlap them.
const DEPTH: usize = 2;

/// A series to light and where to write it.
pub struct Job {
    /// The series.
    pub series: Box<dyn Series>,
    /// Indices into `series.info().steps`, in order.
    pub indices: Vec<usize>,
    /// What to show.
    pub scene: Scene,
    /// Where to compute.
    pub device: Arc<dyn Device>,
    /// Targets, one sink each.
    pub outputs: Vec<String>,
    /// Ledger file (`.csv` or `.json`).
    pub ledger: Option<PathBuf>,
    /// Light to start from where the file is there, and that is left in it at the end, also after an interruption.
    pub light_state: Option<PathBuf>,
    /// Steps that are still being written, instead of `indices`. Where neither scene nor file gives the range of values, it grows
    /// with the steps.
    pub follow: Option<Following>,
    /// Steps whose files are all there, and which the ledger has, are not done again; the ledger is continued.
    pub resume: bool,
    /// Bytes of values that the pass for the range may keep, so that those steps are read once.
    pub keep: u64,
}

/// What became of a run.
#[derive(Debug, Clone, Default)]
pub struct Summary {
    /// Steps written.
    pub done: usize,
    /// Steps lost, with the reason.
    pub lost: Vec<(u64, String)>,
    /// Steps that an earlier run had done.
    pub skipped: usize,
    /// True when the run was stopped before its end.
    pub interrupted: bool,
    /// One row a step, lost ones included.
    pub rows: Vec<LedgerRow>,
}

/// What a run is at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Reading the steps for their range of values.
    Range,
    /// Lighting and writing.
    Light,
}

/// A step has been written (or lost), or is read for its range.
pub struct Progress<'a> {
    /// What the run is at.
    pub stage: Stage,
    /// Steps finished so far, lost ones included.
    pub finished: usize,
    /// Steps in all, where known.
    pub total: Option<usize>,
    /// What the step cost.
    pub row: &'a LedgerRow,
}

/// Called after each step, from the writing thread.
pub type OnProgress<'a> = dyn FnMut(Progress) + Send + 'a;

/// Runs a job to its end, or until `stop` is set: then the step in hand is finished and everything is closed.
pub fn run(job: Job, stop: &AtomicBool, progress: &mut OnProgress<'_>) -> Result<Summary> {
    let Job { series, indices, scene, device, outputs, ledger, light_state, follow, resume, keep } = job;
    let info = series.info().clone();
    if indices.is_empty() && follow.is_none() {
        return Err(Error::format(
            info.series.first().cloned().unwrap_or_default(),
            format!("no step selected out of {}", info.steps.len()),
            "gloaming info SERIES lists the steps",
        ));
    }
    let kept_light = LightState::left_at(light_state.as_deref(), &scene)?;
    if follow.is_some() && scene.render.preview > 1 {
        return Err(Error::Unsupported(
            "--preview of a series that is followed: leave --follow or --preview out".into(),
        ));
    }
    // A device that pages is one that has no room for whole steps, and a preview has no use for them.
    let keep = if device.pages() || scene.render.preview > 1 { 0 } else { keep };
    let count = if follow.is_some() { 0 } else { indices.len() };
    let sinks = || open_sinks(&scene, &outputs, count, [&info.field, &info.units, &info.time_units]);
    let done = if resume { resume::Done::of(sinks()?, &outputs, ledger.as_deref())? } else { resume::Done::default() };
    let mut sinks = sinks()?;
    if resume {
        sinks.iter_mut().try_for_each(|s| s.resume())?;
    }
    let ledger = ledger.map(|path| if resume { Ledger::resume(path) } else { Ledger::create(path) }).transpose()?;
    let left = indices.iter().filter(|&&i| !done.has(info.steps[i].step)).count();
    let pass = match range::known(&*series, &scene) {
        Some(range) => range::Pass { range, ..Default::default() },
        // Frames that are there were made with the range of all steps.
        None if follow.is_none() && left > 0 => guarded(|| range::pass(&*series, &indices, keep, stop, progress))?,
        None => range::Pass::default(),
    };
    let wants_light = sinks.iter().any(|s| s.wants_light());
    let (series, scene) = coarser(series, scene, pass.range)?;
    let mut session = Session::new(device, scene, pass.range, wants_light)?;
    if !sinks.iter().any(|s| s.wants_layers()) {
        session.leave_out_layers();
    }
    if let Some(kept) = kept_light {
        session.start_from(kept);
    }
    let run = Run { session, sinks, ledger, light_state, total: follow.is_none().then_some(left) };
    if let Some(mut follow) = follow {
        let steps = std::iter::from_fn(move || follow.next(stop)).map(move |(step, opened)| match opened {
            _ if done.has(step) => Ok(Turn::Done(step)),
            Ok(step) => Ok(Turn::Now(step)),
            Err(e) => Err((step, e)),
        });
        return run.drive(steps, stop, progress);
    }
    let (series, mut kept) = (&*series, pass.kept);
    let steps = indices.into_iter().map(move |i| {
        let step = info.steps[i].step;
        match kept.remove(&i) {
            _ if done.has(step) => Ok(Turn::Done(step)),
            Some(kept) => Ok(Turn::Now(kept)),
            None => guarded(|| series.timestep(i)).map(Turn::Now).map_err(|e| (step, e)),
        }
    });
    run.drive(steps, stop, progress)
}

/// The series and the scene as a preview shows them.
fn coarser(series: Box<dyn Series>, scene: Scene, range: Option<[f64; 2]>) -> Result<(Box<dyn Series>, Scene)> {
    if scene.render.preview == 1 {
        return Ok((series, scene));
    }
    let range = match scene.field.range {
        RangeKey::Fixed(range) => Some(range),
        RangeKey::Over(_) => range,
    };
    let Some(range) = range else {
        let message = "a preview wants values that are known beforehand; allowed: \"series\" or [lo, hi]";
        return Err(Error::scene("field.range", message));
    };
    let preview = Preview::new(series, scene.render.preview, &scene, range)?;
    let scene = preview.scene(&scene);
    Ok((Box::new(preview), scene))
}

/// Opens one sink for each target. `labels` are the field's name, its units and those of time, for pictures.
pub(crate) fn open_sinks(
    scene: &Scene,
    outputs: &[String],
    steps: usize,
    labels: [&str; 3],
) -> Result<Vec<Box<dyn Sink>>> {
    let [field, units, time_units] = labels.map(String::from);
    let options = SinkOptions {
        steps,
        field,
        units,
        time_units,
        cameras: cameras(scene).into_iter().map(|c| c.name).collect(),
        colors: TransferFunction::new(&scene.transfer)?.colors(),
        ..SinkOptions::from(scene)
    };
    outputs.iter().map(|target| sink::open(target, &options)).collect()
}

/// The range of values over all steps: the scene's, else what the file says, else from a pass over the selected steps.
pub fn series_range(
    series: &dyn Series,
    indices: &[usize],
    scene: &Scene,
    stop: &AtomicBool,
) -> Result<Option<[f64; 2]>> {
    match range::known(series, scene) {
        Some(range) => Ok(range),
        None => Ok(range::pass(series, indices, 0, stop, &mut |_| ())?.range),
    }
}

/// A step whose turn has come.
enum Turn<T> {
    /// An earlier run has done it.
    Done(u64),
    Now(T),
}

/// A step that was found.
type Found = std::result::Result<Turn<Timestep>, (u64, Error)>;

/// What the stages work with.
struct Run {
    session: Session,
    sinks: Vec<Box<dyn Sink>>,
    ledger: Option<Ledger>,
    /// Where the light is left at the end.
    light_state: Option<PathBuf>,
    /// Steps that will come, where known.
    total: Option<usize>,
}

impl Run {
    /// Moves steps through the three stages.
    fn drive(
        self,
        steps: impl Iterator<Item = Found> + Send,
        stop: &AtomicBool,
        progress: &mut OnProgress<'_>,
    ) -> Result<Summary> {
        let Run { mut session, sinks, ledger, light_state, total } = self;
        let (read_tx, read_rx) = bounded(DEPTH);
        let (write_tx, write_rx) = bounded(DEPTH);
        std::thread::scope(|scope| {
            let pages = session.pages();
            let reader = scope.spawn(move || read_ahead(steps, pages, read_tx, stop));
            let writer = scope.spawn(move || write_behind(write_rx, sinks, ledger, total, progress));
            let lit = light_up(&mut session, read_rx, write_tx, stop);
            let written = writer.join().unwrap_or_else(|_| Err(Error::Closed("the writing thread died".into())));
            // A failing sink closes the channel to it; its own error says more than the closed channel does.
            let mut summary = written?;
            summary.skipped = lit?;
            // Without this a reader that died would look like a series that ended.
            reader.join().map_err(|_| Error::Closed("the reading thread died".into()))?;
            summary.interrupted = stop.load(Ordering::Relaxed) && total.is_none_or(|t| summary.rows.len() < t);
            if let (0, 0, false, Some((step, why))) =
                (summary.done, summary.skipped, summary.interrupted, summary.lost.first())
            {
                return Err(Error::Closed(format!("no step could be lit; the first, step {step}: {why}")));
            }
            if let (Some(path), true) = (light_state, summary.done > 0) {
                session.light_state()?.write(&path)?;
            }
            Ok(summary)
        })
    }
}

/// What the reader hands on: values in memory and the time they took, or why there are none.
type Read = std::result::Result<Turn<(Timestep, f64)>, (u64, Error)>;

/// Reads whole steps ahead of their turn; only opens them for a device that pages.
fn read_ahead(steps: impl Iterator<Item = Found>, pages: bool, to: Sender<Read>, stop: &AtomicBool) {
    for found in steps {
        let begun = Instant::now();
        let read = |t: Timestep| {
            let step = t.step;
            let read = if pages { Ok(t) } else { guarded(|| resident(t)) }.map_err(|e| (step, e))?;
            Ok((read, begun.elapsed().as_secs_f64() * 1e3))
        };
        let read = found.and_then(|turn| match turn {
            Turn::Done(step) => Ok(Turn::Done(step)),
            Turn::Now(step) => read(step).map(Turn::Now),
        });
        if stop.load(Ordering::Relaxed) || to.send(read).is_err() {
            return;
        }
    }
}

/// The same step with its values in memory.
fn resident(step: Timestep) -> Result<Timestep> {
    // What the pass for the range kept is in memory already.
    if step.field.is_resident() {
        return Ok(step);
    }
    let mut values = vec![0.0; step.grid.len()];
    step.field.read(step.grid.region(), &mut values)?;
    Ok(Timestep { field: Arc::new(Dense::new(step.grid.size, values)), ..step })
}

/// What the lighting stage hands on: an output, or the row of a lost step.
type Lit = std::result::Result<Output, LedgerRow>;

/// Lights and renders each step; the number of those that an earlier run had done.
fn light_up(session: &mut Session, from: Receiver<Read>, to: Sender<Lit>, stop: &AtomicBool) -> Result<usize> {
    let mut skipped = 0;
    for read in from {
        if stop.load(Ordering::Relaxed) {
            break;
        }
        let lit = match read {
            Ok(Turn::Done(step)) => {
                session.pass_over(step);
                skipped += 1;
                continue;
            }
            Ok(Turn::Now((step, read_ms))) => {
                let (number, time) = (step.step, step.time);
                match guarded(|| session.advance(step)) {
                    Ok(mut output) => {
                        output.row.read_ms = read_ms;
                        Ok(output)
                    }
                    Err(e @ (Error::Format { .. } | Error::Unsupported(_))) => {
                        Err(LedgerRow { step: number, time, lost: e.to_string(), ..Default::default() })
                    }
                    Err(Error::Bug(why)) => return Err(Error::Bug(format!("step {number}: {why}"))),
                    Err(e) => return Err(e),
                }
            }
            Err((step, Error::Bug(why))) => return Err(Error::Bug(format!("reading step {step}: {why}"))),
            Err((step, e)) => Err(LedgerRow { step, lost: e.to_string(), ..Default::default() }),
        };
        if to.send(lit).is_err() {
            break;
        }
    }
    Ok(skipped)
}

/// Writes each output to every sink and keeps the ledger; closes everything at the end, whatever happened.
fn write_behind(
    from: Receiver<Lit>,
    mut sinks: Vec<Box<dyn Sink>>,
    mut ledger: Option<Ledger>,
    total: Option<usize>,
    progress: &mut OnProgress<'_>,
) -> Result<Summary> {
    let mut summary = Summary::default();
    let mut outcome = Ok(());
    for lit in from {
        let row = match lit {
            Ok(mut output) => {
                let begun = Instant::now();
                outcome = sinks.iter_mut().try_for_each(|s| guarded(|| s.write(&output)));
                if outcome.is_err() {
                    break;
                }
                output.row.write_ms = begun.elapsed().as_secs_f64() * 1e3;
                summary.done += 1;
                output.row
            }
            Err(row) => {
                summary.lost.push((row.step, row.lost.clone()));
                row
            }
        };
        if let Some(ledger) = &mut ledger {
            outcome = ledger.push(row.clone());
            if outcome.is_err() {
                break;
            }
        }
        summary.rows.push(row);
        let (finished, row) = (summary.rows.len(), summary.rows.last().expect("just pushed"));
        progress(Progress { stage: Stage::Light, finished, total, row });
    }
    // Every sink is closed, also after one that failed.
    for sink in &mut sinks {
        outcome = outcome.and(guarded(|| sink.finish()));
    }
    outcome.map(|()| summary)
}
