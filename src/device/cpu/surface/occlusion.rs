//! Ambient occlusion: sums of unoccluded directions (the bent normal) and of the part of each ray that escapes; see [`Occlusion`].

use std::f32::consts::TAU;

use glam::Vec3;
use rayon::prelude::*;

use super::{CHUNK, NOWHERE, Space};
use crate::device::cpu::trace::emitter::about;
use crate::device::random::{pcg4d, point, sphere};
use crate::device::surface::{Estimator, Hit, Occlusion, Samples, Surfaces};

/// Its streams of random numbers.
const STREAM: u32 = 1;

/// See [`Device::surface_occlusion`](crate::device::Device::surface_occlusion).
pub fn occlusion(surfaces: &Surfaces, occlusion: &Occlusion, samples: Samples, hits: &[Hit], sums: &mut [[f32; 4]]) {
    assert_eq!(hits.len(), sums.len(), "a sum for each hit");
    let space = Space::new(surfaces);
    sums.par_chunks_mut(CHUNK).zip(hits.par_chunks(CHUNK)).for_each(|(sums, hits)| {
        sums.iter_mut().zip(hits).for_each(|(sum, hit)| add(&space, occlusion, samples, hit, sum));
    });
}

fn add(space: &Space, occlusion: &Occlusion, samples: Samples, hit: &Hit, sum: &mut [f32; 4]) {
    let normal = Vec3::from(hit.normal);
    let start = Vec3::from(hit.position) + Occlusion::OFFSET * space.mean_spacing * normal * space.per_length;
    let origin = pcg4d([hit.pixel, STREAM, occlusion.seed, hit.surface]);
    for i in samples.first..samples.end {
        let [u, turn, jitter] = point(origin, i);
        let way = match occlusion.estimator {
            Estimator::Normalised => about(normal, (1.0 - u).sqrt(), TAU * turn),
            Estimator::Paper => {
                let s = sphere([hit.pixel, STREAM, occlusion.seed], i);
                if s.dot(normal) < 0.0 { -s } else { s }
            }
        };
        let through = escapes(space, occlusion, start, way, hit.before, jitter);
        sum[0] += way.x * through;
        sum[1] += way.y * through;
        sum[2] += way.z * through;
        sum[3] += through;
    }
}

/// What surfaces leave of a ray: each crossing takes its opacity away.
fn escapes(space: &Space, occlusion: &Occlusion, start: Vec3, way: Vec3, mut sides: u32, jitter: f32) -> f32 {
    let slope = way * space.per_length;
    let step = occlusion.radius / occlusion.steps as f32;
    let mut through = 1.0;
    for n in 0..occlusion.steps {
        let position = start + (n as f32 + jitter) * step * slope;
        if position.cmplt(Vec3::splat(-0.5)).any() || position.cmpgt(space.top).any() {
            break;
        }
        let here = if space.kept(position) { space.sides(space.volume.at(position)) } else { NOWHERE };
        if here != sides && here != NOWHERE && sides != NOWHERE {
            let crossed = here ^ sides;
            for (k, surface) in space.surfaces.iter().enumerate() {
                if crossed >> k & 1 == 1 {
                    through *= 1.0 - surface.opacity;
                }
            }
            if through <= 0.0 {
                return 0.0;
            }
        }
        sides = here;
    }
    through
}
