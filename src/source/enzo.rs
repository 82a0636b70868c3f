//! Enzo: a parameter file (`DD0000`), a text of the grids' places (`DD0000.hierarchy`), and HDF5 files with the values of each
//! grid, `/Grid00000001/<field>` (z, y, x) in packed files, `/<field>` in a file of its own otherwise.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use super::choose::choose;
use super::expand::Files;
use super::mesh::{self, Found, Levels, Mesh, Patch};
use super::series::Plan;
use super::values::Values;
use super::{Candidate, SeriesInfo, SourceSpec, h5};
use crate::error::{Error, Result};

/// One output: its parameters and its grids.
struct Dump {
    parameters: HashMap<String, String>,
    grids: Vec<Grid>,
}

/// A grid of an output.
#[derive(Default)]
struct Grid {
    id: u64,
    keys: HashMap<String, String>,
}

/// Longest text that is read: a million grids have less.
const LONGEST: u64 = 1 << 30;

/// Finds the field and its steps.
pub(crate) fn plan(files: &Files, spec: &SourceSpec) -> Result<Plan> {
    let dumps: Vec<(PathBuf, Result<Dump>)> = files
        .entries
        .iter()
        .map(|e| {
            let base = base(&e.path);
            let dump = Dump::read(&base);
            (base, dump)
        })
        .collect();
    let mut first = None;
    for (base, dump) in &dumps {
        if let Ok(dump) = dump {
            first = Some((base, dump));
            break;
        }
    }
    let Some((path, dump)) = first else {
        let why = dumps.into_iter().find_map(|(_, dump)| dump.err());
        return Err(why.unwrap_or_else(|| Error::format("", "no files", "a file, a folder or a pattern")));
    };
    let candidates = dump.fields(path)?;
    let asked = files.dataset.as_deref().or(spec.field.as_deref()).map(|a| a.rsplit('/').next().unwrap_or(a));
    let field = candidates[choose(path, &candidates, asked)?].name.clone();
    let mut info = SeriesInfo {
        layout: "Enzo".into(),
        series: dumps.iter().map(|(base, _)| base.clone()).collect(),
        units: dump.units_of(&field),
        field: field.clone(),
        candidates,
        ..SeriesInfo::default()
    };
    let mut found: Vec<Found> = Vec::new();
    for ((base, dump), entry) in dumps.iter().zip(&files.entries) {
        let (time, mesh) = match dump {
            Ok(dump) => (dump.number("InitialTime"), dump.mesh(base, &field)),
            Err(Error::Format { found, .. }) => (None, Err(found.clone())),
            Err(why) => (None, Err(why.to_string())),
        };
        let step = entry.number.unwrap_or(found.len() as u64);
        found.push(Found { step, time, mesh, file: base.clone() });
    }
    let (grid, level, steps) = mesh::steps(found, spec.level, &mut info.warnings)
        .map_err(|why| Error::format(path, why, "the complete output: parameters, .hierarchy and .cpu files"))?;
    (info.grid, info.level) = (grid, Some(level));
    Ok(Plan { info, steps, start: 0.0 })
}

/// The parameter file that any file of an output belongs to.
fn base(path: &Path) -> PathBuf {
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    match name.split_once('.') {
        Some((stem, _)) => path.with_file_name(stem),
        None => path.to_owned(),
    }
}

