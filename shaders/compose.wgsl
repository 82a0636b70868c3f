// Adds one weighted volume to a stretch of interleaved RGB: the illuminated volume Σ weight·volume.
// volume, rgb → rgb

struct Term {
    // First value of the stretch, and how many follow.
    first: u32,
    count: u32,
    // 0 for the first volume: what the stretch held is forgotten.
    keep: f32,
    red: f32,
    green: f32,
    blue: f32,
}

@group(0) @binding(0) var<storage, read> volume: array<f32>;
@group(0) @binding(1) var<storage, read_write> rgb: array<f32>;
var<immediate> term: Term;

@compute @workgroup_size(256)
fn compose(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = folded(group, groups) * 256u + lane;
    if i >= term.count { return; }
    let value = volume[term.first + i];
    let weight = array(term.red, term.green, term.blue);
    for (var c = 0u; c < 3u; c++) {
        let held = select(0.0, rgb[3u * i + c], term.keep > 0.0);
        rgb[3u * i + c] = held + weight[c] * value;
    }
}
