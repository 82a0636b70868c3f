//! Scattered light by first-collision-source discrete ordinates (light.md):
//!
//! `Ω·∇I + σ* I = σ* S`, `S = ω*/4π · [φ + ΣE_l + 3g* Ω·(J + ΣE_l u_l)] + emission`, `φ = Σ w I`, `J = Σ w Ω I`
//!
//! with delta-Eddington scaling (Joseph, Wiscombe & Weinman 1976, eq. 5–6) `f = g²`, `σ* = σ_t (1 − ωf)`,
//! `ω* = ω(1 − f)/(1 − ωf)`, `g* = g/(1 + g)`. The direct light E_l is given; what is solved for is the scattered light and
//! the uncollided light of the environment and of emission.
//!
//! # When to stop
//!
//! One pass maps x = (φ, J) to Φ(x). The scheme makes every radiance a convex combination of inflow and source functions,
//! so a change of S by at most s changes I by at most s. With `R = ‖δφ‖ + 3g*‖δJ‖` (maximum norm) the change that a pass
//! made, Φ(x) differs from the solution by at most
//!
//! `ω R / (1 − κω)`, ω the largest ω*, `κ = max_Ω Σ_Ω' w'/4π |1 + 3g* Ω·Ω'|` (1 unless g > ½),
//!
//! however x was found, so acceleration and guesses need no proof of their own. Where ω* comes near 1 that is too
//! pessimistic, for light also leaks out: then u = Φ(u) is solved roughly for a unit fluence of first collisions
//! everywhere, and the error is at most `R · max u' / (1 − R_u)`, u' = Φ(u) and R_u the change that this pass made (A is an
//! M-matrix; needs |3g*| ≤ 1). Certified errors are relative to the largest of φ and ΣE_l, up to rounding; they bound the
//! distance from the solution of the discrete equations, not that of the grid or the directions.
//!
//! # Known weaknesses
//!
//! Rays show near tiny bright sources. A medium that is dense right up to the faces of the box loses too much light there,
//! to first order in the spacing: 7 % of the fluence of a cube of τ 16 and ω .99 that fills 32³ voxels, 2 % with a quarter
//! of the box empty around it (both against Monte Carlo). Emission where there is no extinction at all is not carried.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::device::{Buffer, Device, Ordinate, Term, Travel, Weight};
use crate::error::Result;
use crate::grid::Grid;

mod anderson;
mod equation;
mod iterate;
mod quadrature;

use anderson::Anderson;
use equation::{Equation, Residual, State, Work};
pub use quadrature::{cells, ordinates};

/// What scattered light is solved for. All volumes are on the grid of [`Scattered`].
pub struct ScatterProblem<'a> {
    /// Delta-scaled extinction σ*, per world length.
    pub sigma: &'a Buffer,
    /// Scattering coefficient `ω σ_t` per channel, as many as the solution has; not delta-scaled.
    pub scattering: &'a [Buffer],
    /// Emission per world length and channel; empty when nothing glows.
    pub emission: &'a [Buffer],
    /// Direct light of each source through σ*, a factor on it per colour channel, and the way it travels.
    pub first: &'a [(&'a Buffer, [f32; 3], Travel)],
    /// Radiance of the environment along each ordinate of the set; empty where there is none.
    pub environment: &'a [[f32; 3]],
    /// Factor on extinction and scattering per colour channel.
    pub chromatic: [f32; 3],
    /// Henyey–Greenstein g.
    pub anisotropy: f32,
    /// Ordinates: 8, 32 or 128.
    pub directions: usize,
    /// Certified error at which to stop, relative to the largest fluence. 0 goes on until rounding stops all progress,
    /// from a cold start, so that the result does not depend on earlier steps.
    pub tolerance: f32,
    /// Start from earlier solutions.
    pub warm: bool,
    /// False: only the uncollided light of the environment.
    pub scattering_on: bool,
}

/// What a solve started from.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Start {
    /// No scattered light.
    #[default]
    Cold,
    /// The latest solution.
    Previous,
    /// The latest two solutions, extrapolated linearly.
    Extrapolated,
}

