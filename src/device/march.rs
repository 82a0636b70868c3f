//! Ray casting: what rays go through and gather.

use std::ops::Range;

use glam::Vec3;

use super::{Buffer, Clip, Lamp};
use crate::camera::Camera;
use crate::grid::{BrickLayout, Grid};
use crate::transfer::Table;

/// A scalar volume that lights the samples of a ray: in-scattered radiance is `ω(v) · max(0, Σ_terms weight(ray)·value(x))`.
pub struct Term<'a> {
    /// Values on `grid`.
    pub values: &'a Buffer,
    /// Where they sit: fills the same box as the data grid.
    pub grid: &'a Grid,
    /// What a value contributes to each channel.
    pub weight: Weight,
}

/// Weight of a [`Term`]; constant along a ray but for a lamp.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Weight {
    /// The same for every ray: `φ/4π` of a colour channel, say.
    Uniform([f32; 3]),
    /// Direct light: `irradiance · p(cos θ)` with Henyey–Greenstein p, θ between the light's travel and the way to the eye.
    Phase {
        /// The way the light travels, unit.
        direction: Vec3,
        /// Irradiance per channel.
        irradiance: [f32; 3],
        /// Henyey–Greenstein g.
        g: f32,
    },
    /// Direct light of a lamp at x: `intensity · falloff(x) · p(cos θ)`, θ between x − P and the way to the eye.
    Lamp {
        /// Where it is and how its light falls off.
        lamp: Lamp,
        /// Radiant intensity per channel.
        intensity: [f32; 3],
        /// Henyey–Greenstein g.
        g: f32,
    },
    /// One component of a current J: `weight · Ω[axis]`, Ω the way to the eye.
    Current {
        /// 0 x, 1 y, 2 z.
        axis: usize,
        /// Per channel.
        weight: [f32; 3],
    },
}

/// Blinn–Phong shading by the gradient of extinction, gated by its magnitude (Zhang & Ma (24), GPU Gems 39 (2), (4)).
///
/// In-scattered radiance is multiplied by `1 + s·(ambient + diffuse·max(0, n·l) + specular·max(0, n·h)^shininess − 1)`,
/// where ∇σ_t comes from central differences one value apart (positions clamped to the outermost values; holes count 0),
/// `n = −∇σ_t/|∇σ_t|`, h halves the angle between l and the way to the eye, and `s = |∇σ_t|·Δ/(|∇σ_t|·Δ + σ_t)` with Δ the
/// mean spacing: no shading where the gradient vanishes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Phong {
    /// Towards the light, unit; the first light's.
    pub towards_light: Vec3,
    /// Strengths.
    pub ambient: f32,
    /// Lambert.
    pub diffuse: f32,
    /// Highlight.
    pub specular: f32,
    /// Exponent of the highlight.
    pub shininess: f32,
}

/// Ray casting through data lit by light volumes: `L = ∫ T σ_t [ω ΣTerms + j/σ_t] ds`.
///
/// - A ray is cut into intervals `[n·step, min((n+1)·step, length)]` from where it enters the volume's box (or from the eye
///   inside it), and sampled in the middle of each, so that a homogeneous medium has its exact optical depth at any step.
/// - A sample of length `ds` has opacity `α = 1 − e^(−σ_t ds)`; it adds `T·(α·ω·max(0, Σ weight·value) + j·α/σ_t)`, the last
///   factor being `ds` where σ_t = 0.
/// - Where extinction differs between colour channels each has its own α and T; a pixel's coverage is `1 − T` with the mean T.
/// - Data and terms are trilinear between values and clamped in the rim of half a value.
/// - Skipping empty bricks never moves a sample: the picture is the same to the bit with and without it.
/// - A ray ends when its transmittance, in every channel, falls below [`March::OPAQUE`].
pub struct March<'a> {
    /// The data grid.
    pub grid: &'a Grid,
    /// Data values; below [`crate::field::HOLE`] transparent.
    pub field: &'a Buffer,
    /// Gradient magnitudes of the data ([`super::Device::gradient`]), where the table is two-dimensional.
    pub gradient: Option<&'a Buffer>,
    /// Values to optics.
    pub table: &'a Table,
    /// Bricks of the data grid for empty-space skipping.
    pub bricks: BrickLayout,
    /// Largest extinction or emission in each brick with a halo of one value; 0 where nothing can be seen. Empty: no
    /// brick is skipped.
    pub majorant: &'a [f32],
    /// Lights; may be empty (emission only).
    pub terms: &'a [Term<'a>],
    /// Phong shading, if any.
    pub phong: Option<Phong>,
    /// The camera.
    pub camera: &'a Camera,
    /// Where the medium is kept.
    pub clips: &'a [Clip],
    /// World length between samples; at least a millionth of the box's diagonal is taken.
    pub step: f32,
}

