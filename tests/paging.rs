//! Volumes larger than memory (validation.md 16): the same to the bit as in memory, whatever the budget.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};

use gloaming::device::Device;
use gloaming::device::cpu::Cpu;
use gloaming::device::paged::Paged;
use gloaming::field::{Dense, Field, Timestep};
use gloaming::pipeline::{self, Job};
use gloaming::scene::{Scene, ScratchKey};
use gloaming::session::Session;
use gloaming::sink::{self, Output};
use gloaming::source::{self, SourceSpec};
use gloaming::{Error, Grid, Region, Result, memory};

/// Blobs in empty space, with a hole; `t` moves one of them.
fn values(size: [usize; 3], t: f32) -> Vec<f32> {
    let mut values = Vec::with_capacity(size.iter().product());
    for k in 0..size[2] {
        for j in 0..size[1] {
            for i in 0..size[0] {
                let p = [i, j, k].map(|n| n as f32);
                let at = |a: usize, part: f32| part * size[a] as f32;
                let blob = |c: [f32; 3], r: f32| {
                    let d2: f32 = (0..3).map(|a| (p[a] - at(a, c[a])).powi(2)).sum();
                    (1.0 - d2.sqrt() / (r * size[0].max(size[1]).max(size[2]) as f32)).max(0.0)
                };
                let ripple = 0.2 * (0.9 * p[0] + 1.3 * p[1] + 0.7 * p[2]).sin();
                let v = blob([0.5, 0.45, 0.3], 0.35) + blob([0.6 - 0.1 * t, 0.6, 0.7], 0.3);
                values.push(if v > 0.95 {
                    f32::NAN
                } else if v > 0.0 {
                    (v + ripple).max(0.0)
                } else {
                    0.0
                });
            }
        }
    }
    values
}

/// Counts what is read.
struct Counted {
    of: Dense,
    bytes: AtomicU64,
    largest: AtomicUsize,
}

impl Field for Counted {
    fn read(&self, region: Region, out: &mut [f32]) -> Result<()> {
        self.bytes.fetch_add(4 * region.len() as u64, Ordering::Relaxed);
        self.largest.fetch_max(region.size[2], Ordering::Relaxed);
        self.of.read(region, out)
    }
}

fn counted(size: [usize; 3], t: f32) -> Arc<Counted> {
    let of = Dense::new(size, values(size, t));
    Arc::new(Counted { of, bytes: AtomicU64::new(0), largest: AtomicUsize::new(0) })
}

fn grid(size: [usize; 3]) -> Grid {
    Grid { size, spacing: [0.5, 0.4, 0.6], origin: [1.0, -2.0, 3.0] }
}

fn scene(sets: &[&str]) -> Scene {
    let sets: Vec<String> =
        ["render.size=[48, 32]", "transfer.extinction=2.0"].iter().chain(sets).map(|s| s.to_string()).collect();
    Scene::load(None, &sets).unwrap()
}

fn cpu() -> Arc<dyn Device> {
    Arc::new(Cpu::new(2).unwrap())
}

fn paged(inner: Arc<dyn Device>, budget: u64) -> Arc<Paged> {
    Arc::new(Paged::new(inner, budget, &std::env::temp_dir()))
}

/// Lights and renders `steps` steps.
fn light(device: Arc<dyn Device>, scene: &Scene, size: [usize; 3], steps: usize) -> Result<Vec<Output>> {
    let mut session = Session::new(device, scene.clone(), Some([0.0, 1.0]), true)?;
    let step = |n: usize| Timestep { step: n as u64, time: None, grid: grid(size), field: counted(size, n as f32) };
    (0..steps).map(|n| session.advance(step(n))).collect()
}

fn bits(output: &Output) -> Vec<u32> {
    let frames = output.frames.iter().flat_map(|v| v.frame.pixels.as_flattened());
    let light = output.light.iter().flat_map(|l| l.fluence.as_flattened());
    frames.chain(light).map(|v| v.to_bits()).collect()
}

/// The least budget, more, and much more.
fn assert_same_for_every_budget(sets: &[&str], size: [usize; 3]) {
    assert_same_on(&cpu(), sets, size);
}

