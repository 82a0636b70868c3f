//! A series as its layout found it, checked as a whole and opened step by step.

use std::path::Path;
use std::sync::Arc;

use super::values::Values;
use super::{GridInfo, Native, Series, SeriesInfo, SourceSpec, StepInfo, h5, shape_text};
use crate::error::{Error, Result};
use crate::field::Timestep;
use crate::grid::Grid;

/// A step that has been found but not opened.
#[derive(Clone)]
pub(crate) struct Step {
    pub step: u64,
    pub time: Option<f64>,
    /// The step's own grid, where it is known to differ or its metadata was read.
    pub grid: Option<GridInfo>,
    pub values: Values,
}

/// What a layout made of the files: everything but the steps in `info`, and the steps.
pub(crate) struct Plan {
    pub info: SeriesInfo,
    pub steps: Vec<Step>,
    /// Time of step 0 where `--time-step` sets the times.
    pub start: f64,
}

/// A series whose steps are opened on demand.
pub(crate) struct Planned {
    info: SeriesInfo,
    steps: Vec<Step>,
    /// Spacing and origin from the settings, which hold for every step.
    spacing: Option<[f64; 3]>,
    origin: Option<[f64; 3]>,
    opened: Arc<h5::Opened>,
}

impl Planned {
    /// Applies the settings, and checks what concerns the series as a whole.
    pub fn new(plan: Plan, spec: &SourceSpec) -> Result<Planned> {
        let Plan { mut info, mut steps, start } = plan;
        let name = format!("{}:{}", super::first_name(&info.series), info.field);
        if steps.is_empty() {
            return Err(Error::format(name, "the series has no steps", "a run that has written at least one step"));
        }
        if let Some(zero) = info.grid.size.iter().position(|&n| n == 0) {
            let found = format!("no values along {}: the grid is {}", ["x", "y", "z"][zero], grid_text(&info.grid));
            return Err(Error::format(name, found, ""));
        }
        if info.grid.size.iter().try_fold(8usize, |bytes, &n| bytes.checked_mul(n)).is_none_or(|b| b > 1 << 48) {
            let found = format!("the file claims a grid of {}, more than any machine holds", grid_text(&info.grid));
            return Err(Error::format(name, found, "--axes, if its axes were taken for others"));
        }
        if let Some(dt) = spec.time_step {
            steps.iter_mut().for_each(|s| s.time = Some(start + s.step as f64 * dt));
        }
        for (what, set) in [("spacing", spec.spacing), ("origin", spec.origin)] {
            if set.is_some_and(|v| v.iter().any(|v| !v.is_finite() || (what == "spacing" && *v <= 0.0))) {
                return Err(Error::format(
                    name,
                    format!("--{what} {:?} is not usable", set),
                    "finite, positive lengths",
                ));
            }
        }
        check_numbers(&mut steps, &mut info.warnings);
        check_times(&mut steps, &mut info.warnings);
        repair_spacing(&mut info.grid, &mut info.warnings);
        let plan_origin = info.grid.origin;
        if let (Some(set), Some(stretch)) = (spec.spacing, &info.grid.stretch) {
            // The mean of an uneven axis is set; how its values lie to one another stays.
            let factors = std::array::from_fn(|a| set[a] / info.grid.spacing[a]);
            info.grid.stretch = Some(Arc::new(stretch.scaled(factors)));
        }
        info.grid.spacing = spec.spacing.unwrap_or(info.grid.spacing);
        info.grid.origin = spec.origin.unwrap_or(info.grid.origin);
        if spec.level.is_some() && info.level.is_none() {
            return Err(Error::format(
                name,
                "--level: this series has no levels of refinement",
                "the same without --level",
            ));
        }
        info.resampled = info.grid.stretch.as_ref().map(|stretch| {
            let own = Grid { origin: plan_origin, ..Grid::from(&info.grid) };
            let mut even = stretch.grid(&own);
            // The first value was moved by --origin, and everything else with it.
            (0..3).for_each(|a| even.origin[a] += info.grid.origin[a] - plan_origin[a]);
            even
        });
        info.steps = steps.iter().map(|s| StepInfo { step: s.step, time: s.time }).collect();
        Ok(Planned {
            info,
            steps,
            spacing: spec.spacing,
            origin: spec.origin,
            opened: Arc::new(h5::Opened::new(spec.memory)),
        })
    }

    /// The step on the file's own grid.
    fn own(&self, index: usize) -> Result<Timestep> {
        let Some(step) = self.steps.get(index) else {
            let found = format!("step index {index} is past the last of {} steps", self.steps.len());
            return Err(Error::format(super::first_name(&self.info.series), found, "gloaming info lists the steps"));
        };
        let mut grid = Grid::from(&self.info.grid);
        if let Some(own) = &step.grid {
            let mut own = own.clone();
            repair_spacing(&mut own, &mut Vec::new());
            own.spacing = self.spacing.unwrap_or(own.spacing);
            own.origin = self.origin.unwrap_or(own.origin);
            if !same_grid(&own, &self.info.grid) {
                let (was, is) = (grid_text(&self.info.grid), grid_text(&own));
                let found = format!("step {}: the grid changes from {was} to {is}", step.step);
                let name = format!("{}:{}", super::first_name(&self.info.series), self.info.field);
                return Err(Error::format(name, found, "--steps A..B for the steps before or after the change"));
            }
            grid.origin = own.origin;
        }
        let field = step.values.open(grid.size, &self.opened).map_err(|e| match e {
            Error::Format { path, found, remedy } => {
                Error::Format { path, found: format!("step {}: {found}", step.step), remedy }
            }
            other => other,
        })?;
        Ok(Timestep { step: step.step, time: step.time, grid, field })
    }
}

