//! Half-angle slices against ray casting with the light volume, on smoke: how far the pictures are from each other for lights from
//! every side, across l·v = 0, and what a frame takes, light included, in the same run.
//!
//! `cargo bench --bench slices`

use std::sync::Arc;
use std::time::Instant;

use gloaming::device::cpu::Cpu;
use gloaming::frame::Frame;
use gloaming::scene::Scene;
use gloaming::session::Session;
use gloaming::source::{self, SourceSpec};

const COMMON: [&str; 8] = [
    "transfer.colormap=white",
    "transfer.opacity=[[0, 0], [1, 0.1]]",
    "light.scattering=false",
    "light.interpolation=cubic",
    "light.warm=false",
    "render.size=[512, 512]",
    "field.range=[0, 1]",
    "render.step=0.5",
];

/// Directions in the plane of the view and the picture's right, at an angle to the view.
fn direction(degrees: f64) -> String {
    let (azimuth, elevation) = (30f64.to_radians(), 20f64.to_radians());
    let view = [-azimuth.sin() * elevation.cos(), azimuth.cos() * elevation.cos(), -elevation.sin()];
    let right = [azimuth.cos(), azimuth.sin(), 0.0];
    let (sin, cos) = degrees.to_radians().sin_cos();
    let l: Vec<String> = (0..3).map(|a| (cos * view[a] + sin * right[a]).to_string()).collect();
    format!("lights.0.direction=[{}]", l.join(", "))
}

fn relative_rmse(a: &Frame, b: &Frame) -> f64 {
    let pixels = || a.pixels.iter().zip(&b.pixels).flat_map(|(a, b)| (0..3).map(move |c| (a[c], b[c])));
    let square: f64 = pixels().map(|(a, b)| f64::from(a - b).powi(2)).sum();
    let mean = pixels().map(|(_, b)| f64::from(b)).sum::<f64>() / pixels().count() as f64;
    (square / pixels().count() as f64).sqrt() / mean
}

fn main() -> gloaming::Result<()> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/smoke.h5");
    let spec = SourceSpec { series: vec![path.into()], field: Some("density".into()), ..Default::default() };
    let series = source::open(&spec)?;
    let cpu = Arc::new(Cpu::new(0)?);
    println!("{}, {path}, step 40 of {}", gloaming::device::Device::name(&*cpu), series.info().steps.len());
    let shot = |more: &[&str], runs: usize| -> gloaming::Result<(Frame, f64)> {
        let sets: Vec<String> = COMMON.iter().chain(more).map(|s| s.to_string()).collect();
        let mut session = Session::new(cpu.clone(), Scene::parse("", "scene", &sets)?, None, false)?;
        let mut least = f64::INFINITY;
        let mut frame = None;
        for _ in 0..runs {
            let step = series.timestep(40)?;
            let begun = Instant::now();
            frame = Some(session.advance(step)?.frames.remove(0).frame);
            least = least.min(begun.elapsed().as_secs_f64());
        }
        Ok((frame.expect("a run"), least))
    };
    println!("angle l·v   relative RMSE   ray casting ms   slices ms");
    for degrees in [0.0, 45.0, 85.0, 95.0, 135.0, 180.0] {
        let light = direction(degrees);
        let (cast, cast_time) = shot(&[&light, "render.kind=raycast"], 5)?;
        let (sliced, sliced_time) = shot(&[&light, "render.kind=slices"], 5)?;
        let error = relative_rmse(&sliced, &cast);
        println!("{degrees:8}°   {error:13.4}   {:14.1}   {:9.1}", 1e3 * cast_time, 1e3 * sliced_time);
    }
    let around: Vec<Frame> = [88.5, 89.5, 90.5, 91.5]
        .map(|d| shot(&[&direction(d), "render.kind=slices"], 1).map(|s| s.0))
        .into_iter()
        .collect::<gloaming::Result<_>>()?;
    let moves: Vec<String> = around.windows(2).map(|w| format!("{:.4}", relative_rmse(&w[0], &w[1]))).collect();
    println!("change from 88.5° to 89.5°, to 90.5° (the order flips), to 91.5°: {}", moves.join(", "));
    // Where the light volume cannot resolve the medium, fine slices tell whose error it is; and the same values at three times as many
    // places, in between by interpolation, have a light volume three times as fine.
    let refined = ["noise.refine=3", "noise.amplitude=1e-7"];
    println!(
        "opacity, angle l·v   ray casting, of three times the values, slices, at 1.5 texels a voxel: from fine slices"
    );
    for (opacity, degrees) in [0.1, 0.15, 0.3, 0.5].into_iter().flat_map(|o| [(o, 85.0), (o, 180.0)]) {
        let (light, opacity) = (direction(degrees), format!("transfer.opacity=[[0, 0], [1, {opacity}]]"));
        let dense = |more: &[&str]| {
            let sets = [&[light.as_str(), opacity.as_str(), "render.size=[256, 256]"], more].concat();
            shot(&sets, 1).map(|s| s.0)
        };
        let fine = dense(&["render.kind=slices", "render.step=0.1", "slices.resolution=8"])?;
        let pictures = [
            dense(&["render.kind=raycast"])?,
            dense(&[&["render.kind=raycast"], &refined[..]].concat())?,
            dense(&["render.kind=slices"])?,
            dense(&["render.kind=slices", "slices.resolution=1.5"])?,
        ];
        println!("{opacity}, {degrees:3}°   {:.4?}", pictures.map(|p| relative_rmse(&p, &fine)));
    }
    for (what, more) in [
        ("translucent, blurred", &["slices.attenuation=[0.4, 0.6, 0.8]", "slices.blur=40"][..]),
        ("without shadows", &["slices.shadows=false"]),
        ("light buffer at half resolution", &["slices.resolution=0.75"]),
        ("slices a voxel apart", &["render.step=1"]),
    ] {
        let light = direction(60.0);
        let sets: Vec<&str> = [light.as_str(), "render.kind=slices"].into_iter().chain(more.iter().copied()).collect();
        println!("{what}: {:.1} ms", 1e3 * shot(&sets, 5)?.1);
    }
    Ok(())
}
