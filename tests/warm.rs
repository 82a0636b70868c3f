//! Warm starts (validation.md 17): bitwise the cold result at tolerance 0, within the certified bound otherwise.

use std::sync::Arc;

use glam::{DVec3, Vec3};
use gloaming::device::cpu::Cpu;
use gloaming::device::{Buffer, Device};
use gloaming::field::{Dense, Timestep};
use gloaming::light::{Direct, LightSolver, LightVolume, Rays};
use gloaming::lights;
use gloaming::medium::Medium;
use gloaming::scene::Scene;
use gloaming::transfer::TransferFunction;
use gloaming::{BrickLayout, Grid};

/// Extinction of blobs that drift, with structure in some bricks only.
fn medium(grid: &Grid, t: f32) -> Vec<f32> {
    let n = grid.size.map(|n| n as f32);
    let blobs = [
        (Vec3::new(0.3 + 0.002 * t, 0.4, 0.7), 0.10, 0.4),
        (Vec3::new(0.7, 0.5 - 0.001 * t, 0.4 + 0.0015 * t), 0.15, 0.2),
        (Vec3::new(0.2, 0.8, 0.2), 0.08, 0.5),
    ];
    let mut sigma = vec![0.0; grid.len()];
    for k in 0..grid.size[2] {
        for j in 0..grid.size[1] {
            for i in 0..grid.size[0] {
                let p = Vec3::new(i as f32 / n[0], j as f32 / n[1], k as f32 / n[2]);
                let density: f32 = blobs.iter().map(|(c, r, s)| s * (1.0 - (p - *c).length() / r).max(0.0)).sum();
                sigma[grid.index([i, j, k])] = density;
            }
        }
    }
    sigma
}

struct Series {
    cpu: Cpu,
    grid: Grid,
    layout: BrickLayout,
    now: Buffer,
    before: Buffer,
}

impl Series {
    fn new(edge: usize) -> Self {
        let cpu = Cpu::new(2).unwrap();
        let grid = Grid { size: [45, 40, 51], spacing: [1.0, 1.1, 0.9], origin: [0.0; 3] };
        let (now, before) = (cpu.alloc(grid.len()).unwrap(), cpu.alloc(grid.len()).unwrap());
        Series { layout: BrickLayout::new(grid.size, edge), cpu, grid, now, before }
    }

    fn set(&mut self, sigma: &[f32]) -> Vec<[f32; 3]> {
        std::mem::swap(&mut self.now, &mut self.before);
        self.cpu.upload(sigma, &mut self.now).unwrap();
        self.cpu.change(&self.layout, &self.now, &self.before).unwrap()
    }

    fn direct(&self, light: Light) -> Direct {
        let rays = match light {
            Light::Along(u) => Rays::parallel(&self.grid, Vec3::from(u).normalize(), false, 1.0),
            Light::From(at) => {
                let (lo, hi) = self.grid.bounds();
                Rays::radial(&self.grid, lo + DVec3::from(at) * (hi - lo), 1.0)
            }
        };
        Direct::of(self.cpu.alloc(self.grid.len()).unwrap(), &self.layout, rays)
    }

    fn solve(
        &self,
        light: &mut Direct,
        change: Option<&[[f32; 3]]>,
        tolerance: f32,
    ) -> (gloaming::light::DirectReport, Vec<f32>) {
        let report = light.solve(&self.cpu, &self.grid, &self.layout, &self.now, change, tolerance).unwrap();
        let mut rho = vec![0.0; self.grid.len()];
        self.cpu.download(&light.rho, &mut rho).unwrap();
        (report, rho)
    }
}

#[derive(Debug, Clone, Copy)]
enum Light {
    Along([f32; 3]),
    /// In the unit cube that the volume fills.
    From([f64; 3]),
}

/// The point lights: in a blob, in the middle of the box (beside brick corners), at a face, outside.
const LIGHTS: [Light; 8] = [
    Light::Along([0.3, 0.5, -0.8]),
    Light::Along([-1.0, 0.1, 0.2]),
    Light::Along([0.0, 0.0, 1.0]),
    Light::Along([0.4, -0.9, 0.1]),
    Light::From([0.31, 0.42, 0.7]),
    Light::From([24.0 / 45.0, 0.4, 32.0 / 51.0]),
    Light::From([0.6, 0.999, 0.3]),
    Light::From([-0.4, 0.7, 0.2]),
];

