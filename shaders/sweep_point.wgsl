// Direct light from a point by short characteristics: ρ = ρ_foot · exp(−σ_foot·(½Δs − δ) − σ·½Δs), Δs = r/|q_a|, r = |x − P|, q
// the offset from the light in voxels, a its longest axis; the foot lies one layer nearer along a, on the ray from the
// light, f = |q_b|/|q_a| aside. δ = ½ Σ_b f(1 − f)·Δx_b²·(1 − (q_b Δx_b/r)²)/r_foot is how much farther the four voxels round
// it are, in the mean. Outside the grid ρ = 1 and σ = 0. Within two voxels of the light: the integral of trilinear σ along
// the ray.
// sigma, rho of earlier fronts → rho, changes (largest |new − old| per brick, as the bits of a non-negative f32)
//
// Where the plane of the light runs between two bricks, the columns beside it need each other in the layer before. Each brick
// solves the other's column too, its ghost, into `ghost`.

struct Params {
    size: vec3<i32>,
    edge: i32,
    // First index at or beyond the light along each axis, and how far beyond.
    cell: vec3<i32>,
    fraction: vec3<f32>,
    spacing: vec3<f32>,
    // Bricks along x, y, z.
    counts: vec3<u32>,
    // The first plane across z that is held.
    plane: i32,
}

@group(0) @binding(0) var<uniform> params: Params;
// Three planes of (edge + 2)² values for each brick of a front.
@group(0) @binding(5) var<storage, read_write> ghost: array<f32>;

// The brick in hand: its first index and the one past its last, the same with ghosts, and the ghost's index along each axis
// (−2 where there is none).
var<private> start: vec3<i32>;
var<private> end: vec3<i32>;
var<private> solve_start: vec3<i32>;
var<private> solve_end: vec3<i32>;
var<private> ghost_at: vec3<i32>;
var<private> ghost_first: i32;

fn at(p: vec3<i32>) -> u32 {
    return u32(((p.z - params.plane) * params.size.y + p.y) * params.size.x + p.x);
}

fn inside(p: vec3<i32>) -> bool {
    return all(p >= vec3(0)) && all(p < params.size);
}

fn beyond(p: vec3<i32>) -> vec3<bool> {
    return p >= params.cell;
}

// Offset from the light in voxels.
fn offset(p: vec3<i32>) -> vec3<f32> {
    let over = vec3<f32>(p - params.cell) + params.fraction;
    let under = -(vec3<f32>(params.cell - 1 - p) + (1.0 - params.fraction));
    return select(under, over, beyond(p));
}

// Whole voxels between the light and a voxel.
fn layer(p: vec3<i32>) -> vec3<i32> {
    let low = params.cell - select(vec3(0), vec3(1), params.fraction > vec3(0.0));
    return select(low - p, p - params.cell, beyond(p));
}

// Index of a voxel in `ghost`, −1 where it is none.
fn ghost_index(p: vec3<i32>) -> i32 {
    if any(p < solve_start) || any(p >= solve_end) { return -1; }
    let q = p - start + 1;
    let pitch = params.edge + 2;
    if p.x == ghost_at.x { return ghost_first + q.z * pitch + q.y; }
    if p.y == ghost_at.y { return ghost_first + (pitch + q.z) * pitch + q.x; }
    if p.z == ghost_at.z { return ghost_first + (2 * pitch + q.y) * pitch + q.x; }
    return -1;
}

fn rho_at(p: vec3<i32>) -> f32 {
    if !inside(p) { return 1.0; }
    let g = ghost_index(p);
    if g >= 0 { return ghost[g]; }
    return rho[at(p)];
}

fn sigma_at(p: vec3<i32>) -> f32 {
    return select(0.0, sigma[at(clamp(p, vec3(0), params.size - 1))], inside(p));
}

// σ at a place `t` of the way from the light to voxel p, trilinear, clamped in the rim.
fn sigma_along(p: vec3<i32>, d: vec3<f32>, t: f32) -> f32 {
    let x = clamp(vec3<f32>(p) - (1.0 - t) * d, vec3(0.0), vec3<f32>(params.size - 1));
    let first = min(vec3<i32>(x), max(params.size - 2, vec3(0)));
    let f = x - vec3<f32>(first);
    var sum = 0.0;
    for (var corner = 0; corner < 8; corner++) {
        let upper = (vec3(corner) >> vec3(0u, 1u, 2u) & vec3(1)) == vec3(1);
        let w = select(1.0 - f, f, upper);
        let i = min(first + select(vec3(0), vec3(1), upper), params.size - 1);
        sum += w.x * w.y * w.z * sigma[at(i)];
    }
    return sum;
}

// Optical depth from the light to a voxel beside it: Simpson's rule between the planes of voxels that the ray passes.
fn integral(p: vec3<i32>) -> f32 {
    let d = offset(p);
    let q = abs(d);
    let wall = vec3<f32>(select(params.size - 1 - p, p, d > vec3(0.0))) + 0.5;
    let entries = select(vec3(0.0), 1.0 - wall / max(q, vec3(1e-20)), q > wall);
    let enter = max(entries.x, max(entries.y, entries.z));
    let planes = select(vec3(1.0), max(1.0 - 1.0 / max(q, vec3(1e-20)), vec3(enter)), q > vec3(1.0));
    let low = min(planes.x, min(planes.y, planes.z));
    let high = max(planes.x, max(planes.y, planes.z));
    let middle = max(min(planes.x, planes.y), min(max(planes.x, planes.y), planes.z));
    var depth = 0.0;
    var begin = enter;
    for (var i = 0; i < 4; i++) {
        let stop = vec4(low, middle, high, 1.0)[i];
        if stop > begin {
            depth += (stop - begin) / 6.0 * (sigma_along(p, d, begin)
                + 4.0 * sigma_along(p, d, 0.5 * (begin + stop)) + sigma_along(p, d, stop));
            begin = stop;
        }
    }
    return depth * length(d * params.spacing);
}

