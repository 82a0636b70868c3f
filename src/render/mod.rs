//! Renderers: from a lit volume to a frame. A renderer is one file here and one `match` arm.

use crate::camera::Camera;
use crate::device::Device;
use crate::error::{Error, Result};
use crate::frame::Frame;
use crate::light::LightVolume;
use crate::medium::Medium;
use crate::scene::{RenderKind, Scene};

mod raycast;

pub use raycast::Raycast;

/// Makes pictures of a lit volume.
pub trait Renderer: Send {
    /// A picture of `size` pixels of `medium` under `light`, seen by `camera`: scene-linear, premultiplied by coverage.
    fn render(
        &self,
        device: &dyn Device,
        medium: &Medium,
        light: &LightVolume,
        camera: &Camera,
        size: [usize; 2],
    ) -> Result<Frame>;
}

/// The renderer that a scene asks for.
pub fn renderer(scene: &Scene) -> Result<Box<dyn Renderer>> {
    match scene.render.kind {
        RenderKind::Raycast => Ok(Box::new(Raycast::new(scene))),
        kind => Err(Error::Unsupported(format!("render.kind = {kind:?}; this version has \"raycast\""))),
    }
}
