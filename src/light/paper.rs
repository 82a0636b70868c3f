//! The model of Zhang & Ma 2013, "Fast Global Illumination for Interactive Volume Visualization":
//!
//! for each light upwind convection (16) of ρ, `L = Σ_k ρ_k L_k` (22), one diffusion of L (23), and shading by L (24).
//!
//! Where the paper leaves something open, this is what is done: L counts as fluence and is shaded as isotropic scattering,
//! L/4π, so that a scene is as bright as in the physical model; an environment adds its fluence 4πL everywhere; a cone limits
//! the emission angle where lights are composed, which is the same for rays and does not blur its edge; G(x, x_P) is
//! `exp(−r²/2w²)`, w the key `light.width`, else the distance from the light to the farthest corner of the box. Light from
//! one place is always solved in one ordered pass; layers are of distant light.
//!
//! # What is done again (Algorithm 1)
//!
//! A light is convected when the opacity changed, when its own direction or place did, or when it was left unfinished; in
//! order, only the bricks are whose medium or inflow changed.
//! Light is composed and diffused when any ρ or colour changed, and a moved camera changes nothing. A step spends at most
//! `light.iterations` on a layer (and then, with `light.budget_ms`, goes on until the time is used up); what is left unfinished
//! goes on in the next step from where it stands.

use std::time::{Duration, Instant};

use super::{IlluminatedVolume, SolveReport};
use crate::device::convection::{Convection, Layers, Opacity, Rays, Start};
use crate::device::{Buffer, Cone, Device, Lamp, Optic, Term, Weight};
use crate::error::Result;
use crate::grid::{BrickLayout, Grid};
use crate::lights::{Cell, Light};
use crate::medium::Medium;
use crate::scene::{ConvectionMethod, DiffusionMethod, Falloff, OpacityScale, Scene, SolverKeys};

mod diffusion;

use diffusion::Diffusion;

/// Edge of the bricks that ordered convection leaves alone: at half resolution they are as large as those of the data.
const EDGE: usize = 16;

/// What survives a step.
#[derive(Default)]
pub(super) struct Unknowns {
    grid: Option<Grid>,
    lights: Vec<Convected>,
    /// The composed and diffused light, one channel where all are the same.
    light: Vec<Buffer>,
    /// What it was composed of: each light's colour and lamp, and the environment.
    composed: Option<(Vec<Source>, [f32; 3])>,
}

/// ρ of one light.
struct Convected {
    convection: Convection,
    rho: Buffer,
    /// The other half of iterations; an earlier ρ.
    before: Buffer,
    /// Bound on the error of ρ; 1 where it is of another medium.
    error: f32,
    /// False until the first solve.
    solved: bool,
    /// True when ρ is of an earlier medium than that of the step before.
    behind: bool,
}

/// One light as this model sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Source {
    convection: Convection,
    lamp: Option<Lamp>,
    colour: [f32; 3],
    /// Largest factor that `lamp` puts on ρ.
    nearest: f32,
}

/// Extinction now and before, and scratch.
pub(super) struct Paper {
    keys: SolverKeys,
    opacity: Opacity,
    grid: Grid,
    layout: BrickLayout,
    sigma: [Buffer; 2],
    solved: bool,
    diffusion: Diffusion,
    irradiance: Vec<Buffer>,
    ones: Option<Buffer>,
    /// The light that comes first when the time is short.
    turn: usize,
}

