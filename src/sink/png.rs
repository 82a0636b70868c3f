//! PNG: 8-bit sRGB pictures with background, exposure, tone map and overlay, one file per step and camera.

use std::io::Write;
use std::path::PathBuf;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};

use super::template::Template;
use super::{Output, Sink, SinkOptions};
use crate::error::{Error, Result};
use crate::whole::write_whole;

/// Writes one PNG per step and camera.
pub(super) struct Png {
    template: Template,
    options: SinkOptions,
}

impl Png {
    pub(super) fn new(template: Template, options: SinkOptions) -> Self {
        Png { template, options }
    }
}

fn encode(size: [usize; 2], rgb: &[u8], writer: impl Write) -> image::ImageResult<()> {
    // Fast costs a third of the default's time for files a tenth larger.
    PngEncoder::new_with_quality(writer, CompressionType::Fast, FilterType::Adaptive).write_image(
        rgb,
        size[0] as u32,
        size[1] as u32,
        ExtendedColorType::Rgb8,
    )
}

/// The bytes of a PNG file of a picture of `size` (width, height) whose 8-bit `rgb` has row 0 on top.
///
/// # Errors
/// [`Error::Unsupported`] when the bytes do not number three a pixel.
pub fn png_bytes(size: [usize; 2], rgb: &[u8]) -> Result<Vec<u8>> {
    let [w, h] = size;
    if rgb.len() != 3 * w * h {
        return Err(Error::Unsupported(format!("a picture of {w}×{h} pixels in {} bytes", rgb.len())));
    }
    let mut bytes = Vec::new();
    encode(size, rgb, &mut bytes).map_err(|e| Error::Unsupported(format!("a picture of {w}×{h} pixels: {e}")))?;
    Ok(bytes)
}

impl Sink for Png {
    fn write(&mut self, output: &Output) -> Result<()> {
        for view in &output.frames {
            let picture = self.options.picture(output, view);
            let path = self.template.path(output.step, &view.camera);
            write_whole(&path, |writer| {
                let size = [picture.width() as usize, picture.height() as usize];
                encode(size, picture.as_raw(), writer.by_ref()).map_err(|e| match e {
                    image::ImageError::IoError(e) => Error::io(&path, e),
                    e => Error::format(&path, e.to_string(), ""),
                })
            })?;
        }
        Ok(())
    }

    fn wants_layers(&self) -> bool {
        false
    }

    fn finish(&mut self) -> Result<()> {
        Ok(())
    }

    fn paths(&self, step: u64) -> Vec<PathBuf> {
        self.options.cameras.iter().map(|camera| self.template.path(step, camera)).collect()
    }
}
