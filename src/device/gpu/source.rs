//! Source function of scattered light.

use encase::ShaderType;
use glam::{DVec3, UVec3, Vec3};

use super::shader::SOURCE;
use super::{Gpu, dispatch, holds, uvec3};
use crate::device::{Buffer, SourceTerm, Travel};
use crate::error::Result;

#[derive(ShaderType)]
pub(super) struct Params {
    count: u32,
    forward: f32,
    glows: u32,
    near: f32,
    first: u32,
    size: UVec3,
    spacing: Vec3,
}

pub(super) fn source(
    gpu: &Gpu,
    term: &SourceTerm,
    source: &mut Buffer,
    gradient: Option<[&mut Buffer; 3]>,
) -> Result<()> {
    let values = source.len();
    let out = holds(source, values)?;
    // A buffer that is written may be bound only once.
    let unused = [gpu.scratch(1)?, gpu.scratch(1)?, gpu.scratch(1)?, gpu.scratch(1)?];
    let along = match (&term.current, &gradient) {
        (Some((current, forward)), Some(gradient)) => Some((current, *forward, gradient)),
        _ => None,
    };
    let gradients: [&wgpu::Buffer; 3] = match &along {
        Some((_, _, [x, y, z])) => [holds(x, values)?, holds(y, values)?, holds(z, values)?],
        None => [&unused[0], &unused[1], &unused[2]],
    };
    let (spacing, origin) = (DVec3::from(term.grid.spacing).as_vec3(), DVec3::from(term.grid.origin));
    let params = Params {
        count: values as u32,
        forward: along.as_ref().map_or(0.0, |a| a.1),
        glows: u32::from(term.emission.is_some()),
        near: term.grid.mean_spacing() as f32,
        first: (term.plane * term.grid.size[0] * term.grid.size[1]) as u32,
        size: uvec3(term.grid.size),
        spacing,
    };
    let params = gpu.uniform(&params)?;
    let kernel = gpu.kernel(&SOURCE)?;
    let bind = |first: &wgpu::Buffer| {
        kernel.bind(
            &gpu.device,
            &[
                ("params", &params),
                ("sigma", holds(term.sigma, values)?),
                ("scattering", holds(term.scattering, values)?),
                ("emission", term.emission.map_or(Ok(&unused[3]), |e| holds(e, values))?),
                ("first", first),
                ("source", out),
                ("gradient_x", gradients[0]),
                ("gradient_y", gradients[1]),
                ("gradient_z", gradients[2]),
            ],
        )
    };
    let groups = [values.div_ceil(256), 1, 1];

    let mut encoder = gpu.encoder();
    let bytes = 4 * values as u64;
    encoder.copy_buffer_to_buffer(holds(term.phi, values)?, 0, out, 0, bytes);
    if let Some((current, _, _)) = &along {
        for (from, to) in current.iter().zip(gradients) {
            encoder.copy_buffer_to_buffer(holds(from, values)?, 0, to, 0, bytes);
        }
    }
    {
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&kernel.pipeline(&gpu.device, "add_light", &[]));
        for (fluence, irradiance, travel) in term.first {
            pass.set_bind_group(0, &bind(holds(fluence, values)?)?, &[]);
            let (v, radial) = match travel {
                Travel::Along(u) => (*u, 0u32),
                Travel::From(position) => (((*position - origin) / DVec3::from(term.grid.spacing)).as_vec3(), 1),
            };
            pass.set_immediates(0, bytemuck::cast_slice(&[*irradiance, v.x, v.y, v.z]));
            pass.set_immediates(16, bytemuck::bytes_of(&radial));
            dispatch(&mut pass, groups);
        }
        pass.set_pipeline(&kernel.pipeline(&gpu.device, "scatter", &[]));
        pass.set_bind_group(0, &bind(&gpu.scratch(1)?)?, &[]);
        pass.set_immediates(0, &[0; 20]);
        dispatch(&mut pass, groups);
    }
    gpu.submit(encoder)
}
