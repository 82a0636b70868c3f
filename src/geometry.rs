//! Opaque geometry: meshes of triangles in the volume, where rays end and light is blocked.
//!
//! A ray from o along d meets the triangle a, b, c where `o + t d = a + u(b − a) + v(c − a)`, u, v ≥ 0, u + v ≤ 1 (Möller & Trumbore,
//! "Fast, Minimum Storage Ray/Triangle Intersection", 1997); triangles are found in a tree of boxes. A mesh shades the light as the
//! voxels of the light grid that it fills or touches ([`Geometry::blocked`]), so that its shadow is as sharp as that grid. Its surface
//! is flat in each triangle, seen from both sides, and throws light back evenly (Lambert).

use std::cell::Cell;

use glam::{DMat3, DVec3};
use rayon::prelude::*;
use rstar::{AABB, RTree, RTreeObject, SelectionFunction};

use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::scene::MeshKeys;

mod flat;
mod load;

pub use flat::Node;

/// Where a ray ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Distance along the ray, in units of the direction's length.
    pub t: f64,
    /// World position.
    pub position: DVec3,
    /// Unit normal, on the side that the ray comes from.
    pub normal: DVec3,
    /// Share of the light that is thrown back, per channel.
    pub color: [f32; 3],
}

/// A triangle of a mesh.
struct Triangle {
    corner: DVec3,
    /// From the corner to the two others.
    edges: [DVec3; 2],
    /// Number of its mesh.
    mesh: u32,
}

impl Triangle {
    /// Distance to where a ray meets the triangle's plane inside of it; `None` where it does not, or runs along it.
    fn meets(&self, origin: DVec3, direction: DVec3) -> Option<f64> {
        let [e, f] = self.edges;
        let p = direction.cross(f);
        let determinant = e.dot(p);
        let from = origin - self.corner;
        let q = from.cross(e);
        let (u, v) = (from.dot(p) / determinant, direction.dot(q) / determinant);
        // False for NaN, where the determinant is 0.
        (u >= 0.0 && v >= 0.0 && u + v <= 1.0).then(|| f.dot(q) / determinant).filter(|t| t.is_finite())
    }

    fn corners(&self) -> [DVec3; 3] {
        [self.corner, self.corner + self.edges[0], self.corner + self.edges[1]]
    }
}

impl RTreeObject for Triangle {
    type Envelope = AABB<[f64; 3]>;

    fn envelope(&self) -> Self::Envelope {
        let [a, b, c] = self.corners();
        AABB::from_corners(a.min(b).min(c).to_array(), a.max(b).max(c).to_array())
    }
}

/// Boxes that a ray meets before `nearest`.
struct Along<'a> {
    origin: DVec3,
    inverse: DVec3,
    nearest: &'a Cell<f64>,
}

impl SelectionFunction<Triangle> for Along<'_> {
    fn should_unpack_parent(&self, envelope: &AABB<[f64; 3]>) -> bool {
        let lower = (DVec3::from(envelope.lower()) - self.origin) * self.inverse;
        let upper = (DVec3::from(envelope.upper()) - self.origin) * self.inverse;
        let (mut near, mut far) = (0.0f64, self.nearest.get());
        for (l, u) in (0..3).map(|a| (lower[a], upper[a])) {
            // 0·∞ of a ray in the plane of a face, which meets the box.
            if !l.is_nan() && !u.is_nan() {
                near = near.max(l.min(u));
                far = far.min(l.max(u));
            }
        }
        near <= far * (1.0 + 1e-12)
    }

    fn should_unpack_leaf(&self, leaf: &Triangle) -> bool {
        self.should_unpack_parent(&leaf.envelope())
    }
}

/// All meshes of a scene.
pub struct Geometry {
    triangles: RTree<Triangle>,
    colors: Vec<[f32; 3]>,
    /// Lower and upper corner of each mesh.
    bounds: Vec<(DVec3, DVec3)>,
}

