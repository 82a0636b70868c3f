//! Part of a dataset as a field: hyperslabs read by region, axes permuted to (z, y, x), values unpacked.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use hdf5::{Dataset, H5Type, Hyperslab, SliceOrIndex};
use ndarray::{ArrayD, ArrayViewD, ArrayViewMut3, Axis, Ix3, s};

use super::chunks::{Chunks, Kept};
use super::filters;
use crate::error::{Error, Result};
use crate::field::Field;
use crate::grid::Region;
use crate::source::shape_text;

/// How stored numbers become values: `stored·scale + offset`; fills and what lies outside the valid range are NaN.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Packing {
    pub scale: f64,
    pub offset: f64,
    /// Stored numbers that mean "no value".
    pub fills: Vec<f64>,
    /// Stored numbers outside of this are no values either.
    pub valid: Option<[f64; 2]>,
}

impl Default for Packing {
    fn default() -> Self {
        Packing { scale: 1.0, offset: 0.0, fills: Vec::new(), valid: None }
    }
}

impl Packing {
    fn unpack(&self, stored: f64) -> f64 {
        let outside = self.valid.is_some_and(|[lo, hi]| stored < lo || stored > hi);
        if outside || self.fills.contains(&stored) { f64::NAN } else { stored * self.scale + self.offset }
    }
}

/// Three axes of a dataset at fixed places along the others.
#[derive(Debug, Clone)]
pub(crate) struct Slab {
    pub file: PathBuf,
    pub dataset: String,
    /// Rank that the axes were placed for.
    pub rank: usize,
    /// Dataset axis that runs along x, y, z.
    pub space: [usize; 3],
    /// Where along each other axis.
    pub fixed: Vec<(usize, usize)>,
    /// First stored value along x, y, z: files that keep ghost cells or several blocks.
    pub start: [usize; 3],
    /// The grid is the whole dataset, so that another size means another grid.
    pub whole: bool,
    pub packing: Packing,
}

impl Slab {
    /// Opens the dataset and checks that it still has the shape that was found.
    pub fn open(&self, size: [usize; 3], opened: &Opened) -> Result<SlabField> {
        let held = opened.dataset(&self.file, &self.dataset, self)?;
        let shape = held.dataset.shape();
        let fail = |found: String, remedy: &str| Err(Error::format(self.name(), found, remedy));
        if shape.len() != self.rank {
            let found =
                format!("has shape {}, {} axes where {} were expected", shape_text(&shape), shape.len(), self.rank);
            return fail(found, "--steps A..B for the steps that agree");
        }
        if let Some((axis, at)) = self.fixed.iter().find(|(axis, at)| *at >= shape[*axis]) {
            return fail(format!("shape {} ends before index {at} of axis {}", shape_text(&shape), axis + 1), "");
        }
        let is = self.space.map(|a| shape[a]);
        let fits =
            (0..3).all(|a| if self.whole { is[a] == size[a] } else { self.start[a].saturating_add(size[a]) <= is[a] });
        if !fits {
            let found = format!("the grid changes from {} to {} (x, y, z)", shape_text(&size), shape_text(&is));
            return fail(found, "--steps A..B for the steps before or after the change");
        }
        Ok(SlabField { held, slab: self.clone() })
    }

    /// `FILE:/dataset`.
    pub fn name(&self) -> String {
        format!("{}:{}", self.file.display(), self.dataset)
    }
}

/// A dataset held open.
pub(super) struct Held {
    pub dataset: Dataset,
    /// How to unpack its chunks without HDF5, where that is possible.
    chunks: Option<Chunks>,
}

/// Datasets held open from one step to the next.
pub(crate) struct Opened {
    kept: Mutex<VecDeque<(PathBuf, String, Arc<Held>)>>,
    /// Bytes of chunks that HDF5 keeps decoded at most, for each dataset.
    cache: usize,
    /// Chunks that are decoded here.
    chunks: Arc<Kept>,
}

impl Default for Opened {
    fn default() -> Self {
        Opened::new(None)
    }
}

impl Opened {
    /// Keeps decoded chunks within what is left to sources of `memory` bytes, so that reading slab by slab decodes each once.
    pub fn new(memory: Option<u64>) -> Self {
        let most = crate::source::decoded(memory) as usize;
        Opened { kept: Mutex::default(), cache: most / Self::KEPT, chunks: Arc::new(Kept::new(most)) }
    }

