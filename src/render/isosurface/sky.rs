//! The environment as kernels look it up: an octahedral map of radiance, and maps prefiltered by the lobes of surfaces
//! (Kautz & McCool 2000, as section 6.1 has it).

use std::f32::consts::FRAC_PI_2;
use std::sync::Arc;

use glam::{Vec2, Vec3};

use crate::device::surface::{Environment, Filtered, Map};
use crate::device::{Buffer, Device};
use crate::error::Result;
use crate::lights::{Light, Panorama};

/// What is all around.
pub(super) struct Sky {
    /// RGB of all maps.
    texels: Vec<f32>,
    radiance: Map,
    filtered: Option<Filtered>,
}

/// Where radiance comes from.
enum Source<'a> {
    Even(Vec3),
    Image(&'a Arc<Panorama>, Vec3),
    /// Colours from straight below to straight above.
    Gradient(&'a [[f32; 3]]),
}

impl Source<'_> {
    fn radiance(&self, way: Vec3) -> Vec3 {
        match self {
            Source::Even(radiance) => *radiance,
            Source::Image(image, factor) => Vec3::from(image.radiance(way.as_dvec3())) * *factor,
            Source::Gradient(colors) => {
                let at = (0.5 + 0.5 * way.z.clamp(-1.0, 1.0).asin() / FRAC_PI_2) * (colors.len() - 1) as f32;
                let below = (at as usize).min(colors.len() - 2);
                Vec3::from(colors[below]).lerp(Vec3::from(colors[below + 1]), at - below as f32)
            }
        }
    }

    /// Texels along the edge of a map that holds it.
    fn edge(&self) -> usize {
        match self {
            Source::Even(_) => 2,
            Source::Gradient(_) => 64,
            Source::Image(image, _) => image.size()[1].next_power_of_two().clamp(16, 1024),
        }
    }
}

/// Edge of the map of irradiance, and of the smallest of reflections: Lambert's cosine leaves no detail finer than this.
const SMOOTH: usize = 24;
/// Edge of the map that others are filtered from, and of the largest of reflections.
const DETAILED: usize = 96;

impl Sky {
    /// The environment lights together, or a gradient of colours in their stead; `None` where there is no such light.
    pub(super) fn new(lights: &[Light], gradient: Option<&[[f32; 3]]>) -> Option<Sky> {
        let sources: Vec<Source> = match gradient {
            Some(colors) => vec![Source::Gradient(colors)],
            None => lights
                .iter()
                .filter_map(|light| match light {
                    Light::Environment { radiance } => Some(Source::Even((*radiance).into())),
                    Light::Image { image, factor } => Some(Source::Image(image, (*factor).into())),
                    _ => None,
                })
                .collect(),
        };
        let edge = sources.iter().map(Source::edge).max()?;
        let radiance = |way: Vec3| sources.iter().map(|s| s.radiance(way)).sum::<Vec3>();
        let radiance = |way: Vec3| if way.is_finite() { radiance(way) } else { Vec3::ZERO };
        // The mean of 4² directions, so that no small light of an image falls between texels.
        let parts = if edge > 2 { 4 } else { 1 };
        let texels = Map::tabulate(edge, |at| {
            let mut sum = Vec3::ZERO;
            for part in 0..parts * parts {
                let offset = Vec2::new((part % parts) as f32, (part / parts) as f32);
                let place = (at + (offset + 0.5) / parts as f32) / edge as f32;
                sum += radiance(Map::direction(place).normalize());
            }
            sum / (parts * parts) as f32
        });
        Some(Sky { texels, radiance: Map { first: 0, edge }, filtered: None })
    }

    /// Adds prefiltered maps, one of reflections for each exponent.
    pub(super) fn filter(&mut self, exponents: &[f32]) {
        let edge = self.radiance.edge.min(DETAILED);
        // Directions on the octahedron are spread over the sphere by their length cubed.
        let sources: Vec<(Vec3, f32, Vec3)> = (0..edge * edge)
            .map(|i| {
                let place = (Vec2::new((i % edge) as f32, (i / edge) as f32) + 0.5) / edge as f32;
                let on = Map::direction(place);
                let weight = on.length().powi(-3);
                (on.normalize(), weight, self.mean(place, 1.0 / edge as f32))
            })
            .collect();
        let convolve = |exponent: f32, edge: usize| {
            // Where the lobe has fallen to a hundred-thousandth nothing is left of it.
            let least = 1e-5f32.powf(1.0 / exponent.max(1e-3));
            Map::tabulate(edge, |at| {
                let axis = Map::direction((at + 0.5) / edge as f32).normalize();
                let (mut sum, mut total) = (Vec3::ZERO, 0.0);
                let mut nearest = (-2.0, Vec3::ZERO);
                for (way, weight, radiance) in &sources {
                    let cosine = axis.dot(*way);
                    if cosine > nearest.0 {
                        nearest = (cosine, *radiance);
                    }
                    if cosine > least.max(0.0) {
                        let share = weight * cosine.powf(exponent);
                        sum += share * *radiance;
                        total += share;
                    }
                }
                if total > 0.0 { sum / total } else { nearest.1 }
            })
        };
        let mut add = |texels: Vec<f32>, edge: usize| {
            let first = self.texels.len() / 3;
            self.texels.extend(texels);
            Map { first, edge }
        };
        let smooth = SMOOTH.min(edge.max(2));
        let irradiance = add(convolve(1.0, smooth), smooth);
        let reflections = exponents
            .iter()
            .map(|&exponent| {
                let wanted = (4.0 * exponent.sqrt()) as usize;
                let edge = wanted.clamp(SMOOTH, DETAILED).min(edge.max(2));
                add(convolve(exponent, edge), edge)
            })
            .collect();
        self.filtered = Some(Filtered { irradiance, reflections });
    }

    /// Mean radiance over a square of the map.
    fn mean(&self, middle: Vec2, side: f32) -> Vec3 {
        let edge = self.radiance.edge;
        let span = |c: f32| {
            let ends = [c - 0.5 * side, c + 0.5 * side].map(|p| (p * edge as f32).round().max(0.0) as usize);
            let first = ends[0].min(edge - 1);
            first..ends[1].clamp(first + 1, edge)
        };
        let (columns, rows) = (span(middle.x), span(middle.y));
        let count = columns.len() * rows.len();
        let texel = |x: usize, y: usize| {
            let i = 3 * (self.radiance.first + (y + 1) * (edge + 2) + x + 1);
            Vec3::from_slice(&self.texels[i..i + 3])
        };
        let sum: Vec3 = rows.flat_map(|y| columns.clone().map(move |x| (x, y))).map(|(x, y)| texel(x, y)).sum();
        sum / count as f32
    }

    /// The maps where a device can look them up.
    pub(super) fn upload(&self, device: &dyn Device) -> Result<Buffer> {
        let mut texels = device.alloc(self.texels.len())?;
        device.upload(&self.texels, &mut texels)?;
        Ok(texels)
    }

    /// The environment in what [`Sky::upload`] gave.
    pub(super) fn environment<'a>(&'a self, texels: &'a Buffer) -> Environment<'a> {
        Environment { texels, radiance: self.radiance, filtered: self.filtered.as_ref() }
    }
}
