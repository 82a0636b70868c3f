//! Path tracing: see [`Trace`]. `L = Σ_paths f(path) / p(path)`, one path a sample; the same in `shaders/trace.wgsl`.
//!
//! Rows of pixels run in parallel; a sample is the same in whichever thread.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::camera::{Camera, Lens};
use crate::device::emitter::{Emitter, Hit, Shape};
use crate::device::{March, Sampling, Surface, Tally, Trace, Traced};
use crate::geometry;
use medium::{Collision, Medium};
use numbers::Numbers;
use scatter::Lobe;

pub mod emitter;
mod medium;
pub mod numbers;
pub mod scatter;
mod shapes;

pub(crate) use medium::bricks_ahead;

/// Adds samples to the sums of a picture's pixels on the threads of the current rayon pool.
pub(crate) fn trace(
    trace: &Trace,
    (field, gradient): (&[f32], Option<&[f32]>),
    picture: [usize; 2],
    tallies: &mut [Tally],
) -> Traced {
    assert_eq!(tallies.len(), picture[0] * picture[1], "a tally for each pixel");
    if trace.grid.is_empty() || picture.contains(&0) {
        return Traced::default();
    }
    let kernel = Kernel::new(trace, Medium::new(trace, field, gradient), picture);
    let rows = tallies.par_chunks_mut(picture[0]).enumerate();
    let row = |(y, row): (usize, &mut [Tally])| {
        let mut trail = Trail { exceeded: 0, touched: &mut [] };
        row.iter_mut().enumerate().for_each(|(x, tally)| kernel.pixel([x, y], tally, &mut trail));
        trail.exceeded
    };
    Traced { exceeded: rows.with_max_len(1).map(row).sum() }
}

/// The same for some tiles; marks the bricks that each depends on in its part of `touched`.
pub(crate) fn trace_tiles(
    trace: &Trace,
    (field, gradient): (&[f32], Option<&[f32]>),
    tiles: &[u32],
    picture: [usize; 2],
    tallies: &mut [Tally],
    touched: &mut [u64],
) -> Traced {
    let words = trace.bricks.len().div_ceil(64);
    assert_eq!(touched.len(), tiles.len() * words, "a bit for each brick of each tile");
    if trace.grid.is_empty() || tiles.is_empty() {
        return Traced::default();
    }
    let kernel = Kernel::new(trace, Medium::new(trace, field, gradient), picture);
    touched.fill(0);
    let tile = |(tile, touched): (&u32, &mut [u64])| {
        let mut trail = Trail { exceeded: 0, touched };
        let mut sums = Vec::with_capacity(March::TILE * March::TILE);
        for n in March::rows(*tile, picture).flatten() {
            let mut tally = tallies[n];
            kernel.pixel([n % picture[0], n / picture[0]], &mut tally, &mut trail);
            sums.push(tally);
        }
        (sums, trail.exceeded)
    };
    let each = tiles.par_iter().zip(touched.par_chunks_mut(words)).with_max_len(1);
    let done: Vec<(Vec<Tally>, u64)> = each.map(tile).collect();
    for (tile, (sums, _)) in tiles.iter().zip(&done) {
        March::rows(*tile, picture).flatten().zip(sums).for_each(|(n, sum)| tallies[n] = *sum);
    }
    Traced { exceeded: done.iter().map(|(_, exceeded)| exceeded).sum() }
}

/// What paths leave behind.
struct Trail<'a> {
    /// Collisions at which extinction was above the majorant.
    exceeded: u64,
    /// A bit for each brick that they depended on; nothing where nobody asks.
    touched: &'a mut [u64],
}

impl Trail<'_> {
    #[inline]
    fn touch(&mut self, brick: usize) {
        if let Some(word) = self.touched.get_mut(brick / 64) {
            *word |= 1 << (brick % 64);
        }
    }
}

/// Scattering from which on paths end at random.
const ROULETTE: u32 = 3;

