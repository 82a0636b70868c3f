//! openPMD 1.x: `/data/<iteration>/<meshesPath>/<record>`, iterations in one file or one file each.
//!
//! Values are as stored; `unitSI` is reported, not applied. Positions are in metres (`gridUnitSI`), times in seconds
//! (`timeUnitSI`). With `dataOrder` F the per-axis attributes run fastest axis first and are turned round.
//!
//! Records `E_lvl1`, `E_lvl2`, … beside `E` are levels of refinement of it, as AMReX codes write them: on cells (`position` ½)
//! they are read as one mesh.

use std::path::{Path, PathBuf};

use hdf5::{File, Location};

use super::attributes::{number, numbers, text, texts};
use super::tree::type_name;
use super::{Input, Packing, Slab, asked, blocks};
use crate::error::{Error, Result};
use crate::source::axes::Axes;
use crate::source::choose::{choose, component};
use crate::source::mesh::{self as levels, Found, Levels, Patch};
use crate::source::series::{Plan, Step};
use crate::source::values::Values;
use crate::source::{Candidate, GridInfo, SeriesInfo};

/// A component that is stored, or the same everywhere.
#[derive(Clone)]
enum Part {
    Stored,
    Constant(f64),
}

/// A mesh record, its components by name; a scalar has one with an empty name.
struct Record {
    candidate: Candidate,
    parts: Vec<(String, Part)>,
}

/// Finds the record and its iterations.
pub(crate) fn plan(mut input: Input) -> Result<Plan> {
    let path = input.entry.path.clone();
    let base = text(&input.file, "basePath").unwrap_or_else(|| "/data/%T/".into());
    let meshes = text(&input.file, "meshesPath").unwrap_or_else(|| "meshes/".into());
    let before = base.split("%T").next().unwrap_or("/data/").trim_end_matches('/').to_owned();
    let inside = |iteration: &str| format!("{before}/{iteration}/{}", meshes.trim_matches('/'));
    let first = iterations(&input.file, &before);
    let Some((_, first)) = first.first() else {
        let found = format!("openPMD without iterations under {before}");
        return Err(Error::format(path, found, "a run that has written at least one iteration"));
    };
    let records = records(&input.file, &inside(first));
    if records.is_empty() {
        let found = format!("openPMD without three-dimensional meshes in {}", inside(first));
        return Err(Error::format(path, found, "a series with at least one mesh of three axes"));
    }
    let candidates: Vec<Candidate> = records.iter().map(|r| r.candidate.clone()).collect();
    let (record, part) = find(&input, &records, &candidates, &inside(first))?;
    let here = format!("{}/{}", inside(first), record.candidate.name);
    let shown = format!("{}:{here}", path.display());
    let mesh = Mesh::read(&input.file, &here, record, input.spec.axes.as_deref(), &shown, &mut input.warnings)?;
    let chosen = match part {
        Some(part) => vec![part],
        None if record.parts.len() == 1 => vec![0],
        None => pick(record, &shown, input.spec.component.as_deref())?,
    };
    let leaf = &record.parts[chosen[0]].0;
    let unit = input.file.group(&here).ok().and_then(|g| number(&place(&g, leaf)?, "unitSI"));
    let unit = unit.or_else(|| number(&*input.file.dataset(&here).ok()?, "unitSI"));
    if let Some(unit) = unit.filter(|u| *u != 1.0) {
        input.warnings.push(format!("values are as stored; times unitSI = {unit} they are in SI units"));
    }
    let finer = finer(&records, &record.candidate.name);
    let refined = !finer.is_empty() && mesh.positions[chosen[0]] == [0.5; 3];
    if !finer.is_empty() && !refined {
        let names: Vec<&str> = finer.iter().map(|r| r.candidate.name.as_str()).collect();
        input.warnings.push(format!("{} refine the field but are not on cells: they are not shown", names.join(", ")));
    }
    let (mut steps, mut found) = (Vec::new(), Vec::new());
    for entry in &input.files.entries {
        let Some(file) = super::reopen(entry, input.entry, &input.file, &mut input.warnings) else {
            let dataset = format!("{before}/{}", entry.number.unwrap_or(0));
            let values = Values::Hdf5(mesh.slab(entry.path.clone(), dataset));
            let step = entry.number.unwrap_or(steps.len() as u64);
            steps.push(Step { step, time: None, grid: None, values });
            let mesh = Err("cannot be opened".into());
            found.push(Found { step, time: None, mesh, file: entry.path.clone() });
            continue;
        };
        for (number_of, iteration) in iterations(&file, &before) {
            let group = file.group(&format!("{before}/{iteration}")).ok();
            let told = |name: &str| group.as_ref().and_then(|g| number(g, name));
            let time = told("time").map(|t| t * told("timeUnitSI").unwrap_or(1.0));
            let open = |record: &Record| -> Result<(Mesh, Values)> {
                let here = format!("{}/{}", inside(&iteration), record.candidate.name);
                let mesh = Mesh::read(&file, &here, record, input.spec.axes.as_deref(), "", &mut Vec::new())?;
                let values = chosen.iter().map(|&p| mesh.part(record, p, &entry.path, &here)).collect();
                Ok((mesh, Values::of(values)))
            };
            if refined {
                let all = std::iter::once(record).chain(finer.iter().copied()).map(open).collect::<Result<Vec<_>>>();
                let mesh = all.map_err(|e| e.to_string()).and_then(|all| whole_mesh(all, chosen[0]));
                found.push(Found { step: number_of, time, mesh, file: entry.path.clone() });
                continue;
            }
            let here = format!("{}/{}", inside(&iteration), record.candidate.name);
            let values = Values::of(chosen.iter().map(|&p| mesh.part(record, p, &entry.path, &here)).collect());
            let grid = open(record).ok().map(|(mesh, _)| mesh.grid(chosen[0]));
            steps.push(Step { step: number_of, time, grid, values });
        }
    }
    let (mut grid, mut level) = (mesh.grid(chosen[0]), None);
    if refined {
        let joined = levels::steps(found, input.spec.level, &mut input.warnings);
        let (fine, shown, all) = joined.map_err(|why| Error::format(&shown, why, "--field NAME of one level"))?;
        (grid, level, steps) = (GridInfo { units: grid.units, ..fine }, Some(shown), all);
    }
    let leaf = &record.parts[chosen[0]].0;
    let field = match chosen.as_slice() {
        [_] if !leaf.is_empty() => format!("{}/{leaf}", record.candidate.name),
        _ => record.candidate.name.clone(),
    };
    let info = SeriesInfo {
        layout: format!("openPMD {}", text(&input.file, "iterationEncoding").unwrap_or_default()).trim().to_owned(),
        series: input.paths(),
        field,
        candidates,
        grid,
        level,
        time_units: "s".into(),
        warnings: input.warnings,
        ..SeriesInfo::default()
    };
    Ok(Plan { info, steps, start: 0.0 })
}

