//! Direct light: one dispatch per front of bricks, or per layer where the foot is cubic.

use encase::ShaderType;
use glam::{IVec3, UVec3, Vec2};

use super::fronts::front_by_front;
use super::shader::SWEEP;
use super::{Gpu, dispatch, holds, uvec3};
use crate::device::{Buffer, Sweep};
use crate::error::Result;
use crate::grid::BrickLayout;

#[derive(ShaderType)]
pub(super) struct Params {
    size: UVec3,
    edge: u32,
    stride: UVec3,
    length: f32,
    counts: UVec3,
    brick_stride: UVec3,
    travel: IVec3,
    offset: Vec2,
    given: UVec3,
}

/// The axes with the dominant one last: a kernel's (b, c, a). Of the lateral ones, that which is contiguous in memory
/// comes first where there is one.
pub(super) fn layers_last(axis: usize) -> [usize; 3] {
    [[1, 2, 0], [0, 2, 1], [0, 1, 2]][axis]
}

/// Distances in memory between neighbours of a dense array.
pub(super) fn strides(size: [usize; 3]) -> [usize; 3] {
    [1, size[0], size[0] * size[1]]
}

pub(super) fn sweep(
    gpu: &Gpu,
    sweep: &Sweep,
    layout: &BrickLayout,
    sigma: &Buffer,
    rho: &mut Buffer,
    fronts: &[&[u32]],
) -> Result<Vec<f32>> {
    let axes = layers_last(sweep.axis());
    let (size, counts) = (axes.map(|a| sweep.size[a]), layout.counts());
    let ascending = sweep.ascending();
    let offset = |a: usize| (sweep.direction[a] / sweep.direction[sweep.axis()]).abs().min(1.0);
    let given = |a: usize| match a {
        2 if sweep.given => {
            if ascending[2] {
                0
            } else {
                sweep.size[2] as u32 - 1
            }
        }
        _ => u32::MAX,
    };
    let params = Params {
        size: uvec3(size),
        edge: layout.edge as u32,
        stride: uvec3(axes.map(|a| strides(sweep.size)[a])),
        length: sweep.length,
        counts: uvec3(axes.map(|a| counts[a])),
        brick_stride: uvec3(axes.map(|a| strides(counts)[a])),
        travel: IVec3::from_array(axes.map(|a| if ascending[a] { 1 } else { -1 })),
        offset: Vec2::new(offset(axes[0]), offset(axes[1])),
        given: UVec3::from_array(axes.map(given)),
    };
    let values = sweep.size.iter().product();
    let params = gpu.uniform(&params)?;
    let own = [("params", &params), ("sigma", holds(sigma, values)?), ("rho", holds(rho, values)?)];
    if !sweep.cubic {
        return front_by_front(gpu, &SWEEP, "brick_by_brick", &own, layout, fronts);
    }
    assert!(!sweep.given, "a cubic foot needs the whole grid");
    layer_by_layer(gpu, &own, size, ascending[sweep.axis()])?;
    Ok(vec![f32::INFINITY; fronts.iter().map(|front| front.len()).sum()])
}

/// One dispatch per layer of the whole grid, whose `size` has the layers last.
fn layer_by_layer(gpu: &Gpu, own: &[(&str, &wgpu::Buffer)], size: [usize; 3], ascending: bool) -> Result<()> {
    let kernel = gpu.kernel(&SWEEP)?;
    let unused = [gpu.scratch(1)?, gpu.scratch(1)?];
    let bound = kernel.bind(&gpu.device, &[own, &[("bricks", &unused[0]), ("changes", &unused[1])]].concat())?;
    let mut encoder = gpu.encoder();
    {
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_bind_group(0, &bound, &[]);
        pass.set_pipeline(&kernel.pipeline(&gpu.device, "layer_by_layer", &[]));
        for l in 0..size[2] {
            let layer = if ascending { l } else { size[2] - 1 - l };
            pass.set_immediates(0, bytemuck::cast_slice(&[layer as u32, 0]));
            dispatch(&mut pass, [size[0].div_ceil(16), size[1].div_ceil(16), 1]);
        }
    }
    gpu.submit(encoder)
}
