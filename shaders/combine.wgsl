// Linear combinations, inner products and largest values of whole volumes.

struct Stretch {
    count: u32,
    // Weight of what `out` held, and of `a`.
    keep: f32,
    weight: f32,
}

@group(0) @binding(0) var<storage, read> a: array<f32>;
@group(0) @binding(1) var<storage, read> b: array<f32>;
// A volume, or one number for every workgroup.
@group(0) @binding(2) var<storage, read_write> out: array<f32>;
var<immediate> stretch: Stretch;

// a, out → out: keep·out + weight·a
@compute @workgroup_size(256)
fn accumulate(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = folded(group, groups) * 256u + lane;
    if i >= stretch.count { return; }
    let held = select(0.0, stretch.keep * out[i], stretch.keep != 0.0);
    out[i] = held + stretch.weight * a[i];
}

// Values that a workgroup reduces to one.
const CHUNK: u32 = 4096u;

var<workgroup> lanes: array<f32, 256>;

// a, b → out: Σ a·b of each chunk, pairwise within it; the host adds the chunks in double precision.
@compute @workgroup_size(256)
fn dot_chunks(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let chunk = folded(group, groups);
    let start = chunk * CHUNK;
    var sum = 0.0;
    for (var i = start + lane; i < min(start + CHUNK, stretch.count); i += 256u) { sum += a[i] * b[i]; }
    lanes[lane] = sum;
    workgroupBarrier();
    for (var half = 128u; half > 0u; half /= 2u) {
        if lane < half { lanes[lane] += lanes[lane + half]; }
        workgroupBarrier();
    }
    if lane == 0u && start < stretch.count { out[chunk] = lanes[0]; }
}

fn largest_of_chunk(chunk: u32, lane: u32, value: f32) {
    lanes[lane] = value;
    workgroupBarrier();
    for (var half = 128u; half > 0u; half /= 2u) {
        if lane < half { lanes[lane] = max(lanes[lane], lanes[lane + half]); }
        workgroupBarrier();
    }
    if lane == 0u && chunk * CHUNK < stretch.count { out[chunk] = lanes[0]; }
}

// a, b → out: largest |a − b| of each chunk
@compute @workgroup_size(256)
fn distance_chunks(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let chunk = folded(group, groups);
    let end = min((chunk + 1u) * CHUNK, stretch.count);
    var largest = 0.0;
    for (var i = chunk * CHUNK + lane; i < end; i += 256u) { largest = max(largest, abs(a[i] - b[i])); }
    largest_of_chunk(chunk, lane, largest);
}

// a, b → out: largest a/b of each chunk where b > 0
@compute @workgroup_size(256)
fn ratio_chunks(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let chunk = folded(group, groups);
    let end = min((chunk + 1u) * CHUNK, stretch.count);
    var largest = 0.0;
    for (var i = chunk * CHUNK + lane; i < end; i += 256u) {
        if b[i] > 0.0 { largest = max(largest, a[i] / b[i]); }
    }
    largest_of_chunk(chunk, lane, largest);
}
