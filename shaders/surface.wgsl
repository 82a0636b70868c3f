// Isosurfaces in a volume: what the kernels that meet them share. Positions are in values of the data grid, directions unit vectors of
// the world. Along a ray the value is looked at every `step`; where it changes sides of a surface's value, 16 bisections find where.

struct Params {
    size: vec3<u32>,
    step: f32,
    eye: vec3<f32>,
    // Edge of a brick.
    edge: f32,
    forward: vec3<f32>,
    mean_spacing: f32,
    // Already times tan of half the field of view (and aspect): a picture reaches from −1 to 1.
    right: vec3<f32>,
    // Number of rays.
    count: u32,
    up: vec3<f32>,
    surfaces: u32,
    spacing: vec3<f32>,
    seed: u32,
    picture: vec2<u32>,
    // Samples to add, the second excluded; of beauty the diffuse ones.
    samples: vec2<u32>,
    // Of beauty.
    specular_samples: vec2<u32>,
    // First texel and edge.
    radiance: vec2<u32>,
    irradiance: vec2<u32>,
    // World length of an occlusion ray, and its samples.
    radius: f32,
    steps: u32,
    // Attenuation per channel, and the table of extinction.
    rate: vec3<f32>,
    lo: f32,
    scale: f32,
    entries: u32,
    // Subsurface: directions for each transmitted ray.
    secondary: u32,
    // Light volume: its size, kind of weight, and weight.
    light_size: vec3<u32>,
    kind: u32,
    weight: vec3<f32>,
    direction: vec3<f32>,
    position: vec3<f32>,
    floor: f32,
    outer: f32,
    slope: f32,
    cosine: f32,
    clips: u32,
}

struct Surface {
    diffuse: vec3<f32>,
    value: f32,
    specular: f32,
    exponent: f32,
    exponent_gradient: f32,
    opacity: f32,
    transmission: f32,
    spread: f32,
    ior: f32,
    // Prefiltered map: first texel and edge.
    reflection: vec2<u32>,
}

// A ray at an isosurface.
struct Hit {
    position: vec3<f32>,
    pixel: u32,
    normal: vec3<f32>,
    slope: f32,
    depth: f32,
    surface: u32,
    before: u32,
    behind: u32,
}

// Whether bricks are skipped; whether the published estimator is used.
override SKIP: bool = true;
override PAPER: bool = true;
// Whether extinction attenuates; whether anything is cut away.
override TRANSFER: bool = true;
override CUT: bool = true;

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> field: array<f32>;
// For each brick the distance to one that a surface may be in.
@group(0) @binding(2) var<storage, read> empty: array<f32>;
@group(0) @binding(3) var<storage, read> surfaces: array<Surface>;
@group(0) @binding(4) var<storage, read> extinction: array<f32>;
@group(0) @binding(10) var<storage, read> clips: array<Clip>;

const FRESH: u32 = 0xfffffffeu;
const NONE: u32 = 0xffffffffu;
// Sides of a place without data.
const NOWHERE: u32 = 0xffffffffu;
const BISECTIONS: u32 = 16u;
const SHARPEST: f32 = 1e4;
// What is left of a published lobe where it is cut off.
const THRESHOLD: f32 = 0.1;
const QUARTER_PI: f32 = 0.7853981633974483;

fn value_at(position: vec3<f32>) -> f32 {
    let last = vec3<f32>(params.size - 1u);
    let p = clamp(position, vec3(0.0), last);
    let base = min(vec3<u32>(p), max(params.size, vec3(2u)) - 2u);
    let f = p - vec3<f32>(base);
    let reach = min(vec3(1u), params.size - 1u);
    let i = index(params.size, base);
    let row = reach.y * params.size.x;
    let j = i + reach.z * params.size.x * params.size.y;
    let near = vec4(field[i], field[i + reach.x], field[i + row], field[i + row + reach.x]);
    let far = vec4(field[j], field[j + reach.x], field[j + row], field[j + row + reach.x]);
    let across = near * (1.0 - f.z) + far * f.z;
    let along = across.xy * (1.0 - f.y) + across.zw * f.y;
    return along.x * (1.0 - f.x) + along.y * f.x;
}

// Bit k: the value is at least that of surface k.
fn sides_of(value: f32) -> u32 {
    if value < HOLE { return NOWHERE; }
    var bits = 0u;
    for (var k = 0u; k < params.surfaces; k++) { bits |= select(0u, 1u, value >= surfaces[k].value) << k; }
    return bits;
}

fn nonzero(v: vec3<f32>) -> vec3<f32> {
    return select(v, vec3(1e-20), abs(v) < vec3(1e-20));
}

