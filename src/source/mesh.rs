//! Block-structured meshes: patches of cells on levels of refinement, brought to one level.
//!
//! A cell of level l + 1 is 1/r of a cell of level l along each axis, r being the ratio of the two. On the level that is shown
//! a coarser cell repeats r times, and finer ones give the mean of those that fall into a cell, weighted by volume; finer
//! patches win over coarser ones below them, so that no volume counts twice. What no patch covers is empty.

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use rstar::primitives::{GeomWithData, Rectangle};
use rstar::{AABB, RTree};

use super::series::Step;
use super::values::{Values, by_slabs, narrowed};
use super::{GridInfo, Native, Piece, h5, shape_text};
use crate::error::Result;
use crate::field::{Field, Timestep};
use crate::grid::Region;

/// Levels over one box.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Levels {
    /// World position of the lower corner.
    pub corner: [f64; 3],
    /// World lengths of a cell of level 0.
    pub spacing: [f64; 3],
    /// Cells of level 0.
    pub size: [usize; 3],
    /// Cells of level l + 1 in a cell of level l along each axis, one entry for each level but the last.
    pub ratios: Vec<[usize; 3]>,
}

impl Levels {
    /// Number of the finest level.
    pub fn finest(&self) -> usize {
        self.ratios.len()
    }

    /// Cells of a level in a cell of level 0; `None` when they cannot be counted.
    fn factor(&self, level: usize) -> Option<[usize; 3]> {
        self.ratios[..level.min(self.finest())].iter().try_fold([1; 3], |f: [usize; 3], r| {
            Some([f[0].checked_mul(r[0])?, f[1].checked_mul(r[1])?, f[2].checked_mul(r[2])?])
        })
    }

    /// Cells of a level; `None` when they cannot be counted.
    pub fn size_at(&self, level: usize) -> Option<[usize; 3]> {
        let factor = self.factor(level)?;
        let mut size = [0; 3];
        for a in 0..3 {
            size[a] = self.size[a].checked_mul(factor[a])?;
        }
        size.iter().try_fold(8usize, |bytes, &n| bytes.checked_mul(n)).map(|_| size)
    }

    /// The uniform grid of a level.
    fn grid(&self, level: usize) -> GridInfo {
        let factor = self.factor(level).unwrap_or([1; 3]);
        let spacing: [f64; 3] = std::array::from_fn(|a| self.spacing[a] / factor[a] as f64);
        GridInfo {
            size: self.size_at(level).unwrap_or(self.size),
            spacing,
            origin: std::array::from_fn(|a| self.corner[a] + 0.5 * spacing[a]),
            centering: "cell".into(),
            ..GridInfo::default()
        }
    }
}

/// A box of cells of one level.
#[derive(Clone)]
pub(crate) struct Patch {
    pub level: usize,
    /// First cell along x, y, z, counted in cells of its level from the lower corner.
    pub start: [usize; 3],
    pub size: [usize; 3],
    pub values: Values,
}

impl Patch {
    fn end(&self) -> [usize; 3] {
        std::array::from_fn(|a| self.start[a] + self.size[a])
    }
}

/// One step's patches.
#[derive(Clone)]
pub(crate) struct Mesh {
    levels: Levels,
    /// Coarse ones first.
    patches: Vec<Patch>,
}

/// A patch's number and its box in cells of the finest level.
type Placed = GeomWithData<Rectangle<[i64; 3]>, usize>;

/// Finds the patches that a box meets without looking at all of them.
struct Places {
    of: RTree<Placed>,
    /// Cells of the finest level in one of each level.
    finest: Vec<[usize; 3]>,
}

impl Places {
    fn new(Mesh { levels, patches }: &Mesh) -> Places {
        let factor = |level| levels.factor(level).unwrap_or([1; 3]);
        let fine = factor(levels.finest());
        let across = |level| std::array::from_fn(|a| fine[a] / factor(level)[a]);
        let finest: Vec<[usize; 3]> = (0..=levels.finest()).map(across).collect();
        let placed = patches.iter().enumerate().map(|(n, p)| {
            let envelope = envelope(p.start, p.end(), finest[p.level]);
            Placed::new(Rectangle::from_aabb(envelope), n)
        });
        Places { of: RTree::bulk_load(placed.collect()), finest }
    }

