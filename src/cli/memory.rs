//! How much memory a run takes.

use gloaming::lights::{self, Light};
use gloaming::scene::{DiffusionMethod, Falloff, Model, Scene, SolverKeys};
use gloaming::{Grid, Result};

/// Steps that are in memory at once: being read, waiting, being lit, and as handed to the device.
const STEPS: u64 = 5;

/// Bytes that lighting data on `grid` takes at most, every step in memory as a whole.
pub fn working_set(scene: &Scene, grid: &Grid) -> Result<u64> {
    let lights = lights::resolve(scene)?;
    let light = match scene.light.model {
        Model::Physical => physical(scene, grid, &lights),
        Model::Paper => paper(scene, grid, &lights),
    };
    let frame = scene.render.size.iter().map(|n| *n as u64).product::<u64>();
    let frames = STEPS * 4 * frame * scene.cameras.len().max(1) as u64;
    Ok(4 * (STEPS * grid.len() as u64 + light + frames))
}

/// Voxels of the light grid that a resolution key asks for.
fn voxels(key: f64, grid: &Grid) -> u64 {
    SolverKeys::grid_size(key, grid.size).into_iter().map(|n| n as u64).product()
}

/// Values that the physical model holds.
fn physical(scene: &Scene, grid: &Grid, lights: &[Light]) -> u64 {
    let distant = lights.iter().filter(|l| matches!(l, Light::Distant { .. })).count() as u64;
    // Extinction now and before, and the light of each source.
    let direct = voxels(scene.light.direct_resolution, grid) * (2 + distant);
    // For each channel: scattering, emission, source, fluence now and before, and where scattering is anisotropic the
    // current now and before with its part in the source; then extinction, and the light of each source.
    let anisotropic = scene.transfer.anisotropy != 0.0;
    let scattered = voxels(scene.light.resolution, grid) * (3 * if anisotropic { 14 } else { 5 } + 1 + distant);
    direct + scattered
}

/// Values that the paper's model holds.
fn paper(scene: &Scene, grid: &Grid, lights: &[Light]) -> u64 {
    let convected = lights.iter().filter(|l| !matches!(l, Light::Environment { .. })).count() as u64;
    let physical = scene.light.falloff == Falloff::Physical;
    let spread = lights.iter().filter(|l| match l {
        Light::Cone { .. } => true,
        Light::Point { .. } => physical,
        _ => false,
    });
    // Right-hand side, residual and values; coarser grids add a seventh of them.
    let implicit = match scene.light.diffusion {
        DiffusionMethod::Exact => 0,
        DiffusionMethod::GaussSeidel => 3,
        DiffusionMethod::Multigrid => 4,
    };
    // Extinction now and before, ρ of each light with the other half of its iterations, the composed channels, the
    // volume of an environment, and for point and cone lights what reaches a voxel.
    voxels(scene.light.resolution, grid) * (2 + 2 * convected + 3 + 1 + spread.count() as u64 + implicit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_working_set_grows_with_data_lights_and_resolution() {
        let with = |sets: &[&str], size: usize| {
            let sets: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
            working_set(&Scene::load(None, &sets).unwrap(), &Grid::new([size; 3])).unwrap()
        };
        let plain = with(&[], 128);
        assert!(plain > 4 * 128u64.pow(3) * 5);
        assert!((7..=8).contains(&(with(&["render.size=[1,1]"], 256) / with(&["render.size=[1,1]"], 128))));
        assert!(with(&["lights.0.softness=3"], 128) > plain);
        let paper = with(&["light.model=paper"], 128);
        assert!(
            with(&["light.model=paper", "lights.3.kind=point"], 128)
                > with(&["light.model=paper", "lights.2.color=[1,1,1]"], 128)
        );
        assert!(
            paper > 4 * 128u64.pow(3) * 5 && with(&["light.model=paper", "light.diffusion=multigrid"], 128) > paper
        );
        assert!(with(&["light.resolution=1"], 128) > plain && with(&["transfer.anisotropy=0.5"], 128) > plain);
    }
}
