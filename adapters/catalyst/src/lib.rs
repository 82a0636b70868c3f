//! gloaming as a Catalyst 2 implementation, `libcatalyst-gloaming.so`: a simulation that is instrumented for Catalyst is lit while
//! it runs, without being built anew.
//!
//! ```sh
//! export CATALYST_IMPLEMENTATION_NAME=gloaming
//! export CATALYST_IMPLEMENTATION_PATHS=PREFIX/lib/catalyst      # where `./x install --prefix PREFIX` put the library
//! export GLOAMING_CONFIG=scene.toml                             # unless the simulation names a .toml in catalyst/scripts
//! ./simulation
//! ```
//!
//! The configuration is a scene file with an `[insitu]` table. Where a simulation has several fields or channels, `field.name`
//! picks one: `density`, or `grid/density` with the channel's name. Uniform meshes are taken, values at vertices or in elements, of
//! any type and stride; ghost layers are left out, single ghosts become holes. In a run on several processes each lights its own
//! block, and `{rank}` in the configuration stands for the process's number.
//!
//! A simulation that puts a path at `catalyst/gloaming/save_light` into what it executes, where it writes a restart file, finds the
//! light of the steps so far in that file when the call returns; a restarted run whose `insitu.light_state` it is goes on warm.
//! `insitu.light_state_every` does so without the simulation's doing.
//!
//! Every call returns a status: 0, or one of [`Status`]. What went wrong with a step is said on stderr and written in the ledger,
//! and `catalyst_results` tells the latest under `catalyst/gloaming`; the next step goes on.

use std::ffi::c_int;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use gloaming::insitu::{InSitu, Stats};
use gloaming::scene::{ComponentKey, Scene};
use gloaming::{Error, Result};

mod conduit;
mod config;
mod mesh;

use conduit::{Node, RawNode};

/// What a call may return besides 0: the C interface's codes after Catalyst's own, which are below 100.
#[repr(i32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Status {
    /// The operating system refused: a path, a permission, a full disk.
    Io = 101,
    /// A node is missing, or not what it should be.
    Format = 102,
    /// The configuration says something impossible.
    Scene = 103,
    /// A kind of mesh, or a setting, that this version does not do.
    Unsupported = 104,
    /// Memory for a step is lacking.
    OutOfMemory = 105,
    /// The compute device failed or does not exist.
    Device = 106,
    /// Not initialised, initialised twice, or not loaded by Catalyst.
    Closed = 107,
    /// A fault of gloaming's own.
    Bug = 108,
    /// From `catalyst_finalize`: some steps were lost on the way.
    Losses = 110,
}

impl From<&Error> for Status {
    fn from(error: &Error) -> Status {
        match error {
            Error::Io { .. } => Status::Io,
            Error::Format { .. } => Status::Format,
            Error::Scene { .. } => Status::Scene,
            Error::Unsupported(_) => Status::Unsupported,
            Error::OutOfMemory { .. } => Status::OutOfMemory,
            Error::Device(_) => Status::Device,
            Error::Closed(_) => Status::Closed,
            _ => Status::Bug,
        }
    }
}

/// `struct catalyst_impl` of Catalyst's C interface, version 1.
#[repr(C)]
pub struct Implementation {
    version: c_int,
    initialize: unsafe extern "C" fn(*const RawNode) -> c_int,
    execute: unsafe extern "C" fn(*const RawNode) -> c_int,
    finalize: unsafe extern "C" fn(*const RawNode) -> c_int,
    about: unsafe extern "C" fn(*mut RawNode) -> c_int,
    results: unsafe extern "C" fn(*mut RawNode) -> c_int,
}

/// The one symbol that Catalyst's loader looks for.
#[unsafe(no_mangle)]
#[allow(non_upper_case_globals)]
pub static catalyst_api_impl: Implementation =
    Implementation { version: 1, initialize, execute, finalize, about, results };

/// What is kept between calls. Catalyst is one to a process.
struct State {
    open: Option<Coupling>,
    /// Figures of a session that has been closed.
    stats: Stats,
    /// The latest error; empty when there was none.
    error: String,
}

struct Coupling {
    lit: InSitu,
    field: Option<String>,
    component: ComponentKey,
    /// Number of the next step where the simulation does not number them.
    next: u64,
}

/// Where a simulation says that the light is to be kept in a file.
const SAVE_LIGHT: &str = "catalyst/gloaming/save_light";

static STATE: Mutex<Option<State>> = Mutex::new(None);

/// What became of a call, when it failed.
struct Failure {
    error: Error,
    /// True when the session has said it already.
    said: bool,
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        Failure { error, said: false }
    }
}

/// Runs one call. Nothing that goes wrong in it reaches the simulation but the status.
fn answer(name: &str, call: impl FnOnce(&mut State) -> std::result::Result<c_int, Failure>) -> c_int {
    let mut state = STATE.lock().unwrap_or_else(PoisonError::into_inner);
    let state = state.get_or_insert_with(|| State { open: None, stats: Stats::default(), error: String::new() });
    let called = catch_unwind(AssertUnwindSafe(|| call(state)));
    let failure = match called {
        Ok(Ok(status)) => return status,
        Ok(Err(failure)) => failure,
        Err(_) => Error::Bug(format!("catalyst_{name} panicked; the reason is above")).into(),
    };
    let text = failure.error.to_string();
    if !failure.said {
        say(&format!("catalyst_{name}: {text}"));
    }
    state.error = text;
    Status::from(&failure.error) as c_int
}

