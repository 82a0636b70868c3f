//! Fletcher-32 as HDF5 computes it: over 16-bit big-endian words, `s₁ = Σ wᵢ`, `s₂ = Σ s₁` modulo 65535, stored after
//! the values as `s₂·2¹⁶ + s₁` with its low byte first.

/// Checks the sum at the end of `bytes` and takes it off.
pub(super) fn strip(bytes: &mut Vec<u8>) -> Result<(), String> {
    let (values, sum) = bytes.split_last_chunk::<4>().ok_or("no room for a checksum")?;
    let (stored, counted) = (u32::from_le_bytes(*sum), fletcher32(values));
    // Before version 1.6.3 HDF5 wrote the bytes of each half in the machine's order; it still reads those.
    let swapped = |s: u32| (s & 0x00ff_00ff) << 8 | (s >> 8) & 0x00ff_00ff;
    if stored != counted && stored != swapped(counted) {
        return Err(format!("the checksum is {counted:08x} where the file says {stored:08x}"));
    }
    bytes.truncate(bytes.len() - 4);
    Ok(())
}

fn fletcher32(bytes: &[u8]) -> u32 {
    let (mut first, mut second) = (0u32, 0u32);
    let fold = |s: u32| (s & 0xffff) + (s >> 16);
    // 360 words: as many as fit without overflow.
    for block in bytes.chunks(720) {
        for pair in block.chunks(2) {
            first += u32::from(pair[0]) << 8 | pair.get(1).map_or(0, |b| u32::from(*b));
            second += first;
        }
        (first, second) = (fold(first), fold(second));
    }
    fold(second) << 16 | fold(first)
}
