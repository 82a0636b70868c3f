//! Sources: series of timesteps from files. A layout is one file here and one `match` arm.
//!
//! [`open`] expands what was typed to files in step order, tells the kind of file by its first bytes and asks the
//! layout for a plan: every step's number, time and place in the files, from metadata alone. A step is opened, and its
//! values read, only when it is asked for.
//!
//! Steps are numbered by the number in the file's name, the number of the group or dataset, or else from 0. With
//! `--time-step DT` the time of step `n` is `n·DT`, whatever the file says.
//!
//! | layout | read | told by |
//! | --- | --- | --- |
//! | generic HDF5 | a file a step, numbered groups or datasets, or one dataset with a time axis; any axis order, integers and floats of either byte order, vectors | attributes or 1-D datasets `time`, `spacing`, `origin`, `axes`, `x`, `y`, `z`; else `--axes`, `--spacing`, … |
//! | VTKHDF | ImageData, points and cells, temporal | group `/VTKHDF` |
//! | openPMD 1.x | group- and file-based, vectors, constant components; values as stored | root attribute `openPMD` |
//! | netCDF-4 / CF | dimension scales, bounds, packed and fill values; not netCDF-3 | `_NCProperties`, dimension scales |
//! | FLASH, Athena++ | mesh blocks | `bounding box`; `NumMeshBlocks` |
//! | Chombo, AMReX in HDF5 | boxes, ghost cells, all components in one dataset or one each | `level_0` and `Chombo_global` |
//! | Enzo | packed and single files, by folder, parameter file, `.hierarchy` or `.cpu0000` | `TopGridDimensions`, `Grid00000001` |
//! | Grid Data Format | grids on cells, both orders | `gridded_data_format` |
//! | Cholla, Dedalus, Meep, JHTDB, ADIOS2 in HDF5 | one file or one group a step | root attributes; `/tasks`; a time in the file's name; `xcoor`; `NumSteps` |
//! | XDMF | uniform and rectilinear grids over HDF5 (hyperslabs too) and raw files | `<Xdmf` |
//! | VTK `.vti`, `.vtr`, `.vtk`, `.pvd` | images and rectilinear grids in every coding but LZ4 and LZMA | their first bytes |
//! | NRRD, MetaImage | raw, gzip or zlib, text; in one file or two | their first bytes |
//! | raw | anything uniform: `dims` (along x, y, z), `dtype` (`f64le`, `u8`, …), `offset`, `order` (slowest first), `steps`, `components`, `gap` (bytes between steps), `start` (time of step 0) | `--raw` |
//!
//! HDF5 chunks are unpacked on all cores with the filters of deflate, shuffle, Fletcher-32, LZF, LZ4, Zstandard, Bitshuffle, Blosc and
//! Blosc2; others are left to HDF5. A series that is still being written is [followed](follow).
//!
//! Spacing and origin in a file are taken in x, y, z order. Values are as stored, with packing undone; fill values and
//! holes read as NaN. [`Series::timestep`] brings uneven axes to even ones and meshes to one level ([`SourceSpec::level`]);
//! [`Series::native`] has the file's own. All that was assumed is in [`SeriesInfo::warnings`].

mod axes;
mod choose;
mod coords;
mod enzo;
pub(crate) mod expand;
pub mod follow;
pub(crate) mod h5;
mod headed;
mod mesh;
mod mhd;
mod nrrd;
mod raw;
mod series;
mod statistics;
mod stretch;
mod values;
mod vti;
mod vtk;
mod xdmf;
mod xml;

use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::Serialize;

use crate::error::{Error, Result};
use crate::field::Timestep;
use crate::grid::Grid;

pub use statistics::{Piece, Statistics, statistics, statistics_of};

