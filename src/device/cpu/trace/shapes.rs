//! Area lights: where a point is lit from, and where a ray meets them.
//!
//! Flat shapes and boxes are sampled evenly over the area that faces the point, which per solid angle is `p = d²/(A |cos θ|)`, d the
//! distance and θ the angle at the light; balls evenly over the cone that they fill, `p = 1/(2π(1 − cos θ_max))` with
//! `sin θ_max = R/d` (Shirley, Wang & Zimmerman 1996). The WGSL twin is `shaders/shapes.wgsl`.

use std::f32::consts::{PI, TAU};

use glam::Vec3;

use super::emitter::{basis, pixel};
use crate::device::emitter::{Emitter, Hit, Sample, Shape};

/// A way from `point` to an area light, drawn by three numbers in 0..1; `None` where none of its light gets there.
#[inline]
pub fn sample(emitter: &Emitter, images: &[f32], point: Vec3, xi: [f32; 3]) -> Option<Sample> {
    match emitter.shape {
        Shape::Sphere => ball(emitter, images, point, xi),
        Shape::Box => {
            let face = Face::chosen(emitter, point, xi[2])?;
            face.lit(emitter, images, point, [2.0 * xi[0] - 1.0, 2.0 * xi[1] - 1.0])
        }
        _ => {
            let face = Face::flat(emitter);
            let at = match emitter.shape {
                Shape::Rectangle => [2.0 * xi[0] - 1.0, 2.0 * xi[1] - 1.0],
                _ => {
                    let inner = face.hole * face.hole;
                    let (r, angle) = ((inner + xi[0] * (1.0 - inner)).sqrt(), TAU * xi[1]);
                    [r * angle.cos(), r * angle.sin()]
                }
            };
            face.lit(emitter, images, point, at)
        }
    }
}

/// Where a ray meets an area light; `None` where it does not.
#[inline]
pub fn hit(emitter: &Emitter, images: &[f32], origin: Vec3, direction: Vec3) -> Option<Hit> {
    match emitter.shape {
        Shape::Sphere => {
            let way = emitter.position - origin;
            let (square, radius) = (way.length_squared(), emitter.radius * emitter.radius);
            let along = way.dot(direction);
            let aside = (way - along * direction).length_squared();
            if square <= radius || along <= 0.0 || aside > radius {
                return None;
            }
            let distance = along - (radius - aside).sqrt();
            let normal = (distance * direction - way) / emitter.radius;
            Some(Hit { distance, radiance: shown(emitter, images, normal), pdf: 1.0 / (TAU * cap(square, radius)) })
        }
        Shape::Box => {
            let (away, half, axes) = local(emitter, origin);
            let slope = Vec3::from(axes.map(|a| direction.dot(a)));
            let (mut entry, mut exit, mut axis) = (f32::NEG_INFINITY, f32::INFINITY, 0);
            for a in 0..3 {
                let (near, far) = (-half[a] - away[a], half[a] - away[a]);
                if slope[a] == 0.0 {
                    if near > 0.0 || far < 0.0 {
                        return None;
                    }
                    continue;
                }
                let (t0, t1) = (near / slope[a], far / slope[a]);
                if t0.min(t1) > entry {
                    (entry, axis) = (t0.min(t1), a);
                }
                exit = exit.min(t0.max(t1));
            }
            if entry <= 0.0 || entry > exit {
                return None;
            }
            let side = if slope[axis] > 0.0 { -1.0 } else { 1.0 };
            let total = (0..3).filter(|&a| away[a].abs() > half[a]).map(|a| area(half, a)).sum();
            let face = Face { area: total, ..Face::of_box(half, axes, axis, side) };
            let place = (away + entry * slope) / half;
            let [b, c] = ACROSS[axis];
            face.met(emitter, images, entry, [place[b], place[c]], slope[axis].abs())
        }
        _ => {
            let face = Face::flat(emitter);
            let facing = -direction.dot(face.normal);
            if facing == 0.0 || (facing < 0.0 && !emitter.two_sided) {
                return None;
            }
            let distance = (origin - emitter.position).dot(face.normal) / facing;
            if distance <= 0.0 {
                return None;
            }
            let place = origin + distance * direction - emitter.position;
            let at = [place.dot(face.u) / face.u.length_squared(), place.dot(face.v) / face.v.length_squared()];
            let r = at[0] * at[0] + at[1] * at[1];
            let inside = match emitter.shape {
                Shape::Rectangle => at[0].abs() <= 1.0 && at[1].abs() <= 1.0,
                _ => r <= 1.0 && r >= face.hole * face.hole,
            };
            if !inside {
                return None;
            }
            face.met(emitter, images, distance, at, facing.abs())
        }
    }
}

