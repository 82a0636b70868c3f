//! Open sessions by number. A handle is such a number dressed as a pointer, never looked behind, so that one that was closed
//! is refused rather than followed.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use gloaming::Error;
use gloaming::insitu::InSitu;

use super::Fault;

/// An open session.
#[repr(C)]
pub struct gloaming_session {
    _private: [u8; 0],
}

struct Sessions {
    open: BTreeMap<usize, Arc<InSitu>>,
    /// Numbers are never used again.
    last: usize,
}

static SESSIONS: Mutex<Sessions> = Mutex::new(Sessions { open: BTreeMap::new(), last: 0 });

/// The process that has the sessions; 0 before the first.
static PROCESS: AtomicU32 = AtomicU32::new(0);

/// The sessions, where this process has them. In one that was forked the lock may be another thread's that is not here to let go of it.
fn lock() -> Result<MutexGuard<'static, Sessions>, Fault> {
    let process = std::process::id();
    match PROCESS.compare_exchange(0, process, Ordering::Relaxed, Ordering::Relaxed) {
        Err(other) if other != process => {
            let why = "gloaming's sessions belong to the process that this one was forked from\n  try: to open one in a program of its own";
            Err(Error::Closed(why.into()).into())
        }
        _ => Ok(SESSIONS.lock().unwrap_or_else(PoisonError::into_inner)),
    }
}

/// That sessions can be opened in this process.
pub(crate) fn check() -> Result<(), Fault> {
    lock().map(|_| ())
}

pub(crate) fn add(session: InSitu) -> Result<*mut gloaming_session, Fault> {
    let mut sessions = lock()?;
    sessions.last += 1;
    let number = sessions.last;
    sessions.open.insert(number, Arc::new(session));
    Ok(std::ptr::without_provenance_mut(number))
}

pub(crate) fn find(session: *mut gloaming_session) -> Result<Arc<InSitu>, Fault> {
    lock()?.open.get(&session.addr()).cloned().ok_or_else(|| closed(session))
}

pub(crate) fn remove(session: *mut gloaming_session) -> Result<Arc<InSitu>, Fault> {
    lock()?.open.remove(&session.addr()).ok_or_else(|| closed(session))
}

fn closed(session: *mut gloaming_session) -> Fault {
    let why = if session.is_null() { "the session was not opened" } else { "the session was closed" };
    Error::Closed(why.into()).into()
}
