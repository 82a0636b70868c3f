// Irradiance of a lamp per unit of radiant intensity: E(x) = ρ(x) · t²(3 − 2t)/max(r, R)², see lamp.wgsl.
// rho → out

struct Params {
    // Values that are held.
    size: vec3<u32>,
    position: vec3<f32>,
    spacing: vec3<f32>,
    // R².
    floor: f32,
    axis: vec3<f32>,
    outer: f32,
    slope: f32,
    cosine: f32,
    // The first plane that is held.
    plane: u32,
}

// Voxels from the light within which a voxel holds the mean of its points, and their number along an edge.
const NEAR: f32 = 2.5;
const PARTS: u32 = 4u;

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> rho: array<f32>;
@group(0) @binding(2) var<storage, read_write> out: array<f32>;

@compute @workgroup_size(8, 8)
fn irradiate(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id >= params.size) { return; }
    let i = index(params.size, id);
    let away = vec3<f32>(id + vec3(0u, 0u, params.plane)) - params.position;
    if any(abs(away) > vec3(NEAR)) {
        out[i] = rho[i] * falloff(away * params.spacing, params.axis, params.floor, params.outer, params.slope, params.cosine);
        return;
    }
    var sum = 0.0;
    for (var n = 0u; n < PARTS * PARTS * PARTS; n++) {
        let part = vec3<f32>(vec3(n % PARTS, n / PARTS % PARTS, n / (PARTS * PARTS)));
        let d = (away + (part + 0.5) / f32(PARTS) - 0.5) * params.spacing;
        sum += falloff(d, params.axis, params.floor, params.outer, params.slope, params.cosine);
    }
    out[i] = rho[i] * sum / f32(PARTS * PARTS * PARTS);
}
