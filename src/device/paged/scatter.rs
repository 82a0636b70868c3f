//! Scattered light slab after slab: ordinates that travel downwards pass all slabs first, then those that travel upwards.
//! Between two slabs only the radiance of one plane is kept, for each ordinate.

use std::ops::Range;

use super::store::Content;
use super::stream::Feed;
use super::{Paged, slabs, store, store_mut};
use crate::device::cpu::transport::extremes;
use crate::device::{Buffer, Passage, SourceTerm, Sweep, Transport};
use crate::error::Result;
use crate::grid::Grid;

/// Planes that a device may hold beside those of a slab: radiance of two layers of up to eight ordinates.
const LAYERS: usize = 16;

impl Paged {
    /// See [`Device::transport`](crate::device::Device::transport).
    pub(super) fn transport_slabs(
        &self,
        t: &Transport,
        phi: &mut Buffer,
        mut current: Option<[&mut Buffer; 3]>,
    ) -> Result<(f32, f32)> {
        let fields: Vec<&Buffer> = [t.sigma, t.source].into_iter().chain(t.gradient.into_iter().flatten()).collect();
        self.prepare(store_mut(phi))?;
        for part in current.iter_mut().flatten() {
            self.prepare(store_mut(part))?;
        }
        let is_near = |b: &Buffer| matches!(store(b).content, Content::Resident(..));
        let sums_near = is_near(phi) && current.iter().flatten().all(|b| is_near(b));
        if let Some(near) = self.all_near(&fields).filter(|_| sums_near) {
            let gradient = t.gradient.map(|_| [near[2], near[3], near[4]]);
            let t = Transport { sigma: near[0], source: near[1], gradient, ..*t };
            let current = match current {
                Some([x, y, z]) => Some([self.near_mut(x)?, self.near_mut(y)?, self.near_mut(z)?]),
                None => None,
            };
            return self.inner.transport(&t, self.near_mut(phi)?, current);
        }
        let (size, len) = (t.grid.size, t.grid.len());
        let plane = size[0] * size[1];
        let parts = if current.is_some() { 4 } else { 1 };
        let upward = |o: &&crate::device::Ordinate| Sweep::new(t.grid, o.direction, false).ascending()[2];
        let up = t.ordinates.iter().filter(upward).count();
        let faces = up.max(t.ordinates.len() - up);
        // What the first pass leaves of φ and J, and the new φ: the old one is needed to the end.
        let mut sums = self.spares(parts + 1, len)?;
        let mut fresh = sums.pop().expect("one more than parts");

        let weight: f64 = fields.iter().map(|b| Feed::weight(store(b), size, size[2])).sum();
        let sums_weight: f64 = sums.iter().map(|s| Feed::weight(s, size, size[2])).sum();
        // The device has sums of its own, what it has turned, and the faces of slabs of its own.
        let own = (3 * parts + fields.len()) * plane;
        let each = weight + sums_weight + Feed::weight(store(phi), size, size[2]) + own as f64;
        let more = weight + ((parts + 4 * faces + LAYERS) * plane) as f64;
        let depth = self.depth(size[2], each, more)?;
        let slabs = slabs(size[2], depth);
        let mut made = (0..parts).map(|_| self.inner.alloc(plane * (depth + 1))).collect::<Result<Vec<_>>>()?;
        let [mut entry, mut exit] = [self.inner.alloc(faces * plane)?, self.inner.alloc(faces * plane)?];
        let mut pass = |n: usize, ascending: bool, held: &Range<usize>, fields: &[&Buffer], made: &mut [Buffer]| {
            let grid = Grid { size: [size[0], size[1], held.len()], ..*t.grid };
            let slab = Transport {
                grid: &grid,
                ordinates: t.ordinates,
                sigma: fields[0],
                source: fields[1],
                gradient: t.gradient.map(|_| [fields[2], fields[3], fields[4]]),
            };
            let passage = Passage { ascending, given: n > 0, added: ascending };
            let [phi, current @ ..] = made else { unreachable!("φ is summed") };
            let current = match current {
                [x, y, z] => Some([x, y, z]),
                _ => None,
            };
            self.inner.transport_slab(&slab, &passage, (&entry, &mut exit), phi, current)?;
            std::mem::swap(&mut entry, &mut exit);
            Ok::<_, crate::Error>(())
        };
        let feeds = |planes: &[Range<usize>]| -> Vec<Feed> {
            fields.iter().map(|b| Feed { store: store(b), size, planes: planes.to_vec() }).collect()
        };

        let down: Vec<Range<usize>> = slabs.iter().rev().cloned().collect();
        let held: Vec<_> = down.iter().map(|s| s.start..(s.end + 1).min(size[2])).collect();
        self.stream(&feeds(&held), |n, volumes| {
            pass(n, false, &held[n], volumes, &mut made)?;
            for (made, sum) in made.iter().zip(&mut sums) {
                self.put(made, 0, plane * down[n].len(), sum, plane * down[n].start)?;
            }
            Ok(())
        })?;

        let held: Vec<_> = slabs.iter().map(|s| s.start.saturating_sub(1)..s.end).collect();
        let mut all = feeds(&held);
        let own = sums.iter().chain([store(phi)]);
        all.extend(own.map(|store| Feed { store, size, planes: slabs.clone() }));
        let (mut change, mut peak) = (0.0f32, 0.0f32);
        let mut room = [vec![], vec![]];
        self.stream(&all, |n, volumes| {
            let (volumes, sums) = volumes.split_at(fields.len());
            let (start, len) = (plane * slabs[n].start, plane * slabs[n].len());
            let at = if n > 0 { plane } else { 0 };
            for (sum, made) in sums.iter().zip(&mut made) {
                self.inner.copy(sum, 0, len, made, at)?;
            }
            pass(n, true, &held[n], volumes, &mut made)?;
            let [now, before] = &mut room;
            let (now, before) = (self.on_host(&made[0], at, len, now)?, self.on_host(sums[parts], 0, len, before)?);
            let (changed, most) = extremes(now, before);
            (change, peak) = (change.max(changed), peak.max(most));
            self.put(&made[0], at, len, &mut fresh, start)?;
            for (made, out) in made[1..].iter().zip(current.iter_mut().flatten()) {
                self.put(made, at, len, store_mut(out), start)?;
            }
            Ok(())
        })?;
        std::mem::swap(store_mut(phi), &mut fresh);
        sums.push(fresh);
        self.keep_spares(sums);
        Ok((change, peak))
    }

