// What of a light from one place reaches a voxel: out = ρ · cone · 1/max(r², nearest).
// rho → out

struct Params {
    size: vec3<u32>,
    nearest: f32,
    position: vec3<f32>,
    inner: f32,
    spacing: vec3<f32>,
    outer: f32,
    axis: vec3<f32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> rho: array<f32>;
@group(0) @binding(2) var<storage, read_write> out: array<f32>;

@compute @workgroup_size(8, 8)
fn spread(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id >= params.size) { return; }
    let here = index(params.size, id);
    let x = (vec3<f32>(id) - params.position) * params.spacing;
    let square = dot(x, x);
    let cosine = dot(x, params.axis) / max(sqrt(square), 1.17549435e-38);
    let t = clamp((cosine - params.outer) / (params.inner - params.outer), 0.0, 1.0);
    var falloff = 1.0;
    if params.nearest > 0.0 { falloff = 1.0 / max(square, params.nearest); }
    out[here] = rho[here] * falloff * (t * t * (3.0 - 2.0 * t));
}
