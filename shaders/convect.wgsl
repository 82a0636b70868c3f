// Upwind convection (Zhang & Ma 2013, (16)–(20)): ρ' = (1 − σ_a)(ρ − ½Σ_a |d_a| (ρ − ρ_a)), ρ_a the upstream neighbour along
// axis a; its fixed point is ρ = T/s · Σ|d_a| ρ_a, T = (1 − σ_a)s/(s + σ_a(2 − s)), s = Σ|d_a|.
// sigma, before → rho, report (largest error, iterations, voxel updates; or largest change, as bits of non-negative f32)

struct Params {
    size: vec3<u32>,
    // 1: the opacity of a reference length; 0: calibrated.
    literal: u32,
    // Upstream of index i is i − 1 above the centre and i + 1 below it.
    centre: vec3<i32>,
    // Reference length, or h.
    length: f32,
    // |d| of parallel light.
    way: vec3<f32>,
    // 1: light from one place.
    central: u32,
    position: vec3<f32>,
    ball: f32,
    spacing: vec3<f32>,
    falloff: f32,
    // Strips: values along columns, rows and layers, and their distances in memory.
    extent: vec3<u32>,
    strip: u32,
    stride: vec3<u32>,
    start: u32,
    lanes: vec3<f32>,
    iterations: u32,
    forward: vec3<u32>,
    tolerance: f32,
    gain: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> sigma: array<f32>;
@group(0) @binding(2) var<storage, read> before: array<f32>;
@group(0) @binding(3) var<storage, read_write> rho: array<f32>;
// The other half of a strip's iteration; as large as rho.
@group(0) @binding(4) var<storage, read_write> other: array<f32>;
@group(0) @binding(5) var<storage, read_write> errors: array<f32>;
@group(0) @binding(6) var<storage, read_write> report: array<atomic<u32>, 4>;
// Bricks of ordered convection that are not the whole grid.
@group(0) @binding(7) var<storage, read> bricks: array<u32>;
@group(0) @binding(8) var<storage, read_write> changes: array<f32>;
// Number of the front; for bricks the first of them in the list.
var<immediate> front: u32;

fn gaussian(at: vec3<f32>) -> f32 {
    let x = (at - params.position) * params.spacing;
    return exp(-dot(x, x) * params.falloff);
}

fn entering(at: vec3<f32>) -> f32 {
    if params.central == 0u { return 1.0; }
    return gaussian(at);
}

fn way(p: vec3<u32>) -> vec3<f32> {
    if params.central == 0u { return params.way; }
    let o = vec3<f32>(p) - params.position;
    let x = o * params.spacing;
    return select(vec3(0.0), abs(x) / (length(x) * params.spacing), abs(o) > vec3(0.5));
}

// Voxels near a light inside the box are never updated.
fn is_fixed(p: vec3<u32>) -> bool {
    return params.central == 1u && length((vec3<f32>(p) - params.position) * params.spacing) < params.ball;
}

fn transmitted(s_given: f32, value: f32) -> f32 {
    let s = select(1.0, s_given, s_given > 0.0);
    if params.literal == 1u {
        let keep = exp(-params.length * value);
        return keep / (s + (1.0 - keep) * (2.0 - s));
    }
    return exp(-params.length * value / s) / s;
}

fn kept(s_given: f32, value: f32) -> f32 {
    if params.literal == 1u { return exp(-params.length * value); }
    let s = select(1.0, s_given, s_given > 0.0);
    let t = exp(-params.length * value / s);
    return 2.0 * t / (s + t * (2.0 - s));
}

// Upstream neighbour of p along an axis, and whether there is one in the grid.
struct Upstream {
    at: u32,
    inside: bool,
    face: vec3<f32>,
}

fn upstream(p: vec3<u32>, axis: u32) -> Upstream {
    var q = vec3<i32>(p);
    var face = vec3<f32>(p);
    let step = select(-1, 1, q[axis] < params.centre[axis]);
    q[axis] += step;
    face[axis] += 0.5 * f32(step);
    // The centre's own has no upstream: what would be read has no weight and may not be solved yet.
    let own = i32(p[axis]) == params.centre[axis];
    let inside = q[axis] >= 0 && q[axis] < i32(params.size[axis]) && !own;
    return Upstream(index(params.size, vec3<u32>(select(vec3<i32>(p), q, inside))), inside, face);
}

fn before_at(p: vec3<u32>, axis: u32) -> f32 {
    let u = upstream(p, axis);
    if u.inside { return before[u.at]; }
    return entering(u.face);
}

fn rho_at(p: vec3<u32>, axis: u32) -> f32 {
    let u = upstream(p, axis);
    if u.inside { return rho[u.at]; }
    return entering(u.face);
}

// One iteration of all voxels.
@compute @workgroup_size(8, 8)
fn whole(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id >= params.size) { return; }
    let here = index(params.size, id);
    let d = way(id);
    let s = d.x + d.y + d.z;
    let moved = d.x * before_at(id, 0u) + d.y * before_at(id, 1u) + d.z * before_at(id, 2u);
    var value = kept(s, sigma[here]) * ((1.0 - 0.5 * s) * before[here] + 0.5 * moved);
    if is_fixed(id) { value = gaussian(vec3<f32>(id)); }
    let change = abs(value - before[here]);
    rho[here] = value;
    if change > 0.0 { atomicMax(&report[0], bitcast<u32>(change)); }
}

