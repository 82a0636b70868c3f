//! Lights with a surface: rectangles, disks, rings, boxes and balls, even or textured.
//!
//! Radiance L leaves every place of the surface alike to all directions, so that an area A gives the exitance `πL`, the power `πAL`
//! for each side that shines, and the radiant intensity `A cos θ L` at angle θ from its normal. Path tracing samples the surface
//! ([`Area::emitter`]); for the light volume points stand for it ([`Area::points`]), each with the cosine of its face.

use std::f64::consts::PI;

use glam::DVec3;

use super::panorama::read;
use super::{Light, ball};
use crate::device::emitter::{Emitter, Shape};
use crate::error::Result;
use crate::scene::{LightKeys, LightKind, TextureKind, Units};

/// Places along an edge at which a texture is looked up for its means.
const LOOKS: usize = 240;

/// A light with a surface.
#[derive(Debug, Clone, PartialEq)]
pub struct Area {
    shape: Shape,
    position: DVec3,
    /// Right, up and the way that it faces, unit, as one who looks at its shining side sees them.
    axes: [DVec3; 3],
    /// Half edges, or radii, along the axes.
    half: [f64; 3],
    /// Radius of a ring's hole over its radius.
    inner: f64,
    two_sided: bool,
    visible: bool,
    /// Radiance, times the texture's.
    radiance: [f64; 3],
    texture: Option<Texture>,
}

/// Factors on radiance, row by row from the top.
#[derive(Debug, Clone, PartialEq)]
struct Texture {
    size: [usize; 2],
    pixels: Vec<[f32; 3]>,
}

impl Area {
    /// The area light that valid keys describe.
    ///
    /// # Errors
    /// Those of [`Panorama::read`](super::Panorama::read) for its image.
    pub fn new(keys: &LightKeys) -> Result<Self> {
        let facing = DVec3::from(keys.direction).normalize();
        let up = DVec3::from(keys.up).normalize();
        let r = keys.radius;
        let size = |i: usize| 0.5 * keys.size.get(i).copied().unwrap_or(0.0);
        let (shape, half) = match keys.kind {
            LightKind::Rectangle => (Shape::Rectangle, [size(0), size(1), 0.0]),
            LightKind::Disk => (Shape::Disk, [r, r, 0.0]),
            LightKind::Ring => (Shape::Ring, [r, r, 0.0]),
            LightKind::Box => (Shape::Box, [size(0), size(1), size(2)]),
            LightKind::Sphere => (Shape::Sphere, [r; 3]),
            _ => unreachable!("a light without a surface"),
        };
        let axes = match shape {
            Shape::Box => {
                let x = across(DVec3::X, up, DVec3::Y);
                [x, up.cross(x), up]
            }
            Shape::Sphere => DVec3::AXES,
            _ => {
                let v = across(up, facing, DVec3::Y);
                [v.cross(facing), v, facing]
            }
        };
        let mut area = Area {
            shape,
            position: keys.position.into(),
            axes,
            half,
            inner: if shape == Shape::Ring { keys.inner_radius / r } else { 0.0 },
            two_sided: keys.two_sided,
            visible: keys.visible,
            radiance: [f64::from(keys.intensity); 3],
            texture: Texture::new(keys)?,
        };
        // Textures of two colours hold them.
        let color = keys.color.map(f64::from);
        if matches!(keys.texture, TextureKind::Uniform | TextureKind::Bitmap) {
            area.radiance = std::array::from_fn(|c| area.radiance[c] * color[c]);
        }
        let surface = area.surface();
        let factor = match keys.units {
            Units::Radiance => 1.0,
            Units::Power => 1.0 / (PI * surface),
            Units::Exitance => 1.0 / PI,
            Units::Intensity if matches!(shape, Shape::Box | Shape::Sphere) => 4.0 / surface,
            Units::Intensity => 1.0 / (surface / area.sides()),
        };
        // As a whole a textured light is as strong as an even one.
        let even = color.iter().sum::<f64>() / 3.0 * f64::from(keys.intensity);
        let found = area.mean(|_| true).map_or(even, |mean| mean.iter().sum::<f64>() / 3.0);
        let whole = if keys.units != Units::Radiance && found > 0.0 { even / found } else { 1.0 };
        area.radiance = area.radiance.map(|l| l * factor * whole);
        Ok(area)
    }

    /// Sides of a flat light that shine.
    fn sides(&self) -> f64 {
        if self.two_sided { 2.0 } else { 1.0 }
    }

