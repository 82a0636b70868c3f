//! Direct light by short characteristics: closed forms (validation.md 1–3, 5) and invariances (16, 18).

use glam::Vec3;
use gloaming::device::cpu::Cpu;
use gloaming::device::{Device, Optic, Sweep};
use gloaming::scene::Scene;
use gloaming::transfer::TransferFunction;
use gloaming::{BrickLayout, Grid};

/// The equation in f64 over the whole grid, layer by layer: no bricks, no halos.
fn oracle(grid: &Grid, u: Vec3, cubic: bool, sigma: &[f32]) -> Vec<f64> {
    let s = Sweep::new(grid, u, cubic);
    let a = s.axis();
    let (b, c) = [(1, 2), (0, 2), (0, 1)][a];
    let n = grid.size;
    let d: [f64; 3] = s.direction.map(f64::from);
    let (ob, oc) = (d[b] / d[a].abs(), d[c] / d[a].abs());
    let at = |v: &dyn Fn(usize) -> f64, l: usize, ib: isize, ic: isize, pad: f64| -> f64 {
        if ib < 0 || ic < 0 || ib as usize >= n[b] || ic as usize >= n[c] {
            return pad;
        }
        let mut p = [0; 3];
        (p[a], p[b], p[c]) = (l, ib as usize, ic as usize);
        v(grid.index(p))
    };
    let mut rho = vec![0.0f64; grid.len()];
    let length = f64::from(s.length);
    let order: Vec<usize> = if d[a] >= 0.0 { (0..n[a]).collect() } else { (0..n[a]).rev().collect() };
    for (step, &l) in order.iter().enumerate() {
        for ib in 0..n[b] {
            for ic in 0..n[c] {
                let mut p = [0; 3];
                (p[a], p[b], p[c]) = (l, ib, ic);
                let here = grid.index(p);
                let own = f64::from(sigma[here]);
                rho[here] = if step == 0 {
                    (-0.5 * length * own).exp()
                } else {
                    let up = order[step - 1];
                    let (fb, fc) = (ib as f64 - ob, ic as f64 - oc);
                    let (jb, jc) = (fb.floor(), fc.floor());
                    let (tb, tc) = (fb - jb, fc - jc);
                    let (jb, jc) = (jb as isize, jc as isize);
                    let r = |db, dc| at(&|i| rho[i], up, jb + db, jc + dc, 1.0);
                    let s = |db, dc| at(&|i| f64::from(sigma[i]), up, jb + db, jc + dc, 0.0);
                    let bil = |f: &dyn Fn(isize, isize) -> f64| {
                        (1.0 - tb) * ((1.0 - tc) * f(0, 0) + tc * f(0, 1)) + tb * ((1.0 - tc) * f(1, 0) + tc * f(1, 1))
                    };
                    let foot = if cubic {
                        let w = |f: f64| {
                            [
                                -0.5 * f + f * f - 0.5 * f.powi(3),
                                1.0 - 2.5 * f * f + 1.5 * f.powi(3),
                                0.5 * f + 2.0 * f * f - 1.5 * f.powi(3),
                                -0.5 * f * f + 0.5 * f.powi(3),
                            ]
                        };
                        let (wb, wc) = (w(tb), w(tc));
                        let mut sum = 0.0;
                        for (i, wb) in wb.iter().enumerate() {
                            for (j, wc) in wc.iter().enumerate() {
                                sum += wb * wc * r(i as isize - 1, j as isize - 1);
                            }
                        }
                        let near = [r(0, 0), r(0, 1), r(1, 0), r(1, 1)];
                        sum.clamp(
                            near.iter().copied().fold(f64::MAX, f64::min),
                            near.iter().copied().fold(f64::MIN, f64::max),
                        )
                    } else {
                        bil(&r)
                    };
                    foot * (-0.5 * length * (bil(&s) + own)).exp()
                };
            }
        }
    }
    rho
}

fn noise(n: usize, seed: u32) -> Vec<f32> {
    let mut state = seed | 1;
    (0..n)
        .map(|_| {
            state ^= state << 13;
            state ^= state >> 17;
            state ^= state << 5;
            let v = state as f32 / u32::MAX as f32;
            if v > 0.7 { 2.0 * v } else { 0.0 }
        })
        .collect()
}

