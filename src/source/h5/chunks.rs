//! Chunked datasets, decoded on all cores: chunks are read as they are stored, one after the other under HDF5's lock,
//! and unpacked, converted and put into place outside of it.
//!
//! A read touches the chunks that meet its region and no others. Those that reach beyond it are kept for the reads that
//! follow, so that reading brick by brick unpacks each chunk once.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};

use hdf5::Dataset;
use hdf5::plist::dataset_create::ChunkOpts;
use lru::LruCache;
use ndarray::{ArrayViewD, ArrayViewMut3, Axis, Slice};

use super::filters::Pipeline;
use super::slab::{Slab, place};
use super::stored;
use crate::dtype::Dtype;
use crate::error::{Error, Result};
use crate::grid::Region;

/// Bytes of packed chunks that may wait for a core.
const AHEAD: usize = 64 << 20;

/// How the chunks of a dataset are unpacked.
pub(crate) struct Chunks {
    /// Lengths of a chunk, in the dataset's order of axes.
    shape: Vec<usize>,
    dtype: Dtype,
    pipeline: Pipeline,
    /// Bytes of a chunk without its filters.
    bytes: usize,
    /// No chunk has more bytes than the file.
    most: u64,
    /// Which dataset's chunks they are, where they are kept.
    number: u64,
    kept: Arc<Kept>,
}

/// A chunk as it was before the filters.
type Unpacked = Arc<Vec<u8>>;

/// Chunks by dataset and place, and their bytes.
type Chosen = (LruCache<(u64, Vec<u64>), Unpacked>, usize);

/// Unpacked chunks of several datasets: those that were asked for last, in so many bytes.
pub(crate) struct Kept {
    chunks: Mutex<Chosen>,
    limit: usize,
}

impl Kept {
    /// Keeps within `limit` bytes.
    pub fn new(limit: usize) -> Kept {
        Kept { chunks: Mutex::new((LruCache::unbounded(), 0)), limit }
    }

    fn get(&self, key: &(u64, Vec<u64>)) -> Option<Unpacked> {
        locked(&self.chunks).0.get(key).cloned()
    }

    fn put(&self, key: (u64, Vec<u64>), chunk: Unpacked) {
        if chunk.len() > self.limit {
            return;
        }
        let (chunks, bytes) = &mut *locked(&self.chunks);
        *bytes += chunk.len();
        if let Some(before) = chunks.put(key, chunk) {
            *bytes -= before.len();
        }
        while *bytes > self.limit
            && let Some((_, oldest)) = chunks.pop_lru()
        {
            *bytes -= oldest.len();
        }
    }
}

/// Where a chunk begins in the dataset, and the part of a region that it has.
struct Part {
    chunk: Vec<u64>,
    /// In the region, along x, y, z.
    to: Region,
    /// All that the dataset has of this chunk is in the region.
    whole: bool,
}

/// A part that has been read but not unpacked.
enum Packed {
    Filtered(u32, Vec<u8>),
    Kept(Unpacked),
}

/// Buffers that go from chunk to chunk.
struct Scratch<O> {
    spare: Vec<u8>,
    values: Vec<O>,
}

impl Chunks {
    /// How to unpack a dataset's chunks; `None` where HDF5 has to: no chunks, or filters or numbers that only HDF5
    /// knows. They are kept in `kept`, beside those of other datasets.
    pub fn of(dataset: &Dataset, kept: &Arc<Kept>) -> Option<Chunks> {
        static LAST: AtomicU64 = AtomicU64::new(0);
        let shape = dataset.chunk()?;
        let settings = dataset.dcpl().ok()?;
        if settings.get_chunk_opts().ok()?.is_some_and(|o| o.contains(ChunkOpts::DONT_FILTER_PARTIAL_CHUNKS)) {
            return None;
        }
        let dtype = stored::number(&dataset.dtype().ok()?)?;
        // What no filter has packed HDF5 reads in place, of each chunk only what is asked for.
        let pipeline = Pipeline::of(dataset, dtype.bytes()).filter(|p| !p.is_empty())?;
        let bytes = shape.iter().try_fold(dtype.bytes(), |n, &l| n.checked_mul(l)).filter(|n| *n > 0)?;
        let most = dataset.file().ok()?.size();
        let number = LAST.fetch_add(1, Ordering::Relaxed);
        Some(Chunks { shape, dtype, pipeline, bytes, most, number, kept: kept.clone() })
    }

