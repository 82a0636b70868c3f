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

use crate::device::convection::{Convected, Convection, Layers};
use crate::device::slices::Slices;
use crate::device::surface::{Beauty, Environment, Hit, Occlusion, Samples, Subsurface, Surfaces};
use crate::device::{
    Behind, Buffer, Device, Lamp, March, Optic, Part, PointSweep, RUN, Ray, Rays, SourceTerm, Storage, Sweep, Tally,
    Term, Trace, Traced, Transport, cpu,
};
use crate::error::{Error, Result};
use crate::field::Field;
use crate::frame::Frame;
use crate::grid::{BrickLayout, Grid, Region, Slab};
use crate::scene::ScratchKey;
use crate::transfer::Table;

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
use store::{Content, Data, Held, Index, Recipe};
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

impl Device for Paged {
    fn name(&self) -> String {
        format!("{}, {} MiB at a time", self.inner.name(), self.budget >> 20)
    }

    fn pages(&self) -> bool {
        true
    }

    /// Half as much at a time on the same device, down to an eighth of a GiB; then what would go on with that device's work.
    fn instead(&self) -> Option<Arc<dyn Device>> {
        let other = self.inner.instead()?;
        let (inner, budget) = match self.budget / 2 {
            half if half >= LEAST => (self.inner.clone(), half),
            _ => (other, self.budget.max(LEAST)),
        };
        Some(Arc::new(Paged::new(inner, budget, &self.folder).keeping(self.precision)))
    }

    fn alloc(&self, len: usize) -> Result<Buffer> {
        Ok(Buffer(Storage::Paged(Box::new(Store::new(len, Content::Zero)))))
    }

    fn upload(&self, values: &[f32], into: &mut Buffer) -> Result<()> {
        let store = store_mut(into);
        self.prepare(store)?;
        match &mut store.content {
            Content::Resident(buffer, _) => self.inner.upload(values, buffer),
            Content::Scratch(scratch) => scratch.write(0, values),
            _ => unreachable!("just prepared"),
        }
    }

    fn download(&self, from: &Buffer, out: &mut [f32]) -> Result<()> {
        match &store(from).content {
            Content::Zero => out.fill(0.0),
            Content::Resident(buffer, _) => self.inner.download(buffer, out)?,
            Content::Scratch(scratch) => scratch.read(0, out)?,
            Content::Data(data) => drop(data.read(&Slab::whole(data.size), out, &self.read)?),
            Content::Optic(_) => self.parts(store(from), |at, len, values| {
                out[at..at + len].copy_from_slice(self.on_host(values, 0, len, &mut vec![])?);
                Ok(())
            })?,
        }
        Ok(())
    }

    fn take(
        &self,
        grid: &Grid,
        field: &Arc<dyn Field>,
        bricks: &BrickLayout,
        _: &mut Vec<f32>,
        into: &mut Buffer,
    ) -> Result<(u64, Vec<[f32; 2]>)> {
        let mut data = Data { field: field.clone(), size: grid.size, clean: false, index: None };
        let taken = self.look_through(&data, bricks)?;
        data.clean = taken.0 == 0;
        data.index = Some(Arc::new(Index { bricks: *bricks, ranges: taken.1.clone() }));
        *store_mut(into) = Store::new(grid.len(), Content::Data(data));
        Ok(taken)
    }

    fn copy(&self, from: &Buffer, start: usize, len: usize, into: &mut Buffer, at: usize) -> Result<()> {
        self.whole(&[from], &mut [into], 0, |device, from, into| device.copy(from[0], start, len, into[0], at))
    }

    fn classify_slab(
        &self,
        optic: Optic,
        table: &Table,
        data: &Slab,
        field: &Buffer,
        light: &Slab,
        out: &mut Buffer,
    ) -> Result<()> {
        assert!(*data == Slab::whole(data.size) && *light == Slab::whole(light.size), "slabs are cut here");
        let Content::Data(of) = &store(field).content else {
            return Err(Error::Unsupported("extinction of what is not a step's data".into()));
        };
        let recipe = Recipe { optic, table: table.clone(), data: of.clone(), size: light.size };
        let recipe = Store::new(light.len(), Content::Optic(Box::new(recipe)));
        let out = store_mut(out);
        if !self.small(out.len) {
            *out = recipe;
            return Ok(());
        }
        self.map(
            (&recipe, light.size),
            (out, light.size),
            |p| p,
            |v, slab, out| self.inner.copy(v, 0, slab.len(), out, 0),
        )
    }