fn assert_same_on(inner: &Arc<dyn Device>, sets: &[&str], size: [usize; 3]) {
    let scene = scene(sets);
    let whole = light(inner.clone(), &scene, size, 2).unwrap();
    assert!(
        whole[0].frames.iter().all(|v| v.frame.pixels.as_flattened().iter().any(|p| *p > 0.01)),
        "something to see"
    );
    let least = memory::smallest(&scene, &grid(size)).unwrap();
    for budget in [least, least + least / 3, 3 * least, 20 * least] {
        let part = light(paged(inner.clone(), budget), &scene, size, 2)
            .unwrap_or_else(|e| panic!("{sets:?} in {budget}: {e}"));
        for (step, (w, p)) in whole.iter().zip(&part).enumerate() {
            assert!(bits(w) == bits(p), "{sets:?}, {size:?}, step {step}, {budget} bytes");
            assert_eq!(w.row.holes, p.row.holes);
        }
    }
}

const ODD: [usize; 3] = [37, 64, 51];
const LIGHT: &str = "lights.0.direction=[-0.3, 0.5, -0.8]";

#[test]
fn lights_from_every_side_are_the_same_to_the_bit() {
    for direction in [
        "[0.3, 0.5, -0.8]",
        "[-0.2, 0.4, 0.9]",
        "[0.9, 0.2, 0.3]",
        "[-0.9, 0.1, -0.2]",
        "[0.1, 0.9, -0.3]",
        "[0.0, -1.0, 0.0]",
        "[1.0, 0.0, 0.0]",
        "[0.0, 0.0, 1.0]",
    ] {
        let light = format!("lights.0.direction={direction}");
        assert_same_for_every_budget(&[&light, "light.scattering=false"], ODD);
    }
}

#[test]
fn several_lights_with_shading_and_emission_are_the_same_to_the_bit() {
    let sets = [
        LIGHT,
        "lights.0.softness=8",
        "lights.1.direction=[0.8, 0.1, 0.3]",
        "lights.1.color=[0.2, 0.5, 1.0]",
        "light.scattering=false",
        "render.shading=phong",
        "transfer.emission=[[0.0, 0.0], [1.0, 0.4]]",
    ];
    assert_same_for_every_budget(&sets, ODD);
}

#[test]
fn coarser_light_and_flat_volumes_are_the_same_to_the_bit() {
    for size in [[37, 64, 51], [5, 9, 1], [1, 16, 24], [16, 1, 2]] {
        for resolution in ["0.5", "0.37", "70"] {
            let resolution = format!("light.direct_resolution={resolution}");
            assert_same_for_every_budget(&[LIGHT, &resolution, "light.scattering=false"], size);
        }
    }
}

/// On grids that do not fit and on grids that do, warm starts included.
#[test]
fn scattered_light_is_the_same_to_the_bit() {
    assert_same_for_every_budget(&[LIGHT, "light.resolution=1", "light.directions=32"], ODD);
    assert_same_for_every_budget(&[LIGHT, "light.resolution=0.25", "transfer.anisotropy=0.4"], ODD);
    assert_same_for_every_budget(&[LIGHT, "light.resolution=1", "light.directions=8"], [16, 24, 1]);
}

#[test]
fn scattered_light_of_every_kind_is_the_same_to_the_bit() {
    let many = [
        LIGHT,
        "light.resolution=0.8",
        "light.directions=8",
        "light.tolerance=0.01",
        "transfer.anisotropy=0.6",
        "transfer.emission=[[0.0, 0.0], [1.0, 0.4]]",
        "transfer.albedo=[0.9, 0.7, 0.5]",
        "lights.1.kind=environment",
        "lights.1.color=[0.2, 0.5, 1.0]",
        "lights.2.kind=cone",
        "lights.2.position=[5.0, 9.0, 14.0]",
        "lights.2.direction=[0.2, 0.3, 0.9]",
        "lights.2.angle=40",
    ];
    assert_same_for_every_budget(&many, [21, 30, 27]);
    // So nearly all is scattered that the error bound needs passes of its own.
    let white = ["transfer.colormap=white", "transfer.albedo=0.9999", "light.tolerance=0.01"];
    let bright = [&[LIGHT, "light.resolution=1", "light.directions=8"][..], &white].concat();
    assert_same_for_every_budget(&bright, [21, 20, 27]);
    // Nothing but what comes from the sky.
    let sky = ["lights.0.kind=environment", "light.resolution=1", "light.scattering=false"];
    assert_same_for_every_budget(&sky, [21, 20, 27]);
}

