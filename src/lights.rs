//! Light sources.

use std::f64::consts::TAU;

use glam::{DVec3, Vec3};

use crate::error::{Error, Result};
use crate::scene::{LightKeys, LightKind, Model, Scene};

/// A light source in world space.
#[derive(Debug, Clone, Copy, PartialEq)]
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
    /// The same radiance from all directions.
    Environment {
        /// Radiance per channel.
        radiance: [f32; 3],
    },
}

/// The light sources of a scene, in order.
///
/// Without `[[lights]]` there are three that make a first picture look good with the default camera: a key light from its
/// upper left, a weaker fill from its right, and a dim environment. A distant light with softness becomes
/// seven of equal share, spread over the solid angle of its source.
///
/// # Errors
/// [`Error::Unsupported`] for kinds that this version does not have.
pub fn resolve(scene: &Scene) -> Result<Vec<Light>> {
    if scene.lights.is_empty() {
        return Ok(first_picture());
    }
    let mut lights = Vec::new();
    for keys in &scene.lights {
        let strength = keys.color.map(|c| c * keys.intensity);
        match keys.kind {
            LightKind::Distant => lights.extend(distant(keys, strength)),
            LightKind::Environment => lights.push(Light::Environment { radiance: strength }),
            LightKind::Point | LightKind::Cone if scene.light.model == Model::Physical => {
                return Err(Error::Unsupported(
                    "point and cone lights: this version has \"distant\" and \"environment\" lights".into(),
                ));
            }
            LightKind::Point => {
                lights.push(Light::Point { position: keys.position.into(), radius: keys.radius, intensity: strength });
            }
            LightKind::Cone => lights.push(Light::Cone {
                position: keys.position.into(),
                direction: DVec3::from(keys.direction).normalize().as_vec3(),
                angle: keys.angle.to_radians() as f32,
                edge: keys.edge.min(keys.angle).to_radians() as f32,
                radius: keys.radius,
                intensity: strength,
            }),
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

/// Directions of a soft light: one in the middle and six round it, all standing for equal parts of the cap.
const DIRECTIONS: usize = 7;

fn distant(keys: &LightKeys, irradiance: [f32; 3]) -> Vec<Light> {
    let axis = DVec3::from(keys.direction).normalize();
    let light =
        |direction: DVec3, irradiance| Light::Distant { direction: direction.as_vec3().normalize(), irradiance };
    if keys.softness == 0.0 {
        return vec![light(axis, irradiance)];
    }
    let share = irradiance.map(|e| e / DIRECTIONS as f32);
    let (side, other) = axis.any_orthonormal_pair();
    // The mean cosine over a cap of half angle θ is (1 + cos θ)/2: seven directions share it when the ring has this one.
    let count = DIRECTIONS as f64;
    let cos = 1.0 - (1.0 - keys.softness.to_radians().cos()) * count / (2.0 * (count - 1.0));
    let sin = (1.0 - cos * cos).sqrt();
    let ring = (1..DIRECTIONS).map(|i| {
        let angle = TAU * i as f64 / (DIRECTIONS - 1) as f64;
        light(cos * axis + sin * (angle.cos() * side + angle.sin() * other), share)
    });
    std::iter::once(light(axis, share)).chain(ring).collect()
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
        for softness in [0.5f64, 5.0, 40.0] {
            let text = format!("[[lights]]\ndirection = [1, 2, -3]\nintensity = 3\nsoftness = {softness}");
            let lights = resolve(&scene(&text)).unwrap();
            assert_eq!(lights.len(), 7);
            let axis = Vec3::new(1.0, 2.0, -3.0).normalize();
            let (mut total, mut mean) = (0.0, Vec3::ZERO);
            for light in &lights {
                let Light::Distant { direction, irradiance } = light else { panic!("{light:?}") };
                assert!((direction.length() - 1.0).abs() < 1e-6);
                assert!(f64::from(direction.angle_between(axis)) <= softness.to_radians());
                total += irradiance[0];
                mean += *direction / 7.0;
            }
            assert!((total - 3.0).abs() < 1e-5);
            assert!(mean.normalize().dot(axis) > 1.0 - 1e-6, "symmetric about the axis");
            // Over a cap of half angle θ the mean of the cosine is (1 + cos θ)/2.
            let exact = 0.5 * (1.0 + softness.to_radians().cos());
            assert!((f64::from(mean.dot(axis)) - exact).abs() < 1e-6, "{} {exact}", mean.dot(axis));
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
