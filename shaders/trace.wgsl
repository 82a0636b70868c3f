// Path tracing: L = Σ_paths f(path)/p(path), one path for each pixel (Kroes et al. 2012). Delta tracking with a majorant for each
// brick, ratio tracking for shadows, light and scattering samples combined by the power heuristic.
// field, gradient, table, surfaces, majorant, emitters, images, clips, walls, wall_colours, sums → sums

struct Params {
    size: vec3<u32>,
    // Edge of a brick.
    edge: u32,
    bricks: vec3<u32>,
    entries: u32,
    // Index length per world length.
    per_length: vec3<f32>,
    // First value and inverse range of the table.
    lo: f32,
    eye: vec3<f32>,
    scale: f32,
    forward: vec3<f32>,
    focus: f32,
    // Already times tan of half the field of view (and aspect): a picture reaches from −1 to 1.
    right: vec3<f32>,
    // Of the aperture.
    radius: f32,
    up: vec3<f32>,
    blades: u32,
    unit_right: vec3<f32>,
    g: f32,
    unit_up: vec3<f32>,
    phase: u32,
    // Factor on extinction per channel.
    chromatic: vec3<f32>,
    emitters: u32,
    picture: vec2<u32>,
    sample: u32,
    seed: u32,
    depth: u32,
    sampling: u32,
    // Of surfaces.
    factor: f32,
    reference: f32,
    clips: u32,
    // Of a two-dimensional table: rows, and rows for a unit of gradient magnitude.
    rows: u32,
    steep: f32,
    // Nodes of the tree of opaque surfaces.
    walls: u32,
    // How far from one paths go on, so that rounding does not have them meet it again.
    lift: f32,
}

override GLOW: bool = true;
override WALLS: bool = true;
override CHROMATIC: bool = true;
// Whether the table is two-dimensional.
override GRADED: bool = true;
// 0 none, 1 by the gradient, 2 everywhere.
override SURFACES: u32 = 1u;