#[test]
fn lights_in_a_place_are_the_same_to_the_bit() {
    // The box reaches from 0.75 to 19.25, −2.2 to 23.4 and 2.7 to 33.3. Inside, on a plane of voxels, on one between slabs, near a
    // face, and outside on every side along z.
    for place in [
        "[10.1, 9.0, 12.03]",
        "[10.0, 9.2, 12.6]",
        "[3.2, 2.0, 27.0]",
        "[9.0, 9.2, 3.0]",
        "[9.0, 9.2, 60.0]",
        "[4.0, 3.0, -10.0]",
        "[-8.0, 3.0, 12.9]",
    ] {
        let place = format!("lights.0.position={place}");
        assert_same_for_every_budget(&["lights.0.kind=point", &place, "light.scattering=false"], ODD);
    }
    let cone = ["lights.0.kind=cone", "lights.0.position=[9.0, 9.2, 18.1]", "lights.0.direction=[0.2, 0.1, 0.9]"];
    let more = ["lights.1.direction=[0.3, 0.1, 0.8]", "light.direct_resolution=0.7", "light.resolution=0.5"];
    assert_same_for_every_budget(&[&cone[..], &more, &["light.directions=8"]].concat(), ODD);
}

/// Light in the volume included.
#[test]
fn the_papers_light_is_the_same_to_the_bit() {
    let point = ["lights.1.kind=point", "lights.1.position=[10.0, 9.0, 17.0]"];
    assert_same_for_every_budget(&[&["light.model=paper", LIGHT][..], &point].concat(), ODD);
    for (convection, diffusion) in [("ordered", "multigrid"), ("volume", "gauss-seidel"), ("layers", "exact")] {
        let keys = [format!("light.convection={convection}"), format!("light.diffusion={diffusion}")];
        let sets = ["light.model=paper", LIGHT, &keys[0], &keys[1], "light.warm=false", "light.sigma_s=[3, 2, 1]"];
        assert_same_for_every_budget(&sets, [21, 30, 27]);
    }
}

/// Each value of the light is rounded once, so that no pixel is off by more than that part of it.
#[test]
fn light_in_halves_is_off_by_one_rounding() {
    let lights = ["lights.1.kind=point", "lights.1.position=[10.0, 9.0, 17.0]"];
    let scene = scene(&[&[LIGHT, "light.scattering=false"], &lights[..]].concat());
    let budget = memory::smallest(&scene, &grid(ODD)).unwrap();
    let device = Paged::new(cpu(), budget, &std::env::temp_dir()).keeping(ScratchKey::F16);
    let halves = light(Arc::new(device), &scene, ODD, 1).unwrap();
    let whole = light(cpu(), &scene, ODD, 1).unwrap();
    assert_ne!(bits(&halves[0]), bits(&whole[0]));
    let [halves, whole] = [&halves[0], &whole[0]].map(|o| o.frames[0].frame.pixels.as_flattened());
    let off = whole.iter().zip(halves).filter(|(a, b)| (**a - **b).abs() > 4.9e-4 * a.abs() + 1e-6).count();
    assert_eq!(off, 0, "2⁻¹¹ of a value, and what f32 rounds");
}

/// Kernels that look anywhere in a volume have files for memory.
#[test]
fn every_renderer_is_the_same_to_the_bit() {
    for more in [
        &["render.kind=pathtrace", "render.samples=3"][..],
        &["render.kind=slices"],
        &["render.kind=isosurface", "isosurface.values=[0.4]", "isosurface.quality=preview"],
        &[
            "render.kind=isosurface",
            "isosurface.values=[0.3, 0.6]",
            "isosurface.quality=preview",
            "isosurface.light=volume",
        ],
        &["transfer.preintegrated=true"],
        &["transfer.regions=[{gradient = [0.2, 1], opacity = 0.5}]", "transfer.steepest=2"],
        &["light.interpolation=cubic"],
    ] {
        assert_same_for_every_budget(&[&[LIGHT, "light.scattering=false"], more].concat(), ODD);
    }
}