    /// Area that shines.
    fn surface(&self) -> f64 {
        let [a, b, c] = self.half;
        match self.shape {
            Shape::Rectangle => self.sides() * 4.0 * a * b,
            Shape::Box => 8.0 * (a * b + b * c + c * a),
            Shape::Sphere => 4.0 * PI * a * a,
            _ => self.sides() * PI * a * a * (1.0 - self.inner * self.inner),
        }
    }

    /// The size and pixels of its texture, factors on radiance, row by row from the top.
    pub fn texture(&self) -> Option<([usize; 2], &[[f32; 3]])> {
        self.texture.as_ref().map(|t| (t.size, t.pixels.as_slice()))
    }

    /// As path tracing has it, without its position and texture.
    pub fn emitter(&self) -> Emitter {
        let [u, v, axis] = self.axes;
        Emitter {
            axis: axis.as_vec3(),
            u: (u * self.half[0]).as_vec3(),
            v: (v * self.half[1]).as_vec3(),
            radius: self.half[2] as f32,
            inner: self.inner as f32,
            two_sided: self.two_sided,
            visible: self.visible,
            ..Emitter::new(self.shape, self.radiance.map(|l| l as f32))
        }
    }

    /// Points that stand for it, about `samples` for each flat side: even parts of the surface, spread so that their mean square distance
    /// from the middle is that of the whole.
    pub fn points(&self, samples: usize) -> Vec<Light> {
        let [u, v, w] = self.axes;
        let [a, b, c] = self.half;
        match self.shape {
            Shape::Sphere => {
                let mean = self.mean(|_| true).unwrap_or(self.radiance);
                let offsets = ball(samples);
                let intensity = mean.map(|l| (l * PI * a * a / offsets.len() as f64) as f32);
                let at = |o: DVec3| Light::Point { position: self.position + a * o, radius: a, intensity };
                offsets.into_iter().map(at).collect()
            }
            Shape::Box => {
                let faces = [([v, w, u], [b, c, a]), ([u, w, v], [a, c, b]), ([u, v, w], [a, b, c])];
                let of_face = |([u, v, n], [x, y, z]): ([DVec3; 3], [f64; 3])| {
                    [1.0, -1.0].into_iter().flat_map(move |side| {
                        self.patches(self.position + side * z * n, [x * u, y * v, side * n], samples.div_ceil(6))
                    })
                };
                faces.into_iter().flat_map(of_face).collect()
            }
            _ => {
                let front = self.patches(self.position, [a * u, b * v, w], samples);
                let back =
                    if self.two_sided { self.patches(self.position, [a * u, b * v, -w], samples) } else { vec![] };
                front.into_iter().chain(back).collect()
            }
        }
    }

    /// Points of a flat side with half edges `u` and `v` and normal `n`.
    fn patches(&self, middle: DVec3, [u, v, n]: [DVec3; 3], samples: usize) -> Vec<Light> {
        let (a, b) = (u.length(), v.length());
        let places = match self.shape {
            Shape::Rectangle | Shape::Box => grid(samples, a / b),
            Shape::Disk => disk(samples),
            _ => ring(samples, self.inner),
        };
        let whole = match self.shape {
            Shape::Rectangle | Shape::Box => 4.0 * a * b,
            _ => PI * a * b * (1.0 - self.inner * self.inner),
        };
        let part = whole / places.len() as f64;
        let nearest = |at: [f64; 2]| {
            let apart = |p: &[f64; 2]| (a * (p[0] - at[0])).powi(2) + (b * (p[1] - at[1])).powi(2);
            (0..places.len()).min_by(|i, j| apart(&places[*i]).total_cmp(&apart(&places[*j])))
        };
        let light = |(i, place): (usize, &[f64; 2])| {
            let mean = self.mean(|at| nearest(at) == Some(i)).unwrap_or(self.radiance);
            Light::Patch {
                position: middle + place[0] * u + place[1] * v,
                direction: n.as_vec3(),
                radius: (part / PI).sqrt(),
                intensity: mean.map(|l| (l * part) as f32),
            }
        };
        places.iter().enumerate().map(light).collect()
    }