    fn classify_each(
        &self,
        optics: &mut [(Optic, &mut Buffer)],
        table: &Table,
        data: [usize; 3],
        field: &Buffer,
        size: [usize; 3],
    ) -> Result<()> {
        let plane = size[0] * size[1];
        let of = store(field);
        let each = Feed::weight(of, data, size[2]) + plane as f64;
        let more = 4.0 * (data[0] * data[1]) as f64;
        optics.iter_mut().try_for_each(|(_, out)| self.prepare(store_mut(out)))?;
        let depth = self.depth(size[2], each, more)?;
        let slabs = slabs(size[2], depth);
        let light = |n: usize| Slab { size, planes: slabs[n].clone() };
        let planes: Vec<_> = (0..slabs.len()).map(|n| light(n).under(data[2])).collect();
        let mut made = self.inner.alloc(plane * depth)?;
        let rows = match &of.content {
            Content::Data(data) => data.shown(table, &planes),
            _ => vec![0..data[1]; planes.len()],
        };
        self.stream_rows(&[Feed { store: of, size: data, planes: planes.clone() }], &[rows], |n, volumes| {
            let (light, data) = (light(n), Slab { size: data, planes: planes[n].clone() });
            optics.iter_mut().try_for_each(|(optic, out)| {
                self.inner.classify_slab(*optic, table, &data, volumes[0], &light, &mut made)?;
                self.put(&made, 0, light.len(), store_mut(out), light.planes.start * plane)
            })
        })
    }

    fn brick_range(&self, layout: &BrickLayout, field: &Buffer) -> Result<Vec<[f32; 2]>> {
        match &store(field).content {
            Content::Data(data) => Ok(self.look_through(data, layout)?.1),
            _ => self.whole(&[field], &mut [], 0, |device, from, _| device.brick_range(layout, from[0])),
        }
    }

    /// Anything may have changed: to find out would be to read the data once more and extinction before, and a cold sweep reads
    /// the data alone.
    fn change(&self, layout: &BrickLayout, _: &Buffer, _: &Buffer) -> Result<Vec<[f32; 3]>> {
        Ok(vec![[f32::INFINITY; 3]; layout.len()])
    }

    fn restrict_slab(&self, fine: &Slab, values: &Buffer, coarse: &Slab, out: &mut Buffer) -> Result<()> {
        assert!(*fine == Slab::whole(fine.size) && *coarse == Slab::whole(coarse.size), "slabs are cut here");
        let under = |planes: Range<usize>| Slab { size: coarse.size, planes }.under(fine.size[2]);
        self.map((store(values), fine.size), (store_mut(out), coarse.size), under, |v, slab, out| {
            let held = Slab { size: fine.size, planes: under(slab.planes.clone()) };
            self.inner.restrict_slab(&held, v, slab, out)
        })
    }

    fn sweep(
        &self,
        sweep: &Sweep,
        layout: &BrickLayout,
        sigma: &Buffer,
        rho: &mut Buffer,
        fronts: &[&[u32]],
    ) -> Result<Vec<f32>> {
        self.sweep_slabs(sweep, layout, sigma, rho, fronts)
    }

    fn sweep_each(&self, lights: &mut [(Sweep, &mut Buffer)], layout: &BrickLayout, sigma: &Buffer) -> Result<()> {
        for upward in [false, true] {
            let way = lights.iter_mut().filter(|(sweep, _)| sweep.ascending()[2] == upward);
            let mut way: Vec<_> = way.map(|(sweep, rho)| (*sweep, &mut **rho)).collect();
            self.sweep_alike(&mut way, layout, sigma)?;
        }
        Ok(())
    }

    fn sweep_point(
        &self,
        sweep: &PointSweep,
        layout: &BrickLayout,
        sigma: &Buffer,
        rho: &mut Buffer,
        fronts: &[&[u32]],
    ) -> Result<Vec<f32>> {
        self.sweep_point_slabs(sweep, layout, sigma, rho, fronts)
    }

