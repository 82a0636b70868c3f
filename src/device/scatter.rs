//! Transport along ordinates and the source of scattered light (light.md, first-collision-source ordinates).

use glam::{DVec3, Vec3};

use super::Buffer;
use crate::grid::Grid;

/// One discrete ordinate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ordinate {
    /// Unit world direction of travel.
    pub direction: Vec3,
    /// Quadrature weight; all weights sum to 4π.
    pub weight: f32,
    /// Radiance that enters the grid along this direction.
    pub inflow: f32,
}

/// One pass of transport along every ordinate, one colour channel, by step characteristics: a voxel is a step of uniform σ and S,
/// `I_out = I_in + A(S − I_in)` with `A = 1 − e^−τ` and τ = σ times the length of the step between two layers. Its mean over the voxel,
/// `Ī = I_in + B(S − I_in)`, `B = 1 − A/τ`, is accumulated into `φ = Σ w Ī` and `J = Σ w Ω Ī`. I_in is bilinear at the foot in
/// what leaves the layer before; outside the grid it is the inflow, so that inflow and S equal to 1 give I = 1 everywhere (the white
/// furnace). What leaves voxels is what enters them and what they emit, less what they absorb.
pub struct Transport<'a> {
    /// The light grid.
    pub grid: &'a Grid,
    /// The directions.
    pub ordinates: &'a [Ordinate],
    /// Extinction (delta-scaled) per world length.
    pub sigma: &'a Buffer,
    /// Isotropic part of the source function S (radiance; emission per length is σS).
    pub source: &'a Buffer,
    /// Linearly anisotropic part: S(Ω) = source + Ω·gradient, clamped at 0. `None` when g = 0.
    pub gradient: Option<[&'a Buffer; 3]>,
}

/// The way the direct light of a source travels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Travel {
    /// Everywhere along this unit direction.
    Along(Vec3),
    /// Away from this world position: `u = (x − P)/max(|x − P|, Δ)`, Δ the mean spacing, as the mean over a voxel that holds
    /// the light has no direction.
    From(DVec3),
}

/// One colour channel's part in the source function
/// `S = [σ_s*/4π · (φ + ΣE_l + 3g* Ω·(J + ΣE_l u_l)) + emission] / σ*` of [`Device::source`](super::Device::source).
pub struct SourceTerm<'a> {
    /// Delta-scaled extinction σ*.
    pub sigma: &'a Buffer,
    /// Delta-scaled scattering coefficient of the channel, `ω (1 − f) σ_t`.
    pub scattering: &'a Buffer,
    /// Emission per world length of the channel, if any.
    pub emission: Option<&'a Buffer>,
    /// Where the values sit.
    pub grid: &'a Grid,
    /// The first of its planes that buffers hold.
    pub plane: usize,
    /// First-collision fluence of each light on this grid, with the channel's factor on it and the light's direction.
    pub first: &'a [(&'a Buffer, f32, Travel)],
    /// Fluence of scattered light.
    pub phi: &'a Buffer,
    /// Its current J and 3g*, where scattering is anisotropic.
    pub current: Option<([&'a Buffer; 3], f32)>,
}
