// What samples of data look like: data, gradient, table, sums, and fields of `params` of the same names in every kernel.

const FOUR_PI: f32 = 12.566370614359172;

// Whether the table is two-dimensional; whether samples take means over values (pre-integration).
override GRADED: bool = false;
override MEANS: bool = false;

var<private> to_eye: vec3<f32>;

// The eight values round a position, x fastest, and their trilinear weights.
struct Cell {
    low: vec4<u32>,
    high: vec4<u32>,
    low_weight: vec4<f32>,
    high_weight: vec4<f32>,
}

fn cell(size: vec3<u32>, held: vec2<u32>, position: vec3<f32>) -> Cell {
    let first = vec3(0u, 0u, held.x);
    let last = vec3(size.xy - 1u, held.y);
    let p = clamp(position, vec3<f32>(first), vec3<f32>(last));
    let base = min(vec3<u32>(p), max(last, vec3(1u)) - 1u);
    let f = p - vec3<f32>(base);
    let reach = min(vec3(1u), size - 1u);
    let i = index(size, base - first);
    let row = reach.y * size.x;
    let layer = reach.z * size.x * size.y;
    let low = vec4(i, i + reach.x, i + row, i + row + reach.x);
    let across = vec4((1.0 - f.x) * (1.0 - f.y), f.x * (1.0 - f.y), (1.0 - f.x) * f.y, f.x * f.y);
    return Cell(low, low + layer, (1.0 - f.z) * across, f.z * across);
}

fn data_in(c: Cell) -> f32 {
    return dot(vec4(field[c.low.x], field[c.low.y], field[c.low.z], field[c.low.w]), c.low_weight)
        + dot(vec4(field[c.high.x], field[c.high.y], field[c.high.z], field[c.high.w]), c.high_weight);
}

fn data(position: vec3<f32>) -> f32 {
    return data_in(cell(params.size, params.held, position));
}

fn gradient_in(c: Cell) -> f32 {
    if !GRADED { return 0.0; }
    return dot(vec4(gradient[c.low.x], gradient[c.low.y], gradient[c.low.z], gradient[c.low.w]), c.low_weight)
        + dot(vec4(gradient[c.high.x], gradient[c.high.y], gradient[c.high.z], gradient[c.high.w]), c.high_weight);
}

// Single-scattering properties of a table entry.
struct Optics {
    albedo: vec3<f32>,
    extinction: f32,
    emission: vec3<f32>,
}

// Integrals over the entries before each, of extinction times albedo, extinction and emission.
struct Sums {
    scattering: vec3<f32>,
    extinction: f32,
    emission: vec3<f32>,
}

fn mixed(a: Optics, b: Optics, f: f32) -> Optics {
    return Optics(mix(a.albedo, b.albedo, f), mix(a.extinction, b.extinction, f), mix(a.emission, b.emission, f));
}

// Of a value and a gradient magnitude.
fn optics(value: f32, steepness: f32) -> Optics {
    let e = entry(value, params.lo, params.scale, params.entries);
    if !GRADED { return mixed(table[e.below], table[e.below + 1u], e.fraction); }
    let at = clamp(steepness * params.steep, 0.0, f32(params.rows - 1u));
    let row = min(u32(at), params.rows - 2u);
    let i = row * params.entries + e.below;
    let a = mixed(table[i], table[i + 1u], e.fraction);
    let b = mixed(table[i + params.entries], table[i + params.entries + 1u], e.fraction);
    let f = at - f32(row);
    return Optics(a.albedo + f * (b.albedo - a.albedo), a.extinction + f * (b.extinction - a.extinction), a.emission + f * (b.emission - a.emission));
}

// Integrals up to a value; beyond the table it goes on as at its end.
fn integral(value: f32) -> Sums {
    let last = f32(params.entries - 1u);
    let exact = (value - params.lo) * params.scale * last;
    let e = entry(value, params.lo, params.scale, params.entries);
    let at = clamp(exact, 0.0, last);
    let f = e.fraction;
    let beyond = exact - at;
    let a = table[e.below];
    let b = table[e.below + 1u];
    let below = sums[e.below];
    let scattered = a.extinction * a.albedo;
    let s = mix(scattered, b.extinction * b.albedo, f);
    let x = mix(a.extinction, b.extinction, f);
    let j = mix(a.emission, b.emission, f);
    return Sums(
        below.scattering + 0.5 * (scattered + s) * f + beyond * s,
        below.extinction + 0.5 * (a.extinction + x) * f + beyond * x,
        below.emission + 0.5 * (a.emission + j) * f + beyond * j,
    );
}

// A value, or `instead` where it is a hole.
fn unless_hole(value: f32, instead: f32) -> f32 {
    return select(value, instead, value < HOLE);
}

// Of the interval `half` to both sides of x, whose middle lies in a cell and has a value that is no hole.
fn sample(x: vec3<f32>, half: vec3<f32>, c: Cell, value: f32) -> Optics {
    let plain = optics(value, gradient_in(c));
    if !MEANS { return plain; }
    let a = unless_hole(data(x - half), value);
    let b = unless_hole(data(x + half), value);
    let entries = abs(b - a) * params.scale * f32(params.entries - 1u);
    // Within one entry's width the middle is the mean, and differences of integrals are rounding.
    if !(entries > 1.0) { return plain; }
    let low = integral(min(a, b));
    let high = integral(max(a, b));
    let extinction = max((high.extinction - low.extinction) / entries, 0.0);
    let scattering = max((high.scattering - low.scattering) / entries, vec3(0.0));
    let emission = max((high.emission - low.emission) / entries, vec3(0.0));
    return Optics(min(scattering / max(extinction, 1e-30), vec3(1.0)), extinction, emission);
}

fn phase(g: f32, cosine: f32) -> f32 {
    let base = 1.0 + g * g - 2.0 * g * cosine;
    return (1.0 - g * g) / (FOUR_PI * base * sqrt(base));
}

// Extinction at a position; 0 in holes.
fn extinction(x: vec3<f32>) -> f32 {
    let c = cell(params.size, params.held, x);
    let value = data_in(c);
    if value < HOLE { return 0.0; }
    return optics(value, gradient_in(c)).extinction;
}

// Blinn–Phong by the gradient of extinction, gated by its magnitude (Zhang & Ma 2013 (24)).
fn shading(x: vec3<f32>, sigma: f32) -> f32 {
    let gradient = 0.5 * params.per_world * vec3(
        extinction(x + vec3(1.0, 0.0, 0.0)) - extinction(x - vec3(1.0, 0.0, 0.0)),
        extinction(x + vec3(0.0, 1.0, 0.0)) - extinction(x - vec3(0.0, 1.0, 0.0)),
        extinction(x + vec3(0.0, 0.0, 1.0)) - extinction(x - vec3(0.0, 0.0, 1.0)),
    );
    let magnitude = length(gradient);
    if magnitude == 0.0 { return 1.0; }
    let normal = -gradient / magnitude;
    let gate = magnitude * params.spacing / (magnitude * params.spacing + sigma);
    let halfway = normalize(params.towards_light + to_eye);
    let shade = params.ambient + params.diffuse * max(0.0, dot(normal, params.towards_light))
        + params.specular * pow(max(0.0, dot(normal, halfway)), params.shininess);
    return 1.0 + gate * (shade - 1.0);
}
