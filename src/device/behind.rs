//! What rays end at: opaque surfaces in the volume.

use super::{March, Part, Ray};

/// What a pixel's ray ends at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Behind {
    /// World length from the eye; infinite where there is nothing.
    pub end: f32,
    /// Radiance towards the eye from there.
    pub radiance: [f32; 3],
}

impl Behind {
    /// Nothing opaque.
    pub const NOTHING: Behind = Behind { end: f32::INFINITY, radiance: [0.0; 3] };

    /// A ray that has not met anything and ends there.
    pub(crate) fn ray(&self) -> Ray {
        Ray { end: self.end.min(f32::MAX), ..Ray::FRESH }
    }

    /// The pixel of a ray that has come this far: `L + T·radiance`, and opaque.
    pub(crate) fn pixel(&self, ray: &Ray) -> [f32; 4] {
        if self.end == f32::INFINITY {
            return ray.pixel();
        }
        let through = |c: usize| ray.radiance[c] + ray.transmittance[c] * self.radiance[c];
        [through(0), through(1), through(2), 1.0]
    }
}

impl Part {
    /// The whole volume as one slab.
    pub(crate) fn whole(march: &March) -> Part {
        let planes = march.grid.size[2];
        Part { cells: 0..planes, field: 0..planes, terms: march.terms.iter().map(|t| 0..t.grid.size[2]).collect() }
    }
}
