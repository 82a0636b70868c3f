//! The physical model: direct light by short characteristics, multiple scattering by first-collision-source ordinates.

use std::f64::consts::PI;
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use super::direct::{Direct, Rays};
use super::ordinates::{KeptChannel, ScatterProblem, Scattered, cells, forward};
use super::{IlluminatedVolume, SolveReport, Touched};
use crate::device::{Buffer, Device, Lamp, Optic, Term, Travel, Weight};
use crate::error::{Error, Result};
use crate::geometry::Geometry;
use crate::grid::{BrickLayout, Grid};
use crate::lights::{Cell, Light};
use crate::medium::Medium;
use crate::scene::{Interpolation, Scene, SolverKeys};

/// What survives a step.
#[derive(Default)]
pub(super) struct Unknowns {
    /// A sweep for each source, and the source.
    direct: Vec<(Source, Direct)>,
    scattered: Option<Scattered>,
    grid: Option<Grid>,
    anisotropy: f32,
    /// Factor on extinction per colour channel.
    chromatic: [f32; 3],
    /// What the latest scattered light was solved for, and how well.
    lights: Vec<Light>,
    certified: f64,
    converged: bool,
    /// Bricks of direct light that the latest solve swept, where nothing else changed.
    touched: Option<(BrickLayout, Vec<bool>)>,
}

/// Bricks of direct light: finer ones follow what changed more closely, coarser ones are swept faster a voxel. On smoke that
/// moves by a voxel a step 16³ are swept in half of the volume, 32³ in three quarters.
const EDGE: usize = 16;

/// Share of changed bricks above which sweeping those one by one that see a change costs more than the whole grid.
const MANY: f64 = 0.5;

/// What one sweep is for: a light, in the colour channels that dim alike.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Source {
    rays: Rays,
    travel: Travel,
    /// What its transmittance is to be multiplied with, where it is in one place.
    lamp: Option<Lamp>,
    /// Irradiance, or radiant intensity of a lamp, per channel.
    strength: [f32; 3],
}

impl Source {
    /// The sources that `lights` ask for on `grid`: for each light one, or one for each factor on extinction.
    fn all(grid: &Grid, lights: &[Light], cubic: bool, chromatic: [f32; 3]) -> Vec<Self> {
        let mut factors: Vec<f32> = chromatic.to_vec();
        factors.sort_by(|a, b| b.total_cmp(a));
        factors.dedup();
        let of = |light, factor| {
            let source = Source::new(grid, light, cubic, factor)?;
            let strength = std::array::from_fn(|c| if chromatic[c] == factor { source.strength[c] } else { 0.0 });
            Some(Source { strength, ..source })
        };
        lights.iter().flat_map(|light| factors.iter().filter_map(move |&factor| of(light, factor))).collect()
    }

    /// The sweep for a light, if it takes one.
    fn new(grid: &Grid, light: &Light, cubic: bool, factor: f32) -> Option<Self> {
        if let Light::Distant { direction, irradiance } = *light {
            return Some(Source {
                rays: Rays::parallel(grid, direction, cubic, factor),
                travel: Travel::Along(direction),
                lamp: None,
                strength: irradiance,
            });
        }
        let (lamp, strength) = super::lamp(light)?;
        Some(Source {
            rays: Rays::radial(grid, lamp.position, factor),
            travel: Travel::From(lamp.position),
            lamp: Some(lamp),
            strength,
        })
    }

    fn weight(&self, g: f32) -> Weight {
        let Source { strength, .. } = *self;
        match (self.travel, self.lamp) {
            (_, Some(lamp)) => Weight::Lamp { lamp, intensity: strength, g },
            (Travel::Along(direction), None) => Weight::Phase { direction, irradiance: strength, g },
            (Travel::From(_), None) => unreachable!("light from one place falls off"),
        }
    }
}

