//! Kernels that take volumes value by value, or plane by plane with a few planes beside it: what they are cut into does not
//! matter to their results.

use std::ops::Range;

use super::store::Content;
use super::stream::Feed;
use super::{Paged, slabs, store, store_mut};
use crate::device::cpu::relax::between;
use crate::device::{Buffer, RUN};
use crate::error::Result;
use crate::grid::{Region, Slab};

impl Paged {
    /// The volumes in the inner device's memory, where all of them are there.
    pub(super) fn all_near<'a>(&self, buffers: &[&'a Buffer]) -> Option<Vec<&'a Buffer>> {
        let near = |b: &&'a Buffer| match &store(b).content {
            Content::Resident(inner, _) => Some(inner),
            _ => None,
        };
        buffers.iter().map(near).collect()
    }

    /// Calls `each` with the same run of every volume, in buffers of that length; `more` values are held beside for each value.
    /// Runs are multiples of [`RUN`] but for the last.
    pub(super) fn runs(
        &self,
        from: &[&Buffer],
        more: usize,
        mut each: impl FnMut(Range<usize>, &[&Buffer]) -> Result<()>,
    ) -> Result<()> {
        let Some(len) = from.first().map(|b| b.len()) else { return Ok(()) };
        let size = [1, 1, len];
        let weight: f64 = from.iter().map(|b| Feed::weight(store(b), size, len)).sum();
        let deepest = self.depth(len, weight + more as f64, 0.0)?;
        let run = (deepest / RUN * RUN).max(RUN);
        let parts = slabs(len, run);
        let (whole, rest) = parts.split_at(len / run);
        for parts in [whole, rest] {
            let feeds: Vec<Feed> =
                from.iter().map(|b| Feed { store: store(b), size, planes: parts.to_vec() }).collect();
            self.stream(&feeds, |n, volumes| each(parts[n].clone(), volumes))?;
        }
        Ok(())
    }

    /// Computes volumes of `size` from others, slab after slab. `make` is told which planes it has: those of the slab and up to
    /// `halo` more on both sides.
    pub(super) fn planes(
        &self,
        size: [usize; 3],
        halo: usize,
        from: &[&Buffer],
        into: &mut [&mut Buffer],
        mut make: impl FnMut(Range<usize>, &[&Buffer], &mut [&mut Buffer]) -> Result<()>,
    ) -> Result<()> {
        for out in &mut *into {
            self.prepare(store_mut(out))?;
        }
        let near = |b: &&mut Buffer| matches!(store(b).content, Content::Resident(..));
        if let Some(from) = self.all_near(from).filter(|_| into.iter().all(near)) {
            let mut into = into.iter_mut().map(|b| self.near_mut(b)).collect::<Result<Vec<_>>>()?;
            return make(0..size[2], &from, &mut into);
        }
        let plane = size[0] * size[1];
        let weight: f64 = from.iter().map(|b| Feed::weight(store(b), size, size[2])).sum();
        let each = weight + (into.len() * plane) as f64;
        let depth = self.depth(size[2], each, 2.0 * halo as f64 * each)?;
        let slabs = slabs(size[2], depth);
        let held = |slab: &Range<usize>| slab.start.saturating_sub(halo)..(slab.end + halo).min(size[2]);
        let planes: Vec<_> = slabs.iter().map(held).collect();
        let feeds: Vec<Feed> = from.iter().map(|b| Feed { store: store(b), size, planes: planes.clone() }).collect();
        let room = plane * planes.iter().map(Range::len).max().unwrap_or(0);
        let mut made = into.iter().map(|_| self.inner.alloc(room)).collect::<Result<Vec<_>>>()?;
        self.stream(&feeds, |n, volumes| {
            let (slab, held) = (&slabs[n], &planes[n]);
            make(held.clone(), volumes, &mut made.iter_mut().collect::<Vec<_>>())?;
            for (made, out) in made.iter().zip(&mut *into) {
                let own = (slab.start - held.start) * plane;
                self.put(made, own, slab.len() * plane, store_mut(out), slab.start * plane)?;
            }
            Ok(())
        })
    }

    /// See [`Device::crop`](crate::device::Device::crop).
    pub(super) fn crop_slabs(&self, size: [usize; 3], values: &Buffer, region: Region, out: &mut Buffer) -> Result<()> {
        let (from, into) = (store(values), store_mut(out));
        self.prepare(into)?;
        if let (Content::Resident(from, _), Content::Resident(into, _)) = (&from.content, &mut into.content) {
            return self.inner.crop(size, from, region, into);
        }
        let [width, height, deep] = region.size;
        let plane = width * height;
        let depth = self.depth(deep, Feed::weight(from, size, size[2]) + plane as f64, 0.0)?;
        let slabs = slabs(deep, depth);
        let start = region.start[2];
        let planes = slabs.iter().map(|s| start + s.start..start + s.end).collect();
        let mut made = self.inner.alloc(plane * depth)?;
        self.stream(&[Feed { store: from, size, planes }], |n, volumes| {
            let (x, y, held) = (region.start[0], region.start[1], slabs[n].len());
            let part = Region { start: [x, y, 0], size: [width, height, held] };
            self.inner.crop([size[0], size[1], held], volumes[0], part, &mut made)?;
            self.put(&made, 0, plane * held, into, plane * slabs[n].start)
        })
    }

    /// See [`Device::embed`](crate::device::Device::embed).
    pub(super) fn embed_slabs(
        &self,
        region: Region,
        values: &Buffer,
        size: [usize; 3],
        out: &mut Buffer,
    ) -> Result<()> {
        let (from, into) = (store(values), store_mut(out));
        self.prepare(into)?;
        if let (Content::Resident(from, _), Content::Resident(into, _)) = (&from.content, &mut into.content) {
            return self.inner.embed(region, from, size, into);
        }
        let plane = size[0] * size[1];
        let inner = region.size;
        let depth = self.depth(size[2], Feed::weight(from, inner, inner[2]) + plane as f64, 0.0)?;
        let slabs = slabs(size[2], depth);
        let within = |slab: &Range<usize>| {
            let [first, end] = [slab.start, slab.end].map(|p| p.clamp(region.start[2], region.end()[2]));
            first - region.start[2]..end - region.start[2]
        };
        let planes: Vec<_> = slabs.iter().map(within).collect();
        let mut made = self.inner.alloc(plane * depth)?;
        self.stream(&[Feed { store: from, size: inner, planes: planes.clone() }], |n, volumes| {
            let (slab, held) = (&slabs[n], planes[n].len());
            let first = (region.start[2] + planes[n].start).saturating_sub(slab.start).min(slab.len() - held);
            let part = Region { start: [region.start[0], region.start[1], first], size: [inner[0], inner[1], held] };
            self.inner.embed(part, volumes[0], [size[0], size[1], slab.len()], &mut made)?;
            self.put(&made, 0, plane * slab.len(), into, plane * slab.start)
        })
    }

    /// See [`Device::prolong`](crate::device::Device::prolong).
    pub(super) fn prolong_slabs(
        &self,
        coarse: [usize; 3],
        values: &Buffer,
        size: [usize; 3],
        into: &mut Buffer,
    ) -> Result<()> {
        let (from, to) = (store(values), store_mut(into));
        if let (Content::Resident(from, _), Content::Resident(to, _)) = (&from.content, &mut to.content) {
            return self.inner.prolong(coarse, from, size, to);
        }
        let plane = size[0] * size[1];
        let weight = Feed::weight(from, coarse, size[2]) + Feed::weight(to, size, size[2]);
        let depth = self.depth(size[2], weight + plane as f64, 4.0 * (coarse[0] * coarse[1]) as f64)?;
        let slabs = slabs(size[2], depth);
        let beside = |plane: usize| between(plane, size[2], coarse[2]);
        let below: Vec<Range<usize>> = slabs.iter().map(|s| beside(s.start).0..beside(s.end - 1).1 + 1).collect();
        let mut spares = self.spares(2, size.iter().product())?;
        let mut made = self.inner.alloc(plane * depth)?;
        let feeds = [
            Feed { store: from, size: coarse, planes: below.clone() },
            Feed { store: to, size, planes: slabs.clone() },
        ];
        self.stream(&feeds, |n, volumes| {
            let (slab, len) = (Slab { size, planes: slabs[n].clone() }, plane * slabs[n].len());
            self.inner.copy(volumes[1], 0, len, &mut made, 0)?;
            let held = Slab { size: coarse, planes: below[n].clone() };
            self.inner.prolong_slab(&held, volumes[0], &slab, &mut made)?;
            self.put(&made, 0, len, &mut spares[0], plane * slab.planes.start)
        })?;
        std::mem::swap(to, &mut spares[0]);
        self.keep_spares(spares);
        Ok(())
    }

    pub(super) fn combine_runs(&self, terms: &[(&Buffer, f32)], out: &mut Buffer) -> Result<()> {
        let into = store_mut(out);
        if terms.is_empty() && !matches!(into.content, Content::Resident(..)) {
            into.forget();
            into.content = Content::Zero;
            return Ok(());
        }
        self.prepare(into)?;
        let (volumes, weights): (Vec<&Buffer>, Vec<f32>) = terms.iter().copied().unzip();
        if let Content::Resident(inner, _) = &mut into.content
            && let Some(near) = self.all_near(&volumes)
        {
            let terms: Vec<_> = near.into_iter().zip(weights.iter().copied()).collect();
            return self.inner.combine(&terms, inner);
        }
        let mut made: Option<Buffer> = None;
        self.runs(&volumes, 1, |run, volumes| {
            let made = match &mut made {
                Some(made) if made.len() == run.len() => made,
                other => other.insert(self.inner.alloc(run.len())?),
            };
            let terms: Vec<(&Buffer, f32)> = volumes.iter().copied().zip(weights.iter().copied()).collect();
            self.inner.combine(&terms, made)?;
            self.put(made, 0, run.len(), into, run.start)
        })
    }

    /// The largest of what `of` says of the runs of two volumes.
    pub(super) fn largest_of(
        &self,
        a: &Buffer,
        b: &Buffer,
        of: impl Fn(&Buffer, &Buffer) -> Result<f32>,
    ) -> Result<f32> {
        if let Some(near) = self.all_near(&[a, b]) {
            return of(near[0], near[1]);
        }
        let mut largest = 0.0f32;
        self.runs(&[a, b], 0, |_, volumes| {
            largest = largest.max(of(volumes[0], volumes[1])?);
            Ok(())
        })?;
        Ok(largest)
    }

    pub(super) fn dot_runs(&self, a: &Buffer, b: &Buffer) -> Result<Vec<f64>> {
        if let Some(near) = self.all_near(&[a, b]) {
            return self.inner.dot_parts(near[0], near[1]);
        }
        let mut parts = Vec::new();
        self.runs(&[a, b], 0, |_, volumes| {
            parts.extend(self.inner.dot_parts(volumes[0], volumes[1])?);
            Ok(())
        })?;
        Ok(parts)
    }
}
