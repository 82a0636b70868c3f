//! How much memory a run takes and may take, and the device that keeps to it.

use std::path::Path;
use std::sync::Arc;

use crate::detail::Detail;
use crate::device::Device;
use crate::device::paged::Paged;
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::light::ordinates::Scattered;
use crate::lights::{self, Light};
use crate::preview;
use crate::scene::{DiffusionMethod, Falloff, Model, Scene, Shading, SolverKeys};
use crate::source;
use crate::transfer::TransferFunction;

/// Steps that are in memory at once: being read, waiting, being lit, as handed to the device, and the one before.
const STEPS: u64 = 6;

/// What lighting takes. Sizes are along x, y, z.
struct Needs {
    data: [u64; 3],
    /// A volume of direct light that may be paged, and how many there are beside extinction now and before.
    direct: ([u64; 3], u64),
    /// A volume of scattered light, or of the paper's model, and how many there are.
    solved: ([u64; 3], u64),
    /// Some light is in one place.
    lamps: bool,
    /// What is solved slab by slab; else all of it must be in memory.
    scattering: Option<Scattering>,
    /// Values of all pictures of a step.
    frames: u64,
}

/// What a pass of scattered light takes.
struct Scattering {
    /// Ordinates that cross planes one way.
    ordinates: u64,
    /// First-collision light, emission.
    given: u64,
    /// Components of a current: 3 where scattering is anisotropic.
    current: u64,
    channels: u64,
}

impl Needs {
    fn new(scene: &Scene, grid: &Grid) -> Result<Self> {
        let grid = &Detail::grid(&scene.noise, grid);
        let size = |key: f64| SolverKeys::grid_size(key, grid.size).map(|n| n as u64);
        let lights = lights::resolve(scene)?;
        let channels = if gray(scene, &lights)? { 1 } else { 3 };
        let (direct, solved) = match scene.light.model {
            Model::Physical => physical(scene, &lights, channels),
            Model::Paper => (0, paper(scene, &lights)),
        };
        let pixels = scene.render.size.iter().map(|n| *n as u64).product::<u64>();
        let direct_size = match scene.light.model {
            Model::Physical => size(scene.light.direct_resolution),
            Model::Paper => [0; 3],
        };
        Ok(Needs {
            data: grid.size.map(|n| n as u64),
            direct: (direct_size, direct),
            lamps: scene.light.model == Model::Physical && lamps(&lights),
            scattering: (scene.light.model == Model::Physical).then(|| Scattering {
                ordinates: scene.light.directions as u64 / 2,
                given: direct + u64::from(!scene.transfer.emission.is_empty()),
                current: if scene.transfer.anisotropy != 0.0 { 3 } else { 0 },
                channels: channels as u64,
            }),
            solved: (size(scene.light.resolution), solved),
            frames: STEPS * 4 * pixels * scene.cameras.len().max(1) as u64,
        })
    }
}

/// Volumes of direct and of scattered light in the physical model.
fn physical(scene: &Scene, lights: &[Light], channels: usize) -> (u64, u64) {
    let mut factors = scene.transfer.chromatic.map(f32::to_bits).to_vec();
    factors.sort_unstable();
    factors.dedup();
    let all_around = |l: &Light| matches!(l, Light::Environment { .. } | Light::Image { .. });
    let sources = (lights.iter().filter(|l| !all_around(l)).count() * factors.len()) as u64;
    // A lamp's light once more with its falloff.
    // Opaque things and the medium with them.
    let opaque = if scene.meshes.is_empty() { 0 } else { 2 };
    let direct = sources + u64::from(lamps(lights)) + opaque;
    if !scene.light.scattering && !lights.iter().any(all_around) {
        return (direct, 0);
    }
    let glows = !scene.transfer.emission.is_empty();
    let scattered = Scattered::volumes(channels, sources as usize, glows, scene.transfer.anisotropy) as u64;
    (direct, scattered + opaque)
}

/// True where a light is in one place.
fn lamps(lights: &[Light]) -> bool {
    lights.iter().any(|l| matches!(l, Light::Point { .. } | Light::Cone { .. } | Light::Patch { .. }))
}

/// Volumes of the paper's model.
fn paper(scene: &Scene, lights: &[Light]) -> u64 {
    let convected =
        lights.iter().filter(|l| !matches!(l, Light::Environment { .. } | Light::Image { .. })).count() as u64;
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
    2 + 2 * convected + 3 + 1 + spread.count() as u64 + implicit
}