/// What to open, and what overrides or supplies what the files say.
#[derive(Debug, Clone, Default)]
pub struct SourceSpec {
    /// Files, directories, globs or patterns, as on the command line; `FILE:/dataset` names a dataset.
    pub series: Vec<String>,
    /// Field or dataset name.
    pub field: Option<String>,
    /// x, y, z, an index, or magnitude; magnitude when absent.
    pub component: Option<String>,
    /// A dataset's axes, slowest first, with x y z t c.
    pub axes: Option<String>,
    /// World length between values along x, y, z.
    pub spacing: Option<[f64; 3]>,
    /// World position of value (0, 0, 0).
    pub origin: Option<[f64; 3]>,
    /// Physical time between steps.
    pub time_step: Option<f64>,
    /// `dims=96x96x96,dtype=f64le,offset=24,order=zyx,steps=12` for headerless files.
    pub raw: Option<String>,
    /// Level of refinement to bring a mesh to, 0 the coarsest; the finest when absent.
    pub level: Option<usize>,
    /// Bytes that the run may take in all; [`decoded`] parts of files get their share.
    pub memory: Option<u64>,
}

/// What was found, from metadata alone.
#[derive(Debug, Clone, Default, Serialize)]
pub struct SeriesInfo {
    /// Name of the layout, such as `hdf5 4-D dataset`.
    pub layout: String,
    /// The files, in step order.
    pub series: Vec<PathBuf>,
    /// The field that will be read.
    pub field: String,
    /// Everything that could have been.
    pub candidates: Vec<Candidate>,
    /// By which marks the layout was told.
    pub why: Vec<String>,
    /// What else the files hold: datasets that are no volumes.
    pub others: Vec<String>,
    /// Units of the values; empty when the files do not say.
    pub units: String,
    /// Units of the times; empty when the files do not say.
    pub time_units: String,
    /// Grid of the first step, as the file has it.
    pub grid: GridInfo,
    /// The uniform grid that steps are brought to, where the file's own is uneven.
    pub resampled: Option<Grid>,
    /// Level of refinement that `grid` has, where there are levels.
    pub level: Option<usize>,
    /// The steps, in order.
    pub steps: Vec<StepInfo>,
    /// Range of values over the series where the file says it, and where it says so.
    pub range: Option<([f64; 2], String)>,
    /// What looks wrong, and what was assumed.
    pub warnings: Vec<String>,
}

/// A field that could be read.
#[derive(Debug, Clone, Serialize)]
pub struct Candidate {
    /// Name or path.
    pub name: String,
    /// Shape as stored, slowest axis first.
    pub shape: Vec<usize>,
    /// Element type, such as `f32le`.
    pub dtype: String,
    /// What it is: `scalar`, `vector`, …
    pub kind: String,
}

/// The grid as the file has it.
#[derive(Debug, Clone, Default, Serialize)]
pub struct GridInfo {
    /// Values along x, y, z.
    pub size: [usize; 3],
    /// World length between values; the mean where they are uneven.
    pub spacing: [f64; 3],
    /// World position of value (0, 0, 0).
    pub origin: [f64; 3],
    /// Units of length; empty when the file does not say.
    pub units: String,
    /// `node` or `cell`.
    pub centering: String,
    /// Axes that are uneven or run backwards.
    #[serde(skip)]
    pub(crate) stretch: Option<Arc<stretch::Stretch>>,
}

impl From<&GridInfo> for Grid {
    fn from(g: &GridInfo) -> Grid {
        Grid { size: g.size, spacing: g.spacing, origin: g.origin }
    }
}

/// One step, from metadata alone.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct StepInfo {
    /// Step number.
    pub step: u64,
    /// Physical time, where known.
    pub time: Option<f64>,
}

/// An open series: steps in order, each readable on its own.
pub trait Series: Send + Sync {
    /// What was found.
    fn info(&self) -> &SeriesInfo;

    /// Opens the `index`-th step of `info().steps`, on a uniform grid.
    fn timestep(&self, index: usize) -> Result<Timestep>;

    /// The file that holds the values of the `index`-th step, where it is one.
    fn file(&self, index: usize) -> Option<&Path> {
        let _ = index;
        None
    }

