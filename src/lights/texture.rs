//! Images that are thrown or painted with, and how any image is read: as linear light.

use std::path::Path;

use image::{DynamicImage, ImageReader};

use crate::error::{Error, Result};

/// Reads an image as linear RGBA, row by row from the top: OpenEXR and Radiance HDR as they are, PNG from sRGB; coverage as
/// it is. `wanted` is what the file should have been, for messages.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when it is no such image, or holds values that are negative
/// or not finite.
pub(crate) fn read_linear(path: &Path, wanted: &str) -> Result<([usize; 2], Vec<[f32; 4]>)> {
    let reader = ImageReader::open(path).map_err(|e| Error::io(path, e))?;
    let reader = reader.with_guessed_format().map_err(|e| Error::io(path, e))?;
    let image =
        reader.decode().map_err(|e| Error::format(path, format!("not an image that can be read: {e}"), wanted))?;
    let linear = matches!(image, DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_));
    let rgba = image.into_rgba32f();
    let size = [rgba.width() as usize, rgba.height() as usize];
    let decode = |v: f32| match linear {
        true => v,
        // The transfer curve of sRGB (IEC 61966-2-1).
        false if v <= 0.040_45 => v / 12.92,
        false => ((v + 0.055) / 1.055).powf(2.4),
    };
    let pixels: Vec<[f32; 4]> = rgba.pixels().map(|p| [decode(p[0]), decode(p[1]), decode(p[2]), p[3]]).collect();
    if pixels.is_empty() {
        return Err(Error::format(path, "an image without pixels", wanted));
    }
    if let Some(at) = pixels.iter().flatten().position(|v| !(*v >= 0.0 && v.is_finite())) {
        let [x, y] = [at / 4 % size[0], at / 4 / size[0]];
        let found = format!("{} at pixel ({x}, {y})", pixels[at / 4][at % 4]);
        return Err(Error::format(path, found, "values that are finite and 0 or more"));
    }
    Ok((size, pixels))
}

/// An image that a light throws.
#[derive(Debug, Clone, PartialEq)]
pub struct Texture {
    size: [usize; 2],
    /// Linear RGB, row by row from the top.
    pixels: Vec<[f32; 3]>,
}

impl Texture {
    /// Reads an image; where it has coverage, light passes in proportion.
    ///
    /// # Errors
    /// [`Error::Io`], or [`Error::Format`] when it is no image.
    pub fn read(path: &Path) -> Result<Self> {
        let (size, pixels) = read_linear(path, "an OpenEXR, Radiance HDR or PNG image")?;
        Ok(Texture { size, pixels: pixels.into_iter().map(|[r, g, b, a]| [r * a, g * a, b * a]).collect() })
    }

    /// Colour at a place, −1 to 1 from the upper left to the lower right; bilinear between pixels, black outside.
    pub fn at(&self, [x, y]: [f64; 2]) -> [f32; 3] {
        if !(x.abs() <= 1.0 && y.abs() <= 1.0) {
            return [0.0; 3];
        }
        let place = |v: f64, n: usize| {
            let at = ((0.5 * (v + 1.0)) * n as f64 - 0.5).clamp(0.0, (n - 1) as f64);
            (at as usize, (at as usize + 1).min(n - 1), at.fract() as f32)
        };
        let (left, right, u) = place(x, self.size[0]);
        let (above, below, v) = place(y, self.size[1]);
        let pixel = |x: usize, y: usize| self.pixels[y * self.size[0] + x];
        std::array::from_fn(|c| {
            let row = |y: usize| pixel(left, y)[c] * (1.0 - u) + pixel(right, y)[c] * u;
            row(above) * (1.0 - v) + row(below) * v
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_texture_is_its_pixels_and_black_beyond_them() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mask.png");
        image::RgbaImage::from_fn(2, 2, |x, y| image::Rgba([255, 255 * x as u8, 0, 255 * y as u8]))
            .save(&path)
            .unwrap();
        let texture = Texture::read(&path).unwrap();
        assert_eq!(texture.at([-0.5, 0.5]), [1.0, 0.0, 0.0]);
        assert_eq!(texture.at([0.5, 0.5]), [1.0, 1.0, 0.0]);
        assert_eq!(texture.at([0.5, -0.5]), [0.0; 3], "where nothing covers, nothing shines");
        assert_eq!(texture.at([0.5, 0.0]), [0.5, 0.5, 0.0]);
        assert_eq!(texture.at([1.01, 0.5]), [0.0; 3]);
        std::fs::write(&path, "no image").unwrap();
        assert!(matches!(Texture::read(&path), Err(Error::Format { .. })));
    }
}
