//! `[pathtrace]`: what path tracing alone has to know.

use serde::{Deserialize, Serialize};

/// `[pathtrace]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PathtraceKeys {
    /// none, knn or guided.
    pub denoise: Denoise,
    /// Standard deviation of the Gaussian pixel filter in pixels; 0 leaves it out.
    pub filter: f32,
}

impl Default for PathtraceKeys {
    fn default() -> Self {
        PathtraceKeys { denoise: Denoise::None, filter: 0.5 }
    }
}

/// `pathtrace.denoise`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Denoise {
    /// The picture as sampled: right in the mean.
    None,
    /// Means over pixels that look alike (Kroes et al. 2012).
    Knn,
    /// Non-local means guided by albedo, normal, depth and variance.
    Guided,
}
