//! Sinks: where lit frames, illuminated volumes and the ledger go. A format is one file here and one `match` arm.
//!
//! | `--out` | sink | what it takes |
//! | --- | --- | --- |
//! | `movie.mp4` | one movie per camera | frames, with background, exposure, tone map, overlay |
//! | `frames/frame_{step:06}.png` | 8-bit pictures | frames, with background, exposure, tone map, overlay |
//! | `frames/frame_{step:06}.exr` | scene-linear pictures | frames as rendered |
//! | `light.vtkhdf` | temporal VTKHDF ImageData | the illuminated volume |
//! | `light_{step:06}.raw` | raw f32 with an `.xmf` each, and `light.xmf` for all | the illuminated volume |
//!
//! Folders are created. A file appears under its final name only when it is whole: what takes one step is written beside
//! it and renamed; what takes all steps grows under a name with `.partial` in it until [`Sink::finish`].

use std::path::{Path, PathBuf};
use std::sync::Arc;

use image::RgbImage;

use crate::error::{Error, Result};
use crate::frame::{Display, Frame};
use crate::ledger::LedgerRow;
pub use crate::light::IlluminatedVolume;
use crate::scene::{Overlay, Scene};
use crate::whole::writable_folder;

pub mod exr;
mod mp4;
pub(crate) mod overlay;
mod png;
mod raw;
pub(crate) mod template;
mod vtkhdf;
mod yuv;

pub use png::png_bytes;
use template::Template;

/// What a session made of one step.
#[derive(Debug, Clone)]
pub struct Output {
    /// The simulation's step number.
    pub step: u64,
    /// Physical time, where known.
    pub time: Option<f64>,
    /// Values that map to 0 and 1 of the transfer function.
    pub range: [f64; 2],
    /// One frame per camera, with the camera's name and the world-to-view rotation's rows (right, up, forward).
    pub frames: Vec<View>,
    /// The illuminated volume, when a sink wants it.
    pub light: Option<Arc<IlluminatedVolume>>,
    /// What it cost.
    pub row: LedgerRow,
}

/// One camera's picture of a step.
#[derive(Debug, Clone)]
pub struct View {
    /// Name of the camera.
    pub camera: String,
    /// Right, up and forward in world axes, for the axes triad and EXR attributes.
    pub axes: [[f32; 3]; 3],
    /// Eye in world space.
    pub eye: [f32; 3],
    /// Vertical field of view in degrees.
    pub fov: f32,
    /// The picture.
    pub frame: Frame,
}

/// Something that takes the output of one step after another.
pub trait Sink: Send {
    /// Takes one step. A file appears under its final name only when it is whole.
    fn write(&mut self, output: &Output) -> Result<()>;

    /// Closes what is open; the sink is not used afterwards. Called after an interruption and after errors too, so
    /// that a movie of the frames done is playable.
    fn finish(&mut self) -> Result<()>;

    /// Takes up what an earlier run has left; called before the first step.
    fn resume(&mut self) -> Result<()> {
        Ok(())
    }

    /// True when the sink needs the illuminated volume.
    fn wants_light(&self) -> bool {
        false
    }

    /// True when the sink needs frames.
    fn wants_frames(&self) -> bool {
        true
    }

    /// True when the sink takes the layers of frames.
    fn wants_layers(&self) -> bool {
        true
    }

    /// The files that hold a step of their own, for resuming: a step whose files all exist need not be written again.
    /// Empty for sinks that put all steps into one file.
    fn paths(&self, step: u64) -> Vec<PathBuf> {
        let _ = step;
        vec![]
    }
}

/// What sinks need to know before the first step.
#[derive(Debug, Clone, PartialEq)]
pub struct SinkOptions {
    /// Names of the cameras.
    pub cameras: Vec<String>,
    /// Steps that will come; 0 when that is not known beforehand.
    pub steps: usize,
    /// Frames per second of movies.
    pub fps: f64,
    /// Seconds of movie for a unit of physical time; `None` gives each step one frame.
    pub seconds_per_time_unit: Option<f64>,
    /// Constant quality of movies, 0 (best) to 51.
    pub quality: u8,
    /// Background, exposure and tone map of 8-bit pictures.
    pub display: Display,
    /// What is drawn on 8-bit pictures.
    pub overlay: Vec<Overlay>,
    /// Voxels along the edge of the blocks that a preview shows; 1 when it is none.
    pub preview: usize,
    /// Colours of the colour bar from 0 to 1 of the range, sRGB-encoded in 0..1 as colour maps are published.
    pub colors: [[f32; 3]; 256],
    /// Name of the field, over the colour bar; may be empty.
    pub field: String,
    /// Unit of the field; may be empty.
    pub units: String,
    /// Unit of physical time; may be empty.
    pub time_units: String,
    /// Name and version of the program, for files that can hold them.
    pub software: String,
}

impl Default for SinkOptions {
    fn default() -> Self {
        SinkOptions::from(&Scene::default())
    }
}

