//! The environment through diffuse and specular lobes at each hit: sums of both; see [`Beauty`].

use std::f32::consts::TAU;

use glam::Vec3;
use rayon::prelude::*;

use super::{CHUNK, Space};
use crate::device::cpu::host;
use crate::device::cpu::trace::emitter::about;
use crate::device::random::{pcg4d, point, sphere};
use crate::device::surface::{Beauty, Environment, Estimator, Hit, Map, Surface, Surfaces, THRESHOLD, focus, widest};

/// Its streams of random numbers.
const DIFFUSE: u32 = 2;
const SPECULAR: u32 = 3;

/// See [`Device::surface_beauty`](crate::device::Device::surface_beauty).
pub fn beauty(surfaces: &Surfaces, beauty: &Beauty, hits: &[Hit], sums: &mut [[[f32; 3]; 2]]) {
    assert_eq!(hits.len(), sums.len(), "a sum for each hit");
    assert!(beauty.bent.is_empty() || beauty.bent.len() == hits.len(), "a bent normal for each hit");
    let space = Space::new(surfaces);
    let light = Light::new(&beauty.environment);
    sums.par_chunks_mut(CHUNK).zip(hits.par_chunks(CHUNK)).enumerate().for_each(|(n, (sums, hits))| {
        for (i, (sum, hit)) in sums.iter_mut().zip(hits).enumerate() {
            let bent = beauty.bent.get(n * CHUNK + i).copied().unwrap_or_default();
            add(&space, &light, beauty, Vec3::new(bent[0], bent[1], bent[2]), hit, sum);
        }
    });
}

fn add(space: &Space, light: &Light, beauty: &Beauty, bent: Vec3, hit: &Hit, sum: &mut [[f32; 3]; 2]) {
    let surface = &space.surfaces[hit.surface as usize];
    let normal = Vec3::from(hit.normal);
    let open = bent.normalize_or(normal);
    let view = space.towards(hit);
    let mirrored = reflect(view, normal);
    let [mut diffuse, mut specular] = sum.map(Vec3::from);
    if let Some(filtered) = beauty.environment.filtered {
        diffuse += light.at(&filtered.irradiance, open);
        specular += light.at(&filtered.reflections[hit.surface as usize], mirrored);
        *sum = [diffuse.into(), specular.into()];
        return;
    }
    let radiance = beauty.environment.radiance;
    let origin = pcg4d([hit.pixel, DIFFUSE, beauty.seed, hit.surface]);
    for i in beauty.diffuse.first..beauty.diffuse.end {
        let (way, weight) = hemisphere(beauty.estimator, open, origin, [hit.pixel, DIFFUSE, beauty.seed], i);
        diffuse += weight * light.at(&radiance, way);
    }
    let exponent = Surface::exponent_at(surface, hit.slope);
    let origin = pcg4d([hit.pixel, SPECULAR, beauty.seed, hit.surface]);
    for i in beauty.specular.first..beauty.specular.end {
        let (way, weight) = lobe(beauty.estimator, mirrored, exponent, origin, [hit.pixel, SPECULAR, beauty.seed], i);
        // The published lobe may reach below the surface.
        let way = if beauty.estimator == Estimator::Paper { way } else { above(way, normal) };
        specular += weight * light.at(&radiance, way);
    }
    *sum = [diffuse.into(), specular.into()];
}

/// (12): `r = 2n(n·v) − v`, with v against the way of view.
pub(super) fn reflect(view: Vec3, normal: Vec3) -> Vec3 {
    view - 2.0 * view.dot(normal) * normal
}

/// The direction mirrored at the surface if it goes below it.
pub(super) fn above(way: Vec3, normal: Vec3) -> Vec3 {
    way - 2.0 * way.dot(normal).min(0.0) * normal
}

/// Draw `i` of the hemisphere about `normal`, and its weight: (2) with (10), or by Lambert's cosine.
pub(super) fn hemisphere(
    estimator: Estimator,
    normal: Vec3,
    origin: [u32; 4],
    stream: [u32; 3],
    i: u32,
) -> (Vec3, f32) {
    match estimator {
        Estimator::Normalised => {
            let [u, turn, _] = point(origin, i);
            (about(normal, (1.0 - u).sqrt(), TAU * turn), 1.0)
        }
        Estimator::Paper => {
            let s = sphere(stream, i);
            let cosine = s.dot(normal);
            (if cosine < 0.0 { -s } else { s }, cosine.abs())
        }
    }
}

/// Draw `i` of the lobe cos^s about `axis`, and its weight: (3), (6) with (11), or by the lobe's density `(s + 1)/2π·cos^s`.
pub(super) fn lobe(
    estimator: Estimator,
    axis: Vec3,
    exponent: f32,
    origin: [u32; 4],
    stream: [u32; 3],
    i: u32,
) -> (Vec3, f32) {
    match estimator {
        Estimator::Normalised => {
            let [u, turn, _] = point(origin, i);
            (about(axis, (1.0 - u).powf(1.0 / (exponent + 1.0)), TAU * turn), 1.0)
        }
        Estimator::Paper => {
            let s = sphere(stream, i);
            let alpha = focus(widest(exponent, THRESHOLD));
            let hemisphere = if s.dot(axis) < 0.0 { -s } else { s };
            let way = (alpha * hemisphere + (1.0 - alpha) * axis).normalize();
            (way, way.dot(axis).max(0.0).powf(exponent))
        }
    }
}

