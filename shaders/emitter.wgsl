// Light sources: sampling them, and meeting them. Positions are world lengths from value (0, 0, 0) of the data grid.
//
// Images are held one after another: red, green and blue of each pixel, row by row from the top; of an environment also the shares of
// rows, and of the pixels of each row.

struct Emitter {
    position: vec3<f32>,
    shape: u32,
    axis: vec3<f32>,
    radius: f32,
    u: vec3<f32>,
    inner: f32,
    v: vec3<f32>,
    edge: f32,
    radiance: vec3<f32>,
    slope: f32,
    // First value, width, height.
    image: vec3<u32>,
    share: f32,
    two_sided: u32,
    visible: u32,
}

const DISTANT: u32 = 0u;
const POINT: u32 = 1u;
const ENVIRONMENT: u32 = 2u;

const PI: f32 = 3.141592653589793;
const TURN: f32 = 6.283185307179586;
// Farther than anything.
const FAR: f32 = 3e38;

// A way from a point to a light: radiance is irradiance where pdf is 0. Nothing gets there where found is false.
struct LightSample {
    direction: vec3<f32>,
    distance: f32,
    radiance: vec3<f32>,
    pdf: f32,
    found: bool,
}

struct LightHit {
    radiance: vec3<f32>,
    distance: f32,
    pdf: f32,
    found: bool,
}

const NO_SAMPLE: LightSample = LightSample(vec3(0.0), 0.0, vec3(0.0), 0.0, false);
const NO_HIT: LightHit = LightHit(vec3(0.0), 0.0, 0.0, false);

// Two unit vectors that make a right-handed system with a unit vector (Duff et al. 2017).
fn basis(n: vec3<f32>) -> array<vec3<f32>, 2> {
    let s = select(1.0, -1.0, n.z < 0.0);
    let a = -1.0 / (s + n.z);
    let b = n.x * n.y * a;
    return array(vec3(1.0 + s * n.x * n.x * a, s * b, -s * n.x), vec3(b, s + n.y * n.y * a, -n.y));
}

// The unit direction at an angle from `axis`, given by its cosine and the azimuth about it.
fn about(axis: vec3<f32>, cosine: f32, azimuth: f32) -> vec3<f32> {
    let sine = sqrt(max(1.0 - cosine * cosine, 0.0));
    var ab = basis(axis);
    return sine * cos(azimuth) * ab[0] + sine * sin(azimuth) * ab[1] + cosine * axis;
}

// The pixel of an equirectangular image towards a unit direction.
fn sky_pixel(image: vec3<u32>, d: vec3<f32>) -> vec2<u32> {
    let u = 0.5 + atan2(d.x, d.y) / TURN;
    let v = acos(clamp(d.z, -1.0, 1.0)) / PI;
    return min(vec2<u32>(vec2(u, v) * vec2<f32>(image.yz)), image.yz - 1u);
}

fn sky_radiance(image: vec3<u32>, d: vec3<f32>) -> vec3<f32> {
    if image.y == 0u { return vec3(1.0); }
    let p = sky_pixel(image, d);
    let at = image.x + 3u * (p.y * image.y + p.x);
    return vec3(images[at], images[at + 1u], images[at + 2u]);
}

// A cumulative share, 0 before the first.
fn share_before(first: u32, i: u32) -> f32 {
    if i == 0u { return 0.0; }
    return images[first + i - 1u];
}

fn sky_density(image: vec3<u32>, p: vec2<u32>) -> f32 {
    let rows = image.x + 3u * image.y * image.z;
    let row = rows + image.z + p.y * image.y;
    let solid = TURN / f32(image.y) * max(cos(PI * f32(p.y) / f32(image.z)) - cos(PI * f32(p.y + 1u) / f32(image.z)), 1e-12);
    let of_row = images[rows + p.y] - share_before(rows, p.y);
    return of_row * (images[row + p.x] - share_before(row, p.x)) / solid;
}