    /// Reads a region of a slab: `narrow` makes values of stored numbers, `absent` reads what was never stored.
    ///
    /// # Errors
    /// The first chunk that cannot be read or unpacked, by its place.
    pub fn read<O: Copy + Default + Send>(
        &self,
        (dataset, slab): (&Dataset, &Slab),
        region: Region,
        out: &mut [O],
        narrow: impl Fn(f64) -> O + Sync,
        absent: impl Fn(Region, &mut [O]) -> Result<()>,
    ) -> Result<()> {
        if region.is_empty() {
            return Ok(());
        }
        let [nx, ny, nz] = region.size;
        let whole =
            ArrayViewMut3::from_shape((nz, ny, nx), out).map_err(|e| Error::format(slab.name(), e.to_string(), ""))?;
        let parts = self.parts(&dataset.shape(), slab, region);
        let layers = layers(whole, &parts);
        let (failure, scratches) = (Mutex::new(None), Mutex::new(Vec::new()));
        let fail = |why: Error| {
            locked(&failure).get_or_insert(why);
        };
        let failed = || locked(&failure).is_some();
        let unpack = |part: &Part, packed: Packed| -> Result<()> {
            let popped = locked(&scratches).pop();
            let mut scratch: Scratch<O> = popped.unwrap_or_else(|| Scratch { spare: Vec::new(), values: Vec::new() });
            let bytes = match packed {
                Packed::Kept(bytes) => bytes,
                Packed::Filtered(mask, mut bytes) => {
                    let undone = self.pipeline.undo(mask, self.bytes, &mut bytes, &mut scratch.spare);
                    undone.map_err(|why| self.damaged(slab, part, &why))?;
                    Arc::new(bytes)
                }
            };
            scratch.values.resize(self.bytes / self.dtype.bytes(), O::default());
            let each = self.dtype.bytes() as isize;
            self.dtype.decode(&bytes, 0, each, &mut scratch.values, &narrow);
            let stored = self.cut(slab, region, part, &scratch.values);
            put(&layers, part, |out| place(stored, slab.space, out, |v| v));
            locked(&scratches).push(scratch);
            if !part.whole {
                self.kept.put((self.number, part.chunk.clone()), bytes);
            }
            Ok(())
        };
        // What waits is within what may be kept; one chunk at least is in hand.
        let most_ahead = AHEAD.min(self.kept.limit);
        let mut waiting = parts.iter().peekable();
        while waiting.peek().is_some() && !failed() {
            rayon::in_place_scope(|scope| {
                let mut ahead = 0;
                while ahead <= most_ahead && !failed() {
                    let Some(part) = waiting.next() else { break };
                    let packed = match self.packed(dataset, part) {
                        Ok(Some(packed)) => packed,
                        Ok(None) => {
                            let start = std::array::from_fn(|a| region.start[a] + part.to.start[a]);
                            let mut values = vec![O::default(); part.to.len()];
                            match absent(Region { start, size: part.to.size }, &mut values) {
                                Ok(()) => put(&layers, part, |mut out| {
                                    out.iter_mut().zip(values).for_each(|(o, v)| *o = v);
                                }),
                                Err(why) => fail(why),
                            }
                            continue;
                        }
                        Err(e) => {
                            fail(self.damaged(slab, part, &e.to_string()));
                            break;
                        }
                    };
                    if let Packed::Filtered(_, bytes) = &packed {
                        ahead += bytes.len();
                    }
                    let (unpack, fail) = (&unpack, &fail);
                    scope.spawn(move |_| unpack(part, packed).unwrap_or_else(fail));
                }
            });
        }
        match failure.into_inner() {
            Ok(None) => Ok(()),
            Ok(Some(why)) => Err(why),
            Err(_) => Err(Error::Closed(format!("{}: unpacking died", slab.name()))),
        }
    }

    /// The chunks that meet a region, along z, then y, then x.
    fn parts(&self, shape: &[usize], slab: &Slab, region: Region) -> Vec<Part> {
        let first: [usize; 3] = std::array::from_fn(|a| slab.start[a] + region.start[a]);
        let length = |a: usize| self.shape[slab.space[a]];
        let along = |a: usize| first[a] / length(a)..=(first[a] + region.size[a] - 1) / length(a);
        // Chunks that reach over several places along the other axes hold more than this slab.
        let alone = slab.fixed.iter().all(|(axis, _)| self.shape[*axis].min(shape[*axis]) == 1);
        let mut parts = Vec::new();
        for k in along(2) {
            for j in along(1) {
                for i in along(0) {
                    let mut chunk = vec![0; self.shape.len()];
                    for &(axis, at) in &slab.fixed {
                        chunk[axis] = (at / self.shape[axis] * self.shape[axis]) as u64;
                    }
                    let (mut start, mut size, mut whole) = ([0; 3], [0; 3], alone);
                    for (a, n) in [i, j, k].into_iter().enumerate() {
                        let from = n * length(a);
                        let (lo, hi) = (from.max(first[a]), (from + length(a)).min(first[a] + region.size[a]));
                        whole &= lo == from && hi == (from + length(a)).min(shape[slab.space[a]]);
                        (start[a], size[a]) = (lo - first[a], hi - lo);
                        chunk[slab.space[a]] = from as u64;
                    }
                    parts.push(Part { chunk, to: Region { start, size }, whole });
                }
            }
        }
        parts
    }