/// Files that stand for memory are given back before they are more of it than the budget allows.
#[test]
#[cfg(target_os = "linux")]
fn paths_through_a_volume_of_many_budgets_keep_within_one() {
    let (size, sets) = ([128; 3], ["render.kind=pathtrace", "render.samples=32", "transfer.extinction=0.1"]);
    let scene = scene(&sets);
    let budget = memory::smallest(&scene, &grid(size)).unwrap();
    assert!(4 * grid(size).len() as u64 > 3 * budget, "{budget} bytes are not a small part of the volume");
    let trace = |device: Arc<dyn Device>| {
        let mut session = Session::new(device, scene.clone(), Some([0.0, 1.0]), false).unwrap();
        let step = Timestep { step: 0, time: None, grid: grid(size), field: counted(size, 0.0) };
        bits(&session.advance(step).unwrap())
    };
    let device = paged(cpu(), budget);
    assert!(trace(device.clone()) == trace(cpu()));
    assert!(device.released() > 0);
}

/// What does not fit on a GPU is looked at as a whole by the CPU.
#[test]
#[cfg(feature = "gpu")]
fn the_cpu_looks_at_wholes_for_a_gpu() {
    let name = std::env::var("GLOAMING_TEST_DEVICE").unwrap_or("llvmpipe".into());
    let gpu = gloaming::device::open(&name, 0).expect("apt-get install mesa-vulkan-drivers libvulkan1");
    let scene = scene(&["render.kind=pathtrace", "render.samples=3"]);
    let trace = |device: Arc<dyn Device>| {
        let mut session = Session::new(device, scene.clone(), Some([0.0, 1.0]), false).unwrap();
        let step = Timestep { step: 0, time: None, grid: grid(ODD), field: counted(ODD, 0.0) };
        bits(&session.advance(step).unwrap())
    };
    assert!(trace(paged(gpu, memory::smallest(&scene, &grid(ODD)).unwrap())) == trace(cpu()));
}

#[test]
fn cameras_inside_and_outside_are_the_same_to_the_bit() {
    // The box reaches from 0.75 to 19.25, −2.2 to 23.4 and 2.7 to 33.3.
    for eye in
        ["[10.1, 9.0, 12.0]", "[10.0, 10.0, 60.0]", "[10.2, 8.0, -30.0]", "[-20.0, 4.0, 17.0]", "[8.0, 8.0, 33.2]"]
    {
        let eye = format!("cameras.0.position={eye}");
        let sets = [LIGHT, &eye, "cameras.0.fov=70", "cameras.0.up=[0.1, 1.0, 0.0]", "light.scattering=false"];
        assert_same_for_every_budget(&sets, ODD);
    }
}

/// The kernels of GPUs, on software Vulkan unless `GLOAMING_TEST_DEVICE` names another adapter.
#[test]
#[cfg(feature = "gpu")]
fn a_gpu_gives_the_same_to_the_bit() {
    let name = std::env::var("GLOAMING_TEST_DEVICE").unwrap_or("llvmpipe".into());
    let gpu = gloaming::device::open(&name, 0).expect("apt-get install mesa-vulkan-drivers libvulkan1");
    let eye = ["cameras.0.position=[10.1, 9.0, 12.0]", "cameras.0.fov=70", "render.shading=phong"];
    for (direction, more) in [("[0.3, 0.5, -0.8]", &[][..]), ("[0.9, 0.2, 0.3]", &eye), ("[0.1, -0.9, -0.3]", &[])] {
        let direction = format!("lights.0.direction={direction}");
        let sets = [&[&direction, "light.scattering=false", "lights.1.direction=[0.2, 0.1, 0.9]"][..], more].concat();
        assert_same_on(&gpu, &sets, [19, 24, 33]);
    }
    let lamp = ["lights.0.kind=point", "lights.0.position=[5.0, 3.0, 12.03]", "light.scattering=false"];
    assert_same_on(&gpu, &lamp, [19, 24, 33]);
}

