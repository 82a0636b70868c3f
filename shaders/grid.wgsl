// Grids are (z, y, x) in memory, x fastest.

fn index(size: vec3<u32>, p: vec3<u32>) -> u32 {
    return (p.z * size.y + p.y) * size.x + p.x;
}

// One number for a workgroup of a dispatch that was folded to stay under 65535 groups along x.
fn folded(group: vec3<u32>, groups: vec3<u32>) -> u32 {
    return group.y * groups.x + group.x;
}