// Single-scattering properties of a table entry.
struct Optics {
    albedo: vec3<f32>,
    extinction: f32,
    emission: vec3<f32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> field: array<f32>;
@group(0) @binding(2) var<storage, read> table: array<Optics>;
// Diffuse, specular, roughness, index of refraction.
@group(0) @binding(3) var<storage, read> surfaces: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> majorant: array<f32>;
@group(0) @binding(5) var<storage, read> emitters: array<Emitter>;
@group(0) @binding(6) var<storage, read> images: array<f32>;
@group(0) @binding(7) var<storage, read> clips: array<Clip>;
// For each pixel radiance, squares, coverage, albedo, normal, depth, collisions above the majorant.
@group(0) @binding(8) var<storage, read_write> sums: array<f32>;
@group(0) @binding(9) var<storage, read> gradient: array<f32>;
@group(0) @binding(10) var<storage, read> walls: array<Wall>;
@group(0) @binding(11) var<storage, read> wall_colours: array<vec3<f32>>;

const SUMS: u32 = 15u;
const BOTH: u32 = 0u;
const LIGHTS: u32 = 1u;
const SCATTERING: u32 = 2u;
// Scattering from which on paths end at random.
const ROULETTE: u32 = 3u;
// Transmittance below which a shadow ray goes on in every second case only.
const FAINT: f32 = 0.1;

// The eight values round a position, x fastest, and where between them it is.
struct Cell {
    low: vec4<u32>,
    high: vec4<u32>,
    f: vec3<f32>,
}

fn cell_at(position: vec3<f32>) -> Cell {
    let last = params.size - 1u;
    let p = clamp(position, vec3(0.0), vec3<f32>(last));
    let base = min(vec3<u32>(p), max(last, vec3(1u)) - 1u);
    let reach = min(vec3(1u), last) * vec3(1u, params.size.x, params.size.x * params.size.y);
    let i = index(params.size, base);
    let low = vec4(i, i + reach.x, i + reach.y, i + reach.x + reach.y);
    return Cell(low, low + reach.z, p - vec3<f32>(base));
}

fn trilinear(low: vec4<f32>, high: vec4<f32>, f: vec3<f32>) -> f32 {
    let g = 1.0 - f;
    let front = (low.x * g.x + low.y * f.x) * g.y + (low.z * g.x + low.w * f.x) * f.y;
    let back = (high.x * g.x + high.y * f.x) * g.y + (high.z * g.x + high.w * f.x) * f.y;
    return front * g.z + back * f.z;
}

fn data_in(c: Cell) -> f32 {
    let low = vec4(field[c.low.x], field[c.low.y], field[c.low.z], field[c.low.w]);
    let high = vec4(field[c.high.x], field[c.high.y], field[c.high.z], field[c.high.w]);
    return trilinear(low, high, c.f);
}

fn data(position: vec3<f32>) -> f32 {
    return data_in(cell_at(position));
}

// Where a position lies in the table: entry, first of its row, and fraction of the way to the next row.
struct Place {
    entry: Entry,
    row: u32,
    down: f32,
    // False in holes and where the medium is cut away.
    there: bool,
}

fn look(position: vec3<f32>) -> Place {
    let c = cell_at(position);
    let value = data_in(c);
    let e = entry(value, params.lo, params.scale, params.entries);
    let there = value >= HOLE && kept(position, params.clips);
    if !GRADED { return Place(e, 0u, 0.0, there); }
    let low = vec4(gradient[c.low.x], gradient[c.low.y], gradient[c.low.z], gradient[c.low.w]);
    let high = vec4(gradient[c.high.x], gradient[c.high.y], gradient[c.high.z], gradient[c.high.w]);
    let at = clamp(trilinear(low, high, c.f) * params.steep, 0.0, f32(params.rows - 1u));
    let row = min(u32(at), max(params.rows, 2u) - 2u);
    return Place(e, row * params.entries, at - f32(row), there);
}

fn extinction_of(p: Place) -> f32 {
    let i = p.row + p.entry.below;
    let a = mix(table[i].extinction, table[i + 1u].extinction, p.entry.fraction);
    if !GRADED { return a; }
    let j = i + params.entries;
    return mix(a, mix(table[j].extinction, table[j + 1u].extinction, p.entry.fraction), p.down);
}

fn emission_of(p: Place) -> vec3<f32> {
    let i = p.row + p.entry.below;
    let a = mix(table[i].emission, table[i + 1u].emission, p.entry.fraction);
    if !GRADED { return a; }
    let j = i + params.entries;
    return mix(a, mix(table[j].emission, table[j + 1u].emission, p.entry.fraction), p.down);
}

fn albedo_of(p: Place) -> vec3<f32> {
    let i = p.row + p.entry.below;
    let a = mix(table[i].albedo, table[i + 1u].albedo, p.entry.fraction);
    if !GRADED { return a; }
    let j = i + params.entries;
    return mix(a, mix(table[j].albedo, table[j + 1u].albedo, p.entry.fraction), p.down);
}

// A ray among the bricks, in index space.
struct Walk {
    start: vec3<f32>,
    t: f32,
    slope: vec3<f32>,
    end: f32,
    inverse: vec3<f32>,
    // What is left of a free flight, in optical depth of the majorants.
    flight: f32,
    // Where the ray leaves the brick along each axis.
    leave: vec3<f32>,
    bound: f32,
    brick: vec3<i32>,
}

var<private> walk: Walk;
var<private> exceeded: f32;

fn begin_walk(origin: vec3<f32>, way: vec3<f32>, near: f32, far: f32, xi: f32) -> bool {
    walk.start = origin * params.per_length;
    let slope = way * params.per_length;
    walk.slope = select(slope, select(vec3(1e-20), vec3(-1e-20), slope < vec3(0.0)), abs(slope) < vec3(1e-20));
    walk.inverse = 1.0 / walk.slope;
    let last = vec3<f32>(params.size - 1u);
    let low = (vec3(-0.5) - walk.start) * walk.inverse;
    let high = (last + 0.5 - walk.start) * walk.inverse;
    let into = min(low, high);
    let out = max(low, high);
    walk.t = max(max(into.x, max(into.y, into.z)), near);
    walk.end = min(min(out.x, min(out.y, out.z)), far);
    if !(walk.t < walk.end) { return false; }
    let cell = vec3<i32>(clamp(walk.start + walk.t * walk.slope, vec3(0.0), last));
    walk.brick = cell / i32(params.edge);
    let ahead = vec3<f32>(walk.brick) + select(vec3(0.0), vec3(1.0), walk.slope > vec3(0.0));
    walk.leave = (select(ahead * f32(params.edge), vec3(-1.0), ahead <= vec3(0.0)) - walk.start) * walk.inverse;
    walk.flight = -log(1.0 - xi);
    return true;
}

// On to the next tentative collision; false where there is none.
fn fly() -> bool {
    loop {
        let out = min(min(walk.leave.x, min(walk.leave.y, walk.leave.z)), walk.end);
        walk.bound = majorant[index(params.bricks, vec3<u32>(walk.brick))];
        if walk.bound > 0.0 {
            let ahead = walk.flight / walk.bound;
            if walk.t + ahead < out {
                walk.t += ahead;
                return true;
            }
            walk.flight -= max(out - walk.t, 0.0) * walk.bound;
        }
        walk.t = max(out, walk.t);
        if out >= walk.end { return false; }
        var axis = 2u;
        if out == walk.leave.x { axis = 0u; } else if out == walk.leave.y { axis = 1u; }
        let up = walk.slope[axis] > 0.0;
        walk.brick[axis] += select(-1, 1, up);
        if walk.brick[axis] < 0 || walk.brick[axis] >= i32(params.bricks[axis]) { return false; }
        // The first bricks reach as far as the box does, half a value beyond theirs.
        let ahead = f32(walk.brick[axis] + select(0, 1, up));
        let plane = select(ahead * f32(params.edge), -1.0, ahead <= 0.0);
        walk.leave[axis] = (plane - walk.start[axis]) * walk.inverse[axis];
    }
    return false;
}

fn again() {
    walk.flight = -log(1.0 - next_number());
}

fn here() -> vec3<f32> {
    return walk.start + walk.t * walk.slope;
}

// What a path carries.
var<private> weight: vec3<f32>;
var<private> radiance: vec3<f32>;

// Where it collided.
struct Collision {
    position: vec3<f32>,
    t: f32,
    place: Place,
    sigma: f32,
    found: bool,
}

const NO_COLLISION: Collision = Collision(vec3(0.0), 0.0, Place(Entry(0u, 0.0), 0u, 0.0, false), 0.0, false);

// Delta tracking along a part of a ray.
fn collide(origin: vec3<f32>, way: vec3<f32>, near: f32, far: f32, xi: f32) -> Collision {
    if !begin_walk(origin, way, near, far, xi) { return NO_COLLISION; }
    while fly() {
        let position = here();
        let place = look(position);
        if place.there {
            let sigma = extinction_of(place);
            if GLOW { radiance += weight * emission_of(place) / walk.bound; }
            if sigma > walk.bound * 1.0001 { exceeded += 1.0; }
            let xi = next_number();
            if CHROMATIC {
                let sigmas = sigma * params.chromatic;
                let total = max((weight.x + weight.y + weight.z) * walk.bound, 1e-37);
                let chance = min(dot(weight, sigmas) / total, 1.0);
                if xi < chance {
                    weight *= sigmas / (walk.bound * chance);
                    return Collision(position, walk.t, place, sigma, true);
                }
                weight *= max(walk.bound - sigmas, vec3(0.0)) / (walk.bound * (1.0 - chance));
            } else if xi * walk.bound < sigma {
                return Collision(position, walk.t, place, sigma, true);
            }
        }
        again();
    }
    return NO_COLLISION;
}

// Ratio tracking: an unbiased estimate of the transmittance up to a distance.
fn transmittance(origin: vec3<f32>, way: vec3<f32>, far: f32) -> vec3<f32> {
    var left = vec3(1.0);
    if !begin_walk(origin, way, 0.0, far, next_number()) { return left; }
    while fly() {
        let position = here();
        let place = look(position);
        if place.there {
            let sigma = extinction_of(place);
            if sigma > walk.bound * 1.0001 { exceeded += 1.0; }
            left *= max(1.0 - sigma / walk.bound * params.chromatic, vec3(0.0));
            let most = max(left.x, max(left.y, left.z));
            if most < FAINT {
                if most == 0.0 || next_number() >= 0.5 { return vec3(0.0); }
                left *= 2.0;
            }
        }
        again();
    }
    return left;
}

// The normalised value; 0 in holes.
fn normalised(position: vec3<f32>) -> f32 {
    let value = data(position);
    if value < HOLE { return 0.0; }
    return clamp((value - params.lo) * params.scale, 0.0, 1.0);
}

fn gradient_at(p: vec3<f32>) -> vec3<f32> {
    return 0.5 * vec3(
        normalised(p + vec3(1.0, 0.0, 0.0)) - normalised(p - vec3(1.0, 0.0, 0.0)),
        normalised(p + vec3(0.0, 1.0, 0.0)) - normalised(p - vec3(0.0, 1.0, 0.0)),
        normalised(p + vec3(0.0, 0.0, 1.0)) - normalised(p - vec3(0.0, 0.0, 1.0)),
    );
}

// Change of the normalised value along each axis across the cell at a position; 0 beside holes.
fn slope_at(position: vec3<f32>) -> vec3<f32> {
    let c = cell_at(position);
    let f = c.f;
    let low = vec4(field[c.low.x], field[c.low.y], field[c.low.z], field[c.low.w]);
    let high = vec4(field[c.high.x], field[c.high.y], field[c.high.z], field[c.high.w]);
    if any(low < vec4(HOLE)) || any(high < vec4(HOLE)) { return vec3(0.0); }
    return params.scale * vec3(
        mix(mix(low.y - low.x, low.w - low.z, f.y), mix(high.y - high.x, high.w - high.z, f.y), f.z),
        mix(mix(low.z - low.x, low.w - low.y, f.x), mix(high.z - high.x, high.w - high.y, f.x), f.z),
        mix(mix(high.x - low.x, high.y - low.y, f.x), mix(high.z - low.z, high.w - low.w, f.x), f.y),
    );
}

fn power(own: f32, other: f32) -> f32 {
    let ratio = other / own;
    return 1.0 / (1.0 + ratio * ratio);
}

// What a light that a ray has met counts, beside samples of that light; the camera's ray has pdf 0.
fn share_of_hit(e: Emitter, hit: LightHit, pdf: f32) -> f32 {
    if pdf == 0.0 || params.sampling == SCATTERING { return 1.0; }
    if params.sampling == LIGHTS { return 0.0; }
    return power(pdf, e.share * hit.pdf);
}

// True for emitters that rays meet at some distance.
fn placed(e: Emitter) -> bool {
    return e.shape > ENVIRONMENT;
}

// What a ray ends at.
struct End {
    collision: Collision,
    wall: WallHit,
}

// Follows a ray to its next collision or to a wall, and collects what glows and every emitter that it meets before.
fn follow(origin: vec3<f32>, way: vec3<f32>, xi: f32, pdf: f32) -> End {
    var wall = NO_WALL;
    if WALLS { wall = first_wall(origin, way, FAR, params.walls); }
    var start = 0.0;
    var number = xi;
    loop {
        var next = NO_HIT;
        var share = 0.0;
        for (var i = 0u; i < params.emitters; i++) {
            let e = emitters[i];
            if !placed(e) || (pdf == 0.0 && e.visible == 0u) { continue; }
            let hit = hit_emitter(e, origin, way);
            if hit.found && hit.distance > start && hit.distance < wall.t && (!next.found || hit.distance < next.distance) {
                next = hit;
                share = share_of_hit(e, hit, pdf);
            }
        }
        if !next.found { break; }
        let collision = collide(origin, way, start, next.distance, number);
        if collision.found { return End(collision, NO_WALL); }
        radiance += weight * next.radiance * share;
        start = next.distance;
        number = next_number();
    }
    let collision = collide(origin, way, start, wall.t, number);
    if collision.found { return End(collision, NO_WALL); }
    if wall.found { return End(NO_COLLISION, wall); }
    for (var i = 0u; i < params.emitters; i++) {
        let e = emitters[i];
        if placed(e) || (pdf == 0.0 && e.visible == 0u) { continue; }
        let hit = hit_emitter(e, origin, way);
        if hit.found { radiance += weight * hit.radiance * share_of_hit(e, hit, pdf); }
    }
    return End(NO_COLLISION, NO_WALL);
}

// Light that comes straight from one emitter and goes on against `way`.
fn light(lobe: Lobe, origin: vec3<f32>, way: vec3<f32>, choice: f32, xi: vec3<f32>) -> vec3<f32> {
    if params.emitters == 0u { return vec3(0.0); }
    var chosen = 0u;
    var rest = choice;
    while chosen + 1u < params.emitters && rest >= emitters[chosen].share {
        rest -= emitters[chosen].share;
        chosen++;
    }
    let e = emitters[chosen];
    let sample = sample_emitter(e, origin, xi);
    if !sample.found { return vec3(0.0); }
    let worth = lobe_value(lobe, params.phase, params.g, way, sample.direction);
    let density = e.share * select(1.0, sample.pdf, sample.pdf > 0.0);
    var counts = 1.0;
    if sample.pdf > 0.0 {
        if params.sampling == BOTH { counts = power(density, worth.pdf); }
        if params.sampling == SCATTERING { counts = 0.0; }
    }
    let found = worth.f * sample.radiance * (counts / density);
    if !(max(found.x, max(found.y, found.z)) > 0.0) { return vec3(0.0); }
    if WALLS && first_wall(origin, sample.direction, sample.distance, params.walls).found { return vec3(0.0); }
    return found * transmittance(origin, sample.direction, sample.distance);
}

// Whether a collision is with a surface or with a cloud (Kroes et al. 2012, (1)–(3)).
fn lobe_at(c: Collision, albedo: vec3<f32>, gradient: vec3<f32>, way: vec3<f32>, xi: f32) -> Lobe {
    let cloud = Lobe(albedo, 0.0, vec3(0.0), 0.0, 0.0);
    if SURFACES == 0u { return cloud; }
    var normal = -unit_or_zero(gradient * params.per_length);
    var chance = 1.0;
    if SURFACES == 1u {
        let steep = 1.0 - exp(-25.0 * params.factor * params.factor * params.factor * length(gradient));
        chance = (1.0 - exp(-c.sigma * params.reference)) * steep;
    }
    if all(normal == vec3(0.0)) || xi >= chance { return cloud; }
    let e = c.place.entry;
    let s = mix(surfaces[e.below], surfaces[e.below + 1u], e.fraction);
    if dot(normal, way) > 0.0 { normal = -normal; }
    let facing = (s.w - 1.0) / (s.w + 1.0);
    return Lobe(s.x * albedo, s.y, normal, facing * facing, blinn_exponent(s.z));
}

// An even point of an aperture within the unit circle.
fn aperture(xi: vec2<f32>) -> vec2<f32> {
    let r = sqrt(xi.x);
    if params.blades < 3u { return r * vec2(cos(TURN * xi.y), sin(TURN * xi.y)); }
    let at = xi.y * f32(params.blades);
    let a = TURN * floor(at) / f32(params.blades);
    let b = TURN * (floor(at) + 1.0) / f32(params.blades);
    return r * mix(vec2(sin(a), cos(a)), vec2(sin(b), cos(b)), at - floor(at));
}

fn any_light() -> bool {
    if GLOW { return true; }
    if params.sampling == LIGHTS { return false; }
    for (var i = 0u; i < params.emitters; i++) {
        let e = emitters[i];
        if e.shape != POINT && (e.shape != DISTANT || e.edge < 1.0) { return true; }
    }
    return false;
}

@compute @workgroup_size(8, 8)
fn trace(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id.xy >= params.picture) { return; }
    let pixel = id.y * params.picture.x + id.x;
    begin_numbers(pixel, params.sample, params.seed);
    let at = 2.0 * (vec2<f32>(id.xy) + number_pair(0u)) / vec2<f32>(params.picture) - 1.0;
    var way = params.forward + at.x * params.right - at.y * params.up;
    var origin = params.eye;
    if params.radius > 0.0 {
        let on_lens = aperture(number_pair(1u));
        let shift = params.radius * (on_lens.x * params.unit_right + on_lens.y * params.unit_up);
        origin += shift;
        way = params.focus * way - shift;
    }
    way = normalize(way);