impl Geometry {
    /// Reads the meshes; `None` where there are none.
    ///
    /// # Errors
    /// [`Error::Io`] and [`Error::Format`] for files that cannot be read or hold no triangles, naming the file.
    pub fn load(meshes: &[MeshKeys]) -> Result<Option<Geometry>> {
        if meshes.is_empty() {
            return Ok(None);
        }
        let (mut triangles, mut bounds) = (Vec::new(), Vec::new());
        for (n, keys) in meshes.iter().enumerate() {
            let [x, y, z] = keys.rotate.map(f64::to_radians);
            let turn = DMat3::from_rotation_z(z) * DMat3::from_rotation_y(y) * DMat3::from_rotation_x(x);
            let place = |p: [f64; 3]| turn * (keys.scale * DVec3::from(p)) + DVec3::from(keys.position);
            let (mut lo, mut hi) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
            let before = triangles.len();
            for corners in load::triangles(&keys.path)? {
                let [a, b, c] = corners.map(place);
                (lo, hi) = (lo.min(a).min(b).min(c), hi.max(a).max(b).max(c));
                let triangle = Triangle { corner: a, edges: [b - a, c - a], mesh: n as u32 };
                // What has no area is never met.
                if (b - a).cross(c - a).length_squared() > 0.0 {
                    triangles.push(triangle);
                }
            }
            if triangles.len() == before {
                let found = "a mesh whose triangles have no area";
                return Err(Error::format(&keys.path, found, format!("meshes.{n}.scale, if it is too small")));
            }
            bounds.push((lo, hi));
        }
        let colors = meshes.iter().map(|m| m.color).collect();
        Ok(Some(Geometry { triangles: RTree::bulk_load(triangles), colors, bounds }))
    }

    /// Refuses meshes that lie beside the volume: nothing would light them.
    ///
    /// # Errors
    /// [`Error::Scene`], naming the mesh and both boxes.
    pub fn check(&self, grid: &Grid) -> Result<()> {
        let (lo, hi) = grid.bounds();
        for (n, (from, to)) in self.bounds.iter().enumerate() {
            if (0..3).any(|a| to[a] < lo[a] || from[a] > hi[a]) {
                let message = format!(
                    "the mesh reaches from {:?} to {:?} and does not meet the volume, which reaches from {:?} to {:?}; \
                     position, scale and rotate place it",
                    from.to_array(),
                    to.to_array(),
                    lo.to_array(),
                    hi.to_array()
                );
                return Err(Error::scene(format!("meshes.{n}.position"), message));
            }
        }
        Ok(())
    }

    /// Where a ray first meets a surface, if it does before `t_max`, both in units of `direction`'s length. Surfaces count from both
    /// sides; one that the ray starts on does not.
    pub fn first_hit(&self, origin: DVec3, direction: DVec3, t_max: f64) -> Option<Hit> {
        let nearest = Cell::new(t_max);
        let along = Along { origin, inverse: direction.recip(), nearest: &nearest };
        let mut found = None;
        for triangle in self.triangles.locate_with_selection_function(along) {
            match triangle.meets(origin, direction) {
                Some(t) if t > 0.0 && t <= nearest.get() => {
                    nearest.set(t);
                    found = Some(triangle);
                }
                _ => {}
            }
        }
        found.map(|triangle| {
            let normal = triangle.edges[0].cross(triangle.edges[1]).normalize();
            Hit {
                t: nearest.get(),
                position: origin + nearest.get() * direction,
                normal: if normal.dot(direction) > 0.0 { -normal } else { normal },
                color: self.colors[triangle.mesh as usize],
            }
        })
    }