/// Sums over ordinates have another order there, slab by slab; what both certify is a thousandth of the largest fluence.
#[test]
#[cfg(feature = "gpu")]
fn a_gpu_scatters_light_alike() {
    let name = std::env::var("GLOAMING_TEST_DEVICE").unwrap_or("llvmpipe".into());
    let gpu = gloaming::device::open(&name, 0).expect("apt-get install mesa-vulkan-drivers libvulkan1");
    let size = [19, 24, 33];
    let lamp = ["lights.1.kind=point", "lights.1.position=[5.0, 3.0, 14.0]", "transfer.anisotropy=0.4"];
    for more in [&[][..], &["light.direct_resolution=0.4"], &lamp] {
        let sets = [&[LIGHT, "light.resolution=1", "light.directions=8", "light.tolerance=0.001"][..], more].concat();
        let scene = scene(&sets);
        let whole = light(gpu.clone(), &scene, size, 2).unwrap();
        let part = light(paged(gpu.clone(), memory::smallest(&scene, &grid(size)).unwrap()), &scene, size, 2).unwrap();
        for (whole, part) in whole.iter().zip(&part) {
            let fluence = |o: &Output| o.light.as_ref().unwrap().fluence.as_flattened().to_vec();
            let (whole, part) = (fluence(whole), fluence(part));
            let largest = whole.iter().copied().fold(0.0, f32::max);
            let off = whole.iter().zip(&part).fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
            assert!(largest > 0.1 && off <= 2e-3 * largest, "{off} of {largest}");
        }
    }
}

/// Scattered light starts from that of the step before, wherever it is kept.
#[test]
fn scattered_light_starts_warm() {
    let sets = [LIGHT, "light.resolution=1", "light.directions=8", "transfer.colormap=white", "transfer.albedo=0.95"];
    let steps = |warm: &str| {
        let scene = scene(&[&sets[..], &[warm]].concat());
        let budget = memory::smallest(&scene, &grid(ODD)).unwrap();
        let field: Arc<dyn Field> = counted(ODD, 0.0);
        let mut session = Session::new(paged(cpu(), budget), scene, Some([0.0, 1.0]), false).unwrap();
        let step = |n| Timestep { step: n, time: None, grid: grid(ODD), field: field.clone() };
        [0, 1].map(|n| session.advance(step(n)).unwrap().row.iterations)
    };
    let (warm, cold) = (steps("light.warm=true"), steps("light.warm=false"));
    assert!(warm[1] <= 2 && cold[1] == cold[0] && cold[0] > 4, "{warm:?} {cold:?}");
}

#[test]
fn data_are_read_once_a_pass_and_a_slab_at_a_time() {
    let (scene, size) = (scene(&[LIGHT, "light.scattering=false"]), [24, 32, 200]);
    let field = counted(size, 0.0);
    let budget = 2 * memory::smallest(&scene, &grid(size)).unwrap();
    let mut session = Session::new(paged(cpu(), budget), scene, Some([0.0, 1.0]), false).unwrap();
    session.advance(Timestep { step: 0, time: None, grid: grid(size), field: field.clone() }).unwrap();
    let passes = field.bytes.load(Ordering::Relaxed) as f64 / (4.0 * grid(size).len() as f64);
    // Brick ranges, light, rays; the empty ends are not even looked at by rays.
    assert!((2.0..3.1).contains(&passes), "{passes} passes");
    assert!(field.largest.load(Ordering::Relaxed) < size[2] / 4);
}

/// Rows in which no brick shows anything are read once, to find that out.
#[test]
fn empty_rows_are_not_read_again() {
    let (scene, size) = (scene(&[LIGHT, "light.scattering=false"]), [24, 64, 96]);
    let values: Vec<f32> = values(size, 0.0)
        .into_iter()
        .enumerate()
        .map(|(i, v)| if (20..28).contains(&(i / 24 % 64)) { v } else { 0.0 })
        .collect();
    let field = |values: Vec<f32>| {
        Arc::new(Counted { of: Dense::new(size, values), bytes: AtomicU64::new(0), largest: AtomicUsize::new(0) })
    };
    let lit = |device: Arc<dyn Device>, field: Arc<Counted>| {
        let mut session = Session::new(device, scene.clone(), Some([0.0, 1.0]), false).unwrap();
        bits(&session.advance(Timestep { step: 0, time: None, grid: grid(size), field }).unwrap())
    };
    let part = field(values.clone());
    let budget = 2 * memory::smallest(&scene, &grid(size)).unwrap();
    assert!(lit(paged(cpu(), budget), part.clone()) == lit(cpu(), field(values)));
    let passes = part.bytes.load(Ordering::Relaxed) as f64 / (4.0 * grid(size).len() as f64);
    // A quarter of the rows for the light, where bricks are of 8; two bricks more for rays.
    assert!((1.5..1.9).contains(&passes), "{passes} passes");
}

