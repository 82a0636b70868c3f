//! What a residual amounts to in the end, roughly: the error e of Φ(x) obeys `e = K(r + e)`, r = Φ(x) − x and K the linear part of
//! Φ. That is solved for on a grid of twice the spacing along 8 directions, as isotropic scattering of the coefficients
//! `σ* − g*σ_s*` and `(1 − g*)σ_s*`, by a few passes. Added to Φ(x) it takes away the smooth part of the error, which passes are slow at.

use glam::Vec3;

use super::equation::{self, State};
use super::inside::Inside;
use super::quadrature::ordinates;
use crate::device::{Buffer, Device, Ordinate, SourceTerm, Travel};
use crate::error::Result;
use crate::grid::Grid;

/// Directions of the coarse set.
const DIRECTIONS: usize = 8;

/// Passes for each correction: two leave more to the fine passes than they save, six cost more.
const PASSES: usize = 3;

/// The coarse equation of the channel at work.
pub(super) struct Coarse {
    grid: Grid,
    fine: [usize; 3],
    ordinates: Vec<Ordinate>,
    sigma: Buffer,
    scattering: Buffer,
    residual: Buffer,
    source: State,
    error: [State; 2],
    scratch: Buffer,
    /// Voxel updates so far.
    pub updates: u64,
}

impl Coarse {
    /// Room for boxes of a grid of up to `size`.
    pub fn new(device: &dyn Device, grid: &Grid) -> Result<Self> {
        let len = half(grid.size).into_iter().product();
        let volume = || device.alloc(len);
        let state = || State::new(device, len, false);
        Ok(Coarse {
            grid: *grid,
            fine: grid.size,
            ordinates: ordinates(DIRECTIONS, 0.0)?,
            sigma: volume()?,
            scattering: volume()?,
            residual: volume()?,
            source: state()?,
            error: [state()?, state()?],
            scratch: volume()?,
            updates: 0,
        })
    }

    /// Takes the optics of the channel at work; `forward` is g*.
    pub fn take(&mut self, device: &dyn Device, inside: &Inside, forward: f32) -> Result<()> {
        self.fine = inside.grid.size;
        self.grid = inside.grid.resized(half(self.fine));
        let len = self.grid.len();
        let volumes = [&mut self.sigma, &mut self.scattering, &mut self.residual, &mut self.scratch];
        volumes.into_iter().try_for_each(|v| device.resize(v, len))?;
        self.error.iter_mut().chain([&mut self.source]).try_for_each(|s| s.resize(device, len))?;
        device.restrict(self.fine, &inside.scattering, self.grid.size, &mut self.residual)?;
        device.restrict(self.fine, &inside.sigma, self.grid.size, &mut self.scratch)?;
        device.combine(&[(&self.scratch, 1.0), (&self.residual, -forward)], &mut self.sigma)?;
        device.combine(&[(&self.residual, 1.0 - forward)], &mut self.scattering)?;
        self.updates = 2 * inside.grid.len() as u64;
        Ok(())
    }

    /// Adds the error that `residual` = Φ(x) − x tells of to `value` = Φ(x), and to the residual.
    pub fn correct(&mut self, device: &dyn Device, x: &State, value: &mut State, residual: &mut State) -> Result<()> {
        device.restrict(self.fine, &residual.phi, self.grid.size, &mut self.residual)?;
        let unit = [(&self.residual, 1.0, Travel::Along(Vec3::ZERO))];
        let [error, next] = &mut self.error;
        error.combine(device, &[])?;
        for _ in 0..PASSES {
            let term = SourceTerm {
                sigma: &self.sigma,
                scattering: &self.scattering,
                emission: None,
                grid: &self.grid,
                plane: 0,
                first: &unit,
                phi: &error.phi,
                current: None,
            };
            device.source(&term, &mut self.source.phi, None)?;
            equation::pass(device, (&self.grid, &self.ordinates), &self.sigma, &self.source, next)?;
            std::mem::swap(error, next);
        }
        let fine: usize = self.fine.into_iter().product();
        self.updates += (PASSES * (DIRECTIONS + 1) * self.grid.len() + 3 * fine) as u64;
        device.prolong(self.grid.size, &error.phi, self.fine, &mut residual.phi)?;
        device.combine(&[(&x.phi, 1.0), (&residual.phi, 1.0)], &mut value.phi)
    }
}

/// Half as many voxels along each axis.
fn half(size: [usize; 3]) -> [usize; 3] {
    size.map(|n| n.div_ceil(2))
}