    /// Where a ray first and last meets a surface, in units of `direction`'s length.
    pub fn ends(&self, origin: DVec3, direction: DVec3) -> Option<[f64; 2]> {
        let far = Cell::new(f64::INFINITY);
        let along = Along { origin, inverse: direction.recip(), nearest: &far };
        let met = self.triangles.locate_with_selection_function(along);
        met.filter_map(|triangle| triangle.meets(origin, direction)).filter(|t| *t > 0.0).fold(None, |ends, t| {
            let [first, last] = ends.unwrap_or([t; 2]);
            Some([first.min(t), last.max(t)])
        })
    }

    /// For each voxel of a grid 1 where a mesh is, 0 elsewhere: inside of it, or where one of the lines through the centres of voxels
    /// along the axes meets its surface in the voxel. Inside is where two of the three lines through a voxel have met the surface an odd
    /// number of times, so that neither an open mesh nor a line through an edge fills what is outside.
    pub fn blocked(&self, grid: &Grid) -> Vec<f32> {
        let [nx, ny, nz] = grid.size;
        let mut votes = vec![0u8; grid.len()];
        /// Votes of a surface.
        const SURFACE: u8 = 2;
        for axis in 0..3 {
            let (p, q) = ((axis + 1) % 3, (axis + 2) % 3);
            let n = grid.size[axis];
            let lines: Vec<Vec<u8>> = (0..grid.size[p] * grid.size[q])
                .into_par_iter()
                .map(|line| {
                    let mut at = [0.0; 3];
                    // Beside the centres by less than anything that shows: corners and edges often lie on them.
                    (at[p], at[q]) = ((line % grid.size[p]) as f64 + 1.7e-4, (line / grid.size[p]) as f64 + 2.3e-4);
                    at[axis] = -0.5;
                    let start = DVec3::from(grid.origin) + DVec3::from(at) * DVec3::from(grid.spacing);
                    self.line(start, axis, grid.spacing[axis], n, SURFACE)
                })
                .collect();
            for (n, vote) in votes.iter_mut().enumerate() {
                let at = [n % nx, n / nx % ny, n / (nx * ny)];
                *vote = vote.saturating_add(lines[at[q] * grid.size[p] + at[p]][at[axis]]);
            }
        }
        debug_assert_eq!(votes.len(), nx * ny * nz);
        votes.into_iter().map(|v| if v >= SURFACE { 1.0 } else { 0.0 }).collect()
    }

    /// Votes for the voxels along a line that begins where the first of them does: 1 inside, `surface` where it meets a surface.
    fn line(&self, start: DVec3, axis: usize, spacing: f64, count: usize, surface: u8) -> Vec<u8> {
        let mut direction = DVec3::ZERO;
        direction[axis] = spacing;
        let mut votes = vec![0; count];
        // From behind the first voxel on, so that a mesh that the grid cuts is known to have begun.
        let before = self.bounds.iter().fold(0.0f64, |far, (lo, _)| far.max((start[axis] - lo[axis]) / spacing)) + 1.0;
        let origin = start - before * direction;
        let far = Cell::new(f64::INFINITY);
        let along = Along { origin, inverse: direction.recip(), nearest: &far };
        let mut meets: Vec<(u32, f64)> = self
            .triangles
            .locate_with_selection_function(along)
            .filter_map(|triangle| Some((triangle.mesh, triangle.meets(origin, direction)? - before)))
            .collect();
        meets.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        for &(_, t) in meets.iter().filter(|(_, t)| (0.0..count as f64).contains(t)) {
            votes[t as usize] = surface;
        }
        // Each mesh for itself: they may overlap.
        for inside in meets.chunk_by(|a, b| a.0 == b.0).flat_map(|mesh| mesh.chunks_exact(2)) {
            let index = |t: f64| (t + 0.5).clamp(0.0, count as f64) as usize;
            // Voxels with their centres in between.
            for vote in &mut votes[index(inside[0].1)..index(inside[1].1)] {
                *vote = (*vote).max(1);
            }
        }
        votes
    }
}

#[cfg(test)]
mod tests;
