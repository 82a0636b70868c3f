//! Chombo files, and AMReX plotfiles in HDF5, which follow them: groups `level_n` with `boxes` of inclusive cell indices, and
//! `data:datatype=0`, in which the components of one box after another stand, x fastest.

use std::path::Path;

use hdf5::{File, Group, H5Type};

use super::attributes::{number, numbers, numbers_in, text};
use super::{Flat, Input, asked, blocks};
use crate::error::{Error, Result};
use crate::source::choose::choose;
use crate::source::mesh::{Levels, Mesh, Patch};
use crate::source::series::Plan;
use crate::source::values::Values;
use crate::source::{Candidate, SeriesInfo};

/// A box of cells, both ends included.
#[derive(H5Type, Clone, Copy)]
#[repr(C)]
struct Box3 {
    lo_i: i32,
    lo_j: i32,
    lo_k: i32,
    hi_i: i32,
    hi_j: i32,
    hi_k: i32,
}

/// Three whole numbers.
#[derive(H5Type, Clone, Copy)]
#[repr(C)]
struct Vect3 {
    intvecti: i32,
    intvectj: i32,
    intvectk: i32,
}

impl Box3 {
    fn lo(&self) -> [i64; 3] {
        [self.lo_i, self.lo_j, self.lo_k].map(i64::from)
    }

    fn hi(&self) -> [i64; 3] {
        [self.hi_i, self.hi_j, self.hi_k].map(i64::from)
    }

    fn size(&self) -> Option<[usize; 3]> {
        let (lo, hi) = (self.lo(), self.hi());
        (0..3).all(|a| hi[a] >= lo[a]).then(|| std::array::from_fn(|a| (hi[a] - lo[a] + 1) as usize))
    }
}

/// Three lengths.
#[derive(H5Type, Clone, Copy)]
#[repr(C)]
struct Real3 {
    x: f64,
    y: f64,
    z: f64,
}

/// Boxes of a level at most: a hundred times what runs have.
const MOST: usize = 1 << 22;

/// Whether a file bears the marks.
pub(crate) fn is(file: &File) -> bool {
    file.link_exists("level_0") && (file.link_exists("Chombo_global") || file.attr("num_components").is_ok())
}

/// Finds the component and its steps.
pub(crate) fn plan(input: Input) -> Result<Plan> {
    let path = input.entry.path.clone();
    let space = input.file.group("Chombo_global").ok().and_then(|g| number(&g, "SpaceDim"));
    let space = space.or_else(|| number(&input.file, "dim"));
    if space.is_some_and(|d| d != 3.0) {
        let found = format!("a mesh of {} axes in space", space.unwrap_or_default());
        return Err(Error::format(path, found, "a run in three dimensions"));
    }
    let count = number(&input.file, "num_components").unwrap_or(0.0) as usize;
    let names: Vec<String> = (0..count.min(4096))
        .map(|n| text(&input.file, &format!("component_{n}")).unwrap_or_else(|| format!("component_{n}")))
        .collect();
    let dtype = input.file.dataset("level_0/data:datatype=0").map(|d| super::tree::type_name(&d)).unwrap_or_default();
    let domain = input.file.group("level_0").ok().and_then(|g| box_attribute(&g, "prob_domain")?.size());
    let shape = domain.map(|[x, y, z]| vec![z, y, x]).unwrap_or_default();
    let candidate = |name: &String| Candidate {
        name: name.clone(),
        shape: shape.clone(),
        dtype: dtype.clone(),
        kind: "scalar".into(),
    };
    let candidates: Vec<Candidate> = names.iter().map(candidate).collect();
    let component = choose(&path, &candidates, asked(input.files, input.spec))?;
    let plotfile = text(&input.file, "plotfile_type").is_some();
    let about = SeriesInfo {
        layout: if plotfile { "AMReX plotfile in HDF5" } else { "Chombo" }.into(),
        field: names[component].clone(),
        candidates,
        ..SeriesInfo::default()
    };
    blocks::plan(input, about, |file, path| (time(file), mesh(file, path, component, count)))
}

fn time(file: &File) -> Option<f64> {
    number(file, "time").or_else(|| number(&*file.group("level_0").ok()?, "time"))
}

fn box_attribute(group: &Group, name: &str) -> Option<Box3> {
    group.attr(name).ok()?.read_raw::<Box3>().ok()?.first().copied()
}

/// Three numbers of a level, as an array or a compound, or one for all axes.
fn along(group: &Group, names: &[&str]) -> Option<[f64; 3]> {
    names.iter().find_map(|n| {
        let Some(read) = numbers(group, n) else {
            let read = group.attr(n).ok()?.read_raw::<Real3>().ok()?;
            return read.first().map(|v| [v.x, v.y, v.z]);
        };
        match read.as_slice() {
            [one] => Some([*one; 3]),
            [x, y, z] => Some([*x, *y, *z]),
            _ => None,
        }
    })
}

