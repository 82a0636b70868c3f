//! Volumes in a file that has no name: it is gone with the process, whatever ends it.

use std::fs::File;
use std::io::{ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, OnceLock, PoisonError};

use half::slice::{HalfBitsSliceExt, HalfFloatSliceExt};

use crate::device::cpu::mapped::Mapped;
use crate::device::{Buffer, RUN};
use crate::error::{Error, Result};
use crate::scene::ScratchKey;

/// Values that are written at once. The system keeps a file in pieces as they were written and maps a piece as a whole: of pieces
/// of a MiB all of a volume would be in memory sooner than anybody can look.
const PIECE: usize = 1 << 12;

/// Values in a file, as this machine has them in memory or half as long.
pub(super) struct Scratch {
    folder: PathBuf,
    file: Mutex<File>,
    len: usize,
    precision: ScratchKey,
    /// The file as memory, once somebody has asked for that.
    memory: OnceLock<Buffer>,
    /// True when the disk has a place for every value.
    reserved: bool,
}

impl Scratch {
    /// Makes room in `folder`; what is not written reads as 0.
    pub fn new(folder: &Path, len: usize, precision: ScratchKey) -> Result<Self> {
        let file = tempfile::tempfile_in(folder).map_err(|e| explained(folder, e))?;
        file.set_len(precision.bytes() * len as u64).map_err(|e| explained(folder, e))?;
        let (folder, file) = (folder.into(), Mutex::new(file));
        Ok(Scratch { folder, file, len, precision, memory: OnceLock::new(), reserved: false })
    }

    /// Reads values from number `at` on.
    pub fn read(&self, at: usize, out: &mut [f32]) -> Result<()> {
        self.with(|file| {
            file.seek(SeekFrom::Start(self.precision.bytes() * at as u64))?;
            match self.precision {
                ScratchKey::F32 => file.read_exact(bytemuck::cast_slice_mut(out)),
                ScratchKey::F16 => {
                    let mut halves = vec![0u16; RUN.min(out.len())];
                    for out in out.chunks_mut(RUN) {
                        let halves = &mut halves[..out.len()];
                        file.read_exact(bytemuck::cast_slice_mut(halves))?;
                        halves.reinterpret_cast::<half::f16>().convert_to_f32_slice(out);
                    }
                    Ok(())
                }
            }
        })
    }

    /// Writes values from number `at` on.
    pub fn write(&self, at: usize, values: &[f32]) -> Result<()> {
        self.with(|file| {
            file.seek(SeekFrom::Start(self.precision.bytes() * at as u64))?;
            match self.precision {
                ScratchKey::F32 => values.chunks(PIECE).try_for_each(|v| file.write_all(bytemuck::cast_slice(v))),
                ScratchKey::F16 => {
                    let mut halves = vec![0u16; RUN.min(values.len())];
                    for values in values.chunks(RUN) {
                        let halves = &mut halves[..values.len()];
                        halves.reinterpret_cast_mut::<half::f16>().convert_from_f32_slice(values);
                        file.write_all(bytemuck::cast_slice(halves))?;
                    }
                    Ok(())
                }
            }
        })
    }

    /// True where the file holds values as memory does.
    pub fn plain(&self) -> bool {
        self.precision == ScratchKey::F32
    }

    /// The values as memory of the host, where the file holds them so.
    pub fn memory(&self) -> Result<&Buffer> {
        if let Some(memory) = self.memory.get() {
            return Ok(memory);
        }
        let mapped = Mapped::new(&self.file.lock().unwrap_or_else(PoisonError::into_inner), self.len);
        let mapped = mapped.map_err(|e| explained(&self.folder, e))?;
        Ok(self.memory.get_or_init(|| mapped.buffer()))
    }

    /// The same to be written to.
    pub fn memory_mut(&mut self) -> Result<&mut Buffer> {
        self.reserve()?;
        self.memory()?;
        Ok(self.memory.get_mut().expect("just made"))
    }

    /// Gives every value its place: a disk that is full is an error here, and would be the end of the process where memory is
    /// written to.
    fn reserve(&mut self) -> Result<()> {
        #[cfg(target_os = "linux")]
        {
            let file = self.file.get_mut().unwrap_or_else(PoisonError::into_inner);
            let how = rustix::fs::FallocateFlags::empty();
            self.reserved |= rustix::fs::fallocate(&*file, how, 0, 4 * self.len as u64).is_ok();
        }
        if !self.reserved {
            let mut values = vec![0.0; RUN.min(self.len)];
            for at in (0..self.len).step_by(RUN) {
                let values = &mut values[..RUN.min(self.len - at)];
                self.read(at, values)?;
                self.write(at, values)?;
            }
            self.reserved = true;
        }
        Ok(())
    }

