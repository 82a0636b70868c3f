//! Fluence by tracing photons: the reference for everything that approximates light transport. f64, no grid in the medium,
//! unbiased, with its standard error.

use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_xorshift::XorShiftRng;
use rayon::prelude::*;

/// A medium in the box [0, 1]³, vacuum outside.
pub struct Medium<'a> {
    /// Extinction, at most `majorant` everywhere.
    pub extinction: &'a (dyn Fn(DVec3) -> f64 + Sync),
    pub majorant: f64,
    pub albedo: f64,
    /// Henyey–Greenstein g.
    pub anisotropy: f64,
}

/// What lights it.
#[derive(Clone, Copy)]
#[allow(dead_code, reason = "each test has lamps of its own")]
pub enum Lamp {
    Distant {
        direction: DVec3,
        irradiance: f64,
    },
    Environment {
        radiance: f64,
    },
    /// In the box; power/4π.
    Point {
        position: DVec3,
        intensity: f64,
    },
}

/// Mean fluence, direct light included, of the voxels of an n³ grid, x fastest, and its standard error.
pub struct Fluence {
    pub mean: Vec<f64>,
    pub error: Vec<f64>,
}

/// Traces `batches` independent batches of `photons` each.
pub fn fluence(medium: &Medium, lamp: Lamp, n: usize, photons: usize, batches: usize) -> Fluence {
    let all: Vec<Vec<f64>> = (0..batches)
        .into_par_iter()
        .map(|b| {
            let mut rng = XorShiftRng::seed_from_u64(b as u64 + 1);
            let mut tally = vec![0.0; n * n * n];
            for _ in 0..photons {
                trace(medium, lamp, n, &mut tally, &mut rng);
            }
            let voxels = (n * n * n) as f64;
            tally.iter_mut().for_each(|t| *t *= voxels / photons as f64);
            tally
        })
        .collect();
    let count = batches as f64;
    let at = |i: usize| {
        let mean = all.iter().map(|t| t[i]).sum::<f64>() / count;
        let variance = all.iter().map(|t| (t[i] - mean).powi(2)).sum::<f64>() / (count - 1.0);
        (mean, (variance / count).sqrt())
    };
    let (mean, error) = (0..n * n * n).map(at).unzip();
    Fluence { mean, error }
}

/// One photon by delta tracking; every tentative collision of weight w tells of a track of length w/majorant.
fn trace(medium: &Medium, lamp: Lamp, n: usize, tally: &mut [f64], rng: &mut XorShiftRng) {
    let (mut position, mut direction, mut weight) = emit(lamp, rng);
    loop {
        position += direction * (-(1.0 - rng.random::<f64>()).ln() / medium.majorant);
        if position.min_element() < 0.0 || position.max_element() >= 1.0 {
            return;
        }
        let [i, j, k] = (position * n as f64).to_array().map(|c| (c as usize).min(n - 1));
        tally[(k * n + j) * n + i] += weight / medium.majorant;
        let extinction = (medium.extinction)(position);
        assert!(extinction <= medium.majorant * (1.0 + 1e-12), "majorant too low at {position}");
        if rng.random::<f64>() * medium.majorant >= extinction {
            continue;
        }
        weight *= medium.albedo;
        if weight < 0.1 {
            if rng.random::<f64>() >= 0.5 {
                return;
            }
            weight *= 2.0;
        }
        direction = scatter(direction, medium.anisotropy, rng);
    }
}

/// A photon on its way into the box: of power 1/photons for each unit of power that enters.
fn emit(lamp: Lamp, rng: &mut XorShiftRng) -> (DVec3, DVec3, f64) {
    let mut position = DVec3::new(rng.random(), rng.random(), rng.random());
    match lamp {
        Lamp::Distant { direction, irradiance } => {
            let facing = direction.abs();
            let pick = rng.random::<f64>() * facing.element_sum();
            let axis = if pick < facing.x {
                0
            } else if pick < facing.x + facing.y {
                1
            } else {
                2
            };
            position[axis] = if direction[axis] > 0.0 { 0.0 } else { 1.0 - 1e-12 };
            (position, direction, irradiance * facing.element_sum())
        }
        Lamp::Point { position, intensity } => {
            let (cosine, angle) = (2.0 * rng.random::<f64>() - 1.0, rng.random::<f64>() * std::f64::consts::TAU);
            let sine = (1.0 - cosine * cosine).sqrt();
            let direction = DVec3::new(sine * angle.cos(), sine * angle.sin(), cosine);
            (position, direction, 4.0 * std::f64::consts::PI * intensity)
        }
        Lamp::Environment { radiance } => {
            let (axis, side) = (rng.random_range(0..3), rng.random_range(0..2));
            position[axis] = if side == 0 { 0.0 } else { 1.0 - 1e-12 };
            let (cosine, angle) = (rng.random::<f64>().sqrt(), rng.random::<f64>() * std::f64::consts::TAU);
            let sine = (1.0 - cosine * cosine).sqrt();
            let mut direction = DVec3::ZERO;
            direction[axis] = if side == 0 { cosine } else { -cosine };
            direction[(axis + 1) % 3] = sine * angle.cos();
            direction[(axis + 2) % 3] = sine * angle.sin();
            (position, direction, 6.0 * std::f64::consts::PI * radiance)
        }
    }
}

