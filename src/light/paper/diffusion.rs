//! Diffusion of the composed light (Zhang & Ma 2013, (13), (23)): `∂L/∂t = σ_s ∇²L` to t = 1, mirrors at the faces, lengths in
//! voxels of the light grid (their mean, where spacings differ).
//!
//! *Exact*: the heat kernel of the grid, `e^(−2κ) I_n(2κ)` along each axis with `κ_a = σ_s (Δ̄/Δ_a)²`; its variance is exactly 2κ
//! and its mass 1. *Implicit*: one backward-Euler step `(1 − σ_s ∇²) L = L₀`, as published, by red-black Gauss–Seidel or by
//! multigrid; its kernel is Yukawa's `e^(−r/√σ_s)/(4πσ_s r)`, of the same variance. Every row of that system sums to 1 and
//! it is an M-matrix: the largest residual bounds the error, so iterations stop where it is within the tolerance.

use crate::device::{Buffer, Device};
use crate::error::Result;
use crate::grid::Grid;
use crate::scene::{DiffusionMethod, SolverKeys};

/// Mass of a kernel that may be left out: what f32 sums lose anyway.
const TAIL: f64 = 1e-6;
/// Sweeps of an implicit solve at most.
const SWEEPS: u64 = 10_000;
/// Sweeps of Gauss–Seidel between looks at the residual, which cost one more.
const BETWEEN: u64 = 4;
/// Sweeps on a level of multigrid before and after coarser ones.
const SMOOTH: u64 = 2;
/// Σκ below which a sweep leaves so little that coarser levels have nothing to do.
const LOCAL: f32 = 0.25;

/// Solves for diffused light.
pub(super) struct Diffusion {
    method: DiffusionMethod,
    size: [usize; 3],
    /// κ for each channel and axis.
    coupling: [[f32; 3]; 3],
    weights: [[Vec<f32>; 3]; 3],
    levels: Vec<Level>,
}

/// One grid of an implicit solve.
struct Level {
    size: [usize; 3],
    rhs: Buffer,
    values: Buffer,
    residual: Buffer,
}

/// What a solve did.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Diffused {
    pub(super) iterations: u64,
    pub(super) updates: u64,
    /// Bound on the error, in the units of the light.
    pub(super) error: f64,
    pub(super) converged: bool,
}

impl Diffusion {
    pub(super) fn new(keys: &SolverKeys, grid: &Grid) -> Self {
        let mean = grid.mean_spacing();
        let kappa = |channel: usize, axis: usize| {
            // Beyond this the light is even along the axis to f32's last place.
            let even = 4.0 * (grid.size[axis] as f64).powi(2);
            (f64::from(keys.sigma_s[channel]) * (mean / grid.spacing[axis]).powi(2)).min(even)
        };
        let per = |channel| std::array::from_fn(|axis| kappa(channel, axis) as f32);
        let weights = |channel| std::array::from_fn(|axis| heat_kernel(kappa(channel, axis)));
        Diffusion {
            method: keys.diffusion,
            size: grid.size,
            coupling: std::array::from_fn(per),
            weights: std::array::from_fn(weights),
            levels: Vec::new(),
        }
    }

    /// Where light goes that is to be diffused into `out`.
    pub(super) fn input<'a>(&'a mut self, device: &dyn Device, out: &'a mut Buffer) -> Result<&'a mut Buffer> {
        if self.method == DiffusionMethod::Exact {
            return Ok(out);
        }
        if self.levels.is_empty() {
            self.levels = self.levels(device)?;
        }
        Ok(&mut self.levels[0].rhs)
    }

