// One pass of transport along ordinates by step characteristics: I_out = I_in + A(S − I_in), A = 1 − e^−τ, τ = σ·length; the mean
// over the voxel, Ī = I_in + B(S − I_in), B = 1 − A/τ, is accumulated into φ = Σ w Ī and J = Σ w Ω Ī. I_in is what left the
// layer before, bilinear at the foot; outside the grid it is the inflow.
//
// Ordinates that share dominant axis and sign run together, one layer a dispatch; coordinates are (b, c, a) as in sweep.wgsl.

struct Params {
    size: vec3<u32>,
    // Ordinates of this group.
    count: u32,
    stride: vec3<u32>,
    // Total number of values, for `settle`.
    values: u32,
    // +1 or −1 along the dominant axis.
    travel: i32,
    // Values of a plane across z, the plane whose radiance is given and the one whose radiance is carried on; none: 2³² − 1.
    plane: u32,
    given: u32,
    carried: u32,
}

struct Ordinate {
    direction: vec3<f32>,
    weight: f32,
    // Where the foot lies in the layer before, −u_b/|u_a| and −u_c/|u_a|, in −1..1.
    foot: vec2<f32>,
    // World length between layers.
    length: f32,
    inflow: f32,
}

// Layers count from the side where the light enters.
struct Layer {
    number: u32,
}

// Whether S has a part linear in Ω, and whether J is wanted.
override LINEAR: bool = true;
override CURRENT: bool = true;
// Ordinates that a workgroup takes at once, at most 8.
override ABREAST: u32 = 8u;

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> ordinates: array<Ordinate>;
@group(0) @binding(2) var<storage, read> sigma: array<f32>;
@group(0) @binding(3) var<storage, read> source: array<f32>;
@group(0) @binding(4) var<storage, read> gradient_x: array<f32>;
@group(0) @binding(5) var<storage, read> gradient_y: array<f32>;
@group(0) @binding(6) var<storage, read> gradient_z: array<f32>;
// Radiance of two layers in turn, each (ordinate, c, b); then that of the plane that is given and of the one that is carried
// on, each (ordinate, y, x).
@group(0) @binding(7) var<storage, read_write> radiance: array<f32>;
@group(0) @binding(8) var<storage, read_write> sum: array<f32>;
@group(0) @binding(9) var<storage, read_write> current_x: array<f32>;
@group(0) @binding(10) var<storage, read_write> current_y: array<f32>;
@group(0) @binding(11) var<storage, read_write> current_z: array<f32>;
@group(0) @binding(12) var<storage, read_write> phi: array<f32>;
// Largest change of φ and largest φ, as the bits of non-negative f32.
@group(0) @binding(13) var<storage, read_write> extremes: array<atomic<u32>, 2>;
var<immediate> layer: Layer;

fn at(q: vec3<u32>) -> u32 {
    let p = q * params.stride;
    return p.x + p.y + p.z;
}

fn source_at(i: u32, direction: vec3<f32>) -> f32 {
    if !LINEAR { return source[i]; }
    return max(0.0, source[i] + dot(direction, vec3(gradient_x[i], gradient_y[i], gradient_z[i])));
}

fn radiance_index(parity: u32, ordinate: u32, q: vec2<u32>) -> u32 {
    return ((parity * params.count + ordinate) * params.size.y + q.y) * params.size.x + q.x;
}

// A and B; the latter by its series where the difference would cancel.
fn characteristic(tau: f32) -> vec2<f32> {
    if tau < 0.125 {
        let b = tau * (0.5 - tau * (1.0 / 6.0 - tau * (1.0 / 24.0 - tau * (1.0 / 120.0 - tau / 720.0))));
        return vec2(tau * (1.0 - b), b);
    }
    let absorbed = 1.0 - exp(-tau);
    return vec2(absorbed, 1.0 - absorbed / tau);
}

// (φ, J) of up to eight ordinates for each of 32 values. They are summed in the order of the ordinates, so that a pass
// repeats to the bit.
var<workgroup> partial: array<vec4<f32>, 256>;

// ordinates, sigma, source, gradient, radiance that leaves the layer before → radiance, sum, current
@compute @workgroup_size(16, 2, ABREAST)
fn step_layer(@builtin(global_invocation_id) id: vec3<u32>, @builtin(local_invocation_id) thread: vec3<u32>) {
    let q = id.xy;
    let here = all(q < params.size.xy);
    let a = select(params.size.z - 1u - layer.number, layer.number, params.travel > 0);
    let lane = thread.y * 16u + thread.x;
    let before = (layer.number + 1u) & 1u;
    var own = vec4(0.0);
    if here {
        let p = at(vec3(q, a));
        let faces = 2u * params.count * params.size.x * params.size.y;
        for (var d = thread.z; d < params.count; d += ABREAST) {
            let o = ordinates[d];
            if p / params.plane == params.given {
                // The slab before has summed this plane.
                radiance[radiance_index(layer.number & 1u, d, q)] = radiance[faces + d * params.plane + p % params.plane];
                continue;
            }
            var entering = o.inflow;
            if layer.number > 0u {
                // Straight upstream, one over along b, along c, along both. An index below 0 wraps round and is outside too.
                let toward = select(vec2(-1), vec2(1), o.foot >= vec2(0.0));
                let beside = vec2<u32>(vec2<i32>(q) + toward);
                let on_grid = beside < params.size.xy;
                let v = select(q, beside, on_grid);
                let inside = vec4(true, on_grid.x, on_grid.y, all(on_grid));
                let f = abs(o.foot);
                let weights = vec4((1.0 - f.x) * (1.0 - f.y), f.x * (1.0 - f.y), (1.0 - f.x) * f.y, f.x * f.y);
                let i = vec4(radiance_index(before, d, q), radiance_index(before, d, vec2(v.x, q.y)),
                    radiance_index(before, d, vec2(q.x, v.y)), radiance_index(before, d, v));
                let radiances = vec4(radiance[i.x], radiance[i.y], radiance[i.z], radiance[i.w]);
                entering = dot(weights, select(vec4(o.inflow), radiances, inside));
            }
            let step = characteristic(sigma[p] * o.length);
            let gain = source_at(p, o.direction) - entering;
            let leaving = entering + step.x * gain;
            radiance[radiance_index(layer.number & 1u, d, q)] = leaving;
            if p / params.plane == params.carried {
                radiance[faces + (params.count + d) * params.plane + p % params.plane] = leaving;
            }
            own += o.weight * (entering + step.y * gain) * vec4(1.0, o.direction);
        }
    }
    partial[thread.z * 32u + lane] = own;
    workgroupBarrier();
    if here && thread.z == 0u {
        var total = partial[lane];
        for (var z = 1u; z < ABREAST; z++) { total += partial[z * 32u + lane]; }
        let p = at(vec3(q, a));
        sum[p] += total.x;
        if CURRENT {
            current_x[p] += total.y;
            current_y[p] += total.z;
            current_z[p] += total.w;
        }
    }
}

var<workgroup> largest: array<atomic<u32>, 2>;

// sum, phi → phi, extremes
@compute @workgroup_size(256)
fn settle(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = folded(group, groups) * 256u + lane;
    if i < params.values {
        let value = sum[i];
        atomicMax(&largest[0], bitcast<u32>(abs(value - phi[i])));
        atomicMax(&largest[1], bitcast<u32>(max(value, 0.0)));
        phi[i] = value;
    }
    workgroupBarrier();
    if lane < 2u { atomicMax(&extremes[lane], atomicLoad(&largest[lane])); }
}
