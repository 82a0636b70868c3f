//! Direct light, kept from step to step: the certified incremental sweep of light.md.
//!
//! A brick remembers how far its inputs have drifted since it was last swept: the optical depth across it by at most
//! `Σ|Δσ|·Δs`, the light that enters it by at most the changes of its upstream neighbours' downstream faces. Drifts are
//! summed over the steps, so by the triangle inequality the sum bounds the distance to what the brick *last used*, however
//! slowly the medium creeps. Short characteristics are a max-norm contraction, so a brick that is not swept again is off by
//! at most `e = eps_upstream + drift of inflow + min(1, drift of depth)`. It is left alone while e stays below its share of the
//! tolerance (more of it downstream), and swept otherwise. At tolerance 0 only bricks whose inputs are the same to the bit
//! are left alone, so the result is that of a cold solve to the bit.

use glam::{DVec3, Vec3};

use crate::device::{Buffer, Device, PointSweep, Sweep};
use crate::error::Result;
use crate::grid::{BrickLayout, Grid};

/// Rounding that a brick may add to a difference, in units of the last place of 1.
const ROUNDING: f32 = 4.0 * f32::EPSILON;

/// The rays of a light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Rays {
    /// Of a distant light.
    Parallel(Sweep),
    /// From a point.
    Radial(PointSweep),
}

impl Rays {
    /// Parallel rays along unit world direction `direction`, through extinction times `factor`.
    pub fn parallel(grid: &Grid, direction: Vec3, cubic: bool, factor: f32) -> Self {
        let sweep = Sweep::new(grid, direction, cubic);
        Rays::Parallel(Sweep { length: factor * sweep.length, ..sweep })
    }

    /// Rays from world position `position`, through extinction times `factor`; feet are always bilinear.
    pub fn radial(grid: &Grid, position: DVec3, factor: f32) -> Self {
        Rays::Radial(PointSweep::new(grid, position, factor))
    }

    /// The rays' order of bricks: fronts, and the bricks that each brick reads.
    fn order(&self, layout: &BrickLayout) -> (Vec<Vec<u32>>, Vec<Vec<u32>>) {
        match self {
            Rays::Parallel(sweep) => {
                let ascending = sweep.ascending();
                let upstream = (0..layout.len()).map(|b| upstream(layout, b, ascending)).collect();
                (layout.fronts(ascending), upstream)
            }
            Rays::Radial(sweep) => {
                (sweep.fronts(layout), (0..layout.len()).map(|b| sweep.upstream(layout, b)).collect())
            }
        }
    }

    /// For each brick, the longest step of a path per layer along each axis; 0 along an axis that no path in it steps along.
    fn steps(&self, layout: &BrickLayout) -> Vec<[f32; 3]> {
        let step = |b: usize| match self {
            Rays::Parallel(sweep) => std::array::from_fn(|a| if a == sweep.axis() { sweep.length } else { 0.0 }),
            Rays::Radial(sweep) => {
                let region = layout.region(b);
                let span: [[f32; 2]; 3] = std::array::from_fn(|a| {
                    // Ghosts are one voxel beyond the brick.
                    let (first, last) = (region.start[a] as i32 - 1, region.end()[a] as i32);
                    let ends = [sweep.offset(a, first), sweep.offset(a, last)];
                    let far = ends[0].abs().max(ends[1].abs());
                    [if ends[0] * ends[1] < 0.0 { 0.0 } else { ends[0].abs().min(ends[1].abs()) }, far]
                });
                std::array::from_fn(|a| {
                    let others = [(a + 1) % 3, (a + 2) % 3];
                    if others.iter().any(|&o| span[o][0] > span[a][1]) {
                        return 0.0;
                    }
                    let aside = |o: usize| sweep.spacing[o] * (span[o][1] / span[a][0].max(1.0)).min(1.0);
                    let [x, y] = others.map(aside);
                    (sweep.spacing[a].powi(2) + x * x + y * y).sqrt()
                })
            }
        };
        (0..layout.len()).map(step).collect()
    }

    /// Bricks with voxels that take the integral along their ray, and the longest such ray.
    fn beside(&self, layout: &BrickLayout) -> (Vec<u32>, f32) {
        let Rays::Radial(sweep) = self else { return (vec![], 0.0) };
        let near = |a: usize, start: usize, end: usize| (start..end).any(|i| sweep.layer(a, i as i32) <= 1);
        let bricks = (0..layout.len()).filter(|&b| {
            let region = layout.region(b);
            (0..3).all(|a| near(a, region.start[a], region.end()[a]))
        });
        (bricks.map(|b| b as u32).collect(), 2.0 * Vec3::from(sweep.spacing).length())
    }

    fn cubic(&self) -> bool {
        matches!(self, Rays::Parallel(sweep) if sweep.cubic)
    }

