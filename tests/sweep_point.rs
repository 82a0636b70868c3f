//! Direct light from a point by short characteristics: closed forms (validation.md 1, 3, 4) and invariances (16).

use glam::{DVec3, Vec3};
use gloaming::device::cpu::Cpu;
use gloaming::device::{Device, PointSweep, Sweep};
use gloaming::{BrickLayout, Grid};

/// The equation in f64, voxel by voxel in the order of the sums of layers: no bricks, no rows.
fn oracle(grid: &Grid, light: DVec3, sigma: &[f32]) -> Vec<f64> {
    // Lights on a voxel are meant to be on it.
    let at = (1e9 * (light - DVec3::from(grid.origin)) / DVec3::from(grid.spacing)).round() * 1e-9;
    let (n, h) = (grid.size.map(|n| n as i64), DVec3::from(grid.spacing));
    let layers = |p: [i64; 3]| -> [i64; 3] { std::array::from_fn(|a| (p[a] as f64 - at[a]).abs().floor() as i64) };
    let index = |p: [i64; 3]| ((p[2] * n[1] + p[1]) * n[0] + p[0]) as usize;
    let inside = |p: [i64; 3]| (0..3).all(|a| (0..n[a]).contains(&p[a]));
    let mut order = Vec::new();
    for k in 0..n[2] {
        for j in 0..n[1] {
            for i in 0..n[0] {
                order.push([i, j, k]);
            }
        }
    }
    order.sort_by_key(|p| layers(*p).iter().sum::<i64>());
    let mut rho = vec![f64::NAN; grid.len()];
    for p in order {
        let q: [f64; 3] = std::array::from_fn(|a| p[a] as f64 - at[a]);
        let k = layers(p);
        if k.iter().all(|k| *k <= 1) {
            let way = DVec3::from(p.map(|i| i as f64));
            rho[index(p)] = (-ray(grid, sigma, at, way, 20_000)).exp();
            continue;
        }
        let a = (0..3).rev().max_by(|a, b| q[*a].abs().total_cmp(&q[*b].abs())).unwrap();
        let [b, c] = [[1, 2], [0, 2], [0, 1]][a];
        let toward = q.map(|q| if q >= 0.0 { -1 } else { 1 });
        let f = |l: usize| {
            let beside = p[l] + toward[l];
            if k[l] == 0 && !(0..n[l]).contains(&beside) { 0.0 } else { q[l].abs() / q[a].abs() }
        };
        let (fb, fc) = (f(b), f(c));
        let (mut foot, mut sigma_foot) = (0.0, 0.0);
        for (db, dc, w) in
            [(0, 0, (1.0 - fb) * (1.0 - fc)), (1, 0, fb * (1.0 - fc)), (0, 1, (1.0 - fb) * fc), (1, 1, fb * fc)]
        {
            let mut corner = p;
            corner[a] += toward[a];
            corner[b] += db * toward[b];
            corner[c] += dc * toward[c];
            if w == 0.0 {
                continue;
            }
            foot += w * if inside(corner) { rho[index(corner)] } else { 1.0 };
            sigma_foot += w * if inside(corner) { f64::from(sigma[index(corner)]) } else { 0.0 };
        }
        let r = (DVec3::from(q) * h).length();
        let half = 0.5 * r / q[a].abs();
        // Second derivative of the distance along b at the foot.
        let curvature = |l: usize| h[l] * h[l] * (1.0 - (q[l] * h[l] / r).powi(2)) / (r * (1.0 - 1.0 / q[a].abs()));
        let delta = 0.5 * (fb * (1.0 - fb) * curvature(b) + fc * (1.0 - fc) * curvature(c));
        rho[index(p)] = foot * (-sigma_foot * (half - delta).max(0.0) - f64::from(sigma[index(p)]) * half).exp();
    }
    rho
}