/// The records that refine one, level 1 first, as long as there is none missing.
fn finer<'a>(records: &'a [Record], name: &str) -> Vec<&'a Record> {
    let level = |n: usize| records.iter().find(|r| r.candidate.name == format!("{name}_lvl{n}"));
    (1..).map_while(level).collect()
}

/// The levels of a record, coarsest first, as one mesh. `part` tells where in a cell values sit.
fn whole_mesh(all: Vec<(Mesh, Values)>, part: usize) -> Result<levels::Mesh, String> {
    let Some((root, _)) = all.first() else { return Err("no levels".into()) };
    let (size, spacing, corner) = (root.size, root.spacing, root.offset);
    let (mut ratios, mut patches, mut before) = (Vec::new(), Vec::new(), spacing);
    for (level, (mesh, values)) in all.into_iter().enumerate() {
        if mesh.positions[part] != [0.5; 3] {
            return Err(format!("level {level} is not on cells"));
        }
        let mut start = [0; 3];
        let mut ratio = [1; 3];
        for a in 0..3 {
            let askew = || format!("level {level} does not fit into the levels below it");
            start[a] = blocks::whole((mesh.offset[a] - corner[a]) / mesh.spacing[a]).ok_or_else(askew)?;
            ratio[a] = blocks::whole(before[a] / mesh.spacing[a]).filter(|r| *r > 0).ok_or_else(askew)?;
        }
        if level > 0 {
            ratios.push(ratio);
        }
        before = mesh.spacing;
        patches.push(Patch { level, start, size: mesh.size, values });
    }
    levels::Mesh::new(Levels { corner, spacing, size, ratios }, patches)
}

fn place(group: &hdf5::Group, leaf: &str) -> Option<Location> {
    if leaf.is_empty() {
        return Some((**group).clone());
    }
    group.dataset(leaf).map(|d| (**d).clone()).or_else(|_| group.group(leaf).map(|g| (*g).clone())).ok()
}

