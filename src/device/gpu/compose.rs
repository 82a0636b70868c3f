//! The illuminated volume, `L = Σ weight·ρ` per channel (Zhang & Ma 2013, eq. 22).

use super::shader::COMPOSE;
use super::{Gpu, dispatch, holds};
use crate::device::Buffer;
use crate::error::Result;

/// Values composed at a time: 48 MiB of RGB.
const STRETCH: usize = 4 << 20;

pub(super) fn compose(gpu: &Gpu, terms: &[(&Buffer, [f32; 3])], out: &mut [[f32; 3]]) -> Result<()> {
    let values = out.len();
    if terms.is_empty() {
        out.fill([0.0; 3]);
        return Ok(());
    }
    let kernel = gpu.kernel(&COMPOSE)?;
    let rgb = gpu.scratch(3 * values.min(STRETCH))?;
    for (stretch, out) in out.chunks_mut(STRETCH).enumerate() {
        let mut encoder = gpu.encoder();
        {
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(&kernel.pipeline(&gpu.device, "compose", &[]));
            for (t, (volume, weight)) in terms.iter().enumerate() {
                let bound = kernel.bind(&gpu.device, &[("volume", holds(volume, values)?), ("rgb", &rgb)])?;
                pass.set_bind_group(0, &bound, &[]);
                pass.set_immediates(0, bytemuck::cast_slice(&[(stretch * STRETCH) as u32, out.len() as u32]));
                let keep = f32::from(t > 0);
                pass.set_immediates(8, bytemuck::cast_slice(&[keep, weight[0], weight[1], weight[2]]));
                dispatch(&mut pass, [out.len().div_ceil(256), 1, 1]);
            }
        }
        gpu.submit(encoder)?;
        gpu.read(&rgb, bytemuck::cast_slice_mut(out))?;
    }
    Ok(())
}
