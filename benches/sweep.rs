//! Direct light at 256³: voxels per second for every dominant axis, as a share of the machine's copy rate at 8 bytes a voxel
//! (σ is read, ρ is written).

mod common;

use glam::Vec3;
use gloaming::device::cpu::Cpu;
use gloaming::device::{Device, Sweep};
use gloaming::{BrickLayout, Grid};

fn main() {
    let cpu = Cpu::new(0).expect("threads");
    let copy = common::copy_rate();
    println!("{}, copy {:.1} GB/s", cpu.name(), copy * 1e-9);
    for n in [128usize, 256] {
        let grid = Grid::new([n; 3]);
        let layout = BrickLayout::new(grid.size, BrickLayout::EDGE);
        let values: Vec<f32> = (0..grid.len()).map(|i| (i % 97) as f32 * 1e-4).collect();
        let (mut sigma, mut rho) = (cpu.alloc(grid.len()).expect("memory"), cpu.alloc(grid.len()).expect("memory"));
        cpu.upload(&values, &mut sigma).expect("upload");
        for (name, u) in
            [("z", Vec3::new(0.3, 0.4, -0.8)), ("y", Vec3::new(-0.3, 0.8, 0.2)), ("x", Vec3::new(0.8, 0.4, 0.1))]
        {
            for cubic in [false, true] {
                if std::env::args()
                    .nth(1)
                    .is_some_and(|a| a != "--bench" && a != format!("{name}{}", if cubic { "c" } else { "" }))
                {
                    continue;
                }
                let sweep = Sweep::new(&grid, u.normalize(), cubic);
                let fronts = layout.fronts(sweep.ascending());
                let fronts: Vec<&[u32]> = fronts.iter().map(|f| &f[..]).collect();
                let seconds = common::best(9, || {
                    cpu.sweep(&sweep, &layout, &sigma, &mut rho, &fronts).expect("sweep");
                });
                let share = 8.0 * grid.len() as f64 / seconds / copy;
                let foot = if cubic { "cubic" } else { "bilinear" };
                println!(
                    "sweep {n}³ along {name}, {foot:8}: {:7.2} ms, {share:.2} of copy at 8 B a voxel",
                    seconds * 1e3
                );
            }
        }
    }
}
