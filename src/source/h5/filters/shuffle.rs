//! Byte shuffle: byte j of all elements, then byte j+1 of all, …; what does not make a whole element stays at the end.

/// Puts the bytes of each element of `element` bytes together again; both slices have one length.
pub(super) fn undo(element: usize, bytes: &[u8], out: &mut [u8]) {
    match element {
        0 | 1 => out.copy_from_slice(bytes),
        2 => of::<2>(bytes, out),
        4 => of::<4>(bytes, out),
        8 => of::<8>(bytes, out),
        _ => {
            let count = bytes.len() / element;
            for (i, whole) in out.chunks_exact_mut(element).enumerate() {
                whole.iter_mut().enumerate().for_each(|(j, o)| *o = bytes[j * count + i]);
            }
            out[count * element..].copy_from_slice(&bytes[count * element..]);
        }
    }
}

fn of<const N: usize>(bytes: &[u8], out: &mut [u8]) {
    let count = bytes.len() / N;
    let planes: [&[u8]; N] = std::array::from_fn(|j| &bytes[j * count..(j + 1) * count]);
    let (whole, rest) = out.as_chunks_mut::<N>();
    for (i, element) in whole.iter_mut().enumerate() {
        *element = std::array::from_fn(|j| planes[j][i]);
    }
    rest.copy_from_slice(&bytes[count * N..]);
}
