//! Kernels in WGSL: their sources, and pipelines whose bindings are found by name.
//!
//! A shader is the plain concatenation of small files of `shaders/`. Its bindings are declared there and nowhere else: the
//! layout comes from the parsed module, and a call names the buffers it binds.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

use encase::ShaderSize;
use wgpu::naga;

use super::{
    bricks, classify, convect, crop, diffuse, gradient, irradiate, march, relax, sample, slices, source, surface,
    sweep, sweep_point, trace, transport,
};
use crate::error::{Error, Result};

/// A kernel's WGSL, and what the host believes about it.
#[derive(Debug, Clone, Copy)]
pub struct Shader {
    /// Its name: that of the file in `shaders/` that holds its entry points.
    pub name: &'static str,
    /// The whole module.
    pub source: &'static str,
    /// Bytes of the host's `Params`, if it has a uniform of that name; equals the span of the one in WGSL.
    pub params: Option<u64>,
}

macro_rules! shader {
    ($name:literal, [$($part:literal),*], $params:expr) => {
        Shader {
            name: $name,
            source: concat!(
                $(include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/shaders/", $part, ".wgsl")), "\n",)*
                include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/shaders/", $name, ".wgsl"))
            ),
            params: $params,
        }
    };
}

const fn size_of<P: ShaderSize>() -> Option<u64> {
    Some(P::SHADER_SIZE.get())
}

/// See `shaders/classify.wgsl`.
pub static CLASSIFY: Shader = shader!("classify", ["grid", "cover", "table"], size_of::<classify::Classify>());
/// See `shaders/restrict.wgsl`.
pub static RESTRICT: Shader = shader!("restrict", ["grid", "cover"], size_of::<classify::Restrict>());
/// See `shaders/brick_range.wgsl`.
pub static BRICK_RANGE: Shader = shader!("brick_range", ["grid", "bricks", "table"], size_of::<bricks::Bricks>());
/// See `shaders/change.wgsl`.
pub static CHANGE: Shader = shader!("change", ["grid", "bricks"], size_of::<bricks::Bricks>());
/// See `shaders/sweep.wgsl`.
pub static SWEEP: Shader = shader!("sweep", ["grid", "fronts"], size_of::<sweep::Params>());
/// See `shaders/sweep_point.wgsl`.
pub static SWEEP_POINT: Shader = shader!("sweep_point", ["grid", "fronts"], size_of::<sweep_point::Params>());
/// See `shaders/irradiate.wgsl`.
pub static IRRADIATE: Shader = shader!("irradiate", ["grid", "lamp"], size_of::<irradiate::Params>());
/// See `shaders/source.wgsl`.
pub static SOURCE: Shader = shader!("source", ["grid"], size_of::<source::Params>());
/// See `shaders/transport.wgsl`.
pub static TRANSPORT: Shader = shader!("transport", ["grid"], size_of::<transport::Params>());
/// See `shaders/convect.wgsl`.
pub static CONVECT: Shader = shader!("convect", ["grid", "bricks"], size_of::<convect::Params>());
/// See `shaders/diffuse.wgsl`.
pub static DIFFUSE: Shader = shader!("diffuse", ["grid"], size_of::<diffuse::Params>());
/// See `shaders/relax.wgsl`.
pub static RELAX: Shader = shader!("relax", ["grid"], size_of::<relax::Relax>());
/// See `shaders/prolong.wgsl`.
pub static PROLONG: Shader = shader!("prolong", ["grid"], size_of::<relax::Prolong>());
/// See `shaders/combine.wgsl`.
pub static COMBINE: Shader = shader!("combine", ["grid"], None);
/// See `shaders/crop.wgsl`.
pub static CROP: Shader = shader!("crop", ["grid"], size_of::<crop::Params>());
/// See `shaders/compose.wgsl`.
pub static COMPOSE: Shader = shader!("compose", ["grid"], None);
/// See `shaders/sample.wgsl`.
pub static SAMPLE: Shader = shader!("sample", ["grid"], size_of::<sample::Params>());
/// See `shaders/march.wgsl`.
pub static MARCH: Shader = shader!("march", ["grid", "table", "lamp", "matter", "clip"], size_of::<march::Params>());
/// See `shaders/gradient.wgsl`.
pub static GRADIENT: Shader = shader!("gradient", ["grid", "table"], size_of::<gradient::Params>());
/// See `shaders/slice.wgsl`.
pub static SLICE: Shader = shader!("slice", ["grid", "table", "lamp", "matter", "clip"], size_of::<slices::Params>());

/// See `shaders/surface_hits.wgsl`.
pub static SURFACE_HITS: Shader =
    shader!("surface_hits", ["grid", "table", "clip", "hash", "random", "surface"], size_of::<surface::Params>());
/// See `shaders/surface_occlusion.wgsl`.
pub static SURFACE_OCCLUSION: Shader =
    shader!("surface_occlusion", ["grid", "table", "clip", "hash", "random", "surface"], size_of::<surface::Params>());
/// See `shaders/surface_beauty.wgsl`.
pub static SURFACE_BEAUTY: Shader = shader!(
    "surface_beauty",
    ["grid", "table", "clip", "hash", "random", "surface", "surface_sky"],
    size_of::<surface::Params>()
);
/// See `shaders/surface_subsurface.wgsl`.
pub static SURFACE_SUBSURFACE: Shader = shader!(
    "surface_subsurface",
    ["grid", "table", "clip", "hash", "random", "surface", "surface_sky"],
    size_of::<surface::Params>()
);
/// See `shaders/surface_light.wgsl`.
pub static SURFACE_LIGHT: Shader = shader!(
    "surface_light",
    ["grid", "table", "clip", "hash", "random", "lamp", "surface"],
    size_of::<surface::Params>()
);

/// See `shaders/trace.wgsl`.
pub static TRACE: Shader = shader!(
    "trace",
    ["grid", "table", "clip", "hash", "numbers", "emitter", "shapes", "scatter", "walls"],
    size_of::<trace::Params>()
);

/// Every shader.
pub fn shaders() -> Vec<&'static Shader> {
    vec![
        &CLASSIFY,
        &RESTRICT,
        &BRICK_RANGE,
        &CHANGE,
        &SWEEP,
        &SWEEP_POINT,
        &IRRADIATE,
        &SOURCE,
        &TRANSPORT,
        &CONVECT,
        &COMBINE,
        &CROP,
        &COMPOSE,
        &SAMPLE,
        &MARCH,
        &GRADIENT,
        &SLICE,
        &SURFACE_HITS,
        &SURFACE_OCCLUSION,
        &SURFACE_BEAUTY,
        &SURFACE_SUBSURFACE,
        &SURFACE_LIGHT,
        &TRACE,
    ]
}

