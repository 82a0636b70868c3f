// Source function of scattered light: S = [σ_s*/4π · (φ + ΣE_l + 3g* Ω·(J + ΣE_l u_l)) + emission] / σ*, as an isotropic
// part and a gradient along Ω; 0 where σ* = 0. `source` starts as φ and the gradients as J.

struct Params {
    count: u32,
    // 3g* (0 without a gradient), and whether there is emission.
    forward: f32,
    glows: u32,
    // World length below which the way from a light has no direction.
    near: f32,
    // Number of the first value on the grid.
    first: u32,
    size: vec3<u32>,
    spacing: vec3<f32>,
}

// A light's first-collision fluence is E·first, its current E·first·u: (x, y, z) is u, or where it comes from.
struct Light {
    irradiance: f32,
    x: f32,
    y: f32,
    z: f32,
    radial: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> sigma: array<f32>;
@group(0) @binding(2) var<storage, read> scattering: array<f32>;
@group(0) @binding(3) var<storage, read> emission: array<f32>;
@group(0) @binding(4) var<storage, read> first: array<f32>;
@group(0) @binding(5) var<storage, read_write> source: array<f32>;
@group(0) @binding(6) var<storage, read_write> gradient_x: array<f32>;
@group(0) @binding(7) var<storage, read_write> gradient_y: array<f32>;
@group(0) @binding(8) var<storage, read_write> gradient_z: array<f32>;
var<immediate> light: Light;

const PER_STERADIAN: f32 = 0.07957747154594767;

// first → source, gradient: adds one light.
@compute @workgroup_size(256)
fn add_light(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = folded(group, groups) * 256u + lane;
    if i >= params.count { return; }
    let fluence = first[i];
    source[i] += light.irradiance * fluence;
    if params.forward != 0.0 {
        var u = vec3(light.x, light.y, light.z);
        if light.radial != 0u {
            let size = params.size;
            let n = params.first + i;
            let d = (vec3<f32>(vec3(n % size.x, n / size.x % size.y, n / (size.x * size.y))) - u) * params.spacing;
            u = d / max(length(d), params.near);
        }
        let current = light.irradiance * fluence * u;
        gradient_x[i] += current.x;
        gradient_y[i] += current.y;
        gradient_z[i] += current.z;
    }
}

// sigma, scattering, emission, source, gradient → source, gradient: from fluence and current to radiance.
@compute @workgroup_size(256)
fn scatter(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = folded(group, groups) * 256u + lane;
    if i >= params.count { return; }
    let inverse = select(0.0, 1.0 / sigma[i], sigma[i] > 0.0);
    let albedo = PER_STERADIAN * scattering[i] * inverse;
    var glow = 0.0;
    if params.glows != 0u { glow = emission[i] * inverse; }
    source[i] = albedo * source[i] + glow;
    if params.forward != 0.0 {
        let along = params.forward * albedo;
        gradient_x[i] *= along;
        gradient_y[i] *= along;
        gradient_z[i] *= along;
    }
}
