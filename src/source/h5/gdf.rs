//! Grid Data Format 1.0, as yt writes it: `/data/grid_0000000000/<field>`, and lists of each grid's level, first cell and size.

use std::path::Path;

use hdf5::{Dataset, File};

use super::attributes::{number, numbers, numbers_in, text};
use super::tree::type_name;
use super::{Input, Packing, Slab, asked, blocks};
use crate::error::{Error, Result};
use crate::source::choose::choose;
use crate::source::mesh::{Levels, Mesh, Patch};
use crate::source::series::Plan;
use crate::source::values::Values;
use crate::source::{Candidate, GridInfo, SeriesInfo};

/// Whether a file bears the marks.
pub(crate) fn is(file: &File) -> bool {
    file.link_exists("gridded_data_format") && file.link_exists("grid_left_index")
}

/// Finds the field and its steps.
pub(crate) fn plan(input: Input) -> Result<Plan> {
    let path = input.entry.path.clone();
    let fail = |found: String, remedy: &str| Error::format(&path, found, remedy);
    let first = input
        .file
        .group("data/grid_0000000000")
        .map_err(|e| fail(format!("GDF without /data/grid_0000000000 ({e})"), ""))?;
    let mut candidates: Vec<Candidate> = Vec::new();
    for name in first.member_names().unwrap_or_default() {
        let Ok(dataset) = first.dataset(&name) else { continue };
        if dataset.ndim() == 3 && !type_name(&dataset).is_empty() {
            let (shape, dtype) = (dataset.shape(), type_name(&dataset));
            candidates.push(Candidate { name, shape, dtype, kind: "scalar".into() });
        }
    }
    let asked = asked(input.files, input.spec).map(|a| a.trim_start_matches("/data/grid_0000000000/"));
    let field = candidates[choose(&path, &candidates, asked)?].name.clone();
    let kind = input.file.group(&format!("field_types/{field}")).ok();
    if let Some(staggering) = kind.as_ref().and_then(|g| number(g, "staggering")).filter(|s| *s != 0.0) {
        let found = format!("field `{field}` has staggering {staggering}; values on cells (0) are read");
        return Err(fail(found, "a field on cells"));
    }
    let unit = kind.and_then(|g| text(&g, "field_units")).filter(|u| u != "None").unwrap_or_default();
    let units = |name: &str| {
        let dataset = input.file.dataset(&format!("dataset_units/{name}")).ok();
        let (value, unit) =
            dataset.and_then(|d: Dataset| Some((numbers_in(&d)?.first().copied()?, text(&d, "unit")?)))?;
        (value == 1.0).then_some(unit)
    };
    let about = SeriesInfo {
        layout: "Grid Data Format".into(),
        field: field.clone(),
        candidates,
        units: unit,
        time_units: units("time_unit").unwrap_or_default(),
        grid: GridInfo { units: units("length_unit").unwrap_or_default(), ..GridInfo::default() },
        ..SeriesInfo::default()
    };
    blocks::plan(input, about, |file, path| {
        let time = file.group("simulation_parameters").ok().and_then(|g| number(&g, "current_time"));
        (time, mesh(file, path, &field))
    })
}

fn mesh(file: &File, path: &Path, field: &str) -> Result<Mesh, String> {
    let run = file.group("simulation_parameters").map_err(|e| format!("no /simulation_parameters ({e})"))?;
    let triple = |name: &str| {
        let read = numbers(&run, name).and_then(|v| <[f64; 3]>::try_from(v).ok());
        read.ok_or_else(|| format!("/simulation_parameters has no usable {name}"))
    };
    let (least, most, cells) =
        (triple("domain_left_edge")?, triple("domain_right_edge")?, triple("domain_dimensions")?);
    let geometry = number(&run, "geometry").unwrap_or(0.0);
    if geometry != 0.0 {
        return Err(format!("geometry {geometry}; cartesian meshes (0) are read"));
    }
    if number(&run, "num_ghost_zones").is_some_and(|n| n != 0.0) {
        return Err("grids with ghost zones".into());
    }
    if !cells.iter().all(|n| (1.0..1e9).contains(n)) {
        return Err(format!("domain_dimensions {cells:?}"));
    }
    let refine = numbers(&run, "refine_by").unwrap_or_else(|| vec![2.0]);
    let by = |a: usize| refine.get(a).or(refine.first()).copied().filter(|r| (1.0..1e6).contains(r)).unwrap_or(2.0);
    let list = |name: &str| file.dataset(name).ok().and_then(|d| numbers_in(&d)).ok_or_else(|| format!("no /{name}"));
    let (levels, starts, sizes) = (list("grid_level")?, list("grid_left_index")?, list("grid_dimensions")?);
    if starts.len() != 3 * levels.len()
        || sizes.len() != starts.len()
        || levels.iter().any(|l| !(0.0..40.0).contains(l))
    {
        return Err(format!(
            "{} grid_level, {} grid_left_index and {} grid_dimensions do not agree",
            levels.len(),
            starts.len(),
            sizes.len()
        ));
    }
    let finest = levels.iter().fold(0.0, |a: f64, b| a.max(*b)) as usize;
    // Ordering 0 is Fortran's view of the array: x slowest in the file.
    let zyx = number(&run, "field_ordering").unwrap_or(0.0) == 1.0;
    let space = if zyx { [2, 1, 0] } else { [0, 1, 2] };
    let size = cells.map(|n| n as usize);
    // An axis of one cell is not refined.
    let ratio = std::array::from_fn(|a| if size[a] > 1 { by(a) as usize } else { 1 });
    let patch = |n: usize| {
        let at = |list: &[f64]| -> [usize; 3] { std::array::from_fn(|a| list[3 * n + a].max(0.0) as usize) };
        let slab = Slab {
            file: path.to_owned(),
            dataset: format!("/data/grid_{n:010}/{field}"),
            rank: 3,
            space,
            fixed: Vec::new(),
            start: [0; 3],
            whole: true,
            packing: Packing::default(),
        };
        Patch { level: levels[n] as usize, start: at(&starts), size: at(&sizes), values: Values::Hdf5(slab) }
    };
    if starts.iter().any(|s| *s < 0.0) {
        return Err("a grid begins outside of the domain".into());
    }
    let spacing = std::array::from_fn(|a| (most[a] - least[a]) / cells[a]);
    Mesh::new(
        Levels { corner: least, spacing, size, ratios: vec![ratio; finest] },
        (0..levels.len()).map(patch).collect(),
    )
}
