//! Short characteristics: how direct light crosses a grid, along a direction or away from a point (light.md, direct light).

use glam::{DVec3, Vec3};

use crate::grid::{BrickLayout, Grid};

/// Geometry of one pass of short characteristics over a grid, dominant axis first (light.md, direct light).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sweep {
    /// Values along x, y, z.
    pub size: [usize; 3],
    /// The way the light travels, in index space: unit world direction divided by spacing, so that anisotropic spacing
    /// enters offsets and lengths. Only the ratios matter.
    pub direction: [f32; 3],
    /// World length of the path between two layers perpendicular to the dominant axis: `Δx_a / |u_a|`.
    pub length: f32,
    /// Foot by clamped Catmull–Rom instead of bilinear weights. Whole-grid only: `fronts` are ignored and every brick is
    /// swept, because a cubic foot reaches downstream bricks of the previous layer.
    pub cubic: bool,
    /// A slab of a larger grid: its first plane across z, the way the light travels, is the last of the slab before. Its ρ is
    /// given and stays.
    pub given: bool,
}

impl Sweep {
    /// The sweep of `grid` along unit world direction `u`.
    pub fn new(grid: &Grid, u: Vec3, cubic: bool) -> Self {
        let direction: [f32; 3] = std::array::from_fn(|a| (f64::from(u[a]) / grid.spacing[a]) as f32);
        let sweep = Sweep { size: grid.size, direction, length: 0.0, cubic, given: false };
        Sweep { length: 1.0 / direction[sweep.axis()].abs(), ..sweep }
    }

    /// The dominant axis in index space; where two are equal the higher one, whose layers are contiguous in memory.
    pub fn axis(&self) -> usize {
        let d = self.direction.map(f32::abs);
        if d[2] >= d[0] && d[2] >= d[1] {
            2
        } else if d[1] >= d[0] {
            1
        } else {
            0
        }
    }

    /// True along each axis where the light travels towards increasing indices (also where it does not move).
    pub fn ascending(&self) -> [bool; 3] {
        self.direction.map(|d| d >= 0.0)
    }
}

/// Geometry of one pass of short characteristics away from a point (light.md, direct light).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointSweep {
    /// Values along x, y, z.
    pub size: [usize; 3],
    /// The first index at or beyond the light along each axis.
    pub cell: [i32; 3],
    /// How far beyond, in voxels: 0 ≤ fraction < 1.
    pub fraction: [f32; 3],
    /// Length of a step of one voxel along each axis: the world's, times any factor on extinction.
    pub spacing: [f32; 3],
    /// The first plane across z that buffers hold. They hold those of the bricks at hand, one more of ρ on the light's side and two
    /// more of extinction on both, as far as there are any.
    pub plane: usize,
}

/// What lies behind the end of a brick along an axis, as its light sees it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Edge {
    /// Nothing that the brick needs.
    Downstream,
    /// A layer that an earlier front has solved, or the outside of the grid.
    Upstream,
    /// The other one of the two columns beside the light's plane: the brick solves it too.
    Ghost,
}

impl PointSweep {
    /// Farther lights, in voxels, are brought this near: their rays are parallel to a millionth.
    const FARTHEST: f64 = (1 << 20) as f64;

    /// The sweep of `grid` away from world position `position`, with extinction times `factor`.
    pub fn new(grid: &Grid, position: DVec3, factor: f32) -> Self {
        let (spacing, origin) = (DVec3::from(grid.spacing), DVec3::from(grid.origin));
        let middle = 0.5 * DVec3::from(grid.size.map(|n| n as f64 - 1.0));
        let at = (position - origin) / spacing;
        let at = middle + (at - middle).clamp_length_max(Self::FARTHEST);
        // To a millionth of a voxel, so that a light that is meant to be on a voxel is on it.
        let at = (at * Self::FARTHEST).round() / Self::FARTHEST;
        Self {
            size: grid.size,
            cell: at.ceil().as_ivec3().to_array(),
            fraction: (at.ceil() - at).as_vec3().to_array(),
            spacing: (spacing * f64::from(factor)).as_vec3().to_array(),
            plane: 0,
        }
    }

