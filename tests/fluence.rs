//! Scattered light against Monte Carlo (validation.md 8, 9, 20; light.md, "Promise, tested").

use glam::DVec3;
use gloaming::device::cpu::Cpu;
use gloaming::device::{Buffer, Device, Sweep, Travel};
use gloaming::light::ordinates::{ScatterProblem, Scattered, forward};
use gloaming::{BrickLayout, Grid};

#[path = "common/monte_carlo.rs"]
mod monte_carlo;

use monte_carlo::{Fluence, Lamp, Medium};

/// Light voxels along an axis; direct light is solved on twice as many.
const N: usize = 32;

fn smoothstep(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

/// Optical depth 10 across, albedo .9.
fn soft_sphere(p: DVec3) -> f64 {
    12.5 * smoothstep((0.5 - (p - 0.5).length()) / 0.2)
}

/// Dense blobs with voids between and in them, albedo .95.
fn blobs_and_voids(p: DVec3) -> f64 {
    const BLOBS: [([f64; 3], f64, f64); 7] = [
        ([0.30, 0.35, 0.60], 0.20, 1.2),
        ([0.65, 0.40, 0.35], 0.18, 1.2),
        ([0.55, 0.70, 0.65], 0.16, 1.2),
        ([0.35, 0.65, 0.25], 0.12, 1.0),
        ([0.30, 0.35, 0.65], 0.09, -1.4),
        ([0.70, 0.40, 0.40], 0.08, -1.4),
        ([0.55, 0.60, 0.60], 0.08, -1.2),
    ];
    let sum: f64 = BLOBS.iter().map(|(c, r, a)| a * (-(p - DVec3::from(*c)).length_squared() / (r * r)).exp()).sum();
    24.0 * (sum - 0.15).clamp(0.0, 1.0)
}

/// Optical depth 16 from face to face, albedo .99; a quarter of the box is around it.
fn cube(p: DVec3) -> f64 {
    if (p - 0.5).abs().max_element() < 0.375 { 16.0 / 0.75 } else { 0.0 }
}

struct Case {
    extinction: fn(DVec3) -> f64,
    majorant: f64,
    albedo: f64,
}

const SPHERE: Case = Case { extinction: soft_sphere, majorant: 12.5, albedo: 0.9 };
const BLOBS: Case = Case { extinction: blobs_and_voids, majorant: 24.0, albedo: 0.95 };
const CUBE: Case = Case { extinction: cube, majorant: 16.0 / 0.75, albedo: 0.99 };

fn light() -> DVec3 {
    DVec3::new(0.6, 0.4, -0.7).normalize()
}

fn traced(case: &Case, g: f64) -> Fluence {
    let medium = Medium { extinction: &case.extinction, majorant: case.majorant, albedo: case.albedo, anisotropy: g };
    monte_carlo::fluence(&medium, Lamp::Distant { direction: light(), irradiance: 1.0 }, N, 120_000, 16)
}

/// Total fluence by ordinates, in f64.
fn solved(device: &dyn Device, case: &Case, g: f64, directions: usize) -> Vec<f64> {
    let grid = |n: usize| Grid { spacing: [1.0 / n as f64; 3], ..Grid::new([n; 3]) };
    let (fine, coarse) = (grid(2 * N), grid(N));
    let scaled = 1.0 - case.albedo * f64::from(forward(g as f32));
    // Mean over a voxel by 3³ samples.
    let extinction = |i: usize| {
        let n = 2 * N;
        let corner = [i % n, i / n % n, i / n / n];
        let samples = (0..27).map(|s| {
            let at = [s % 3, s / 3 % 3, s / 9];
            let p: [f64; 3] = std::array::from_fn(|a| (corner[a] as f64 + (at[a] as f64 + 0.5) / 3.0) / n as f64);
            (case.extinction)(DVec3::from(p))
        });
        samples.sum::<f64>() / 27.0
    };
    let sigma: Vec<f32> = (0..fine.len()).map(|i| (scaled * extinction(i)) as f32).collect();
    let buffer = |n: usize| device.alloc(n).unwrap();
    let mut sigma_fine = buffer(fine.len());
    device.upload(&sigma, &mut sigma_fine).unwrap();
    let u = light().as_vec3();
    let sweep = Sweep::new(&fine, u, false);
    let layout = BrickLayout::new(fine.size, BrickLayout::EDGE);
    let fronts = layout.fronts(sweep.ascending());
    let fronts: Vec<&[u32]> = fronts.iter().map(|f| &f[..]).collect();
    let mut rho = buffer(fine.len());
    device.sweep(&sweep, &layout, &sigma_fine, &mut rho, &fronts).unwrap();
    let [mut sigma, mut first, mut scattering] = [(); 3].map(|()| buffer(coarse.len()));
    device.restrict(fine.size, &sigma_fine, coarse.size, &mut sigma).unwrap();
    device.restrict(fine.size, &rho, coarse.size, &mut first).unwrap();
    device.combine(&[(&sigma, (case.albedo / scaled) as f32)], &mut scattering).unwrap();
    let mut solution = Scattered::new(device, coarse, 1, g as f32).unwrap();
    let problem = ScatterProblem {
        sigma: &sigma,
        scattering: std::slice::from_ref(&scattering),
        emission: &[],
        first: &[(&first, [1.0; 3], Travel::Along(u))],
        environment: &[],
        chromatic: [1.0; 3],
        anisotropy: g as f32,
        directions,
        tolerance: 1e-3,
        warm: false,
        scattering_on: true,
        everywhere: true,
        passes: None,
        until: None,
    };
    let report = solution.solve(device, &problem).unwrap();
    assert!(report.converged, "{report:?}");
    let values = |b: &Buffer| {
        let mut out = vec![0.0; coarse.len()];
        device.download(b, &mut out).unwrap();
        out
    };
    let (direct, scattered) = (values(&first), values(solution.fluence()[0].0));
    direct.iter().zip(&scattered).map(|(a, b)| f64::from(a + b)).collect()
}

/// Relative RMS difference, the noise of the reference taken out.
fn rmse(got: &[f64], reference: &Fluence) -> f64 {
    let squares = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>();
    let difference = squares(&mut got.iter().zip(&reference.mean).map(|(a, b)| a - b));
    let noise = squares(&mut reference.error.iter().copied());
    let total = squares(&mut reference.mean.iter().copied());
    assert!(noise < 0.07f64.powi(2) * total, "the reference is too noisy: {}", (noise / total).sqrt());
    ((difference - noise).max(0.0) / total).sqrt()
}

/// The promise: relative RMS error of the total fluence.
fn keeps(case: &Case, g: f64, bound: f64) {
    let device = Cpu::new(0).unwrap();
    let error = rmse(&solved(&device, case, g, 32), &traced(case, g));
    assert!(error <= bound, "g = {g}: {error}");
}

#[test]
fn soft_sphere_within_4_percent() {
    keeps(&SPHERE, 0.0, 0.04);
}

#[test]
fn soft_sphere_forward_within_4_percent() {
    keeps(&SPHERE, 0.5, 0.04);
}

#[test]
fn soft_sphere_backward_within_4_percent() {
    keeps(&SPHERE, -0.5, 0.04);
}

#[test]
fn soft_sphere_strongly_forward_within_8_percent() {
    keeps(&SPHERE, 0.85, 0.08);
}

#[test]
fn blobs_and_voids_within_4_percent() {
    keeps(&BLOBS, 0.0, 0.04);
}

#[test]
fn blobs_and_voids_forward_within_4_percent() {
    keeps(&BLOBS, 0.5, 0.04);
}

#[test]
fn blobs_and_voids_strongly_forward_within_8_percent() {
    keeps(&BLOBS, 0.85, 0.08);
}

#[test]
fn cube_within_4_percent_and_not_with_8_directions() {
    let device = Cpu::new(0).unwrap();
    let reference = traced(&CUBE, 0.0);
    let [few, usual] = [8, 32].map(|directions| rmse(&solved(&device, &CUBE, 0.0, directions), &reference));
    assert!(usual <= 0.04, "32 directions: {usual}");
    assert!(few > 0.04, "8 directions: {few}");
}

#[test]
fn cube_forward_within_4_percent() {
    keeps(&CUBE, 0.5, 0.04);
}

#[test]
fn cube_strongly_forward_within_8_percent() {
    keeps(&CUBE, 0.85, 0.08);
}

/// validation.md 8: without absorption, in a uniform environment, radiance is that of the environment everywhere.
#[test]
fn the_reference_passes_the_white_furnace() {
    for g in [0.0, 0.7] {
        let medium = Medium { extinction: &soft_sphere, majorant: 12.5, albedo: 1.0, anisotropy: g };
        let found = monte_carlo::fluence(&medium, Lamp::Environment { radiance: 1.0 }, 4, 20_000, 32);
        for (mean, error) in found.mean.iter().zip(&found.error) {
            let off = (mean - 4.0 * std::f64::consts::PI) / error;
            assert!(off.abs() < 4.5, "{off} standard errors");
        }
    }
}

/// validation.md 9: the sampled phase function against ∫p over each of 32 equal steps of the cosine, χ² of 31 degrees of
/// freedom (99.99 % below 71), and its mean cosine.
#[test]
fn sampled_directions_follow_henyey_greenstein() {
    const STEPS: usize = 32;
    const SAMPLES: usize = 200_000;
    for g in [-0.5f64, 0.0, 0.5, 0.85] {
        let mut rng = <rand_xorshift::XorShiftRng as rand::SeedableRng>::seed_from_u64(11);
        let (mut counts, mut sum) = ([0usize; STEPS], 0.0);
        for _ in 0..SAMPLES {
            let cosine = monte_carlo::scatter(light(), g, &mut rng).dot(light());
            counts[(((cosine + 1.0) * 0.5 * STEPS as f64) as usize).min(STEPS - 1)] += 1;
            sum += cosine;
        }
        // ∫ from −1 to x of (1 − g²)/(2 (1 + g² − 2gμ)^{3/2}) dμ.
        let below = |x: f64| match g {
            0.0 => 0.5 * (x + 1.0),
            _ => (1.0 - g * g) / (2.0 * g) * ((1.0 + g * g - 2.0 * g * x).sqrt().recip() - (1.0 + g).recip()),
        };
        assert!((below(1.0) - 1.0).abs() < 1e-12);
        let edge = |i: usize| 2.0 * i as f64 / STEPS as f64 - 1.0;
        let term = |i: usize| {
            let expected = SAMPLES as f64 * (below(edge(i + 1)) - below(edge(i)));
            (counts[i] as f64 - expected).powi(2) / expected
        };
        let chi2: f64 = (0..STEPS).map(term).sum();
        assert!(chi2 < 71.0, "g = {g}: χ² = {chi2}");
        assert!((sum / SAMPLES as f64 - g).abs() < 4.0 / (3.0 * SAMPLES as f64).sqrt(), "g = {g}");
    }
}
