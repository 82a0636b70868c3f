// Implicit diffusion (Zhang & Ma 2013, (23)), one backward-Euler step: v − Σ_a κ_a (v_a⁻ − 2v + v_a⁺) = rhs, neighbours outside
// being the voxel itself.
// relax: rhs, values → values of one colour; residual: rhs, values → out = rhs − A v, largest (|r| as bits)

struct Params {
    size: vec3<u32>,
    colour: u32,
    coupling: vec3<f32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> rhs: array<f32>;
@group(0) @binding(2) var<storage, read_write> values: array<f32>;
@group(0) @binding(3) var<storage, read_write> out: array<f32>;
@group(0) @binding(4) var<storage, read_write> largest: atomic<u32>;

@compute @workgroup_size(8, 8)
fn relax(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id >= params.size) || (id.x + id.y + id.z) % 2u != params.colour { return; }
    let here = index(params.size, id);
    var sum = rhs[here];
    var weight = 1.0;
    for (var a = 0u; a < 3u; a++) {
        var p = id;
        if id[a] > 0u {
            p[a] = id[a] - 1u;
            sum += params.coupling[a] * values[index(params.size, p)];
            weight += params.coupling[a];
        }
        if id[a] + 1u < params.size[a] {
            p[a] = id[a] + 1u;
            sum += params.coupling[a] * values[index(params.size, p)];
            weight += params.coupling[a];
        }
    }
    values[here] = sum / weight;
}

@compute @workgroup_size(8, 8)
fn residual(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id >= params.size) { return; }
    let here = index(params.size, id);
    let v = values[here];
    var applied = v;
    for (var a = 0u; a < 3u; a++) {
        var low = id;
        var high = id;
        low[a] = max(id[a], 1u) - 1u;
        high[a] = min(id[a] + 1u, params.size[a] - 1u);
        let differences = (v - values[index(params.size, low)]) + (v - values[index(params.size, high)]);
        applied += params.coupling[a] * differences;
    }
    let r = rhs[here] - applied;
    out[here] = r;
    if abs(r) > 0.0 { atomicMax(&largest, bitcast<u32>(abs(r))); }
}