fn solve(p: vec3<u32>) {
    let here = index(params.size, p);
    if is_fixed(p) {
        rho[here] = gaussian(vec3<f32>(p));
        return;
    }
    let d = way(p);
    let moved = d.x * rho_at(p, 0u) + d.y * rho_at(p, 1u) + d.z * rho_at(p, 2u);
    rho[here] = transmitted(d.x + d.y + d.z, sigma[here]) * moved;
}

// The voxels that lie `front` steps downstream of where light starts: one or two of each row.
@compute @workgroup_size(8, 8)
fn ordered(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id.xy >= params.size.yz) { return; }
    let start = clamp(params.centre, vec3(0), vec3<i32>(params.size) - 1);
    let left = i32(front) - abs(i32(id.x) - start.y) - abs(i32(id.y) - start.z);
    if left < 0 { return; }
    for (var side = -1; side <= select(-1, 1, left > 0); side += 2) {
        let i = start.x + side * left;
        if i >= 0 && i < i32(params.size.x) { solve(vec3(u32(i), id.xy)); }
    }
}

fn at_end(p: vec3<u32>, start: vec3<u32>, end: vec3<u32>) -> bool {
    let last = select(start, end - 1u, vec3<i32>(start) >= params.centre);
    return any(p == last);
}

// One workgroup per brick of a front: its parts on the sides of the light's planes, those above first, each in steps
// downstream of its first voxel.
@compute @workgroup_size(256)
fn brick_by_brick(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let number = bricks[front + group.x];
    let b = brick(params.size, params.strip, number);
    let cut = vec3<u32>(clamp(params.centre, vec3<i32>(b.start), vec3<i32>(b.end)));
    var change = 0.0;
    for (var part = 0u; part < 8u; part++) {
        let below = vec3(part & 1u, part / 2u & 1u, part / 4u) == vec3(1u);
        let start = select(cut, b.start, below);
        let end = select(b.end, cut, below);
        let extent = end - start;
        if any(extent == vec3(0u)) { continue; }
        for (var step = 0u; step < extent.x + extent.y + extent.z - 2u; step++) {
            for (var v = lane; v < extent.y * extent.z; v += LANES) {
                let q = vec2(v % extent.y, v / extent.y);
                if q.x + q.y > step || step - q.x - q.y >= extent.x { continue; }
                let l = vec3(step - q.x - q.y, q);
                let p = select(start + l, end - 1u - l, below);
                let here = index(params.size, p);
                let earlier = rho[here];
                solve(p);
                if at_end(p, start, end) { change = max(change, abs(rho[here] - earlier)); }
            }
            storageBarrier();
        }
    }
    let most = reduce(lane, change);
    if lane == 0u { changes[number] = most; }
}

const LANES: u32 = 256u;
var<workgroup> largest: array<f32, LANES>;
var<workgroup> decided: f32;

fn reduce(lane: u32, value: f32) -> f32 {
    workgroupBarrier();
    largest[lane] = value;
    workgroupBarrier();
    for (var half = LANES / 2u; half > 0u; half /= 2u) {
        if lane < half { largest[lane] = max(largest[lane], largest[lane + half]); }
        workgroupBarrier();
    }
    if lane == 0u { decided = largest[0]; }
    return workgroupUniformLoad(&decided);
}

// Index in memory of a column of the row and layer that light reaches as number `row` and `layer`.
fn place(column: u32, row: u32, layer: u32) -> u32 {
    let n = vec3(column, row, layer);
    let flipped = select(params.extent - 1u - n, n, params.forward == vec3(1u));
    let q = vec3(column, flipped.y, flipped.z) * params.stride;
    return q.x + q.y + q.z;
}

struct Strip {
    first: u32,
    rows: u32,
    layer: u32,
}

// Column beside, upstream; its index wraps round outside the grid.
fn beside(column: u32) -> u32 { return select(column + 1u, column - 1u, params.forward.x == 1u); }

