//! Uniform grids, regions of them, and their partition into bricks.
//!
//! Sizes and indices are `[x, y, z]`; memory is (z, y, x), x fastest: voxel (i, j, k) is at `(k·ny + j)·nx + i`.

use glam::DVec3;
use serde::{Deserialize, Serialize};

/// A uniform grid of values. Value (i, j, k) sits at `origin + (i, j, k)·spacing`; the volume's box reaches half a
/// voxel beyond the outermost values.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Grid {
    /// Values along x, y, z.
    pub size: [usize; 3],
    /// World length between neighbouring values.
    pub spacing: [f64; 3],
    /// World position of value (0, 0, 0).
    pub origin: [f64; 3],
}

impl Grid {
    /// A grid of `size` values with unit spacing and its first value at the origin.
    pub fn new(size: [usize; 3]) -> Self {
        Grid { size, spacing: [1.0; 3], origin: [0.0; 3] }
    }

    /// Number of values.
    pub fn len(&self) -> usize {
        self.size.iter().product()
    }

    /// True when some axis has no values.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The box of the volume in world space: half a voxel beyond the outermost values.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        let (origin, spacing) = (DVec3::from(self.origin), DVec3::from(self.spacing));
        let lo = origin - 0.5 * spacing;
        (lo, lo + spacing * DVec3::from(self.size.map(|n| n as f64)))
    }

    /// Mean of the three spacings: the length that "one voxel" means in a scene file.
    pub fn mean_spacing(&self) -> f64 {
        self.spacing.iter().sum::<f64>() / 3.0
    }

    /// The grid of another size that fills the same box.
    pub fn resized(&self, size: [usize; 3]) -> Grid {
        let (lo, hi) = self.bounds();
        let spacing: [f64; 3] = std::array::from_fn(|a| (hi[a] - lo[a]) / size[a] as f64);
        Grid { size, spacing, origin: std::array::from_fn(|a| lo[a] + 0.5 * spacing[a]) }
    }

    /// The whole grid as a region.
    pub fn region(&self) -> Region {
        Region { start: [0; 3], size: self.size }
    }

    /// Index of value (i, j, k) in memory.
    pub fn index(&self, [i, j, k]: [usize; 3]) -> usize {
        (k * self.size[1] + j) * self.size[0] + i
    }
}

/// A box of values inside a grid: `start <= index < start + size`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Region {
    /// First value along x, y, z.
    pub start: [usize; 3],
    /// Values along x, y, z.
    pub size: [usize; 3],
}

impl Region {
    /// Number of values.
    pub fn len(&self) -> usize {
        self.size.iter().product()
    }

    /// True when some axis has no values.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// One past the last value along each axis.
    pub fn end(&self) -> [usize; 3] {
        std::array::from_fn(|a| self.start[a] + self.size[a])
    }

    /// Its planes across z in order, as many at a time as have `most` values, and at least one. Values in (z, y, x) order follow
    /// one another from slab to slab.
    pub fn slabs(self, most: usize) -> impl Iterator<Item = Region> {
        let Region { start: [x, y, z], size: [nx, ny, nz] } = self;
        let thickness = (most / (nx * ny).max(1)).max(1);
        (0..nz)
            .step_by(thickness)
            .map(move |first| Region { start: [x, y, z + first], size: [nx, ny, thickness.min(nz - first)] })
    }

    /// Grown by `halo` values on every side, clipped to a grid of `size`.
    pub fn grown(&self, halo: usize, size: [usize; 3]) -> Region {
        let start = self.start.map(|s| s.saturating_sub(halo));
        Region { start, size: std::array::from_fn(|a| (self.end()[a] + halo).min(size[a]) - start[a]) }
    }
}

/// Consecutive planes across z of a grid: what is worked on at a time where a volume does not fit. Its values stand alone in
/// memory, the first plane's first.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Slab {
    /// Values of the whole grid along x, y, z.
    pub size: [usize; 3],
    /// The planes.
    pub planes: std::ops::Range<usize>,
}

impl Slab {
    /// All planes of a grid of `size`.
    pub fn whole(size: [usize; 3]) -> Self {
        Slab { size, planes: 0..size[2] }
    }

    /// Values of a plane.
    pub fn plane(&self) -> usize {
        self.size[0] * self.size[1]
    }

    /// Number of values.
    pub fn len(&self) -> usize {
        self.plane() * self.planes.len()
    }

