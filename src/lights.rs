//! Light sources.

use std::f64::consts::TAU;
use std::sync::Arc;

use glam::{DVec3, Vec3};

use crate::error::Result;
use crate::scene::{LightKeys, LightKind, Model, Scene};

mod area;
mod emitters;
mod panorama;
mod texture;

pub use area::Area;
pub use emitters::Emitters;
pub use panorama::{Cell, Panorama};
pub use texture::Texture;
pub(crate) use texture::read_linear;

/// A light source in world space.
#[derive(Debug, Clone, PartialEq)]
pub enum Light {
    /// Parallel rays.
    Distant {
        /// The way the light travels, unit.
        direction: Vec3,
        /// Irradiance on a facing plane per channel.
        irradiance: [f32; 3],
    },
    /// From one place in all directions.
    Point {
        /// World position.
        position: DVec3,
        /// Radius of the source, world length: 1/r² is held at 1/radius² nearer than this.
        radius: f64,
        /// Radiant intensity per channel, power/4π: irradiance at distance r in vacuum is intensity/r².
        intensity: [f32; 3],
    },
    /// From one place within a cone.
    Cone {
        /// World position of the tip.
        position: DVec3,
        /// The way the light travels along the axis, unit.
        direction: Vec3,
        /// Half angle in radians, above 0, at most π/2.
        angle: f32,
        /// Angle in radians, measured inwards from the half angle, over which the light fades.
        edge: f32,
        /// As of a point light.
        radius: f64,
        /// As of a point light, within the cone: a narrower cone takes light away and does not bundle it.
        intensity: [f32; 3],
    },
    /// From a small flat place with the cosine of its side: part of an area light.
    Patch {
        /// World position.
        position: DVec3,
        /// The way that it faces, unit.
        direction: Vec3,
        /// As of a point light.
        radius: f64,
        /// Radiant intensity per channel along `direction`; at angle θ from it times cos θ, and nothing behind.
        intensity: [f32; 3],
    },
    /// The same radiance from all directions.
    Environment {
        /// Radiance per channel.
        radiance: [f32; 3],
    },
    /// The radiance of an image all around.
    Image {
        /// What is all around.
        image: Arc<Panorama>,
        /// Factor on its radiance per channel.
        factor: [f32; 3],
    },
}

impl Light {
    /// Mean radiance from all directions of an environment; `None` of other lights.
    pub fn mean_radiance(&self) -> Option<[f32; 3]> {
        match self {
            Light::Environment { radiance } => Some(*radiance),
            Light::Image { image, factor } => {
                let mean = image.mean(&Cell { z: [-1.0, 1.0], azimuth: [0.0, TAU] });
                Some(std::array::from_fn(|c| factor[c] * mean[c]))
            }
            _ => None,
        }
    }
}

/// The light sources of a scene, in order.
///
/// Without `[[lights]]` there are three that make a first picture look good with the default camera: a key light from its
/// upper left, a weaker fill from its right, and a dim environment. In the physical model a light with softness, a radius or a
/// surface becomes `samples` of equal share, spread over the solid angle, the ball, or the surface that it is.
///
/// # Errors
/// Those of [`Panorama::read`].
pub fn resolve(scene: &Scene) -> Result<Vec<Light>> {
    if scene.lights.is_empty() {
        return Ok(first_picture());
    }
    let mut lights = Vec::new();
    for keys in &scene.lights {
        let strength = keys.color.map(|c| c * keys.intensity);
        match keys.kind {
            LightKind::Distant => lights.extend(distant(keys, strength)),
            LightKind::Environment => lights.push(match Panorama::of(keys)? {
                Some(image) => Light::Image { image: Arc::new(image), factor: strength },
                None => Light::Environment { radiance: strength },
            }),
            kind if kind.is_area() => lights.extend(Area::new(keys)?.points(keys.samples)),
            _ => lights.extend(placed(keys, strength, scene.light.model)),
        }
    }
    Ok(lights)
}

/// Key, fill and environment round the default camera, which looks from azimuth 30° and elevation 20°.
fn first_picture() -> Vec<Light> {
    let distant =
        |direction: [f32; 3], irradiance| Light::Distant { direction: Vec3::from(direction).normalize(), irradiance };
    vec![
        distant([0.85, 0.75, -0.9], [8.5, 8.1, 7.6]),
        distant([-1.08, 0.07, -0.2], [0.7, 0.8, 0.95]),
        Light::Environment { radiance: [0.07, 0.075, 0.085] },
    ]
}