impl March<'_> {
    /// Transmittance below which a ray ends: what lies behind can add at most this fraction of its radiance, less than
    /// a twentieth of a level of an 8-bit picture.
    pub const OPAQUE: f32 = 1e-4;

    /// Pixels along the edge of a tile. Tiles are numbered row by row from the upper left; those at the right and lower
    /// edges of a picture may be cut.
    pub const TILE: usize = 16;

    /// Tiles along x and y of a picture.
    pub fn tiles(picture: [usize; 2]) -> [usize; 2] {
        picture.map(|n| n.div_ceil(Self::TILE))
    }

    /// The rows of a tile as ranges of a picture's pixels, from the top.
    pub fn rows(tile: u32, picture: [usize; 2]) -> impl Iterator<Item = Range<usize>> {
        let [across, _] = Self::tiles(picture);
        let [x, y] = [tile as usize % across, tile as usize / across].map(|t| t * Self::TILE);
        let width = Self::TILE.min(picture[0] - x);
        (y..(y + Self::TILE).min(picture[1])).map(move |y| y * picture[0] + x..y * picture[0] + x + width)
    }
}

/// A ray on its way, between two slabs.
#[derive(Debug, Clone, Copy, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct Ray {
    /// Radiance so far, from the eye on.
    pub radiance: [f32; 3],
    /// Transmittance so far, per channel.
    pub transmittance: [f32; 3],
    /// Number of the next sample.
    pub next: f32,
    /// World length from the eye to something opaque, where the ray ends.
    pub end: f32,
}

impl Ray {
    /// A ray that has not met anything.
    pub const FRESH: Ray = Ray { radiance: [0.0; 3], transmittance: [1.0; 3], next: 0.0, end: f32::MAX };

    /// What the ray has gathered: radiance and coverage.
    pub fn pixel(&self) -> [f32; 4] {
        let [r, g, b] = self.radiance;
        let [x, y, z] = self.transmittance;
        let passed = if x == y && y == z { x } else { (x + y + z) * (1.0 / 3.0) };
        [r, g, b, 1.0 - passed]
    }
}

/// The rays of a picture on their way from slab to slab.
pub struct Rays {
    /// Pixels along x and y.
    pub picture: [usize; 2],
    /// A ray for each pixel, row by row.
    pub each: Vec<Ray>,
    /// What the CPU knows of them since the last slab.
    pub(crate) known: super::cpu::march::Known,
}

impl Rays {
    /// One ray for each pixel.
    pub fn new(picture: [usize; 2], each: Vec<Ray>) -> Self {
        assert_eq!(each.len(), picture[0] * picture[1], "a ray for each pixel");
        Rays { picture, each, known: Default::default() }
    }
}

/// A slab of what rays are cast through: `field` and the values of the terms hold only these planes.
#[derive(Debug, Clone, PartialEq)]
pub struct Part {
    /// Samples are taken whose lower neighbours along z are in these planes of the data.
    pub cells: Range<usize>,
    /// Planes of the data that are held: `cells` and one above; with shading one more on both sides.
    pub field: Range<usize>,
    /// Planes that each term holds, on its own grid.
    pub terms: Vec<Range<usize>>,
}
