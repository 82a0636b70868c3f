//! The lighting thread: takes waiting steps, lights and renders them, hands them on. It has a floating-point environment,
//! cores and a pool of its own; nothing that goes wrong with one step ends it.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::Arc;

use crossbeam_channel::{Sender, bounded};

use super::queue::{Arrived, Next, Queue};
use super::writing::{Handed, Writing};
use super::{Opening, say};
use crate::device;
use crate::device::cpu::float::DefaultFloat;
use crate::error::{Error, Result, guarded, panic_text};
use crate::field::Timestep;
use crate::ledger::{Ledger, LedgerRow};
use crate::light_state::LightState;
use crate::pipeline::open_sinks;
use crate::scene::InSituKeys;
use crate::session::Session;
use crate::sink::{Output, Sink};

/// Lit steps that may wait to be written.
const DEPTH: usize = 2;

pub(super) struct Lighting {
    session: Session,
    queue: Arc<Queue>,
    /// Where the light is left at the end, and after how many steps.
    light_state: Option<PathBuf>,
    light_state_every: Option<u64>,
    /// Steps lit since the light was left.
    since: u64,
    /// When resuming: the outputs, asked only for the files that a step has.
    complete: Vec<Box<dyn Sink>>,
}

/// Opens everything on the calling thread, tells `opened`, then lights until the queue ends. What fails at the end is the
/// result.
pub(super) fn run(opening: Opening, queue: Arc<Queue>, opened: &Sender<Result<()>>) -> Result<()> {
    let _float = DefaultFloat::enter();
    let set_up = catch_unwind(AssertUnwindSafe(|| set_up(opening, queue)));
    let set_up = set_up.unwrap_or_else(|panic| Err(Error::Bug(panic_text(&*panic))));
    let (mut lighting, writing) = match set_up {
        Ok(both) => both,
        Err(e) => {
            let _ = opened.send(Err(e));
            return Ok(());
        }
    };
    let (to, from) = bounded(DEPTH);
    let writer = std::thread::Builder::new().name("gloaming-write".into()).spawn(move || writing.run(&from));
    let writer = match writer {
        Ok(writer) => writer,
        Err(e) => {
            let _ = opened.send(Err(Error::Device(format!("cannot start a thread: {e}"))));
            return Ok(());
        }
    };
    let _ = opened.send(Ok(()));
    lighting.light_up(to);
    let kept = catch_unwind(AssertUnwindSafe(|| lighting.keep_light()));
    let kept = kept.unwrap_or_else(|panic| Err(Error::Bug(panic_text(&*panic))));
    // A GPU that is put down badly must not take the files with it.
    let put_down = catch_unwind(AssertUnwindSafe(|| drop(lighting)));
    let written = writer.join().unwrap_or_else(|panic| Err(Error::Bug(panic_text(&*panic))));
    written.and(kept).and(put_down.map_err(|panic| Error::Bug(panic_text(&*panic))))
}

fn set_up(opening: Opening, queue: Arc<Queue>) -> Result<(Lighting, Writing)> {
    let Opening { scene, device, mut sinks } = opening;
    let keys = scene.insitu.clone();
    scene.validate()?;
    let kept = LightState::left_at(keys.light_state.as_deref(), &scene)?;
    if keys.outputs.is_empty() && sinks.is_empty() && keys.ledger.is_none() {
        return Err(Error::scene("insitu.outputs", "nothing would be written: give outputs = [\"movie.mp4\"], say"));
    }
    let threads = if keys.threads == 0 { keys.cores.len() } else { keys.threads };
    stay_on(&keys)?;
    let field = scene.field.name.clone().unwrap_or_default();
    // Sinks given by the program are not asked: nobody knows whether what they made last time is still there.
    let resumable = keys.resume && sinks.is_empty();
    let complete = if resumable { open_sinks(&scene, &keys.outputs, 0, [&field, "", ""])? } else { vec![] };
    let mut all = open_sinks(&scene, &keys.outputs, 0, [&field, "", ""])?;
    if keys.resume {
        all.iter_mut().try_for_each(|s| s.resume())?;
    }
    all.append(&mut sinks);
    let ledger = match &keys.ledger {
        Some(path) if keys.resume => Some(Ledger::resume(path)?),
        Some(path) => Some(Ledger::create(path)?),
        None => None,
    };
    // Last: what is wrong with the settings is found before a driver is loaded.
    let device = match device {
        Some(device) => device,
        None => device::open(&keys.device, threads)?,
    };
    let wants_light = all.iter().any(|s| s.wants_light());
    let mut session = Session::new(device, scene, None, wants_light)?;
    if !all.iter().any(|s| s.wants_layers()) {
        session.leave_out_layers();
    }
    session.count_before(keys.steps_before);
    if let Some(kept) = kept {
        session.start_from(kept);
    }
    keys.light_change.into_iter().for_each(|change| session.only_when_light_changes(change));
    let writing = Writing::new(all, ledger, queue.clone());
    let InSituKeys { light_state, light_state_every, .. } = keys;
    Ok((Lighting { session, queue, light_state, light_state_every, since: 0, complete }, writing))
}

