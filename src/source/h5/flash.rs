//! FLASH plot and checkpoint files: blocks (block, z, y, x), each with its bounding box; leaves of the tree are read.

use std::path::Path;

use hdf5::types::FixedAscii;
use hdf5::{File, H5Type};

use super::attributes::numbers_in;
use super::blocks::{self, block, whole};
use super::tree::type_name;
use super::{Input, asked};
use crate::error::Result;
use crate::source::choose::choose;
use crate::source::mesh::{Levels, Mesh, Patch};
use crate::source::series::Plan;
use crate::source::{Candidate, SeriesInfo, shape_text};

/// A row of the table `real scalars`.
#[derive(H5Type, Clone, Copy)]
#[repr(C)]
struct Scalar {
    name: FixedAscii<80>,
    value: f64,
}

/// Whether a file bears the marks.
pub(crate) fn is(file: &File) -> bool {
    file.link_exists("bounding box") && file.link_exists("unknown names")
}

/// Finds the variable and its steps.
pub(crate) fn plan(input: Input) -> Result<Plan> {
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
    let about = SeriesInfo {
        layout: "FLASH".into(),
        field: variable.name.clone(),
        candidates: variables,
        ..SeriesInfo::default()
    };
    blocks::plan(input, about, |file, path| (time(file), mesh(file, path, &variable)))
}

fn time(file: &File) -> Option<f64> {
    let rows = file.dataset("real scalars").ok()?.read_raw::<Scalar>().ok()?;
    rows.iter().find(|r| r.name.as_str().trim() == "time").map(|r| r.value)
}

fn mesh(file: &File, path: &Path, variable: &Candidate) -> Result<Mesh, String> {
    let list = |name: &str| file.dataset(name).ok().and_then(|d| numbers_in(&d));
    let shape = file.dataset(&variable.name).map(|d| d.shape()).map_err(|_| format!("no dataset {}", variable.name))?;
    let &[count, nz, ny, nx] = shape.as_slice() else {
        return Err(format!("{} is {}", variable.name, shape_text(&shape)));
    };
    let size = [nx, ny, nz];
    if size.contains(&0) || count == 0 {
        return Err(format!("{} is {}: no values", variable.name, shape_text(&shape)));
    }
    let boxes = list("bounding box").filter(|b| Some(b.len()) == count.checked_mul(6));
    let boxes = boxes.ok_or("its bounding box does not fit its blocks")?;
    if boxes.iter().any(|b| !b.is_finite()) {
        return Err("its bounding box is not finite".into());
    }
    let kinds = list("node type").filter(|k| k.len() == count);
    let bound = |b: usize, a: usize, side: usize| boxes[6 * b + 2 * a + side];
    let cell = |b: usize, a: usize| (bound(b, a, 1) - bound(b, a, 0)) / size[a] as f64;
    let across = |pick: fn(f64, f64) -> f64, of: &dyn Fn(usize) -> f64| (0..count).map(of).reduce(pick).unwrap_or(0.0);
    // The root of the tree is in the file, so that level 0 is the same in every step.
    let widest: [f64; 3] = std::array::from_fn(|a| across(f64::max, &|b| cell(b, a)));
    let corner: [f64; 3] = std::array::from_fn(|a| across(f64::min, &|b| bound(b, a, 0)));
    let far: [f64; 3] = std::array::from_fn(|a| across(f64::max, &|b| bound(b, a, 1)));
    let mut root = [0; 3];
    for a in 0..3 {
        if !(0..count).all(|b| cell(b, a) > 0.0) {
            return Err("blocks without extent".into());
        }
        root[a] = whole((far[a] - corner[a]) / widest[a]).ok_or("its blocks do not fill a box")?;
    }
    let level = |b: usize| -> Option<usize> {
        let ratio = whole(widest[0] / cell(b, 0)).filter(|r| r.is_power_of_two())?;
        Some(ratio.trailing_zeros() as usize)
    };
    let leaves = (0..count).filter(|&b| kinds.as_ref().is_none_or(|k| k[b] == 1.0));
    let mut patches = Vec::new();
    for b in leaves {
        let level = level(b).ok_or_else(|| format!("block {b} is not 1, 2, 4, … times finer than the coarsest"))?;
        let mut start = [0; 3];
        for a in 0..3 {
            start[a] =
                whole((bound(b, a, 0) - corner[a]) / cell(b, a)).ok_or_else(|| format!("block {b} lies askew"))?;
        }
        patches.push(Patch { level, start, size, values: block(path, &variable.name, vec![(0, b)]) });
    }
    let finest = patches.iter().map(|p| p.level).max().unwrap_or(0);
    Mesh::new(Levels { corner, spacing: widest, size: root, ratios: vec![[2; 3]; finest] }, patches)
}
