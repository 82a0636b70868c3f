//! Values in somebody else's memory, taken as they lie: any type, any strides, ghost layers left out.

use std::ops::Range;

use crate::dtype::{Dtype, Kind};
use crate::error::{Error, Result};
use crate::field::Field;
use crate::grid::{Grid, Region};

/// A block of values in memory, borrowed (`Strided<&[u8]>`) or owned (`Strided<Values<f64>>`, or anything else that gives
/// bytes). Value (i, j, k) of the shown region lies at `first + (start + (i, j, k))·strides`, all in bytes.
///
/// ```
/// use gloaming::insitu::Strided;
/// use gloaming::Region;
///
/// // 8×6×4 values with one layer of ghosts all round, slowest along x as C arrays a[x][y][z] are.
/// let values = vec![0.0f64; 10 * 8 * 6];
/// let shown = Strided::of(&values, [10, 8, 6])
///     .strides([8 * 6, 6, 1])
///     .region(Region { start: [1; 3], size: [8, 6, 4] })
///     .spacing([0.1; 3]);
/// assert_eq!(shown.grid().size, [8, 6, 4]);
/// assert_eq!(shown.grid().origin, [0.1, 0.1, 0.1]); // the array's own first value, a ghost, is at the origin
/// ```
#[derive(Debug, Clone)]
pub struct Strided<B> {
    bytes: B,
    dtype: Dtype,
    size: [usize; 3],
    /// Bytes between neighbours along x, y, z.
    strides: [isize; 3],
    first: usize,
    region: Region,
    spacing: [f64; 3],
    origin: [f64; 3],
}

/// A number that a block may be made of.
pub trait Number: bytemuck::NoUninit + Send + Sync + 'static {
    /// Its type.
    const KIND: Kind;
}

macro_rules! numbers {
    ($($t:ty: $kind:ident),*) => { $(impl Number for $t { const KIND: Kind = Kind::$kind; })* };
}
numbers!(u8: U8, i8: I8, u16: U16, i16: I16, u32: U32, i32: I32, u64: U64, i64: I64, f32: F32, f64: F64);

/// Values in between that are copied along must be fewer than one in this many.
const LOOSE: usize = 4;

/// Owned numbers as bytes.
#[derive(Debug, Clone)]
pub struct Values<T>(pub Vec<T>);

impl<T: Number> AsRef<[u8]> for Values<T> {
    fn as_ref(&self) -> &[u8] {
        bytemuck::cast_slice(&self.0)
    }
}

impl<'a> Strided<&'a [u8]> {
    /// Borrowed values of an array of `size`, x fastest until [`Strided::strides`] says otherwise.
    pub fn of<T: Number>(values: &'a [T], size: [usize; 3]) -> Self {
        Strided::new(bytemuck::cast_slice(values), Dtype::native(T::KIND), size)
    }
}

impl<T: Number> Strided<Values<T>> {
    /// Values given away, of an array of `size`, x fastest until [`Strided::strides`] says otherwise.
    pub fn owned(values: Vec<T>, size: [usize; 3]) -> Self {
        Strided::new(Values(values), Dtype::native(T::KIND), size)
    }

    /// The memory that they are in.
    pub(super) fn into_values(self) -> Vec<T> {
        self.bytes.0
    }
}

impl<B: AsRef<[u8]>> Strided<B> {
    /// Bytes that hold numbers of type `dtype`, at any alignment, of an array of `size`, dense and x fastest until told
    /// otherwise. Unit spacing, the first value at the origin, everything shown.
    pub fn new(bytes: B, dtype: Dtype, size: [usize; 3]) -> Self {
        let n = dtype.bytes() as isize;
        let [nx, ny, _] = size.map(|n| n as isize);
        Strided {
            bytes,
            dtype,
            size,
            strides: [n, nx.saturating_mul(n), nx.saturating_mul(ny).saturating_mul(n)],
            first: 0,
            region: Region { start: [0; 3], size },
            spacing: [1.0; 3],
            origin: [0.0; 3],
        }
    }

    /// Numbers, not bytes, between neighbours along x, y, z; may be negative or 0.
    pub fn strides(self, numbers: [isize; 3]) -> Self {
        let n = self.dtype.bytes() as isize;
        self.byte_strides(numbers.map(|s| s.saturating_mul(n)))
    }

    /// Bytes between neighbours along x, y, z; may be negative or 0.
    pub fn byte_strides(self, strides: [isize; 3]) -> Self {
        Strided { strides, ..self }
    }

