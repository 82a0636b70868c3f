//! Which tiles of a picture may differ from the step before: those that see a brick whose values or light changed where
//! something can be seen (light.md, frames). A brick is seen within the rectangle round its projected corners, so that the
//! answer errs on the side of too many tiles, and the other tiles keep their pixels to the bit.

use glam::DVec3;

use crate::camera::Camera;
use crate::device::{Device, March};
use crate::error::Result;
use crate::frame::Frame;
use crate::grid::Grid;
use crate::light::{LightVolume, Touched};
use crate::medium::Medium;
use crate::render::replay::Paths;

/// A picture of the step before.
pub struct Kept {
    /// Who saw it.
    pub camera: Camera,
    /// What was seen.
    pub seen: Seen,
}

/// What is kept of a picture.
pub enum Seen {
    /// Its pixels.
    Frame(Frame),
    /// The paths that it is made of.
    Paths(Paths),
}

impl Seen {
    pub(crate) fn frame(self) -> Option<Frame> {
        if let Seen::Frame(frame) = self { Some(frame) } else { None }
    }

    pub(crate) fn paths(self) -> Option<Paths> {
        if let Seen::Paths(paths) = self { Some(paths) } else { None }
    }
}

/// For each of [`Medium::bricks`] whether it may look different than in the step before; `None`: every brick may.
pub fn changed(device: &dyn Device, medium: &Medium, light: &LightVolume) -> Result<Option<Vec<bool>>> {
    let Touched::Bricks(layout, touched) = light.touched() else { return Ok(None) };
    let Some(mut changed) = medium.looks_changed(device, false)? else { return Ok(None) };
    let counts = medium.bricks.counts();
    for b in (0..layout.len()).filter(|&b| touched[b]) {
        // Data bricks with samples that interpolate this one's light, which reaches a light voxel beyond it.
        let region = layout.region(b);
        let brick = |a: usize, index: f64| {
            let data = (index + 0.5) * medium.grid.size[a] as f64 / layout.size[a] as f64 - 0.5;
            (data.max(0.0) as usize / medium.bricks.edge).min(counts[a] - 1)
        };
        let first: [usize; 3] = std::array::from_fn(|a| brick(a, region.start[a] as f64 - 1.0));
        let last: [usize; 3] = std::array::from_fn(|a| brick(a, region.end()[a] as f64));
        for z in first[2]..=last[2] {
            for y in first[1]..=last[1] {
                for x in first[0]..=last[0] {
                    let n = medium.bricks.number([x, y, z]);
                    changed[n] |= medium.majorant[n] > 0.0;
                }
            }
        }
    }
    Ok(Some(changed))
}

/// Numbers of the tiles ([`March::TILE`]) of a picture of `size` that see a changed brick; `None`: possibly all.
pub fn tiles(medium: &Medium, changed: &[bool], camera: &Camera, size: [usize; 2]) -> Option<Vec<u32>> {
    let counts = March::tiles(size);
    let mut dirty = vec![false; counts[0] * counts[1]];
    for b in (0..changed.len()).filter(|&b| changed[b]) {
        let region = medium.bricks.region(b);
        // Shading looks one value farther than interpolation.
        let start = region.start.map(|i| i as f64 - 1.5);
        let end = region.end().map(|i| i as f64 + 0.5);
        let [low, high] = rectangle(&medium.grid, [start, end], camera, size)?;
        let span = |a: usize| -> Option<std::ops::Range<usize>> {
            // A pixel's ray is at its centre; a pixel of margin forgives rounding.
            let (low, high) = (low[a] - 1.0, high[a] + 1.0);
            (high >= 0.0 && low < size[a] as f64).then(|| {
                let tile = |p: f64| (p.clamp(0.0, size[a] as f64 - 1.0) as usize) / March::TILE;
                tile(low)..tile(high) + 1
            })
        };
        let (Some(x), Some(y)) = (span(0), span(1)) else { continue };
        for row in y {
            dirty[row * counts[0]..][x.clone()].fill(true);
        }
    }
    Some((0..dirty.len() as u32).filter(|&t| dirty[t as usize]).collect())
}

/// Lowest and highest pixel position of a box in index space; `None` when it reaches beside or behind the eye.
fn rectangle(grid: &Grid, corners: [[f64; 3]; 2], camera: &Camera, size: [usize; 2]) -> Option<[[f64; 2]; 2]> {
    let [width, height] = size.map(|n| n as f64);
    let tan = f64::from(camera.tan);
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for corner in 0..8 {
        let at = |a: usize| grid.origin[a] + grid.spacing[a] * corners[corner >> a & 1][a];
        let from_eye = DVec3::new(at(0), at(1), at(2)) - camera.eye.as_dvec3();
        let depth = from_eye.dot(camera.forward.as_dvec3());
        if depth <= 1e-3 * from_eye.length() {
            return None;
        }
        let right = from_eye.dot(camera.right.as_dvec3()) / (depth * tan * width / height);
        let up = from_eye.dot(camera.up.as_dvec3()) / (depth * tan);
        let pixel = [0.5 * (right + 1.0) * width, 0.5 * (1.0 - up) * height];
        for a in 0..2 {
            (low[a], high[a]) = (low[a].min(pixel[a]), high[a].max(pixel[a]));
        }
    }
    Some([low, high])
}
