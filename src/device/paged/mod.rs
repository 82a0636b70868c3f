//! Volumes larger than memory: a device that has another one do the work, slab after slab.
//!
//! The unit is a slab of planes across z, as the file has them: whatever the direction of light or of a ray, it crosses
//! them in one order, so that one plane of light between slabs and the state of each ray are all that is carried along.
//! The algorithms above know nothing of it, and every kernel does with a slab what it does with the whole, so results are the
//! same to the bit.
//!
//! Data stay where they are, and are read by slab as often as they are needed. Extinction is computed from them as they
//! come by. Light that does not fit goes to a scratch file. Kernels that look anywhere in a volume have files for memory.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use crate::device::{Buffer, Device, Storage, cpu};
use crate::error::{Error, Result};
use crate::grid::{BrickLayout, Slab};
use crate::scene::ScratchKey;

mod kernels;
mod lamp;
mod march;
mod scatter;
mod scratch;
mod store;
mod stream;
mod sweep;
mod values;
mod whole;

pub(crate) use store::Store;
use store::{Content, Data, Held};
use stream::Feed;

/// A device that holds no more than a budget of what it works on.
pub struct Paged {
    inner: Arc<dyn Device>,
    budget: u64,
    folder: PathBuf,
    /// Bytes of volumes that stay in the inner device's memory.
    resident: Arc<AtomicU64>,
    /// Bytes of data read.
    read: AtomicU64,
    /// Volumes that a pass of transport works in.
    spares: Mutex<Vec<Store>>,
    /// Numbers that direct light is kept in on the disk.
    precision: ScratchKey,
    /// True where the inner device works in the host's memory.
    hosted: bool,
    /// What looks at whole volumes that do not fit.
    host: OnceLock<Arc<dyn Device>>,
    /// How often files were as much of this process's memory as the budget allows.
    released: AtomicU64,
}

/// Budget in bytes below which a device that fails is given up.
const LEAST: u64 = 128 << 20;

/// Slabs that a pass takes at least where there are planes enough, so that reading and working overlap.
const SLABS: usize = 6;

impl Paged {
    /// Volumes up to one part in so many of the budget stay in memory.
    pub(crate) const SMALL: u64 = 8;

    /// Has `inner` work within `budget` bytes; light that does not fit goes to a file without a name in `folder`.
    pub fn new(inner: Arc<dyn Device>, budget: u64, folder: &Path) -> Self {
        let hosted = inner.alloc(1).is_ok_and(|buffer| buffer.host().is_some());
        Paged {
            inner,
            hosted,
            host: OnceLock::new(),
            released: AtomicU64::new(0),
            budget,
            folder: folder.into(),
            resident: Arc::default(),
            read: AtomicU64::new(0),
            spares: Mutex::default(),
            precision: ScratchKey::F32,
        }
    }

    /// Keeps direct light that does not fit in these numbers; each value is rounded once.
    pub fn keeping(self, precision: ScratchKey) -> Self {
        Paged { precision, ..self }
    }

    /// Bytes of data read so far.
    pub fn bytes_read(&self) -> u64 {
        self.read.load(Ordering::Relaxed)
    }

    /// How often files that stand for memory were given back because they were more of it than the budget allows.
    pub fn released(&self) -> u64 {
        self.released.load(Ordering::Relaxed)
    }

    /// How many planes of a volume of `total` a slab may have: `each` values for every plane, `more` for those that it
    /// shares with its neighbours and whatever else is held meanwhile.
    fn depth(&self, total: usize, each: f64, more: f64) -> Result<usize> {
        let held = self.resident.load(Ordering::Relaxed);
        // No single buffer of a slab takes more than all that is counted for a plane.
        let free = self.budget.saturating_sub(held).min(self.inner.largest()) as f64 / 4.0;
        let deepest = ((free - more) / each.max(1.0)).floor();
        if deepest < 1.0 {
            let needed = held + (4.0 * (each + more)).ceil() as u64;
            return Err(Error::OutOfMemory { needed, budget: self.budget });
        }
        let slabs = total.div_ceil(deepest as usize).max(SLABS.min(total));
        Ok(total.div_ceil(slabs))
    }

    /// Memory of the inner device, of which account is kept.
    fn hold(&self, len: usize) -> Result<(Buffer, Held)> {
        let (bytes, held) = (4 * len as u64, self.resident.load(Ordering::Relaxed));
        if held + bytes > self.budget {
            return Err(Error::OutOfMemory { needed: held + bytes, budget: self.budget });
        }
        Ok((self.inner.alloc(len)?, Held::new(bytes, &self.resident)))
    }

