//! The light volume at each hit: adds what one term gives a white diffuse surface, and a perfect specular lobe.
//!
//! - light of a direction: `E·max(0, n·l)/π` and `E·(s + 1)/2π·max(0, r·l)^s` where n·l > 0, E its irradiance times the value;
//! - scattered light counts as even: `L` and `L`; its current is left out.

use std::f32::consts::{FRAC_1_PI, TAU};

use glam::Vec3;
use rayon::prelude::*;

use super::beauty::reflect;
use super::{CHUNK, Space, Volume};
use crate::device::cpu::host;
use crate::device::cpu::irradiate::shape;
use crate::device::surface::{Hit, Surfaces};
use crate::device::{Term, Weight};

/// See [`Device::surface_light`](crate::device::Device::surface_light).
pub fn light(surfaces: &Surfaces, term: &Term, hits: &[Hit], sums: &mut [[[f32; 3]; 2]]) {
    assert_eq!(hits.len(), sums.len(), "a sum for each hit");
    if matches!(term.weight, Weight::Current { .. }) {
        return;
    }
    let space = Space::new(surfaces);
    let volume = Volume::new(host(term.values), term.grid.size);
    let size = |n: [usize; 3]| Vec3::from(n.map(|n| n as f32));
    let scale = size(term.grid.size) / size(surfaces.grid.size);
    sums.par_chunks_mut(CHUNK).zip(hits.par_chunks(CHUNK)).for_each(|(sums, hits)| {
        for (sum, hit) in sums.iter_mut().zip(hits) {
            let value = volume.at((Vec3::from(hit.position) + 0.5) * scale - 0.5);
            let [diffuse, specular] = arrives(&space, surfaces, term, hit);
            sum[0] = (Vec3::from(sum[0]) + value * diffuse).into();
            sum[1] = (Vec3::from(sum[1]) + value * specular).into();
        }
    });
}

/// What a value of 1 gives.
fn arrives(space: &Space, surfaces: &Surfaces, term: &Term, hit: &Hit) -> [Vec3; 2] {
    let (from, irradiance) = match term.weight {
        Weight::Uniform(radiance) => return [radiance.into(); 2],
        Weight::Phase { direction, irradiance, .. } => (-direction, Vec3::from(irradiance)),
        Weight::Lamp { lamp, intensity, .. } => {
            let falloff = lamp.on(surfaces.grid, 1);
            let way = (Vec3::from(hit.position) - falloff.position) * falloff.spacing;
            let square = way.length_squared();
            let r = square.max(1e-30).sqrt();
            let t = ((way.dot(falloff.axis) / r - falloff.outer) * falloff.slope).clamp(0.0, 1.0);
            let shape = shape(t, falloff.cosine) / square.max(falloff.floor);
            (-way / r, Vec3::from(intensity) * shape)
        }
        Weight::Current { .. } => return [Vec3::ZERO; 2],
    };
    let normal = Vec3::from(hit.normal);
    let cosine = normal.dot(from);
    if cosine <= 0.0 {
        return [Vec3::ZERO; 2];
    }
    let exponent = space.surfaces[hit.surface as usize].exponent_at(hit.slope);
    let highlight = reflect(space.towards(hit), normal).dot(from).max(0.0).powf(exponent) * (exponent + 1.0) / TAU;
    [irradiance * (cosine * FRAC_1_PI), irradiance * highlight]
}
