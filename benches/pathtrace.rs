//! Path tracing: samples a second, a majorant for each brick against one for all, and how the error falls with samples.
//!
//! `cargo bench --bench pathtrace [-- --quick]`

use std::sync::Arc;
use std::time::Instant;

use gloaming::camera::Camera;
use gloaming::device::cpu::Cpu;
use gloaming::device::{Device, Phase, Sampling, Tally, Trace};
use gloaming::field::{Dense, Timestep};
use gloaming::grid::{BrickLayout, Grid};
use gloaming::lights::Emitters;
use gloaming::medium::Medium;
use gloaming::scene::Scene;
use gloaming::transfer::TransferFunction;

/// A volume, and how it is shown.
struct Series {
    name: &'static str,
    grid: Grid,
    values: Vec<f32>,
    keys: &'static str,
}

fn data(file: &str) -> String {
    format!("{}/tests/data/{file}", env!("CARGO_MANIFEST_DIR"))
}

/// One step of a dataset of (step, z, y, x), or of (z, y, x), on a grid of at most `most` values along an axis.
fn read(file: &str, dataset: &str, step: Option<usize>, most: usize) -> gloaming::Result<(Grid, Vec<f32>)> {
    let path = data(file);
    let all = || -> hdf5::Result<ndarray::ArrayD<f32>> { hdf5::File::open(&path)?.dataset(dataset)?.read_dyn::<f32>() };
    let mut all = all().map_err(|e| gloaming::Error::format(&path, e.to_string(), "git lfs pull"))?;
    if let Some(step) = step {
        all = all.index_axis_move(ndarray::Axis(0), step);
    }
    let coarse = all.into_dimensionality::<ndarray::Ix3>().expect("three axes");
    let (nz, ny, nx) = coarse.dim();
    let grid = Grid::new([nx, ny, nz]);
    Ok(resampled(&grid, |i, j, k| coarse[[k, j, i]], most))
}

/// Trilinear on a grid of `most` values along the longest axis that fills the same box.
fn resampled(grid: &Grid, value: impl Fn(usize, usize, usize) -> f32, most: usize) -> (Grid, Vec<f32>) {
    let longest = grid.size.into_iter().max().unwrap_or(1);
    let fine = grid.resized(grid.size.map(|n| (n * most).div_ceil(longest)));
    let at = |axis: usize, i: usize| {
        let (n, m) = (grid.size[axis], fine.size[axis]);
        let x = ((i as f32 + 0.5) * n as f32 / m as f32 - 0.5).clamp(0.0, n as f32 - 1.0);
        let low = (x as usize).min(n.max(2) - 2);
        (low, (low + 1).min(n - 1), x - low as f32)
    };
    let mix = |a: f32, b: f32, t: f32| a * (1.0 - t) + b * t;
    let mut out = Vec::with_capacity(fine.len());
    for k in 0..fine.size[2] {
        let (z0, z1, tz) = at(2, k);
        for j in 0..fine.size[1] {
            let (y0, y1, ty) = at(1, j);
            for i in 0..fine.size[0] {
                let (x0, x1, tx) = at(0, i);
                let row = |y, z| mix(value(x0, y, z), value(x1, y, z), tx);
                out.push(mix(mix(row(y0, z0), row(y1, z0), ty), mix(row(y0, z1), row(y1, z1), ty), tz));
            }
        }
    }
    (fine, out)
}

/// Blocks of three densities in empty space.
fn blocks(n: usize) -> Series {
    let block = |i: usize| (i * 7 / n) % 2;
    let grid = Grid::new([n; 3]);
    let value = |v: usize| {
        let [i, j, k] = [v % n, v / n % n, v / (n * n)];
        if block(i) + block(j) + block(k) == 3 { (1 + (i + 2 * j + 3 * k) * 7 / n % 3) as f32 / 3.0 } else { 0.0 }
    };
    Series {
        name: "blocks",
        values: (0..grid.len()).map(value).collect(),
        grid,
        keys: "transfer.opacity = [[0, 0], [1, 0.6]]",
    }
}

