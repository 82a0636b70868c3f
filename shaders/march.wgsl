// Ray casting through data lit by light volumes: L = ∫ T σ_t [ω max(0, Σ weight·value) + j/σ_t] ds. A ray is cut into
// intervals of `step` from where it enters the box, sampled in the middle of each; α = 1 − e^(−σ_t ds).
// field, gradient, table, sums, majorant, terms, light0…7, clips, rays → rays
//
// Each term has a light buffer of its own, except that the eighth and all further ones share the last.
//
// Positions are in values of the data grid: value (i, j, k) sits at (i, j, k), the box reaches half a value beyond.

struct Params {
    size: vec3<u32>,
    step: f32,
    eye: vec3<f32>,
    // Edge of a brick.
    edge: u32,
    forward: vec3<f32>,
    // First value and inverse range of the table.
    lo: f32,
    // Already times tan of half the field of view (and aspect): a picture reaches from −1 to 1.
    right: vec3<f32>,
    scale: f32,
    up: vec3<f32>,
    entries: u32,
    // Rows of a two-dimensional table, and rows per unit of gradient magnitude.
    rows: u32,
    steep: f32,
    per_world: vec3<f32>,
    // Mean spacing.
    spacing: f32,
    towards_light: vec3<f32>,
    ambient: f32,
    diffuse: f32,
    specular: f32,
    shininess: f32,
    // Factor on extinction per channel.
    chromatic: vec3<f32>,
    picture: vec2<u32>,
    // First and last plane of the data that is held.
    held: vec2<u32>,
    clips: u32,
    // Samples are taken whose lower neighbours along z are in these planes, the second excluded.
    cells: vec2<u32>,
}

// Number of terms; whether `majorant` is there; whether to shade; whether anything glows.
override TERMS: u32 = 8u;
override SKIP: bool = true;
override SHADE: bool = true;
override GLOW: bool = true;
// Whether any term is a lamp.
override LAMPS: bool = true;
// Whether channels dim differently.
override CHROMATIC: bool = true;

const UNIFORM: u32 = 0u;
const PHASE: u32 = 1u;
const CURRENT: u32 = 2u;
const LAMP: u32 = 3u;

