//! Blosc chunks, of version 1 and of version 2 with its longer header: blocks, each of one or more packed streams, then
//! shuffled.
//!
//! A header of 16 bytes: version, codec's version, flags, bytes of an element, and as little-endian numbers of 4 bytes
//! the lengths of the values, of a block, and of the chunk. Both shuffles flagged at once mean a header of 32 bytes:
//! six filters, their settings, and what kind of special chunk this may be. Then come the places of the blocks.

use super::{bitshuffle, blosclz, deflate, lz4, shuffle, zstd};

/// What a chunk's header says.
struct Header<'a> {
    chunk: &'a [u8],
    version: u8,
    flags: u8,
    element: usize,
    block: usize,
    /// Filters in the order in which they were applied, with their settings.
    filters: Vec<(u8, u8)>,
    /// Bytes of the header.
    length: usize,
    /// 1 zeros, 2 NaN, 3 one value, 4 not initialised.
    special: u8,
}

/// Bytes that the values of a chunk take, as far as its header tells.
pub(super) fn length_of(chunk: &[u8]) -> Result<usize, String> {
    number(chunk, 4)
}

/// Unpacks a chunk into its values.
pub(super) fn decode(chunk: &[u8], out: &mut [u8]) -> Result<(), String> {
    let claimed = length_of(chunk)?;
    if claimed != out.len() {
        return Err(format!("a chunk of {claimed} bytes instead of {}", out.len()));
    }
    let header = Header::read(chunk)?;
    match header.special {
        0 => {}
        1 | 4 => {
            out.fill(0);
            return Ok(());
        }
        2 => return nan(header.element, out),
        3 => return repeated(&chunk[header.length..], header.element, out),
        other => return Err(format!("a special chunk of kind {other}")),
    }
    if header.flags & 2 != 0 {
        let stored = chunk.get(header.length..header.length + out.len()).ok_or("it ends early")?;
        out.copy_from_slice(stored);
        return Ok(());
    }
    if header.block == 0 {
        return if out.is_empty() { Ok(()) } else { Err("blocks of no bytes".into()) };
    }
    let (mut shuffled, mut spare) = (Vec::new(), Vec::new());
    for (n, out) in out.chunks_mut(header.block).enumerate() {
        let at = number(chunk, header.length + 4 * n)?;
        shuffled.resize(out.len(), 0);
        header.unpack(at, &mut shuffled)?;
        header.unfilter(&mut shuffled, &mut spare)?;
        out.copy_from_slice(&shuffled);
    }
    Ok(())
}

/// The number of 4 bytes at `at`; negative ones are lengths beyond reason.
fn number(chunk: &[u8], at: usize) -> Result<usize, String> {
    Ok(signed(chunk, at)?.try_into().map_err(|_| "a negative length")?)
}

fn signed(chunk: &[u8], at: usize) -> Result<i32, String> {
    let bytes = chunk.get(at..).and_then(<[u8]>::first_chunk).ok_or("it ends early")?;
    Ok(i32::from_le_bytes(*bytes))
}

/// Fills with NaN of elements of 4 or 8 bytes.
pub(super) fn nan(element: usize, out: &mut [u8]) -> Result<(), String> {
    match element {
        4 => repeated(&f32::NAN.to_le_bytes(), 4, out),
        8 => repeated(&f64::NAN.to_le_bytes(), 8, out),
        _ => Err(format!("NaN of {element} bytes")),
    }
}

fn repeated(value: &[u8], element: usize, out: &mut [u8]) -> Result<(), String> {
    let value = value.get(..element).filter(|v| !v.is_empty()).ok_or("it ends early")?;
    out.chunks_mut(element).for_each(|o| o.copy_from_slice(&value[..o.len()]));
    Ok(())
}