    /// Finds a place for what will be written to a volume.
    fn prepare(&self, store: &mut Store) -> Result<()> {
        self.prepare_in(store, ScratchKey::F32)
    }

    /// The same, in these numbers where it does not fit.
    fn prepare_in(&self, store: &mut Store, precision: ScratchKey) -> Result<()> {
        store.forget();
        if matches!(store.content, Content::Resident(..) | Content::Scratch(_)) {
            return Ok(());
        }
        store.content = if self.small(store.len) {
            let (buffer, held) = self.hold(store.len)?;
            Content::Resident(buffer, held)
        } else {
            Content::Scratch(scratch::Scratch::new(&self.folder, store.len, precision)?)
        };
        Ok(())
    }

    /// True for volumes that stay in memory without need.
    fn small(&self, len: usize) -> bool {
        let (bytes, held) = (4 * len as u64, self.resident.load(Ordering::Relaxed));
        bytes <= self.budget / Self::SMALL && held + bytes <= self.budget / 4
    }

    /// Writes `len` values of an inner buffer, from `start` on, into a volume, at `at`.
    fn put(&self, from: &Buffer, start: usize, len: usize, into: &mut Store, at: usize) -> Result<()> {
        match &mut into.content {
            Content::Resident(buffer, _) => self.inner.copy(from, start, len, buffer, at),
            Content::Scratch(scratch) => scratch.write(at, self.on_host(from, start, len, &mut vec![])?),
            _ => unreachable!("prepared before"),
        }
    }

    /// `len` values of an inner buffer, from `start` on; in `room` where they are not the host's.
    fn on_host<'a>(&self, from: &'a Buffer, start: usize, len: usize, room: &'a mut Vec<f32>) -> Result<&'a [f32]> {
        if let Some(values) = from.host() {
            return Ok(&values[start..start + len]);
        }
        room.resize(start + len, 0.0);
        self.inner.download(from, room)?;
        Ok(&room[start..])
    }

    /// `count` volumes of `len` values to work in, with a place of their own.
    fn spares(&self, count: usize, len: usize) -> Result<Vec<Store>> {
        let mut kept = std::mem::take(&mut *self.spares.lock().unwrap_or_else(PoisonError::into_inner));
        kept.retain(|s| s.len == len);
        kept.truncate(count);
        kept.resize_with(count, || Store::new(len, Content::Zero));
        kept.iter_mut().try_for_each(|s| self.prepare(s))?;
        Ok(kept)
    }

    fn keep_spares(&self, spares: Vec<Store>) {
        *self.spares.lock().unwrap_or_else(PoisonError::into_inner) = spares;
    }