    /// True when there are no values.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Its values as a region of the grid.
    pub fn region(&self) -> Region {
        let [nx, ny, _] = self.size;
        Region { start: [0, 0, self.planes.start], size: [nx, ny, self.planes.len()] }
    }

    /// The planes of a grid of `fine` values along z, over the same box, that lie under these.
    pub fn under(&self, fine: usize) -> std::ops::Range<usize> {
        let n = self.size[2];
        self.planes.start * fine / n..(self.planes.end * fine).div_ceil(n)
    }
}

/// A partition of a grid into bricks: the unit of skipping, empty space, paging, parallelism and distribution.
/// Brick (bx, by, bz) has the number `(bz·ny + by)·nx + bx`; the last brick along an axis may be smaller.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BrickLayout {
    /// Values of the grid along x, y, z.
    pub size: [usize; 3],
    /// Values along one edge of a brick.
    pub edge: usize,
}

impl BrickLayout {
    /// Edge of a brick unless somebody asks for another: 32³ f32 fill half of a usual second-level cache.
    pub const EDGE: usize = 32;

    /// The partition of a grid of `size` into bricks of `edge`³.
    pub fn new(size: [usize; 3], edge: usize) -> Self {
        assert!(edge > 0, "a brick has at least one voxel");
        BrickLayout { size, edge }
    }

    /// Bricks along x, y, z.
    pub fn counts(&self) -> [usize; 3] {
        self.size.map(|n| n.div_ceil(self.edge))
    }

    /// Number of bricks.
    pub fn len(&self) -> usize {
        self.counts().iter().product()
    }

    /// True when the grid has no values.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Brick coordinates of brick number `b`.
    pub fn coords(&self, b: usize) -> [usize; 3] {
        let [nx, ny, _] = self.counts();
        [b % nx, b / nx % ny, b / (nx * ny)]
    }

    /// Number of the brick at brick coordinates.
    pub fn number(&self, [bx, by, bz]: [usize; 3]) -> usize {
        let [nx, ny, _] = self.counts();
        (bz * ny + by) * nx + bx
    }

    /// The values of brick `b`.
    pub fn region(&self, b: usize) -> Region {
        let start = self.coords(b).map(|c| c * self.edge);
        Region { start, size: std::array::from_fn(|a| self.edge.min(self.size[a] - start[a])) }
    }

    /// The bricks ordered into fronts for light that travels towards increasing (`true`) or decreasing indices along
    /// each axis: bricks of one front do not depend on each other, and depend only on earlier fronts.
    pub fn fronts(&self, ascending: [bool; 3]) -> Vec<Vec<u32>> {
        let counts = self.counts();
        let depth = |b: usize| -> usize {
            let c = self.coords(b);
            (0..3).map(|a| if ascending[a] { c[a] } else { counts[a] - 1 - c[a] }).sum()
        };
        let mut fronts = vec![Vec::new(); if self.is_empty() { 0 } else { counts.iter().sum::<usize>() - 2 }];
        for b in 0..self.len() {
            fronts[depth(b)].push(b as u32);
        }
        fronts
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// validation.md 19: any partition covers the grid exactly once, and fronts hold every brick once.
        #[test]
        fn bricks_cover_the_grid_exactly_once(nx in 1usize..40, ny in 1usize..40, nz in 1usize..40, edge in 1usize..20) {
            let grid = Grid::new([nx, ny, nz]);
            let layout = BrickLayout::new(grid.size, edge);
            let mut seen = vec![0u8; grid.len()];
            for b in 0..layout.len() {
                prop_assert_eq!(layout.number(layout.coords(b)), b);
                let r = layout.region(b);
                for k in r.start[2]..r.end()[2] { for j in r.start[1]..r.end()[1] { for i in r.start[0]..r.end()[0] {
                    seen[grid.index([i, j, k])] += 1;
                } } }
            }
            prop_assert!(seen.iter().all(|&n| n == 1));
            let mut order: Vec<u32> = layout.fronts([true, false, true]).concat();
            order.sort_unstable();
            prop_assert_eq!(order, (0..layout.len() as u32).collect::<Vec<_>>());
        }
    }

    #[test]
    fn resizing_keeps_the_box() {
        let grid = Grid { size: [37, 64, 51], spacing: [0.5, 1.0, 2.0], origin: [3.0, -1.0, 0.25] };
        let (lo, hi) = grid.bounds();
        let (lo2, hi2) = grid.resized([18, 32, 26]).bounds();
        assert!((lo - lo2).length() < 1e-12 && (hi - hi2).length() < 1e-12);
    }
}
