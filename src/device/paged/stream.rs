//! One pass over volumes, slab after slab: a thread reads the next slab, and hands it to a device with memory of its own, while
//! one is worked on. Planes that two slabs share are read once.

use std::ops::Range;

use crossbeam_channel::{Receiver, Sender, bounded};
use rayon::prelude::*;

use super::Paged;
use super::store::{Content, Data, Store};
use crate::device::Buffer;
use crate::error::{Error, Result};
use crate::field::EMPTY;
use crate::grid::Slab;

/// A volume as a pass reads it: which planes each step needs.
pub(super) struct Feed<'a> {
    pub store: &'a Store,
    pub size: [usize; 3],
    pub planes: Vec<Range<usize>>,
}

/// Where the reading thread gets planes from.
enum From<'a> {
    /// From nowhere: the volume is in the inner device's memory, or zero.
    Nowhere,
    Scratch(&'a super::scratch::Scratch),
    Data(&'a Data),
}

/// What the reading thread reads of one volume.
struct Reading<'a> {
    from: From<'a>,
    size: [usize; 3],
    planes: Vec<Range<usize>>,
    /// The rows of each plane that are needed, for each step.
    rows: Vec<Range<usize>>,
    /// Planes that the next slab needs too, and their values.
    kept: (Range<usize>, Vec<f32>),
}

/// What was read of a volume for a step.
struct Load {
    values: Vec<f32>,
    /// The same where the inner device works on it, unless that is the host's memory.
    there: Option<Buffer>,
}

/// A load for each volume.
type Step = Vec<Load>;

impl<'a> Feed<'a> {
    fn reading(&self) -> Reading<'a> {
        let (from, size, planes): (_, _, Vec<Range<usize>>) = match &self.store.content {
            Content::Zero | Content::Resident(..) => (From::Nowhere, self.size, self.planes.clone()),
            Content::Scratch(scratch) => (From::Scratch(scratch), self.size, self.planes.clone()),
            Content::Data(data) => (From::Data(data), data.size, self.planes.clone()),
            Content::Optic(recipe) => {
                let under = |planes: &Range<usize>| {
                    Slab { size: recipe.size, planes: planes.clone() }.under(recipe.data.size[2])
                };
                (From::Data(&recipe.data), recipe.data.size, self.planes.iter().map(under).collect())
            }
        };
        let rows = match &self.store.content {
            // What shows nothing has no extinction, nor scatters or glows.
            Content::Optic(recipe) => recipe.data.shown(&recipe.table, &planes),
            _ => vec![0..size[1]; planes.len()],
        };
        Reading { from, size, planes, rows, kept: (0..0, vec![]) }
    }

    /// Values of the inner device that the deepest slab of this volume takes, for each plane of another volume of `of` planes:
    /// twice what is read, for one slab is read while another is worked on, and what is computed from it.
    pub fn weight(store: &Store, size: [usize; 3], of: usize) -> f64 {
        let per = |size: [usize; 3]| (size[0] * size[1] * size[2]) as f64 / of as f64;
        match &store.content {
            Content::Zero => per(size),
            Content::Resident(..) => per(size),
            Content::Scratch(_) | Content::Data(_) => 2.0 * per(size),
            Content::Optic(recipe) => 2.0 * per(recipe.data.size) + per(size),
        }
    }
}

