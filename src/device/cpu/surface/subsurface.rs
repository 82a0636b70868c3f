//! Subsurface scattering: sums of the radiance that comes back through a surface from the next one; see [`Subsurface`].

use glam::Vec3;
use rayon::prelude::*;

use super::beauty::{Light, above, hemisphere, lobe};
use super::{CHUNK, Space};
use crate::device::random::pcg4d;
use crate::device::surface::{Hit, Subsurface, Surfaces};

/// Its streams of random numbers.
const PRIMARY: u32 = 4;
const SECONDARY: u32 = 5;

/// See [`Device::surface_subsurface`](crate::device::Device::surface_subsurface).
pub fn subsurface(surfaces: &Surfaces, subsurface: &Subsurface, hits: &[Hit], sums: &mut [[f32; 3]]) {
    assert_eq!(hits.len(), sums.len(), "a sum for each hit");
    let space = Space::new(surfaces);
    let light = Light::new(&subsurface.environment);
    sums.par_chunks_mut(CHUNK).zip(hits.par_chunks(CHUNK)).for_each(|(sums, hits)| {
        sums.iter_mut().zip(hits).for_each(|(sum, hit)| add(&space, &light, subsurface, hit, sum));
    });
}

fn add(space: &Space, light: &Light, of: &Subsurface, hit: &Hit, sum: &mut [f32; 3]) {
    let surface = &space.surfaces[hit.surface as usize];
    if surface.transmission <= 0.0 {
        return;
    }
    let normal = Vec3::from(hit.normal);
    let view = space.towards(hit);
    let axis = if of.refracts { refract(view, normal, surface.ior) } else { view };
    let radiance = of.environment.radiance;
    let origin = pcg4d([hit.pixel, PRIMARY, of.seed, hit.surface]);
    let inner = pcg4d([hit.pixel, SECONDARY, of.seed, hit.surface]);
    let attenuation = |thick: f32| (-Vec3::from(of.attenuation.rate) * thick).exp();
    let mut total = Vec3::from(*sum);
    for i in of.primary.first..of.primary.end {
        let (way, weight) = lobe(of.estimator, axis, surface.spread, origin, [hit.pixel, PRIMARY, of.seed], i);
        let way = above(way, -normal);
        let (next, thick) = space.follow(&space.path(hit.position.into(), way), hit.behind, Some(&of.attenuation));
        let passed = surface.transmission * attenuation(thick);
        let Some(next) = next else {
            total += weight * passed * light.at(&radiance, way);
            continue;
        };
        let (normal, _) = space.normal(next.position, way);
        let albedo = Vec3::from(space.surfaces[next.surface as usize].diffuse);
        let mut returned = Vec3::ZERO;
        for j in 0..of.secondary {
            let draw = i * of.secondary + j;
            let (out, weight) = hemisphere(of.estimator, normal, inner, [hit.pixel, SECONDARY, of.seed], draw);
            let left = if of.fast { passed } else { leaves(space, of, next.position, out, next.before) };
            returned += weight * left * light.at(&radiance, out);
        }
        total += weight * passed * albedo * returned / of.secondary as f32;
    }
    *sum = total.into();
}

/// What is left of light on its way out: attenuated between surfaces, and by each on the way without a change of direction.
fn leaves(space: &Space, of: &Subsurface, position: Vec3, way: Vec3, mut sides: u32) -> Vec3 {
    let (mut thick, mut through, mut position) = (0.0, 1.0, position);
    // A ray that winds through more surfaces than this is lost.
    for crossed in 0..4 * Surfaces::MOST {
        let (next, more) = space.follow(&space.path(position, way), sides, Some(&of.attenuation));
        // Beyond the last surface it is outside, where extinction alone dims it.
        if next.is_some() || crossed == 0 || of.attenuation.table.is_some() {
            thick += more;
        }
        let Some(next) = next else {
            return through * (-Vec3::from(of.attenuation.rate) * thick).exp();
        };
        through *= space.surfaces[next.surface as usize].transmission;
        if through <= 0.0 {
            break;
        }
        (position, sides) = (next.position, next.behind);
    }
    Vec3::ZERO
}

/// Snell's law for light that enters from outside, where the index is 1; an index below 1 may reflect all of it, which then
/// goes along the surface.
fn refract(view: Vec3, normal: Vec3, ior: f32) -> Vec3 {
    let ratio = 1.0 / ior;
    let cosine = -view.dot(normal);
    let square = 1.0 - ratio * ratio * (1.0 - cosine * cosine);
    (ratio * view + (ratio * cosine - square.max(0.0).sqrt()) * normal).normalize_or(view)
}
