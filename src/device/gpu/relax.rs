//! Implicit diffusion: red-black relaxation, residuals, and the way back from coarser grids.

use encase::ShaderType;
use glam::{UVec3, Vec3};

use super::classify::groups;
use super::shader::{PROLONG, RELAX};
use super::{Gpu, holds, uvec3};
use crate::device::Buffer;
use crate::error::Result;
use crate::grid::Slab;

#[derive(ShaderType)]
pub(super) struct Relax {
    size: UVec3,
    colour: u32,
    coupling: Vec3,
}

#[derive(ShaderType)]
pub(super) struct Prolong {
    coarse: UVec3,
    below: u32,
    size: UVec3,
    first: u32,
    planes: u32,
}

fn run(
    gpu: &Gpu,
    entry: &str,
    params: Relax,
    [rhs, values, out, largest]: [&wgpu::Buffer; 4],
    size: [usize; 3],
) -> Result<()> {
    let params = gpu.uniform(&params)?;
    let buffers = [("params", &params), ("rhs", rhs), ("values", values), ("out", out), ("largest", largest)];
    gpu.run(&RELAX, entry, &buffers, groups(size))
}

pub(super) fn relax(
    gpu: &Gpu,
    size: [usize; 3],
    coupling: [f32; 3],
    rhs: &Buffer,
    values: &mut Buffer,
    colour: usize,
) -> Result<()> {
    let len = size.iter().product();
    let params = Relax { size: uvec3(size), colour: colour as u32, coupling: Vec3::from_array(coupling) };
    let unused = [gpu.scratch(1)?, gpu.scratch(1)?];
    run(gpu, "relax", params, [holds(rhs, len)?, holds(values, len)?, &unused[0], &unused[1]], size)
}

pub(super) fn residual(
    gpu: &Gpu,
    size: [usize; 3],
    coupling: [f32; 3],
    rhs: &Buffer,
    values: &Buffer,
    out: &mut Buffer,
) -> Result<f32> {
    let len = size.iter().product();
    let params = Relax { size: uvec3(size), colour: 0, coupling: Vec3::from_array(coupling) };
    let largest = gpu.scratch(1)?;
    run(gpu, "residual", params, [holds(rhs, len)?, holds(values, len)?, holds(out, len)?, &largest], size)?;
    Ok(gpu.values::<f32>(&largest, 1)?[0])
}

pub(super) fn prolong(gpu: &Gpu, coarse: &Slab, values: &Buffer, fine: &Slab, into: &mut Buffer) -> Result<()> {
    let params = gpu.uniform(&Prolong {
        coarse: uvec3(coarse.size),
        below: coarse.planes.start as u32,
        size: uvec3(fine.size),
        first: fine.planes.start as u32,
        planes: fine.planes.len() as u32,
    })?;
    let [values, into] = [holds(values, coarse.len())?, holds(into, fine.len())?];
    let size = [fine.size[0], fine.size[1], fine.planes.len()];
    gpu.run(&PROLONG, "prolong", &[("params", &params), ("values", values), ("into", into)], groups(size))
}