    /// Numbers of the patches that share a cell with `start..end` of a level, coarse ones first.
    fn meet(&self, level: usize, start: [usize; 3], end: [usize; 3]) -> Vec<usize> {
        let within = self.of.locate_in_envelope_intersecting(envelope(start, end, self.finest[level]));
        let mut numbers: Vec<usize> = within.map(|placed| placed.data).collect();
        numbers.sort_unstable();
        numbers
    }
}

/// First and last cell of the finest level in a box of cells that have `finest` of those each.
fn envelope(start: [usize; 3], end: [usize; 3], finest: [usize; 3]) -> AABB<[i64; 3]> {
    let fine = |cell: [usize; 3], less: i64| std::array::from_fn(|a| (cell[a] * finest[a]) as i64 - less);
    AABB::from_corners(fine(start, 0), fine(end, 1))
}

impl Mesh {
    /// Checks that every patch lies inside of its level.
    pub fn new(levels: Levels, mut patches: Vec<Patch>) -> Result<Mesh, String> {
        if levels.size.contains(&0) || levels.ratios.iter().flatten().any(|r| *r == 0) {
            return Err(format!("a mesh of {} cells and ratios {:?}", shape_text(&levels.size), levels.ratios));
        }
        let fine = levels.size_at(levels.finest());
        if fine.is_none() || levels.finest() > 40 {
            return Err(format!("{} levels have more cells than can be counted", levels.finest() + 1));
        }
        if patches.is_empty() {
            return Err("a mesh without blocks".into());
        }
        for (n, patch) in patches.iter().enumerate() {
            let size = if patch.level <= levels.finest() { levels.size_at(patch.level) } else { None };
            let inside = |size: [usize; 3]| {
                (0..3).all(|a| {
                    patch.size[a] > 0 && patch.start[a].checked_add(patch.size[a]).is_some_and(|end| end <= size[a])
                })
            };
            if !size.is_some_and(inside) {
                return Err(format!(
                    "block {n} of level {}, {} cells from {:?}, lies outside of the mesh",
                    patch.level,
                    shape_text(&patch.size),
                    patch.start
                ));
            }
        }
        patches.sort_by_key(|p| p.level);
        Ok(Mesh { levels, patches })
    }

    /// The same mesh with the file's own grid brought to `level`.
    fn at(self, level: usize) -> OnLevel {
        OnLevel { mesh: Arc::new(self), level, places: Arc::default() }
    }
}

/// A step that has been found, with its mesh or what is wrong with it.
pub(crate) struct Found {
    pub step: u64,
    pub time: Option<f64>,
    pub mesh: Result<Mesh, String>,
    /// The file, for messages.
    pub file: PathBuf,
}

/// Values of the finest level that are shown without being asked for: 4 GiB of f32.
const MOST: usize = 1 << 30;

/// Brings the meshes of all steps to one level: the one asked for, else the finest of any step. Returns the grid, the level
/// and the steps; what was done is told.
pub(crate) fn steps(
    found: Vec<Found>,
    asked: Option<usize>,
    warnings: &mut Vec<String>,
) -> Result<(GridInfo, usize, Vec<Step>), String> {
    let meshes = || found.iter().filter_map(|f| f.mesh.as_ref().ok());
    let deepest = meshes().map(|m| &m.levels).max_by_key(|l| l.finest());
    let Some(levels) = deepest.cloned() else {
        return Err(found.into_iter().find_map(|f| f.mesh.err()).unwrap_or_else(|| "no steps".into()));
    };
    let finest = levels.finest();
    let cells =
        |level| levels.size_at(level).map_or(usize::MAX, |s| s.iter().fold(1, |n: usize, &l| n.saturating_mul(l)));
    let level = match asked {
        Some(level) if level > finest => return Err(format!("no level {level}; there are 0 to {finest}")),
        Some(level) => level,
        None => (0..=finest).rev().find(|&l| cells(l) <= MOST).unwrap_or(0),
    };
    let grid = levels.grid(level);
    if finest > 0 {
        let factor = |level| levels.factor(level).unwrap_or([1; 3]);
        let coarsest = meshes().flat_map(|m| &m.patches).map(|p| p.level).min().unwrap_or(0).min(level);
        let times = (0..3).map(|a| factor(level)[a] / factor(coarsest)[a]).max().unwrap_or(1);
        let (size, fine) = (shape_text(&grid.size), shape_text(&levels.size_at(finest).unwrap_or_default()));
        warnings.push(if level == finest {
            format!(
                "a mesh of {} levels is brought to its finest level, {size}: coarse values repeat up to {} times; --level N \
                 picks another",
                finest + 1,
                times
            )
        } else {
            let why = if asked.is_some() { "as asked" } else { "since the finest would be large" };
            format!(
                "a mesh of {} levels is brought to level {level}, {size}, {why}: finer values are averaged; --level {finest} \
                 would be {fine}",
                finest + 1
            )
        });
    }
    let place = |found: Found| {
        let (values, grid) = match found.mesh {
            Err(why) => (Values::Broken(found.file, why, "the complete file".into()), None),
            Ok(mesh) => {
                let shared = mesh.levels.finest();
                let same = mesh.levels.ratios[..] == levels.ratios[..shared];
                // A step without the finest level has its grid all the same.
                let own = Levels { ratios: levels.ratios.clone(), ..mesh.levels.clone() };
                if same && own.size_at(finest).is_some() {
                    let grid = own.grid(level);
                    (Values::Mesh(Mesh { levels: own, ..mesh }.at(level)), Some(grid))
                } else {
                    let why = format!("the refinement changes from {:?} to {:?}", levels.ratios, mesh.levels.ratios);
                    (Values::Broken(found.file, why, "--steps A..B for the steps that agree".into()), None)
                }
            }
        };
        Step { step: found.step, time: found.time, grid, values }
    };
    Ok((grid, level, found.into_iter().map(place).collect()))
}

