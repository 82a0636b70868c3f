//! `[[clip]]`: where the medium is cut away.

use serde::{Deserialize, Serialize};

/// `[[clip]]`: a part of space in which the medium is kept; of several, what all of them keep.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ClipKeys {
    /// box or plane.
    pub kind: ClipKind,
    /// Lowest corner of a box, world axes.
    pub min: [f64; 3],
    /// Highest corner of a box, world axes.
    pub max: [f64; 3],
    /// A point on a plane, world axes.
    pub point: [f64; 3],
    /// Across a plane, towards what is kept.
    pub normal: [f64; 3],
    /// Keeps the outside of the box, or the other side of the plane.
    pub invert: bool,
}

impl Default for ClipKeys {
    fn default() -> Self {
        ClipKeys {
            kind: ClipKind::Box,
            min: [f64::NEG_INFINITY; 3],
            max: [f64::INFINITY; 3],
            point: [0.0; 3],
            normal: [0.0, 0.0, 1.0],
            invert: false,
        }
    }
}

/// `clip.kind`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ClipKind {
    /// Between two corners; sides that are not given are open.
    Box,
    /// On one side of a plane.
    Plane,
}
