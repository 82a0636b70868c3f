//! The light buffer, which nobody outside sees.

use glam::{DVec3, Vec3};

use super::*;
use crate::camera::Camera;
use crate::device::cpu::Cpu;
use crate::device::slices::{Projection, Slicing};
use crate::device::{Buffer, Device, Storage, Weight};
use crate::field::EMPTY;
use crate::grid::{BrickLayout, Grid};
use crate::transfer::Table;

fn table(sigma: f32) -> Table {
    let last = (Table::ENTRIES - 1) as f32;
    Table {
        chromatic: [1.0, 0.5, 0.25],
        lo: 0.0,
        hi: 1.0,
        extinction: (0..Table::ENTRIES).map(|i| sigma * i as f32 / last).collect(),
        albedo: vec![[0.9, 0.8, 0.7]; Table::ENTRIES],
        ..Default::default()
    }
}

/// Clumps with holes.
fn clumps(grid: &Grid) -> Vec<f32> {
    let at = |i: usize| [i % grid.size[0], i / grid.size[0] % grid.size[1], i / (grid.size[0] * grid.size[1])];
    (0..grid.len())
        .map(|i| {
            let [x, y, z] = at(i).map(|c| c as f32 * 0.7);
            if i % 97 == 0 { EMPTY } else { (x.sin() * (1.3 * y).cos() + (0.8 * z).sin() - 0.3).max(0.0) }
        })
        .collect()
}

fn pass<'a>(grid: &'a Grid, field: &'a Buffer, table: &'a Table, parallel: bool) -> Slices<'a> {
    let camera = Camera::look_at(Vec3::new(30.0, -40.0, 20.0), Vec3::splat(8.0), Vec3::Z, 30.0);
    let eye = Projection::of(&camera, [32, 24]);
    let axis = DVec3::new(0.3, 0.9, -0.2).normalize();
    let view = Projection {
        origin: DVec3::new(8.0, -18.0, 12.0),
        forward: DVec3::Y * if parallel { 1.0 } else { 10.0 },
        right: DVec3::X * 14.0,
        down: DVec3::new(0.0, 0.0, -14.0),
        parallel,
    };
    Slices {
        grid,
        field,
        gradient: None,
        table,
        bricks: BrickLayout::new(grid.size, 4),
        majorant: &[],
        slicing: Slicing::new(grid, axis, 0.6),
        under: true,
        eye,
        picture: [32, 24],
        window: [[0, 32], [0, 24]],
        unshadowed: &[],
        beam: Some(Beam {
            weight: Weight::Phase { direction: Vec3::Y, irradiance: [1.0; 3], g: 0.0 },
            view,
            size: [32, 32],
            inner: [f64::INFINITY; 2],
            start: None,
            attenuation: [1.0; 3],
            blur: 0.0,
            opaque: &[],
        }),
        glows: true,
        phong: None,
        clips: &[],
    }
}

fn buffers(slices: &Slices) -> Vec<Vec<f32>> {
    let mut rays = vec![Ray::FRESH; slices.picture[0] * slices.picture[1]];
    let mut all = vec![];
    slice_watched(slices, &mut rays, |_, front| all.push(front.to_vec()));
    assert!(rays.iter().all(|r| r.radiance.iter().chain(&r.transmittance).all(|v| v.is_finite())));
    all
}

/// Behind every slice there is no more light than before it, in any texel; where it blurs, no texel is brighter than the brightest
/// was (validation.md 13).
#[test]
fn the_light_buffer_never_grows() {
    let grid = Grid::new([16; 3]);
    let (field, table) = (Buffer(Storage::Host(clumps(&grid))), table(0.4));
    for parallel in [true, false] {
        for blur in [0.0, 0.05, 3.0] {
            let mut slices = pass(&grid, &field, &table, parallel);
            slices.beam.as_mut().unwrap().blur = blur;
            let all = buffers(&slices);
            assert!(all.len() > 3);
            let brightest = |b: &[f32]| b.iter().copied().fold(0.0, f32::max);
            assert!(brightest(&all[0]) <= 1.0);
            for pair in all.windows(2) {
                assert!(brightest(&pair[1]) <= brightest(&pair[0]));
                assert!(blur > 0.0 || pair[0].iter().zip(&pair[1]).all(|(before, after)| after <= before));
            }
            let darkest = all[all.len() - 1].iter().copied().fold(1.0, f32::min);
            assert!((0.0..0.7).contains(&darkest), "the clumps cast a shadow: {darkest}");
        }
    }
}

