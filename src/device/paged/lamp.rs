//! Light from a point slab after slab, outward from the point: upwards, then downwards.

use std::ops::{Range, RangeInclusive};

use super::store::Content;
use super::stream::Feed;
use super::{Paged, store, store_mut};
use crate::device::{Buffer, PointSweep};
use crate::error::Result;
use crate::grid::BrickLayout;

impl Paged {
    /// Edges of the bricks that slabs are made of: the largest that fits. Bricks on both sides of the light's plane would need
    /// each other's light, so none ends there.
    const EDGES: RangeInclusive<usize> = 8..=16;

    /// See [`Device::sweep_point`](crate::device::Device::sweep_point).
    pub(super) fn sweep_point_slabs(
        &self,
        sweep: &PointSweep,
        layout: &BrickLayout,
        sigma: &Buffer,
        rho: &mut Buffer,
        fronts: &[&[u32]],
    ) -> Result<Vec<f32>> {
        self.prepare_in(store_mut(rho), self.precision)?;
        if let Some(near) = self.all_near(&[sigma]).filter(|_| matches!(store(rho).content, Content::Resident(..))) {
            return self.inner.sweep_point(sweep, layout, near[0], self.near_mut(rho)?, fronts);
        }
        let [nx, ny, nz] = sweep.size;
        let (plane, sigma) = (nx * ny, store(sigma));
        let weight = Feed::weight(sigma, sweep.size, nz);
        let each = weight + plane as f64;
        // Two planes beside a slab on both sides, and light of one on each.
        let more = 4.0 * each + 2.0 * plane as f64;
        let deep = |edge: usize| {
            let layers = nz.div_ceil(edge);
            Ok::<_, crate::Error>((edge, self.depth(layers, edge.min(nz) as f64 * each, more)?))
        };
        let whole = |edge: &usize| sweep.fraction[2] == 0.0 || sweep.cell[2] % *edge as i32 != 0;
        let mut edges = Self::EDGES.rev().filter(whole);
        let largest = deep(edges.next().expect("no number divides by all"));
        let (edge, layers) = edges.fold(largest, |found, edge| found.or_else(|_| deep(edge)))?;
        let bricks = BrickLayout::new(sweep.size, edge);
        let [across, along, count] = bricks.counts();
        let of_light = sweep.cell[2].clamp(0, nz as i32 - 1) as usize / edge;
        let up = (of_light..count).step_by(layers).map(|l| l..(l + layers).min(count));
        let down = (0..of_light).rev().step_by(layers).map(|l| (l + 1).saturating_sub(layers)..l + 1);
        let order: Vec<Range<usize>> = up.chain(down).collect();
        let own: Vec<Range<usize>> = order.iter().map(|l| l.start * edge..(l.end * edge).min(nz)).collect();
        let held: Vec<Range<usize>> = own.iter().map(|p| p.start.saturating_sub(2)..(p.end + 2).min(nz)).collect();
        let room = plane * held.iter().map(Range::len).max().unwrap_or(0);
        let feed = Feed { store: sigma, size: sweep.size, planes: held.clone() };
        let mut light = self.inner.alloc(room)?;
        // The lowest and the highest plane that is done.
        let mut faces = [self.inner.alloc(plane)?, self.inner.alloc(plane)?];
        let all = sweep.fronts(&bricks);
        self.stream(&[feed], |n, volumes| {
            let (own, held) = (&own[n], &held[n]);
            let at = |z: usize| plane * (z - held.start);
            let upward = own.start >= of_light * edge;
            if n > 0 {
                let (face, to) = if upward { (&faces[1], own.start - 1) } else { (&faces[0], own.end) };
                self.inner.copy(face, 0, plane, &mut light, at(to))?;
            }
            let here = |b: &&u32| order[n].contains(&(**b as usize / (across * along)));
            let fronts: Vec<Vec<u32>> = all.iter().map(|f| f.iter().filter(here).copied().collect()).collect();
            let fronts: Vec<&[u32]> = fronts.iter().map(|f| &f[..]).filter(|f| !f.is_empty()).collect();
            let slab = PointSweep { plane: held.start, ..*sweep };
            self.inner.sweep_point(&slab, &bricks, volumes[0], &mut light, &fronts)?;
            if n == 0 || !upward {
                self.inner.copy(&light, at(own.start), plane, &mut faces[0], 0)?;
            }
            if upward {
                self.inner.copy(&light, at(own.end - 1), plane, &mut faces[1], 0)?;
            }
            self.put(&light, at(own.start), plane * own.len(), store_mut(rho), plane * own.start)
        })?;
        Ok(vec![f32::INFINITY; fronts.iter().map(|f| f.len()).sum()])
    }
}