const SMOKE: &str =
    "transfer.colormap = \"white\"\ntransfer.albedo = 0.9\ntransfer.opacity = [[0.0, 0.0], [1.0, 0.35]]";

fn series() -> gloaming::Result<Vec<Series>> {
    let of = |name, (grid, values), keys| Series { name, grid, values, keys };
    let raw =
        std::fs::read(data("gray_scott_32.raw")).map_err(|e| gloaming::Error::io(data("gray_scott_32.raw"), e))?;
    let last = &raw[raw.len() - 8 * 32 * 32 * 32..];
    let value = |i: usize| f64::from_le_bytes(std::array::from_fn(|b| last[8 * i + b])) as f32;
    Ok(vec![
        of("smoke", read("smoke.h5", "density", Some(40), 64)?, SMOKE),
        of("smoke, early", read("smoke.h5", "density", Some(12), 64)?, SMOKE),
        of("plume", read("plume_128.h5", "density", None, 64)?, SMOKE),
        of(
            "Gray–Scott",
            resampled(&Grid::new([32; 3]), |i, j, k| value((k * 32 + j) * 32 + i), 64),
            "transfer.colormap = \"viridis\"\ntransfer.opacity = [[0.0, 0.0], [0.3, 0.0], [1.0, 0.5]]",
        ),
        blocks(64),
    ])
}

/// What `Device::trace` takes, but for the picture.
struct Stage {
    device: Cpu,
    medium: Medium,
    majorant: Vec<f32>,
    emitters: Emitters,
    camera: Camera,
}

impl Stage {
    fn new(series: &Series, more: &str) -> gloaming::Result<Self> {
        let scene = Scene::parse(&format!("{}\n{more}", series.keys), "bench", &[])?;
        let device = Cpu::new(0)?;
        let (lo, hi) = series.values.iter().fold((f32::MAX, f32::MIN), |(l, h), v| (l.min(*v), h.max(*v)));
        let table = TransferFunction::new(&scene.transfer)?.table([lo.into(), hi.into()], series.grid.mean_spacing());
        let mut medium = Medium::new(&device, series.grid, table.clone())?;
        let field = Arc::new(Dense::new(series.grid.size, series.values.clone()));
        medium.take(&device, &Timestep { step: 0, time: None, grid: series.grid, field })?;
        medium.classify(table);
        let keys = scene.cameras.first().cloned().unwrap_or_default();
        let camera = Camera::framed(&keys, &series.grid, 1.0, 0)?;
        let majorant = medium.majorant.clone();
        Ok(Stage { device, medium, majorant, emitters: Emitters::new(&scene)?, camera })
    }

    /// Traces samples of a picture of `size`², into sums that begin at 0; returns them and the seconds that it took.
    fn run(&self, size: usize, samples: std::ops::Range<u32>, depth: u32, global: bool) -> (Vec<Tally>, f64) {
        let emitters = self.emitters.on(&self.medium.grid);
        let most = [self.majorant.iter().fold(0.0f32, |m, v| m.max(*v))];
        let longest = self.medium.grid.size.into_iter().max().unwrap_or(1);
        let whole = BrickLayout::new(self.medium.grid.size, longest);
        let trace = Trace {
            grid: &self.medium.grid,
            field: &self.medium.field,
            gradient: self.medium.gradient.as_ref(),
            table: &self.medium.table,
            surface: None,
            bricks: if global { whole } else { self.medium.bricks },
            majorant: if global { &most } else { &self.majorant },
            emitters: &emitters,
            images: self.emitters.images(),
            camera: &self.camera,
            focus: self.distance(),
            clips: &[],
            meshes: None,
            phase: Phase::HenyeyGreenstein(0.0),
            sampling: Sampling::Both,
            depth,
            seed: 1 + u32::from(samples.start > 0),
            samples,
        };
        let mut tallies = vec![Tally::default(); size * size];
        let begun = Instant::now();
        self.device.trace(&trace, [size, size], &mut tallies).expect("the CPU traces");
        (tallies, begun.elapsed().as_secs_f64())
    }

