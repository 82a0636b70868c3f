//! Bricks in the order in which light reaches them: one dispatch per front, see `shaders/fronts.wgsl`.

use super::shader::Shader;
use super::{Gpu, dispatch};
use crate::error::Result;
use crate::grid::BrickLayout;

/// Solves bricks front by front; returns what the kernel says of each, in order. `own` are the kernel's bindings but for those
/// of the fronts.
pub(super) fn front_by_front(
    gpu: &Gpu,
    shader: &Shader,
    entry: &'static str,
    own: &[(&str, &wgpu::Buffer)],
    layout: &BrickLayout,
    fronts: &[&[u32]],
) -> Result<Vec<f32>> {
    let listed: Vec<u32> = fronts.concat();
    if listed.is_empty() {
        return Ok(Vec::new());
    }
    let (bricks, changes) = (gpu.storage(&listed)?, gpu.scratch(layout.len())?);
    let kernel = gpu.kernel(shader)?;
    let bound = kernel.bind(&gpu.device, &[own, &[("bricks", &bricks), ("changes", &changes)]].concat())?;
    let mut encoder = gpu.encoder();
    {
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_bind_group(0, &bound, &[]);
        pass.set_pipeline(&kernel.pipeline(&gpu.device, entry, &[]));
        let mut first = 0;
        for front in fronts {
            pass.set_immediates(0, bytemuck::cast_slice(&[first, front.len() as u32]));
            dispatch(&mut pass, [front.len(), 1, 1]);
            first += front.len() as u32;
        }
    }
    gpu.submit(encoder)?;
    let changes: Vec<f32> = gpu.values(&changes, layout.len())?;
    Ok(listed.iter().map(|&b| changes[b as usize]).collect())
}