#[test]
fn tolerance_zero_is_cold_to_the_bit() {
    for edge in [8, 16] {
        let mut series = Series::new(edge);
        let mut kept: Vec<Direct> = LIGHTS.iter().map(|light| series.direct(*light)).collect();
        let mut skipped = 0;
        for step in 0..12 {
            let sigma = medium(&series.grid, step as f32);
            let change = series.set(&sigma);
            for (light, of) in kept.iter_mut().zip(LIGHTS) {
                let (report, warm) = series.solve(light, (step > 0).then_some(&change), 0.0);
                let (_, cold) = series.solve(&mut series.direct(of), None, 0.0);
                assert!(warm.iter().zip(&cold).all(|(w, c)| w.to_bits() == c.to_bits()), "step {step}, light {of:?}");
                assert_eq!(report.certified_error, 0.0);
                skipped += report.bricks_total - report.bricks_active;
            }
        }
        assert!(skipped > 0, "nothing was ever skipped with bricks of {edge}");
    }
}

/// 120 drifting steps with a jump of the transfer function (σ doubled) and holes that come and go.
#[test]
fn the_certificate_holds_over_a_long_drift() {
    for tolerance in [1e-2, 1e-3, 1e-4] {
        let mut series = Series::new(8);
        let mut kept: Vec<Direct> = LIGHTS.iter().map(|light| series.direct(*light)).collect();
        // Of distant and of point lights.
        let mut swept = [(0, 0); 2];
        for step in 0..120 {
            let mut sigma = medium(&series.grid, 0.02 * step as f32);
            if step >= 50 {
                sigma.iter_mut().for_each(|s| *s *= 2.0);
            }
            if step % 40 == 39 {
                sigma[series.grid.len() / 2..series.grid.len() / 2 + 400].fill(0.0);
            }
            let change = series.set(&sigma);
            for (light, of) in kept.iter_mut().zip(LIGHTS) {
                let (report, warm) = series.solve(light, (step > 0).then_some(&change), tolerance);
                if step > 0 {
                    let (active, total) = &mut swept[usize::from(matches!(of, Light::From(_)))];
                    (*active, *total) = (*active + report.bricks_active, *total + report.bricks_total);
                }
                assert!(report.certified_error <= tolerance, "step {step}: certified only {}", report.certified_error);
                // A cold solve to compare with costs more than all else; errors last until the next sweep.
                if step % 3 != 0 {
                    continue;
                }
                let (_, cold) = series.solve(&mut series.direct(of), None, tolerance);
                let error = warm.iter().zip(&cold).map(|(w, c)| (w - c).abs()).fold(0.0, f32::max);
                assert!(
                    error <= report.certified_error,
                    "step {step}: off by {error}, certified {}",
                    report.certified_error
                );
            }
        }
        println!("tolerance {tolerance}: swept {swept:?} bricks");
        let share = swept.map(|(active, total)| active as f64 / total as f64);
        // Bounds of the depth along rays that fan out are wider.
        assert!(share[0] < 0.5 && share[1] < 0.8, "tolerance {tolerance}: swept {swept:?}");
    }
}

