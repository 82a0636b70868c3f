//! Kernels that look anywhere in a volume: path tracing, surfaces, slices, the paper's light.
//!
//! What does not fit is a file that is mapped into memory. The system reads what is looked at and keeps it for as long as there is
//! room, and as soon as more of it than the budget allows counts as this process's memory, all is given back: the next look finds
//! it in the file cache, or on the disk. GPUs cannot look at files: the CPU takes such work over, and says so.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use crossbeam_channel::{RecvTimeoutError, bounded};

use super::scratch::Scratch;
use super::store::{Content, Store};
use super::{Paged, store, store_mut};
use crate::device::cpu::Cpu;
use crate::device::cpu::mapped::Pages;
use crate::device::{Buffer, Device, March, Storage, Term};
use crate::error::Result;
use crate::scene::ScratchKey;

/// Time between two looks at what is in memory.
const LOOK: Duration = Duration::from_micros(500);

impl Paged {
    /// Runs a kernel on whole volumes; `beside` bytes are held by those that ask for it.
    pub(super) fn whole<T>(
        &self,
        from: &[&Buffer],
        into: &mut [&mut Buffer],
        beside: usize,
        run: impl FnOnce(&dyn Device, &[&Buffer], &mut [&mut Buffer]) -> Result<T>,
    ) -> Result<T> {
        if !self.hosted && self.fits(from, into) {
            let from = from.iter().map(|b| self.near(b)).collect::<Result<Vec<_>>>()?;
            let mut into = into.iter_mut().map(|b| self.near_mut(b)).collect::<Result<Vec<_>>>()?;
            return run(&*self.inner, &from, &mut into);
        }
        let host = self.host()?;
        let from = from.iter().map(|b| self.mapped(b)).collect::<Result<Vec<_>>>()?;
        let mut into = into.iter_mut().map(|b| self.mapped_mut(b)).collect::<Result<Vec<_>>>()?;
        let pages: Vec<Pages> =
            from.iter().copied().chain(into.iter().map(|b| &**b)).filter_map(Buffer::pages).collect();
        let held = self.resident.load(Ordering::Relaxed) + beside as u64;
        let room = self.budget.saturating_sub(held).max(self.budget / Self::SMALL);
        self.watched(&pages, room, || run(&*host, &from, &mut into))
    }

    /// [`Paged::whole`] for a picture of rays.
    pub(super) fn march_whole<T>(
        &self,
        march: &March,
        beside: usize,
        run: impl FnOnce(&dyn Device, &March) -> Result<T>,
    ) -> Result<T> {
        let from: Vec<&Buffer> =
            [march.field].into_iter().chain(march.terms.iter().map(|t| t.values)).chain(march.gradient).collect();
        self.whole(&from, &mut [], beside, |device, from, _| {
            let (field, rest) = (from[0], &from[1..]);
            let terms: Vec<Term> = march.terms.iter().zip(rest).map(|(t, values)| Term { values, ..*t }).collect();
            let gradient = march.gradient.and(rest.last().copied());
            run(device, &March { field, gradient, terms: &terms, ..*march })
        })
    }

    /// True where a GPU has memory for copies of all.
    fn fits(&self, from: &[&Buffer], into: &[&mut Buffer]) -> bool {
        let all: Vec<&Store> = from.iter().map(|b| store(b)).chain(into.iter().map(|b| store(b))).collect();
        let there = |s: &Store| matches!(s.content, Content::Resident(..)) || s.near.get().is_some();
        let missing: u64 = all.iter().filter(|s| !there(s)).map(|s| 4 * s.len as u64).sum();
        let largest = all.iter().map(|s| 4 * s.len as u64).max().unwrap_or(0);
        self.resident.load(Ordering::Relaxed) + missing <= self.budget && largest <= self.inner.largest()
    }

