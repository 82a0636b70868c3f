//! Path tracing: samples a second, a majorant for each brick against one for all, how the error falls with samples, and how long a
//! picture takes.
//!
//! `cargo bench --bench pathtrace [-- [speed] [slopes] [time] [--all] [--quick]]`
//!
//! `speed`, `slopes` and `time` choose parts; without them all three run, a few minutes in all. `slopes` are of five series with three
//! apertures under one to eight lights each, with `--quick` of one series. `time` is that of each series in focus under one light, and
//! with `--all` of each row of `slopes`, seconds each. Series are read from the folder that `GLOAMING_BENCH_DATA` names, or
//! `tests/data`; in place of one that is not there, one is made, and its name says so.

use std::ops::Range;
use std::path::PathBuf;
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
use gloaming::source::{self, SourceSpec};
use gloaming::transfer::TransferFunction;

/// A volume, and how it is shown.
struct Series {
    name: String,
    grid: Grid,
    values: Vec<f32>,
    keys: &'static str,
}

const SMOKE: &str =
    "transfer.colormap = \"white\"\ntransfer.albedo = 0.9\ntransfer.opacity = [[0.0, 0.0], [1.0, 0.35]]";
const LIQUID: &str = "transfer.colormap = \"viridis\"\ntransfer.opacity = [[0.0, 0.0], [0.3, 0.0], [1.0, 0.5]]";
const SOLVENT: &str = "transfer.colormap = \"viridis\"\ntransfer.opacity = [[0.0, 0.5], [0.7, 0.1], [0.9, 0.0]]";
const WAVE: &str = "transfer.colormap = \"white\"\ntransfer.opacity = [[0.0, 0.6], [0.4, 0.0], [0.6, 0.0], [1.0, 0.6]]";

/// File, field, layout where there is no header, step (the last where there are fewer), and how it is shown.
type Shown = (&'static str, Option<&'static str>, Option<&'static str>, usize, &'static str);

const FILES: [Shown; 5] = [
    ("smoke.h5", Some("density"), None, 40, SMOKE),
    ("smoke.h5", Some("density"), None, 12, SMOKE),
    ("gray_scott_32.raw", None, Some("dims=32x32x32,dtype=f64le,offset=24,steps=12"), 11, LIQUID),
    ("openpmd_gray_scott.h5", Some("U"), None, 19, SOLVENT),
    ("meep_ez.h5", Some("ez"), None, 39, WAVE),
];

/// One of [`FILES`] on a grid of `most` values along its longest axis.
fn series(number: usize, most: usize) -> gloaming::Result<Series> {
    let (file, field, raw, step, keys) = FILES[number];
    let folder = std::env::var_os("GLOAMING_BENCH_DATA")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data"), PathBuf::from);
    let path = folder.join(file);
    if !path.exists() {
        let (grid, values) = puffs(most, number as u32);
        return Ok(Series { name: format!("made in place of {file}"), grid, values, keys });
    }
    let series = source::open(&SourceSpec {
        series: vec![path.display().to_string()],
        field: field.map(str::to_owned),
        raw: raw.map(str::to_owned),
        ..Default::default()
    })?;
    let step = step.min(series.info().steps.len().saturating_sub(1));
    let Timestep { grid, field, .. } = series.timestep(step)?;
    let mut coarse = vec![0.0; grid.len()];
    field.read(grid.region(), &mut coarse)?;
    let (grid, values) = resampled(&grid, |at| coarse[grid.index(at)], most);
    Ok(Series { name: format!("{file} {step}"), grid, values, keys })
}

/// Soft balls where a hash says.
fn puffs(n: usize, seed: u32) -> (Grid, Vec<f32>) {
    let grid = Grid::new([n; 3]);
    let ball = |b: u32| gloaming::device::random::pcg4d([b, seed, 7, 9]).map(gloaming::device::random::unit);
    let balls: Vec<[f32; 4]> = (0..24).map(ball).collect();
    let value = |v: usize| {
        let p = [v % n, v / n % n, v / (n * n)].map(|i| (i as f32 + 0.5) / n as f32);
        let at = |[x, y, z, r]: &[f32; 4]| {
            let centre = [x, y, z].map(|c| 0.2 + 0.6 * c);
            let square: f32 = (0..3).map(|a| (p[a] - centre[a]).powi(2)).sum();
            (1.0 - square / (0.05 + 0.1 * r).powi(2)).max(0.0)
        };
        balls.iter().map(at).sum::<f32>().min(1.0)
    };
    (grid, (0..grid.len()).map(value).collect())
}