impl Series for Planned {
    fn info(&self) -> &SeriesInfo {
        &self.info
    }

    fn file(&self, index: usize) -> Option<&Path> {
        self.steps.get(index)?.values.file()
    }

    fn timestep(&self, index: usize) -> Result<Timestep> {
        let own = self.own(index)?;
        let (Some(stretch), Some(even)) = (&self.info.grid.stretch, self.info.resampled) else { return Ok(own) };
        Ok(Timestep { grid: even, field: Arc::new(stretch.field(own.field)), ..own })
    }

    fn native(&self, index: usize) -> Result<Native> {
        let own = self.own(index)?;
        match &self.steps[index].values {
            Values::Mesh(mesh) => mesh.native(own, &self.opened),
            _ => Ok(Native::from(own)),
        }
    }
}

/// `96×96×96, spacing 1 1 1`.
fn grid_text(grid: &GridInfo) -> String {
    let [dx, dy, dz] = grid.spacing;
    format!("{} (x, y, z), spacing {dx} {dy} {dz}", shape_text(&grid.size))
}

/// The same size, and the same spacing to single precision: what the light volume depends on.
fn same_grid(a: &GridInfo, b: &GridInfo) -> bool {
    a.size == b.size && (0..3).all(|i| (a.spacing[i] - b.spacing[i]).abs() <= 1e-6 * b.spacing[i].abs())
}

/// A spacing that no volume can have becomes 1, and says so.
fn repair_spacing(grid: &mut GridInfo, warnings: &mut Vec<String>) {
    if grid.spacing.iter().any(|d| !d.is_finite() || *d <= 0.0) {
        let [dx, dy, dz] = grid.spacing;
        warnings.push(format!("spacing {dx} {dy} {dz} is not positive: 1 1 1 is taken; --spacing DX,DY,DZ sets it"));
        grid.spacing = [1.0; 3];
    }
    if grid.origin.iter().any(|o| !o.is_finite()) {
        warnings.push("the origin is not finite: 0 0 0 is taken; --origin X,Y,Z sets it".into());
        grid.origin = [0.0; 3];
    }
}

/// Orders steps by number; numbers that occur twice give way to the index, and gaps are told.
fn check_numbers(steps: &mut [Step], warnings: &mut Vec<String>) {
    steps.sort_by_key(|s| s.step);
    if let Some(twice) = steps.windows(2).find(|w| w[0].step == w[1].step).map(|w| w[0].step) {
        warnings.push(format!("step number {twice} occurs more than once: steps are numbered from 0 instead"));
        steps.iter_mut().enumerate().for_each(|(i, s)| s.step = i as u64);
        return;
    }
    let gaps = || steps.windows(2).map(|w| w[1].step - w[0].step);
    let Some(stride) = gaps().min() else { return };
    let gapped: Vec<String> = steps
        .windows(2)
        .filter(|w| w[1].step - w[0].step >= 2 * stride && (w[1].step - w[0].step) % stride == 0)
        .map(|w| match (w[0].step + stride, w[1].step - stride) {
            (a, b) if a == b => a.to_string(),
            (a, b) => format!("{a} to {b}"),
        })
        .collect();
    // Where most steps are apart by more than the least stride, the numbers are irregular, not missing.
    if !gapped.is_empty() && gapped.len() * 2 <= steps.len() {
        let more = if gapped.len() > 8 { format!(" and {} more gaps", gapped.len() - 8) } else { String::new() };
        warnings.push(format!("step numbers are missing: {}{more}", gapped[..gapped.len().min(8)].join(", ")));
    }
}

/// Times that are not numbers become unknown; those that repeat or go back are told.
fn check_times(steps: &mut [Step], warnings: &mut Vec<String>) {
    let odd: Vec<u64> = steps.iter().filter(|s| s.time.is_some_and(|t| !t.is_finite())).map(|s| s.step).collect();
    if !odd.is_empty() {
        warnings.push(format!("time is NaN or infinite at step {}; --time-step DT sets times", list(&odd)));
        steps.iter_mut().for_each(|s| s.time = s.time.filter(|t| t.is_finite()));
    }
    let timed: Vec<(u64, f64)> = steps.iter().filter_map(|s| Some((s.step, s.time?))).collect();
    let at = |test: fn(f64, f64) -> bool| -> Vec<u64> {
        timed.windows(2).filter(|w| test(w[0].1, w[1].1)).map(|w| w[1].0).collect()
    };
    for (how, at) in [("repeats", at(|a, b| a == b)), ("goes back", at(|a, b| b < a))] {
        if !at.is_empty() {
            warnings.push(format!("time {how} at step {}", list(&at)));
        }
    }
    let untimed: Vec<u64> = steps.iter().filter(|s| s.time.is_none()).map(|s| s.step).collect();
    if !untimed.is_empty() && untimed.len() < steps.len() && odd.is_empty() {
        warnings.push(format!("time is missing at step {}; --time-step DT sets times", list(&untimed)));
    }
}

fn list(steps: &[u64]) -> String {
    let shown: Vec<String> = steps.iter().take(8).map(u64::to_string).collect();
    let more = if steps.len() > 8 { format!(" and {} more", steps.len() - 8) } else { String::new() };
    format!("{}{more}", shown.join(", "))
}
