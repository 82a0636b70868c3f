//! Linked into a running simulation: steps go in, frames and movies come out, lit on threads of gloaming's own.
//!
//! The contract:
//!
//! 1. **The simulation is never hurt.** Every call returns a result. No panic, NaN, lost device or full disk crosses the
//!    boundary; gloaming never exits, aborts or touches signal handlers, and leaves the floating-point environment as it
//!    found it. What goes wrong with one step is said on stderr and in the ledger, and the next step goes on. A GPU that is
//!    lost is replaced by the CPU.
//! 2. **The simulation waits only for the copy** of [`InSitu::push`], for nothing with [`InSitu::push_owned`], unless the queue
//!    is full and the policy is to wait.
//! 3. **Nothing is lost silently**: drops and losses are counted ([`InSitu::stats`]) and have a row in the ledger.
//!
//! What is shown, written and dropped is in the scene: its `[insitu]` table ([`InSituKeys`]) names outputs, ledger, device,
//! threads, queue, policy and triggers.
//!
//! ```no_run
//! use gloaming::insitu::{InSitu, Strided};
//!
//! # fn main() -> gloaming::Result<()> {
//! let lit = InSitu::open(
//!     r#"
//!     field.range = [0.0, 1.0]
//!     [insitu]
//!     outputs = ["movie.mp4", "frames/frame_{step:06}.png"]
//!     ledger = "ledger.csv"
//!     threads = 1
//!     policy = "drop-oldest"
//!     "#,
//! )?;
//! let density = vec![0.0f64; 66 * 66 * 66];
//! for step in 0..100 {
//!     // … the simulation advances `density`; one layer of ghosts all round is left out.
//!     let block = Strided::of(&density, [66; 3]).region(gloaming::Region { start: [1; 3], size: [64; 3] });
//!     lit.push(step, Some(0.01 * step as f64), &block)?;
//! }
//! println!("{} steps lit", lit.close()?.lit);
//! # Ok(())
//! # }
//! ```

use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Instant;

use crossbeam_channel::bounded;

use crate::device::Device;
use crate::device::cpu::float::DefaultFloat;
use crate::error::{Error, Result, panic_text};
use crate::field::Timestep;
use crate::scene::Scene;
pub use crate::scene::{InSituKeys, Policy};
use crate::sink::Sink;

mod lighting;
mod queue;
mod strided;
mod writing;

pub use queue::Stats;
use queue::{Admission, Arrived, Copied, Queue};
pub use strided::{Number, Strided, Values};

/// What became of a pushed step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Taken {
    /// It waits to be lit.
    Queued,
    /// The queue was full and the policy dropped it: it is counted, and in the ledger.
    Dropped,
    /// No trigger asked for it.
    Skipped,
}

/// An open session. Every method may be called from any thread; steps are lit in the order in which their pushes end.
///
/// Its threads live in the process that opened it. In one that was forked from it every method fails ([`Error::Closed`]) rather than
/// wait for threads that are not there, [`InSitu::stats`] are all 0, and dropping it does nothing. A forked process opens no
/// session of its own either, before it has executed another program: locks of libraries may have been held when it was made.
pub struct InSitu {
    queue: Arc<Queue>,
    lighting: Mutex<Option<JoinHandle<Result<()>>>>,
    /// The process that has the threads.
    process: u32,
}

/// A session to be opened: a scene, and what a scene file cannot say.
pub struct Opening {
    scene: Scene,
    device: Option<Arc<dyn Device>>,
    sinks: Vec<Box<dyn Sink>>,
}

impl Opening {
    /// Computes on this device instead of `insitu.device`.
    pub fn device(self, device: Arc<dyn Device>) -> Self {
        Opening { device: Some(device), ..self }
    }

    /// Hands every lit step to this sink too, on the writing thread.
    pub fn sink(mut self, sink: Box<dyn Sink>) -> Self {
        self.sinks.push(sink);
        self
    }

    /// Opens the device and the outputs, on threads of the session's own.
    ///
    /// # Errors
    /// What is wrong with the settings, an output that cannot be written, a device that does not exist.
    pub fn open(self) -> Result<InSitu> {
        let queue = Arc::new(Queue::new(&self.scene.insitu));
        let (tell, opened) = bounded(1);
        let of_thread = queue.clone();
        let run = move || {
            let result = catch_unwind(AssertUnwindSafe(|| lighting::run(self, of_thread.clone(), &tell)));
            let result = result.unwrap_or_else(|panic| Err(Error::Bug(panic_text(&*panic))));
            of_thread.end(if result.is_ok() {
                "the session was closed"
            } else {
                "the session ended; close() tells why"
            });
            result
        };
        let thread = std::thread::Builder::new().name("gloaming-light".into()).spawn(run);
        let thread = thread.map_err(|e| Error::Device(format!("cannot start a thread: {e}")))?;
        let died = || Err(Error::Bug("the lighting thread died while opening".into()));
        match opened.recv().unwrap_or_else(|_| died()) {
            Ok(()) => Ok(InSitu { queue, lighting: Mutex::new(Some(thread)), process: std::process::id() }),
            Err(e) => {
                let _ = thread.join();
                Err(e)
            }
        }
    }
}

impl InSitu {
    /// Opens a session from the text of a scene file with an `[insitu]` table.
    ///
    /// # Errors
    /// Those of [`Scene::load`] and [`Opening::open`].
    pub fn open(config: &str) -> Result<InSitu> {
        InSitu::with(Scene::parse(config, "config", &[])?).open()
    }

