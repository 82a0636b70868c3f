//! Isosurfaces: see [`Surfaces`]. What its kernels share: the volume, and rays through it.

use glam::{DVec3, Vec3};

use crate::device::Clip;
use crate::device::cpu::host;
use crate::device::cpu::march::kernel::three;
use crate::device::cpu::march::lanes::Lanes;
use crate::device::surface::{Attenuation, Hit, Surface, Surfaces};
use crate::field::HOLE;

mod beauty;
mod hits;
mod light;
mod occlusion;
mod subsurface;

pub(super) use beauty::beauty;
pub(super) use hits::hits;
pub(super) use light::light;
pub(super) use occlusion::occlusion;
pub(super) use subsurface::subsurface;

/// Rays that a thread takes at a time.
const CHUNK: usize = 256;

/// Sides of a place without data.
const NOWHERE: u32 = u32::MAX;

/// Values that can be interpolated: trilinear, clamped in the rim.
struct Volume<'a> {
    values: &'a [f32],
    last: Vec3,
    last_cell: Vec3,
    /// To the neighbour along each axis; 0 along an axis with one value.
    beside: [usize; 3],
    row: usize,
    slice: usize,
}

impl<'a> Volume<'a> {
    fn new(values: &'a [f32], size: [usize; 3]) -> Self {
        assert!(size.iter().all(|n| *n > 0) && values.len() >= size.iter().product(), "values fill the grid");
        let strides = [1, size[0], size[0] * size[1]];
        Volume {
            values,
            last: Vec3::from(size.map(|n| (n - 1) as f32)),
            last_cell: Vec3::from(size.map(|n| n.saturating_sub(2) as f32)),
            beside: std::array::from_fn(|a| if size[a] > 1 { strides[a] } else { 0 }),
            row: strides[1],
            slice: strides[2],
        }
    }

    #[inline(always)]
    fn at(&self, position: Vec3) -> f32 {
        // `max` first: it turns a NaN into a number.
        let p = position.max(Vec3::ZERO).min(self.last);
        let cell = p.min(self.last_cell);
        let [i, j, k] = [cell.x as usize, cell.y as usize, cell.z as usize];
        let f = p - Vec3::new(i as f32, j as f32, k as f32);
        let first = k * self.slice + j * self.row + i;
        let [x, y, z] = self.beside;
        debug_assert!(first + x + y + z < self.values.len());
        // SAFETY: the cell's lower corner is at most the last but one along each axis, or 0 along an axis with one value, to
        // whose neighbour the step is 0; `new` has seen that the values fill the grid.
        let v = |offset: usize| unsafe { *self.values.get_unchecked(first + offset) };
        // a·lower + b·upper: exact at both ends, also beside a hole.
        let mix = |a: f32, b: f32, t: f32| a * (1.0 - t) + b * t;
        let near = mix(mix(v(0), v(x), f.x), mix(v(y), v(x + y), f.x), f.y);
        let far = mix(mix(v(z), v(x + z), f.x), mix(v(y + z), v(x + y + z), f.x), f.y);
        mix(near, far, f.z)
    }

    /// The same of a packet of positions, to the bit. The instruction set of lanes that gather must reach all values.
    #[inline(always)]
    fn along<V: Lanes>(&self, position: [V; 3]) -> V {
        let p = three!(a => position[a].max(V::splat(0.0)).min(V::splat(self.last[a])));
        let cell = three!(a => p[a].min(V::splat(self.last_cell[a])).trunc());
        let f = three!(a => p[a] - V::float(cell[a]));
        let first = V::linear(cell, [self.row, self.slice]);
        let [_, y, z] = self.beside;
        let near = mix(self.pair(0, first, f[0]), self.pair(y, first, f[0]), f[1]);
        let far = mix(self.pair(z, first, f[0]), self.pair(y + z, first, f[0]), f[1]);
        mix(near, far, f[2])
    }

    /// Between two neighbours along x, `offset` beyond the first of a cell.
    #[inline(always)]
    fn pair<V: Lanes>(&self, offset: usize, first: V::Int, t: V) -> V {
        let values = self.values.as_ptr().wrapping_add(offset);
        // SAFETY: as in `at`; along an axis with one value there is no neighbour.
        let (a, b) = unsafe {
            match self.beside[0] {
                1 => V::pairs(values, first),
                _ => (V::gather(values, first), V::gather(values, first)),
            }
        };
        mix(a, b, t)
    }
}

/// a·(1 − t) + b·t: exact at both ends, also beside a hole.
#[inline(always)]
fn mix<V: Lanes>(a: V, b: V, t: V) -> V {
    a * (V::splat(1.0) - t) + b * t
}

/// What all rays of a call share.
struct Space<'a> {
    volume: Volume<'a>,
    surfaces: &'a [Surface],
    clips: &'a [Clip],
    spacing: Vec3,
    /// Values per world length.
    per_length: Vec3,
    /// Upper corner of the box; the lower one is −½.
    top: Vec3,
    step: f32,
    mean_spacing: f32,
    eye: Vec3,
    forward: Vec3,
    /// Half a picture to the right, and upwards.
    right: Vec3,
    up: Vec3,
    picture: [usize; 2],
    empty: &'a [f32],
    /// Bricks from one row, and from one slice, to the next.
    bricks: [usize; 2],
    edge: f32,
}