/// A direction sampled from Henyey–Greenstein's phase function about `direction`.
pub fn scatter(direction: DVec3, g: f64, rng: &mut XorShiftRng) -> DVec3 {
    let u = rng.random::<f64>();
    let cosine = if g.abs() < 1e-3 {
        1.0 - 2.0 * u
    } else {
        let s = (1.0 - g * g) / (1.0 - g + 2.0 * g * u);
        ((1.0 + g * g - s * s) / (2.0 * g)).clamp(-1.0, 1.0)
    };
    let angle = rng.random::<f64>() * std::f64::consts::TAU;
    let sine = (1.0 - cosine * cosine).sqrt();
    let (a, b) = direction.any_orthonormal_pair();
    (a * (sine * angle.cos()) + b * (sine * angle.sin()) + direction * cosine).normalize()
}

/// Radiance that arrives at `eye` against `direction` (unit), of light scattered at least once in an isotropic medium under a
/// distant light, and its standard error: paths by delta tracking, light at each collision by ratio tracking.
#[allow(dead_code)]
pub fn radiance(medium: &Medium, lamp: Lamp, eye: DVec3, direction: DVec3, paths: usize, seed: u64) -> (f64, f64) {
    let Lamp::Distant { direction: travel, irradiance } = lamp else { panic!("a distant light") };
    assert_eq!(medium.anisotropy, 0.0, "isotropic");
    let mut rng = XorShiftRng::seed_from_u64(seed);
    let (mut sum, mut squares) = (0.0, 0.0);
    for _ in 0..paths {
        let (mut position, mut way, mut weight, mut found) = (eye, direction, 1.0, 0.0);
        while let Some(collision) = collide(medium, position, way, &mut rng) {
            position = collision;
            weight *= medium.albedo;
            if weight < 0.1 {
                if rng.random::<f64>() >= 0.5 {
                    break;
                }
                weight *= 2.0;
            }
            found +=
                weight * irradiance / (4.0 * std::f64::consts::PI) * transmittance(medium, position, -travel, &mut rng);
            way = scatter(way, 0.0, &mut rng);
        }
        sum += found;
        squares += found * found;
    }
    let n = paths as f64;
    (sum / n, ((squares / n - (sum / n).powi(2)) / (n - 1.0)).max(0.0).sqrt())
}

/// Where a ray is inside the box, as a range of lengths.
fn inside(position: DVec3, way: DVec3) -> [f64; 2] {
    let (low, high) = (-position / way, (1.0 - position) / way);
    [low.min(high).max_element().max(0.0), low.max(high).min_element()]
}

/// The next collision along a ray, if it meets one before it leaves.
fn collide(medium: &Medium, position: DVec3, way: DVec3, rng: &mut XorShiftRng) -> Option<DVec3> {
    let [mut t, end] = inside(position, way);
    loop {
        t -= (1.0 - rng.random::<f64>()).ln() / medium.majorant;
        if t >= end {
            return None;
        }
        let at = position + t * way;
        if rng.random::<f64>() * medium.majorant < (medium.extinction)(at) {
            return Some(at);
        }
    }
}

/// An unbiased estimate of the transmittance along a ray out of the box.
fn transmittance(medium: &Medium, position: DVec3, way: DVec3, rng: &mut XorShiftRng) -> f64 {
    let [mut t, end] = inside(position, way);
    let mut left = 1.0;
    loop {
        t -= (1.0 - rng.random::<f64>()).ln() / medium.majorant;
        if t >= end || left == 0.0 {
            return left;
        }
        left *= 1.0 - (medium.extinction)(position + t * way) / medium.majorant;
    }
}