/// Extinction now and before, and scratch.
pub(super) struct Physical {
    keys: SolverKeys,
    anisotropy: f32,
    grid: Grid,
    coarse: Grid,
    layout: BrickLayout,
    sigma: [Buffer; 2],
    solved: bool,
    only_visible: bool,
    /// See [`super::LightSolver::only_direct`].
    only_direct: bool,
    optics: Option<Optics>,
    /// Irradiance of a lamp on the grid of direct light.
    lit: Option<Buffer>,
    /// What is opaque beside the medium.
    opaque: Option<Opaque>,
}

/// Extinction of opaque things, on the grids of direct and of scattered light, and room to add it to the medium's.
struct Opaque {
    fine: [Buffer; 2],
    coarse: [Buffer; 2],
}

/// Optical depth of a voxel that something opaque fills.
const OPAQUE: f64 = 40.0;

/// What is known of light that is kept in a file, besides its volumes.
#[derive(Serialize, Deserialize)]
struct Kept {
    /// None: no bound is known.
    certified: Option<f64>,
    converged: bool,
    sources: usize,
    chromatic: [f32; 3],
    scattered: Option<Vec<KeptChannel>>,
    /// False where scattered light was left out outside the medium.
    #[serde(default = "yes")]
    everywhere: bool,
}