fn solve(cpu: &Cpu, grid: &Grid, u: Vec3, cubic: bool, edge: usize, sigma: &[f32]) -> Vec<f32> {
    let s = Sweep::new(grid, u, cubic);
    let layout = BrickLayout::new(grid.size, edge);
    let (mut sb, mut rb) = (cpu.alloc(grid.len()).unwrap(), cpu.alloc(grid.len()).unwrap());
    cpu.upload(sigma, &mut sb).unwrap();
    let fronts = layout.fronts(s.ascending());
    let fronts: Vec<&[u32]> = fronts.iter().map(|f| &f[..]).collect();
    let changes = cpu.sweep(&s, &layout, &sb, &mut rb, &fronts).unwrap();
    assert_eq!(changes.len(), layout.len());
    let mut out = vec![0.0; grid.len()];
    cpu.download(&rb, &mut out).unwrap();
    out
}

const DIRECTIONS: [[f32; 3]; 12] = [
    [0.0, 0.0, -1.0],
    [0.0, 1.0, 0.0],
    [-1.0, 0.0, 0.0],
    [1.0, 0.0, 0.0],
    [0.6, 0.4, -0.7],
    [-0.2, 0.9, 0.35],
    [0.95, -0.2, 0.1],
    [-0.8, -0.5, 0.3],
    [0.5, 0.5, 0.5],
    [-0.57, 0.57, -0.57],
    [0.1, -0.3, 0.9],
    [-0.9, 0.0, 0.4],
];

#[test]
fn kernel_solves_the_equation_in_every_direction() {
    let cpu = Cpu::new(2).unwrap();
    let grid = Grid { size: [37, 29, 41], spacing: [0.7, 1.0, 1.6], origin: [0.0; 3] };
    let sigma = noise(grid.len(), 7);
    for d in DIRECTIONS {
        let u = Vec3::from(d).normalize();
        for cubic in [false, true] {
            let exact = oracle(&grid, u, cubic, &sigma);
            let got = solve(&cpu, &grid, u, cubic, 16, &sigma);
            let worst = got.iter().zip(&exact).map(|(g, e)| (f64::from(*g) - e).abs()).fold(0.0, f64::max);
            assert!(worst < 3e-6, "direction {d:?}, cubic {cubic}: differs by {worst}");
        }
    }
}

/// validation.md 16: the partition into bricks does not change a bit.
#[test]
fn bricked_is_whole_bitwise() {
    let cpu = Cpu::new(2).unwrap();
    let grid = Grid { size: [37, 64, 51], spacing: [1.0, 0.9, 1.2], origin: [0.0; 3] };
    let sigma = noise(grid.len(), 3);
    for d in DIRECTIONS {
        let u = Vec3::from(d).normalize();
        let whole = solve(&cpu, &grid, u, false, 64, &sigma);
        for edge in [7, 8, 16, 32] {
            let bricked = solve(&cpu, &grid, u, false, edge, &sigma);
            assert!(
                whole.iter().zip(&bricked).all(|(a, b)| a.to_bits() == b.to_bits()),
                "direction {d:?}, bricks of {edge}"
            );
        }
    }
}

/// validation.md 1: exact in a homogeneous slab along each axis, e^(−σ·(k+½)·Δx).
#[test]
fn beer_lambert_along_each_axis() {
    let cpu = Cpu::new(2).unwrap();
    let grid = Grid { size: [24, 24, 24], spacing: [0.5, 1.0, 2.0], origin: [0.0; 3] };
    let sigma = vec![0.3; grid.len()];
    for a in 0..3 {
        for sign in [1.0, -1.0] {
            let mut u = Vec3::ZERO;
            u[a] = sign;
            let rho = solve(&cpu, &grid, u, false, 8, &sigma);
            for k in 0..24 {
                let mut p = [12, 12, 12];
                p[a] = if sign > 0.0 { k } else { 23 - k };
                let exact = (-0.3 * grid.spacing[a] * (k as f64 + 0.5)).exp();
                let got = f64::from(rho[grid.index(p)]);
                assert!((got - exact).abs() < 2e-6 * exact, "axis {a}, layer {k}: {got} against {exact}");
            }
        }
    }
}

