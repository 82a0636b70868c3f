//! Open sessions by number. A handle is such a number dressed as a pointer, never looked behind, so that one that was closed
//! is refused rather than followed.

use std::collections::BTreeMap;
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

fn lock() -> MutexGuard<'static, Sessions> {
    SESSIONS.lock().unwrap_or_else(PoisonError::into_inner)
}

pub(crate) fn add(session: InSitu) -> *mut gloaming_session {
    let mut sessions = lock();
    sessions.last += 1;
    let number = sessions.last;
    sessions.open.insert(number, Arc::new(session));
    std::ptr::without_provenance_mut(number)
}

pub(crate) fn find(session: *mut gloaming_session) -> Result<Arc<InSitu>, Fault> {
    lock().open.get(&session.addr()).cloned().ok_or_else(|| closed(session))
}

pub(crate) fn remove(session: *mut gloaming_session) -> Result<Arc<InSitu>, Fault> {
    lock().open.remove(&session.addr()).ok_or_else(|| closed(session))
}

fn closed(session: *mut gloaming_session) -> Fault {
    let why = if session.is_null() { "the session was not opened" } else { "the session was closed" };
    Error::Closed(why.into()).into()
}