/// Trilinear on a grid of `most` values along the longest axis that fills the same box.
fn resampled(grid: &Grid, value: impl Fn([usize; 3]) -> f32, most: usize) -> (Grid, Vec<f32>) {
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
                let row = |y, z| mix(value([x0, y, z]), value([x1, y, z]), tx);
                out.push(mix(mix(row(y0, z0), row(y1, z0), ty), mix(row(y0, z1), row(y1, z1), ty), tz));
            }
        }
    }
    (fine, out)
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
    fn run(&self, size: usize, samples: Range<u32>, depth: u32, global: bool) -> (Vec<Tally>, f64) {
        let mut tallies = vec![Tally::default(); size * size];
        let seconds = self.add(size, samples, depth, global, &mut tallies);
        (tallies, seconds)
    }

    /// The same into sums that go on.
    fn add(&self, size: usize, samples: Range<u32>, depth: u32, global: bool, tallies: &mut [Tally]) -> f64 {
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
            // Samples of one seed fill each other's gaps: what is held against a reference is of another.
            seed: 1 + u32::from(samples.start > 0),
            samples,
        };
        let begun = Instant::now();
        self.device.trace(&trace, [size, size], tallies).expect("the CPU traces");
        begun.elapsed().as_secs_f64()
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

/// Samples a second and core on smoke of 128³ at 512², eight samples of a pixel at a time, the two in turns.
fn speed(quick: bool) -> gloaming::Result<()> {
    let smoke = series(0, 128)?;
    let stage = Stage::new(&smoke, "")?;
    let (size, runs) = if quick { (128, 1) } else { (512, 3) };
    let threads = stage.device.threads() as f64;
    println!("{} on 128³, {size}² pixels, three lights, {threads} threads", smoke.name);
    for (what, depth) in [("single scattering", 1), ("all orders", 1000)] {
        let mut best = [f64::INFINITY; 2];
        for run in 0..runs {
            for (global, best) in [false, true].into_iter().zip(&mut best) {
                let (_, seconds) = stage.run(size, 8 * run..8 * run + 8, depth, global);
                *best = best.min(seconds);
            }
        }
        let rate = |seconds: f64| (8 * size * size) as f64 / seconds / threads;
        println!(
            "{what}: {:.0} samples/s/core with a majorant for each brick, {:.0} with one for all: {:.2} times",
            rate(best[0]),
            rate(best[1]),
            best[1] / best[0]
        );
    }
    Ok(())
}

/// A series through a lens whose aperture is a part of the volume's diagonal, under lights all round.
fn stage(series: &Series, aperture: f64, lights: usize) -> gloaming::Result<Stage> {
    let light = |i: usize| {
        let angle = 0.8 + std::f64::consts::TAU * i as f64 / lights as f64;
        let ([x, y], intensity) = ([angle.cos(), angle.sin()], 6.0 / lights as f64);
        format!("[[lights]]\nsoftness = 5\nintensity = {intensity}\ndirection = [{x}, {y}, -0.7]\n")
    };
    let lights: String = (0..lights).map(light).collect();
    let (lo, hi) = series.grid.bounds();
    let width = aperture * (hi - lo).length();
    Stage::new(series, &format!("render.kind = \"pathtrace\"\n{lights}[[cameras]]\naperture = {width}"))
}

const APERTURES: [f64; 3] = [0.0, 0.02, 0.08];
const LIGHTS: [usize; 4] = [1, 2, 4, 8];

