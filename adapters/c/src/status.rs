//! Codes, and errors in the caller's structure.

use std::ffi::c_char;
use std::panic::{AssertUnwindSafe, catch_unwind};

use gloaming::Error;
use gloaming::device::cpu::float::DefaultFloat;

use super::Taken;

/// Done.
pub const GLOAMING_OK: i32 = 0;
/// No trigger asked for the step: not an error.
pub const GLOAMING_SKIPPED: i32 = -1;
/// The queue was full, and the policy dropped the step: counted, and in the ledger.
pub const GLOAMING_DROPPED: i32 = -2;
/// The operating system refused: a path, a permission, a full disk.
pub const GLOAMING_IO: i32 = 1;
/// A file is not what it should be, or needs a setting.
pub const GLOAMING_FORMAT: i32 = 2;
/// The configuration says something impossible: key, line and allowed values are in the message.
pub const GLOAMING_SCENE: i32 = 3;
/// Not supported, or a block that cannot be read.
pub const GLOAMING_UNSUPPORTED: i32 = 4;
/// Too little memory.
pub const GLOAMING_OUT_OF_MEMORY: i32 = 5;
/// The compute device failed or does not exist.
pub const GLOAMING_DEVICE: i32 = 6;
/// The session is closed, or was never opened.
pub const GLOAMING_CLOSED: i32 = 7;
/// A fault of gloaming's own.
pub const GLOAMING_BUG: i32 = 8;
/// A pointer that must not be NULL is, or text is not UTF-8.
pub const GLOAMING_ARGUMENT: i32 = 9;
/// An error of a kind that this version has no code for.
pub const GLOAMING_OTHER: i32 = 99;

/// What went wrong, in the caller's memory.
#[repr(C)]
pub struct gloaming_error {
    /// As the function returned it.
    pub code: i32,
    /// What happened and what to try, UTF-8, ends in 0, cut off where it is longer; empty where nothing went wrong.
    pub message: [c_char; 1020],
}

impl Default for gloaming_error {
    fn default() -> Self {
        gloaming_error { code: GLOAMING_OK, message: [0; 1020] }
    }
}

impl gloaming_error {
    pub(crate) fn text(&self) -> String {
        let bytes: Vec<u8> = self.message.iter().take_while(|c| **c != 0).map(|c| *c as u8).collect();
        String::from_utf8_lossy(&bytes).into_owned()
    }

    fn fill(&mut self, code: i32, message: &str) {
        self.code = code;
        let mut end = message.len().min(self.message.len() - 1);
        while !message.is_char_boundary(end) {
            end -= 1;
        }
        self.message.fill(0);
        self.message.iter_mut().zip(&message.as_bytes()[..end]).for_each(|(to, from)| *to = *from as c_char);
    }
}

/// An error with its code.
pub(crate) struct Fault {
    code: i32,
    message: String,
}

impl Fault {
    pub fn argument(what: &str) -> Self {
        Fault { code: GLOAMING_ARGUMENT, message: what.into() }
    }
}

impl From<Error> for Fault {
    fn from(e: Error) -> Self {
        let code = match &e {
            Error::Io { .. } => GLOAMING_IO,
            Error::Format { .. } => GLOAMING_FORMAT,
            Error::Scene { .. } => GLOAMING_SCENE,
            Error::Unsupported(_) => GLOAMING_UNSUPPORTED,
            Error::OutOfMemory { .. } => GLOAMING_OUT_OF_MEMORY,
            Error::Device(_) => GLOAMING_DEVICE,
            Error::Closed(_) => GLOAMING_CLOSED,
            Error::Bug(_) => GLOAMING_BUG,
            _ => GLOAMING_OTHER,
        };
        Fault { code, message: e.to_string() }
    }
}

pub(crate) fn taken(taken: Taken) -> i32 {
    match taken {
        Taken::Queued => GLOAMING_OK,
        Taken::Dropped => GLOAMING_DROPPED,
        Taken::Skipped => GLOAMING_SKIPPED,
    }
}

/// Runs a call from outside: with the default floating-point environment, and no panic gets out.
///
/// # Safety
/// `error` is NULL or points to a gloaming_error.
pub(crate) unsafe fn guarded(error: *mut gloaming_error, run: impl FnOnce() -> Result<i32, Fault>) -> i32 {
    let _float = DefaultFloat::enter();
    let done = catch_unwind(AssertUnwindSafe(run)).unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<&str>().copied().unwrap_or("a panic");
        Err(Fault { code: GLOAMING_BUG, message: format!("a bug: {text}") })
    });
    let (code, message) = match &done {
        Ok(code) => (*code, ""),
        Err(fault) => (fault.code, &fault.message[..]),
    };
    // SAFETY: as the caller promises.
    if let Some(error) = unsafe { error.as_mut() } {
        error.fill(code, message);
    }
    code
}
