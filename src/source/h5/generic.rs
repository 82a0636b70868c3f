//! HDF5 that follows no convention: one file a step, numbered groups or datasets, or one dataset with a time axis.

use std::path::Path;

use hdf5::{File, Location};

use super::Input;
use super::attributes::{first, first_text, number, numbers_in, outwards};
use super::conventions::Convention;
use super::slab::{Packing, Slab};
use super::tree::{Found, Tree, type_name, walk};
use crate::error::{Error, Result};
use crate::source::axes::{Axes, Evidence, place};
use crate::source::choose::{choose, component};
use crate::source::coords::{self, Along};
use crate::source::expand::Entry;
use crate::source::series::{Plan, Step};
use crate::source::values::Values;
use crate::source::{Candidate, GridInfo, SeriesInfo, shape_text};

/// Names under which a file tells time, in the order in which they are believed.
const TIMES: [&str; 10] =
    ["time", "Time", "t", "TIME", "times", "Times", "sim_time", "simulation_time", "current_time", "InitialTime"];

/// Finds the field and its steps.
pub(crate) fn plan(input: Input, convention: &Convention) -> Result<Plan> {
    let Input { files, spec, file, entry: first_entry, mut warnings } = input;
    let tree = walk(&file);
    let asked = super::asked(files, spec);
    let found = find(&tree, &file, asked, &first_entry.path)?;
    let name = format!("{}:{}", first_entry.path.display(), found.members[0].1);
    let places = outwards(&file, &found.members[0].1);
    let many = files.entries.len() > 1 || found.members.len() > 1;
    let stated = first_text(&places[..1], &["axes", "AXES", "axis_order", "dimension_order", "DIMENSION_LABELS"]);
    let stated = stated.or_else(|| (convention.axes)(found.shape.len()).map(String::from));
    let times = time_lists(&file, &found.members[0].1);
    let time_lengths: Vec<usize> = times.iter().map(Vec::len).filter(|&n| n > 0).collect();
    let evidence = Evidence {
        name: &name,
        shape: &found.shape,
        asked: spec.axes.as_deref(),
        stated: stated.as_deref(),
        unlimited: &found.unlimited,
        time_lengths: &time_lengths,
        many,
    };
    let (axes, reason) = place(&evidence, &mut warnings)?;
    let grid = grid(&file, &found, &axes, convention, &mut warnings);
    let parts = component(&name, axes.component.map(|c| found.shape[c]), spec.component.as_deref())?;
    let layout = match (axes.time.is_some(), found.members.len() > 1, files.entries.len() > 1) {
        (true, _, false) if found.members.len() == 1 => "hdf5 4-D dataset",
        (_, true, _) if found.members[0].1.ends_with(&format!("/{}", found.name.trim_start_matches('/'))) => {
            "hdf5 group per step"
        }
        (_, true, _) => "hdf5 dataset per step",
        (_, _, true) => "hdf5 file per step",
        _ => "hdf5 3-D dataset",
    };
    let range = range(&places).map(|([lo, hi], from)| {
        // The valid range is told in stored numbers.
        let packing = packing(&places[..1]);
        let unpack = |v: f64| if from.contains("valid") { v * packing.scale + packing.offset } else { v };
        ([unpack(lo), unpack(hi)], from)
    });
    if let Some(told) = number(&file, "NumSteps").filter(|n| *n as usize != found.members.len()) {
        warnings.push(format!("NumSteps says {told} steps, but there are {}", found.members.len()));
    }
    warnings.extend(missing_sources(&file, &found.members[0].1, &first_entry.path));
    let mut steps = Vec::new();
    for entry in &files.entries {
        let own = super::reopen(entry, first_entry, &file, &mut warnings);
        let file = own.as_ref();
        let source = Source { entry, file, found: &found, axes: &axes, parts: &parts, convention };
        source.steps(files.entries.len() > 1, &mut steps);
    }
    let info = SeriesInfo {
        layout: if convention.name.is_empty() { layout.into() } else { convention.name.into() },
        series: files.entries.iter().map(|e| e.path.clone()).collect(),
        field: found.name.clone(),
        candidates: tree.volumes.iter().map(candidate).collect(),
        why: vec![format!("axes {} of {}: {reason}", axes.spelled(), shape_text(&found.shape))],
        others: tree.others.clone(),
        units: first_text(&places[..1], &["units", "Units", "unit"]).unwrap_or_default(),
        time_units: time_units(&file, &found.members[0].1),
        grid,
        range,
        warnings: warnings
            .into_iter()
            .chain(tree.dangling.iter().map(|d| format!("{d}: the link leads nowhere")))
            .chain(tree.unreadable.iter().map(|d| unreadable(d)))
            .collect(),
        ..SeriesInfo::default()
    };
    Ok(Plan { info, steps, start: 0.0 })
}

