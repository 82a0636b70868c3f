//! Light sources.

use glam::Vec3;

/// A light source in world space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Light {
    /// Parallel rays.
    Distant {
        /// The way the light travels, unit.
        direction: Vec3,
        /// Irradiance on a facing plane per channel.
        irradiance: [f32; 3],
    },
    /// The same radiance from all directions.
    Environment {
        /// Radiance per channel.
        radiance: [f32; 3],
    },
}
