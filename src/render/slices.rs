//! Half-angle slices (GPU Gems 39, section 39.5.1): shadows without a light volume, one pass over the slices for each light.
//!
//! Slices lie across `s`, half-way between the light's way l and the view v, or its reverse where l·v < 0, at distances
//! `d_s = d_v·cos(θ/2)` (7), θ the angle between the two: along either, samples are d_v apart. Each pass adds what one light
//! scatters to the eye; the last also what arrives undimmed (environments) and what the medium emits. Without lights that cast
//! shadows one pass over slices across the view does it.
//!
//! Rays that part from each other, of the eye by β and of a lamp by α from their middle, need an axis that all of them cross
//! in the same order: where half-way is not it, the nearest that is; where there is none, the lamp's rays are divided among
//! several passes. A lamp inside the volume takes at least six.

use std::f64::consts::FRAC_PI_2;

use std::sync::Arc;

use glam::{DMat3, DVec3};

use crate::camera::Camera;
use crate::device::slices::{Beam, Projection, Slices, Slicing, corners};
use crate::device::{Behind, Device, Phong, Ray, Term, Weight};
use crate::error::{Error, Result};
use crate::frame::Frame;
use crate::geometry::Geometry;
use crate::grid::Grid;
use crate::light::{self, LightVolume};
use crate::lights::{self, Light, Texture};
use crate::medium::Medium;
use crate::render::surfaces::{Surfaces, lit, reflected};
use crate::render::{Renderer, raycast};
use crate::scene::{RenderKeys, Scene, SlicesKeys};

/// Largest angle between the axis and a ray, in degrees: samples along it are 5.8 times as far apart as along the axis.
const STEEPEST: f64 = 80.0;
/// Pixels whose rays part by more than this, in degrees from their middle, are done in several parts.
const WIDEST: f64 = 45.0;
/// Lamps that see the box within this angle, in degrees, take one pass where the eye allows it.
const LAMP: f64 = 50.0;

/// Half-angle slices.
pub struct HalfAngle {
    render: RenderKeys,
    keys: SlicesKeys,
    lights: Vec<Light>,
    anisotropy: f32,
    spotlight: Option<Texture>,
    surfaces: Option<Surfaces>,
}

/// What one pass is for.
struct Pass {
    axis: DVec3,
    /// Distance of slices, in distances of samples.
    spacing: f64,
    /// The light's view, its picture's size in texels, and the part of the picture that is lit.
    view: Projection,
    size: [usize; 2],
    inner: [f64; 2],
}

impl HalfAngle {
    /// Slices as `scene.slices` and `scene.render` say, under the lights of the scene, up to what is opaque.
    ///
    /// # Errors
    /// Those of [`lights::resolve`], and of reading the image of spotlights.
    pub fn new(scene: &Scene, geometry: Option<Arc<Geometry>>) -> Result<Self> {
        Ok(HalfAngle {
            render: scene.render.clone(),
            keys: scene.slices.clone(),
            lights: lights::resolve(scene)?,
            anisotropy: scene.transfer.anisotropy,
            spotlight: scene.slices.spotlight.as_deref().map(Texture::read).transpose()?,
            surfaces: geometry.map(Surfaces::new),
        })
    }

    /// Radiance of the environments, as even light.
    fn even(&self) -> [f32; 3] {
        let mean = self.lights.iter().filter_map(Light::mean_radiance);
        mean.fold([0.0; 3], |even, radiance| std::array::from_fn(|c| even[c] + radiance[c]))
    }

    /// What arrives undimmed: environments, as even light; without shadows all lights.
    fn unshadowed(&self) -> Vec<Weight> {
        let even = self.even();
        let mut weights: Vec<Weight> = (even != [0.0; 3]).then_some(Weight::Uniform(even)).into_iter().collect();
        if !self.keys.shadows {
            weights.extend(self.lights.iter().filter_map(|l| light::weight(l, self.anisotropy)));
        }
        weights
    }