/// A mesh and the level it is brought to.
#[derive(Clone)]
pub(crate) struct OnLevel {
    mesh: Arc<Mesh>,
    level: usize,
    /// Sorted when they are first looked for.
    places: Arc<OnceLock<Places>>,
}

impl OnLevel {
    /// The file of the first patch.
    pub fn file(&self) -> Option<&Path> {
        self.mesh.patches.first()?.values.file()
    }

    fn places(&self) -> &Places {
        self.places.get_or_init(|| Places::new(&self.mesh))
    }

    /// Opens the mesh; its patches are opened when a region first meets them.
    pub fn open(&self, opened: &Arc<h5::Opened>) -> MeshField {
        let patches = self.mesh.patches.iter().map(|_| OnceLock::new()).collect();
        MeshField { of: self.clone(), fields: patches, opened: opened.clone() }
    }

    /// The step with the file's own cells: one piece for each patch, less what finer patches cover.
    pub fn native(&self, step: Timestep, opened: &Arc<h5::Opened>) -> Result<Native> {
        let (mesh, open) = (&self.mesh, Arc::new(self.open(opened)));
        let factor = |level| mesh.levels.factor(level).unwrap_or([1; 3]);
        let pieces = mesh.patches.iter().enumerate().map(|(n, patch)| {
            let finer = if patch.level == mesh.patches[mesh.patches.len() - 1].level {
                Vec::new()
            } else {
                self.places().meet(patch.level, patch.start, patch.end())
            };
            let finer = finer.into_iter().map(|n| &mesh.patches[n]).filter(|p| p.level > patch.level);
            let covers = finer.filter_map(|p| {
                let (f, own) = (factor(p.level), factor(patch.level));
                let r: [usize; 3] = std::array::from_fn(|a| f[a] / own[a]);
                let lo: [usize; 3] = std::array::from_fn(|a| p.start[a].div_ceil(r[a]).max(patch.start[a]));
                let hi: [usize; 3] = std::array::from_fn(|a| (p.end()[a] / r[a]).min(patch.end()[a]));
                (0..3).all(|a| lo[a] < hi[a]).then(|| Region {
                    start: std::array::from_fn(|a| lo[a] - patch.start[a]),
                    size: std::array::from_fn(|a| hi[a] - lo[a]),
                })
            });
            let field = Arc::new(PatchField { mesh: open.clone(), patch: n });
            Piece { size: patch.size, field, covered: covers.collect() }
        });
        Ok(Native { pieces: pieces.collect(), step })
    }
}

/// An open mesh on one level.
pub(crate) struct MeshField {
    of: OnLevel,
    fields: Vec<OnceLock<Arc<dyn Field>>>,
    opened: Arc<h5::Opened>,
}

/// One patch of an open mesh, opened when it is read.
struct PatchField {
    mesh: Arc<MeshField>,
    patch: usize,
}

impl Field for PatchField {
    fn read(&self, region: Region, out: &mut [f32]) -> Result<()> {
        self.mesh.patch(self.patch)?.read(region, out)
    }

    fn read_f64(&self, region: Region, out: &mut [f64]) -> Result<()> {
        self.mesh.patch(self.patch)?.read_f64(region, out)
    }
}

