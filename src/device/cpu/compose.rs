//! The illuminated volume.

use crate::device::Buffer;

pub(crate) fn compose(_terms: &[(&Buffer, [f32; 3])], _out: &mut [[f32; 3]]) {}