    /// The byte at which value (0, 0, 0) begins; 0 unless strides are negative or bytes lead the array.
    pub fn first(self, first: usize) -> Self {
        Strided { first, ..self }
    }

    /// What is shown of the array: ghost layers lie outside.
    pub fn region(self, region: Region) -> Self {
        Strided { region, ..self }
    }

    /// World length between neighbours along x, y, z.
    pub fn spacing(self, spacing: [f64; 3]) -> Self {
        Strided { spacing, ..self }
    }

    /// World position of value (0, 0, 0) of the array, ghosts included.
    pub fn origin(self, origin: [f64; 3]) -> Self {
        Strided { origin, ..self }
    }

    /// Where the shown values sit.
    pub fn grid(&self) -> Grid {
        let origin = std::array::from_fn(|a| self.origin[a] + self.region.start[a] as f64 * self.spacing[a]);
        Grid { size: self.region.size, spacing: self.spacing, origin }
    }

    /// Bytes of the shown values.
    pub fn shown_bytes(&self) -> u64 {
        (self.region.len() * self.dtype.bytes()) as u64
    }

    /// Refuses what cannot be read or shown.
    ///
    /// # Errors
    /// [`Error::Unsupported`] when nothing is shown, the region leaves the array, the array leaves the memory, or the
    /// spacing is not positive.
    pub fn check(&self) -> Result<()> {
        let refuse = |what: String| Err(Error::Unsupported(what));
        let Region { start, size } = self.region;
        if size.contains(&0) {
            return refuse(format!("a block of {size:?} values: there is nothing to light"));
        }
        if (0..3).any(|a| start[a].checked_add(size[a]).is_none_or(|end| end > self.size[a])) {
            return refuse(format!(
                "a region of {size:?} values from {start:?} in an array of {:?}\n  try: start + size at most the array's size",
                self.size
            ));
        }
        if !self.spacing.iter().all(|s| *s > 0.0 && s.is_finite()) || !self.origin.iter().all(|o| o.is_finite()) {
            return refuse(format!(
                "spacing {:?}, origin {:?}\n  try: spacing above 0, and finite numbers",
                self.spacing, self.origin
            ));
        }
        let number = self.dtype.bytes() as i128;
        let (mut low, mut high) = (self.first as i128, self.first as i128);
        for a in 0..3 {
            let ends = [start[a], start[a] + size[a] - 1].map(|i| i as i128 * self.strides[a] as i128);
            low += ends[0].min(ends[1]);
            high += ends[0].max(ends[1]);
        }
        let length = self.bytes.as_ref().len() as i128;
        if low < 0 || high + number > length {
            return refuse(format!(
                "values at bytes {low} to {} of {length}: size {:?}, strides of {:?} bytes\n  try: strides that stay inside the memory",
                high + number,
                self.size,
                self.strides
            ));
        }
        Ok(())
    }

    /// Reads a region of the shown values in (z, y, x) order; the block has been checked.
    fn gather<T: Copy + Send>(&self, region: Region, out: &mut [T], narrow: impl Fn(f64) -> T + Copy) {
        let bytes = self.bytes.as_ref();
        let [i0, j0, k0] = region.start;
        let at = |i: usize, j: usize, k: usize| self.at([i0 + i, j0 + j, k0 + k]);
        let [nx, ny, nz] = region.size;
        let strides = self.strides.map(isize::unsigned_abs);
        if strides[0] <= strides[1].min(strides[2]) || nx == 1 {
            for (row, out) in out.chunks_exact_mut(nx).enumerate() {
                self.dtype.decode(bytes, at(0, row % ny, row / ny), self.strides[0], out, narrow);
            }
            return;
        }
        // Values fastest along y or z: a few rows' worth of x at a time, so that a cache line is used while it is there.
        const ABREAST: usize = 8;
        let fast_is_z = strides[2] < strides[1];
        let (fast, slow) = if fast_is_z { (nz, ny) } else { (ny, nz) };
        for s in 0..slow {
            for i in (0..nx).step_by(ABREAST) {
                for f in 0..fast {
                    let (j, k) = if fast_is_z { (s, f) } else { (f, s) };
                    let to = (k * ny + j) * nx;
                    let out = &mut out[to + i..to + nx.min(i + ABREAST)];
                    self.dtype.decode(bytes, at(i, j, k), self.strides[0], out, narrow);
                }
            }
        }
    }

