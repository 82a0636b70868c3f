//! Coefficients of the medium continued past its edges.

use encase::ShaderType;
use glam::UVec3;

use super::classify::groups;
use super::shader::EXTEND;
use super::{Gpu, holds, uvec3};
use crate::device::{Buffer, FAINT};
use crate::error::Result;

#[derive(ShaderType)]
pub(super) struct Params {
    size: UVec3,
    faint: f32,
}

pub(super) fn extend(gpu: &Gpu, size: [usize; 3], sigma: &Buffer, values: &Buffer, out: &mut Buffer) -> Result<()> {
    let len = size.iter().product();
    gpu.run(
        &EXTEND,
        "extend",
        &[
            ("params", &gpu.uniform(&Params { size: uvec3(size), faint: FAINT })?),
            ("sigma", holds(sigma, len)?),
            ("values", holds(values, len)?),
            ("out", holds(out, len)?),
        ],
        groups(size),
    )
}