/// The axes along a face of a box across an axis: images stand upright on its sides, where v lies along w.
const ACROSS: [[usize; 2]; 3] = [[1, 2], [0, 2], [0, 1]];

/// A flat piece of a light, about its middle.
struct Face {
    /// Middle, relative to the light's position.
    middle: Vec3,
    u: Vec3,
    v: Vec3,
    normal: Vec3,
    /// Radius of the hole over that of the disk.
    hole: f32,
    /// Area that is sampled: of a box, of all faces that face the point.
    area: f32,
}

impl Face {
    #[inline]
    fn flat(emitter: &Emitter) -> Self {
        let hole = if emitter.shape == Shape::Ring { emitter.inner } else { 0.0 };
        let edges = emitter.u.length() * emitter.v.length();
        let area = if emitter.shape == Shape::Rectangle { 4.0 * edges } else { PI * edges * (1.0 - hole * hole) };
        Face { middle: Vec3::ZERO, u: emitter.u, v: emitter.v, normal: emitter.axis, hole, area }
    }

    #[inline]
    fn of_box(half: Vec3, axes: [Vec3; 3], axis: usize, side: f32) -> Self {
        let [b, c] = ACROSS[axis];
        Face {
            middle: side * half[axis] * axes[axis],
            u: half[b] * axes[b],
            v: half[c] * axes[c],
            normal: side * axes[axis],
            hole: 0.0,
            area: area(half, axis),
        }
    }

    /// A face of a box that faces `point`, by its area; `None` from within.
    #[inline]
    fn chosen(emitter: &Emitter, point: Vec3, xi: f32) -> Option<Self> {
        let (away, half, axes) = local(emitter, point);
        let areas: [f32; 3] = std::array::from_fn(|a| if away[a].abs() > half[a] { area(half, a) } else { 0.0 });
        let total = areas[0] + areas[1] + areas[2];
        if total == 0.0 {
            return None;
        }
        // The last face at which something of the number is left.
        let (mut pick, mut axis) = (xi * total, 0);
        for (a, area) in areas.into_iter().enumerate().filter(|(_, area)| *area > 0.0) {
            if pick >= 0.0 {
                axis = a;
            }
            pick -= area;
        }
        let side = if away[axis] > 0.0 { 1.0 } else { -1.0 };
        Some(Face { area: total, ..Face::of_box(half, axes, axis, side) })
    }

    /// The way from `point` to place `at` of the face.
    #[inline]
    fn lit(&self, emitter: &Emitter, images: &[f32], point: Vec3, at: [f32; 2]) -> Option<Sample> {
        let way = emitter.position + self.middle + at[0] * self.u + at[1] * self.v - point;
        let square = way.length_squared();
        let distance = square.sqrt();
        let direction = way / distance;
        let facing = -direction.dot(self.normal);
        // From the edge of the face there is nothing to see; nor is there a way to a place from itself.
        if square == 0.0 || facing.abs() <= 1e-6 || (facing < 0.0 && !emitter.two_sided) {
            return None;
        }
        let radiance = emitter.radiance * texel(emitter, images, at);
        Some(Sample { direction, distance, radiance, pdf: square / (self.area * facing.abs()) })
    }

    /// What a ray meets at place `at` of the face.
    #[inline]
    fn met(&self, emitter: &Emitter, images: &[f32], distance: f32, at: [f32; 2], facing: f32) -> Option<Hit> {
        let radiance = emitter.radiance * texel(emitter, images, at);
        Some(Hit { distance, radiance, pdf: distance * distance / (self.area * facing.max(1e-6)) })
    }
}

