// Gradient magnitude by central differences, edges repeated: ∂v/∂x ≈ (v(x+1) − v(x−1))/2Δx (GPU Gems 39 (2)).
// field → out

struct Params {
    size: vec3<u32>,
    // 1/2Δx.
    scale: vec3<f32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> field: array<f32>;
@group(0) @binding(2) var<storage, read_write> out: array<f32>;

// A neighbour's value; `own` where it is a hole.
fn known(p: vec3<u32>, own: f32) -> f32 {
    let value = field[index(params.size, p)];
    return select(value, own, value < HOLE);
}

@compute @workgroup_size(8, 8)
fn gradient(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id >= params.size) { return; }
    let own = field[index(params.size, id)];
    let low = max(id, vec3(1u)) - 1u;
    let high = min(id + 1u, params.size - 1u);
    let slope = params.scale * vec3(
        known(vec3(high.x, id.yz), own) - known(vec3(low.x, id.yz), own),
        known(vec3(id.x, high.y, id.z), own) - known(vec3(id.x, low.y, id.z), own),
        known(vec3(id.xy, high.z), own) - known(vec3(id.xy, low.z), own),
    );
    out[index(params.size, id)] = select(length(slope), 0.0, own < HOLE);
}
