//! Environments as images.
//!
//! An equirectangular image surrounds the volume: the top row lies towards +z, the bottom row towards −z; the middle column
//! lies towards +y, and columns to its right towards +x, as one who looks along +y sees them.

use std::f64::consts::{PI, TAU};
use std::path::Path;

use glam::DVec3;

use super::texture::read_linear;
use crate::error::Result;
use crate::scene::LightKeys;

/// An equirectangular image of radiance.
#[derive(Debug)]
pub struct Panorama {
    size: [usize; 2],
    /// Linear RGB, row by row from the top.
    pixels: Vec<[f32; 3]>,
}

impl PartialEq for Panorama {
    fn eq(&self, other: &Self) -> bool {
        std::ptr::eq(self, other) || (self.size == other.size && self.pixels == other.pixels)
    }
}

/// Part of the sphere: cosines to +z, and angles from +x towards +y.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cell {
    /// Smallest and largest z of its directions.
    pub z: [f64; 2],
    /// First and last azimuth in radians, ascending.
    pub azimuth: [f64; 2],
}

impl Panorama {
    /// Wraps `pixels` of `size` [width, height], row by row from the top.
    pub fn new(size: [usize; 2], pixels: Vec<[f32; 3]>) -> Self {
        assert!(!pixels.is_empty() && pixels.len() == size[0] * size[1], "pixels must fill the image");
        Panorama { size, pixels }
    }

    /// Reads an image: OpenEXR and Radiance HDR as they are, PNG from sRGB to linear light.
    ///
    /// # Errors
    /// [`Error::Io`](crate::Error::Io) when the file cannot be read; [`Error::Format`](crate::Error::Format) when it is no such image, or holds radiance that is
    /// negative or not finite.
    pub fn read(path: &Path) -> Result<Self> {
        let (size, pixels) = read(path, "an equirectangular OpenEXR, Radiance HDR or PNG image")?;
        Ok(Panorama { size, pixels })
    }

    /// What surrounds the volume by the keys of an environment; `None` where that is one colour.
    ///
    /// # Errors
    /// Those of [`Panorama::read`].
    pub fn of(keys: &LightKeys) -> Result<Option<Self>> {
        match (&keys.image, keys.gradient) {
            (Some(path), _) => Panorama::read(path).map(Some),
            (None, gradient) => Ok(gradient.map(Panorama::gradient)),
        }
    }

    /// Colours straight down, at the horizon and straight up, and what is linear in the height z of a direction between them, in
    /// rows of even angles: each has the mean of its directions, so that those of the whole and of each half are exact.
    pub fn gradient([bottom, horizon, top]: [[f32; 3]; 3]) -> Self {
        const ROWS: usize = 256;
        let row = |y: usize| {
            let [above, below] = [y, y + 1].map(|y| (PI * y as f64 / ROWS as f64).cos());
            let z = (0.5 * (above + below)) as f32;
            let end = if z > 0.0 { top } else { bottom };
            std::array::from_fn(|c| horizon[c] + z.abs() * (end[c] - horizon[c]))
        };
        Panorama { size: [1, ROWS], pixels: (0..ROWS).map(row).collect() }
    }

    /// Width and height in pixels.
    pub fn size(&self) -> [usize; 2] {
        self.size
    }

    /// Linear RGB, row by row from the top.
    pub fn pixels(&self) -> &[[f32; 3]] {
        &self.pixels
    }

    /// The pixel towards a unit world direction.
    pub fn radiance(&self, towards: DVec3) -> [f32; 3] {
        let [width, height] = self.size;
        let u = 0.5 + towards.x.atan2(towards.y) / TAU;
        let v = towards.z.clamp(-1.0, 1.0).acos() / PI;
        let at = |t: f64, n: usize| ((t * n as f64) as usize).min(n - 1);
        self.pixels[at(v, height) * width + at(u, width)]
    }

    /// Mean radiance from the directions of a cell, each pixel by the solid angle that it shares with it: over a partition
    /// of the sphere, means times solid angles add up to the whole.
    pub fn mean(&self, cell: &Cell) -> [f32; 3] {
        let [width, height] = self.size;
        let rows: Vec<(usize, f64)> = (0..height)
            .filter_map(|y| {
                let edge = |y: usize| (PI * y as f64 / height as f64).cos();
                let share = edge(y).min(cell.z[1]) - edge(y + 1).max(cell.z[0]);
                (share > 0.0).then_some((y, share))
            })
            .collect();
        // Columns from the azimuth of the cell's last direction on: u falls as the azimuth grows.
        let u = |azimuth: f64| (0.75 - azimuth / TAU) * width as f64;
        let (first, last) = (u(cell.azimuth[1]), u(cell.azimuth[0]));
        let columns: Vec<(usize, f64)> = (first.floor() as i64..last.ceil() as i64)
            .map(|x| (x.rem_euclid(width as i64) as usize, last.min((x + 1) as f64) - first.max(x as f64)))
            .filter(|(_, share)| *share > 0.0)
            .collect();
        let (mut sum, mut total) = ([0.0; 3], 0.0);
        for (y, of_row) in &rows {
            for (x, of_column) in &columns {
                let share = of_row * of_column;
                total += share;
                let pixel = self.pixels[y * width + x];
                (0..3).for_each(|c| sum[c] += share * f64::from(pixel[c]));
            }
        }
        sum.map(|s| (s / total) as f32)
    }
}

