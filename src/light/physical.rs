//! The physical model: direct light by short characteristics, multiple scattering by first-collision-source ordinates.

use super::direct::Direct;
use super::ordinates::{ScatterProblem, Scattered};
use super::{IlluminatedVolume, SolveReport};
use crate::device::{Buffer, Device, Optic, Term, Weight};
use crate::error::Result;
use crate::grid::{BrickLayout, Grid};
use crate::lights::Light;
use crate::medium::Medium;
use crate::scene::{Interpolation, Scene, SolverKeys};

/// What survives a step.
#[derive(Default)]
pub(super) struct Unknowns {
    direct: Vec<Direct>,
    scattered: Option<Scattered>,
    grid: Option<Grid>,
    anisotropy: f32,
    /// What the latest scattered light was solved for, and how well.
    lights: Vec<Light>,
    certified: f64,
    converged: bool,
}

/// Bricks of direct light: finer ones follow what changed more closely, coarser ones are swept faster a voxel. On smoke that
/// moves by a voxel a step 16³ are swept in half of the volume, 32³ in three quarters.
const EDGE: usize = 16;

/// Share of the bricks above which sweeping them one by one costs more than the whole.
const MANY: f64 = 0.6;

/// Steps that are swept whole, without looking for change, after one in which many bricks were.
const UNLOOKED: u32 = 3;

/// Extinction now and before, and scratch.
pub(super) struct Physical {
    keys: SolverKeys,
    anisotropy: f32,
    grid: Grid,
    coarse: Grid,
    layout: BrickLayout,
    sigma: [Buffer; 2],
    solved: bool,
    /// Steps still to come that are swept whole.
    unlooked: u32,
    optics: Option<Optics>,
}

/// Optics and first-collision light on the grid of scattered light.
struct Optics {
    sigma: Buffer,
    scattering: Vec<Buffer>,
    emission: Vec<Buffer>,
    first: Vec<Buffer>,
}

impl Physical {
    /// Allocates a solver for data on `data`.
    pub(super) fn new(device: &dyn Device, scene: &Scene, data: &Grid) -> Result<Self> {
        let keys = scene.light.clone();
        let grid = data.resized(SolverKeys::grid_size(keys.direct_resolution, data.size));
        let coarse = data.resized(SolverKeys::grid_size(keys.resolution, data.size));
        Ok(Physical {
            anisotropy: scene.transfer.anisotropy,
            layout: BrickLayout::new(grid.size, EDGE),
            sigma: [device.alloc(grid.len())?, device.alloc(grid.len())?],
            solved: false,
            unlooked: 0,
            optics: None,
            keys,
            grid,
            coarse,
        })
    }

    /// Solves the light of `medium` under `lights`, starting from what `volume` holds.
    pub(super) fn solve(
        &mut self,
        device: &dyn Device,
        medium: &Medium,
        lights: &[Light],
        volume: &mut Unknowns,
    ) -> Result<SolveReport> {
        let mut report = SolveReport { converged: true, ..Default::default() };
        self.sigma.swap(0, 1);
        let [now, before] = &mut self.sigma;
        // With multiple scattering the forward peak counts as unscattered (delta-Eddington), in what the eye sees too.
        let f = if self.keys.scattering { self.anisotropy * self.anisotropy } else { 0.0 };
        let optic = if f == 0.0 { Optic::Extinction } else { Optic::ScaledExtinction { f } };
        device.classify(optic, &medium.table, medium.grid.size, &medium.field, self.grid.size, now)?;
        let warm = self.keys.warm && std::mem::replace(&mut self.solved, false) && volume.grid == Some(self.grid);
        let look = warm && self.unlooked == 0;
        self.unlooked = self.unlooked.saturating_sub(1);
        let change = if look {
            report.voxel_updates += self.grid.len() as u64;
            Some(device.change(&self.layout, now, before)?)
        } else {
            None
        };
        volume.grid = Some(self.grid);
        volume.anisotropy = self.anisotropy;
        report.warm = warm;
        self.direct(device, lights, change.as_deref(), volume, &mut report)?;
        if look && report.bricks_active as f64 > MANY * report.bricks_total as f64 {
            self.unlooked = UNLOOKED;
        }
        let still = change.is_some_and(|c| c.iter().all(|c| *c == [0.0; 3])) && volume.lights == lights;
        if still && volume.scattered.is_some() && self.still(device, medium, &mut report)? {
            report.certified_error += volume.certified;
            report.converged = volume.converged;
        } else {
            let direct = report.certified_error;
            self.scattered(device, medium, lights, warm, volume, &mut report)?;
            volume.certified = report.certified_error - direct;
            volume.converged = report.converged;
            volume.lights = lights.to_vec();
        }
        self.solved = true;
        Ok(report)
    }

