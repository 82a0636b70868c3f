//! PNG: 8-bit sRGB pictures with background, exposure, tone map and overlay, one file per step and camera.

use std::io::Write;
use std::path::PathBuf;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};

use super::template::Template;
use super::whole::write_whole;
use super::{Output, Sink, SinkOptions};
use crate::error::{Error, Result};

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

impl Sink for Png {
    fn write(&mut self, output: &Output) -> Result<()> {
        for view in &output.frames {
            let picture = self.options.picture(output, view);
            let path = self.template.path(output.step, &view.camera);
            write_whole(&path, |writer| {
                // Fast costs a third of the default's time for files a tenth larger.
                PngEncoder::new_with_quality(writer.by_ref(), CompressionType::Fast, FilterType::Adaptive)
                    .write_image(picture.as_raw(), picture.width(), picture.height(), ExtendedColorType::Rgb8)
                    .map_err(|e| match e {
                        image::ImageError::IoError(e) => Error::io(&path, e),
                        e => Error::format(&path, e.to_string(), ""),
                    })
            })?;
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<()> {
        Ok(())
    }

    fn paths(&self, step: u64) -> Vec<PathBuf> {
        self.options.cameras.iter().map(|camera| self.template.path(step, camera)).collect()
    }
}
