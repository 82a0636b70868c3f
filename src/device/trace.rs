//! Path tracing: arguments of [`Device::trace`](super::Device::trace).

use std::ops::Range;

use super::emitter::Emitter;
use super::{Buffer, Clip};
use crate::camera::Camera;
use crate::geometry::Geometry;
use crate::grid::{BrickLayout, Grid};
use crate::transfer::Table;

/// Paths from the camera through a medium (Kroes et al. 2012).
///
/// - A ray flies freely until it collides: delta tracking (Woodcock 1965) with a majorant of each brick, brick after brick. Where
///   channels dim differently, the chance of a collision is that of the channels' mean, each weighted by what the path still carries,
///   so that no channel's weight can grow beyond three.
/// - At a collision light is sampled from one emitter, chosen by its share, dimmed by ratio tracking, and the path goes on along
///   the phase function or a surface's reflection; rays collect the emitters that they meet. Both ways to find the same light are
///   combined by the power heuristic.
/// - A ray that meets a mesh ends there, and the path goes on from it as from a collision; nothing gets through it.
/// - From the third scattering on a path survives with the probability of its largest weight.
/// - Random numbers are a hash of pixel, sample, dimension and seed: the same sample comes out whichever call, tile or thread makes
///   it. Those of a path's first dimensions are an Owen-scrambled Sobol' sequence over the samples of a pixel.
///
/// Data are trilinear between values and clamped in the rim of half a value, and so are gradient magnitudes.
pub struct Trace<'a> {
    /// The data grid.
    pub grid: &'a Grid,
    /// Data values; below [`crate::field::HOLE`] transparent.
    pub field: &'a Buffer,
    /// Their gradient magnitudes, where the table is two-dimensional.
    pub gradient: Option<&'a Buffer>,
    /// Values to optics. Collisions are points: a table for pre-integration is read like any other.
    pub table: &'a Table,
    /// How surfaces reflect, where there are any.
    pub surface: Option<Surface<'a>>,
    /// Bricks of the data grid.
    pub bricks: BrickLayout,
    /// At least the largest extinction in each brick with a halo of one value, and above 0 where anything glows; 0 where nothing
    /// can be met.
    pub majorant: &'a [f32],
    /// Light sources, placed against the grid; their shares sum to 1.
    pub emitters: &'a [Emitter],
    /// Their images.
    pub images: &'a [f32],
    /// The camera.
    pub camera: &'a Camera,
    /// World length along the view that is in focus, where the camera has an aperture.
    pub focus: f32,
    /// Where the medium is cut away.
    pub clips: &'a [Clip],
    /// Opaque surfaces in it, which throw light back evenly (Lambert).
    pub meshes: Option<&'a Geometry>,
    /// How it scatters where it has no surface.
    pub phase: Phase,
    /// Which light is found how.
    pub sampling: Sampling,
    /// Scatterings of a path at most.
    pub depth: u32,
    /// Number that other noise comes from.
    pub seed: u32,
    /// Numbers of the samples of each pixel.
    pub samples: Range<u32>,
}

/// Phase function of mean cosine g.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Phase {
    /// Henyey & Greenstein 1941: `(1 − g²)/(4π (1 + g² − 2g cos θ)^1.5)`; isotropic at g = 0.
    HenyeyGreenstein(f32),
    /// Blasi, Le Saëc & Schlick 1993: `(1 − k²)/(4π (1 − k cos θ)²)`, `k = 1.55 g − 0.55 g³`.
    Schlick(f32),
}

/// Surfaces in a medium (Kroes et al. 2012, (1) and (2)): at a collision light is reflected with probability
/// `α (1 − exp(−25 f³ |∇|))`, else scattered, α the opacity of a reference length, f the factor, |∇| the change of the normalised
/// value from voxel to voxel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surface<'a> {
    /// The factor f in 0..1; `None`: every collision reflects.
    pub factor: Option<f32>,
    /// For each entry of the table: diffuse and specular reflection as factors on albedo and Fresnel's term, roughness in 0..1, index of
    /// refraction.
    pub columns: &'a [[f32; 4]],
    /// Reference length of opacity, world length.
    pub reference: f32,
}

/// How light is found; all have the same mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sampling {
    /// By choosing a point of a light and by scattering, combined by the power heuristic.
    Both,
    /// By choosing a point of a light.
    Lights,
    /// By scattering, but for lights that no ray can meet.
    Scattering,
}

/// Sums over the samples of a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Default, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct Tally {
    /// Radiance per channel.
    pub radiance: [f64; 3],
    /// 1 for each sample that met the medium or a mesh.
    pub coverage: f64,
    /// Square of the radiance per channel.
    pub squares: [f64; 3],
    /// Single-scattering albedo, or the mesh's colour, where something was met first.
    pub albedo: [f32; 3],
    /// World direction against the gradient there, or the mesh's normal, unit, or 0.
    pub normal: [f32; 3],
    /// Distance from the eye's plane along the ray to there, world length.
    pub depth: f32,
    /// Number of samples.
    pub samples: u32,
}

/// What a call of [`Device::trace`](super::Device::trace) has to say.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Traced {
    /// Collisions at which extinction was above the majorant: the picture is too bright there.
    pub exceeded: u64,
}