    /// True when the medium scatters and glows as in the step before; its extinction does.
    fn still(&self, device: &dyn Device, medium: &Medium, report: &mut SolveReport) -> Result<bool> {
        if !medium.same_table() {
            return Ok(false);
        }
        let told = self.grid.size == medium.grid.size && medium.table.constant_albedo().is_some();
        if told && medium.table.emission.is_empty() {
            return Ok(true);
        }
        report.voxel_updates += medium.grid.len() as u64;
        medium.still(device)
    }

    /// Direct light of every distant light.
    fn direct(
        &mut self,
        device: &dyn Device,
        lights: &[Light],
        change: Option<&[[f32; 3]]>,
        volume: &mut Unknowns,
        report: &mut SolveReport,
    ) -> Result<()> {
        let cubic = self.keys.interpolation == Interpolation::Cubic;
        // An error of direct light comes back from scattering up to 1/(1 − ω) times, and a sweep costs less than one ordinate's:
        // where light scatters on, only what is the same to the bit is left alone.
        let tolerance = if self.keys.scattering { 0.0 } else { self.keys.tolerance };
        let distant: Vec<_> = distant(lights).collect();
        let total: f32 = distant.iter().map(|(_, e)| brightest(*e)).sum();
        volume.direct.truncate(distant.len());
        for (n, (direction, irradiance)) in distant.into_iter().enumerate() {
            if volume.direct.get(n).is_none_or(|d| !d.fits(&self.grid, direction, cubic)) {
                let fresh = Direct::new(device, &self.grid, &self.layout, direction, cubic)?;
                if n < volume.direct.len() {
                    volume.direct[n] = fresh;
                } else {
                    volume.direct.push(fresh);
                }
            }
            let kept = &mut volume.direct[n];
            let done = kept.solve(device, &self.grid, &self.layout, &self.sigma[0], change, tolerance)?;
            report.bricks_active += done.bricks_active;
            report.bricks_total += done.bricks_total;
            report.voxel_updates += done.voxels;
            report.sweeps += done.voxels as f64 / self.grid.len() as f64;
            if total > 0.0 {
                report.certified_error += f64::from(done.certified_error * brightest(irradiance) / total);
            }
        }
        Ok(())
    }

    /// Scattered light, and the uncollided light of the environment.
    fn scattered(
        &mut self,
        device: &dyn Device,
        medium: &Medium,
        lights: &[Light],
        warm: bool,
        volume: &mut Unknowns,
        report: &mut SolveReport,
    ) -> Result<()> {
        let environment = environment(lights);
        if !self.keys.scattering && environment == [0.0; 3] {
            volume.scattered = None;
            return Ok(());
        }
        let channels = if gray(medium, lights) { 1 } else { 3 };
        let glows = !medium.table.emission.is_empty();
        let f = self.anisotropy * self.anisotropy;
        let fits = |o: &Optics| {
            o.scattering.len() == channels && o.emission.is_empty() != glows && o.first.len() == volume.direct.len()
        };
        if !self.optics.as_ref().is_some_and(fits) {
            let buffer = || device.alloc(self.coarse.len());
            let buffers = |n: usize| (0..n).map(|_| buffer()).collect::<Result<Vec<_>>>();
            self.optics = Some(Optics {
                sigma: buffer()?,
                scattering: buffers(channels)?,
                emission: buffers(if glows { channels } else { 0 })?,
                first: buffers(volume.direct.len())?,
            });
        }
        let optics = self.optics.as_mut().expect("just made");
        let classify = |optic, out: &mut Buffer| {
            device.classify(optic, &medium.table, medium.grid.size, &medium.field, self.coarse.size, out)
        };
        classify(Optic::ScaledExtinction { f }, &mut optics.sigma)?;
        for (channel, out) in optics.scattering.iter_mut().enumerate() {
            classify(Optic::Scattering { channel }, out)?;
        }
        for (channel, out) in optics.emission.iter_mut().enumerate() {
            classify(Optic::Emission { channel }, out)?;
        }
        for (direct, out) in volume.direct.iter().zip(&mut optics.first) {
            device.restrict(self.grid.size, &direct.rho, self.coarse.size, out)?;
        }
        let first: Vec<_> =
            optics.first.iter().zip(distant(lights)).map(|(rho, (direction, e))| (rho, e, direction)).collect();
        let problem = ScatterProblem {
            sigma: &optics.sigma,
            scattering: &optics.scattering,
            emission: &optics.emission,
            first: &first,
            environment,
            anisotropy: self.anisotropy,
            directions: self.keys.directions,
            tolerance: self.keys.tolerance,
            warm,
            scattering_on: self.keys.scattering,
        };
        if volume.scattered.as_ref().is_none_or(|s| !s.fits(&self.coarse, channels, self.anisotropy)) {
            volume.scattered = Some(Scattered::new(device, self.coarse, channels, self.anisotropy)?);
        }
        let done = volume.scattered.as_mut().expect("just made").solve(device, &problem)?;
        report.iterations = done.iterations;
        report.sweeps += done.sweeps;
        report.voxel_updates += done.voxel_updates;
        report.certified_error += done.certified_error;
        report.converged = done.converged;
        Ok(())
    }

