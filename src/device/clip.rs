//! Parts of space in which the medium is kept.

use glam::Vec3;

/// What is kept of a medium, in index space of the data grid (value (i, j, k) at (i, j, k)).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clip {
    /// Where the medium is kept.
    pub shape: ClipShape,
    /// It is cut away there, and kept elsewhere.
    pub invert: bool,
}

/// The shape of a [`Clip`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ClipShape {
    /// Between two corners.
    Box {
        /// Lowest position.
        low: Vec3,
        /// Highest position.
        high: Vec3,
    },
    /// On one side of a plane: `normal · x ≥ offset`.
    Plane {
        /// Towards what is kept; of any length.
        normal: Vec3,
        /// Product with the positions on the plane.
        offset: f32,
    },
}

impl Clip {
    /// True where the medium is kept.
    #[inline]
    pub fn keeps(&self, position: Vec3) -> bool {
        let inside = match self.shape {
            ClipShape::Box { low, high } => position.cmpge(low).all() && position.cmple(high).all(),
            ClipShape::Plane { normal, offset } => normal.dot(position) >= offset,
        };
        inside != self.invert
    }

    /// True when nothing is kept within `reach` of a position along each axis.
    pub fn cuts(&self, position: Vec3, reach: f32) -> bool {
        let (below, above) = (position - reach, position + reach);
        match (self.shape, self.invert) {
            (ClipShape::Box { low, high }, false) => above.cmplt(low).any() || below.cmpgt(high).any(),
            (ClipShape::Box { low, high }, true) => below.cmpge(low).all() && above.cmple(high).all(),
            (ClipShape::Plane { normal, offset }, false) => {
                normal.dot(position) + reach * normal.abs().element_sum() < offset
            }
            (ClipShape::Plane { normal, offset }, true) => {
                normal.dot(position) - reach * normal.abs().element_sum() >= offset
            }
        }
    }
}