    /// What the picture's rays end at: surfaces in the direct light of the light volume, and in all of the environment's; without
    /// shadows in undimmed light. Nothing where nothing is opaque.
    fn behind(
        &self,
        device: &dyn Device,
        grid: &Grid,
        terms: &[Term],
        camera: &Camera,
        size: [usize; 2],
    ) -> Result<Vec<Behind>> {
        let Some(surfaces) = &self.surfaces else { return Ok(vec![]) };
        let dims =
            |term: &&Term| self.keys.shadows && matches!(term.weight, Weight::Phase { .. } | Weight::Lamp { .. });
        surfaces.seen(camera, size, |met| {
            let mut radiance = lit(device, grid, terms.iter().filter(dims), met)?;
            let (even, undimmed) = (self.even(), self.unshadowed());
            for (radiance, hit) in radiance.iter_mut().zip(met) {
                let shares = undimmed.iter().map(|weight| match weight {
                    Weight::Uniform(_) => even,
                    other => reflected(other, hit, grid),
                });
                *radiance = shares.fold(*radiance, |sum, share| std::array::from_fn(|c| sum[c] + share[c]));
            }
            Ok(radiance)
        })
    }

    fn phong(&self, grid: &Grid) -> Option<Phong> {
        raycast::phong(&self.render, &self.lights, grid)
    }

    /// The image that a cone light throws, where a pass of it begins.
    fn start(&self, light: &Light, pass: &Pass) -> Option<Vec<[f32; 3]>> {
        let (Some(texture), Light::Cone { direction, angle, .. }) = (&self.spotlight, light) else { return None };
        let frame = frame_of(DVec3::from(*direction));
        let tan = f64::from(*angle).min(89.9f64.to_radians()).tan();
        let [width, height] = pass.size;
        let texel = |i: usize, n: usize| 2.0 * (i as f64 + 0.5) / n as f64 - 1.0;
        let at = |n: usize| {
            let p = frame.transpose() * pass.view.way([texel(n % width, width), texel(n / width, height)]);
            if p.z > 0.0 { texture.at([p.x / (p.z * tan), p.y / (p.z * tan)]) } else { [0.0; 3] }
        };
        Some((0..width * height).map(at).collect())
    }
}

/// Columns right, down and forward of one who looks along `forward`, with +z upwards as far as it can be.
fn frame_of(forward: DVec3) -> DMat3 {
    let up = if forward.z.abs() < 0.999 { DVec3::Z } else { DVec3::Y };
    let right = forward.cross(up).normalize();
    DMat3::from_cols(right, forward.cross(right), forward)
}

/// The axis for light along `light`, its rays within `alpha` of it, and a view along `view`, its rays within `beta`; with the distance
/// of slices, in distances of samples: the lesser of the cosines between the axis and the two. Half-way where possible; `None` where no axis is within [`STEEPEST`] of all rays.
fn half_way(light: DVec3, alpha: f64, view: DVec3, beta: f64) -> Option<(DVec3, f64)> {
    let facing = if light.dot(view) >= 0.0 { view } else { -view };
    let theta = light.angle_between(facing);
    let steepest = STEEPEST.to_radians();
    let (least, most) = ((theta + beta - steepest).max(0.0), (steepest - alpha).min(theta));
    if least > most {
        return None;
    }
    let from_light = (0.5 * theta).clamp(least, most);
    let aside = (facing - light * light.dot(facing)).normalize_or_zero();
    let axis = (light * from_light.cos() + aside * from_light.sin()).normalize();
    // Along the light's outermost ray samples are at most twice as far apart as along the view.
    let spacing = from_light.cos().min((theta - from_light).cos()).min(2.0 * (from_light + alpha).cos());
    Some((axis, spacing))
}

/// A part of a picture, and how far its rays part from its middle one.
struct Part {
    window: [[usize; 2]; 2],
    middle: DVec3,
    beta: f64,
}

impl Part {
    fn new(eye: &Projection, picture: [usize; 2], window: [[usize; 2]; 2]) -> Self {
        let q = |a: usize, at: f64| 2.0 * at / picture[a] as f64 - 1.0;
        let ends = |a: usize| window[a].map(|p| q(a, p as f64));
        let middle = eye.way([0, 1].map(|a| 0.5 * (ends(a)[0] + ends(a)[1])));
        let beta = (0..4).map(|c| eye.way([ends(0)[c & 1], ends(1)[c >> 1]]).angle_between(middle)).fold(0.0, f64::max);
        Part { window, middle, beta }
    }

