// Carries each ray on to its next surface: position by bisection, normal towards the viewer, signed |∇| (section 3, (8)).
// field, empty, surfaces, hits → hits

@group(0) @binding(5) var<storage, read_write> hits: array<Hit>;

@compute @workgroup_size(64)
fn surface_hits(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = 64u * folded(group, groups) + local;
    if i >= params.count || hits[i].surface == NONE { return; }
    let pixel = hits[i].pixel;
    let at = (2.0 * vec2(f32(pixel % params.picture.x), f32(pixel / params.picture.x)) + 1.0)
        / vec2<f32>(params.picture) - 1.0;
    let way = normalize(params.forward + at.x * params.right - at.y * params.up);
    var path: Path;
    var sides: u32;
    if hits[i].surface == FRESH {
        path = path_from(params.eye, way);
        sides = sides_of(value_at(path.start));
    } else {
        path = path_from(hits[i].position, way);
        sides = hits[i].behind;
    }
    let c = follow(path, sides, false);
    if !c.met {
        hits[i].surface = NONE;
        return;
    }
    let n = normal_at(c.position, way);
    let depth = length((c.position - params.eye) * params.spacing);
    hits[i] = Hit(c.position, pixel, n.xyz, n.w, depth, c.surface, c.before, c.behind);
}
