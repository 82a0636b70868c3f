//! NumPy arrays as blocks of values, wherever and in whatever order they lie.

use gloaming::dtype::{Dtype, Kind};
use gloaming::insitu::Strided;
use gloaming::{Error, Result};
use numpy::{PyArrayDescrMethods, PyArrayDyn, PyArrayMethods, PyUntypedArray, PyUntypedArrayMethods};
use pyo3::prelude::*;

/// The memory of a NumPy array, which lives as long as this.
pub struct Memory {
    low: *const u8,
    length: usize,
    _array: Py<PyUntypedArray>,
}

// SAFETY: the memory stays where it is while the array lives, and is only read. Python code that writes to it in the meantime
// races with the reading, as with every NumPy function that releases the interpreter's lock: the values are then a mixture of
// old and new.
unsafe impl Send for Memory {}
// SAFETY: as above.
unsafe impl Sync for Memory {}

impl AsRef<[u8]> for Memory {
    fn as_ref(&self) -> &[u8] {
        // SAFETY: `block` took the bytes between the array's lowest and highest from NumPy, and the array is kept.
        unsafe { std::slice::from_raw_parts(self.low, self.length) }
    }
}

/// A three-dimensional array (z, y, x) as a block of values; nothing is copied. `spacing` and `origin` are along x, y, z.
///
/// # Errors
/// [`Error::Unsupported`] for another number of axes or a type that has no place among real numbers.
pub fn block(array: &Bound<'_, PyUntypedArray>, spacing: [f64; 3], origin: [f64; 3]) -> Result<Strided<Memory>> {
    let (&[nz, ny, nx], &[sz, sy, sx]) = (array.shape(), array.strides()) else {
        let shape = array.shape();
        return Err(Error::Unsupported(format!("an array of shape {shape:?}\n  try: one of three axes (z, y, x)")));
    };
    let dtype = dtype(array)?;
    let (size, strides) = ([nx, ny, nz], [sx, sy, sz]);
    let (mut before, mut after) = (0usize, dtype.bytes());
    for (n, stride) in size.into_iter().zip(strides) {
        let reach = n.saturating_sub(1) * stride.unsigned_abs();
        if stride < 0 { before += reach } else { after += reach }
    }
    let empty = size.contains(&0);
    // SAFETY: only the address of the first value is taken, and bytes have no alignment that the values' type could lack.
    let first = unsafe { array.cast_unchecked::<PyArrayDyn<u8>>() }.data().cast_const();
    let memory = Memory {
        low: if empty { std::ptr::NonNull::dangling().as_ptr() } else { first.wrapping_sub(before) },
        length: if empty { 0 } else { before + after },
        _array: array.clone().unbind(),
    };
    Ok(Strided::new(memory, dtype, size).byte_strides(strides).first(before).spacing(spacing).origin(origin))
}

fn dtype(array: &Bound<'_, PyUntypedArray>) -> Result<Dtype> {
    let dtype = array.dtype();
    let kind = match (dtype.kind(), dtype.itemsize()) {
        (b'f', 2) => Kind::F16,
        (b'f', 4) => Kind::F32,
        (b'f', 8) => Kind::F64,
        (b'i', 1) => Kind::I8,
        (b'i', 2) => Kind::I16,
        (b'i', 4) => Kind::I32,
        (b'i', 8) => Kind::I64,
        (b'u' | b'b', 1) => Kind::U8,
        (b'u', 2) => Kind::U16,
        (b'u', 4) => Kind::U32,
        (b'u', 8) => Kind::U64,
        _ => return Err(Error::Unsupported(format!("an array of {dtype}\n  try: array.astype('float32')"))),
    };
    let native = Dtype::native(kind);
    Ok(match dtype.byteorder() {
        b'<' => Dtype { big_endian: false, ..native },
        b'>' => Dtype { big_endian: true, ..native },
        _ => native,
    })
}
