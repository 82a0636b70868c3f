//! The C interface: an opaque handle, plain structures, a code for each kind of error. The rules stand at the top of
//! `include/gloaming.h`, which is made from this crate.

#![allow(non_camel_case_types)]

use std::ffi::{CStr, c_char, c_void};
use std::path::Path;
use std::sync::Arc;

use gloaming::field::Timestep;
use gloaming::insitu::{InSitu, Taken};
use gloaming::scene::Scene;

mod block;
mod sessions;
mod status;

pub use block::*;
pub use sessions::gloaming_session;
pub use status::*;

/// What has become of the steps so far: pushed = lit + lost + dropped + skipped + waiting.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub struct gloaming_stats {
    /// Steps offered.
    pub pushed: u64,
    /// Steps lit and written, to every output.
    pub lit: u64,
    /// Steps that could not be taken in, lit, or written to some output.
    pub lost: u64,
    /// Steps dropped because the queue was full.
    pub dropped: u64,
    /// Steps that no trigger asked for.
    pub skipped: u64,
    /// Steps waiting, being lit or being written.
    pub waiting: u64,
    /// Bytes copied out of the simulation's memory.
    pub bytes: u64,
    /// Time the simulation was held by pushes, in milliseconds.
    pub held_ms: f64,
    /// The longest that one push held it, in milliseconds.
    pub longest_held_ms: f64,
}

impl From<gloaming::insitu::Stats> for gloaming_stats {
    fn from(s: gloaming::insitu::Stats) -> Self {
        gloaming_stats {
            pushed: s.pushed,
            lit: s.lit,
            lost: s.lost,
            dropped: s.dropped,
            skipped: s.skipped,
            waiting: s.waiting,
            bytes: s.bytes,
            held_ms: s.held_ms,
            longest_held_ms: s.longest_held_ms,
        }
    }
}

/// The version of the library, such as "0.1.0". Lives as long as the program.
#[unsafe(no_mangle)]
pub extern "C" fn gloaming_version() -> *const c_char {
    concat!(env!("CARGO_PKG_VERSION"), "\0").as_ptr().cast()
}

/// Opens a session from `config`, the text of a scene file with an `[insitu]` table (see the README), as UTF-8 that ends in
/// 0. The text is read before this returns. NULL when it fails: `error` tells why, and so does stderr.
///
/// # Safety
/// `config` is NULL or ends in 0; `error` is NULL or points to a gloaming_error.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gloaming_open(config: *const c_char, error: *mut gloaming_error) -> *mut gloaming_session {
    // SAFETY: as the caller promises.
    unsafe { opened(error, || Scene::parse(text(config)?, "config", &[]).map_err(Fault::from)) }
}

/// Opens a session from the scene file at `path`. As gloaming_open.
///
/// # Safety
/// `path` is NULL or ends in 0; `error` is NULL or points to a gloaming_error.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gloaming_open_file(path: *const c_char, error: *mut gloaming_error) -> *mut gloaming_session {
    // SAFETY: as the caller promises.
    unsafe { opened(error, || Scene::load(Some(Path::new(text(path)?)), &[]).map_err(Fault::from)) }
}

/// Hands over a step: `dims` values along x, y, z in memory at `values`, of type `type` (GLOAMING_F32 …), `strides` values
/// apart along x, y, z (NULL: dense, x fastest, as Fortran arrays `a(x, y, z)` and C arrays `a[z][y][x]` are). `time` is the
/// simulation's; NaN where it has none. The values are copied before this returns, as 32-bit floats. It waits only when the
/// queue is full and the policy is "block".
///
/// # Safety
/// `dims` points to 3 numbers; `strides` to 3, or is NULL; all `dims` values can be read at `values`; `error` is NULL or points
/// to a gloaming_error. Nothing is kept.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gloaming_push(
    session: *mut gloaming_session,
    step: u64,
    time: f64,
    dims: *const usize,
    strides: *const isize,
    r#type: i32,
    values: *const c_void,
    error: *mut gloaming_error,
) -> i32 {
    // SAFETY: as the caller promises.
    unsafe {
        guarded(error, || {
            if dims.is_null() {
                return Err(Fault::argument("dims is NULL"));
            }
            let dims = dims.cast::<[usize; 3]>().read_unaligned();
            let strides = if strides.is_null() { [0; 3] } else { strides.cast::<[isize; 3]>().read_unaligned() };
            let block = gloaming_block { dims, strides, r#type, ..Default::default() };
            push(session, step, time, &block, values)
        })
    }
}

/// Hands over a step as gloaming_push does, with ghost layers left out and a place in space: see gloaming_block.
///
/// # Safety
/// `block` points to a gloaming_block; all its `dims` values can be read at `values`; `error` is NULL or points to a
/// gloaming_error. Nothing is kept.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gloaming_push_block(
    session: *mut gloaming_session,
    step: u64,
    time: f64,
    block: *const gloaming_block,
    values: *const c_void,
    error: *mut gloaming_error,
) -> i32 {
    // SAFETY: as the caller promises.
    unsafe {
        guarded(error, || {
            let block = block.as_ref().ok_or_else(|| Fault::argument("block is NULL"))?;
            push(session, step, time, block, values)
        })
    }
}

