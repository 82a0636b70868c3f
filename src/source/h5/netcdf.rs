//! netCDF-4 with CF conventions: dimension scales tell axes, times and positions; packed values are unpacked, fill
//! values and what lies outside of the valid range are empty.

use hdf5::types::VarLenArray;
use hdf5::{Dataset, File, ObjectReference1, ReferencedObject};

use super::attributes::{number, numbers, numbers_in, text};
use super::generic::range;
use super::tree::{Found, type_name, walk};
use super::{Input, Packing, Slab, asked};
use crate::error::{Error, Result};
use crate::source::axes::{Axes, Evidence, place};
use crate::source::choose::{choose, component};
use crate::source::coords::{self, Along};
use crate::source::series::{Plan, Step};
use crate::source::values::Values;
use crate::source::{Candidate, GridInfo, SeriesInfo, shape_text};

/// A dimension of a variable: its name, and its coordinates where it has any.
#[derive(Default)]
pub(crate) struct Scale {
    name: String,
    units: String,
    axis: String,
    standard_name: String,
    /// Variable with the two ends of each cell.
    bounds: String,
    /// Positive values lie below: depths.
    down: bool,
    pub values: Option<Vec<f64>>,
}

/// Whether some dataset at the root is a dimension scale.
pub(crate) fn has_scales(file: &File) -> bool {
    file.member_names()
        .unwrap_or_default()
        .iter()
        .any(|n| file.dataset(n).is_ok_and(|d| text(&d, "CLASS").is_some_and(|c| c == "DIMENSION_SCALE")))
}

/// Finds the variable and its steps.
pub(crate) fn plan(mut input: Input) -> Result<Plan> {
    let path = input.entry.path.clone();
    let tree = walk(&input.file);
    let mut variables: Vec<(Found, Vec<Scale>)> = Vec::new();
    for found in tree.volumes {
        let Ok(dataset) = input.file.dataset(&found.members[0].1) else { continue };
        let scales = scales(&input.file, &dataset);
        // (time, y, x) is a series of maps.
        let flat = found.shape.len() == 3 && scales.iter().any(|s| s.role() == Some('t'));
        if !flat {
            variables.push((found, scales));
        }
    }
    let candidate = |(f, _): &(Found, Vec<Scale>)| Candidate {
        name: f.name.clone(),
        shape: f.shape.clone(),
        dtype: f.dtype.clone(),
        kind: "scalar".into(),
    };
    let candidates: Vec<Candidate> = variables.iter().map(candidate).collect();
    if candidates.is_empty() {
        let found = format!("netCDF without variables of three axes in space; it has {}", tree.others.join("; "));
        return Err(Error::format(path, found, "a file with at least one such variable"));
    }
    let (found, scales) = &variables[choose(&path, &candidates, asked(input.files, input.spec))?];
    if super::conventions::is_cutout(&input.file) {
        return super::generic::plan(input, &super::conventions::JHTDB);
    }
    if found.members.len() > 1 {
        return super::generic::plan(input, &super::conventions::NONE);
    }
    let dataset_path = found.members[0].1.clone();
    let name = format!("{}:{dataset_path}", path.display());
    let stated = spelled(scales);
    let time_lengths: Vec<usize> =
        scales.iter().zip(&found.shape).filter(|(s, _)| s.role() == Some('t')).map(|(_, n)| *n).collect();
    let evidence = Evidence {
        name: &name,
        shape: &found.shape,
        asked: input.spec.axes.as_deref(),
        stated: stated.as_deref(),
        unlimited: &found.unlimited,
        time_lengths: &time_lengths,
        many: input.files.entries.len() > 1,
    };
    let (axes, reason) = place(&evidence, &mut input.warnings)?;
    let grid = grid(&input.file, &axes, found, scales, &mut input.warnings);
    let parts = component(&name, axes.component.map(|c| found.shape[c]), input.spec.component.as_deref())?;
    let dataset = super::open_dataset(&input.file, &path, &dataset_path)?;
    let packing = packing(&dataset);
    let range = range(&[(**dataset).clone()]).map(|([lo, hi], from)| {
        let unpack = |v: f64| if from.contains("valid") { v * packing.scale + packing.offset } else { v };
        ([unpack(lo), unpack(hi)], from)
    });
    let mut steps: Vec<Step> = Vec::new();
    for entry in &input.files.entries {
        let own = super::reopen(entry, input.entry, &input.file, &mut input.warnings);
        let here = own.as_ref().and_then(|f| f.dataset(&dataset_path).ok());
        let times = axes.time.zip(here.as_ref()).map(|(axis, d)| times(own.as_ref(), d, axis));
        let count = times.as_ref().map_or(1, Vec::len);
        let times = times.unwrap_or_else(|| vec![own.as_ref().and_then(scalar_time)]);
        for (index, time) in times.into_iter().enumerate() {
            let next = steps.len() as u64;
            let step = if count == 1 { entry.number.unwrap_or(next) } else { next };
            let part = |c: &Option<usize>| {
                Values::Hdf5(Slab {
                    file: entry.path.clone(),
                    dataset: dataset_path.clone(),
                    rank: axes.rank(),
                    space: axes.space,
                    fixed: axes.time.map(|t| (t, index)).into_iter().chain(axes.component.zip(*c)).collect(),
                    start: [0; 3],
                    whole: true,
                    packing: packing.clone(),
                })
            };
            steps.push(Step { step, time, grid: None, values: Values::of(parts.iter().map(part).collect()) });
        }
    }
    let info = SeriesInfo {
        layout: "netCDF-4".into(),
        series: input.paths(),
        field: found.name.clone(),
        candidates,
        why: vec![format!("axes {} of {}: {reason}", axes.spelled(), shape_text(&found.shape))],
        others: tree.others,
        units: text(&dataset, "units").unwrap_or_default(),
        time_units: axes.time.and_then(|t| scales.get(t)).map(Scale::time_units).unwrap_or_default(),
        grid,
        range,
        warnings: input.warnings,
        ..SeriesInfo::default()
    };
    Ok(Plan { info, steps, start: 0.0 })
}