    /// Opens the same step as the file has it.
    fn native(&self, index: usize) -> Result<Native> {
        Ok(Native::from(self.timestep(index)?))
    }

    /// The uniform grid of the steps.
    fn grid(&self) -> Grid {
        self.info().resampled.unwrap_or_else(|| Grid::from(&self.info().grid))
    }
}

/// A step before anything is resampled.
pub struct Native {
    /// The step on `info().grid`: uneven axes keep their own indices, a mesh is brought to the level that `info().level`
    /// tells.
    pub step: Timestep,
    /// The file's own cells: pieces that share none.
    pub pieces: Vec<Piece>,
}

impl From<Timestep> for Native {
    fn from(step: Timestep) -> Native {
        let piece = Piece { size: step.grid.size, field: step.field.clone(), covered: Vec::new() };
        Native { step, pieces: vec![piece] }
    }
}

/// Opens a series: finds the files, detects the layout, checks that the steps agree.
///
/// # Errors
/// [`Error::Format`] for files that cannot be read or placed; it names the file, what was found, and the setting that
/// helps. What is wrong with one later step is reported when that step is opened.
pub fn open(spec: &SourceSpec) -> Result<Box<dyn Series>> {
    let files = expand::expand(&spec.series)?;
    let plan = match spec.raw.as_deref() {
        Some(text) => raw::plan(&files, text, spec)?,
        None => plan(&files, spec)?,
    };
    Ok(Box::new(series::Planned::new(plan, spec)?))
}

/// Bytes of decoded parts of files that a series keeps at most.
pub const DECODED: u64 = 256 << 20;

/// The share of a budget for everything in which a series keeps decoded parts of files: a quarter, [`DECODED`] at most.
pub fn decoded(budget: Option<u64>) -> u64 {
    budget.map_or(DECODED, |b| DECODED.min(b / 4))
}

/// Asks the layout that the files have for a plan.
fn plan(files: &expand::Files, spec: &SourceSpec) -> Result<series::Plan> {
    let (found, mark) = match detect(files)? {
        FileKind::Hdf5 => return h5::plan(files, spec),
        FileKind::Nrrd => (headed::plan(files, spec, "NRRD", nrrd::read), "the file begins with NRRD000"),
        FileKind::MetaImage => (headed::plan(files, spec, "MetaImage", mhd::read), "keys NDims, DimSize, ElementType"),
        FileKind::Vtk => (headed::plan(files, spec, "VTK legacy", vtk::read), "the file begins with # vtk DataFile"),
        FileKind::Vti => (headed::plan(files, spec, "VTK XML", vti::read), "element <VTKFile"),
        FileKind::Pvd => {
            let listed = vti::collection(&files.entries[0].path)?;
            (plan(&expand::Files { dataset: files.dataset.clone(), ..listed }, spec), "element <Collection")
        }
        FileKind::Xdmf => (xdmf::plan(files, spec), "element <Xdmf"),
        FileKind::Enzo => (enzo::plan(files, spec), "parameters InitialTime and TopGridDimensions, or a .hierarchy"),
    };
    found.map(|mut plan| {
        plan.info.why.push(mark.into());
        plan
    })
}

/// Kinds of file, by their first bytes.
enum FileKind {
    Hdf5,
    Nrrd,
    MetaImage,
    Vtk,
    Vti,
    Pvd,
    Xdmf,
    Enzo,
}

/// The kind of the first file that has one.
fn detect(files: &expand::Files) -> Result<FileKind> {
    let mut reason = None;
    for entry in &files.entries {
        match kind_of(&entry.path) {
            Ok(kind) => return Ok(kind),
            Err(why) => reason = reason.or(Some(why)),
        }
    }
    Err(reason.unwrap_or_else(|| Error::format("", "no files", "a file, a folder, a glob or a pattern")))
}

