//! Light: kept from step to step, by the model that the scene asks for.
//!
//! A *solver* holds what a solve needs (extinction now and before, scratch); the [`LightVolume`] holds the unknowns that
//! survive steps. Each solve starts from what the volume holds. Each model has a file of its own.
//!
//! Memory of the physical model, in f32: 2 values and one more for each distant light a voxel of the grid of direct light, and
//! [`ordinates::Scattered::volumes`] a voxel of the grid of scattered light: 30, and 2 for each light, where one channel stands for
//! all and scattering is isotropic. All of it is taken in the first steps and used again.

use crate::device::{Cone, Device, Lamp, Term, Weight};
use crate::error::{Error, Result};
use crate::geometry::Geometry;
use crate::grid::{BrickLayout, Grid};
use crate::lights::Light;
use crate::medium::Medium;
use crate::scene::{Model, Scene};

mod direct;
pub mod ordinates;
mod paper;
mod physical;

pub use direct::{Direct, DirectReport, Rays};
use paper::Paper;
use physical::Physical;

/// The lamp that a light in one place is, and its radiant intensity.
pub(crate) fn lamp(light: &Light) -> Option<(Lamp, [f32; 3])> {
    match *light {
        Light::Point { position, radius, intensity } => Some((Lamp { position, radius, cone: None }, intensity)),
        Light::Cone { position, direction, angle, edge, radius, intensity } => {
            let cone = Cone { axis: direction, outer: angle.cos(), inner: (angle - edge).cos(), cosine: false };
            Some((Lamp { position, radius, cone: Some(cone) }, intensity))
        }
        Light::Patch { position, direction, radius, intensity } => {
            Some((Lamp { position, radius, cone: Some(Cone::facing(direction)) }, intensity))
        }
        _ => None,
    }
}

/// What one unit of a light's transmittance adds to radiance where it is scattered by Henyey–Greenstein's `g`; `None` of
/// environments.
pub(crate) fn weight(light: &Light, g: f32) -> Option<Weight> {
    match *light {
        Light::Distant { direction, irradiance } => Some(Weight::Phase { direction, irradiance, g }),
        _ => lamp(light).map(|(lamp, intensity)| Weight::Lamp { lamp, intensity, g }),
    }
}

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
    /// Bricks of direct light that were left out because nobody can see them ([`LightSolver::only_visible`]), all lights.
    pub bricks_culled: u64,
    /// Bound on the error of the fluence against a cold solve, relative to the unattenuated light.
    pub certified_error: f64,
    /// False when scattered light, or an iteration of the paper's model, stopped at its limit or at the end of its budget.
    pub converged: bool,
}

/// Where the light of [`LightVolume::terms`] differs from that of the solve before.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Touched<'a> {
    /// Possibly everywhere.
    Everywhere,
    /// At most in the bricks that are marked; their grid fills the same box as the data's.
    Bricks(BrickLayout, &'a [bool]),
}

/// Solves the light of one step after another.
pub struct LightSolver(Solver);

enum Solver {
    Physical(Box<Physical>),
    Paper(Box<Paper>),
}

impl LightSolver {
    /// Allocates a solver for data on `data`.
    ///
    /// # Errors
    /// What the device says of the memory.
    pub fn new(device: &dyn Device, scene: &Scene, data: &Grid) -> Result<Self> {
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

    /// Has opaque things block the light: their voxels of the light grids let nothing through. Before the first solve.
    ///
    /// # Errors
    /// [`Error::Unsupported`] for the paper's model, and on devices that page.
    pub fn block(&mut self, device: &dyn Device, geometry: &Geometry) -> Result<()> {
        match &mut self.0 {
            Solver::Physical(solver) => solver.block(device, geometry),
            Solver::Paper(_) => Err(Error::Unsupported("opaque things with light.model = \"paper\"".into())),
        }
    }

    /// Leaves out light that no picture of the medium can show: direct light, where nothing scatters it on, of bricks without visible
    /// medium from which it reaches none, and scattered light outside the box of the medium. [`LightSolver::illuminated`] holds
    /// old or no light there.
    pub fn only_visible(&mut self, only: bool) {
        if let Solver::Physical(solver) = &mut self.0 {
            solver.only_visible(only);
        }
    }

    /// Leaves out scattered light, and the environment's, which come together: for pictures that need neither. Direct light is the
    /// same to the bit.
    pub fn only_direct(&mut self, only: bool) {
        if let Solver::Physical(solver) = &mut self.0 {
            solver.only_direct(only);
        }
    }

    /// What a later run may start from, put into `volumes` by name, and what it says of them. `None` before the first solve, and for
    /// the paper's model, which keeps nothing.
    pub fn keep(
        &self,
        device: &dyn Device,
        volume: &LightVolume,
        volumes: &mut Vec<(String, Vec<f32>)>,
    ) -> Result<Option<serde_json::Value>> {
        match &self.0 {
            Solver::Physical(solver) => solver.keep(device, &volume.physical, volumes),
            Solver::Paper(_) => Ok(None),
        }
    }

    /// Takes up what [`LightSolver::keep`] gave for the same settings and lights, so that the next solve is warm. False when it
    /// does not fit: the next solve is cold.
    pub fn restore(
        &mut self,
        device: &dyn Device,
        kept: &serde_json::Value,
        take: impl FnMut(&str) -> Option<Vec<f32>>,
        lights: &[Light],
        volume: &mut LightVolume,
    ) -> Result<bool> {
        *volume = LightVolume::default();
        let Solver::Physical(solver) = &mut self.0 else { return Ok(false) };
        let fits = solver.restore(device, kept, take, lights, &mut volume.physical)?;
        if fits {
            volume.lights = lights.to_vec();
        } else {
            *volume = LightVolume::default();
        }
        Ok(fits)
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

    /// Where the latest solve left the light as it was before.
    pub fn touched(&self) -> Touched<'_> {
        self.physical.touched()
    }

    /// The lights of the latest solve.
    pub fn lights(&self) -> &[Light] {
        &self.lights
    }
}