/// Size and linear RGB of an image file, row by row from the top; `remedy` is what would do instead of what cannot be read.
pub(super) fn read(path: &Path, remedy: &str) -> Result<([usize; 2], Vec<[f32; 3]>)> {
    let (size, pixels) = read_linear(path, remedy)?;
    let pixels = pixels.into_iter().map(|[r, g, b, _]| [r, g, b]).collect();
    Ok((size, pixels))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each pixel tells where it is.
    fn marked(size: [usize; 2]) -> Panorama {
        let pixels = (0..size[0] * size[1]).map(|i| [(i % size[0]) as f32, (i / size[0]) as f32, 1.0]).collect();
        Panorama::new(size, pixels)
    }

    #[test]
    fn directions_find_their_pixels() {
        let image = marked([8, 4]);
        for (towards, pixel) in [
            (DVec3::new(0.01, 1.0, 0.01), [4.0, 1.0, 1.0]),
            (DVec3::new(1.0, 0.01, -0.01), [5.0, 2.0, 1.0]),
            (DVec3::new(-1.0, 0.01, 0.01), [2.0, 1.0, 1.0]),
            (DVec3::new(0.01, -1.0, 0.01), [7.0, 1.0, 1.0]),
            (DVec3::new(0.0, 0.01, 1.0), [4.0, 0.0, 1.0]),
            (DVec3::new(0.0, 0.01, -1.0), [4.0, 3.0, 1.0]),
        ] {
            assert_eq!(image.radiance(towards.normalize()), pixel, "{towards}");
        }
    }

    #[test]
    fn small_cells_hold_the_pixel_in_their_middle() {
        let image = marked([16, 8]);
        for z in [-0.93, -0.4, 0.1, 0.8] {
            for step in 0..32 {
                let azimuth = (f64::from(step) + 0.5) * TAU / 32.0;
                let cell = Cell { z: [z - 1e-4, z + 1e-4], azimuth: [azimuth - 1e-4, azimuth + 1e-4] };
                let side = (1.0f64 - z * z).sqrt();
                let middle = DVec3::new(side * azimuth.cos(), side * azimuth.sin(), z);
                assert_eq!(image.mean(&cell), image.radiance(middle), "{cell:?}");
            }
        }
    }

    #[test]
    fn a_gradient_has_the_means_of_its_halves() {
        let sky = Panorama::gradient([[1.0, 0.0, 0.0], [0.0, 1.0, 0.5], [0.0, 0.0, 2.0]]);
        let half = |z| sky.mean(&Cell { z, azimuth: [0.0, TAU] });
        for (got, want) in [(half([0.0, 1.0]), [0.0, 0.5, 1.25]), (half([-1.0, 0.0]), [0.5, 0.5, 0.25])] {
            assert!((0..3).all(|c| (got[c] - want[c]).abs() < 1e-5f32), "{got:?}");
        }
        let at = sky.radiance(DVec3::new(0.6, 0.0, 0.8));
        assert!((at[2] - (0.2 * 0.5 + 0.8 * 2.0)).abs() < 0.02, "{at:?}");
    }

    #[test]
    fn cells_add_up_to_the_image() {
        let image = marked([10, 7]);
        let whole = image.mean(&Cell { z: [-1.0, 1.0], azimuth: [0.0, TAU] });
        let mut sum = [0.0f64; 3];
        for i in 0..5 {
            for j in 0..6 {
                let cell = Cell {
                    z: [-1.0 + 0.4 * i as f64, -0.6 + 0.4 * i as f64],
                    azimuth: [TAU * j as f64 / 6.0, TAU * (j + 1) as f64 / 6.0],
                };
                let mean = image.mean(&cell);
                (0..3).for_each(|c| sum[c] += f64::from(mean[c]) / 30.0);
            }
        }
        for c in 0..3 {
            assert!((sum[c] - f64::from(whole[c])).abs() < 1e-5, "{sum:?} {whole:?}");
        }
        // Half of the solid angle lies above the middle row.
        assert!((whole[0] - 4.5).abs() < 1e-5 && (whole[1] - 3.0).abs() < 1e-5, "{whole:?}");
    }
}
