// Ambient occlusion: sums of unoccluded directions and of the part of each ray that escapes (section 6.2).
// field, surfaces, hits, sums → sums

@group(0) @binding(5) var<storage, read> hits: array<Hit>;
@group(0) @binding(6) var<storage, read_write> sums: array<vec4<f32>>;

// Its stream of random numbers; how far off the surface rays begin, in mean spacings.
const STREAM: u32 = 1u;
const OFFSET: f32 = 0.1;

@compute @workgroup_size(64)
fn surface_occlusion(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = 64u * folded(group, groups) + local;
    if i >= params.count { return; }
    let hit = hits[i];
    let start = hit.position + OFFSET * params.mean_spacing * hit.normal / params.spacing;
    let origin = pcg4d(vec4(hit.pixel, STREAM, params.seed, hit.surface));
    let step = params.radius / f32(params.steps);
    let top = vec3<f32>(params.size) - 0.5;
    var sum = sums[i];
    for (var n = params.samples.x; n < params.samples.y; n++) {
        let u = point(origin, n);
        var way: vec3<f32>;
        if PAPER {
            way = sphere(vec3(hit.pixel, STREAM, params.seed), n);
            if dot(way, hit.normal) < 0.0 { way = -way; }
        } else {
            way = about(hit.normal, sqrt(1.0 - u.x), u.y);
        }
        let slope = way / params.spacing;
        var sides = hit.before;
        var through = 1.0;
        for (var k = 0u; k < params.steps; k++) {
            let position = start + (f32(k) + u.z) * step * slope;
            if any(position < vec3(-0.5)) || any(position > top) { break; }
            var here = NOWHERE;
            if stays(position) { here = sides_of(value_at(position)); }
            if here != sides && here != NOWHERE && sides != NOWHERE {
                for (var s = 0u; s < params.surfaces; s++) {
                    if (((here ^ sides) >> s) & 1u) == 1u { through *= 1.0 - surfaces[s].opacity; }
                }
                if through <= 0.0 {
                    through = 0.0;
                    break;
                }
            }
            sides = here;
        }
        sum += vec4(way, 1.0) * through;
    }
    sums[i] = sum;
}
