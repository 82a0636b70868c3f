// Opaque surfaces: o + t d = a + u e + v f, u, v ≥ 0, u + v ≤ 1 (Möller & Trumbore 1997). Triangles lie in a tree of boxes, depth first;
// a ray that misses a box goes on with the node that the box names.

struct Wall {
    // Corners of a box; of a triangle, a corner and the ways to the others.
    lower: vec3<f32>,
    skip: u32,
    upper: vec3<f32>,
    // 0 for a box, 1 + number of its mesh for a triangle.
    mesh: u32,
    edge: vec3<f32>,
}

struct WallHit {
    // Unit, on the side that the ray comes from.
    normal: vec3<f32>,
    t: f32,
    mesh: u32,
    found: bool,
}

const NO_WALL: WallHit = WallHit(vec3(0.0), FAR, 0u, false);

// The first triangle of `count` nodes that a ray meets before a distance.
fn first_wall(origin: vec3<f32>, way: vec3<f32>, before: f32, count: u32) -> WallHit {
    var nearest = before;
    var met = count;
    // A component of nearly 0 is made tiny, so that neither 0/0 nor ∞·0 can arise.
    let inverse = 1.0 / select(way, select(vec3(1e-20), vec3(-1e-20), way < vec3(0.0)), abs(way) < vec3(1e-20));
    var i = 0u;
    while i < count {
        let node = walls[i];
        if node.mesh == 0u {
            let low = (node.lower - origin) * inverse;
            let high = (node.upper - origin) * inverse;
            let into = min(low, high);
            let out = max(low, high);
            let near = max(max(into.x, max(into.y, into.z)), 0.0);
            let far = min(min(out.x, min(out.y, out.z)), nearest);
            i = select(node.skip, i + 1u, near <= far * 1.000001);
            continue;
        }
        let p = cross(way, node.edge);
        let determinant = dot(node.upper, p);
        let start = origin - node.lower;
        let q = cross(start, node.upper);
        if determinant != 0.0 {
            let u = dot(start, p) / determinant;
            let v = dot(way, q) / determinant;
            let t = dot(node.edge, q) / determinant;
            if u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0 && t <= nearest {
                nearest = t;
                met = i;
            }
        }
        i++;
    }
    if met == count { return NO_WALL; }
    let normal = normalize(cross(walls[met].upper, walls[met].edge));
    return WallHit(select(normal, -normal, dot(normal, way) > 0.0), nearest, walls[met].mesh - 1u, true);
}
