//! What overlays draw with: text and lines with soft edges, set off from any picture by a halo.

use image::RgbImage;
use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

/// A face of the font: one of its rasters, enlarged by a whole number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Face {
    raster: RasterHeight,
    zoom: usize,
}

impl Face {
    /// The face whose line height is nearest to `pixels`; 16 pixels is the smallest.
    pub fn nearest(pixels: f32) -> Self {
        let rasters = [RasterHeight::Size16, RasterHeight::Size20, RasterHeight::Size24, RasterHeight::Size32];
        (1..=16)
            .flat_map(|zoom| rasters.map(|raster| Face { raster, zoom }))
            .min_by_key(|face| ((face.height() - pixels).abs() * 8.0) as usize + face.zoom)
            .expect("there are faces")
    }

    /// Line height in pixels.
    pub fn height(self) -> f32 {
        (self.raster.val() * self.zoom) as f32
    }

    /// Width in pixels of a text.
    pub fn width(self, text: &str) -> f32 {
        (text.chars().count() * get_raster_width(FontWeight::Regular, self.raster) * self.zoom) as f32
    }
}

/// Ink of one colour on a part of a picture, before it is printed.
pub(crate) struct Ink {
    left: i64,
    top: i64,
    width: usize,
    height: usize,
    /// Share of each pixel that is covered.
    cover: Vec<f32>,
    halo: f32,
}

impl Ink {
    /// A blank for marks within a box of the picture, with a halo of `halo` pixels.
    pub fn within([left, top, right, bottom]: [f32; 4], halo: f32) -> Self {
        let margin = halo.ceil() + 1.0;
        let (left, top) = ((left - margin).floor() as i64, (top - margin).floor() as i64);
        let width = ((right + margin).ceil() as i64 - left).max(0) as usize;
        let height = ((bottom + margin).ceil() as i64 - top).max(0) as usize;
        Ink { left, top, width, height, cover: vec![0.0; width * height], halo }
    }

    fn add(&mut self, x: i64, y: i64, cover: f32) {
        let (x, y) = (x - self.left, y - self.top);
        if x >= 0 && y >= 0 && (x as usize) < self.width && (y as usize) < self.height {
            let at = &mut self.cover[y as usize * self.width + x as usize];
            *at = at.max(cover);
        }
    }

    /// Sets a text with its upper left corner at a point. Characters without a glyph become `?`.
    pub fn text(&mut self, face: Face, x: f32, y: f32, text: &str) {
        let (mut x, y) = (x.round() as i64, y.round() as i64);
        for c in text.chars() {
            let glyph = |c| get_raster(c, FontWeight::Regular, face.raster);
            let glyph = glyph(c).or_else(|| glyph('?')).expect("the font has ASCII");
            let zoom = face.zoom;
            for j in 0..glyph.height() * zoom {
                for i in 0..glyph.width() * zoom {
                    self.add(x + i as i64, y + j as i64, sample(&glyph, i, j, zoom));
                }
            }
            x += (glyph.width() * zoom) as i64;
        }
    }

    /// Draws a line whose half width changes along it: `width(0)` at `from`, `width(1)` at `to`.
    pub fn line(&mut self, from: [f32; 2], to: [f32; 2], width: impl Fn(f32) -> f32) {
        let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
        let length2 = (dx * dx + dy * dy).max(1e-6);
        for y in 0..self.height {
            for x in 0..self.width {
                // Centres of pixels are at halves.
                let (px, py) =
                    ((self.left + x as i64) as f32 + 0.5 - from[0], (self.top + y as i64) as f32 + 0.5 - from[1]);
                let t = ((px * dx + py * dy) / length2).clamp(0.0, 1.0);
                let distance = (px - t * dx).hypot(py - t * dy);
                let cover = (width(t) + 0.5 - distance).clamp(0.0, 1.0);
                let at = &mut self.cover[y * self.width + x];
                *at = at.max(cover);
            }
        }
    }

    /// Prints the halo, then the ink.
    pub fn print(&self, picture: &mut RgbImage, color: [u8; 3], around: [u8; 3]) {
        let shade = self.shade();
        for y in 0..self.height {
            for x in 0..self.width {
                let (px, py) = (self.left + x as i64, self.top + y as i64);
                if px < 0 || py < 0 || px >= i64::from(picture.width()) || py >= i64::from(picture.height()) {
                    continue;
                }
                let at = y * self.width + x;
                let pixel = picture.get_pixel_mut(px as u32, py as u32);
                for c in 0..3 {
                    let under = mix(f32::from(pixel.0[c]), f32::from(around[c]), 0.85 * shade[at]);
                    pixel.0[c] = mix(under, f32::from(color[c]), self.cover[at]).round() as u8;
                }
            }
        }
    }

    /// The halo: the ink grown by its radius, fading outwards.
    fn shade(&self) -> Vec<f32> {
        let reach = self.halo.ceil() as i64;
        let offsets: Vec<(i64, i64, f32)> = (-reach..=reach)
            .flat_map(|j| (-reach..=reach).map(move |i| (i, j)))
            .map(|(i, j)| (i, j, (1.5 * (1.0 - (i as f32).hypot(j as f32) / (self.halo + 1.0))).clamp(0.0, 1.0)))
            .filter(|o| o.2 > 0.0)
            .collect();
        let mut shade = vec![0.0f32; self.cover.len()];
        for y in 0..self.height as i64 {
            for x in 0..self.width as i64 {
                let cover = self.cover[(y * self.width as i64 + x) as usize];
                if cover == 0.0 {
                    continue;
                }
                for &(i, j, weight) in &offsets {
                    let (x, y) = (x + i, y + j);
                    if x >= 0 && y >= 0 && x < self.width as i64 && y < self.height as i64 {
                        let at = &mut shade[(y * self.width as i64 + x) as usize];
                        *at = at.max(weight * cover);
                    }
                }
            }
        }
        shade
    }
}

/// Coverage of pixel (i, j) of a glyph enlarged `zoom` times, bilinear between the raster's pixels.
fn sample(glyph: &noto_sans_mono_bitmap::RasterizedChar, i: usize, j: usize, zoom: usize) -> f32 {
    let value = |x: i64, y: i64| match (usize::try_from(x), usize::try_from(y)) {
        (Ok(x), Ok(y)) => f32::from(glyph.pixel(x, y).unwrap_or(0)) / 255.0,
        _ => 0.0,
    };
    let place = |i: usize| (i as f32 + 0.5) / zoom as f32 - 0.5;
    let (x, y) = (place(i), place(j));
    let (x0, y0) = (x.floor(), y.floor());
    let row = |y: i64| mix(value(x0 as i64, y), value(x0 as i64 + 1, y), x - x0);
    mix(row(y0 as i64), row(y0 as i64 + 1), y - y0)
}

fn mix(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}
