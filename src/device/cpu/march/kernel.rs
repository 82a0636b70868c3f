//! reads data, terms, table, distances → writes one tile of pixels.
//!
//! One body for every instruction set: generic over [`Lanes`].

use glam::Vec3;

use super::lanes::{Lanes, opacity};
use super::plan::{Albedo, Column, Group, Lattice, Matter, Optics, Plan, Summed, Volume};
use crate::device::{Clip, ClipShape, Falloff, March, Phong, Ray, Weight};

/// Pixels along the edge of a tile: enough that tiles of a 256² picture keep 64 cores busy, a multiple of every packet.
pub(super) const TILE: usize = March::TILE;
/// Samples between two questions whether the bricks ahead are empty. Asking costs about a third of a sample; not asking costs
/// the samples taken beyond the end of a brick. Measured on `benches/raycast.rs` with bricks of 8³ (AVX-512, ms of one core):
/// 157 at 1, 143 at 2, 133 at 4, 124 at 8, 124 at 12.
const RUN: usize = 8;

/// Pixels along the edge of a block: a multiple of every packet.
const BLOCK: usize = 4;
/// Blocks of a tile.
const BLOCKS: usize = (TILE / BLOCK) * (TILE / BLOCK);
/// For each block the lowest and the highest cell along z in which its rays have their next samples; the highest below the lowest
/// where all rays are done.
pub(super) type Waiting = [[f32; 2]; BLOCKS];

/// A tile.
#[derive(Clone)]
pub(super) struct Tile {
    /// Row by row.
    pub rays: [Ray; TILE * TILE],
    pub waiting: Waiting,
}

impl Tile {
    /// Rays that have not met anything and may be anywhere.
    pub const FRESH: Tile = Tile { rays: [Ray::FRESH; TILE * TILE], waiting: [[0.0, f32::MAX]; BLOCKS] };
}

/// `[value with a = 0, with a = 1, with a = 2]`. Not a closure: one would be compiled without the caller's instruction set.
macro_rules! three {
    ($a:ident => $value:expr) => {
        [
            {
                let $a = 0;
                $value
            },
            {
                let $a = 1;
                $value
            },
            {
                let $a = 2;
                $value
            },
        ]
    };
}

pub(in crate::device::cpu) use three;

/// Carries the rays of the tile whose first pixel is `first` on.
#[inline(always)]
pub(super) fn tile<V: Lanes>(plan: &Plan, first: [usize; 2], tile: &mut Tile) {
    assert!(plan.matter.reach <= V::REACH, "indices must fit");
    let mut weights = vec![[V::splat(0.0); 3]; plan.terms];
    for (n, waiting) in tile.waiting.iter_mut().enumerate() {
        if plan.meets(*waiting) {
            let corner = [n % (TILE / BLOCK) * BLOCK, n / (TILE / BLOCK) * BLOCK];
            *waiting = block(plan, first, corner, &mut weights, &mut tile.rays);
        }
    }
}

