//! Doors for the fuzz targets in `tests/fuzz`: parsers that are otherwise reached only through the file system.

use crate::sink::template::Template;
use crate::source::{expand, h5};

/// The pattern and the numbers in names: what is typed against one path.
pub fn pattern(typed: &str, path: &str) {
    expand::probe(typed, path);
}

/// A name of outputs, and what is derived from it.
pub fn template(text: &str, step: u64) {
    if let Ok(template) = Template::parse(text) {
        let _ = (template.path(step, text), template.folder(), template.without_step(), template.with("_{step}"));
    }
}

/// Decoders of HDF5 filters; `which` picks one.
pub fn filter(which: u8, length: u16, bytes: &[u8]) {
    h5::filters::probe(which, usize::from(length), bytes);
}