/// What one solve of scattered light did.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ScatterReport {
    /// Passes of the channel that took most, those of rejected guesses and of the error bound included.
    pub iterations: u64,
    /// Sweeps over the grid: passes × directions, all channels.
    pub sweeps: f64,
    /// Voxel updates: passes × (directions + 1 for the source function), all channels.
    pub voxel_updates: u64,
    /// Bound on the error of the fluence, relative to the largest fluence; infinite where no bound is known.
    pub certified_error: f64,
    /// False when the limit of passes or rounding came first.
    pub converged: bool,
    /// The guess with the least residual, in the last channel.
    pub start: Start,
}

/// Scattered light, kept from step to step.
pub struct Scattered {
    grid: Grid,
    anisotropy: f32,
    channels: Vec<Channel>,
    optics: Optics,
    work: Work,
    states: [State; 3],
    anderson: Anderson,
    ones: Option<Buffer>,
}

/// Delta-scaled optics of the channel at work, continued past the edges of the medium.
struct Optics {
    sigma: Buffer,
    scattering: Buffer,
    emission: Buffer,
}

/// One colour channel: its latest solutions.
struct Channel {
    solution: State,
    before: State,
    /// How many of the two mean anything.
    known: usize,
    /// u of the error bound.
    majorant: Option<State>,
    /// The guess that won in the latest step and its residual relative to the largest fluence.
    won: Option<(Start, f64)>,
}

/// What is known of a channel whose volumes are kept.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(super) struct KeptChannel {
    known: usize,
    won: Option<(Start, f64)>,
    majorant: bool,
}

/// Names of a channel's volumes.
const STATES: [&str; 3] = ["solution", "before", "majorant"];

/// A bound R ↦ gain·R on the error of Φ(x).
#[derive(Debug, Clone, Copy)]
struct Certificate {
    gain: f64,
    rigorous: bool,
}

/// Gains above which the bound by u is worth its passes.
const LARGE_GAIN: f64 = 100.0;

impl Scattered {
    /// Allocates the unknowns of `channels` colour channels (1 or 3) on `grid`.
    ///
    /// # Errors
    /// [`Error::OutOfMemory`](crate::Error::OutOfMemory), or the device's.
    pub fn new(device: &dyn Device, grid: Grid, channels: usize, anisotropy: f32) -> Result<Self> {
        let state = || State::new(device, grid.len(), anisotropy != 0.0);
        let channel = |_| Ok(Channel { solution: state()?, before: state()?, known: 0, majorant: None, won: None });
        Ok(Scattered {
            grid,
            anisotropy,
            channels: (0..channels).map(channel).collect::<Result<_>>()?,
            optics: Optics {
                sigma: device.alloc(grid.len())?,
                scattering: device.alloc(grid.len())?,
                emission: device.alloc(grid.len())?,
            },
            work: Work::new(device, grid.len(), anisotropy != 0.0)?,
            states: [state()?, state()?, state()?],
            anderson: Anderson::default(),
            ones: None,
        })
    }

    /// Volumes that are held at most for `channels` colour channels, those of the problem included but for the lights'.
    pub fn volumes(channels: usize, glows: bool, anisotropy: f32) -> usize {
        // The latest two solutions of each channel and its bound; those at work, their source, and what is mixed.
        let states = 3 * channels + 3 + 1 + 2 * anderson::DEPTH;
        let parts = if anisotropy != 0.0 { 4 } else { 1 };
        // Extinction, scattering and emission as they are and continued past their edges; ones.
        let optics = 1 + channels * (1 + usize::from(glows)) + 3 + 1;
        states * parts + optics
    }

    /// True when the kept solution is on this grid with as many channels and the same g.
    pub fn fits(&self, grid: &Grid, channels: usize, anisotropy: f32) -> bool {
        self.grid == *grid && self.channels.len() == channels && self.anisotropy == anisotropy
    }

