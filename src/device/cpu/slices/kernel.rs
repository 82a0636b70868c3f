//! reads data, table, light buffer → writes the light buffer, and one tile of pixels: see [`crate::device::slices`].
//!
//! One body for every instruction set: generic over [`Lanes`].

use std::ops::Range;

use super::super::march::kernel::{Cell, Sample, dots, kept, lamp, shade, three, weight};
use super::super::march::lanes::{Lanes, opacity};
use super::super::march::plan::Matter;
use super::plan::{Plan, Shine, Source};
use crate::device::slices::{BATCH, Beam, Casting};
use crate::device::{Clip, March, Ray, Weight};

/// Pixels, and texels, along the edge of a tile.
pub(super) const TILE: usize = March::TILE;

/// Rays of a packet in index space; distances along them in world length.
struct Rays<V> {
    start: [V; 3],
    slope: [V; 3],
    direction: [V; 3],
    /// Distances at which they enter and leave the box; `near ≥ far` where they miss it.
    near: V,
    far: V,
    /// Distance of plane 0, and from plane to plane.
    base: V,
    spacing: V,
    /// World length of the way, before it was made unit.
    norm: V,
}

impl<V: Lanes> Rays<V> {
    #[inline(always)]
    fn new(casting: &Casting, matter: &Matter, [qx, qy]: [V; 2]) -> Self {
        let blend = |middle: f32, right: f32, down: f32| V::splat(middle) + qx * V::splat(right) + qy * V::splat(down);
        let start = three!(a => blend(casting.start[a], casting.start_right[a], casting.start_down[a]));
        let way: [V; 3] = three!(a => blend(casting.way[a], casting.way_right[a], casting.way_down[a]));
        let norm = dots(way, way).sqrt();
        let direction = three!(a => way[a] / norm);
        let slope = three!(a => direction[a] * V::splat(matter.per_length[a]));
        let (mut near, mut far) = (V::splat(0.0), V::splat(f32::MAX));
        for a in 0..3 {
            let inverse = V::splat(1.0) / nonzero(slope[a]);
            let below = (V::splat(-0.5) - start[a]) * inverse;
            let above = (V::splat(matter.top[a]) - start[a]) * inverse;
            near = below.min(above).max(near);
            far = below.max(above).min(far);
        }
        let along = nonzero(dots(direction, three!(a => V::splat(casting.axis[a]))));
        let base = blend(casting.base[0], casting.base[1], casting.base[2]) / along;
        Rays { start, slope, direction, near, far, base, spacing: V::splat(casting.spacing) / along, norm }
    }

    /// Distance of a plane.
    #[inline(always)]
    fn plane(&self, i: f32) -> V {
        self.base + V::splat(i) * self.spacing
    }

    /// From where to where they are in a slab, or in a row of them; the second is not above the first where they are not.
    #[inline(always)]
    fn within(&self, slabs: &Range<usize>) -> (V, V) {
        let (a, b) = (self.plane(slabs.start as f32), self.plane(slabs.end as f32));
        (a.min(b).max(self.near), a.max(b).min(self.far))
    }

    #[inline(always)]
    fn position(&self, t: V) -> [V; 3] {
        three!(a => self.start[a] + t * self.slope[a])
    }
}

#[inline(always)]
fn nonzero<V: Lanes>(v: V) -> V {
    let tiny = V::splat(1e-20);
    V::select(v.max(V::splat(0.0) - v).lt(tiny), tiny, v)
}

/// Points of a picture, −1 to 1, of a packet's pixels.
#[inline(always)]
fn points<V: Lanes>(at: [usize; 2], picture: [usize; 2]) -> [V; 2] {
    let [w, _] = V::SHAPE;
    let (one, two, half) = (V::splat(1.0), V::splat(2.0), V::splat(0.5));
    let x = two * (V::from_fn(|l| (at[0] + l % w) as f32) + half) / V::splat(picture[0] as f32) - one;
    let y = two * (V::from_fn(|l| (at[1] + l / w) as f32) + half) / V::splat(picture[1] as f32) - one;
    [x, y]
}

