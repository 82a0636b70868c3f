//! The medium along a ray: brick after brick (a 3-D DDA), each with its majorant; values trilinear.

use std::ops::Range;

use glam::{IVec3, Vec3, Vec3A};

use super::Trail;
use super::numbers::Numbers;
use crate::device::cpu::march;
use crate::device::{Clip, Surface, Trace};
use crate::field::HOLE;
use crate::grid::BrickLayout;
use crate::transfer::Graded;

/// What a ray meets, in a form for kernels. Positions are world lengths from value (0, 0, 0).
pub(super) struct Medium<'a> {
    field: &'a [f32],
    /// Gradient magnitudes, rows of the table for a unit of them, and the last row; where the table has rows.
    gradient: Option<(&'a [f32], f32, f32)>,
    /// Values along x, y, z.
    size: [usize; 3],
    /// Lower corner of the last cell.
    last_cell: Vec3A,
    last: Vec3A,
    /// From one value to the next along each axis; 0 where there is only one.
    stride: [usize; 3],
    /// Index length per world length.
    pub per_length: Vec3A,
    lo: f32,
    scale: f32,
    entries: usize,
    extinction: &'a [f32],
    albedo: &'a [[f32; 3]],
    emission: &'a [[f32; 3]],
    /// Factor on extinction per channel.
    chromatic: Vec3,
    gray: bool,
    pub glows: bool,
    /// For each brick its majorant; where that is 0, less the number of bricks that can be crossed at once.
    bounds: Vec<f32>,
    /// From one brick to the next along each axis.
    stride_of_bricks: IVec3,
    edge: f32,
    per_edge: f32,
    clips: &'a [Clip],
    pub surface: Option<Surface<'a>>,
}

/// How many bricks a ray may cross at once from each: the Chebyshev distance to the nearest in which anything can be met; 0 in
/// such a brick.
pub(crate) fn bricks_ahead(bricks: &BrickLayout, majorant: &[f32]) -> Vec<u8> {
    march::distances(bricks, majorant).into_iter().map(|d| d as u8).collect()
}

/// Where a position lies in the table.
#[derive(Clone, Copy)]
pub(super) struct Entry {
    /// Entry below, and fraction of the way to the next.
    pub at: (usize, f32),
    /// Where its row begins, and fraction of the way to the next row.
    row: (usize, f32),
}

/// Where a path collides.
pub(super) struct Collision {
    /// World length along the ray.
    pub t: f32,
    /// Index position.
    pub position: Vec3A,
    /// What is there.
    pub entry: Entry,
    /// Extinction of the channel that dims most.
    pub sigma: f32,
}

/// A ray among the bricks. Numbers of bricks and of the planes between them are whole numbers in floats.
struct Walk {
    /// Index position at t = 0, and index length per world length.
    start: Vec3A,
    slope: Vec3A,
    inverse: Vec3A,
    /// 1 or −1: which way it goes.
    way: Vec3A,
    t: f32,
    end: f32,
    /// Plane at which the ray leaves the brick along each axis, and t there.
    plane: Vec3A,
    leave: Vec3A,
    /// Number of the brick, and what is added to it for a step along each axis.
    brick: i32,
    stride: IVec3,
}

impl Walk {
    /// The ray's part within the volume's box and `range`; `None` where there is none.
    #[inline]
    fn new(medium: &Medium, origin: Vec3, direction: Vec3, range: Range<f32>) -> Option<Self> {
        let start = Vec3A::from(origin) * medium.per_length;
        let slope = Vec3A::from(direction) * medium.per_length;
        let way = Vec3A::select(slope.cmpge(Vec3A::ZERO), Vec3A::ONE, Vec3A::NEG_ONE);
        // A component of nearly 0 is made tiny, so that neither 0/0 nor ∞·0 can arise.
        let slope = Vec3A::select(slope.abs().cmplt(Vec3A::splat(1e-20)), 1e-20 * way, slope);
        let inverse = slope.recip();
        let (low, high) = ((Vec3A::splat(-0.5) - start) * inverse, (medium.last + 0.5 - start) * inverse);
        let t = low.min(high).max_element().max(range.start);
        let end = low.max(high).min_element().min(range.end);
        if t.is_nan() || end.is_nan() || t >= end {
            return None;
        }
        let (plane, leave, stride) = (Vec3A::ZERO, Vec3A::ZERO, way.as_ivec3() * medium.stride_of_bricks);
        let mut walk = Walk { start, slope, inverse, way, t, end, plane, leave, brick: 0, stride };
        walk.enter(medium, medium.brick_at(start + t * slope));
        Some(walk)
    }

    #[inline]
    fn enter(&mut self, medium: &Medium, brick: Vec3A) {
        self.plane = brick + 0.5 * (self.way + 1.0);
        self.leave = self.at(medium, self.plane);
        let b = brick.as_ivec3() * medium.stride_of_bricks;
        self.brick = b.x + b.y + b.z;
    }