    /// A device that works in the host's memory.
    fn host(&self) -> Result<Arc<dyn Device>> {
        if let Some(host) = self.host.get() {
            return Ok(host.clone());
        }
        let host: Arc<dyn Device> = match self.hosted {
            true => self.inner.clone(),
            false => {
                let cpu = Arc::new(Cpu::new(0)?);
                let name = self.inner.name();
                tracing::warn!("volumes that do not fit on {name} are looked at as wholes: {} does that", cpu.name());
                cpu
            }
        };
        Ok(self.host.get_or_init(|| host).clone())
    }

    /// A whole volume where the host can look at it.
    fn mapped<'a>(&self, buffer: &'a Buffer) -> Result<&'a Buffer> {
        let store = store(buffer);
        match &store.content {
            Content::Resident(inner, _) if inner.host().is_some() => return Ok(inner),
            Content::Scratch(scratch) if scratch.plain() => return scratch.memory(),
            _ => {}
        }
        if store.copy.get().is_none() {
            let copy = self.spill(store)?;
            let _ = store.copy.set(copy);
        }
        store.copy.get().expect("just made").memory()
    }

    /// The same to be written to.
    fn mapped_mut<'a>(&self, buffer: &'a mut Buffer) -> Result<&'a mut Buffer> {
        let store = store_mut(buffer);
        store.near.take();
        let copy = store.copy.take();
        if matches!(store.content, Content::Zero) {
            // Small ones stay in memory.
            self.prepare(store)?;
        }
        let elsewhere = match &store.content {
            Content::Resident(inner, _) => inner.host().is_none(),
            Content::Scratch(scratch) => !scratch.plain(),
            _ => true,
        };
        if elsewhere {
            store.content = Content::Scratch(copy.map_or_else(|| self.spill(store), Ok)?);
        }
        match &mut store.content {
            Content::Resident(inner, _) => Ok(inner),
            Content::Scratch(scratch) => scratch.memory_mut(),
            _ => unreachable!("just made"),
        }
    }

    /// Writes a volume to a file.
    fn spill(&self, store: &Store) -> Result<Scratch> {
        let scratch = Scratch::new(&self.folder, store.len, ScratchKey::F32)?;
        let mut room = vec![];
        let mut write =
            |at: usize, len: usize, values: &Buffer| scratch.write(at, self.on_host(values, 0, len, &mut room)?);
        match &store.content {
            Content::Resident(inner, _) => write(0, store.len, inner)?,
            _ => self.parts(store, write)?,
        }
        Ok(scratch)
    }

    /// Runs something while no more than about `room` bytes of files count as this process's memory.
    fn watched<T>(&self, pages: &[Pages], room: u64, run: impl FnOnce() -> Result<T>) -> Result<T> {
        if pages.is_empty() {
            return run();
        }
        let release = || pages.iter().for_each(Pages::release);
        release();
        let before = files_in_memory().unwrap_or(0);
        let (done, ended) = bounded::<()>(0);
        std::thread::scope(|scope| {
            scope.spawn(move || {
                let mut going = true;
                while going {
                    going = ended.recv_timeout(LOOK) == Err(RecvTimeoutError::Timeout);
                    if files_in_memory().is_some_and(|now| now.saturating_sub(before) > room / 2) {
                        release();
                        self.released.fetch_add(1, Ordering::Relaxed);
                    }
                }
                release();
            });
            let result = run();
            drop(done);
            result
        })
    }
}

impl Buffer {
    fn pages(&self) -> Option<Pages> {
        match &self.0 {
            Storage::Mapped(mapped) => Some(mapped.pages()),
            _ => None,
        }
    }
}

/// Bytes of files that count as this process's memory; `None` where the system does not say.
fn files_in_memory() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let of =
        |key: &str| status.lines().find_map(|l| l.strip_prefix(key))?.split_whitespace().next()?.parse::<u64>().ok();
    Some(1024 * (of("RssFile:")? + of("RssShmem:")?))
}
