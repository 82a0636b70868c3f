// Direct light by short characteristics: ρ = ρ_foot · exp(−½(σ_foot + σ)·length); ρ = 1 and σ = 0 outside the grid; the
// first layer lies half a step inside it.
// sigma, rho of the layer before → rho, changes (largest |new − old| per brick, as the bits of a non-negative f32)
//
// Coordinates are (b, c, a): two lateral axes, then the dominant one.

struct Params {
    // Values along b, c, a, and the distance in memory between neighbours.
    size: vec3<u32>,
    edge: u32,
    stride: vec3<u32>,
    length: f32,
    // Bricks along b, c, a, and the difference of neighbours' numbers.
    counts: vec3<u32>,
    brick_stride: vec3<u32>,
    // +1 or −1: the way the light travels.
    travel: vec3<i32>,
    // |u_b|/|u_a|, |u_c|/|u_a|: how far upstream the foot lies, in 0..1.
    offset: vec2<f32>,
}

// A front: `count` numbers in `bricks` from `first` on. For the cubic kernel `first` is the layer.
struct Dispatch {
    first: u32,
    count: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> sigma: array<f32>;
@group(0) @binding(2) var<storage, read_write> rho: array<f32>;
@group(0) @binding(3) var<storage, read> bricks: array<u32>;
@group(0) @binding(4) var<storage, read_write> changes: array<atomic<u32>>;
var<immediate> front: Dispatch;

fn inside(q: vec3<i32>) -> bool {
    return all(q.xy >= vec2(0)) && all(q.xy < vec2<i32>(params.size.xy));
}

fn at(q: vec3<i32>) -> u32 {
    let p = vec3<u32>(q) * params.stride;
    return p.x + p.y + p.z;
}

fn sigma_at(q: vec3<i32>) -> f32 {
    if inside(q) { return sigma[at(q)]; }
    return 0.0;
}

fn rho_at(q: vec3<i32>) -> f32 {
    if inside(q) { return rho[at(q)]; }
    return 1.0;
}

fn bilinear(v00: f32, v10: f32, v01: f32, v11: f32) -> f32 {
    let f = params.offset;
    return (1.0 - f.y) * ((1.0 - f.x) * v00 + f.x * v10) + f.y * ((1.0 - f.x) * v01 + f.x * v11);
}

fn sigma_foot(q: vec3<i32>) -> f32 {
    let b = vec3(params.travel.x, 0, params.travel.z);
    let c = vec3(0, params.travel.y, 0);
    let up = vec3(0, 0, params.travel.z);
    return bilinear(sigma_at(q - up), sigma_at(q - b), sigma_at(q - up - c), sigma_at(q - b - c));
}

fn rho_foot(q: vec3<i32>) -> f32 {
    let b = vec3(params.travel.x, 0, params.travel.z);
    let c = vec3(0, params.travel.y, 0);
    let up = vec3(0, 0, params.travel.z);
    return bilinear(rho_at(q - up), rho_at(q - b), rho_at(q - up - c), rho_at(q - b - c));
}

fn catmull_rom(f: f32) -> vec4<f32> {
    let f2 = f * f;
    let f3 = f2 * f;
    return vec4(-0.5 * f + f2 - 0.5 * f3, 1.0 - 2.5 * f2 + 1.5 * f3, 0.5 * f + 2.0 * f2 - 1.5 * f3, 0.5 * (f3 - f2));
}

// Clamped to the four nearest values, so that a shadow neither overshoots nor rings.
fn rho_foot_cubic(q: vec3<i32>) -> f32 {
    let wb = catmull_rom(params.offset.x);
    let wc = catmull_rom(params.offset.y);
    var sum = 0.0;
    var low = 1e30;
    var high = -1e30;
    for (var j = 0; j < 4; j++) {
        for (var i = 0; i < 4; i++) {
            let v = rho_at(q - vec3((i - 1) * params.travel.x, (j - 1) * params.travel.y, params.travel.z));
            sum += wb[i] * wc[j] * v;
            if (i == 1 || i == 2) && (j == 1 || j == 2) {
                low = min(low, v);
                high = max(high, v);
            }
        }
    }
    return clamp(sum, low, high);
}

fn entering(q: vec3<i32>) -> bool {
    let up = q.z - params.travel.z;
    return up < 0 || up >= i32(params.size.z);
}

var<workgroup> largest: atomic<u32>;

// One workgroup per brick of a front. Layers run in order; feet in other bricks were written by earlier fronts.
@compute @workgroup_size(16, 16)
fn brick_by_brick(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_id) thread: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let n = folded(group, groups);
    if n >= front.count { return; }
    let number = bricks[front.first + n];
    let start = number / params.brick_stride % params.counts * params.edge;
    let extent = min(vec3(params.edge), params.size - start);
    let last = select(start, start + extent - 1u, params.travel > vec3(0));

    var change = 0.0;
    for (var l = 0u; l < extent.z; l++) {
        let a = select(start.z + extent.z - 1u - l, start.z + l, params.travel.z > 0);
        for (var j = thread.y; j < extent.y; j += 16u) {
            for (var i = thread.x; i < extent.x; i += 16u) {
                let p = vec3(start.x + i, start.y + j, a);
                let q = vec3<i32>(p);
                var value: f32;
                if entering(q) {
                    value = exp(-0.5 * params.length * sigma_at(q));
                } else {
                    value = rho_foot(q) * exp(-0.5 * params.length * (sigma_foot(q) + sigma_at(q)));
                }
                if any(p == last) { change = max(change, abs(value - rho_at(q))); }
                rho[at(q)] = value;
            }
        }
        storageBarrier();
    }

    if change > 0.0 { atomicMax(&largest, bitcast<u32>(change)); }
    workgroupBarrier();
    if lane == 0u { atomicStore(&changes[number], atomicLoad(&largest)); }
}

// One invocation per value of a layer: a cubic foot reaches downstream bricks, so whole layers run in order.
@compute @workgroup_size(16, 16)
fn layer_by_layer(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id.xy >= params.size.xy) { return; }
    let q = vec3(vec2<i32>(id.xy), i32(front.first));
    var value: f32;
    if entering(q) {
        value = exp(-0.5 * params.length * sigma_at(q));
    } else {
        value = rho_foot_cubic(q) * exp(-0.5 * params.length * (sigma_foot(q) + sigma_at(q)));
    }
    let change = abs(value - rho_at(q));
    rho[at(q)] = value;
    if change > 0.0 {
        let coords = vec3<u32>(q) / params.edge * params.brick_stride;
        atomicMax(&changes[coords.x + coords.y + coords.z], bitcast<u32>(change));
    }
}
