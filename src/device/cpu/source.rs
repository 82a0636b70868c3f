//! Source function of scattered light.

use crate::device::SourceTerm;

pub(crate) fn source(_term: &SourceTerm, _source: &mut [f32], _gradient: Option<[&mut [f32]; 3]>) {}
