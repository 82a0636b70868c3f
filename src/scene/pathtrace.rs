//! `[pathtrace]`: what path tracing alone has to know.

use serde::{Deserialize, Serialize};

/// `[pathtrace]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PathtraceKeys {
    /// Scatterings of a path at most; absent as many as matter, or one where `light.scattering` is false.
    pub depth: Option<u32>,
    /// What light does where it collides: phase, hybrid or brdf.
    pub scattering: ScatteringKey,
    /// How readily surfaces reflect in hybrid scattering, 0 to 1.
    pub gradient_factor: f32,
    /// Phase function of mean cosine `transfer.anisotropy`: henyey-greenstein or schlick.
    pub phase: PhaseKey,
    /// How light is found: both, lights or scattering. All have the same mean.
    pub sampling: SamplingKey,
    /// Number that other noise comes from. Steps of a series share it, so that noise does not flicker where nothing changes.
    pub seed: u32,
    /// none, knn or guided.
    pub denoise: Denoise,
    /// Standard deviation of the Gaussian pixel filter in pixels; 0 leaves it out.
    pub filter: f32,
    /// Whether tiles of a series whose paths met nothing that has changed keep their estimate.
    pub replay: bool,
}

impl Default for PathtraceKeys {
    fn default() -> Self {
        PathtraceKeys {
            depth: None,
            scattering: ScatteringKey::Phase,
            gradient_factor: 0.5,
            phase: PhaseKey::HenyeyGreenstein,
            sampling: SamplingKey::Both,
            seed: 1,
            denoise: Denoise::None,
            filter: 0.5,
            replay: false,
        }
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

/// `pathtrace.scattering`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ScatteringKey {
    /// The phase function, as the light solver has it.
    Phase,
    /// Surfaces where the gradient is well defined, else the phase function (Kroes et al. 2012).
    Hybrid,
    /// Surfaces alone.
    Brdf,
}

/// `pathtrace.phase`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PhaseKey {
    /// Henyey & Greenstein 1941.
    HenyeyGreenstein,
    /// Schlick's rational one, of nearly the same shape.
    Schlick,
}

/// `pathtrace.sampling`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SamplingKey {
    /// Lights and scattering, combined by the power heuristic.
    Both,
    /// Lights alone.
    Lights,
    /// Scattering alone, but for lights that no ray can meet.
    Scattering,
}
