//! Errors as Python exceptions, one class for each variant; the classes are Python's, in `gloaming/errors.py`.

use gloaming::Error;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// The exception for an error.
pub fn raised(py: Python<'_>, error: Error) -> PyErr {
    exception(py, error).unwrap_or_else(|failed| failed)
}

fn exception(py: Python<'_>, error: Error) -> PyResult<PyErr> {
    let text = error.to_string();
    let fields = PyDict::new(py);
    let name = match error {
        Error::Io { path, source } => {
            fields.set_item("errno", source.raw_os_error())?;
            fields.set_item("path", path)?;
            "IoError"
        }
        Error::Format { path, found, remedy } => {
            fields.set_item("path", path)?;
            fields.set_item("found", found)?;
            fields.set_item("remedy", remedy)?;
            "FormatError"
        }
        Error::Scene { line, key, message } => {
            fields.set_item("line", line)?;
            fields.set_item("key", key)?;
            fields.set_item("reason", message)?;
            "SceneError"
        }
        Error::OutOfMemory { needed, budget } => {
            fields.set_item("needed", needed)?;
            fields.set_item("budget", budget)?;
            "OutOfMemoryError"
        }
        Error::Unsupported(_) => "UnsupportedError",
        Error::Device(_) => "DeviceError",
        Error::Closed(_) => "ClosedError",
        Error::Bug(_) => "BugError",
        _ => "GloamingError",
    };
    let class = py.import("gloaming.errors")?.getattr(name)?;
    Ok(PyErr::from_value(class.call((text,), Some(&fields))?))
}