struct Term {
    size: vec3<u32>,
    // First value in its light buffer.
    first: u32,
    weight: vec3<f32>,
    kind: u32,
    // Of a lamp: its cone's axis.
    direction: vec3<f32>,
    g: f32,
    // First and last plane that is held.
    held: vec2<u32>,
    // Of a lamp: where it is, and its falloff, see lamp.wgsl.
    position: vec3<f32>,
    floor: f32,
    outer: f32,
    slope: f32,
    cosine: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> field: array<f32>;
@group(0) @binding(2) var<storage, read> table: array<Optics>;
@group(0) @binding(3) var<storage, read> majorant: array<f32>;
@group(0) @binding(4) var<storage, read> terms: array<Term>;
@group(0) @binding(5) var<storage, read> light0: array<f32>;
@group(0) @binding(6) var<storage, read> light1: array<f32>;
@group(0) @binding(7) var<storage, read> light2: array<f32>;
@group(0) @binding(8) var<storage, read> light3: array<f32>;
@group(0) @binding(9) var<storage, read> light4: array<f32>;
@group(0) @binding(10) var<storage, read> light5: array<f32>;
@group(0) @binding(11) var<storage, read> light6: array<f32>;
@group(0) @binding(12) var<storage, read> light7: array<f32>;
// For each pixel radiance, transmittance, number of the next sample, and world length to where it ends.
@group(0) @binding(13) var<storage, read_write> rays: array<f32>;
@group(0) @binding(14) var<storage, read> gradient: array<f32>;
@group(0) @binding(15) var<storage, read> sums: array<Sums>;

@group(0) @binding(16) var<storage, read> clips: array<Clip>;

const MAX_TERMS: u32 = 32u;
// Transmittance below which a ray ends.
const OPAQUE: f32 = 1e-4;

fn light0_at(c: Cell) -> f32 {
    let a = c.low;
    let b = c.high;
    return dot(vec4(light0[a.x], light0[a.y], light0[a.z], light0[a.w]), c.low_weight)
        + dot(vec4(light0[b.x], light0[b.y], light0[b.z], light0[b.w]), c.high_weight);
}

fn light1_at(c: Cell) -> f32 {
    let a = c.low;
    let b = c.high;
    return dot(vec4(light1[a.x], light1[a.y], light1[a.z], light1[a.w]), c.low_weight)
        + dot(vec4(light1[b.x], light1[b.y], light1[b.z], light1[b.w]), c.high_weight);
}

fn light2_at(c: Cell) -> f32 {
    let a = c.low;
    let b = c.high;
    return dot(vec4(light2[a.x], light2[a.y], light2[a.z], light2[a.w]), c.low_weight)
        + dot(vec4(light2[b.x], light2[b.y], light2[b.z], light2[b.w]), c.high_weight);
}

fn light3_at(c: Cell) -> f32 {
    let a = c.low;
    let b = c.high;
    return dot(vec4(light3[a.x], light3[a.y], light3[a.z], light3[a.w]), c.low_weight)
        + dot(vec4(light3[b.x], light3[b.y], light3[b.z], light3[b.w]), c.high_weight);
}

fn light4_at(c: Cell) -> f32 {
    let a = c.low;
    let b = c.high;
    return dot(vec4(light4[a.x], light4[a.y], light4[a.z], light4[a.w]), c.low_weight)
        + dot(vec4(light4[b.x], light4[b.y], light4[b.z], light4[b.w]), c.high_weight);
}

fn light5_at(c: Cell) -> f32 {
    let a = c.low;
    let b = c.high;
    return dot(vec4(light5[a.x], light5[a.y], light5[a.z], light5[a.w]), c.low_weight)
        + dot(vec4(light5[b.x], light5[b.y], light5[b.z], light5[b.w]), c.high_weight);
}

fn light6_at(c: Cell) -> f32 {
    let a = c.low;
    let b = c.high;
    return dot(vec4(light6[a.x], light6[a.y], light6[a.z], light6[a.w]), c.low_weight)
        + dot(vec4(light6[b.x], light6[b.y], light6[b.z], light6[b.w]), c.high_weight);
}

fn light7_at(c: Cell) -> f32 {
    let a = c.low;
    let b = c.high;
    return dot(vec4(light7[a.x], light7[a.y], light7[a.z], light7[a.w]), c.low_weight)
        + dot(vec4(light7[b.x], light7[b.y], light7[b.z], light7[b.w]), c.high_weight);
}

var<private> weights: array<vec3<f32>, MAX_TERMS>;

// What one unit of a term's value contributes at a position.
fn weight_at(t: u32, x: vec3<f32>) -> vec3<f32> {
    if !LAMPS || terms[t].kind != LAMP { return weights[t]; }
    let lamp = terms[t];
    let d = (x - lamp.position) / params.per_world;
    let cosine = dot(d, to_eye) / sqrt(max(dot(d, d), 1e-30));
    return lamp.weight * (falloff(d, lamp.direction, lamp.floor, lamp.outer, lamp.slope, lamp.cosine) * phase(lamp.g, cosine));
}

// The cell of a term at a position on the data grid; that of the term before where both have the same grid.
fn term_cell(t: u32, x: vec3<f32>, before: Cell) -> Cell {
    let size = terms[t].size;
    let held = terms[t].held;
    if t > 0u && all(size == terms[t - 1u].size) && all(held == terms[t - 1u].held) { return before; }
    return cell(size, held, (x + 0.5) * vec3<f32>(size) / vec3<f32>(params.size) - 0.5);
}

// Σ weight·value of all terms, at least 0.
fn in_scatter(x: vec3<f32>) -> vec3<f32> {
    var sum = vec3(0.0);
    var c: Cell;
    if TERMS > 0u {
        c = term_cell(0u, x, c);
        sum += weight_at(0u, x) * light0_at(c);
    }
    if TERMS > 1u {
        c = term_cell(1u, x, c);
        sum += weight_at(1u, x) * light1_at(c);
    }
    if TERMS > 2u {
        c = term_cell(2u, x, c);
        sum += weight_at(2u, x) * light2_at(c);
    }
    if TERMS > 3u {
        c = term_cell(3u, x, c);
        sum += weight_at(3u, x) * light3_at(c);
    }
    if TERMS > 4u {
        c = term_cell(4u, x, c);
        sum += weight_at(4u, x) * light4_at(c);
    }
    if TERMS > 5u {
        c = term_cell(5u, x, c);
        sum += weight_at(5u, x) * light5_at(c);
    }
    if TERMS > 6u {
        c = term_cell(6u, x, c);
        sum += weight_at(6u, x) * light6_at(c);
    }
    for (var t = 7u; t < TERMS; t++) {
        c = term_cell(t, x, c);
        let first = terms[t].first;
        sum += weight_at(t, x) * light7_at(Cell(c.low + first, c.high + first, c.low_weight, c.high_weight));
    }
    return max(sum, vec3(0.0));
}

// What one unit of a term's value contributes along a ray; of a lamp that depends on the position too.
fn term_weight(term: Term) -> vec3<f32> {
    if term.kind == UNIFORM || term.kind == LAMP { return term.weight; }
    let cosine = dot(term.direction, to_eye);
    if term.kind == CURRENT { return term.weight * cosine; }
    return term.weight * phase(term.g, cosine);
}

@compute @workgroup_size(8, 8)
fn march(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id.xy >= params.picture) { return; }
    let at = (2.0 * vec2<f32>(id.xy) + 1.0) / vec2<f32>(params.picture) - 1.0;
    let ray = normalize(params.forward + at.x * params.right - at.y * params.up);
    to_eye = -ray;
    for (var t = 0u; t < TERMS; t++) { weights[t] = term_weight(terms[t]); }

