//! What the warm start saves: the measurement itself is honest.

use std::sync::Arc;

use gloaming::device::cpu::Cpu;
use gloaming::field::{Dense, Timestep};
use gloaming::savings::{self, Savings};
use gloaming::scene::Scene;
use gloaming::source::{self, Series, SeriesInfo, SourceSpec};
use gloaming::{Grid, Result};

/// Steps in memory.
struct Made {
    info: SeriesInfo,
    grid: Grid,
    steps: Vec<Vec<f32>>,
}

impl Made {
    /// A ball in one corner that grows a little each step, or not at all.
    fn ball(steps: usize, growth: f32) -> Self {
        let smoke = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/smoke.h5");
        let info =
            source::open(&SourceSpec { series: vec![smoke.into()], ..Default::default() }).unwrap().info().clone();
        let grid = Grid::new([64, 64, 64]);
        let ball = |step: usize| {
            let radius = 9.0 + growth * step as f32;
            (0..grid.len())
                .map(|i| {
                    let p = [i % 64, i / 64 % 64, i / 4096].map(|v| v as f32 - 12.0);
                    (radius - (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]).sqrt()).clamp(0.0, 1.0)
                })
                .collect()
        };
        Made { info, grid, steps: (0..steps).map(ball).collect() }
    }
}

impl Series for Made {
    fn info(&self) -> &SeriesInfo {
        &self.info
    }

    fn timestep(&self, index: usize) -> Result<Timestep> {
        let field = Arc::new(Dense::new(self.grid.size, self.steps[index].clone()));
        Ok(Timestep { step: index as u64, time: None, grid: self.grid, field })
    }
}

fn measure(series: &Made, sets: &[&str]) -> Savings {
    let sets: Vec<String> = sets.iter().chain(&["light.directions=8"]).map(|s| s.to_string()).collect();
    let scene = Scene::load(None, &sets).unwrap();
    let indices: Vec<usize> = (0..series.steps.len()).collect();
    savings::measure(&Cpu::new(2).unwrap(), series, &indices, &scene, [0.0, 1.0], &mut |_| ()).unwrap()
}

#[test]
fn totals_are_sums_and_errors_are_certified() {
    let found = measure(&Made::ball(4, 0.3), &[]);
    assert_eq!(found.steps.len(), 4);
    assert_eq!(found.warm.voxel_updates, found.steps.iter().map(|s| s.warm.voxel_updates).sum::<u64>());
    assert_eq!(found.cold.iterations, found.steps.iter().map(|s| s.cold.iterations).sum::<u64>());
    for s in &found.steps {
        assert!(s.warm.true_error <= s.warm.certified_error + f64::from(found.tight_tolerance), "{s:?}");
        assert!(s.cold.true_error <= s.cold.certified_error + f64::from(found.tight_tolerance), "{s:?}");
        assert!(s.warm.certified_error <= f64::from(found.tolerance), "{s:?}");
    }
    let first = &found.steps[0];
    assert_eq!(
        (first.warm.sweeps, first.warm.iterations),
        (first.cold.sweeps, first.cold.iterations),
        "step 0 has no past"
    );
}

/// What does not change costs only the look for change: one pass for direct light.
#[test]
fn a_still_series_costs_one_pass_of_looking() {
    let found = measure(&Made::ball(3, 0.0), &["light.scattering=false", "lights.0.kind=distant"]);
    for s in &found.steps[1..] {
        assert_eq!((s.warm.bricks_active, s.warm.voxel_updates), (0, 64 * 64 * 64), "{s:?}");
        assert_eq!(s.warm.true_error, s.cold.true_error);
    }
}

/// With all light too, whatever the transfer function: the scattered light of a medium that does not change is kept.
#[test]
fn scattered_light_of_a_still_series_is_kept() {
    for colours in ["transfer.colormap=white", "transfer.colormap=inferno"] {
        let found = measure(&Made::ball(3, 0.0), &[colours, "lights.0.kind=distant", "lights.1.kind=environment"]);
        for s in &found.steps[1..] {
            assert_eq!((s.warm.bricks_active, s.warm.iterations), (0, 0), "{s:?}");
            assert!(s.warm.voxel_updates <= 2 * 64 * 64 * 64, "{s:?}");
            assert_eq!(s.warm.certified_error, found.steps[0].warm.certified_error);
            assert!(s.warm.true_error <= s.warm.certified_error + f64::from(found.tight_tolerance), "{s:?}");
        }
    }
}

/// A corner of the box changes: bricks that its light does not reach are left alone, and no result differs at tolerance 0.
#[test]
fn a_change_in_a_corner_is_cheaper_than_the_box_and_exact_at_tolerance_zero() {
    let lights = "lights.0.direction=[-0.4, -0.5, -0.8]";
    let found = measure(&Made::ball(4, 0.2), &["light.scattering=false", "light.tolerance=0", lights]);
    for s in &found.steps[1..] {
        assert!(s.warm.bricks_active < s.cold.bricks_active, "{s:?}");
        assert_eq!(s.warm.true_error, s.cold.true_error);
    }
    assert!(found.ratio.bricks_active > 1.5, "{:?}", found.ratio);
}

/// The paper's model goes to the same certified tolerance either way, whatever the scene's iterations.
#[test]
fn the_papers_model_is_measured_too() {
    for method in ["layers", "ordered"] {
        let method = format!("light.convection={method}");
        let found = measure(&Made::ball(3, 0.2), &["light.model=paper", "light.iterations=1", &method]);
        for s in &found.steps {
            assert!(s.warm.true_error <= s.warm.certified_error + f64::from(found.tight_tolerance), "{s:?}");
            assert!(s.warm.certified_error <= f64::from(found.tolerance), "{s:?}");
            assert!(s.cold.certified_error <= f64::from(found.tolerance), "{s:?}");
        }
        let still = measure(&Made::ball(2, 0.0), &["light.model=paper", &method]);
        assert_eq!(still.steps[1].warm.voxel_updates, 32 * 32 * 32, "one look for change");
    }
}

#[test]
fn the_report_needs_no_other_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("report.html");
    let found = measure(&Made::ball(3, 0.3), &[]);
    let direct = measure(&Made::ball(3, 0.3), &["light.scattering=false"]);
    savings::write_html(&[found.clone(), direct], &path).unwrap();
    let html = std::fs::read_to_string(&path).unwrap();
    assert_eq!(html.matches("<svg").count(), 10, "one plot each");
    assert!(html.contains("<h2>The physical model") && html.contains("<h2>Direct light alone"), "sections have names");
    assert!(!html.contains("src=") && !html.contains("href="), "refers to another file");
    assert!(html.contains(&format!("{:.6}", found.warm.sweeps)), "the figures stand in the table");
    let json: serde_json::Value = serde_json::from_str(&serde_json::to_string(&found).unwrap()).unwrap();
    for key in
        ["iterations", "sweeps", "voxel_updates", "bricks_active", "seconds", "certified_error", "true_error", "bytes"]
    {
        assert!(json["warm"][key].is_number() && json["steps"][0]["cold"][key].is_number(), "{key}");
    }
}
