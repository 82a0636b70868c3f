//! Files that appear under their final name only when they are whole.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use tempfile::{NamedTempFile, TempPath};

use crate::error::{Error, Result};

/// Writes a file through `fill` under a temporary name beside `path`, then renames it. After an error nothing is left.
pub(crate) fn write_whole(path: &Path, fill: impl FnOnce(&mut BufWriter<&mut File>) -> Result<()>) -> Result<()> {
    let failed = |e: std::io::Error| Error::io(path, e);
    let folder = folder_of(path);
    std::fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, e))?;
    let mut temporary = temporary_in(&folder).map_err(failed)?;
    let mut writer = BufWriter::with_capacity(1 << 20, temporary.as_file_mut());
    fill(&mut writer)?;
    writer.flush().map_err(failed)?;
    drop(writer);
    temporary.persist(path).map_err(|e| failed(e.error))?;
    Ok(())
}

/// The name of a file beside `path` that a library may fill and that then takes its name; it is gone if it does not.
pub(crate) fn temporary_beside(path: &Path) -> Result<TempPath> {
    let folder = folder_of(path);
    let made = std::fs::create_dir_all(&folder).and_then(|()| temporary_in(&folder));
    Ok(made.map_err(|e| Error::io(folder, e))?.into_temp_path())
}

/// Creates a folder, and finds out now rather than after the first step's work whether files can be made in it.
pub(crate) fn writable_folder(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder).and_then(|()| temporary_in(folder)).map_err(|e| Error::io(folder, e))?;
    Ok(())
}

/// The folder of a file.
pub(crate) fn folder_of(path: &Path) -> PathBuf {
    match path.parent() {
        Some(p) if !p.as_os_str().is_empty() => p.to_path_buf(),
        _ => ".".into(),
    }
}

/// The name under which a file grows that takes all steps: `light.vtkhdf` grows as `light.partial.vtkhdf`, which the
/// usual programs open too, should the run be killed.
pub(crate) fn partial_name(path: &Path) -> PathBuf {
    let extension = path.extension().unwrap_or_default().to_string_lossy();
    path.with_extension(format!("partial.{extension}"))
}

/// Sets `bytes` aside from byte `end` of a file, so that a full disk is found before a format's own library is half-way
/// through changing it. File systems that cannot do so are taken at their word.
pub(crate) fn reserve(path: &Path, end: u64, bytes: u64) -> Result<()> {
    #[cfg(target_os = "linux")]
    {
        use rustix::fs::{FallocateFlags, fallocate};
        use rustix::io::Errno;
        let file = File::options().write(true).open(path).map_err(|e| Error::io(path, e))?;
        if let Err(e @ (Errno::NOSPC | Errno::DQUOT | Errno::FBIG)) =
            fallocate(&file, FallocateFlags::empty(), end, bytes)
        {
            return Err(Error::io(path, e));
        }
    }
    Ok(())
}

fn temporary_in(folder: &Path) -> std::io::Result<NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(".gloaming-");
    // Others may read what is written, as far as the umask lets them; the default is the owner alone.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder.tempfile_in(folder)
}
