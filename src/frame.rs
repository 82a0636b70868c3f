//! Frames: scene-linear pictures, and their way to 8 bits: background, exposure, tone map.
//!
//! A pixel of radiance L and coverage α before background B becomes `v = f(exposure, L + (1 − α)·B)` per channel, then
//! `round(255·s(v))` with the transfer curve s of IEC 61966-2-1 (sRGB):
//! `s(v) = 12.92 v` up to 0.0031308, `1.055 v^(1/2.4) − 0.055` above.

use std::sync::LazyLock;

use image::RgbImage;

use crate::scene::{RenderKeys, Tonemap};

/// A picture. Pixels are scene-linear radiance, premultiplied by coverage, RGBA, row 0 on top, before background,
/// exposure and tone mapping.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Width and height in pixels.
    pub size: [usize; 2],
    /// `width·height` pixels.
    pub pixels: Vec<[f32; 4]>,
    /// What a renderer knows besides, by name; EXR files hold it, others do not.
    pub layers: Vec<Layer>,
}

/// One more quantity of each pixel: normal, depth, variance, a part of the picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Layer {
    /// Name, without a dot: the EXR file has channels `NAME.CHANNEL`.
    pub name: String,
    /// A letter for each channel: `RGB`, `XYZ`, `V` by convention for colours, vectors and single values.
    pub channels: String,
    /// `width·height` pixels, the values of one pixel after another.
    pub values: Vec<f32>,
}

impl Frame {
    /// A transparent frame.
    pub fn new(size: [usize; 2]) -> Self {
        Frame { size, pixels: vec![[0.0; 4]; size[0] * size[1]], layers: vec![] }
    }

    /// The layer of that name.
    pub fn layer(&self, name: &str) -> Option<&Layer> {
        self.layers.iter().find(|layer| layer.name == name)
    }
}

/// How radiance becomes 8-bit sRGB.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Display {
    /// Colour behind the volume, scene-linear; exposed and tone-mapped like the rest.
    pub background: [f32; 3],
    /// Factor on radiance ([`Tonemap::Srgb`], [`Tonemap::None`]), or the radiance that maps to 1 − 1/e
    /// ([`Tonemap::Exposure`]).
    pub exposure: f32,
    /// The curve.
    pub tonemap: Tonemap,
}

impl Default for Display {
    fn default() -> Self {
        Display::from(&RenderKeys::default())
    }
}

impl From<&RenderKeys> for Display {
    fn from(keys: &RenderKeys) -> Self {
        Display { background: keys.background, exposure: keys.exposure, tonemap: keys.tonemap }
    }
}

impl Display {
    /// The 8-bit value of a scene-linear radiance; NaN is black.
    ///
    /// | tone map | value |
    /// | --- | --- |
    /// | `srgb` | `s(min(exposure·L, 1))` |
    /// | `exposure` | `s(1 − e^(−L/exposure))`, Kroes et al. 2012 |
    /// | `none` | `min(exposure·L, 1)`, linear |
    pub fn encode(&self, radiance: f32) -> u8 {
        match self.tonemap {
            Tonemap::Srgb => CURVE.encode(self.exposure * radiance),
            Tonemap::Exposure => CURVE.encode(-(-radiance / self.exposure).exp_m1()),
            // The cast saturates, and takes NaN to 0.
            Tonemap::None => (self.exposure * radiance * 255.0).round() as u8,
        }
    }

    /// What [`Display::encode`] clips at 1 and rounds; 0 and more.
    pub fn shown(&self, radiance: f32) -> f32 {
        match self.tonemap {
            Tonemap::Srgb => srgb_encode(f64::from((self.exposure * radiance).max(0.0))) as f32,
            Tonemap::Exposure => srgb_encode(f64::from(-(-radiance.max(0.0) / self.exposure).exp_m1())) as f32,
            Tonemap::None => (self.exposure * radiance).max(0.0),
        }
    }

    /// The frame before the background, exposed and tone-mapped.
    pub fn picture(&self, frame: &Frame) -> RgbImage {
        let [w, h] = frame.size;
        let mut bytes = Vec::with_capacity(3 * w * h);
        for &[r, g, b, a] in &frame.pixels {
            let through = 1.0 - a;
            let [br, bg, bb] = self.background;
            bytes.extend([r + through * br, g + through * bg, b + through * bb].map(|v| self.encode(v)));
        }
        RgbImage::from_raw(w as u32, h as u32, bytes).expect("three bytes a pixel")
    }
}

