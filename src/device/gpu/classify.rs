//! Optical properties on a light grid, and means over coarser grids.

use encase::ShaderType;
use glam::UVec3;

use super::shader::{CLASSIFY, RESTRICT};
use super::{Gpu, holds, uvec3};
use crate::device::{Buffer, Optic};
use crate::error::Result;
use crate::transfer::Table;

#[derive(ShaderType)]
pub(super) struct Classify {
    data: UVec3,
    lo: f32,
    size: UVec3,
    scale: f32,
    entries: u32,
}

#[derive(ShaderType)]
pub(super) struct Restrict {
    size: UVec3,
    coarse: UVec3,
}

/// One invocation for each value of a grid, in workgroups of 8 × 8 × 1.
pub(super) fn groups(size: [usize; 3]) -> [usize; 3] {
    [size[0].div_ceil(8), size[1].div_ceil(8), size[2]]
}

/// Fine voxels under a coarse one, of which a kernel's invocation takes one after another.
fn under(fine: [usize; 3], coarse: [usize; 3]) -> f64 {
    (0..3).map(|a| (fine[a].div_ceil(coarse[a].max(1)) + 1) as f64).product()
}

pub(super) fn classify(
    gpu: &Gpu,
    optic: Optic,
    table: &Table,
    data: [usize; 3],
    field: &Buffer,
    size: [usize; 3],
    out: &mut Buffer,
) -> Result<()> {
    gpu.rounds(under(data, size), "a light grid so much coarser than the data")?;
    let curve = optic.curve(table);
    let params = Classify {
        data: uvec3(data),
        lo: table.lo,
        size: uvec3(size),
        scale: table.scale(),
        entries: curve.len() as u32,
    };
    gpu.run(
        &CLASSIFY,
        "classify",
        &[
            ("params", &gpu.uniform(&params)?),
            ("field", holds(field, data.iter().product())?),
            ("table", &gpu.storage(&curve)?),
            ("out", holds(out, size.iter().product())?),
        ],
        groups(size),
    )
}

pub(super) fn restrict(
    gpu: &Gpu,
    size: [usize; 3],
    values: &Buffer,
    coarse: [usize; 3],
    out: &mut Buffer,
) -> Result<()> {
    gpu.rounds(under(size, coarse), "a grid so much coarser than the volume")?;
    let params = Restrict { size: uvec3(size), coarse: uvec3(coarse) };
    gpu.run(
        &RESTRICT,
        "restrict_mean",
        &[
            ("params", &gpu.uniform(&params)?),
            ("values", holds(values, size.iter().product())?),
            ("out", holds(out, coarse.iter().product())?),
        ],
        groups(coarse),
    )
}
