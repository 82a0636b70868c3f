//! Scattered light: the transport kernel, the solver, and both against known answers.

use glam::Vec3;
use gloaming::Grid;
use gloaming::device::cpu::Cpu;
use gloaming::device::{Buffer, Device, Ordinate, Transport};

fn upload(device: &dyn Device, values: &[f32]) -> Buffer {
    let mut buffer = device.alloc(values.len()).unwrap();
    device.upload(values, &mut buffer).unwrap();
    buffer
}

/// Numbers in [0, 1) that depend only on the seed.
fn noise(n: usize, seed: u64) -> Vec<f32> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 40) as f32 / (1u64 << 24) as f32
    };
    (0..n).map(|_| next()).collect()
}

/// Directions in general position, one along an axis, and one that is a tie between axes.
fn directions() -> Vec<Ordinate> {
    let mut all = vec![Vec3::new(0.0, 0.0, -1.0), Vec3::new(1.0, -1.0, 1.0), Vec3::new(-1.0, 0.3, 0.0)];
    all.extend((0..40).map(|i| {
        let (z, a) = (((i * 7) % 40) as f32 / 20.0 - 0.97, i as f32 * 2.4);
        Vec3::new((1.0 - z * z).sqrt() * a.cos(), (1.0 - z * z).sqrt() * a.sin(), z)
    }));
    let number = |i: usize| 0.2 + (i % 5) as f32 / 9.0;
    let one = |(i, d): (usize, Vec3)| Ordinate { direction: d.normalize(), weight: number(i), inflow: number(i / 3) };
    all.into_iter().enumerate().map(one).collect()
}

/// What the kernel must compute, voxel by voxel in f64: φ and J.
fn reference(
    grid: &Grid,
    ordinates: &[Ordinate],
    sigma: &[f32],
    source: &[f32],
    gradient: Option<[&[f32]; 3]>,
) -> [Vec<f64>; 4] {
    let mut sums: [Vec<f64>; 4] = std::array::from_fn(|_| vec![0.0; grid.len()]);
    for o in ordinates {
        let u = o.direction.as_dvec3();
        let d: [f64; 3] = std::array::from_fn(|a| u[a] / grid.spacing[a]);
        let axis = (0..3).max_by(|&a, &b| d[a].abs().total_cmp(&d[b].abs()).then(b.cmp(&a))).unwrap();
        let emitted = |i: usize| match gradient {
            Some(g) => (f64::from(source[i]) + (0..3).map(|a| u[a] * f64::from(g[a][i])).sum::<f64>()).max(0.0),
            None => f64::from(source[i]),
        };
        let length = 1.0 / d[axis].abs();
        let mut radiance = vec![0.0; grid.len()];
        for l in 0..grid.size[axis] {
            let layer = if d[axis] > 0.0 { l } else { grid.size[axis] - 1 - l };
            let (b, c) = ([1, 0, 0][axis], [2, 2, 1][axis]);
            for p in 0..grid.size[b] {
                for q in 0..grid.size[c] {
                    let mut at = [0; 3];
                    (at[axis], at[b], at[c]) = (layer, p, q);
                    let i = grid.index(at);
                    let sigma_here = f64::from(sigma[i]);
                    let (mut up, mut sigma_up, mut s_up) = (f64::from(o.inflow), 0.0, emitted(i));
                    if l > 0 {
                        (up, s_up) = (0.0, 0.0);
                        let (foot_b, foot_c) = (p as f64 - d[b] / d[axis].abs(), q as f64 - d[c] / d[axis].abs());
                        for (db, dc) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                            let (pb, pc) = (foot_b.floor() + f64::from(db), foot_c.floor() + f64::from(dc));
                            let w = (1.0 - (foot_b - pb).abs()) * (1.0 - (foot_c - pc).abs());
                            let inside = pb >= 0.0 && pc >= 0.0 && pb < grid.size[b] as f64 && pc < grid.size[c] as f64;
                            let mut from = at;
                            from[axis] = if d[axis] > 0.0 { layer - 1 } else { layer + 1 };
                            (from[b], from[c]) = (pb as usize, pc as usize);
                            let values = if inside {
                                let j = grid.index(from);
                                [radiance[j], f64::from(sigma[j]), emitted(j)]
                            } else {
                                [f64::from(o.inflow), 0.0, f64::from(o.inflow)]
                            };
                            (up, sigma_up, s_up) = (up + w * values[0], sigma_up + w * values[1], s_up + w * values[2]);
                        }
                    }
                    let tau = 0.5 * length * (sigma_up + sigma_here);
                    let e = (-tau).exp();
                    let (w0, w1) =
                        if tau < 1e-6 { (tau / 2.0, tau / 2.0) } else { (1.0 - (1.0 - e) / tau, (1.0 - e) / tau - e) };
                    radiance[i] = up * e + w0 * emitted(i) + w1 * s_up;
                }
            }
        }
        for i in 0..grid.len() {
            sums[0][i] += f64::from(o.weight) * radiance[i];
            for a in 0..3 {
                sums[a + 1][i] += f64::from(o.weight) * u[a] * radiance[i];
            }
        }
    }
    sums
}

