//! Blocks of values in C's memory.

use std::ffi::c_void;

use gloaming::dtype::{Dtype, Kind};
use gloaming::insitu::Strided;
use gloaming::{Error, Region};

/// uint8_t
pub const GLOAMING_U8: i32 = 1;
/// int8_t
pub const GLOAMING_I8: i32 = 2;
/// uint16_t
pub const GLOAMING_U16: i32 = 3;
/// int16_t
pub const GLOAMING_I16: i32 = 4;
/// uint32_t
pub const GLOAMING_U32: i32 = 5;
/// int32_t
pub const GLOAMING_I32: i32 = 6;
/// uint64_t
pub const GLOAMING_U64: i32 = 7;
/// int64_t
pub const GLOAMING_I64: i32 = 8;
/// IEEE 754 binary16
pub const GLOAMING_F16: i32 = 9;
/// float
pub const GLOAMING_F32: i32 = 10;
/// double
pub const GLOAMING_F64: i32 = 11;

/// How values lie in memory and in space. Set what is not needed to 0: `gloaming_block b = {.dims = {nx, ny, nz}, .type =
/// GLOAMING_F32};`
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub struct gloaming_block {
    /// Values along x, y, z, ghost layers included.
    pub dims: [usize; 3],
    /// Values (not bytes) between neighbours along x, y, z, from value (0, 0, 0) at the pointer; may be negative. All 0: dense,
    /// x fastest.
    pub strides: [isize; 3],
    /// First value that is shown, after the ghost layers.
    pub start: [usize; 3],
    /// Values that are shown along x, y, z. All 0: from `start` to the end.
    pub size: [usize; 3],
    /// World length between neighbours. All 0: 1.
    pub spacing: [f64; 3],
    /// World position of value (0, 0, 0), ghost layers included.
    pub origin: [f64; 3],
    /// GLOAMING_F32 and so on.
    pub r#type: i32,
}

impl gloaming_block {
    fn dtype(&self) -> Result<Dtype, Error> {
        let kind = match self.r#type {
            GLOAMING_U8 => Kind::U8,
            GLOAMING_I8 => Kind::I8,
            GLOAMING_U16 => Kind::U16,
            GLOAMING_I16 => Kind::I16,
            GLOAMING_U32 => Kind::U32,
            GLOAMING_I32 => Kind::I32,
            GLOAMING_U64 => Kind::U64,
            GLOAMING_I64 => Kind::I64,
            GLOAMING_F16 => Kind::F16,
            GLOAMING_F32 => Kind::F32,
            GLOAMING_F64 => Kind::F64,
            other => {
                let what = format!(
                    "values of type {other}\n  try: GLOAMING_U8 ({GLOAMING_U8}) to GLOAMING_F64 ({GLOAMING_F64})"
                );
                return Err(Error::Unsupported(what));
            }
        };
        Ok(Dtype::native(kind))
    }

    fn strides(&self) -> [isize; 3] {
        let [nx, ny, _] = self.dims.map(|n| n as isize);
        if self.strides == [0; 3] { [1, nx, nx.saturating_mul(ny)] } else { self.strides }
    }

    /// Bytes from the lowest address to value (0, 0, 0), and to the end of the highest value; `None` where there are no values,
    /// or more than memory has.
    fn extent(&self) -> Option<(usize, usize)> {
        let number = self.dtype().ok()?.bytes() as i128;
        if self.dims.contains(&0) {
            return None;
        }
        let (mut low, mut high) = (0i128, 0i128);
        for (n, stride) in self.dims.iter().zip(self.strides()) {
            let end = (*n as i128 - 1).checked_mul(stride as i128 * number)?;
            low += end.min(0);
            high += end.max(0);
        }
        let below = usize::try_from(-low).ok()?;
        let length = usize::try_from(high - low + number).ok().filter(|l| *l <= isize::MAX as usize)?;
        Some((below, length))
    }

    /// The memory of the values; empty where there are none, so that the block is refused later on.
    ///
    /// # Safety
    /// All `dims` values can be read at `values` as long as the result is used.
    pub(crate) unsafe fn bytes<'a>(&self, values: *const c_void) -> &'a [u8] {
        match self.extent() {
            Some((below, length)) if !values.is_null() => {
                // SAFETY: the lowest and the highest address of the values that the caller promises.
                unsafe { std::slice::from_raw_parts(values.cast::<u8>().wrapping_sub(below), length) }
            }
            _ => &[],
        }
    }

    /// The block over its bytes.
    pub(crate) fn over<B: AsRef<[u8]>>(&self, bytes: B) -> Result<Strided<B>, Error> {
        let dtype = self.dtype()?;
        let size = if self.size == [0; 3] {
            std::array::from_fn(|a| self.dims[a].saturating_sub(self.start[a]))
        } else {
            self.size
        };
        let spacing = if self.spacing == [0.0; 3] { [1.0; 3] } else { self.spacing };
        Ok(Strided::new(bytes, dtype, self.dims)
            .strides(self.strides())
            .first(self.extent().map_or(0, |(below, _)| below))
            .region(Region { start: self.start, size })
            .spacing(spacing)
            .origin(self.origin))
    }
}

/// A function of the simulation's, called when this is dropped.
pub(crate) struct Release {
    release: Option<unsafe extern "C" fn(*mut c_void)>,
    user: *mut c_void,
}

impl Release {
    pub fn new(release: Option<unsafe extern "C" fn(*mut c_void)>, user: *mut c_void) -> Self {
        Release { release, user }
    }
}

impl Drop for Release {
    fn drop(&mut self) {
        if let Some(release) = self.release {
            // SAFETY: the caller of gloaming_push_owned allows one call, from any thread.
            unsafe { release(self.user) };
        }
    }
}

/// Memory that was given away.
pub(crate) struct Given {
    bytes: &'static [u8],
    _release: Release,
}

// SAFETY: the caller of gloaming_push_owned lets the values be read, and the function be called, from any thread.
unsafe impl Send for Given {}
// SAFETY: as above; the values are only read.
unsafe impl Sync for Given {}

impl Given {
    /// # Safety
    /// All of the block's `dims` values can be read at `values`, from any thread, until `release` is dropped.
    pub unsafe fn new(block: &gloaming_block, values: *const c_void, release: Release) -> Self {
        // SAFETY: the borrow ends with `release`, which is dropped with it.
        Given { bytes: unsafe { block.bytes(values) }, _release: release }
    }
}

impl AsRef<[u8]> for Given {
    fn as_ref(&self) -> &[u8] {
        self.bytes
    }
}
