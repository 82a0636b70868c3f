//! A volume at points.

use encase::ShaderType;
use glam::UVec3;

use super::shader::SAMPLE;
use super::{Gpu, holds, uvec3};
use crate::device::Buffer;
use crate::error::Result;

/// Points looked up at a time: 48 MiB of them.
const STRETCH: usize = 4 << 20;

#[derive(ShaderType)]
pub(super) struct Params {
    size: UVec3,
    count: u32,
}

pub(super) fn sample(gpu: &Gpu, size: [usize; 3], values: &Buffer, points: &[[f32; 3]], out: &mut [f32]) -> Result<()> {
    assert_eq!(points.len(), out.len(), "a value for each point");
    let values = holds(values, size.iter().product())?;
    for (points, out) in points.chunks(STRETCH).zip(out.chunks_mut(STRETCH)) {
        let params = gpu.uniform(&Params { size: uvec3(size), count: points.len() as u32 })?;
        let (points, found) = (gpu.storage(points.as_flattened())?, gpu.scratch(out.len())?);
        let bindings = [("params", &params), ("values", values), ("points", &points), ("found", &found)];
        gpu.run(&SAMPLE, "sample", &bindings, [out.len().div_ceil(256), 1, 1])?;
        gpu.read(&found, bytemuck::cast_slice_mut(out))?;
    }
    Ok(())
}
