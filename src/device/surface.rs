//! Arguments of the kernels that meet isosurfaces (Rezk-Salama 2007): where they are, and what light does at them.
//!
//! Positions are in values of the data grid: value (i, j, k) sits at (i, j, k), the box reaches half a value beyond. Directions and
//! normals are unit vectors of the world.

use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;

use crate::camera::Camera;
use crate::device::{Buffer, Clip};
use crate::grid::{BrickLayout, Grid};
use crate::transfer::Table;

/// An isosurface and what light does at it: section 5's k_d, k_s, k_t and exponents s and q.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surface {
    /// Data value.
    pub value: f32,
    /// k_d times colour, per channel.
    pub diffuse: [f32; 3],
    /// k_s.
    pub specular: f32,
    /// s where the gradient is 0.
    pub exponent: f32,
    /// Growth of s with |∇|, in data values per world length.
    pub exponent_gradient: f32,
    /// Part of what lies behind, and of the light of the surroundings, that the surface takes away, 0 to 1.
    pub opacity: f32,
    /// k_t.
    pub transmission: f32,
    /// q, the exponent of the lobe of transmitted light.
    pub spread: f32,
    /// Index of refraction behind the surface.
    pub ior: f32,
}

impl Surface {
    /// Largest exponent: half of the lobe lies within 0.7 degrees.
    pub const SHARPEST: f32 = 1e4;

    /// Exponent s of the specular lobe at a place with gradient `slope`.
    pub fn exponent_at(&self, slope: f32) -> f32 {
        (self.exponent + self.exponent_gradient * slope.abs()).clamp(0.0, Self::SHARPEST)
    }

    /// Schlick's approximation to Fresnel's reflectance, `F₀ + (1 − F₀)(1 − cos θ)⁵` with `F₀ = ((n − 1)/(n + 1))²`.
    pub fn fresnel(&self, cosine: f32) -> f32 {
        let head_on = ((self.ior - 1.0) / (self.ior + 1.0)).powi(2);
        head_on + (1.0 - head_on) * (1.0 - cosine.clamp(0.0, 1.0)).powi(5)
    }
}

/// Isosurfaces in a volume, and who looks at them.
///
/// Along a ray the value is looked at every `step`. Where it changes sides of a surface's value between two samples, 16 bisections
/// find where; the ray is at the surface just behind it. Values below [`crate::field::HOLE`] are no data: nothing is met at their
/// edge. Of what is cut away nothing is met either, up to the cut, and it takes no light away. Skipping bricks in which no surface is
/// changes nothing, to the bit.
#[derive(Clone, Copy)]
pub struct Surfaces<'a> {
    /// The data grid.
    pub grid: &'a Grid,
    /// Data values.
    pub field: &'a Buffer,
    /// Bricks of the data grid.
    pub bricks: BrickLayout,
    /// For each brick the distance to one that a surface may be in: see [`distances`]. Empty: no brick is skipped.
    pub empty: &'a [f32],
    /// The surfaces, values ascending; at most [`Surfaces::MOST`].
    pub surfaces: &'a [Surface],
    /// Where surfaces and what is between them are kept.
    pub clips: &'a [Clip],
    /// World length between samples.
    pub step: f32,
    /// Who looks.
    pub camera: &'a Camera,
    /// Pixels along x and y.
    pub picture: [usize; 2],
}

impl Surfaces<'_> {
    /// Surfaces at most.
    pub const MOST: usize = 8;
    /// Halvings of a step: to 1.5e-5 of it.
    pub const BISECTIONS: usize = 16;

    /// Eye on the data grid.
    pub(crate) fn eye(&self) -> Vec3 {
        ((self.camera.eye.as_dvec3() - DVec3::from(self.grid.origin)) / DVec3::from(self.grid.spacing)).as_vec3()
    }
}

/// For each brick the Chebyshev distance in bricks to the nearest whose range of values (with a halo of one) holds one of `values`;
/// 0 in such a brick, and everywhere when there is none to skip.
pub fn distances(bricks: &BrickLayout, ranges: &[[f32; 2]], values: &[f32]) -> Vec<f32> {
    // Interpolation rounds: a value beside the range may be met.
    let holds = |r: &[f32; 2]| {
        let margin = 1e-5 * r[0].abs().max(r[1].abs());
        values.iter().any(|v| r[0] - margin <= *v && *v <= r[1] + margin)
    };
    let met: Vec<f32> = ranges.iter().map(|r| f32::from(u8::from(holds(r)))).collect();
    super::cpu::march::distances(bricks, &met)
}

