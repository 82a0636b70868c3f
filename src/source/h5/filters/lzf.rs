//! LZF (liblzf): a byte below 32 begins that many literals and one more; else its upper three bits are a length less 2
//! (7: the next byte adds to it) and the lower five with the next byte a distance less 1.

use super::{filled, take, word};

pub(super) fn decode(mut from: &[u8], out: &mut [u8]) -> Result<(), String> {
    let mut at = 0;
    while let Some((&control, rest)) = from.split_first() {
        from = rest;
        if control < 32 {
            let literals = take(&mut from, usize::from(control) + 1)?;
            let place = out.get_mut(at..at + literals.len()).ok_or("more bytes than there is room for")?;
            place.copy_from_slice(literals);
            at += literals.len();
            continue;
        }
        let mut length = usize::from(control >> 5);
        if length == 7 {
            length += usize::from(word::<1>(&mut from)?[0]);
        }
        let distance = (usize::from(control & 31) << 8) + usize::from(word::<1>(&mut from)?[0]) + 1;
        at = repeat(out, at, distance, length + 2)?;
    }
    filled(at, out)
}

/// Copies `length` bytes from `distance` bytes before `at` to `at`, one after the other: they may overlap.
pub(super) fn repeat(out: &mut [u8], at: usize, distance: usize, length: usize) -> Result<usize, String> {
    let end = at + length;
    if distance > at || end > out.len() {
        return Err("a copy from outside of the chunk".into());
    }
    if distance >= length {
        out.copy_within(at - distance..end - distance, at);
    } else {
        (at..end).for_each(|i| out[i] = out[i - distance]);
    }
    Ok(end)
}
