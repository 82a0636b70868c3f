// The environment through diffuse and specular lobes at each hit: sums of both (section 6.1).
// surfaces, hits, bent, texels, sums → sums

@group(0) @binding(5) var<storage, read> hits: array<Hit>;
// Diffuse and specular RGB of each hit.
@group(0) @binding(6) var<storage, read_write> sums: array<f32>;
@group(0) @binding(8) var<storage, read> bent: array<vec4<f32>>;

override BENT: bool = true;
override FILTERED: bool = true;

// Its streams of random numbers.
const DIFFUSE: u32 = 2u;
const SPECULAR: u32 = 3u;

@compute @workgroup_size(64)
fn surface_beauty(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = 64u * folded(group, groups) + local;
    if i >= params.count { return; }
    let hit = hits[i];
    let surface = surfaces[hit.surface];
    var open = hit.normal;
    if BENT {
        let reach = length(bent[i].xyz);
        if reach > 0.0 { open = bent[i].xyz / reach; }
    }
    let mirrored = mirror(towards(hit.position), hit.normal);
    var diffuse = vec3(sums[6u * i], sums[6u * i + 1u], sums[6u * i + 2u]);
    var specular = vec3(sums[6u * i + 3u], sums[6u * i + 4u], sums[6u * i + 5u]);
    if FILTERED {
        diffuse += sky(params.irradiance, open);
        specular += sky(surface.reflection, mirrored);
    } else {
        var origin = pcg4d(vec4(hit.pixel, DIFFUSE, params.seed, hit.surface));
        for (var n = params.samples.x; n < params.samples.y; n++) {
            let draw = hemisphere(open, origin, vec3(hit.pixel, DIFFUSE, params.seed), n);
            diffuse += draw.w * sky(params.radiance, draw.xyz);
        }
        let exponent = exponent_at(surface, hit.slope);
        origin = pcg4d(vec4(hit.pixel, SPECULAR, params.seed, hit.surface));
        for (var n = params.specular_samples.x; n < params.specular_samples.y; n++) {
            let draw = lobe(mirrored, exponent, origin, vec3(hit.pixel, SPECULAR, params.seed), n);
            var way = draw.xyz;
            if !PAPER { way = above(way, hit.normal); }
            specular += draw.w * sky(params.radiance, way);
        }
    }
    sums[6u * i] = diffuse.x;
    sums[6u * i + 1u] = diffuse.y;
    sums[6u * i + 2u] = diffuse.z;
    sums[6u * i + 3u] = specular.x;
    sums[6u * i + 4u] = specular.y;
    sums[6u * i + 5u] = specular.z;
}