/// All light over 110 drifting steps (validation.md 17): the transfer function's range jumps, a light turns, grows and goes out,
/// blocks of NaN come and go, steps repeat. Each step's fluence is held against a tight solve from nothing.
#[test]
fn certified_errors_bound_true_errors_of_all_light() {
    let cpu = Cpu::new(2).unwrap();
    let grid = Grid { size: [22, 20, 24], spacing: [1.0, 1.1, 0.9], origin: [0.0; 3] };
    for sets in [
        &["light.tolerance=1e-2"][..],
        &["light.tolerance=1e-3", "transfer.anisotropy=0.5"],
        &["light.tolerance=1e-2", "light.scattering=false"],
    ] {
        let common = ["transfer.albedo=0.9", "transfer.colormap=white", "light.directions=8"];
        let scene = |more: &[&str]| {
            let sets: Vec<String> = common.iter().chain(sets).chain(more).map(|s| s.to_string()).collect();
            Scene::load(None, &sets).unwrap()
        };
        let (kept, tight) = (scene(&[]), scene(&["light.tolerance=1e-6", "light.warm=false"]));
        let transfer = TransferFunction::new(&kept.transfer).unwrap();
        let mut medium_now = Medium::new(&cpu, grid, transfer.table([0.0, 1.0], 1.0)).unwrap();
        medium_now.remember(&cpu).unwrap();
        let mut warm = (LightSolver::new(&cpu, &kept, &grid).unwrap(), LightVolume::default());
        let mut cold = (LightSolver::new(&cpu, &tight, &grid).unwrap(), LightVolume::default());
        let (mut warm_steps, mut worst) = (0, 0.0f64);
        for step in 0..110usize {
            // Every tenth step is the one before once more.
            let t = if step % 10 == 9 { step - 1 } else { step };
            let mut values = medium(&grid, 0.05 * t as f32);
            if t % 25 == 20 {
                let at = grid.len() / 3;
                values[at..at + 300].fill(f32::NAN);
            }
            let range = if (40..60).contains(&t) { [0.0, 0.4] } else { [0.0, 0.6] };
            let direction = if t < 70 { Vec3::new(0.3, 0.5, -0.8) } else { Vec3::new(-0.6, 0.2, -0.5) };
            let irradiance = if t < 85 { [1.0; 3] } else { [2.5; 3] };
            let mut lights = vec![lights::Light::Distant { direction: direction.normalize(), irradiance }];
            if t < 95 {
                lights.push(lights::Light::Distant { direction: Vec3::Y, irradiance: [0.4; 3] });
            }
            let field = Arc::new(Dense::new(grid.size, values));
            medium_now.take(&cpu, &Timestep { step: step as u64, time: None, grid, field }).unwrap();
            medium_now.classify(transfer.table(range, 1.0));
            let report = warm.0.solve(&cpu, &medium_now, &lights, &mut warm.1).unwrap();
            cold.0.solve(&cpu, &medium_now, &lights, &mut cold.1).unwrap();
            let got = warm.0.illuminated(&cpu, &warm.1).unwrap().fluence;
            let want = cold.0.illuminated(&cpu, &cold.1).unwrap().fluence;
            let largest = want.iter().flatten().fold(0.0f32, |m, v| m.max(*v));
            let off = got.iter().flatten().zip(want.iter().flatten()).map(|(g, w)| (g - w).abs()).fold(0.0, f32::max);
            let error = f64::from(off / largest);
            assert!(got.iter().flatten().all(|v| v.is_finite()), "step {step}");
            // The tight solve's own error, and rounding.
            assert!(error <= report.certified_error + 3e-6, "{sets:?}, step {step}: {error}, {report:?}");
            assert!(report.certified_error <= f64::from(kept.light.tolerance), "{sets:?}, step {step}: {report:?}");
            warm_steps += usize::from(report.warm);
            worst = worst.max(error);
        }
        assert_eq!(warm_steps, 109);
        println!("{sets:?}: largest true error {worst:.1e}");
    }
}

/// `light.passes` and `light.budget_ms`: a step that stands still goes on with what was left, until nothing is, and then costs a look.
#[test]
fn what_a_budget_leaves_is_carried_to_the_next_step() {
    let cpu = Cpu::new(2).unwrap();
    let grid = Grid { size: [22, 20, 24], spacing: [1.0; 3], origin: [0.0; 3] };
    for (sets, once) in [("light.passes=3", false), ("light.budget_ms=1e-3", false), ("light.budget_ms=1e5", true)] {
        let sets = ["transfer.albedo=0.95", "transfer.colormap=white", "light.directions=8", sets].map(String::from);
        let scene = Scene::load(None, &sets).unwrap();
        let transfer = TransferFunction::new(&scene.transfer).unwrap();
        let mut medium_now = Medium::new(&cpu, grid, transfer.table([0.0, 0.6], 1.0)).unwrap();
        medium_now.remember(&cpu).unwrap();
        let (mut solver, mut light) = (LightSolver::new(&cpu, &scene, &grid).unwrap(), LightVolume::default());
        let lights = lights::resolve(&scene).unwrap();
        let mut reports = vec![];
        for step in 0..80 {
            let field = Arc::new(Dense::new(grid.size, medium(&grid, 0.0)));
            medium_now.take(&cpu, &Timestep { step, time: None, grid, field }).unwrap();
            medium_now.classify(transfer.table([0.0, 0.6], 1.0));
            let report = solver.solve(&cpu, &medium_now, &lights, &mut light).unwrap();
            assert_eq!(report.converged, report.certified_error <= 1e-3, "{report:?}");
            assert!(!sets[3].contains("passes") || report.iterations <= 3, "{report:?}");
            let rests = report.iterations == 0;
            reports.push(report);
            if rests {
                break;
            }
        }
        let (last, first) = (reports.last().unwrap(), &reports[0]);
        assert!(last.iterations == 0 && last.converged, "{sets:?}: {last:?}");
        assert_eq!(first.converged, once, "{sets:?}: {first:?}");
        assert_eq!(reports.len() == 2, once, "{sets:?}: {} steps", reports.len());
    }
}
