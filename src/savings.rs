//! What the warm start saves, measured honestly (light.md): each step is lit cold and warm under the same certified tolerance in one
//! process, in turns, and both are held against a tight cold solve. Losses are reported as losses. Limits on a step's iterations and
//! time are lifted: what an unfinished step leaves would not be comparable.

use std::time::Instant;

use serde::Serialize;

use crate::device::Device;
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::light::{LightSolver, LightVolume};
use crate::lights::{self, Light};
use crate::medium::Medium;
use crate::scene::{Model, Scene};
use crate::source::Series;
use crate::transfer::TransferFunction;

mod report;

/// What lighting one step, or all of them, took.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Cost {
    /// Iterations of scattered light.
    pub iterations: u64,
    /// Sweeps in whole-grid units, all lights and directions.
    pub sweeps: f64,
    /// Light-voxel updates, passes that look for change or measure residuals included.
    pub voxel_updates: u64,
    /// Bricks of direct light that were swept.
    pub bricks_active: u64,
    /// Bricks of direct light in all.
    pub bricks_total: u64,
    /// Wall time of classification and light.
    pub seconds: f64,
    /// Bound on the error against a cold solve, relative to the unattenuated light; in a total, the largest.
    pub certified_error: f64,
    /// Largest difference of the fluence to the tight solve's on the light grid, relative to its largest; in a total, the
    /// largest.
    pub true_error: f64,
    /// Bytes that the updates move at least: 8 each, one value read and one written.
    pub bytes: u64,
}

impl Cost {
    fn add(&mut self, other: &Cost) {
        self.iterations += other.iterations;
        self.sweeps += other.sweeps;
        self.voxel_updates += other.voxel_updates;
        self.bricks_active += other.bricks_active;
        self.bricks_total += other.bricks_total;
        self.seconds += other.seconds;
        self.bytes += other.bytes;
        self.certified_error = self.certified_error.max(other.certified_error);
        self.true_error = self.true_error.max(other.true_error);
    }
}

/// Cold ÷ warm: above 1 the warm start saves, below 1 it loses.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Ratio {
    /// Of iterations.
    pub iterations: f64,
    /// Of sweeps.
    pub sweeps: f64,
    /// Of voxel updates.
    pub voxel_updates: f64,
    /// Of bricks swept.
    pub bricks_active: f64,
    /// Of wall time.
    pub seconds: f64,
    /// Of bytes.
    pub bytes: f64,
}

impl Ratio {
    fn of(cold: &Cost, warm: &Cost) -> Self {
        // Nothing against nothing is even; JSON has no infinity, so something against nothing counts as against one.
        let ratio = |c: f64, w: f64| if c == w { 1.0 } else { c / if w == 0.0 { 1.0 } else { w } };
        Ratio {
            iterations: ratio(cold.iterations as f64, warm.iterations as f64),
            sweeps: ratio(cold.sweeps, warm.sweeps),
            voxel_updates: ratio(cold.voxel_updates as f64, warm.voxel_updates as f64),
            bricks_active: ratio(cold.bricks_active as f64, warm.bricks_active as f64),
            seconds: ratio(cold.seconds, warm.seconds),
            bytes: ratio(cold.bytes as f64, warm.bytes as f64),
        }
    }
}

/// One step, lit both ways.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Step {
    /// The simulation's step number.
    pub step: u64,
    /// Physical time, where known.
    pub time: Option<f64>,
    /// From scratch.
    pub cold: Cost,
    /// From the step before.
    pub warm: Cost,
    /// Cold ÷ warm.
    pub ratio: Ratio,
}

/// A series, lit both ways.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Savings {
    /// What was lit how.
    pub what: String,
    /// Where it was computed.
    pub device: String,
    /// `light.tolerance` of both.
    pub tolerance: f32,
    /// Tolerance of the solve that true errors are taken against.
    pub tight_tolerance: f32,
    /// Each step, the first included.
    pub steps: Vec<Step>,
    /// Sum over all steps, errors the largest.
    pub cold: Cost,
    /// Sum over all steps, errors the largest.
    pub warm: Cost,
    /// Cold ÷ warm of the sums.
    pub ratio: Ratio,
}

/// One way of lighting a series.
struct Way {
    solver: LightSolver,
    light: LightVolume,
}

impl Way {
    fn new(device: &dyn Device, scene: &Scene, grid: &Grid, warm: bool, tolerance: f32) -> Result<Self> {
        let mut scene = scene.clone();
        (scene.light.warm, scene.light.tolerance) = (warm, tolerance);
        // Both ways go to the same certified tolerance, however many iterations the scene gives a step.
        (scene.light.iterations, scene.light.passes, scene.light.budget_ms) = (10_000, None, None);
        Ok(Way { solver: LightSolver::new(device, &scene, grid)?, light: LightVolume::default() })
    }

