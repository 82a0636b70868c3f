//! Volumes in a file that has no name: it is gone with the process, whatever ends it.

use std::fs::File;
use std::io::{ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use crate::error::{Error, Result};

/// Values in a file, as this machine has them in memory.
pub(super) struct Scratch {
    folder: PathBuf,
    file: Mutex<File>,
}

impl Scratch {
    /// Makes room in `folder`; what is not written reads as 0.
    pub fn new(folder: &Path, len: usize) -> Result<Self> {
        let file = tempfile::tempfile_in(folder).map_err(|e| explained(folder, e))?;
        file.set_len(4 * len as u64).map_err(|e| explained(folder, e))?;
        Ok(Scratch { folder: folder.into(), file: Mutex::new(file) })
    }

    /// Reads values from number `at` on.
    pub fn read(&self, at: usize, out: &mut [f32]) -> Result<()> {
        self.with(|file| {
            file.seek(SeekFrom::Start(4 * at as u64))?;
            file.read_exact(bytemuck::cast_slice_mut(out))
        })
    }

    /// Writes values from number `at` on.
    pub fn write(&self, at: usize, values: &[f32]) -> Result<()> {
        self.with(|file| {
            file.seek(SeekFrom::Start(4 * at as u64))?;
            file.write_all(bytemuck::cast_slice(values))
        })
    }

    fn with(&self, act: impl FnOnce(&mut File) -> std::io::Result<()>) -> Result<()> {
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        act(&mut file).map_err(|e| explained(&self.folder, e))
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
        let scratch = Scratch::new(folder.path(), 100).unwrap();
        scratch.write(40, &[1.5, -2.0]).unwrap();
        let mut out = [9.0; 4];
        scratch.read(39, &mut out).unwrap();
        assert_eq!(out, [0.0, 1.5, -2.0, 0.0]);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "the file has no name");
        assert!(scratch.read(99, &mut out).is_err());
    }

    #[test]
    fn a_full_disk_is_an_error_that_says_what_to_do() {
        let full = std::io::Error::from(ErrorKind::StorageFull);
        let message = explained(Path::new("/somewhere"), full).to_string();
        assert!(message.contains("/somewhere") && message.contains("TMPDIR"), "{message}");
        let message = Scratch::new(Path::new("/no/such/folder"), 1).err().expect("no folder").to_string();
        assert!(message.contains("/no/such/folder"), "{message}");
    }
}