    /// Values that buffers hold at least for these bricks.
    pub(crate) fn held(&self, layout: &BrickLayout, bricks: &[&[u32]]) -> usize {
        let end = bricks.iter().copied().flatten().map(|&b| layout.region(b as usize).end()[2]).max().unwrap_or(0);
        self.size[0] * self.size[1] * end.saturating_sub(self.plane)
    }

    /// Offset of index `i` from the light along an axis, in voxels.
    pub fn offset(&self, axis: usize, i: i32) -> f32 {
        let (cell, fraction) = (self.cell[axis], self.fraction[axis]);
        if i >= cell { (i - cell) as f32 + fraction } else { -((cell - 1 - i) as f32 + (1.0 - fraction)) }
    }

    /// Whole voxels between the light and index `i` along an axis.
    pub fn layer(&self, axis: usize, i: i32) -> i32 {
        if i >= self.cell[axis] { i - self.cell[axis] } else { self.near(axis)[0] - i }
    }

    /// The lowest and the highest index of layer 0: a pair unless the light is on a plane of voxels.
    fn near(&self, axis: usize) -> [i32; 2] {
        [self.cell[axis] - i32::from(self.fraction[axis] > 0.0), self.cell[axis]]
    }

    /// What lies before index `start` and behind index `end − 1` of a brick.
    pub fn edges(&self, axis: usize, start: i32, end: i32) -> [Edge; 2] {
        let [low, high] = self.near(axis);
        let ghost = |inside: bool| if inside { Edge::Ghost } else { Edge::Downstream };
        [
            if start > high { Edge::Upstream } else { ghost(start == high && low < high && start > 0) },
            if end <= low { Edge::Upstream } else { ghost(end == high && low < high && end < self.size[axis] as i32) },
        ]
    }

    /// Bricks between the light and brick coordinate `c` along an axis.
    fn depth(&self, layout: &BrickLayout, axis: usize, c: usize) -> usize {
        let [low, high] = self.near(axis);
        let (start, end) = (c * layout.edge, ((c + 1) * layout.edge).min(layout.size[axis]));
        if start as i32 > high {
            c - if high < 0 { 0 } else { high as usize / layout.edge }
        } else if end as i32 <= low {
            (low as usize / layout.edge).min(layout.counts()[axis] - 1) - c
        } else {
            0
        }
    }

    /// Bricks ordered outward from the light: those of one front do not depend on each other.
    pub fn fronts(&self, layout: &BrickLayout) -> Vec<Vec<u32>> {
        let mut fronts: Vec<Vec<u32>> = Vec::new();
        for b in 0..layout.len() {
            let c = layout.coords(b);
            let depth = (0..3).map(|a| self.depth(layout, a, c[a])).sum();
            if fronts.len() <= depth {
                fronts.resize(depth + 1, Vec::new());
            }
            fronts[depth].push(b as u32);
        }
        // A light far outside leaves no gap: depths along an axis begin at 0.
        fronts
    }

    /// The bricks that brick `b` reads light from.
    pub fn upstream(&self, layout: &BrickLayout, b: usize) -> Vec<u32> {
        let coords = layout.coords(b);
        let region = layout.region(b);
        // For each axis the neighbour that may be read, and whether it is upstream.
        let beside: [Option<(usize, bool)>; 3] = std::array::from_fn(|a| {
            let [low, high] = self.edges(a, region.start[a] as i32, region.end()[a] as i32);
            let (edge, to) = match (low, high) {
                (Edge::Downstream, high) => (high, coords[a] + 1),
                (low, _) => (low, coords[a].wrapping_sub(1)),
            };
            (edge != Edge::Downstream && to < layout.counts()[a]).then_some((to, edge == Edge::Upstream))
        });
        (1..8usize)
            .filter_map(|mask| {
                let mut c = coords;
                let mut upstream = false;
                for a in 0..3 {
                    if mask >> a & 1 == 1 {
                        let (to, up) = beside[a]?;
                        c[a] = to;
                        upstream |= up;
                    }
                }
                upstream.then(|| layout.number(c) as u32)
            })
            .collect()
    }
}
