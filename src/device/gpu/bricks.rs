//! What bricks hold and how much it changed.

use encase::ShaderType;
use glam::UVec3;

use super::shader::{BRICK_RANGE, CHANGE};
use super::{Gpu, holds, uvec3};
use crate::device::Buffer;
use crate::error::{Error, Result};
use crate::grid::BrickLayout;

/// Largest edge whose layers, with the halo, `shaders/change.wgsl` keeps in workgroup memory.
const MAX_EDGE: usize = 64;

#[derive(ShaderType)]
pub(super) struct Bricks {
    size: UVec3,
    edge: u32,
    bricks: u32,
}

impl Bricks {
    fn new(layout: &BrickLayout) -> Self {
        Bricks { size: uvec3(layout.size), edge: layout.edge as u32, bricks: layout.len() as u32 }
    }
}

pub(super) fn brick_range(gpu: &Gpu, layout: &BrickLayout, field: &Buffer) -> Result<Vec<[f32; 2]>> {
    let ranges = gpu.scratch(2 * layout.len())?;
    gpu.run(
        &BRICK_RANGE,
        "brick_range",
        &[
            ("params", &gpu.uniform(&Bricks::new(layout))?),
            ("field", holds(field, layout.size.iter().product())?),
            ("ranges", &ranges),
        ],
        [layout.len(), 1, 1],
    )?;
    let ranges: Vec<[f32; 2]> = gpu.values(&ranges, layout.len())?;
    let nothing = [f32::INFINITY, f32::NEG_INFINITY];
    Ok(ranges.into_iter().map(|r| if r[0] > r[1] { nothing } else { r }).collect())
}

pub(super) fn change(gpu: &Gpu, layout: &BrickLayout, now: &Buffer, before: &Buffer) -> Result<Vec<[f32; 3]>> {
    if layout.edge > MAX_EDGE {
        return Err(Error::Unsupported(format!("bricks of edge {} on a GPU; at most {MAX_EDGE}", layout.edge)));
    }
    let values = layout.size.iter().product();
    let bounds = gpu.scratch(3 * layout.len())?;
    gpu.run(
        &CHANGE,
        "change",
        &[
            ("params", &gpu.uniform(&Bricks::new(layout))?),
            ("now", holds(now, values)?),
            ("before", holds(before, values)?),
            ("bounds", &bounds),
        ],
        [layout.len(), 1, 1],
    )?;
    gpu.values(&bounds, layout.len())
}
