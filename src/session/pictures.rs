//! The pictures of one step: each camera's, or of one at rest only the tiles that what changed can be seen in.

use crate::camera::Camera;
use crate::device::{Device, March};
use crate::error::Result;
use crate::frame::Frame;
use crate::light::LightVolume;
use crate::medium::Medium;
use crate::render::Renderer;
use crate::render::reuse::{self, Kept, Seen};
use crate::scene::{CameraKeys, Scene};
use crate::sink::View;

/// What cameras look at.
pub(super) struct Scenery<'a> {
    pub(super) scene: &'a Scene,
    pub(super) renderer: &'a dyn Renderer,
    pub(super) medium: &'a Medium,
    pub(super) light: &'a LightVolume,
}

/// What they saw.
#[derive(Default)]
pub(super) struct Pictures {
    pub(super) views: Vec<View>,
    /// What the next step may keep some of.
    pub(super) kept: Vec<Kept>,
    pub(super) tiles_reused: u64,
    pub(super) tiles_total: u64,
}

impl Scenery<'_> {
    /// The picture of every camera in the step of number `steps` of the session; `before` are those of the step before.
    pub(super) fn pictures(&self, device: &dyn Device, steps: u64, before: Vec<Kept>) -> Result<Pictures> {
        let reuses = self.scene.light.warm && self.renderer.keeps_tiles();
        let changed = if reuses { reuse::changed(device, self.medium, self.light)? } else { None };
        let size = self.scene.render.size;
        let all = March::tiles(size).iter().product::<usize>();
        let mut before = before.into_iter();
        let mut pictures = Pictures::default();
        for keys in cameras(self.scene) {
            let camera = Camera::framed(&keys, &self.medium.grid, size[0] as f64 / size[1] as f64, steps)?;
            let seen = before.next().filter(|kept| kept.camera == camera).map(|kept| kept.seen);
            let (frame, reused) = if self.renderer.replays() {
                let mut paths = seen.and_then(Seen::paths);
                let (frame, reused) = self.renderer.replay(device, self.medium, &camera, size, &mut paths)?;
                pictures.kept.extend(paths.map(|paths| Kept { camera, seen: Seen::Paths(paths) }));
                (frame, reused)
            } else {
                // What changed since the picture is known, and the camera is where it was.
                let again = seen.and_then(Seen::frame).zip(changed.as_ref()).and_then(|(frame, changed)| {
                    let tiles = reuse::tiles(self.medium, changed, &camera, size)?;
                    (tiles.len() < all).then_some((frame, tiles))
                });
                let (frame, rendered) = self.picture(device, &camera, again)?;
                // Light that changes everywhere in this step will in the next, most likely: then a copy is not worth its time.
                if changed.is_some() {
                    pictures.kept.push(Kept { camera, seen: Seen::Frame(frame.clone()) });
                }
                (frame, rendered.map_or(0, |tiles| all - tiles))
            };
            pictures.tiles_total += all as u64;
            pictures.tiles_reused += reused as u64;
            pictures.views.push(view(&keys, &camera, frame));
        }
        Ok(pictures)
    }

    /// A picture, and of how many tiles, if not all, it was rendered.
    fn picture(
        &self,
        device: &dyn Device,
        camera: &Camera,
        again: Option<(Frame, Vec<u32>)>,
    ) -> Result<(Frame, Option<usize>)> {
        if let Some((mut frame, tiles)) = again
            && self.renderer.render_tiles(device, self.medium, self.light, camera, &tiles, &mut frame)?
        {
            return Ok((frame, Some(tiles.len())));
        }
        Ok((self.renderer.render(device, self.medium, self.light, camera, self.scene.render.size)?, None))
    }
}

/// The cameras of a scene; one that frames the volume when it names none.
pub(crate) fn cameras(scene: &Scene) -> Vec<CameraKeys> {
    if scene.cameras.is_empty() { vec![CameraKeys::default()] } else { scene.cameras.clone() }
}

fn view(keys: &CameraKeys, camera: &Camera, frame: Frame) -> View {
    View {
        camera: keys.name.clone(),
        axes: [camera.right.into(), camera.up.into(), camera.forward.into()],
        eye: camera.eye.into(),
        fov: keys.fov as f32,
        frame,
    }
}