/// What a sample brings home.
#[derive(Default)]
struct Found {
    radiance: Vec3,
    /// Where the medium was met first.
    first: Option<First>,
}

struct First {
    albedo: Vec3,
    normal: Vec3,
    depth: f32,
}

/// What a ray ends at.
enum End {
    Medium(Collision),
    Mesh(geometry::Hit),
}

struct Kernel<'a> {
    medium: Medium<'a>,
    trace: &'a Trace<'a>,
    picture: [usize; 2],
    eye: Vec3,
    /// World position of value (0, 0, 0).
    origin: DVec3,
    /// How far from a mesh paths go on, so that rounding does not have them meet it again.
    lift: f32,
    /// Already times tan of half the field of view, and the aspect.
    right: Vec3,
    up: Vec3,
    /// Emitters that rays can meet at some distance.
    placed: Vec<&'a Emitter>,
    /// Emitters that rays can meet behind everything.
    behind: Vec<&'a Emitter>,
}

impl<'a> Kernel<'a> {
    fn new(trace: &'a Trace<'a>, medium: Medium<'a>, picture: [usize; 2]) -> Self {
        let Camera { eye, right, up, tan, .. } = *trace.camera;
        let met = |e: &&Emitter| e.shape != Shape::Point && !(e.shape == Shape::Distant && e.edge >= 1.0);
        let far = |e: &&Emitter| matches!(e.shape, Shape::Distant | Shape::Environment);
        let (behind, placed) = trace.emitters.iter().filter(met).partition(far);
        Kernel {
            medium,
            trace,
            picture,
            eye: (eye.as_dvec3() - DVec3::from(trace.grid.origin)).as_vec3(),
            origin: DVec3::from(trace.grid.origin),
            lift: (1e-3 * trace.grid.mean_spacing()) as f32,
            right: tan * picture[0] as f32 / picture[1] as f32 * right,
            up: tan * up,
            placed,
            behind,
        }
    }

    /// Adds the samples of a pixel.
    fn pixel(&self, pixel: [usize; 2], tally: &mut Tally, trail: &mut Trail) {
        let number = (pixel[1] * self.picture[0] + pixel[0]) as u32;
        let mut numbers = Numbers::new(number, self.trace.seed);
        let (mut first, end) = (self.trace.samples.start, self.trace.samples.end);
        while first < end {
            // Where rays go depends on long chains of operations, which are many at a time here.
            let places: [[f32; 2]; 8] = std::array::from_fn(|i| numbers.spread(0, first.wrapping_add(i as u32)));
            for (sample, place) in (first..end).zip(places) {
                numbers.begin(sample);
                let Found { radiance, first } = self.path(pixel, place, &mut numbers, trail);
                tally.add(radiance, first);
            }
            first = first.saturating_add(8);
        }
    }

    /// The ray of a sample from the camera, through a place in a pixel.
    #[inline]
    fn ray(&self, [x, y]: [usize; 2], [u, v]: [f32; 2], numbers: &Numbers) -> (Vec3, Vec3) {
        let at = |i: usize, u: f32, n: usize| 2.0 * (i as f32 + u) / n as f32 - 1.0;
        let (px, py) = (at(x, u, self.picture[0]), at(y, v, self.picture[1]));
        let way = self.trace.camera.forward + px * self.right - py * self.up;
        let Camera { lens, right, up, .. } = *self.trace.camera;
        let (radius, focus) = (lens.radius, self.trace.focus);
        if radius <= 0.0 {
            return (self.eye, way.normalize());
        }
        let [a, b] = aperture(lens, numbers.pair(1));
        let shift = radius * (a * right + b * up);
        // `way` reaches one length along the view.
        (self.eye + shift, (focus * way - shift).normalize())
    }