    /// See [`Device::source`](crate::device::Device::source).
    pub(super) fn source_slabs(
        &self,
        term: &SourceTerm,
        source: &mut Buffer,
        gradient: Option<[&mut Buffer; 3]>,
    ) -> Result<()> {
        let (lights, glows, linear) = (term.first.len(), term.emission.is_some(), term.current.is_some());
        let mut from = vec![term.sigma, term.scattering, term.phi];
        from.extend(term.first.iter().map(|f| f.0));
        from.extend(term.emission);
        from.extend(term.current.iter().flat_map(|(j, _)| j));
        let mut into = vec![source];
        into.extend(gradient.into_iter().flatten());
        self.planes(term.grid.size, 0, &from, &mut into, |held, volumes, made| {
            let first: Vec<_> =
                volumes[3..].iter().zip(term.first).map(|(v, (_, e, travel))| (*v, *e, *travel)).collect();
            let rest = &volumes[3 + lights..];
            let j = &rest[usize::from(glows)..];
            let [source, gradient @ ..] = made else { unreachable!("there is a source") };
            let term = SourceTerm {
                sigma: volumes[0],
                scattering: volumes[1],
                phi: volumes[2],
                first: &first,
                emission: glows.then(|| rest[0]),
                current: term.current.filter(|_| linear).map(|(_, weight)| ([j[0], j[1], j[2]], weight)),
                grid: term.grid,
                plane: term.plane + held.start,
            };
            let gradient = match gradient {
                [x, y, z] => Some([&mut **x, &mut **y, &mut **z]),
                _ => None,
            };
            self.inner.source(&term, source, gradient)
        })
    }
}