/// A straight way through the box; t is world length from its start.
struct Path {
    start: Vec3,
    /// Values per world length.
    slope: Vec3,
    /// To where it leaves the box.
    length: f32,
}

impl Path {
    fn at(&self, t: f32) -> Vec3 {
        self.start + t * self.slope
    }
}

/// Where a path goes through a surface.
struct Crossing {
    t: f32,
    position: Vec3,
    surface: u32,
    before: u32,
    behind: u32,
}

impl<'a> Space<'a> {
    fn new(s: &Surfaces<'a>) -> Self {
        let grid = s.grid;
        let spacing = DVec3::from(grid.spacing);
        let aspect = s.picture[0] as f32 / s.picture[1] as f32;
        let counts = s.bricks.counts();
        let (lo, hi) = grid.bounds();
        assert!(s.surfaces.len() <= Surfaces::MOST, "at most {} surfaces", Surfaces::MOST);
        assert!(s.empty.is_empty() || s.empty.len() == s.bricks.len(), "a distance for each brick");
        Space {
            volume: Volume::new(host(s.field), grid.size),
            surfaces: s.surfaces,
            clips: s.clips,
            spacing: spacing.as_vec3(),
            per_length: spacing.recip().as_vec3(),
            top: Vec3::from(grid.size.map(|n| n as f32 - 0.5)),
            step: s.step.max((1e-6 * (hi - lo).length()) as f32),
            mean_spacing: grid.mean_spacing() as f32,
            eye: s.eye(),
            forward: s.camera.forward,
            right: s.camera.tan * aspect * s.camera.right,
            up: s.camera.tan * s.camera.up,
            picture: s.picture,
            empty: s.empty,
            bricks: [counts[0], counts[0] * counts[1]],
            edge: s.bricks.edge as f32,
        }
    }

    /// Unit direction of the ray through a pixel.
    fn way(&self, pixel: u32) -> Vec3 {
        let [w, h] = self.picture;
        let [x, y] = [pixel as usize % w, pixel as usize / w];
        let px = (2.0 * x as f32 + 1.0) / w as f32 - 1.0;
        let py = (2.0 * y as f32 + 1.0) / h as f32 - 1.0;
        (self.forward + px * self.right - py * self.up).normalize()
    }

    /// Bit k: the value is at least that of surface k.
    #[inline(always)]
    fn sides(&self, value: f32) -> u32 {
        if value < HOLE {
            return NOWHERE;
        }
        self.surfaces.iter().enumerate().fold(0, |bits, (k, s)| bits | u32::from(value >= s.value) << k)
    }

    /// False where a cut has taken away what was there.
    #[inline(always)]
    fn kept(&self, position: Vec3) -> bool {
        self.clips.iter().all(|clip| clip.keeps(position))
    }

    /// The way from `position`, which may lie outside the box, along a unit direction through it.
    fn path(&self, position: Vec3, way: Vec3) -> Path {
        let slope = way * self.per_length;
        // A component of nearly 0 counts as barely positive: neither 0/0 nor ∞·0 can arise.
        let inverse = nonzero(slope).recip();
        let (below, above) = ((Vec3::splat(-0.5) - position) * inverse, (self.top - position) * inverse);
        let near = below.min(above).max_element().max(0.0);
        let length = below.max(above).min_element() - near;
        // Also turns a NaN into a way that misses.
        let length = if length > 0.0 && length < f32::MAX { length } else { 0.0 };
        let near = if length > 0.0 { near } else { 0.0 };
        Path { start: position + near * slope, slope, length }
    }

    /// Number of the last sample that surely lies, like sample n at `position`, in bricks without a surface; n if there is none.
    #[inline(always)]
    fn leap(&self, path: &Path, position: Vec3, n: u32) -> u32 {
        if self.empty.is_empty() {
            return n;
        }
        let cell = position.max(Vec3::ZERO).min(self.volume.last_cell).trunc();
        let brick = ((cell + 0.5) / self.edge).trunc();
        let number = brick.z as usize * self.bricks[1] + brick.y as usize * self.bricks[0] + brick.x as usize;
        let distance = self.empty[number];
        if distance < 0.5 {
            return n;
        }
        let slope = nonzero(path.slope);
        let ahead = Vec3::select(slope.cmplt(Vec3::ZERO), brick - distance + 1.0, brick + distance) * self.edge;
        let t = ((ahead - path.start) / slope).min_element().min(path.length);
        (t / self.step - 0.01 - n as f32 * 1e-6).max(0.0) as u32
    }

