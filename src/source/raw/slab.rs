//! Part of a file, or of bytes decoded from one, as a field.
//!
//! Values are read with positioned reads, not from a memory map: a file that shrinks while it is mapped ends the
//! process, one that is read ends in an error.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use super::Dtype;
use crate::error::{Error, Result};
use crate::field::Field;
use crate::grid::Region;
use crate::source::{file_problem, shape_text};

/// Where bytes come from: a file, read where they lie, or something decoded from one (compressed, text).
#[derive(Clone)]
pub(crate) enum Bytes {
    File(PathBuf),
    Decoded(PathBuf, Arc<dyn Fn() -> Result<Vec<u8>> + Send + Sync>),
}

impl Bytes {
    /// The file, for messages.
    pub fn path(&self) -> &Path {
        match self {
            Bytes::File(path) | Bytes::Decoded(path, _) => path,
        }
    }
}

/// An array of three axes inside a file.
#[derive(Clone)]
pub(crate) struct Slab {
    pub bytes: Bytes,
    /// Byte at which value (0, 0, 0) is.
    pub offset: u64,
    pub dtype: Dtype,
    /// Numbers from one value to the next along x, y, z.
    pub strides: [usize; 3],
    pub size: [usize; 3],
}

impl Slab {
    /// Byte after the last number.
    fn end(&self) -> Option<u64> {
        let last = (0..3).try_fold(0u64, |at, a| {
            (self.size[a] as u64).checked_sub(1)?.checked_mul(self.strides[a] as u64)?.checked_add(at)
        })?;
        last.checked_add(1)?.checked_mul(self.dtype.bytes() as u64)?.checked_add(self.offset)
    }

    /// Opens the file and checks that it is long enough.
    pub fn open(&self, size: [usize; 3]) -> Result<RawField> {
        let path = self.bytes.path();
        if size != self.size {
            let found = format!("the grid changes from {} to {}", shape_text(&size), shape_text(&self.size));
            return Err(Error::format(path, found, "--steps A..B for the steps that agree"));
        }
        let (held, length) = match &self.bytes {
            Bytes::Decoded(_, decode) => {
                let bytes = decode()?;
                let length = bytes.len() as u64;
                (Held::Memory(bytes), length)
            }
            Bytes::File(path) => {
                if let Some(problem) = file_problem(path) {
                    return Err(problem);
                }
                let file = File::open(path).map_err(|e| Error::io(path, e))?;
                let length = file.metadata().map_err(|e| Error::io(path, e))?.len();
                (Held::File(Mutex::new(file)), length)
            }
        };
        let end = self.end().unwrap_or(u64::MAX);
        if end > length {
            let found = format!("this step ends at byte {end}, but there are {length} bytes");
            return Err(Error::format(path, found, "the complete file, or other dims, dtype, offset or steps"));
        }
        Ok(RawField { slab: self.clone(), held })
    }
}

/// An open [`Slab`].
pub(crate) struct RawField {
    slab: Slab,
    held: Held,
}

/// Bytes that are open.
enum Held {
    File(Mutex<File>),
    Memory(Vec<u8>),
}

impl RawField {
    fn bytes(&self, from: u64, length: usize, buffer: &mut Vec<u8>) -> Result<()> {
        match &self.held {
            Held::Memory(all) => {
                buffer.clear();
                buffer.extend_from_slice(&all[from as usize..from as usize + length]);
                Ok(())
            }
            Held::File(file) => {
                buffer.resize(length, 0);
                let mut file = file.lock().unwrap_or_else(|e| e.into_inner());
                let read = file.seek(SeekFrom::Start(from)).and_then(|_| file.read_exact(buffer));
                read.map_err(|e| Error::io(self.slab.bytes.path(), e))
            }
        }
    }

    /// Reads one plane across the slowest axis at a time: all that the region needs of it in one piece.
    fn read_as<T: Copy>(&self, region: Region, out: &mut [T], narrow: impl Fn(f64) -> T) -> Result<()> {
        let Slab { strides, dtype, offset, .. } = &self.slab;
        let number = dtype.bytes();
        let slowest = (0..3).max_by_key(|&a| strides[a]).unwrap_or(2);
        let [inner, outer] = match slowest {
            2 => [0, 1],
            1 => [0, 2],
            _ => [1, 2],
        };
        let (mut buffer, mut row) = (Vec::new(), vec![narrow(0.0); region.size[inner]]);
        let along = |a: usize, n: usize| n * strides[a];
        let span = along(inner, region.size[inner] - 1) + along(outer, region.size[outer] - 1) + 1;
        let [nx, ny, _] = region.size;
        let steps = [1, nx, nx * ny];
        for s in 0..region.size[slowest] {
            let first = along(slowest, region.start[slowest] + s)
                + along(inner, region.start[inner])
                + along(outer, region.start[outer]);
            self.bytes(offset + (first * number) as u64, span * number, &mut buffer)?;
            for o in 0..region.size[outer] {
                dtype.decode(&buffer, along(outer, o) * number, (strides[inner] * number) as isize, &mut row, &narrow);
                let at = s * steps[slowest] + o * steps[outer];
                for (i, value) in row.iter().enumerate() {
                    out[at + i * steps[inner]] = *value;
                }
            }
        }
        Ok(())
    }
}

impl Field for RawField {
    fn read(&self, region: Region, out: &mut [f32]) -> Result<()> {
        if region.is_empty() { Ok(()) } else { self.read_as(region, out, |v| v as f32) }
    }

    fn read_f64(&self, region: Region, out: &mut [f64]) -> Result<()> {
        if region.is_empty() { Ok(()) } else { self.read_as(region, out, |v| v) }
    }
}
