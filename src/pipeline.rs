//! A whole series: reading ∥ lighting and rendering ∥ writing, on bounded channels.
//!
//! One thread reads ahead, the calling thread lights and renders, one thread writes. A step that cannot be read is lost:
//! stated on stderr and in the ledger, and the rest goes on. A sink or a device that fails ends the run with its error,
//! after everything already finished is closed properly.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use crossbeam_channel::{Receiver, Sender, bounded};

use crate::device::Device;
use crate::error::{Error, Result};
use crate::field::{self, Dense, Timestep};
use crate::grid::Slab;
use crate::ledger::{Ledger, LedgerRow};
use crate::scene::{RangeKey, RangeOver, Scene};
use crate::session::{Session, cameras};
use crate::sink::{self, Output, Sink, SinkOptions};
use crate::source::Series;
use crate::transfer::TransferFunction;

/// Steps that may wait between two stages: one in hand and one ready is enough to overlap them.
const DEPTH: usize = 2;

/// Bytes of a step that are held at a time where only its range of values is wanted.
const RANGE_BYTES: usize = 32 << 20;

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
}

/// What became of a run.
#[derive(Debug, Clone, Default)]
pub struct Summary {
    /// Steps written.
    pub done: usize,
    /// Steps lost, with the reason.
    pub lost: Vec<(u64, String)>,
    /// True when the run was stopped before its end.
    pub interrupted: bool,
    /// One row a step, lost ones included.
    pub rows: Vec<LedgerRow>,
}

/// A step has been written (or lost).
pub struct Progress<'a> {
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
    let Job { series, indices, scene, device, outputs, ledger } = job;
    if indices.is_empty() {
        let info = series.info();
        return Err(Error::format(
            info.series.first().cloned().unwrap_or_default(),
            format!("no step selected out of {}", info.steps.len()),
            "gloaming info SERIES lists the steps",
        ));
    }
    let range = series_range(&*series, &indices, &scene, stop)?;
    let total = indices.len();
    let info = series.info();
    let sinks = open_sinks(&scene, &outputs, total, [&info.field, &info.units, &info.time_units])?;
    let wants_light = sinks.iter().any(|s| s.wants_light());
    let session = Session::new(device, scene, range, wants_light)?;
    let steps = indices.into_iter().map(|i| {
        let step = series.info().steps[i].step;
        series.timestep(i).map_err(|e| (step, e))
    });
    drive(steps, session, sinks, ledger, Some(total), stop, progress)
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
    if scene.field.range != RangeKey::Over(RangeOver::Series) {
        return Ok(None);
    }
    if let Some((range, source)) = &series.info().range {
        tracing::info!("values {}..{} from {source}", range[0], range[1]);
        return Ok(Some(*range));
    }
    let (mut lo, mut hi) = (f32::INFINITY, f32::NEG_INFINITY);
    let mut values = Vec::new();
    for &i in indices {
        if stop.load(Ordering::Relaxed) {
            break;
        }
        // A step that cannot be read is reported when its turn comes.
        let Ok(step) = series.timestep(i) else { continue };
        let [nx, ny, nz] = step.grid.size;
        let deep = (RANGE_BYTES / (4 * nx * ny).max(1)).clamp(1, nz);
        values.resize(nx * ny * deep, 0.0);
        let (mut least, mut most) = (lo, hi);
        let read = (0..nz).step_by(deep).try_for_each(|z| {
            let slab = Slab { size: step.grid.size, planes: z..(z + deep).min(nz) };
            field::read_planes(&*step.field, &slab, &mut values)?;
            for &v in values[..slab.len()].iter().filter(|v| **v >= field::HOLE) {
                least = least.min(v);
                most = most.max(v);
            }
            Ok::<_, Error>(())
        });
        if read.is_ok() {
            (lo, hi) = (least, most);
        }
    }
    if lo > hi {
        return Ok(None);
    }
    tracing::info!("values {lo}..{hi} from a pass over {} steps; field.range = [lo, hi] saves it", indices.len());
    Ok(Some([f64::from(lo), f64::from(hi)]))
}

