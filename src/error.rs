//! Errors, one variant for each party who can act on it.

use std::path::PathBuf;

/// What went wrong, by who can do something about it. A message names the file, dataset and step where there is
/// one, and the next thing to try.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system refused: a path, a permission, a full disk.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or directory concerned.
        path: PathBuf,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// A file is not what it should be, or needs a setting to be read.
    #[error("{}: {found}{}", path.display(), if remedy.is_empty() { String::new() } else { format!("\n  try: {remedy}") })]
    Format {
        /// The file (and `:/dataset` where there is one).
        path: PathBuf,
        /// What was found.
        found: String,
        /// The setting or command that would help; empty when there is none.
        remedy: String,
    },
    /// The scene file or a `--set` says something impossible.
    #[error("scene{}: {key}: {message}", line.map(|l| format!(", line {l}")).unwrap_or_default())]
    Scene {
        /// Line in the scene file, counted from 1.
        line: Option<usize>,
        /// Dotted key, such as `light.tolerance`.
        key: String,
        /// What is wrong and which values are allowed.
        message: String,
    },
    /// A combination of settings that this version does not do.
    #[error("not supported: {0}")]
    Unsupported(String),
    /// The working set does not fit.
    #[error("out of memory: {needed} bytes needed, {budget} allowed\n  try: --memory {}MiB or more", needed.div_ceil(1 << 20))]
    OutOfMemory {
        /// Bytes that the step needs.
        needed: u64,
        /// Bytes that the budget allows.
        budget: u64,
    },
    /// The compute device failed or does not exist.
    #[error("device: {0}")]
    Device(String),
    /// The other end of the pipeline is gone, or the session was closed.
    #[error("closed: {0}")]
    Closed(String),
    /// A fault of gloaming's own, or of a sink or device that it was given: a panic that was caught.
    #[error("a bug: {0}")]
    Bug(String),
}

/// Shorthand for results of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    /// An [`Error::Io`] about `path`.
    pub fn io(path: impl Into<PathBuf>, source: impl Into<std::io::Error>) -> Self {
        Error::Io { path: path.into(), source: source.into() }
    }

    /// An [`Error::Format`]: what was found in `path`, and what would help (may be empty).
    pub fn format(path: impl Into<PathBuf>, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Error::Format { path: path.into(), found: found.into(), remedy: remedy.into() }
    }

    /// An [`Error::Scene`] about `key`, without a line.
    pub fn scene(key: impl Into<String>, message: impl Into<String>) -> Self {
        Error::Scene { line: None, key: key.into(), message: message.into() }
    }
}

/// Runs something of which a panic is an [`Error::Bug`].
pub(crate) fn guarded<T>(run: impl FnOnce() -> Result<T>) -> Result<T> {
    let caught = std::panic::catch_unwind(std::panic::AssertUnwindSafe(run));
    caught.unwrap_or_else(|panic| Err(Error::Bug(panic_text(&*panic))))
}

/// What a panic says.
pub(crate) fn panic_text(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().copied().or_else(|| panic.downcast_ref::<String>().map(String::as_str));
    text.unwrap_or("a panic without words").into()
}
