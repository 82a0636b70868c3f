//! Renderers: from a lit volume to a frame. A renderer is one file here and one `match` arm.

use std::sync::Arc;

use crate::camera::Camera;
use crate::device::Device;
use crate::error::{Error, Result};
use crate::frame::Frame;
use crate::geometry::Geometry;
use crate::light::LightVolume;
use crate::medium::Medium;
use crate::scene::{RenderKind, Scene};
use replay::Paths;

pub mod denoise;
pub mod film;
pub mod isosurface;
mod pathtrace;
mod raycast;
pub mod replay;
pub mod reuse;
mod slices;
mod surfaces;

pub use isosurface::Isosurface;
pub use pathtrace::Pathtrace;
pub use raycast::Raycast;
pub use slices::HalfAngle;

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

    /// Makes some tiles of `frame` anew ([`crate::device::March::TILE`]), to the bit as [`Renderer::render`] would, and leaves
    /// the others. False: this renderer cannot, and nothing was done.
    fn render_tiles(
        &self,
        device: &dyn Device,
        medium: &Medium,
        light: &LightVolume,
        camera: &Camera,
        tiles: &[u32],
        frame: &mut Frame,
    ) -> Result<bool> {
        let _ = (device, medium, light, camera, tiles, frame);
        Ok(false)
    }

    /// True when a tile depends on nothing but the bricks that it sees, so that [`Renderer::render_tiles`] may do.
    fn keeps_tiles(&self) -> bool {
        false
    }

    /// As [`Renderer::render`], to the bit, from the paths of the step before, where the camera is where it was; leaves those of this step.
    /// Also how many tiles were kept.
    fn replay(
        &self,
        device: &dyn Device,
        medium: &Medium,
        camera: &Camera,
        size: [usize; 2],
        paths: &mut Option<Paths>,
    ) -> Result<(Frame, usize)> {
        let _ = (device, medium, camera, size, paths);
        Err(Error::Unsupported("pathtrace.replay\n  try: render.kind = \"pathtrace\"".into()))
    }

    /// True when pictures are to be made by [`Renderer::replay`].
    fn replays(&self) -> bool {
        false
    }

    /// False when pictures do not depend on the light volume: then nobody need solve it.
    fn needs_light(&self) -> bool {
        true
    }

    /// From now on frames need hold no layers.
    fn leave_out_layers(&mut self) {}

    /// False when pictures do not depend on its scattered light.
    fn needs_scattered_light(&self) -> bool {
        true
    }
}

/// The renderer that a scene asks for, with what is opaque in it.
pub fn renderer(scene: &Scene, geometry: Option<&Arc<Geometry>>) -> Result<Box<dyn Renderer>> {
    match scene.render.kind {
        RenderKind::Raycast => Ok(Box::new(Raycast::new(scene, geometry.cloned()))),
        RenderKind::Slices => Ok(Box::new(HalfAngle::new(scene, geometry.cloned())?)),
        RenderKind::Isosurface => Ok(Box::new(Isosurface::new(scene, geometry.cloned())?)),
        RenderKind::Pathtrace => Ok(Box::new(Pathtrace::new(scene, geometry.cloned())?)),
    }
}