/// The environment's maps in memory.
pub(super) struct Light<'a> {
    texels: &'a [f32],
}

impl<'a> Light<'a> {
    pub(super) fn new(environment: &Environment<'a>) -> Self {
        let maps = environment.filtered.iter().flat_map(|f| f.reflections.iter().chain([&f.irradiance]));
        let texels = host(environment.texels);
        let within = |map: &Map| 3 * (map.first + map.texels()) <= texels.len();
        assert!(maps.chain([&environment.radiance]).all(within), "maps lie within the texels");
        Light { texels }
    }

    /// Bilinear between texels.
    #[inline(always)]
    pub(super) fn at(&self, map: &Map, way: Vec3) -> Vec3 {
        // With the border, the first texel's middle is at 1.
        let p = Map::place(way) * map.edge as f32 + 0.5;
        let [x, y] = [p.x, p.y].map(|c| c.clamp(0.0, map.edge as f32) as usize);
        let f = p - glam::Vec2::new(x as f32, y as f32);
        let row = map.edge + 2;
        let texel = |dx: usize, dy: usize| {
            let i = 3 * (map.first + (y + dy) * row + x + dx);
            Vec3::from_slice(&self.texels[i..i + 3])
        };
        let mix = |a: Vec3, b: Vec3, t: f32| a * (1.0 - t) + b * t;
        mix(mix(texel(0, 0), texel(1, 0), f.x), mix(texel(0, 1), texel(1, 1), f.x), f.y)
    }
}

#[cfg(test)]
mod tests {
    use std::f32::consts::{FRAC_PI_2, PI};

    use super::*;

    fn axes() -> [Vec3; 4] {
        [Vec3::Z, -Vec3::Z, Vec3::new(0.6, -0.8, 0.0), Vec3::new(-0.3, 0.2, -0.5).normalize()]
    }

    #[test]
    fn the_focus_goes_from_the_hemisphere_to_the_axis() {
        // (4) to (6): no exponent opens the lobe to the whole hemisphere, an endless one closes it.
        assert_eq!((widest(0.0, THRESHOLD), focus(FRAC_PI_2)), (FRAC_PI_2, 1.0));
        assert_eq!((widest(f32::INFINITY, THRESHOLD), focus(0.0)), (0.0, 0.0));
        assert!((focus(0.25 * PI) - 0.5).abs() < 1e-6);
        for s in [1.0, 7.0, 300.0] {
            assert!((widest(s, THRESHOLD).cos().powf(s) - THRESHOLD).abs() < 1e-4, "{s}");
        }
    }

    #[test]
    fn published_lobes_stay_within_their_angle_and_reach_it() {
        for axis in axes() {
            for exponent in [1.0, 10.0, 200.0] {
                let most = widest(exponent, THRESHOLD);
                let angles = (0..4000)
                    .map(|i| lobe(Estimator::Paper, axis, exponent, [0; 4], [1, 2, 3], i).0.angle_between(axis));
                let largest = angles.fold(0.0, f32::max);
                // A random direction at a right angle to the axis lands on the edge of the cone.
                assert!(largest <= most + 1e-3 && largest > 0.95 * most, "{largest} of {most}");
            }
        }
    }

    #[test]
    fn hemispheres_are_hemispheres() {
        for axis in axes() {
            for estimator in [Estimator::Paper, Estimator::Normalised] {
                let mut mean = Vec3::ZERO;
                for i in 0..4000 {
                    let (way, weight) = hemisphere(estimator, axis, pcg4d([1, 2, 3, 4]), [5, 6, 7], i);
                    assert!(way.dot(axis) > -1e-6 && (way.length() - 1.0).abs() < 1e-4);
                    mean += weight * way / 4000.0;
                }
                // ∫ cos²/2π dω = 1/3 without the density, ∫ cos²/π dω = 2/3 with it; four standard errors of 4000 draws.
                let wanted = if estimator == Estimator::Paper { 1.0 / 3.0 } else { 2.0 / 3.0 };
                assert!((mean - wanted * axis).length() < 0.03, "{mean} {axis}");
            }
        }
    }

    #[test]
    fn normalised_lobes_have_the_mean_cosine_of_their_density() {
        for axis in axes() {
            for exponent in [0.0, 3.0, 50.0] {
                let origin = pcg4d([9, 2, 3, 4]);
                let draws =
                    (0..2000).map(|i| lobe(Estimator::Normalised, axis, exponent, origin, [0; 3], i).0.dot(axis));
                let mean = draws.sum::<f32>() / 2000.0;
                assert!((mean - (exponent + 1.0) / (exponent + 2.0)).abs() < 2e-3, "{mean} for {exponent}");
            }
        }
    }

    #[test]
    fn what_falls_below_the_surface_is_mirrored_at_it() {
        let normal = Vec3::new(0.0, 0.6, 0.8);
        for way in axes() {
            let above = above(way, normal);
            assert!(above.dot(normal) >= -1e-6 && (above.length() - 1.0).abs() < 1e-5);
            assert!((above.dot(normal).abs() - way.dot(normal).abs()).abs() < 1e-6);
        }
    }
}