impl Reading<'_> {
    fn plane(&self) -> usize {
        self.size[0] * self.size[1]
    }

    /// Values of the deepest slab.
    fn room(&self) -> usize {
        match self.from {
            From::Nowhere => 0,
            _ => self.plane() * self.planes.iter().map(Range::len).max().unwrap_or(0),
        }
    }

    /// Fills `out` with the planes of step `n`.
    fn fill(&mut self, n: usize, out: &mut [f32], paged: &Paged) -> Result<()> {
        let (plane, wanted) = (self.plane(), self.planes[n].clone());
        if matches!(self.from, From::Nowhere) {
            return Ok(());
        }
        let (kept, values) = &self.kept;
        let both = kept.start.max(wanted.start)..kept.end.min(wanted.end);
        let mut missing = vec![wanted.clone()];
        if !both.is_empty() {
            let at = |p: usize, of: &Range<usize>| (p - of.start) * plane;
            out[at(both.start, &wanted)..at(both.end, &wanted)]
                .copy_from_slice(&values[at(both.start, kept)..at(both.end, kept)]);
            missing = vec![wanted.start..both.start, both.end..wanted.end];
        }
        for planes in missing.into_iter().filter(|p| !p.is_empty()) {
            let out = &mut out[(planes.start - wanted.start) * plane..(planes.end - wanted.start) * plane];
            let (nx, rows) = (self.size[0], self.rows[n].clone());
            match &self.from {
                From::Nowhere => {}
                From::Scratch(scratch) if plane == nx * rows.len() => scratch.read(planes.start * plane, out)?,
                From::Scratch(scratch) => {
                    for (p, out) in planes.zip(out.chunks_exact_mut(plane)) {
                        scratch.read(p * plane + rows.start * nx, &mut out[rows.start * nx..rows.end * nx])?;
                    }
                }
                From::Data(data) => {
                    if !rows.is_empty() {
                        data.read_rows(&Slab { size: self.size, planes }, rows.clone(), out, &paged.read)?;
                    }
                    // Reading leaves anything in the others.
                    for plane in out.chunks_exact_mut(plane) {
                        plane[..rows.start * nx].fill(EMPTY);
                        plane[rows.end * nx..].fill(EMPTY);
                    }
                }
            }
        }
        // Also those that a step after the next needs, where the next needs none.
        let ahead = self.planes[n + 1..].iter().find(|p| !p.is_empty()).cloned().unwrap_or(0..0);
        let both = ahead.start.max(wanted.start)..ahead.end.min(wanted.end);
        self.kept.1.clear();
        if both.is_empty() {
            self.kept.0 = 0..0;
        } else if !wanted.is_empty() {
            let at = |p: usize| (p - wanted.start) * plane;
            self.kept.1.extend_from_slice(&out[at(both.start)..at(both.end)]);
            self.kept.0 = both;
        }
        Ok(())
    }
}

/// One volume where the inner device works on it.
struct Place {
    /// What was read.
    read: Option<Buffer>,
    /// What was made of it, or copied out of a resident volume.
    made: Option<Buffer>,
}

impl Paged {
    /// Calls `each` with the number of every step and the volumes' planes, in the inner device's memory.
    pub(super) fn stream(&self, feeds: &[Feed], each: impl FnMut(usize, &[&Buffer]) -> Result<()>) -> Result<()> {
        self.stream_rows(feeds, &[], each)
    }

    /// The same with only some rows of each plane in each step of the first volumes, which are no recipes; other rows hold no data,
    /// or anything in a volume of light.
    pub(super) fn stream_rows(
        &self,
        feeds: &[Feed],
        rows: &[Vec<Range<usize>>],
        mut each: impl FnMut(usize, &[&Buffer]) -> Result<()>,
    ) -> Result<()> {
        let steps = feeds.first().map_or(0, |f| f.planes.len());
        let mut readings: Vec<Reading> = feeds.iter().map(Feed::reading).collect();
        readings.iter_mut().zip(rows).for_each(|(r, rows)| r.rows = rows.clone());
        let rooms: Vec<usize> = readings.iter().map(Reading::room).collect();
        let mut places = feeds.iter().zip(&rooms).map(|(f, room)| self.place(f, *room)).collect::<Result<Vec<_>>>()?;
        let (full_tx, full_rx) = bounded::<Result<Step>>(0);
        let (empty_tx, empty_rx) = bounded::<Step>(1);
        // The inner device has memory for one slab already: this is for the one that is read meanwhile.
        let there = |n: usize| (!self.hosted && n > 0).then(|| self.inner.alloc(n)).transpose();
        let load = |&n: &usize| Ok(Load { values: vec![0.0; n], there: there(n)? });
        let _ = empty_tx.send(rooms.iter().map(load).collect::<Result<Step>>()?);
        std::thread::scope(|scope| {
            // Dropped when this closure returns, which ends the thread's wait, whatever happened.
            let (full_rx, empty_tx) = (full_rx, empty_tx);
            scope.spawn(move || read_ahead(self, &mut readings, steps, &full_tx, &empty_rx));
            for step in 0..steps {
                let gone = || Error::Closed("the thread that reads ahead died".into());
                let loads = full_rx.recv().map_err(|_| gone())??;
                let mut emptied = Vec::with_capacity(loads.len());
                for ((feed, place), load) in feeds.iter().zip(&mut places).zip(loads) {
                    emptied.push(self.bring(feed, step, place, load)?);
                }
                let _ = empty_tx.send(emptied);
                let volumes: Vec<&Buffer> = feeds.iter().zip(&places).map(|(f, p)| p.shown(f)).collect();
                each(step, &volumes)?;
            }
            Ok(())
        })
    }