/// The dataset asked for, else the only one that could be meant.
fn find(tree: &Tree, file: &File, asked: Option<&str>, path: &Path) -> Result<Found> {
    let names: Vec<&str> = tree.volumes.iter().map(|f| f.name.as_str()).collect();
    if let Some(asked) = asked
        && !names.iter().any(|n| crate::source::choose::matches(n, asked))
        && let Some(odd) = named_outright(file, asked, path)?
    {
        return Ok(odd);
    }
    let all: Vec<Candidate> = tree.volumes.iter().map(candidate).collect();
    if all.is_empty() {
        let dangling = tree.dangling.iter().map(|d| format!("{d} (a link that leads nowhere)"));
        let unreadable = tree.unreadable.iter().map(|d| unreadable(d));
        let there: Vec<String> = tree.others.iter().cloned().chain(dangling).chain(unreadable).collect();
        let found = match there.len() {
            0 => String::from("no datasets in this file"),
            _ => format!("no volume in this file; it has {}", there[..there.len().min(12)].join("; ")),
        };
        if let Some(asked) = asked {
            super::open_dataset(file, path, asked)?;
        }
        return Err(Error::format(path, found, "a file with a dataset of three axes or more"));
    }
    let index = choose(path, &all, asked).map_err(|e| match asked.map(|a| super::open_dataset(file, path, a)) {
        // A link that leads nowhere is a better answer than "no such field".
        Some(Err(why)) if why.to_string().contains("link leads nowhere") => why,
        _ => e,
    })?;
    Ok(tree.volumes[index].clone())
}

/// What to say of a dataset that does not open.
fn unreadable(dataset: &str) -> String {
    let (major, minor, patch) = hdf5::library_version();
    format!("{dataset} (cannot be opened: damaged, or written by a newer HDF5 than {major}.{minor}.{patch})")
}

/// A dataset named outright that the walk did not list: one step's own path, or not a volume.
fn named_outright(file: &File, asked: &str, path: &Path) -> Result<Option<Found>> {
    let Ok(dataset) = file.dataset(asked) else { return Ok(None) };
    let (shape, dtype) = (dataset.shape(), type_name(&dataset));
    if dtype.is_empty() {
        let name = format!("{}:{asked}", path.display());
        return Err(Error::format(name, "its values are not numbers", "gloaming info lists the datasets"));
    }
    let maxima = dataset.space().map(|s| s.maxdims()).unwrap_or_default();
    let unlimited = maxima.iter().enumerate().filter(|(_, m)| m.is_none()).map(|(a, _)| a).collect();
    let full = format!("/{}", asked.trim_start_matches('/'));
    Ok(Some(Found { name: full[1..].to_owned(), members: vec![(None, full)], shape, dtype, unlimited }))
}

fn candidate(found: &Found) -> Candidate {
    let rank = found.shape.len();
    let kind = if rank > 4 { "vector" } else { "scalar" };
    Candidate { name: found.name.clone(), shape: found.shape.clone(), dtype: found.dtype.clone(), kind: kind.into() }
}

/// One file, and what of it belongs to the series.
struct Source<'a> {
    entry: &'a Entry,
    /// `None` when it did not open: its step then fails when it is asked for.
    file: Option<&'a File>,
    found: &'a Found,
    axes: &'a Axes,
    parts: &'a [Option<usize>],
    convention: &'a Convention,
}