fn yes() -> bool {
    true
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
            only_visible: false,
            only_direct: false,
            optics: None,
            lit: None,
            opaque: None,
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
        let begun = Instant::now();
        let mut report = SolveReport { converged: true, ..Default::default() };
        self.sigma.swap(0, 1);
        let [now, before] = &mut self.sigma;
        // With multiple scattering the forward peak counts as unscattered (delta-Eddington), in what the eye sees too.
        let f = if self.keys.scattering { forward(self.anisotropy) } else { 0.0 };
        let optic = if f == 0.0 { Optic::Extinction } else { Optic::ScaledExtinction { f } };
        medium.property(device, optic, self.grid.size, now)?;
        if let Some(Opaque { fine: [things, sum], .. }) = &mut self.opaque {
            device.combine(&[(now, 1.0), (things, 1.0)], sum)?;
            std::mem::swap(now, sum);
        }
        let warm = self.keys.warm && std::mem::replace(&mut self.solved, false) && volume.grid == Some(self.grid);
        let change = if warm {
            report.voxel_updates += self.grid.len() as u64;
            Some(device.change(&self.layout, now, before)?)
        } else {
            None
        };
        volume.grid = Some(self.grid);
        volume.anisotropy = self.anisotropy;
        volume.chromatic = medium.table.chromatic;
        report.warm = warm;
        let seen = (self.only_visible && !self.keys.scattering).then(|| self.seen(medium));
        let few = change.as_deref().filter(|c| {
            let changed = c.iter().filter(|c| **c != [0.0; 3]).count();
            changed as f64 <= MANY * c.len() as f64
        });
        self.direct(device, (lights, medium.table.chromatic), (few, seen.as_deref()), volume, &mut report)?;
        let mut touched = volume.touched.take().map_or_else(Vec::new, |(_, bricks)| bricks);
        touched.clear();
        touched.resize(self.layout.len(), false);
        for (_, direct) in &volume.direct {
            touched.iter_mut().zip(direct.touched()).for_each(|(t, d)| *t |= d);
        }
        let same_lights = warm && volume.lights == lights;
        let still = change.is_some_and(|c| c.iter().all(|c| *c == [0.0; 3])) && volume.lights == lights;
        // What a budget has left unfinished goes on where it may: at tolerance 0 every step is as a cold one.
        let limited = self.keys.passes.is_some() || self.keys.budget_ms.is_some();
        let unfinished = limited && !volume.converged && self.keys.tolerance > 0.0;
        let enough = volume.scattered.as_ref().is_some_and(|s| self.only_visible || s.is_everywhere());
        if still && !unfinished && enough && self.still(device, medium, &mut report)? {
            report.certified_error += volume.certified;
            report.converged = volume.converged;
            volume.touched = Some((self.layout, touched));
        } else {
            let direct = report.certified_error;
            self.scattered(device, medium, (lights, begun), warm, volume, &mut report)?;
            volume.certified = report.certified_error - direct;
            volume.converged = report.converged;
            volume.lights = lights.to_vec();
            volume.touched = (same_lights && volume.scattered.is_none()).then_some((self.layout, touched));
        }
        self.solved = true;
        Ok(report)
    }

    /// See [`super::LightSolver::only_direct`].
    pub(super) fn only_direct(&mut self, only: bool) {
        self.only_direct = only;
    }

    /// See [`super::LightSolver::block`].
    pub(super) fn block(&mut self, device: &dyn Device, geometry: &Geometry) -> Result<()> {
        if device.pages() {
            let what = "[[meshes]] in volumes that do not fit into memory\n  try: a larger --memory, or --preview";
            return Err(Error::Unsupported(what.into()));
        }
        let on = |grid: &Grid| -> Result<[Buffer; 2]> {
            let least = grid.spacing.iter().copied().fold(f64::INFINITY, f64::min);
            let extinction = (OPAQUE / least) as f32;
            let values: Vec<f32> = geometry.blocked(grid).into_iter().map(|b| b * extinction).collect();
            let mut things = device.alloc(grid.len())?;
            device.upload(&values, &mut things)?;
            Ok([things, device.alloc(grid.len())?])
        };
        self.opaque = Some(Opaque { fine: on(&self.grid)?, coarse: on(&self.coarse)? });
        Ok(())
    }

    /// See [`super::LightSolver::only_visible`].
    pub(super) fn only_visible(&mut self, only: bool) {
        self.only_visible = only;
    }

    /// Bricks whose light some sample of a ray interpolates where there is something to see.
    fn seen(&self, medium: &Medium) -> Vec<bool> {
        let mut seen = vec![false; self.layout.len()];
        let edge = self.layout.edge;
        for b in (0..medium.bricks.len()).filter(|&b| medium.majorant[b] > 0.0) {
            let region = medium.bricks.region(b);
            let at = |a: usize, data: f64| {
                let index = (data + 0.5) * self.grid.size[a] as f64 / medium.grid.size[a] as f64 - 0.5;
                index.clamp(0.0, (self.grid.size[a] - 1) as f64) as usize / edge
            };
            // A light voxel beyond what the samples' cells reach: interpolation looks there.
            let scale = |a: usize| medium.grid.size[a] as f64 / self.grid.size[a] as f64;
            let first: [usize; 3] = std::array::from_fn(|a| at(a, region.start[a] as f64 - 1.0 - scale(a)));
            let last: [usize; 3] = std::array::from_fn(|a| at(a, region.end()[a] as f64 + scale(a)));
            for z in first[2]..=last[2] {
                for y in first[1]..=last[1] {
                    for x in first[0]..=last[0] {
                        seen[self.layout.number([x, y, z])] = true;
                    }
                }
            }
        }
        seen
    }

    /// What a later run may start from; `None` before the first solve.
    pub(super) fn keep(
        &self,
        device: &dyn Device,
        volume: &Unknowns,
        volumes: &mut Vec<(String, Vec<f32>)>,
    ) -> Result<Option<serde_json::Value>> {
        if !self.solved {
            return Ok(None);
        }
        let mut put = |name: String, buffer: &Buffer| {
            let mut values = vec![0.0; buffer.len()];
            device.download(buffer, &mut values)?;
            volumes.push((name, values));
            Ok::<_, crate::Error>(())
        };
        put("extinction".into(), &self.sigma[0])?;
        for (n, (_, direct)) in volume.direct.iter().enumerate() {
            put(format!("direct_{n}"), &direct.rho)?;
        }
        volumes.extend(volume.direct.iter().enumerate().map(|(n, (_, d))| (format!("direct_{n}_drift"), d.drift())));
        let kept = Kept {
            certified: Some(volume.certified).filter(|c| c.is_finite()),
            converged: volume.converged,
            sources: volume.direct.len(),
            chromatic: volume.chromatic,
            scattered: volume.scattered.as_ref().map(|s| s.keep(device, volumes)).transpose()?,
            everywhere: volume.scattered.as_ref().is_none_or(Scattered::is_everywhere),
        };
        Ok(Some(serde_json::to_value(kept).expect("numbers and lists")))
    }

    /// Takes up what [`Physical::keep`] gave for the same settings and lights. False when it does not fit: the next solve is cold.
    pub(super) fn restore(
        &mut self,
        device: &dyn Device,
        kept: &serde_json::Value,
        mut take: impl FnMut(&str) -> Option<Vec<f32>>,
        lights: &[Light],
        volume: &mut Unknowns,
    ) -> Result<bool> {
        let Ok(kept) = serde_json::from_value::<Kept>(kept.clone()) else { return Ok(false) };
        match take("extinction") {
            Some(values) if values.len() == self.grid.len() => device.upload(&values, &mut self.sigma[0])?,
            _ => return Ok(false),
        }
        self.sources(device, lights, kept.chromatic, volume)?;
        if volume.direct.len() != kept.sources {
            return Ok(false);
        }
        for (n, (_, direct)) in volume.direct.iter_mut().enumerate() {
            let (rho, drift) = (take(&format!("direct_{n}")), take(&format!("direct_{n}_drift")));
            let (Some(rho), Some(drift)) = (rho, drift) else { return Ok(false) };
            if !direct.restore(device, &rho, &drift)? {
                return Ok(false);
            }
        }
        volume.scattered = match kept.scattered {
            Some(channels) => {
                let mut scattered = Scattered::new(device, self.coarse, channels.len(), self.anisotropy)?;
                if !scattered.restore(device, &channels, kept.everywhere, take)? {
                    return Ok(false);
                }
                Some(scattered)
            }
            None => None,
        };
        volume.grid = Some(self.grid);
        volume.anisotropy = self.anisotropy;
        volume.certified = kept.certified.unwrap_or(f64::INFINITY);
        volume.converged = kept.converged;
        volume.lights = lights.to_vec();
        self.solved = true;
        Ok(true)
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

    /// Direct light of every source. A light that was there before keeps its sweep, wherever it stands in the list and
    /// whatever its strength. Returns the share of the bricks of such lights that was swept.
    fn direct(
        &mut self,
        device: &dyn Device,
        (lights, chromatic): (&[Light], [f32; 3]),
        (change, seen): (Option<&[[f32; 3]]>, Option<&[bool]>),
        volume: &mut Unknowns,
        report: &mut SolveReport,
    ) -> Result<()> {
        // An error of direct light comes back from scattering up to 1/(1 − ω) times, and a sweep costs less than one ordinate's:
        // where light scatters on, only what is the same to the bit is left alone.
        let tolerance = if self.keys.scattering { 0.0 } else { self.keys.tolerance };
        self.sources(device, lights, chromatic, volume)?;
        if volume.direct.iter().any(|(s, _)| s.lamp.is_some()) && self.lit.is_none() {
            self.lit = Some(device.alloc(self.grid.len())?);
        }
        let total: f32 = volume.direct.iter().map(|(s, _)| brightest(s.strength)).sum();
        let mut worst = 0.0f64;
        let together = device.pages();
        if together {
            let mut lights: Vec<_> = volume.direct.iter_mut().filter_map(|(_, d)| d.parallel()).collect();
            device.sweep_each(&mut lights, &self.layout, &self.sigma[0])?;
        }
        for (source, direct) in &mut volume.direct {
            direct.demand(seen);
            let done = match source.rays {
                Rays::Parallel(_) if together => direct.swept(&self.layout, true),
                _ => direct.solve(device, &self.grid, &self.layout, &self.sigma[0], change, tolerance)?,
            };
            report.bricks_active += done.bricks_active;
            report.bricks_total += done.bricks_total;
            report.bricks_culled += done.bricks_culled;
            report.voxel_updates += done.voxels;
            report.sweeps += done.voxels as f64 / self.grid.len() as f64;
            worst = worst.max(done.certified_error.into());
            if total > 0.0 {
                report.certified_error += f64::from(done.certified_error * brightest(source.strength) / total);
            }
        }
        // What lamps of different places add up to differs from voxel to voxel: the worst of them bounds it everywhere.
        if volume.direct.iter().any(|(s, _)| s.lamp.is_some()) {
            report.certified_error = worst;
        }
        Ok(())
    }

    /// Makes room for the direct light of each source. A light that was there before keeps its sweep, wherever it stands in the list
    /// and whatever its strength.
    fn sources(&self, device: &dyn Device, lights: &[Light], chromatic: [f32; 3], volume: &mut Unknowns) -> Result<()> {
        let cubic = self.keys.interpolation == Interpolation::Cubic;
        let sources = Source::all(&self.grid, lights, cubic, chromatic);
        let mut kept = std::mem::take(&mut volume.direct);
        let mut found: Vec<Option<Direct>> = sources
            .iter()
            .map(|source| {
                let at = kept.iter().position(|(_, direct)| *direct.rays() == source.rays)?;
                Some(kept.swap_remove(at).1)
            })
            .collect();
        for (source, found) in sources.iter().zip(&mut found) {
            let direct = match found.take() {
                Some(direct) => direct,
                None => {
                    let rho = match kept.pop() {
                        Some((_, other)) => other.rho,
                        None => device.alloc(self.grid.len())?,
                    };
                    Direct::of(rho, &self.layout, source.rays)
                }
            };
            volume.direct.push((*source, direct));
        }
        Ok(())
    }

    /// Scattered light, and the uncollided light of the environment.
    fn scattered(
        &mut self,
        device: &dyn Device,
        medium: &Medium,
        (lights, begun): (&[Light], Instant),
        warm: bool,
        volume: &mut Unknowns,
        report: &mut SolveReport,
    ) -> Result<()> {
        let environment = environment(lights, self.keys.directions)?;
        if self.only_direct || !self.keys.scattering && environment.iter().flatten().all(|l| *l == 0.0) {
            volume.scattered = None;
            return Ok(());
        }
        let strengths = volume.direct.iter().map(|(source, _)| source.strength);
        let channels = if gray(medium, strengths.chain(environment.iter().copied())) { 1 } else { 3 };
        let glows = !medium.table.emission.is_empty();
        let f = forward(self.anisotropy);
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
        let Optics { sigma, scattering, emission, .. } = optics;
        let mut wanted = vec![(Optic::ScaledExtinction { f }, sigma)];
        wanted.extend(scattering.iter_mut().enumerate().map(|(channel, out)| (Optic::Scattering { channel }, out)));
        wanted.extend(emission.iter_mut().enumerate().map(|(channel, out)| (Optic::Emission { channel }, out)));
        medium.properties(device, &mut wanted, self.coarse.size)?;
        if let Some(Opaque { coarse: [things, sum], .. }) = &mut self.opaque {
            device.combine(&[(&optics.sigma, 1.0), (things, 1.0)], sum)?;
            std::mem::swap(&mut optics.sigma, sum);
        }
        for ((source, direct), out) in volume.direct.iter().zip(&mut optics.first) {
            let fine = match (&source.lamp, &mut self.lit) {
                (Some(lamp), Some(lit)) => {
                    device.irradiate(lamp, &self.grid, 0..self.grid.size[2], &direct.rho, lit)?;
                    lit
                }
                _ => &direct.rho,
            };
            device.restrict(self.grid.size, fine, self.coarse.size, out)?;
        }
        let sources = volume.direct.iter().map(|(source, _)| source);
        let first: Vec<_> = optics.first.iter().zip(sources).map(|(e, s)| (e, s.strength, s.travel)).collect();
        let problem = ScatterProblem {
            sigma: &optics.sigma,
            scattering: &optics.scattering,
            emission: &optics.emission,
            first: &first,
            environment: &environment,
            chromatic: medium.table.chromatic,
            anisotropy: self.anisotropy,
            directions: self.keys.directions,
            tolerance: self.keys.tolerance,
            warm,
            scattering_on: self.keys.scattering,
            everywhere: !self.only_visible,
            passes: self.keys.passes.map(|p| p as u64),
            until: self.keys.budget_ms.map(|ms| begun + Duration::from_secs_f64(ms * 1e-3)),
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
    pub(super) fn illuminated(&self, device: &dyn Device, volume: &Unknowns) -> Result<IlluminatedVolume> {
        let mut first = Vec::new();
        for (source, direct) in &volume.direct {
            let mut out = device.alloc(self.coarse.len())?;
            let mut lit = None;
            if let Some(lamp) = &source.lamp {
                let lit = lit.insert(device.alloc(self.grid.len())?);
                device.irradiate(lamp, &self.grid, 0..self.grid.size[2], &direct.rho, lit)?;
            }
            device.restrict(self.grid.size, lit.as_ref().unwrap_or(&direct.rho), self.coarse.size, &mut out)?;
            first.push((out, source.strength));
        }
        let mut terms: Vec<(&Buffer, [f32; 3])> = first.iter().map(|(e, strength)| (e, *strength)).collect();
        if let Some(scattered) = &volume.scattered {
            terms.extend(scattered.fluence());
        }
        let mut fluence = vec![[0.0; 3]; self.coarse.len()];
        device.compose(&terms, &mut fluence)?;
        Ok(IlluminatedVolume { grid: self.coarse, fluence })
    }
}

impl Unknowns {
    /// Where the latest solve changed the light.
    pub(super) fn touched(&self) -> Touched<'_> {
        self.touched.as_ref().map_or(Touched::Everywhere, |(layout, bricks)| Touched::Bricks(*layout, bricks))
    }

    /// The light as the ray caster takes it: one term for each light, and those of scattered light.
    pub(super) fn terms(&self) -> Vec<Term<'_>> {
        let Some(grid) = &self.grid else { return vec![] };
        let direct = self.direct.iter().map(|(source, direct)| Term {
            values: &direct.rho,
            grid,
            weight: source.weight(self.anisotropy),
        });
        let scattered = self.scattered.iter().flat_map(|s| s.terms());
        direct.chain(scattered).collect()
    }
}