    #[inline]
    fn path(&self, pixel: [usize; 2], place: [f32; 2], numbers: &mut Numbers, trail: &mut Trail) -> Found {
        let trace = self.trace;
        let (mut origin, mut way) = self.ray(pixel, place, numbers);
        let mut found = Found::default();
        let mut weight = Vec3::ONE;
        // Density with which the way was chosen.
        let mut pdf = 0.0;
        for bounce in 0..=trace.depth {
            // The last ray only looks for light.
            if bounce > 0 && bounce == trace.depth && self.blind() {
                break;
            }
            // Most rays from the camera meet nothing: theirs are found when they are needed.
            let drawn = (bounce > 0).then(|| [numbers.draw(), numbers.draw()]);
            let end = self.fly(
                (origin, way),
                drawn.map(|[flight, _]| flight),
                (bounce > 0).then_some(pdf),
                numbers,
                &mut weight,
                &mut found,
                trail,
            );
            let (here, lobe, first) = match end {
                None => break,
                Some(End::Medium(collision)) => {
                    let albedo = self.medium.albedo(collision.entry);
                    // For surfaces it is smoothed; for the picture's normals the mean over samples does that.
                    let gradient = match self.medium.surface {
                        Some(_) => self.medium.gradient(collision.position),
                        None if bounce == 0 => self.medium.slope(collision.position),
                        None => Vec3::ZERO,
                    };
                    let normal = -(gradient * Vec3::from(self.medium.per_length)).normalize_or_zero();
                    let lobe = self.lobe(&collision, albedo, gradient, way, numbers.draw());
                    (origin + collision.t * way, lobe, First { albedo, normal, depth: collision.t })
                }
                Some(End::Mesh(hit)) => {
                    let (normal, albedo, depth) = (hit.normal.as_vec3(), Vec3::from(hit.color), hit.t as f32);
                    // What has come from afar is rounded more.
                    let here = origin + depth * way + (self.lift + 1e-6 * depth) * normal;
                    (here, Lobe::Matte { normal, albedo }, First { albedo, normal, depth })
                }
            };
            if bounce == 0 {
                found.first = Some(first);
            }
            if bounce == trace.depth {
                break;
            }

            let xi = if bounce == 0 { numbers.pair(3) } else { [numbers.draw(), numbers.draw()] };
            let third = numbers.draw();
            let [_, choice] = drawn.unwrap_or_else(|| numbers.pair(2));
            found.radiance += weight * self.light(&lobe, here, way, choice, [xi[0], xi[1], third], numbers, trail);

            let xi = if bounce == 0 { numbers.pair(4) } else { [numbers.draw(), numbers.draw()] };
            let to = lobe.sample(way, [xi[0], xi[1], numbers.draw()]);
            let (f, p) = lobe.value(way, to);
            if p.is_nan() || p <= 0.0 {
                break;
            }
            weight *= f / p;
            if bounce + 1 >= ROULETTE {
                let survival = weight.max_element().min(1.0);
                if numbers.draw() >= survival {
                    break;
                }
                weight /= survival;
            }
            if weight == Vec3::ZERO {
                break;
            }
            (origin, way, pdf) = (here, to, p);
        }
        found
    }

    /// True when a ray on its own finds no light.
    #[inline]
    fn blind(&self) -> bool {
        let lights = self.trace.sampling != Sampling::Lights && !(self.placed.is_empty() && self.behind.is_empty());
        !lights && !self.medium.glows
    }