impl Paper {
    /// Allocates a solver for data on `data`.
    pub(super) fn new(device: &dyn Device, scene: &Scene, data: &Grid) -> Result<Self> {
        let keys = scene.light.clone();
        let grid = data.resized(SolverKeys::grid_size(keys.resolution, data.size));
        let opacity = match keys.opacity_scale {
            OpacityScale::Calibrated => Opacity::Calibrated { length: Convection::step(&grid) as f32 },
            OpacityScale::Literal => {
                Opacity::Literal { length: (scene.transfer.reference * data.mean_spacing()) as f32 }
            }
        };
        Ok(Paper {
            diffusion: Diffusion::new(&keys, &grid),
            layout: BrickLayout::new(grid.size, EDGE),
            sigma: [device.alloc(grid.len())?, device.alloc(grid.len())?],
            solved: false,
            irradiance: vec![],
            ones: None,
            turn: 0,
            opacity,
            keys,
            grid,
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
        let begun = Instant::now();
        let mut report = SolveReport { converged: true, ..Default::default() };
        self.sigma.swap(0, 1);
        medium.property(device, Optic::Extinction, self.grid.size, &mut self.sigma[0])?;
        let warm = self.keys.warm && std::mem::replace(&mut self.solved, false) && volume.grid == Some(self.grid);
        let change = if warm {
            report.voxel_updates += self.grid.len() as u64;
            Some(device.change(&self.layout, &self.sigma[0], &self.sigma[1])?)
        } else {
            None
        };
        report.warm = warm;
        volume.grid = Some(self.grid);
        let sources: Vec<Source> = lights.iter().filter_map(|l| self.source(l)).collect();
        let moved = self.convect(device, &sources, (change.as_deref(), begun), volume, &mut report)?;
        let environment = environment(lights);
        let composed = (sources, environment);
        if moved || volume.composed.as_ref() != Some(&composed) {
            volume.composed = None;
            self.compose(device, &composed.0, composed.1, warm, volume, &mut report)?;
            volume.composed = Some(composed);
        }
        self.solved = true;
        report.sweeps = report.voxel_updates as f64 / self.grid.len() as f64;
        Ok(report)
    }

    /// A light as convection and what multiplies it; `None` for an environment.
    fn source(&self, light: &Light) -> Option<Source> {
        let grid = &self.grid;
        let (place, colour, radius, cone) = match *light {
            Light::Distant { direction, irradiance } => {
                let convection = Convection::distant(grid, direction, self.opacity);
                return Some(Source { convection, lamp: None, colour: irradiance, nearest: 1.0 });
            }
            Light::Point { position, radius, intensity } => (position, intensity, radius, None),
            Light::Cone { position, direction, angle, edge, radius, intensity } => {
                let cone = Cone { axis: direction, outer: angle.cos(), inner: (angle - edge).cos(), cosine: false };
                (position, intensity, radius, Some(cone))
            }
            Light::Patch { position, direction, radius, intensity } => {
                (position, intensity, radius, Some(Cone::facing(direction)))
            }
            Light::Environment { .. } | Light::Image { .. } => return None,
        };
        let physical = self.keys.falloff == Falloff::Physical;
        let (lo, hi) = grid.bounds();
        let farthest = (place - lo).abs().max((place - hi).abs()).length();
        let width = (!physical).then(|| self.keys.width.unwrap_or(farthest));
        let convection = Convection::central(grid, place, width, self.opacity);
        // 1/r² is held within half a voxel: a light's own voxel would be infinitely bright. Light that falls off as it is
        // convected is held in the whole grid, and its colour makes up for it.
        let radius = if physical { radius.max(0.5 * grid.mean_spacing()) } else { 2.0 * farthest };
        let nearest = 1.0 / (radius * radius) as f32;
        let lamp = (physical || cone.is_some()).then_some(Lamp { position: place, radius, cone });
        let colour = if lamp.is_none() || physical { colour } else { colour.map(|c| c / nearest) };
        Some(Source { convection, lamp, colour, nearest: if lamp.is_some() { nearest } else { 1.0 } })
    }

    /// Convects what has to be; true when some ρ is another one now.
    fn convect(
        &mut self,
        device: &dyn Device,
        sources: &[Source],
        (change, begun): (Option<&[[f32; 3]]>, Instant),
        volume: &mut Unknowns,
        report: &mut SolveReport,
    ) -> Result<bool> {
        let tolerance = self.tolerance();
        let changed = change.is_none_or(|c| c.iter().flatten().any(|c| *c > 0.0));
        volume.lights.truncate(sources.len());
        for (n, source) in sources.iter().enumerate() {
            if volume.lights.get(n).is_none_or(|l| l.convection.size != source.convection.size) {
                let [rho, before] = [device.alloc(self.grid.len())?, device.alloc(self.grid.len())?];
                let fresh =
                    Convected { convection: source.convection, rho, before, error: 1.0, solved: false, behind: false };
                volume.lights.truncate(n);
                volume.lights.push(fresh);
            }
            let light = &mut volume.lights[n];
            if light.convection != source.convection {
                (light.convection, light.solved) = (source.convection, false);
            }
            light.solved &= change.is_some();
            if changed || !light.solved {
                light.error = 1.0;
            }
        }
        // What was left of an earlier step goes on only where it may: at tolerance 0 every step is as a cold one.
        let unfinished = |l: &Convected| l.error > tolerance && (tolerance > 0.0 || changed);
        let count = sources.len();
        let mut order: Vec<usize> = (0..count).map(|n| (n + self.turn) % count.max(1)).collect();
        order.retain(|&n| !volume.lights[n].solved || unfinished(&volume.lights[n]));
        let budget = self.keys.budget_ms.map(|ms| Duration::from_secs_f64(ms * 1e-3));
        let in_time = || budget.is_none_or(|b| begun.elapsed() < b);
        report.bricks_total += (count * self.layout.len()) as u64;
        // Iterations run over everything.
        let iterated = order.iter().filter(|&&n| self.iterates(&volume.lights[n].convection)).count();
        report.bricks_active += (iterated * self.layout.len()) as u64;
        let moved = !order.is_empty();
        let mut done = 0;
        'passes: while !order.is_empty() {
            for (place, &n) in order.iter().enumerate() {
                // A step lights something, however short its time.
                if done > 0 && !in_time() {
                    self.turn = n;
                    order[place..].iter().for_each(|&n| volume.lights[n].behind |= changed);
                    break 'passes;
                }
                self.pass(device, &mut volume.lights[n], change, report)?;
                done += 1;
            }
            let endless = self.keys.budget_ms.is_some() && self.keys.convection != ConvectionMethod::Ordered;
            order.retain(|&n| endless && volume.lights[n].error > tolerance.max(f32::EPSILON));
        }
        let total: f32 = sources.iter().map(|s| brightest(s.colour) * s.nearest).sum();
        for (source, light) in sources.iter().zip(&volume.lights) {
            report.converged &= light.error <= tolerance;
            if total > 0.0 {
                report.certified_error += f64::from(light.error * brightest(source.colour) * source.nearest / total);
            }
        }
        Ok(moved)
    }

    /// One pass of convection of one light.
    fn pass(
        &self,
        device: &dyn Device,
        light: &mut Convected,
        change: Option<&[[f32; 3]]>,
        report: &mut SolveReport,
    ) -> Result<()> {
        let sigma = &self.sigma[0];
        let Convected { convection, rho, before, error, solved, behind } = light;
        let warm = *solved && self.tolerance() > 0.0;
        let voxels = self.grid.len() as u64;
        match self.keys.convection {
            ConvectionMethod::Layers if self.iterates(convection) => {
                std::mem::swap(rho, before);
                let start = if warm { Start::Best } else { Start::Upstream };
                let iterations = self.keys.iterations as u32;
                let layers = Layers { iterations, tolerance: self.tolerance(), start };
                let done = device.convect_layers(convection, layers, sigma, before, rho)?;
                report.iterations = report.iterations.max(done.iterations.into());
                report.voxel_updates += done.updates;
                *error = done.error.min(1.0);
            }
            ConvectionMethod::Volume => {
                if !warm {
                    device.combine(&[], rho)?;
                }
                let mut taken = 0;
                *error = 1.0;
                while taken < self.keys.iterations as u64 && *error > self.tolerance() {
                    std::mem::swap(rho, before);
                    let change = device.convect_whole(convection, sigma, before, rho)?;
                    *error = (convection.whole_gain() * change).min(1.0);
                    // Where no bound is known, an iteration that changes nothing is the end.
                    if change == 0.0 {
                        *error = 0.0;
                    }
                    taken += 1;
                }
                report.iterations = report.iterations.max(taken);
                report.voxel_updates += taken * voxels;
            }
            _ => {
                let change = change.filter(|_| *solved && !*behind);
                let [bricks, updates] = self.ordered(device, convection, rho, change)?;
                report.voxel_updates += updates;
                report.bricks_active += bricks;
                *error = 0.0;
            }
        }
        (*solved, *behind) = (true, false);
        Ok(())
    }

    /// True where a light is solved by iterations, false where in order.
    fn iterates(&self, convection: &Convection) -> bool {
        match self.keys.convection {
            ConvectionMethod::Layers => matches!(convection.rays, Rays::Parallel { .. }),
            ConvectionMethod::Volume => true,
            ConvectionMethod::Ordered => false,
        }
    }

    /// Ordered convection, given what changed since ρ was solved: a brick whose medium and inflow are the same to the bit is
    /// left alone, so that the light is that of a cold solve to the bit. Returns bricks and voxels that were solved.
    fn ordered(
        &self,
        device: &dyn Device,
        convection: &Convection,
        rho: &mut Buffer,
        change: Option<&[[f32; 3]]>,
    ) -> Result<[u64; 2]> {
        let (layout, sigma) = (&self.layout, &self.sigma[0]);
        let fronts = convection.fronts(layout);
        let Some(change) = change else {
            let fronts: Vec<&[u32]> = fronts.iter().map(|f| &f[..]).collect();
            device.convect_ordered(convection, layout, sigma, rho, &fronts)?;
            return Ok([layout.len() as u64, self.grid.len() as u64]);
        };
        let mut moved = vec![0.0f32; layout.len()];
        let (mut bricks, mut updates) = (0, 0);
        for front in &fronts {
            let mut active = front.clone();
            active.retain(|&b| {
                let lit = || convection.upstream(layout, b as usize);
                change[b as usize] != [0.0; 3] || lit().iter().any(|&n| moved[n as usize] != 0.0)
            });
            if active.is_empty() {
                continue;
            }
            let changes = device.convect_ordered(convection, layout, sigma, rho, &[&active])?;
            for (&b, change) in active.iter().zip(changes) {
                moved[b as usize] = change;
                updates += layout.region(b as usize).len() as u64;
            }
            bricks += active.len() as u64;
        }
        Ok([bricks, updates])
    }

    /// Composes (22) and diffuses (23).
    fn compose(
        &mut self,
        device: &dyn Device,
        sources: &[Source],
        environment: [f32; 3],
        warm: bool,
        volume: &mut Unknowns,
        report: &mut SolveReport,
    ) -> Result<()> {
        let voxels = self.grid.len();
        let even = |c: [f32; 3]| c[0] == c[1] && c[1] == c[2];
        let gray = even(self.keys.sigma_s) && even(environment) && sources.iter().all(|s| even(s.colour));
        let channels = if gray { 1 } else { 3 };
        let kept = warm && volume.light.len() == channels;
        if volume.light.len() != channels {
            volume.light = (0..channels).map(|_| device.alloc(voxels)).collect::<Result<_>>()?;
        }
        let masked = sources.iter().filter(|s| s.lamp.is_some()).count();
        while self.irradiance.len() < masked {
            self.irradiance.push(device.alloc(voxels)?);
        }
        let mut masks = self.irradiance.iter_mut();
        for (source, light) in sources.iter().zip(&volume.lights) {
            if let Some(lamp) = &source.lamp {
                let out = masks.next().expect("one for each");
                device.irradiate(lamp, &self.grid, 0..self.grid.size[2], &light.rho, out)?;
                report.voxel_updates += voxels as u64;
            }
        }
        if environment != [0.0; 3] && self.ones.is_none() {
            let mut ones = device.alloc(voxels)?;
            device.fill(1.0, &mut ones)?;
            self.ones = Some(ones);
        }
        let total: f32 = sources.iter().map(|s| brightest(s.colour) * s.nearest).sum();
        let scale = f64::from(total).max(f64::MIN_POSITIVE);
        let mut worst = 0.0f64;
        for (channel, out) in volume.light.iter_mut().enumerate() {
            let mut masks = self.irradiance.iter();
            let mut terms: Vec<(&Buffer, f32)> = sources
                .iter()
                .zip(&volume.lights)
                .map(|(source, light)| {
                    let rho = if source.lamp.is_some() { masks.next().expect("one for each") } else { &light.rho };
                    (rho, source.colour[channel])
                })
                .collect();
            if let Some(ones) = &self.ones {
                terms.push((ones, environment[channel]));
            }
            device.combine(&terms, self.diffusion.input(device, out)?)?;
            report.voxel_updates += voxels as u64;
            let tolerance = f64::from(self.tolerance()) * scale;
            let done = self.diffusion.solve(device, channel, out, kept && self.tolerance() > 0.0, tolerance)?;
            report.iterations = report.iterations.max(done.iterations);
            report.voxel_updates += done.updates;
            report.converged &= done.converged;
            worst = worst.max(done.error / scale);
        }
        report.certified_error += worst;
        Ok(())
    }

    /// What convection and, where it iterates, diffusion may each leave.
    fn tolerance(&self) -> f32 {
        match self.keys.diffusion {
            DiffusionMethod::Exact => self.keys.tolerance,
            _ => 0.5 * self.keys.tolerance,
        }
    }

    /// The light of the latest solve.
    pub(super) fn illuminated(&self, device: &dyn Device, volume: &Unknowns) -> Result<IlluminatedVolume> {
        let mut fluence = vec![[0.0; 3]; self.grid.len()];
        let terms: Vec<(&Buffer, [f32; 3])> =
            volume.light.iter().enumerate().map(|(c, light)| (light, volume.share(c, 1.0))).collect();
        device.compose(&terms, &mut fluence)?;
        Ok(IlluminatedVolume { grid: self.grid, fluence })
    }
}

impl Unknowns {
    /// The light as the ray caster takes it: `L/4π` in each channel.
    pub(super) fn terms(&self) -> Vec<Term<'_>> {
        let Some(grid) = &self.grid else { return vec![] };
        let per_sphere = 0.25 * std::f32::consts::FRAC_1_PI;
        let term = |(c, values)| Term { values, grid, weight: Weight::Uniform(self.share(c, per_sphere)) };
        self.light.iter().enumerate().map(term).collect()
    }

    /// `amount` in the colours that channel `c` stands for.
    fn share(&self, c: usize, amount: f32) -> [f32; 3] {
        std::array::from_fn(|a| if self.light.len() == 1 || a == c { amount } else { 0.0 })
    }
}

/// Fluence of all environment lights together.
fn environment(lights: &[Light]) -> [f32; 3] {
    lights.iter().fold([0.0; 3], |sum, l| match l {
        Light::Environment { radiance } => std::array::from_fn(|c| sum[c] + 4.0 * std::f32::consts::PI * radiance[c]),
        Light::Image { image, factor } => {
            let mean = image.mean(&Cell { z: [-1.0, 1.0], azimuth: [0.0, std::f64::consts::TAU] });
            std::array::from_fn(|c| sum[c] + 4.0 * std::f32::consts::PI * factor[c] * mean[c])
        }
        _ => sum,
    })
}

fn brightest(rgb: [f32; 3]) -> f32 {
    rgb.into_iter().fold(0.0, f32::max)
}
