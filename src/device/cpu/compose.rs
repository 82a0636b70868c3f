//! The illuminated volume: `L = Σ weight_k · ρ_k` (Zhang & Ma, eq. 22), per channel.

use rayon::prelude::*;

use super::host;
use crate::device::Buffer;

/// reads volumes → writes interleaved RGB.
pub(crate) fn compose(terms: &[(&Buffer, [f32; 3])], out: &mut [[f32; 3]]) {
    const CHUNK: usize = 4096;
    out.par_chunks_mut(CHUNK).enumerate().for_each(|(c, out)| {
        out.fill([0.0; 3]);
        for (volume, weight) in terms {
            let values = &host(volume)[c * CHUNK..];
            for (rgb, v) in out.iter_mut().zip(values) {
                (0..3).for_each(|a| rgb[a] += weight[a] * v);
            }
        }
    });
}
