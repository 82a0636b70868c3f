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
    // Index along b, c or a of a plane whose ρ is given and stays; beyond the grid where there is none.
    given: vec3<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;

fn at(q: vec3<u32>) -> u32 {
    let p = q * params.stride;
    return p.x + p.y + p.z;
}

// The four values round a foot in the layer before: straight upstream, one over along b, along c, along both.
struct Foot {
    at: vec4<u32>,
    inside: vec4<bool>,
}

fn foot(q: vec3<u32>) -> Foot {
    let move_by = params.travel * vec3<i32>(params.stride);
    let straight = i32(at(q)) - move_by.z;
    // An index below 0 wraps round and is outside too.
    let beside = vec2<u32>(vec2<i32>(q.xy) - params.travel.xy) < params.size.xy;
    let inside = vec4(true, beside.x, beside.y, all(beside));
    let corners = vec4(straight, straight - move_by.x, straight - move_by.y, straight - move_by.x - move_by.y);
    return Foot(vec4<u32>(select(vec4(straight), corners, inside)), inside);
}

fn weights() -> vec4<f32> {
    let f = params.offset;
    return vec4((1.0 - f.x) * (1.0 - f.y), f.x * (1.0 - f.y), (1.0 - f.x) * f.y, f.x * f.y);
}

fn sigma_foot(f: Foot) -> f32 {
    let values = vec4(sigma[f.at.x], sigma[f.at.y], sigma[f.at.z], sigma[f.at.w]);
    return dot(weights(), select(vec4(0.0), values, f.inside));
}

fn rho_foot(f: Foot) -> f32 {
    let values = vec4(rho[f.at.x], rho[f.at.y], rho[f.at.z], rho[f.at.w]);
    return dot(weights(), select(vec4(1.0), values, f.inside));
}

fn catmull_rom(f: f32) -> vec4<f32> {
    let f2 = f * f;
    let f3 = f2 * f;
    return vec4(-0.5 * f + f2 - 0.5 * f3, 1.0 - 2.5 * f2 + 1.5 * f3, 0.5 * f + 2.0 * f2 - 1.5 * f3, 0.5 * (f3 - f2));
}

// Clamped to the four nearest values, so that a shadow neither overshoots nor rings.
fn rho_foot_cubic(q: vec3<u32>) -> f32 {
    let wb = catmull_rom(params.offset.x);
    let wc = catmull_rom(params.offset.y);
    var sum = 0.0;
    var low = 1e30;
    var high = -1e30;
    for (var j = 0; j < 4; j++) {
        for (var i = 0; i < 4; i++) {
            let p = vec3<u32>(vec3<i32>(q) - vec3(i - 1, j - 1, 1) * params.travel);
            let inside = all(p.xy < params.size.xy);
            let v = select(1.0, rho[select(0u, at(p), inside)], inside);
            sum += wb[i] * wc[j] * v;
            if (i == 1 || i == 2) && (j == 1 || j == 2) {
                low = min(low, v);
                high = max(high, v);
            }
        }
    }
    return clamp(sum, low, high);
}

fn entering(q: vec3<u32>) -> bool {
    return u32(i32(q.z) - params.travel.z) >= params.size.z;
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
                if any(p == params.given) { continue; }
                let here = at(p);
                var value: f32;
                if entering(p) {
                    value = exp(-0.5 * params.length * sigma[here]);
                } else {
                    let f = foot(p);
                    value = rho_foot(f) * exp(-0.5 * params.length * (sigma_foot(f) + sigma[here]));
                }
                if any(p == last) { change = max(change, abs(value - rho[here])); }
                rho[here] = value;
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
    let p = vec3(id.xy, front.first);
    let here = at(p);
    var value: f32;
    if entering(p) {
        value = exp(-0.5 * params.length * sigma[here]);
    } else {
        value = rho_foot_cubic(p) * exp(-0.5 * params.length * (sigma_foot(foot(p)) + sigma[here]));
    }
    rho[here] = value;
}
