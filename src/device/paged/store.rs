//! Where a volume is that may not fit: nowhere yet, in the inner device's memory, in a scratch file, in the file that it
//! came from, or in a recipe that makes it of what is in such a file.

use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};

use super::scratch::Scratch;
use crate::device::{Buffer, Optic};
use crate::error::Result;
use crate::field::{self, Field};
use crate::grid::{BrickLayout, Slab};
use crate::transfer::Table;

/// A volume of `len` values.
pub(crate) struct Store {
    pub len: usize,
    pub(super) content: Content,
    /// A copy in the inner device's memory of what is not there, for kernels that need the whole.
    pub(super) near: OnceLock<(Buffer, Held)>,
    /// A copy in a file of what is not in one that the host can look at, for the same.
    pub(super) copy: OnceLock<Scratch>,
}

impl Store {
    pub(super) fn new(len: usize, content: Content) -> Self {
        Store { len, content, near: OnceLock::new(), copy: OnceLock::new() }
    }

    /// Forgets what is known of values that will not stay.
    pub(super) fn forget(&mut self) {
        self.near.take();
        self.copy.take();
    }
}

pub(super) enum Content {
    /// Zeros; nothing is held.
    Zero,
    /// Held for as long as the buffer lives.
    Resident(Buffer, #[allow(dead_code)] Held),
    Scratch(Scratch),
    Data(Data),
    Optic(Box<Recipe>),
}

/// Data of a step where it lies.
#[derive(Clone)]
pub(super) struct Data {
    pub field: Arc<dyn Field>,
    pub size: [usize; 3],
    /// True where all has been looked through, and no hole was there.
    pub clean: bool,
    /// What was found.
    pub index: Option<Arc<Index>>,
}

/// The smallest and the largest value of each brick with a halo of one value.
pub(super) struct Index {
    pub bricks: BrickLayout,
    pub ranges: Vec<[f32; 2]>,
}

/// A property of the medium, computed when it is read.
pub(super) struct Recipe {
    pub optic: Optic,
    pub table: Table,
    pub data: Data,
    pub size: [usize; 3],
}

/// Bytes of the inner device that are in use; given back when dropped.
pub(super) struct Held {
    bytes: u64,
    of: Arc<AtomicU64>,
}

impl Held {
    pub fn new(bytes: u64, of: &Arc<AtomicU64>) -> Self {
        of.fetch_add(bytes, Ordering::Relaxed);
        Held { bytes, of: of.clone() }
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        self.of.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

impl Data {
    /// For each of some runs of planes the rows between which all lies that a table shows.
    pub fn shown(&self, table: &Table, planes: &[Range<usize>]) -> Vec<Range<usize>> {
        let Some(index) = &self.index else { return vec![0..self.size[1]; planes.len()] };
        let ([across, along, _], edge) = (index.bricks.counts(), index.bricks.edge);
        let majorant = table.majorants(&index.ranges);
        let layers: Vec<Range<usize>> = majorant
            .chunks_exact(across * along)
            .map(|layer| {
                let shows = |row: &[f32]| row.iter().any(|m| *m > 0.0);
                let first = layer.chunks_exact(across).position(shows).unwrap_or(along);
                let last = layer.chunks_exact(across).rposition(shows).map_or(first, |row| row + 1);
                first * edge..(last * edge).min(self.size[1])
            })
            .collect();
        let over = |planes: &Range<usize>| {
            let layers = layers[planes.start / edge..planes.end.div_ceil(edge)].iter().filter(|rows| !rows.is_empty());
            layers.cloned().reduce(|a, b| a.start.min(b.start)..a.end.max(b.end)).unwrap_or(0..0)
        };
        planes.iter().map(over).collect()
    }

    /// Reads planes, holes marked; adds what was read to `bytes`, and returns the number of holes.
    pub fn read(&self, slab: &Slab, out: &mut [f32], bytes: &AtomicU64) -> Result<u64> {
        self.read_rows(slab, 0..slab.size[1], out, bytes)
    }

    /// The same for some rows of each plane.
    pub fn read_rows(&self, slab: &Slab, rows: Range<usize>, out: &mut [f32], bytes: &AtomicU64) -> Result<u64> {
        bytes.fetch_add(4 * (slab.size[0] * rows.len() * slab.planes.len()) as u64, Ordering::Relaxed);
        field::read_rows(&*self.field, slab, rows, out, self.clean)
    }
}
