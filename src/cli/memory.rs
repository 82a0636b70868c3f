//! How much memory a run takes.

use gloaming::lights::{self, Light};
use gloaming::scene::{Scene, SolverKeys};
use gloaming::{Grid, Result};

/// Steps that are in memory at once: being read, waiting, being lit, and as handed to the device.
const STEPS: u64 = 5;

/// Bytes that lighting data on `grid` takes at most, every step in memory as a whole.
pub fn working_set(scene: &Scene, grid: &Grid) -> Result<u64> {
    let size = |key: f64| SolverKeys::grid_size(key, grid.size).into_iter().map(|n| n as u64).product::<u64>();
    let (data, direct, scattered) =
        (grid.len() as u64, size(scene.light.direct_resolution), size(scene.light.resolution));
    let distant = lights::resolve(scene)?.iter().filter(|l| matches!(l, Light::Distant { .. })).count() as u64;
    // Extinction now and before, and the light of each source.
    let direct = direct * (2 + distant);
    // For each channel: scattering, emission, source, fluence now and before, and where scattering is anisotropic the
    // current now and before with its part in the source; then extinction, and the light of each source.
    let anisotropic = scene.transfer.anisotropy != 0.0;
    let scattered = scattered * (3 * if anisotropic { 14 } else { 5 } + 1 + distant);
    let frame = scene.render.size.iter().map(|n| *n as u64).product::<u64>();
    let frames = STEPS * 4 * frame * scene.cameras.len().max(1) as u64;
    Ok(4 * (STEPS * data + direct + scattered + frames))
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
        assert!(with(&["light.resolution=1"], 128) > plain && with(&["transfer.anisotropy=0.5"], 128) > plain);
    }
}
