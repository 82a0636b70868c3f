//! Optical properties of data, as [`Device::classify`](super::Device::classify) computes them.

use crate::transfer::Table;

/// Which optical property is computed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Optic {
    /// Extinction σ_t of direct and uncollided light, 1/world length.
    Extinction,
    /// Delta-scaled extinction `σ_t (1 − ω f)`, ω the mean over channels, f = g² (light.md, delta-Eddington).
    ScaledExtinction {
        /// Fraction of scattering that is treated as going straight on.
        f: f32,
    },
    /// Scattering coefficient `ω σ_t` of a channel.
    Scattering {
        /// 0 red, 1 green, 2 blue.
        channel: usize,
    },
    /// Emitted radiance per world length of a channel.
    Emission {
        /// 0 red, 1 green, 2 blue.
        channel: usize,
    },
}

impl Optic {
    /// The property for each entry of a transfer function, row by row where it has more than one; what lies between entries is
    /// linear.
    pub fn curve(self, table: &Table) -> Vec<f32> {
        let (extinction, albedo, emission) = table.columns();
        (0..extinction.len())
            .map(|i| {
                let (sigma, albedo) = (extinction[i], albedo[i]);
                match self {
                    Optic::Extinction => sigma,
                    Optic::ScaledExtinction { f } => sigma * (1.0 - f * (albedo[0] + albedo[1] + albedo[2]) / 3.0),
                    Optic::Scattering { channel } => sigma * albedo[channel],
                    Optic::Emission { channel } => emission.get(i).map_or(0.0, |e| e[channel]),
                }
            })
            .collect()
    }
}