/// validation.md 1: the error of a smooth oblique problem falls at least linearly as the grid is refined.
#[test]
fn oblique_light_converges() {
    let cpu = Cpu::new(2).unwrap();
    let u = Vec3::new(0.5, 0.3, -0.8).normalize();
    let blob = |p: Vec3| 6.0 * (-(p - 0.5).length_squared() / 0.03).exp();
    let error = |n: usize| {
        let grid = Grid { size: [n; 3], spacing: [1.0 / n as f64; 3], origin: [0.5 / n as f64; 3] };
        let centre = |i: usize| (i as f32 + 0.5) / n as f32;
        let mut sigma = vec![0.0; grid.len()];
        for k in 0..n {
            for j in 0..n {
                for i in 0..n {
                    sigma[grid.index([i, j, k])] = blob(Vec3::new(centre(i), centre(j), centre(k)));
                }
            }
        }
        let rho = solve(&cpu, &grid, u, false, 32, &sigma);
        let (mut sum, mut count) = (0.0, 0);
        for k in (0..n).step_by(n / 8) {
            for j in (0..n).step_by(n / 8) {
                for i in (0..n).step_by(n / 8) {
                    let p = Vec3::new(centre(i), centre(j), centre(k));
                    let tau: f64 = (0..2000).map(|s| f64::from(blob(p - u * ((s as f32 + 0.5) * 1e-3))) * 1e-3).sum();
                    sum += (f64::from(rho[grid.index([i, j, k])]) - (-tau).exp()).powi(2);
                    count += 1;
                }
            }
        }
        (sum / count as f64).sqrt()
    };
    let (coarse, fine) = (error(32), error(64));
    assert!(fine < 0.6 * coarse && fine < 0.01, "errors {coarse} at 32, {fine} at 64");
}

/// validation.md 3: behind a homogeneous sphere, e^(−2σ√(R²−b²)).
#[test]
fn shadow_of_a_sphere() {
    let cpu = Cpu::new(2).unwrap();
    let n = 96;
    let grid = Grid { size: [n; 3], spacing: [1.0; 3], origin: [0.5; 3] };
    let (radius, sigma_t, centre) = (24.0f64, 0.04, 48.0);
    let mut sigma = vec![0.0; grid.len()];
    for k in 0..n {
        for j in 0..n {
            for i in 0..n {
                // Cover of the voxel by 16³ points near the rim: the medium that the grid stands for.
                let p = [i, j, k].map(|v| v as f64 - centre);
                let middle = p.iter().map(|v| (v + 0.5).powi(2)).sum::<f64>().sqrt();
                let inside = if (middle - radius).abs() > 1.0 {
                    if middle < radius { 4096 } else { 0 }
                } else {
                    let point = |s: usize| [s % 16, s / 16 % 16, s / 256].map(|v| (v as f64 + 0.5) / 16.0);
                    let r2 = |o: [f64; 3]| (0..3).map(|a| (p[a] + o[a]).powi(2)).sum::<f64>();
                    (0..4096).filter(|&s| r2(point(s)) < radius * radius).count()
                };
                sigma[grid.index([i, j, k])] = (sigma_t * inside as f64 / 4096.0) as f32;
            }
        }
    }
    let rho = solve(&cpu, &grid, Vec3::NEG_Z, false, 32, &sigma);
    for i in 0..n {
        // The chord's mean over the voxel's footprint: the chord itself is not smooth at the rim.
        let chord = (0..256)
            .map(|s| {
                let o = [s % 16, s / 16].map(|v| (v as f64 + 0.5) / 16.0);
                let b2 = (i as f64 + o[0] - centre).powi(2) + o[1].powi(2);
                2.0 * (radius * radius - b2).max(0.0).sqrt() / 256.0f64
            })
            .sum::<f64>();
        let got = f64::from(rho[grid.index([i, 48, 0])]);
        let exact = (-sigma_t * chord).exp();
        assert!((got - exact).abs() < 2e-3, "at {i}: {got} against {exact}");
    }
}

/// validation.md 5: light that comes obliquely enters through all three lit faces undimmed.
#[test]
fn all_lit_faces_are_lit() {
    let cpu = Cpu::new(2).unwrap();
    let grid = Grid::new([20, 21, 22]);
    let sigma = vec![0.0; grid.len()];
    for d in DIRECTIONS {
        let rho = solve(&cpu, &grid, Vec3::from(d).normalize(), false, 8, &sigma);
        assert!(rho.iter().all(|&r| (r - 1.0).abs() < 1e-5), "vacuum dims light along {d:?}");
    }
}