fn guessed(strip: Strip, choice: u32, column: u32, row: u32) -> f32 {
    if choice == 3u { return 0.0; }
    let here = place(column, row, strip.layer);
    if choice == 1u { return before[here]; }
    var layer_before = 1.0;
    var then = 1.0;
    if strip.layer > 0u {
        let up = place(column, row, strip.layer - 1u);
        layer_before = rho[up];
        then = before[up];
    }
    if choice == 0u { return layer_before; }
    return clamp(before[here] + (layer_before - then), 0.0, 1.0);
}

// A value of the strip as its iteration has it, `flip` saying which of the two halves; the row upstream is done.
fn held(flip: bool, at: u32) -> f32 { return select(rho[at], other[at], flip); }

fn mixed(own: f32, side: f32, up: f32, ahead: f32, at: u32) -> f32 {
    let d = params.lanes;
    let s = d.x + d.y + d.z;
    return kept(s, sigma[at]) * ((1.0 - 0.5 * s) * own + 0.5 * d.x * side + (0.5 * d.y * up + 0.5 * d.z * ahead));
}

fn ahead_of(strip: Strip, column: u32, row: u32) -> f32 {
    if strip.layer == 0u { return 1.0; }
    return rho[place(column, row, strip.layer - 1u)];
}

// One workgroup per strip of a front: band + layer = front.
@compute @workgroup_size(256)
fn strips(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let columns = params.extent.x;
    let layers = params.extent.z;
    let bands = (params.extent.y + params.strip - 1u) / params.strip;
    let band = group.x;
    if band >= bands || front < band || front - band >= layers { return; }
    let first = band * params.strip;
    let strip = Strip(first, min(params.strip, params.extent.y - first), front - band);
    let count = strip.rows * columns;

    var choice = select(select(2u, 0u, params.start == 1u), 3u, params.start == 0u);
    var updates = 0u;
    if params.start == 2u {
        let row = first + strip.rows / 2u;
        var least = 1e38;
        for (var c = 0u; c < 3u; c++) {
            var change = 0.0;
            for (var i = lane; i < columns; i += LANES) {
                let own = guessed(strip, c, i, row);
                var side = 1.0;
                if beside(i) < columns { side = guessed(strip, c, beside(i), row); }
                var up = 1.0;
                if row > first { up = guessed(strip, c, i, row - 1u); }
                else if row > 0u { up = rho[place(i, row - 1u, strip.layer)]; }
                let value = mixed(own, side, up, ahead_of(strip, i, row), place(i, row, strip.layer));
                change = max(change, abs(value - own));
            }
            let residual = reduce(lane, change);
            if residual < least {
                least = residual;
                choice = c;
            }
            updates += columns;
        }
    }
    for (var v = lane; v < count; v += LANES) {
        let row = first + v / columns;
        rho[place(v % columns, row, strip.layer)] = guessed(strip, choice, v % columns, row);
    }
    storageBarrier();

    if lane == 0u {
        decided = 0.0;
        if band > 0u { decided = errors[strip.layer * bands + band - 1u]; }
        if strip.layer > 0u { decided = max(decided, errors[(strip.layer - 1u) * bands + band]); }
    }
    let upstream_error = workgroupUniformLoad(&decided);
    let share = params.tolerance * f32(strip.layer + band + 1u) / f32(layers + bands - 1u);
    var taken = 0u;
    var change = 1e38;
    var flip = false;
    while taken < params.iterations && (taken == 0u || upstream_error + params.gain * change > share) {
        var most = 0.0;
        for (var v = lane; v < count; v += LANES) {
            let i = v % columns;
            let row = first + v / columns;
            let here = place(i, row, strip.layer);
            let own = held(flip, here);
            var side = 1.0;
            if beside(i) < columns { side = held(flip, place(beside(i), row, strip.layer)); }
            var up = 1.0;
            if row > first { up = held(flip, place(i, row - 1u, strip.layer)); }
            else if row > 0u { up = rho[place(i, row - 1u, strip.layer)]; }
            let value = mixed(own, side, up, ahead_of(strip, i, row), here);
            most = max(most, abs(value - own));
            if flip { rho[here] = value; } else { other[here] = value; }
        }
        storageBarrier();
        change = reduce(lane, most);
        flip = !flip;
        taken++;
    }
    if flip {
        for (var v = lane; v < count; v += LANES) {
            let here = place(v % columns, first + v / columns, strip.layer);
            rho[here] = other[here];
        }
    }
    if lane == 0u {
        let error = upstream_error + params.gain * change;
        errors[strip.layer * bands + band] = error;
        atomicMax(&report[0], bitcast<u32>(error));
        atomicMax(&report[1], taken);
        // In units of a row, so that the count holds.
        atomicAdd(&report[2], (updates + taken * count) / columns);
    }
}