impl Header<'_> {
    const SHUFFLE: u8 = 1;
    const BITSHUFFLE: u8 = 4;

    fn read(chunk: &[u8]) -> Result<Header<'_>, String> {
        let &[version, _, flags, element, ..] = chunk else { return Err("it ends early".into()) };
        let (element, block) = (usize::from(element).max(1), number(chunk, 8)?);
        let both = Self::SHUFFLE | Self::BITSHUFFLE;
        if flags & both != both {
            let filters = match flags & both {
                Self::SHUFFLE => vec![(1, 0)],
                Self::BITSHUFFLE => vec![(2, 0)],
                _ => vec![],
            };
            return Ok(Header { chunk, version, flags, element, block, filters, length: 16, special: 0 });
        }
        let more: &[u8; 16] = chunk.get(16..).and_then(<[u8]>::first_chunk).ok_or("it ends early")?;
        let filters: Vec<(u8, u8)> = (0..6).map(|i| (more[i], more[8 + i])).filter(|(f, _)| *f != 0).collect();
        if more[15] & 1 != 0 {
            return Err("packed with a dictionary, which is not read".into());
        }
        Ok(Header { chunk, version, flags, element, block, filters, length: 32, special: more[15] >> 4 & 7 })
    }

    /// Unpacks the streams of the block at `at`.
    fn unpack(&self, mut at: usize, out: &mut [u8]) -> Result<(), String> {
        let whole = out.len() == self.block;
        // Version 1 of the library split by these limits; version 2 says what it did.
        let small = self.version <= 2 && (self.element > 16 || self.block / self.element < 128);
        let streams = if self.flags & 0x10 == 0 && whole && !small { self.element } else { 1 };
        let length = out.len() / streams;
        if length == 0 {
            return Err("blocks smaller than an element".into());
        }
        for out in out.chunks_mut(length).take(streams) {
            let packed = signed(self.chunk, at)?;
            at += 4;
            if packed <= 0 && self.version > 2 {
                // A run of zeros, or of the byte whose negative this is.
                if packed < 0 {
                    let token = self.chunk.get(at).ok_or("it ends early")?;
                    at += 1;
                    if token & 1 == 0 || packed < -255 {
                        return Err(format!("a stream of {packed} bytes"));
                    }
                }
                out.fill(packed.unsigned_abs() as u8);
                continue;
            }
            let packed = usize::try_from(packed).map_err(|_| "a negative length")?;
            let stream = self.chunk.get(at..at.saturating_add(packed)).ok_or("it ends early")?;
            at += packed;
            if packed == out.len() { out.copy_from_slice(stream) } else { self.codec(stream, out)? }
        }
        Ok(())
    }

    fn codec(&self, stream: &[u8], out: &mut [u8]) -> Result<(), String> {
        match self.flags >> 5 {
            0 => blosclz::decode(stream, out),
            1 => lz4::unpack(stream, out),
            3 => deflate(stream, out),
            4 => zstd(stream, out),
            2 => Err("packed with Snappy, which is not read".into()),
            other => Err(format!("packed with codec {other}, which is not known")),
        }
    }

    /// Undoes the filters on a block.
    fn unfilter(&self, block: &mut Vec<u8>, spare: &mut Vec<u8>) -> Result<(), String> {
        for &(filter, setting) in self.filters.iter().rev() {
            let element = if setting == 0 { self.element } else { usize::from(setting) };
            match filter {
                1 => {
                    spare.resize(block.len(), 0);
                    shuffle::undo(element, block, spare);
                    std::mem::swap(block, spare);
                }
                2 => self.unshuffle_bits(block, spare),
                // Bits that were cut off do not come back.
                4 => {}
                3 => return Err("filtered by differences between blocks, which is not read".into()),
                other => return Err(format!("filtered by {other}, which is not known")),
            }
        }
        Ok(())
    }

    fn unshuffle_bits(&self, block: &mut Vec<u8>, spare: &mut Vec<u8>) {
        let elements = block.len() / self.element;
        // Version 1 leaves a block alone whose elements are no multiple of 8; version 2 leaves the rest alone.
        if self.version <= 2 && !elements.is_multiple_of(8) {
            return;
        }
        let whole = elements / 8 * 8 * self.element;
        spare.resize(block.len(), 0);
        bitshuffle::unshuffle(self.element, &block[..whole], &mut spare[..whole]);
        spare[whole..].copy_from_slice(&block[whole..]);
        std::mem::swap(block, spare);
    }
}