/// Patches that stay open: each may be a file of its own, and a process has a thousand or so.
const OPEN: usize = 256;

impl MeshField {
    fn patch(&self, n: usize) -> Result<Arc<dyn Field>> {
        if let Some(field) = self.fields[n].get() {
            return Ok(field.clone());
        }
        let patch = &self.of.mesh.patches[n];
        let field = patch.values.open(patch.size, &self.opened)?;
        Ok(if self.fields.len() <= OPEN { self.fields[n].get_or_init(|| field).clone() } else { field })
    }

    fn slab(&self, region: Region, out: &mut [f64]) -> Result<()> {
        let Mesh { levels, patches } = &*self.of.mesh;
        let shown = levels.factor(self.of.level).unwrap_or([1; 3]);
        out.fill(f64::NAN);
        let mut averages = None;
        let mut part = Vec::new();
        for n in self.of.places().meet(self.of.level, region.start, region.end()) {
            let patch = &patches[n];
            let own = levels.factor(patch.level).unwrap_or([1; 3]);
            let coarser = patch.level <= self.of.level;
            let ratio: [usize; 3] =
                std::array::from_fn(|a| if coarser { shown[a] / own[a] } else { own[a] / shown[a] });
            // First and last shown cell that the patch and the region share.
            let (from, to): ([usize; 3], [usize; 3]) = if coarser {
                (std::array::from_fn(|a| patch.start[a] * ratio[a]), std::array::from_fn(|a| patch.end()[a] * ratio[a]))
            } else {
                let end = patch.end();
                (std::array::from_fn(|a| patch.start[a] / ratio[a]), std::array::from_fn(|a| end[a].div_ceil(ratio[a])))
            };
            let lo: [usize; 3] = std::array::from_fn(|a| from[a].max(region.start[a]));
            let hi: [usize; 3] = std::array::from_fn(|a| to[a].min(region.end()[a]));
            if (0..3).any(|a| lo[a] >= hi[a]) {
                continue;
            }
            let cells = |at: [usize; 3], up: bool| -> [usize; 3] {
                std::array::from_fn(|a| match (coarser, up) {
                    (true, false) => at[a] / ratio[a],
                    (true, true) => at[a].div_ceil(ratio[a]),
                    (false, _) => (at[a] * ratio[a]).clamp(patch.start[a], patch.end()[a]),
                })
            };
            let (first, past) = (cells(lo, false), cells(hi, true));
            let under = Region {
                start: std::array::from_fn(|a| first[a] - patch.start[a]),
                size: std::array::from_fn(|a| past[a] - first[a]),
            };
            // Opening checks that the file holds what the mesh claims, before room is made for it.
            let field = self.patch(n)?;
            part.clear();
            part.resize(under.len(), 0.0);
            field.read_f64(under, &mut part)?;
            let at =
                |k: usize, j: usize| ((k - region.start[2]) * region.size[1] + j - region.start[1]) * region.size[0];
            if coarser {
                for (k, j) in (lo[2]..hi[2]).flat_map(|k| (lo[1]..hi[1]).map(move |j| (k, j))) {
                    let row = ((k / ratio[2] - first[2]) * under.size[1] + j / ratio[1] - first[1]) * under.size[0];
                    let out = &mut out[at(k, j) + lo[0] - region.start[0]..at(k, j) + hi[0] - region.start[0]];
                    out.iter_mut().enumerate().for_each(|(i, o)| *o = part[row + (lo[0] + i) / ratio[0] - first[0]]);
                }
                continue;
            }
            let sums = averages.get_or_insert_with(|| Averages::new(patch.level, out.len()));
            if sums.level != patch.level {
                sums.settle(out);
                sums.level = patch.level;
            }
            sums.cells = ratio.iter().product::<usize>() as f64;
            for (n, row) in part.chunks_exact(under.size[0]).enumerate() {
                let (j, k) = (first[1] + n % under.size[1], first[2] + n / under.size[1]);
                let at = at(k / ratio[2], j / ratio[1]);
                for (i, &value) in row.iter().enumerate() {
                    sums.add(at + (first[0] + i) / ratio[0] - region.start[0], value);
                }
            }
        }
        if let Some(mut sums) = averages {
            sums.settle(out);
        }
        Ok(())
    }
}

/// Means of the finer cells in each shown cell, gathered level by level.
struct Averages {
    level: usize,
    /// Finer cells in a shown one.
    cells: f64,
    /// Sum and number of valid values, and number of all.
    sums: Vec<[f64; 3]>,
}

