//! The WGSL kernels: each parses, has the layout that the host believes, and computes what its twin in Rust computes.
//!
//! They run on software Vulkan unless `GLOAMING_TEST_DEVICE` names another adapter.
#![cfg(feature = "gpu")]

mod convection;
mod light;
mod march;
mod session;
mod slices;
mod surface;
mod trace;
mod volumes;

use std::sync::{Arc, OnceLock};

use glam::Vec3;
use gloaming::device::gpu::{Gpu, adapters, shader};
use gloaming::device::{Buffer, Device, cpu::Cpu};
use gloaming::transfer::Table;
use gloaming::{Error, Grid};

/// Prime to bricks and workgroups on every axis.
const ODD: [usize; 3] = [37, 64, 51];

/// The device under test, opened once.
fn shared() -> &'static Arc<Gpu> {
    static GPU: OnceLock<Arc<Gpu>> = OnceLock::new();
    GPU.get_or_init(|| {
        let name = std::env::var("GLOAMING_TEST_DEVICE").unwrap_or("llvmpipe".into());
        Arc::new(Gpu::open(Some(&name)).unwrap_or_else(|e| {
            panic!("{e}\nThese tests want software Vulkan: apt-get install mesa-vulkan-drivers libvulkan1")
        }))
    })
}

fn gpu() -> &'static Gpu {
    shared()
}

fn cpu() -> &'static Cpu {
    static CPU: OnceLock<Cpu> = OnceLock::new();
    CPU.get_or_init(|| Cpu::new(0).unwrap())
}

/// Numbers in 0..1 without pattern.
fn noise(seed: u32, n: usize) -> Vec<f32> {
    let mut state = seed.wrapping_mul(2_654_435_761).wrapping_add(0x9e37_79b9);
    (0..n)
        .map(|_| {
            state ^= state << 13;
            state ^= state >> 17;
            state ^= state << 5;
            (state >> 8) as f32 / 16_777_216.0
        })
        .collect()
}

fn upload(device: &dyn Device, values: &[f32]) -> Buffer {
    let mut buffer = device.alloc(values.len()).unwrap();
    device.upload(values, &mut buffer).unwrap();
    buffer
}

fn download(device: &dyn Device, buffer: &Buffer) -> Vec<f32> {
    let mut out = vec![0.0; buffer.len()];
    device.download(buffer, &mut out).unwrap();
    out
}

/// Runs the same on both devices.
fn both<T>(run: impl Fn(&dyn Device) -> T) -> [T; 2] {
    [run(cpu()), run(gpu())]
}

/// Fails unless `got` is within `tolerance` of `want`, relative to the largest value wanted.
fn assert_close(want: &[f32], got: &[f32], tolerance: f32, what: &str) {
    assert_eq!(want.len(), got.len(), "{what}");
    let scale = want.iter().filter(|v| v.is_finite()).fold(f32::MIN_POSITIVE, |m, v| m.max(v.abs()));
    for (i, (w, g)) in want.iter().zip(got).enumerate() {
        assert!(w == g || (w - g).abs() <= tolerance * scale, "{what}: value {i}: {w} on the CPU, {g} on the GPU");
    }
}

/// A smooth transfer function with colour and glow.
fn table() -> Table {
    let at = |i: usize| i as f32 / (Table::ENTRIES - 1) as f32;
    Table {
        chromatic: [1.0; 3],
        lo: 0.1,
        hi: 0.8,
        extinction: (0..Table::ENTRIES).map(|i| 9.0 * at(i) * at(i)).collect(),
        albedo: (0..Table::ENTRIES).map(|i| [0.9, 0.5 + 0.4 * at(i), 0.8 - 0.3 * at(i)]).collect(),
        emission: (0..Table::ENTRIES).map(|i| [at(i), 0.0, 0.5 * at(i)]).collect(),
        ..Default::default()
    }
}

fn anisotropic() -> Grid {
    Grid { size: ODD, spacing: [0.02, 0.015, 0.03], origin: [1.0, -2.0, 0.5] }
}

/// All octants, each axis dominant, exactly along axes, and along a diagonal where the foot is a voxel.
fn directions() -> Vec<Vec3> {
    let mut all: Vec<Vec3> = Vec::new();
    for (i, lengths) in [[0.9f32, 0.35, 0.2], [0.3, 0.8, 0.5], [0.1, 0.4, 0.7]].iter().enumerate() {
        for octant in 0..8 {
            // Two of three octants for each dominant axis keep the test short.
            if (octant + i) % 3 != 0 {
                let sign = |a: usize| if octant >> a & 1 == 0 { 1.0 } else { -1.0 };
                all.push(Vec3::new(sign(0) * lengths[0], sign(1) * lengths[1], sign(2) * lengths[2]).normalize());
            }
        }
    }
    all.extend([Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z]);
    all.extend([Vec3::new(1.0, -1.0, 1.0).normalize(), Vec3::new(0.0, 1.0, -1.0).normalize()]);
    all
}

