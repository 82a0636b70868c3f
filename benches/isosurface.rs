//! Isosurface layers of smoke: preview against final quality, pass by pass, and time against the size of the volume; the best of
//! several runs. The shape to meet is table 1 of Rezk-Salama 2007: final about 12 times preview, occlusion 12, subsurface
//! scattering 20 to 30, and time that hardly depends on the volume's size.
//!
//! `cargo bench --bench isosurface [-- --quick]`

#[path = "common/smoke.rs"]
mod smoke;

use std::time::Instant;

use glam::Vec3;
use gloaming::BrickLayout;
use gloaming::camera::Camera;
use gloaming::device::cpu::Cpu;
use gloaming::device::surface::{
    Attenuation, Beauty, Environment, Estimator, Hit, Map, Occlusion, Samples, Subsurface, Surface, Surfaces, distances,
};
use gloaming::device::{Buffer, Device};
use gloaming::grid::Grid;

/// Seconds, the best of `runs`.
fn best(runs: usize, mut run: impl FnMut()) -> f64 {
    (0..runs)
        .map(|_| {
            let start = Instant::now();
            run();
            start.elapsed().as_secs_f64()
        })
        .fold(f64::INFINITY, f64::min)
}

/// Seconds of the passes.
struct Times {
    hits: f64,
    beauty: [f64; 2],
    occlusion: [f64; 2],
    subsurface: [[f64; 2]; 2],
    count: usize,
}

fn to(end: u32) -> Samples {
    Samples { first: 0, end }
}

fn measure(cpu: &Cpu, n: usize, picture: [usize; 2], runs: usize) -> gloaming::Result<Times> {
    let (grid, values) = smoke::smoke(n)?;
    let mut field = cpu.alloc(values.len())?;
    cpu.upload(&values, &mut field)?;
    let bricks = BrickLayout::new(grid.size, 8);
    let isovalues = [0.15, 0.5];
    let empty = distances(&bricks, &cpu.brick_range(&bricks, &field)?, &isovalues);
    let surface = |value| Surface {
        value,
        diffuse: [0.6; 3],
        specular: 0.1,
        exponent: 40.0,
        exponent_gradient: 0.0,
        opacity: 0.5,
        transmission: 0.3,
        spread: 10.0,
        ior: 1.4,
    };
    let solids = isovalues.map(surface);
    let (lo, hi) = grid.bounds();
    let centre = (0.5 * (lo + hi)).as_vec3();
    let camera = Camera::look_at(centre + Vec3::new(90.0, -150.0, 60.0), centre, Vec3::Z, 30.0);
    let surfaces = Surfaces {
        grid: &grid,
        field: &field,
        bricks,
        empty: &empty,
        surfaces: &solids,
        clips: &[],
        step: 0.5 * grid.mean_spacing() as f32,
        camera: &camera,
        picture,
    };
    let sky = Map::tabulate(256, |at| Vec3::splat(1.0 + 0.5 * Map::direction((at + 0.5) / 256.0).z));
    let texels: Buffer = {
        let mut buffer = cpu.alloc(sky.len())?;
        cpu.upload(&sky, &mut buffer)?;
        buffer
    };
    let environment = Environment { texels: &texels, radiance: Map { first: 0, edge: 256 }, filtered: None };

    let rays: Vec<Hit> = (0..(picture[0] * picture[1]) as u32).map(Hit::ray).collect();
    let mut hits = rays.clone();
    let first = best(runs, || {
        hits.copy_from_slice(&rays);
        cpu.surface_hits(&surfaces, &mut hits).expect("hits");
    });
    hits.retain(|hit| hit.surface != Hit::NONE);
    let count = hits.len();
    let estimator = Estimator::Normalised;
    let beauty = [(8, 16), (64, 128)].map(|(diffuse, specular)| {
        let beauty =
            Beauty { environment, diffuse: to(diffuse), specular: to(specular), bent: &[], estimator, seed: 0 };
        let mut sums = vec![[[0.0; 3]; 2]; count];
        best(runs, || cpu.surface_beauty(&surfaces, &beauty, &hits, &mut sums).expect("beauty"))
    });
    // The published rays are as long in either quality.
    let radius = 12.0 * Grid::new([96; 3]).mean_spacing() as f32;
    let occlusion = [(32, 10), (128, 20)].map(|(rays, steps)| {
        let occlusion = Occlusion { radius, steps, estimator, seed: 0 };
        let mut sums = vec![[0.0; 4]; count];
        best(runs, || cpu.surface_occlusion(&surfaces, &occlusion, to(rays), &hits, &mut sums).expect("occlusion"))
    });
    let subsurface = [true, false].map(|fast| {
        [(4, 4), (64, 16)].map(|(primary, secondary)| {
            let of = Subsurface {
                environment,
                primary: to(primary),
                secondary,
                fast,
                refracts: false,
                attenuation: Attenuation { rate: [0.01; 3], table: None },
                estimator,
                seed: 0,
            };
            let mut sums = vec![[0.0; 3]; count];
            let runs = if primary > 4 { 1 } else { runs };
            best(runs, || cpu.surface_subsurface(&surfaces, &of, &hits, &mut sums).expect("subsurface"))
        })
    });
    Ok(Times { hits: first, beauty, occlusion, subsurface, count })
}

fn main() -> gloaming::Result<()> {
    let quick = std::env::args().any(|a| a == "--quick");
    let (runs, picture) = if quick { (2, [160, 120]) } else { (3, [320, 240]) };
    let cpu = Cpu::new(0)?;
    println!("{}, {} x {} pixels; ms, preview and final", cpu.name(), picture[0], picture[1]);
    println!("volume   hits  first hit       beauty            occlusion         subsurface         all      ratios");
    println!("subsurface scattering fast, then accurate");
    for n in [64, 128, 256] {
        let t = measure(&cpu, n, picture, runs)?;
        let ms = |t: [f64; 2]| format!("{:7.1} {:8.1}", 1e3 * t[0], 1e3 * t[1]);
        let ratio = |t: [f64; 2]| t[1] / t[0];
        for subsurface in t.subsurface {
            let all = [0, 1].map(|q| t.hits + t.beauty[q] + t.occlusion[q] + subsurface[q]);
            println!(
                "{n:>4}³ {:>7} {:>8.1} {} {} {} {}   {:.1} {:.1} {:.1} {:.1}",
                t.count,
                1e3 * t.hits,
                ms(t.beauty),
                ms(t.occlusion),
                ms(subsurface),
                ms(all),
                ratio(t.beauty),
                ratio(t.occlusion),
                ratio(subsurface),
                ratio(all)
            );
        }
    }
    Ok(())
}