/// Parallel light along an axis of a homogeneous box leaves it dimmed by Beer and Lambert's law, whatever the slices' tilt.
#[test]
fn light_is_dimmed_by_the_exact_path() {
    let grid = Grid::new([16; 3]);
    let (field, table) = (Buffer(Storage::Host(vec![1.0; grid.len()])), table(0.1));
    let all = buffers(&pass(&grid, &field, &table, true));
    let last = &all[all.len() - 1];
    let mut inside = 0;
    for y in 0..32 {
        for x in 0..32 {
            let at = |i: usize| 14.0 * (2.0 * (i as f64 + 0.5) / 32.0 - 1.0);
            let (px, pz) = (8.0 + at(x), 12.0 - at(y));
            if !(-0.49..15.49).contains(&px) || !(-0.49..15.49).contains(&pz) {
                continue;
            }
            inside += 1;
            for (c, factor) in [1.0, 0.5, 0.25].into_iter().enumerate() {
                let value = f64::from(last[(y * 3 + c) * 32 + x]);
                // Sums of forty intervals of about half a world length, each rounded to 1e-7 of the box.
                assert!((value - (-0.1f64 * factor * 16.0).exp()).abs() < 2e-5, "({x}, {y}): {value}");
            }
        }
    }
    assert!(inside > 200);
}

/// Blur moves no light in the mean, and spreads an edge with the variance that was asked for.
#[test]
fn blur_has_the_variance_of_its_disk() {
    let grid = Grid::new([16; 3]);
    let (field, table) = (Buffer(Storage::Host(vec![0.0; grid.len()])), table(0.0));
    let start: Vec<[f32; 3]> =
        (0..32 * 32).map(|i| [if i % 32 == 16 && i / 32 == 20 { 1.0 } else { 0.0 }; 3]).collect();
    for blur in [0.02, 0.15] {
        let mut slices = pass(&grid, &field, &table, true);
        let beam = slices.beam.as_mut().unwrap();
        (beam.blur, beam.start) = (blur, Some(&start[..]));
        let all = buffers(&slices);
        let last = &all[all.len() - 1];
        let value = |x: usize, y: usize| f64::from(last[(y * 3) * 32 + x]);
        let sum: f64 = (0..32 * 32).map(|i| value(i % 32, i / 32)).sum();
        // Where rays enter and leave the box, neighbours blur by a little more or less.
        assert!((sum - 1.0).abs() < 5e-3, "{sum}");
        let texel = 28.0 / 32.0;
        let variance: f64 =
            (0..32 * 32).map(|i| value(i % 32, i / 32) * (texel * (i as f64 % 32.0 - 16.0)).powi(2)).sum::<f64>() / sum;
        // The light goes 16 through the box.
        assert!((variance / (16.0 * blur) - 1.0).abs() < 0.02, "{variance} for {blur}");
    }
}

/// Skipping empty bricks, the number of threads and the instruction set change no bit.
#[test]
fn what_is_skipped_was_empty() {
    let grid = Grid { size: [21, 16, 30], spacing: [0.8, 1.0, 0.5], origin: [0.0; 3] };
    let values: Vec<f32> = clumps(&grid).iter().enumerate().map(|(i, v)| if i < 5000 { 0.0 } else { *v }).collect();
    let cpu = Cpu::new(2).unwrap();
    let (field, table) = (Buffer(Storage::Host(values)), table(0.4));
    let bricks = BrickLayout::new(grid.size, 4);
    let majorant = table.majorants(&cpu.brick_range(&bricks, &field).unwrap());
    assert!(majorant.contains(&0.0));
    for under in [true, false] {
        let mut whole = pass(&grid, &field, &table, false);
        if !under {
            whole.slicing = Slicing::new(&grid, DVec3::new(-0.8, 0.3, -0.5).normalize(), 0.6);
            whole.under = false;
            whole.eye.origin = DVec3::new(-30.0, 10.0, -4.0);
            whole.eye.forward = DVec3::X;
            whole.eye.right = DVec3::new(0.0, -0.5, 0.0);
            whole.eye.down = DVec3::new(0.0, 0.0, -0.5);
        }
        let skipping = Slices { majorant: &majorant, bricks, ..whole };
        let [all, some] = [&whole, &skipping].map(|slices| {
            let mut rays = vec![Ray::FRESH; 32 * 24];
            slice(slices, &mut rays);
            rays
        });
        assert!(all.iter().any(|r| r.transmittance[0] < 0.5));
        assert_eq!(all, some);
    }
}