impl Scale {
    fn read(dataset: &Dataset) -> Scale {
        let told = |name: &str| text(dataset, name).unwrap_or_default();
        // A dimension without a variable of its own is a dataset without meaning.
        let bare = told("NAME").starts_with("This is a netCDF dimension but not a netCDF variable");
        let values =
            if bare || dataset.ndim() != 1 || type_name(dataset).is_empty() { None } else { numbers_in(dataset) };
        Scale {
            name: dataset.name().rsplit('/').next().unwrap_or_default().to_owned(),
            units: told("units"),
            axis: told("axis").to_ascii_uppercase(),
            standard_name: told("standard_name"),
            bounds: told("bounds"),
            down: told("positive").eq_ignore_ascii_case("down"),
            values,
        }
    }

    /// `s` of `seconds since 2000-01-01`.
    fn time_units(&self) -> String {
        let word = self.units.split(" since ").next().unwrap_or_default().trim();
        let short = [("second", "s"), ("minute", "min"), ("hour", "h"), ("day", "d")];
        short.iter().find(|(long, _)| word.trim_end_matches('s') == *long).map_or(word, |(_, s)| s).to_owned()
    }

    /// x, y, z or t, where the convention or the name tells.
    fn role(&self) -> Option<char> {
        let name = self.name.to_ascii_lowercase();
        match (self.axis.as_str(), self.standard_name.as_str()) {
            ("T", _) | (_, "time") => return Some('t'),
            ("X", _) | (_, "longitude" | "projection_x_coordinate") => return Some('x'),
            ("Y", _) | (_, "latitude" | "projection_y_coordinate") => return Some('y'),
            ("Z", _) | (_, "height" | "altitude" | "depth" | "air_pressure") => return Some('z'),
            _ if self.units.contains(" since ") => return Some('t'),
            _ => {}
        }
        match name.as_str() {
            "time" | "t" | "times" => Some('t'),
            "lon" | "longitude" | "west_east" | "east_west" => Some('x'),
            "lat" | "latitude" | "south_north" | "north_south" => Some('y'),
            "lev" | "level" | "depth" | "height" | "altitude" | "plev" | "pfull" | "bottom_top" => Some('z'),
            _ => name.chars().next().filter(|c| "xyz".contains(*c) && name.len() <= 3),
        }
    }
}

/// The axes as their scales tell them, slowest first; `None` unless every one is told.
fn spelled(scales: &[Scale]) -> Option<String> {
    let letters: Option<String> = scales.iter().map(Scale::role).collect();
    letters.filter(|l| !l.is_empty() && Axes::parse(l).is_ok())
}

/// The scales of a variable's axes: from `DIMENSION_LIST`, else by dimension scales of the same length.
pub(crate) fn scales(file: &File, dataset: &Dataset) -> Vec<Scale> {
    let listed = || -> Option<Vec<Scale>> {
        let lists = dataset.attr("DIMENSION_LIST").ok()?.read_raw::<VarLenArray<ObjectReference1>>().ok()?;
        // An axis may do without: that of a vector's components does.
        let scale = |list: &VarLenArray<ObjectReference1>| match file.dereference(list.first()?).ok()? {
            ReferencedObject::Dataset(scale) => Some(Scale::read(&scale)),
            _ => None,
        };
        Some(lists.iter().map(|list| scale(list).unwrap_or_default()).collect())
    };
    listed().unwrap_or_default()
}

