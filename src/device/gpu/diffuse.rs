//! Diffusion, exact in time: one dispatch for each axis.

use encase::ShaderType;
use glam::UVec3;

use super::classify::groups;
use super::shader::DIFFUSE;
use super::{Gpu, holds, uvec3};
use crate::device::Buffer;
use crate::error::Result;

#[derive(ShaderType)]
pub(super) struct Params {
    size: UVec3,
    axis: u32,
    radius: u32,
}

pub(super) fn diffuse(gpu: &Gpu, size: [usize; 3], weights: [&[f32]; 3], values: &mut Buffer) -> Result<()> {
    let len = size.iter().product();
    let values = holds(values, len)?;
    let other = gpu.spare(len)?;
    for (axis, weights) in weights.into_iter().enumerate() {
        if weights.len() < 2 {
            continue;
        }
        gpu.rounds(weights.len() as f64, "so strong a diffusion")?;
        let mut encoder = gpu.encoder();
        encoder.copy_buffer_to_buffer(values, 0, &other, 0, 4 * len as u64);
        gpu.submit(encoder)?;
        let params = Params { size: uvec3(size), axis: axis as u32, radius: weights.len() as u32 - 1 };
        gpu.run(
            &DIFFUSE,
            "diffuse",
            &[
                ("params", &gpu.uniform(&params)?),
                ("values", &other),
                ("weights", &gpu.storage(weights)?),
                ("out", values),
            ],
            groups(size),
        )?;
    }
    Ok(())
}
