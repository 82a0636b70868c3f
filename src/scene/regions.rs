use serde::{Deserialize, Serialize};

/// `[[transfer.regions]]`: a part of the plane of value and gradient magnitude that is seen (GPU Gems 39; Kniss et al. 2002).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RegionKeys {
    /// rectangle, or triangle: its tip in the middle of the values at the least gradient, its base at the largest.
    pub shape: Shape,
    /// Least and largest value, in 0..1 of the range.
    pub value: [f32; 2],
    /// Least and largest gradient magnitude, in 0..1 of `transfer.steepest`.
    pub gradient: [f32; 2],
    /// Opacity per reference length.
    pub opacity: f32,
    /// Colour, scene-linear.
    pub color: [f32; 3],
    /// Emitted radiance per reference length, in the colour.
    pub emission: f32,
    /// Share of the half width over which opacity and emission fade towards the borders, 0 to 1.
    pub edge: f32,
}

impl Default for RegionKeys {
    fn default() -> Self {
        RegionKeys {
            shape: Shape::Rectangle,
            value: [0.0, 1.0],
            gradient: [0.0, 1.0],
            opacity: 0.5,
            color: [1.0; 3],
            emission: 0.0,
            edge: 0.0,
        }
    }
}

/// `transfer.regions.shape`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Shape {
    /// All values at all gradients.
    Rectangle,
    /// The more values, the steeper the gradient: boundaries between materials, without the materials.
    Triangle,
}
