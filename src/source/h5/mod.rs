//! HDF5: telling layouts apart, and opening files and datasets with errors that say what to do.
//!
//! A layout is one file here and one arm in [`plan`]: it turns what is in the files into steps, each of which names
//! its place in them.

mod athena;
mod attributes;
mod blocks;
mod chombo;
mod chunks;
mod conventions;
pub(crate) mod filters;
mod flash;
mod flat;
mod gdf;
mod generic;
mod netcdf;
mod openpmd;
mod slab;
mod stored;
mod tree;
mod vtkhdf;

use std::path::{Path, PathBuf};

use hdf5::{Dataset, File};

use super::expand::{Entry, Files};
use super::series::Plan;
use super::{SourceSpec, file_problem};
use crate::error::{Error, Result};

pub(crate) use attributes::numbers_in;
pub(crate) use flat::Flat;
pub(crate) use slab::{Opened, Packing, Slab};
pub(crate) use tree::type_name;

/// What a layout starts from: the files, and the first of them that opens.
pub(crate) struct Input<'a> {
    pub files: &'a Files,
    pub spec: &'a SourceSpec,
    pub file: File,
    pub entry: &'a Entry,
    pub warnings: Vec<String>,
}

impl<'a> Input<'a> {
    /// Finds the first file that opens; that others before it do not is a warning unless none does.
    fn new(files: &'a Files, spec: &'a SourceSpec) -> Result<Input<'a>> {
        let (mut reason, mut warnings) = (None, Vec::new());
        for entry in &files.entries {
            match open_file(&entry.path, 0) {
                Ok(file) => return Ok(Input { files, spec, file, entry, warnings }),
                Err(why) => reason = reason.or(Some(why)),
            }
            warnings.push(unreadable(entry));
        }
        Err(reason.unwrap_or_else(|| Error::format("", "no files", "a file, a folder or a pattern")))
    }

    fn paths(&self) -> Vec<PathBuf> {
        self.files.entries.iter().map(|e| e.path.clone()).collect()
    }
}

fn unreadable(entry: &Entry) -> String {
    format!("{}: cannot be opened; its step will fail", entry.path.display())
}

/// The field that was asked for, by `FILE:/dataset` or by name.
fn asked<'a>(files: &'a Files, spec: &'a SourceSpec) -> Option<&'a str> {
    files.dataset.as_deref().or(spec.field.as_deref())
}

/// Opens one file of the series; one that does not open is a warning, and its step will fail.
fn reopen(entry: &Entry, first: &Entry, file: &File, warnings: &mut Vec<String>) -> Option<File> {
    if entry.path == first.path {
        return Some(file.clone());
    }
    let opened = open_file(&entry.path, 0).ok();
    if opened.is_none() && !warnings.contains(&unreadable(entry)) {
        warnings.push(unreadable(entry));
    }
    opened
}

/// Finds out which layout the files have, and what is in them. A dataset that is named outright and that the layout
/// does not list is read as it stands.
pub(crate) fn plan(files: &Files, spec: &SourceSpec) -> Result<Plan> {
    let input = Input::new(files, spec)?;
    let (layout, mark) = layout(&input.file);
    let found = match layout {
        Layout::Generic => {
            let (convention, mark) = conventions::of(&input.file, input.entry)?;
            return marked(generic::plan(input, convention), mark);
        }
        Layout::Athena => athena::plan(input),
        Layout::Chombo => chombo::plan(input),
        Layout::Enzo => super::enzo::plan(files, spec),
        Layout::Flash => flash::plan(input),
        Layout::Gdf => gdf::plan(input),
        Layout::Vtkhdf => vtkhdf::plan(input),
        Layout::OpenPmd => openpmd::plan(input),
        Layout::Netcdf => netcdf::plan(input),
    };
    match found {
        Err(why) if files.dataset.is_some() => {
            let outright = generic::plan(Input::new(files, spec)?, &conventions::NONE).map_err(|_| why);
            marked(outright, "the dataset was named outright")
        }
        other => marked(other, mark),
    }
}

fn marked(plan: Result<Plan>, mark: &str) -> Result<Plan> {
    plan.map(|mut plan| {
        plan.info.why.splice(0..0, ["HDF5 signature".to_owned(), mark.to_owned()]);
        plan
    })
}

/// Layouts of HDF5 files.
enum Layout {
    Generic,
    Athena,
    Chombo,
    Enzo,
    Flash,
    Gdf,
    Vtkhdf,
    OpenPmd,
    Netcdf,
}

/// The layout whose marks a file bears, and which those are.
fn layout(file: &File) -> (Layout, &'static str) {
    let marked = |name: &str| file.attr(name).is_ok();
    if file.link_exists("VTKHDF") {
        (Layout::Vtkhdf, "group /VTKHDF")
    } else if marked("openPMD") && marked("basePath") {
        (Layout::OpenPmd, "root attributes openPMD and basePath")
    } else if marked("NumMeshBlocks") && marked("RootGridSize") {
        (Layout::Athena, "root attributes NumMeshBlocks and RootGridSize")
    } else if flash::is(file) {
        (Layout::Flash, "datasets /bounding box and /unknown names")
    } else if chombo::is(file) {
        (Layout::Chombo, "groups /level_0 and /Chombo_global")
    } else if gdf::is(file) {
        (Layout::Gdf, "group /gridded_data_format and dataset /grid_left_index")
    } else if file.link_exists("Grid00000001") {
        (Layout::Enzo, "group /Grid00000001")
    } else if marked("_NCProperties") {
        (Layout::Netcdf, "root attribute _NCProperties")
    } else if netcdf::has_scales(file) {
        (Layout::Netcdf, "dimension scales")
    } else {
        (Layout::Generic, "")
    }
}

/// Opens a file for reading. `cache` bytes of decoded chunks are kept for each dataset.
pub(crate) fn open_file(path: &Path, cache: usize) -> Result<File> {
    if let Some(problem) = file_problem(path) {
        return Err(problem);
    }
    // 12421 slots: a prime some hundred times the chunks that a cache holds, as the HDF5 manual asks.
    let open = |swmr: bool| {
        let mut options = File::with_options();
        options.with_fapl(|p| p.chunk_cache(12421, cache, 0.75));
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