/// Optical depth between two index positions through trilinear σ, clamped in the rim and 0 outside the box, by midpoints.
fn ray(grid: &Grid, sigma: &[f32], from: DVec3, to: DVec3, steps: usize) -> f64 {
    let n = grid.size;
    let length = ((to - from) * DVec3::from(grid.spacing)).length();
    let mut sum = 0.0;
    for s in 0..steps {
        let x = from + (to - from) * ((s as f64 + 0.5) / steps as f64);
        if (0..3).any(|a| x[a] < -0.5 || x[a] > n[a] as f64 - 0.5) {
            continue;
        }
        let x: [f64; 3] = std::array::from_fn(|a| x[a].clamp(0.0, n[a] as f64 - 1.0));
        let i: [usize; 3] = std::array::from_fn(|a| (x[a] as usize).min(n[a].saturating_sub(2)));
        for corner in 0..8 {
            let mut w = 1.0;
            let mut p = i;
            for a in 0..3 {
                let f = x[a] - i[a] as f64;
                if corner >> a & 1 == 1 {
                    w *= f;
                    p[a] = (i[a] + 1).min(n[a] - 1);
                } else {
                    w *= 1.0 - f;
                }
            }
            sum += w * f64::from(sigma[grid.index(p)]);
        }
    }
    sum * length / steps as f64
}

fn noise(n: usize, seed: u32) -> Vec<f32> {
    let mut state = seed.wrapping_mul(0x9e37_79b9) | 1;
    (0..n)
        .map(|_| {
            state ^= state << 13;
            state ^= state >> 17;
            state ^= state << 5;
            let v = state as f32 / u32::MAX as f32;
            if v > 0.6 { 0.5 * v } else { 0.0 }
        })
        .collect()
}

fn solve(cpu: &Cpu, grid: &Grid, light: DVec3, edge: usize, sigma: &[f32]) -> Vec<f32> {
    let sweep = PointSweep::new(grid, light, 1.0);
    let layout = BrickLayout::new(grid.size, edge);
    let (mut s, mut rho) = (cpu.alloc(grid.len()).unwrap(), cpu.alloc(grid.len()).unwrap());
    cpu.upload(sigma, &mut s).unwrap();
    cpu.upload(&vec![f32::NAN; grid.len()], &mut rho).unwrap();
    let fronts = sweep.fronts(&layout);
    let fronts: Vec<&[u32]> = fronts.iter().map(|f| &f[..]).collect();
    assert_eq!(cpu.sweep_point(&sweep, &layout, &s, &mut rho, &fronts).unwrap().len(), layout.len());
    let mut out = vec![0.0; grid.len()];
    cpu.download(&rho, &mut out).unwrap();
    out
}

/// σ of a smooth medium at unit-cube positions.
fn smooth(size: usize, f: impl Fn(DVec3) -> f64) -> (Grid, Vec<f32>) {
    let grid = Grid { spacing: [1.0 / size as f64; 3], origin: [0.5 / size as f64; 3], ..Grid::new([size; 3]) };
    let at = |i: usize| (i as f64 + 0.5) / size as f64;
    let sigma = (0..grid.len())
        .map(|i| f(DVec3::new(at(i % size), at(i / size % size), at(i / (size * size)))) as f32)
        .collect();
    (grid, sigma)
}

fn cpu() -> Cpu {
    Cpu::new(2).unwrap()
}

/// Index positions: between voxels, on a voxel, on a plane, on brick corners of every edge used, in the rim, outside a face,
/// an edge and a corner.
fn lights(n: [usize; 3]) -> Vec<DVec3> {
    let n = DVec3::from(n.map(|n| n as f64));
    vec![
        DVec3::new(7.3, 8.6, 5.2),
        DVec3::new(7.0, 8.0, 5.0),
        DVec3::new(7.5, 8.0, 4.3),
        DVec3::splat(7.5),
        DVec3::new(7.5, 3.5, 15.5),
        DVec3::new(-0.3, 5.2, 6.0),
        n - DVec3::new(0.7, 1.0, 0.6),
        DVec3::new(-6.4, 5.3, 7.7),
        DVec3::new(-1.5, -0.8, 7.5),
        DVec3::new(n.x + 3.2, -4.5, 2.0),
        DVec3::new(-5.0, n.y + 4.0, n.z + 9.5),
    ]
}

