//! What all rays of a pass share.

use super::super::host;
use super::super::march::plan::Matter;
use crate::device::slices::{Beam, Casting, Lookup, Slices};
use crate::device::{Clip, Falloff, Phong, Weight};
use crate::grid::Slab;

/// A weight, and where its lamp is if it is one's.
pub(super) struct Source {
    pub weight: Weight,
    pub falloff: Option<Falloff>,
}

impl Source {
    fn new(slices: &Slices, weight: Weight) -> Self {
        let falloff = match weight {
            Weight::Lamp { lamp, .. } => Some(lamp.on(slices.grid, 1)),
            _ => None,
        };
        Source { weight, falloff }
    }
}

/// A light, ready for its rays.
pub(super) struct Shine<'a> {
    pub source: Source,
    pub casting: Casting,
    pub lookup: Lookup,
    pub size: [usize; 2],
    /// Factor on extinction of each channel that is kept.
    pub factors: Vec<f32>,
    pub blur: f32,
    /// Where the rays of texels meet something opaque; empty where nothing is.
    pub opaque: &'a [[f32; 2]],
}

/// A pass, ready for rays.
pub(super) struct Plan<'a> {
    pub matter: Matter<'a>,
    pub eye: Casting,
    pub picture: [usize; 2],
    /// True where the eye meets slabs in the same order as the light.
    pub under: bool,
    pub unshadowed: Vec<Source>,
    pub shine: Option<Shine<'a>>,
    pub glows: bool,
    pub phong: Option<Phong>,
    pub clips: &'a [Clip],
}

impl<'a> Plan<'a> {
    pub fn new(slices: &'a Slices) -> Self {
        let grid = slices.grid;
        let whole = Slab::whole(grid.size);
        let shine = |beam: &'a Beam| Shine {
            source: Source::new(slices, beam.weight),
            casting: Casting::new(&beam.view, &slices.slicing, grid),
            lookup: Lookup::new(beam, grid),
            size: beam.size,
            factors: beam.factors(slices.table.chromatic),
            blur: beam.blur as f32,
            opaque: beam.opaque,
        };
        Plan {
            matter: Matter::new(
                grid,
                &whole,
                (host(slices.field), slices.gradient.map(host)),
                slices.table,
                (&slices.bricks, slices.majorant),
            ),
            eye: Casting::new(&slices.eye, &slices.slicing, grid),
            picture: slices.picture,
            under: slices.under,
            unshadowed: slices.unshadowed.iter().map(|w| Source::new(slices, *w)).collect(),
            shine: slices.beam.as_ref().map(shine),
            glows: slices.glows,
            phong: slices.phong,
            clips: slices.clips,
        }
    }
}