fn values(size: [u64; 3]) -> u64 {
    size.into_iter().product()
}

/// True when one colour channel of scattered light stands for all.
fn gray(scene: &Scene, lights: &[Light]) -> Result<bool> {
    let table = TransferFunction::new(&scene.transfer)?.table([0.0, 1.0], 1.0);
    let even = |c: &[f32; 3]| c[0] == c[1] && c[1] == c[2];
    let light = |l: &Light| match l {
        Light::Distant { irradiance, .. } => even(irradiance),
        Light::Environment { radiance } => even(radiance),
        Light::Point { intensity, .. } | Light::Cone { intensity, .. } | Light::Patch { intensity, .. } => {
            even(intensity)
        }
        Light::Image { .. } => false,
    };
    Ok(table.gray() && table.emission.iter().all(even) && lights.iter().all(light))
}

/// Bytes that lighting data on `grid` takes at most, every step in memory as a whole.
pub fn working_set(scene: &Scene, grid: &Grid) -> Result<u64> {
    let Needs { data, direct, solved, frames, .. } = Needs::new(scene, grid)?;
    // Extinction now and before, and the light of each source.
    let direct = values(direct.0) * (2 + direct.1);
    let gradient = if scene.transfer.two_dimensional() { values(data) } else { 0 };
    Ok(4 * (STEPS * values(data) + gradient + direct + values(solved.0) * solved.1 + frames))
}

/// The least budget that leaves `lighting` bytes beside what sources keep [`decoded`](source::decoded).
pub fn with_decoded(lighting: u64) -> u64 {
    lighting + source::DECODED.min(lighting.div_ceil(3))
}

/// The least budget, in bytes, within which data on `grid` can be lit, its volumes a slab at a time.
pub fn smallest(scene: &Scene, grid: &Grid) -> Result<u64> {
    let Needs { data, direct: (light, lights), solved: (coarse, volumes), lamps, scattering, .. } =
        Needs::new(scene, grid)?;
    // As the paged device counts: a slab of one plane, and what it shares with its neighbours.
    let per = |size: [u64; 3], planes: u64| values(size).div_ceil(planes.max(1));
    let plane = |size: [u64; 3]| size[0] * size[1];
    let extinction = 2 * per(data, light[2]) + plane(light);
    let sweep = 2 * (extinction + plane(light)) + plane(light) * lights.max(1);
    // A layer of bricks of the least edge, or one more where such would end at the light's plane, and two planes on both sides.
    let outward = (light[2].min(9) + 4) * (extinction + plane(light)) + 2 * plane(light);
    let shade = if scene.render.shading == Shading::Phong { 2 } else { 0 };
    let [w, h] = scene.render.size.map(|n| n as u64);
    let cells = (data[2] - 1).max(1);
    // Of the paper's model one volume for each colour.
    let shown = scattering.as_ref().map_or(3, |s| s.channels * (1 + s.current)).min(volumes);
    let terms = per(light, cells) * lights + per(coarse, cells) * shown;
    let march = (4 + shade) * 2 * (per(data, cells) + terms) + 8 * w * h;
    let below = per(data, coarse[2]).max(per(light, coarse[2]));
    let coarser = 2 * below + 2 * plane(coarse) + 4 * plane(data).max(plane(light));
    let mut least = march;
    if lights > 0 {
        least = least.max(sweep);
    }
    if lamps {
        least = least.max(outward);
    }
    if volumes > 0 {
        least = least.max(match scattering {
            Some(Scattering { ordinates, given, current, .. }) => {
                let (fields, sums) = (2 + current, 1 + current);
                let transport = 5 * fields + 2 + 6 * sums + 4 * ordinates + 16;
                let source = 2 * (3 + given + current) + sums;
                coarser.max(plane(coarse) * transport.max(source))
            }
            // Solved in files that stand for memory.
            None => coarser.max(8 * plane(coarse)),
        });
    }
    // Other small volumes stay in memory too, up to a quarter of it.
    let small = |size: [u64; 3]| values(size) * Paged::SMALL <= least * 4 / 3;
    let kept = |size: [u64; 3], count: u64| if small(size) { values(size) * count } else { 0 };
    // Those of the medium's box may be of any size.
    let boxed = if volumes > 0 { least / 3 } else { 0 };
    let kept = boxed + kept(data, 2) + kept(light, 2 + lights) + kept(coarse, lights + volumes);
    // A hundredth more for what rounding adds.
    Ok((4 * (least + kept.min(least / 3))).div_ceil(100) * 101)
}