    /// Solves for scattered light.
    ///
    /// # Errors
    /// [`Error::Scene`](crate::Error::Scene) for a number of directions that is no set, or the device's. Not converging is
    /// in the report.
    pub fn solve(&mut self, device: &dyn Device, problem: &ScatterProblem) -> Result<ScatterReport> {
        let mut report = ScatterReport { converged: true, ..Default::default() };
        for channel in 0..self.channels.len() {
            if let Some((like, ratio)) = multiple(device, problem, channel)? {
                let staged = &mut self.states[0];
                staged.combine(device, &[(&self.channels[like].solution, ratio)])?;
                let known = self.channels[like].known;
                let Channel { solution, before, .. } = &mut self.channels[channel];
                std::mem::swap(before, solution);
                std::mem::swap(solution, staged);
                self.channels[channel].known = known;
                report.voxel_updates += 2 * self.grid.len() as u64;
                continue;
            }
            let mut set = ordinates(problem.directions, 0.0)?;
            set.iter_mut().zip(problem.environment).for_each(|(o, radiance)| o.inflow = radiance[channel]);
            let done = self.solve_channel(device, problem, channel, &set)?;
            report.iterations = report.iterations.max(done.iterations);
            report.certified_error = report.certified_error.max(done.certified_error);
            report.converged &= done.converged;
            report.start = done.start;
            report.sweeps += (done.iterations as usize * set.len()) as f64;
            report.voxel_updates += done.iterations * (set.len() as u64 + 1) * self.grid.len() as u64;
        }
        Ok(report)
    }

    fn solve_channel(
        &mut self,
        device: &dyn Device,
        problem: &ScatterProblem,
        channel: usize,
        set: &[Ordinate],
    ) -> Result<ScatterReport> {
        let g = problem.anisotropy;
        let linear = 3.0 * g / (1.0 + g);
        let Scattered { grid, channels, optics, work, states: [x, value, other], anderson, ones, .. } = self;
        let Channel { solution, before, known, majorant, won } = &mut channels[channel];
        // A colour channel with extinction of its own has sweeps of its own.
        let first: Vec<_> = problem.first.iter().map(|(t, e, u)| (*t, e[channel], *u)).filter(|f| f.1 != 0.0).collect();
        let emission = problem.emission.get(channel);
        optics.prepare(
            device,
            grid,
            problem.sigma,
            (&problem.scattering[channel], 1.0 - g * g),
            problem.chromatic[channel],
            emission,
            &mut x.phi,
        )?;
        let mut equation = Equation {
            device,
            grid,
            ordinates: set,
            sigma: &optics.sigma,
            scattering: problem.scattering_on.then_some(&optics.scattering),
            emission: emission.map(|_| &optics.emission),
            first: &first,
            linear,
        };
        x.combine(device, &[])?;
        if !problem.scattering_on {
            equation.apply(x, solution, work)?;
            *known = 0;
            return Ok(ScatterReport { iterations: 1, converged: true, ..Default::default() });
        }
        let mut passes = 0;
        let albedo = f64::from(device.largest_ratio(&optics.scattering, &optics.sigma)?);
        let mut certificate = contraction(albedo, set, linear);
        if certificate.gain >= LARGE_GAIN && linear.abs() <= 1.0 {
            let ones = match ones {
                Some(ones) => ones,
                None => {
                    let mut buffer = device.alloc(grid.len())?;
                    device.fill(1.0, &mut buffer)?;
                    ones.insert(buffer)
                }
            };
            let vacuum: Vec<_> = set.iter().map(|o| Ordinate { inflow: 0.0, ..*o }).collect();
            let unit = [(&*ones, 1.0, Travel::Along(Vec3::ZERO))];
            let bound = Equation { ordinates: &vacuum, emission: None, first: &unit, ..equation };
            let kept = match majorant {
                Some(kept) => kept,
                None => majorant.insert(State::new(device, grid.len(), linear != 0.0)?),
            };
            let residual = bound.apply(kept, value, work)?;
            anderson.clear();
            anderson.take(device, kept, value)?;
            let done = iterate::iterate(&bound, kept, value, residual, (anderson, work), |_| 0.5)?;
            passes += 1 + done.passes;
            if done.residual.change < 1.0 {
                let gain = done.residual.peak / (1.0 - done.residual.change);
                certificate = Certificate { gain: gain.min(certificate.gain), rigorous: true };
            }
            std::mem::swap(kept, value);
            equation = Equation { ordinates: set, ..equation };
        }

        x.combine(device, &[])?;
        let light: Vec<_> = first.iter().map(|(t, e, _)| (*t, *e)).collect();
        device.combine(&light, &mut value.phi)?;
        let direct = f64::from(device.distance(&value.phi, &x.phi)?);
        let scale = |peak: f64| direct.max(peak).max(f64::MIN_POSITIVE);
        let tolerance = f64::from(problem.tolerance);
        let target = |peak: f64| tolerance * scale(peak) / certificate.gain.max(f64::MIN_POSITIVE);

        let warm = problem.warm && tolerance > 0.0;
        let guesses = match (*known, *won) {
            (2, Some((Start::Previous, _))) if warm => &[Start::Previous, Start::Extrapolated][..],
            (2, _) if warm => &[Start::Extrapolated, Start::Previous],
            (1, _) if warm => &[Start::Previous],
            _ => &[Start::Cold],
        };
        let mut best: Option<(Residual, Start)> = None;
        anderson.clear();
        for &guess in guesses {
            match guess {
                Start::Cold => {}
                Start::Previous => x.combine(device, &[(solution, 1.0)])?,
                Start::Extrapolated => x.combine(device, &[(solution, 2.0), (before, -1.0)])?,
            }
            let residual = equation.apply(x, value, work)?;
            passes += 1;
            // A guess that loses still helps the mixture.
            anderson.take(device, x, value)?;
            if best.is_none_or(|(b, _)| residual.change < b.change) {
                best = Some((residual, guess));
                std::mem::swap(value, other);
            }
            // The other guess costs a pass too: it is tried only when the one that won last does worse than it did then.
            let as_usual = won.is_some_and(|(w, r)| w == guess && residual.change <= 1.5 * r * scale(residual.peak));
            if as_usual || residual.change <= target(residual.peak) {
                break;
            }
        }
        let (residual, start) = best.expect("there is a guess");
        std::mem::swap(value, other);
        *won = (*known == 2).then(|| (start, residual.change / scale(residual.peak)));
        let done = iterate::iterate(&equation, x, value, residual, (anderson, work), target)?;
        passes += done.passes;
        std::mem::swap(before, solution);
        std::mem::swap(solution, value);
        *known = (*known + 1).min(2);
        let bound = certificate.gain * done.residual.change / scale(done.residual.peak);
        Ok(ScatterReport {
            iterations: passes,
            certified_error: if certificate.rigorous { bound } else { f64::INFINITY },
            converged: done.converged,
            start,
            ..Default::default()
        })
    }

