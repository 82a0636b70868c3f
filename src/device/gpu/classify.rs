//! Optical properties on a light grid, and means over coarser grids.

use encase::ShaderType;
use glam::UVec3;

use super::shader::{CLASSIFY, RESTRICT};
use super::{Gpu, holds, uvec3};
use crate::device::{Buffer, Optic};
use crate::error::{Error, Result};
use crate::grid::Slab;
use crate::transfer::Table;

#[derive(ShaderType)]
pub(super) struct Classify {
    data: UVec3,
    lo: f32,
    size: UVec3,
    scale: f32,
    entries: u32,
    above: u32,
    first: u32,
    planes: u32,
    rows: u32,
    steep: f32,
}

#[derive(ShaderType)]
pub(super) struct Restrict {
    size: UVec3,
    above: u32,
    coarse: UVec3,
    first: u32,
    planes: u32,
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
    data: &Slab,
    (field, gradient): (&Buffer, Option<&Buffer>),
    light: &Slab,
    out: &mut Buffer,
) -> Result<()> {
    gpu.rounds(under(data.size, light.size), "a light grid so much coarser than the data")?;
    let curve = optic.curve(table);
    let params = Classify {
        data: uvec3(data.size),
        lo: table.lo,
        size: uvec3(light.size),
        scale: table.scale(),
        entries: table.extinction.len() as u32,
        above: data.planes.start as u32,
        first: light.planes.start as u32,
        planes: light.planes.len() as u32,
        rows: (curve.len() / table.extinction.len()) as u32,
        steep: table.graded.as_ref().map_or(0.0, |graded| graded.scale()),
    };
    let gradient = match (&table.graded, gradient) {
        (Some(_), Some(gradient)) => holds(gradient, data.len())?.clone(),
        (Some(_), None) => return Err(Error::Device("a two-dimensional table without gradients".into())),
        (None, _) => gpu.scratch(1)?,
    };
    gpu.run_with(
        &CLASSIFY,
        "classify",
        &[("GRADED", f64::from(table.graded.is_some()))],
        &[
            ("params", &gpu.uniform(&params)?),
            ("field", holds(field, data.len())?),
            ("gradient", &gradient),
            ("table", &gpu.storage(&curve)?),
            ("out", holds(out, light.len())?),
        ],
        groups(light.region().size),
    )
}

pub(super) fn restrict(gpu: &Gpu, fine: &Slab, values: &Buffer, coarse: &Slab, out: &mut Buffer) -> Result<()> {
    gpu.rounds(under(fine.size, coarse.size), "a grid so much coarser than the volume")?;
    let params = Restrict {
        size: uvec3(fine.size),
        above: fine.planes.start as u32,
        coarse: uvec3(coarse.size),
        first: coarse.planes.start as u32,
        planes: coarse.planes.len() as u32,
    };
    gpu.run(
        &RESTRICT,
        "restrict_mean",
        &[
            ("params", &gpu.uniform(&params)?),
            ("values", holds(values, fine.len())?),
            ("out", holds(out, coarse.len())?),
        ],
        groups(coarse.region().size),
    )
}
