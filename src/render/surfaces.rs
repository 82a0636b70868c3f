//! Opaque surfaces in the light of the volume, `L = ρ/π · E`: where rays end (Lambert).
//!
//! E is the irradiance in front of the surface: of direct light `Σ E_l T_l max(0, −n·u_l)`, with the transmittance T_l of the light
//! volume; of scattered light φ/2, since it comes from the side that the surface faces, evenly. Light is taken a voxel and a half of its
//! grid in front of the surface, clear of the voxels that the surface blocks; outside of the volume, where the volume ends.

use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::camera::Camera;
use crate::device::slices::Projection;
use crate::device::{Behind, Device, Term, Weight};
use crate::error::Result;
use crate::geometry::{Geometry, Hit};
use crate::grid::Grid;

/// Voxels of a light grid in front of a surface at which its light is taken.
const IN_FRONT: f64 = 1.5;

/// Pictures whose hits are kept, so that cameras at rest do not look for them again.
const KEPT: usize = 8;

/// What a picture's rays end at, for each pixel.
type Hits = Arc<Vec<Option<Hit>>>;

/// The surfaces of a scene.
pub(super) struct Surfaces {
    geometry: Arc<Geometry>,
    kept: Mutex<Vec<(Camera, [usize; 2], Hits)>>,
}

impl Surfaces {
    pub fn new(geometry: Arc<Geometry>) -> Self {
        Surfaces { geometry, kept: Mutex::default() }
    }

    /// What the rays of a picture end at; `radiance` gives that of what is met, as white surfaces throw it back.
    pub fn seen(
        &self,
        camera: &Camera,
        size: [usize; 2],
        radiance: impl FnOnce(&[Hit]) -> Result<Vec<[f32; 3]>>,
    ) -> Result<Vec<Behind>> {
        let hits = self.hits(camera, size);
        let met: Vec<Hit> = hits.iter().copied().flatten().collect();
        let mut radiance = radiance(&met)?.into_iter();
        let mut behind = |hit: Hit| {
            let white = radiance.next().unwrap_or_default();
            let radiance = std::array::from_fn(|c| hit.color[c] * white[c].max(0.0));
            Behind { end: hit.t as f32, radiance }
        };
        Ok(hits.iter().map(|hit| hit.map_or(Behind::NOTHING, &mut behind)).collect())
    }

    /// What rays of a picture meet first, by their numbers, row by row.
    pub fn meet(&self, camera: &Camera, size: [usize; 2], rays: Range<usize>) -> Vec<Option<Hit>> {
        let eye = camera.eye.as_dvec3();
        let ray = |n: usize| camera.ray(size, (n % size[0]) as f32, (n / size[0]) as f32).as_dvec3();
        rays.into_par_iter().map(|n| self.geometry.first_hit(eye, ray(n), f64::from(f32::MAX))).collect()
    }

    /// For each texel of a light's picture the world length of its ray up to where it first and last meets a surface; infinite where
    /// it does not.
    pub fn shade(&self, view: &Projection, size: [usize; 2]) -> Vec<[f32; 2]> {
        let texel = |i: usize, n: usize| 2.0 * (i as f64 + 0.5) / n as f64 - 1.0;
        let ends = |n: usize| {
            let q = [texel(n % size[0], size[0]), texel(n / size[0], size[1])];
            let (start, way) = (view.start(q), view.way(q));
            self.geometry.ends(start, way).map_or([f32::INFINITY; 2], |ends| ends.map(|t| t as f32))
        };
        (0..size[0] * size[1]).into_par_iter().map(ends).collect()
    }

    fn hits(&self, camera: &Camera, size: [usize; 2]) -> Hits {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((.., hits)) = kept.iter().find(|(of, at, _)| of == camera && *at == size) {
            return hits.clone();
        }
        let hits: Hits = Arc::new(self.meet(camera, size, 0..size[0] * size[1]));
        if kept.len() == KEPT {
            kept.remove(0);
        }
        kept.push((*camera, size, hits.clone()));
        hits
    }
}

/// Radiance that white surfaces throw back of the light of `terms`.
pub(super) fn lit<'a>(
    device: &dyn Device,
    data: &Grid,
    terms: impl IntoIterator<Item = &'a Term<'a>>,
    met: &[Hit],
) -> Result<Vec<[f32; 3]>> {
    let mut radiance = vec![[0.0; 3]; met.len()];
    let (mut points, mut values) = (Vec::new(), Vec::new());
    for term in terms {
        let Grid { size, spacing, origin } = *term.grid;
        let ahead = IN_FRONT * term.grid.mean_spacing();
        points.clear();
        points.extend(met.iter().map(|hit| {
            let at = hit.position + ahead * hit.normal - DVec3::from(origin);
            (at / DVec3::from(spacing)).as_vec3().to_array()
        }));
        values.clear();
        values.resize(points.len(), 0.0);
        device.sample(size, term.values, &points, &mut values)?;
        for ((radiance, hit), value) in radiance.iter_mut().zip(met).zip(&values) {
            let share = reflected(&term.weight, hit, data);
            (0..3).for_each(|c| radiance[c] += share[c] * value);
        }
    }
    Ok(radiance)
}

/// Radiance that a white surface throws back for one unit of a term's value.
pub(super) fn reflected(weight: &Weight, hit: &Hit, data: &Grid) -> [f32; 3] {
    const PI: f32 = std::f32::consts::PI;
    let normal = hit.normal.as_vec3();
    let facing = |travel: Vec3| (-normal.dot(travel)).max(0.0) / PI;
    match *weight {
        // The weight is that of φ/4π: ρ/π · φ/2 is twice of it.
        Weight::Uniform(weight) => weight.map(|w| 2.0 * w),
        Weight::Phase { direction, irradiance, .. } => irradiance.map(|e| e * facing(direction)),
        Weight::Lamp { lamp, intensity, .. } => {
            let travel = (hit.position - lamp.position).as_vec3();
            let falloff = lamp.falloff(data, hit.position);
            intensity.map(|i| i * falloff * facing(travel.normalize_or_zero()))
        }
        // What the phase function adds to even light is none of the surface's.
        Weight::Current { .. } => [0.0; 3],
    }
}