// The first of `n` cumulative shares that exceeds a number.
fn find_share(first: u32, n: u32, xi: f32) -> u32 {
    var low = 0u;
    var high = n - 1u;
    while low < high {
        let middle = (low + high) / 2u;
        if images[first + middle] <= xi { low = middle + 1u; } else { high = middle; }
    }
    return low;
}

fn within_share(first: u32, i: u32, xi: f32) -> f32 {
    let before = share_before(first, i);
    return clamp((xi - before) / max(images[first + i] - before, 1e-12), 0.0, 1.0);
}

// A direction by the power of an image's pixels.
fn sky_direction(image: vec3<u32>, xi: vec3<f32>) -> vec4<f32> {
    let rows = image.x + 3u * image.y * image.z;
    let y = find_share(rows, image.z, xi.x);
    let row = rows + image.z + y * image.y;
    let x = find_share(row, image.y, xi.y);
    let above = cos(PI * f32(y) / f32(image.z));
    let below = cos(PI * f32(y + 1u) / f32(image.z));
    let z = above + within_share(rows, y, xi.x) * (below - above);
    let azimuth = TURN * ((f32(x) + within_share(row, x, xi.y)) / f32(image.y) - 0.5);
    let side = sqrt(max(1.0 - z * z, 0.0));
    return vec4(side * sin(azimuth), side * cos(azimuth), z, sky_density(image, vec2(x, y)));
}

fn sample_lamp(e: Emitter, point: vec3<f32>, xi: vec3<f32>) -> LightSample {
    let r = sqrt(xi.x);
    let angle = TURN * xi.y;
    let ball = vec3(r * cos(angle), r * sin(angle), sqrt(max(1.0 - xi.x, 0.0)) * cos(TURN * xi.z));
    let way = e.position + e.radius * ball - point;
    let square = dot(way, way);
    let distance = sqrt(square);
    var direction = vec3(0.0, 0.0, 1.0);
    if distance > 0.0 { direction = way / distance; }
    let t = clamp((-dot(direction, e.axis) - e.edge) * e.slope, 0.0, 1.0);
    let falloff = t * t * (3.0 - 2.0 * t) / max(max(square, e.radius * e.radius), 1e-37);
    return LightSample(direction, distance, falloff * e.radiance, 0.0, falloff > 0.0);
}

fn sample_emitter(e: Emitter, point: vec3<f32>, xi: vec3<f32>) -> LightSample {
    if e.shape == DISTANT {
        if e.edge >= 1.0 { return LightSample(-e.axis, FAR, e.radiance, 0.0, true); }
        let cap = 1.0 - e.edge;
        return LightSample(about(-e.axis, 1.0 - xi.x * cap, TURN * xi.y), FAR, e.radiance, 1.0 / max(TURN * cap, 1e-12), true);
    }
    if e.shape == POINT { return sample_lamp(e, point, xi); }
    if e.shape == ENVIRONMENT {
        var to = vec4(about(vec3(0.0, 0.0, 1.0), 1.0 - 2.0 * xi.x, TURN * xi.y), 0.25 / PI);
        if e.image.y > 0u { to = sky_direction(e.image, xi); }
        return LightSample(to.xyz, FAR, e.radiance * sky_radiance(e.image, to.xyz), to.w, true);
    }
    return sample_shape(e, point, xi);
}

fn hit_emitter(e: Emitter, origin: vec3<f32>, direction: vec3<f32>) -> LightHit {
    if e.shape == DISTANT && e.edge < 1.0 && -dot(direction, e.axis) >= e.edge {
        return LightHit(e.radiance, FAR, 1.0 / max(TURN * (1.0 - e.edge), 1e-12), true);
    }
    if e.shape == ENVIRONMENT {
        var pdf = 0.25 / PI;
        if e.image.y > 0u { pdf = sky_density(e.image, sky_pixel(e.image, direction)); }
        return LightHit(e.radiance * sky_radiance(e.image, direction), FAR, pdf, true);
    }
    if e.shape > ENVIRONMENT { return hit_shape(e, origin, direction); }
    return NO_HIT;
}