/// Carries the rays of a block on; returns where they wait.
#[inline(always)]
fn block<V: Lanes>(
    plan: &Plan,
    first: [usize; 2],
    corner: [usize; 2],
    weights: &mut [[V; 3]],
    rays: &mut [Ray; TILE * TILE],
) -> [f32; 2] {
    let [w, h] = V::SHAPE;
    let mut lanes = [[0.0; 16]; 9];
    let mut waiting = [f32::MAX, -1.0];
    for y in (corner[1]..corner[1] + BLOCK).step_by(h) {
        for x in (corner[0]..corner[0] + BLOCK).step_by(w) {
            let at = [first[0] + x, first[1] + y];
            if at[0] >= plan.picture[0] || at[1] >= plan.picture[1] {
                continue;
            }
            let ray = |l: usize| (y + l / w) * TILE + x + l % w;
            let mut state = State {
                radiance: three!(c => V::from_fn(|l| rays[ray(l)].radiance[c])),
                through: three!(c => V::from_fn(|l| rays[ray(l)].transmittance[c])),
                next: V::from_fn(|l| rays[ray(l)].next),
                waiting: [V::splat(f32::MAX), V::splat(-1.0)],
            };
            packet(plan, at, weights, V::from_fn(|l| rays[ray(l)].end), &mut state);
            let [r, g, b] = state.radiance;
            let [t0, t1, t2] = state.through;
            let [lowest, highest] = state.waiting;
            for (value, lanes) in [r, g, b, t0, t1, t2, state.next, lowest, highest].into_iter().zip(&mut lanes) {
                value.store(lanes);
            }
            for l in 0..w * h {
                let [r, g, b, t0, t1, t2, next, lowest, highest] = std::array::from_fn(|c| lanes[c][l]);
                rays[ray(l)] = Ray { radiance: [r, g, b], transmittance: [t0, t1, t2], next, ..rays[ray(l)] };
                waiting = [waiting[0].min(lowest), waiting[1].max(highest)];
            }
        }
    }
    waiting
}

#[inline(always)]
pub(in crate::device::cpu) fn dot<V: Lanes>(a: [V; 3], b: Vec3) -> V {
    a[0] * V::splat(b.x) + a[1] * V::splat(b.y) + a[2] * V::splat(b.z)
}