/// Of a box: where a point is along its axes, half its edges, and the axes.
#[inline]
fn local(emitter: &Emitter, point: Vec3) -> (Vec3, Vec3, [Vec3; 3]) {
    let (u, v) = (emitter.u.length(), emitter.v.length());
    let axes = [emitter.u / u, emitter.v / v, emitter.axis];
    let away = point - emitter.position;
    (Vec3::from(axes.map(|a| away.dot(a))), Vec3::new(u, v, emitter.radius), axes)
}

/// Area of the faces of a box across an axis.
#[inline]
fn area(half: Vec3, axis: usize) -> f32 {
    4.0 * half[(axis + 1) % 3] * half[(axis + 2) % 3]
}

/// `1 − cos θ_max` of a ball, by the squares of its distance and radius; without the difference, which would cancel.
#[inline]
fn cap(square: f32, radius: f32) -> f32 {
    let sine = radius / square;
    sine / (1.0 + (1.0 - sine).max(0.0).sqrt())
}

#[inline]
fn ball(emitter: &Emitter, images: &[f32], point: Vec3, xi: [f32; 3]) -> Option<Sample> {
    let way = emitter.position - point;
    let (square, radius) = (way.length_squared(), emitter.radius * emitter.radius);
    if square <= radius {
        return None;
    }
    let cap = cap(square, radius);
    let less = xi[0] * cap;
    let (cosine, sine) = (1.0 - less, (less * (2.0 - less)).sqrt());
    let axis = way / square.sqrt();
    let (a, b) = basis(axis);
    let direction = (sine * (TAU * xi[1]).cos()) * a + (sine * (TAU * xi[1]).sin()) * b + cosine * axis;
    let distance = square.sqrt() * cosine - (radius - square * sine * sine).max(0.0).sqrt();
    let normal = (distance * direction - way) / emitter.radius;
    Some(Sample { direction, distance, radiance: shown(emitter, images, normal), pdf: 1.0 / (TAU * cap) })
}

/// Radiance of a ball where its normal is `normal`: its image surrounds it as an environment's does.
#[inline]
fn shown(emitter: &Emitter, images: &[f32], normal: Vec3) -> Vec3 {
    match emitter.image {
        [_, 0, _] => emitter.radiance,
        image => {
            let [x, y] = pixel(image, normal);
            let at = image[0] as usize + 3 * (y * image[1] as usize + x);
            emitter.radiance * Vec3::from_slice(&images[at..at + 3])
        }
    }
}