    /// t at planes. The first bricks reach as far as the box does, half a value beyond theirs; the last reach farther.
    #[inline]
    fn at(&self, medium: &Medium, plane: Vec3A) -> Vec3A {
        let position = Vec3A::select(plane.cmple(Vec3A::ZERO), Vec3A::NEG_ONE, plane * medium.edge);
        (position - self.start) * self.inverse
    }

    /// Where the ray leaves the brick, or ends.
    #[inline]
    fn exit(&self) -> f32 {
        self.leave.min_element().min(self.end)
    }

    /// On to the next brick; false behind the last. Through an edge between bricks it goes along both axes at once.
    #[inline]
    fn step(&mut self, medium: &Medium, exit: f32) -> bool {
        self.t = exit.max(self.t);
        let axes = self.leave.cmple(Vec3A::splat(exit));
        self.plane += Vec3A::select(axes, self.way, Vec3A::ZERO);
        self.leave = self.at(medium, self.plane);
        let axes = axes.bitmask() as i32;
        self.brick += (axes & 1) * self.stride.x + (axes >> 1 & 1) * self.stride.y + (axes >> 2 & 1) * self.stride.z;
        exit < self.end
    }

    /// On to the first brick that is not within `reach` bricks of this one, all of which are empty; false behind the last.
    #[inline]
    fn leap(&mut self, medium: &Medium, reach: f32) -> bool {
        let plane = self.plane + (reach - 1.0) * self.way;
        let leave = self.at(medium, plane);
        let exit = leave.min_element();
        self.t = exit.max(self.t);
        let up = 0.5 * (self.way + 1.0);
        // Along the axis by which it leaves, rounding has no say.
        let brick = medium.brick_at(self.start + self.t * self.slope);
        let brick = Vec3A::select(leave.cmple(Vec3A::splat(exit)), plane + self.way - up, brick);
        self.enter(medium, brick);
        exit < self.end
    }
}

impl<'a> Medium<'a> {
    /// `gradient`: the magnitudes of `trace.gradient`.
    pub fn new(trace: &Trace<'a>, field: &'a [f32], gradient: Option<&'a [f32]>) -> Self {
        let (size, len) = (trace.grid.size, trace.grid.len());
        let table = trace.table;
        let (extinction, albedo, emission) = table.columns();
        let rows = |graded: &Graded| {
            let gradient = gradient.expect("a two-dimensional table comes with gradients");
            (&gradient[..len], graded.scale(), (graded.rows() - 1) as f32)
        };
        let counts = trace.bricks.counts();
        let ahead = bricks_ahead(&trace.bricks, trace.majorant);
        let bound = |(majorant, ahead): (&f32, u8)| if *majorant > 0.0 { *majorant } else { -f32::from(ahead) };
        let bounds = trace.majorant.iter().zip(ahead).map(bound);
        let reach = |a: usize, stride: usize| if size[a] > 1 { stride } else { 0 };
        Medium {
            field: &field[..len],
            gradient: table.graded.as_ref().map(rows),
            size,
            last_cell: Vec3A::from(size.map(|n| n.saturating_sub(2) as f32)),
            last: Vec3A::from(size.map(|n| n as f32 - 1.0)),
            stride: [reach(0, 1), reach(1, size[0]), reach(2, size[0] * size[1])],
            per_length: Vec3A::from(trace.grid.spacing.map(|s| (1.0 / s) as f32)),
            lo: table.lo,
            scale: table.scale(),
            entries: table.extinction.len(),
            extinction,
            albedo,
            emission,
            chromatic: table.chromatic.into(),
            gray: table.chromatic == [1.0; 3],
            glows: !table.emission.is_empty(),
            bounds: bounds.collect(),
            stride_of_bricks: IVec3::new(1, counts[0] as i32, (counts[0] * counts[1]) as i32),
            edge: trace.bricks.edge as f32,
            per_edge: 1.0 / trace.bricks.edge as f32,
            clips: trace.clips,
            surface: trace.surface,
        }
    }

    /// The brick of the cell at an index position.
    #[inline]
    fn brick_at(&self, position: Vec3A) -> Vec3A {
        let cell = position.max(Vec3A::ZERO).min(self.last).trunc();
        ((cell + 0.5) * self.per_edge).trunc()
    }

    /// Lower corner of the cell at an index position, and where in the cell that is.
    #[inline(always)]
    fn cell(&self, position: Vec3A) -> (usize, Vec3A) {
        let p = position.max(Vec3A::ZERO).min(self.last);
        let cell = p.min(self.last_cell).as_ivec3();
        let [nx, ny, _] = self.size;
        ((cell.z as usize * ny + cell.y as usize) * nx + cell.x as usize, p - cell.as_vec3a())
    }