    fn sweep(
        &self,
        device: &dyn Device,
        layout: &BrickLayout,
        sigma: &Buffer,
        rho: &mut Buffer,
        fronts: &[&[u32]],
    ) -> Result<Vec<f32>> {
        match self {
            Rays::Parallel(sweep) => device.sweep(sweep, layout, sigma, rho, fronts),
            Rays::Radial(sweep) => device.sweep_point(sweep, layout, sigma, rho, fronts),
        }
    }
}

/// Share of the bricks above which sweeping the needed ones costs more than the whole grid.
const FEW: f64 = 0.5;

/// Direct light of one light: transmittance from the light to every voxel of a grid.
pub struct Direct {
    /// Transmittance ρ, 0..1, (z, y, x).
    pub rho: Buffer,
    rays: Rays,
    fronts: Vec<Vec<u32>>,
    upstream: Vec<Vec<u32>>,
    /// See [`Rays::steps`] and [`Rays::beside`].
    steps: Vec<[f32; 3]>,
    beside: (Vec<u32>, f32),
    bricks: Vec<Brick>,
    /// Largest change of a brick's downstream faces in this step.
    moved: Vec<f32>,
    /// Bricks that the latest solve swept.
    touched: Vec<bool>,
    /// Bricks that somebody can see, and those upstream of them.
    needed: Vec<bool>,
    solved: bool,
}

/// What a brick knows of its own error.
#[derive(Clone, Copy, Default)]
struct Brick {
    /// Drift of optical depth since the brick was swept.
    depth: f32,
    /// Drift of the light that enters since then.
    inflow: f32,
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
    /// Bricks that would have been swept if anybody could see their light.
    pub bricks_culled: u64,
    /// Voxels that were swept.
    pub voxels: u64,
    /// Bound on the error of ρ against a cold solve.
    pub certified_error: f32,
}

impl Direct {
    /// Allocates the state for light that travels along unit world direction `direction`.
    pub fn new(device: &dyn Device, grid: &Grid, layout: &BrickLayout, direction: Vec3, cubic: bool) -> Result<Self> {
        Ok(Self::of(device.alloc(grid.len())?, layout, Rays::parallel(grid, direction, cubic, 1.0)))
    }