/// A ray at an isosurface. Laid out as WGSL has it.
#[derive(Debug, Clone, Copy, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct Hit {
    /// Where, on the data grid.
    pub position: [f32; 3],
    /// Number of the pixel that the ray goes through.
    pub pixel: u32,
    /// Direction of the gradient, turned towards the viewer (8).
    pub normal: [f32; 3],
    /// Its magnitude in data values per world length; negative where the normal had to be turned.
    pub slope: f32,
    /// World distance from the eye.
    pub depth: f32,
    /// Which surface; [`Hit::FRESH`] or [`Hit::NONE`].
    pub surface: u32,
    /// Bit k: the value is at least that of surface k just before the surface.
    pub before: u32,
    /// The same just behind it.
    pub behind: u32,
}

impl Hit {
    /// In place of a surface: the ray has not begun.
    pub const FRESH: u32 = u32::MAX - 1;
    /// In place of a surface: the ray has left.
    pub const NONE: u32 = u32::MAX;

    /// A ray that begins.
    pub fn ray(pixel: u32) -> Self {
        Hit { pixel, surface: Hit::FRESH, ..bytemuck::Zeroable::zeroed() }
    }
}

/// Samples to add to sums: numbers from the first to before the end. Sums are the same however samples are split over calls.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Samples {
    /// Number of the first.
    pub first: u32,
    /// One more than the last.
    pub end: u32,
}

/// How directions are drawn and weighted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Estimator {
    /// By the lobe's own density, from points that fill space evenly: under the same light from everywhere a lobe returns k times
    /// that light. What falls below the surface is mirrored at it.
    Normalised,
    /// As published: uniform on the sphere by rejection, turned into the hemisphere (2) or drawn together (3), (6), and averaged with
    /// the factors (10), (11), (13) but without a density.
    Paper,
}

/// (4), (5): the angle at which `cos^s` has fallen to `threshold`.
pub fn widest(exponent: f32, threshold: f32) -> f32 {
    threshold.powf(1.0 / exponent.max(1e-6)).acos()
}

/// (6): weight of the random direction for that angle; 1 at a right angle, 0 at none.
pub fn focus(angle: f32) -> f32 {
    (0.5 * (1.0 + (angle - std::f32::consts::FRAC_PI_4).tan())).clamp(0.0, 1.0)
}

/// What is left of the lobe where it is cut off (4).
pub const THRESHOLD: f32 = 0.1;

/// Light from all around, as square maps of directions on an octahedron (Cigolle et al. 2014), bilinear between texels.
#[derive(Clone, Copy)]
pub struct Environment<'a> {
    /// RGB of each texel of the maps, one map after another.
    pub texels: &'a Buffer,
    /// Radiance.
    pub radiance: Map,
    /// Prefiltered maps, if lobes are not to be sampled.
    pub filtered: Option<&'a Filtered>,
}

/// Prefiltered light: one look-up each.
#[derive(Debug, Clone, PartialEq)]
pub struct Filtered {
    /// Mean radiance by Lambert's cosine about a direction: irradiance/π.
    pub irradiance: Map,
    /// For each surface the mean radiance by its specular lobe.
    pub reflections: Vec<Map>,
}

/// A square of `edge` texels each way with one more all around, so that interpolation needs no branches.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Map {
    /// Number of its first texel.
    pub first: usize,
    /// Texels along an edge, without the border.
    pub edge: usize,
}

impl Map {
    /// Texels, with the border.
    pub fn texels(&self) -> usize {
        (self.edge + 2) * (self.edge + 2)
    }

    /// Where a unit direction is on the map, 0..1.
    #[inline(always)]
    pub fn place(way: Vec3) -> Vec2 {
        let p = Vec2::new(way.x, way.y) / (way.x.abs() + way.y.abs() + way.z.abs());
        let folded = Vec2::new((1.0 - p.y.abs()).copysign(p.x), (1.0 - p.x.abs()).copysign(p.y));
        0.5 * if way.z < 0.0 { folded } else { p } + 0.5
    }