    fn with(&self, act: impl FnOnce(&mut File) -> std::io::Result<()>) -> Result<()> {
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        act(&mut file).map_err(|e| explained(&self.folder, e))
    }
}

impl ScratchKey {
    fn bytes(self) -> u64 {
        match self {
            ScratchKey::F32 => 4,
            ScratchKey::F16 => 2,
        }
    }
}

/// An error of the scratch file, with what to do about it.
fn explained(folder: &Path, e: std::io::Error) -> Error {
    let kind = e.kind();
    if matches!(kind, ErrorKind::StorageFull | ErrorKind::QuotaExceeded | ErrorKind::FileTooLarge) {
        let text = format!(
            "no room left for light that does not fit in memory ({e})\n  try: TMPDIR=FOLDER on a larger disk, or more --memory"
        );
        return Error::io(folder, std::io::Error::new(kind, text));
    }
    Error::io(folder, e)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_come_back_and_nothing_is_left_behind() {
        let folder = tempfile::tempdir().unwrap();
        let scratch = Scratch::new(folder.path(), 100, ScratchKey::F32).unwrap();
        scratch.write(40, &[1.5, -2.0]).unwrap();
        let mut out = [9.0; 4];
        scratch.read(39, &mut out).unwrap();
        assert_eq!(out, [0.0, 1.5, -2.0, 0.0]);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "the file has no name");
        assert!(scratch.read(99, &mut out).is_err());
    }

    #[test]
    fn halves_take_half_the_room_and_are_off_by_one_rounding() {
        let folder = tempfile::tempdir().unwrap();
        let len = 2 * RUN + 9;
        let scratch = Scratch::new(folder.path(), len, ScratchKey::F16).unwrap();
        let values: Vec<f32> = (0..len).map(|i| (-0.001 * i as f32).exp()).collect();
        scratch.write(0, &values).unwrap();
        let mut out = vec![0.0; len];
        scratch.read(0, &mut out).unwrap();
        let near = |a: f32, b: f32| (a - b).abs() <= a * 2f32.powi(-11) + 2f32.powi(-25);
        assert!(values.iter().zip(&out).all(|(a, b)| near(*a, *b)) && values != out && !scratch.plain());
        let mut part = [0.0; 3];
        scratch.read(RUN - 1, &mut part).unwrap();
        assert_eq!(part, out[RUN - 1..RUN + 2]);
        assert_eq!(scratch.file.lock().unwrap().metadata().unwrap().len(), 2 * len as u64);
    }

    #[test]
    fn memory_and_file_are_the_same() {
        let folder = tempfile::tempdir().unwrap();
        let mut scratch = Scratch::new(folder.path(), 3000, ScratchKey::F32).unwrap();
        scratch.write(2000, &[1.5, -2.0]).unwrap();
        assert_eq!(scratch.memory().unwrap().host().unwrap()[1999..2003], [0.0, 1.5, -2.0, 0.0]);
        scratch.write(2002, &[7.0]).unwrap();
        assert_eq!(scratch.memory().unwrap().host().unwrap()[2002], 7.0);
        let Buffer(crate::device::Storage::Mapped(mapped)) = scratch.memory_mut().unwrap() else { panic!("a map") };
        mapped.values_mut()[2999] = 4.0;
        mapped.pages().release();
        assert_eq!(mapped.values()[2999], 4.0);
        let mut out = [9.0; 2];
        scratch.read(2998, &mut out).unwrap();
        assert_eq!(out, [0.0, 4.0]);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "the file has no name");
    }

    #[test]
    fn a_full_disk_is_an_error_that_says_what_to_do() {
        let full = std::io::Error::from(ErrorKind::StorageFull);
        let message = explained(Path::new("/somewhere"), full).to_string();
        assert!(message.contains("/somewhere") && message.contains("TMPDIR"), "{message}");
        let message =
            Scratch::new(Path::new("/no/such/folder"), 1, ScratchKey::F32).err().expect("no folder").to_string();
        assert!(message.contains("/no/such/folder"), "{message}");
    }
}