/// Says something to whoever watches the simulation, which may have closed stderr.
fn say(text: &str) {
    use std::io::Write;
    let _ = writeln!(std::io::stderr(), "gloaming: {text}");
}

unsafe extern "C" fn initialize(params: *const RawNode) -> c_int {
    answer("initialize", |state| {
        if state.open.is_some() {
            return Err(Error::Closed("initialised already: finalise first".into()).into());
        }
        // SAFETY: the host's node, live during the call.
        let root = unsafe { Node::root(params) }?;
        let scene = config::scene(&root)?;
        state.open = Some(open(scene)?);
        state.stats = Stats::default();
        state.error.clear();
        Ok(0)
    })
}

fn open(scene: Scene) -> Result<Coupling> {
    // Warnings would reach nobody in a program without a subscriber.
    let _ = tracing_subscriber::fmt()
        .with_max_level(tracing_subscriber::filter::LevelFilter::WARN)
        .with_writer(std::io::stderr)
        .without_time()
        .try_init();
    let (field, component) = (scene.field.name.clone(), scene.field.component.clone());
    Ok(Coupling { lit: InSitu::with(scene).open()?, field, component, next: 0 })
}

fn not_open() -> Failure {
    Error::Closed("not initialised, or finalised already".into()).into()
}

unsafe extern "C" fn execute(params: *const RawNode) -> c_int {
    answer("execute", |state| {
        let coupling = state.open.as_mut().ok_or_else(not_open)?;
        // SAFETY: the host's node, live during the call; nothing of it is kept.
        let root = unsafe { Node::root(params) };
        let (step, time) = match &root {
            Ok(root) => mesh::moment(root, coupling.next),
            Err(_) => (coupling.next, None),
        };
        coupling.next = step + 1;
        let block = root.and_then(|root| {
            let field = mesh::choose(&root, coupling.field.as_deref())?;
            mesh::block(&field, &coupling.component)
        });
        let pushed = match block {
            Ok(mesh::Block::Lent(block)) => coupling.lit.push(step, time, &block),
            Ok(mesh::Block::Made(grid, field)) => {
                coupling.lit.push_owned(gloaming::field::Timestep { step, time, grid, field })
            }
            Err(e) => coupling.lit.lose(step, time, e),
        };
        let said = |error| Failure { said: !matches!(error, Error::Closed(_)), error };
        pushed.map_err(said)?;
        // SAFETY: as above.
        let root = unsafe { Node::root(params) }?;
        if root.get(SAVE_LIGHT).is_some() {
            coupling.lit.save_light(Path::new(&root.need_text(SAVE_LIGHT)?))?;
        }
        Ok(0)
    })
}

unsafe extern "C" fn finalize(_: *const RawNode) -> c_int {
    answer("finalize", |state| {
        let coupling = state.open.take().ok_or_else(not_open)?;
        let closed = coupling.lit.close();
        state.stats = coupling.lit.stats();
        closed?;
        let Stats { pushed, lost, dropped, .. } = state.stats;
        if lost + dropped > 0 {
            say(&format!("of {pushed} steps {lost} were lost and {dropped} dropped"));
        }
        Ok(if lost > 0 { Status::Losses as c_int } else { 0 })
    })
}

unsafe extern "C" fn about(params: *mut RawNode) -> c_int {
    answer("about", |_| {
        // SAFETY: the host's node, live during the call, for us to fill.
        let root = unsafe { Node::root(params) }?;
        root.put_text("catalyst/implementation", "gloaming");
        root.put_text("catalyst/gloaming/version", env!("CARGO_PKG_VERSION"));
        Ok(0)
    })
}

unsafe extern "C" fn results(params: *mut RawNode) -> c_int {
    answer("results", |state| {
        // SAFETY: the host's node, live during the call, for us to fill.
        let root = unsafe { Node::root(params) }?;
        let stats = state.open.as_ref().map_or_else(|| state.stats.clone(), |open| open.lit.stats());
        let Stats { pushed, lit, lost, dropped, skipped, waiting, held_ms, last_loss, .. } = stats;
        let counts = [("steps", pushed), ("lit", lit), ("lost", lost), ("dropped", dropped), ("skipped", skipped)];
        for (name, count) in counts.into_iter().chain([("waiting", waiting)]) {
            root.put_integer(&format!("catalyst/gloaming/{name}"), count);
        }
        root.put_number("catalyst/gloaming/held_ms", held_ms);
        // Losses on gloaming's own threads come after the call that pushed the step.
        let error = last_loss.map_or_else(|| state.error.clone(), |(step, why)| format!("step {step}: {why}"));
        if !error.is_empty() {
            root.put_text("catalyst/gloaming/error", &error);
        }
        Ok(0)
    })
}

// On LP64 the loader reads 48 bytes.
#[cfg(target_pointer_width = "64")]
const _: () = assert!(size_of::<Implementation>() == 48);
