//! Sampling light sources, and meeting them: see [`Emitter`].
//!
//! Images are held one after another: red, green and blue of each pixel, row by row from the top; of an environment also, for each row,
//! the share of its power in that row and all above, and for each pixel the share of the row's power in it and all left of it.

use std::f32::consts::{PI, TAU};

use glam::Vec3;

use super::shapes;
use crate::device::emitter::{Emitter, Hit, Sample, Shape};

/// A way from `point` to `emitter`, drawn by three numbers in 0..1; `None` where none of its light gets there.
#[inline]
pub fn sample(emitter: &Emitter, images: &[f32], point: Vec3, xi: [f32; 3]) -> Option<Sample> {
    match emitter.shape {
        Shape::Distant if emitter.edge >= 1.0 => {
            Some(Sample { direction: -emitter.axis, distance: f32::INFINITY, radiance: emitter.radiance, pdf: 0.0 })
        }
        Shape::Distant => {
            let cap = 1.0 - emitter.edge;
            let direction = about(-emitter.axis, 1.0 - xi[0] * cap, TAU * xi[1]);
            Some(Sample {
                direction,
                distance: f32::INFINITY,
                radiance: emitter.radiance,
                pdf: 1.0 / (TAU * cap).max(1e-12),
            })
        }
        Shape::Point => lamp(emitter, point, xi),
        Shape::Environment => {
            let (direction, pdf) = match emitter.image {
                [_, 0, _] => (about(Vec3::Z, 1.0 - 2.0 * xi[0], TAU * xi[1]), 0.25 / PI),
                image => panorama(image, images, xi),
            };
            let radiance = emitter.radiance * background(emitter, images, direction);
            Some(Sample { direction, distance: f32::INFINITY, radiance, pdf })
        }
        _ => shapes::sample(emitter, images, point, xi),
    }
}

/// Where a ray meets `emitter`; `None` where it does not.
#[inline]
pub fn hit(emitter: &Emitter, images: &[f32], origin: Vec3, direction: Vec3) -> Option<Hit> {
    match emitter.shape {
        Shape::Distant if emitter.edge < 1.0 && -direction.dot(emitter.axis) >= emitter.edge => {
            let pdf = 1.0 / (TAU * (1.0 - emitter.edge)).max(1e-12);
            Some(Hit { distance: f32::INFINITY, radiance: emitter.radiance, pdf })
        }
        Shape::Environment => {
            let radiance = emitter.radiance * background(emitter, images, direction);
            let pdf = match emitter.image {
                [_, 0, _] => 0.25 / PI,
                image => density(image, images, pixel(image, direction)),
            };
            Some(Hit { distance: f32::INFINITY, radiance, pdf })
        }
        Shape::Distant | Shape::Point => None,
        _ => shapes::hit(emitter, images, origin, direction),
    }
}

/// The unit direction at an angle from `axis`, given by its cosine and the azimuth about it.
#[inline]
pub fn about(axis: Vec3, cosine: f32, azimuth: f32) -> Vec3 {
    let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
    let (a, b) = basis(axis);
    (sine * azimuth.cos()) * a + (sine * azimuth.sin()) * b + cosine * axis
}

/// Two unit vectors that make a right-handed system with a unit vector (Duff et al. 2017).
#[inline]
pub fn basis(n: Vec3) -> (Vec3, Vec3) {
    let sign = if n.z < 0.0 { -1.0 } else { 1.0 };
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    (Vec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x), Vec3::new(b, sign + n.y * n.y * a, -n.y))
}

