//! Chunks as they are stored: the few calls of HDF5 that have no safe counterpart.

use hdf5::datatype::ByteOrder;
use hdf5::types::{FloatSize, IntSize, TypeDescriptor};
use hdf5::{Dataset, Datatype};
use hdf5_sys::h5::{herr_t, hsize_t};
use hdf5_sys::h5d::H5Dread_chunk1;
use hdf5_sys::h5i::hid_t;
use hdf5_sys::h5p::H5P_DEFAULT;
use hdf5_sys::h5t::{H5Tget_ebias, H5Tget_fields, H5Tget_precision};

use crate::dtype::{Dtype, Kind};

// SAFETY: as HDF5 declares it since 1.10.2; the bindings lack it.
unsafe extern "C" {
    fn H5Dget_chunk_storage_size(dataset: hid_t, offset: *const hsize_t, size: *mut hsize_t) -> herr_t;
}

/// Bytes of the chunk at `offset` (one number for each axis) as they are stored, and the mask of the filters that were
/// not applied; `None` where HDF5 has no chunk, or one of more than `most` bytes.
pub(super) fn chunk(dataset: &Dataset, offset: &[u64], most: u64) -> hdf5::Result<Option<(u32, Vec<u8>)>> {
    assert_eq!(offset.len(), dataset.ndim());
    hdf5::sync::sync(|| {
        let mut size = 0;
        // SAFETY: the dataset is open, under HDF5's lock, and `offset` has a number for each of its axes.
        let found = unsafe { H5Dget_chunk_storage_size(dataset.id(), offset.as_ptr(), &mut size) };
        if found < 0 || size == 0 || size > most {
            return Ok(None);
        }
        let (mut mask, mut bytes) = (0, vec![0u8; size as usize]);
        let into = bytes.as_mut_ptr().cast();
        // SAFETY: as above, and `bytes` has the room that HDF5 asked for under the same lock.
        hdf5::h5check(unsafe { H5Dread_chunk1(dataset.id(), H5P_DEFAULT, offset.as_ptr(), &mut mask, into) })?;
        Ok(Some((mask, bytes)))
    })
}

/// The type of number, where it is one of those that Rust has; others HDF5 converts.
pub(super) fn number(dtype: &Datatype) -> Option<Dtype> {
    let (kind, fields) = match dtype.to_descriptor().ok()? {
        TypeDescriptor::Unsigned(IntSize::U1) => (Kind::U8, None),
        TypeDescriptor::Integer(IntSize::U1) => (Kind::I8, None),
        TypeDescriptor::Unsigned(IntSize::U2) => (Kind::U16, None),
        TypeDescriptor::Integer(IntSize::U2) => (Kind::I16, None),
        TypeDescriptor::Unsigned(IntSize::U4) => (Kind::U32, None),
        TypeDescriptor::Integer(IntSize::U4) => (Kind::I32, None),
        TypeDescriptor::Unsigned(IntSize::U8) => (Kind::U64, None),
        TypeDescriptor::Integer(IntSize::U8) => (Kind::I64, None),
        // Places of sign, exponent and mantissa, and the exponent's bias.
        TypeDescriptor::Float(FloatSize::U2) => (Kind::F16, Some([15, 10, 5, 0, 10, 15])),
        TypeDescriptor::Float(FloatSize::U4) => (Kind::F32, Some([31, 23, 8, 0, 23, 127])),
        TypeDescriptor::Float(FloatSize::U8) => (Kind::F64, Some([63, 52, 11, 0, 52, 1023])),
        _ => return None,
    };
    let big_endian = match dtype.byte_order() {
        ByteOrder::LittleEndian => false,
        ByteOrder::BigEndian => true,
        _ if dtype.size() == 1 => false,
        _ => return None,
    };
    let standard = hdf5::sync::sync(|| {
        // SAFETY: the type is open, under HDF5's lock.
        let whole = unsafe { H5Tget_precision(dtype.id()) } == 8 * dtype.size();
        let Some(should) = fields else { return whole };
        let mut is = [0; 6];
        let [sign, exponent, exponents, mantissa, mantissas, bias] = &mut is;
        // SAFETY: as above; a type of floating-point numbers, as both calls ask.
        let read = unsafe {
            *bias = H5Tget_ebias(dtype.id());
            H5Tget_fields(dtype.id(), sign, exponent, exponents, mantissa, mantissas)
        };
        whole && read >= 0 && is == should
    });
    standard.then_some(Dtype { kind, big_endian })
}
