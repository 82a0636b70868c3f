//! The arguments of every command that takes a series.

use clap::Args;
use gloaming::source::SourceSpec;

use super::parse;

/// A series, and what overrides or supplies what its files say.
#[derive(Args)]
pub struct SeriesArgs {
    /// Files, a directory, a glob, or a pattern such as run/plt_{step:05}.h5; FILE:/dataset names a dataset
    #[arg(required = true, value_name = "SERIES")]
    pub series: Vec<String>,
    /// Field or dataset to read, where there are several
    #[arg(long, value_name = "NAME")]
    pub field: Option<String>,
    /// Axes of the dataset, slowest first, of x y z t c (such as tzyx)
    #[arg(long, value_name = "ORDER")]
    pub axes: Option<String>,
    /// World length between values
    #[arg(long, value_name = "DX,DY,DZ", value_parser = parse::lengths, allow_hyphen_values = true)]
    pub spacing: Option<[f64; 3]>,
    /// World position of the first value
    #[arg(long, value_name = "X,Y,Z", value_parser = parse::place, allow_hyphen_values = true)]
    pub origin: Option<[f64; 3]>,
    /// Physical time between steps
    #[arg(long, value_name = "DT", allow_hyphen_values = true)]
    pub time_step: Option<f64>,
    /// Layout of headerless files, such as dims=96x96x96,dtype=f64le,offset=24,order=zyx,steps=12
    #[arg(long, value_name = "LAYOUT")]
    pub raw: Option<String>,
    /// Level of refinement to bring a mesh to, 0 the coarsest; the finest when absent
    #[arg(long, value_name = "N")]
    pub level: Option<usize>,
}

impl SeriesArgs {
    /// What to open.
    pub fn spec(self) -> SourceSpec {
        let SeriesArgs { series, field, axes, spacing, origin, time_step, raw, level } = self;
        SourceSpec { series, field, component: None, axes, spacing, origin, time_step, raw, level, memory: None }
    }
}