    /// Follows a path from its start, which is on `sides`, to the first surface. Also tells ∫ρ ds to there, or to the end: ρ is
    /// the extinction of `attenuation`, else 1, and 0 where it is cut away.
    fn follow(&self, path: &Path, sides: u32, attenuation: Option<&Attenuation>) -> (Option<Crossing>, f32) {
        let table = attenuation.and_then(|a| a.table);
        let density = |position: Vec3, value: f32| match table {
            _ if !self.kept(position) => 0.0,
            Some(_) if value < HOLE => 0.0,
            Some(table) => table.extinction_of(value),
            None => 1.0,
        };
        // What differs from place to place has to be summed up everywhere.
        let differs = table.is_some() || attenuation.is_some() && !self.clips.is_empty();
        let (mut before, mut from, mut n) = (sides, 0.0, 0u32);
        let mut here = path.start;
        let mut thick = 0.0;
        let mut rho = if differs { density(here, self.volume.at(here)) } else { 1.0 };
        while from < path.length {
            let last = if differs { n } else { self.leap(path, here, n) };
            n = last.max(n + 1);
            let to = (n as f32 * self.step).min(path.length);
            here = path.at(to);
            let value = self.volume.at(here);
            let behind = self.sides(value);
            if behind != before
                && let Some(crossing) = self.crossing(path, [from, to], before, behind)
            {
                if differs {
                    let end = density(crossing.position, self.surfaces[crossing.surface as usize].value);
                    thick += 0.5 * (rho + end) * (crossing.t - from);
                } else {
                    thick = crossing.t;
                }
                return (Some(crossing), thick);
            }
            if differs {
                let end = density(here, value);
                thick += 0.5 * (rho + end) * (to - from);
                rho = end;
            } else {
                thick = to;
            }
            (before, from) = (behind, to);
        }
        (None, thick)
    }

    /// Where a path goes through a surface in a step between two sides; `None` where there is none, or it is cut away. Far behind a
    /// cut are no data: a step that begins or ends there does so at the cut.
    fn crossing(
        &self,
        path: &Path,
        [mut from, mut to]: [f32; 2],
        mut before: u32,
        mut behind: u32,
    ) -> Option<Crossing> {
        if before == NOWHERE || behind == NOWHERE {
            let ends = [from, to].map(|t| self.kept(path.at(t)));
            if ends[0] == ends[1] {
                return None;
            }
            let (mut near, mut far) = (from, to);
            for _ in 0..Surfaces::BISECTIONS {
                let middle = 0.5 * (near + far);
                if self.kept(path.at(middle)) == ends[0] { near = middle } else { far = middle }
            }
            let cut = if ends[0] { near } else { far };
            let sides = self.sides(self.volume.at(path.at(cut)));
            if ends[0] {
                (to, behind) = (cut, sides)
            } else {
                (from, before) = (cut, sides)
            }
            if before == behind || before == NOWHERE || behind == NOWHERE {
                return None;
            }
        }
        self.bisect(path, [from, to], before, behind).filter(|crossing| self.kept(crossing.position))
    }

    /// Interval bisection; `None` where there is a hole between.
    fn bisect(&self, path: &Path, [mut from, mut to]: [f32; 2], before: u32, mut behind: u32) -> Option<Crossing> {
        for _ in 0..Surfaces::BISECTIONS {
            let middle = 0.5 * (from + to);
            match self.sides(self.volume.at(path.at(middle))) {
                NOWHERE => return None,
                sides if sides == before => from = middle,
                sides => (to, behind) = (middle, sides),
            }
        }
        // Of surfaces that lie closer together than that, the first in the way.
        let crossed = before ^ behind;
        let surface = if behind & crossed != 0 { crossed.trailing_zeros() } else { crossed.ilog2() };
        Some(Crossing { t: to, position: path.at(to), surface, before, behind })
    }

    /// Gradient by central differences one value apart, in data values per world length; one-sided at the rim and beside holes.
    fn gradient(&self, position: Vec3) -> Vec3 {
        let p = position.max(Vec3::ZERO).min(self.volume.last);
        let here = self.volume.at(p);
        let component = |a: usize| {
            let beside = |offset: f32| {
                let mut q = p;
                q[a] = (p[a] + offset).max(0.0).min(self.volume.last[a]);
                let value = self.volume.at(q);
                if value < HOLE { (p[a], here) } else { (q[a], value) }
            };
            let ((low, below), (high, above)) = (beside(-1.0), beside(1.0));
            if high > low { (above - below) / (high - low) * self.per_length[a] } else { 0.0 }
        };
        Vec3::new(component(0), component(1), component(2))
    }

    /// (8): the gradient's direction turned against a ray, and its signed magnitude.
    fn normal(&self, position: Vec3, way: Vec3) -> (Vec3, f32) {
        let gradient = self.gradient(position);
        let slope = gradient.length();
        if slope <= 0.0 || !slope.is_finite() {
            return (-way, 0.0);
        }
        let normal = gradient / slope;
        if normal.dot(way) > 0.0 { (-normal, -slope) } else { (normal, slope) }
    }

    /// Direction in which the viewer looks at a hit.
    fn towards(&self, hit: &Hit) -> Vec3 {
        ((Vec3::from(hit.position) - self.eye) * self.spacing).normalize_or(self.forward)
    }
}

/// Components that can be divided by.
#[inline(always)]
fn nonzero(v: Vec3) -> Vec3 {
    Vec3::select(v.abs().cmplt(Vec3::splat(1e-20)), Vec3::splat(1e-20), v)
}