    /// From the eye to the middle of the volume.
    fn distance(&self) -> f32 {
        let (lo, hi) = self.medium.grid.bounds();
        (0.5 * (lo + hi)).as_vec3().distance(self.camera.eye)
    }
}

/// Root mean square of the error of the sums' means, over the mean of the truth.
fn error(tallies: &[Tally], truth: &[Tally]) -> f64 {
    let mean = |t: &Tally, c: usize| t.radiance[c] / f64::from(t.samples);
    let (mut square, mut sum) = (0.0, 0.0);
    for (a, b) in tallies.iter().zip(truth) {
        for c in 0..3 {
            square += (mean(a, c) - mean(b, c)).powi(2);
            sum += mean(b, c);
        }
    }
    let n = 3.0 * truth.len() as f64;
    (square / n).sqrt() / (sum / n)
}

fn speed(quick: bool) -> gloaming::Result<()> {
    let smoke = read("smoke.h5", "density", Some(40), 128)?;
    let smoke = Series { name: "smoke", grid: smoke.0, values: smoke.1, keys: SMOKE };
    let stage = Stage::new(&smoke, "")?;
    let (size, runs) = if quick { (128, 1) } else { (512, 3) };
    let threads = stage.device.threads() as f64;
    println!("smoke on 128³, {size}² pixels, three lights, {threads} threads");
    for (what, depth) in [("single scattering", 1), ("all orders", 1000)] {
        let mut best = [f64::INFINITY; 2];
        for run in 0..runs {
            for (global, best) in [false, true].into_iter().zip(&mut best) {
                let (_, seconds) = stage.run(size, run..run + 1, depth, global);
                *best = best.min(seconds);
            }
        }
        let rate = |seconds: f64| (size * size) as f64 / seconds / threads;
        println!(
            "{what}: {:.0} samples/s/core with a majorant for each brick, {:.0} with one for all: {:.1} times",
            rate(best[0]),
            rate(best[1]),
            best[1] / best[0]
        );
    }
    Ok(())
}

fn convergence(quick: bool) -> gloaming::Result<()> {
    let (size, truth) = if quick { (24, 128) } else { (64, 1024) };
    println!("\nnormalised RMSE at {size}² by samples a pixel, against {truth} samples; time to 10 % at 512²");
    println!("series | aperture | lights | 1 | 4 | 16 | 64 | exponent | s to 10 %");
    for series in series()? {
        let (lo, hi) = series.grid.bounds();
        for aperture in [0.0, 0.02, 0.08] {
            for lights in [1, 2, 4, 8] {
                let light = |i: usize| {
                    let angle = 0.8 + std::f64::consts::TAU * i as f64 / lights as f64;
                    let [x, y] = [angle.cos(), angle.sin()];
                    format!(
                        "[[lights]]\nsoftness = 5\nintensity = {}\ndirection = [{x}, {y}, -0.7]\n",
                        6.0 / lights as f64
                    )
                };
                let lights_keys: String = (0..lights).map(light).collect();
                let width = aperture * (hi - lo).length();
                let stage = Stage::new(
                    &series,
                    &format!("render.kind = \"pathtrace\"\n{lights_keys}[[cameras]]\naperture = {width}"),
                )?;
                let (reference, _) = stage.run(size, 0..truth, 1000, false);
                let counts = [1u32, 4, 16, 64];
                let runs = counts.map(|n| stage.run(size, truth..truth + n, 1000, false));
                let errors = runs.each_ref().map(|(tallies, _)| error(tallies, &reference));
                let exponent = (errors[3] / errors[1]).ln() / 16f64.ln();
                let needed = (errors[2] / 0.1).powi(2) * 16.0;
                let seconds = needed.ceil() * runs[3].1 / 64.0 * (512.0 / size as f64).powi(2);
                let [a, b, c, d] = errors;
                println!(
                    "{} | {aperture} | {lights} | {a:.3} | {b:.3} | {c:.4} | {d:.4} | {exponent:.2} | {seconds:.1}",
                    series.name
                );
            }
        }
    }
    Ok(())
}

fn main() -> gloaming::Result<()> {
    let quick = std::env::args().any(|a| a == "--quick");
    speed(quick)?;
    convergence(quick)
}