    /// Parts of a picture whose rays part by no more than [`WIDEST`], or that are a packet of rays.
    fn all(eye: &Projection, picture: [usize; 2]) -> Vec<Self> {
        let mut parts = vec![];
        let mut rest = vec![Part::new(eye, picture, [[0, picture[0]], [0, picture[1]]])];
        while let Some(part) = rest.pop() {
            let lengths = part.window.map(|[first, end]| end - first);
            let a = usize::from(lengths[1] > lengths[0]);
            if part.beta <= WIDEST.to_radians() || lengths[a] <= 4 {
                parts.push(part);
                continue;
            }
            let [first, end] = part.window[a];
            let middle = first + (lengths[a] / 2).next_multiple_of(4).min(lengths[a] - 1) / 4 * 4;
            for half in [[first, middle], [middle, end]] {
                let mut window = part.window;
                window[a] = half;
                rest.push(Part::new(eye, picture, window));
            }
        }
        parts
    }
}

/// Rays of a lamp: through a rectangle `[least, largest]` at depth 1 of a frame (right, down, forward).
struct Rays {
    frame: DMat3,
    window: [[f64; 2]; 2],
    /// Whether other passes are for what lies beyond the rectangle.
    divided: bool,
}

impl Rays {
    /// Those of a lamp that meet the box, or may.
    fn all(light: &Light, grid: &Grid) -> Vec<Self> {
        let (lo, hi) = grid.bounds();
        let (position, cone) = match *light {
            Light::Cone { position, direction, angle, .. } => {
                (position, Some((DVec3::from(direction), f64::from(angle))))
            }
            // A flat surface shines as a cone of a half-space.
            Light::Patch { position, direction, .. } => (position, Some((DVec3::from(direction), FRAC_PI_2))),
            Light::Point { position, .. } => (position, None),
            _ => return vec![],
        };
        let towards = (0.5 * (lo + hi) - position).normalize_or_zero();
        let limit = LAMP.to_radians();
        // A narrow cone, as it is; a box that is seen at a narrow angle; or all round.
        if let Some((axis, angle)) = cone.filter(|(_, angle)| *angle <= limit) {
            let tan = angle.tan();
            return vec![Rays { frame: frame_of(axis), window: [[-tan; 2], [tan; 2]], divided: false }];
        }
        let narrow = |c: DVec3| (c - position).normalize_or_zero().dot(towards) > limit.cos();
        if towards != DVec3::ZERO && corners(grid).into_iter().all(narrow) {
            let frame = frame_of(towards);
            let mut window = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
            for p in corners(grid).map(|c| frame.transpose() * (c - position)) {
                for (a, q) in [p.x / p.z, p.y / p.z].into_iter().enumerate() {
                    window = [
                        std::array::from_fn(|i| if i == a { window[0][a].min(q) } else { window[0][i] }),
                        std::array::from_fn(|i| if i == a { window[1][a].max(q) } else { window[1][i] }),
                    ];
                }
            }
            return vec![Rays { frame, window, divided: false }];
        }
        let faces = [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z];
        faces.map(|f| Rays { frame: frame_of(f), window: [[-1.0; 2], [1.0; 2]], divided: true }).into()
    }

    fn ray(&self, q: [f64; 2]) -> DVec3 {
        (self.frame * DVec3::new(q[0], q[1], 1.0)).normalize()
    }

    /// The middle one, and the largest angle to it.
    fn spread(&self) -> (DVec3, f64) {
        let [least, largest] = self.window;
        let middle = self.ray([0, 1].map(|a| 0.5 * (least[a] + largest[a])));
        let corner = |c: usize| self.ray([[least, largest][c & 1][0], [least, largest][c >> 1][1]]);
        (middle, (0..4).map(|c| corner(c).angle_between(middle)).fold(0.0, f64::max))
    }

    fn quarters(&self) -> Vec<Self> {
        let [least, largest] = self.window;
        let cuts: [[f64; 3]; 2] = std::array::from_fn(|a| [least[a], 0.5 * (least[a] + largest[a]), largest[a]]);
        let quarter = |n: usize| {
            let at = [n & 1, n >> 1];
            let window = [0, 1].map(|end| std::array::from_fn(|a| cuts[a][at[a] + end]));
            Rays { frame: self.frame, window, divided: true }
        };
        (0..4).map(quarter).collect()
    }

    /// False when the box lies beside or behind them.
    fn meets(&self, grid: &Grid, position: DVec3) -> bool {
        let [least, largest] = self.window;
        let inside = corners(grid).map(|c| {
            let p = self.frame.transpose() * (c - position);
            let at = [p.x, p.y];
            let beside = (0..2).flat_map(|a| [at[a] - least[a] * p.z, largest[a] * p.z - at[a]]);
            beside.chain([p.z]).collect::<Vec<_>>()
        });
        (0..5).all(|side| inside.iter().any(|c| c[side] >= 0.0))
    }

