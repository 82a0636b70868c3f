//! What convection is about: where light comes from, what opacity means, how a solve starts.
//!
//! Zhang & Ma 2013, (16)–(20): `ρ' = (1 − σ_a)(ρ − ½Σ_a |d_a| (ρ − ρ_a))`, ρ_a the upstream neighbour along axis a and
//! `d_a = u_a h/Δx_a` the way of light in voxels, h the least of the three spacings, so that `s = Σ|d_a| ≤ √3` and the step is
//! stable. Its fixed point is `ρ = T/s · Σ|d_a| ρ_a` with `T = (1 − σ_a)s / (s + σ_a(2 − s))`.

use glam::DVec3;

use crate::grid::{BrickLayout, Grid, Region};

/// One light on one grid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Convection {
    /// Values along x, y, z.
    pub size: [usize; 3],
    /// The way of light at each voxel, and what enters the grid.
    pub rays: Rays,
    /// What a voxel takes away.
    pub opacity: Opacity,
}

/// The way of light. Lengths are in units of h, the least spacing of the grid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Rays {
    /// Distant light (6), (7): ρ = 1 outside the up to three faces that it enters by.
    Parallel {
        /// d along x, y, z.
        way: [f32; 3],
    },
    /// Light from one place (8)–(11), (14), (15).
    ///
    /// In the layer of voxels that holds the light's plane across an axis, light moves along that plane: neither neighbour
    /// across it is upstream of the other, so every voxel's upstream neighbours are nearer to the light.
    Central {
        /// The place, in voxels.
        position: [f32; 3],
        /// Δx, Δy, Δz.
        spacing: [f32; 3],
        /// Voxels nearer than this hold G and are never updated; 0 for a light outside the box, whose G is held outside the
        /// faces that the light enters by.
        ball: f32,
        /// `1/(2 width²)` of the Gaussian `G = exp(−r²·falloff)`; 0 for G = 1.
        falloff: f32,
    },
}

/// σ_a from the mean extinction of a voxel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Opacity {
    /// σ_a such that light is dimmed by `e^(−σ_t·length)` along a world length h, whatever its direction: `t = e^(−τ/s)`,
    /// `σ_a = s(1 − t)/(s + t(2 − s))`, so that T = t.
    Calibrated {
        /// h, world length.
        length: f32,
    },
    /// σ_a is the opacity of the transfer function, `1 − e^(−σ_t·length)`, whatever the size of a voxel: about twice the
    /// extinction, on a grid of that spacing.
    Literal {
        /// Reference length of the transfer function, world length.
        length: f32,
    },
}

/// What the iterations of a layer start from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Start {
    /// Nothing: light has to cross every layer by iterations.
    Zero,
    /// The layer upstream.
    Upstream,
    /// Of the layer upstream, the earlier light of this layer, and that light moved by the change of the layer upstream, the
    /// one with the least residual in the middle row of the strip.
    Best,
}

/// How [`Device::convect_layers`](super::Device::convect_layers) goes about it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Layers {
    /// Most iterations of a strip.
    pub iterations: u32,
    /// A strip stops where the bound on its error is within its share of this, more of it downstream.
    pub tolerance: f32,
    /// What it starts from.
    pub start: Start,
}

/// What a pass of convection did.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Convected {
    /// Bound on the distance to the fixed point, for ρ = 1 at the light; infinite where no bound is known.
    pub error: f32,
    /// Most iterations that a strip took.
    pub iterations: u32,
    /// Voxel updates, those of tried guesses included.
    pub updates: u64,
}

impl Convection {
    /// Rows of a strip: iterations of a layer run strip by strip, so that strips on a diagonal run at the same time.
    pub const STRIP: usize = 32;

    /// h: the least spacing of a grid.
    pub fn step(grid: &Grid) -> f64 {
        grid.spacing.into_iter().fold(f64::INFINITY, f64::min)
    }

    /// Distant light that travels along the unit world direction `u`.
    pub fn distant(grid: &Grid, u: glam::Vec3, opacity: Opacity) -> Self {
        let h = Self::step(grid);
        let way = std::array::from_fn(|a| (f64::from(u[a]) * h / grid.spacing[a]) as f32);
        Convection { size: grid.size, rays: Rays::Parallel { way }, opacity }
    }

