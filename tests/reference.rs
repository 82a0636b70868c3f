//! The picture with all orders of scattering against Monte Carlo (light.md, measured on the scene whose single scattering is
//! known): direct light at data resolution with
//! cubic feet, 32 ordinates at half. Bilinear feet leave 1.3e-3.

use std::sync::Arc;

use glam::DVec3;
use gloaming::Grid;
use gloaming::camera::Camera;
use gloaming::device::cpu::Cpu;
use gloaming::field::{Dense, Timestep};
use gloaming::scene::Scene;
use gloaming::session::Session;
use rayon::prelude::*;

#[path = "common/monte_carlo.rs"]
#[allow(dead_code)]
mod monte_carlo;

use monte_carlo::{Lamp, Medium};

const SIZE: usize = 256;
/// Every so many pixels are traced, along both axes.
const EVERY: usize = 8;
const PATHS: usize = 2500;

const SCENE: [&str; 11] = [
    "light.interpolation=cubic",
    "field.range=[0.0, 1.0]",
    "transfer.colormap=white",
    "transfer.extinction=30.0",
    "transfer.albedo=0.8",
    "lights.0.direction=[0.6, 0.4, -0.7]",
    "lights.0.intensity=3.14159265",
    "cameras.0.position=[0.5, -2.0, 0.55]",
    "cameras.0.target=[0.5, 0.5, 0.5]",
    "cameras.0.fov=28.0",
    "render.size=[256, 256]",
];

fn density() -> Vec<f32> {
    let file = hdf5::File::open(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/plume_128.h5")).unwrap();
    file.dataset("density").unwrap().read_raw().unwrap()
}

/// Trilinear between voxel centres, clamped at the border of the box.
fn trilinear(density: &[f32], p: DVec3) -> f64 {
    let at = (p * 128.0 - 0.5).clamp(DVec3::ZERO, DVec3::splat(127.0));
    let low = at.floor().min(DVec3::splat(126.0));
    let t = at - low;
    let [x, y, z] = low.to_array().map(|v| v as usize);
    let row = |y: usize, z: usize| {
        let i = (z * 128 + y) * 128 + x;
        f64::from(density[i]) * (1.0 - t.x) + f64::from(density[i + 1]) * t.x
    };
    let layer = |z: usize| row(y, z) * (1.0 - t.y) + row(y + 1, z) * t.y;
    layer(z) * (1.0 - t.z) + layer(z + 1) * t.z
}

/// RMSE over every eighth pixel, the noise of the reference taken out: at most 1e-3, 3.4 % of the mean.
#[test]
fn all_orders_of_scattering_within_a_thousandth() {
    let density = density();
    let sets: Vec<String> = SCENE.iter().map(|s| s.to_string()).collect();
    let scene = Scene::load(None, &sets).unwrap();
    let camera = &scene.cameras[0];
    let camera = Camera::look_at(
        DVec3::from(camera.position.unwrap()).as_vec3(),
        DVec3::from(camera.target.unwrap()).as_vec3(),
        glam::Vec3::Z,
        28.0,
    );
    let mut session = Session::new(Arc::new(Cpu::new(0).unwrap()), scene, None, false).unwrap();
    let grid = Grid { size: [128; 3], spacing: [1.0 / 128.0; 3], origin: [0.5 / 128.0; 3] };
    let field = Arc::new(Dense::new(grid.size, density.clone()));
    let output = session.advance(Timestep { step: 0, time: None, grid, field }).unwrap();
    let picture = &output.frames[0].frame.pixels;

    let extinction = |p: DVec3| 30.0 * trilinear(&density, p);
    let medium = Medium { extinction: &extinction, majorant: 30.0, albedo: 0.8, anisotropy: 0.0 };
    let lamp = Lamp::Distant { direction: DVec3::new(0.6, 0.4, -0.7).normalize(), irradiance: std::f64::consts::PI };
    let pixels: Vec<[usize; 2]> =
        (3..SIZE).step_by(EVERY).flat_map(|y| (3..SIZE).step_by(EVERY).map(move |x| [x, y])).collect();
    let traced: Vec<(f64, f64)> = pixels
        .par_iter()
        .map(|&[x, y]| {
            let way = camera.ray([SIZE; 2], x as f32, y as f32).as_dvec3().normalize();
            monte_carlo::radiance(&medium, lamp, camera.eye.as_dvec3(), way, PATHS, (y * SIZE + x) as u64)
        })
        .collect();
    let n = pixels.len() as f64;
    let mean = traced.iter().map(|t| t.0).sum::<f64>() / n;
    let noise = traced.iter().map(|t| t.1 * t.1).sum::<f64>() / n;
    let difference = pixels.iter().zip(&traced).map(|([x, y], t)| (f64::from(picture[y * SIZE + x][0]) - t.0).powi(2));
    let rmse = (difference.sum::<f64>() / n - noise).max(0.0).sqrt();
    println!(
        "RMSE {rmse:.2e} of mean {mean:.4} ({:.1} %), noise {:.1e}, {} iterations",
        1e2 * rmse / mean,
        noise.sqrt(),
        output.row.iterations
    );
    assert!(noise.sqrt() < 1.5e-3, "the reference is too noisy: {}", noise.sqrt());
    assert!(rmse <= 1e-3 && rmse <= 0.034 * mean, "RMSE {rmse}, mean {mean}");
    // The brightness as a whole, within four standard errors and the error of 32 directions.
    let brightness = pixels.iter().map(|[x, y]| f64::from(picture[y * SIZE + x][0])).sum::<f64>() / n;
    assert!((brightness / mean - 1.0).abs() < 0.02 + 4.0 * noise.sqrt() / n.sqrt() / mean, "{brightness} for {mean}");
}
