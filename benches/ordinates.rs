//! Time of one transport pass against the time that its memory traffic needs at the machine's copy rate, and of a solve.
//! `cargo bench --bench ordinates [-- SIZE [DIRECTIONS]]`

mod common;

use std::hint::black_box;
use std::time::Instant;

use glam::Vec3;
use gloaming::Grid;
use gloaming::device::cpu::Cpu;
use gloaming::device::{Buffer, Device, Transport, Travel};
use gloaming::light::ordinates::{ScatterProblem, Scattered, ordinates};

fn main() {
    let mut given = std::env::args().filter_map(|a| a.parse().ok());
    let (size, only): (usize, Option<usize>) = (given.next().unwrap_or(128), given.next());
    let device = Cpu::new(0).unwrap();
    println!("{}, {size}³", device.name());
    let grid = Grid { spacing: [1.0 / size as f64; 3], ..Grid::new([size; 3]) };
    let n = grid.len();

    // Of arrays that no cache holds, and of some as large as those of a pass.
    let (source, mut target) = (device.alloc(2 * n).unwrap(), device.alloc(2 * n).unwrap());
    let near = common::best(9, || device.combine(&[(black_box(&source), 1.0)], &mut target).unwrap());
    let copy = [common::copy_rate(), 16.0 * n as f64 / near];
    println!("copy {:.1} GB/s, read and written; arrays of this size {:.1} GB/s", copy[0] * 1e-9, copy[1] * 1e-9);

    let cloud = |at: usize| {
        let p: [f64; 3] = std::array::from_fn(|a| (at / size.pow(a as u32) % size) as f64 / size as f64 - 0.5);
        (1.2 - 4.0 * p.iter().map(|x| x * x).sum::<f64>()).max(0.0) as f32 * 16.0
    };
    let upload = |values: Vec<f32>| -> Buffer {
        let mut buffer = device.alloc(values.len()).unwrap();
        device.upload(&values, &mut buffer).unwrap();
        buffer
    };
    let sigma = upload((0..n).map(cloud).collect());
    let source = upload((0..n).map(|i| 0.1 * cloud(i)).collect());
    let gradient: [Buffer; 3] = std::array::from_fn(|a| upload((0..n).map(|i| 0.01 * (a as f32) * cloud(i)).collect()));
    let mut phi = device.alloc(n).unwrap();
    let mut current: [Buffer; 3] = std::array::from_fn(|_| device.alloc(n).unwrap());

    for directions in [8, 32, 128].into_iter().filter(|d| only.is_none_or(|o| o == *d)) {
        let set = ordinates(directions, 0.0).unwrap();
        for linear in [false, true] {
            let (gradient, current) = (linear.then(|| gradient.each_ref()), linear.then(|| current.each_mut()));
            let transport = Transport { grid: &grid, ordinates: &set, sigma: &sigma, source: &source, gradient };
            let mut current = current;
            let time = common::best(7, || {
                let current = current.as_mut().map(|[x, y, z]| [&mut **x, &mut **y, &mut **z]);
                black_box(device.transport(&transport, &mut phi, current).unwrap());
            });
            // For each of the six pairs of axis and way along it: σ and S in, φ in and out; with a gradient six more values.
            let bytes = 6.0 * 4.0 * n as f64 * if linear { 13.0 } else { 4.0 };
            println!(
                "{directions:3} directions{:8} {:7.2} ms, {:.3} ns a voxel and direction, {:.1} × bandwidth-bound ({:.2} ms), {:.1} × at the nearer rate",
                if linear { ", g ≠ 0" } else { "" },
                time * 1e3,
                time * 1e9 / (n * directions) as f64,
                time * copy[0] / bytes,
                bytes / copy[0] * 1e3,
                time * copy[1] / bytes,
            );
        }
    }

    let scattering = upload((0..n).map(|i| 0.95 * cloud(i)).collect());
    let first = upload((0..n).map(|i| 1.0 / (1.0 + cloud(i))).collect());
    let mut solution = Scattered::new(&device, grid, 1, 0.0).unwrap();
    let problem = ScatterProblem {
        sigma: &sigma,
        scattering: std::slice::from_ref(&scattering),
        emission: &[],
        first: &[(&first, [1.0; 3], Travel::Along(Vec3::Z))],
        environment: &[],
        chromatic: [1.0; 3],
        anisotropy: 0.0,
        directions: 32,
        tolerance: 1e-3,
        warm: false,
        scattering_on: true,
        everywhere: true,
        passes: None,
        until: None,
    };
    let start = Instant::now();
    let report = solution.solve(&device, &problem).unwrap();
    println!("cold solve, ω = 0.95     {:7.1} ms, {report:?}", start.elapsed().as_secs_f64() * 1e3);
}