/// Radiance of all environment lights together, along each ordinate.
fn environment(lights: &[Light], directions: usize) -> Result<Vec<[f32; 3]>> {
    let mut radiance = vec![[0.0; 3]; directions];
    for light in lights {
        match light {
            Light::Environment { radiance: even } => {
                radiance.iter_mut().for_each(|r| *r = std::array::from_fn(|c| r[c] + even[c]));
            }
            Light::Image { image, factor } => {
                for (r, cell) in radiance.iter_mut().zip(cells(directions)?) {
                    // Light that travels along Ω comes from −Ω.
                    let from = Cell { z: cell.z.map(|z| -z), azimuth: cell.azimuth.map(|a| a + PI) };
                    let mean = image.mean(&Cell { z: [from.z[1], from.z[0]], ..from });
                    *r = std::array::from_fn(|c| r[c] + factor[c] * mean[c]);
                }
            }
            Light::Distant { .. } | Light::Point { .. } | Light::Cone { .. } | Light::Patch { .. } => {}
        }
    }
    Ok(radiance)
}

fn brightest(rgb: [f32; 3]) -> f32 {
    rgb.into_iter().fold(0.0, f32::max)
}

/// True when one channel stands for all three: the medium is gray, and so are these colours of light.
fn gray(medium: &Medium, mut light: impl Iterator<Item = [f32; 3]>) -> bool {
    let even = |c: [f32; 3]| c[0] == c[1] && c[1] == c[2];
    medium.table.gray() && medium.table.emission.iter().all(|e| even(*e)) && light.all(even)
}
