//! Where media are cut away, as `shaders/clip.wgsl` has it.

use encase::ShaderType;
use glam::Vec3;

use crate::device::{Clip, ClipShape};

#[derive(ShaderType)]
pub(super) struct ClipParams {
    a: Vec3,
    plane: u32,
    b: Vec3,
    invert: u32,
}

pub(super) fn clips(clips: &[Clip]) -> Vec<ClipParams> {
    let of = |clip: &Clip| {
        let invert = clip.invert.into();
        match clip.shape {
            ClipShape::Box { low, high } => ClipParams { a: low, plane: 0, b: high, invert },
            ClipShape::Plane { normal, offset } => ClipParams { a: normal, plane: 1, b: Vec3::splat(offset), invert },
        }
    };
    clips.iter().map(of).collect()
}
