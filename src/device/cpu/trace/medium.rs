//! The medium along a ray: brick after brick (a 3-D DDA), each with its majorant; values trilinear.

use std::ops::Range;

use glam::{IVec3, Vec3};

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
    last_cell: Vec3,
    last: Vec3,
    /// From one value to the next along each axis; 0 where there is only one.
    stride: [usize; 3],
    /// Index length per world length.
    pub per_length: Vec3,
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
    majorant: &'a [f32],
    bricks: IVec3,
    edge: f32,
    per_edge: f32,
    /// Bricks that can be crossed at once: Chebyshev distance to the nearest that is not empty.
    empty: Vec<u8>,
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
    pub position: Vec3,
    /// What is there.
    pub entry: Entry,
    /// Extinction of the channel that dims most.
    pub sigma: f32,
}

/// A ray among the bricks.
struct Walk {
    /// Index position at t = 0, and index length per world length.
    start: Vec3,
    slope: Vec3,
    inverse: Vec3,
    t: f32,
    end: f32,
    brick: IVec3,
    /// Where the ray leaves the brick along each axis.
    leave: Vec3,
}

impl Walk {
    /// The ray's part within the volume's box and `range`; `None` where there is none.
    #[inline]
    fn new(medium: &Medium, origin: Vec3, direction: Vec3, range: Range<f32>) -> Option<Self> {
        let start = origin * medium.per_length;
        let slope = direction * medium.per_length;
        // A component of nearly 0 is made tiny, so that neither 0/0 nor ∞·0 can arise.
        let nonzero = |s: f32| if s.abs() < 1e-20 { 1e-20f32.copysign(s) } else { s };
        let slope = Vec3::new(nonzero(slope.x), nonzero(slope.y), nonzero(slope.z));
        let inverse = slope.recip();
        let (low, high) = ((Vec3::splat(-0.5) - start) * inverse, (medium.last + 0.5 - start) * inverse);
        let t = low.min(high).max_element().max(range.start);
        let end = low.max(high).min_element().min(range.end);
        if t.is_nan() || end.is_nan() || t >= end {
            return None;
        }
        let mut walk = Walk { start, slope, inverse, t, end, brick: IVec3::ZERO, leave: Vec3::ZERO };
        walk.enter(medium, medium.brick_at(start + t * slope));
        Some(walk)
    }

    #[inline]
    fn enter(&mut self, medium: &Medium, brick: IVec3) {
        self.brick = brick;
        let b = brick.as_vec3();
        let ahead = Vec3::select(self.slope.cmpgt(Vec3::ZERO), b + 1.0, b);
        self.leave = (ahead * medium.edge - self.start) * self.inverse;
    }

    /// Where the ray leaves the brick, or ends.
    #[inline]
    fn exit(&self) -> f32 {
        self.leave.min_element().min(self.end)
    }

    /// On to the next brick; false behind the last.
    #[inline]
    fn step(&mut self, medium: &Medium, exit: f32) -> bool {
        self.t = exit.max(self.t);
        if exit >= self.end {
            return false;
        }
        let axis = if exit == self.leave.x {
            0
        } else if exit == self.leave.y {
            1
        } else {
            2
        };
        let up = self.slope[axis] > 0.0;
        self.brick[axis] += if up { 1 } else { -1 };
        if self.brick[axis] < 0 || self.brick[axis] >= medium.bricks[axis] {
            return false;
        }
        let plane = (self.brick[axis] + i32::from(up)) as f32 * medium.edge;
        self.leave[axis] = (plane - self.start[axis]) * self.inverse[axis];
        true
    }

    /// On to the first brick that is not within `reach` bricks of this one, all of which are empty; false behind the last.
    #[inline]
    fn leap(&mut self, medium: &Medium, reach: f32) -> bool {
        let b = self.brick.as_vec3();
        let ahead = Vec3::select(self.slope.cmpgt(Vec3::ZERO), b + reach, b - (reach - 1.0));
        let leave = (ahead * medium.edge - self.start) * self.inverse;
        let exit = leave.min_element();
        if exit >= self.end {
            return false;
        }
        self.t = exit.max(self.t);
        let axis = if exit == leave.x {
            0
        } else if exit == leave.y {
            1
        } else {
            2
        };
        let mut brick = medium.brick_at(self.start + self.t * self.slope);
        // Along the axis by which it leaves, rounding has no say.
        let up = self.slope[axis] > 0.0;
        brick[axis] = self.brick[axis] + if up { reach as i32 } else { -(reach as i32) };
        if brick[axis] < 0 || brick[axis] >= medium.bricks[axis] {
            return false;
        }
        self.enter(medium, brick);
        true
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
        let reach = |a: usize, stride: usize| if size[a] > 1 { stride } else { 0 };
        Medium {
            field: &field[..len],
            gradient: table.graded.as_ref().map(rows),
            size,
            last_cell: Vec3::from(size.map(|n| n.saturating_sub(2) as f32)),
            last: Vec3::from(size.map(|n| n as f32 - 1.0)),
            stride: [reach(0, 1), reach(1, size[0]), reach(2, size[0] * size[1])],
            per_length: Vec3::from(trace.grid.spacing.map(|s| (1.0 / s) as f32)),
            lo: table.lo,
            scale: table.scale(),
            entries: table.extinction.len(),
            extinction,
            albedo,
            emission,
            chromatic: table.chromatic.into(),
            gray: table.chromatic == [1.0; 3],
            glows: !table.emission.is_empty(),
            majorant: trace.majorant,
            bricks: IVec3::from(counts.map(|n| n as i32)),
            edge: trace.bricks.edge as f32,
            per_edge: 1.0 / trace.bricks.edge as f32,
            empty: bricks_ahead(&trace.bricks, trace.majorant),
            clips: trace.clips,
            surface: trace.surface,
        }
    }

