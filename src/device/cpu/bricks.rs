//! What bricks hold and how much it changed.

use crate::grid::BrickLayout;

pub(crate) fn brick_range(_layout: &BrickLayout, _field: &[f32]) -> Vec<[f32; 2]> {
    vec![]
}

pub(crate) fn change(_layout: &BrickLayout, _now: &[f32], _before: &[f32]) -> Vec<[f32; 3]> {
    vec![]
}
