//! FLASH plot and checkpoint files: blocks (block, z, y, x), each with its bounding box; refined meshes are brought to
//! the finest level, each coarse value repeated.

use hdf5::types::FixedAscii;
use hdf5::{File, H5Type};

use super::attributes::numbers_in;
use super::tree::type_name;
use super::{Input, Packing, Slab, asked};
use crate::error::{Error, Result};
use crate::grid::Region;
use crate::source::choose::choose;
use crate::source::series::{Plan, Step};
use crate::source::values::Values;
use crate::source::{Candidate, GridInfo, SeriesInfo, shape_text};

/// A row of the table `real scalars`.
#[derive(H5Type, Clone, Copy)]
#[repr(C)]
struct Scalar {
    name: FixedAscii<80>,
    value: f64,
}

/// The leaf blocks of one file on a grid of the finest cells.
struct Mesh {
    grid: GridInfo,
    /// Cells of a block along x, y, z.
    block: [usize; 3],
    /// Number in the file, first fine cell and fine cells for each cell, of each leaf.
    leaves: Vec<(usize, [usize; 3], usize)>,
}

/// Whether a file bears the marks.
pub(crate) fn is(file: &File) -> bool {
    file.link_exists("bounding box") && file.link_exists("unknown names")
}

/// Finds the variable and its steps.
pub(crate) fn plan(mut input: Input) -> Result<Plan> {
    let path = input.entry.path.clone();
    let variables: Vec<Candidate> = input
        .file
        .datasets()
        .unwrap_or_default()
        .iter()
        .filter(|d| d.ndim() == 4 && !type_name(d).is_empty())
        .map(|d| Candidate {
            name: d.name().trim_start_matches('/').to_owned(),
            shape: d.shape(),
            dtype: type_name(d),
            kind: "scalar".into(),
        })
        .collect();
    let variable = variables[choose(&path, &variables, asked(input.files, input.spec))?].clone();
    let mesh = Mesh::read(&input.file, &variable)
        .map_err(|why| Error::format(&path, why, "a cartesian mesh of three axes"))?;
    let coarsest = mesh.leaves.iter().map(|l| l.2).max().unwrap_or(1);
    if coarsest > 1 {
        let fine = shape_text(&mesh.grid.size);
        input.warnings.push(format!(
            "a refined mesh is brought to its finest level, {fine}: coarse values repeat up to {coarsest} times"
        ));
    }
    let mut steps: Vec<Step> = Vec::new();
    for entry in &input.files.entries {
        let own = super::reopen(entry, input.entry, &input.file, &mut input.warnings);
        let read = own.as_ref().map_or(Err("cannot be opened".into()), |f| Mesh::read(f, &variable));
        let (values, grid) = match read {
            Ok(own) => (own.values(&variable, entry.path.clone()), Some(own.grid)),
            Err(why) => (Values::Broken(entry.path.clone(), why, "the complete file".into()), None),
        };
        let step = entry.number.unwrap_or(steps.len() as u64);
        steps.push(Step { step, time: own.as_ref().and_then(time), grid, values });
    }
    let info = SeriesInfo {
        layout: "FLASH".into(),
        series: input.paths(),
        field: variable.name.clone(),
        candidates: variables,
        grid: mesh.grid,
        steps: Vec::new(),
        range: None,
        warnings: input.warnings,
    };
    Ok(Plan { info, steps, start: 0.0 })
}

fn time(file: &File) -> Option<f64> {
    let rows = file.dataset("real scalars").ok()?.read_raw::<Scalar>().ok()?;
    rows.iter().find(|r| r.name.as_str().trim() == "time").map(|r| r.value)
}

impl Mesh {
    fn read(file: &File, variable: &Candidate) -> Result<Mesh, String> {
        let list = |name: &str| file.dataset(name).ok().and_then(|d| numbers_in(&d));
        let shape =
            file.dataset(&variable.name).map(|d| d.shape()).map_err(|_| format!("no dataset {}", variable.name))?;
        let &[count, nz, ny, nx] = shape.as_slice() else {
            return Err(format!("{} is {}", variable.name, shape_text(&shape)));
        };
        let boxes =
            list("bounding box").filter(|b| b.len() == 6 * count).ok_or("its bounding box does not fit its blocks")?;
        let kinds = list("node type").filter(|k| k.len() == count);
        let block = [nx, ny, nz];
        if block.contains(&0) {
            return Err(format!("{} is {}: no values", variable.name, shape_text(&shape)));
        }
        let leaves: Vec<usize> = (0..count).filter(|&b| kinds.as_ref().is_none_or(|k| k[b] == 1.0)).collect();
        let bound = |b: usize, a: usize, side: usize| boxes[6 * b + 2 * a + side];
        let cell = |b: usize, a: usize| (bound(b, a, 1) - bound(b, a, 0)) / block[a] as f64;
        let across = |pick: fn(f64, f64) -> f64, of: &dyn Fn(usize) -> f64| leaves.iter().map(|&b| of(b)).reduce(pick);
        let (mut corner, mut spacing, mut size) = ([0.0; 3], [0.0; 3], [0usize; 3]);
        for a in 0..3 {
            let least = across(f64::min, &|b| bound(b, a, 0)).ok_or("no leaf blocks")?;
            let most = across(f64::max, &|b| bound(b, a, 1)).ok_or("no leaf blocks")?;
            let fine = across(f64::min, &|b| cell(b, a))
                .filter(|d| d.is_finite() && *d > 0.0)
                .ok_or("blocks without extent")?;
            (corner[a], spacing[a], size[a]) = (least, fine, ((most - least) / fine).round() as usize);
        }
        let mut placed = Vec::new();
        for b in leaves {
            let times = (cell(b, 0) / spacing[0]).round() as usize;
            let at: [usize; 3] = std::array::from_fn(|a| ((bound(b, a, 0) - corner[a]) / spacing[a]).round() as usize);
            let ends = |a: usize| times.checked_mul(block[a]).and_then(|n| n.checked_add(at[a]));
            if times == 0 || !(0..3).all(|a| ends(a).is_some_and(|end| end <= size[a])) {
                return Err(format!("block {b} lies outside of the mesh"));
            }
            placed.push((b, at, times));
        }
        let origin = std::array::from_fn(|a| corner[a] + 0.5 * spacing[a]);
        let grid = GridInfo { size, spacing, origin, units: String::new(), centering: "cell".into() };
        Ok(Mesh { grid, block, leaves: placed })
    }

    fn values(&self, variable: &Candidate, file: std::path::PathBuf) -> Values {
        let leaf = |&(number, start, times): &(usize, [usize; 3], usize)| {
            let stored = Values::Hdf5(Slab {
                file: file.clone(),
                dataset: variable.name.clone(),
                rank: 4,
                space: [3, 2, 1],
                fixed: vec![(0, number)],
                start: [0; 3],
                whole: true,
                packing: Packing::default(),
            });
            let region = Region { start, size: self.block.map(|n| n * times) };
            (region, if times == 1 { stored } else { Values::Repeated(Box::new(stored), [times; 3]) })
        };
        Values::Blocks(self.leaves.iter().map(leaf).collect())
    }
}
