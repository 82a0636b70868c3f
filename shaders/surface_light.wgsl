// One term of the light volume at each hit: E·max(0, n·l)/π and E·(s + 1)/2π·max(0, r·l)^s; scattered light counts as even.
// surfaces, light, hits, sums → sums

@group(0) @binding(5) var<storage, read> hits: array<Hit>;
// Diffuse and specular RGB of each hit.
@group(0) @binding(6) var<storage, read_write> sums: array<f32>;
@group(0) @binding(7) var<storage, read> light: array<f32>;

const UNIFORM: u32 = 0u;
const PHASE: u32 = 1u;
const PI: f32 = 3.141592653589793;

fn light_at(position: vec3<f32>) -> f32 {
    let size = params.light_size;
    let p = clamp(position, vec3(0.0), vec3<f32>(size - 1u));
    let base = min(vec3<u32>(p), max(size, vec3(2u)) - 2u);
    let f = p - vec3<f32>(base);
    let reach = min(vec3(1u), size - 1u);
    let i = index(size, base);
    let row = reach.y * size.x;
    let j = i + reach.z * size.x * size.y;
    let near = vec4(light[i], light[i + reach.x], light[i + row], light[i + row + reach.x]);
    let far = vec4(light[j], light[j + reach.x], light[j + row], light[j + row + reach.x]);
    let across = near * (1.0 - f.z) + far * f.z;
    let along = across.xy * (1.0 - f.y) + across.zw * f.y;
    return along.x * (1.0 - f.x) + along.y * f.x;
}

@compute @workgroup_size(64)
fn surface_light(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = 64u * folded(group, groups) + local;
    if i >= params.count { return; }
    let hit = hits[i];
    let scale = vec3<f32>(params.light_size) / vec3<f32>(params.size);
    let value = light_at((hit.position + 0.5) * scale - 0.5);
    var diffuse = params.weight;
    var specular = params.weight;
    if params.kind != UNIFORM {
        var toward = -params.direction;
        var irradiance = params.weight;
        if params.kind != PHASE {
            let d = (hit.position - params.position) * params.spacing;
            toward = -d / sqrt(max(dot(d, d), 1e-30));
            irradiance *= falloff(d, params.direction, params.floor, params.outer, params.slope, params.cosine);
        }
        let cosine = dot(hit.normal, toward);
        let exponent = exponent_at(surfaces[hit.surface], hit.slope);
        let mirrored = mirror(towards(hit.position), hit.normal);
        let facing = select(0.0, 1.0, cosine > 0.0);
        let highlight = pow(max(dot(mirrored, toward), 0.0), exponent) * (exponent + 1.0) / TAU;
        diffuse = irradiance * (facing * cosine / PI);
        specular = irradiance * (facing * highlight);
    }
    sums[6u * i] += value * diffuse.x;
    sums[6u * i + 1u] += value * diffuse.y;
    sums[6u * i + 2u] += value * diffuse.z;
    sums[6u * i + 3u] += value * specular.x;
    sums[6u * i + 4u] += value * specular.y;
    sums[6u * i + 5u] += value * specular.z;
}