    /// The fluence of the latest solve on the grid of scattered light (light grid, `light.resolution`).
    pub(super) fn illuminated(
        &self,
        device: &dyn Device,
        lights: &[Light],
        volume: &Unknowns,
    ) -> Result<IlluminatedVolume> {
        let mut first = Vec::new();
        for direct in &volume.direct {
            let mut out = device.alloc(self.coarse.len())?;
            device.restrict(self.grid.size, &direct.rho, self.coarse.size, &mut out)?;
            first.push(out);
        }
        let mut terms: Vec<(&Buffer, [f32; 3])> =
            first.iter().zip(distant(lights)).map(|(rho, (_, e))| (rho, e)).collect();
        if let Some(scattered) = &volume.scattered {
            terms.extend(scattered.fluence());
        }
        let mut fluence = vec![[0.0; 3]; self.coarse.len()];
        device.compose(&terms, &mut fluence)?;
        Ok(IlluminatedVolume { grid: self.coarse, fluence })
    }
}

impl Unknowns {
    /// The light as the ray caster takes it: one term for each light, and those of scattered light.
    pub(super) fn terms(&self, lights: &[Light]) -> Vec<Term<'_>> {
        let Some(grid) = &self.grid else { return vec![] };
        let g = self.anisotropy;
        let direct = self.direct.iter().zip(distant(lights)).map(|(d, (direction, irradiance))| Term {
            values: &d.rho,
            grid,
            weight: Weight::Phase { direction, irradiance, g },
        });
        let scattered = self.scattered.iter().flat_map(|s| s.terms());
        direct.chain(scattered).collect()
    }
}

fn distant(lights: &[Light]) -> impl Iterator<Item = (glam::Vec3, [f32; 3])> {
    lights.iter().filter_map(|l| match *l {
        Light::Distant { direction, irradiance } => Some((direction, irradiance)),
        Light::Point { .. } | Light::Cone { .. } | Light::Environment { .. } => None,
    })
}

/// Radiance of all environment lights together.
fn environment(lights: &[Light]) -> [f32; 3] {
    lights.iter().fold([0.0; 3], |sum, l| match l {
        Light::Environment { radiance } => std::array::from_fn(|c| sum[c] + radiance[c]),
        Light::Distant { .. } | Light::Point { .. } | Light::Cone { .. } => sum,
    })
}

fn brightest(rgb: [f32; 3]) -> f32 {
    rgb.into_iter().fold(0.0, f32::max)
}

/// True when one channel stands for all three: medium and lights are gray.
fn gray(medium: &Medium, lights: &[Light]) -> bool {
    let even = |c: [f32; 3]| c[0] == c[1] && c[1] == c[2];
    medium.table.gray()
        && medium.table.emission.iter().all(|e| even(*e))
        && distant(lights).all(|(_, e)| even(e))
        && even(environment(lights))
}