    /// What a later solve may start from: what is known of each channel, and its volumes, for a file.
    pub(super) fn keep(&self, device: &dyn Device, volumes: &mut Vec<(String, Vec<f32>)>) -> Result<Vec<KeptChannel>> {
        let mut kept = Vec::new();
        for (c, channel) in self.channels.iter().enumerate() {
            let states = [Some(&channel.solution), Some(&channel.before), channel.majorant.as_ref()];
            for (name, state) in STATES.iter().zip(states) {
                for (part, buffer) in state.into_iter().flat_map(State::parts).enumerate() {
                    let mut values = vec![0.0; buffer.len()];
                    device.download(buffer, &mut values)?;
                    volumes.push((format!("scattered_{c}_{name}_{part}"), values));
                }
            }
            let majorant = channel.majorant.is_some();
            kept.push(KeptChannel { known: channel.known, won: channel.won, majorant });
        }
        Ok(kept)
    }

    /// Takes up what [`Scattered::keep`] gave. False when it is of other channels or sizes; then the next solve is cold.
    pub(super) fn restore(
        &mut self,
        device: &dyn Device,
        kept: &[KeptChannel],
        mut take: impl FnMut(&str) -> Option<Vec<f32>>,
    ) -> Result<bool> {
        if kept.len() != self.channels.len() {
            return Ok(false);
        }
        let linear = self.anisotropy != 0.0;
        for (c, (channel, kept)) in self.channels.iter_mut().zip(kept).enumerate() {
            if kept.majorant {
                channel.majorant = Some(State::new(device, self.grid.len(), linear)?);
            }
            let states = [Some(&mut channel.solution), Some(&mut channel.before), channel.majorant.as_mut()];
            for (name, state) in STATES.iter().zip(states) {
                for (part, buffer) in state.into_iter().flat_map(State::parts_mut).enumerate() {
                    match take(&format!("scattered_{c}_{name}_{part}")) {
                        Some(values) if values.len() == buffer.len() => device.upload(&values, buffer)?,
                        _ => return Ok(false),
                    }
                }
            }
            (channel.known, channel.won) = (kept.known.min(2), kept.won);
        }
        Ok(true)
    }

    /// Fluence of scattered light with its share in each colour channel, for [`Device::compose`].
    pub fn fluence(&self) -> Vec<(&Buffer, [f32; 3])> {
        self.channels.iter().enumerate().map(|(c, channel)| (&channel.solution.phi, self.share(c, 1.0))).collect()
    }