    /// The direction of a place, not normalised: on the octahedron |x| + |y| + |z| = 1.
    pub fn direction(place: Vec2) -> Vec3 {
        let p = 2.0 * place - 1.0;
        let z = 1.0 - p.x.abs() - p.y.abs();
        let folded = Vec2::new((1.0 - p.y.abs()).copysign(p.x), (1.0 - p.x.abs()).copysign(p.y));
        let p = if z < 0.0 { folded } else { p };
        Vec3::new(p.x, p.y, z)
    }

    /// RGB of the texels of a map with its border; `radiance` takes the corner of a texel, counted in texels.
    pub fn tabulate(edge: usize, radiance: impl Fn(Vec2) -> Vec3 + Sync) -> Vec<f32> {
        let inner: Vec<Vec3> = (0..edge * edge)
            .into_par_iter()
            .map(|i| radiance(Vec2::new((i % edge) as f32, (i / edge) as f32)))
            .collect();
        // Beyond an edge the octahedron goes on with that edge mirrored.
        let at = |x: i64, y: i64| {
            let n = edge as i64;
            let (x, y) = if x < 0 || x >= n { (x.clamp(0, n - 1), n - 1 - y) } else { (x, y) };
            let (x, y) = if y < 0 || y >= n { (n - 1 - x, y.clamp(0, n - 1)) } else { (x, y) };
            inner[(y * n + x) as usize]
        };
        let reach = -1..edge as i64 + 1;
        reach.clone().flat_map(|y| reach.clone().map(move |x| (x, y))).flat_map(|(x, y)| at(x, y).to_array()).collect()
    }
}

/// Ambient occlusion: what part of short rays over the hemisphere escapes (section 6.2).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Occlusion {
    /// World length of a ray.
    pub radius: f32,
    /// Samples on it; the first lies a random part of a step from the surface.
    pub steps: u32,
    /// Uniform over the hemisphere in the paper's, by Lambert's cosine in the normalised.
    pub estimator: Estimator,
    /// Sets another sequence of rays.
    pub seed: u32,
}

impl Occlusion {
    /// How far off the surface rays begin, in mean spacings: interpolated surfaces have facets, which would shade themselves.
    pub const OFFSET: f32 = 0.1;
}

/// The beauty pass: the environment through diffuse and specular lobes (section 6.1).
#[derive(Clone, Copy)]
pub struct Beauty<'a> {
    /// What is all around.
    pub environment: Environment<'a>,
    /// Samples of the diffuse lobe to add.
    pub diffuse: Samples,
    /// Samples of the specular lobe to add.
    pub specular: Samples,
    /// Sums of unoccluded directions to use as normals of the diffuse lobe; empty for the gradient.
    pub bent: &'a [[f32; 4]],
    /// How lobes are sampled.
    pub estimator: Estimator,
    /// Sets another sequence of directions.
    pub seed: u32,
}

/// Subsurface scattering: through the first surface within a lobe to the next one, there reflected over the hemisphere, and
/// out (section 6.3).
#[derive(Clone, Copy)]
pub struct Subsurface<'a> {
    /// What is all around.
    pub environment: Environment<'a>,
    /// Transmitted rays to add.
    pub primary: Samples,
    /// Reflected directions for each of them.
    pub secondary: u32,
    /// Light leaves the way it came: the attenuation so far is squared, and no ray is traced outwards.
    pub fast: bool,
    /// The lobe is about the direction of Snell's law instead of straight on.
    pub refracts: bool,
    /// What the inside takes away.
    pub attenuation: Attenuation<'a>,
    /// How directions are drawn.
    pub estimator: Estimator,
    /// Sets another sequence of directions.
    pub seed: u32,
}

/// Attenuation between surfaces (7): `e^(−rate·∫ρ ds)` per channel.
#[derive(Clone, Copy)]
pub struct Attenuation<'a> {
    /// Per world length, or factor on extinction.
    pub rate: [f32; 3],
    /// ρ is the extinction of this transfer function; else 1.
    pub table: Option<&'a Table>,
}
