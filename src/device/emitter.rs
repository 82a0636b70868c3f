//! Light sources as path tracing sees them: something that a point can be lit from (sampled), and that a ray may meet (hit).
//!
//! For direct light from solid angle dω the estimate of one sample is `f · L / p`, p its density; a source that fills no solid
//! angle (a parallel or a point light) has p = 0 and gives `f · L` with L its irradiance, and no ray meets it. Light and
//! scattering samples are combined by the power heuristic (Veach & Guibas 1995, section 4), so that both [`Sample::pdf`] and
//! [`Hit::pdf`] are densities per solid angle of the same strategy.
//!
//! Light passes through sources, and a ray collects every one that it meets: so what is behind a visible source shows through, and
//! light and scattering samples estimate the same integral.

use glam::Vec3;

/// What an emitter is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum Shape {
    /// Parallel rays along `axis`, or, where `edge` < 1, the same radiance from all directions within a cap round −`axis`, `edge` the
    /// cosine of its angle.
    Distant = 0,
    /// From `position` with the falloff of a [`Lamp`](crate::device::Lamp): `radiance` is its radiant intensity. With a `radius` from
    /// points in a ball, of density ∝ 1/√(radius² − r²), which is an even disk from every side. No ray meets it.
    Point = 1,
    /// The same radiance from all directions, or that of an equirectangular image.
    Environment = 2,
    /// `position + s·u + t·v` for −1 ≤ s, t ≤ 1.
    Rectangle = 3,
    /// `position + s·u + t·v` for s² + t² ≤ 1; u and v of the same length.
    Disk = 4,
    /// A disk without its inner part, s² + t² < `inner`².
    Ring = 5,
    /// The outside of `position + r·u + s·v + t·w`, −1 ≤ r, s, t ≤ 1, w along `axis` with length `radius`.
    Box = 6,
    /// The outside of a ball of `radius`.
    Sphere = 7,
}

/// A light source; the same fields in `shaders/emitter.wgsl`. Positions are world lengths from value (0, 0, 0) of the data grid,
/// so that they keep their digits in f32.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Emitter {
    /// What it is, and what the other fields mean.
    pub shape: Shape,
    /// Where it is.
    pub position: Vec3,
    /// Distant, cone: the way the light travels; flat shapes: the side that shines. Unit.
    pub axis: Vec3,
    /// Half edges.
    pub u: Vec3,
    /// Half edges.
    pub v: Vec3,
    /// World length.
    pub radius: f32,
    /// Of a ring: inner over outer radius.
    pub inner: f32,
    /// Cosine of the angle at which a cone or a cap ends.
    pub edge: f32,
    /// Of a cone: 1/(inner − outer), of the cosines between which it fades.
    pub slope: f32,
    /// Radiance per channel; irradiance of parallel rays, radiant intensity of a point.
    pub radiance: Vec3,
    /// Probability with which it is chosen when a point is lit; all emitters' sum to 1.
    pub share: f32,
    /// Where its image begins in the emitters' images, and its width and height: 0 where it has none.
    pub image: [u32; 3],
    /// Flat shapes shine on both sides.
    pub two_sided: bool,
    /// The camera sees it.
    pub visible: bool,
}

impl Emitter {
    /// A source of a shape in the origin, with everything else off.
    pub fn new(shape: Shape, radiance: [f32; 3]) -> Self {
        Emitter {
            shape,
            position: Vec3::ZERO,
            axis: Vec3::Z,
            u: Vec3::X,
            v: Vec3::Y,
            radius: 0.0,
            inner: 0.0,
            edge: 1.0,
            slope: 1.0,
            radiance: radiance.into(),
            share: 0.0,
            image: [0; 3],
            two_sided: false,
            visible: false,
        }
    }
}

/// A way from a point to a light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Towards the light, unit.
    pub direction: Vec3,
    /// World length; infinite where the light is.
    pub distance: f32,
    /// Radiance that comes from there; irradiance where `pdf` is 0.
    pub radiance: Vec3,
    /// Density per solid angle; 0: no other sample can find this light.
    pub pdf: f32,
}

/// Where a ray meets a light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// World length; infinite where the light is.
    pub distance: f32,
    /// Radiance that comes from there.
    pub radiance: Vec3,
    /// Density per solid angle with which [`Sample`]s from the ray's origin go this way.
    pub pdf: f32,
}