    /// A whole volume in the inner device's memory.
    fn near<'a>(&self, buffer: &'a Buffer) -> Result<&'a Buffer> {
        let store = store(buffer);
        if let Content::Resident(inner, _) = &store.content {
            return Ok(inner);
        }
        if let Some((inner, _)) = store.near.get() {
            return Ok(inner);
        }
        let (mut inner, held) = self.hold(store.len)?;
        self.bring_all(store, &mut inner)?;
        Ok(&store.near.get_or_init(|| (inner, held)).0)
    }

    fn near_mut<'a>(&self, buffer: &'a mut Buffer) -> Result<&'a mut Buffer> {
        let store = store_mut(buffer);
        store.copy.take();
        if !matches!(store.content, Content::Resident(..)) {
            let (inner, held) = match store.near.take() {
                Some(kept) => kept,
                None => {
                    let (mut inner, held) = self.hold(store.len)?;
                    self.bring_all(store, &mut inner)?;
                    (inner, held)
                }
            };
            store.content = Content::Resident(inner, held);
        }
        match &mut store.content {
            Content::Resident(inner, _) => Ok(inner),
            _ => unreachable!("just made"),
        }
    }

    /// Copies a volume into a buffer of the inner device, part by part.
    fn bring_all(&self, store: &Store, into: &mut Buffer) -> Result<()> {
        self.parts(store, |at, len, values| self.inner.copy(values, 0, len, into, at))
    }

    /// Calls `each` with one part after another of a volume that is not zero: number of its first value, length, and values.
    fn parts(&self, store: &Store, mut each: impl FnMut(usize, usize, &Buffer) -> Result<()>) -> Result<()> {
        if matches!(store.content, Content::Zero) {
            return Ok(());
        }
        // Planes are those that the volume is made of, or anything where it lies as it is.
        let size = match &store.content {
            Content::Data(data) => data.size,
            Content::Optic(recipe) => recipe.size,
            _ => [1, 1, store.len],
        };
        let plane = size[0] * size[1];
        let parts = slabs(size[2], self.depth(size[2], Feed::weight(store, size, size[2]), 4.0 * plane as f64)?);
        self.stream(&[Feed { store, size, planes: parts.clone() }], |n, volumes| {
            each(plane * parts[n].start, plane * parts[n].len(), volumes[0])
        })
    }

    /// Computes a volume of `size` from one pass over another one, slab after slab: `under` says which of its planes are needed
    /// for planes of the result, `make` computes them.
    fn map(
        &self,
        (from, from_size): (&Store, [usize; 3]),
        (into, size): (&mut Store, [usize; 3]),
        under: impl Fn(Range<usize>) -> Range<usize>,
        make: impl Fn(&Buffer, &Slab, &mut Buffer) -> Result<()>,
    ) -> Result<()> {
        self.prepare(into)?;
        let plane = size[0] * size[1];
        let shared = 2.0 * (from_size[0] * from_size[1]) as f64 * 2.0;
        let depth = self.depth(size[2], Feed::weight(from, from_size, size[2]) + plane as f64, shared)?;
        let slabs = slabs(size[2], depth);
        let planes = slabs.iter().cloned().map(under).collect();
        let mut out = self.inner.alloc(plane * depth)?;
        self.stream(&[Feed { store: from, size: from_size, planes }], |n, volumes| {
            let slab = Slab { size, planes: slabs[n].clone() };
            make(volumes[0], &slab, &mut out)?;
            self.put(&out, 0, slab.len(), into, slab.planes.start * plane)
        })
    }
}

/// Consecutive runs of at most `depth` planes.
fn slabs(total: usize, depth: usize) -> Vec<Range<usize>> {
    (0..total).step_by(depth).map(|p| p..(p + depth).min(total)).collect()
}

/// What is known of a buffer. One of another device is a bug of ours.
fn store(buffer: &Buffer) -> &Store {
    match &buffer.0 {
        Storage::Paged(store) => store,
        _ => panic!("a buffer of the paged device"),
    }
}

fn store_mut(buffer: &mut Buffer) -> &mut Store {
    match &mut buffer.0 {
        Storage::Paged(store) => store,
        _ => panic!("a buffer of the paged device"),
    }
}

impl Paged {
    /// Reads all data once: the number of holes and the range of each brick.
    fn look_through(&self, data: &Data, layout: &BrickLayout) -> Result<(u64, Vec<[f32; 2]>)> {
        let [nx, ny, nz] = data.size;
        let plane = nx * ny;
        let depth = self.depth(nz, 2.0 * plane as f64, 0.0)?;
        let mut ranges = vec![[f32::INFINITY, f32::NEG_INFINITY]; layout.len()];
        let flat = BrickLayout::new([nx, ny, 1], layout.edge);
        let across = flat.len();
        let mut look = |planes: Range<usize>, values: &[f32]| {
            for (z, values) in planes.zip(values.chunks_exact(plane)) {
                // A brick sees one plane more on both sides.
                let (from, to) = (z.saturating_sub(1) / layout.edge, (z + 1).min(nz - 1) / layout.edge);
                let here = cpu::bricks::brick_range(&flat, values);
                for layer in from..=to {
                    let of = &mut ranges[layer * across..][..across];
                    of.iter_mut().zip(&here).for_each(|(r, h)| *r = [r[0].min(h[0]), r[1].max(h[1])]);
                }
            }
        };
        let read = |planes: &Range<usize>, out: &mut [f32]| {
            data.read(&Slab { size: data.size, planes: planes.clone() }, out, &self.read)
        };
        let slabs = slabs(nz, depth);
        let [mut now, mut next] = [vec![0.0; plane * depth], vec![0.0; plane * depth]];
        let mut holes = read(&slabs[0], &mut now)?;
        for (n, planes) in slabs.iter().enumerate() {
            let ahead = slabs.get(n + 1);
            let (read, ()) =
                rayon::join(|| ahead.map_or(Ok(0), |planes| read(planes, &mut next)), || look(planes.clone(), &now));
            holes += read?;
            std::mem::swap(&mut now, &mut next);
        }
        Ok((holes, ranges))
    }
}