/// False only when nothing can be seen along the rays between two distances.
#[inline(always)]
fn visible<V: Lanes>(matter: &Matter, rays: &Rays<V>, (from, to): (V, V)) -> bool {
    let live = from.lt(to);
    let Some(empty) = &matter.empty else { return V::any(live) };
    let half = V::splat(0.5);
    let middle = rays.position((from + to) * half);
    let brick = three!(a => {
        let cell = middle[a].max(V::splat(0.0)).min(V::splat(matter.last_cell[a])).trunc();
        ((V::float(cell) + half) * V::splat(empty.per_edge)).trunc()
    });
    // SAFETY: cells are inside the grid, so their bricks are inside the layout.
    let distance = unsafe { V::gather(empty.as_ptr(), V::linear(brick, empty.stride)) };
    // All bricks nearer than `distance` are empty: that far around the middle less the way to the edge of its own brick.
    let free = (distance - V::splat(1.0)) * V::splat(empty.edge) - V::splat(1.0);
    let mut reach = V::splat(0.0);
    for a in 0..3 {
        let along = (to - from) * half * rays.slope[a];
        reach = reach.max(along.max(V::splat(0.0) - along));
    }
    V::any(live & free.lt(reach))
}

/// What a packet looks up in the middle of an interval, and where that is.
#[inline(always)]
fn sample<V: Lanes>(matter: &Matter, rays: &Rays<V>, (from, to): (V, V)) -> (Sample<V>, [V; 3]) {
    let (position, half) = (rays.position((from + to) * V::splat(0.5)), (to - from) * V::splat(0.5));
    let cell = Cell::new(&matter.lattice, position);
    (Sample::new(matter, position, three!(a => half * rays.slope[a]), &cell), position)
}

/// Extinction in an interval; 0 in holes, where it is cut away, and where there is no interval.
#[inline(always)]
fn extinction<V: Lanes>(matter: &Matter, clips: &[Clip], rays: &Rays<V>, (from, to): (V, V)) -> V {
    let (sample, position) = sample(matter, rays, (from, to));
    let mut inside = from.lt(to);
    if !clips.is_empty() {
        inside = inside & kept(clips, position);
    }
    V::select(inside, sample.extinction(&matter.optics), V::splat(0.0))
}

/// 0 where the rays of texels meet something opaque between two distances, 1 elsewhere.
#[inline(always)]
fn passes<V: Lanes>(meets: [V; 2], (from, to): (V, V)) -> V {
    let (zero, one) = (V::splat(0.0), V::splat(1.0));
    let free = |at: V| V::select(from.lt(at), V::select(to.lt(at), one, zero), one);
    free(meets[0]) * free(meets[1])
}

/// Layout of a light buffer: rows of texels, each channel after the other; of the layers that the eye reads: rows, each layer
/// after the other.
#[derive(Clone, Copy)]
pub(super) struct Texels {
    pub size: [usize; 2],
    pub channels: usize,
}

impl Texels {
    /// Values of a row.
    pub fn row(&self) -> usize {
        self.size[0] * self.channels
    }

    pub fn len(&self) -> usize {
        self.row() * self.size[1]
    }
}

/// A texel's bilinear neighbours.
struct Corners<V: Lanes> {
    first: V::Int,
    right: V,
    below: V,
}

impl<V: Lanes> Corners<V> {
    /// Of a place on the buffer, texel (i, j) at (i, j); `stride` from row to row.
    #[inline(always)]
    fn new([x, y]: [V; 2], size: [usize; 2], stride: usize) -> Self {
        let edge = |v: V, n: usize| v.max(V::splat(0.0)).min(V::splat((n - 1) as f32));
        let low = |v: V, n: usize| v.min(V::splat((n - 2) as f32)).trunc();
        let (x, y) = (edge(x, size[0]), edge(y, size[1]));
        let (i, j) = (low(x, size[0]), low(y, size[1]));
        let none = V::splat(0.0).trunc();
        Corners { first: V::linear([i, j, none], [stride, 0]), right: x - V::float(i), below: y - V::float(j) }
    }

    /// # Safety
    /// `values` is a buffer of the size and stride that the corners are of.
    #[inline(always)]
    unsafe fn value(&self, values: *const f32, stride: usize) -> V {
        // SAFETY: corners are at most the last texel but one along each axis.
        let [(a, b), (c, d)] =
            unsafe { [V::pairs(values, self.first), V::pairs(values.wrapping_add(stride), self.first)] };
        let one = V::splat(1.0);
        let above = a * (one - self.right) + b * self.right;
        let under = c * (one - self.right) + d * self.right;
        above * (one - self.below) + under * self.below
    }
}

