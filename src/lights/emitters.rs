//! The lights of a scene as path tracing samples them: each one whole, where the light solver takes a few points of it.

use std::f64::consts::{PI, TAU};

use glam::{DVec3, Vec3};

use super::{Area, Light, Panorama, first_picture};
use crate::device::emitter::{Emitter, Shape};
use crate::error::Result;
use crate::grid::Grid;
use crate::scene::{LightKeys, LightKind, Scene};

/// All lights of a scene, and their images.
#[derive(Debug, Clone, Default)]
pub struct Emitters {
    /// World position, and the rest.
    list: Vec<(DVec3, Emitter)>,
    images: Vec<f32>,
}

impl Emitters {
    /// The lights of a scene; without any those of [`resolve`](super::resolve).
    ///
    /// # Errors
    /// Those of [`Panorama::read`].
    pub fn new(scene: &Scene) -> Result<Self> {
        let mut all = Emitters::default();
        if scene.lights.is_empty() {
            all.list.extend(first_picture().iter().map(|light| (DVec3::ZERO, from_light(light))));
        }
        for keys in &scene.lights {
            let emitter = Emitter { visible: keys.visible, ..all.emitter(keys)? };
            all.list.push((DVec3::from(keys.position), emitter));
        }
        Ok(all)
    }

    /// The images of all emitters, one after another: see `device/cpu/trace/emitter.rs`.
    pub fn images(&self) -> &[f32] {
        &self.images
    }

    /// The lights as the volume on `grid` sees them: placed against its first value, each with a share by the fluence that it would have
    /// in the middle of the volume. Those that shine nothing are left out.
    pub fn on(&self, grid: &Grid) -> Vec<Emitter> {
        let (lo, hi) = grid.bounds();
        let (middle, reach) = (0.5 * (lo + hi), 0.5 * (hi - lo).length());
        let mut placed: Vec<Emitter> = (self.list.iter())
            .map(|(position, emitter)| {
                let away = position.distance(middle).max(reach);
                let share = (self.brightness(emitter) * strength(emitter, away)) as f32;
                let position = (*position - DVec3::from(grid.origin)).as_vec3();
                Emitter { position, share, ..*emitter }
            })
            .filter(|e| e.share > 0.0)
            .collect();
        let total: f32 = placed.iter().map(|e| e.share).sum();
        placed.iter_mut().for_each(|e| e.share /= total);
        placed
    }

    fn emitter(&mut self, keys: &LightKeys) -> Result<Emitter> {
        let strength = keys.color.map(|c| c * keys.intensity);
        let axis = DVec3::from(keys.direction).normalize().as_vec3();
        Ok(match keys.kind {
            LightKind::Distant if keys.softness > 0.0 => {
                let cosine = keys.softness.to_radians().cos();
                // Its fluence is the irradiance of the sharp light, as the light solver has it.
                let radiance = strength.map(|e| (f64::from(e) / (TAU * (1.0 - cosine))) as f32);
                Emitter { axis, edge: cosine as f32, ..Emitter::new(Shape::Distant, radiance) }
            }
            LightKind::Distant => Emitter { axis, ..Emitter::new(Shape::Distant, strength) },
            LightKind::Point => point(Vec3::ZERO, -1.0, 0.0, keys.radius, strength),
            LightKind::Cone => {
                let (outer, inner) = (keys.angle.to_radians().cos(), (keys.angle - keys.edge).to_radians().cos());
                point(axis, outer, inner, keys.radius, strength)
            }
            LightKind::Environment => {
                let mut emitter = Emitter::new(Shape::Environment, strength);
                if let Some(image) = Panorama::of(keys)? {
                    emitter.image = self.panorama(&image);
                }
                emitter
            }
            _ => {
                let area = Area::new(keys)?;
                let mut emitter = area.emitter();
                if let Some(([width, height], pixels)) = area.texture() {
                    emitter.image = [self.images.len() as u32, width as u32, height as u32];
                    self.images.extend(pixels.as_flattened());
                }
                emitter
            }
        })
    }

