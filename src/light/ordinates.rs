//! Scattered light by first-collision-source discrete ordinates (light.md):
//!
//! `Ω·∇I + σ* I = σ* S`, `S = ω*/4π · [φ + ΣE_l + 3g* Ω·(J + ΣE_l u_l)] + emission`, `φ = Σ w I`, `J = Σ w Ω I`
//!
//! with delta-Eddington scaling (Joseph, Wiscombe & Weinman 1976, eq. 5–6) `f = g²`, `σ* = σ_t (1 − ωf)`,
//! `ω* = ω(1 − f)/(1 − ωf)`, `g* = (g − f)/(1 − f)`; f = 0 for g < 0 ([`forward`]). The direct light E_l is given; what is solved for is the scattered light and
//! the uncollided light of the environment and of emission.
//!
//! # When to stop
//!
//! One pass maps x = (φ, J) to Φ(x). The scheme makes every radiance a convex combination of inflow and source functions,
//! so a change of S by at most s changes I by at most s. With `R = ‖δφ‖ + 3g*‖δJ‖` (maximum norm) the change that a pass
//! made, Φ(x) differs from the solution by at most
//!
//! `ω R / (1 − κω)`, ω the largest ω*, `κ = max_Ω Σ_Ω' w'/4π |1 + 3g* Ω·Ω'|` (1 unless g > ½ or g < −⅓),
//!
//! however x was found, so acceleration and guesses need no proof of their own. Where ω* comes near 1 that is too
//! pessimistic, for light also leaks out: then u = Φ(u) is solved roughly for a unit fluence of first collisions
//! everywhere, and the error is at most `R · max u' / (1 − R_u)`, u' = Φ(u) and R_u the change that this pass made (A is an
//! M-matrix; needs |3g*| ≤ 1). Certified errors are relative to the largest of φ and ΣE_l, up to rounding; they bound the
//! distance from the solution of the discrete equations, not that of the grid or the directions.
//!
//! # Where
//!
//! Where there is no extinction nothing is emitted, and radiance goes on as it came. Iterations run in the box of the medium
//! alone, to the same bits, and what errors there may be outside stem from those inside; a last pass finds the light of the
//! whole grid.
//!
//! # Known weaknesses
//!
//! Rays show near tiny bright sources. A medium that is dense right up to the faces of the box loses too much light there,
//! to first order in the spacing: 3 % of the fluence of a cube of τ 16 and ω .99 that fills 32³ voxels, 1.4 % with a quarter
//! of the box empty around it (both against Monte Carlo). Emission where there is no extinction at all is not carried.

use std::time::Instant;

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::device::{Buffer, Device, Ordinate, Term, Travel, Weight};
use crate::error::Result;
use crate::grid::Grid;

mod anderson;
mod budget;
mod coarse;
mod equation;
mod inside;
mod iterate;
mod quadrature;

use anderson::Anderson;
use budget::Budget;
use coarse::Coarse;
use equation::{Equation, Residual, State};
use inside::{Inside, Whole};
use iterate::Means;
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
    /// False: the light is needed in the medium and beside it alone, and may be left out elsewhere.
    pub everywhere: bool,
    /// Passes at most, for each channel; at least 2, as the last one goes over the whole grid where light is needed everywhere.
    pub passes: Option<u64>,
    /// When to end, converged or not; two passes are made however short the time.
    pub until: Option<Instant>,
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
    /// Sweeps over the grid: passes × directions, all channels; those over the box of the medium by its share.
    pub sweeps: f64,
    /// Voxel updates: passes × (directions + 1 for the source function), all channels, and looking for the medium.
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
    /// σ* of the channel at work, where that is not the problem's, and zeros.
    sigma: Option<Buffer>,
    zeros: Buffer,
    /// Scratch: the source function of the grid, and a state of it.
    whole: State,
    inside: Inside,
    /// In the box of the medium, as what follows.
    source: State,
    states: [State; 3],
    /// False where the latest solution is 0 outside the box of the medium.
    everywhere: bool,
    anderson: Anderson,
    coarse: Coarse,
    ones: Option<Buffer>,
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

