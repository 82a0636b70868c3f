// One pass of half-angle slicing, some slabs at a time (GPU Gems 39, section 39.5.1; src/device/slices.rs):
// light  I_mid = I·e^(−k a σ d/2), I ← I·e^(−k a σ d)                            (8)
// under  C ← C + T·c, T ← T·e^(−k σ d_v)  (6);  over  C ← c + C·e^(−k σ d_v)     (5)
// field, gradient, table, sums, majorant, sources, meets, clips, fronts, layers, rays → fronts, layers (light); rays (eye)

// Rays of a view in index space; distances along them in world length.
struct Casting {
    start: vec3<f32>,
    start_right: vec3<f32>,
    start_down: vec3<f32>,
    way: vec3<f32>,
    way_right: vec3<f32>,
    way_down: vec3<f32>,
    axis: vec3<f32>,
    // From where a ray starts to plane 0 along the axis.
    base: vec3<f32>,
    spacing: f32,
}

struct Params {
    size: vec3<u32>,
    lo: f32,
    scale: f32,
    entries: u32,
    rows: u32,
    steep: f32,
    per_world: vec3<f32>,
    // Mean spacing of the data.
    spacing: f32,
    towards_light: vec3<f32>,
    ambient: f32,
    diffuse: f32,
    specular: f32,
    shininess: f32,
    // Edge of a brick.
    edge: u32,
    chromatic: vec3<f32>,
    held: vec2<u32>,
    picture: vec2<u32>,
    eye: Casting,
    light: Casting,
    // Rows that take a position to (qx·c, qy·c, c) on the light buffer.
    row_x: vec3<f32>,
    row_y: vec3<f32>,
    row_z: vec3<f32>,
    shift: vec3<f32>,
    // Factor on extinction of each channel of the light buffer.
    factors: vec3<f32>,
    blur: f32,
    inner: vec2<f32>,
    texel: vec2<f32>,
    texels: vec2<u32>,
    clips: u32,
}

// Whether light comes through the light buffer, along parallel rays; whether the eye meets slabs in the same order.
override LIT: bool = true;
override PARALLEL: bool = true;
override UNDER: bool = true;
override SKIP: bool = true;
override SHADE: bool = true;
override GLOW: bool = true;
override CHROMATIC: bool = true;
override BLUR: bool = true;
// Whether light meets something opaque.
override OPAQUE: bool = true;
// Channels of the light buffer; sources that arrive undimmed.
override CHANNELS: u32 = 3u;
override SOURCES: u32 = 0u;

const UNIFORM: u32 = 0u;
const PHASE: u32 = 1u;
const LAMP: u32 = 3u;
// Layers of the light buffer that are kept.
const BATCH: u32 = 8u;
const FADE: f32 = 1e-4;

struct Source {
    weight: vec3<f32>,
    kind: u32,
    // Of a lamp: its cone's axis.
    direction: vec3<f32>,
    g: f32,
    position: vec3<f32>,
    floor: f32,
    outer: f32,
    slope: f32,
    cosine: f32,
}