fn anisotropic(size: [usize; 3]) -> Grid {
    Grid { size, spacing: [0.8, 1.1, 0.95], origin: [3.0, -2.0, 10.0] }
}

fn world(grid: &Grid, index: DVec3) -> DVec3 {
    DVec3::from(grid.origin) + index * DVec3::from(grid.spacing)
}

#[test]
fn every_position_solves_the_equation() {
    let grid = anisotropic([17, 19, 18]);
    let sigma = noise(grid.len(), 3);
    for light in lights(grid.size) {
        let got = solve(&cpu(), &grid, world(&grid, light), 8, &sigma);
        let want = oracle(&grid, world(&grid, light), &sigma);
        for (i, (g, w)) in got.iter().zip(&want).enumerate() {
            let p = [i % 17, i / 17 % 19, i / (17 * 19)];
            // The oracle's ray beside the light has 20 000 midpoints; the rest is rounding.
            assert!((f64::from(*g) - w).abs() < 2e-5, "light {light}: {g} for {w} at {p:?}");
        }
    }
}

#[test]
fn bricks_of_any_size_give_the_same_bits() {
    let grid = anisotropic([33, 27, 30]);
    let sigma = noise(grid.len(), 4);
    for light in lights(grid.size) {
        let at = world(&grid, light);
        let whole = solve(&cpu(), &grid, at, 64, &sigma);
        for edge in [1, 2, 3, 4, 8, 16, 31] {
            let bricked = solve(&cpu(), &grid, at, edge, &sigma);
            let differ = whole.iter().zip(&bricked).filter(|(a, b)| a.to_bits() != b.to_bits()).count();
            assert_eq!(differ, 0, "light {light}, bricks of {edge}");
        }
    }
}

#[test]
fn fronts_hold_every_brick_once_after_all_that_it_reads() {
    for size in [[33, 27, 30], [5, 64, 9]] {
        let grid = Grid::new(size);
        for light in lights(size) {
            for edge in [1, 4, 16] {
                let layout = BrickLayout::new(size, edge);
                let sweep = PointSweep::new(&grid, light, 1.0);
                let mut front_of = vec![None; layout.len()];
                for (n, front) in sweep.fronts(&layout).iter().enumerate() {
                    assert!(!front.is_empty());
                    for &b in front {
                        assert_eq!(front_of[b as usize].replace(n), None);
                    }
                }
                for b in 0..layout.len() {
                    let upstream = sweep.upstream(&layout, b);
                    assert!(upstream.iter().all(|&u| front_of[u as usize] < front_of[b]), "brick {b}, light {light}");
                }
            }
        }
    }
}

#[test]
fn nothing_is_lost_in_vacuum() {
    let grid = anisotropic([40, 33, 37]);
    for light in lights(grid.size) {
        let rho = solve(&cpu(), &grid, world(&grid, light), 16, &vec![0.0; grid.len()]);
        // The four weights of a foot sum to 1 but for rounding, layer by layer.
        assert!(rho.iter().all(|r| (r - 1.0).abs() < 40.0 * f32::EPSILON), "light {light}");
    }
}

