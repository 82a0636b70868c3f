//! Volumes larger than memory against the same work in memory: wall time, peak resident memory, data read.
//!
//! `./x bench paging -- 256 512`: edges of the volumes; `--memory 512` sets the budget in MiB, `--raw` writes raw files
//! instead of HDF5 in chunks of 64³, `--folder DIR` says where, `--set KEY=VALUE` changes the scene. Each run is a process of its
//! own, so that its peak memory is its own.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::time::Instant;

use gloaming::device::Device;
use gloaming::device::cpu::Cpu;
use gloaming::device::paged::Paged;
use gloaming::scene::Scene;
use gloaming::session::Session;
use gloaming::source::{self, SourceSpec};

/// Smoke: ripples on a few blobs, about half of the box empty.
fn plane(n: usize, k: usize) -> Vec<f32> {
    use rayon::prelude::*;
    let blobs = [([0.45, 0.5, 0.3], 0.28), ([0.6, 0.4, 0.6], 0.25), ([0.4, 0.6, 0.8], 0.2)];
    let at = |i: usize| (i as f32 + 0.5) / n as f32;
    let mut values = vec![0.0f32; n * n];
    values.par_chunks_mut(n).enumerate().for_each(|(j, row)| {
        for (i, v) in row.iter_mut().enumerate() {
            let p = [at(i), at(j), at(k)];
            let of = |(c, r): &([f32; 3], f32)| {
                let d2: f32 = (0..3).map(|a| (p[a] - c[a]).powi(2)).sum();
                (1.0 - d2 / (r * r)).max(0.0)
            };
            let density: f32 = blobs.iter().map(of).sum();
            let ripple = (31.0 * p[0] + 9.0 * (23.0 * p[1]).sin()).sin() * (37.0 * p[2] + 11.0 * p[0]).cos();
            *v = density * (0.6 + 0.4 * ripple);
        }
    });
    values
}

/// Writes a volume of n³, 64 planes at a time.
fn generate(path: &Path, n: usize, raw: bool) {
    const DEEP: usize = 64;
    let slab = |k: usize| -> Vec<f32> { (k..(k + DEEP).min(n)).flat_map(|k| plane(n, k)).collect() };
    if raw {
        use std::io::Write;
        let mut file = std::fs::File::create(path).expect("a file");
        (0..n).step_by(DEEP).for_each(|k| file.write_all(bytemuck::cast_slice(&slab(k))).expect("room on the disk"));
        return;
    }
    let file = hdf5::File::create(path).expect("a file");
    let edge = DEEP.min(n);
    let data = file.new_dataset::<f32>().chunk([edge; 3]).shape([n; 3]).create("density").expect("a dataset");
    for k in (0..n).step_by(DEEP) {
        let values = ndarray::Array3::from_shape_vec([DEEP.min(n - k), n, n], slab(k)).expect("a slab");
        data.write_slice(&values, ndarray::s![k..(k + DEEP).min(n), .., ..]).expect("room on the disk");
    }
}

/// Keys that the command line sets.
fn asked() -> Vec<String> {
    let arguments: Vec<String> = std::env::args().collect();
    arguments.windows(2).filter(|pair| pair[0] == "--set").map(|pair| pair[1].clone()).collect()
}

/// Lights and renders the volume; prints what it took.
fn child(path: &str, n: usize, budget: u64, folder: &Path) {
    let raw = path.ends_with(".raw").then(|| format!("dims={n}x{n}x{n},dtype=f32le"));
    let spec =
        SourceSpec { series: vec![path.into()], raw, memory: (budget > 0).then_some(budget), ..Default::default() };
    let series = source::open(&spec).expect("the volume");
    let mut sets = vec!["lights.0.direction=[-0.5, 0.6, -0.7]", "light.warm=false", "render.size=[1280, 720]"];
    let scattered = std::env::args().any(|a| a == "--scattered");
    sets.push(if scattered { "light.resolution=0.5" } else { "light.scattering=false" });
    let opacity = format!("transfer.extinction={}", 12.0 / n as f64);
    let sets: Vec<String> = sets.into_iter().map(String::from).chain([opacity]).chain(asked()).collect();
    let scene = Scene::load(None, &sets).expect("a scene");
    let cpu: Arc<dyn Device> = Arc::new(Cpu::new(0).expect("threads"));
    let paged = (budget > 0).then(|| Arc::new(Paged::new(cpu.clone(), budget, folder)));
    let device = paged.clone().map_or(cpu, |p| p as Arc<dyn Device>);
    let mut session = Session::new(device, scene, Some([0.0, 1.0]), false).expect("a session");
    let begun = Instant::now();
    let output = session.advance(series.timestep(0).expect("a step")).expect("light");
    let seconds = begun.elapsed().as_secs_f64();
    let read = paged.map_or(4 * (n as u64).pow(3), |p| p.bytes_read());
    let bits = output.frames[0].frame.pixels.as_flattened().iter().map(|v| u64::from(v.to_bits()));
    let sum = bits.fold(0u64, |h, b| h.wrapping_mul(0x100_0000_01b3) ^ b);
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status.lines().find_map(|l| l.strip_prefix("VmHWM:")).and_then(|l| l.split_whitespace().next());
    let peak = peak.and_then(|kib| kib.parse::<f64>().ok()).unwrap_or(f64::NAN) / 1024.0;
    let row = &output.row;
    println!("{seconds} {peak} {read} {sum} {} {} {}", row.classify_ms, row.light_ms, row.render_ms);
}

