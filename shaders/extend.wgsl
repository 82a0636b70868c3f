// Coefficients of the medium continued past its edges: out = FAINT · Σ values/Σ σ over the 26 neighbours where σ = 0 and
// Σ σ > 0, else out = values.
// sigma, values → out

struct Params {
    size: vec3<u32>,
    faint: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> sigma: array<f32>;
@group(0) @binding(2) var<storage, read> values: array<f32>;
@group(0) @binding(3) var<storage, read_write> out: array<f32>;

@compute @workgroup_size(8, 8)
fn extend(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id >= params.size) { return; }
    let here = index(params.size, id);
    var value = values[here];
    if sigma[here] <= 0.0 {
        let start = max(id, vec3(1u)) - 1u;
        let end = min(id + 2u, params.size);
        var around = 0.0;
        var coefficient = 0.0;
        for (var k = start.z; k < end.z; k++) {
            for (var j = start.y; j < end.y; j++) {
                for (var i = start.x; i < end.x; i++) {
                    let p = index(params.size, vec3(i, j, k));
                    around += sigma[p];
                    coefficient += values[p];
                }
            }
        }
        if around > 0.0 { value = params.faint * (coefficient / around); }
    }
    out[here] = value;
}
