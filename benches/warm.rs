//! What the warm start saves on smoke.h5, lit by two distant lights, albedo 0.9, tolerance 1e-3, and on series made of it that
//! change more slowly or in a small part of the volume only.
//!
//! `cargo bench --bench warm [-- SERIES]`; see [`gloaming::savings`] for how it is measured. Steps after the first.

use std::sync::Arc;

use gloaming::device::cpu::Cpu;
use gloaming::field::{Dense, Timestep};
use gloaming::savings::{self, Cost, Step};
use gloaming::scene::Scene;
use gloaming::source::{self, Series, SeriesInfo, SourceSpec};
use gloaming::{Grid, Region, Result};

const LIGHT: [&str; 6] = [
    "transfer.colormap=white",
    "transfer.albedo=0.9",
    "lights.0.direction=[-0.5,-1.0,-0.4]",
    "lights.1.direction=[0.6,0.4,-0.7]",
    "lights.1.intensity=1.0",
    "light.tolerance=1e-3",
];

/// Thick smoke (the default transfer function, optical depth about 30) and thin smoke (about 6).
const MEDIA: [(&str, &str); 2] = [("thick", "[1.0, 0.5]"), ("thin", "[1.0, 0.1]")];

fn main() -> Result<()> {
    let only = std::env::args().skip(1).find(|a| !a.starts_with("--"));
    let cpu = Cpu::new(0)?;
    println!("cold → warm, mean of a step after the first; share = warm ÷ cold");
    for (name, every, part) in [("smoke", 1, false), ("slow", 4, false), ("part", 1, true), ("slow part", 4, true)] {
        if only.as_ref().is_some_and(|o| o != name) {
            continue;
        }
        let series = Smoke::new(every, part)?;
        let indices: Vec<usize> = (0..series.times.len()).collect();
        for (medium, opacity) in MEDIA {
            for scattering in [true, false] {
                let opacity = format!("transfer.opacity=[[0.0, 0.0], {opacity}]");
                let sets = LIGHT.iter().map(|s| s.to_string());
                let sets: Vec<String> = sets.chain([opacity, format!("light.scattering={scattering}")]).collect();
                let scene = Scene::load(None, &sets)?;
                let found = savings::measure(&cpu, &series, &indices, &scene, [0.0, 1.0], &mut |_| ())?;
                let light = if scattering { "all light" } else { "direct" };
                report(&format!("{name}, {medium}, {light}"), &found.steps[1..]);
            }
        }
    }
    Ok(())
}

fn report(name: &str, steps: &[Step]) {
    let mean = |of: fn(&Cost) -> f64| {
        let sum = |pick: fn(&Step) -> &Cost| steps.iter().map(|s| of(pick(s))).sum::<f64>() / steps.len() as f64;
        (sum(|s| &s.cold), sum(|s| &s.warm))
    };
    print!("{name:28}");
    type Figure = (&'static str, fn(&Cost) -> f64);
    let figures: [Figure; 4] = [
        ("iterations", |c| c.iterations as f64),
        ("bricks", |c| c.bricks_active as f64),
        ("Mvoxels", |c| c.voxel_updates as f64 * 1e-6),
        ("ms", |c| c.seconds * 1e3),
    ];
    for (what, of) in figures {
        let (cold, warm) = mean(of);
        if cold > 0.0 {
            print!("  {what} {cold:.1} → {warm:.1} ({:.2})", warm / cold);
        }
    }
    let most = |of: fn(&Step) -> f64| steps.iter().map(of).fold(0.0, f64::max);
    let losses = steps.iter().filter(|s| s.warm.voxel_updates > s.cold.voxel_updates).count();
    println!(
        "  error {:.1e} certified {:.1e}, {losses} of {} steps lost",
        most(|s| s.warm.true_error),
        most(|s| s.warm.certified_error),
        steps.len()
    );
}

/// Steps made of smoke.h5.
struct Smoke {
    series: Box<dyn Series>,
    /// In steps of the file.
    times: Vec<f64>,
    /// Where it changes; elsewhere it stays as at the first time.
    changes: Option<Region>,
}

impl Smoke {
    /// `every` steps for each of the file, linear in between. `part`: only 2 % of the volume change, a cube where the smoke is
    /// densest half way.
    fn new(every: usize, part: bool) -> Result<Self> {
        let smoke = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/smoke.h5");
        let series = source::open(&SourceSpec { series: vec![smoke.into()], ..Default::default() })?;
        let all = series.info().steps.len();
        let first = if every == 1 && !part { 0 } else { all / 2 };
        let count = if every == 1 && !part { all } else { 24 };
        let times =
            (0..count).map(|n| first as f64 + n as f64 / every as f64).filter(|t| *t <= (all - 1) as f64).collect();
        let mut this = Smoke { series, times, changes: None };
        if part {
            let grid = this.series.timestep(first)?.grid;
            let values = this.at(first as f64, &grid)?;
            let edge = ((0.02 * grid.len() as f64).cbrt()).round() as usize;
            let cubes = (0..grid.size[2] - edge).step_by(8).flat_map(|z| {
                (0..grid.size[1] - edge)
                    .step_by(8)
                    .flat_map(move |y| (0..grid.size[0] - edge).step_by(8).map(move |x| [x, y, z]))
            });
            let mass = |start: &[usize; 3]| -> f32 {
                let region = Region { start: *start, size: [edge; 3] };
                inside(&region).map(|p| values[grid.index(p)]).filter(|v| v.is_finite()).sum()
            };
            let start = cubes.max_by(|a, b| mass(a).total_cmp(&mass(b))).expect("cubes");
            this.changes = Some(Region { start, size: [edge; 3] });
        }
        Ok(this)
    }

    fn at(&self, time: f64, grid: &Grid) -> Result<Vec<f32>> {
        let read = |step: usize| {
            let mut values = vec![0.0; grid.len()];
            self.series.timestep(step)?.field.read(grid.region(), &mut values)?;
            Ok::<_, gloaming::Error>(values)
        };
        let mut values = read(time as usize)?;
        let t = time.fract() as f32;
        if t > 0.0 {
            let next = read(time as usize + 1)?;
            values.iter_mut().zip(next).for_each(|(v, n)| *v += t * (n - *v));
        }
        Ok(values)
    }
}

fn inside(region: &Region) -> impl Iterator<Item = [usize; 3]> {
    let (start, end) = (region.start, region.end());
    (start[2]..end[2])
        .flat_map(move |z| (start[1]..end[1]).flat_map(move |y| (start[0]..end[0]).map(move |x| [x, y, z])))
}

impl Series for Smoke {
    fn info(&self) -> &SeriesInfo {
        self.series.info()
    }

    fn timestep(&self, index: usize) -> Result<Timestep> {
        let grid = self.series.timestep(0)?.grid;
        let mut values = self.at(self.times[index], &grid)?;
        if let Some(region) = &self.changes {
            let mut still = self.at(self.times[0], &grid)?;
            inside(region).map(|p| grid.index(p)).for_each(|i| still[i] = values[i]);
            values = still;
        }
        let field = Arc::new(Dense::new(grid.size, values));
        Ok(Timestep { step: index as u64, time: Some(self.times[index]), grid, field })
    }
}