    weight = vec3(1.0);
    radiance = vec3(0.0);
    exceeded = 0.0;
    var met_any = false;
    var first_t = 0.0;
    var first_albedo = vec3(0.0);
    var first_normal = vec3(0.0);
    // Density with which the way was chosen.
    var pdf = 0.0;
    for (var bounce = 0u; bounce <= params.depth; bounce++) {
        // The last ray only looks for light.
        if bounce > 0u && bounce == params.depth && !any_light() { break; }
        var draw: vec2<f32>;
        if bounce == 0u { draw = number_pair(2u); } else { draw = vec2(next_number(), next_number()); }
        let end = follow(origin, way, draw.x, pdf);
        let c = end.collision;
        var met: vec3<f32>;
        var lobe: Lobe;
        var albedo: vec3<f32>;
        var normal: vec3<f32>;
        var t: f32;
        if c.found {
            albedo = albedo_of(c.place);
            var gradient = vec3(0.0);
            // For surfaces it is smoothed; for the picture's normals the mean over samples does that.
            if SURFACES > 0u { gradient = gradient_at(c.position); } else if bounce == 0u { gradient = slope_at(c.position); }
            normal = -unit_or_zero(gradient * params.per_length);
            t = c.t;
            met = origin + t * way;
            lobe = lobe_at(c, albedo, gradient, way, next_number());
        } else if WALLS && end.wall.found {
            albedo = wall_colours[end.wall.mesh];
            normal = end.wall.normal;
            t = end.wall.t;
            // What has come from afar is rounded more.
            met = origin + t * way + (params.lift + 1e-6 * t) * normal;
            lobe = Lobe(albedo, 0.0, normal, 0.0, MATTE);
        } else { break; }
        if bounce == 0u {
            met_any = true;
            first_t = t;
            first_albedo = albedo;
            first_normal = normal;
        }
        if bounce == params.depth { break; }

        var xi: vec2<f32>;
        if bounce == 0u { xi = number_pair(3u); } else { xi = vec2(next_number(), next_number()); }
        let third = next_number();
        radiance += weight * light(lobe, met, way, draw.y, vec3(xi, third));

        if bounce == 0u { xi = number_pair(4u); } else { xi = vec2(next_number(), next_number()); }
        let to = lobe_sample(lobe, params.phase, params.g, way, vec3(xi, next_number()));
        let worth = lobe_value(lobe, params.phase, params.g, way, to);
        if !(worth.pdf > 0.0) { break; }
        weight *= worth.f / worth.pdf;
        let most = max(weight.x, max(weight.y, weight.z));
        if bounce + 1u >= ROULETTE {
            let survival = min(most, 1.0);
            if next_number() >= survival { break; }
            weight /= survival;
        }
        if most == 0.0 { break; }
        origin = met;
        way = to;
        pdf = worth.pdf;
    }

    let out = SUMS * pixel;
    for (var c = 0u; c < 3u; c++) {
        var value = radiance[c];
        // Also false for what is not a number.
        if !(abs(value) < FAR) { value = 0.0; }
        sums[out + c] += value;
        sums[out + 3u + c] += value * value;
        sums[out + 7u + c] += first_albedo[c];
        sums[out + 10u + c] += first_normal[c];
    }
    sums[out + 6u] += select(0.0, 1.0, met_any);
    sums[out + 13u] += first_t;
    sums[out + 14u] += exceeded;
}
