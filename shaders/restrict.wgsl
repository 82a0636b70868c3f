// Mean of a volume over the voxels of a coarser (or equal) grid that fills the same box.
// values → out

struct Params {
    size: vec3<u32>,
    // First plane of the finer grid that is held.
    above: u32,
    coarse: vec3<u32>,
    // First and number of the planes of the coarser grid that are written.
    first: u32,
    planes: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> values: array<f32>;
@group(0) @binding(2) var<storage, read_write> out: array<f32>;

@compute @workgroup_size(8, 8)
fn restrict_mean(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id >= vec3(params.coarse.xy, params.planes)) { return; }
    let voxel = id + vec3(0u, 0u, params.first);
    let cover = covered(params.size, params.coarse, voxel);
    var sum = 0.0;
    for (var k = cover.start.z; k < cover.end.z; k++) {
        for (var j = cover.start.y; j < cover.end.y; j++) {
            for (var i = cover.start.x; i < cover.end.x; i++) {
                let p = vec3(i, j, k);
                sum += overlap(params.size, params.coarse, voxel, p) * values[index(params.size, p - vec3(0u, 0u, params.above))];
            }
        }
    }
    out[index(params.coarse, id)] = sum;
}