/// Beer–Lambert in a homogeneous medium: exact along axes, of first order elsewhere.
#[test]
fn a_homogeneous_medium_dims_by_the_distance() {
    let worst = |size: usize| {
        let (grid, sigma) = smooth(size, |_| 3.0);
        let light = DVec3::new(0.41, 0.53, 0.38);
        let rho = solve(&cpu(), &grid, light, 16, &sigma);
        (0..grid.len())
            .map(|i| {
                let p = [i % size, i / size % size, i / (size * size)].map(|i| (i as f64 + 0.5) / size as f64);
                (f64::from(rho[i]) - (-3.0 * (DVec3::from(p) - light).length()).exp()).abs()
            })
            .fold(0.0, f64::max)
    };
    let (coarse, fine) = (worst(16), worst(48));
    assert!(coarse < 0.004 && fine < 0.0015, "{coarse} {fine}");
    assert!(coarse / fine > 2.0, "{coarse} to {fine} over three times the resolution");

    let grid = Grid::new([21; 3]);
    let rho = solve(&cpu(), &grid, DVec3::splat(10.0), 8, &vec![0.1; grid.len()]);
    for d in 1..=10 {
        let exact = (-0.1 * d as f32).exp();
        for p in [[10 + d, 10, 10], [10 - d, 10, 10], [10, 10 + d, 10], [10, 10, 10 - d]] {
            assert!((rho[grid.index(p)] - exact).abs() < 1e-6, "{p:?}");
        }
    }
}

/// The shadow of a homogeneous sphere is a cone with the tip in the light: a ray at angle θ to the axis passes it at distance
/// b = D sin θ and keeps e^(−2σ√(R²−b²)).
#[test]
fn a_sphere_throws_a_cone_of_shadow() {
    let size = 64;
    let (centre, radius, strength) = (DVec3::new(0.45, 0.5, 0.52), 0.14, 8.0);
    // Voxels at the surface hold the covered fraction, roughly.
    let (grid, sigma) =
        smooth(size, |p| strength * ((radius - (p - centre).length()) * size as f64 + 0.5).clamp(0.0, 1.0));
    let light = DVec3::new(0.12, 0.2, 0.15);
    let rho = solve(&cpu(), &grid, light, 32, &sigma);
    let axis = centre - light;
    let (mut worst, mut inside, mut square) = (0.0f64, 0, 0.0);
    let mut behind = 0;
    for (i, r) in rho.iter().enumerate() {
        let p = DVec3::from([i % size, i / size % size, i / (size * size)].map(|i| (i as f64 + 0.5) / size as f64));
        let ray = p - light;
        let b = ray.cross(axis).length() / ray.length();
        // Well behind the sphere, away from the edge of the shadow, where it is as sharp as the grid.
        if ray.dot(axis) < 1.4 * axis.length_squared() || (b - radius).abs() < 0.03 {
            continue;
        }
        behind += 1;
        let exact = if b < radius { (-2.0 * strength * (radius * radius - b * b).sqrt()).exp() } else { 1.0 };
        inside += usize::from(b < radius);
        let error = (f64::from(*r) - exact).abs();
        worst = worst.max(error);
        square += error * error;
    }
    let rms = (square / behind as f64).sqrt();
    assert!(inside > 3000, "{inside}");
    // Bilinear feet smear an edge over about the square root of the layers crossed.
    assert!(rms < 0.03 && worst < 0.25, "rms {rms}, worst {worst}");
}

#[test]
fn axes_and_directions_are_alike() {
    let grid = Grid::new([18, 18, 18]);
    let sigma = noise(grid.len(), 9);
    let light = DVec3::new(6.3, 9.5, 11.0);
    let reference = solve(&cpu(), &grid, light, 8, &sigma);
    let n = 17.0;
    for mirror in 0..8u32 {
        for axes in [[0, 1, 2], [1, 2, 0], [2, 0, 1], [1, 0, 2]] {
            let flip = |a: usize, v: f64| if mirror >> a & 1 == 1 { n - v } else { v };
            // Voxel p of the transformed volume is voxel `source(p)` of the first one.
            let source = |p: [usize; 3]| {
                let mut q = [0; 3];
                (0..3).for_each(|a| q[axes[a]] = flip(a, p[a] as f64) as usize);
                q
            };
            let coords = |i: usize| [i % 18, i / 18 % 18, i / 324];
            let turned: Vec<f32> = (0..grid.len()).map(|i| sigma[grid.index(source(coords(i)))]).collect();
            let at = DVec3::from_array(std::array::from_fn(|a| flip(a, light[axes[a]])));
            let rho = solve(&cpu(), &grid, at, 8, &turned);
            for (i, r) in rho.iter().enumerate() {
                let expected = reference[grid.index(source(coords(i)))];
                // The four parts of a foot are added in another order; where two axes are equally long, another is chosen.
                assert!((r - expected).abs() < 2e-5, "{mirror} {axes:?} at {:?}: {r} {expected}", coords(i));
            }
        }
    }
}