    /// A session of `scene`, to be opened.
    pub fn with(scene: Scene) -> Opening {
        Opening { scene, device: None, sinks: vec![] }
    }

    /// Hands over a step whose values stay the simulation's: they are copied before this returns. Waits for room in
    /// the queue only when the policy is [`Policy::Block`]. `time` is the simulation's, `None` where it has none.
    ///
    /// # Errors
    /// [`Error::Unsupported`] for a block that cannot be read or shown, [`Error::OutOfMemory`] without memory for the copy
    /// (the step is lost, and in the ledger); [`Error::Closed`] after [`InSitu::close`].
    pub fn push<B: AsRef<[u8]>>(&self, step: u64, time: Option<f64>, block: &Strided<B>) -> Result<Taken> {
        self.offer(step, time, |memory| {
            block.check()?;
            let copy = Arc::new(block.copied(memory)?);
            let step = Timestep { step, time, grid: block.grid(), field: copy.clone() };
            Ok((step, Some(copy), block.shown_bytes()))
        })
    }

    /// Hands over a step for good: nothing is copied here. The field is read on the session's own thread, and dropped when
    /// the step is done with. An owned [`Strided`] is a field; so is whatever implements [`Field`](crate::field::Field).
    ///
    /// # Errors
    /// [`Error::Unsupported`] for a grid without values; [`Error::Closed`] after [`InSitu::close`].
    pub fn push_owned(&self, step: Timestep) -> Result<Taken> {
        self.offer(step.step, step.time, |_| {
            if step.grid.is_empty() {
                let size = step.grid.size;
                return Err(Error::Unsupported(format!("a block of {size:?} values: there is nothing to light")));
            }
            Ok((step, None, 0))
        })
    }

    /// Gives a step up that could not be handed over, so that it is counted, said and in the ledger like any other loss.
    ///
    /// # Errors
    /// `why`, when a trigger or the policy did not pass the step over anyway; [`Error::Closed`] after [`InSitu::close`].
    pub fn lose(&self, step: u64, time: Option<f64>, why: Error) -> Result<Taken> {
        self.offer(step, time, |_| Err(why))
    }

    fn offer(
        &self,
        step: u64,
        time: Option<f64>,
        take: impl FnOnce(Vec<f32>) -> Result<(Timestep, Option<Copied>, u64)>,
    ) -> Result<Taken> {
        self.is_here()?;
        let begun = Instant::now();
        let _float = DefaultFloat::enter();
        let (spare, row) = match self.queue.admit(step, time, begun)? {
            Admission::Skipped => return Ok(Taken::Skipped),
            Admission::Dropped => return Ok(Taken::Dropped),
            Admission::Room(spare, row) => (spare, *row),
        };
        let taken = catch_unwind(AssertUnwindSafe(|| take(spare)));
        match taken.unwrap_or_else(|panic| Err(Error::Bug(panic_text(&*panic)))) {
            Ok((step, copy, bytes)) => {
                let row = crate::ledger::LedgerRow { bytes, ..row };
                self.queue.put(Arrived { step, copy, row }, begun);
                Ok(Taken::Queued)
            }
            Err(e) => {
                self.queue.refuse(row, &e, begun);
                Err(e)
            }
        }
    }

    /// Waits until every step pushed so far is lit and written.
    ///
    /// # Errors
    /// [`Error::Closed`] when the session has ended. Steps that were lost are no error here: see [`InSitu::stats`].
    pub fn flush(&self) -> Result<()> {
        self.is_here()?;
        self.queue.flush()
    }

    /// Waits until the steps pushed so far are lit and written, and keeps their light in a file, for a simulation to call where it
    /// writes a restart file. A run that is restarted from there goes on warm when the file is its `insitu.light_state`, with the
    /// frames that this one makes. The file appears under its name only when it is whole, in the place of an earlier one.
    ///
    /// # Errors
    /// [`Error::Unsupported`] before the first step and for the paper's model, [`Error::Io`] where the file cannot be written;
    /// [`Error::Closed`] when the session has ended.
    pub fn save_light(&self, path: &Path) -> Result<()> {
        self.flush()?;
        self.queue.keep(path.into())
    }

    /// What has become of the steps so far.
    pub fn stats(&self) -> Stats {
        if self.is_here().is_ok() { self.queue.stats() } else { Stats::default() }
    }

    /// Lights what is still waiting, closes every file and ends the threads. Later calls give the same figures.
    ///
    /// # Errors
    /// The first file that could not be closed; [`InSitu::stats`] still tells the rest.
    pub fn close(&self) -> Result<Stats> {
        self.is_here()?;
        self.queue.close();
        let thread = self.lighting.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(thread) = thread {
            thread.join().unwrap_or_else(|panic| Err(Error::Bug(panic_text(&*panic))))?;
        }
        Ok(self.stats())
    }

    /// That this is the process that has the session's threads.
    fn is_here(&self) -> Result<()> {
        if std::process::id() == self.process {
            return Ok(());
        }
        let why = "the session belongs to the process that this one was forked from\n  try: to open one in a program of its own";
        Err(Error::Closed(why.into()))
    }
}

impl Drop for InSitu {
    fn drop(&mut self) {
        if self.is_here().is_err() {
            // Not even detached: the thread is not here.
            std::mem::forget(self.lighting.get_mut().unwrap_or_else(PoisonError::into_inner).take());
            return;
        }
        // What could not be closed has been said.
        let _ = self.close();
    }
}

/// Says something to whoever watches the simulation. It may have closed stderr, which is no reason to end it.
fn say(text: &str) {
    let _ = writeln!(std::io::stderr(), "gloaming: {text}");
}
