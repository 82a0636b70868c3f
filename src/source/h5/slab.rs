//! Part of a dataset as a field: hyperslabs read by region, axes permuted to (z, y, x), values unpacked.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use hdf5::{Dataset, H5Type, Hyperslab, SliceOrIndex};
use ndarray::{ArrayD, ArrayView3, ArrayViewMut3, Axis, s};

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
        let dataset = opened.dataset(&self.file, &self.dataset, self)?;
        let shape = dataset.shape();
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
        Ok(SlabField { dataset, slab: self.clone() })
    }

    /// `FILE:/dataset`.
    fn name(&self) -> String {
        format!("{}:{}", self.file.display(), self.dataset)
    }
}

/// Decoded chunks kept at most, so that reading brick by brick decodes each chunk once.
const CACHE: usize = 256 << 20;

/// Datasets held open from one step to the next.
#[derive(Default)]
pub(crate) struct Opened(Mutex<VecDeque<(PathBuf, String, Arc<Dataset>)>>);

impl Opened {
    /// Datasets kept: the three components of a vector and one more.
    const KEPT: usize = 4;

    pub(super) fn dataset(&self, path: &Path, name: &str, slab: &Slab) -> Result<Arc<Dataset>> {
        let mut kept = self.0.lock().unwrap_or_else(|e| e.into_inner());
        if let Some((.., dataset)) = kept.iter().find(|(p, n, _)| p == path && n == name) {
            return Ok(dataset.clone());
        }
        let first = super::open_dataset(&super::open_file(path, 0)?, path, name)?;
        let cache = cache_bytes(&first, slab);
        drop(first);
        let dataset = Arc::new(super::open_dataset(&super::open_file(path, cache)?, path, name)?);
        if kept.len() == Self::KEPT {
            kept.pop_front();
        }
        kept.push_back((path.to_owned(), name.to_owned(), dataset.clone()));
        Ok(dataset)
    }
}

/// Bytes of the chunks that one step touches, at most [`CACHE`] but always one chunk.
fn cache_bytes(dataset: &Dataset, slab: &Slab) -> usize {
    let (Some(chunk), Ok(kind)) = (dataset.chunk(), dataset.dtype()) else { return 0 };
    let shape = dataset.shape();
    let bytes = chunk.iter().fold(kind.size().max(1), |b, &n| b.saturating_mul(n));
    let touched = slab
        .space
        .iter()
        .filter(|a| **a < chunk.len())
        .fold(1usize, |n, &a| n.saturating_mul(shape[a].div_ceil(chunk[a].max(1))));
    bytes.saturating_mul(touched).min(CACHE).max(bytes)
}

/// Edge of the tiles in which transposed values are copied.
const TILE: usize = 32;

/// An open [`Slab`].
pub(crate) struct SlabField {
    dataset: Arc<Dataset>,
    slab: Slab,
}

impl SlabField {
    /// Reads values of type `T` as stored and hands them to `take` in (z, y, x) order.
    fn read_as<T: H5Type + Copy, O: Copy>(&self, region: Region, out: &mut [O], take: impl Fn(T) -> O) -> Result<()> {
        let mut along = vec![SliceOrIndex::from(0..1); self.slab.rank];
        for &(axis, at) in &self.slab.fixed {
            along[axis] = (at..at + 1).into();
        }
        for (a, &axis) in self.slab.space.iter().enumerate() {
            let start = self.slab.start[a] + region.start[a];
            along[axis] = (start..start + region.size[a]).into();
        }
        let read: ArrayD<T> = self
            .dataset
            .read_slice(Hyperslab::from(along))
            .map_err(|e| read_error(&self.slab.name(), &self.dataset, &e))?;
        let [x, y, z] = self.slab.space;
        let others = (0..self.slab.rank).filter(|a| ![x, y, z].contains(a));
        let mut stored = read.view().permuted_axes([z, y, x].into_iter().chain(others).collect::<Vec<_>>());
        while stored.ndim() > 3 {
            let last = stored.ndim() - 1;
            stored = stored.index_axis_move(Axis(last), 0);
        }
        if let Some(values) = stored.as_slice() {
            out.iter_mut().zip(values).for_each(|(o, &v)| *o = take(v));
            return Ok(());
        }
        let wrong = |e: ndarray::ShapeError| Error::format(self.slab.name(), e.to_string(), "");
        let [nx, ny, nz] = region.size;
        let mut out = ArrayViewMut3::from_shape((nz, ny, nx), out).map_err(wrong)?;
        let stored: ArrayView3<T> = stored.into_dimensionality().map_err(wrong)?;
        // Tiles of z and x, so that each cache line of either side is used whole whichever axis runs fastest.
        for (z, y, x) in
            (0..nz).step_by(TILE).flat_map(|z| (0..ny).flat_map(move |y| (0..nx).step_by(TILE).map(move |x| (z, y, x))))
        {
            let tile = s![z..nz.min(z + TILE), y, x..nx.min(x + TILE)];
            ndarray::Zip::from(out.slice_mut(tile)).and(stored.slice(tile)).for_each(|o, &v| *o = take(v));
        }
        Ok(())
    }
}

impl Field for SlabField {
    fn read(&self, region: Region, out: &mut [f32]) -> Result<()> {
        if self.slab.packing == Packing::default() {
            return self.read_as(region, out, |v: f32| v);
        }
        self.read_as(region, out, |v: f64| self.slab.packing.unpack(v) as f32)
    }

    fn read_f64(&self, region: Region, out: &mut [f64]) -> Result<()> {
        self.read_as(region, out, |v: f64| self.slab.packing.unpack(v))
    }
}

/// What kept HDF5 from reading values, in words.
pub(super) fn read_error(name: &str, dataset: &Dataset, e: &hdf5::Error) -> Error {
    let text = e.to_string();
    let absent = dataset.filters().into_iter().find(|f| !f.is_available());
    if let Some(filter) = absent {
        let known = [
            (32000, "LZF"),
            (32001, "Blosc"),
            (32004, "LZ4"),
            (32008, "Bitshuffle"),
            (32013, "ZFP"),
            (32015, "Zstandard"),
        ];
        let called = known.iter().find(|(id, _)| *id == filter.id()).map_or("", |(_, n)| n);
        let found = format!("compressed by filter {} {called}, which this HDF5 lacks", filter.id());
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
