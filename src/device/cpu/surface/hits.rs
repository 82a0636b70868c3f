//! Carries each ray on to its next surface: position by bisection, normal towards the viewer, signed |∇| (section 3, (8)).

use glam::Vec3;
use rayon::prelude::*;

use super::{CHUNK, Space};
use crate::device::surface::{Hit, Surfaces};

/// See [`Device::surface_hits`](crate::device::Device::surface_hits).
pub fn hits(surfaces: &Surfaces, hits: &mut [Hit]) {
    let space = Space::new(surfaces);
    hits.par_chunks_mut(CHUNK).for_each(|chunk| chunk.iter_mut().for_each(|hit| advance(&space, hit)));
}

fn advance(space: &Space, hit: &mut Hit) {
    if hit.surface == Hit::NONE {
        return;
    }
    let way = space.way(hit.pixel);
    let (path, sides) = if hit.surface == Hit::FRESH {
        let path = space.path(space.eye, way);
        let sides = space.sides(space.volume.at(path.start));
        (path, sides)
    } else {
        (space.path(hit.position.into(), way), hit.behind)
    };
    let Some(crossing) = space.follow(&path, sides, None).0 else {
        hit.surface = Hit::NONE;
        return;
    };
    let (normal, slope) = space.normal(crossing.position, way);
    *hit = Hit {
        position: crossing.position.into(),
        pixel: hit.pixel,
        normal: normal.into(),
        slope,
        depth: ((crossing.position - space.eye) * space.spacing).length(),
        surface: crossing.surface,
        before: crossing.before,
        behind: crossing.behind,
    };
    debug_assert!(Vec3::from(hit.normal).is_finite());
}
