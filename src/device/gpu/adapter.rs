//! Which adapters there are, and which one to take.

use crate::error::{Error, Result};

/// What there is to know about an adapter before opening it.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct AdapterReport {
    /// The adapter's name, as `--device` takes it.
    pub name: String,
    /// The interface it is reached through: `vulkan`, `metal`, `dx12` or `gl`.
    pub backend: String,
    /// True for a processor made for it, false for software that runs on the CPU.
    pub hardware: bool,
    /// The driver and its version.
    pub driver: String,
    /// Bytes of the largest buffer.
    pub max_buffer: u64,
    /// Bytes of the largest buffer that a kernel can work on: bounds the number of voxels, at 4 bytes each.
    pub max_binding: u64,
    /// Invocations in the largest workgroup.
    pub max_workgroup: u32,
    /// Why kernels cannot run on it, if so.
    pub lacks: Option<String>,
}

/// Invocations of a workgroup that the kernels are written for.
const WORKGROUP: u32 = 256;
/// Storage buffers of the kernel with the most.
const STORAGE_BUFFERS: u32 = 13;

/// The adapters of this machine. Empty where there is no driver.
pub fn adapters() -> Vec<AdapterReport> {
    enumerate().iter().map(report).collect()
}

pub(super) fn report(adapter: &wgpu::Adapter) -> AdapterReport {
    let (info, limits) = (adapter.get_info(), adapter.limits());
    let lacks = if !adapter.features().contains(wgpu::Features::IMMEDIATES) {
        Some("immediate data".to_owned())
    } else if limits.max_compute_invocations_per_workgroup < WORKGROUP {
        Some(format!("workgroups of {WORKGROUP}"))
    } else if limits.max_storage_buffers_per_shader_stage < STORAGE_BUFFERS {
        Some(format!("{STORAGE_BUFFERS} storage buffers in a kernel"))
    } else {
        None
    };
    AdapterReport {
        backend: info.backend.to_string(),
        hardware: !matches!(info.device_type, wgpu::DeviceType::Cpu),
        driver: [info.driver, info.driver_info].join(" ").trim().to_owned(),
        name: info.name,
        max_buffer: limits.max_buffer_size,
        max_binding: limits.max_storage_buffer_binding_size,
        max_workgroup: limits.max_compute_invocations_per_workgroup,
        lacks,
    }
}

fn enumerate() -> Vec<wgpu::Adapter> {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
    pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()))
}

/// The best hardware adapter that can run the kernels.
pub(super) fn hardware() -> Option<wgpu::Adapter> {
    enumerate().into_iter().filter(|a| report(a).hardware && report(a).lacks.is_none()).min_by_key(rank)
}

/// The best adapter whose name or driver contains `name`, in any case.
pub(super) fn named(name: &str) -> Result<wgpu::Adapter> {
    let wanted = name.to_lowercase();
    let all = enumerate();
    let matches = |a: &wgpu::Adapter| {
        let r = report(a);
        // Mesa's software Vulkan is called lavapipe and calls itself llvmpipe, the compiler inside.
        let lavapipe = if r.backend == "vulkan" && r.name.starts_with("llvmpipe") { "lavapipe" } else { "" };
        format!("{} {} {} {lavapipe}", r.name, r.driver, r.backend).to_lowercase().contains(&wanted)
    };
    let Some(adapter) = all.iter().filter(|a| matches(a)).min_by_key(|a| (report(a).lacks.is_some(), rank(a))) else {
        let known: Vec<String> = all.iter().map(|a| a.get_info().name).collect();
        return Err(Error::Device(match known.is_empty() {
            true => format!("no adapter `{name}`, nor any other: no graphics driver is installed\n  try: --device cpu"),
            false => format!("no adapter `{name}`; there is: {}\n  try: gloaming devices", known.join(", ")),
        }));
    };
    match report(adapter).lacks {
        Some(lack) => Err(Error::Device(format!(
            "{} has no {lack}, which the kernels need\n  try: another driver, or --device cpu",
            adapter.get_info().name
        ))),
        None => Ok(adapter.clone()),
    }
}

/// Discrete before integrated before virtual; native interfaces before GL.
fn rank(adapter: &wgpu::Adapter) -> (u8, u8) {
    let info = adapter.get_info();
    let kind = match info.device_type {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    };
    (kind, u8::from(info.backend == wgpu::Backend::Gl))
}