// Some slabs: the first, their number, the layer of the first; the half of `fronts` that is read; the pixels that are made.
struct Turn {
    first: u32,
    count: u32,
    layer: u32,
    half: u32,
    corner: vec2<u32>,
    end: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> field: array<f32>;
@group(0) @binding(2) var<storage, read> gradient: array<f32>;
@group(0) @binding(3) var<storage, read> table: array<Optics>;
@group(0) @binding(4) var<storage, read> sums: array<Sums>;
@group(0) @binding(5) var<storage, read> majorant: array<f32>;
// Those that arrive undimmed, then the one of the light buffer.
@group(0) @binding(6) var<storage, read> sources: array<Source>;
// Rows of texels, each channel after the other; twice.
@group(0) @binding(7) var<storage, read_write> fronts: array<f32>;
// Rows of texels, each layer after the other.
@group(0) @binding(8) var<storage, read_write> layers: array<f32>;
@group(0) @binding(9) var<storage, read_write> rays: array<f32>;
// Where the ray of each texel first and last meets something opaque.
@group(0) @binding(10) var<storage, read> meets: array<vec2<f32>>;
@group(0) @binding(11) var<storage, read> clips: array<Clip>;

var<immediate> turn: Turn;

struct Line {
    start: vec3<f32>,
    direction: vec3<f32>,
    slope: vec3<f32>,
    near: f32,
    far: f32,
    base: f32,
    spacing: f32,
    norm: f32,
}

fn nonzero(v: f32) -> f32 {
    return select(v, 1e-20, abs(v) < 1e-20);
}

fn line(c: Casting, q: vec2<f32>) -> Line {
    let start = c.start + q.x * c.start_right + q.y * c.start_down;
    let way = c.way + q.x * c.way_right + q.y * c.way_down;
    let norm = length(way);
    let direction = way / norm;
    let slope = direction * params.per_world;
    let divisor = select(slope, vec3(1e-20), abs(slope) < vec3(1e-20));
    let below = (vec3(-0.5) - start) / divisor;
    let above = (vec3<f32>(params.size) - 0.5 - start) / divisor;
    let enters = min(below, above);
    let leaves = max(below, above);
    let along = nonzero(dot(direction, c.axis));
    let base = c.base.x + q.x * c.base.y + q.y * c.base.z;
    return Line(
        start,
        direction,
        slope,
        max(max(enters.x, enters.y), max(enters.z, 0.0)),
        min(leaves.x, min(leaves.y, leaves.z)),
        base / along,
        c.spacing / along,
        norm,
    );
}

fn plane(l: Line, i: f32) -> f32 {
    return l.base + i * l.spacing;
}

// From where to where a ray is in a slab.
fn within(l: Line, slab: u32) -> vec2<f32> {
    let a = plane(l, f32(slab));
    let b = plane(l, f32(slab + 1u));
    return vec2(max(min(a, b), l.near), min(max(a, b), l.far));
}

// True where the brick of a position is empty.
fn empty(x: vec3<f32>) -> bool {
    if !SKIP { return false; }
    let nearest = clamp(x + 0.5, vec3(0.0), vec3<f32>(params.size - 1u));
    let bricks = (params.size + params.edge - 1u) / params.edge;
    return majorant[index(bricks, vec3<u32>(nearest) / params.edge)] == 0.0;
}

// Extinction in an interval.
fn dims(l: Line, interval: vec2<f32>) -> f32 {
    if !(interval.x < interval.y) { return 0.0; }
    let x = l.start + 0.5 * (interval.x + interval.y) * l.slope;
    if empty(x) { return 0.0; }
    let c = cell(params.size, params.held, x);
    let value = data_in(c);
    if value < HOLE || !kept(x, params.clips) { return 0.0; }
    return sample(x, 0.5 * (interval.y - interval.x) * l.slope, c, value).extinction;
}

fn front_at(p: vec2<u32>, channel: u32) -> f32 {
    let half = turn.half * params.texels.x * params.texels.y * CHANNELS;
    return fronts[half + (p.y * CHANNELS + channel) * params.texels.x + p.x];
}

// Blur of one slab: three by three texels, or every `step`th where they are too fine, with the variance of an even disk of the
// radius that (9) gives.
fn blurred(p: vec2<u32>, l: Line, interval: vec2<f32>, channel: u32) -> f32 {
    let own = front_at(p, channel);
    if !BLUR || !(interval.x < interval.y) { return own; }
    let depth = select(0.5 * (interval.x + interval.y) / l.norm, 1.0, PARALLEL);
    let variance = params.blur * (interval.y - interval.x);
    let size = max(params.texel * depth, vec2(1e-20));
    let wanted = min(variance / (size * size), vec2(1e12));
    let last = vec2<f32>(params.texels - 1u);
    let step = floor(min(sqrt(wanted + wanted), last)) + 1.0;
    let side = min(0.5 * wanted / (step * step), vec2(0.25));
    let low = vec2<u32>(max(vec2<f32>(p) - step, vec2(0.0)));
    let high = vec2<u32>(min(vec2<f32>(p) + step, last));
    var taps: array<f32, 9>;
    var brightest = own;
    for (var j = 0u; j < 3u; j++) {
        for (var i = 0u; i < 3u; i++) {
            let tap = vec2(select(select(high.x, p.x, i == 1u), low.x, i == 0u), select(select(high.y, p.y, j == 1u), low.y, j == 0u));
            let value = front_at(tap, channel);
            taps[3u * j + i] = value;
            brightest = max(brightest, value);
        }
    }
    var across: vec3<f32>;
    for (var j = 0u; j < 3u; j++) {
        let middle = taps[3u * j + 1u];
        across[j] = middle + side.x * ((taps[3u * j] - middle) + (taps[3u * j + 2u] - middle));
    }
    return clamp(across.y + side.y * ((across.x - across.y) + (across.z - across.y)), 0.0, brightest);
}

// 0 where the ray of a texel meets something opaque between two distances, 1 elsewhere.
fn passes(at: vec2<f32>, begin: f32, end: f32) -> f32 {
    let stops = (vec2(begin) < at) & (at <= vec2(end));
    return select(1.0, 0.0, any(stops));
}

@compute @workgroup_size(8, 8)
fn light(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id.xy >= params.texels) { return; }
    let l = line(params.light, (2.0 * vec2<f32>(id.xy) + 1.0) / vec2<f32>(params.texels) - 1.0);
    var arriving: vec3<f32>;
    for (var c = 0u; c < CHANNELS; c++) { arriving[c] = blurred(id.xy, l, within(l, turn.first), c); }
    let row = params.texels.x * CHANNELS;
    for (var k = 0u; k < turn.count; k++) {
        let slab = turn.first + k;
        let interval = within(l, slab);
        let length = max(interval.y - interval.x, 0.0);
        let before = clamp(plane(l, f32(slab) + 0.5) - interval.x, 0.0, length);
        let sigma = dims(l, interval);
        var ahead = 1.0;
        var through = 1.0;
        if OPAQUE {
            let at = meets[id.y * params.texels.x + id.x];
            // What light meets on its way to the first slab counts for that.
            let begin = select(plane(l, f32(slab)), 0.0, slab == 0u);
            ahead = passes(at, begin, plane(l, f32(slab) + 0.5));
            through = passes(at, begin, plane(l, f32(slab + 1u)));
        }
        for (var c = 0u; c < CHANNELS; c++) {
            let behind = through * arriving[c] * exp(-sigma * params.factors[c] * length);
            let middle = ahead * arriving[c] * exp(-sigma * params.factors[c] * before);
            layers[id.y * BATCH * row + (turn.layer + k) * row + c * params.texels.x + id.x] = max(middle, behind);
            arriving[c] = behind;
        }
    }
    let half = (1u - turn.half) * row * params.texels.y;
    for (var c = 0u; c < CHANNELS; c++) { fronts[half + id.y * row + c * params.texels.x + id.x] = arriving[c]; }
}

