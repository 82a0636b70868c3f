// A box of a grid as a volume of its own, and back: out[p] = values[start + p].

struct Params {
    // The grid, and the box in it.
    size: vec3<u32>,
    start: vec3<u32>,
    inner: vec3<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> values: array<f32>;
@group(0) @binding(2) var<storage, read_write> out: array<f32>;

// values of the grid → those of the box
@compute @workgroup_size(8, 8)
fn crop(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id >= params.inner) { return; }
    out[index(params.inner, id)] = values[index(params.size, params.start + id)];
}

// values of the box → those of the grid, 0 outside
@compute @workgroup_size(8, 8)
fn embed(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id >= params.size) { return; }
    let p = id - params.start;
    var value = 0.0;
    // Before the box the difference wraps round, and is beyond it too.
    if all(p < params.inner) { value = values[index(params.inner, p)]; }
    out[index(params.size, id)] = value;
}