/// The smallest blocks, in voxels along an edge and at least 2, whose means can be lit within `budget` bytes as a whole, beside
/// [`decoded`](source::decoded) files.
pub fn preview(scene: &Scene, grid: &Grid, budget: Option<u64>) -> Result<usize> {
    let budget = budget.unwrap_or(u64::MAX);
    let room = budget - source::decoded(Some(budget));
    let mut needed = 0;
    for factor in 2..=64 {
        needed = working_set(scene, &grid.resized(preview::size(grid.size, factor)))?;
        if needed <= room {
            return Ok(factor);
        }
    }
    Err(Error::OutOfMemory { needed: with_decoded(needed), budget })
}

/// Bytes of memory that this process may still take: what the machine has available, within the limits of its control group;
/// a tenth of it is left to others. `None` where the system does not say.
pub fn available() -> Option<u64> {
    let number = |path: &str| std::fs::read_to_string(path).ok()?.trim().parse::<u64>().ok();
    let about = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = about.lines().find(|l| l.starts_with("MemAvailable:"))?;
    let machine = 1024 * line.split_whitespace().nth(1)?.parse::<u64>().ok()?;
    let group = |limit: &str, used: &str| Some(number(limit)?.saturating_sub(number(used)?));
    let limits = [
        group("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
        group("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
    ];
    Some(limits.into_iter().flatten().fold(machine, u64::min) / 10 * 9)
}

/// `device`, or one that has it work on a slab at a time, where lighting data on `grid` would take more than what `budget`
/// bytes leave beside [`decoded`](source::decoded) files. Light that does not fit then goes to a file without a name in `folder`.
///
/// # Errors
/// [`Error::OutOfMemory`], naming the smallest budget that works.
pub fn fit(device: Arc<dyn Device>, scene: &Scene, grid: &Grid, budget: u64, folder: &Path) -> Result<Arc<dyn Device>> {
    let whole = working_set(scene, grid)?;
    let room = budget - source::decoded(Some(budget));
    let Needs { data, direct, solved, .. } = Needs::new(scene, grid)?;
    let largest = 4 * [data, direct.0, solved.0].map(values).into_iter().max().unwrap_or(0);
    if whole <= room && largest <= device.largest() {
        return Ok(device);
    }
    let least = smallest(scene, grid)?;
    // Where the whole takes little more than the least there is nothing to gain.
    if least > room || (whole <= least && whole > room) {
        return Err(Error::OutOfMemory { needed: with_decoded(least.min(whole)), budget });
    }
    Ok(Arc::new(Paged::new(device, room, folder).keeping(scene.light.scratch)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(sets: &[&str]) -> Scene {
        let sets: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
        Scene::load(None, &sets).unwrap()
    }

    #[test]
    fn the_working_set_grows_with_data_lights_and_resolution() {
        let with = |sets: &[&str], size: usize| working_set(&scene(sets), &Grid::new([size; 3])).unwrap();
        let plain = with(&[], 128);
        assert!(plain > 4 * 128u64.pow(3) * 5);
        assert!((7..=8).contains(&(with(&["render.size=[1,1]"], 256) / with(&["render.size=[1,1]"], 128))));
        assert!(with(&["lights.0.softness=3"], 128) > plain);
        let paper = with(&["light.model=paper"], 128);
        assert!(
            with(&["light.model=paper", "lights.0.kind=cone"], 128)
                > with(&["light.model=paper", "lights.0.color=[1,1,1]"], 128)
        );
        assert!(
            paper > 4 * 128u64.pow(3) * 5 && with(&["light.model=paper", "light.diffusion=multigrid"], 128) > paper
        );
        assert!(with(&["light.resolution=1"], 128) > plain && with(&["transfer.anisotropy=0.5"], 128) > plain);
    }

    #[test]
    fn slabs_of_direct_light_take_little() {
        let (sets, grid) = (["light.scattering=false", "lights.0.intensity=3"], Grid::new([1024; 3]));
        let (least, whole) = (smallest(&scene(&sets), &grid).unwrap(), working_set(&scene(&sets), &grid).unwrap());
        assert!(least < 128 << 20 && whole > 16 << 30, "{least} of {whole}");
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn this_machine_has_memory() {
        assert!(available().expect("Linux says") > 1 << 20);
    }
}
