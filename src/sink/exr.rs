//! OpenEXR: scene-linear frames before background, exposure and tone map, premultiplied RGBA in 32-bit float. Further layers
//! of a frame are channels `LAYER.CHANNEL` of the same part, in 32-bit float too.
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

use exr::meta::MetaData;
use exr::meta::attribute::AttributeValue;
use exr::prelude::*;

use super::template::Template;
use super::{Output, SinkOptions, View};
use crate::error::{Error, Result};
use crate::frame::{self, Frame};
use crate::whole::write_whole;

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
    write_with(path, &view.frame, attributes(output, view, options))
}

/// Writes a picture and its further layers, without the attributes of a step.
pub fn write_frame(path: &Path, frame: &Frame) -> Result<()> {
    write_with(path, frame, LayerAttributes::default())
}

/// The attributes of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct Attributes(LayerAttributes);

impl Attributes {
    /// Those of the picture that [`read()`] takes from a file.
    ///
    /// # Errors
    /// As [`read()`].
    pub fn of(path: &Path) -> Result<Attributes> {
        let meta = MetaData::read_from_file(path, false).map_err(|e| named(path, e))?;
        let first = meta.headers.into_iter().next();
        Ok(Attributes(first.map(|header| header.own_attributes).unwrap_or_default()))
    }

    /// Writes a picture and its further layers with these attributes.
    ///
    /// # Errors
    /// [`Error::Io`] and [`Error::Format`].
    pub fn write(&self, path: &Path, frame: &Frame) -> Result<()> {
        write_with(path, frame, self.0.clone())
    }
}

fn write_with(path: &Path, frame: &Frame, attributes: LayerAttributes) -> Result<()> {
    let Frame { size: [width, height], pixels, layers } = frame;
    let planes = "RGBA".char_indices().map(|(c, name)| plane(name.to_string(), pixels.iter().map(|p| p[c]).collect()));
    let further = layers.iter().flat_map(|layer| {
        let count = layer.channels.chars().count();
        layer.channels.chars().enumerate().map(move |(c, name)| {
            plane(format!("{}.{name}", layer.name), layer.values.iter().skip(c).step_by(count).copied().collect())
        })
    });
    let channels = AnyChannels::sort(planes.chain(further).collect());
    let layer = exr::image::Layer::new((*width, *height), attributes, Encoding::SMALL_LOSSLESS, channels);
    write_whole(path, |writer| Image::from_layer(layer).write().to_buffered(writer).map_err(|e| named(path, e)))
}

fn plane(name: String, values: Vec<f32>) -> AnyChannel<FlatSamples> {
    AnyChannel::new(Text::new_or_panic(name), FlatSamples::F32(values))
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

/// Reads a picture and its further layers, whatever program wrote it; alpha is 1 where the file has none.
///
/// # Errors
/// [`Error::Io`] and [`Error::Format`] for files that cannot be read or have no R, G and B.
pub fn read(path: &Path) -> Result<Frame> {
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_file(path)
        .map_err(|e| named(path, e))?;
    let size = image.layer_data.size;
    let mut frame = Frame::new([size.width(), size.height()]);
    frame.pixels.fill([0.0, 0.0, 0.0, 1.0]);
    let mut colours = 0;
    for channel in image.layer_data.channel_data.list {
        let name = channel.name.to_string();
        if channel.sampling != Vec2(1, 1) {
            return Err(Error::format(
                path,
                format!("channel {name} has fewer values than the picture has pixels"),
                "",
            ));
        }
        let values = channel.sample_data.values_as_f32();
        match ("RGBA".find(&name).filter(|_| name.len() == 1), name.rsplit_once('.')) {
            (Some(c), _) => {
                colours += usize::from(c < 3);
                frame.pixels.iter_mut().zip(values).for_each(|(pixel, value)| pixel[c] = value);
            }
            (None, Some((layer, channel))) => add(&mut frame, layer, channel, values.collect()),
            (None, None) => add(&mut frame, &name, "V", values.collect()),
        }
    }
    if colours < 3 {
        return Err(Error::format(path, "an EXR without channels R, G and B", ""));
    }
    // Files hold channels by the alphabet.
    let rank = |c: char| "RGBAXYZ".find(c).unwrap_or(c as usize);
    frame.layers.iter_mut().for_each(|layer| {
        let mut order: Vec<(usize, char)> = layer.channels.chars().enumerate().collect();
        order.sort_by_key(|(_, name)| rank(*name));
        let pixels = layer.values.chunks_exact(order.len());
        layer.values = pixels.flat_map(|pixel| order.iter().map(|(from, _)| pixel[*from])).collect();
        layer.channels = order.iter().map(|(_, name)| *name).collect();
    });
    Ok(frame)
}

/// Adds a channel to a layer of a frame.
fn add(frame: &mut Frame, name: &str, channel: &str, values: Vec<f32>) {
    let channel = channel.chars().next().unwrap_or('V');
    match frame.layers.iter_mut().find(|layer| layer.name == name) {
        None => frame.layers.push(frame::Layer { name: name.into(), channels: channel.into(), values }),
        Some(layer) => {
            let before = layer.values.chunks_exact(layer.channels.chars().count());
            layer.values = before.zip(values).flat_map(|(pixel, value)| pixel.iter().copied().chain([value])).collect();
            layer.channels.push(channel);
        }
    }
}

fn named(path: &Path, e: exr::error::Error) -> Error {
    match e {
        exr::error::Error::Io(e) => Error::io(path, e),
        e => Error::format(path, format!("not a readable RGB(A) EXR: {e}"), ""),
    }
}