/// A shader on a device: its bindings by name, and its pipelines by entry point and constants.
pub(super) struct Kernel {
    name: &'static str,
    module: wgpu::ShaderModule,
    layout: wgpu::BindGroupLayout,
    pipeline_layout: wgpu::PipelineLayout,
    bindings: Vec<(String, u32)>,
    pipelines: Mutex<HashMap<String, wgpu::ComputePipeline>>,
}

impl Kernel {
    pub(super) fn new(device: &wgpu::Device, shader: &Shader) -> Result<Self> {
        let broken = |what: String| Error::Device(format!("shader {}: {what}", shader.name));
        let parsed = naga::front::wgsl::parse_str(shader.source)
            .map_err(|e| broken(e.emit_to_string_with_path(shader.source, &format!("{}.wgsl", shader.name))))?;

        let mut bindings = Vec::new();
        let mut entries = Vec::new();
        let mut immediate_size = 0;
        for (_, variable) in parsed.global_variables.iter() {
            let ty = match variable.space {
                naga::AddressSpace::Uniform => wgpu::BufferBindingType::Uniform,
                naga::AddressSpace::Storage { access } => {
                    wgpu::BufferBindingType::Storage { read_only: !access.contains(naga::StorageAccess::STORE) }
                }
                naga::AddressSpace::Immediate => {
                    immediate_size = parsed.types[variable.ty].inner.size(parsed.to_ctx());
                    continue;
                }
                _ => continue,
            };
            let (Some(binding), Some(name)) = (&variable.binding, &variable.name) else {
                return Err(broken("a resource without a binding".into()));
            };
            entries.push(wgpu::BindGroupLayoutEntry {
                binding: binding.binding,
                visibility: wgpu::ShaderStages::COMPUTE,
                ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
                count: None,
            });
            bindings.push((name.clone(), binding.binding));
        }

        let layout = device
            .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(shader.name), entries: &entries });
        let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(shader.name),
            bind_group_layouts: &[Some(&layout)],
            immediate_size,
        });
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(shader.name),
            source: wgpu::ShaderSource::Wgsl(shader.source.into()),
        });
        Ok(Kernel { name: shader.name, module, layout, pipeline_layout, bindings, pipelines: Mutex::default() })
    }

    /// Binds buffers by the names that WGSL gives them; all of them must be named.
    pub(super) fn bind(&self, device: &wgpu::Device, buffers: &[(&str, &wgpu::Buffer)]) -> Result<wgpu::BindGroup> {
        let entries = self
            .bindings
            .iter()
            .map(|(name, binding)| {
                let (_, buffer) = buffers
                    .iter()
                    .find(|(n, _)| n == name)
                    .ok_or_else(|| Error::Device(format!("shader {}: `{name}` is not bound", self.name)))?;
                Ok(wgpu::BindGroupEntry { binding: *binding, resource: buffer.as_entire_binding() })
            })
            .collect::<Result<Vec<_>>>()?;
        Ok(device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(self.name),
            layout: &self.layout,
            entries: &entries,
        }))
    }

    /// The pipeline of an entry point, compiled for these values of the shader's `override` constants. What a picture or a
    /// solve does not need costs nothing then; on software Vulkan a branch not taken costs as much as one taken.
    pub(super) fn pipeline(
        &self,
        device: &wgpu::Device,
        entry: &str,
        constants: &[(&str, f64)],
    ) -> wgpu::ComputePipeline {
        let mut pipelines = self.pipelines.lock().unwrap_or_else(PoisonError::into_inner);
        let create = || {
            device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(entry),
                layout: Some(&self.pipeline_layout),
                module: &self.module,
                entry_point: Some(entry),
                compilation_options: wgpu::PipelineCompilationOptions { constants, ..Default::default() },
                cache: None,
            })
        };
        pipelines.entry(format!("{entry} {constants:?}")).or_insert_with(create).clone()
    }
}