/// Light from a place: see [`Shape::Point`].
#[inline]
fn lamp(emitter: &Emitter, point: Vec3, xi: [f32; 3]) -> Option<Sample> {
    // An even point of the unit sphere of four dimensions, without its last coordinate: first an even point of the disk.
    let (r, angle) = (xi[0].sqrt(), TAU * xi[1]);
    let ball = Vec3::new(r * angle.cos(), r * angle.sin(), (1.0 - xi[0]).max(0.0).sqrt() * (TAU * xi[2]).cos());
    let way = emitter.position + emitter.radius * ball - point;
    let square = way.length_squared();
    let distance = square.sqrt();
    // No way leads from a point to itself.
    let direction = if distance > 0.0 { way / distance } else { Vec3::Z };
    let t = ((-direction.dot(emitter.axis) - emitter.edge) * emitter.slope).clamp(0.0, 1.0);
    let falloff = t * t * (3.0 - 2.0 * t) / square.max(emitter.radius * emitter.radius).max(f32::MIN_POSITIVE);
    (falloff > 0.0).then_some(Sample { direction, distance, radiance: falloff * emitter.radiance, pdf: 0.0 })
}

/// Factor on an environment's radiance towards a direction.
#[inline]
fn background(emitter: &Emitter, images: &[f32], direction: Vec3) -> Vec3 {
    match emitter.image {
        [_, 0, _] => Vec3::ONE,
        image => {
            let [x, y] = pixel(image, direction);
            let at = image[0] as usize + 3 * (y * image[1] as usize + x);
            Vec3::from_slice(&images[at..at + 3])
        }
    }
}

/// The pixel of an equirectangular image towards a unit direction: see [`Panorama`](crate::lights::Panorama).
#[inline]
pub(super) fn pixel([_, width, height]: [u32; 3], direction: Vec3) -> [usize; 2] {
    let u = 0.5 + direction.x.atan2(direction.y) / TAU;
    let v = direction.z.clamp(-1.0, 1.0).acos() / PI;
    let at = |t: f32, n: u32| ((t * n as f32) as u32).min(n - 1) as usize;
    [at(u, width), at(v, height)]
}

/// The shares of an image's rows, and of the pixels of a row.
#[inline]
fn shares([first, width, height]: [u32; 3], images: &[f32]) -> (&[f32], &[f32]) {
    let (width, height) = (width as usize, height as usize);
    let rows = first as usize + 3 * width * height;
    (&images[rows..rows + height], &images[rows + height..rows + height + width * height])
}

/// Density with which [`panorama`] goes towards a pixel.
#[inline]
fn density(image: [u32; 3], images: &[f32], [x, y]: [usize; 2]) -> f32 {
    let (width, height) = (image[1] as usize, image[2] as usize);
    let (rows, pixels) = shares(image, images);
    let share = |cumulative: &[f32], i: usize| cumulative[i] - if i > 0 { cumulative[i - 1] } else { 0.0 };
    let [above, below] = [y, y + 1].map(|y| (PI * y as f32 / height as f32).cos());
    let solid = TAU / width as f32 * (above - below).max(1e-12);
    share(rows, y) * share(&pixels[y * width..][..width], x) / solid
}

/// A direction by the power of an image's pixels, and its density.
#[inline]
fn panorama(image: [u32; 3], images: &[f32], xi: [f32; 3]) -> (Vec3, f32) {
    let (width, height) = (image[1] as usize, image[2] as usize);
    let (rows, pixels) = shares(image, images);
    // The first whose cumulative share exceeds the number, and how far into it the number is.
    let find = |cumulative: &[f32], xi: f32| {
        let i = cumulative.partition_point(|&c| c <= xi).min(cumulative.len() - 1);
        let before = if i > 0 { cumulative[i - 1] } else { 0.0 };
        (i, ((xi - before) / (cumulative[i] - before).max(1e-12)).clamp(0.0, 1.0))
    };
    let (y, down) = find(rows, xi[0]);
    let (x, across) = find(&pixels[y * width..][..width], xi[1]);
    let [above, below] = [y, y + 1].map(|y| (PI * y as f32 / height as f32).cos());
    let z = above + down * (below - above);
    let azimuth = TAU * ((x as f32 + across) / width as f32 - 0.5);
    let side = (1.0 - z * z).max(0.0).sqrt();
    (Vec3::new(side * azimuth.sin(), side * azimuth.cos(), z), density(image, images, [x, y]))
}