// A straight way through the box; t is world length from its start.
struct Path {
    start: vec3<f32>,
    slope: vec3<f32>,
    length: f32,
}

fn path_from(position: vec3<f32>, way: vec3<f32>) -> Path {
    let slope = way / params.spacing;
    let inverse = 1.0 / nonzero(slope);
    let below = (vec3(-0.5) - position) * inverse;
    let above = (vec3<f32>(params.size) - 0.5 - position) * inverse;
    let entries = min(below, above);
    let exits = max(below, above);
    let near = max(max(entries.x, entries.y), max(entries.z, 0.0));
    let reach = min(exits.x, min(exits.y, exits.z)) - near;
    if !(reach > 0.0) { return Path(position, slope, 0.0); }
    return Path(position + near * slope, slope, reach);
}

struct Crossing {
    // Whether there is one.
    met: bool,
    t: f32,
    position: vec3<f32>,
    surface: u32,
    before: u32,
    behind: u32,
    // ∫ρ ds to there, or to the end.
    thick: f32,
}

// Number of the last sample that surely lies, like sample n at `position`, in bricks without a surface; n if there is none.
fn leap(path: Path, position: vec3<f32>, n: u32) -> u32 {
    let bricks = vec3<u32>((vec3<f32>(params.size) + params.edge - 1.0) / params.edge);
    let cell = trunc(clamp(position, vec3(0.0), vec3<f32>(max(params.size, vec3(2u)) - 2u)));
    let brick = trunc((cell + 0.5) / params.edge);
    let distance = empty[index(bricks, vec3<u32>(brick))];
    if distance < 0.5 { return n; }
    let slope = nonzero(path.slope);
    let ahead = select(brick + distance, brick - distance + 1.0, slope < vec3(0.0)) * params.edge;
    let to = (ahead - path.start) / slope;
    let t = min(min(to.x, min(to.y, to.z)), path.length);
    return u32(max(t / params.step - 0.01 - f32(n) * 1e-6, 0.0));
}

// False where a cut has taken away what was there.
fn stays(position: vec3<f32>) -> bool {
    return !CUT || kept(position, params.clips);
}

fn density(position: vec3<f32>, value: f32) -> f32 {
    if !stays(position) { return 0.0; }
    if !TRANSFER { return 1.0; }
    if value < HOLE { return 0.0; }
    let e = entry(value, params.lo, params.scale, params.entries);
    return mix(extinction[e.below], extinction[e.below + 1u], e.fraction);
}

// From the start of a path, which is on `sides`, to the first surface; `dims` asks for ∫ρ ds, ρ being extinction or 1, and 0 where it
// is cut away.
fn follow(path: Path, sides: u32, dims: bool) -> Crossing {
    var before = sides;
    var begin = 0.0;
    var n = 0u;
    var here = path.start;
    var thick = 0.0;
    var rho = 1.0;
    let differs = (TRANSFER || CUT) && dims;
    if differs { rho = density(here, value_at(here)); }
    while begin < path.length {
        var last = n;
        if SKIP && !differs { last = leap(path, here, n); }
        n = max(last, n + 1u);
        let end = min(f32(n) * params.step, path.length);
        here = path.start + end * path.slope;
        let value = value_at(here);
        let behind = sides_of(value);
        if behind != before {
            var from_t = begin;
            var to_t = end;
            var close = before;
            var far = behind;
            if CUT && (before == NOWHERE || behind == NOWHERE) {
                // Far behind a cut are no data: what begins or ends there does so at the cut.
                let first = stays(path.start + begin * path.slope);
                if first != stays(path.start + end * path.slope) {
                    var near_t = begin;
                    var far_t = end;
                    for (var i = 0u; i < BISECTIONS; i++) {
                        let middle = 0.5 * (near_t + far_t);
                        if stays(path.start + middle * path.slope) == first { near_t = middle; } else { far_t = middle; }
                    }
                    let cut = select(far_t, near_t, first);
                    let there = sides_of(value_at(path.start + cut * path.slope));
                    if first {
                        to_t = cut;
                        far = there;
                    } else {
                        from_t = cut;
                        close = there;
                    }
                }
            }
            var hole = close == far || close == NOWHERE || far == NOWHERE;
            for (var i = 0u; i < BISECTIONS; i++) {
                let middle = 0.5 * (from_t + to_t);
                let s = sides_of(value_at(path.start + middle * path.slope));
                if s == NOWHERE {
                    hole = true;
                    break;
                }
                if s == close {
                    from_t = middle;
                } else {
                    to_t = middle;
                    far = s;
                }
            }
            let met = path.start + to_t * path.slope;
            if !hole && stays(met) {
                let crossed = close ^ far;
                let surface = select(firstLeadingBit(crossed), firstTrailingBit(crossed), (far & crossed) != 0u);
                var dimmed = to_t;
                if differs {
                    dimmed = thick + 0.5 * (rho + density(met, surfaces[surface].value)) * (to_t - begin);
                }
                return Crossing(true, to_t, met, surface, close, far, dimmed);
            }
        }
        if differs {
            let next = density(here, value);
            thick += 0.5 * (rho + next) * (end - begin);
            rho = next;
        } else {
            thick = end;
        }
        before = behind;
        begin = end;
    }
    return Crossing(false, path.length, here, NONE, before, before, thick);
}