/// Gives a step away: nothing is copied. `values` must stay as they are until `release(user)` is called, exactly once, whatever
/// becomes of the step: from a thread of gloaming's, or from this one before this returns. `release` must not call gloaming,
/// throw or jump; NULL when the memory outlives the session.
///
/// # Safety
/// `block` points to a gloaming_block; all its `dims` values can be read at `values`, from any thread, until the release;
/// `error` is NULL or points to a gloaming_error.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gloaming_push_owned(
    session: *mut gloaming_session,
    step: u64,
    time: f64,
    block: *const gloaming_block,
    values: *mut c_void,
    release: Option<unsafe extern "C" fn(*mut c_void)>,
    user: *mut c_void,
    error: *mut gloaming_error,
) -> i32 {
    let release = Release::new(release, user);
    // SAFETY: as the caller promises.
    unsafe {
        guarded(error, || {
            let block = block.as_ref().ok_or_else(|| Fault::argument("block is NULL"))?;
            let lit = sessions::find(session)?;
            let time = known(time);
            let taken = match block.over(Given::new(block, values, release)) {
                Ok(given) => lit.push_owned(Timestep { step, time, grid: given.grid(), field: Arc::new(given) }),
                Err(e) => lit.lose(step, time, e),
            };
            Ok(status::taken(taken?))
        })
    }
}

/// Waits until every step pushed so far is lit and written. Steps that were lost are no failure here: see gloaming_stats.
///
/// # Safety
/// `error` is NULL or points to a gloaming_error.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gloaming_flush(session: *mut gloaming_session, error: *mut gloaming_error) -> i32 {
    // SAFETY: as the caller promises.
    unsafe {
        guarded(error, || {
            sessions::find(session)?.flush()?;
            Ok(GLOAMING_OK)
        })
    }
}

/// Waits until every step pushed so far is lit and written, and keeps their light in the file at `path`: call it where a restart
/// file is written. A run that is restarted from there goes on warm when that is its `insitu.light_state`. The file appears under
/// its name only when it is whole, in the place of an earlier one.
///
/// # Safety
/// `path` is NULL or ends in 0; `error` is NULL or points to a gloaming_error.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gloaming_save_light(
    session: *mut gloaming_session,
    path: *const c_char,
    error: *mut gloaming_error,
) -> i32 {
    // SAFETY: as the caller promises.
    unsafe {
        guarded(error, || {
            let lit = sessions::find(session)?;
            lit.save_light(Path::new(text(path)?))?;
            Ok(GLOAMING_OK)
        })
    }
}

/// Tells what has become of the steps so far.
///
/// # Safety
/// `stats` points to a gloaming_stats; `error` is NULL or points to a gloaming_error.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gloaming_get_stats(
    session: *mut gloaming_session,
    stats: *mut gloaming_stats,
    error: *mut gloaming_error,
) -> i32 {
    // SAFETY: as the caller promises.
    unsafe {
        guarded(error, || {
            let now = sessions::find(session)?.stats();
            stats.as_mut().map(|stats| *stats = now.into()).ok_or_else(|| Fault::argument("stats is NULL"))?;
            Ok(GLOAMING_OK)
        })
    }
}

/// Lights what is still waiting, closes every file and ends the threads. `stats`, unless it is NULL, receives the final
/// figures, also when this fails because a file could not be closed. The session is gone afterwards, whatever this returns.
///
/// # Safety
/// `stats` is NULL or points to a gloaming_stats; `error` is NULL or points to a gloaming_error.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gloaming_close(
    session: *mut gloaming_session,
    stats: *mut gloaming_stats,
    error: *mut gloaming_error,
) -> i32 {
    // SAFETY: as the caller promises.
    unsafe {
        guarded(error, || {
            let lit = sessions::remove(session)?;
            let closed = lit.close();
            if let Some(stats) = stats.as_mut() {
                *stats = lit.stats().into();
            }
            closed?;
            Ok(GLOAMING_OK)
        })
    }
}

/// Opens a session and says on stderr when it could not be.
///
/// # Safety
/// `error` is NULL or points to a gloaming_error.
unsafe fn opened(error: *mut gloaming_error, scene: impl FnOnce() -> Result<Scene, Fault>) -> *mut gloaming_session {
    // Warnings would reach nobody in a program without a subscriber.
    let _ = tracing_subscriber::fmt()
        .with_max_level(tracing_subscriber::filter::LevelFilter::WARN)
        .with_writer(std::io::stderr)
        .without_time()
        .try_init();
    let mut session = std::ptr::null_mut();
    let mut own = gloaming_error::default();
    // SAFETY: `own` is a gloaming_error.
    let code = unsafe {
        guarded(&raw mut own, || {
            sessions::check()?;
            session = sessions::add(InSitu::with(scene()?).open()?)?;
            Ok(GLOAMING_OK)
        })
    };
    if code != GLOAMING_OK {
        use std::io::Write;
        let _ = writeln!(std::io::stderr(), "gloaming: not opened: {}", own.text());
    }
    // SAFETY: as the caller promises.
    if let Some(error) = unsafe { error.as_mut() } {
        *error = own;
    }
    session
}

/// # Safety
/// All of the block's `dims` values can be read at `values`.
unsafe fn push(
    session: *mut gloaming_session,
    step: u64,
    time: f64,
    block: &gloaming_block,
    values: *const c_void,
) -> Result<i32, Fault> {
    let lit = sessions::find(session)?;
    let time = known(time);
    // SAFETY: as the caller promises; the borrow ends with this function.
    let bytes = unsafe { block.bytes(values) };
    let taken = match block.over(bytes) {
        Ok(strided) => lit.push(step, time, &strided),
        Err(e) => lit.lose(step, time, e),
    };
    Ok(status::taken(taken?))
}

fn known(time: f64) -> Option<f64> {
    Some(time).filter(|t| !t.is_nan())
}

/// # Safety
/// `text` is NULL or ends in 0, and stays as it is while the result is used.
unsafe fn text<'a>(text: *const c_char) -> Result<&'a str, Fault> {
    if text.is_null() {
        return Err(Fault::argument("the text is NULL"));
    }
    // SAFETY: as the caller promises.
    unsafe { CStr::from_ptr(text) }.to_str().map_err(|e| Fault::argument(&format!("the text is not UTF-8: {e}")))
}
