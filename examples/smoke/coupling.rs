//! The output loop: every step goes into a file, as before, and to gloaming, which lights it on threads of its own while
//! the simulation computes the next one.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result};
use gloaming::Grid;
use gloaming::field::{Dense, Timestep};
use gloaming::insitu::{InSitu, Stats};
use gloaming::scene::Scene;

use super::simulation::{Smoke, series::Series};

/// What is shown, lit how, seen from where.
const SCENE: &str = include_str!("scene.toml");

/// The scene that the demo shows.
pub fn scene() -> gloaming::Result<Scene> {
    Scene::parse(SCENE, "scene.toml", &[])
}

/// Runs the simulation for `steps` steps and leaves a movie, frames, the illuminated volume, the ledger and the
/// simulation's own series in `out`. `each` is told the number of steps done.
pub fn run(out: &Path, size: usize, steps: usize, mut each: impl FnMut(usize)) -> Result<Stats> {
    std::fs::create_dir_all(out).with_context(|| format!("cannot create {}", out.display()))?;
    let outputs =
        ["movie.mp4", "frames/frame_{step:06}.png", "light.vtkhdf"].map(|o| out.join(o).display().to_string());

    let mut smoke = Smoke::new(size);
    let spacing = smoke.spacing();
    let grid = Grid { size: smoke.size(), spacing: [spacing; 3], origin: [0.5 * spacing; 3] };
    let mut series = Series::create(&out.join("series.h5"), smoke.size(), spacing)?;

    let mut scene = scene()?;
    scene.field.name = Some("density".into());
    scene.insitu.outputs = outputs.into();
    scene.insitu.ledger = Some(out.join("ledger.csv"));
    scene.insitu.device = "cpu".into();
    let lit = InSitu::with(scene).open()?;

    for step in 0..steps {
        smoke.step();
        let density = smoke.density();
        series.append(smoke.time(), &density)?;
        let field = Arc::new(Dense::new(smoke.size(), density));
        lit.push_owned(Timestep { step: step as u64, time: Some(smoke.time()), grid, field })?;
        each(step + 1);
    }
    Ok(lit.close()?)
}
