//! What of a light from one place reaches a voxel.

use encase::ShaderType;
use glam::{UVec3, Vec3};

use super::classify::groups;
use super::shader::SPREAD;
use super::{Gpu, holds, uvec3};
use crate::device::Buffer;
use crate::device::convection::Spread;
use crate::error::Result;

#[derive(ShaderType)]
pub(super) struct Params {
    size: UVec3,
    nearest: f32,
    position: Vec3,
    inner: f32,
    spacing: Vec3,
    outer: f32,
    axis: Vec3,
}

pub(super) fn spread(gpu: &Gpu, size: [usize; 3], spread: &Spread, rho: &Buffer, out: &mut Buffer) -> Result<()> {
    let len = size.iter().product();
    let params = gpu.uniform(&Params {
        size: uvec3(size),
        nearest: spread.nearest,
        position: Vec3::from_array(spread.position),
        inner: spread.inner,
        spacing: Vec3::from_array(spread.spacing),
        outer: spread.outer,
        axis: Vec3::from_array(spread.axis),
    })?;
    let [rho, out] = [holds(rho, len)?, holds(out, len)?];
    gpu.run(&SPREAD, "spread", &[("params", &params), ("rho", rho), ("out", out)], groups(size))
}