    /// True where rows along x can be copied as they lie.
    fn has_plain_rows(&self) -> bool {
        self.dtype == Dtype::native(Kind::F32) && self.strides[0] == 4
    }

    /// Copies a region of the shown values, whose rows are plain; the block has been checked.
    fn copy_rows(&self, region: Region, out: &mut [f32]) {
        let bytes = self.bytes.as_ref();
        let [nx, ny, nz] = region.size;
        let [i0, j0, k0] = region.start;
        let mut rows = bytemuck::cast_slice_mut(out).chunks_exact_mut(4 * nx);
        // Rows are short: a division for each would take as long as the row itself.
        for k in 0..nz {
            let mut from = self.at([i0, j0, k0 + k]);
            for out in rows.by_ref().take(ny) {
                out.copy_from_slice(&bytes[from..from + 4 * nx]);
                from = from.wrapping_add_signed(self.strides[1]);
            }
        }
    }

    /// The bytes from the first to the last shown value, in the order of memory; the block has been checked.
    fn span(&self) -> Range<usize> {
        let corners = |pick: fn(isize) -> bool| {
            let far: isize =
                (0..3).map(|a| (self.region.size[a] - 1) as isize * self.strides[a]).filter(|d| pick(*d)).sum();
            self.at([0; 3]).wrapping_add_signed(far)
        };
        corners(|d| d < 0)..corners(|d| d > 0) + self.dtype.bytes()
    }

    /// A copy of the shown values, in the memory of an earlier one. Native f32 that lie together, perhaps with ghosts between them
    /// or in another order of axes, are copied in one piece as they lie: that holds their owner for the shortest time, and they
    /// are sorted where they are read. Other values become f32, dense. The block has been checked.
    ///
    /// # Errors
    /// [`Error::OutOfMemory`].
    pub(super) fn copied(&self, mut memory: Vec<f32>) -> Result<Strided<Values<f32>>> {
        let span = self.span();
        let shown = self.region.len();
        let whole = self.dtype == Dtype::native(Kind::F32)
            && self.strides.iter().all(|s| s % 4 == 0)
            && span.len() / 4 <= shown + shown / LOOSE;
        let length = if whole { span.len() / 4 } else { shown };
        let more = length.saturating_sub(memory.len());
        let lacking = |_| Error::OutOfMemory { needed: 4 * length as u64, budget: 0 };
        memory.try_reserve_exact(more).map_err(lacking)?;
        memory.resize(length, 0.0);
        let Grid { size, spacing, origin } = self.grid();
        if whole {
            bytemuck::cast_slice_mut(&mut memory).copy_from_slice(&self.bytes.as_ref()[span.clone()]);
        } else {
            self.gather(Region { start: [0; 3], size }, &mut memory, |v| v as f32);
        }
        let copy = Strided::owned(memory, size).spacing(spacing).origin(origin);
        Ok(if whole { copy.first(self.at([0; 3]) - span.start).byte_strides(self.strides) } else { copy })
    }

    /// Where a shown value begins.
    fn at(&self, index: [usize; 3]) -> usize {
        let offset: isize = (0..3).map(|a| (self.region.start[a] + index[a]) as isize * self.strides[a]).sum();
        self.first.wrapping_add_signed(offset)
    }
}

/// An owned block is a field as it is: it is read, and converted, where the field is lit.
impl<B: AsRef<[u8]> + Send + Sync> Field for Strided<B> {
    fn read(&self, region: Region, out: &mut [f32]) -> Result<()> {
        self.check()?;
        if self.has_plain_rows() {
            self.copy_rows(region, out);
        } else {
            self.gather(region, out, |v| v as f32);
        }
        Ok(())
    }

    fn is_resident(&self) -> bool {
        self.has_plain_rows()
    }

