//! `[[meshes]]`: opaque things in the volume.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

/// `[[meshes]]`: a mesh of triangles, see [`crate::geometry`]. Its vertices are scaled, turned and then moved.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MeshKeys {
    /// OBJ, STL or PLY file.
    pub path: PathBuf,
    /// Share of the light that the surface throws back, red, green and blue.
    pub color: [f32; 3],
    /// Factor on the file's lengths.
    pub scale: f64,
    /// Degrees about the x axis, then y, then z.
    pub rotate: [f64; 3],
    /// World position of the file's origin.
    pub position: [f64; 3],
}

impl Default for MeshKeys {
    fn default() -> Self {
        MeshKeys { path: PathBuf::new(), color: [0.8; 3], scale: 1.0, rotate: [0.0; 3], position: [0.0; 3] }
    }
}
