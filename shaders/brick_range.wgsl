// Smallest and largest value of each brick with a halo of one value, holes left out.
// field → ranges

struct Params {
    size: vec3<u32>,
    edge: u32,
    bricks: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> field: array<f32>;
@group(0) @binding(2) var<storage, read_write> ranges: array<vec2<f32>>;

// The largest finite values stand for "nothing yet": WGSL has no infinities.
const NOTHING: vec2<f32> = vec2(3.4028234e38, -3.4028234e38);

var<workgroup> lanes: array<vec2<f32>, 256>;

@compute @workgroup_size(16, 16)
fn brick_range(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_id) thread: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let number = folded(group, groups);
    if number >= params.bricks { return; }
    let region = haloed(params.size, params.edge, number);
    var range = NOTHING;
    for (var k = region.start.z; k < region.end.z; k++) {
        for (var j = region.start.y + thread.y; j < region.end.y; j += 16u) {
            for (var i = region.start.x + thread.x; i < region.end.x; i += 16u) {
                let value = field[index(params.size, vec3(i, j, k))];
                if value >= HOLE { range = vec2(min(range.x, value), max(range.y, value)); }
            }
        }
    }
    lanes[lane] = range;
    workgroupBarrier();
    for (var half = 128u; half > 0u; half /= 2u) {
        if lane < half {
            let other = lanes[lane + half];
            lanes[lane] = vec2(min(lanes[lane].x, other.x), max(lanes[lane].y, other.y));
        }
        workgroupBarrier();
    }
    if lane == 0u { ranges[number] = lanes[0]; }
}