    /// Datasets kept: the three components of a vector and one more.
    const KEPT: usize = 4;

    pub(super) fn dataset(&self, path: &Path, name: &str, slab: &Slab) -> Result<Arc<Held>> {
        let mut kept = self.kept.lock().unwrap_or_else(|e| e.into_inner());
        if let Some((.., held)) = kept.iter().find(|(p, n, _)| p == path && n == name) {
            return Ok(held.clone());
        }
        let open = |cache| super::open_dataset(&super::open_file(path, cache)?, path, name);
        let mut dataset = open(0)?;
        let chunks = if slab.rank >= 3 { Chunks::of(&dataset, &self.chunks) } else { None };
        if chunks.is_none() {
            let cache = cache_bytes(&dataset, slab, self.cache);
            drop(dataset);
            dataset = open(cache)?;
        }
        let held = Arc::new(Held { dataset, chunks });
        if kept.len() == Self::KEPT {
            kept.pop_front();
        }
        kept.push_back((path.to_owned(), name.to_owned(), held.clone()));
        Ok(held)
    }
}

/// Bytes of chunks to keep decoded, `limit` at most: all of a step's, else those that reading plane after plane comes back to.
/// Chunks that are stored as they are need no cache: what is wanted of them is read from where it lies.
fn cache_bytes(dataset: &Dataset, slab: &Slab, limit: usize) -> usize {
    let (Some(chunk), Ok(kind)) = (dataset.chunk(), dataset.dtype()) else { return 0 };
    if dataset.filters().is_empty() {
        return 0;
    }
    let shape = dataset.shape();
    let bytes = chunk.iter().fold(kind.size().max(1), |b, &n| b.saturating_mul(n));
    let touched = |axes: &[usize]| {
        let counts = axes.iter().filter(|a| **a < chunk.len()).map(|&a| shape[a].div_ceil(chunk[a].max(1)));
        counts.fold(bytes, usize::saturating_mul)
    };
    let [x, y, z] = slab.space;
    let (step, layer) = (touched(&[x, y, z]), touched(&[x, y]));
    if step > limit && layer > limit {
        tracing::warn!(
            "{}: chunks of {} MiB in all lie side by side in a plane; where the memory for them is less, they are decoded \
             more than once",
            slab.name(),
            layer >> 20
        );
    }
    if step <= limit { step } else { layer.min(limit).max(bytes) }
}

/// Edge of the tiles in which transposed values are copied.
const TILE: usize = 32;

/// An open [`Slab`].
pub(crate) struct SlabField {
    held: Arc<Held>,
    slab: Slab,
}

impl SlabField {
    /// Reads a region in (z, y, x) order; `take` makes values of numbers that HDF5 converts to `T`, `narrow` of those that
    /// are unpacked here.
    fn read_as<T: H5Type + Copy, O: Copy + Default + Send>(
        &self,
        region: Region,
        out: &mut [O],
        take: impl Fn(T) -> O,
        narrow: impl Fn(f64) -> O + Sync,
    ) -> Result<()> {
        let Held { dataset, chunks } = &*self.held;
        match chunks {
            Some(chunks) => {
                chunks.read((dataset, &self.slab), region, out, narrow, |region, out| self.convert(region, out, &take))
            }
            None => self.convert(region, out, take),
        }
    }

    /// Has HDF5 read a region.
    fn convert<T: H5Type + Copy, O: Copy>(&self, region: Region, out: &mut [O], take: impl Fn(T) -> O) -> Result<()> {
        let mut along = vec![SliceOrIndex::from(0..1); self.slab.rank];
        for &(axis, at) in &self.slab.fixed {
            along[axis] = (at..at + 1).into();
        }
        for (a, &axis) in self.slab.space.iter().enumerate() {
            let start = self.slab.start[a] + region.start[a];
            along[axis] = (start..start + region.size[a]).into();
        }
        let dataset = &self.held.dataset;
        let read: ArrayD<T> =
            dataset.read_slice(Hyperslab::from(along)).map_err(|e| read_error(&self.slab.name(), dataset, &e))?;
        let [nx, ny, nz] = region.size;
        let out = ArrayViewMut3::from_shape((nz, ny, nx), out)
            .map_err(|e| Error::format(self.slab.name(), e.to_string(), ""))?;
        place(read.view(), self.slab.space, out, take);
        Ok(())
    }
}