fn text(path: &Path) -> Result<String> {
    if let Some(problem) = super::file_problem(path) {
        return Err(problem);
    }
    let length = std::fs::metadata(path).map_err(|e| Error::io(path, e))?.len();
    if length > LONGEST {
        return Err(Error::format(path, format!("{length} bytes of text"), "the .hierarchy of an Enzo output"));
    }
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

/// `Key = value` of a line.
fn pair(line: &str) -> Option<(&str, &str)> {
    let (key, value) = line.split_once('=')?;
    Some((key.trim(), value.trim()))
}

fn numbers(text: &str) -> Option<Vec<f64>> {
    text.split_whitespace().map(|w| w.parse().ok()).collect()
}

impl Grid {
    fn three(&self, key: &str) -> Result<[f64; 3], String> {
        let read = self.keys.get(key).and_then(|t| numbers(t)).and_then(|v| <[f64; 3]>::try_from(v).ok());
        read.filter(|v| v.iter().all(|n| n.is_finite()))
            .ok_or_else(|| format!("Grid = {} of the .hierarchy has no three numbers {key}", self.id))
    }

    /// Active cells along x, y, z.
    fn size(&self) -> Result<[usize; 3], String> {
        let (first, last) = (self.three("GridStartIndex")?, self.three("GridEndIndex")?);
        if (0..3).any(|a| !(0.0..1e9).contains(&first[a]) || !(first[a]..1e9).contains(&last[a])) {
            return Err(format!("Grid = {} has no cells", self.id));
        }
        Ok(std::array::from_fn(|a| (last[a] - first[a]) as usize + 1))
    }

    /// The file with the values, by its own name: the folder that is written down is that of the run.
    fn file(&self, base: &Path) -> Option<PathBuf> {
        let name = self.keys.get("BaryonFileName")?;
        Some(base.with_file_name(Path::new(name).file_name()?))
    }
}

impl Dump {
    fn read(base: &Path) -> Result<Dump> {
        let name = base.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let parameters = text(base)?;
        let hierarchy = text(&base.with_file_name(format!("{name}.hierarchy")))?;
        let parameters = parameters.lines().filter_map(pair).map(|(k, v)| (k.to_owned(), v.to_owned())).collect();
        let mut grids: Vec<Grid> = Vec::new();
        for (key, value) in hierarchy.lines().filter(|l| !l.starts_with("Pointer")).filter_map(pair) {
            if key == "Grid" {
                grids.push(Grid { id: value.parse().unwrap_or(0), keys: HashMap::new() });
            } else if let Some(grid) = grids.last_mut() {
                grid.keys.insert(key.to_owned(), value.to_owned());
            }
        }
        Ok(Dump { parameters, grids })
    }

    fn number(&self, key: &str) -> Option<f64> {
        self.parameters.get(key)?.split_whitespace().next()?.parse().ok()
    }

    fn three(&self, key: &str) -> Option<[f64; 3]> {
        numbers(self.parameters.get(key)?)?.try_into().ok()
    }

    fn units_of(&self, field: &str) -> String {
        let index = (0..256).find(|i| self.parameters.get(&format!("DataLabel[{i}]")).is_some_and(|l| l == field));
        let units = index.and_then(|i| self.parameters.get(&format!("DataUnits[{i}]")));
        units.filter(|u| *u != "(null)" && *u != "none").cloned().unwrap_or_default()
    }

    /// Where a grid's field is: the dataset, in packed files under the grid's group.
    fn dataset(packed: bool, id: u64, field: &str) -> String {
        if packed { format!("/Grid{id:08}/{field}") } else { format!("/{field}") }
    }

    /// The fields of the first grid that has a file.
    fn fields(&self, base: &Path) -> Result<Vec<Candidate>> {
        let nothing =
            || Error::format(base, "Enzo output whose grids name no files with fields", "the complete output");
        let (grid, file) = self.grids.iter().find_map(|g| Some((g, g.file(base)?))).ok_or_else(nothing)?;
        let open = h5::open_file(&file, 0)?;
        let group = open.group(&format!("/Grid{:08}", grid.id)).or_else(|_| open.group("/"));
        let group = group.map_err(|e| Error::format(&file, format!("{e}"), ""))?;
        let mut all = Vec::new();
        for name in group.member_names().unwrap_or_default() {
            let Ok(dataset) = group.dataset(&name) else { continue };
            let dtype = h5::type_name(&dataset);
            if dataset.ndim() == 3 && !dtype.is_empty() {
                all.push(Candidate { name, shape: dataset.shape(), dtype, kind: "scalar".into() });
            }
        }
        Ok(all)
    }

    fn mesh(&self, base: &Path, field: &str) -> Result<Mesh, String> {
        let rank = self.number("TopGridRank").unwrap_or(3.0);
        if rank != 3.0 {
            return Err(format!("TopGridRank = {rank}; meshes of three axes are read"));
        }
        let cells = self.three("TopGridDimensions").filter(|n| n.iter().all(|n| (1.0..1e9).contains(n)));
        let cells = cells.ok_or("no usable TopGridDimensions")?;
        let least = self.three("DomainLeftEdge").unwrap_or([0.0; 3]);
        let most = self.three("DomainRightEdge").unwrap_or([1.0; 3]);
        let by = self.number("RefineBy").filter(|r| (2.0..1e3).contains(r)).unwrap_or(2.0);
        let spacing: [f64; 3] = std::array::from_fn(|a| (most[a] - least[a]) / cells[a]);
        // All grids of an output are kept in the same way: the first tells whether files are packed, and have ghost zones.
        let mut kept: Option<(bool, bool)> = None;
        let mut there: HashMap<PathBuf, bool> = HashMap::new();
        let (mut patches, mut finest) = (Vec::new(), 0);
        for grid in &self.grids {
            let Some(file) = grid.file(base) else { continue };
            if !*there.entry(file.clone()).or_insert_with(|| file.is_file()) {
                return Err(format!("{}, which has Grid = {}, is missing", file.display(), grid.id));
            }
            let (size, low, high) = (grid.size()?, grid.three("GridLeftEdge")?, grid.three("GridRightEdge")?);
            let ghosts = grid.three("GridStartIndex")?.map(|n| n as usize);
            let cell: [f64; 3] = std::array::from_fn(|a| (high[a] - low[a]) / size[a] as f64);
            let level = (spacing[0] / cell[0]).log(by).round();
            if !(0.0..40.0).contains(&level) {
                return Err(format!("Grid = {} has cells of {}, the top grid of {}", grid.id, cell[0], spacing[0]));
            }
            let fine = by.powf(level);
            let mut start = [0; 3];
            for a in 0..3 {
                let at = ((low[a] - least[a]) / spacing[a] * fine).round();
                let fits = (spacing[a] / cell[a] / fine - 1.0).abs() < 1e-3 && (0.0..1e15).contains(&at);
                if !fits {
                    return Err(format!("Grid = {} lies askew to the top grid", grid.id));
                }
                start[a] = at as usize;
            }
            let (packed, ghostly) = match kept {
                Some(kept) => kept,
                None => {
                    let open = h5::open_file(&file, 0).map_err(|e| e.to_string())?;
                    let packed = open.group(&format!("/Grid{:08}", grid.id)).is_ok();
                    let shape = open.dataset(&Dump::dataset(packed, grid.id, field)).map(|d| d.shape());
                    let shape = shape.map_err(|e| format!("{}: no {field} ({e})", file.display()))?;
                    let whole = [size[2], size[1], size[0]];
                    let ghostly = shape != whole;
                    *kept.insert((packed, ghostly))
                }
            };
            let values = Values::Hdf5(h5::Slab {
                dataset: Dump::dataset(packed, grid.id, field),
                file,
                rank: 3,
                space: [2, 1, 0],
                fixed: Vec::new(),
                start: if ghostly { ghosts } else { [0; 3] },
                whole: !ghostly,
                packing: h5::Packing::default(),
            });
            finest = finest.max(level as usize);
            patches.push(Patch { level: level as usize, start, size, values });
        }
        let size = cells.map(|n| n as usize);
        // An axis of one cell is not refined.
        let ratio = std::array::from_fn(|a| if size[a] > 1 { by as usize } else { 1 });
        Mesh::new(Levels { corner: least, spacing, size, ratios: vec![ratio; finest] }, patches)
    }
}
