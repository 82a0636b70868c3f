//! Direct light from a point: one dispatch per front of bricks.

use encase::ShaderType;
use glam::{IVec3, UVec3, Vec3};

use super::shader::SWEEP_POINT;
use super::{Gpu, dispatch, holds, uvec3};
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
}

pub(super) fn sweep_point(
    gpu: &Gpu,
    sweep: &PointSweep,
    layout: &BrickLayout,
    sigma: &Buffer,
    rho: &mut Buffer,
    fronts: &[&[u32]],
) -> Result<Vec<f32>> {
    let listed: Vec<u32> = fronts.concat();
    if listed.is_empty() {
        return Ok(Vec::new());
    }
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
    };
    let values = sweep.size.iter().product();
    let changes = gpu.scratch(layout.len())?;
    let most = fronts.iter().map(|f| f.len()).max().unwrap_or(0);
    let ghost = gpu.scratch(3 * (layout.edge + 2).pow(2) * most)?;
    let kernel = gpu.kernel(&SWEEP_POINT)?;
    let bound = kernel.bind(
        &gpu.device,
        &[
            ("params", &gpu.uniform(&params)?),
            ("sigma", holds(sigma, values)?),
            ("rho", holds(rho, values)?),
            ("bricks", &gpu.storage(&listed)?),
            ("changes", &changes),
            ("ghost", &ghost),
        ],
    )?;
    let mut encoder = gpu.encoder();
    {
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_bind_group(0, &bound, &[]);
        pass.set_pipeline(&kernel.pipeline(&gpu.device, "sweep_point", &[]));
        let mut first = 0;
        for front in fronts {
            pass.set_immediates(0, bytemuck::cast_slice(&[first, front.len() as u32]));
            dispatch(&mut pass, [front.len(), 1, 1]);
            first += front.len() as u32;
        }
    }
    gpu.submit(encoder)?;
    let changes: Vec<f32> = gpu.values(&changes, layout.len())?;
    Ok(listed.iter().map(|&b| changes[b as usize]).collect())
}