#[inline(always)]
pub(in crate::device::cpu) fn dots<V: Lanes>(a: [V; 3], b: [V; 3]) -> V {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// What the rays of a packet carry along.
struct State<V> {
    radiance: [V; 3],
    /// Transmittance per channel.
    through: [V; 3],
    next: V,
    /// The cell along z of the next sample, twice; the largest number and −1 where there is none.
    waiting: [V; 2],
}

/// Rays of a packet in index space; `t` is world length from where they enter the box.
struct Rays<V> {
    start: [V; 3],
    /// Index length per world length.
    slope: [V; 3],
    /// Unit world direction.
    direction: [V; 3],
    length: V,
    step: V,
}

impl<V: Lanes> Rays<V> {
    #[inline(always)]
    fn new(plan: &Plan, at: [usize; 2], end: V) -> Self {
        let [w, _] = V::SHAPE;
        let [width, height] = plan.picture.map(|n| V::splat(n as f32));
        let (one, two, half) = (V::splat(1.0), V::splat(2.0), V::splat(0.5));
        let px = two * (V::from_fn(|l| (at[0] + l % w) as f32) + half) / width - one;
        let py = two * (V::from_fn(|l| (at[1] + l / w) as f32) + half) / height - one;
        let way: [V; 3] =
            three!(a => V::splat(plan.forward[a]) + px * V::splat(plan.right[a]) - py * V::splat(plan.up[a]));
        let norm = dots(way, way).sqrt();
        let direction = three!(a => way[a] / norm);
        let slope = three!(a => direction[a] * V::splat(plan.matter.per_length[a]));

        // Slabs. A component of nearly 0 counts as barely positive: neither 0/0 nor ∞·0 can arise.
        let (mut near, mut far) = (V::splat(0.0), end);
        for (a, &slope) in slope.iter().enumerate() {
            let inverse = V::splat(1.0) / Self::nonzero(slope);
            let below = (V::splat(-0.5) - V::splat(plan.eye[a])) * inverse;
            let above = (V::splat(plan.matter.top[a]) - V::splat(plan.eye[a])) * inverse;
            near = below.min(above).max(near);
            far = below.max(above).min(far);
        }
        let length = far - near;
        // Also turns a NaN into a ray that misses.
        let length = V::select(V::splat(0.0).lt(length) & length.lt(V::splat(f32::MAX)), length, V::splat(0.0));
        let near = V::select(V::splat(0.0).lt(length), near, V::splat(0.0));
        let start = three!(a => V::splat(plan.eye[a]) + near * slope[a]);
        Rays { start, slope, direction, length, step: V::splat(plan.step) }
    }

    #[inline(always)]
    fn nonzero(slope: V) -> V {
        let tiny = V::splat(1e-20);
        V::select(V::splat(0.0).max(slope).max(V::splat(0.0) - slope).lt(tiny), tiny, slope)
    }

    /// Index position in the middle of interval `n`, and the length of the interval; not positive beyond the end.
    #[inline(always)]
    fn sample(&self, n: V) -> ([V; 3], V) {
        let t = n * self.step;
        let ds = self.step.min(self.length - t);
        let t = t + V::splat(0.5) * ds;
        (three!(a => self.start[a] + t * self.slope[a]), ds)
    }
}

/// Where a position lies between values: index of the lower corner, weights of the upper and of the lower neighbours.
pub(in crate::device::cpu) struct Cell<V: Lanes> {
    first: V::Int,
    upper: [V; 3],
    lower: [V; 3],
}

impl<V: Lanes> Cell<V> {
    #[inline(always)]
    pub fn new(lattice: &Lattice, position: [V; 3]) -> Self {
        // `max` first: it turns a NaN into a number, so that indices stay inside whatever comes.
        let clamped = three!(a => position[a].max(V::splat(lattice.first[a])).min(V::splat(lattice.last[a])));
        let corner = three!(a => clamped[a].min(V::splat(lattice.last_cell[a])).trunc());
        let upper = three!(a => clamped[a] - V::float(corner[a]));
        Cell { first: V::linear(corner, lattice.stride), upper, lower: three!(a => V::splat(1.0) - upper[a]) }
    }

    /// `a·lower + b·upper`: unlike `a + (b − a)·upper` exact at both ends, also beside a hole.
    #[inline(always)]
    fn mix(&self, axis: usize, (a, b): (V, V)) -> V {
        a * self.lower[axis] + b * self.upper[axis]
    }

    /// Trilinear interpolation.
    #[inline(always)]
    pub fn value(&self, lattice: &Lattice, volume: &Volume) -> V {
        let p = volume.origin();
        let [y, z, yz] = lattice.corners;
        // SAFETY: a cell's lower corner is first..=last_cell along each axis, so that the corners' offsets (0 along an axis
        // with one value; rows have at least two) stay inside; `tile` has checked REACH.
        let [a, b, c, d] = unsafe {
            [
                V::pairs(p, self.first),
                V::pairs(p.wrapping_add(y), self.first),
                V::pairs(p.wrapping_add(z), self.first),
                V::pairs(p.wrapping_add(yz), self.first),
            ]
        };
        let front = self.mix(1, (self.mix(0, a), self.mix(0, b)));
        let back = self.mix(1, (self.mix(0, c), self.mix(0, d)));
        self.mix(2, (front, back))
    }
}

/// Where a value lies between entries of the table, and between its rows where it has more than one.
struct Entry<V: Lanes> {
    first: V::Int,
    upper: V,
    lower: V,
    /// Width of a row, and the weight of the next one.
    row: Option<(usize, V)>,
}

impl<V: Lanes> Entry<V> {
    #[inline(always)]
    fn new(optics: &Optics, value: V, gradient: Option<V>) -> Self {
        let at = ((value - V::splat(optics.lo)) * V::splat(optics.scale)).max(V::splat(0.0)).min(V::splat(optics.last));
        let first = at.min(V::splat(optics.last - 1.0)).trunc();
        let upper = at - V::float(first);
        let lower = V::splat(1.0) - upper;
        let (Some(rows), Some(gradient)) = (&optics.rows, gradient) else {
            return Entry { first, upper, lower, row: None };
        };
        let at = (gradient * V::splat(rows.scale)).max(V::splat(0.0)).min(V::splat(rows.last));
        let row = at.min(V::splat(rows.last - 1.0)).trunc();
        let none = V::splat(0.0).trunc();
        let weight = at - V::float(row);
        Entry { first: V::linear([first, row, none], [rows.width, 0]), upper, lower, row: Some((rows.width, weight)) }
    }

    #[inline(always)]
    fn of(&self, column: &Column) -> V {
        // SAFETY: `first` is at most the last entry but one of a row, and all columns have the same length, at least 2.
        let (a, b) = unsafe { V::pairs(column.as_ptr(), self.first) };
        let value = a * self.lower + b * self.upper;
        let Some((width, weight)) = self.row else { return value };
        // SAFETY: `first` is at most in the last row but one.
        let (a, b) = unsafe { V::pairs(column.as_ptr().wrapping_add(width), self.first) };
        // Exact where both rows are the same.
        value + weight * ((a * self.lower + b * self.upper) - value)
    }
}

/// One end of an interval of values, and how far it is beyond the table, in entries.
struct End<V: Lanes> {
    at: Entry<V>,
    beyond: V,
}

impl<V: Lanes> End<V> {
    #[inline(always)]
    fn new(optics: &Optics, value: V) -> Self {
        let exact = (value - V::splat(optics.lo)) * V::splat(optics.scale);
        let beyond = exact - exact.max(V::splat(0.0)).min(V::splat(optics.last));
        End { at: Entry::new(optics, value, None), beyond }
    }

    /// The integral of a column up to here.
    #[inline(always)]
    fn of(&self, column: &Summed) -> V {
        // SAFETY: as of `Entry::of`; sums have the length of their column.
        let ((a, b), (sum, _)) =
            unsafe { (V::pairs(column.values.as_ptr(), self.at.first), V::pairs(column.sums.as_ptr(), self.at.first)) };
        let value = a * self.at.lower + b * self.at.upper;
        sum + V::splat(0.5) * (a + value) * self.at.upper + self.beyond * value
    }
}

/// What a sample looks up: its value, or all values between those at the ends of its interval.
pub(in crate::device::cpu) struct Sample<V: Lanes> {
    /// False in holes.
    pub there: V::Mask,
    entry: Entry<V>,
    between: Option<([End<V>; 2], V, V::Mask)>,
}

impl<V: Lanes> Sample<V> {
    /// Of the interval `half` to both sides of `position`, which lies in `cell`.
    #[inline(always)]
    pub fn new(matter: &Matter, position: [V; 3], half: [V; 3], cell: &Cell<V>) -> Self {
        let hole = V::splat(crate::field::HOLE);
        let optics = &matter.optics;
        let value = cell.value(&matter.lattice, &matter.data);
        let gradient = matter.gradient.as_ref().map(|gradient| cell.value(&matter.lattice, gradient));
        let entry = Entry::new(optics, value, gradient);
        let mut between = None;
        if optics.means.is_some() {
            // The edge of a hole is as far as values go.
            let before = three!(a => position[a] - half[a]);
            let found = Cell::new(&matter.lattice, before).value(&matter.lattice, &matter.data);
            let a = V::select(hole.lt(found), found, value);
            let after = three!(a => position[a] + half[a]);
            let found = Cell::new(&matter.lattice, after).value(&matter.lattice, &matter.data);
            let b = V::select(hole.lt(found), found, value);
            let entries = (b.max(a) - a.min(b)) * V::splat(optics.scale);
            let (low, high) = (End::new(optics, a.min(b)), End::new(optics, a.max(b)));
            // Within one entry's width the middle is the mean, and differences of integrals are rounding.
            let wide = V::splat(1.0).lt(entries);
            between = Some(([low, high], V::splat(1.0) / entries.max(V::splat(1.0)), wide));
        }
        Sample { there: hole.lt(value), entry, between }
    }

    #[inline(always)]
    fn mean(&self, plain: V, column: Option<&Summed>) -> V {
        let (Some(([low, high], inverse, wide)), Some(column)) = (&self.between, column) else { return plain };
        let mean = ((high.of(column) - low.of(column)) * *inverse).max(V::splat(0.0));
        V::select(*wide, mean, plain)
    }

    /// Extinction; 0 in holes.
    #[inline(always)]
    pub fn extinction(&self, optics: &Optics) -> V {
        let sigma = self.mean(self.entry.of(&optics.extinction), optics.means.as_ref().map(|m| &m.extinction));
        V::select(self.there, sigma, V::splat(0.0))
    }

    /// Albedo where extinction is `sigma`: the mean weighted by it.
    #[inline(always)]
    pub fn albedo(&self, optics: &Optics, sigma: V) -> [V; 3] {
        let plain = match &optics.albedo {
            Albedo::Constant(albedo) => return three!(c => V::splat(albedo[c])),
            Albedo::Gray(column) => [self.entry.of(column); 3],
            Albedo::Rgb(columns) => three!(c => self.entry.of(&columns[c])),
        };
        let (Some(means), Some((_, _, wide))) = (&optics.means, &self.between) else { return plain };
        let zero = V::splat(0.0);
        three!(c => {
            let scattering = self.mean(zero, Some(&means.scattering[c]));
            V::select(*wide, (scattering / sigma.max(V::splat(1e-30))).min(V::splat(1.0)), plain[c])
        })
    }

    /// Emission of a channel.
    #[inline(always)]
    pub fn emission(&self, optics: &Optics, columns: &[Column; 3], c: usize) -> V {
        let sums = optics.means.as_ref().and_then(|m| m.emission.as_ref());
        self.mean(self.entry.of(&columns[c]), sums.map(|s| &s[c]))
    }
}

/// Extinction at a position; 0 in holes.
#[inline(always)]
fn extinction<V: Lanes>(matter: &Matter, position: [V; 3]) -> V {
    let cell = Cell::new(&matter.lattice, position);
    let value = cell.value(&matter.lattice, &matter.data);
    let gradient = matter.gradient.as_ref().map(|gradient| cell.value(&matter.lattice, gradient));
    let sigma = Entry::new(&matter.optics, value, gradient).of(&matter.optics.extinction);
    V::select(value.lt(V::splat(crate::field::HOLE)), V::splat(0.0), sigma)
}

/// Henyey–Greenstein: (1 − g²) / (4π (1 + g² − 2g cos θ)^1.5).
#[inline(always)]
pub(in crate::device::cpu) fn phase<V: Lanes>(g: f32, cos: V) -> V {
    let s = (V::splat(1.0 + g * g) - V::splat(2.0 * g) * cos).max(V::splat(1e-12));
    V::splat((1.0 - g * g) / (4.0 * std::f32::consts::PI)) / (s * s.sqrt())
}

/// Weight of a lamp at a position: falloff times phase function, per unit of intensity.
#[inline(always)]
pub(in crate::device::cpu) fn lamp<V: Lanes>(falloff: &Falloff, g: f32, direction: [V; 3], position: [V; 3]) -> V {
    let way: [V; 3] = three!(a => (position[a] - V::splat(falloff.position[a])) * V::splat(falloff.spacing[a]));
    let square = dots(way, way);
    let r = square.max(V::splat(1e-30)).sqrt();
    let t = (dot(way, falloff.axis) / r - V::splat(falloff.outer)) * V::splat(falloff.slope);
    let t = t.max(V::splat(0.0)).min(V::splat(1.0));
    let smooth = t * t * (V::splat(3.0) - V::splat(2.0) * t);
    let shape = (smooth + V::splat(falloff.cosine) * (t - smooth)) / square.max(V::splat(falloff.floor));
    // The way to the eye is −direction.
    shape * phase(g, V::splat(0.0) - dots(direction, way) / r)
}

/// Weight of a term for each ray and channel.
#[inline(always)]
pub(in crate::device::cpu) fn weight<V: Lanes>(weight: &Weight, direction: [V; 3]) -> [V; 3] {
    match *weight {
        Weight::Uniform(rgb) => three!(c => V::splat(rgb[c])),
        Weight::Phase { direction: travel, irradiance, g } => {
            // The way to the eye is −direction.
            let p = phase(g, V::splat(0.0) - dot(direction, travel));
            three!(c => V::splat(irradiance[c]) * p)
        }
        // Multiplied by what `lamp` gives at each sample.
        Weight::Lamp { intensity, .. } => three!(c => V::splat(intensity[c])),
        Weight::Current { axis, weight } => {
            let to_eye = V::splat(0.0) - direction[axis];
            three!(c => V::splat(weight[c]) * to_eye)
        }
    }
}

/// `Σ weight·value` of all terms at a position.
#[inline(always)]
fn in_scatter<V: Lanes>(
    groups: &[Group],
    weights: &[[V; 3]],
    direction: [V; 3],
    position: [V; 3],
    cell: &Cell<V>,
) -> [V; 3] {
    let mut sum = [V::splat(0.0); 3];
    let mut weights = weights.iter();
    for group in groups {
        let lattice = &group.lattice;
        let own;
        let cell = if group.with_data {
            cell
        } else {
            own =
                Cell::new(lattice, three!(a => position[a] * V::splat(lattice.scale[a]) + V::splat(lattice.shift[a])));
            &own
        };
        for (term, weight) in group.terms.iter().zip(&mut weights) {
            let mut value = cell.value(lattice, &term.volume);
            if let (Some(falloff), Weight::Lamp { g, .. }) = (&term.falloff, term.weight) {
                value = value * lamp(falloff, g, direction, position);
            }
            sum = three!(c => sum[c] + weight[c] * value);
        }
    }
    three!(c => sum[c].max(V::splat(0.0)))
}

/// Extinction at `position` moved along an axis.
#[inline(always)]
fn beside<V: Lanes>(matter: &Matter, mut position: [V; 3], axis: usize, offset: f32) -> V {
    position[axis] = position[axis] + V::splat(offset);
    extinction(matter, position)
}

/// Factor on in-scattered radiance: see [`Phong`].
#[inline(always)]
pub(in crate::device::cpu) fn shade<V: Lanes>(
    matter: &Matter,
    phong: &Phong,
    direction: [V; 3],
    position: [V; 3],
    sigma: V,
) -> V {
    let gradient = three!(a => {
        let difference = beside(matter, position, a, 1.0) - beside(matter, position, a, -1.0);
        difference * V::splat(0.5 * matter.per_length[a])
    });
    let steepness = dots(gradient, gradient).sqrt();
    let per_steepness = V::splat(-1.0) / steepness.max(V::splat(1e-20));
    let normal = three!(a => gradient[a] * per_steepness);

    let light = phong.towards_light;
    let half = three!(a => V::splat(light[a]) - direction[a]);
    let zero = V::splat(0.0);
    let lambert = dot(normal, light).max(zero);
    let cos = (dots(normal, half) / dots(half, half).sqrt().max(V::splat(1e-20))).max(zero);
    let mut highlight = [0.0; 16];
    cos.store(&mut highlight);
    let highlight = V::from_fn(|l| highlight[l].powf(phong.shininess));

    let lit = V::splat(phong.ambient) + V::splat(phong.diffuse) * lambert + V::splat(phong.specular) * highlight;
    let edge = steepness * V::splat(matter.spacing);
    let gate = edge / (edge + sigma).max(V::splat(1e-20));
    V::splat(1.0) + gate * (lit - V::splat(1.0))
}

/// First sample at or after `n` that may see something; beyond the end of the ray if there is none.
#[inline(always)]
fn skip<V: Lanes>(plan: &Plan, rays: &Rays<V>, mut n: V, live: V::Mask) -> V {
    let Some(empty) = &plan.matter.empty else { return n };
    let per_step = V::splat(1.0 / plan.step);
    let beyond = rays.length * per_step + V::splat(2.0);
    loop {
        let (position, ds) = rays.sample(n);
        // The brick of the cell that the sample reads, so that rounding cannot put a sample into the wrong brick.
        let brick = three!(a => {
            let cell = position[a].max(V::splat(0.0)).min(V::splat(plan.matter.last_cell[a])).trunc();
            ((V::float(cell) + V::splat(0.5)) * V::splat(empty.per_edge)).trunc()
        });
        // SAFETY: cells are inside the grid, so their bricks are inside the layout.
        let distance = unsafe { V::gather(empty.as_ptr(), V::linear(brick, empty.stride)) };
        let skipping = live & V::splat(0.0).lt(ds) & V::splat(0.5).lt(distance);
        if !V::any(skipping) {
            return n;
        }
        // Leave the cube of empty bricks around this one.
        let mut t = V::splat(f32::MAX);
        for a in 0..3 {
            let slope = Rays::nonzero(rays.slope[a]);
            let brick = V::float(brick[a]);
            let (up, down) = (brick + distance, brick - distance + V::splat(1.0));
            let plane = V::select(slope.lt(V::splat(0.0)), down, up) * V::splat(empty.edge);
            t = ((plane - rays.start[a]) / slope).min(t);
        }
        // Samples up to `last` are inside by more than rounding errors.
        let last = t * per_step - V::splat(0.51) - n * V::splat(1e-6);
        let next = V::float(last.max(V::splat(0.0)).min(beyond).trunc()) + V::splat(1.0);
        n = V::select(skipping, next.max(n + V::splat(1.0)), n);
    }
}

/// The cell along z that a sample lies in.
#[inline(always)]
fn layer<V: Lanes>(plan: &Plan, position: [V; 3]) -> V {
    V::float(position[2].max(V::splat(0.0)).min(V::splat(plan.matter.last_cell[2])).trunc())
}

/// The samples whose cells lie in a window.
#[inline(always)]
fn within<V: Lanes>(plan: &Plan, [above, below]: [f32; 2], position: [V; 3]) -> V::Mask {
    let cell = layer(plan, position);
    V::splat(above).lt(cell) & cell.lt(V::splat(below))
}

/// Where rays wait whose next samples are `n` and see something.
#[inline(always)]
fn waiting<V: Lanes>(plan: &Plan, rays: &Rays<V>, n: V, live: V::Mask) -> [V; 2] {
    let (position, ds) = rays.sample(n);
    let (live, cell) = (live & V::splat(0.0).lt(ds), layer(plan, position));
    [V::select(live, cell, V::splat(f32::MAX)), V::select(live, cell, V::splat(-1.0))]
}

/// Where the medium is not cut away.
#[inline(always)]
pub(in crate::device::cpu) fn kept<V: Lanes>(clips: &[Clip], position: [V; 3]) -> V::Mask {
    let (zero, one) = (V::splat(0.0), V::splat(1.0));
    let mut kept = one;
    for clip in clips {
        let inside = match clip.shape {
            ClipShape::Box { low, high } => {
                let [x, y, z] = three!(a => V::splat(low[a]).lt(position[a]) & position[a].lt(V::splat(high[a])));
                x & y & z
            }
            ClipShape::Plane { normal, offset } => V::splat(offset).lt(dot(position, normal)),
        };
        let (yes, no) = if clip.invert { (zero, one) } else { (one, zero) };
        kept = kept * V::select(inside, yes, no);
    }
    zero.lt(kept)
}

/// Carries a packet of rays on.
#[inline(always)]
fn packet<V: Lanes>(plan: &Plan, at: [usize; 2], weights: &mut [[V; 3]], end: V, state: &mut State<V>) {
    let (zero, one) = (V::splat(0.0), V::splat(1.0));
    let State { mut radiance, mut through, next: mut n, .. } = *state;
    // Of the channel that dims least, where channels differ; `through` is of each then.
    let mut transmittance = through[0].max(through[1]).max(through[2]);
    let rays = Rays::<V>::new(plan, at, end);
    let mut live = zero.lt(rays.length) & V::splat(March::OPAQUE).lt(transmittance);
    // Where rays leave the window; nowhere so far.
    let mut left = V::splat(-1.0);
    if let Some(window) = plan.window {
        n = skip(plan, &rays, n, live);
        let (position, ds) = rays.sample(n);
        state.next = n;
        state.waiting = waiting(plan, &rays, n, live);
        if !V::any(live & zero.lt(ds) & within(plan, window, position)) {
            return;
        }
    }
    if !V::any(live) {
        return;
    }
    let terms = plan.groups.iter().flat_map(|group| &group.terms);
    for (lanes, of) in weights.iter_mut().zip(terms) {
        *lanes = weight(&of.weight, rays.direction);
    }

    let optics = &plan.matter.optics;
    loop {
        n = skip(plan, &rays, n, live);
        live = live & zero.lt(rays.length - n * rays.step);
        if !V::any(live) {
            break;
        }
        for _ in 0..RUN {
            let (position, ds) = rays.sample(n);
            if let Some(window) = plan.window {
                let inside = within(plan, window, position);
                left = V::select(live, V::select(inside, left, n), left);
                live = live & inside;
                if !V::any(live) {
                    break;
                }
            }
            n = n + one;
            let cell = Cell::new(&plan.matter.lattice, position);
            let half = ds * V::splat(0.5);
            let sample = Sample::new(&plan.matter, position, three!(a => half * rays.slope[a]), &cell);
            let mut inside = live & zero.lt(ds) & sample.there;
            if !plan.clips.is_empty() {
                inside = inside & kept(plan.clips, position);
            }
            let sigma = V::select(inside, sample.extinction(optics), zero);
            let seen = zero.lt(sigma);
            if !V::any(seen) && optics.emission.is_none() {
                continue;
            }
            let alpha = opacity(sigma * ds);
            let opaque = transmittance * alpha;
            let shares = match optics.chromatic {
                None => [opaque; 3],
                Some(k) => three!(c => through[c] * opacity(sigma * V::splat(k[c]) * ds)),
            };
            if V::any(seen) {
                let mut source = in_scatter(&plan.groups, weights, rays.direction, position, &cell);
                if let Some(phong) = &plan.phong {
                    let factor = shade(&plan.matter, phong, rays.direction, position, sigma);
                    source = three!(c => source[c] * factor);
                }
                let albedo = sample.albedo(optics, sigma);
                let scattered = three!(c => source[c] * albedo[c]);
                radiance = three!(c => radiance[c] + shares[c] * scattered[c]);
            }
            if let Some(emission) = &optics.emission {
                let thin = sigma * ds;
                let clear = V::select(inside, ds, zero);
                let glow = match optics.chromatic {
                    None => {
                        let path = V::select(V::splat(1e-20).lt(thin), alpha / sigma, clear);
                        [transmittance * path; 3]
                    }
                    Some(k) => three!(c => {
                        let dims = sigma * V::splat(k[c]);
                        V::select(V::splat(1e-20).lt(dims * ds), shares[c] / dims, through[c] * clear)
                    }),
                };
                radiance = three!(c => radiance[c] + glow[c] * sample.emission(optics, emission, c));
            }
            if optics.chromatic.is_some() {
                through = three!(c => through[c] - shares[c]);
                transmittance = through[0].max(through[1]).max(through[2]);
            } else {
                transmittance = transmittance - opaque;
            }
            live = live & V::splat(March::OPAQUE).lt(transmittance);
        }
    }
    if optics.chromatic.is_none() {
        through = [transmittance; 3];
    }
    let mut next = V::select(left.lt(zero), n, left);
    if plan.window.is_some() {
        // Up to a sample that sees something: only where such are need they be looked at again.
        let live = zero.lt(rays.length) & V::splat(March::OPAQUE).lt(transmittance);
        next = skip(plan, &rays, next, live);
        state.waiting = waiting(plan, &rays, next, live);
    }
    *state = State { radiance, through, next, ..*state };
}