/// Size, spacing and origin; coordinates in different units along the axes are told.
fn grid(file: &File, axes: &Axes, found: &Found, scales: &[Scale], warnings: &mut Vec<String>) -> GridInfo {
    let size = axes.size(&found.shape);
    let along = |a: usize| -> Along {
        let scale = scales.get(axes.space[a]).filter(|s| s.values.as_ref().is_some_and(|v| v.len() == size[a]));
        let Some((scale, values)) = scale.and_then(|s| Some((s, s.values.as_ref()?))) else {
            return Along::points(&(0..size[a]).map(|i| i as f64).collect::<Vec<_>>());
        };
        let sign = if scale.down { -1.0 } else { 1.0 };
        let faces = scale.faces(file, &found.members[0].1, size[a]);
        let turned = |v: &Vec<f64>| v.iter().map(|x| sign * x).collect::<Vec<f64>>();
        Along { centres: turned(values), faces: faces.as_ref().map(turned) }
    };
    let along = [along(0), along(1), along(2)];
    let units: Vec<&str> = axes.space.iter().filter_map(|&a| scales.get(a)).map(|s| s.units.as_str()).collect();
    let same = units.windows(2).all(|w| w[0] == w[1]);
    if !same {
        warnings
            .push(format!("coordinates along x, y, z are in {}: --spacing DX,DY,DZ sets one unit", units.join(", ")));
    }
    if axes.space.iter().filter_map(|&a| scales.get(a)).any(|s| s.down) {
        warnings.push("a coordinate is positive downwards: it is shown with its sign turned, so that up is up".into());
    }
    let units = if same { units.first().copied().unwrap_or_default().to_owned() } else { String::new() };
    let mut grid = GridInfo { size, spacing: [1.0; 3], units, centering: "node".into(), ..GridInfo::default() };
    coords::place(&mut grid, along, warnings);
    grid
}

impl Scale {
    /// Ends of the cells where `bounds` names them and they leave no gap.
    fn faces(&self, file: &File, variable: &str, count: usize) -> Option<Vec<f64>> {
        let group = variable.rsplit_once('/').map_or("", |(group, _)| group);
        let bounds = file.dataset(&format!("{group}/{}", self.bounds)).ok().filter(|_| !self.bounds.is_empty())?;
        let pairs = numbers_in(&bounds).filter(|v| bounds.shape() == [count, 2] && v.len() == 2 * count)?;
        let joined = pairs.chunks_exact(2).zip(pairs.chunks_exact(2).skip(1)).all(|(a, b)| a[1] == b[0]);
        joined.then(|| pairs.iter().step_by(2).chain(pairs.last()).copied().collect())
    }
}

/// Times along a variable's time axis in one file.
fn times(file: Option<&File>, dataset: &Dataset, axis: usize) -> Vec<Option<f64>> {
    let count = dataset.shape().get(axis).copied().unwrap_or(0);
    let values = file.and_then(|f| scales(f, dataset).into_iter().nth(axis)?.values);
    (0..count).map(|i| values.as_ref().and_then(|v| v.get(i).copied())).collect()
}

/// A file that holds one time as a variable without dimensions.
fn scalar_time(file: &File) -> Option<f64> {
    let values = ["time", "t", "Time"].iter().find_map(|n| numbers_in(&*file.dataset(n).ok()?))?;
    values.first().copied().filter(|_| values.len() == 1)
}

/// What netCDF writes where nothing was written, for floats.
const UNWRITTEN: f64 = 9.969_209_968_386_869e36;

fn packing(dataset: &Dataset) -> Packing {
    let one = |name: &str| number(dataset, name);
    let mut fills: Vec<f64> = ["_FillValue", "missing_value"].iter().filter_map(|n| one(n)).collect();
    if type_name(dataset).starts_with('f') {
        fills.push(UNWRITTEN);
    }
    let valid = numbers(dataset, "valid_range").and_then(|v| <[f64; 2]>::try_from(v).ok()).or_else(|| {
        let (lo, hi) = (one("valid_min"), one("valid_max"));
        (lo.is_some() || hi.is_some()).then(|| [lo.unwrap_or(f64::NEG_INFINITY), hi.unwrap_or(f64::INFINITY)])
    });
    Packing { scale: one("scale_factor").unwrap_or(1.0), offset: one("add_offset").unwrap_or(0.0), fills, valid }
}
