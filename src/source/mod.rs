//! Sources: series of timesteps from files. A layout is one file here and one `match` arm.

use std::path::PathBuf;

use serde::Serialize;

use crate::error::Result;
use crate::field::Timestep;
use crate::grid::Grid;

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
}

/// What was found, from metadata alone.
#[derive(Debug, Clone, Serialize)]
pub struct SeriesInfo {
    /// Name of the layout, such as `hdf5 4-D dataset`.
    pub layout: String,
    /// The files, in step order.
    pub series: Vec<PathBuf>,
    /// The field that will be read.
    pub field: String,
    /// Everything that could have been.
    pub candidates: Vec<Candidate>,
    /// Grid of the first step.
    pub grid: GridInfo,
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
#[derive(Debug, Clone, Serialize)]
pub struct GridInfo {
    /// Values along x, y, z.
    pub size: [usize; 3],
    /// World length between values.
    pub spacing: [f64; 3],
    /// World position of value (0, 0, 0).
    pub origin: [f64; 3],
    /// Units of length; empty when the file does not say.
    pub units: String,
    /// `node` or `cell`.
    pub centering: String,
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

    /// Opens the `index`-th step of `info().steps`.
    fn timestep(&self, index: usize) -> Result<Timestep>;
}

/// Opens a series: finds the files, detects the layout, checks that the steps agree.
pub fn open(spec: &SourceSpec) -> Result<Box<dyn Series>> {
    let _ = spec;
    Err(crate::Error::Unsupported("no layout yet".into()))
}