    fn irradiate(&self, lamp: &Lamp, grid: &Grid, planes: Range<usize>, rho: &Buffer, out: &mut Buffer) -> Result<()> {
        assert!(planes == (0..grid.size[2]), "slabs are cut here");
        self.planes(grid.size, 0, &[rho], &mut [out], |held, volumes, made| {
            self.inner.irradiate(lamp, grid, held, volumes[0], made[0])
        })
    }

    fn source(&self, term: &SourceTerm, source: &mut Buffer, gradient: Option<[&mut Buffer; 3]>) -> Result<()> {
        self.source_slabs(term, source, gradient)
    }

    fn transport(&self, t: &Transport, phi: &mut Buffer, current: Option<[&mut Buffer; 3]>) -> Result<(f32, f32)> {
        self.transport_slabs(t, phi, current)
    }

    fn convect_layers(
        &self,
        convection: &Convection,
        layers: Layers,
        sigma: &Buffer,
        before: &Buffer,
        rho: &mut Buffer,
    ) -> Result<Convected> {
        self.whole(&[sigma, before], &mut [rho], 0, |device, from, into| {
            device.convect_layers(convection, layers, from[0], from[1], into[0])
        })
    }

    fn convect_whole(&self, convection: &Convection, sigma: &Buffer, before: &Buffer, rho: &mut Buffer) -> Result<f32> {
        self.whole(&[sigma, before], &mut [rho], 0, |device, from, into| {
            device.convect_whole(convection, from[0], from[1], into[0])
        })
    }

    fn convect_ordered(
        &self,
        convection: &Convection,
        layout: &BrickLayout,
        sigma: &Buffer,
        rho: &mut Buffer,
        fronts: &[&[u32]],
    ) -> Result<Vec<f32>> {
        self.whole(&[sigma], &mut [rho], 0, |device, from, into| {
            device.convect_ordered(convection, layout, from[0], into[0], fronts)
        })
    }

    fn diffuse(&self, size: [usize; 3], weights: [&[f32]; 3], values: &mut Buffer) -> Result<()> {
        self.whole(&[], &mut [values], 0, |device, _, into| device.diffuse(size, weights, into[0]))
    }

    fn relax(
        &self,
        size: [usize; 3],
        coupling: [f32; 3],
        rhs: &Buffer,
        values: &mut Buffer,
        colour: usize,
    ) -> Result<()> {
        self.whole(&[rhs], &mut [values], 0, |device, from, into| {
            device.relax(size, coupling, from[0], into[0], colour)
        })
    }

    fn residual(
        &self,
        size: [usize; 3],
        coupling: [f32; 3],
        rhs: &Buffer,
        values: &Buffer,
        out: &mut Buffer,
    ) -> Result<f32> {
        self.whole(&[rhs, values], &mut [out], 0, |device, from, into| {
            device.residual(size, coupling, from[0], from[1], into[0])
        })
    }

    fn prolong(&self, coarse: [usize; 3], values: &Buffer, size: [usize; 3], into: &mut Buffer) -> Result<()> {
        self.prolong_slabs(coarse, values, size, into)
    }

    fn prolong_slab(&self, _: &Slab, _: &Buffer, _: &Slab, _: &mut Buffer) -> Result<()> {
        Err(Error::Unsupported("a slab of a volume that is paged already".into()))
    }

    fn combine(&self, terms: &[(&Buffer, f32)], out: &mut Buffer) -> Result<()> {
        self.combine_runs(terms, out)
    }

    fn dot_parts(&self, a: &Buffer, b: &Buffer) -> Result<Vec<f64>> {
        self.dot_runs(a, b)
    }

    fn distance(&self, a: &Buffer, b: &Buffer) -> Result<f32> {
        self.largest_of(a, b, |a, b| self.inner.distance(a, b))
    }

    fn largest_ratio(&self, a: &Buffer, b: &Buffer) -> Result<f32> {
        self.largest_of(a, b, |a, b| self.inner.largest_ratio(a, b))
    }

    fn extend(&self, size: [usize; 3], sigma: &Buffer, values: &Buffer, out: &mut Buffer) -> Result<()> {
        self.planes(size, 1, &[sigma, values], &mut [out], |held, volumes, made| {
            self.inner.extend([size[0], size[1], held.len()], volumes[0], volumes[1], made[0])
        })
    }