impl Averages {
    fn new(level: usize, cells: usize) -> Self {
        Averages { level, cells: 1.0, sums: vec![[0.0; 3]; cells] }
    }

    fn add(&mut self, at: usize, value: f64) {
        let [sum, valid, all] = &mut self.sums[at];
        *all += 1.0;
        if value.is_finite() {
            (*sum, *valid) = (*sum + value, *valid + 1.0);
        }
    }

    /// Puts the means over what lies below them: in whole where the finer cells fill a cell, in part where they do not.
    fn settle(&mut self, out: &mut [f64]) {
        for (o, s) in out.iter_mut().zip(&mut self.sums) {
            let [sum, valid, all] = std::mem::take(s);
            if all == 0.0 {
                continue;
            }
            let mean = if 2.0 * valid >= all { sum / valid } else { f64::NAN };
            let share = all / self.cells;
            *o = match (share >= 1.0 || o.is_nan(), mean.is_nan()) {
                (true, _) => mean,
                (false, true) => *o,
                (false, false) => *o * (1.0 - share) + mean * share,
            };
        }
    }
}

/// Values in hand at a time: 128 MiB.
const SLAB: usize = 16 << 20;

impl Field for MeshField {
    fn read(&self, region: Region, out: &mut [f32]) -> Result<()> {
        narrowed(self, region, out)
    }

