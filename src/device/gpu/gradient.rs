//! Gradient magnitude of data.

use encase::ShaderType;
use glam::{DVec3, UVec3, Vec3};

use super::classify::groups;
use super::shader::GRADIENT;
use super::{Gpu, holds, uvec3};
use crate::device::Buffer;
use crate::error::Result;
use crate::grid::Grid;

#[derive(ShaderType)]
pub(super) struct Params {
    size: UVec3,
    scale: Vec3,
}

pub(super) fn gradient(gpu: &Gpu, grid: &Grid, field: &Buffer, out: &mut Buffer) -> Result<()> {
    let scale = (0.5 / DVec3::from(grid.spacing)).as_vec3();
    let params = gpu.uniform(&Params { size: uvec3(grid.size), scale })?;
    let bindings = [("params", &params), ("field", holds(field, grid.len())?), ("out", holds(out, grid.len())?)];
    gpu.run(&GRADIENT, "gradient", &bindings, groups(grid.size))
}