    fn fill(&self, value: f32, into: &mut Buffer) -> Result<()> {
        let store = store_mut(into);
        self.prepare(store)?;
        if let Content::Resident(inner, _) = &mut store.content {
            return self.inner.fill(value, inner);
        }
        let values = vec![value; RUN.min(store.len)];
        let Content::Scratch(scratch) = &store.content else { unreachable!("just prepared") };
        let runs = slabs(store.len, RUN);
        runs.into_iter().try_for_each(|run| scratch.write(run.start, &values[..run.len()]))
    }

    fn compose(&self, terms: &[(&Buffer, [f32; 3])], out: &mut [[f32; 3]]) -> Result<()> {
        // Value by value: planes may as well be single values.
        let size = [1, 1, out.len()];
        let each = terms.iter().map(|(v, _)| Feed::weight(store(v), size, out.len())).sum();
        let parts = slabs(out.len(), self.depth(out.len(), each, 0.0)?);
        let feeds: Vec<Feed> =
            terms.iter().map(|(v, _)| Feed { store: store(v), size, planes: parts.clone() }).collect();
        if feeds.is_empty() {
            return self.inner.compose(&[], out);
        }
        self.stream(&feeds, |n, volumes| {
            let terms: Vec<_> = volumes.iter().zip(terms).map(|(v, (_, weight))| (*v, *weight)).collect();
            self.inner.compose(&terms, &mut out[parts[n].clone()])
        })
    }

    fn march(&self, march: &March, frame: &mut Frame) -> Result<()> {
        match reaches_beyond(march) {
            true => self.march_whole(march, size_of_val(&frame.pixels[..]), |device, march| device.march(march, frame)),
            false => self.march_slabs(march, frame),
        }
    }

    fn march_slab(&self, _: &March, _: &Part, _: &mut Rays) -> Result<()> {
        Err(Error::Unsupported("a slab of volumes that are cut into slabs already".into()))
    }

    fn gradient(&self, grid: &Grid, field: &Buffer, out: &mut Buffer) -> Result<()> {
        self.whole(&[field], &mut [out], 0, |device, from, into| device.gradient(grid, from[0], into[0]))
    }

    fn classify_graded(
        &self,
        optic: Optic,
        table: &Table,
        (data, field, gradient): ([usize; 3], &Buffer, &Buffer),
        size: [usize; 3],
        out: &mut Buffer,
    ) -> Result<()> {
        self.whole(&[field, gradient], &mut [out], 0, |device, from, into| {
            device.classify_graded(optic, table, (data, from[0], from[1]), size, into[0])
        })
    }

    fn slice(&self, slices: &Slices, rays: &mut [Ray]) -> Result<()> {
        let from: Vec<&Buffer> = [slices.field].into_iter().chain(slices.gradient).collect();
        self.whole(&from, &mut [], size_of_val(rays), |device, from, _| {
            device.slice(&Slices { field: from[0], gradient: from.get(1).copied(), ..*slices }, rays)
        })
    }

    fn surface_hits(&self, surfaces: &Surfaces, hits: &mut [Hit]) -> Result<()> {
        self.whole(&[surfaces.field], &mut [], size_of_val(hits), |device, from, _| {
            device.surface_hits(&Surfaces { field: from[0], ..*surfaces }, hits)
        })
    }

    fn surface_occlusion(
        &self,
        surfaces: &Surfaces,
        occlusion: &Occlusion,
        samples: Samples,
        hits: &[Hit],
        sums: &mut [[f32; 4]],
    ) -> Result<()> {
        self.whole(&[surfaces.field], &mut [], size_of_val(hits), |device, from, _| {
            device.surface_occlusion(&Surfaces { field: from[0], ..*surfaces }, occlusion, samples, hits, sums)
        })
    }