/// Keeps this thread, and those that it will start, on the cores of the settings.
fn stay_on(keys: &InSituKeys) -> Result<()> {
    if keys.cores.is_empty() {
        return Ok(());
    }
    #[cfg(target_os = "linux")]
    {
        let mut cores = rustix::thread::CpuSet::new();
        keys.cores.iter().for_each(|core| cores.set(*core));
        rustix::thread::sched_setaffinity(None, &cores).map_err(|e| {
            Error::scene("insitu.cores", format!("{:?}: {e}; allowed are cores that this process may use", keys.cores))
        })
    }
    #[cfg(not(target_os = "linux"))]
    Err(Error::Unsupported("insitu.cores: threads can be kept on cores on Linux only; threads = N bounds them".into()))
}

impl Lighting {
    fn light_up(&mut self, to: Sender<Handed>) {
        loop {
            let handed = match self.queue.next() {
                Next::End => return,
                Next::Note(rows) => rows.into_iter().map(Handed::Note).collect(),
                Next::Light(arrived) => Vec::from_iter(self.light(*arrived)),
                Next::Keep(keep) => {
                    let _ = keep.told.send(guarded(|| self.session.light_state()?.write(&keep.path)));
                    continue;
                }
            };
            for handed in handed {
                if to.send(handed).is_err() {
                    self.queue.end("the writing thread died");
                    return;
                }
            }
            self.keep_light_in_between();
        }
    }

    /// Leaves the light after every so many steps.
    fn keep_light_in_between(&mut self) {
        if self.light_state_every.is_none_or(|every| self.since < every) {
            return;
        }
        self.since = 0;
        if let Err(e) = guarded(|| self.keep_light()) {
            say(&format!("the light is not kept: {e}"));
        }
    }

    /// Leaves the light of the last step for a later run, where one is wanted and a step was lit.
    fn keep_light(&self) -> Result<()> {
        match &self.light_state {
            Some(path) if self.session.grid().is_some() => self.session.light_state()?.write(path),
            _ => Ok(()),
        }
    }

    /// Lights one step, on another device if need be; `None` for one that needs no lighting.
    fn light(&mut self, arrived: Arrived) -> Option<Handed> {
        let Arrived { step, copy, row: pushed } = arrived;
        if self.is_complete(step.step) {
            self.session.pass_over(step.step);
            drop(step);
            self.queue.recycle(copy);
            self.queue.passed_over();
            return None;
        }
        if let Some(before) = self.session.grid().filter(|before| *before != step.grid) {
            let sizes = (before.size, step.grid.size);
            say(&format!("step {}: the grid changed from {:?} to {:?}: lit from scratch", step.step, sizes.0, sizes.1));
            self.session.forget();
        }
        let lit = self.advance(&step);
        drop(step);
        self.queue.recycle(copy);
        let LedgerRow { held_ms, queue_depth, drops, bytes, .. } = pushed;
        Some(match lit {
            Ok(mut output) => {
                self.since += 1;
                output.row = LedgerRow { held_ms, queue_depth, drops, bytes, ..output.row };
                let nothing = output.frames.is_empty() && output.light.is_none();
                if nothing { Handed::Unchanged(output.row) } else { Handed::Lit(Box::new(output)) }
            }
            Err(e) => Handed::Lost(LedgerRow { lost: e.to_string(), ..pushed }),
        })
    }

    /// True when every output has all its files of a step.
    fn is_complete(&self, step: u64) -> bool {
        let has_all = |paths: Vec<PathBuf>| !paths.is_empty() && paths.iter().all(|p| p.exists());
        !self.complete.is_empty() && self.complete.iter().all(|sink| has_all(sink.paths(step)))
    }

    /// Lights a step; where a device fails, has no memory left or panics, another one goes on, which the simulation's user is
    /// told.
    fn advance(&mut self, step: &Timestep) -> Result<Output> {
        loop {
            let lit = catch_unwind(AssertUnwindSafe(|| self.session.try_advance(step)));
            let lit = lit.unwrap_or_else(|panic| Err(Error::Bug(panic_text(&*panic))));
            let Err(why @ (Error::Device(_) | Error::OutOfMemory { .. } | Error::Bug(_))) = lit else {
                if !matches!(lit, Ok(_) | Err(Error::Format { .. } | Error::Io { .. })) {
                    // The light may be half one step's, half the other's.
                    self.session.forget();
                }
                return lit;
            };
            let Some(next) = self.session.fall_back() else {
                self.session.forget();
                return Err(why);
            };
            say(&format!("step {}: {why}\n  going on with {next}", step.step));
        }
    }
}
