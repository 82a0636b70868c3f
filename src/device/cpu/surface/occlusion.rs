//! Ambient occlusion: sums of unoccluded directions (the bent normal) and of the part of each ray that escapes; see [`Occlusion`].
//!
//! The rays of a hit travel side by side, one a lane. Each computes what it would alone, and sums are taken in the order of samples, so
//! that they hold the same bits on every instruction set.

use std::f32::consts::TAU;

use glam::Vec3;
use rayon::prelude::*;

use super::{CHUNK, NOWHERE, Space};
use crate::device::cpu::march::kernel::{kept, three};
use crate::device::cpu::march::lanes::{Array, Lanes};
use crate::device::cpu::simd::{self, Level};
use crate::device::cpu::trace::emitter::about;
use crate::device::random::{pcg4d, point, sphere};
use crate::device::surface::{Estimator, Hit, Occlusion, Samples, Surfaces};
use crate::field::HOLE;

/// Its streams of random numbers.
const STREAM: u32 = 1;

/// Lanes of a packet at most.
const MOST: usize = 16;

/// See [`Device::surface_occlusion`](crate::device::Device::surface_occlusion).
pub fn occlusion(surfaces: &Surfaces, occlusion: &Occlusion, samples: Samples, hits: &[Hit], sums: &mut [[f32; 4]]) {
    assert_eq!(hits.len(), sums.len(), "a sum for each hit");
    let space = Space::new(surfaces);
    // A volume that 32-bit indices cannot address goes without gathers.
    let add = at_level(if surfaces.grid.len() > i32::MAX as usize { Level::Portable } else { simd::level() });
    sums.par_chunks_mut(CHUNK).zip(hits.par_chunks(CHUNK)).for_each(|(sums, hits)| {
        sums.iter_mut().zip(hits).for_each(|(sum, hit)| add(&space, occlusion, samples, hit, sum));
    });
}

type Add = fn(&Space, &Occlusion, Samples, &Hit, &mut [f32; 4]);

