//! Ray casting lit by the light volume: one extra fetch per sample (Zhang & Ma 2013, section 4).

use std::sync::Arc;

use super::surfaces::{Surfaces, lit};
use crate::camera::Camera;
use crate::device::{Device, March, Phong};
use crate::error::Result;
use crate::frame::Frame;
use crate::geometry::Geometry;
use crate::grid::Grid;
use crate::light::LightVolume;
use crate::lights::Light;
use crate::medium::Medium;
use crate::render::Renderer;
use crate::scene::{RenderKeys, Scene, Shading};

/// Ray casting.
pub struct Raycast {
    keys: RenderKeys,
    surfaces: Option<Surfaces>,
}

impl Raycast {
    /// Ray casting as `scene.render` says, up to what is opaque.
    pub fn new(scene: &Scene, geometry: Option<Arc<Geometry>>) -> Self {
        Raycast { keys: scene.render.clone(), surfaces: geometry.map(Surfaces::new) }
    }
}

/// Phong shading for the first distant, point or cone light, if it is wanted; a light in a place counts as distant, as the middle
/// of the volume sees it.
pub(super) fn phong(keys: &RenderKeys, lights: &[Light], grid: &Grid) -> Option<Phong> {
    let (lo, hi) = grid.bounds();
    let direction = lights.iter().find_map(|l| match *l {
        Light::Distant { direction, .. } => Some(direction),
        Light::Point { position, .. } | Light::Cone { position, .. } | Light::Patch { position, .. } => {
            (0.5 * (lo + hi) - position).as_vec3().try_normalize()
        }
        _ => None,
    })?;
    let RenderKeys { ambient, diffuse, specular, shininess, .. } = *keys;
    let phong = Phong { towards_light: -direction, ambient, diffuse, specular, shininess };
    (keys.shading == Shading::Phong).then_some(phong)
}

impl Renderer for Raycast {
    fn render(
        &self,
        device: &dyn Device,
        medium: &Medium,
        light: &LightVolume,
        camera: &Camera,
        size: [usize; 2],
    ) -> Result<Frame> {
        let mut frame = Frame::new(size);
        self.cast(device, medium, light, camera, None, &mut frame)?;
        Ok(frame)
    }

    fn render_tiles(
        &self,
        device: &dyn Device,
        medium: &Medium,
        light: &LightVolume,
        camera: &Camera,
        tiles: &[u32],
        frame: &mut Frame,
    ) -> Result<bool> {
        self.cast(device, medium, light, camera, Some(tiles), frame)?;
        Ok(true)
    }

    fn keeps_tiles(&self) -> bool {
        // Light on a surface is not that of the bricks that its pixel sees.
        self.surfaces.is_none()
    }
}

impl Raycast {
    fn cast(
        &self,
        device: &dyn Device,
        medium: &Medium,
        light: &LightVolume,
        camera: &Camera,
        tiles: Option<&[u32]>,
        frame: &mut Frame,
    ) -> Result<()> {
        let terms = light.terms();
        let march = March {
            grid: &medium.grid,
            field: &medium.field,
            gradient: medium.gradient.as_ref(),
            table: &medium.table,
            bricks: medium.bricks,
            majorant: &medium.majorant,
            terms: &terms,
            phong: phong(&self.keys, light.lights(), &medium.grid),
            camera,
            clips: &medium.clips,
            step: self.keys.step * medium.grid.mean_spacing() as f32,
        };
        if let Some(surfaces) = &self.surfaces {
            let behind = surfaces.seen(camera, frame.size, |met| lit(device, &medium.grid, &terms, met))?;
            return device.march_before(&march, &behind, frame);
        }
        match tiles {
            Some(tiles) => device.march_tiles(&march, tiles, frame),
            None => device.march(&march, frame),
        }
    }
}
