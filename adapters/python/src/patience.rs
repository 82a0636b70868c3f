//! Waiting for long work without keeping Python from anything: other threads run, and Ctrl-C is answered.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::time::Duration;

use gloaming::{Error, Result};
use pyo3::prelude::*;

use crate::errors::raised;

/// How long a Ctrl-C may go unnoticed.
const NOTICE: Duration = Duration::from_millis(20);

/// Does `work` on a thread of its own. When a signal handler raises an exception, that is raised at once, and the work ends by
/// itself, unheard.
pub fn patiently<T: Send + 'static>(py: Python<'_>, work: impl FnOnce() -> Result<T> + Send + 'static) -> PyResult<T> {
    let (done, wait) = sync_channel(1);
    let run = move || {
        let result = catch_unwind(AssertUnwindSafe(work));
        // Nobody waits any more after a Ctrl-C.
        let _ = done.send(result.unwrap_or_else(|_| Err(Error::Bug("a panic; what it said is above".into()))));
    };
    std::thread::Builder::new()
        .name("gloaming".into())
        .spawn(run)
        .map_err(|e| raised(py, Error::Device(format!("cannot start a thread: {e}"))))?;
    // A receiver may not be shared between threads, and none does: the lock is for the compiler.
    let wait = std::sync::Mutex::new(wait);
    loop {
        let heard = py.detach(|| wait.lock().expect("only we lock it").recv_timeout(NOTICE));
        match heard {
            Ok(result) => return result.map_err(|e| raised(py, e)),
            Err(RecvTimeoutError::Timeout) => py.check_signals()?,
            Err(RecvTimeoutError::Disconnected) => return Err(raised(py, Error::Bug("the thread died".into()))),
        }
    }
}