    /// Mean radiance over the places of the surface, each −1 to 1 along both axes, that `part` picks. `None` without a texture, or
    /// where no place is in the part.
    fn mean(&self, part: impl Fn([f64; 2]) -> bool) -> Option<[f64; 3]> {
        let texture = self.texture.as_ref()?;
        let (mut sum, mut total) = ([0.0; 3], 0.0);
        for (i, j) in (0..LOOKS).flat_map(|j| (0..LOOKS).map(move |i| (i, j))) {
            let at = [i, j].map(|n| (2 * n + 1) as f64 / LOOKS as f64 - 1.0);
            let r = at[0] * at[0] + at[1] * at[1];
            let weight = match self.shape {
                Shape::Disk | Shape::Ring if r > 1.0 || r < self.inner * self.inner => 0.0,
                // Rows of a ball's image by the solid angle that they stand for.
                Shape::Sphere => (0.5 * PI * at[1]).cos(),
                _ => 1.0,
            };
            if weight > 0.0 && part(at) {
                let texel = texture.at(at);
                (0..3).for_each(|c| sum[c] += weight * f64::from(texel[c]));
                total += weight;
            }
        }
        (total > 0.0).then(|| std::array::from_fn(|c| self.radiance[c] * sum[c] / total))
    }
}

impl Texture {
    fn new(keys: &LightKeys) -> Result<Option<Self>> {
        let (first, second) = (keys.color, keys.second_color);
        Ok(match keys.texture {
            TextureKind::Uniform => None,
            TextureKind::Checker => {
                let [width, height] = keys.tiles;
                // The lower left field has the first colour.
                let field =
                    |i: usize| if (i % width + height - 1 - i / width).is_multiple_of(2) { first } else { second };
                Some(Texture { size: keys.tiles, pixels: (0..width * height).map(field).collect() })
            }
            TextureKind::Gradient => {
                const ROWS: usize = 256;
                let row = |y: usize| {
                    let t = (y as f32 + 0.5) / ROWS as f32;
                    std::array::from_fn(|c| second[c] + t * (first[c] - second[c]))
                };
                Some(Texture { size: [1, ROWS], pixels: (0..ROWS).map(row).collect() })
            }
            TextureKind::Bitmap => {
                let path = keys.image.as_ref().expect("a valid scene has an image for a bitmap");
                let (size, pixels) = read(path, "an OpenEXR, Radiance HDR or PNG image")?;
                Some(Texture { size, pixels })
            }
        })
    }

    /// The texel at a place, −1 to 1 to the right and upwards.
    fn at(&self, [s, t]: [f64; 2]) -> [f32; 3] {
        let index = |t: f64, n: usize| ((t * n as f64) as usize).min(n - 1);
        let [width, height] = self.size;
        self.pixels[index(0.5 - 0.5 * t, height) * width + index(0.5 + 0.5 * s, width)]
    }
}

/// `wanted`, made perpendicular to unit vector `to`; `instead`, or what is left, where the two are parallel.
fn across(wanted: DVec3, to: DVec3, instead: DVec3) -> DVec3 {
    let aside = |v: DVec3| (v - v.dot(to) * to).try_normalize().filter(|_| v.cross(to).length() > 1e-6);
    aside(wanted).or_else(|| aside(instead)).unwrap_or_else(|| to.any_orthonormal_vector())
}

/// About `samples` places of a rectangle that is `aspect` times as wide as high, −1 to 1: middles of even fields, drawn apart so that
/// their mean square is ⅓.
fn grid(samples: usize, aspect: f64) -> Vec<[f64; 2]> {
    let columns = ((samples as f64 * aspect).sqrt().round() as usize).clamp(1, samples);
    let rows = ((samples as f64 / columns as f64).round() as usize).max(1);
    let place = |i: usize, n: usize| {
        let apart = if n > 1 { n as f64 / ((n * n - 1) as f64).sqrt() } else { 0.0 };
        apart * ((2 * i + 1) as f64 / n as f64 - 1.0)
    };
    (0..rows).flat_map(|j| (0..columns).map(move |i| [place(i, columns), place(j, rows)])).collect()
}

/// `count` places on a circle.
fn circle(count: usize, radius: f64, turn: f64) -> impl Iterator<Item = [f64; 2]> {
    (0..count).map(move |i| {
        let angle = 2.0 * PI * (i as f64 + turn) / count as f64;
        [radius * angle.cos(), radius * angle.sin()]
    })
}

/// Places of a disk: its middle, with it six, with them twelve more; their mean square distance is ½.
fn disk(samples: usize) -> Vec<[f64; 2]> {
    let middle = std::iter::once([0.0; 2]);
    match samples {
        7 => middle.chain(circle(6, (3.5f64 / 6.0).sqrt(), 0.0)).collect(),
        19 => middle.chain(circle(6, 0.5, 0.0)).chain(circle(12, (8.0f64 / 12.0).sqrt(), 0.5)).collect(),
        _ => middle.collect(),
    }
}

