//! Athena++ (`.athdf`): mesh blocks (variable, block, z, y, x) and where each sits; refined meshes are brought to the
//! finest level, each coarse value repeated.

use hdf5::File;

use super::attributes::{number, numbers, numbers_in, texts};
use super::{Input, Packing, Slab, asked};
use crate::error::{Error, Result};
use crate::grid::Region;
use crate::source::choose::choose;
use crate::source::series::{Plan, Step};
use crate::source::values::Values;
use crate::source::{Candidate, GridInfo, SeriesInfo, shape_text};

/// A variable: its dataset and its place on the leading axis.
struct Variable {
    candidate: Candidate,
    dataset: String,
    index: usize,
}

/// The mesh of one file.
struct Mesh {
    /// Values of the finest level along x, y, z.
    size: [usize; 3],
    block: [usize; 3],
    /// Level, and place in blocks of that level, of each block.
    blocks: Vec<(u32, [usize; 3])>,
    finest: u32,
    /// Corner and far corner.
    bounds: [[f64; 2]; 3],
}

/// Finds the variable and its steps.
pub(crate) fn plan(mut input: Input) -> Result<Plan> {
    let path = input.entry.path.clone();
    let variables = variables(&input.file);
    if variables.is_empty() {
        return Err(Error::format(path, "Athena++ output without variables", "an output of prim or cons variables"));
    }
    let candidates: Vec<Candidate> = variables.iter().map(|v| v.candidate.clone()).collect();
    let variable = &variables[choose(&path, &candidates, asked(input.files, input.spec))?];
    let mesh =
        Mesh::read(&input.file).map_err(|why| Error::format(&path, why, "a uniform or refined cartesian mesh"))?;
    if mesh.finest > 0 {
        let fine = shape_text(&mesh.size);
        input.warnings.push(format!(
            "a mesh of {} levels is brought to its finest, {fine}: coarse values repeat",
            mesh.finest + 1
        ));
    }
    let uneven = (1..=3)
        .any(|a| numbers(&input.file, &format!("RootGridX{a}")).is_some_and(|v| v.get(2).is_some_and(|r| *r != 1.0)));
    if uneven {
        input.warnings.push("the mesh is uneven (RootGridX ratio is not 1): its mean spacing is taken".into());
    }
    let mut steps: Vec<Step> = Vec::new();
    for entry in &input.files.entries {
        let own = super::reopen(entry, input.entry, &input.file, &mut input.warnings);
        let read = own.as_ref().map(|f| (Mesh::read(f), number(f, "Time")));
        let (values, time, grid) = match read {
            None => {
                (Values::Broken(entry.path.clone(), "cannot be opened".into(), "the complete file".into()), None, None)
            }
            Some((Err(why), time)) => (Values::Broken(entry.path.clone(), why, String::new()), time, None),
            // The finest level may come and go: its grid stays that of the first step.
            Some((Ok(own), time)) => (own.values(variable, entry.path.clone()), time, Some(own.grid())),
        };
        steps.push(Step { step: entry.number.unwrap_or(steps.len() as u64), time, grid, values });
    }
    let info = SeriesInfo {
        layout: "Athena++".into(),
        series: input.paths(),
        field: variable.candidate.name.clone(),
        candidates,
        grid: mesh.grid(),
        steps: Vec::new(),
        range: None,
        warnings: input.warnings,
    };
    Ok(Plan { info, steps, start: 0.0 })
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

impl Mesh {
    fn read(file: &File) -> Result<Mesh, String> {
        let lengths = |name: &str| -> Result<[usize; 3], String> {
            let read = numbers(file, name).filter(|v| v.len() == 3 && v.iter().all(|n| *n >= 1.0 && *n < 1e9));
            read.map(|v| [v[0] as usize, v[1] as usize, v[2] as usize]).ok_or_else(|| format!("no usable {name}"))
        };
        let (root, block) = (lengths("RootGridSize")?, lengths("MeshBlockSize")?);
        let coordinates = texts(file, "Coordinates").map(|t| t.concat()).unwrap_or_else(|| "cartesian".into());
        if coordinates != "cartesian" && coordinates != "minkowski" {
            return Err(format!("coordinates `{coordinates}`; cartesian ones are read"));
        }
        let list =
            |name: &str| file.dataset(name).ok().and_then(|d| numbers_in(&d)).ok_or_else(|| format!("no {name}"));
        let (levels, places) = (list("Levels")?, list("LogicalLocations")?);
        if places.len() != 3 * levels.len() || levels.iter().any(|l| !(0.0..20.0).contains(l)) {
            return Err(format!("{} Levels and {} LogicalLocations do not agree", levels.len(), places.len()));
        }
        let finest = levels.iter().fold(0.0, |a: f64, b| a.max(*b)) as u32;
        let size = root.map(|n| n << finest);
        let place = |p: &[f64]| [p[0] as usize, p[1] as usize, p[2] as usize];
        let blocks: Vec<(u32, [usize; 3])> =
            levels.iter().zip(places.chunks_exact(3)).map(|(l, p)| (*l as u32, place(p))).collect();
        let inside = |(level, at): &(u32, [usize; 3])| {
            (0..3).all(|a| at[a].saturating_add(1).saturating_mul(block[a] << (finest - level)) <= size[a])
        };
        if !blocks.iter().all(inside) {
            return Err("a mesh block lies outside of the mesh".into());
        }
        let bounds = |a: usize| {
            numbers(file, &format!("RootGridX{}", a + 1)).filter(|v| v.len() >= 2).map_or([0.0, 1.0], |v| [v[0], v[1]])
        };
        Ok(Mesh { size, block, blocks, finest, bounds: std::array::from_fn(bounds) })
    }

    fn grid(&self) -> GridInfo {
        let spacing: [f64; 3] = std::array::from_fn(|a| (self.bounds[a][1] - self.bounds[a][0]) / self.size[a] as f64);
        let origin = std::array::from_fn(|a| self.bounds[a][0] + 0.5 * spacing[a]);
        GridInfo { size: self.size, spacing, origin, units: String::new(), centering: "cell".into() }
    }

    fn values(&self, variable: &Variable, file: std::path::PathBuf) -> Values {
        let block = |(n, (level, at)): (usize, &(u32, [usize; 3]))| {
            let times = 1 << (self.finest - level);
            let size = self.block.map(|b| b * times);
            let region = Region { start: std::array::from_fn(|a| at[a] * size[a]), size };
            let stored = Values::Hdf5(Slab {
                file: file.clone(),
                dataset: variable.dataset.clone(),
                rank: 5,
                space: [4, 3, 2],
                fixed: vec![(0, variable.index), (1, n)],
                start: [0; 3],
                whole: true,
                packing: Packing::default(),
            });
            (region, if times == 1 { stored } else { Values::Repeated(Box::new(stored), [times; 3]) })
        };
        Values::Blocks(self.blocks.iter().enumerate().map(block).collect())
    }
}
