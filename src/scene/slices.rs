use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::NumberOrRgb;

/// `[slices]`: half-angle slices, `render.kind = "slices"`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SlicesKeys {
    /// Whether the medium casts shadows. Without, slices are aligned with the view, and one pass serves all lights.
    pub shadows: bool,
    /// Texels of the light buffer per data voxel along an axis; 1.5 to 3 when absent, by what a voxel dims.
    pub resolution: Option<f64>,
    /// Factor on the extinction of light on its way from its source, a number or per channel: below 1 the medium is
    /// translucent.
    pub attenuation: NumberOrRgb,
    /// Degrees by which light spreads on its way (GPU Gems 39 (9)); 0 keeps shadows sharp.
    pub blur: f64,
    /// Image (OpenEXR, Radiance HDR, PNG) that every cone light throws; its circle is inscribed in the image.
    pub spotlight: Option<PathBuf>,
}

impl Default for SlicesKeys {
    fn default() -> Self {
        SlicesKeys {
            shadows: true,
            resolution: None,
            attenuation: NumberOrRgb::Number(1.0),
            blur: 0.0,
            spotlight: None,
        }
    }
}