// Position and value one value off along an axis; the middle's where that is a hole.
fn beside(p: vec3<f32>, here: f32, offset: vec3<f32>) -> vec2<f32> {
    let q = clamp(p + offset, vec3(0.0), vec3<f32>(params.size - 1u));
    let value = value_at(q);
    let axis = abs(offset);
    if value < HOLE { return vec2(dot(p, axis), here); }
    return vec2(dot(q, axis), value);
}

fn component(p: vec3<f32>, here: f32, axis: vec3<f32>) -> f32 {
    let low = beside(p, here, -axis);
    let high = beside(p, here, axis);
    if high.x > low.x { return (high.y - low.y) / (high.x - low.x); }
    return 0.0;
}

// (8): the gradient's direction turned against a ray, and its signed magnitude.
fn normal_at(position: vec3<f32>, way: vec3<f32>) -> vec4<f32> {
    let p = clamp(position, vec3(0.0), vec3<f32>(params.size - 1u));
    let here = value_at(p);
    let gradient = vec3(
        component(p, here, vec3(1.0, 0.0, 0.0)),
        component(p, here, vec3(0.0, 1.0, 0.0)),
        component(p, here, vec3(0.0, 0.0, 1.0)),
    ) / params.spacing;
    let slope = length(gradient);
    if !(slope > 0.0 && slope < 3e38) { return vec4(-way, 0.0); }
    let normal = gradient / slope;
    if dot(normal, way) > 0.0 { return vec4(-normal, -slope); }
    return vec4(normal, slope);
}

// Direction in which the viewer looks at a hit.
fn towards(position: vec3<f32>) -> vec3<f32> {
    let way = (position - params.eye) * params.spacing;
    let reach = length(way);
    if !(reach > 0.0) { return params.forward; }
    return way / reach;
}

fn mirror(view: vec3<f32>, normal: vec3<f32>) -> vec3<f32> {
    return view - 2.0 * dot(view, normal) * normal;
}

// The direction mirrored at the surface if it goes below it.
fn above(way: vec3<f32>, normal: vec3<f32>) -> vec3<f32> {
    return way - 2.0 * min(dot(way, normal), 0.0) * normal;
}

fn exponent_at(surface: Surface, slope: f32) -> f32 {
    return clamp(surface.exponent + surface.exponent_gradient * abs(slope), 0.0, SHARPEST);
}

// Draw i of the hemisphere, and its weight: (2) with (10), or by Lambert's cosine.
fn hemisphere(normal: vec3<f32>, origin: vec4<u32>, stream: vec3<u32>, i: u32) -> vec4<f32> {
    if PAPER {
        let s = sphere(stream, i);
        let cosine = dot(s, normal);
        return vec4(select(s, -s, cosine < 0.0), abs(cosine));
    }
    let u = point(origin, i);
    return vec4(about(normal, sqrt(1.0 - u.x), u.y), 1.0);
}

// Draw i of the lobe cos^s, and its weight: (3), (6) with (11), or by the lobe's density.
fn lobe(axis: vec3<f32>, exponent: f32, origin: vec4<u32>, stream: vec3<u32>, i: u32) -> vec4<f32> {
    if PAPER {
        let s = sphere(stream, i);
        let widest = acos(pow(THRESHOLD, 1.0 / max(exponent, 1e-6)));
        let alpha = clamp(0.5 * (1.0 + tan(widest - QUARTER_PI)), 0.0, 1.0);
        let way = normalize(alpha * select(s, -s, dot(s, axis) < 0.0) + (1.0 - alpha) * axis);
        return vec4(way, pow(max(dot(way, axis), 0.0), exponent));
    }
    let u = point(origin, i);
    return vec4(about(axis, pow(1.0 - u.x, 1.0 / (exponent + 1.0)), u.y), 1.0);
}