impl Source<'_> {
    fn steps(&self, several_files: bool, steps: &mut Vec<Step>) {
        let members = &self.found.members;
        for (place, (number, dataset)) in members.iter().enumerate() {
            let shape = self.file.and_then(|f| f.dataset(dataset).ok()).map(|d| d.shape());
            let count = self.axes.time.map(|axis| shape.as_ref().and_then(|s| s.get(axis)).copied().unwrap_or(1));
            let times = self.times(dataset, count, place);
            let size = shape.as_ref().filter(|s| s.len() == self.found.shape.len()).map(|s| self.axes.size(s));
            let grid = self.file.zip(size).map(|(file, size)| self.own_grid(file, dataset, size));
            let packing = self.file.map(|f| packing(&outwards(f, dataset)[..1])).unwrap_or_default();
            // Numbers of groups say nothing about the order of files: several steps in each of several files are
            // numbered through.
            let several = members.len() > 1 || count.is_some_and(|n| n > 1);
            let told = self.listed(self.convention.numbers).filter(|l| l.len() == count.unwrap_or(1));
            for index in 0..count.unwrap_or(1) {
                let next = steps.len() as u64;
                let step = match (several_files, several) {
                    _ if told.is_some() => told.as_ref().map_or(next, |l| l[index] as u64),
                    (true, true) => next,
                    (true, false) => self.entry.number.unwrap_or(next),
                    (false, true) if members.len() == 1 => index as u64,
                    (false, _) => number.or(self.entry.number).unwrap_or(next),
                };
                let part =
                    |c: &Option<usize>| self.slab(dataset, self.axes.time.map(|axis| (axis, index)), *c, &packing);
                let values = Values::of(self.parts.iter().map(part).collect());
                let time = times.get(index).copied().or(self.entry.decimal);
                steps.push(Step { step, time, grid: grid.clone(), values });
            }
        }
    }

    fn slab(&self, dataset: &str, time: Option<(usize, usize)>, part: Option<usize>, packing: &Packing) -> Values {
        let fixed = time.into_iter().chain(self.axes.component.zip(part)).collect();
        Values::Hdf5(Slab {
            file: self.entry.path.clone(),
            dataset: dataset.to_owned(),
            rank: self.axes.rank(),
            space: self.axes.space,
            fixed,
            start: [0; 3],
            whole: true,
            packing: packing.clone(),
        })
    }

    fn own_grid(&self, file: &File, dataset: &str, size: [usize; 3]) -> GridInfo {
        let here = Found { members: vec![(None, dataset.to_owned())], ..self.found.clone() };
        GridInfo { size, ..grid(file, &here, self.axes, self.convention, &mut Vec::new()) }
    }

    /// Numbers in a dataset that the convention names.
    fn listed(&self, dataset: &str) -> Option<Vec<f64>> {
        if dataset.is_empty() { None } else { numbers_in(&*self.file?.dataset(dataset).ok()?) }
    }

    /// Times of a member: `along` values where it has a time axis, else one.
    fn times(&self, dataset: &str, along: Option<usize>, member: usize) -> Vec<f64> {
        let Some(file) = self.file else { return Vec::new() };
        let places = outwards(file, dataset);
        let lists = time_lists(file, dataset);
        let wanted = along.unwrap_or(1);
        if let Some(told) = self.listed(self.convention.times).filter(|l| l.len() == wanted) {
            return told;
        }
        if let Some(list) =
            lists.iter().find(|l| l.len() == wanted && (along.is_some() || self.found.members.len() == 1))
        {
            return list.clone();
        }
        if let Some(times) = first(&places, &TIMES, wanted) {
            return times;
        }
        // One list at the root for all groups, or one number in each group.
        let all = lists.iter().find(|l| l.len() == self.found.members.len()).and_then(|l| l.get(member));
        all.or_else(|| lists.iter().find(|l| l.len() == 1).and_then(|l| l.first()))
            .map(|t| vec![*t])
            .unwrap_or_default()
    }
}

/// Lists of times beside a dataset and in the groups round it, innermost first.
fn time_lists(file: &File, dataset: &str) -> Vec<Vec<f64>> {
    let mut lists = Vec::new();
    let mut path = dataset;
    while let Some((group, _)) = path.rsplit_once('/') {
        for name in TIMES {
            let full = format!("{group}/{name}");
            if full != dataset
                && let Ok(list) = file.dataset(&full)
                && list.ndim() <= 1
            {
                lists.extend(numbers_in(&list));
            }
        }
        path = group;
    }
    lists
}

/// Units of the list of times beside a dataset.
fn time_units(file: &File, dataset: &str) -> String {
    let mut path = dataset;
    while let Some((group, _)) = path.rsplit_once('/') {
        let units = |name: &&str| super::attributes::text(&*file.dataset(&format!("{group}/{name}")).ok()?, "units");
        if let Some(units) = TIMES.iter().find_map(units) {
            return units;
        }
        path = group;
    }
    first_text(&outwards(file, dataset), &["time_units", "time_unit"]).unwrap_or_default()
}