    /// The brick of the cell at an index position.
    #[inline]
    fn brick_at(&self, position: Vec3) -> IVec3 {
        let cell = position.max(Vec3::ZERO).min(self.last).as_ivec3();
        ((cell.as_vec3() + 0.5) * self.per_edge).as_ivec3()
    }

    /// Lower corner of the cell at an index position, and where in the cell that is.
    #[inline]
    fn cell(&self, position: Vec3) -> (usize, Vec3) {
        let p = position.max(Vec3::ZERO).min(self.last);
        let cell = p.min(self.last_cell).as_ivec3();
        let [nx, ny, _] = self.size;
        ((cell.z as usize * ny + cell.y as usize) * nx + cell.x as usize, p - cell.as_vec3())
    }

    /// The field, or its gradient magnitudes, in a cell.
    #[inline]
    fn interpolate(&self, of: &[f32], (at, f): (usize, Vec3)) -> f32 {
        debug_assert_eq!(of.len(), self.field.len());
        let [x, y, z] = self.stride;
        // SAFETY: a cell's lower corner is at most the last but one along each axis that has more than one value, and the
        // stride along the others is 0, so that all corners are inside the grid, to whose length `new` has cut both.
        let v = |offset: usize| unsafe { *of.get_unchecked(at + offset) };
        let g = Vec3::ONE - f;
        // Exact at both ends, also beside a hole.
        let row = |offset: usize| v(offset) * g.x + v(offset + x) * f.x;
        let plane = |offset: usize| row(offset) * g.y + row(offset + y) * f.y;
        plane(0) * g.z + plane(z) * f.z
    }

    /// The value at an index position; below [`HOLE`] where it touches a hole.
    #[inline]
    fn value(&self, position: Vec3) -> f32 {
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

    #[inline]
    fn sigma(&self, Entry { at: (below, fraction), row: (first, down) }: Entry) -> f32 {
        let above = (below + 1).min(self.entries - 1);
        let of = |first: usize| {
            self.extinction[first + below] * (1.0 - fraction) + self.extinction[first + above] * fraction
        };
        let above = of(first);
        if down == 0.0 { above } else { above + (of(first + self.entries) - above) * down }
    }

    /// Where an index position lies in the table; `None` in holes and where the medium is cut away.
    #[inline]
    fn look(&self, position: Vec3) -> Option<Entry> {
        let cell = self.cell(position);
        let value = self.interpolate(self.field, cell);
        if value < HOLE || !self.clips.iter().all(|clip| clip.keeps(position)) {
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
    /// no. `first` is the number that draws the first free flight.
    #[inline]
    fn fly(
        &self,
        (origin, direction): (Vec3, Vec3),
        range: Range<f32>,
        first: f32,
        numbers: &mut Numbers,
        trail: &mut Trail,
        mut event: impl FnMut(&mut Numbers, &mut Trail, Vec3, f32, f32) -> bool,
    ) {
        let Some(mut walk) = Walk::new(self, origin, direction, range) else { return };
        let mut depth = -(1.0 - first).ln();
        loop {
            let b = ((walk.brick.z * self.bricks.y + walk.brick.y) * self.bricks.x + walk.brick.x) as usize;
            trail.touch(b);
            let majorant = self.majorant[b];
            if majorant > 0.0 {
                let exit = walk.exit();
                loop {
                    let ahead = depth / majorant;
                    if walk.t + ahead >= exit {
                        depth -= (exit - walk.t).max(0.0) * majorant;
                        break;
                    }
                    walk.t += ahead;
                    if !event(numbers, trail, walk.start + walk.t * walk.slope, walk.t, majorant) {
                        return;
                    }
                    depth = -(1.0 - numbers.draw()).ln();
                }
                if !walk.step(self, exit) {
                    return;
                }
            } else {
                let reach = self.empty[b];
                let on = if reach > 1 { walk.leap(self, f32::from(reach)) } else { walk.step(self, walk.exit()) };
                if !on {
                    return;
                }
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
        first: f32,
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
        self.fly(ray, range, first, numbers, trail, |numbers, trail, position, _, majorant| {
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

    /// Change of the normalised value from voxel to voxel along each axis, by central differences; holes count as 0.
    #[inline]
    pub fn gradient(&self, position: Vec3) -> Vec3 {
        let at = |offset: Vec3| {
            let value = self.value(position + offset);
            if value >= HOLE { ((value - self.lo) * self.scale).clamp(0.0, 1.0) } else { 0.0 }
        };
        0.5 * Vec3::new(at(Vec3::X) - at(-Vec3::X), at(Vec3::Y) - at(-Vec3::Y), at(Vec3::Z) - at(-Vec3::Z))
    }
}
