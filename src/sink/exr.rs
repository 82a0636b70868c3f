//! OpenEXR: scene-linear frames before background, exposure and tone map, premultiplied RGBA in 32-bit float.
//!
//! Attributes of a file:
//!
//! | attribute | type | what |
//! | --- | --- | --- |
//! | `step` | int (string where it does not fit) | the simulation's step number |
//! | `time` | double | physical time; absent when unknown |
//! | `camera` | string | name of the camera |
//! | `eye` | v3f | eye in world space |
//! | `right`, `up`, `forward` | v3f | view axes in world space |
//! | `verticalFov` | float | vertical field of view in degrees |
//! | `fieldRange` | v2f | data values at 0 and 1 of the transfer function |
//! | `previewBlocks` | int | voxels along the edge of the blocks that a preview shows; absent when it is none |
//! | `software` | string | `gloaming` and its version |

use std::path::{Path, PathBuf};

use exr::meta::attribute::AttributeValue;
use exr::prelude::*;

use super::template::Template;
use super::whole::write_whole;
use super::{Output, SinkOptions, View};
use crate::error::{Error, Result};
use crate::frame::Frame;

/// Writes one EXR per step and camera.
pub(super) struct Exr {
    template: Template,
    options: SinkOptions,
}

impl Exr {
    pub(super) fn new(template: Template, options: SinkOptions) -> Self {
        Exr { template, options }
    }
}

impl super::Sink for Exr {
    fn write(&mut self, output: &Output) -> Result<()> {
        for view in &output.frames {
            write(&self.template.path(output.step, &view.camera), output, view, &self.options)?;
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

fn write(path: &Path, output: &Output, view: &View, options: &SinkOptions) -> Result<()> {
    let Frame { size: [width, height], pixels } = &view.frame;
    let channels = SpecificChannels::rgba(|at: Vec2<usize>| {
        let [r, g, b, a] = pixels[at.y() * width + at.x()];
        (r, g, b, a)
    });
    let layer = Layer::new((*width, *height), attributes(output, view, options), Encoding::SMALL_LOSSLESS, channels);
    write_whole(path, |writer| Image::from_layer(layer).write().to_buffered(writer).map_err(|e| named(path, e)))
}

fn attributes(output: &Output, view: &View, options: &SinkOptions) -> LayerAttributes {
    let vector = |[x, y, z]: [f32; 3]| AttributeValue::FloatVec3((x, y, z));
    let software = &*options.software;
    let mut attributes = LayerAttributes { software_name: Some(Text::new_or_panic(software)), ..Default::default() };
    let mut add = |name: &str, value| attributes.other.insert(Text::new_or_panic(name), value);
    add("step", i32::try_from(output.step).map_or_else(|_| text(&output.step.to_string()), AttributeValue::I32));
    if let Some(time) = output.time {
        add("time", AttributeValue::F64(time));
    }
    if options.preview > 1 {
        add("previewBlocks", AttributeValue::I32(options.preview as i32));
    }
    add("camera", text(&view.camera));
    add("eye", vector(view.eye));
    add("right", vector(view.axes[0]));
    add("up", vector(view.axes[1]));
    add("forward", vector(view.axes[2]));
    add("verticalFov", AttributeValue::F32(view.fov));
    add("fieldRange", AttributeValue::FloatVec2(Vec2(output.range[0] as f32, output.range[1] as f32)));
    attributes
}

/// Text as EXR has it; characters beyond Latin-1 become `?`.
fn text(value: &str) -> AttributeValue {
    let latin: String = value.chars().map(|c| if (c as u32) < 256 { c } else { '?' }).collect();
    AttributeValue::Text(Text::new_or_panic(latin))
}

/// Reads the first RGBA layer of a file as scene-linear pixels; alpha is 1 where the file has none.
pub fn read(path: &Path) -> Result<Frame> {
    let image = read_first_rgba_layer_from_file(
        path,
        |size, _| Frame::new([size.width(), size.height()]),
        |frame: &mut Frame, at, (r, g, b, a): (f32, f32, f32, f32)| {
            let width = frame.size[0];
            frame.pixels[at.y() * width + at.x()] = [r, g, b, a];
        },
    )
    .map_err(|e| named(path, e))?;
    Ok(image.layer_data.channel_data.pixels)
}

fn named(path: &Path, e: exr::error::Error) -> Error {
    match e {
        exr::error::Error::Io(e) => Error::io(path, e),
        e => Error::format(path, format!("not a readable RGB(A) EXR: {e}"), ""),
    }
}