    /// Lights a step; the true error is filled in by [`against`].
    fn solve(&mut self, device: &dyn Device, medium: &Medium, lights: &[Light]) -> Result<Cost> {
        let begun = Instant::now();
        let report = self.solver.solve(device, medium, lights, &mut self.light)?;
        Ok(Cost {
            iterations: report.iterations,
            sweeps: report.sweeps,
            voxel_updates: report.voxel_updates,
            bricks_active: report.bricks_active,
            bricks_total: report.bricks_total,
            seconds: begun.elapsed().as_secs_f64(),
            certified_error: report.certified_error,
            true_error: 0.0,
            bytes: 8 * report.voxel_updates,
        })
    }

    fn fluence(&self, device: &dyn Device) -> Result<Vec<[f32; 3]>> {
        Ok(self.solver.illuminated(device, &self.light)?.fluence)
    }
}

/// Largest difference of two fluences, relative to the largest of the second.
fn against(fluence: &[[f32; 3]], tight: &[[f32; 3]]) -> f64 {
    let largest = tight.iter().flatten().fold(0.0f32, |m, v| m.max(*v));
    let differences = fluence.iter().flatten().zip(tight.iter().flatten()).map(|(a, b)| (a - b).abs());
    let most = differences.fold(0.0f32, f32::max);
    if largest > 0.0 { f64::from(most / largest) } else { 0.0 }
}

/// Measures the steps `indices` of `series` under `scene`. `range` are the values that map to 0 and 1 of the transfer function;
/// `progress` hears of each step.
pub fn measure(
    device: &dyn Device,
    series: &dyn Series,
    indices: &[usize],
    scene: &Scene,
    range: [f64; 2],
    progress: &mut dyn FnMut(&Step),
) -> Result<Savings> {
    scene.validate()?;
    let lights = lights::resolve(scene)?;
    let transfer = TransferFunction::new(&scene.transfer)?;
    let tolerance = scene.light.tolerance;
    let tight_tolerance = (tolerance * 0.01).max(1e-6);
    let first = indices.first().ok_or_else(|| Error::Unsupported("savings of no steps".into()))?;
    let grid = series.timestep(*first)?.grid;
    let table = transfer.table(range, grid.mean_spacing());
    let mut medium = Medium::new(device, grid, table.clone())?;
    medium.remember(device)?;
    let mut cold = Way::new(device, scene, &grid, false, tolerance)?;
    let mut warm = Way::new(device, scene, &grid, true, tolerance)?;
    let mut tight = Way::new(device, scene, &grid, false, tight_tolerance)?;
    let mut steps = Vec::with_capacity(indices.len());
    for (turn, &index) in indices.iter().enumerate() {
        let timestep = series.timestep(index)?;
        medium.take(device, &timestep)?;
        medium.classify(table.clone());
        // In turns, so that neither always finds the caches warm.
        let (mut c, mut w);
        if turn % 2 == 0 {
            c = cold.solve(device, &medium, &lights)?;
            w = warm.solve(device, &medium, &lights)?;
        } else {
            w = warm.solve(device, &medium, &lights)?;
            c = cold.solve(device, &medium, &lights)?;
        }
        tight.solve(device, &medium, &lights)?;
        let truth = tight.fluence(device)?;
        c.true_error = against(&cold.fluence(device)?, &truth);
        w.true_error = against(&warm.fluence(device)?, &truth);
        let ratio = Ratio::of(&c, &w);
        steps.push(Step { step: timestep.step, time: timestep.time, cold: c, warm: w, ratio });
        progress(steps.last().expect("just pushed"));
    }
    let sum = |pick: fn(&Step) -> &Cost| {
        steps.iter().fold(Cost::default(), |mut sum, s| {
            sum.add(pick(s));
            sum
        })
    };
    let (cold, warm) = (sum(|s| &s.cold), sum(|s| &s.warm));
    let what = match (scene.light.model, scene.light.scattering) {
        (Model::Paper, _) => "the paper's model",
        (Model::Physical, true) => "the physical model",
        (Model::Physical, false) => "direct light alone, physical model",
    };
    Ok(Savings {
        what: what.into(),
        device: device.name(),
        tolerance,
        tight_tolerance,
        ratio: Ratio::of(&cold, &warm),
        steps,
        cold,
        warm,
    })
}

/// The scene with each model, and with direct light alone, which sweeps bricks and iterates nothing.
pub fn each_model(scene: &Scene) -> Vec<Scene> {
    let with = |model: Model, scattering: bool| {
        let mut scene = scene.clone();
        (scene.light.model, scene.light.scattering) = (model, scattering);
        scene
    };
    vec![with(Model::Physical, true), with(Model::Physical, false), with(Model::Paper, true)]
}

/// Writes the report as one HTML file, a section for each measurement; it appears only when whole.
pub fn write_html(all: &[Savings], path: &std::path::Path) -> Result<()> {
    let html = report::html(all)?;
    crate::whole::write_whole(path, |file| {
        std::io::Write::write_all(file, html.as_bytes()).map_err(|e| Error::io(path, e))
    })
}