    /// The field, or its gradient magnitudes, in a cell.
    #[inline(always)]
    fn interpolate(&self, of: &[f32], (at, f): (usize, Vec3A)) -> f32 {
        debug_assert_eq!(of.len(), self.field.len());
        let [x, y, z] = self.stride;
        // SAFETY: a cell's lower corner is at most the last but one along each axis that has more than one value, and the
        // stride along the others is 0, so that all corners are inside the grid, to whose length `new` has cut both.
        let v = |offset: usize| unsafe { *of.get_unchecked(at + offset) };
        let corners = [v(0), v(x), v(y), v(x + y), v(z), v(x + z), v(y + z), v(x + y + z)];
        let g = Vec3A::ONE - f;
        // Exact at both ends, also beside a hole.
        let rows = [0, 2, 4, 6].map(|i| corners[i] * g.x + corners[i + 1] * f.x);
        let planes = [0, 2].map(|i| rows[i] * g.y + rows[i + 1] * f.y);
        planes[0] * g.z + planes[1] * f.z
    }

    /// The value at an index position; below [`HOLE`] where it touches a hole.
    #[inline]
    fn value(&self, position: Vec3A) -> f32 {
        self.interpolate(self.field, self.cell(position))
    }

    /// A column of one row of the table at an entry.
    #[inline]
    pub fn column<const N: usize>(column: &[[f32; N]], (below, fraction): (usize, f32)) -> [f32; N] {
        let (a, b) = (column[below], column[(below + 1).min(column.len() - 1)]);
        std::array::from_fn(|c| a[c] * (1.0 - fraction) + b[c] * fraction)
    }

    /// A colour of the table.
    #[inline]
    fn colour(&self, column: &[[f32; 3]], Entry { at, row: (first, down) }: Entry) -> Vec3 {
        let of = |first: usize| Vec3::from(Self::column(&column[first..first + self.entries], at));
        let above = of(first);
        // The same to the bit where rows are alike.
        if down == 0.0 { above } else { above + (of(first + self.entries) - above) * down }
    }

    /// Single-scattering albedo.
    #[inline]
    pub fn albedo(&self, entry: Entry) -> Vec3 {
        self.colour(self.albedo, entry)
    }

    #[inline(always)]
    fn sigma(&self, Entry { at: (below, fraction), row: (first, down) }: Entry) -> f32 {
        let above = (below + 1).min(self.entries - 1);
        let of = |first: usize| {
            self.extinction[first + below] * (1.0 - fraction) + self.extinction[first + above] * fraction
        };
        let above = of(first);
        if down == 0.0 { above } else { above + (of(first + self.entries) - above) * down }
    }

    /// Where an index position lies in the table; `None` in holes and where the medium is cut away.
    #[inline(always)]
    fn look(&self, position: Vec3A) -> Option<Entry> {
        let cell = self.cell(position);
        let value = self.interpolate(self.field, cell);
        if value < HOLE || !self.clips.iter().all(|clip| clip.keeps(position.into())) {
            return None;
        }
        let at = ((value - self.lo) * self.scale).clamp(0.0, 1.0) * (self.entries - 1) as f32;
        let below = (at as usize).min(self.entries.max(2) - 2);
        let row = self.gradient.map_or((0, 0.0), |(gradient, scale, last)| {
            let at = (self.interpolate(gradient, cell) * scale).clamp(0.0, last);
            let row = (at as usize).min(last as usize - 1);
            (row * self.entries, at - row as f32)
        });
        Some(Entry { at: (below, at - below as f32), row })
    }

    /// Calls `event` at each tentative collision along a part of a ray, with the position, t and the majorant there, until it says
    /// no. `first` is the number that draws the first free flight; the camera's when there is none.
    #[inline]
    fn fly(
        &self,
        (origin, direction): (Vec3, Vec3),
        range: Range<f32>,
        first: Option<f32>,
        numbers: &mut Numbers,
        trail: &mut Trail,
        mut event: impl FnMut(&mut Numbers, &mut Trail, Vec3A, f32, f32) -> bool,
    ) {
        let Some(mut walk) = Walk::new(self, origin, direction, range) else { return };
        let mut depth = -(1.0 - first.unwrap_or_else(|| numbers.pair(2)[0])).ln();
        // Within the box, which lies within the bricks, there is always one.
        while let Some(&bound) = self.bounds.get(walk.brick as usize) {
            trail.touch(walk.brick as usize);
            let on = if bound > 0.0 {
                let exit = walk.exit();
                loop {
                    let rest = (exit - walk.t).max(0.0) * bound;
                    if depth >= rest {
                        depth -= rest;
                        break;
                    }
                    walk.t += depth / bound;
                    if !event(numbers, trail, walk.start + walk.t * walk.slope, walk.t, bound) {
                        return;
                    }
                    depth = -(1.0 - numbers.draw()).ln();
                }
                walk.step(self, exit)
            } else if bound < -1.0 {
                walk.leap(self, -bound)
            } else {
                walk.step(self, walk.exit())
            };
            if !on {
                return;
            }
        }
    }

