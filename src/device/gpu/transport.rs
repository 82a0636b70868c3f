//! Transport along discrete ordinates: those that share dominant axis and sign run together, layer by layer.

use encase::ShaderType;
use glam::{UVec3, Vec2, Vec3};

use super::shader::TRANSPORT;
use super::sweep::{layers_last, strides};
use super::{Gpu, dispatch, holds, uvec3};
use crate::device::{Buffer, Sweep, Transport};
use crate::error::Result;

/// Most ordinates that a workgroup takes at once.
const ABREAST: usize = 8;

#[derive(ShaderType)]
pub(super) struct Params {
    size: UVec3,
    count: u32,
    stride: UVec3,
    values: u32,
    travel: i32,
}

#[derive(ShaderType)]
struct Ordinate {
    direction: Vec3,
    weight: f32,
    foot: Vec2,
    length: f32,
    inflow: f32,
}

pub(super) fn transport(
    gpu: &Gpu,
    t: &Transport,
    phi: &mut Buffer,
    current: Option<[&mut Buffer; 3]>,
) -> Result<(f32, f32)> {
    let size = t.grid.size;
    let values = t.grid.len();
    let kernel = gpu.kernel(&TRANSPORT)?;
    // A buffer that is written may be bound only once.
    let unused = [gpu.scratch(1)?, gpu.scratch(1)?, gpu.scratch(1)?, gpu.scratch(1)?];
    let gradient = match t.gradient {
        Some([x, y, z]) => [holds(x, values)?, holds(y, values)?, holds(z, values)?],
        None => [&unused[3]; 3],
    };
    let currents = match &current {
        Some([x, y, z]) => [holds(x, values)?, holds(y, values)?, holds(z, values)?],
        None => [&unused[0], &unused[1], &unused[2]],
    };
    let (phi, sum, extremes) = (holds(phi, values)?, gpu.scratch(values)?, gpu.scratch(2)?);
    let (sigma, source) = (holds(t.sigma, values)?, holds(t.source, values)?);
    let bind = |params: &Params, ordinates: &[Ordinate], radiance: &wgpu::Buffer| {
        kernel.bind(
            &gpu.device,
            &[
                ("params", &gpu.uniform(params)?),
                ("ordinates", &gpu.structures(ordinates)?),
                ("sigma", sigma),
                ("source", source),
                ("gradient_x", gradient[0]),
                ("gradient_y", gradient[1]),
                ("gradient_z", gradient[2]),
                ("radiance", radiance),
                ("sum", &sum),
                ("current_x", currents[0]),
                ("current_y", currents[1]),
                ("current_z", currents[2]),
                ("phi", phi),
                ("extremes", &extremes),
            ],
        )
    };

    let mut encoder = gpu.encoder();
    if current.is_some() {
        currents.iter().for_each(|c| encoder.clear_buffer(c, 0, Some(4 * values as u64)));
    }
    {
        let mut pass = encoder.begin_compute_pass(&Default::default());
        let mut params = Params { size: uvec3(size), count: 0, stride: UVec3::ZERO, values: values as u32, travel: 1 };
        for (axis, ascending) in [(0, true), (0, false), (1, true), (1, false), (2, true), (2, false)] {
            let axes = layers_last(axis);
            let group = group(t, axis, ascending);
            if group.is_empty() {
                continue;
            }
            let [b, c, layers] = axes.map(|a| size[a]);
            params.size = uvec3([b, c, layers]);
            params.count = group.len() as u32;
            params.stride = uvec3(axes.map(|a| strides(size)[a]));
            params.travel = if ascending { 1 } else { -1 };
            let parts = [
                ("LINEAR", t.gradient.is_some().into()),
                ("CURRENT", current.is_some().into()),
                ("ABREAST", group.len().min(ABREAST) as f64),
            ];
            pass.set_pipeline(&kernel.pipeline(&gpu.device, "step_layer", &parts));
            let radiance = gpu.scratch(2 * group.len() * b * c)?;
            pass.set_bind_group(0, &bind(&params, &group, &radiance)?, &[]);
            for layer in 0..layers as u32 {
                pass.set_immediates(0, bytemuck::bytes_of(&layer));
                dispatch(&mut pass, [b.div_ceil(16), c.div_ceil(2), 1]);
            }
        }
        let nobody = Ordinate { direction: Vec3::ZERO, weight: 0.0, foot: Vec2::ZERO, length: 0.0, inflow: 0.0 };
        pass.set_pipeline(&kernel.pipeline(&gpu.device, "settle", &[]));
        pass.set_bind_group(0, &bind(&params, &[nobody], &gpu.scratch(1)?)?, &[]);
        dispatch(&mut pass, [values.div_ceil(256), 1, 1]);
    }
    gpu.submit(encoder)?;
    let extremes: Vec<f32> = gpu.values(&extremes, 2)?;
    Ok((extremes[0], extremes[1]))
}

/// The ordinates that travel mainly along `axis` the given way, in their order.
fn group(t: &Transport, axis: usize, ascending: bool) -> Vec<Ordinate> {
    let [b, c, _] = layers_last(axis);
    t.ordinates
        .iter()
        .map(|o| (o, Sweep::new(t.grid, o.direction, false)))
        .filter(|(_, s)| s.axis() == axis && s.ascending()[axis] == ascending)
        .map(|(o, s)| {
            let foot = |lateral: usize| (-s.direction[lateral] / s.direction[axis].abs()).clamp(-1.0, 1.0);
            Ordinate {
                direction: o.direction,
                weight: o.weight,
                foot: Vec2::new(foot(b), foot(c)),
                length: s.length,
                inflow: o.inflow,
            }
        })
        .collect()
}