/// sRGB-encoded value in 0..1 of a linear value in 0..1.
pub fn srgb_encode(v: f64) -> f64 {
    if v <= 0.0031308 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}

/// Linear value in 0..1 of an sRGB-encoded value in 0..1.
pub fn srgb_decode(s: f64) -> f64 {
    if s <= 0.04045 { s / 12.92 } else { ((s + 0.055) / 1.055).powf(2.4) }
}

static CURVE: LazyLock<Curve> = LazyLock::new(Curve::new);

/// The sRGB curve to 8 bits, rounded exactly, without a power per pixel: the curve is nowhere steeper than 12.92·255 codes
/// per unit, so a bucket of 1/4096 holds at most one step between codes.
struct Curve {
    /// Code at the low end of each bucket.
    first: [u8; Curve::BUCKETS + 1],
    /// Smallest linear value of each code; one past the last is never reached.
    from: [f32; 257],
}

impl Curve {
    const BUCKETS: usize = 4096;

    fn new() -> Self {
        let mut from = [0.0; 257];
        for (code, from) in from.iter_mut().enumerate().skip(1) {
            *from = srgb_decode((code as f64 - 0.5) / 255.0) as f32;
        }
        from[256] = f32::INFINITY;
        let first = std::array::from_fn(|b| {
            let low = b as f32 / Curve::BUCKETS as f32;
            (from.partition_point(|&t| t <= low) - 1) as u8
        });
        Curve { first, from }
    }

    fn encode(&self, v: f32) -> u8 {
        // NaN passes the clamp, indexes bucket 0 and reaches no threshold: black.
        let v = v.clamp(0.0, 1.0);
        let code = self.first[(v * Curve::BUCKETS as f32) as usize];
        code + u8::from(v >= self.from[usize::from(code) + 1])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_rounds_like_the_formula() {
        for i in 0..=1_000_000u32 {
            let v = i as f32 / 1e6;
            let exact = 255.0 * srgb_encode(f64::from(v));
            // At a tie within f32 resolution of the threshold either neighbour is right.
            let code = f64::from(CURVE.encode(v));
            assert!((code - exact).abs() <= 0.5 + 1e-3, "{v}: {code} for {exact}");
        }
    }

    #[test]
    fn known_values() {
        let display = Display { background: [0.0; 3], exposure: 1.0, tonemap: Tonemap::Srgb };
        // 18 % grey is 118 in sRGB; 0.5 linear is 188.
        assert_eq!(
            [0.0, 0.18, 0.5, 1.0, 7.0, -1.0, f32::NAN].map(|v| display.encode(v)),
            [0, 118, 188, 255, 255, 0, 0]
        );
        // Twice the exposure on half the radiance is the same picture.
        assert_eq!(Display { exposure: 2.0, ..display }.encode(0.09), 118);
        // 1 − e^(−ln 2) = 0.5, whatever the exposure, when L = exposure·ln 2.
        for exposure in [0.25, 1.0, 8.0] {
            let display = Display { exposure, tonemap: Tonemap::Exposure, ..display };
            assert_eq!(display.encode(exposure * std::f32::consts::LN_2), 188);
            assert_eq!(display.encode(f32::INFINITY), 255);
        }
        let display = Display { tonemap: Tonemap::None, ..display };
        assert_eq!([0.0, 0.2, 0.5, 2.0, f32::NAN].map(|v| display.encode(v)), [0, 51, 128, 255, 0]);
    }

    #[test]
    fn background_shows_through_uncovered_pixels() {
        let display = Display { background: [0.18, 0.5, 1.0], exposure: 1.0, tonemap: Tonemap::Srgb };
        let mut frame = Frame::new([3, 1]);
        frame.pixels[1] = [0.18, 0.18, 0.18, 1.0];
        frame.pixels[2] = [0.09, 0.25, 0.5, 0.5];
        assert_eq!(display.picture(&frame).as_raw(), &[118, 188, 255, 118, 118, 118, 118, 188, 255]);
    }
}