/// Factor on a flat light's radiance at place `at` along u and v, −1 to 1; the image's top row lies where v ends.
#[inline]
fn texel(emitter: &Emitter, images: &[f32], at: [f32; 2]) -> Vec3 {
    let [first, width, height] = emitter.image;
    if width == 0 {
        return Vec3::ONE;
    }
    let index = |t: f32, n: u32| ((t.max(0.0) * n as f32) as u32).min(n - 1);
    let (x, y) = (index(0.5 + 0.5 * at[0], width), index(0.5 - 0.5 * at[1], height));
    let at = (first + 3 * (y * width + x)) as usize;
    Vec3::from_slice(&images[at..at + 3])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::cpu::trace::emitter::{hit as meet, sample as draw};

    /// Evenly spread numbers.
    fn numbers(n: usize) -> impl Iterator<Item = [f32; 3]> {
        let r = [0.819_172_5, 0.671_043_6, 0.549_700_5];
        (0..n).map(move |i| r.map(|r: f64| (0.5 + r * i as f64).fract() as f32))
    }

    /// Directions all around, evenly spread: the plane's own pair of numbers leaves smaller gaps than two of three.
    fn directions(n: usize) -> impl Iterator<Item = Vec3> {
        let r = [0.754_877_666_2, 0.569_840_291_0];
        (0..n).map(move |i| {
            let [z, turn] = r.map(|r: f64| (0.5 + r * i as f64).fract());
            let (z, angle) = (1.0 - 2.0 * z, 2.0 * std::f64::consts::PI * turn);
            let side = (1.0 - z * z).max(0.0).sqrt();
            glam::DVec3::new(side * angle.cos(), side * angle.sin(), z).as_vec3()
        })
    }

    /// Turned, so that no axis is special.
    fn turned(shape: Shape) -> Emitter {
        let turn = glam::Quat::from_euler(glam::EulerRot::XYZ, 0.4, -0.7, 1.1);
        Emitter {
            position: Vec3::new(0.3, -0.2, 0.5),
            axis: turn * Vec3::Z,
            u: turn * Vec3::X * if shape == Shape::Disk || shape == Shape::Ring { 0.6 } else { 0.9 },
            v: turn * Vec3::Y * 0.6,
            radius: 0.7,
            inner: 0.4,
            ..Emitter::new(shape, [1.0, 2.0, 3.0])
        }
    }

    const SHAPES: [Shape; 5] = [Shape::Rectangle, Shape::Disk, Shape::Ring, Shape::Box, Shape::Sphere];

    /// Points around, near and far.
    fn points() -> impl Iterator<Item = Vec3> {
        directions(24).enumerate().map(|(i, way)| Vec3::new(0.3, -0.2, 0.5) + [1.3, 2.5, 12.0][i % 3] * way)
    }

    /// What a sample finds, a ray that goes there meets: at the same distance, as bright, with the same density.
    #[test]
    fn samples_and_hits_agree() {
        let image: Vec<f32> = (0..3 * 35).map(|i| (i % 11) as f32).collect();
        for (shape, two_sided) in SHAPES.into_iter().map(|s| (s, false)).chain([(Shape::Ring, true)]) {
            let light = Emitter { two_sided, image: [0, 7, 5], ..turned(shape) };
            let (mut seen, mut differ, mut all) = (0, 0, 0);
            for point in points() {
                for xi in numbers(200) {
                    let Some(s) = draw(&light, &image, point, xi) else { continue };
                    assert!((s.direction.length() - 1.0).abs() < 1e-5 && s.pdf > 0.0);
                    all += 1;
                    let Some(h) = meet(&light, &image, point, s.direction) else { continue };
                    seen += 1;
                    let close = |a: f32, b: f32, by: f32| (a - b).abs() <= by * b.abs();
                    assert!(close(h.distance, s.distance, 1e-3), "{shape:?} {} {}", h.distance, s.distance);
                    assert!(close(h.pdf, s.pdf, 2e-3) || s.pdf > 1e3, "{shape:?} {} {}", h.pdf, s.pdf);
                    // At the edge of a texel.
                    differ += usize::from(h.radiance != s.radiance);
                }
            }
            assert!(all > 1000, "{shape:?}: {all}");
            assert!(
                seen as f32 > 0.99 * all as f32 && (differ as f32) < 0.01 * all as f32,
                "{shape:?} {all} {seen} {differ}"
            );
        }
    }

    /// The density of rays that meet the light integrates to 1, and that of samples tells the solid angle that is met.
    #[test]
    fn densities_are_those_of_the_solid_angle() {
        for shape in SHAPES {
            let light = turned(shape);
            let mut tried = 0;
            for point in points().filter(|p| p.distance(light.position) < 3.0) {
                let n = 40_000;
                let (mut total, mut solid) = (0.0f64, 0.0f64);
                for way in directions(n) {
                    if let Some(h) = meet(&light, &[], point, way) {
                        total += f64::from(h.pdf * 2.0 * TAU) / n as f64;
                        solid += f64::from(2.0 * TAU) / n as f64;
                    }
                }
                let inverse = |xi| draw(&light, &[], point, xi).map_or(0.0, |s| f64::from(1.0 / s.pdf));
                let sampled: f64 = numbers(n).map(inverse).sum::<f64>() / n as f64;
                if solid < 0.05 {
                    // Seen from the edge or from behind.
                    assert!(sampled < 0.06, "{shape:?} {solid} {sampled}");
                    continue;
                }
                tried += 1;
                // Spread evenly, n numbers find an area to about n^−⅔ of its outline.
                assert!((sampled / solid - 1.0).abs() < 0.03, "{shape:?}: {sampled} for {solid}");
                assert!((total - 1.0).abs() < 0.04, "{shape:?}: {total} over {solid}");
            }
            assert!(tried >= 4, "{shape:?}: {tried}");
        }
    }

    /// Irradiance of a surface at `point` with a normal.
    fn irradiance(light: &Emitter, point: Vec3, normal: Vec3) -> f64 {
        let n = 1 << 14;
        let one = |xi| {
            let s = draw(light, &[], point, xi)?;
            Some(f64::from(s.radiance.x * s.direction.dot(normal).max(0.0) / s.pdf))
        };
        numbers(n).filter_map(one).sum::<f64>() / n as f64
    }

    /// Form factor of a rectangle seen face on, its corner straight above (Siegel & Howell).
    fn corner(a: f64, b: f64, h: f64) -> f64 {
        let (x, y) = (a / h, b / h);
        let part = |x: f64, y: f64| x / (1.0 + x * x).sqrt() * (y / (1.0 + x * x).sqrt()).atan();
        (part(x, y) + part(y, x)) / (2.0 * std::f64::consts::PI)
    }

    #[test]
    fn irradiance_has_its_closed_forms() {
        let pi = std::f64::consts::PI;
        // All face down; the point looks up.
        let down =
            Emitter { axis: -Vec3::Z, position: Vec3::new(1.0, 2.0, 5.0), ..Emitter::new(Shape::Disk, [2.0; 3]) };
        for h in [0.3f32, 1.0, 4.0, 50.0] {
            let below = down.position - h * Vec3::Z;
            let close = |light: Emitter, exact: f64| {
                let found = irradiance(&light, below, Vec3::Z);
                assert!((found / exact - 1.0).abs() < 4e-3, "{:?} at {h}: {found} for {exact}", light.shape);
            };
            let hh = f64::from(h);
            let disk = |r: f64| 2.0 * pi * r * r / (r * r + hh * hh);
            close(Emitter { u: 1.5 * Vec3::X, v: 1.5 * Vec3::Y, ..down }, disk(1.5));
            close(
                Emitter { shape: Shape::Ring, inner: 0.5, u: 1.5 * Vec3::X, v: 1.5 * Vec3::Y, ..down },
                disk(1.5) - disk(0.75),
            );
            let rectangle = |h| 4.0 * 2.0 * pi * corner(1.2, 0.4, h);
            close(Emitter { shape: Shape::Rectangle, u: 1.2 * Vec3::X, v: 0.4 * Vec3::Y, ..down }, rectangle(hh));
            if h > 0.6 {
                // Below the middle of a box only its lower face is seen.
                let cuboid = Emitter {
                    shape: Shape::Box,
                    u: 1.2 * Vec3::X,
                    v: 0.4 * Vec3::Y,
                    axis: Vec3::Z,
                    radius: 0.5,
                    ..down
                };
                close(cuboid, rectangle(hh - 0.5));
                close(Emitter { shape: Shape::Sphere, radius: 0.5, ..down }, 2.0 * pi * (0.5 / hh).powi(2));
            }
            // What faces up is dark from below, but for one that shines on both sides.
            let up = Emitter { axis: Vec3::Z, u: 1.5 * Vec3::X, v: 1.5 * Vec3::Y, ..down };
            assert_eq!(irradiance(&up, below, Vec3::Z), 0.0);
            assert!(meet(&up, &[], below, Vec3::Z).is_none());
            close(Emitter { two_sided: true, ..up }, disk(1.5));
        }
        // Within a ball or a box its outside is not seen.
        for shape in [Shape::Box, Shape::Sphere] {
            let light = turned(shape);
            assert!(draw(&light, &[], light.position + 0.1, [0.3; 3]).is_none());
            assert!(meet(&light, &[], light.position + 0.1, Vec3::X).is_none());
        }
    }

    /// A picture on a light lies as one sees it who looks at the shining side with `v` upwards.
    #[test]
    fn images_lie_the_right_way() {
        // A row of red, green above one of blue, white.
        let image = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0];
        let light = Emitter { image: [0, 2, 2], ..Emitter::new(Shape::Rectangle, [1.0; 3]) };
        // It faces +z, seen from there: x to the right, y upwards.
        let color = |x: f32, y: f32| meet(&light, &image, Vec3::new(x, y, 2.0), -Vec3::Z).unwrap().radiance.to_array();
        assert_eq!(color(-0.5, 0.5), [1.0, 0.0, 0.0]);
        assert_eq!(color(0.5, 0.5), [0.0, 1.0, 0.0]);
        assert_eq!(color(-0.5, -0.5), [0.0, 0.0, 1.0]);
        assert_eq!(color(0.5, -0.5), [1.0; 3]);
    }
}