/// Carries the light of a band of texels through slabs; one slab at a time where it blurs. `front` is the whole buffer before
/// them, `next` receives the band behind them, `layers` the band in the middle of each.
#[inline(always)]
pub(super) fn light<V: Lanes>(
    (plan, shine): (&Plan, &Shine),
    slabs: &Range<usize>,
    band: usize,
    front: &[f32],
    next: &mut [f32],
    layers: &mut [f32],
) {
    let matter = &plan.matter;
    assert!(matter.reach <= V::REACH && front.len() <= V::REACH, "indices must fit");
    let texels = Texels { size: shine.size, channels: shine.factors.len() };
    assert!(front.len() >= texels.len() && (shine.blur == 0.0 || slabs.len() == 1));
    let [w, h] = V::SHAPE;
    let (zero, one) = (V::splat(0.0), V::splat(1.0));
    let row = texels.row();
    let mut lanes = [0.0; 16];
    for y in (0..TILE).step_by(h) {
        for x in (0..texels.size[0]).step_by(w) {
            let at = [x, band * TILE + y];
            let rays = Rays::<V>::new(&shine.casting, matter, points(at, texels.size));
            let span = rays.within(slabs);
            let idle = !visible(matter, &rays, span);
            let meets = (!shine.opaque.is_empty()).then(|| {
                [0, 1].map(|end| V::from_fn(|l| shine.opaque[(at[1] + l / w) * texels.size[0] + x + l % w][end]))
            });
            let mut store = |value: V, into: &mut [f32], stride: usize, first: usize| {
                value.store(&mut lanes);
                for r in 0..h {
                    into[first + r * stride..][..w].copy_from_slice(&lanes[r * w..][..w]);
                }
            };
            let load = |c: usize| V::from_fn(|l| front[(at[1] + l / w) * row + c * texels.size[0] + x + l % w]);
            let spread = (shine.blur > 0.0 && V::any(span.0.lt(span.1))).then(|| Spread::new(shine, &rays, span, at));
            for c in 0..texels.channels {
                let mut arriving = match &spread {
                    // SAFETY: a buffer of `texels`, from the first value of a channel on.
                    Some(spread) => unsafe { spread.blurred(front.as_ptr().wrapping_add(c * texels.size[0]), load(c)) },
                    None => load(c),
                };
                let factor = V::splat(shine.factors[c]);
                for (k, i) in slabs.clone().enumerate() {
                    let mut middle = arriving;
                    if !idle {
                        let (from, to) = rays.within(&(i..i + 1));
                        let sigma = extinction(matter, plan.clips, &rays, (from, to)) * factor;
                        let before = (rays.plane(i as f32 + 0.5).max(from) - from).min((to - from).max(zero));
                        middle = arriving * (one - opacity(sigma * before));
                        arriving = arriving * (one - opacity(sigma * (to - from).max(zero)));
                        // Two roundings must not let light grow.
                        middle = middle.max(arriving);
                    }
                    if let Some(meets) = meets {
                        let [half, to] = [rays.plane(i as f32 + 0.5), rays.plane((i + 1) as f32)];
                        // What light meets on its way to the first slab counts for that.
                        let from = if i == 0 { zero } else { rays.plane(i as f32) };
                        middle = middle * passes(meets, (from, half));
                        arriving = arriving * passes(meets, (from, to));
                    }
                    store(middle, layers, BATCH * row, y * BATCH * row + k * row + c * texels.size[0] + x);
                }
                store(arriving, next, row, y * row + c * texels.size[0] + x);
            }
        }
    }
}

/// Blur of one slab: a kernel of three by three texels, or of every `step`th where they are too fine, whose variance is that of
/// an even disk of the radius that (9) gives.
struct Spread<V: Lanes> {
    /// Nine indices, row by row.
    taps: [V::Int; 9],
    /// Weight of the neighbours along x and y.
    side: [V; 2],
}

impl<V: Lanes> Spread<V> {
    #[inline(always)]
    fn new(shine: &Shine, rays: &Rays<V>, (from, to): (V, V), at: [usize; 2]) -> Self {
        let [w, _] = V::SHAPE;
        let (zero, half) = (V::splat(0.0), V::splat(0.5));
        let lookup = &shine.lookup;
        let depth = if lookup.parallel { V::splat(1.0) } else { (from + to) * half / rays.norm };
        let variance = V::splat(shine.blur) * (to - from).max(zero);
        let column = V::from_fn(|l| (at[0] + l % w) as f32);
        let line = V::from_fn(|l| (at[1] + l / w) as f32);
        let along = |a: usize, own: V| {
            let texel = nonzero(V::splat(lookup.texel[a]) * depth);
            let texels = (variance / (texel * texel)).min(V::splat(1e12));
            let last = V::splat((shine.size[a] - 1) as f32);
            // The least distance of the outer taps at which the middle keeps at least half.
            let step = V::float((texels + texels).sqrt().min(last).trunc()) + V::splat(1.0);
            let side = (half * texels / (step * step)).min(V::splat(0.25));
            ([(own - step).max(zero).trunc(), own.trunc(), (own + step).min(last).trunc()], side)
        };
        let (xs, x_side) = along(0, column);
        let (ys, y_side) = along(1, line);
        let stride = shine.size[0] * shine.factors.len();
        let none = zero.trunc();
        let mut taps = [none; 9];
        for j in 0..3 {
            for i in 0..3 {
                taps[3 * j + i] = V::linear([xs[i], ys[j], none], [stride, 0]);
            }
        }
        Spread { taps, side: [x_side, y_side] }
    }