/// validation.md 2: a shadow does not depend on the resolution of the light grid, because extinction is averaged after the
/// transfer function.
#[test]
fn the_shadow_is_the_same_at_half_one_and_two_times_the_resolution() {
    let cpu = Cpu::new(2).unwrap();
    let n = 48;
    let data = Grid::new([n; 3]);
    let scene = Scene::load(None, &["transfer.opacity=[[0,0],[0.4,0.02],[1,0.3]]".into()]).unwrap();
    let table = TransferFunction::new(&scene.transfer).unwrap().table([0.0, 1.0], 1.0);
    let values: Vec<f32> = (0..data.len())
        .map(|i| {
            let p = Vec3::new((i % n) as f32, (i / n % n) as f32, (i / n / n) as f32) - 23.5;
            (-p.length_squared() / 120.0).exp()
        })
        .collect();
    let mut field = cpu.alloc(data.len()).unwrap();
    cpu.upload(&values, &mut field).unwrap();
    // Mean transmittance of 4×4×4 data voxels, on every light grid.
    let shadow = |size: usize, u: Vec3| -> Vec<f32> {
        let grid = data.resized([size; 3]);
        let mut sigma = cpu.alloc(grid.len()).unwrap();
        cpu.classify(Optic::Extinction, &table, data.size, &field, grid.size, &mut sigma).unwrap();
        let mut out = vec![0.0; grid.len()];
        cpu.download(&sigma, &mut out).unwrap();
        let rho = solve(&cpu, &grid, u, false, 16, &out);
        let (mut fine, mut coarse) = (cpu.alloc(grid.len()).unwrap(), cpu.alloc(12 * 12 * 12).unwrap());
        cpu.upload(&rho, &mut fine).unwrap();
        cpu.restrict(grid.size, &fine, [12; 3], &mut coarse).unwrap();
        let mut mean = vec![0.0; 12 * 12 * 12];
        cpu.download(&coarse, &mut mean).unwrap();
        mean
    };
    for u in [Vec3::NEG_Z, Vec3::X, Vec3::new(0.3, 0.5, -0.8).normalize()] {
        let one = shadow(n, u);
        assert!(one.iter().any(|&t| t < 0.2), "there is a shadow along {u}");
        for size in [n / 2, 2 * n] {
            let other = shadow(size, u);
            let differences = || other.iter().zip(&one).map(|(a, b)| (a - b).abs());
            let rms = (differences().map(|d| d * d).sum::<f32>() / one.len() as f32).sqrt();
            assert!(rms < 0.012, "along {u} the shadow at {size}³ differs by {rms} (root mean square)");
            // Oblique light also smears by the foot's interpolation, which is the grid's: its edge may differ by more.
            let worst = differences().fold(0.0, f32::max);
            let axial = u.abs().max_element() == 1.0;
            assert!(!axial || worst < 0.03, "along {u} the shadow at {size}³ differs by {worst}");
        }
    }
}

/// validation.md 2: σ → T → τ is the identity through the transfer function's opacity per reference length.
#[test]
fn opacity_to_extinction_to_transmittance_is_the_identity() {
    let cpu = Cpu::new(1).unwrap();
    let grid = Grid { size: [4, 4, 32], spacing: [0.5; 3], origin: [0.0; 3] };
    for opacity in [0.05f32, 0.3, 0.7] {
        let scene = Scene::load(None, &[format!("transfer.opacity=[[0,{opacity}],[1,{opacity}]]")]).unwrap();
        let table = TransferFunction::new(&scene.transfer).unwrap().table([0.0, 1.0], grid.mean_spacing());
        let rho = solve(&cpu, &grid, Vec3::Z, false, 8, &vec![table.extinction[512]; grid.len()]);
        // Between the centres of two voxels lies one reference length.
        let (a, b) = (rho[grid.index([2, 2, 3])], rho[grid.index([2, 2, 4])]);
        assert!((b / a - (1.0 - opacity)).abs() < 1e-5, "opacity {opacity}: {}", 1.0 - b / a);
    }
}