/// Lights that cross planes the same way are swept in one pass.
#[test]
fn lights_share_a_reading() {
    let passes = |direction: &str| {
        let second = format!("lights.1.direction={direction}");
        let (scene, size) = (scene(&[LIGHT, &second, "light.scattering=false"]), [24, 32, 200]);
        let field = counted(size, 0.0);
        let budget = 2 * memory::smallest(&scene, &grid(size)).unwrap();
        let mut session = Session::new(paged(cpu(), budget), scene, Some([0.0, 1.0]), false).unwrap();
        session.advance(Timestep { step: 0, time: None, grid: grid(size), field: field.clone() }).unwrap();
        field.bytes.load(Ordering::Relaxed) as f64 / (4.0 * grid(size).len() as f64)
    };
    let (alike, opposite) = (passes("[0.9, 0.1, -0.2]"), passes("[0.9, 0.1, 0.2]"));
    assert!((0.9..1.1).contains(&(opposite - alike)), "{alike} and {opposite} passes");
}

#[test]
fn too_little_memory_names_what_is_enough() {
    for sets in [&[LIGHT, "light.scattering=false"][..], &[LIGHT, "light.resolution=0.25", "light.directions=8"]] {
        let scene = scene(sets);
        let grid = grid(ODD);
        let Err(Error::OutOfMemory { needed, .. }) = memory::fit(cpu(), &scene, &grid, 1000, Path::new("/tmp")) else {
            panic!("1000 bytes are not enough")
        };
        let device = memory::fit(cpu(), &scene, &grid, needed, &std::env::temp_dir()).unwrap();
        assert!(device.pages(), "{}", device.name());
        light(device, &scene, ODD, 1).unwrap();
        // Well below it the device itself says so.
        assert!(matches!(light(paged(cpu(), needed / 4), &scene, ODD, 1), Err(Error::OutOfMemory { .. })));
    }
}

#[test]
fn no_scratch_folder_is_an_error_that_names_it() {
    let nowhere = Arc::new(Paged::new(cpu(), 1 << 20, Path::new("/no/such/folder")));
    let scene = scene(&[LIGHT, "light.scattering=false"]);
    let why = light(nowhere, &scene, [64, 64, 64], 1).map(|_| ()).unwrap_err().to_string();
    assert!(why.contains("/no/such/folder"), "{why}");
}

const SMOKE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/smoke.h5");

/// `gloaming render` of two steps of smoke, started through a shell: its words and its first picture.
fn rendered(shell: &str, folder: &Path, memory: u64) -> (std::process::Output, std::path::PathBuf) {
    let target = folder.join(format!("{memory}_{{step:03}}.exr"));
    let mut command = std::process::Command::new("sh");
    command.arg("-c").arg(shell).arg("sh").arg(env!("CARGO_BIN_EXE_gloaming")).args(["render", SMOKE]);
    command.args(["--steps", "30..40:8", "--memory", &memory.to_string(), "--device", "cpu", "--out"]).arg(&target);
    command.args(SMOKE_SETS.iter().flat_map(|set| ["--set", set]));
    let output = command.env("TMPDIR", folder.join("scratch")).output().unwrap();
    (output, folder.join(format!("{memory}_038.exr")))
}

const SMOKE_SETS: [&str; 5] = [
    "render.size=[96, 64]",
    "light.directions=8",
    "light.resolution=0.7",
    "lights.0.kind=point",
    "lights.0.position=[40, 90, 60]",
];

fn smallest_for_smoke() -> u64 {
    let series = source::open(&SourceSpec { series: vec![SMOKE.into()], ..Default::default() }).unwrap();
    let scene = Scene::load(None, &SMOKE_SETS.map(String::from)).unwrap();
    memory::with_decoded(memory::smallest(&scene, &series.grid()).unwrap())
}

#[test]
fn a_series_comes_out_the_same_whatever_the_memory() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("scratch")).unwrap();
    let pictures = [smallest_for_smoke(), 1 << 33].map(|memory| {
        let (said, picture) = rendered("exec \"$@\"", folder.path(), memory);
        assert!(said.status.success(), "{}", String::from_utf8_lossy(&said.stderr));
        sink::exr::read(&picture).unwrap().pixels
    });
    assert!(pictures[0] == pictures[1] && pictures[0].as_flattened().iter().any(|v| *v > 0.01));
}