/// What a run in a process of its own says.
struct Run {
    seconds: f64,
    peak: f64,
    read: f64,
    picture: u64,
    parts: String,
}

fn run(path: &Path, n: usize, budget: u64, folder: &Path, scattered: bool) -> Run {
    let mut command = Command::new(std::env::current_exe().expect("this program"));
    command.arg("--child").arg(path).args([n.to_string(), budget.to_string()]).arg(folder);
    command.args(scattered.then_some("--scattered")).args(asked().into_iter().flat_map(|set| ["--set".into(), set]));
    let output = command.output().expect("a child");
    let said = String::from_utf8_lossy(&output.stdout);
    let words: Vec<&str> = said.split_whitespace().collect();
    assert_eq!(words.len(), 7, "{}{}", said, String::from_utf8_lossy(&output.stderr));
    let number = |i: usize| words[i].parse::<f64>().expect("a number");
    let parts = (4..7).map(|i| format!("{:.1}", number(i) / 1e3)).collect::<Vec<_>>().join(" + ");
    Run {
        seconds: number(0),
        peak: number(1),
        read: number(2) / (4.0 * (n as f64).powi(3)),
        picture: words[3].parse().expect("a number"),
        parts,
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    if let [first, path, n, budget, folder, ..] = &arguments[..]
        && first == "--child"
    {
        return child(path, n.parse().expect("an edge"), budget.parse().expect("a budget"), Path::new(folder));
    }
    let after = |key: &str| arguments.iter().position(|a| a == key).and_then(|i| arguments.get(i + 1));
    let memory: u64 = after("--memory").map_or(512, |m| m.parse().expect("MiB"));
    let parent = after("--folder").map_or_else(std::env::temp_dir, PathBuf::from);
    let (raw, scattered) = (arguments.iter().any(|a| a == "--raw"), arguments.iter().any(|a| a == "--scattered"));
    let valued = ["--memory", "--folder"].map(|k| arguments.iter().position(|a| a == k).map(|i| i + 1));
    let edges = arguments.iter().enumerate().filter(|(i, _)| !valued.contains(&Some(*i)));
    let mut edges: Vec<usize> = edges.filter_map(|(_, a)| a.parse().ok()).collect();
    if edges.is_empty() {
        edges = vec![256, 512];
    }
    let folder = tempfile::tempdir_in(parent).expect("a folder");
    for n in edges {
        let path = folder.path().join(if raw { "volume.raw" } else { "volume.h5" });
        generate(&path, n, raw);
        let paged = run(&path, n, memory << 20, folder.path(), scattered);
        println!(
            "{n}³ in {memory} MiB: {:.2} s (values + light + rays {} s), peak {:.0} MiB, data read {:.2} times",
            paged.seconds, paged.parts, paged.peak, paged.read
        );
        let whole = run(&path, n, 0, folder.path(), scattered);
        println!("{n}³ in memory: {:.2} s ({} s), peak {:.0} MiB", whole.seconds, whole.parts, whole.peak);
        let same = if whole.picture == paged.picture { "the same picture to the bit" } else { "ANOTHER PICTURE" };
        println!("{n}³: {:.2} times as long, {same}", paged.seconds / whole.seconds);
        std::fs::remove_file(&path).expect("the file is there");
    }
}