/// Places of a ring with a hole of radius `inner`, all as far from its middle as the root mean square.
fn ring(samples: usize, inner: f64) -> Vec<[f64; 2]> {
    let radius = (0.5 * (1.0 + inner * inner)).sqrt();
    if samples > 1 { circle(samples, radius, 0.0).collect() } else { vec![[0.0; 2]] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;

    fn area(text: &str) -> Area {
        Area::new(&toml::from_str(text).unwrap()).unwrap()
    }

    /// Every shape, with the area that shines.
    fn shapes() -> Vec<(&'static str, f64, f64)> {
        vec![
            ("kind = \"rectangle\"\nsize = [2, 0.5]", 1.0, 1.0),
            ("kind = \"rectangle\"\nsize = [2, 0.5]\ntwo_sided = true", 2.0, 1.0),
            ("kind = \"disk\"\nradius = 1.5", PI * 2.25, PI * 2.25),
            ("kind = \"ring\"\nradius = 1.5\ninner_radius = 0.5", PI * 2.0, PI * 2.0),
            // Of boxes and balls what is seen from one side in the mean: a quarter.
            ("kind = \"box\"\nsize = [1, 2, 3]", 22.0, 5.5),
            ("kind = \"sphere\"\nradius = 0.5", PI, 0.25 * PI),
        ]
    }

    #[test]
    fn units_say_what_color_times_intensity_is() {
        for (text, surface, seen) in shapes() {
            let radiance = |units: &str| {
                let light = area(&format!("{text}\nunits = \"{units}\"\ncolor = [1, 0.5, 0]\nintensity = 4"));
                assert!((light.surface() / surface - 1.0).abs() < 1e-9, "{text}");
                assert!((light.radiance[1] / light.radiance[0] - 0.5).abs() < 1e-6 && light.radiance[2] == 0.0);
                light.radiance[0]
            };
            for (units, exact) in [
                ("radiance", 4.0),
                ("power", 4.0 / (PI * surface)),
                ("exitance", 4.0 / PI),
                ("flux", 4.0 / PI),
                ("intensity", 4.0 / seen),
            ] {
                assert!((radiance(units) / exact - 1.0).abs() < 1e-6, "{text} {units}: {} {exact}", radiance(units));
            }
        }
    }

    #[test]
    fn a_textured_light_is_as_strong_as_an_even_one() {
        let textures = [
            "texture = \"checker\"\ntiles = [3, 5]\nsecond_color = [0.2, 0, 4]",
            "texture = \"gradient\"\nsecond_color = [0.1, 0.6, 0]",
        ];
        for ((text, surface, _), texture) in shapes().into_iter().flat_map(|s| textures.map(|t| (s, t))) {
            let light = area(&format!("{text}\n{texture}\nunits = \"power\"\ncolor = [1, 0.5, 0.3]\nintensity = 7"));
            let mean = light.mean(|_| true).unwrap().iter().sum::<f64>() / 3.0;
            // Power over the channels' mean: 7 · 1.8/3.
            assert!((PI * surface * mean / (7.0 * 0.6) - 1.0).abs() < 1e-3, "{text} {texture}");
        }
        // In radiance colours are what they are.
        let light = area(
            "kind = \"disk\"\nradius = 1\ntexture = \"checker\"\nsecond_color = [3, 0, 0]\nintensity = 2\ntiles = [2, 2]",
        );
        let pixels = &light.texture.as_ref().unwrap().pixels;
        assert_eq!(light.radiance, [2.0; 3]);
        // The lower left field has the first colour.
        assert_eq!(
            [pixels[2], pixels[3], pixels[0], pixels[1]],
            [[1.0; 3], [3.0, 0.0, 0.0], [3.0, 0.0, 0.0], [1.0; 3]]
        );
        let half = |sign: f64| light.mean(|at| sign * at[0] > 0.0 && sign * at[1] > 0.0).unwrap();
        assert_eq!((half(-1.0), half(1.0)), ([2.0; 3], [2.0; 3]));
    }

    #[test]
    fn points_have_the_whole_intensity_and_the_spread_of_the_surface() {
        for (text, _, seen) in shapes() {
            for samples in [1, 7, 19] {
                let light = area(&format!(
                    "{text}\nposition = [1, 2, 3]\ndirection = [2, 1, -2]\nintensity = 4\nsamples = {samples}"
                ));
                let points = light.points(samples);
                let facing = DVec3::new(2.0, 1.0, -2.0) / 3.0;
                let (mut total, mut front) = (0.0, 0.0);
                let (mut middle, mut square) = (DVec3::ZERO, 0.0);
                for p in &points {
                    let (position, along, cosine) = match p {
                        Light::Point { position, intensity, .. } => (*position, f64::from(intensity[0]), 1.0),
                        Light::Patch { position, direction, intensity, .. } => {
                            // In the mean over all directions cos θ is a quarter.
                            (*position, f64::from(intensity[0]), direction.as_dvec3().dot(facing))
                        }
                        other => panic!("{other:?}"),
                    };
                    total += along * if matches!(p, Light::Point { .. }) { 1.0 } else { 0.25 };
                    front += along * cosine.max(0.0);
                    let offset = position - DVec3::new(1.0, 2.0, 3.0);
                    middle += offset / points.len() as f64;
                    square += offset.length_squared() / points.len() as f64;
                }
                assert!(middle.length() < 1e-9, "{text}");
                let flat = !(text.contains("box") || text.contains("sphere"));
                let sides = if text.contains("two_sided") { 2.0 } else { 1.0 };
                // A quarter of the surface's area is seen in the mean, of a flat light one side along its direction.
                assert!(
                    (total / (4.0 * if flat { 0.25 * sides * seen } else { seen }) - 1.0).abs() < 1e-5,
                    "{text} {total}"
                );
                if flat {
                    assert!((front / (4.0 * seen) - 1.0).abs() < 1e-5, "{text} {front}");
                }
                if samples == 1 {
                    continue;
                }
                let exact = match () {
                    () if text.contains("rectangle") => (1.0 + 0.0625) / 3.0,
                    () if text.contains("disk") => 0.5 * 2.25,
                    () if text.contains("ring") => 0.5 * (2.25 + 0.25),
                    () => continue,
                };
                // A row of few points has no spread across.
                assert!((square / exact - 1.0).abs() < 0.07, "{text} {samples}: {square} {exact}");
            }
        }
    }

    #[test]
    fn images_stand_upright_and_boxes_keep_to_the_axes() {
        // On a wall that looks along −y, one who looks along +y sees x to the right and z upwards.
        let wall = area("kind = \"rectangle\"\nsize = [2, 4]\ndirection = [0, -3, 0]");
        assert_eq!(wall.axes, [DVec3::X, DVec3::Z, DVec3::NEG_Y]);
        // A ceiling: +z is no upwards; +y is.
        let ceiling = area("kind = \"rectangle\"\nsize = [2, 4]\ndirection = [0, 0, -1]");
        assert_eq!(ceiling.axes[1..], [DVec3::Y, DVec3::NEG_Z]);
        assert_eq!(area("kind = \"box\"\nsize = [1, 2, 3]").axes, DVec3::AXES);
    }

    #[test]
    fn what_area_lights_are_not_is_refused_by_key() {
        let refused = |text: &str| match Scene::parse(&format!("[[lights]]\n{text}"), "test", &[]) {
            Err(e) => e.to_string(),
            Ok(_) => panic!("{text} was taken"),
        };
        for (text, says) in [
            ("kind = \"disk\"", "lights.0.radius"),
            ("kind = \"rectangle\"\nsize = [1]", "[width, height]"),
            ("kind = \"box\"\nsize = [1, 1]", "[x, y, z]"),
            ("kind = \"ring\"\nradius = 1\ninner_radius = 1", "below the radius"),
            ("kind = \"disk\"\nradius = 1\ninner_radius = 0.5", "rings do"),
            ("kind = \"point\"\nunits = \"power\"", "area lights do"),
            ("kind = \"sphere\"\nradius = 1\ntwo_sided = true", "rectangles, disks and rings do"),
            ("kind = \"disk\"\nradius = 1\ntexture = \"bitmap\"", "needs the path"),
            ("kind = \"disk\"\nradius = 1\ntiles = [2, 2]", "checker"),
            ("kind = \"disk\"\nradius = 1\nimage = \"a.png\"", "bitmap"),
            ("gradient = [[0, 0, 0], [1, 1, 1], [2, 2, 2]]", "environments do"),
            ("kind = \"sphere\"\nradius = 1\ntexture = \"checker\"", "pathtrace"),
            ("kind = \"disk\"\nradius = 1\n[light]\nmodel = \"paper\"", "falloff"),
        ] {
            assert!(refused(text).contains(says), "{}", refused(text));
        }
    }
}