    fn surface_beauty(
        &self,
        surfaces: &Surfaces,
        beauty: &Beauty,
        hits: &[Hit],
        sums: &mut [[[f32; 3]; 2]],
    ) -> Result<()> {
        self.whole(&[surfaces.field, beauty.environment.texels], &mut [], size_of_val(hits), |device, from, _| {
            let environment = Environment { texels: from[1], ..beauty.environment };
            let (surfaces, beauty) = (Surfaces { field: from[0], ..*surfaces }, Beauty { environment, ..*beauty });
            device.surface_beauty(&surfaces, &beauty, hits, sums)
        })
    }

    fn surface_subsurface(
        &self,
        surfaces: &Surfaces,
        subsurface: &Subsurface,
        hits: &[Hit],
        sums: &mut [[f32; 3]],
    ) -> Result<()> {
        self.whole(&[surfaces.field, subsurface.environment.texels], &mut [], size_of_val(hits), |device, from, _| {
            let environment = Environment { texels: from[1], ..subsurface.environment };
            let surfaces = Surfaces { field: from[0], ..*surfaces };
            device.surface_subsurface(&surfaces, &Subsurface { environment, ..*subsurface }, hits, sums)
        })
    }

    fn surface_light(&self, surfaces: &Surfaces, term: &Term, hits: &[Hit], sums: &mut [[[f32; 3]; 2]]) -> Result<()> {
        self.whole(&[surfaces.field, term.values], &mut [], size_of_val(hits), |device, from, _| {
            let (surfaces, term) = (Surfaces { field: from[0], ..*surfaces }, Term { values: from[1], ..*term });
            device.surface_light(&surfaces, &term, hits, sums)
        })
    }

    fn march_before(&self, march: &March, behind: &[Behind], frame: &mut Frame) -> Result<()> {
        if reaches_beyond(march) {
            let beside = size_of_val(behind) + size_of_val(&frame.pixels[..]);
            return self.march_whole(march, beside, |device, march| device.march_before(march, behind, frame));
        }
        let mut rays = Rays::new(frame.size, behind.iter().map(Behind::ray).collect());
        self.march_rays(march, &mut rays)?;
        let pixels = behind.iter().zip(&rays.each).map(|(behind, ray)| behind.pixel(ray));
        frame.pixels.iter_mut().zip(pixels).for_each(|(to, pixel)| *to = pixel);
        Ok(())
    }

    fn sample(&self, size: [usize; 3], values: &Buffer, points: &[[f32; 3]], out: &mut [f32]) -> Result<()> {
        self.whole(&[values], &mut [], size_of_val(points), |device, from, _| device.sample(size, from[0], points, out))
    }

    fn trace(&self, trace: &Trace, picture: [usize; 2], tallies: &mut [Tally]) -> Result<Traced> {
        let from: Vec<&Buffer> = [trace.field].into_iter().chain(trace.gradient).collect();
        self.whole(&from, &mut [], size_of_val(tallies), |device, from, _| {
            let (gradient, samples) = (from.get(1).copied(), trace.samples.clone());
            device.trace(&Trace { field: from[0], gradient, samples, ..*trace }, picture, tallies)
        })
    }

    fn trace_tiles(
        &self,
        trace: &Trace,
        tiles: &[u32],
        picture: [usize; 2],
        tallies: &mut [Tally],
        touched: &mut [u64],
    ) -> Result<Traced> {
        let from: Vec<&Buffer> = [trace.field].into_iter().chain(trace.gradient).collect();
        let beside = size_of_val(tallies) + size_of_val(touched);
        self.whole(&from, &mut [], beside, |device, from, _| {
            let (gradient, samples) = (from.get(1).copied(), trace.samples.clone());
            let trace = Trace { field: from[0], gradient, samples, ..*trace };
            device.trace_tiles(&trace, tiles, picture, tallies, touched)
        })
    }

    fn on_threads(&self, work: &mut (dyn FnMut() + Send)) {
        self.inner.on_threads(work);
    }

    fn crop(&self, size: [usize; 3], values: &Buffer, region: Region, out: &mut Buffer) -> Result<()> {
        self.crop_slabs(size, values, region, out)
    }

    fn embed(&self, region: Region, values: &Buffer, size: [usize; 3], out: &mut Buffer) -> Result<()> {
        self.embed_slabs(region, values, size, out)
    }
}

/// True where a sample looks farther than a slab's planes.
fn reaches_beyond(march: &March) -> bool {
    march.table.preintegrated || march.table.graded.is_some()
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