    /// Light from `position`, with G of this `width` (world lengths; `None` for G = 1).
    pub fn central(grid: &Grid, position: DVec3, width: Option<f64>, opacity: Opacity) -> Self {
        let h = Self::step(grid);
        let (lo, hi) = grid.bounds();
        let inside = position.cmpge(lo).all() && position.cmple(hi).all();
        let rays = Rays::Central {
            position: std::array::from_fn(|a| ((position[a] - grid.origin[a]) / grid.spacing[a]) as f32),
            spacing: grid.spacing.map(|d| (d / h) as f32),
            ball: if inside { (2.0 * grid.mean_spacing() / h) as f32 } else { 0.0 },
            falloff: width.map_or(0.0, |w| (0.5 * (h / w).powi(2)) as f32),
        };
        Convection { size: grid.size, rays, opacity }
    }

    /// Along each axis the index towards and beyond which everything is downstream: the upstream neighbour of index i is
    /// i − 1 above it and i + 1 below it. −1 and the size stand for the faces.
    pub fn centre(&self) -> [i32; 3] {
        match self.rays {
            Rays::Parallel { way } => std::array::from_fn(|a| if way[a] >= 0.0 { -1 } else { self.size[a] as i32 }),
            Rays::Central { position, .. } => {
                std::array::from_fn(|a| position[a].round().clamp(-1.0, self.size[a] as f32) as i32)
            }
        }
    }

    /// The axis that parallel light crosses most voxels along; z, where light comes from one place.
    pub fn axis(&self) -> usize {
        match self.rays {
            Rays::Parallel { way } => {
                let d = way.map(f32::abs);
                // Along z and y rows of memory lie in the layers.
                if d[2] >= d[1] && d[2] >= d[0] {
                    2
                } else if d[1] >= d[0] {
                    1
                } else {
                    0
                }
            }
            Rays::Central { .. } => 2,
        }
    }

    /// Bound on the error of a strip per size of its last update: in the layer's system a row sums to at most
    /// `1 − ½|d_a|`, so iterations close in on the solution at that rate, and the error is at most `(2/|d_a| − 1)` times the
    /// update. What flows in wrong stays as wrong as it was at most: every update is a mean.
    pub fn gain(&self) -> f32 {
        match self.rays {
            Rays::Parallel { way } => 2.0 / way[self.axis()].abs() - 1.0,
            Rays::Central { .. } => f32::INFINITY,
        }
    }

    /// Bound on the error of the whole volume per size of the last update of all voxels: `A w ≥ 1` for
    /// `w = 2n/|d_a|`, n the layers from the entry face on (A is an M-matrix).
    pub fn whole_gain(&self) -> f32 {
        match self.rays {
            Rays::Parallel { way } => 2.0 * self.size[self.axis()] as f32 / way[self.axis()].abs(),
            Rays::Central { .. } => f32::INFINITY,
        }
    }

    /// Layers and bands of strips: `[layers, bands]`.
    pub fn strips(&self) -> [usize; 2] {
        let [_, row, layer] = self.axes();
        [self.size[layer], self.size[row].div_ceil(Self::STRIP)]
    }

    /// Axes `[column, row, layer]`: layers across the dominant one, strips of rows in them.
    pub fn axes(&self) -> [usize; 3] {
        [[1, 2, 0], [0, 2, 1], [0, 1, 2]][self.axis()]
    }

    /// Bricks in an order such that every voxel's upstream neighbours come first: the bricks of a front are independent of
    /// one another.
    pub fn fronts(&self, layout: &BrickLayout) -> Vec<Vec<u32>> {
        let mut fronts = Vec::new();
        for b in 0..layout.len() {
            let depth: usize = self.depth(layout, b).iter().sum();
            if fronts.len() <= depth {
                fronts.resize(depth + 1, Vec::new());
            }
            fronts[depth].push(b as u32);
        }
        fronts
    }

    /// Bricks between the brick where light starts and brick `b`, along each axis.
    fn depth(&self, layout: &BrickLayout, b: usize) -> [usize; 3] {
        let (centre, coords) = (self.centre(), layout.coords(b));
        std::array::from_fn(|a| {
            let start = centre[a].clamp(0, self.size[a] as i32 - 1) as usize / layout.edge;
            coords[a].abs_diff(start)
        })
    }

    /// The up to seven bricks that brick `b` takes light from.
    pub fn upstream(&self, layout: &BrickLayout, b: usize) -> Vec<u32> {
        let (centre, coords, depth) = (self.centre(), layout.coords(b), self.depth(layout, b));
        let mut bricks = Vec::new();
        for mask in 1..8usize {
            if (0..3).all(|a| mask >> a & 1 == 0 || depth[a] > 0) {
                let nearer: [usize; 3] = std::array::from_fn(|a| match mask >> a & 1 {
                    0 => coords[a],
                    _ if (coords[a] * layout.edge) as i32 > centre[a] => coords[a] - 1,
                    _ => coords[a] + 1,
                });
                bricks.push(layout.number(nearer) as u32);
            }
        }
        bricks
    }

