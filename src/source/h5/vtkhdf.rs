//! VTKHDF ImageData, one volume or temporal: `/VTKHDF/PointData/<array>` and `CellData`, (z, y, x) or with time leading.

use hdf5::{File, Group};

use super::attributes::{number, numbers, numbers_in, text};
use super::tree::type_name;
use super::{Input, Packing, Slab, asked};
use crate::error::{Error, Result};
use crate::source::axes::Axes;
use crate::source::choose::{choose, component};
use crate::source::series::{Plan, Step};
use crate::source::values::Values;
use crate::source::{Candidate, GridInfo, SeriesInfo};

/// An array of the file.
struct Array {
    candidate: Candidate,
    path: String,
    /// On cells, not points.
    cells: bool,
    axes: Axes,
}

/// Finds the array and its steps.
pub(crate) fn plan(mut input: Input) -> Result<Plan> {
    let path = &input.entry.path;
    let root = input.file.group("VTKHDF").map_err(|e| Error::format(path, format!("/VTKHDF: {e}"), ""))?;
    let kind = text(&root, "Type").unwrap_or_default();
    if kind != "ImageData" {
        let found = format!("VTKHDF of type `{kind}`; ImageData, a uniform grid, is read");
        return Err(Error::format(path, found, "ParaView's filter Resample To Image, saved as VTKHDF"));
    }
    let temporal = root.group("Steps").is_ok();
    let arrays = arrays(&root, temporal);
    if arrays.is_empty() {
        return Err(Error::format(
            path,
            "VTKHDF without arrays in PointData or CellData",
            "a file with at least one array",
        ));
    }
    let candidates: Vec<Candidate> = arrays.iter().map(|a| a.candidate.clone()).collect();
    let wanted =
        asked(input.files, input.spec).map(|a| a.trim_start_matches("/VTKHDF/").trim_start_matches("PointData/"));
    let array = &arrays[choose(path, &candidates, wanted)?];
    let name = format!("{}:{}", path.display(), array.path);
    let axes = match &input.spec.axes {
        None => array.axes.clone(),
        Some(asked) => Axes::parse(asked).map_err(|why| Error::format(&name, why, "--axes tzyx"))?,
    };
    let shape = &array.candidate.shape;
    if axes.rank() != shape.len() {
        let found = format!("--axes {} does not fit {}", axes.spelled(), crate::source::shape_text(shape));
        return Err(Error::format(&name, found, format!("--axes {}", array.axes.spelled())));
    }
    let grid = grid(&root, axes.size(shape), array.cells, &mut input.warnings);
    let parts = component(&name, axes.component.map(|c| shape[c]), input.spec.component.as_deref())?;
    let mut steps: Vec<Step> = Vec::new();
    for entry in &input.files.entries {
        let own = super::reopen(entry, input.entry, &input.file, &mut input.warnings);
        let told = own.as_ref().map_or_else(|| vec![(None, 0)], |f| times(f, array, temporal));
        let several = told.len() > 1 || input.files.entries.len() == 1;
        for (time, index) in told {
            let next = steps.len() as u64;
            let part = |c: &Option<usize>| {
                Values::Hdf5(Slab {
                    file: entry.path.clone(),
                    dataset: array.path.clone(),
                    rank: axes.rank(),
                    space: axes.space,
                    fixed: axes.time.map(|t| (t, index)).into_iter().chain(axes.component.zip(*c)).collect(),
                    start: [0; 3],
                    whole: true,
                    packing: Packing::default(),
                })
            };
            let step = if several { next } else { entry.number.unwrap_or(next) };
            let values = Values::of(parts.iter().map(part).collect());
            steps.push(Step { step, time: time.or(entry.decimal), grid: None, values });
        }
    }
    let info = SeriesInfo {
        layout: if temporal { "vtkhdf ImageData, temporal" } else { "vtkhdf ImageData" }.into(),
        series: input.paths(),
        field: array.candidate.name.clone(),
        candidates,
        grid,
        warnings: input.warnings,
        ..SeriesInfo::default()
    };
    Ok(Plan { info, steps, start: 0.0 })
}

/// Arrays of points, then of cells; one that both have is told apart by `CellData/`.
fn arrays(root: &Group, temporal: bool) -> Vec<Array> {
    let mut all: Vec<Array> = Vec::new();
    for (place, cells) in [("PointData", false), ("CellData", true)] {
        let Ok(group) = root.group(place) else { continue };
        for name in group.member_names().unwrap_or_default() {
            let Ok(dataset) = group.dataset(&name) else { continue };
            let (shape, dtype) = (dataset.shape(), type_name(&dataset));
            let axes = match (temporal, shape.len()) {
                (true, 4) => "tzyx",
                (true, 5) => "tzyxc",
                (false, 3) => "zyx",
                (false, 4) => "zyxc",
                _ => continue,
            };
            let Ok(axes) = Axes::parse(axes) else { continue };
            if dtype.is_empty() {
                continue;
            }
            let taken = all.iter().any(|a| a.candidate.name == name);
            let shown = if taken { format!("{place}/{name}") } else { name.clone() };
            let kind = if axes.component.is_some() { "vector" } else { "scalar" };
            let candidate = Candidate { name: shown, shape, dtype, kind: kind.into() };
            all.push(Array { candidate, path: format!("/VTKHDF/{place}/{name}"), cells, axes });
        }
    }
    all
}

/// Time and index along the time axis of each step in a file.
fn times(file: &File, array: &Array, temporal: bool) -> Vec<(Option<f64>, usize)> {
    let Some(root) = file.group("VTKHDF").ok().filter(|_| temporal) else { return vec![(None, 0)] };
    let list = |path: &str| root.dataset(path).ok().and_then(|d| numbers_in(&d));
    let values = list("Steps/Values").unwrap_or_default();
    let count = root.group("Steps").ok().and_then(|s| number(&s, "NSteps")).map_or(values.len(), |n| n as usize);
    let place = if array.cells { "CellDataOffsets" } else { "PointDataOffsets" };
    let leaf = array.path.rsplit('/').next().unwrap_or_default();
    let offsets = list(&format!("Steps/{place}/{leaf}")).unwrap_or_default();
    let index = |n: usize| offsets.get(n).map_or(n, |o| *o as usize);
    (0..count).map(|n| (values.get(n).copied(), index(n))).collect()
}

/// `Origin` is where point (0, 0, 0) of the extent lies, which may start elsewhere; cells sit half a spacing further.
fn grid(root: &Group, size: [usize; 3], cells: bool, warnings: &mut Vec<String>) -> GridInfo {
    let triple = |name: &str, default: f64| {
        let read = numbers(root, name).and_then(|v| <[f64; 3]>::try_from(v).ok());
        read.unwrap_or_else(|| {
            warnings.push(format!("/VTKHDF has no usable {name}: {default} {default} {default} is taken"));
            [default; 3]
        })
    };
    let mut triple = triple;
    let (spacing, origin) = (triple("Spacing", 1.0), triple("Origin", 0.0));
    let extent = numbers(root, "WholeExtent").filter(|e| e.len() == 6).unwrap_or_else(|| vec![0.0; 6]);
    let half = if cells { 0.5 } else { 0.0 };
    let origin = std::array::from_fn(|a| origin[a] + (extent[2 * a] + half) * spacing[a]);
    if let Some(d) = numbers(root, "Direction")
        && d != [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    {
        warnings
            .push("/VTKHDF has a rotated Direction, which is ignored: the volume is shown along its own axes".into());
    }
    let centering = if cells { "cell" } else { "node" }.into();
    GridInfo { size, spacing, origin, centering, ..GridInfo::default() }
}
