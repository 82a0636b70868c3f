// Adds a coarser grid of the same box to a finer one: trilinear between its values, constant beyond the outermost.
// values, into → into

struct Params {
    coarse: vec3<u32>,
    // The first plane of each that is held, and how many of the finer grid.
    below: u32,
    size: vec3<u32>,
    first: u32,
    planes: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> values: array<f32>;
@group(0) @binding(2) var<storage, read_write> into: array<f32>;

@compute @workgroup_size(8, 8)
fn prolong(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id >= vec3(params.size.xy, params.planes)) { return; }
    let last = vec3<f32>(params.coarse - 1u);
    let scale = vec3<f32>(params.coarse) / vec3<f32>(params.size);
    let at = clamp((vec3<f32>(id + vec3(0u, 0u, params.first)) + 0.5) * scale - 0.5, vec3(0.0), last);
    let low = vec3<u32>(at);
    let high = min(low + 1u, params.coarse - 1u);
    let t = at - vec3<f32>(low);
    var planes: array<f32, 2>;
    for (var k = 0u; k < 2u; k++) {
        let z = select(low.z, high.z, k == 1u) - params.below;
        let a = mix(values[index(params.coarse, vec3(low.x, low.y, z))], values[index(params.coarse, vec3(high.x, low.y, z))], t.x);
        let b = mix(values[index(params.coarse, vec3(low.x, high.y, z))], values[index(params.coarse, vec3(high.x, high.y, z))], t.x);
        planes[k] = mix(a, b, t.y);
    }
    into[index(params.size, id)] += mix(planes[0], planes[1], t.z);
}
