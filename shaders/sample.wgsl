// A volume at points: Σ weight·value over the eight values round each, trilinear, positions clamped to the outermost values.
// values, points → found

struct Params {
    size: vec3<u32>,
    count: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> values: array<f32>;
// x, y, z of each, in the index space of the volume.
@group(0) @binding(2) var<storage, read> points: array<f32>;
@group(0) @binding(3) var<storage, read_write> found: array<f32>;

@compute @workgroup_size(256)
fn sample(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let n = folded(group, groups) * 256u + lane;
    if n >= params.count { return; }
    let last = params.size - 1u;
    let point = vec3(points[3u * n], points[3u * n + 1u], points[3u * n + 2u]);
    let p = clamp(point, vec3(0.0), vec3<f32>(last));
    let first = min(vec3<u32>(p), max(last, vec3(1u)) - 1u);
    let next = min(first + 1u, last);
    let upper = p - vec3<f32>(first);
    let lower = 1.0 - upper;
    var planes: array<f32, 2>;
    for (var k = 0u; k < 2u; k++) {
        let z = select(first.z, next.z, k == 1u);
        let near = values[index(params.size, vec3(first.x, first.y, z))] * lower.x
            + values[index(params.size, vec3(next.x, first.y, z))] * upper.x;
        let far = values[index(params.size, vec3(first.x, next.y, z))] * lower.x
            + values[index(params.size, vec3(next.x, next.y, z))] * upper.x;
        planes[k] = near * lower.y + far * upper.y;
    }
    found[n] = planes[0] * lower.z + planes[1] * upper.z;
}