/// Copies `stored`, whose axes `space` run along x, y, z and whose others have one place, to `out` in (z, y, x) order.
pub(super) fn place<T: Copy, O>(
    stored: ArrayViewD<T>,
    space: [usize; 3],
    mut out: ArrayViewMut3<O>,
    take: impl Fn(T) -> O,
) {
    let [x, y, z] = space;
    let others = (0..stored.ndim()).filter(|a| !space.contains(a));
    let order: Vec<usize> = [z, y, x].into_iter().chain(others).collect();
    let mut stored = stored.permuted_axes(order);
    while stored.ndim() > 3 {
        let last = stored.ndim() - 1;
        stored = stored.index_axis_move(Axis(last), 0);
    }
    let stored = stored.into_dimensionality::<Ix3>().expect("three axes are left");
    if let (Some(out), Some(values)) = (out.as_slice_mut(), stored.as_slice()) {
        out.iter_mut().zip(values).for_each(|(o, &v)| *o = take(v));
        return;
    }
    if stored.strides()[2] == 1 {
        ndarray::Zip::from(out.rows_mut()).and(stored.rows()).for_each(|mut out, row| {
            out.iter_mut().zip(row).for_each(|(o, &v)| *o = take(v));
        });
        return;
    }
    // Tiles of z and x, so that each cache line of either side is used whole whichever axis runs fastest.
    let (nz, ny, nx) = out.dim();
    for (z, y, x) in
        (0..nz).step_by(TILE).flat_map(|z| (0..ny).flat_map(move |y| (0..nx).step_by(TILE).map(move |x| (z, y, x))))
    {
        let tile = s![z..nz.min(z + TILE), y, x..nx.min(x + TILE)];
        ndarray::Zip::from(out.slice_mut(tile)).and(stored.slice(tile)).for_each(|o, &v| *o = take(v));
    }
}

impl Field for SlabField {
    fn read(&self, region: Region, out: &mut [f32]) -> Result<()> {
        let packing = &self.slab.packing;
        if *packing == Packing::default() {
            return self.read_as(region, out, |v: f32| v, |v| v as f32);
        }
        self.read_as(region, out, |v: f64| packing.unpack(v) as f32, |v| packing.unpack(v) as f32)
    }

    fn read_f64(&self, region: Region, out: &mut [f64]) -> Result<()> {
        let packing = &self.slab.packing;
        self.read_as(region, out, |v: f64| packing.unpack(v), |v| packing.unpack(v))
    }
}

/// What kept HDF5 from reading values, in words.
pub(super) fn read_error(name: &str, dataset: &Dataset, e: &hdf5::Error) -> Error {
    let text = e.to_string();
    let absent = dataset.filters().into_iter().find(|f| !f.is_available());
    if let Some(filter) = absent {
        let called = filters::name_of(filter.id());
        let called = if called.is_empty() { "which is not registered" } else { called };
        let found = format!("compressed by filter {} ({called}), which is not read", filter.id());
        return Error::format(
            name,
            found,
            "HDF5_PLUGIN_PATH=FOLDER with its plugin, or h5repack -f GZIP=4 IN OUT where it is known",
        );
    }
    if text.contains("filter") {
        let found = format!("its values cannot be decompressed: the file is damaged or incomplete ({text})");
        return Error::format(name, found, "--steps A..B for the steps before");
    }
    if text.contains("external") {
        let found = format!("its values lie in an external raw file that cannot be opened ({text})");
        return Error::format(name, found, "HDF5_EXTFILE_PREFIX='${ORIGIN}' when that file lies beside this one");
    }
    if text.contains("conversion path") {
        return Error::format(
            name,
            format!("its values are not numbers ({text})"),
            "--field NAME of a numeric dataset",
        );
    }
    let found = format!("values cannot be read: the file is damaged or incomplete ({text})");
    Error::format(name, found, "--steps A..B for the steps before")
}
