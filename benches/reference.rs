//! The picture whose truth is known, cold: data taken in, light solved, 256² pixels cast, and how far from the truth it is.
//!
//! Then the same with all orders of scattering: cold, and warm while the plume rises by a quarter of a voxel a step, against a
//! frame of direct light alone. Their error is tested in tests/reference.rs.
//!
//! `cargo bench --bench reference [-- --json]`; `./x bench peers` puts other renderers beside it.

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result};
use gloaming::Grid;
use gloaming::device::cpu::Cpu;
use gloaming::field::{Dense, Timestep};
use gloaming::scene::Scene;
use gloaming::session::Session;

const SIZE: usize = 256;
const RUNS: usize = 15;

/// tests/data/plume_128.h5 seen as tests/data/single_256.npy has it.
const SCENE: &str = r#"
[field]
range = [0.0, 1.0]
[transfer]
colormap = "white"
extinction = 30.0
albedo = 0.8
[[lights]]
kind = "distant"
direction = [0.6, 0.4, -0.7]
intensity = 3.14159265
[light]
scattering = false
warm = false
[[cameras]]
position = [0.5, -2.0, 0.55]
target = [0.5, 0.5, 0.5]
fov = 28.0
[render]
size = [256, 256]
"#;

/// Settings that trade time for error.
const SETTINGS: [(&str, &[&str]); 4] = [
    ("cubic, step 0.5", &["light.interpolation=cubic"]),
    ("cubic, step 1", &["light.interpolation=cubic", "render.step=1.0"]),
    ("cubic, step 2", &["light.interpolation=cubic", "render.step=2.0"]),
    ("bilinear, step 1", &["render.step=1.0"]),
];

fn main() -> Result<()> {
    let json = std::env::args().any(|a| a == "--json");
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
    let truth = truth(&data.join("single_256.npy"))?;
    let step = plume(&data.join("plume_128.h5"))?;
    for (setting, sets) in SETTINGS {
        let sets: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
        let scene = Scene::parse(SCENE, "the reference scene", &sets)?;
        let mut session = Session::new(Arc::new(Cpu::new(0)?), scene, None, false)?;
        let (mut seconds, mut light, mut render) = (f64::INFINITY, 0.0, 0.0);
        let mut pixels = vec![];
        // The first run allocates; a movie does that once.
        for run in 0..=RUNS {
            let begun = Instant::now();
            let output = session.advance(step.clone())?;
            let took = begun.elapsed().as_secs_f64();
            if run > 0 && took < seconds {
                (seconds, light, render) = (took, output.row.light_ms, output.row.render_ms);
            }
            pixels = output.frames.into_iter().next().context("one camera makes one frame")?.frame.pixels;
        }
        let squares = pixels.iter().zip(&truth).map(|(p, t)| f64::from(p[0] - t).powi(2));
        let rmse = (squares.sum::<f64>() / truth.len() as f64).sqrt();
        if json {
            let setting = format!("{setting}, {RUNS} cold runs");
            println!("{}", serde_json::json!({ "setting": setting, "seconds": seconds, "rmse": rmse }));
        } else {
            let total = 1e3 * seconds;
            println!("{setting:18} RMSE {rmse:.2e}  {total:6.1} ms: light {light:.1}, rays {render:.1}");
        }
    }
    if !json {
        all_orders(&step)?;
    }
    Ok(())
}

/// Direct light alone, all orders cold, all orders warm: best times of a whole step, in turns.
fn all_orders(plume: &Timestep) -> Result<()> {
    let session = |sets: &[&str]| -> Result<Session> {
        let sets: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
        Ok(Session::new(Arc::new(Cpu::new(0)?), Scene::parse(SCENE, "the reference scene", &sets)?, None, false)?)
    };
    let all = "light.scattering=true";
    let mut ways = [
        ("direct light", session(&[])?, f64::INFINITY, 0),
        ("all orders, cold", session(&[all])?, f64::INFINITY, 0),
        ("all orders, warm", session(&[all, "light.warm=true"])?, f64::INFINITY, 0),
    ];
    let mut values = vec![0.0; plume.grid.len()];
    plume.field.read(plume.grid.region(), &mut values)?;
    let layer = 128 * 128;
    for run in 0..=RUNS {
        // Up by a quarter of a voxel each time, linear in between.
        let (whole, part) = (run / 4, (run % 4) as f32 / 4.0);
        let at = |i: usize, down: usize| if i >= down * layer { values[i - down * layer] } else { 0.0 };
        let risen = (0..values.len()).map(|i| (1.0 - part) * at(i, whole) + part * at(i, whole + 1)).collect();
        let step = Timestep { field: Arc::new(Dense::new(plume.grid.size, risen)), ..plume.clone() };
        for (_, session, best, iterations) in &mut ways {
            let begun = Instant::now();
            let output = session.advance(step.clone())?;
            // The first two have no past to start from.
            if run > 1 {
                *best = best.min(begun.elapsed().as_secs_f64());
                *iterations += output.row.iterations;
            }
        }
    }
    let direct = ways[0].2;
    for (name, _, best, iterations) in ways {
        let iterations = iterations as f64 / (RUNS - 1) as f64;
        println!(
            "{name:18} {:6.1} ms, {:.1} frames of direct light, {iterations:.1} iterations",
            1e3 * best,
            best / direct
        );
    }
    Ok(())
}

/// The plume as a step in memory.
fn plume(path: &Path) -> Result<Timestep> {
    let read = || hdf5::File::open(path)?.dataset("density")?.read_raw::<f32>();
    let values = read().with_context(|| format!("{}", path.display()))?;
    let grid = Grid { size: [128; 3], spacing: [1.0 / 128.0; 3], origin: [0.5 / 128.0; 3] };
    Ok(Timestep { step: 0, time: None, grid, field: Arc::new(Dense::new(grid.size, values)) })
}

/// The picture at the end of a `.npy` file of f32.
fn truth(path: &Path) -> Result<Vec<f32>> {
    let bytes = std::fs::read(path).with_context(|| format!("{}", path.display()))?;
    let header = bytes.len().checked_sub(4 * SIZE * SIZE).context("the picture is too small")?;
    Ok(bytes[header..].chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
}