    /// What of a chunk's `values` belongs to a part, in the dataset's order of axes.
    fn cut<'a, O>(&self, slab: &Slab, region: Region, part: &Part, values: &'a [O]) -> ArrayViewD<'a, O> {
        let mut view = ArrayViewD::from_shape(self.shape.as_slice(), values).expect("a chunk has its shape");
        for (axis, &from) in part.chunk.iter().enumerate() {
            let (at, count) =
                match (slab.space.iter().position(|&s| s == axis), slab.fixed.iter().find(|f| f.0 == axis)) {
                    (Some(a), _) => (slab.start[a] + region.start[a] + part.to.start[a], part.to.size[a]),
                    (None, Some((_, at))) => (*at, 1),
                    (None, None) => (0, 1),
                };
            let at = at - from as usize;
            view.slice_axis_inplace(Axis(axis), Slice::from(at..at + count));
        }
        view
    }

    /// A part's chunk, kept or as it is stored; `None` where there is none.
    fn packed(&self, dataset: &Dataset, part: &Part) -> hdf5::Result<Option<Packed>> {
        if let Some(bytes) = self.kept.get(&(self.number, part.chunk.clone())) {
            return Ok(Some(Packed::Kept(bytes)));
        }
        Ok(stored::chunk(dataset, &part.chunk, self.most)?.map(|(mask, bytes)| Packed::Filtered(mask, bytes)))
    }

    fn damaged(&self, slab: &Slab, part: &Part, why: &str) -> Error {
        let place: Vec<String> = part.chunk.iter().map(u64::to_string).collect();
        let found = format!("the chunk at ({}) cannot be unpacked: {why}; the file is damaged", place.join(", "));
        Error::format(slab.name(), found, "--steps A..B for the steps before")
    }
}

/// The planes of each layer of chunks, so that only chunks of one layer wait for each other to be put into place.
type Layers<'a, O> = Vec<(usize, Mutex<ArrayViewMut3<'a, O>>)>;

fn layers<'a, O>(whole: ArrayViewMut3<'a, O>, parts: &[Part]) -> Layers<'a, O> {
    let (mut rest, mut layers): (_, Layers<O>) = (Some(whole), Vec::new());
    for part in parts {
        if layers.last().is_some_and(|(first, _)| *first == part.to.start[2]) {
            continue;
        }
        if let Some(left) = rest.take() {
            let (layer, after) = left.split_at(Axis(0), part.to.size[2]);
            layers.push((part.to.start[2], Mutex::new(layer)));
            rest = Some(after);
        }
    }
    layers
}

/// Lets `put` write where a part goes, while no other part of its layer is being put into place.
fn put<O>(layers: &Layers<O>, part: &Part, put: impl FnOnce(ArrayViewMut3<O>)) {
    let Some((_, layer)) = layers.iter().find(|(first, _)| *first == part.to.start[2]) else { return };
    let mut layer = locked(layer);
    let mut view = layer.view_mut();
    for (axis, a) in [(1, 1), (2, 0)] {
        view.slice_axis_inplace(Axis(axis), Slice::from(part.to.start[a]..part.to.start[a] + part.to.size[a]));
    }
    put(view);
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(|e| e.into_inner())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chunks_of_all_datasets_share_one_limit() {
        let kept = Kept::new(100);
        let chunk = |bytes| Arc::new(vec![0; bytes]);
        for dataset in 0..3 {
            kept.put((dataset, vec![0]), chunk(40));
        }
        // The first gave way to the third; the second was asked for last, so that the next to go is the third.
        assert!(kept.get(&(0, vec![0])).is_none() && kept.get(&(1, vec![0])).is_some());
        kept.put((0, vec![0]), chunk(60));
        assert!(kept.get(&(2, vec![0])).is_none() && kept.get(&(1, vec![0])).is_some());
        // The same again counts once, and what can never fit drives nothing out.
        kept.put((0, vec![0]), chunk(60));
        kept.put((3, vec![0]), chunk(101));
        assert!(kept.get(&(0, vec![0])).is_some() && kept.get(&(1, vec![0])).is_some());
        assert_eq!(locked(&kept.chunks).1, 100);
    }
}