/// On a file system of 4 MiB where one can be mounted, by root or in a name space of one's own; else with files of at most 1 MiB.
#[test]
#[cfg(target_os = "linux")]
fn scratch_that_is_full_is_an_error_that_says_so_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("scratch")).unwrap();
    let mount = r#"mount -t tmpfs -o size=4m none "$TMPDIR""#;
    let possible = |how: &str| {
        let mut shell = std::process::Command::new("sh");
        shell.args(["-c", how]).env("TMPDIR", folder.path().join("scratch"));
        shell.output().unwrap().status.success()
    };
    // What the file system holds at the end is looked at where it is mounted.
    let then = r#""$@"; code=$?; echo "left behind: $(ls -A "$TMPDIR" | wc -l), $(df -k --output=used "$TMPDIR" | tail -n 1)"; exit $code"#;
    let shell = if possible(&format!("unshare -rm sh -c '{mount}'")) {
        format!("exec unshare -rm sh -c '{mount} && {then}' sh \"$@\"")
    } else if possible(&format!("unshare -m sh -c '{mount}'")) {
        format!("exec unshare -m sh -c '{mount} && {then}' sh \"$@\"")
    } else {
        format!("trap '' XFSZ; ulimit -f 2048; {then}")
    };
    let (said, _) = rendered(&shell, folder.path(), smallest_for_smoke());
    let (out, err) = (String::from_utf8_lossy(&said.stdout), String::from_utf8_lossy(&said.stderr));
    assert!(!said.status.success() && err.contains("no room left for light"), "{out}{err}");
    assert!(err.contains("scratch") && err.contains("TMPDIR=FOLDER"), "{err}");
    assert!(out.contains("left behind: 0,"), "{out}");
    assert!(shell.starts_with("trap") || out.trim_end().ends_with(" 0"), "{out}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "no picture, nor a part of one");
}

/// A preview is a picture of the same thing, and says in the file that it is one.
#[test]
fn a_preview_is_near_the_whole_and_says_so() {
    let out = tempfile::tempdir().unwrap();
    let smoke = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/smoke.h5");
    let picture = |factor: usize| {
        let sets = [
            format!("render.preview={factor}"),
            "render.size=[96, 96]".into(),
            "light.scattering=false".into(),
            "field.range=[0, 1]".into(),
            // Thin, and of one colour: bright edges of opaque smoke are what blocks must blur.
            "transfer.colormap=white".into(),
            "transfer.extinction=0.3".into(),
        ];
        let target = out.path().join(format!("preview_{factor}.exr"));
        let job = Job {
            series: source::open(&SourceSpec { series: vec![smoke.into()], ..Default::default() }).unwrap(),
            indices: vec![40],
            scene: Scene::load(None, &sets).unwrap(),
            device: cpu(),
            outputs: vec![target.to_str().unwrap().into()],
            ledger: None,
            follow: None,
            resume: false,
            keep: 0,
            light_state: None,
        };
        pipeline::run(job, &AtomicBool::new(false), &mut |_| ()).unwrap();
        let header = &exr::meta::MetaData::read_from_file(&target, true).unwrap().headers[0];
        let mark = header.own_attributes.other.get(&exr::meta::attribute::Text::from("previewBlocks")).cloned();
        (sink::exr::read(&target).unwrap().pixels, mark)
    };
    let (whole, mark) = picture(1);
    assert_eq!(mark, None);
    let mean = whole.iter().map(|p| f64::from(p[1])).sum::<f64>() / whole.len() as f64;
    let mut before = 0.0;
    for factor in [2, 3] {
        let (blocks, mark) = picture(factor);
        assert_eq!(mark, Some(exr::meta::attribute::AttributeValue::I32(factor as i32)));
        let squares: f64 = whole.iter().zip(&blocks).map(|(a, b)| f64::from(a[1] - b[1]).powi(2)).sum();
        let error = (squares / whole.len() as f64).sqrt() / mean;
        // What blocks blur away, and more of it with larger blocks: 0.24 and 0.43 of the mean, most of the picture being black.
        assert!(error < 0.5 && error > before, "{error} of the mean at {factor}");
        before = error;
    }
}
