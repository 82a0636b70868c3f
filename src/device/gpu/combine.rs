//! Linear combinations, inner products and largest values of whole volumes.

use super::shader::COMBINE;
use super::{Gpu, dispatch, gpu as raw, holds};
use crate::device::Buffer;
use crate::error::Result;

/// Values that `shaders/combine.wgsl` reduces to one.
const CHUNK: usize = 4096;

pub(super) fn combine(gpu: &Gpu, terms: &[(&Buffer, f32)], out: &mut Buffer) -> Result<()> {
    let values = out.len();
    let out = raw(out)?;
    let mut encoder = gpu.encoder();
    match terms {
        [] => encoder.clear_buffer(out, 0, None),
        [(volume, 1.0)] => encoder.copy_buffer_to_buffer(holds(volume, values)?, 0, out, 0, 4 * values as u64),
        _ => {
            let kernel = gpu.kernel(&COMBINE)?;
            let unused = gpu.scratch(1)?;
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(&kernel.pipeline(&gpu.device, "accumulate", &[]));
            for (t, (volume, weight)) in terms.iter().enumerate() {
                let buffers = [("a", holds(volume, values)?), ("b", &unused), ("out", out)];
                pass.set_bind_group(0, &kernel.bind(&gpu.device, &buffers)?, &[]);
                pass.set_immediates(0, bytemuck::bytes_of(&(values as u32)));
                pass.set_immediates(4, bytemuck::cast_slice(&[f32::from(t > 0), *weight]));
                dispatch(&mut pass, [values.div_ceil(256), 1, 1]);
            }
        }
    }
    gpu.submit(encoder)
}

/// One number for every chunk of two volumes.
fn chunks(gpu: &Gpu, entry: &str, a: &Buffer, b: &Buffer) -> Result<Vec<f32>> {
    let values = a.len();
    let groups = values.div_ceil(CHUNK);
    let out = gpu.scratch(groups)?;
    let kernel = gpu.kernel(&COMBINE)?;
    let bound = kernel.bind(&gpu.device, &[("a", raw(a)?), ("b", holds(b, values)?), ("out", &out)])?;
    let mut encoder = gpu.encoder();
    {
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&kernel.pipeline(&gpu.device, entry, &[]));
        pass.set_bind_group(0, &bound, &[]);
        pass.set_immediates(0, bytemuck::cast_slice(&[values as u32, 0, 0]));
        dispatch(&mut pass, [groups, 1, 1]);
    }
    gpu.submit(encoder)?;
    gpu.values(&out, groups)
}

pub(super) fn dot_parts(gpu: &Gpu, a: &Buffer, b: &Buffer) -> Result<Vec<f64>> {
    Ok(chunks(gpu, "dot_chunks", a, b)?.into_iter().map(f64::from).collect())
}

pub(super) fn distance(gpu: &Gpu, a: &Buffer, b: &Buffer) -> Result<f32> {
    Ok(chunks(gpu, "distance_chunks", a, b)?.into_iter().fold(0.0, f32::max))
}

pub(super) fn largest_ratio(gpu: &Gpu, a: &Buffer, b: &Buffer) -> Result<f32> {
    Ok(chunks(gpu, "ratio_chunks", a, b)?.into_iter().fold(0.0, f32::max))
}