    // Where the ray meets the box. WGSL promises nothing about division by 0: a component of 0 is made tiny.
    let along = ray * params.per_world;
    let divisor = select(along, vec3(1e-20), abs(along) < vec3(1e-20));
    let to_low = (vec3(-0.5) - params.eye) / divisor;
    let to_high = (vec3<f32>(params.size) - 0.5 - params.eye) / divisor;
    let entries = min(to_low, to_high);
    let exits = max(to_low, to_high);
    let near = max(max(entries.x, entries.y), max(entries.z, 0.0));
    let ray_state = 8u * (id.y * params.picture.x + id.x);
    let reach = min(rays[ray_state + 7u], min(exits.x, min(exits.y, exits.z))) - near;
    if !(reach > 0.0) { return; }
    let entered = params.eye + near * along;
    let count = u32(ceil(reach / params.step));
    let bricks = (params.size + params.edge - 1u) / params.edge;

    var radiance = vec3(rays[ray_state], rays[ray_state + 1u], rays[ray_state + 2u]);
    var transmittance = vec3(rays[ray_state + 3u], rays[ray_state + 4u], rays[ray_state + 5u]);
    var n = u32(rays[ray_state + 6u]);
    while n < count && any(transmittance >= vec3(OPAQUE)) {
        let begin = f32(n) * params.step;
        let end = min(begin + params.step, reach);
        let x = entered + 0.5 * (begin + end) * along;
        if SKIP {
            let nearest = clamp(x + 0.5, vec3(0.0), vec3<f32>(params.size - 1u));
            let b = vec3<u32>(nearest) / params.edge;
            if majorant[index(bricks, b)] == 0.0 {
                // On to the first sample behind the brick; the majorant's halo of one value forgives rounding.
                let low = vec3<f32>(b * params.edge) - 0.5;
                let leave = (select(low, low + f32(params.edge), divisor > vec3(0.0)) - entered) / divisor;
                let exit = min(min(leave.x, leave.y), min(leave.z, reach));
                n = max(n + 1u, u32(max(0.0, ceil(exit / params.step - 0.5))));
                continue;
            }
        }
        let lower = min(u32(clamp(x.z, 0.0, f32(params.size.z - 1u))), max(params.size.z, 2u) - 2u);
        if lower < params.cells.x || lower >= params.cells.y { break; }
        n++;
        let c = cell(params.size, params.held, x);
        let value = data_in(c);
        if value < HOLE || !kept(x, params.clips) { continue; }
        let ds = end - begin;
        let o = sample(x, 0.5 * ds * along, c, value);
        let sigma = o.extinction;
        var sigmas = vec3(sigma);
        var alpha = vec3(1.0 - exp(-sigma * ds));
        if CHROMATIC {
            sigmas *= params.chromatic;
            alpha = 1.0 - exp(-sigmas * ds);
        }
        var added = vec3(0.0);
        if GLOW { added = o.emission * select(vec3(ds), alpha / sigmas, sigmas > vec3(0.0)); }
        if sigma > 0.0 && TERMS > 0u {
            var scattered = in_scatter(x);
            if SHADE { scattered *= shading(x, sigma); }
            added += alpha * o.albedo * scattered;
        }
        radiance += transmittance * added;
        transmittance *= 1.0 - alpha;
    }
    rays[ray_state] = radiance.x;
    rays[ray_state + 1u] = radiance.y;
    rays[ray_state + 2u] = radiance.z;
    rays[ray_state + 3u] = transmittance.x;
    rays[ray_state + 4u] = transmittance.y;
    rays[ray_state + 5u] = transmittance.z;
    rays[ray_state + 6u] = f32(n);
}
