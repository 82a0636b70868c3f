//! Ray casting 512² through smoke on 256³, lit by one distant light on the same grid: SIMD against its scalar twin, with and
//! without skipping, best of several in one run, beside the machine's copy rate.
//!
//! `cargo bench --bench raycast [-- --quick]`

use std::hint::black_box;
use std::time::Instant;

use glam::Vec3;
use gloaming::camera::Camera;
use gloaming::device::cpu::{Cpu, march};
use gloaming::device::{Buffer, Device, March, Optic, Sweep, Term, Weight};
use gloaming::frame::Frame;
use gloaming::grid::BrickLayout;
use gloaming::transfer::Table;
use rayon::prelude::*;

#[path = "common/smoke.rs"]
mod smoke;

const SIZE: usize = 256;
const PICTURE: [usize; 2] = [512, 512];

/// Seconds, the best of `runs`.
fn best(runs: usize, mut f: impl FnMut()) -> f64 {
    (0..runs)
        .map(|_| {
            let start = Instant::now();
            f();
            start.elapsed().as_secs_f64()
        })
        .fold(f64::INFINITY, f64::min)
}

fn main() -> gloaming::Result<()> {
    let quick = std::env::args().any(|a| a == "--quick");
    let runs = if quick { 3 } else { 15 };
    let cpu = Cpu::new(0)?;
    println!("{}", cpu.name());

    let (grid, values) = smoke::smoke(SIZE)?;
    let ramp = |i: usize| i as f32 / (Table::ENTRIES - 1) as f32;
    let table = Table {
        chromatic: [1.0; 3],
        lo: 0.0,
        hi: 1.0,
        extinction: (0..Table::ENTRIES).map(|i| 0.6 * ramp(i)).collect(),
        albedo: vec![[0.8, 0.7, 0.6]; Table::ENTRIES],
        ..Default::default()
    };
    let upload = |values: &[f32]| -> gloaming::Result<Buffer> {
        let mut buffer = cpu.alloc(values.len())?;
        cpu.upload(values, &mut buffer)?;
        Ok(buffer)
    };
    let field = upload(&values)?;
    let mut sigma = cpu.alloc(grid.len())?;
    cpu.classify(Optic::Extinction, &table, grid.size, &field, grid.size, &mut sigma)?;
    let direction = Vec3::new(-0.5, -0.4, -1.0).normalize();
    let sweep = Sweep::new(&grid, direction, false);
    let layout = BrickLayout::new(grid.size, BrickLayout::EDGE);
    let fronts = layout.fronts(sweep.ascending());
    let mut light = cpu.alloc(grid.len())?;
    cpu.sweep(&sweep, &layout, &sigma, &mut light, &fronts.iter().map(Vec::as_slice).collect::<Vec<_>>())?;

    let terms = [Term {
        values: &light,
        grid: &grid,
        weight: Weight::Phase { direction, irradiance: [3.0, 2.9, 2.7], g: 0.3 },
    }];
    let centre = Vec3::splat(47.5);
    let camera = Camera::look_at(centre + Vec3::new(90.0, -150.0, 60.0), centre, Vec3::Z, 35.0);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(cpu.threads()).build().expect("threads");
    let mut frame = Frame::new(PICTURE);

    let copied = vec![1.0f32; 64 << 20];
    let mut target = vec![0.0f32; copied.len()];
    let seconds = best(runs, || {
        pool.install(|| {
            target.par_chunks_mut(1 << 20).zip(copied.par_chunks(1 << 20)).for_each(|(t, c)| t.copy_from_slice(c))
        });
        black_box(&mut target);
    });
    println!("copy rate {:.1} GB/s (read + written)", 8e-9 * copied.len() as f64 / seconds);

    println!("bricks      SIMD ms   scalar ms   scalar/SIMD");
    for edge in [None, Some(8), Some(16), Some(32)] {
        let bricks = BrickLayout::new(grid.size, edge.unwrap_or(BrickLayout::EDGE));
        let ranges = cpu.brick_range(&bricks, &field)?;
        let majorant: Vec<f32> =
            if edge.is_some() { ranges.iter().map(|r| 0.6 * r[1].max(0.0)).collect() } else { vec![] };
        let march = March {
            grid: &grid,
            field: &field,
            gradient: None,
            table: &table,
            bricks,
            majorant: &majorant,
            terms: &terms,
            phong: None,
            camera: &camera,
            clips: &[],
            step: (0.5 * grid.mean_spacing()) as f32,
        };
        // Interleaved, so that a neighbour on the machine slows both.
        let (mut simd, mut scalar) = (f64::INFINITY, f64::INFINITY);
        for _ in 0..runs {
            simd = simd.min(best(1, || pool.install(|| march::march(&march, &mut frame))));
            scalar = scalar.min(best(1, || pool.install(|| march::march_scalar(&march, &mut frame))));
        }
        let edge = edge.map_or("none".into(), |e| format!("{e}³"));
        println!("{edge:<8} {:>10.1} {:>11.1} {:>13.2}", 1e3 * simd, 1e3 * scalar, scalar / simd);
    }
    Ok(())
}