fn layer_at(p: vec2<u32>, k: u32, channel: u32) -> f32 {
    return layers[((p.y * BATCH + k) * CHANNELS + channel) * params.texels.x + p.x];
}

// Light that arrives at a position in the middle of layer k.
fn arriving_at(x: vec3<f32>, k: u32) -> vec3<f32> {
    let p = vec3(dot(params.row_x, x), dot(params.row_y, x), dot(params.row_z, x)) + params.shift;
    if !(p.z > 0.0) { return vec3(0.0); }
    let q = select(p.xy / p.z, p.xy, PARALLEL);
    let inside = clamp((params.inner - abs(q)) * (0.5 / FADE) + 0.5, vec2(0.0), vec2(1.0));
    let at = clamp((q + 1.0) * 0.5 * vec2<f32>(params.texels) - 0.5, vec2(0.0), vec2<f32>(params.texels - 1u));
    let first = min(vec2<u32>(at), params.texels - 2u);
    let f = at - vec2<f32>(first);
    var light: vec3<f32>;
    for (var c = 0u; c < CHANNELS; c++) {
        let above = mix(layer_at(first, k, c), layer_at(first + vec2(1u, 0u), k, c), f.x);
        let below = mix(layer_at(first + vec2(0u, 1u), k, c), layer_at(first + vec2(1u, 1u), k, c), f.x);
        light[c] = mix(above, below, f.y);
    }
    if CHANNELS == 1u { light = vec3(light.x); }
    return light * inside.x * inside.y;
}

