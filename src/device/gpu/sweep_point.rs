//! Direct light from a point: one dispatch per front of bricks.

use encase::ShaderType;
use glam::{IVec3, UVec3, Vec3};

use super::fronts::front_by_front;
use super::shader::SWEEP_POINT;
use super::{Gpu, holds, uvec3};
use crate::device::{Buffer, PointSweep};
use crate::error::Result;
use crate::grid::BrickLayout;

#[derive(ShaderType)]
pub(super) struct Params {
    size: IVec3,
    edge: i32,
    cell: IVec3,
    fraction: Vec3,
    spacing: Vec3,
    counts: UVec3,
    plane: i32,
}

pub(super) fn sweep_point(
    gpu: &Gpu,
    sweep: &PointSweep,
    layout: &BrickLayout,
    sigma: &Buffer,
    rho: &mut Buffer,
    fronts: &[&[u32]],
) -> Result<Vec<f32>> {
    // Sums of layers, times rows that an invocation takes of each.
    let rounds = 3 * (layout.edge + 2) * ((layout.edge + 2).pow(2)).div_ceil(256);
    gpu.rounds(rounds as f64, "a brick of this size")?;
    let params = Params {
        size: uvec3(sweep.size).as_ivec3(),
        edge: layout.edge as i32,
        cell: IVec3::from_array(sweep.cell),
        fraction: sweep.fraction.into(),
        spacing: sweep.spacing.into(),
        counts: uvec3(layout.counts()),
        plane: sweep.plane as i32,
    };
    let values = sweep.held(layout, fronts);
    let most = fronts.iter().map(|f| f.len()).max().unwrap_or(0);
    let ghost = gpu.scratch(3 * (layout.edge + 2).pow(2) * most)?;
    let params = gpu.uniform(&params)?;
    let (sigma, rho) = (holds(sigma, values)?, holds(rho, values)?);
    let own = [("params", &params), ("sigma", sigma), ("rho", rho), ("ghost", &ghost)];
    front_by_front(gpu, &SWEEP_POINT, "sweep_point", &own, layout, fronts)
}