    /// The state for any rays, in memory for ρ that somebody allocated.
    pub fn of(rho: Buffer, layout: &BrickLayout, rays: Rays) -> Self {
        let (fronts, upstream) = rays.order(layout);
        Direct {
            rho,
            rays,
            fronts,
            upstream,
            steps: rays.steps(layout),
            beside: rays.beside(layout),
            bricks: vec![Brick::default(); layout.len()],
            moved: vec![0.0; layout.len()],
            touched: vec![true; layout.len()],
            needed: vec![true; layout.len()],
            solved: false,
        }
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
        let still = |c: &[[f32; 3]]| c.iter().flatten().all(|c| *c == 0.0);
        // Where nothing is known of any brick, all at once is the faster way.
        let known = |c: &[[f32; 3]]| c.iter().flatten().any(|c| c.is_finite());
        let change = change.filter(|c| self.solved && known(c) && (!self.rays.cubic() || still(c)));
        // Until every front is done the state is neither the old nor the new solution.
        self.solved = false;
        let Some(change) = change else {
            let needed = self.needed.iter().filter(|n| **n).count();
            let whole = self.rays.cubic() || needed as f64 > FEW * layout.len() as f64;
            let wanted = |b: &u32| whole || self.needed[*b as usize];
            let fronts: Vec<Vec<u32>> =
                self.fronts.iter().map(|f| f.iter().copied().filter(wanted).collect()).collect();
            let fronts: Vec<&[u32]> = fronts.iter().map(|f| &f[..]).filter(|f| !f.is_empty()).collect();
            self.rays.sweep(device, layout, sigma, &mut self.rho, &fronts)?;
            let report = self.swept(layout, whole);
            debug_assert!(!whole || report.voxels == grid.len() as u64);
            return Ok(report);
        };

        // No |Δσ| in a brick is larger than its change along any axis.
        let beside = self.beside.0.iter().map(|&b| change[b as usize].into_iter().fold(f32::INFINITY, f32::min));
        let beside = self.beside.1 * beside.fold(0.0, f32::max);
        self.moved.fill(0.0);
        self.touched.fill(false);
        let deepest = self.fronts.len() as f32;
        for (depth, front) in self.fronts.iter().enumerate() {
            let share = tolerance * (depth + 1) as f32 / deepest;
            let mut active = Vec::new();
            for &b in front {
                let read = || self.upstream[b as usize].iter().map(|&n| n as usize);
                let upstream = read().fold(0.0f32, |m, n| m.max(self.bricks[n].error));
                let arriving = read().fold(0.0f32, |m, n| m.max(self.moved[n]));
                let brick = &mut self.bricks[b as usize];
                // `change` is per layer; a path crosses each in at most a step.
                let across = self.steps[b as usize].into_iter().zip(change[b as usize]);
                brick.depth += across.map(|(step, c)| if step > 0.0 { step * c } else { 0.0 }).sum::<f32>();
                if self.beside.0.contains(&b) {
                    brick.depth += beside;
                }
                brick.inflow += arriving;
                if brick.depth == 0.0 && brick.inflow == 0.0 {
                    brick.error = upstream;
                    continue;
                }
                let depth = if brick.depth < f32::INFINITY { brick.depth.min(1.0) } else { brick.depth };
                let error = upstream + brick.inflow + depth + ROUNDING;
                if !self.needed[b as usize] {
                    // Drift goes on adding up, until the brick is needed.
                    brick.error = error;
                    report.bricks_culled += 1;
                } else if error <= share {
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
            let changes = self.rays.sweep(device, layout, sigma, &mut self.rho, &[&active])?;
            report.bricks_active += active.len() as u64;
            for (&b, change) in active.iter().zip(changes) {
                self.touched[b as usize] = true;
                report.voxels += layout.region(b as usize).len() as u64;
                self.moved[b as usize] = change;
            }
        }
        self.solved = true;
        let needed = self.bricks.iter().zip(&self.needed).filter(|(_, needed)| **needed);
        report.certified_error = needed.fold(0.0, |m, (b, _)| m.max(b.error));
        Ok(report)
    }

    /// The sweep of parallel rays and where their light is, for [`Device::sweep_each`].
    pub(super) fn parallel(&mut self) -> Option<(Sweep, &mut Buffer)> {
        let Rays::Parallel(sweep) = self.rays else { return None };
        self.solved = false;
        Some((sweep, &mut self.rho))
    }

    /// Takes note of a sweep of all bricks, or of those that are needed.
    pub(super) fn swept(&mut self, layout: &BrickLayout, whole: bool) -> DirectReport {
        let mut report = DirectReport { bricks_total: layout.len() as u64, ..Default::default() };
        for (b, brick) in self.bricks.iter_mut().enumerate() {
            let swept = whole || self.needed[b];
            // What was left out holds nothing that could be kept.
            *brick = Brick { depth: if swept { 0.0 } else { f32::INFINITY }, ..Brick::default() };
            self.touched[b] = swept;
            report.voxels += if swept { layout.region(b).len() as u64 } else { 0 };
            report.bricks_active += u64::from(swept);
        }
        self.solved = true;
        report.bricks_culled = report.bricks_total - report.bricks_active;
        report
    }

    /// The rays that the kept solution is of.
    pub fn rays(&self) -> &Rays {
        &self.rays
    }

    /// True when there is a kept solution.
    pub fn is_solved(&self) -> bool {
        self.solved
    }

    /// Solves from now on only for the bricks that are marked as seen and for those that their light comes through; `None`: for
    /// all.
    pub fn demand(&mut self, seen: Option<&[bool]>) {
        let Some(seen) = seen else { return self.needed.fill(true) };
        self.needed.copy_from_slice(seen);
        for &b in self.fronts.iter().rev().flatten() {
            if self.needed[b as usize] {
                self.upstream[b as usize].iter().for_each(|n| self.needed[*n as usize] = true);
            }
        }
    }

    /// What each brick knows of its own error, for [`Direct::restore`].
    pub(super) fn drift(&self) -> Vec<f32> {
        self.bricks.iter().flat_map(|b| [b.depth, b.inflow, b.error]).collect()
    }

    /// Takes up a solution of this light that was kept: ρ and the drift of each brick. False when they are of another size.
    pub(super) fn restore(&mut self, device: &dyn Device, rho: &[f32], drift: &[f32]) -> Result<bool> {
        if rho.len() != self.rho.len() || drift.len() != 3 * self.bricks.len() {
            return Ok(false);
        }
        device.upload(rho, &mut self.rho)?;
        for (brick, known) in self.bricks.iter_mut().zip(drift.chunks_exact(3)) {
            *brick = Brick { depth: known[0], inflow: known[1], error: known[2] };
        }
        self.solved = true;
        Ok(true)
    }

    /// For each brick whether the latest solve swept it; the others hold what they held.
    pub fn touched(&self) -> &[bool] {
        &self.touched
    }

    /// Forgets the kept solution: the next solve is cold.
    pub fn forget(&mut self) {
        self.solved = false;
    }
}

/// The up to seven neighbours of brick `b` against the light.
fn upstream(layout: &BrickLayout, b: usize, ascending: [bool; 3]) -> Vec<u32> {
    let (counts, coords) = (layout.counts(), layout.coords(b));
    (1..8usize)
        .filter_map(|mask| {
            let mut c = coords;
            for a in 0..3 {
                if mask >> a & 1 == 1 {
                    c[a] = if ascending[a] { c[a].checked_sub(1)? } else { c[a] + 1 };
                    if c[a] >= counts[a] {
                        return None;
                    }
                }
            }
            Some(layout.number(c) as u32)
        })
        .collect()
}
