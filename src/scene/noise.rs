//! `[noise]`: procedural detail.

use serde::{Deserialize, Serialize};

/// `[noise]`: detail finer than the data, see [`crate::detail`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NoiseKeys {
    /// Standard deviation by which values are scaled up and down; 0 leaves them.
    pub amplitude: f64,
    /// The value that stays what it is, whatever the noise: empty space, as a rule.
    pub about: f64,
    /// Standard deviation, along each axis and in voxels, by which the place where data are looked up is shifted.
    pub warp: f64,
    /// Size of the largest features in voxels.
    pub scale: f64,
    /// Noises that are added up, each of half the size of the one before.
    pub octaves: u32,
    /// Strength of each noise beside the one before.
    pub gain: f64,
    /// World lengths per unit of time that the largest features move; finer ones move faster, so that the pattern changes.
    pub drift: [f64; 3],
    /// Values for each one of the data along every axis: detail needs voxels to be seen in.
    pub refine: usize,
    /// Another number, another pattern.
    pub seed: u32,
}

impl Default for NoiseKeys {
    fn default() -> Self {
        NoiseKeys {
            amplitude: 0.0,
            about: 0.0,
            warp: 0.0,
            scale: 8.0,
            octaves: 4,
            gain: 0.5,
            drift: [0.0; 3],
            refine: 2,
            seed: 0,
        }
    }
}