impl From<&Scene> for SinkOptions {
    /// What a scene says. Steps, field, units and the colours of the bar (a grey ramp) are for the caller to fill in.
    fn from(scene: &Scene) -> Self {
        let cameras = scene.cameras.iter().map(|c| c.name.clone()).collect::<Vec<_>>();
        SinkOptions {
            cameras: if cameras.is_empty() { vec!["main".into()] } else { cameras },
            steps: 0,
            fps: scene.movie.fps,
            seconds_per_time_unit: scene.movie.seconds_per_time_unit,
            quality: scene.movie.quality,
            display: Display::from(&scene.render),
            overlay: scene.render.overlay.clone(),
            preview: scene.render.preview,
            colors: std::array::from_fn(|i| [i as f32 / 255.0; 3]),
            field: scene.field.name.clone().unwrap_or_default(),
            units: String::new(),
            time_units: String::new(),
            software: concat!("gloaming ", env!("CARGO_PKG_VERSION")).into(),
        }
    }
}

impl SinkOptions {
    /// A view as people see it: background, exposure, tone map, overlay.
    pub fn picture(&self, output: &Output, view: &View) -> RgbImage {
        let mut picture = self.display.picture(&view.frame);
        overlay::draw(&mut picture, self, output, view);
        picture
    }
}

const KNOWN: &str = ".mp4, .png, .exr, .vtkhdf, .raw";

/// Opens the sink for an output path, by its extension. See the table of this [module](self).
///
/// Steps and cameras that would overwrite each other are errors that name the place missing in the path, and a folder
/// in which no file can be made is one now rather than after the first step.
pub fn open(target: &str, options: &SinkOptions) -> Result<Box<dyn Sink>> {
    let extension = Path::new(target).extension().unwrap_or_default().to_string_lossy().to_lowercase();
    let template = Template::parse(target)?;
    let options = options.clone();
    match extension.as_str() {
        "png" => {
            one_file_per_step(&template, &options)?;
            one_file_per_camera(&template, &options)?;
            writable_folder(&template.folder())?;
            Ok(Box::new(png::Png::new(template, options)))
        }
        "exr" => {
            one_file_per_step(&template, &options)?;
            one_file_per_camera(&template, &options)?;
            writable_folder(&template.folder())?;
            Ok(Box::new(exr::Exr::new(template, options)))
        }
        "mp4" => {
            one_file_for_all_steps(&template)?;
            one_file_per_camera(&template, &options)?;
            writable_folder(&template.folder())?;
            Ok(Box::new(mp4::Mp4::new(template, options)?))
        }
        "vtkhdf" => {
            one_file_for_all_steps(&template)?;
            no_camera(&template)?;
            writable_folder(&template.folder())?;
            Ok(Box::new(vtkhdf::VtkHdf::new(template, options)))
        }
        "raw" => {
            one_file_per_step(&template, &options)?;
            no_camera(&template)?;
            writable_folder(&template.folder())?;
            Ok(Box::new(raw::Raw::new(template)))
        }
        "" => Err(Error::format(target, "no extension, which picks the format", format!("one of {KNOWN}"))),
        other => Err(Error::format(target, format!("unknown output format `.{other}`"), format!("one of {KNOWN}"))),
    }
}

fn one_file_per_step(template: &Template, options: &SinkOptions) -> Result<()> {
    if template.has_step() || options.steps == 1 {
        return Ok(());
    }
    let found = match options.steps {
        0 => "every step would overwrite the one before".to_string(),
        n => format!("{n} steps would overwrite one another"),
    };
    Err(Error::format(template.text(), found, format!("--out {}", template.with("_{step:06}"))))
}

fn one_file_for_all_steps(template: &Template) -> Result<()> {
    if !template.has_step() {
        return Ok(());
    }
    let remedy = format!("--out {}", template.without_step().display());
    Err(Error::format(template.text(), "this format takes all steps into one file", remedy))
}

fn no_camera(template: &Template) -> Result<()> {
    if !template.has_camera() {
        return Ok(());
    }
    let remedy = format!("--out {}", template.text().replace("_{camera}", "").replace("{camera}", "light"));
    Err(Error::format(template.text(), "the illuminated volume is the same for all cameras", remedy))
}

fn one_file_per_camera(template: &Template, options: &SinkOptions) -> Result<()> {
    let names = &options.cameras;
    if let Some(twice) = names.iter().enumerate().find_map(|(i, name)| names[..i].contains(name).then_some(name)) {
        return Err(Error::scene("cameras.name", format!("`{twice}` is the name of two cameras: names must differ")));
    }
    if template.has_camera() || names.len() <= 1 {
        return Ok(());
    }
    let found = format!("{} cameras ({}) would overwrite one another", names.len(), names.join(", "));
    Err(Error::format(template.text(), found, format!("--out {}", template.with("_{camera}"))))
}
