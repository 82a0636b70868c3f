//! The LZ4 filter: the length of all and of a block as big-endian numbers of 8 and 4 bytes, then each block behind its
//! packed length (4 bytes); one that did not shrink is stored as it is.

use super::{filled, take, word};

pub(super) fn decode(mut from: &[u8], out: &mut [u8]) -> Result<(), String> {
    let length = u64::from_be_bytes(word(&mut from)?);
    filled(usize::try_from(length).unwrap_or(usize::MAX), out)?;
    let block = u32::from_be_bytes(word(&mut from)?) as usize;
    if block == 0 {
        return if out.is_empty() { Ok(()) } else { Err("blocks of no bytes".into()) };
    }
    for out in out.chunks_mut(block) {
        let packed = u32::from_be_bytes(word(&mut from)?) as usize;
        let packed = take(&mut from, packed)?;
        if packed.len() == out.len() { out.copy_from_slice(packed) } else { unpack(packed, out)? }
    }
    Ok(())
}

/// One LZ4 block.
pub(super) fn unpack(packed: &[u8], out: &mut [u8]) -> Result<(), String> {
    let written = lz4_flex::block::decompress_into(packed, out).map_err(|e| e.to_string())?;
    filled(written, out)
}
