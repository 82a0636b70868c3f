//! Athena++ (`.athdf`): mesh blocks (variable, block, z, y, x) and where each sits.

use std::path::Path;

use hdf5::File;

use super::attributes::{number, numbers, numbers_in, texts};
use super::blocks::{self, block};
use super::{Input, asked};
use crate::error::{Error, Result};
use crate::source::choose::choose;
use crate::source::coords::{self, Along};
use crate::source::mesh::{Levels, Mesh, Patch};
use crate::source::series::Plan;
use crate::source::{Candidate, SeriesInfo};

/// A variable: its dataset and its place on the leading axis.
struct Variable {
    candidate: Candidate,
    dataset: String,
    index: usize,
}

/// Finds the variable and its steps.
pub(crate) fn plan(input: Input) -> Result<Plan> {
    let path = input.entry.path.clone();
    let variables = variables(&input.file);
    if variables.is_empty() {
        return Err(Error::format(path, "Athena++ output without variables", "an output of prim or cons variables"));
    }
    let candidates: Vec<Candidate> = variables.iter().map(|v| v.candidate.clone()).collect();
    let variable = &variables[choose(&path, &candidates, asked(input.files, input.spec))?];
    let ends: [Option<Vec<f64>>; 3] =
        std::array::from_fn(|a| numbers(&input.file, &format!("RootGridX{}", a + 1)).filter(|v| v.len() >= 3));
    let root = numbers(&input.file, "RootGridSize").unwrap_or_default();
    let about = SeriesInfo {
        layout: "Athena++".into(),
        field: variable.candidate.name.clone(),
        candidates,
        ..Default::default()
    };
    let mut plan = blocks::plan(input, about, |file, path| (number(file, "Time"), mesh(file, path, variable)))?;
    let size = plan.info.grid.size;
    // A mesh with longer axes is refused later on; its faces need no room before.
    if ends.iter().flatten().any(|e| e[2] != 1.0) && size.iter().all(|n| *n <= 1 << 24) {
        let along = std::array::from_fn(|a| {
            let [least, most, ratio] = ends[a].as_deref().map_or([0.0, 1.0, 1.0], |e| [e[0], e[1], e[2]]);
            Along::cells(&faces(least, most, ratio, root.get(a).copied().unwrap_or(1.0), size[a]))
        });
        coords::place(&mut plan.info.grid, along, &mut plan.info.warnings);
        plan.steps.iter_mut().for_each(|s| s.grid = None);
    }
    Ok(plan)
}

/// Faces of `cells` even parts of the logical axis, on which each of `root` cells is `ratio` times as wide as the one before.
fn faces(least: f64, most: f64, ratio: f64, root: f64, cells: usize) -> Vec<f64> {
    let place = |at: f64| if ratio == 1.0 { at } else { (ratio.powf(at * root) - 1.0) / (ratio.powf(root) - 1.0) };
    (0..=cells).map(|i| least + (most - least) * place(i as f64 / cells as f64)).collect()
}

fn variables(file: &File) -> Vec<Variable> {
    let (sets, names) =
        (texts(file, "DatasetNames").unwrap_or_default(), texts(file, "VariableNames").unwrap_or_default());
    let counts = numbers(file, "NumVariables").unwrap_or_default();
    let mut names = names.into_iter();
    let mut all = Vec::new();
    for (dataset, count) in sets.into_iter().zip(counts) {
        let Ok(stored) = file.dataset(&dataset) else { continue };
        let (shape, dtype) = (stored.shape(), super::tree::type_name(&stored));
        for (index, name) in names.by_ref().take(count as usize).enumerate() {
            let candidate = Candidate {
                name,
                shape: shape.get(1..).unwrap_or_default().to_vec(),
                dtype: dtype.clone(),
                kind: "scalar".into(),
            };
            all.push(Variable { candidate, dataset: dataset.clone(), index });
        }
    }
    all
}

fn mesh(file: &File, path: &Path, variable: &Variable) -> Result<Mesh, String> {
    let lengths = |name: &str| -> Result<[usize; 3], String> {
        let read = numbers(file, name).filter(|v| v.len() == 3 && v.iter().all(|n| *n >= 1.0 && *n < 1e9));
        read.map(|v| [v[0] as usize, v[1] as usize, v[2] as usize]).ok_or_else(|| format!("no usable {name}"))
    };
    let (root, size) = (lengths("RootGridSize")?, lengths("MeshBlockSize")?);
    let coordinates = texts(file, "Coordinates").map(|t| t.concat()).unwrap_or_else(|| "cartesian".into());
    if coordinates != "cartesian" && coordinates != "minkowski" {
        return Err(format!("coordinates `{coordinates}`; cartesian ones are read"));
    }
    let list = |name: &str| file.dataset(name).ok().and_then(|d| numbers_in(&d)).ok_or_else(|| format!("no {name}"));
    let (levels, places) = (list("Levels")?, list("LogicalLocations")?);
    if places.len() != 3 * levels.len() || levels.iter().any(|l| !(0.0..20.0).contains(l)) {
        return Err(format!("{} Levels and {} LogicalLocations do not agree", levels.len(), places.len()));
    }
    let finest = levels.iter().fold(0.0, |a: f64, b| a.max(*b)) as usize;
    let bounds = |a: usize| {
        numbers(file, &format!("RootGridX{}", a + 1)).filter(|v| v.len() >= 2).map_or([0.0, 1.0], |v| [v[0], v[1]])
    };
    // An axis of one cell is not refined.
    let ratio = root.map(|n| if n > 1 { 2 } else { 1 });
    let over = Levels {
        corner: std::array::from_fn(|a| bounds(a)[0]),
        spacing: std::array::from_fn(|a| (bounds(a)[1] - bounds(a)[0]) / root[a] as f64),
        size: root,
        ratios: vec![ratio; finest],
    };
    let patch = |(n, (level, at)): (usize, (&f64, &[f64]))| Patch {
        level: *level as usize,
        start: std::array::from_fn(|a| (at[a] as usize).saturating_mul(size[a])),
        size,
        values: block(path, &variable.dataset, vec![(0, variable.index), (1, n)]),
    };
    Mesh::new(over, levels.iter().zip(places.chunks_exact(3)).enumerate().map(patch).collect())
}