/// The kernel for `level`, which the processor must have.
fn at_level(level: Level) -> Add {
    match level {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the caller got the level from `simd::level`, which has asked the processor.
        Level::Avx512 => |space, of, samples, hit, sum| unsafe { x86::avx512(space, of, samples, hit, sum) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        Level::Avx2 => |space, of, samples, hit, sum| unsafe { x86::avx2(space, of, samples, hit, sum) },
        _ => add::<Array<4>>,
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::super::Space;
    use super::add;
    use crate::device::cpu::march::lanes::{Avx2, Avx512};
    use crate::device::surface::{Hit, Occlusion, Samples};

    macro_rules! compiled {
        ($features:literal, $lanes:ty, $name:ident) => {
            #[target_feature(enable = $features)]
            pub(super) fn $name(space: &Space, of: &Occlusion, samples: Samples, hit: &Hit, sum: &mut [f32; 4]) {
                add::<$lanes>(space, of, samples, hit, sum);
            }
        };
    }
    compiled!("avx512f,avx512vl,avx512bw,avx512dq,avx2,bmi2,lzcnt,popcnt", Avx512, avx512);
    compiled!("avx2,bmi2,lzcnt,popcnt", Avx2, avx2);
}

#[inline(always)]
fn add<V: Lanes>(space: &Space, occlusion: &Occlusion, samples: Samples, hit: &Hit, sum: &mut [f32; 4]) {
    let normal = Vec3::from(hit.normal);
    let start = Vec3::from(hit.position) + Occlusion::OFFSET * space.mean_spacing * normal * space.per_length;
    let origin = pcg4d([hit.pixel, STREAM, occlusion.seed, hit.surface]);
    let lanes = V::SHAPE[0] * V::SHAPE[1];
    let (mut ways, mut jitter, mut through) = ([Vec3::ZERO; MOST], [0.0; MOST], [0.0; MOST]);
    for first in (samples.first..samples.end).step_by(lanes) {
        let count = lanes.min((samples.end - first) as usize);
        for l in 0..count {
            let i = first + l as u32;
            let [u, turn, later] = point(origin, i);
            ways[l] = match occlusion.estimator {
                Estimator::Normalised => about(normal, (1.0 - u).sqrt(), TAU * turn),
                Estimator::Paper => {
                    let s = sphere([hit.pixel, STREAM, occlusion.seed], i);
                    if s.dot(normal) < 0.0 { -s } else { s }
                }
            };
            jitter[l] = later;
        }
        escapes::<V>(space, occlusion, start, &ways, hit.before, &jitter).store(&mut through);
        for (way, through) in ways[..count].iter().zip(through) {
            sum[0] += way.x * through;
            sum[1] += way.y * through;
            sum[2] += way.z * through;
            sum[3] += through;
        }
    }
}

/// What surfaces leave of rays: each crossing takes its opacity away.
#[inline(always)]
fn escapes<V: Lanes>(
    space: &Space,
    occlusion: &Occlusion,
    start: Vec3,
    ways: &[Vec3; MOST],
    sides: u32,
    jitter: &[f32; MOST],
) -> V {
    let (zero, one) = (V::splat(0.0), V::splat(1.0));
    let slope = three!(a => V::from_fn(|l| ways[l][a] * space.per_length[a]));
    let jitter = V::from_fn(|l| jitter[l]);
    let step = V::splat(occlusion.radius / occlusion.steps as f32);
    let mut side = [zero; Surfaces::MOST];
    for (k, side) in side.iter_mut().enumerate() {
        *side = V::splat((sides >> k & 1) as f32);
    }
    // Whether the sample before is data, and whether a ray is still in the box.
    let (mut known, mut inside, mut through) = (if sides == NOWHERE { zero } else { one }, one, one);
    for n in 0..occlusion.steps {
        let t = (V::splat(n as f32) + jitter) * step;
        let position = three!(a => V::splat(start[a]) + t * slope[a]);
        for (p, top) in position.into_iter().zip(space.top.to_array()) {
            inside = V::select(p.lt(V::splat(-0.5)), zero, inside);
            inside = V::select(V::splat(top).lt(p), zero, inside);
        }
        if !V::any(zero.lt(inside * through)) {
            break;
        }
        let value = space.volume.along(position);
        let mut data = V::select(value.lt(V::splat(HOLE)), zero, one);
        if !space.clips.is_empty() {
            data = V::select(kept(space.clips, position), data, zero);
        }
        let counts = zero.lt(inside * known * data);
        for (side, surface) in side.iter_mut().zip(space.surfaces) {
            let now = V::select(value.lt(V::splat(surface.value)), zero, one);
            let crossed = counts & zero.lt((now - *side) * (now - *side));
            through = V::select(crossed, through * V::splat(1.0 - surface.opacity), through);
            *side = now;
        }
        known = data;
    }
    through
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Camera;
    use crate::device::surface::Surface;
    use crate::device::{Buffer, Clip, ClipShape, Storage};
    use crate::field::EMPTY;
    use crate::grid::{BrickLayout, Grid};

    /// Among holes and cuts, through transparent surfaces, from a known side and from none: a lane at a time and any number of them.
    #[test]
    fn packets_hold_the_bits_of_single_rays() {
        for size in [[21, 18, 24], [1, 18, 24]] {
            let grid = Grid { size, spacing: [0.5, 1.0, 0.75], origin: [10.0, -3.0, 0.0] };
            let value = |i: usize| {
                let p = [i % size[0], i / size[0] % size[1], i / (size[0] * size[1])].map(|c| c as f32);
                // In the plane of the values where they have only one along x.
                let flat = |c: [f32; 3]| Vec3::from(c).min(Vec3::from(size.map(|n| (n - 1) as f32)));
                let blob = |c: [f32; 3], r: f32| (1.0 - Vec3::from(p).distance(flat(c)) / r).max(0.0);
                if i.is_multiple_of(97) { EMPTY } else { blob([8.0, 7.0, 9.0], 9.0) + blob([15.0, 12.0, 16.0], 7.0) }
            };
            let field = Buffer(Storage::Host((0..grid.len()).map(value).collect()));
            let surface = |value, opacity| Surface {
                value,
                diffuse: [0.5; 3],
                specular: 0.1,
                exponent: 9.0,
                exponent_gradient: 0.0,
                opacity,
                transmission: 0.0,
                spread: 5.0,
                ior: 1.3,
            };
            let (lo, hi) = grid.bounds();
            let centre = (0.5 * (lo + hi)).as_vec3();
            let camera = Camera::look_at(centre + Vec3::new(30.0, -30.0, 20.0), centre, Vec3::Z, 30.0);
            let cut = Clip { shape: ClipShape::Plane { normal: Vec3::new(0.3, -0.8, 0.5), offset: 1.3 }, invert: true };
            for clips in [&[][..], &[cut]] {
                let surfaces = Surfaces {
                    grid: &grid,
                    field: &field,
                    bricks: BrickLayout::new(size, 4),
                    empty: &[],
                    surfaces: &[surface(0.2, 0.4), surface(0.6, 0.7)],
                    clips,
                    step: 0.3,
                    camera: &camera,
                    picture: [20, 20],
                };
                let mut hits: Vec<Hit> = (0..400).map(Hit::ray).collect();
                super::super::hits(&surfaces, &mut hits);
                hits.retain(|h| h.surface != Hit::NONE);
                assert!(hits.len() > 5, "{}", hits.len());
                hits.extend(hits.clone().into_iter().map(|hit| Hit { before: NOWHERE, ..hit }));
                let space = Space::new(&surfaces);
                let of = Occlusion { radius: 6.0, steps: 9, estimator: Estimator::Normalised, seed: 0 };
                let sums = |add: Add| -> Vec<[u32; 4]> {
                    let sum = |hit: &Hit| {
                        let mut sum = [0.0; 4];
                        add(&space, &of, Samples { first: 2, end: 35 }, hit, &mut sum);
                        sum.map(f32::to_bits)
                    };
                    hits.iter().map(sum).collect()
                };
                let alone = sums(add::<Array<1>>);
                // Of a flat volume nearly all rays go out at once.
                assert!(size[0] == 1 || alone.iter().any(|s| f32::from_bits(s[3]) < 30.0));
                for level in [Level::Portable, Level::Avx2, Level::Avx512].into_iter().filter(|l| *l <= simd::level()) {
                    assert!(sums(at_level(level)) == alone, "{level:?} on {size:?}");
                }
            }
        }
    }
}