    /// Scattered light as the ray caster takes it: `φ/4π` and, where scattering is anisotropic, `3g/4π Ω·J`. A ray sees
    /// the unscaled medium; what delta-Eddington scaling counts as going straight on then arrives by
    /// `f·3 + (1 − f)·3g* = 3g` of J.
    pub fn terms(&self) -> Vec<Term<'_>> {
        let per_sphere = 0.25 * std::f32::consts::FRAC_1_PI;
        let mut terms = Vec::new();
        for (c, channel) in self.channels.iter().enumerate() {
            let State { phi, current } = &channel.solution;
            let weight = Weight::Uniform(self.share(c, per_sphere));
            terms.push(Term { values: phi, grid: &self.grid, weight });
            for (axis, values) in current.iter().flatten().enumerate() {
                let weight = self.share(c, 3.0 * self.anisotropy * per_sphere);
                terms.push(Term { values, grid: &self.grid, weight: Weight::Current { axis, weight } });
            }
        }
        terms
    }

    /// `weight` in the colour channels that channel `c` stands for.
    fn share(&self, c: usize, weight: f32) -> [f32; 3] {
        if self.channels.len() == 1 {
            [weight; 3]
        } else {
            std::array::from_fn(|rgb| if rgb == c { weight } else { 0.0 })
        }
    }
}

impl Optics {
    fn prepare(
        &mut self,
        device: &dyn Device,
        grid: &Grid,
        sigma: &Buffer,
        (scattering, scale): (&Buffer, f32),
        chromatic: f32,
        emission: Option<&Buffer>,
        scratch: &mut Buffer,
    ) -> Result<()> {
        if chromatic == 1.0 {
            device.extend(grid.size, sigma, sigma, &mut self.sigma)?;
        } else {
            device.combine(&[(sigma, chromatic)], scratch)?;
            device.extend(grid.size, sigma, scratch, &mut self.sigma)?;
        }
        device.combine(&[(scattering, scale * chromatic)], scratch)?;
        device.extend(grid.size, sigma, scratch, &mut self.scattering)?;
        match emission {
            Some(emission) => device.extend(grid.size, sigma, emission, &mut self.emission),
            None => Ok(()),
        }
    }
}

/// An earlier channel of the same problem but for a factor, and the factor: one colour of light in a gray medium, say.
fn multiple(device: &dyn Device, problem: &ScatterProblem, channel: usize) -> Result<Option<(usize, f32)>> {
    for like in 0..channel {
        let pairs = || {
            let lights = problem.first.iter().map(|(_, e, _)| (e[like], e[channel]));
            lights.chain(problem.environment.iter().map(|e| (e[like], e[channel])))
        };
        let Some((from, to)) = pairs().max_by(|a, b| a.0.total_cmp(&b.0)).filter(|p| p.0 > 0.0) else { continue };
        let ratio = to / from;
        let proportional = pairs().all(|(a, b)| (b - ratio * a).abs() <= 1e-6 * ratio * from);
        let glows = !problem.emission.is_empty();
        let dims_alike = problem.chromatic[like] == problem.chromatic[channel];
        if !proportional || !dims_alike || (glows && ratio != 1.0) {
            continue;
        }
        let same = |of: &[Buffer]| Ok::<_, crate::Error>(device.distance(&of[like], &of[channel])? == 0.0);
        if same(problem.scattering)? && (!glows || same(problem.emission)?) {
            return Ok(Some((like, ratio)));
        }
    }
    Ok(None)
}

/// The bound that the largest albedo gives.
fn contraction(albedo: f64, set: &[Ordinate], linear: f32) -> Certificate {
    let row = |o: &Ordinate| -> f64 {
        let kernel = |p: &Ordinate| f64::from(p.weight * (1.0 + linear * o.direction.dot(p.direction)).abs());
        set.iter().map(kernel).sum::<f64>() / (4.0 * std::f64::consts::PI)
    };
    let kappa = if linear.abs() <= 1.0 { 1.0 } else { set.iter().map(row).fold(0.0, f64::max) };
    let contraction = kappa * albedo;
    if contraction < 1.0 {
        Certificate { gain: albedo / (1.0 - contraction), rigorous: true }
    } else {
        Certificate { gain: LARGE_GAIN, rigorous: false }
    }
}
