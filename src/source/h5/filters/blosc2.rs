//! Blosc2: a contiguous frame of one chunk. Its header has fixed places: its own length at byte 11, the packed length
//! of all chunks at 39, both big-endian; the chunk follows. A layer `b2nd` in the header means values in blocks along
//! several axes.

use super::blosc;

pub(super) fn decode(frame: &[u8], out: &mut [u8]) -> Result<(), String> {
    if frame.get(2..10) != Some(b"b2frame\0") {
        return Err("no Blosc2 frame".into());
    }
    let header = i32::from_be_bytes(at(frame, 11)?);
    let packed = i64::from_be_bytes(at(frame, 39)?);
    let header = usize::try_from(header).ok().filter(|&h| h <= frame.len()).ok_or("it ends early")?;
    let (head, chunk) = frame.split_at(header);
    if packed == 0 {
        return special(head, chunk, out);
    }
    let Some(blocks) = Blocks::find(head)? else { return blosc::decode(chunk, out) };
    let mut blocked = vec![0; blocks.checked(chunk, out.len())?];
    blosc::decode(chunk, &mut blocked)?;
    blocks.gather(&blocked, out);
    Ok(())
}

fn at<const N: usize>(bytes: &[u8], place: usize) -> Result<[u8; N], String> {
    Ok(*bytes.get(place..).and_then(<[u8]>::first_chunk).ok_or("it ends early")?)
}

/// A chunk of which only the list of chunks tells: zeros, or NaN.
fn special(head: &[u8], list: &[u8], out: &mut [u8]) -> Result<(), String> {
    let mut place = [0; 8];
    blosc::decode(list, &mut place)?;
    match place[7] {
        0x81 | 0x84 => {
            out.fill(0);
            Ok(())
        }
        0x82 => blosc::nan(i32::from_be_bytes(at(head, 48)?).try_into().unwrap_or(0), out),
        other => Err(format!("a chunk of kind {other:#x}")),
    }
}

/// Values in blocks: the chunk is cut into blocks along each axis, the last ones filled up, and stored block by block.
struct Blocks {
    chunk: Vec<usize>,
    block: Vec<usize>,
    /// Bytes of an element.
    element: usize,
}

impl Blocks {
    /// Finds the layer and reads it: MessagePack of version, number of axes, and the lengths of array, chunk and block.
    fn find(head: &[u8]) -> Result<Option<Blocks>, String> {
        let Some(name) = head.windows(5).position(|w| w == b"\xa4b2nd") else { return Ok(None) };
        let element = usize::try_from(i32::from_be_bytes(at(head, 48)?)).unwrap_or(0).max(1);
        // The name is followed by the layer's place in the header.
        let place = u32::from_be_bytes(at(head, name + 6)?) as usize;
        // A length of 4 bytes, then an array of 5 or 7: version, axes.
        let (count, axes): ([u8; 1], [u8; 1]) = (at(head, place + 5)?, at(head, place + 7)?);
        let axes = usize::from(axes[0]);
        if count[0] & 0xf0 != 0x90 || axes > 8 {
            return Err("a layer of axes that is not understood".into());
        }
        let chunk = place + 8 + 1 + 9 * axes;
        let lengths = |from: usize| -> Result<Vec<usize>, String> {
            let one = |a: usize| Ok::<_, String>(i32::from_be_bytes(at(head, from + 1 + 5 * a + 1)?));
            (0..axes).map(|a| Ok(usize::try_from(one(a)?).map_err(|_| "a negative length")?)).collect()
        };
        let (chunk, block) = (lengths(chunk)?, lengths(chunk + 1 + 5 * axes)?);
        if block.contains(&0) || axes == 0 {
            return Err("blocks of no values".into());
        }
        Ok(Some(Blocks { chunk, block, element }))
    }

    /// Bytes of all blocks, which the chunk must have, for values of `length` bytes.
    fn checked(&self, chunk: &[u8], length: usize) -> Result<usize, String> {
        let bytes = |lengths: Vec<usize>| {
            let product = lengths.into_iter().try_fold(self.element, usize::checked_mul);
            product.ok_or("lengths that cannot be counted")
        };
        let values = bytes(self.chunk.clone())?;
        let whole = self.chunk.iter().zip(&self.block).map(|(c, b)| c.div_ceil(*b).saturating_mul(*b));
        let all = bytes(whole.collect())?;
        // Filling up at most doubles each axis.
        if values != length || all != blosc::length_of(chunk)? || all > length << self.chunk.len() {
            return Err(format!("blocks of {all} bytes for values of {length}"));
        }
        Ok(all)
    }

    /// Copies row by row into place.
    fn gather(&self, blocked: &[u8], out: &mut [u8]) {
        let last = self.chunk.len() - 1;
        let counts: Vec<usize> = self.chunk.iter().zip(&self.block).map(|(c, b)| c.div_ceil(*b)).collect();
        let row = self.block[last] * self.element;
        for (n, values) in blocked.chunks_exact(row).enumerate() {
            // Place of this row: in its block along all axes but the last, and of the block among the blocks.
            let mut rest = n;
            let mut place = vec![0; last + 1];
            for a in (0..last).rev() {
                place[a] = rest % self.block[a];
                rest /= self.block[a];
            }
            for a in (0..=last).rev() {
                place[a] += rest % counts[a] * self.block[a];
                rest /= counts[a];
            }
            if place.iter().zip(&self.chunk).any(|(p, c)| p >= c) {
                continue;
            }
            let from = place.iter().zip(&self.chunk).fold(0, |at, (p, c)| at * c + p) * self.element;
            let length = row.min((self.chunk[last] - place[last]) * self.element);
            out[from..from + length].copy_from_slice(&values[..length]);
        }
    }
}