/// Size from the shape; spacing and origin from attributes in x, y, z order, or from 1-D arrays x, y, z.
fn grid(file: &File, found: &Found, axes: &Axes, convention: &Convention, warnings: &mut Vec<String>) -> GridInfo {
    let places = outwards(file, &found.members[0].1);
    let size = if axes.rank() == found.shape.len() { axes.size(&found.shape) } else { [0; 3] };
    if let Some(told) = (convention.grid)(file, &found.members[0].1, axes, size, warnings) {
        return told;
    }
    let each = |names: [&str; 3]| -> Option<Vec<f64>> {
        names.iter().map(|n| first(&places, &[n], 1).map(|v| v[0])).collect()
    };
    let mut grid = GridInfo {
        size,
        spacing: [1.0; 3],
        units: first_text(&places, &["spacing_units", "length_units", "length_unit", "grid_units"]).unwrap_or_default(),
        centering: first_text(&places, &["centering", "center"]).unwrap_or_else(|| "node".into()).to_lowercase(),
        ..GridInfo::default()
    };
    let spacing =
        first(&places, &["spacing", "Spacing", "grid_spacing", "gridSpacing", "voxel_size", "cell_size", "dx"], 3)
            .or_else(|| first(&places, &["element_size_um"], 3).map(|zyx| vec![zyx[2], zyx[1], zyx[0]]))
            .or_else(|| each(["dx", "dy", "dz"]))
            .or_else(|| {
                first(&places, &["spacing", "Spacing", "voxel_size", "cell_size", "dx", "h"], 1).map(|h| vec![h[0]; 3])
            });
    let origin = first(&places, &["origin", "Origin", "ORIGIN", "grid_origin", "offset"], 3)
        .or_else(|| each(["x0", "y0", "z0"]))
        .or_else(|| each(["xmin", "ymin", "zmin"]));
    let coordinates = spacing.is_none() && coordinates(file, &found.members[0].1, &mut grid, warnings);
    if let Some(d) = &spacing
        && (d[0] != d[1] || d[1] != d[2])
    {
        warnings.push(format!(
            "spacing {} {} {} is taken in x, y, z order; --spacing DX,DY,DZ overrides",
            d[0], d[1], d[2]
        ));
    }
    let set = |v: Option<Vec<f64>>, to: &mut [f64; 3]| {
        if let Some(v) = v {
            *to = [v[0], v[1], v[2]];
        }
    };
    set(spacing, &mut grid.spacing);
    set(origin.filter(|_| !coordinates), &mut grid.origin);
    grid
}

/// Takes positions from 1-D arrays `x`, `y`, `z` (`xcoor`, …) beside the dataset, as long as its axes, or longer by one: faces
/// of cells.
fn coordinates(file: &File, dataset: &str, grid: &mut GridInfo, warnings: &mut Vec<String>) -> bool {
    let mut path = dataset;
    while let Some((group, _)) = path.rsplit_once('/') {
        let along = |a: usize| -> Option<Along> {
            let named = |tail: &str| file.dataset(&format!("{group}/{}{tail}", ["x", "y", "z"][a]));
            let array = named("").or_else(|_| named("coor")).ok()?;
            match array.shape().as_slice() {
                [n] if *n == grid.size[a] => numbers_in(&array).map(|v| Along::points(&v)),
                [n] if *n == grid.size[a] + 1 => numbers_in(&array).map(|v| Along::cells(&v)),
                _ => None,
            }
        };
        if let (Some(x), Some(y), Some(z)) = (along(0), along(1), along(2)) {
            if x.faces.is_some() {
                grid.centering = "cell".into();
            }
            return coords::place(grid, [x, y, z], warnings);
        }
        path = group;
    }
    false
}

/// Packing and fill values as CF spells them, which others do as well.
fn packing(places: &[Location]) -> Packing {
    let one = |names: &[&str]| names.iter().find_map(|n| places.iter().find_map(|p| number(p, n)));
    Packing {
        scale: one(&["scale_factor"]).unwrap_or(1.0),
        offset: one(&["add_offset"]).unwrap_or(0.0),
        fills: ["_FillValue", "missing_value"].iter().filter_map(|n| one(&[n])).collect(),
        valid: None,
    }
}

/// Parts of a virtual dataset whose files are missing: HDF5 fills them in without a word.
fn missing_sources(file: &File, dataset: &str, path: &Path) -> Vec<String> {
    let Ok(plist) = file.dataset(dataset).and_then(|d| d.dcpl()) else { return Vec::new() };
    let folder = path.parent().unwrap_or(Path::new(""));
    let missing =
        |name: &String| name != "." && !name.contains('%') && !folder.join(name).exists() && !Path::new(name).exists();
    let mut names: Vec<String> = plist.virtual_map().into_iter().map(|m| m.src_filename).filter(missing).collect();
    names.dedup();
    let told = |n: &String| {
        format!("{dataset}: part of this virtual dataset is missing with the file {n}; it reads as fill values")
    };
    names.iter().map(told).collect()
}

/// Range over the series where an attribute says it.
pub(crate) fn range(places: &[Location]) -> Option<([f64; 2], String)> {
    let fine = |r: &[f64]| r[0].is_finite() && r[1].is_finite() && r[0] < r[1];
    for name in ["actual_range", "valid_range", "data_range", "value_range", "range"] {
        if let Some(r) = first(&places[..1], &[name], 2).filter(|r| fine(r)) {
            return Some(([r[0], r[1]], format!("attribute {name}")));
        }
    }
    for (lo, hi) in [("min", "max"), ("minimum", "maximum"), ("valid_min", "valid_max"), ("data_min", "data_max")] {
        if let Some((a, b)) = number(&places[0], lo).zip(number(&places[0], hi)).filter(|(a, b)| fine(&[*a, *b])) {
            return Some(([a, b], format!("attributes {lo} and {hi}")));
        }
    }
    None
}