    /// # Safety
    /// `values` is a channel of the light buffer.
    #[inline(always)]
    unsafe fn blurred(&self, values: *const f32, own: V) -> V {
        // SAFETY: taps are clamped to the buffer.
        let at = |n: usize| unsafe { V::gather(values, self.taps[n]) };
        // Differences, so that even light stays as it is to the bit.
        let across = |j: usize| {
            let middle = at(3 * j + 1);
            middle + self.side[0] * ((at(3 * j) - middle) + (at(3 * j + 2) - middle))
        };
        let middle = across(1);
        let blurred = middle + self.side[1] * ((across(0) - middle) + (across(2) - middle));
        // Rounding must not carry light above what was there.
        let mut brightest = own;
        for n in 0..9 {
            brightest = brightest.max(at(n));
        }
        blurred.max(V::splat(0.0)).min(brightest)
    }
}

/// What a source contributes along rays; a lamp's is multiplied by its falloff at each sample.
#[inline(always)]
fn at_sample<V: Lanes>(source: &Source, constant: [V; 3], direction: [V; 3], position: [V; 3]) -> [V; 3] {
    match (&source.falloff, source.weight) {
        (Some(falloff), Weight::Lamp { g, .. }) => {
            let factor = lamp(falloff, g, direction, position);
            three!(c => constant[c] * factor)
        }
        _ => constant,
    }
}

/// Light that arrives at a position in the middle of layer `k`.
#[inline(always)]
fn arriving<V: Lanes>(shine: &Shine, layers: &[f32], k: usize, position: [V; 3]) -> [V; 3] {
    let lookup = &shine.lookup;
    let texels = Texels { size: shine.size, channels: shine.factors.len() };
    let row = three!(a => V::splat(lookup.shift[a]));
    let [a, b, c] = three!(r => {
        let of = lookup.rows[r];
        position[0] * V::splat(of.x) + position[1] * V::splat(of.y) + position[2] * V::splat(of.z) + row[r]
    });
    let q = if lookup.parallel { [a, b] } else { [a / nonzero(c), b / nonzero(c)] };
    let place = |n: usize| (q[n] + V::splat(1.0)) * V::splat(0.5 * texels.size[n] as f32) - V::splat(0.5);
    let stride = BATCH * texels.row();
    let corners = Corners::new([place(0), place(1)], texels.size, stride);
    let layer = layers.as_ptr().wrapping_add(k * texels.row());
    let (zero, one) = (V::splat(0.0), V::splat(1.0));
    // Fades within a hair, so that what two passes share of a sample on their border adds up to 1 whatever the rounding.
    let mut mine = V::select(zero.lt(c), one, zero);
    for (at, inner) in q.into_iter().zip(lookup.inner) {
        let inside = V::splat(inner) - at.max(zero - at);
        mine = mine * (inside * V::splat(0.5 / Beam::FADE) + V::splat(0.5)).max(zero).min(one);
    }
    if texels.channels == 1 {
        // SAFETY: a layer of the buffer.
        let value = unsafe { corners.value(layer, stride) } * mine;
        return [value; 3];
    }
    // SAFETY: as above, a channel further on each time.
    three!(c => unsafe { corners.value(layer.wrapping_add(c * texels.size[0]), stride) } * mine)
}

