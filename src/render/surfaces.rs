//! Opaque surfaces in the light of the volume, `L = ρ/π · E`: where rays end (Lambert).
//!
//! E is the irradiance in front of the surface: of direct light `Σ E_l T_l max(0, −n·u_l)`, with the transmittance T_l of the light
//! volume; of scattered light φ/2, since it comes from the side that the surface faces, evenly. Light is taken a voxel and a half of its
//! grid in front of the surface, clear of the voxels that the surface blocks; outside of the volume, where the volume ends.

use std::sync::{Arc, Mutex, PoisonError};

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::camera::Camera;
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

    /// What the rays of a picture end at, lit by `terms`.
    pub fn seen(
        &self,
        device: &dyn Device,
        data: &Grid,
        terms: &[Term],
        camera: &Camera,
        size: [usize; 2],
    ) -> Result<Vec<Behind>> {
        let hits = self.hits(camera, size);
        let met: Vec<(usize, Hit)> = hits.iter().enumerate().filter_map(|(n, hit)| Some((n, (*hit)?))).collect();
        let mut behind = vec![Behind::NOTHING; hits.len()];
        for (n, hit) in &met {
            behind[*n].end = hit.t as f32;
        }
        let (mut points, mut values) = (Vec::new(), Vec::new());
        for term in terms {
            let Grid { size, spacing, origin } = *term.grid;
            let ahead = IN_FRONT * term.grid.mean_spacing();
            points.clear();
            points.extend(met.iter().map(|(_, hit)| {
                let at = hit.position + ahead * hit.normal - DVec3::from(origin);
                (at / DVec3::from(spacing)).as_vec3().to_array()
            }));
            values.clear();
            values.resize(points.len(), 0.0);
            device.sample(size, term.values, &points, &mut values)?;
            for ((n, hit), value) in met.iter().zip(&values) {
                let share = reflected(&term.weight, hit, data);
                let radiance = &mut behind[*n].radiance;
                (0..3).for_each(|c| radiance[c] += hit.color[c] * share[c] * value);
            }
        }
        for (n, _) in &met {
            behind[*n].radiance.iter_mut().for_each(|l| *l = l.max(0.0));
        }
        Ok(behind)
    }

    fn hits(&self, camera: &Camera, size: [usize; 2]) -> Hits {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((.., hits)) = kept.iter().find(|(of, at, _)| of == camera && *at == size) {
            return hits.clone();
        }
        let [width, height] = size;
        let ray = |n: usize| camera.ray(size, (n % width) as f32, (n / width) as f32);
        let eye = camera.eye.as_dvec3();
        let hit = |n: usize| self.geometry.first_hit(eye, ray(n).as_dvec3(), f64::from(f32::MAX));
        let hits: Hits = Arc::new((0..width * height).into_par_iter().map(hit).collect());
        if kept.len() == KEPT {
            kept.remove(0);
        }
        kept.push((*camera, size, hits.clone()));
        hits
    }
}

/// Radiance that a white surface throws back for one unit of a term's value.
fn reflected(weight: &Weight, hit: &Hit, data: &Grid) -> [f32; 3] {
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