    fn read_f64(&self, region: Region, out: &mut [f64]) -> Result<()> {
        self.check()?;
        self.gather(region, out, |v| v);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SIZE: [usize; 3] = [11, 7, 5];

    /// An array whose value at (i, j, k) is `i + 20 j + 400 k`, laid out with the axes in the given order, fastest first,
    /// some of them backwards.
    fn laid_out<T: Number>(
        fastest_first: [usize; 3],
        backwards: [bool; 3],
        number: impl Fn(usize) -> T,
    ) -> (Vec<T>, [isize; 3], usize) {
        let mut strides = [0isize; 3];
        let mut step = 1;
        for a in fastest_first {
            strides[a] = step;
            step *= SIZE[a] as isize;
        }
        let mut first = 0;
        for a in 0..3 {
            if backwards[a] {
                first += strides[a] * (SIZE[a] as isize - 1);
                strides[a] = -strides[a];
            }
        }
        let mut values = vec![number(0); SIZE.iter().product()];
        for (k, j, i) in itertools(SIZE) {
            let at = first + i as isize * strides[0] + j as isize * strides[1] + k as isize * strides[2];
            values[at as usize] = number(i + 20 * j + 400 * k);
        }
        (values, strides, first as usize * size_of::<T>())
    }

    fn itertools([nx, ny, nz]: [usize; 3]) -> impl Iterator<Item = (usize, usize, usize)> {
        (0..nx * ny * nz).map(move |n| (n / (nx * ny), n / nx % ny, n % nx))
    }

    fn shown_as<T: Number>(
        order: [usize; 3],
        backwards: [bool; 3],
        region: Region,
        number: impl Fn(usize) -> T,
    ) -> Vec<f32> {
        let (values, strides, first) = laid_out(order, backwards, number);
        let block = Strided::of(&values, SIZE).strides(strides).first(first).region(region);
        block.check().unwrap();
        let copy = block.copied(vec![7.0; 3]).unwrap();
        assert_eq!(copy.grid(), block.grid());
        let [mut out, mut twice] = [(); 2].map(|()| vec![-1.0; region.len()]);
        block.read(Region { start: [0; 3], size: region.size }, &mut out).unwrap();
        copy.read(Region { start: [0; 3], size: region.size }, &mut twice).unwrap();
        assert_eq!(out, twice);
        let (half, mut again) = (region.size.map(|n| n.div_ceil(2)), vec![-1.0; region.len()]);
        let part = Region { start: std::array::from_fn(|a| region.size[a] - half[a]), size: half };
        block.read(part, &mut again[..part.len()]).unwrap();
        for (n, (k, j, i)) in itertools(half).enumerate() {
            let [x, y, z] = [i + part.start[0], j + part.start[1], k + part.start[2]];
            assert_eq!(again[n], out[(z * region.size[1] + y) * region.size[0] + x]);
        }
        out
    }

    proptest! {
        /// Every order of axes, direction, type and region gives the same values.
        #[test]
        fn values_are_found_wherever_they_lie(
            order in Just([0usize, 1, 2]).prop_shuffle(),
            backwards in any::<[bool; 3]>(),
            start in [0usize..10, 0usize..6, 0usize..4],
        ) {
            let region = Region { start, size: std::array::from_fn(|a| SIZE[a] - start[a]) };
            let expected: Vec<f32> = itertools(region.size)
                .map(|(k, j, i)| (i + start[0] + 20 * (j + start[1]) + 400 * (k + start[2])) as f32)
                .collect();
            prop_assert_eq!(&shown_as(order, backwards, region, |v| v as f32), &expected);
            prop_assert_eq!(&shown_as(order, backwards, region, |v| v as f64), &expected);
            prop_assert_eq!(&shown_as(order, backwards, region, |v| v as i16), &expected);
            prop_assert_eq!(&shown_as(order, backwards, region, |v| v as u64), &expected);
        }
    }

    #[test]
    fn what_lies_outside_is_refused() {
        let values = [0.0f32; 24];
        let all = || Strided::of(&values, [4, 3, 2]);
        assert!(all().check().is_ok());
        let why = |block: Strided<&[u8]>| block.check().unwrap_err().to_string();
        assert!(why(all().strides([1, 4, 13])).contains("100 of 96"));
        assert!(why(all().strides([-1, 4, 12])).contains("bytes -12"));
        assert!(why(all().first(2)).contains("98 of 96"));
        assert!(why(Strided::of(&values, [4, 0, 2])).contains("nothing to light"));
        assert!(why(all().region(Region { start: [1, 0, 0], size: [4, 3, 2] })).contains("start + size"));
        assert!(why(all().spacing([1.0, 0.0, 1.0])).contains("spacing"));
        assert!(why(all().strides([isize::MAX; 3])).contains("strides"));
        // Half a byte's worth of misalignment is nobody's fault.
        let bytes: Vec<u8> = [0u8].into_iter().chain(7.5f32.to_ne_bytes()).collect();
        let mut out = [0.0];
        let block = Strided::new(&bytes, Dtype::native(Kind::F32), [1; 3]).first(1);
        block.check().unwrap();
        block.read(Region { start: [0; 3], size: [1; 3] }, &mut out).unwrap();
        assert_eq!(out, [7.5]);
    }
}
