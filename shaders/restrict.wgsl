// Mean of a volume over the voxels of a coarser (or equal) grid that fills the same box.
// values → out

struct Params {
    size: vec3<u32>,
    coarse: vec3<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> values: array<f32>;
@group(0) @binding(2) var<storage, read_write> out: array<f32>;

@compute @workgroup_size(8, 8)
fn restrict_mean(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id >= params.coarse) { return; }
    let cover = covered(params.size, params.coarse, id);
    var sum = 0.0;
    for (var k = cover.start.z; k < cover.end.z; k++) {
        for (var j = cover.start.y; j < cover.end.y; j++) {
            for (var i = cover.start.x; i < cover.end.x; i++) {
                let p = vec3(i, j, k);
                sum += overlap(params.size, params.coarse, id, p) * values[index(params.size, p)];
            }
        }
    }
    out[index(params.coarse, id)] = sum;
}