/// Cells of the next level in a cell of this one: a number, or a compound of three.
fn ratio(group: &Group) -> Option<[usize; 3]> {
    let three = || {
        let read = group.attr("vec_ref_ratio").ok()?.read_raw::<Vect3>().ok()?;
        read.first().map(|v| [v.intvecti, v.intvectj, v.intvectk].map(f64::from))
    };
    let found = along(group, &["ref_ratio"]).or_else(three)?;
    found.iter().all(|r| (1.0..1e6).contains(r)).then(|| found.map(|r| r as usize))
}

fn ghosts(file: &File) -> [usize; 3] {
    let attributes = file.group("level_0/data_attributes");
    let told = attributes.ok().and_then(|g| g.attr("outputGhost").ok()?.read_raw::<Vect3>().ok()?.first().copied());
    told.map_or([0; 3], |g| [g.intvecti, g.intvectj, g.intvectk].map(|n| n.clamp(0, 64) as usize))
}

fn mesh(file: &File, path: &Path, component: usize, components: usize) -> Result<Mesh, String> {
    if let Some(odd) = number(file, "coordinate_system").filter(|c| *c != 0.0) {
        return Err(format!("coordinate_system {odd}; cartesian meshes (0) are read"));
    }
    let level = |n: usize| file.group(&format!("level_{n}"));
    let first = level(0).map_err(|e| format!("no level_0 ({e})"))?;
    let domain = box_attribute(&first, "prob_domain").ok_or("level_0 has no prob_domain")?;
    let size = domain.size().ok_or("prob_domain is empty")?;
    let spacing = along(&first, &["Vec_dx", "vec_dx", "dx"]).ok_or("level_0 has no dx")?;
    let low = domain.lo();
    let corner = along(&first, &["prob_lo"]);
    let corner = corner.unwrap_or_else(|| std::array::from_fn(|a| low[a] as f64 * spacing[a]));
    let told = number(file, "num_levels").filter(|n| (1.0..64.0).contains(n)).map_or(64, |n| n as usize);
    let ghosts = ghosts(file);
    let (mut ratios, mut patches) = (Vec::new(), Vec::new());
    // The lower corner of the domain in cells of the level.
    let mut low = low;
    for n in 0..told {
        if level(n).is_err() {
            break;
        }
        if n > 0 {
            let before =
                level(n - 1).ok().and_then(|g| ratio(&g)).ok_or_else(|| format!("level_{} has no ref_ratio", n - 1))?;
            (0..3).for_each(|a| low[a] *= before[a] as i64);
            ratios.push(before);
        }
        let name = format!("level_{n}/boxes");
        let boxes = file.dataset(&name).map_err(|e| format!("{name}: {e}"))?;
        if boxes.size() > MOST {
            return Err(format!("{name} claims {} boxes", boxes.size()));
        }
        let boxes = boxes.read_raw::<Box3>().map_err(|e| format!("{name} does not hold boxes of three axes ({e})"))?;
        // One dataset a component, or all components of a box one after the other.
        let apart = file.link_exists(&format!("level_{n}/data:datatype=1"));
        let (each, skip) = if apart { (1, 0) } else { (components, component) };
        let dataset = format!("level_{n}/data:datatype={}", if apart { component } else { 0 });
        let listed = file.dataset(&format!("level_{n}/data:offsets=0")).ok().and_then(|d| numbers_in(&d));
        let mut next = 0usize;
        for (b, cells) in boxes.iter().enumerate() {
            let size = cells.size().ok_or_else(|| format!("{name}: box {b} is empty"))?;
            let stored: [usize; 3] = std::array::from_fn(|a| size[a] + 2 * ghosts[a]);
            let count = stored
                .iter()
                .try_fold(1usize, |n, &l| n.checked_mul(l))
                .ok_or_else(|| format!("{name}: box {b} is too large"))?;
            let from = match &listed {
                Some(offsets) => *offsets.get(b).ok_or_else(|| format!("level_{n} has no offset of box {b}"))? as usize,
                None => next,
            };
            next = count.checked_mul(each).and_then(|n| n.checked_add(from)).ok_or("offsets that cannot be counted")?;
            let lo = cells.lo();
            if (0..3).any(|a| lo[a] < low[a]) {
                return Err(format!("{name}: box {b} begins outside of the domain"));
            }
            let offset =
                count.checked_mul(skip).and_then(|n| n.checked_add(from)).ok_or("offsets that cannot be counted")?;
            patches.push(Patch {
                level: n,
                start: std::array::from_fn(|a| (lo[a] - low[a]) as usize),
                size,
                values: Values::Flat(Flat { file: path.to_owned(), dataset: dataset.clone(), offset, stored, ghosts }),
            });
        }
    }
    Mesh::new(Levels { corner, spacing, size, ratios }, patches)
}
