// Mean of an optical property over the data voxels under each light voxel, after the transfer function; holes count as zero.
// field, gradient, table → out

struct Params {
    // Sizes of the data and of the light grid: both fill the same box.
    data: vec3<u32>,
    lo: f32,
    size: vec3<u32>,
    scale: f32,
    entries: u32,
    // First plane of the data that is held, and first and number of those of the light grid that are written.
    above: u32,
    first: u32,
    planes: u32,
    // Rows of a two-dimensional table, and rows per unit of gradient magnitude.
    rows: u32,
    steep: f32,
}

// Whether the table is two-dimensional.
override GRADED: bool = false;

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> field: array<f32>;
@group(0) @binding(2) var<storage, read> table: array<f32>;
@group(0) @binding(3) var<storage, read_write> out: array<f32>;
@group(0) @binding(4) var<storage, read> gradient: array<f32>;

fn along(row: u32, e: Entry) -> f32 {
    let first = row * params.entries;
    return mix(table[first + e.below], table[first + min(e.below + 1u, params.entries - 1u)], e.fraction);
}

// Of a value of the data.
fn optic(i: u32) -> f32 {
    let value = field[i];
    if value < HOLE { return 0.0; }
    let e = entry(value, params.lo, params.scale, params.entries);
    if !GRADED { return along(0u, e); }
    let at = clamp(gradient[i] * params.steep, 0.0, f32(params.rows - 1u));
    let row = min(u32(at), params.rows - 2u);
    let a = along(row, e);
    return a + (at - f32(row)) * (along(row + 1u, e) - a);
}

@compute @workgroup_size(8, 8)
fn classify(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id >= vec3(params.size.xy, params.planes)) { return; }
    let voxel = id + vec3(0u, 0u, params.first);
    let cover = covered(params.data, params.size, voxel);
    var sum = 0.0;
    for (var k = cover.start.z; k < cover.end.z; k++) {
        for (var j = cover.start.y; j < cover.end.y; j++) {
            for (var i = cover.start.x; i < cover.end.x; i++) {
                let p = vec3(i, j, k);
                sum += overlap(params.data, params.size, voxel, p) * optic(index(params.data, p - vec3(0u, 0u, params.above)));
            }
        }
    }
    out[index(params.size, id)] = sum;
}