/// Iterations of a file in order.
fn iterations(file: &File, before: &str) -> Vec<(u64, String)> {
    let names =
        file.group(if before.is_empty() { "/" } else { before }).and_then(|g| g.member_names()).unwrap_or_default();
    let mut all: Vec<(u64, String)> = names.into_iter().filter_map(|n| Some((n.parse().ok()?, n))).collect();
    all.sort();
    all
}

/// Mesh records of three axes.
fn records(file: &File, meshes: &str) -> Vec<Record> {
    let Ok(group) = file.group(meshes) else { return Vec::new() };
    let mut all = Vec::new();
    let record = |name: &str, shape: Vec<usize>, dtype: String, kind: &str, parts| {
        let candidate = Candidate { name: name.into(), shape, dtype, kind: kind.into() };
        (candidate.shape.len() == 3 && !candidate.dtype.is_empty()).then_some(Record { candidate, parts })
    };
    for name in group.member_names().unwrap_or_default() {
        if let Ok(dataset) = group.dataset(&name) {
            let parts = vec![(String::new(), Part::Stored)];
            all.extend(record(&name, dataset.shape(), type_name(&dataset), "scalar", parts));
        } else if let Ok(inner) = group.group(&name) {
            if let Some((value, shape)) = constant(&inner) {
                let parts = vec![(String::new(), Part::Constant(value))];
                all.extend(record(&name, shape, "f64le".into(), "constant", parts));
                continue;
            }
            let (mut shape, mut dtype, mut parts) = (Vec::new(), String::from("f64le"), Vec::new());
            for leaf in inner.member_names().unwrap_or_default() {
                if let Ok(dataset) = inner.dataset(&leaf) {
                    (shape, dtype) = (dataset.shape(), type_name(&dataset));
                    parts.push((leaf, Part::Stored));
                } else if let Some((value, extent)) = inner.group(&leaf).ok().and_then(|g| constant(&g)) {
                    if shape.is_empty() {
                        shape = extent;
                    }
                    parts.push((leaf, Part::Constant(value)));
                }
            }
            all.extend(record(&name, shape, dtype, "vector", parts));
        }
    }
    all
}

/// Value and shape of a constant component.
fn constant(group: &hdf5::Group) -> Option<(f64, Vec<usize>)> {
    let shape = numbers(group, "shape")?.into_iter().map(|n| n as usize).collect();
    Some((number(group, "value")?, shape))
}

/// The record asked for, as `B`, or one component of it, as `B/x`; else the only one that is stored.
fn find<'a>(
    input: &Input,
    records: &'a [Record],
    candidates: &[Candidate],
    inside: &str,
) -> Result<(&'a Record, Option<usize>)> {
    let path = &input.entry.path;
    let asked = asked(input.files, input.spec).map(|a| a.strip_prefix(inside).unwrap_or(a).trim_matches('/'));
    if let Some((name, leaf)) = asked.and_then(|a| a.rsplit_once(['/', '.']))
        && let Some(record) = records.iter().find(|r| r.candidate.name == name)
        && let Some(part) = record.parts.iter().position(|(l, _)| l == leaf)
    {
        return Ok((record, Some(part)));
    }
    let refines = |r: &Record| {
        let base = r.candidate.name.rsplit_once("_lvl").filter(|(_, n)| n.bytes().all(|b| b.is_ascii_digit()));
        base.is_some_and(|(base, _)| records.iter().any(|r| r.candidate.name == base))
    };
    let stored = |r: &&Record| r.parts.iter().any(|(_, p)| matches!(p, Part::Stored)) && !refines(r);
    let mut alive = records.iter().filter(stored);
    match (asked, alive.next(), alive.next()) {
        (None, Some(only), None) => Ok((only, None)),
        _ => choose(path, candidates, asked).map(|i| (&records[i], None)),
    }
}

/// Components of a vector: all of them for the magnitude, or the one with this name or index.
fn pick(record: &Record, shown: &str, asked: Option<&str>) -> Result<Vec<usize>> {
    if let Some(by_name) = record.parts.iter().position(|(leaf, _)| Some(leaf.as_str()) == asked) {
        return Ok(vec![by_name]);
    }
    Ok(component(shown, Some(record.parts.len()), asked)?.into_iter().flatten().collect())
}

