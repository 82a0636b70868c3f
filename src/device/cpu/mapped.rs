//! Files as memory: values that are in memory as far as somebody has looked at them, for the kernels that look anywhere.

use std::fs::File;
use std::sync::Arc;

use memmap2::MmapRaw;

use crate::device::{Buffer, Storage};

/// The values of a file that nobody else knows.
pub(crate) struct Mapped {
    map: Arc<MmapRaw>,
    len: usize,
}

impl Mapped {
    /// Of a file of `len` values. Every value has its place on the disk where they are written: no disk is full then.
    pub fn new(file: &File, len: usize) -> std::io::Result<Self> {
        let map = Arc::new(MmapRaw::map_raw(file)?);
        if map.len() < 4 * len {
            return Err(std::io::Error::new(std::io::ErrorKind::UnexpectedEof, "a file shorter than its values"));
        }
        Ok(Mapped { map, len })
    }

    /// As a buffer of the CPU.
    pub fn buffer(self) -> Buffer {
        Buffer(Storage::Mapped(self))
    }

    pub fn values(&self) -> &[f32] {
        // SAFETY: pages are aligned, `new` has asked for the length, and any bits are a number. The file has no name, so that this
        // process alone may change it, and does so through `&mut` of the store that owns file and map.
        unsafe { std::slice::from_raw_parts(self.map.as_ptr().cast(), self.len) }
    }

    pub fn values_mut(&mut self) -> &mut [f32] {
        // SAFETY: as above; clones of the map release pages and nothing else.
        unsafe { std::slice::from_raw_parts_mut(self.map.as_mut_ptr().cast(), self.len) }
    }

    /// Its pages.
    pub fn pages(&self) -> Pages {
        Pages(self.map.clone())
    }
}

/// What of a file is in this process's memory.
pub(crate) struct Pages(#[cfg_attr(not(target_os = "linux"), allow(dead_code))] Arc<MmapRaw>);

impl Pages {
    /// Gives all pages back to the system, which keeps their values in its file cache or writes them to the file.
    pub fn release(&self) {
        #[cfg(target_os = "linux")]
        // SAFETY: the map is of a file and shared, so that pages come back as they were when somebody looks at them. That the
        // system refuses costs memory and nothing else.
        let _ = unsafe { self.0.unchecked_advise(memmap2::UncheckedAdvice::DontNeed) };
    }
}
