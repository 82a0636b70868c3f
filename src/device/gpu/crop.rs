//! A box of a grid as a volume of its own, and back.

use encase::ShaderType;
use glam::UVec3;

use super::classify::groups;
use super::shader::CROP;
use super::{Gpu, holds, uvec3};
use crate::device::Buffer;
use crate::error::Result;
use crate::grid::Region;

#[derive(ShaderType)]
pub(super) struct Params {
    size: UVec3,
    start: UVec3,
    inner: UVec3,
}

fn params(region: Region, size: [usize; 3]) -> Params {
    Params { size: uvec3(size), start: uvec3(region.start), inner: uvec3(region.size) }
}

pub(super) fn crop(gpu: &Gpu, size: [usize; 3], values: &Buffer, region: Region, out: &mut Buffer) -> Result<()> {
    let params = gpu.uniform(&params(region, size))?;
    let [values, out] = [holds(values, size.iter().product())?, holds(out, region.len())?];
    gpu.run(&CROP, "crop", &[("params", &params), ("values", values), ("out", out)], groups(region.size))
}

pub(super) fn embed(gpu: &Gpu, region: Region, values: &Buffer, size: [usize; 3], out: &mut Buffer) -> Result<()> {
    let params = gpu.uniform(&params(region, size))?;
    let [values, out] = [holds(values, region.len())?, holds(out, size.iter().product())?];
    gpu.run(&CROP, "embed", &[("params", &params), ("values", values), ("out", out)], groups(size))
}
