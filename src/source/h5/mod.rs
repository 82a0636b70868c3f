//! HDF5: opening files and datasets with errors that say what to do, and telling layouts apart.

mod attributes;
mod generic;
mod slab;
mod tree;

use std::path::Path;

use hdf5::{Dataset, File};

use super::expand::Files;
use super::series::Plan;
use super::{SourceSpec, file_problem};
use crate::error::{Error, Result};

pub(crate) use slab::{Opened, Slab};

/// Finds out which layout the files have, and what is in them.
pub(crate) fn plan(files: &Files, spec: &SourceSpec) -> Result<Plan> {
    generic::plan(files, spec)
}

/// Opens a file for reading. `cache` bytes of decoded chunks are kept for each dataset.
pub(crate) fn open_file(path: &Path, cache: usize) -> Result<File> {
    if let Some(problem) = file_problem(path) {
        return Err(problem);
    }
    // 12421 slots: a prime some hundred times the chunks that a cache holds, as the HDF5 manual asks.
    let open = |swmr: bool| {
        let mut options = File::with_options();
        options.with_fapl(|p| p.chunk_cache(12421, cache.max(1 << 20), 0.75));
        options.open_as(path, if swmr { hdf5::OpenMode::ReadSWMR } else { hdf5::OpenMode::Read })
    };
    open(false).or_else(|why| open(true).map_err(|_| why)).map_err(|e| open_error(path, &e))
}

/// What kept HDF5 from opening a file, in words.
fn open_error(path: &Path, e: &hdf5::Error) -> Error {
    let text = e.to_string();
    if let Err(io) = std::fs::File::open(path) {
        return Error::io(path, io);
    }
    let (found, remedy) = if text.contains("lock file")
        || text.contains("unable to lock")
        || text.contains("errno = 11")
    {
        ("another program is writing this file", "HDF5_USE_FILE_LOCKING=FALSE, or after the writer has closed it")
    } else if text.contains("truncated file") {
        ("truncated HDF5: the file is shorter than its header says", "the complete file; it may still be being copied")
    } else if text.contains("signature") {
        ("not HDF5: no HDF5 signature", "a raw file needs --raw 'dims=…,dtype=…'")
    } else {
        ("HDF5 cannot open this file", "h5dump -H FILE shows whether it is damaged")
    };
    Error::format(path, format!("{found} ({text})"), remedy)
}

/// Opens a dataset; a link that leads nowhere is told apart from a name that does not exist.
pub(crate) fn open_dataset(file: &File, path: &Path, dataset: &str) -> Result<Dataset> {
    file.dataset(dataset).map_err(|e| {
        let name = format!("{}:{dataset}", path.display());
        let dangling = file.loc_type_by_name(dataset).is_err() && link_exists(file, dataset);
        if dangling {
            let found = "the link leads nowhere: the file or object it points to is missing";
            return Error::format(name, found, "the file that an external link names, beside this one");
        }
        if file.group(dataset).is_ok() {
            return Error::format(name, "is a group, not a dataset", "gloaming info lists the datasets");
        }
        Error::format(name, format!("no such dataset, or a damaged one ({e})"), "gloaming info lists the datasets")
    })
}

fn link_exists(file: &File, dataset: &str) -> bool {
    let (group, leaf) = dataset.rsplit_once('/').unwrap_or(("", dataset));
    let group = if group.is_empty() { "/" } else { group };
    file.group(group).is_ok_and(|g| g.link_exists(leaf))
}