fn module(s: &shader::Shader) -> naga::Module {
    naga::front::wgsl::parse_str(s.source).unwrap_or_else(|e| panic!("{}", e.emit_to_string(s.source)))
}

#[test]
fn shaders_are_valid() {
    for s in shader::shaders() {
        let capabilities = naga::valid::Capabilities::IMMEDIATES;
        let mut validator = naga::valid::Validator::new(naga::valid::ValidationFlags::all(), capabilities);
        let checked = validator.validate(&module(s));
        assert!(checked.is_ok(), "{}: {}", s.name, checked.unwrap_err().emit_to_string(s.source));
    }
}

#[test]
fn uniforms_have_the_layout_of_the_host() {
    for s in shader::shaders() {
        let module = module(s);
        let uniform = module.global_variables.iter().find(|(_, v)| v.space == naga::AddressSpace::Uniform);
        let span = uniform.map(|(_, v)| u64::from(module.types[v.ty].inner.size(module.to_ctx())));
        assert_eq!(s.params, span, "{}", s.name);
    }
}

#[test]
fn values_come_back() {
    let values = noise(1, 12_345);
    assert_eq!(download(gpu(), &upload(gpu(), &values)), values);
    assert!(download(gpu(), &gpu().alloc(999).unwrap()).iter().all(|&v| v == 0.0));
    assert!(gpu().alloc(0).unwrap().is_empty());
}

#[test]
fn too_much_is_an_error() {
    let budget = gpu().report().max_binding;
    match gpu().alloc((budget / 4 + 1) as usize) {
        Err(Error::OutOfMemory { needed, budget: b }) => assert!(needed == budget + 4 && b == budget),
        other => panic!("{:?}", other.map(|b| b.len())),
    }
}

#[test]
fn foreign_and_short_buffers_are_errors() {
    let mut out = gpu().alloc(8).unwrap();
    let mut coarse = |values: &Buffer| gpu().restrict([4; 3], values, [2; 3], &mut out);
    assert!(matches!(coarse(&upload(cpu(), &[0.0; 64])), Err(Error::Device(_))));
    assert!(matches!(coarse(&upload(gpu(), &[0.0; 63])), Err(Error::Device(_))));
    assert!(coarse(&upload(gpu(), &[0.0; 64])).is_ok());
}

#[test]
fn unknown_adapters_are_named_errors() {
    let Err(e) = Gpu::open(Some("no such adapter")) else { panic!("opened") };
    let message = e.to_string();
    assert!(message.contains("no such adapter") && message.contains("try:"), "{message}");
    assert!(adapters().iter().any(|a| message.contains(&a.name)), "{message}");
}

#[test]
fn adapters_are_found_by_any_part_of_their_name() {
    let report = gpu().report();
    assert!(report.max_binding >= 128 << 20 && report.max_workgroup >= 256 && report.lacks.is_none(), "{report:?}");
    let part = report.name[..5].to_uppercase();
    assert_eq!(Gpu::open(Some(&part)).unwrap().report().name, report.name);
}

#[test]
fn what_software_vulkan_would_cut_short_is_refused() {
    if !gpu().report().name.contains("llvmpipe") {
        return;
    }
    let (values, mut out) = (gpu().alloc(64 * 64 * 64).unwrap(), gpu().alloc(1).unwrap());
    let refused = gpu().restrict([64; 3], &values, [1; 3], &mut out);
    assert!(matches!(refused, Err(Error::Unsupported(_))), "{refused:?}");
}

/// In a process of its own, as a driver is looked for once.
#[test]
fn without_a_driver_there_are_no_adapters() {
    const CHILD: &str = "GLOAMING_TEST_WITHOUT_DRIVER";
    if std::env::var_os(CHILD).is_none() {
        let child = std::process::Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "without_a_driver_there_are_no_adapters", "--nocapture"])
            .env(CHILD, "1")
            .env("WGPU_BACKEND", "vulkan")
            .env("VK_ICD_FILENAMES", "/nowhere.json")
            .env("VK_DRIVER_FILES", "/nowhere.json")
            .output()
            .unwrap();
        assert!(child.status.success(), "{}", String::from_utf8_lossy(&child.stdout));
        return;
    }
    assert_eq!(adapters(), []);
    assert!(Gpu::hardware().unwrap().is_none());
    for name in [None, Some("llvmpipe")] {
        let Err(e) = Gpu::open(name) else { panic!("opened {name:?}") };
        assert!(e.to_string().contains("--device cpu"), "{e}");
    }
}