    /// The pass of these rays, texels of the given size at the far end of the box.
    fn pass(&self, grid: &Grid, position: DVec3, texel: f64, (axis, spacing): (DVec3, f64)) -> Pass {
        let [least, largest] = self.window;
        let depth = corners(grid).map(|c| self.frame.z_axis.dot(c - position)).into_iter().fold(0.0, f64::max);
        let half = [0, 1].map(|a| (0.5 * (largest[a] - least[a])).max(1e-6));
        let middle = [0, 1].map(|a| 0.5 * (least[a] + largest[a]));
        let size = half.map(|h| texels(2.0 * h * depth / texel));
        // A texel beyond the rectangle on each side, so that what is read between texels is right up to its border.
        let wide: [f64; 2] = std::array::from_fn(|a| half[a] * size[a] as f64 / (size[a] - 2) as f64);
        Pass {
            axis,
            spacing,
            view: Projection {
                origin: position,
                forward: self.frame * DVec3::new(middle[0], middle[1], 1.0),
                right: self.frame.x_axis * wide[0],
                down: self.frame.y_axis * wide[1],
                parallel: false,
            },
            size,
            inner: std::array::from_fn(|a| if self.divided { half[a] / wide[a] } else { f64::INFINITY }),
        }
    }
}

/// Texels per voxel for a medium. Light is bilinear between texels, so that pictures are off by about the 3/2th power of what a texel
/// dims: 1.5 texels a voxel where the densest takes a tenth of the light, and more by the square root up to 3, which cost four times as much.
fn resolution(medium: &Medium) -> f64 {
    let densest = medium.table.extinction.iter().copied().fold(0.0, f32::max);
    let depth = f64::from(densest) * medium.grid.mean_spacing();
    1.5 * (depth / -(0.9f64.ln())).sqrt().clamp(1.0, 2.0)
}

/// Texels for a length of so many, one more on each side.
fn texels(length: f64) -> usize {
    (length.ceil() as usize + 2).next_multiple_of(Beam::ALIGN)
}

/// The pass of a distant light over the whole box.
fn parallel(grid: &Grid, direction: DVec3, texel: f64, (axis, spacing): (DVec3, f64)) -> Pass {
    let frame = frame_of(direction);
    let (lo, hi) = grid.bounds();
    let centre = 0.5 * (lo + hi);
    let mut reach = DVec3::ZERO;
    for c in corners(grid) {
        reach = reach.max((frame.transpose() * (c - centre)).abs());
    }
    let size = [reach.x, reach.y].map(|r| texels(2.0 * r / texel));
    let half = size.map(|n| 0.5 * n as f64 * texel);
    Pass {
        axis,
        spacing,
        view: Projection {
            origin: centre - 1.01 * reach.z.max(texel) * direction,
            forward: direction,
            right: half[0] * frame.x_axis,
            down: half[1] * frame.y_axis,
            parallel: true,
        },
        size,
        inner: [f64::INFINITY; 2],
    }
}

/// The passes of a light over a part of the picture; `None` where the eye's rays part too far.
fn passes(light: &Light, grid: &Grid, texel: f64, part: &Part) -> Option<Vec<Pass>> {
    let axis = |light, alpha| half_way(light, alpha, part.middle, part.beta);
    let position = match *light {
        Light::Distant { direction, .. } => {
            let direction = DVec3::from(direction).normalize();
            return Some(vec![parallel(grid, direction, texel, axis(direction, 0.0)?)]);
        }
        Light::Point { position, .. } | Light::Cone { position, .. } | Light::Patch { position, .. } => position,
        Light::Environment { .. } | Light::Image { .. } => return Some(vec![]),
    };
    let mut passes = vec![];
    let mut rest = Rays::all(light, grid);
    while let Some(rays) = rest.pop() {
        if !rays.meets(grid, position) {
            continue;
        }
        let (middle, alpha) = rays.spread();
        match axis(middle, alpha) {
            Some(axis) => passes.push(rays.pass(grid, position, texel, axis)),
            None if alpha < 0.02 => return None,
            None => rest.extend(rays.quarters()),
        }
    }
    Some(passes)
}