    /// Levels of an implicit solve, the finest first; only that one for Gauss–Seidel.
    fn levels(&self, device: &dyn Device) -> Result<Vec<Level>> {
        let strongest: f32 = self.coupling.iter().map(|k| k.iter().sum()).fold(0.0, f32::max);
        let mut levels = Vec::new();
        let mut size = self.size;
        loop {
            let len = size.iter().product();
            // The finest level's values are those of the caller.
            let values = if levels.is_empty() { 0 } else { len };
            levels.push(Level {
                size,
                rhs: device.alloc(len)?,
                values: device.alloc(values)?,
                residual: device.alloc(len)?,
            });
            let ratio = (0..3).map(|a| size[a] as f32 / self.size[a] as f32).fold(0.0, f32::max);
            let coarser = size.map(|n| n.div_ceil(2));
            let local = strongest * ratio * ratio < LOCAL;
            if self.method == DiffusionMethod::GaussSeidel || local || coarser == size {
                return Ok(levels);
            }
            size = coarser;
        }
    }

    /// Diffuses what [`Diffusion::input`] gave to `out`, which for implicit methods may hold an earlier solution (`warm`).
    /// `tolerance` is in the units of the light.
    pub(super) fn solve(
        &mut self,
        device: &dyn Device,
        channel: usize,
        out: &mut Buffer,
        warm: bool,
        tolerance: f64,
    ) -> Result<Diffused> {
        let voxels = out.len() as u64;
        if self.method == DiffusionMethod::Exact {
            let weights = self.weights[channel].each_ref().map(|w| &w[..]);
            let passes = weights.iter().filter(|w| w.len() > 1).count() as u64;
            device.diffuse(self.size, weights, out)?;
            return Ok(Diffused { updates: passes * voxels, converged: true, ..Default::default() });
        }
        let mut report = Diffused::default();
        let coupling = self.coupling[channel];
        std::mem::swap(&mut self.levels[0].values, out);
        let residual = |level: &mut Level| {
            let Level { size, rhs, values, residual } = level;
            device.residual(*size, coupling, rhs, values, residual)
        };
        let finest = &mut self.levels[0];
        report.error = f64::INFINITY;
        if warm {
            report.error = f64::from(residual(finest)?);
            report.updates += voxels;
        }
        if !warm || report.error > tolerance {
            // The light before diffusion is the other guess: take what is nearer.
            let before = report.error;
            std::mem::swap(&mut finest.values, out);
            if out.len() != finest.values.len() {
                finest.values = device.alloc(voxels as usize)?;
            }
            device.combine(&[(&finest.rhs, 1.0)], &mut finest.values)?;
            report.error = f64::from(residual(finest)?);
            report.updates += 2 * voxels;
            if warm && before < report.error {
                std::mem::swap(&mut finest.values, out);
                report.error = before;
            }
        }
        while report.error > tolerance && report.iterations < SWEEPS {
            let before = report.error;
            match self.method {
                DiffusionMethod::Multigrid => report.updates += self.cycle(device, coupling)?,
                _ => {
                    let Level { size, rhs, values, .. } = &mut self.levels[0];
                    sweep(device, *size, coupling, rhs, values, BETWEEN)?;
                    report.updates += BETWEEN * voxels;
                }
            }
            report.iterations += if self.method == DiffusionMethod::Multigrid { 1 } else { BETWEEN };
            report.error = f64::from(residual(&mut self.levels[0])?);
            report.updates += voxels;
            if report.error > 0.999 * before {
                break;
            }
        }
        report.converged = report.error <= tolerance;
        std::mem::swap(&mut self.levels[0].values, out);
        Ok(report)
    }