/// A soft light's directions: one in the middle and rings of six and twelve round it, all standing for equal parts of the cap.
fn distant(keys: &LightKeys, irradiance: [f32; 3]) -> Vec<Light> {
    let axis = DVec3::from(keys.direction).normalize();
    let light =
        |direction: DVec3, irradiance| Light::Distant { direction: direction.as_vec3().normalize(), irradiance };
    let rings = match keys.samples {
        _ if keys.softness == 0.0 => 0,
        19 => 2,
        7 => 1,
        _ => 0,
    };
    let count = (1 + 3 * rings * (rings + 1)) as f64;
    let share = irradiance.map(|e| e / count as f32);
    let (side, other) = axis.any_orthonormal_pair();
    // The middle of a ring's part of the cap, stretched so that the mean cosine is that of the cap, (1 + cos θ)/2: the middle
    // of the cap stands on its axis.
    let middle = |ring: usize| (1 + 3 * ring * ring) as f64 / count;
    let stretch = 0.5 * count / (1..=rings).map(|ring| (6 * ring) as f64 * middle(ring)).sum::<f64>();
    let spread = 1.0 - keys.softness.to_radians().cos();
    let ring = |ring: usize| {
        let cos = 1.0 - spread * middle(ring) * stretch;
        let sin = (1.0 - cos * cos).sqrt();
        (0..6 * ring).map(move |i| {
            let angle = TAU * (i as f64 + 0.5 * (ring - 1) as f64) / (6 * ring) as f64;
            light(cos * axis + sin * (angle.cos() * side + angle.sin() * other), share)
        })
    };
    std::iter::once(light(axis, share)).chain((1..=rings).flat_map(ring)).collect()
}

/// A point or cone light; in the physical model the points of equal share that stand for it.
fn placed(keys: &LightKeys, intensity: [f32; 3], model: Model) -> Vec<Light> {
    let offsets = match model {
        Model::Physical if keys.radius > 0.0 => ball(keys.samples),
        _ => vec![DVec3::ZERO],
    };
    let intensity = intensity.map(|i| i / offsets.len() as f32);
    let direction = DVec3::from(keys.direction).normalize().as_vec3();
    let at = |offset: DVec3| {
        let (position, radius) = (DVec3::from(keys.position) + keys.radius * offset, keys.radius);
        match keys.kind {
            LightKind::Cone => Light::Cone {
                position,
                direction,
                angle: keys.angle.to_radians() as f32,
                edge: keys.edge.to_radians() as f32,
                radius,
                intensity,
            },
            _ => Light::Point { position, radius, intensity },
        }
    };
    offsets.into_iter().map(at).collect()
}

