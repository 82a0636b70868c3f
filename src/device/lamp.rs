//! Lights in one place: how their irradiance falls off.

use glam::{DVec3, Vec3};

use crate::grid::Grid;

/// A light in one place. Per unit of radiant intensity its irradiance in vacuum, at distance r and angle θ from the cone's
/// axis, is `t²(3 − 2t)/max(r, radius)²` with `t = (cos θ − outer)/(inner − outer)` clamped to 0..1; with a [`Cone::cosine`] the
/// first factor is t itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lamp {
    /// World position.
    pub position: DVec3,
    /// World length below which 1/r² does not grow any more; nor does it below 0.36 voxels of the grid at hand, which is
    /// what 1/r² is in the mean over a ball as large as a voxel round the light.
    pub radius: f64,
    /// The cone that it is limited to, if any.
    pub cone: Option<Cone>,
}

/// Where a [`Lamp`] shines.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cone {
    /// The way the light travels along the axis, unit.
    pub axis: Vec3,
    /// Cosine of the angle at which the light ends.
    pub outer: f32,
    /// Cosine of the angle within which it is full.
    pub inner: f32,
    /// It fades as the cosine itself and not smoothly: a flat surface, where `outer` is 0 and `inner` 1.
    pub cosine: bool,
}

impl Cone {
    /// The half-space before a flat surface.
    pub fn facing(axis: Vec3) -> Self {
        Cone { axis, outer: 0.0, inner: 1.0, cosine: true }
    }
}

/// A [`Lamp`] in the index space of a grid, as kernels take it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Falloff {
    pub position: Vec3,
    pub spacing: Vec3,
    /// Square of the lamp's radius.
    pub floor: f32,
    pub axis: Vec3,
    pub outer: f32,
    /// 1/(inner − outer).
    pub slope: f32,
    /// 1 for [`Cone::cosine`], else 0.
    pub cosine: f32,
}

impl Lamp {
    /// Voxels from the light within which 1/r² in the middle of a voxel is more than a hundredth below its mean.
    pub const NEAR: f32 = 2.5;
    /// Points along an edge of such a voxel.
    pub(crate) const PARTS: usize = 4;

    /// Irradiance in vacuum at a world position, for the voxels of `grid`, per unit of radiant intensity.
    pub fn falloff(&self, grid: &Grid, position: DVec3) -> f32 {
        let Falloff { floor, axis, outer, slope, .. } = self.on(grid, 1);
        let d = (position - self.position).as_vec3();
        let square = d.length_squared();
        let t = ((d.dot(axis) / square.sqrt().max(f32::MIN_POSITIVE) - outer) * slope).clamp(0.0, 1.0);
        t * t * (3.0 - 2.0 * t) / square.max(floor)
    }

    /// On a grid of which each voxel stands for `parts`³ points.
    pub(crate) fn on(&self, grid: &Grid, parts: usize) -> Falloff {
        let spacing = DVec3::from(grid.spacing);
        // In a ball of radius R the mean of 1/r² is 3/R².
        let ball = (0.75 / std::f64::consts::PI * grid.spacing.iter().product::<f64>()).cbrt();
        let least = ball / 3f64.sqrt() / parts as f64;
        // Without a cone the axis is 0, and t = 1 whatever the angle.
        let cone = self.cone.unwrap_or(Cone { axis: Vec3::ZERO, outer: -1.0, inner: 0.0, cosine: false });
        Falloff {
            position: ((self.position - DVec3::from(grid.origin)) / spacing).as_vec3(),
            spacing: spacing.as_vec3(),
            floor: (self.radius.max(least) * self.radius.max(least)) as f32,
            axis: cone.axis,
            outer: cone.outer,
            slope: 1.0 / (cone.inner - cone.outer).max(1e-6),
            cosine: if cone.cosine { 1.0 } else { 0.0 },
        }
    }
}
