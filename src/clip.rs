//! Media that are cut away by boxes and planes.
//!
//! Renderers cut exactly, sample by sample ([`Clip::keeps`]). What no sample near the cut can see is taken from the data themselves,
//! as holes ([`Clipped`]), so that it casts no shadow either: what is left of it is within a voxel of the cut.

use std::sync::Arc;

use glam::{DVec3, Vec3};

use crate::device::{Clip, ClipShape};
use crate::error::Result;
use crate::field::{EMPTY, Field};
use crate::grid::{Grid, Region};
use crate::scene::{ClipKeys, ClipKind};

/// The cuts of a scene in index space of `grid`.
pub fn clips(keys: &[ClipKeys], grid: &Grid) -> Vec<Clip> {
    let (origin, spacing) = (DVec3::from(grid.origin), DVec3::from(grid.spacing));
    let index = |p: [f64; 3]| (DVec3::from(p) - origin) / spacing;
    let of = |keys: &ClipKeys| {
        let shape = match keys.kind {
            ClipKind::Box => ClipShape::Box { low: index(keys.min).as_vec3(), high: index(keys.max).as_vec3() },
            ClipKind::Plane => {
                let normal = DVec3::from(keys.normal).normalize() * spacing;
                ClipShape::Plane { normal: normal.as_vec3(), offset: normal.dot(index(keys.point)) as f32 }
            }
        };
        Clip { shape, invert: keys.invert }
    };
    keys.iter().map(of).collect()
}

/// A field whose values are holes where cuts leave nothing of the cells round them.
pub struct Clipped {
    /// What is cut.
    pub field: Arc<dyn Field>,
    /// By what.
    pub clips: Vec<Clip>,
}

impl Field for Clipped {
    fn read(&self, region: Region, out: &mut [f32]) -> Result<()> {
        self.field.read(region, out)?;
        let [nx, ny, _] = region.size;
        for (row, out) in out.chunks_exact_mut(nx.max(1)).enumerate() {
            let at = |i: usize| [region.start[0] + i, region.start[1] + row % ny, region.start[2] + row / ny];
            for (i, value) in out.iter_mut().enumerate() {
                let at = Vec3::from(at(i).map(|n| n as f32));
                if self.clips.iter().any(|clip| clip.cuts(at, 1.0)) {
                    *value = EMPTY;
                }
            }
        }
        Ok(())
    }
}