fn solved(p: vec3<i32>) -> f32 {
    if all(layer(p) <= vec3(1)) { return exp(-integral(p)); }
    let d = offset(p);
    let q = abs(d);
    let toward = select(vec3(1), vec3(-1), beyond(p));
    // (b, c, a): a is the longest axis, the lower one where two are equal.
    var axes = vec3(0, 1, 2);
    if q.x >= q.y && q.x >= q.z { axes = vec3(1, 2, 0); } else if q.y >= q.z { axes = vec3(0, 2, 1); }
    let inverse = 1.0 / q[axes.z];
    // Beyond the light the medium goes on as it is, where the grid ends there.
    let beside = p + toward;
    let moves = (layer(p) > vec3(0)) | ((beside >= vec3(0)) & (beside < params.size));
    let lateral = min(select(vec3(0.0), q, moves) * inverse, vec3(1.0));
    let f = vec2(lateral[axes.x], lateral[axes.y]);
    let w = vec4((1.0 - f.x) * (1.0 - f.y), f.x * (1.0 - f.y), (1.0 - f.x) * f.y, f.x * f.y);
    var straight = p;
    straight[axes.z] += toward[axes.z];
    var b = straight;
    if f.x > 0.0 { b[axes.x] += toward[axes.x]; }
    var c = straight;
    if f.y > 0.0 { c[axes.y] += toward[axes.y]; }
    let both = b + c - straight;
    let rho_foot = dot(w, vec4(rho_at(straight), rho_at(b), rho_at(c), rho_at(both)));
    let sigma_foot = dot(w, vec4(sigma_at(straight), sigma_at(b), sigma_at(c), sigma_at(both)));
    let way = d * params.spacing;
    let along = dot(way, way);
    let r = sqrt(along);
    let half_step = 0.5 * r * inverse;
    let bends = params.spacing * params.spacing * (along - way * way);
    let bend = f.x * (1.0 - f.x) * bends[axes.x] + f.y * (1.0 - f.y) * bends[axes.y];
    let at_foot = max(half_step - 0.5 * bend / (along * r * (1.0 - inverse)), 0.0);
    return rho_foot * exp(-(at_foot * sigma_foot + half_step * sigma[at(p)]));
}

var<workgroup> largest: atomic<u32>;

fn settle(p: vec3<i32>) -> f32 {
    if any(p < solve_start) || any(p >= solve_end) { return 0.0; }
    let value = solved(p);
    let g = ghost_index(p);
    if g >= 0 {
        ghost[g] = value;
        return 0.0;
    }
    let here = at(p);
    let old = rho[here];
    rho[here] = value;
    // Light leaves a brick through a face unless the light is beyond it.
    let leaves = ((p == start) & (start <= params.cell)) | ((p + 1 == end) & (end > params.cell));
    return select(0.0, abs(value - old), any(leaves));
}

// One workgroup per brick of a front. A voxel needs only voxels whose layers add up to less, so these sums run in order.
@compute @workgroup_size(256)
fn sweep_point(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let n = folded(group, groups);
    if n >= front.count { return; }
    let number = bricks[front.first + n];
    let counts = params.counts;
    start = vec3<i32>(vec3(number % counts.x, number / counts.x % counts.y, number / (counts.x * counts.y))) * params.edge;
    end = min(start + params.edge, params.size);
    let pair = params.fraction > vec3(0.0);
    let ghost_low = pair & (start == params.cell) & (start > vec3(0));
    let ghost_high = pair & (end == params.cell) & (end < params.size);
    solve_start = start - select(vec3(0), vec3(1), ghost_low);
    solve_end = end + select(vec3(0), vec3(1), ghost_high);
    ghost_at = select(select(vec3(-2), end, ghost_high), start - 1, ghost_low);
    let pitch = params.edge + 2;
    ghost_first = i32(n) * 3 * pitch * pitch;

    // Layers of the solved voxels along each axis.
    let first = layer(solve_start);
    let last = layer(solve_end - 1);
    let low = params.cell - select(vec3(0), vec3(1), pair);
    let across = (solve_start <= params.cell) & (solve_end > low);
    let least = select(min(first, last), vec3(0), across);
    let most = max(first, last);

    let extent = solve_end - solve_start;
    let rows = extent.y * extent.z;
    var change = 0.0;
    for (var sum = least.x + least.y + least.z; sum <= most.x + most.y + most.z; sum++) {
        for (var i = i32(lane); i < rows; i += 256) {
            let row = solve_start + vec3(0, i % extent.y, i / extent.y);
            let k = layer(row);
            let x = sum - k.y - k.z;
            if x < 0 { continue; }
            change = max(change, settle(vec3(params.cell.x + x, row.yz)));
            // On a plane of voxels layer 0 is one column.
            if x > 0 || pair.x { change = max(change, settle(vec3(low.x - x, row.yz))); }
        }
        storageBarrier();
    }

    if change > 0.0 { atomicMax(&largest, bitcast<u32>(change)); }
    workgroupBarrier();
    if lane == 0u { atomicStore(&changes[number], atomicLoad(&largest)); }
}