/// Points in the unit ball that stand for it: seen from any side their mean square distance from the middle is that of an
/// even disk, ¼ along each axis, so that penumbras are as wide. The middle; with it the six points along the axes; with
/// them the twelve between two axes.
fn ball(samples: usize) -> Vec<DVec3> {
    let signs = [-1.0, 1.0];
    let axes = DVec3::AXES.into_iter().flat_map(|axis| signs.map(|s| s * axis));
    let edges = (0..3).flat_map(|a| {
        let [b, c] = [(a + 1) % 3, (a + 2) % 3].map(|i| DVec3::AXES[i]);
        signs.into_iter().flat_map(move |s| signs.map(|t| (s * b + t * c) / 2f64.sqrt()))
    });
    // Σ r²/3 = samples/4.
    let middle = std::iter::once(DVec3::ZERO);
    match samples {
        7 => middle.chain(axes.map(|p| p * (7.0f64 / 8.0).sqrt())).collect(),
        19 => {
            let inner: f64 = 0.7;
            let outer = ((0.75 * 19.0 - 6.0 * inner * inner) / 12.0).sqrt();
            middle.chain(axes.map(|p| inner * p)).chain(edges.map(|p| outer * p)).collect()
        }
        _ => middle.collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Grid;
    use crate::camera::Camera;

    fn scene(text: &str) -> Scene {
        Scene::parse(text, "test", &[]).unwrap()
    }

    #[test]
    fn a_light_is_its_colour_times_its_intensity_along_its_unit_direction() {
        let lights = resolve(&scene(
            "[[lights]]\ndirection = [0, 3, -4]\ncolor = [1, 0.5, 0]\nintensity = 2\n[[lights]]\nkind = \"environment\"\nintensity = 0.5",
        ));
        let expected = [
            Light::Distant { direction: Vec3::new(0.0, 0.6, -0.8), irradiance: [2.0, 1.0, 0.0] },
            Light::Environment { radiance: [0.5; 3] },
        ];
        assert_eq!(lights.unwrap(), expected);
    }

    #[test]
    fn a_soft_light_keeps_its_irradiance_and_stays_within_its_angle() {
        for (softness, samples) in [(0.5f64, 7), (5.0, 7), (40.0, 7), (5.0, 19), (60.0, 19)] {
            let text = format!(
                "[[lights]]\ndirection = [1, 2, -3]\nintensity = 3\nsoftness = {softness}\nsamples = {samples}"
            );
            let lights = resolve(&scene(&text)).unwrap();
            assert_eq!(lights.len(), samples);
            let axis = Vec3::new(1.0, 2.0, -3.0).normalize();
            let (mut total, mut mean) = (0.0, Vec3::ZERO);
            for light in &lights {
                let Light::Distant { direction, irradiance } = light else { panic!("{light:?}") };
                assert!((direction.length() - 1.0).abs() < 1e-6);
                assert!(f64::from(direction.angle_between(axis)) <= softness.to_radians());
                total += irradiance[0];
                mean += *direction / samples as f32;
            }
            assert!((total - 3.0).abs() < 1e-5);
            assert!(mean.normalize().dot(axis) > 1.0 - 1e-6, "symmetric about the axis");
            // Over a cap of half angle θ the mean of the cosine is (1 + cos θ)/2.
            let exact = 0.5 * (1.0 + softness.to_radians().cos());
            assert!((f64::from(mean.dot(axis)) - exact).abs() < 1e-6, "{} {exact}", mean.dot(axis));
        }
    }

    #[test]
    fn a_ball_of_light_keeps_its_intensity_and_is_as_wide_as_a_disk_from_every_side() {
        for samples in [7, 19] {
            let text = format!(
                "[[lights]]\nkind = \"point\"\nposition = [1, 2, 3]\nradius = 0.5\nintensity = 3\nsamples = {samples}"
            );
            let lights = resolve(&scene(&text)).unwrap();
            assert_eq!(lights.len(), samples);
            let mut total = 0.0;
            let mut second = glam::DMat3::ZERO;
            for light in &lights {
                let Light::Point { position, intensity, .. } = light else { panic!("{light:?}") };
                let offset = (*position - DVec3::new(1.0, 2.0, 3.0)) / 0.5;
                assert!(offset.length() <= 1.0);
                total += f64::from(intensity[1]);
                second += glam::DMat3::from_cols(offset * offset.x, offset * offset.y, offset * offset.z);
            }
            assert!((total - 3.0).abs() < 1e-5);
            // An even disk of radius 1 has the mean square ¼ along each axis across the view.
            assert!(
                (second * (1.0 / samples as f64)).abs_diff_eq(glam::DMat3::from_diagonal(DVec3::splat(0.25)), 1e-12)
            );
        }
    }

    #[test]
    fn without_lights_a_key_a_weaker_fill_and_a_dim_environment_are_set() {
        let lights = resolve(&Scene::default()).unwrap();
        let [
            Light::Distant { direction, irradiance: key },
            Light::Distant { irradiance: fill, .. },
            Light::Environment { radiance },
        ] = lights[..]
        else {
            panic!("{lights:?}")
        };
        assert!(direction.z < 0.0, "the key light travels downwards");
        let camera = Camera::framed(&Default::default(), &Grid::new([8; 3]), 1.5, 0).unwrap();
        assert!(direction.dot(camera.forward) > 0.0, "the key light comes from the camera's side");
        assert!(direction.dot(camera.right) > 0.0, "and from its left");
        assert!(key[1] > 3.0 * fill[1] && fill[1] > radiance[1]);
    }
}
