//! Optical properties on a light grid.

use crate::device::Optic;
use crate::transfer::Table;

pub(crate) fn classify(_o: Optic, _t: &Table, _data: [usize; 3], _field: &[f32], _size: [usize; 3], _out: &mut [f32]) {}

pub(crate) fn restrict(_size: [usize; 3], _values: &[f32], _coarse: [usize; 3], _out: &mut [f32]) {}