/// Runs the kernel; returns φ, J and what it reports.
fn pass(
    device: &dyn Device,
    grid: &Grid,
    ordinates: &[Ordinate],
    fields: &[&[f32]],
    before: &[f32],
) -> ([Vec<f32>; 4], (f32, f32)) {
    let buffers: Vec<Buffer> = fields.iter().map(|f| upload(device, f)).collect();
    let mut phi = upload(device, before);
    let mut current: [Buffer; 3] = std::array::from_fn(|_| device.alloc(grid.len()).unwrap());
    let gradient = (buffers.len() > 2).then(|| [&buffers[2], &buffers[3], &buffers[4]]);
    let transport = Transport { grid, ordinates, sigma: &buffers[0], source: &buffers[1], gradient };
    let report = device.transport(&transport, &mut phi, Some(current.each_mut())).unwrap();
    let [x, y, z] = &current;
    let out = [&phi, x, y, z].map(|b| {
        let mut values = vec![0.0; grid.len()];
        device.download(b, &mut values).unwrap();
        values
    });
    (out, report)
}

#[test]
fn a_pass_is_what_the_equation_says_on_any_grid() {
    let device = Cpu::new(2).unwrap();
    for size in [[1, 1, 1], [37, 21, 45], [16, 70, 33], [5, 1, 18]] {
        let grid = Grid { size, spacing: [0.9, 1.1, 1.3], origin: [0.0; 3] };
        let n = grid.len();
        let [sigma, source, x, y, z, before] = std::array::from_fn(|f| noise(n, f as u64 + 1));
        let sigma: Vec<f32> = sigma.iter().map(|s| if *s < 0.3 { 0.0 } else { 2.0 * s * s }).collect();
        let linear = [&sigma[..], &source, &x, &y, &z];
        for fields in [&linear[..2], &linear[..]] {
            let gradient = (fields.len() > 2).then(|| [&x[..], &y, &z]);
            let expected = reference(&grid, &directions(), &sigma, &source, gradient);
            let (got, (change, peak)) = pass(&device, &grid, &directions(), fields, &before);
            let largest = expected[0].iter().fold(0.0f64, |m, v| m.max(*v));
            for (e, g) in expected.iter().zip(&got) {
                let worst = e.iter().zip(g).map(|(e, g)| (e - f64::from(*g)).abs()).fold(0.0, f64::max);
                assert!(worst < 2e-6 * largest, "{size:?}, {} fields: {worst} of {largest}", fields.len());
            }
            let max = |f: &dyn Fn(usize) -> f32| (0..n).map(f).fold(0.0, f32::max);
            assert_eq!((change, peak), (max(&|i| (got[0][i] - before[i]).abs()), max(&|i| got[0][i])));
        }
    }
}

#[test]
fn a_pass_does_not_depend_on_the_number_of_threads() {
    let grid = Grid::new([40, 75, 90]);
    let fields: [Vec<f32>; 5] = std::array::from_fn(|f| noise(grid.len(), f as u64 + 9));
    let fields = fields.each_ref().map(|f| &f[..]);
    for fields in [&fields[..2], &fields[..]] {
        let run = |threads| pass(&Cpu::new(threads).unwrap(), &grid, &directions(), fields, fields[0]);
        let alone = run(1);
        for threads in [2, 3, 8] {
            assert!(run(threads) == alone, "{threads} threads");
        }
    }
}