    fn read_f64(&self, region: Region, out: &mut [f64]) -> Result<()> {
        // Finer cells are read to be averaged: as many of them are in hand as there may be values.
        let levels = &self.of.mesh.levels;
        let factor = |level| levels.factor(level).unwrap_or([1; 3]).iter().product::<usize>();
        let finer = factor(levels.finest()) / factor(self.of.level).max(1);
        by_slabs(region, SLAB / finer.max(1), out, |slab, out| self.slab(slab, out))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn levels() -> Levels {
        Levels { corner: [0.0; 3], spacing: [1.0; 3], size: [4, 2, 2], ratios: vec![[2; 3]] }
    }

    fn patch(level: usize, start: [usize; 3], size: [usize; 3], value: f64) -> Patch {
        Patch { level, start, size, values: Values::Constant(value) }
    }

    fn read(mesh: &Mesh, level: usize, region: Region) -> Vec<f64> {
        let mut out = vec![0.0; region.len()];
        mesh.clone().at(level).open(&Default::default()).read_f64(region, &mut out).unwrap();
        out
    }

    fn two_levels() -> Mesh {
        // The finer patch covers the shown cells x 1..3 in whole at y, z 0.
        Mesh::new(levels(), vec![patch(1, [2, 0, 0], [4, 2, 2], 5.0), patch(0, [0; 3], [4, 2, 2], 1.0)]).unwrap()
    }

    #[test]
    fn finer_patches_win_on_every_level() {
        let mesh = two_levels();
        let row = |level, n| read(&mesh, level, Region { start: [0; 3], size: [n, 1, 1] });
        assert_eq!(row(1, 8), [1.0, 1.0, 5.0, 5.0, 5.0, 5.0, 1.0, 1.0]);
        assert_eq!(row(0, 4), [1.0, 5.0, 5.0, 1.0]);
        assert_eq!(read(&mesh, 1, Region { start: [3, 1, 1], size: [1, 2, 2] }), [5.0, 1.0, 1.0, 1.0]);
    }

    #[test]
    fn a_cell_that_finer_ones_fill_in_part_is_weighted_by_volume() {
        let mesh =
            Mesh::new(levels(), vec![patch(0, [0; 3], [4, 2, 2], 1.0), patch(1, [1, 0, 0], [1; 3], 9.0)]).unwrap();
        // One of eight finer cells.
        assert_eq!(read(&mesh, 0, Region { start: [0; 3], size: [2, 1, 1] }), [2.0, 1.0]);
    }

    #[test]
    fn what_no_patch_covers_is_empty_and_each_cell_counts_once() {
        let mesh = Mesh::new(levels(), vec![patch(1, [2, 0, 0], [4, 2, 2], 5.0)]).unwrap();
        let row = read(&mesh, 0, Region { start: [0; 3], size: [4, 1, 1] });
        assert!(row[0].is_nan() && row[3].is_nan() && row[1] == 5.0 && row[2] == 5.0, "{row:?}");
        let grid = crate::grid::Grid::new([8, 4, 4]);
        let mesh = two_levels().at(1);
        let opened = Default::default();
        let field = Arc::new(mesh.open(&opened));
        let native = mesh.native(Timestep { step: 0, time: None, grid, field }, &opened).unwrap();
        let found = super::super::statistics_of(&native.pieces).unwrap();
        // 16 coarse cells less the two that are covered, and 16 fine ones.
        assert_eq!((found.total, found.valid, found.mean), (30, 30, (14.0 + 16.0 * 5.0) / 30.0));
    }

    #[test]
    fn patches_outside_and_levels_beyond_count_are_refused() {
        assert!(Mesh::new(levels(), vec![patch(1, [7, 0, 0], [2, 1, 1], 0.0)]).is_err());
        assert!(Mesh::new(levels(), vec![patch(2, [0; 3], [1; 3], 0.0)]).is_err());
        assert!(Mesh::new(levels(), vec![patch(0, [usize::MAX, 0, 0], [1; 3], 0.0)]).is_err());
        let deep = Levels { ratios: vec![[1 << 20; 3]; 4], ..levels() };
        assert!(Mesh::new(deep, vec![patch(0, [0; 3], [1; 3], 0.0)]).err().unwrap().contains("counted"));
        assert!(Mesh::new(levels(), vec![]).is_err());
    }

    /// No block is held against more than those that lie over it, however many there are.
    #[test]
    fn the_cells_of_many_blocks_are_found_without_looking_at_all_of_them() {
        const EDGE: usize = 28;
        let levels = Levels { size: [2 * EDGE; 3], ..levels() };
        let at = |n: usize| [n % EDGE, n / EDGE % EDGE, n / (EDGE * EDGE)];
        let coarse = (0..EDGE.pow(3)).map(|n| patch(0, at(n).map(|i| 2 * i), [2; 3], 1.0));
        // Every second block of the coarse level is refined in whole.
        let fine = (0..EDGE.pow(3)).filter(|n| at(*n).iter().sum::<usize>() % 2 == 0);
        let fine = fine.map(|n| patch(1, at(n).map(|i| 4 * i), [4; 3], 2.0));
        let mesh = Mesh::new(levels, coarse.chain(fine).collect()).unwrap().at(1);
        let looked_at = |p: &Patch| mesh.places().meet(p.level, p.start, p.end()).len();
        assert_eq!(mesh.mesh.patches.len(), 32_928);
        // Itself, and the other of two that lie over each other.
        assert_eq!(mesh.mesh.patches.iter().map(looked_at).sum::<usize>(), 32_928 + 2 * 10_976);

        let opened = Default::default();
        let grid = crate::grid::Grid::new([4 * EDGE; 3]);
        let field = Arc::new(mesh.open(&opened));
        let native = mesh.native(Timestep { step: 0, time: None, grid, field }, &opened).unwrap();
        let covered = native.pieces.iter().filter(|p| p.covered == [Region { start: [0; 3], size: [2; 3] }]);
        assert_eq!(covered.count(), 10_976);
        let mut probe = [0.0; 2];
        native.step.field.read_f64(Region { start: [3, 0, 0], size: [2, 1, 1] }, &mut probe).unwrap();
        assert_eq!(probe, [2.0, 1.0]);
    }

    #[test]
    fn steps_share_the_finest_level_of_any_and_say_so() {
        let coarse = Levels { ratios: vec![], ..levels() };
        let alone = Mesh::new(coarse, vec![patch(0, [0; 3], [4, 2, 2], 3.0)]).unwrap();
        let found = |mesh: Result<Mesh, String>| Found { step: 0, time: None, mesh, file: "a".into() };
        let made = || vec![found(Ok(alone.clone())), found(Ok(two_levels())), found(Err("gone".into()))];
        let mut told = Vec::new();
        let (grid, level, steps) = super::steps(made(), None, &mut told).unwrap();
        assert_eq!((grid.size, level, grid.origin), ([8, 4, 4], 1, [0.25; 3]));
        assert!(told[0].contains("finest level, 8×4×4"), "{told:?}");
        assert_eq!(steps[0].grid.as_ref().unwrap().size, [8, 4, 4]);
        assert!(matches!(steps[2].values, Values::Broken(..)));
        let (grid, ..) = super::steps(made(), Some(0), &mut told).unwrap();
        assert_eq!(grid.size, [4, 2, 2]);
        assert!(told[1].contains("averaged"), "{told:?}");
        assert!(super::steps(made(), Some(2), &mut told).err().unwrap().contains("0 to 1"));
    }
}