/// Moves steps through the three stages.
fn drive(
    steps: impl Iterator<Item = std::result::Result<Timestep, (u64, Error)>> + Send,
    mut session: Session,
    sinks: Vec<Box<dyn Sink>>,
    ledger: Option<PathBuf>,
    total: Option<usize>,
    stop: &AtomicBool,
    progress: &mut OnProgress<'_>,
) -> Result<Summary> {
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
        lit?;
        // Without this a reader that died would look like a series that ended.
        reader.join().map_err(|_| Error::Closed("the reading thread died".into()))?;
        summary.interrupted = stop.load(Ordering::Relaxed) && total.is_none_or(|t| summary.rows.len() < t);
        if let (0, false, Some((step, why))) = (summary.done, summary.interrupted, summary.lost.first()) {
            return Err(Error::Closed(format!("no step could be lit; the first, step {step}: {why}")));
        }
        Ok(summary)
    })
}

/// What the reader hands on: values in memory and the time they took, or why there are none.
type Read = std::result::Result<(Timestep, f64), (u64, Error)>;

/// Reads whole steps ahead of their turn; only opens them for a device that pages.
fn read_ahead(
    steps: impl Iterator<Item = std::result::Result<Timestep, (u64, Error)>>,
    pages: bool,
    to: Sender<Read>,
    stop: &AtomicBool,
) {
    for step in steps {
        let begun = Instant::now();
        let read = step.and_then(|t| if pages { Ok(t) } else { resident(t.clone()).map_err(|e| (t.step, e)) });
        let read = read.map(|t| (t, begun.elapsed().as_secs_f64() * 1e3));
        if stop.load(Ordering::Relaxed) || to.send(read).is_err() {
            return;
        }
    }
}

/// The same step with its values in memory.
fn resident(step: Timestep) -> Result<Timestep> {
    let mut values = vec![0.0; step.grid.len()];
    step.field.read(step.grid.region(), &mut values)?;
    Ok(Timestep { field: Arc::new(Dense::new(step.grid.size, values)), ..step })
}

/// What the lighting stage hands on: an output, or the row of a lost step.
type Lit = std::result::Result<Output, LedgerRow>;

/// Lights and renders each step.
fn light_up(session: &mut Session, from: Receiver<Read>, to: Sender<Lit>, stop: &AtomicBool) -> Result<()> {
    for read in from {
        if stop.load(Ordering::Relaxed) {
            break;
        }
        let lit = match read {
            Ok((step, read_ms)) => {
                let (number, time) = (step.step, step.time);
                match session.advance(step) {
                    Ok(mut output) => {
                        output.row.read_ms = read_ms;
                        Ok(output)
                    }
                    Err(e @ (Error::Format { .. } | Error::Unsupported(_))) => {
                        Err(LedgerRow { step: number, time, lost: e.to_string(), ..Default::default() })
                    }
                    Err(e) => return Err(e),
                }
            }
            Err((step, e)) => Err(LedgerRow { step, lost: e.to_string(), ..Default::default() }),
        };
        if to.send(lit).is_err() {
            break;
        }
    }
    Ok(())
}

/// Writes each output to every sink and keeps the ledger; closes everything at the end, whatever happened.
fn write_behind(
    from: Receiver<Lit>,
    mut sinks: Vec<Box<dyn Sink>>,
    ledger: Option<PathBuf>,
    total: Option<usize>,
    progress: &mut OnProgress<'_>,
) -> Result<Summary> {
    let mut ledger = ledger.map(Ledger::create).transpose()?;
    let mut summary = Summary::default();
    let mut outcome = Ok(());
    for lit in from {
        let row = match lit {
            Ok(mut output) => {
                let begun = Instant::now();
                outcome = sinks.iter_mut().try_for_each(|s| s.write(&output));
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
        progress(Progress { finished: summary.rows.len(), total, row: summary.rows.last().expect("just pushed") });
    }
    // Every sink is closed, also after one that failed.
    for sink in &mut sinks {
        outcome = outcome.and(sink.finish());
    }
    outcome.map(|()| summary)
}
