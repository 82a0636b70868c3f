// Bound on the change of optical depth across each brick, per unit spacing and for each dominant axis:
// Σ_layers max|now − before| over the brick grown by a halo of one value, plus half the larger of the halo's layers.
// now, before → bounds

struct Params {
    size: vec3<u32>,
    edge: u32,
    bricks: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> now: array<f32>;
@group(0) @binding(2) var<storage, read> before: array<f32>;
@group(0) @binding(3) var<storage, read_write> bounds: array<f32>;

// Layers of a brick of edge 64 with its halo.
const LAYERS: u32 = 66u;

// Largest difference per axis and layer, as the bits of a non-negative f32.
var<workgroup> layers: array<atomic<u32>, 198>;

@compute @workgroup_size(16, 16)
fn change(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_id) thread: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let number = folded(group, groups);
    if number >= params.bricks { return; }
    let region = haloed(params.size, params.edge, number);
    for (var k = region.start.z; k < region.end.z; k++) {
        for (var j = region.start.y + thread.y; j < region.end.y; j += 16u) {
            for (var i = region.start.x + thread.x; i < region.end.x; i += 16u) {
                let p = vec3(i, j, k);
                let difference = abs(now[index(params.size, p)] - before[index(params.size, p)]);
                if difference > 0.0 {
                    let bits = bitcast<u32>(difference);
                    let layer = p - region.start;
                    atomicMax(&layers[layer.x], bits);
                    atomicMax(&layers[LAYERS + layer.y], bits);
                    atomicMax(&layers[2u * LAYERS + layer.z], bits);
                }
            }
        }
    }
    workgroupBarrier();
    if lane < 3u {
        let own = brick(params.size, params.edge, number);
        var inner = 0.0;
        var outer = 0.0;
        for (var p = region.start[lane]; p < region.end[lane]; p++) {
            let most = bitcast<f32>(atomicLoad(&layers[lane * LAYERS + p - region.start[lane]]));
            if p >= own.start[lane] && p < own.end[lane] {
                inner += most;
            } else {
                outer = max(outer, most);
            }
        }
        bounds[3u * number + lane] = inner + 0.5 * outer;
    }
}
