// Subsurface scattering: through a surface within a lobe to the next, there over the hemisphere, and out (section 6.3).
// field, empty, surfaces, extinction, hits, texels, sums → sums

@group(0) @binding(5) var<storage, read> hits: array<Hit>;
// RGB of each hit.
@group(0) @binding(6) var<storage, read_write> sums: array<f32>;

// Whether light leaves the way it came; whether the lobe bends.
override FAST: bool = false;
override REFRACTS: bool = true;

// Its streams of random numbers; surfaces that a ray on its way out winds through at most.
const PRIMARY: u32 = 4u;
const SECONDARY: u32 = 5u;
const MOST: u32 = 32u;

fn refracted(view: vec3<f32>, normal: vec3<f32>, ior: f32) -> vec3<f32> {
    let ratio = 1.0 / ior;
    let cosine = -dot(view, normal);
    let square = 1.0 - ratio * ratio * (1.0 - cosine * cosine);
    return normalize(ratio * view + (ratio * cosine - sqrt(max(square, 0.0))) * normal);
}

// What is left of light on its way out.
fn leaves(from_position: vec3<f32>, way: vec3<f32>, from_sides: u32) -> vec3<f32> {
    var position = from_position;
    var sides = from_sides;
    var thick = 0.0;
    var through = 1.0;
    for (var i = 0u; i < MOST; i++) {
        let next = follow(path_from(position, way), sides, true);
        // Beyond the last surface it is outside, where extinction alone dims it.
        if next.met || i == 0u || TRANSFER { thick += next.thick; }
        if !next.met { return through * exp(-params.rate * thick); }
        through *= surfaces[next.surface].transmission;
        if through <= 0.0 { break; }
        position = next.position;
        sides = next.behind;
    }
    return vec3(0.0);
}

@compute @workgroup_size(64)
fn surface_subsurface(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = 64u * folded(group, groups) + local;
    if i >= params.count { return; }
    let hit = hits[i];
    let surface = surfaces[hit.surface];
    if surface.transmission <= 0.0 { return; }
    let view = towards(hit.position);
    var axis = view;
    if REFRACTS { axis = refracted(view, hit.normal, surface.ior); }
    let origin = pcg4d(vec4(hit.pixel, PRIMARY, params.seed, hit.surface));
    let inner = pcg4d(vec4(hit.pixel, SECONDARY, params.seed, hit.surface));
    var total = vec3(sums[3u * i], sums[3u * i + 1u], sums[3u * i + 2u]);
    for (var n = params.samples.x; n < params.samples.y; n++) {
        let draw = lobe(axis, surface.spread, origin, vec3(hit.pixel, PRIMARY, params.seed), n);
        let way = above(draw.xyz, -hit.normal);
        let next = follow(path_from(hit.position, way), hit.behind, true);
        let passed = surface.transmission * exp(-params.rate * next.thick);
        if !next.met {
            total += draw.w * passed * sky(params.radiance, way);
            continue;
        }
        let normal = normal_at(next.position, way).xyz;
        var returned = vec3(0.0);
        for (var j = 0u; j < params.secondary; j++) {
            let stream = vec3(hit.pixel, SECONDARY, params.seed);
            let out = hemisphere(normal, inner, stream, n * params.secondary + j);
            var left = passed;
            if !FAST { left = leaves(next.position, out.xyz, next.before); }
            returned += out.w * left * sky(params.radiance, out.xyz);
        }
        total += draw.w * passed * surfaces[next.surface].diffuse * returned / f32(params.secondary);
    }
    sums[3u * i] = total.x;
    sums[3u * i + 1u] = total.y;
    sums[3u * i + 2u] = total.z;
}
