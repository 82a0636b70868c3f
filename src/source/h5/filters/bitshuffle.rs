//! Bitshuffle: in blocks of elements, bit k of byte b of all elements, in order of b and then k; by itself or with each
//! block packed by LZ4 or Zstandard. Elements that do not make eight stay as they are at the end.

use super::{filled, lz4, same, take, word, zstd};

/// The filter's settings.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Options {
    /// Bytes of an element.
    pub element: usize,
    /// Elements of a block; 0 for the default.
    pub block: usize,
    /// 0 none, 2 LZ4, 3 Zstandard.
    pub coding: u8,
}

impl Options {
    /// Reads the numbers that are stored with the filter: version twice, bytes of an element, block, coding.
    pub fn of(values: &[u32], element: usize) -> Option<Options> {
        let value = |i: usize| values.get(i).copied().unwrap_or(0);
        let coding = u8::try_from(value(4)).ok().filter(|c| [0, 2, 3].contains(c))?;
        let element = if value(2) == 0 { element } else { value(2) as usize };
        Some(Options { element, block: value(3) as usize, coding })
    }

    pub fn decode(&self, mut from: &[u8], out: &mut [u8]) -> Result<(), String> {
        let element = self.element;
        let mut block = match self.block {
            0 => (8192 / element / 8 * 8).max(128),
            n => n,
        };
        if self.coding != 0 {
            let length = u64::from_be_bytes(word(&mut from)?);
            filled(usize::try_from(length).unwrap_or(usize::MAX), out)?;
            block = u32::from_be_bytes(word(&mut from)?) as usize / element;
        } else {
            same(from, out.len())?;
        }
        if block == 0 || !block.is_multiple_of(8) {
            return Err(format!("blocks of {block} elements"));
        }
        let whole = out.len() / element / 8 * 8 * element;
        let (shuffled, rest) = out.split_at_mut(whole);
        let mut unpacked = Vec::new();
        for out in shuffled.chunks_mut(block.saturating_mul(element)) {
            if self.coding == 0 {
                unshuffle(element, take(&mut from, out.len())?, out);
                continue;
            }
            let packed = u32::from_be_bytes(word(&mut from)?) as usize;
            let packed = take(&mut from, packed)?;
            unpacked.resize(out.len(), 0);
            match self.coding {
                2 => lz4::unpack(packed, &mut unpacked)?,
                _ => zstd(packed, &mut unpacked)?,
            }
            unshuffle(element, &unpacked, out);
        }
        rest.copy_from_slice(same(from, rest.len())?);
        Ok(())
    }
}

/// Puts the bits of elements together again. Both slices have one length: a multiple of 8 elements.
pub(super) fn unshuffle(element: usize, bytes: &[u8], out: &mut [u8]) {
    let eights = bytes.len() / element / 8;
    for b in 0..element {
        for j in 0..eights {
            let rows = u64::from_le_bytes(std::array::from_fn(|k| bytes[(8 * b + k) * eights + j]));
            for (i, byte) in transpose(rows).to_le_bytes().into_iter().enumerate() {
                out[(8 * j + i) * element + b] = byte;
            }
        }
    }
}

/// Transposes 8×8 bits, row r in byte r (H. S. Warren, Hacker's Delight, 7–3).
fn transpose(x: u64) -> u64 {
    let swap = |x: u64, by: u32, mask: u64| {
        let t = (x ^ (x >> by)) & mask;
        x ^ t ^ (t << by)
    };
    let x = swap(x, 7, 0x00aa_00aa_00aa_00aa);
    let x = swap(x, 14, 0x0000_cccc_0000_cccc);
    swap(x, 28, 0x0000_0000_f0f0_f0f0)
}