/// Where a record's values sit.
struct Mesh {
    axes: Axes,
    size: [usize; 3],
    spacing: [f64; 3],
    offset: [f64; 3],
    /// Of each component, in spacings from the grid's corner.
    positions: Vec<[f64; 3]>,
}

impl Mesh {
    fn read(
        file: &File,
        path: &str,
        record: &Record,
        asked: Option<&str>,
        shown: &str,
        warnings: &mut Vec<String>,
    ) -> Result<Mesh> {
        let at: Location = match file.dataset(path) {
            Ok(dataset) => (**dataset).clone(),
            Err(_) => (*file.group(path).map_err(|e| Error::format(shown, format!("no such mesh ({e})"), ""))?).clone(),
        };
        let geometry = text(&at, "geometry").unwrap_or_else(|| "cartesian".into());
        if geometry != "cartesian" {
            let found = format!("a mesh of geometry `{geometry}`; cartesian ones are read");
            return Err(Error::format(shown, found, "the simulation's cartesian output"));
        }
        let fortran = text(&at, "dataOrder").is_some_and(|o| o.eq_ignore_ascii_case("F"));
        // Slowest axis first, whatever the order in the file.
        let turned = |mut v: Vec<f64>| {
            if fortran {
                v.reverse();
            }
            v
        };
        let mut labels = texts(&at, "axisLabels").unwrap_or_default();
        if fortran {
            labels.reverse();
        }
        let labels = labels.concat();
        let axes = match (asked, Axes::parse(&labels)) {
            (Some(asked), _) => Axes::parse(asked).map_err(|why| Error::format(shown, why, "--axes zyx"))?,
            (None, Ok(axes)) if axes.rank() == 3 => axes,
            _ => {
                warnings.push(format!("axisLabels `{labels}` do not name x, y, z: z, y, x is taken; --axes overrides"));
                Axes { space: [2, 1, 0], time: None, component: None }
            }
        };
        if axes.rank() != 3 {
            return Err(Error::format(shown, "openPMD meshes have three axes", "--axes zyx"));
        }
        let along = |v: Option<Vec<f64>>, default: f64| -> [f64; 3] {
            let v = v.filter(|v| v.len() == 3).map_or_else(|| vec![default; 3], turned);
            axes.space.map(|a| v[a])
        };
        let unit = match numbers(&at, "gridUnitSI").unwrap_or_default().as_slice() {
            [one] => [*one; 3],
            several => along(Some(several.to_vec()), 1.0),
        };
        let spacing = along(numbers(&at, "gridSpacing"), 1.0);
        let offset = along(numbers(&at, "gridGlobalOffset"), 0.0);
        let position = |(leaf, _): &(String, Part)| {
            let inner = file.group(path).ok().and_then(|g| place(&g, leaf));
            along(numbers(inner.as_ref().unwrap_or(&at), "position"), 0.0)
        };
        let times_unit = |v: [f64; 3]| std::array::from_fn(|a| v[a] * unit[a]);
        Ok(Mesh {
            size: axes.size(&record.candidate.shape),
            spacing: times_unit(spacing),
            offset: times_unit(offset),
            positions: record.parts.iter().map(position).collect(),
            axes,
        })
    }

    fn grid(&self, part: usize) -> GridInfo {
        let position = self.positions[part];
        let origin = std::array::from_fn(|a| self.offset[a] + position[a] * self.spacing[a]);
        let centering = if position == [0.5; 3] { "cell" } else { "node" };
        GridInfo {
            size: self.size,
            spacing: self.spacing,
            origin,
            units: "m".into(),
            centering: centering.into(),
            stretch: None,
        }
    }

    /// A component of a record at `here`: stored, or the same everywhere.
    fn part(&self, record: &Record, part: usize, file: &Path, here: &str) -> Values {
        match &record.parts[part] {
            (_, Part::Constant(value)) => Values::Constant(*value),
            (leaf, Part::Stored) if leaf.is_empty() => Values::Hdf5(self.slab(file.to_owned(), here.to_owned())),
            (leaf, Part::Stored) => Values::Hdf5(self.slab(file.to_owned(), format!("{here}/{leaf}"))),
        }
    }

    fn slab(&self, file: PathBuf, dataset: String) -> Slab {
        let packing = Packing::default();
        Slab { file, dataset, rank: 3, space: self.axes.space, fixed: Vec::new(), start: [0; 3], whole: true, packing }
    }
}
