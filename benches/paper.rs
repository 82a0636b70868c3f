//! The paper's model: diffusion against a copy of its data in the same run, and convection.

mod common;

use std::sync::Arc;

use glam::Vec3;
use gloaming::device::Device;
use gloaming::device::convection::{Convection, Layers, Opacity, Start};
use gloaming::device::cpu::Cpu;
use gloaming::field::{Dense, Timestep};
use gloaming::light::{LightSolver, LightVolume};
use gloaming::medium::Medium;
use gloaming::scene::Scene;
use gloaming::transfer::TransferFunction;
use gloaming::{BrickLayout, Grid};

fn main() {
    let cpu = Cpu::new(0).expect("threads");
    let copy = common::copy_rate();
    println!("{}, copy {:.1} GB/s", cpu.name(), copy * 1e-9);
    let wanted = std::env::args().nth(1).filter(|a| a != "--bench");
    let wants = |name: &str| wanted.as_deref().is_none_or(|w| w == name);
    for n in [64usize, 128, 256] {
        let grid = Grid::new([n; 3]);
        // Reading and writing each value once.
        let once = 8.0 * grid.len() as f64 / copy;
        if wants("diffusion") {
            diffusion(&cpu, n, once);
        }
        if wants("convection") {
            convection(&cpu, &grid, once);
        }
    }
}

/// The diffusion of a whole solve in which nothing else changes: composition (one more pass) and the heat kernel.
fn diffusion(cpu: &Cpu, n: usize, once: f64) {
    let kernel = |kappa: f64| {
        let deviation = (2.0 * kappa).sqrt();
        let mut weights: Vec<f32> = (0..=(5.0 * deviation + 1.5) as usize)
            .map(|i| (-0.5 * (i as f64 / deviation).powi(2)).exp() as f32)
            .collect();
        let mass = weights[0] + 2.0 * weights[1..].iter().sum::<f32>();
        weights.iter_mut().for_each(|w| *w /= mass);
        weights
    };
    let mut values = cpu.alloc(n * n * n).expect("memory");
    cpu.upload(&(0..n * n * n).map(|i| (i % 97) as f32).collect::<Vec<_>>(), &mut values).expect("upload");
    for sigma in [1.0, 10.0] {
        let weights = kernel(sigma);
        let seconds = common::best(9, || cpu.diffuse([n; 3], [&weights; 3], &mut values).expect("diffusion"));
        println!(
            "diffusion {n}³, σ_s {sigma:4}, {:2} values to a side: {:7.2} ms, {:5.2} times a copy",
            weights.len() - 1,
            seconds * 1e3,
            seconds / once
        );
    }
    for method in ["exact", "gauss-seidel", "multigrid"] {
        let seconds = solve(cpu, n, &["light.convection=ordered", &format!("light.diffusion={method}")]);
        println!("light {n}³, one light, {method:12}: {:7.2} ms", seconds * 1e3);
    }
}

/// A cold solve of one light over smooth data.
fn solve(cpu: &Cpu, n: usize, sets: &[&str]) -> f64 {
    let usual = ["light.model=paper", "light.resolution=1", "light.warm=false", "lights.0.direction=[0.3,0.4,-0.8]"];
    let sets: Vec<String> = usual.iter().chain(sets).map(|s| s.to_string()).collect();
    let scene = Scene::load(None, &sets).expect("scene");
    let grid = Grid::new([n; 3]);
    let transfer = TransferFunction::new(&scene.transfer).expect("transfer function");
    let mut medium = Medium::new(cpu, grid, transfer.table([0.0, 1.0], 1.0)).expect("memory");
    let values = (0..grid.len()).map(|i| ((i % n) as f32 / n as f32) * 0.2).collect();
    let field = Arc::new(Dense::new(grid.size, values));
    medium.take(cpu, &Timestep { step: 0, time: None, grid, field }).expect("values");
    medium.classify(transfer.table([0.0, 1.0], 1.0));
    let lights = gloaming::lights::resolve(&scene).expect("lights");
    let mut solver = LightSolver::new(cpu, &scene, &grid).expect("solver");
    let mut volume = LightVolume::default();
    common::best(5, || {
        solver.solve(cpu, &medium, &lights, &mut volume).expect("solve");
    })
}

fn convection(cpu: &Cpu, grid: &Grid, once: f64) {
    let values: Vec<f32> = (0..grid.len()).map(|i| (i % 97) as f32 * 1e-4).collect();
    let [mut sigma, before, mut rho] = std::array::from_fn(|_| cpu.alloc(grid.len()).expect("memory"));
    cpu.upload(&values, &mut sigma).expect("upload");
    let opacity = Opacity::Calibrated { length: 1.0 };
    for (name, u) in
        [("z", Vec3::new(0.3, 0.4, -0.8)), ("y", Vec3::new(-0.3, 0.8, 0.2)), ("x", Vec3::new(0.8, 0.4, 0.1))]
    {
        let light = Convection::distant(grid, u.normalize(), opacity);
        let layers = Layers { iterations: 5, tolerance: 0.0, start: Start::Upstream };
        let layout = BrickLayout::new(grid.size, BrickLayout::EDGE);
        let fronts = light.fronts(&layout);
        let fronts: Vec<&[u32]> = fronts.iter().map(|f| &f[..]).collect();
        let report = |what: &str, seconds: f64| {
            println!(
                "convection {}³ along {name}, {what:20}: {:7.2} ms, {:5.2} times a copy",
                grid.size[0],
                seconds * 1e3,
                seconds / once
            );
        };
        report(
            "5 a layer",
            common::best(7, || {
                cpu.convect_layers(&light, layers, &sigma, &before, &mut rho).expect("convection");
            }),
        );
        report(
            "all voxels at once",
            common::best(7, || {
                cpu.convect_whole(&light, &sigma, &before, &mut rho).expect("convection");
            }),
        );
        report(
            "ordered",
            common::best(7, || {
                cpu.convect_ordered(&light, &layout, &sigma, &mut rho, &fronts).expect("convection");
            }),
        );
    }
}