    fn place(&self, feed: &Feed, room: usize) -> Result<Place> {
        let deepest = feed.planes.iter().map(Range::len).max().unwrap_or(0) * feed.size[0] * feed.size[1];
        let whole = deepest == feed.store.len;
        let (read, made) = match &feed.store.content {
            Content::Resident(..) if whole => (None, None),
            Content::Zero | Content::Resident(..) => (None, Some(self.inner.alloc(deepest)?)),
            Content::Scratch(_) | Content::Data(_) => (Some(self.inner.alloc(room)?), None),
            Content::Optic(_) => (Some(self.inner.alloc(room)?), Some(self.inner.alloc(deepest)?)),
        };
        Ok(Place { read, made })
    }

    /// Puts the planes of a step where the inner device works on them; returns memory for others.
    fn bring(&self, feed: &Feed, step: usize, place: &mut Place, mut load: Load) -> Result<Load> {
        let planes = &feed.planes[step];
        if planes.is_empty() {
            return Ok(load);
        }
        match (&mut place.read, &mut load.there) {
            (Some(read), Some(there)) => std::mem::swap(read, there),
            (Some(read), None) => load.values = self.inner.exchange(load.values, read)?,
            (None, _) => {}
        }
        match (&feed.store.content, place) {
            (Content::Resident(whole, _), Place { made: Some(made), .. }) => {
                let plane = feed.size[0] * feed.size[1];
                self.inner.copy(whole, planes.start * plane, planes.len() * plane, made, 0)?;
            }
            (Content::Optic(recipe), Place { read: Some(read), made: Some(made) }) => {
                let light = Slab { size: recipe.size, planes: planes.clone() };
                let size = recipe.data.size;
                let data = Slab { size, planes: light.under(size[2]) };
                self.inner.classify_slab(recipe.optic, &recipe.table, &data, read, &light, made)?;
            }
            _ => {}
        }
        Ok(load)
    }
}

impl Place {
    fn shown<'a>(&'a self, feed: &'a Feed) -> &'a Buffer {
        match (&self.made, &self.read, &feed.store.content) {
            (Some(made), ..) => made,
            (None, Some(read), _) => read,
            (None, None, Content::Resident(whole, _)) => whole,
            _ => unreachable!("every volume has its place"),
        }
    }
}

/// Reads step after step as memory comes back.
fn read_ahead(
    paged: &Paged,
    readings: &mut [Reading],
    steps: usize,
    full: &Sender<Result<Step>>,
    empty: &Receiver<Step>,
) {
    for n in 0..steps {
        let Ok(mut loads) = empty.recv() else { return };
        let read = readings.par_iter_mut().zip(&mut loads).try_for_each(|(r, load)| {
            r.fill(n, &mut load.values, paged)?;
            match &mut load.there {
                Some(there) if !r.planes[n].is_empty() => paged.inner.upload(&load.values, there),
                _ => Ok(()),
            }
        });
        let failed = read.is_err();
        if full.send(read.map(|()| loads)).is_err() || failed {
            return;
        }
    }
}