    /// Takes in an image of the sky, with the shares by which its directions are chosen.
    fn panorama(&mut self, image: &Panorama) -> [u32; 3] {
        let [width, height] = image.size();
        let first = self.images.len();
        self.images.extend(image.pixels().as_flattened());
        let bright = |p: &[f32; 3]| f64::from(p[0]) + f64::from(p[1]) + f64::from(p[2]);
        let mut rows = vec![];
        let mut shares = vec![];
        for (y, row) in image.pixels().chunks(width).enumerate() {
            let [above, below] = [y, y + 1].map(|y| (PI * y as f64 / height as f64).cos());
            let (total, cumulative) = cumulative(&row.iter().map(bright).collect::<Vec<_>>());
            rows.push(total * (above - below));
            shares.extend(cumulative);
        }
        self.images.extend(cumulative(&rows).1);
        self.images.extend(shares);
        [first as u32, width as u32, height as u32]
    }

    /// Mean over channels of an emitter's radiance, and over its image.
    fn brightness(&self, emitter: &Emitter) -> f64 {
        let mean = |v: Vec3| f64::from(v.element_sum()) / 3.0;
        let [first, width, height] = emitter.image.map(|n| n as usize);
        if width == 0 {
            return mean(emitter.radiance);
        }
        let row = |y: usize| {
            let [above, below] = [y, y + 1].map(|y| (PI * y as f64 / height as f64).cos());
            let around = matches!(emitter.shape, Shape::Environment | Shape::Sphere);
            let part = if around { 0.5 * (above - below) } else { 1.0 / height as f64 };
            let pixels = self.images[first + 3 * y * width..][..3 * width].chunks_exact(3);
            part * pixels.map(|p| mean(Vec3::from_slice(p) * emitter.radiance)).sum::<f64>() / width as f64
        };
        (0..height).map(row).sum()
    }
}

/// Shares of each value and all before it; even ones where all are 0. Also their sum.
fn cumulative(values: &[f64]) -> (f64, Vec<f32>) {
    let total: f64 = values.iter().sum();
    let mut sum = 0.0;
    let share = |(i, v): (usize, &f64)| {
        sum += v;
        let share = if total > 0.0 { sum / total } else { (i + 1) as f64 / values.len() as f64 };
        if i + 1 == values.len() { 1.0 } else { share as f32 }
    };
    (total, values.iter().enumerate().map(share).collect())
}

/// Fluence at a distance from an emitter of radiance, irradiance or intensity 1.
fn strength(emitter: &Emitter, away: f64) -> f64 {
    let area = |area: f64| area / (away * away);
    let radius = f64::from(emitter.radius);
    let (u, v) = (f64::from(emitter.u.length()), f64::from(emitter.v.length()));
    match emitter.shape {
        Shape::Distant if emitter.edge < 1.0 => TAU * (1.0 - f64::from(emitter.edge)),
        Shape::Distant => 1.0,
        Shape::Point => area(1.0),
        Shape::Environment => 2.0 * TAU,
        Shape::Rectangle => area(4.0 * u * v),
        Shape::Disk => area(PI * u * v),
        Shape::Ring => area(PI * u * v * (1.0 - f64::from(emitter.inner * emitter.inner))),
        Shape::Box => area(2.0 * (u * v + v * radius + radius * u)),
        Shape::Sphere => area(PI * radius * radius),
    }
}

fn point(axis: Vec3, outer: f64, inner: f64, radius: f64, intensity: [f32; 3]) -> Emitter {
    Emitter {
        axis,
        edge: outer as f32,
        slope: (1.0 / (inner - outer).max(1e-6)) as f32,
        radius: radius as f32,
        ..Emitter::new(Shape::Point, intensity)
    }
}