    /// Follows a ray to its next collision or to a mesh, and collects what glows and every emitter that it meets before.
    #[inline]
    fn fly(
        &self,
        ray: (Vec3, Vec3),
        mut flight: Option<f32>,
        pdf: Option<f32>,
        numbers: &mut Numbers,
        weight: &mut Vec3,
        found: &mut Found,
        trail: &mut Trail,
    ) -> Option<End> {
        let radiance = &mut found.radiance;
        let wall = self.wall(ray, f32::INFINITY);
        let end = wall.map_or(f32::INFINITY, |hit| hit.t as f32);
        let mut from = 0.0;
        while !self.placed.is_empty() {
            // Free flights have no memory: to the next emitter and on from there is as well as at once.
            let next = self.next(ray, from, pdf.is_none()).filter(|(_, hit)| hit.distance < end);
            let Some((emitter, hit)) = next else { break };
            let until = from..hit.distance;
            let collision = self.medium.collide(ray, until, flight, numbers, weight, radiance, trail);
            if collision.is_some() {
                return collision.map(End::Medium);
            }
            *radiance += *weight * hit.radiance * self.share(emitter, &hit, pdf);
            from = hit.distance;
            flight = Some(numbers.draw());
        }
        let collision = self.medium.collide(ray, from..end, flight, numbers, weight, radiance, trail);
        let end = collision.map(End::Medium).or(wall.map(End::Mesh));
        if end.is_none() {
            for emitter in self.behind.iter().filter(|e| pdf.is_some() || e.visible) {
                if let Some(hit) = emitter::hit(emitter, self.trace.images, ray.0, ray.1) {
                    *radiance += *weight * hit.radiance * self.share(emitter, &hit, pdf);
                }
            }
        }
        end
    }

    /// The first mesh that a ray meets before a distance.
    #[inline]
    fn wall(&self, (origin, way): (Vec3, Vec3), before: f32) -> Option<geometry::Hit> {
        self.trace.meshes?.first_hit(self.origin + origin.as_dvec3(), way.as_dvec3(), before.into())
    }

    /// The first emitter that a ray meets beyond a distance.
    #[inline]
    fn next(&self, ray: (Vec3, Vec3), beyond: f32, camera: bool) -> Option<(&Emitter, Hit)> {
        (self.placed.iter().filter(|e| !camera || e.visible))
            .filter_map(|e| Some((*e, emitter::hit(e, self.trace.images, ray.0, ray.1)?)))
            .filter(|(_, hit)| hit.distance > beyond)
            .min_by(|a, b| a.1.distance.total_cmp(&b.1.distance))
    }

    /// What a light that a ray has met counts, beside samples of that light.
    #[inline]
    fn share(&self, emitter: &Emitter, hit: &Hit, pdf: Option<f32>) -> f32 {
        match (pdf, self.trace.sampling) {
            (None, _) | (_, Sampling::Scattering) => 1.0,
            (_, Sampling::Lights) => 0.0,
            (Some(pdf), Sampling::Both) => power(pdf, emitter.share * hit.pdf),
        }
    }

    /// Light that comes straight from one emitter and goes on against `way`.
    #[inline]
    fn light(
        &self,
        lobe: &Lobe,
        here: Vec3,
        way: Vec3,
        choice: f32,
        xi: [f32; 3],
        numbers: &mut Numbers,
        trail: &mut Trail,
    ) -> Vec3 {
        let Some(emitter) = choose(self.trace.emitters, choice) else { return Vec3::ZERO };
        let Some(sample) = emitter::sample(emitter, self.trace.images, here, xi) else { return Vec3::ZERO };
        let (f, p) = lobe.value(way, sample.direction);
        let density = emitter.share * if sample.pdf > 0.0 { sample.pdf } else { 1.0 };
        let counts = match self.trace.sampling {
            _ if sample.pdf == 0.0 => 1.0,
            Sampling::Both => power(density, p),
            Sampling::Lights => 1.0,
            Sampling::Scattering => 0.0,
        };
        let worth = f * sample.radiance * (counts / density);
        if worth.is_nan() || worth.max_element() <= 0.0 {
            return Vec3::ZERO;
        }
        if self.wall((here, sample.direction), sample.distance).is_some() {
            return Vec3::ZERO;
        }
        worth * self.medium.transmittance((here, sample.direction), 0.0..sample.distance, numbers, trail)
    }

