//! The tree of triangles as a list, for kernels that have no stack.

use glam::{DVec3, Vec3};
use rstar::{ParentNode, RTreeNode};

use super::{Geometry, Triangle};

/// A node of the tree, depth first: a box, or a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Node {
    /// Lower corner of a box, or a corner of a triangle.
    pub lower: Vec3,
    /// Number of the node to go on with when a ray does not meet this one.
    pub skip: u32,
    /// Upper corner of a box, or from a triangle's corner to the second.
    pub upper: Vec3,
    /// 0 for a box, 1 + number of its mesh for a triangle.
    pub mesh: u32,
    /// From a triangle's corner to the third.
    pub edge: Vec3,
}

impl Geometry {
    /// All nodes, with positions relative to `origin`. Boxes hold what is in them in spite of rounding.
    pub fn nodes(&self, origin: DVec3) -> Vec<Node> {
        let mut nodes = Vec::with_capacity(2 * self.triangles.size());
        lay(self.triangles.root(), origin, &mut nodes);
        nodes
    }

    /// Share of the light that each mesh throws back, per channel.
    pub fn colors(&self) -> &[[f32; 3]] {
        &self.colors
    }
}

fn lay(parent: &ParentNode<Triangle>, origin: DVec3, nodes: &mut Vec<Node>) {
    let at = nodes.len();
    let envelope = parent.envelope();
    let [lower, upper] = [envelope.lower(), envelope.upper()].map(|corner| (DVec3::from(corner) - origin).as_vec3());
    let lower = Vec3::from(lower.to_array().map(f32::next_down));
    let upper = Vec3::from(upper.to_array().map(f32::next_up));
    nodes.push(Node { lower, skip: 0, upper, mesh: 0, edge: Vec3::ZERO });
    for child in parent.children() {
        match child {
            RTreeNode::Parent(parent) => lay(parent, origin, nodes),
            RTreeNode::Leaf(triangle) => nodes.push(Node {
                lower: (triangle.corner - origin).as_vec3(),
                skip: nodes.len() as u32 + 1,
                upper: triangle.edges[0].as_vec3(),
                mesh: triangle.mesh + 1,
                edge: triangle.edges[1].as_vec3(),
            }),
        }
    }
    nodes[at].skip = nodes.len() as u32;
}