    /// One V-cycle; returns its voxel updates.
    fn cycle(&mut self, device: &dyn Device, finest: [f32; 3]) -> Result<u64> {
        let sizes: Vec<[usize; 3]> = self.levels.iter().map(|l| l.size).collect();
        let coupling = |l: usize| -> [f32; 3] {
            std::array::from_fn(|a| finest[a] * (sizes[l][a] as f32 / sizes[0][a] as f32).powi(2))
        };
        let mut updates = 0;
        let deepest = self.levels.len() - 1;
        for l in 0..deepest {
            let (fine, coarse) = self.levels.split_at_mut(l + 1);
            let (fine, coarse) = (&mut fine[l], &mut coarse[0]);
            sweep(device, fine.size, coupling(l), &fine.rhs, &mut fine.values, SMOOTH)?;
            device.residual(fine.size, coupling(l), &fine.rhs, &fine.values, &mut fine.residual)?;
            device.restrict(fine.size, &fine.residual, coarse.size, &mut coarse.rhs)?;
            device.combine(&[], &mut coarse.values)?;
            updates += (SMOOTH + 1) * fine.rhs.len() as u64 + 2 * coarse.rhs.len() as u64;
        }
        let Level { size, rhs, values, .. } = &mut self.levels[deepest];
        // The coarsest system is small or local: a few sweeps solve it.
        sweep(device, *size, coupling(deepest), rhs, values, 4 * SMOOTH)?;
        updates += 4 * SMOOTH * rhs.len() as u64;
        for l in (0..deepest).rev() {
            let (fine, coarse) = self.levels.split_at_mut(l + 1);
            let (fine, coarse) = (&mut fine[l], &coarse[0]);
            device.prolong(coarse.size, &coarse.values, fine.size, &mut fine.values)?;
            sweep(device, fine.size, coupling(l), &fine.rhs, &mut fine.values, SMOOTH)?;
            updates += (SMOOTH + 1) * fine.rhs.len() as u64;
        }
        Ok(updates)
    }
}

fn sweep(
    device: &dyn Device,
    size: [usize; 3],
    coupling: [f32; 3],
    rhs: &Buffer,
    values: &mut Buffer,
    times: u64,
) -> Result<()> {
    for _ in 0..times {
        device.relax(size, coupling, rhs, values, 0)?;
        device.relax(size, coupling, rhs, values, 1)?;
    }
    Ok(())
}

/// The heat kernel of a line of voxels after κ = σ_s t: `w_n = e^(−2κ) I_n(2κ)`, n = 0, 1, … until at most [`TAIL`] is left,
/// scaled to the mass 1. Ratios of Bessel functions by their continued fraction, from far out inwards.
fn heat_kernel(kappa: f64) -> Vec<f32> {
    let x = 2.0 * kappa;
    if x <= 0.0 {
        return vec![1.0];
    }
    let far = (8.0 * x.sqrt() + 24.0) as usize;
    let mut ratios = vec![0.0; far + 1];
    let mut ratio = 0.0;
    for n in (1..=far).rev() {
        ratio = 1.0 / (2.0 * n as f64 / x + ratio);
        ratios[n] = ratio;
    }
    let mut weights = vec![1.0];
    for ratio in &ratios[1..] {
        weights.push(weights[weights.len() - 1] * ratio);
    }
    let mass = |w: &[f64]| w[0] + 2.0 * w[1..].iter().sum::<f64>();
    let whole = mass(&weights);
    let mut tail = 0.0;
    while weights.len() > 1 && tail + 2.0 * weights[weights.len() - 1] / whole <= TAIL {
        tail += 2.0 * weights.pop().expect("there is one") / whole;
    }
    let whole = mass(&weights);
    weights.iter().map(|w| (w / whole) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_heat_kernel_has_mass_one_and_variance_two_kappa() {
        for kappa in [1e-3, 0.1, 1.0, 2.5, 10.0, 400.0] {
            let w = heat_kernel(kappa);
            let sum = |f: &dyn Fn(f64) -> f64| {
                w.iter()
                    .enumerate()
                    .map(|(n, w)| if n == 0 { f(0.0) } else { 2.0 * f(n as f64) } * f64::from(*w))
                    .sum::<f64>()
            };
            assert!((sum(&|_| 1.0) - 1.0).abs() < 1e-6, "mass at {kappa}");
            // What is left out lies at most a few deviations beyond the last weight.
            let allowed = 1e-4 * (2.0 * kappa) + 2.0 * TAIL * (w.len() as f64 + 2.0).powi(2);
            assert!((sum(&|n| n * n) - 2.0 * kappa).abs() < allowed, "variance at {kappa}: {}", sum(&|n| n * n));
        }
        // I₀(2)e⁻², I₁(2)e⁻²: Abramowitz & Stegun, table 9.8.
        let w = heat_kernel(1.0);
        assert!((w[0] - 0.308_508_3).abs() < 1e-6 && (w[1] - 0.215_269_3).abs() < 1e-6, "{w:?}");
    }
}