fn kind_of(path: &Path) -> Result<FileKind> {
    if let Some(problem) = file_problem(path) {
        return Err(problem);
    }
    let mut file = std::fs::File::open(path).map_err(|e| Error::io(path, e))?;
    // An HDF5 superblock may stand behind a user block of 512, 1024, … bytes.
    for at in [0, 512, 1024, 2048, 4096] {
        let mut magic = [0; 8];
        if file.seek(SeekFrom::Start(at)).and_then(|_| file.read_exact(&mut magic)).is_ok()
            && magic == *b"\x89HDF\r\n\x1a\n"
        {
            return Ok(FileKind::Hdf5);
        }
    }
    let mut start = Vec::new();
    file.seek(SeekFrom::Start(0))
        .and_then(|_| file.take(4096).read_to_end(&mut start))
        .map_err(|e| Error::io(path, e))?;
    let text = String::from_utf8_lossy(&start);
    let has = |mark: &str| text.contains(mark);
    match () {
        _ if text.starts_with("NRRD000") => return Ok(FileKind::Nrrd),
        _ if text.starts_with("# vtk DataFile") => return Ok(FileKind::Vtk),
        _ if has("ObjectType") && has("DimSize") || has("NDims") && has("ElementType") => {
            return Ok(FileKind::MetaImage);
        }
        _ if has("<VTKFile") && has("Collection") => return Ok(FileKind::Pvd),
        _ if has("<VTKFile") => return Ok(FileKind::Vti),
        _ if has("<Xdmf") => return Ok(FileKind::Xdmf),
        _ if has("TopGridDimensions") || has("InitialCycleNumber") && has("InitialTime") => return Ok(FileKind::Enzo),
        _ if has("GridRank") && has("GridStartIndex") => return Ok(FileKind::Enzo),
        _ => {}
    }
    if start.starts_with(b"CDF") {
        let remedy = "nccopy -k nc4 IN.nc OUT.nc";
        return Err(Error::format(path, "netCDF in its classic format, which is not read", remedy));
    }
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    if ["h5", "hdf5", "he5", "nc", "nc4", "vtkhdf", "athdf", "hdf"].contains(&extension.as_str()) {
        return Err(Error::format(
            path,
            "not HDF5: its signature is missing",
            "the complete file, or --raw for a headerless one",
        ));
    }
    let bytes = std::fs::metadata(path).map_err(|e| Error::io(path, e))?.len();
    let found = format!("no known kind of file ({bytes} bytes)");
    Err(Error::format(
        path,
        found,
        "--raw 'dims=NXxNYxNZ,dtype=f32le,offset=0,order=zyx,steps=1' for a headerless file",
    ))
}

/// What is wrong with a file before its format matters: missing, empty, or a Git LFS pointer.
fn file_problem(path: &Path) -> Option<Error> {
    let length = match std::fs::metadata(path) {
        Ok(about) if about.is_dir() => return Some(Error::format(path, "is a folder", "the files in it, as a glob")),
        Ok(about) => about.len(),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
            return Some(Error::format(path, "no such file", "gloaming info lists the files of a series"));
        }
        Err(e) => return Some(Error::io(path, e)),
    };
    if length == 0 {
        return Some(Error::format(path, "the file is empty", "the complete file; it may still be being written"));
    }
    let mut start = Vec::new();
    let read = std::fs::File::open(path).and_then(|f| f.take(40).read_to_end(&mut start));
    if let Err(e) = read {
        return Some(Error::io(path, e));
    }
    let pointer = start.starts_with(b"version https://git-lfs.github.com/");
    pointer.then(|| Error::format(path, "a Git LFS pointer, not the data", "git lfs pull"))
}

/// `48×96×96`.
fn shape_text(shape: &[usize]) -> String {
    if shape.is_empty() {
        "a single value".into()
    } else {
        shape.iter().map(usize::to_string).collect::<Vec<_>>().join("×")
    }
}

/// The first file of a series, for messages.
fn first_name(series: &[PathBuf]) -> String {
    series.first().map(|p| p.display().to_string()).unwrap_or_default()
}