/// Against the integral along the ray, through waves of a third of the box: converges with the grid.
#[test]
fn structured_media_converge_to_the_ray_integral() {
    let field = |p: DVec3| {
        let wave = |k: DVec3, phase: f64| (19.0 * k.dot(p) + phase).sin();
        2.0 + wave(DVec3::new(0.7, 0.3, -0.6), 0.3) + wave(DVec3::new(-0.2, 0.9, 0.4), 1.7)
    };
    // From outside light enters through layers that half lie outside.
    for (light, bound) in [(DVec3::new(0.47, 0.55, 0.42), 0.008), (DVec3::new(-0.4, 0.3, 1.2), 0.02)] {
        let depth = |to: DVec3| {
            let steps = 300;
            let at = |s: usize| light + (to - light) * ((s as f64 + 0.5) / steps as f64);
            let inside = |x: &DVec3| x.min_element() >= 0.0 && x.max_element() <= 1.0;
            (0..steps).map(at).filter(inside).map(field).sum::<f64>() * (to - light).length() / steps as f64
        };
        let rms = |size: usize| {
            let (grid, sigma) = smooth(size, field);
            let rho = solve(&cpu(), &grid, light, 16, &sigma);
            let mut errors = Vec::new();
            for i in (0..grid.len()).step_by(37) {
                let p = [i % size, i / size % size, i / (size * size)].map(|i| (i as f64 + 0.5) / size as f64);
                errors.push(f64::from(rho[i]) - (-depth(DVec3::from(p))).exp());
            }
            (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt()
        };
        let (coarse, fine) = (rms(16), rms(48));
        assert!(fine < bound && coarse / fine > 2.0, "light {light}: {coarse}, {fine}");
    }
}

/// Far away a point light is a distant one.
#[test]
fn a_light_far_outside_is_distant() {
    let grid = anisotropic([24, 31, 27]);
    let (lo, hi) = grid.bounds();
    let sigma = noise(grid.len(), 12);
    for u in [Vec3::new(0.3, -0.5, 0.7), Vec3::new(-0.9, 0.2, 0.1), Vec3::new(0.05, 0.8, 0.3), Vec3::Z] {
        let u = u.normalize();
        let point = solve(&cpu(), &grid, 0.5 * (lo + hi) - 1e6 * u.as_dvec3(), 16, &sigma);
        let sweep = Sweep::new(&grid, u, false);
        let layout = BrickLayout::new(grid.size, 16);
        let (mut s, mut rho) = (cpu().alloc(grid.len()).unwrap(), cpu().alloc(grid.len()).unwrap());
        cpu().upload(&sigma, &mut s).unwrap();
        let fronts = layout.fronts(sweep.ascending());
        let fronts: Vec<&[u32]> = fronts.iter().map(|f| &f[..]).collect();
        cpu().sweep(&sweep, &layout, &s, &mut rho, &fronts).unwrap();
        for (p, d) in point.iter().zip(rho.host().unwrap()) {
            // Directions differ by 30/10⁶ across the box, feet by that many voxels in each of 30 layers.
            assert!((p - d).abs() < 1e-3, "{u}: {p} {d}");
        }
    }
}
