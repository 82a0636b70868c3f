// Overlap of voxels of two grids that fill the same box: along an axis, voxel i of `coarse` covers
// [i·fine/coarse, (i + 1)·fine/coarse) in voxels of `fine`.

struct Cover {
    start: vec3<u32>,
    end: vec3<u32>,
}

fn covered(fine: vec3<u32>, coarse: vec3<u32>, i: vec3<u32>) -> Cover {
    return Cover(i * fine / coarse, ((i + 1u) * fine + coarse - 1u) / coarse);
}

// Fraction of coarse voxel i that fine voxel p takes up. The ends are counted in 1/coarse of a fine voxel, exactly.
fn overlap(fine: vec3<u32>, coarse: vec3<u32>, i: vec3<u32>, p: vec3<u32>) -> f32 {
    let shared_length = min((p + 1u) * coarse, (i + 1u) * fine) - max(p * coarse, i * fine);
    let fraction = vec3<f32>(shared_length) / vec3<f32>(fine);
    return fraction.x * fraction.y * fraction.z;
}