fn from_light(light: &Light) -> Emitter {
    match *light {
        Light::Distant { direction, irradiance } => {
            Emitter { axis: direction, ..Emitter::new(Shape::Distant, irradiance) }
        }
        Light::Environment { radiance } => Emitter::new(Shape::Environment, radiance),
        _ => unreachable!("the first picture has distant lights and an environment"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::cpu::trace::emitter::{hit, sample};

    /// Evenly spread numbers.
    fn numbers(n: usize) -> impl Iterator<Item = [f32; 3]> {
        let r = [0.819_172_5, 0.671_043_6, 0.549_700_5];
        (0..n).map(move |i| r.map(|r| (0.5 + r * i as f64).fract() as f32))
    }

    /// What a point is lit by is the integral of what its rays meet, and both know the same density.
    #[test]
    fn samples_and_hits_agree() {
        let pixels = (0..32).map(|i| [(i % 5) as f32, if i > 20 { 9.0 } else { 0.0 }, 0.5]).collect();
        let mut sky = Emitters::default();
        let image = sky.panorama(&Panorama::new([8, 4], pixels));
        let environment = Emitter::new(Shape::Environment, [2.0, 1.0, 0.5]);
        let cap =
            Emitter { axis: Vec3::new(0.6, 0.0, 0.8), edge: 0.7, ..Emitter::new(Shape::Distant, [1.0, 2.0, 3.0]) };
        for emitter in [environment, Emitter { image, ..environment }, cap] {
            let (mut lit, mut met) = (Vec3::ZERO, Vec3::ZERO);
            let n = 1 << 16;
            for xi in numbers(n) {
                let s = sample(&emitter, &sky.images, Vec3::ONE, xi).unwrap();
                assert!((s.direction.length() - 1.0).abs() < 1e-5);
                let h = hit(&emitter, &sky.images, Vec3::ONE, s.direction);
                // Right at an edge the two may differ by rounding.
                if let Some(h) = h.filter(|h| (h.pdf - s.pdf).abs() <= 1e-3 * s.pdf) {
                    lit += h.radiance * (1.0 + s.direction.x) / s.pdf / n as f32;
                }
                let way = even(xi);
                if let Some(h) = hit(&emitter, &sky.images, Vec3::ONE, way) {
                    met += h.radiance * (1.0 + way.x) * (2.0 * TAU as f32) / n as f32;
                }
            }
            // Edges of pixels leave the sums an error of a hundredth.
            assert!((lit - met).abs().max_element() < 0.02 * met.max_element(), "{lit} {met} {emitter:?}");
        }
    }

    /// A direction, all alike.
    fn even(xi: [f32; 3]) -> Vec3 {
        crate::device::cpu::trace::emitter::about(Vec3::Z, 1.0 - 2.0 * xi[0], TAU as f32 * xi[1])
    }

    /// From a ball of light at a distance comes what comes from its middle, spread as from an even disk.
    #[test]
    fn a_ball_is_an_even_disk_from_every_side() {
        let ball = point(Vec3::ZERO, -1.0, 0.0, 2.0, [3.0; 3]);
        let from = Vec3::new(300.0, 400.0, 0.0);
        let (mut lit, mut spread) = (0.0f64, 0.0f64);
        let n = 1 << 14;
        for xi in numbers(n) {
            let s = sample(&ball, &[], from, xi).unwrap();
            assert!((s.distance - 500.0).abs() <= 2.001 && s.pdf == 0.0);
            lit += f64::from(s.radiance.x) / n as f64;
            let away = s.direction * s.distance + from;
            spread += f64::from(away.z * away.z) / n as f64;
        }
        assert!((lit / (3.0 / 250_000.0) - 1.0).abs() < 1e-3, "{lit}");
        // The mean square along an axis is ¼ of the radius squared.
        assert!((spread - 1.0).abs() < 0.02, "{spread}");
    }

    #[test]
    fn shares_are_by_brightness_and_lights_that_are_off_are_left_out() {
        let text = "[[lights]]\nintensity = 3\n[[lights]]\nkind = \"environment\"\nintensity = 0\n[[lights]]\nkind = \"environment\"\nintensity = 1";
        let scene = Scene::parse(text, "test", &[]).unwrap();
        let all = Emitters::new(&scene).unwrap().on(&Grid::new([8; 3]));
        assert_eq!(all.iter().map(|e| e.shape).collect::<Vec<_>>(), [Shape::Distant, Shape::Environment]);
        let expected = 3.0 / (3.0 + 4.0 * std::f32::consts::PI);
        assert!((all[0].share - expected).abs() < 1e-6 && (all[1].share - 1.0 + expected).abs() < 1e-6);
    }
}