// What one unit of a source adds to radiance at a position.
fn weight_at(n: u32, x: vec3<f32>) -> vec3<f32> {
    let source = sources[n];
    if source.kind == UNIFORM { return source.weight; }
    if source.kind == PHASE { return source.weight * phase(source.g, dot(source.direction, to_eye)); }
    let d = (x - source.position) / params.per_world;
    let cosine = dot(d, to_eye) / sqrt(max(dot(d, d), 1e-30));
    return source.weight * (falloff(d, source.direction, source.floor, source.outer, source.slope, source.cosine) * phase(source.g, cosine));
}

@compute @workgroup_size(8, 8)
fn eye(@builtin(global_invocation_id) id: vec3<u32>) {
    let pixel = id.xy + turn.corner;
    if any(pixel >= turn.end) { return; }
    var l = line(params.eye, (2.0 * vec2<f32>(pixel) + 1.0) / vec2<f32>(params.picture) - 1.0);
    to_eye = -l.direction;
    let state = 8u * (pixel.y * params.picture.x + pixel.x);
    l.far = min(l.far, rays[state + 7u]);
    var radiance = vec3(rays[state], rays[state + 1u], rays[state + 2u]);
    var through = vec3(rays[state + 3u], rays[state + 4u], rays[state + 5u]);
    for (var k = 0u; k < turn.count; k++) {
        let interval = within(l, turn.first + k);
        let ds = interval.y - interval.x;
        if !(ds > 0.0) { continue; }
        let x = l.start + 0.5 * (interval.x + interval.y) * l.slope;
        if empty(x) { continue; }
        let c = cell(params.size, params.held, x);
        let value = data_in(c);
        if value < HOLE || !kept(x, params.clips) { continue; }
        let o = sample(x, 0.5 * ds * l.slope, c, value);
        let sigma = o.extinction;
        var sigmas = vec3(sigma);
        if CHROMATIC { sigmas *= params.chromatic; }
        let alpha = 1.0 - exp(-sigmas * ds);
        var added = vec3(0.0);
        if GLOW { added = o.emission * select(vec3(ds), alpha / sigmas, sigmas > vec3(0.0)); }
        if sigma > 0.0 {
            var scattered = vec3(0.0);
            for (var n = 0u; n < SOURCES; n++) { scattered += weight_at(n, x); }
            if LIT { scattered += weight_at(SOURCES, x) * arriving_at(x, k); }
            if SHADE { scattered *= shading(x, sigma); }
            added += alpha * o.albedo * scattered;
        }
        if UNDER {
            radiance += through * added;
        } else {
            radiance = added + (1.0 - alpha) * radiance;
        }
        through *= 1.0 - alpha;
    }
    rays[state] = radiance.x;
    rays[state + 1u] = radiance.y;
    rays[state + 2u] = radiance.z;
    rays[state + 3u] = through.x;
    rays[state + 4u] = through.y;
    rays[state + 5u] = through.z;
}
