//! Irradiance of a lamp.

use encase::ShaderType;
use glam::{UVec3, Vec3};

use super::shader::IRRADIATE;
use super::{Gpu, holds, uvec3};
use crate::device::{Buffer, Falloff, Lamp};
use crate::error::Result;
use crate::grid::Grid;

#[derive(ShaderType)]
pub(super) struct Params {
    size: UVec3,
    position: Vec3,
    spacing: Vec3,
    floor: f32,
    axis: Vec3,
    outer: f32,
    slope: f32,
    cosine: f32,
}

pub(super) fn irradiate(gpu: &Gpu, lamp: &Lamp, grid: &Grid, rho: &Buffer, out: &mut Buffer) -> Result<()> {
    let Falloff { position, spacing, floor, axis, outer, slope, cosine } = lamp.on(grid, Lamp::PARTS);
    let params =
        gpu.uniform(&Params { size: uvec3(grid.size), position, spacing, floor, axis, outer, slope, cosine })?;
    let [nx, ny, nz] = grid.size;
    gpu.run(
        &IRRADIATE,
        "irradiate",
        &[("params", &params), ("rho", holds(rho, grid.len())?), ("out", holds(out, grid.len())?)],
        [nx.div_ceil(8), ny.div_ceil(8), nz],
    )
}
