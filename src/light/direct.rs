//! Direct light, kept from step to step: the certified incremental sweep of light.md.
//!
//! A brick remembers how far its inputs have drifted since it was last swept: the optical depth across it by at most
//! `Σ|Δσ|·Δs`, the light that enters it by at most the changes of its upstream neighbours' downstream faces. Drifts are
//! summed over the steps, so by the triangle inequality the sum bounds the distance to what the brick *last used*, however
//! slowly the medium creeps. Short characteristics are a max-norm contraction, so a brick that is not swept again is off by
//! at most `e = eps_upstream + drift of inflow + min(1, drift of depth)`. It is left alone while e stays below its share of the
//! tolerance (more of it downstream), and swept otherwise. At tolerance 0 only bricks whose inputs are the same to the bit
//! are left alone, so the result is that of a cold solve to the bit.

use glam::Vec3;

use crate::device::{Buffer, Device, Sweep};
use crate::error::Result;
use crate::grid::{BrickLayout, Grid};

/// Rounding that a brick may add to a difference, in units of the last place of 1.
const ROUNDING: f32 = 4.0 * f32::EPSILON;

/// Direct light of one distant light: transmittance from the light to every voxel of a grid.
pub struct Direct {
    /// Transmittance ρ, 0..1, (z, y, x).
    pub rho: Buffer,
    sweep: Sweep,
    fronts: Vec<Vec<u32>>,
    bricks: Vec<Brick>,
    solved: bool,
}

/// What a brick knows of its own error.
#[derive(Clone, Copy, Default)]
struct Brick {
    /// Drift of optical depth since the brick was swept.
    depth: f32,
    /// Drift of the light that enters since then.
    inflow: f32,
    /// Largest change of an upstream neighbour's face in this step.
    arriving: f32,
    /// Bound on the error against a cold solve.
    error: f32,
}

/// What one solve of direct light did.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct DirectReport {
    /// Bricks that were swept.
    pub bricks_active: u64,
    /// Bricks in all.
    pub bricks_total: u64,
    /// Voxels that were swept.
    pub voxels: u64,
    /// Bound on the error of ρ against a cold solve.
    pub certified_error: f32,
}

impl Direct {
    /// Allocates the state for light that travels along unit world direction `direction`.
    pub fn new(device: &dyn Device, grid: &Grid, layout: &BrickLayout, direction: Vec3, cubic: bool) -> Result<Self> {
        let sweep = Sweep::new(grid, direction, cubic);
        Ok(Direct {
            rho: device.alloc(grid.len())?,
            sweep,
            fronts: layout.fronts(sweep.ascending()),
            bricks: vec![Brick::default(); layout.len()],
            solved: false,
        })
    }

    /// Solves for `sigma`. `change` is [`Device::change`] against the medium of the previous call, `None` for a cold solve.
    pub fn solve(
        &mut self,
        device: &dyn Device,
        grid: &Grid,
        layout: &BrickLayout,
        sigma: &Buffer,
        change: Option<&[[f32; 3]]>,
        tolerance: f32,
    ) -> Result<DirectReport> {
        let mut report = DirectReport { bricks_total: layout.len() as u64, ..Default::default() };
        // A cubic foot is not certified by bricks: unless nothing changed at all, everything is swept.
        let still = |c: &[[f32; 3]]| c.iter().all(|c| c[self.sweep.axis()] == 0.0);
        // Where nothing is known of any brick, all at once is the faster way.
        let known = |c: &[[f32; 3]]| c.iter().any(|c| c[self.sweep.axis()].is_finite());
        let change = change.filter(|c| self.solved && known(c) && (!self.sweep.cubic || still(c)));
        let Some(change) = change else {
            self.solved = false;
            let fronts: Vec<&[u32]> = self.fronts.iter().map(|f| &f[..]).collect();
            device.sweep(&self.sweep, layout, sigma, &mut self.rho, &fronts)?;
            self.bricks.fill(Brick::default());
            self.solved = true;
            report.bricks_active = layout.len() as u64;
            report.voxels = grid.len() as u64;
            return Ok(report);
        };

        // Until every front is done the state is neither the old nor the new solution.
        self.solved = false;
        let axis = self.sweep.axis();
        // `change` is per unit spacing along the axis; a path crosses a layer in `length`.
        let per_change = self.sweep.length;
        let deepest = self.fronts.len() as f32;
        let ascending = self.sweep.ascending();
        for (depth, front) in self.fronts.iter().enumerate() {
            let share = tolerance * (depth + 1) as f32 / deepest;
            let mut active = Vec::new();
            for &b in front {
                let upstream = neighbours(layout, b, ascending, false).fold(0.0f32, |m, n| m.max(self.bricks[n].error));
                let brick = &mut self.bricks[b as usize];
                brick.depth += change[b as usize][axis] * per_change;
                brick.inflow += std::mem::take(&mut brick.arriving);
                if brick.depth == 0.0 && brick.inflow == 0.0 {
                    brick.error = upstream;
                    continue;
                }
                let error = upstream + brick.inflow + brick.depth.min(1.0) + ROUNDING;
                if error <= share {
                    brick.error = error;
                } else {
                    let rounding = if upstream > 0.0 { ROUNDING } else { 0.0 };
                    *brick = Brick { error: upstream + rounding, ..Brick::default() };
                    active.push(b);
                }
            }
            if active.is_empty() {
                continue;
            }
            let changes = device.sweep(&self.sweep, layout, sigma, &mut self.rho, &[&active])?;
            report.bricks_active += active.len() as u64;
            for (&b, change) in active.iter().zip(changes) {
                report.voxels += layout.region(b as usize).len() as u64;
                for n in neighbours(layout, b, ascending, true) {
                    self.bricks[n].arriving = self.bricks[n].arriving.max(change);
                }
            }
        }
        self.solved = true;
        report.certified_error = self.bricks.iter().fold(0.0, |m, b| m.max(b.error));
        Ok(report)
    }

    /// True when the kept solution is of this light: same direction, grid and foot.
    pub fn fits(&self, grid: &Grid, direction: Vec3, cubic: bool) -> bool {
        self.sweep == Sweep::new(grid, direction, cubic)
    }

    /// Forgets the kept solution: the next solve is cold.
    pub fn forget(&mut self) {
        self.solved = false;
    }
}

/// The up to seven neighbours of brick `b` towards (`downstream`) or against the light.
fn neighbours(layout: &BrickLayout, b: u32, ascending: [bool; 3], downstream: bool) -> impl Iterator<Item = usize> {
    let (layout, counts, coords) = (*layout, layout.counts(), layout.coords(b as usize));
    (1..8).filter_map(move |mask: usize| {
        let mut c = coords;
        for a in 0..3 {
            if mask >> a & 1 == 1 {
                c[a] = if ascending[a] == downstream { c[a] + 1 } else { c[a].checked_sub(1)? };
                if c[a] >= counts[a] {
                    return None;
                }
            }
        }
        Some(layout.number(c))
    })
}
