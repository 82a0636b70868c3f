//! Light: kept from step to step, by the model that the scene asks for.
//!
//! A *solver* holds what a solve needs (extinction now and before, scratch); the [`LightVolume`] holds the unknowns that
//! survive steps. Each solve starts from what the volume holds. Each model has a file of its own.

use crate::device::{Device, Term};
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::lights::Light;
use crate::medium::Medium;
use crate::scene::{Model, Scene, SolverKeys};

mod direct;
pub mod ordinates;
mod paper;
mod physical;

pub use direct::{Direct, DirectReport, Rays};
use paper::Paper;
use physical::Physical;

/// The light of one step: fluence per colour channel on the light grid.
#[derive(Debug, Clone, PartialEq)]
pub struct IlluminatedVolume {
    /// Where the values sit.
    pub grid: Grid,
    /// Fluence as (z, y, x, rgb).
    pub fluence: Vec<[f32; 3]>,
}

/// The light of the latest step; what the next solve starts from.
#[derive(Default)]
pub struct LightVolume {
    lights: Vec<Light>,
    physical: physical::Unknowns,
    paper: paper::Unknowns,
}

/// What one solve did and how good its result is.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SolveReport {
    /// True when the solve started from the previous step's light.
    pub warm: bool,
    /// Iterations of scattered light, 0 when it was not solved; in the paper's model the most that a layer or the diffusion
    /// took.
    pub iterations: u64,
    /// Sweeps in units of the whole grid they run on, all lights and directions.
    pub sweeps: f64,
    /// Voxel updates, change detection, residuals and comparisons included.
    pub voxel_updates: u64,
    /// Bricks of direct light that were swept, all lights; in the paper's model, of convection.
    pub bricks_active: u64,
    /// Bricks of direct light in all, all lights.
    pub bricks_total: u64,
    /// Bound on the error of the fluence against a cold solve, relative to the unattenuated light.
    pub certified_error: f64,
    /// False when scattered light, or an iteration of the paper's model, stopped at its limit.
    pub converged: bool,
}

/// Solves the light of one step after another.
pub struct LightSolver(Solver);

enum Solver {
    Physical(Box<Physical>),
    Paper(Box<Paper>),
}

impl LightSolver {
    /// Refuses what this version does not solve.
    pub fn check(keys: &SolverKeys) -> Result<()> {
        if keys.budget_ms.is_some() && keys.model == Model::Physical {
            return Err(Error::Unsupported(
                "light.budget_ms with light.model = \"physical\": that model solves to light.tolerance; \"paper\" has a budget"
                    .into(),
            ));
        }
        Ok(())
    }

    /// Allocates a solver for data on `data`.
    ///
    /// # Errors
    /// Those of [`LightSolver::check`], and what the device says of the memory.
    pub fn new(device: &dyn Device, scene: &Scene, data: &Grid) -> Result<Self> {
        Self::check(&scene.light)?;
        Ok(LightSolver(match scene.light.model {
            Model::Physical => Solver::Physical(Box::new(Physical::new(device, scene, data)?)),
            Model::Paper => Solver::Paper(Box::new(Paper::new(device, scene, data)?)),
        }))
    }

    /// Solves the light of `medium` under `lights`, starting from what `volume` holds.
    pub fn solve(
        &mut self,
        device: &dyn Device,
        medium: &Medium,
        lights: &[Light],
        volume: &mut LightVolume,
    ) -> Result<SolveReport> {
        volume.lights = lights.to_vec();
        match &mut self.0 {
            Solver::Physical(solver) => solver.solve(device, medium, lights, &mut volume.physical),
            Solver::Paper(solver) => solver.solve(device, medium, lights, &mut volume.paper),
        }
    }

    /// The fluence of the latest solve on the light grid, `light.resolution`.
    pub fn illuminated(&self, device: &dyn Device, volume: &LightVolume) -> Result<IlluminatedVolume> {
        match &self.0 {
            Solver::Physical(solver) => solver.illuminated(device, &volume.physical),
            Solver::Paper(solver) => solver.illuminated(device, &volume.paper),
        }
    }
}

impl LightVolume {
    /// The light as the ray caster takes it.
    pub fn terms(&self) -> Vec<Term<'_>> {
        let mut terms = self.physical.terms();
        terms.extend(self.paper.terms());
        terms
    }

    /// The lights of the latest solve.
    pub fn lights(&self) -> &[Light] {
        &self.lights
    }
}