    /// Whether a collision is with a surface or with a cloud (Kroes et al. 2012, (1)–(3)).
    #[inline]
    fn lobe(&self, collision: &Collision, albedo: Vec3, gradient: Vec3, way: Vec3, xi: f32) -> Lobe {
        match &self.medium.surface {
            Some(surface) => self.lobe_of(surface, collision, albedo, gradient, way, xi),
            None => Lobe::Phase { phase: self.trace.phase, albedo },
        }
    }

    /// The same where there are surfaces. On its own, or what it needs is worked out for every path, from memory that holds nothing where
    /// there are none: numbers so small that they take processors a hundred cycles.
    #[inline(never)]
    fn lobe_of(
        &self,
        surface: &Surface,
        collision: &Collision,
        albedo: Vec3,
        gradient: Vec3,
        way: Vec3,
        xi: f32,
    ) -> Lobe {
        let normal = -(gradient * Vec3::from(self.medium.per_length)).normalize_or_zero();
        let chance = if normal == Vec3::ZERO { 0.0 } else { reflects(surface, collision.sigma, gradient.length()) };
        if xi >= chance {
            return Lobe::Phase { phase: self.trace.phase, albedo };
        }
        let [diffuse, specular, roughness, ior] = Medium::column(surface.columns, collision.entry.at);
        let facing = (ior - 1.0) / (ior + 1.0);
        Lobe::Surface {
            normal: if normal.dot(way) > 0.0 { -normal } else { normal },
            diffuse: diffuse * albedo,
            specular,
            facing: facing * facing,
            exponent: scatter::exponent(roughness),
        }
    }
}

/// The probability that a collision is with a surface, of extinction and the change of the normalised value per voxel.
pub fn reflects(surface: &Surface, sigma: f32, change: f32) -> f32 {
    match surface.factor {
        None => 1.0,
        Some(f) => (1.0 - (-sigma * surface.reference).exp()) * (1.0 - (-25.0 * f * f * f * change).exp()),
    }
}

/// Veach & Guibas's power heuristic.
#[inline]
fn power(own: f32, other: f32) -> f32 {
    let ratio = other / own;
    1.0 / (1.0 + ratio * ratio)
}

/// An emitter by its share.
#[inline]
fn choose(emitters: &[Emitter], mut xi: f32) -> Option<&Emitter> {
    for emitter in emitters {
        if xi < emitter.share {
            return Some(emitter);
        }
        xi -= emitter.share;
    }
    emitters.last()
}

/// An even point of an aperture within the unit circle.
#[inline]
pub fn aperture(lens: Lens, [u, v]: [f32; 2]) -> [f32; 2] {
    if lens.blades < 3 {
        let (r, angle) = (u.sqrt(), std::f32::consts::TAU * v);
        return [r * angle.cos(), r * angle.sin()];
    }
    // A triangle between two neighbouring corners and the middle.
    let at = v * lens.blades as f32;
    let corner = |i: f32| {
        let angle = std::f32::consts::TAU * i / lens.blades as f32;
        [angle.sin(), angle.cos()]
    };
    let (a, b) = (corner(at.floor()), corner(at.floor() + 1.0));
    let (r, t) = (u.sqrt(), at - at.floor());
    std::array::from_fn(|i| r * (a[i] * (1.0 - t) + b[i] * t))
}

impl Tally {
    #[inline]
    fn add(&mut self, radiance: Vec3, first: Option<First>) {
        self.samples += 1;
        // One sample that is not finite would be a pixel that never is.
        if radiance != Vec3::ZERO && radiance.is_finite() {
            for c in 0..3 {
                let value = f64::from(radiance[c]);
                self.radiance[c] += value;
                self.squares[c] += value * value;
            }
        }
        if let Some(First { albedo, normal, depth }) = first {
            self.coverage += 1.0;
            self.depth += depth;
            for c in 0..3 {
                self.albedo[c] += albedo[c];
                self.normal[c] += normal[c];
            }
        }
    }
}