impl Renderer for HalfAngle {
    /// Slices find their own shadows, in the medium.
    fn needs_light(&self) -> bool {
        self.surfaces.is_some() && self.keys.shadows
    }

    fn needs_scattered_light(&self) -> bool {
        false
    }

    fn render(
        &self,
        device: &dyn Device,
        medium: &Medium,
        light: &LightVolume,
        camera: &Camera,
        size: [usize; 2],
    ) -> Result<Frame> {
        let grid = &medium.grid;
        let eye = Projection::of(camera, size);
        let step = f64::from(self.render.step) * grid.mean_spacing();
        let texel = grid.mean_spacing() / self.keys.resolution.unwrap_or_else(|| resolution(medium));
        let unshadowed = self.unshadowed();
        let phong = self.phong(grid);
        // R = d·tan(θ/2) (9) for a step of a voxel; of an even disk, a quarter of R² is the variance along each axis.
        let blur = 0.25 * grid.mean_spacing() * (0.5 * self.keys.blur).to_radians().tan().powi(2);
        let behind = self.behind(device, grid, &light.terms(), camera, size)?;
        let mut rays = vec![Ray::FRESH; size[0] * size[1]];
        let mut frame = Frame::new(size);
        for part in Part::all(&eye, size) {
            let too_wide = || {
                Error::Unsupported(format!(
                    "slices of a picture of {size:?} pixels so wide an angle: give it more pixels, or a smaller cameras.fov"
                ))
            };
            let lights = self.lights.iter().filter(|_| self.keys.shadows);
            let mut all: Vec<(Option<&Light>, Option<Pass>)> = vec![];
            for light in lights {
                let passes = passes(light, grid, texel, &part).ok_or_else(too_wide)?;
                all.extend(passes.into_iter().map(|pass| (Some(light), Some(pass))));
            }
            if all.is_empty() {
                all.push((None, None));
            }
            let last = all.len() - 1;
            for (number, (light, pass)) in all.iter().enumerate() {
                let start = light.zip(pass.as_ref()).and_then(|(light, pass)| self.start(light, pass));
                let opaque = self.surfaces.as_ref().zip(pass.as_ref());
                let opaque = opaque.map_or(vec![], |(surfaces, pass)| surfaces.shade(&pass.view, pass.size));
                let beam = light.zip(pass.as_ref()).map(|(light, pass)| Beam {
                    weight: light::weight(light, self.anisotropy).expect("a light that casts shadows"),
                    view: pass.view,
                    size: pass.size,
                    inner: pass.inner,
                    start: start.as_deref(),
                    opaque: &opaque,
                    attenuation: self.keys.attenuation.rgb(),
                    blur,
                });
                let (axis, spacing) = pass.as_ref().map_or((part.middle, 1.0), |p| (p.axis, p.spacing));
                rays.fill(Ray::FRESH);
                rays.iter_mut().zip(&behind).for_each(|(ray, behind)| *ray = behind.ray());
                let slices = Slices {
                    grid,
                    field: &medium.field,
                    gradient: medium.gradient.as_ref(),
                    table: &medium.table,
                    bricks: medium.bricks,
                    majorant: &medium.majorant,
                    slicing: Slicing::new(grid, axis, spacing * step),
                    under: axis.dot(part.middle) > 0.0,
                    eye,
                    picture: size,
                    window: part.window,
                    unshadowed: if number == last { &unshadowed } else { &[] },
                    beam,
                    glows: number == last,
                    phong,
                    clips: &medium.clips,
                };
                device.slice(&slices, &mut rays)?;
                let [[left, right], [top, bottom]] = part.window;
                for y in top..bottom {
                    let row = y * size[0] + left..y * size[0] + right;
                    for (n, (pixel, ray)) in frame.pixels[row.clone()].iter_mut().zip(&rays[row.clone()]).enumerate() {
                        let [r, g, b, coverage] = match behind.get(row.start + n) {
                            Some(behind) if number == last => behind.pixel(ray),
                            _ => ray.pixel(),
                        };
                        *pixel = [pixel[0] + r, pixel[1] + g, pixel[2] + b, coverage];
                    }
                }
            }
        }
        Ok(frame)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_axis_is_half_way_and_spacing_is_that_of_equation_7() {
        let view = DVec3::Y;
        for degrees in [0.0f64, 30.0, 60.0, 89.9, 90.1, 120.0, 180.0] {
            let (sin, cos) = degrees.to_radians().sin_cos();
            let light = DVec3::new(sin, cos, 0.0);
            let (axis, spacing) = half_way(light, 0.0, view, 0.5).unwrap();
            let theta = degrees.min(180.0 - degrees).to_radians();
            assert!((spacing - (0.5 * theta).cos()).abs() < 1e-12, "{degrees}");
            assert!((axis.dot(light) - (0.5 * theta).cos()).abs() < 1e-12, "{degrees}");
            assert_eq!(axis.dot(view) > 0.0, degrees < 90.0, "front to back for the eye where l·v > 0");
        }
    }

    /// Every ray of the eye and of the light crosses the slices in the order that is assumed.
    #[test]
    fn rays_cross_slices_in_one_order() {
        let grid = Grid { size: [20, 30, 10], spacing: [1.0, 0.5, 2.0], origin: [0.0; 3] };
        let position = DVec3::new(9.0, 8.0, 7.0);
        let point = |position| Light::Point { position, radius: 0.0, intensity: [1.0; 3] };
        let cone = |angle: f32| Light::Cone {
            position,
            direction: glam::Vec3::X,
            angle,
            edge: 0.0,
            radius: 0.0,
            intensity: [1.0; 3],
        };
        let lights = [point(position), point(DVec3::new(9.0, -40.0, 30.0)), cone(0.4), cone(1.5)];
        for (fov, picture) in [(35.0, [64, 36]), (120.0, [64, 64]), (1.0, [8, 8])] {
            let camera = Camera::look_at(glam::Vec3::new(40.0, -30.0, 20.0), position.as_vec3(), glam::Vec3::Z, fov);
            let eye = Projection::of(&camera, picture);
            let parts = Part::all(&eye, picture);
            let pixels: usize = parts.iter().map(|p| p.window.map(|[a, b]| b - a).iter().product::<usize>()).sum();
            assert_eq!(pixels, picture[0] * picture[1], "parts cover the picture once");
            for (light, part) in lights.iter().flat_map(|l| parts.iter().map(move |p| (l, p))) {
                for pass in passes(light, &grid, 1.0, part).unwrap() {
                    let order = part.middle.dot(pass.axis).signum();
                    for n in 0..16 {
                        let at = |a: usize| {
                            let [first, end] = part.window[a].map(|p| 2.0 * p as f64 / picture[a] as f64 - 1.0);
                            first + (end - first) * (if a == 0 { n % 4 } else { n / 4 }) as f64 / 3.0
                        };
                        assert!(order * eye.way([at(0), at(1)]).dot(pass.axis) > 0.17);
                        let q = [n % 4, n / 4].map(|i| (2.0 * i as f64 / 3.0 - 1.0) * pass.inner[0].min(1.0));
                        assert!(pass.view.way(q).dot(pass.axis) > 0.0);
                    }
                }
            }
        }
    }

    /// Each point of the box is lit once, by one pass of a point light or by several in parts.
    #[test]
    fn passes_of_a_lamp_share_the_box() {
        let grid = Grid::new([16; 3]);
        let camera = Camera::look_at(glam::Vec3::new(40.0, -30.0, 20.0), glam::Vec3::splat(8.0), glam::Vec3::Z, 50.0);
        let eye = Projection::of(&camera, [32, 32]);
        let part = Part::new(&eye, [32, 32], [[0, 32], [0, 32]]);
        for position in [DVec3::new(7.3, 5.1, 9.2), DVec3::new(-3.0, 8.0, 8.0), DVec3::new(60.0, 8.0, 30.0)] {
            let light = Light::Point { position, radius: 0.0, intensity: [1.0; 3] };
            let passes = passes(&light, &grid, 1.0, &part).unwrap();
            for n in 0..1000 {
                let x = DVec3::new((n % 10) as f64, (n / 10 % 10) as f64, (n / 100) as f64) * 1.61 - 0.37;
                let inside =
                    |inner: f64, q: f64| (0.5 + 0.5 * (inner - q.abs()) / f64::from(Beam::FADE)).clamp(0.0, 1.0);
                let share = |pass: &Pass| {
                    pass.view.project(x).map_or(0.0, |q| (0..2).map(|a| inside(pass.inner[a], q[a])).product::<f64>())
                };
                let lit: f64 = passes.iter().map(share).sum();
                assert!((lit - 1.0).abs() < 1e-3, "{lit} at {x} of a light at {position}");
            }
        }
    }
}