    /// Delta tracking along a part of a ray. `weight` is multiplied by what the path is worth after it, `glow` takes what glows on the
    /// way.
    #[inline]
    pub fn collide(
        &self,
        ray: (Vec3, Vec3),
        range: Range<f32>,
        first: Option<f32>,
        numbers: &mut Numbers,
        weight: &mut Vec3,
        glow: &mut Vec3,
        trail: &mut Trail,
    ) -> Option<Collision> {
        let mut found = None;
        self.fly(ray, range, first, numbers, trail, |numbers, trail, position, t, majorant| {
            let Some(entry) = self.look(position) else { return true };
            let sigma = self.sigma(entry);
            if self.glows {
                *glow += *weight * self.colour(self.emission, entry) / majorant;
            }
            trail.exceeded += u64::from(sigma > majorant * 1.0001);
            let xi = numbers.draw();
            if self.gray {
                if xi * majorant < sigma {
                    found = Some(Collision { t, position, entry, sigma });
                    return false;
                }
                return true;
            }
            let sigmas = sigma * self.chromatic;
            let chance = (weight.dot(sigmas) / (weight.element_sum() * majorant).max(f32::MIN_POSITIVE)).min(1.0);
            if xi < chance {
                *weight *= sigmas / (majorant * chance);
                found = Some(Collision { t, position, entry, sigma });
                return false;
            }
            *weight *= (majorant - sigmas).max(Vec3::ZERO) / (majorant * (1.0 - chance));
            true
        });
        found
    }

    /// Ratio tracking: an unbiased estimate of the transmittance along a part of a ray.
    #[inline]
    pub fn transmittance(
        &self,
        ray: (Vec3, Vec3),
        range: Range<f32>,
        numbers: &mut Numbers,
        trail: &mut Trail,
    ) -> Vec3 {
        let mut left = Vec3::ONE;
        let first = numbers.draw();
        self.fly(ray, range, Some(first), numbers, trail, |numbers, trail, position, _, majorant| {
            let Some(entry) = self.look(position) else { return true };
            let sigma = self.sigma(entry);
            trail.exceeded += u64::from(sigma > majorant * 1.0001);
            left *= (1.0 - sigma / majorant * self.chromatic).max(Vec3::ZERO);
            let most = left.max_element();
            if most < Self::FAINT {
                // What is hardly worth following is followed rarely.
                if most == 0.0 || numbers.draw() >= 0.5 {
                    left = Vec3::ZERO;
                    return false;
                }
                left *= 2.0;
            }
            true
        });
        left
    }

    /// Transmittance below which a shadow ray goes on in every second case only.
    const FAINT: f32 = 0.1;

    /// Change of the normalised value along each axis across the cell at an index position; 0 beside holes.
    #[inline]
    pub fn slope(&self, position: Vec3A) -> Vec3 {
        let ((at, f), [x, y, z]) = (self.cell(position), self.stride);
        let v = |offset: usize| self.field[at + offset];
        let low = [v(0), v(x), v(y), v(x + y)];
        let high = [v(z), v(x + z), v(y + z), v(x + y + z)];
        if low.iter().chain(&high).any(|v| *v < HOLE) {
            return Vec3::ZERO;
        }
        let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
        let along_x =
            mix(mix(low[1] - low[0], low[3] - low[2], f.y), mix(high[1] - high[0], high[3] - high[2], f.y), f.z);
        let along_y =
            mix(mix(low[2] - low[0], low[3] - low[1], f.x), mix(high[2] - high[0], high[3] - high[1], f.x), f.z);
        let along_z =
            mix(mix(high[0] - low[0], high[1] - low[1], f.x), mix(high[2] - low[2], high[3] - low[3], f.x), f.y);
        self.scale * Vec3::new(along_x, along_y, along_z)
    }

    /// Change of the normalised value from voxel to voxel along each axis, by central differences; holes count as 0.
    #[inline]
    pub fn gradient(&self, position: Vec3A) -> Vec3 {
        let at = |offset: Vec3A| {
            let value = self.value(position + offset);
            if value >= HOLE { ((value - self.lo) * self.scale).clamp(0.0, 1.0) } else { 0.0 }
        };
        0.5 * Vec3::new(at(Vec3A::X) - at(-Vec3A::X), at(Vec3A::Y) - at(-Vec3A::Y), at(Vec3A::Z) - at(-Vec3A::Z))
    }
}