/// Carries the rays of the tile whose first pixel is `first` through slabs. `band` are the rays of whole rows from that row on.
#[inline(always)]
pub(super) fn eye<V: Lanes>(
    plan: &Plan,
    slabs: &Range<usize>,
    layers: &[f32],
    first: [usize; 2],
    window: [[usize; 2]; 2],
    band: &mut [Ray],
) {
    assert!(plan.matter.reach <= V::REACH && layers.len() <= V::REACH, "indices must fit");
    let [w, h] = V::SHAPE;
    let width = plan.picture[0];
    let mut constants = vec![[V::splat(0.0); 3]; plan.unshadowed.len()];
    let mut lanes = [[0.0; 16]; 6];
    for y in (0..TILE).step_by(h) {
        for x in (0..TILE).step_by(w) {
            let at = [first[0] + x, first[1] + y];
            if (0..2).any(|a| at[a] >= window[a][1] || at[a] < window[a][0]) {
                continue;
            }
            // Lanes beyond the picture repeat its last pixel.
            let index = |l: usize| (y + l / w).min(band.len() / width - 1) * width + (at[0] + l % w).min(width - 1);
            let mut rays = Rays::<V>::new(&plan.eye, &plan.matter, points(at, plan.picture));
            rays.far = rays.far.min(V::from_fn(|l| band[index(l)].end));
            let span = rays.within(slabs);
            if !visible(&plan.matter, &rays, span) {
                continue;
            }
            let mut through = three!(c => V::from_fn(|l| band[index(l)].transmittance[c]));
            let opaque = V::splat(March::OPAQUE);
            if plan.under && !V::any(opaque.lt(through[0].max(through[1]).max(through[2]))) {
                continue;
            }
            let mut radiance = three!(c => V::from_fn(|l| band[index(l)].radiance[c]));
            for (constant, source) in constants.iter_mut().zip(&plan.unshadowed) {
                *constant = weight(&source.weight, rays.direction);
            }
            packet(plan, slabs, layers, &rays, &constants, (&mut radiance, &mut through));
            for (value, lanes) in radiance.into_iter().chain(through).zip(&mut lanes) {
                value.store(lanes);
            }
            for l in 0..w * h {
                if at[0] + l % w < width && (y + l / w) * width < band.len() {
                    let [r, g, b, t0, t1, t2] = std::array::from_fn(|c| lanes[c][l]);
                    let ray = &mut band[(y + l / w) * width + at[0] + l % w];
                    *ray = Ray { radiance: [r, g, b], transmittance: [t0, t1, t2], ..*ray };
                }
            }
        }
    }
}

/// Carries a packet of rays through slabs.
#[inline(always)]
fn packet<V: Lanes>(
    plan: &Plan,
    slabs: &Range<usize>,
    layers: &[f32],
    rays: &Rays<V>,
    constants: &[[V; 3]],
    (radiance, through): (&mut [V; 3], &mut [V; 3]),
) {
    let (zero, one) = (V::splat(0.0), V::splat(1.0));
    let matter = &plan.matter;
    let optics = &matter.optics;
    let chromatic = optics.chromatic.unwrap_or([1.0; 3]);
    let emission = optics.emission.as_ref().filter(|_| plan.glows);
    let lit = plan.shine.as_ref().map(|shine| (shine, weight(&shine.source.weight, rays.direction)));
    for (k, i) in slabs.clone().enumerate() {
        let (from, to) = rays.within(&(i..i + 1));
        if !V::any(from.lt(to)) {
            continue;
        }
        let ds = (to - from).max(zero);
        let (sample, position) = sample(matter, rays, (from, to));
        let mut inside = zero.lt(ds) & sample.there;
        if !plan.clips.is_empty() {
            inside = inside & kept(plan.clips, position);
        }
        let sigma = V::select(inside, sample.extinction(optics), zero);
        let seen = V::any(zero.lt(sigma));
        if !seen && emission.is_none() {
            continue;
        }
        let alpha = match optics.chromatic {
            None => [opacity(sigma * ds); 3],
            Some(k) => three!(c => opacity(sigma * V::splat(k[c]) * ds)),
        };
        let mut added = [zero; 3];
        if seen {
            let mut source = [zero; 3];
            for (of, constant) in plan.unshadowed.iter().zip(constants) {
                let more = at_sample(of, *constant, rays.direction, position);
                source = three!(c => source[c] + more[c]);
            }
            if let Some((shine, constant)) = &lit {
                let weight = at_sample(&shine.source, *constant, rays.direction, position);
                let light = arriving(shine, layers, k, position);
                source = three!(c => source[c] + weight[c] * light[c]);
            }
            if let Some(phong) = &plan.phong {
                let factor = shade(matter, phong, rays.direction, position, sigma);
                source = three!(c => source[c] * factor);
            }
            let albedo = sample.albedo(optics, sigma);
            added = three!(c => alpha[c] * source[c] * albedo[c]);
        }
        if let Some(emission) = emission {
            let clear = V::select(inside, ds, zero);
            added = three!(c => {
                let dims = sigma * V::splat(chromatic[c]);
                let path = V::select(V::splat(1e-20).lt(dims * ds), alpha[c] / dims, clear);
                added[c] + path * sample.emission(optics, emission, c)
            });
        }
        if plan.under {
            *radiance = three!(c => radiance[c] + through[c] * added[c]);
        } else {
            *radiance = three!(c => added[c] + (one - alpha[c]) * radiance[c]);
        }
        *through = three!(c => through[c] * (one - alpha[c]));
    }
}