/// The exponent with which the error falls, fitted over all numbers of samples.
fn slopes(quick: bool) -> gloaming::Result<()> {
    const SIZE: usize = 16;
    const COUNTS: [u32; 5] = [1, 4, 16, 64, 256];
    let (truth, repeats, number) = if quick { (1024, 1, 1) } else { (8192, 4, FILES.len()) };
    println!("\nnormalised RMSE at {SIZE}² by samples a pixel, against {truth} others, in the mean of {repeats}");
    println!("series | aperture | lights | 1 | 4 | 16 | 64 | 256 | exponent");
    let (mut steepest, mut flattest) = (0.0f64, -1.0f64);
    for number in 0..number {
        let series = series(number, 48)?;
        for aperture in APERTURES {
            for lights in LIGHTS {
                let stage = stage(&series, aperture, lights)?;
                let (reference, _) = stage.run(SIZE, 0..truth, 1000, false);
                let once =
                    |first: u32, n: u32| error(&stage.run(SIZE, first..first + n, 1000, false).0, &reference).powi(2);
                let errors = COUNTS.map(|n| {
                    let squares: f64 = (0..repeats).map(|r| once(truth + r * COUNTS[4], n)).sum();
                    (squares / f64::from(repeats)).sqrt()
                });
                // Least squares of logarithms; the numbers of samples are powers of four about the middle one.
                let exponent = (0..5).map(|i| (i as f64 - 2.0) * errors[i].ln()).sum::<f64>() / (10.0 * 4f64.ln());
                (steepest, flattest) = (steepest.min(exponent), flattest.max(exponent));
                let shown = errors.map(|e| format!("{e:.4}")).join(" | ");
                println!("{} | {aperture} | {lights} | {shown} | {exponent:.3}", series.name);
            }
        }
    }
    println!("exponents from {steepest:.3} to {flattest:.3}");
    Ok(())
}

/// Seconds to an error of a tenth at 512², taken at 128² of the same view: an error is that of a pixel, and a sixteenth of the pixels
/// takes a sixteenth of the time. Against a reference of finite samples R an error of n others is larger than the true one by
/// `√(1 + n/R)`, which is taken out.
fn time(all: bool, quick: bool) -> gloaming::Result<()> {
    let (size, truth): (usize, u32) = if quick { (32, 256) } else { (128, 1024) };
    let times = (512 / size).pow(2) as f64;
    println!(
        "\nseconds to a normalised RMSE of 10 % at 512²: {times} times those at {size}², against {truth} other samples"
    );
    println!("series | aperture | lights | samples | error | s");
    for number in 0..FILES.len() {
        let series = series(number, 64)?;
        for aperture in if all { &APERTURES[..] } else { &APERTURES[..1] } {
            for lights in if all { &LIGHTS[..] } else { &LIGHTS[..1] } {
                let stage = stage(&series, *aperture, *lights)?;
                let (reference, _) = stage.run(size, 0..truth, 1000, false);
                let mut tallies = vec![Tally::default(); size * size];
                let (mut samples, mut seconds, mut off) = (0, 0.0, f64::INFINITY);
                while off > 0.1 && samples < 8 * truth {
                    // As many at a time as a sixteenth of those that there are, so that little is taken too much.
                    let more = (samples / 16).max(1);
                    let next = truth + samples..truth + samples + more;
                    seconds += stage.add(size, next, 1000, false, &mut tallies);
                    samples += more;
                    off = error(&tallies, &reference) / (1.0 + f64::from(samples) / f64::from(truth)).sqrt();
                }
                println!("{} | {aperture} | {lights} | {samples} | {off:.3} | {:.1}", series.name, times * seconds);
            }
        }
    }
    Ok(())
}

fn main() -> gloaming::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let parts = ["speed", "slopes", "time"];
    if let Some(unknown) = arguments.iter().find(|a| !parts.contains(&&a[..]) && *a != "--all" && *a != "--quick") {
        eprintln!("no part or option {unknown}: speed, slopes, time, --all, --quick");
        std::process::exit(2);
    }
    let given = |name: &str| arguments.iter().any(|a| a == name);
    let wanted = |part: &str| given(part) || !parts.iter().any(|p| given(p));
    let quick = given("--quick");
    if wanted("speed") {
        speed(quick)?;
    }
    if wanted("slopes") {
        slopes(quick)?;
    }
    if wanted("time") {
        time(given("--all"), quick)?;
    }
    Ok(())
}
