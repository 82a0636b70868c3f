//! Irradiance of a lamp.

use std::ops::Range;

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
    plane: u32,
}

pub(super) fn irradiate(
    gpu: &Gpu,
    lamp: &Lamp,
    grid: &Grid,
    planes: Range<usize>,
    rho: &Buffer,
    out: &mut Buffer,
) -> Result<()> {
    let Falloff { position, spacing, floor, axis, outer, slope, cosine } = lamp.on(grid, Lamp::PARTS);
    let [nx, ny, nz] = [grid.size[0], grid.size[1], planes.len()];
    let plane = planes.start as u32;
    let params = gpu.uniform(&Params {
        size: uvec3([nx, ny, nz]),
        position,
        spacing,
        floor,
        axis,
        outer,
        slope,
        cosine,
        plane,
    })?;
    gpu.run(
        &IRRADIATE,
        "irradiate",
        &[("params", &params), ("rho", holds(rho, nx * ny * nz)?), ("out", holds(out, nx * ny * nz)?)],
        [nx.div_ceil(8), ny.div_ceil(8), nz],
    )
}
