//! 8-bit sRGB pictures as Y′CbCr of ITU-R BT.709 in limited range with 4:2:0 chroma.
//!
//! `Y′ = 0.2126 R′ + 0.7152 G′ + 0.0722 B′`, `Cb = (B′ − Y′)/1.8556`, `Cr = (R′ − Y′)/1.5748` (BT.709-6, 3.2–3.3), quantised
//! as `16 + 219 Y′` and `128 + 224 C`, rounded. A chroma sample sits on the left luma column of its pair, half-way
//! between the two rows (the position that H.264 assumes unless told): weights ¼ ½ ¼ across, ½ ½ down.

use image::RgbImage;

/// Planes of a picture, each row after row without padding.
pub(super) struct Yuv {
    /// Width and height of the luma plane: even.
    pub size: [usize; 2],
    pub y: Vec<u8>,
    pub u: Vec<u8>,
    pub v: Vec<u8>,
}

const RED: f32 = 0.2126;
const GREEN: f32 = 0.7152;
const BLUE: f32 = 0.0722;

impl Yuv {
    /// Converts a picture. An odd width or height grows by one: the last column or row is repeated.
    pub fn from_rgb(picture: &RgbImage) -> Self {
        let (w, h) = (picture.width() as usize, picture.height() as usize);
        let (cw, ch) = (w.div_ceil(2), h.div_ceil(2));
        let mut y = Vec::with_capacity(4 * cw * ch);
        let (mut u, mut v) = (Vec::with_capacity(cw * ch), Vec::with_capacity(cw * ch));
        let row = |j: usize| &picture.as_raw()[3 * w * j.min(h - 1)..][..3 * w];
        let mut pair = vec![[0.0f32; 3]; w];
        for j in 0..ch {
            let (upper, lower) = (row(2 * j), row(2 * j + 1));
            for luma in [upper, lower] {
                y.extend(
                    luma.chunks_exact(3).map(|p| quantise(16.0, 219.0, brightness([p[0], p[1], p[2]].map(f32::from)))),
                );
                if w % 2 == 1 {
                    y.push(y[y.len() - 1]);
                }
            }
            for ((sum, a), b) in pair.iter_mut().zip(upper.chunks_exact(3)).zip(lower.chunks_exact(3)) {
                *sum = std::array::from_fn(|c| 0.5 * (f32::from(a[c]) + f32::from(b[c])));
            }
            for i in 0..cw {
                let (left, mid, right) = (pair[(2 * i).saturating_sub(1)], pair[2 * i], pair[(2 * i + 1).min(w - 1)]);
                let rgb: [f32; 3] = std::array::from_fn(|c| 0.25 * (left[c] + right[c]) + 0.5 * mid[c]);
                let luma = brightness(rgb);
                u.push(quantise(128.0, 224.0, (rgb[2] - luma) / (2.0 * (1.0 - BLUE))));
                v.push(quantise(128.0, 224.0, (rgb[0] - luma) / (2.0 * (1.0 - RED))));
            }
        }
        Yuv { size: [2 * cw, 2 * ch], y, u, v }
    }
}

fn brightness([r, g, b]: [f32; 3]) -> f32 {
    RED * r + GREEN * g + BLUE * b
}

/// `offset + gain·value`, the value in 0..255 (or ±127.5) instead of 0..1, rounded.
fn quantise(offset: f32, gain: f32, value: f32) -> u8 {
    (offset + gain / 255.0 * value + 0.5) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    /// BT.709 8-bit limited-range codes of the primaries, white and black, as broadcasting's colour bars have them.
    #[test]
    fn primaries_have_their_broadcast_codes() {
        for (rgb, yuv) in [
            ([0, 0, 0], [16, 128, 128]),
            ([255, 255, 255], [235, 128, 128]),
            ([255, 0, 0], [63, 102, 240]),
            ([0, 255, 0], [173, 42, 26]),
            ([0, 0, 255], [32, 240, 118]),
            ([255, 255, 0], [219, 16, 138]),
        ] {
            let yuv_of = Yuv::from_rgb(&RgbImage::from_pixel(4, 2, image::Rgb(rgb)));
            assert_eq!(yuv_of.size, [4, 2]);
            assert!(yuv_of.y.iter().all(|&y| y == yuv[0]), "{rgb:?} {:?}", yuv_of.y);
            assert!(yuv_of.u.iter().all(|&u| u == yuv[1]), "{rgb:?} {:?}", yuv_of.u);
            assert!(yuv_of.v.iter().all(|&v| v == yuv[2]), "{rgb:?} {:?}", yuv_of.v);
        }
    }

    #[test]
    fn odd_sizes_repeat_the_last_column_and_row() {
        let picture = RgbImage::from_fn(3, 3, |x, y| image::Rgb([(80 * x) as u8, (80 * y) as u8, 40]));
        let yuv = Yuv::from_rgb(&picture);
        assert_eq!((yuv.size, yuv.y.len(), yuv.u.len()), ([4, 4], 16, 4));
        assert_eq!(yuv.y[2], yuv.y[3]);
        assert_eq!(yuv.y[8..12], yuv.y[12..16]);
    }
}