    /// A region in parts that lie on one side of the light's planes each, in an order such that upstream comes first.
    pub fn parts(&self, region: Region) -> Vec<Region> {
        let centre = self.centre();
        let sides: [Vec<(usize, usize)>; 3] = std::array::from_fn(|a| {
            let (start, end) = (region.start[a], region.end()[a]);
            let cut = centre[a].clamp(start as i32, end as i32) as usize;
            // The centre's own layer is above: what lies below waits for it.
            [(cut, end), (start, cut)].into_iter().filter(|(start, end)| start < end).collect()
        });
        let mut parts = Vec::new();
        for z in &sides[2] {
            for y in &sides[1] {
                for x in &sides[0] {
                    let size = [x.1 - x.0, y.1 - y.0, z.1 - z.0];
                    parts.push(Region { start: [x.0, y.0, z.0], size });
                }
            }
        }
        parts
    }

    /// Bound on the change of ρ across a layer, per world length of extinction changed: along the dominant axis a path goes
    /// `Δx/|u|` from layer to layer, and the literal scheme takes away at most twice what the opacity says.
    pub fn sensitivity(&self) -> f32 {
        match self.opacity {
            Opacity::Calibrated { length } => length,
            Opacity::Literal { length } => 2.0 * length,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every voxel is in one part of one brick, and its upstream neighbours are in the same or an earlier one.
    #[test]
    fn fronts_cover_the_grid_upstream_first() {
        let grid = Grid { size: [13, 9, 11], spacing: [1.0, 0.7, 1.3], origin: [0.0; 3] };
        let opacity = Opacity::Calibrated { length: 1.0 };
        let mut all = vec![
            Convection::distant(&grid, glam::Vec3::new(0.6, -0.64, 0.48), opacity),
            Convection::distant(&grid, glam::Vec3::NEG_Y, opacity),
        ];
        for position in [[6.2, 3.5, 4.9], [-3.0, 2.0, 30.0], [-0.3, 6.0, 5.0], [12.6, 2.8, 0.0], [40.0, 40.0, -40.0]] {
            all.push(Convection::central(&grid, DVec3::from(position), None, opacity));
        }
        for convection in all {
            let layout = BrickLayout::new(grid.size, 4);
            let fronts = convection.fronts(&layout);
            let mut depths = vec![0; layout.len()];
            for (depth, front) in fronts.iter().enumerate() {
                front.iter().for_each(|b| depths[*b as usize] = depth);
            }
            let (mut order, mut brick) = (vec![usize::MAX; grid.len()], vec![0; grid.len()]);
            for (n, b) in fronts.concat().into_iter().enumerate() {
                let upstream = convection.upstream(&layout, b as usize);
                assert!(upstream.iter().all(|u| depths[*u as usize] < depths[b as usize]), "{convection:?}");
                for (m, part) in convection.parts(layout.region(b as usize)).into_iter().enumerate() {
                    for k in part.start[2]..part.end()[2] {
                        for j in part.start[1]..part.end()[1] {
                            for i in part.start[0]..part.end()[0] {
                                let at = grid.index([i, j, k]);
                                assert_eq!(order[at], usize::MAX, "twice");
                                (order[at], brick[at]) = (8 * n + m, b);
                            }
                        }
                    }
                }
            }
            assert!(order.iter().all(|o| *o < usize::MAX), "not all");
            let centre = convection.centre();
            for at in 0..grid.len() {
                let p = [at % 13, at / 13 % 9, at / 117];
                for a in 0..3 {
                    let mut q = p.map(|v| v as i32);
                    match (q[a]).cmp(&centre[a]) {
                        std::cmp::Ordering::Equal => continue,
                        std::cmp::Ordering::Greater => q[a] -= 1,
                        std::cmp::Ordering::Less => q[a] += 1,
                    }
                    if (0..3).all(|a| q[a] >= 0 && q[a] < grid.size[a] as i32) {
                        let up = grid.index(q.map(|v| v as usize));
                        assert!(order[up] <= order[at], "{convection:?}: {q:?} after {p:?}");
                        let same = brick[up] == brick[at];
                        assert!(same || convection.upstream(&layout, brick[at] as usize).contains(&brick[up]));
                    }
                }
            }
        }
    }
}
