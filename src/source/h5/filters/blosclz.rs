//! BloscLZ: like LZF with run lengths without bound and distances beyond 8191.
//!
//! A byte below 32 begins that many literals and one more. Else its upper three bits are a length less 2 (7: bytes add
//! to it up to and with the first that is not 255) and the lower five with the next byte a distance less 1; all ones:
//! 8192 more than the next two bytes tell. The first byte is one of literals whatever its upper bits.

use super::lzf::repeat;
use super::{filled, take, word};

/// The largest distance of the short form.
const NEAR: usize = 8191;

pub(super) fn decode(mut from: &[u8], out: &mut [u8]) -> Result<(), String> {
    let (mut at, mut first) = (0, true);
    while let Some((&byte, rest)) = from.split_first() {
        from = rest;
        let control = if std::mem::take(&mut first) { byte & 31 } else { byte };
        if control < 32 {
            let literals = take(&mut from, usize::from(control) + 1)?;
            let place = out.get_mut(at..at + literals.len()).ok_or("more bytes than there is room for")?;
            place.copy_from_slice(literals);
            at += literals.len();
            continue;
        }
        let mut length = usize::from(control >> 5) + 2;
        if control >> 5 == 7 {
            loop {
                let more = usize::from(word::<1>(&mut from)?[0]);
                length = length.saturating_add(more);
                if more != 255 {
                    break;
                }
            }
        }
        let high = usize::from(control & 31) << 8;
        let low = usize::from(word::<1>(&mut from)?[0]);
        let distance = match (high, low) {
            (0x1f00, 255) => NEAR + usize::from(u16::from_be_bytes(word(&mut from)?)) + 1,
            _ => high + low + 1,
        };
        if length > out.len() {
            return Err("a copy longer than the chunk".into());
        }
        at = repeat(out, at, distance, length)?;
    }
    filled(at, out)
}