/// The share of what is scattered that delta-Eddington scaling counts as going straight on: g² where scattering is forward. A
/// peak that goes back is none that goes on: there S is linear in the cosine with the whole of g.
pub fn forward(g: f32) -> f32 {
    if g > 0.0 { g * g } else { 0.0 }
}

/// A bound R ↦ gain·R on the error of Φ(x).
#[derive(Debug, Clone, Copy)]
struct Certificate {
    gain: f64,
    rigorous: bool,
}

/// A guess that is within so many times the goal needs no corrections: a pass or two are quicker.
const NEAR: f64 = 3.0;

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
            sigma: None,
            zeros: device.alloc(grid.len())?,
            whole: state()?,
            inside: Inside::new(device, &grid)?,
            source: state()?,
            states: [state()?, state()?, state()?],
            everywhere: true,
            anderson: Anderson::new(grid.len()),
            coarse: Coarse::new(device, &grid)?,
            ones: None,
        })
    }

    /// Volumes that are held at most for `channels` colour channels and the direct light of `lights` lights, those of the problem
    /// included. Those that iterations work on are as large as the medium's box.
    pub fn volumes(channels: usize, lights: usize, glows: bool, anisotropy: f32) -> usize {
        // The latest two solutions of each channel and its bound; those at work, their source, and what is mixed; the source of
        // the whole grid.
        let states = 3 * channels + 3 + 1 + 2 * anderson::DEPTH + 1;
        let parts = if anisotropy != 0.0 { 4 } else { 1 };
        // Extinction, scattering and emission as they are and in the box; a channel's own extinction, zeros, ones.
        let optics = 1 + channels * (1 + usize::from(glows)) + 2 + usize::from(glows) + 3;
        // A pass's sums of two ways; with many threads as much again is turned, and what is summed from.
        let passing = 2 * parts + 2 * (1 + 2 * parts);
        // Of a coarse grid, ten volumes of an eighth.
        states * parts + optics + 2 * lights + passing + 2
    }

    /// True when the kept solution is on this grid with as many channels and the same g.
    pub fn fits(&self, grid: &Grid, channels: usize, anisotropy: f32) -> bool {
        self.grid == *grid && self.channels.len() == channels && self.anisotropy == anisotropy
    }

    /// False where the latest solution is left out outside the medium.
    pub fn is_everywhere(&self) -> bool {
        self.everywhere
    }

    /// Solves for scattered light.
    ///
    /// # Errors
    /// [`Error::Scene`](crate::Error::Scene) for a number of directions that is no set, or the device's. Not converging is
    /// in the report.
    pub fn solve(&mut self, device: &dyn Device, problem: &ScatterProblem) -> Result<ScatterReport> {
        let mut report = ScatterReport { converged: true, ..Default::default() };
        if problem.scattering_on {
            self.inside.find(device, &self.grid, problem.sigma)?;
            report.voxel_updates += self.grid.len() as u64;
            let len = self.inside.grid.len();
            self.inside.fit(device, problem)?;
            self.states.iter_mut().chain([&mut self.source]).try_for_each(|s| s.resize(device, len))?;
        }
        for channel in 0..self.channels.len() {
            if let Some((like, ratio)) = multiple(device, problem, channel)? {
                let staged = &mut self.whole;
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
            report.sweeps += done.sweeps;
            report.voxel_updates += done.voxel_updates;
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
        let linear = 3.0 * (g - forward(g)) / (1.0 - forward(g));
        let over_the_grid = (set.len() * self.grid.len()) as u64;
        self.prepare(device, problem, channel)?;
        let Scattered { grid, channels, sigma, whole, inside, source, anderson, coarse, ones, .. } = self;
        let sigma = sigma.as_ref().filter(|_| problem.chromatic[channel] != 1.0).unwrap_or(problem.sigma);
        let [x, value, other] = &mut self.states;
        let Channel { solution, before, known, majorant, won } = &mut channels[channel];
        if !problem.scattering_on || inside.grid.is_empty() {
            // Nothing but what enters.
            whole.combine(device, &[])?;
            let (_, peak) = equation::pass(device, (grid, set), sigma, whole, before)?;
            std::mem::swap(before, solution);
            *known = if problem.scattering_on { (*known + 1).min(2) } else { 0 };
            *won = None;
            self.everywhere = true;
            return Ok(ScatterReport {
                iterations: 1,
                sweeps: set.len() as f64,
                voxel_updates: over_the_grid,
                converged: peak.is_finite(),
                ..Default::default()
            });
        }
        // A colour channel with extinction of its own has sweeps of its own.
        let lit = |e: &[f32; 3]| e[channel] != 0.0;
        let light: Vec<_> = problem.first.iter().filter(|f| lit(&f.1)).map(|(t, e, _)| (*t, e[channel])).collect();
        let first = problem.first.iter().zip(&inside.first).filter(|(f, _)| lit(&f.1));
        let first: Vec<_> = first.map(|((_, e, u), cropped)| (cropped, e[channel], *u)).collect();
        let equation = Equation {
            device,
            grid: &inside.grid,
            ordinates: set,
            sigma: &inside.sigma,
            scattering: &inside.scattering,
            emission: (!problem.emission.is_empty()).then_some(&inside.emission),
            first: &first,
            linear,
        };
        let (size, region) = (grid.size, inside.region);
        let (mut passes, mut over) = (0, 0);
        let share = inside.grid.len() as f64 / grid.len() as f64;
        let mut budget = Budget::new(problem.passes, problem.until, 1.0 / share);
        coarse.take(device, inside, linear / 3.0)?;
        let albedo = f64::from(device.largest_ratio(&inside.scattering, &inside.sigma)?);
        let mut certificate = contraction(albedo, set, linear);
        if certificate.gain >= LARGE_GAIN && linear.abs() <= 1.0 {
            let ones = match ones {
                Some(ones) => ones,
                None => ones.insert(device.alloc(grid.len())?),
            };
            device.resize(ones, inside.grid.len())?;
            device.fill(1.0, ones)?;
            let vacuum: Vec<_> = set.iter().map(|o| Ordinate { inflow: 0.0, ..*o }).collect();
            let unit = [(&*ones, 1.0, Travel::Along(Vec3::ZERO))];
            let bound = Equation { ordinates: &vacuum, emission: None, first: &unit, ..equation };
            let kept = match majorant {
                Some(kept) => kept,
                None => majorant.insert(State::new(device, grid.len(), linear != 0.0)?),
            };
            x.crop(device, kept, size, region)?;
            let residual = bound.apply(x, value, source)?;
            anderson.clear();
            anderson.take(device, x, value, Some(coarse))?;
            let mut half = budget.part(0.5);
            half.spent();
            let means = Means { anderson, source, coarse: Some(coarse), whole: None, budget: &mut half };
            let done = iterate::iterate(&bound, x, value, residual, means, |_| 0.5)?;
            passes += 1 + done.passes;
            (0..passes).for_each(|_| budget.spent());
            if done.residual.change < 1.0 {
                let gain = done.residual.peak / (1.0 - done.residual.change);
                certificate = Certificate { gain: gain.min(certificate.gain), rigorous: true };
            }
            kept.embed(device, value, region, size)?;
        }

        device.combine(&light, &mut whole.phi)?;
        let direct = f64::from(device.distance(&whole.phi, &self.zeros)?);
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
        let mut corrects = false;
        anderson.clear();
        for &guess in guesses {
            match guess {
                Start::Cold => x.combine(device, &[])?,
                Start::Previous => x.crop(device, solution, size, region)?,
                Start::Extrapolated => {
                    whole.combine(device, &[(solution, 2.0), (before, -1.0)])?;
                    x.crop(device, whole, size, region)?;
                }
            }
            let residual = equation.apply(x, value, source)?;
            passes += 1;
            budget.spent();
            let goal = target(residual.peak);
            let done = residual.change <= goal;
            if !done {
                // A guess that loses still helps the mixture.
                // One way all through: pairs of two equations do not mix.
                corrects = if best.is_none() { residual.change > NEAR * goal } else { corrects };
                anderson.take(device, x, value, Some(&mut *coarse).filter(|_| corrects))?;
            }
            if best.is_none_or(|(b, _)| residual.change < b.change) {
                best = Some((residual, guess));
                std::mem::swap(value, other);
            }
            // The other guess costs a pass too: it is tried only when the one that won last does worse than it did then.
            let as_usual = won.is_some_and(|(w, r)| w == guess && residual.change <= 1.5 * r * scale(residual.peak));
            if as_usual || done || !budget.allows(problem.everywhere) {
                break;
            }
        }
        let (residual, start) = best.expect("there is a guess");
        std::mem::swap(value, other);
        *won = (*known == 2).then(|| (start, residual.change / scale(residual.peak)));
        let boxed = !inside.is_all_of(grid);
        let beyond = Whole { grid, region, sigma, source: whole, out: before };
        let means = Means {
            anderson,
            source,
            coarse: Some(&mut *coarse).filter(|_| corrects),
            whole: Some(beyond).filter(|_| boxed && problem.everywhere),
            budget: &mut budget,
        };
        let done = iterate::iterate(&equation, x, value, residual, means, target)?;
        passes += done.passes;
        over += done.whole;
        if boxed && !problem.everywhere {
            before.embed(device, value, region, size)?;
        }
        std::mem::swap(before, solution);
        if !boxed {
            std::mem::swap(solution, value);
        }
        self.everywhere = problem.everywhere || !boxed;
        *known = (*known + 1).min(2);
        let bound = certificate.gain * done.residual.change / scale(done.residual.peak);
        let (within, pass) = (passes - over, set.len() as u64 + 1);
        Ok(ScatterReport {
            iterations: passes,
            sweeps: (within as f64 * share + over as f64) * set.len() as f64,
            voxel_updates: (within * inside.grid.len() as u64 + over * grid.len() as u64) * pass + coarse.updates,
            certified_error: if certificate.rigorous { bound } else { f64::INFINITY },
            converged: done.converged,
            start,
        })
    }

    /// Makes the optics of a channel in the box of the medium.
    fn prepare(&mut self, device: &dyn Device, problem: &ScatterProblem, channel: usize) -> Result<()> {
        let Scattered { grid: Grid { size, .. }, sigma, states: [scratch, ..], inside, .. } = self;
        let (size, region, chromatic) = (*size, inside.region, problem.chromatic[channel]);
        if chromatic != 1.0 {
            let sigma = match sigma {
                Some(sigma) => sigma,
                None => sigma.insert(device.alloc(problem.sigma.len())?),
            };
            device.combine(&[(problem.sigma, chromatic)], sigma)?;
        }
        if !problem.scattering_on {
            return Ok(());
        }
        let sigma = sigma.as_ref().filter(|_| chromatic != 1.0).unwrap_or(problem.sigma);
        device.crop(size, sigma, region, &mut inside.sigma)?;
        let scatters = (1.0 - forward(problem.anisotropy)) * chromatic;
        device.crop(size, &problem.scattering[channel], region, &mut scratch.phi)?;
        device.combine(&[(&scratch.phi, scatters)], &mut inside.scattering)?;
        if let Some(emission) = problem.emission.get(channel) {
            device.crop(size, emission, region, &mut inside.emission)?;
        }
        for ((light, factors, _), cropped) in problem.first.iter().zip(&mut inside.first) {
            if factors[channel] != 0.0 {
                device.crop(size, light, region, cropped)?;
            }
        }
        Ok(())
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
        everywhere: bool,
        mut take: impl FnMut(&str) -> Option<Vec<f32>>,
    ) -> Result<bool> {
        if kept.len() != self.channels.len() {
            return Ok(false);
        }
        self.everywhere = everywhere;
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
