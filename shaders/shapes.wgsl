// Area lights: where a point is lit from, and where a ray meets them. Flat shapes and boxes are sampled evenly over the area that faces
// the point, per solid angle p = d²/(A |cos θ|); balls evenly over the cone that they fill, p = 1/(2π(1 − cos θ_max)),
// sin θ_max = R/d. Needs emitter.wgsl.

const RECTANGLE: u32 = 3u;
const DISK: u32 = 4u;
const RING: u32 = 5u;
const BOX: u32 = 6u;
const SPHERE: u32 = 7u;

// A flat piece of a light: its middle relative to the light's position, half edges, normal, and the area that is sampled, of a box that of
// all faces that face the point.
struct Face {
    middle: vec3<f32>,
    area: f32,
    u: vec3<f32>,
    v: vec3<f32>,
    normal: vec3<f32>,
    // Square of the radius of a ring's hole over its own.
    hole: f32,
}

fn flat_face(e: Emitter) -> Face {
    let hole = select(0.0, e.inner * e.inner, e.shape == RING);
    let edges = length(e.u) * length(e.v);
    let area = select(PI * edges * (1.0 - hole), 4.0 * edges, e.shape == RECTANGLE);
    return Face(vec3(0.0), area, e.u, e.v, e.axis, hole);
}

// Of a box: half edges, axes in columns, and where a point is along them.
struct Local {
    away: vec3<f32>,
    half: vec3<f32>,
    axes: mat3x3<f32>,
}

fn box_local(e: Emitter, point: vec3<f32>) -> Local {
    let half = vec3(length(e.u), length(e.v), e.radius);
    let axes = mat3x3<f32>(e.u / half.x, e.v / half.y, e.axis);
    return Local((point - e.position) * axes, half, axes);
}

// Areas of the faces of a box across each axis that face the point; 0 where none does.
fn facing_areas(l: Local) -> vec3<f32> {
    return select(vec3(0.0), 4.0 * l.half.yzx * l.half.zxy, abs(l.away) > l.half);
}

// The face of a box across an axis on one side; images stand upright on its sides.
fn box_face(l: Local, axis: u32, side: f32, area: f32) -> Face {
    let u = select(0u, 1u, axis == 0u);
    let v = select(2u, 1u, axis == 2u);
    var half = l.half;
    var axes = l.axes;
    return Face(side * half[axis] * axes[axis], area, half[u] * axes[u], half[v] * axes[v], side * axes[axis], 0.0);
}

// Factor on a flat light's radiance at a place along u and v, −1 to 1; the image's top row lies where v ends.
fn texel(e: Emitter, at: vec2<f32>) -> vec3<f32> {
    if e.image.y == 0u { return vec3(1.0); }
    let t = max(vec2(0.5 + 0.5 * at.x, 0.5 - 0.5 * at.y), vec2(0.0));
    let p = min(vec2<u32>(t * vec2<f32>(e.image.yz)), e.image.yz - 1u);
    let first = e.image.x + 3u * (p.y * e.image.y + p.x);
    return vec3(images[first], images[first + 1u], images[first + 2u]);
}

fn sample_face(e: Emitter, face: Face, point: vec3<f32>, at: vec2<f32>) -> LightSample {
    let way = e.position + face.middle + at.x * face.u + at.y * face.v - point;
    let square = dot(way, way);
    if square == 0.0 { return NO_SAMPLE; }
    let distance = sqrt(square);
    let direction = way / distance;
    let facing = -dot(direction, face.normal);
    if abs(facing) <= 1e-6 || (facing < 0.0 && e.two_sided == 0u) { return NO_SAMPLE; }
    return LightSample(direction, distance, e.radiance * texel(e, at), square / (face.area * abs(facing)), true);
}

// 1 − cos θ_max of a ball, by the squares of its distance and radius; without the difference, which would cancel.
fn ball_cap(square: f32, radius: f32) -> f32 {
    let sine = radius / square;
    return sine / (1.0 + sqrt(max(1.0 - sine, 0.0)));
}

fn sample_ball(e: Emitter, point: vec3<f32>, xi: vec3<f32>) -> LightSample {
    let way = e.position - point;
    let square = dot(way, way);
    let radius = e.radius * e.radius;
    if square <= radius { return NO_SAMPLE; }
    let cap = ball_cap(square, radius);
    let less = xi.x * cap;
    let cosine = 1.0 - less;
    let sine = sqrt(less * (2.0 - less));
    let axis = way / sqrt(square);
    var ab = basis(axis);
    let direction = sine * cos(TURN * xi.y) * ab[0] + sine * sin(TURN * xi.y) * ab[1] + cosine * axis;
    let distance = sqrt(square) * cosine - sqrt(max(radius - square * sine * sine, 0.0));
    let normal = (distance * direction - way) / e.radius;
    return LightSample(direction, distance, e.radiance * sky_radiance(e.image, normal), 1.0 / (TURN * cap), true);
}

fn sample_shape(e: Emitter, point: vec3<f32>, xi: vec3<f32>) -> LightSample {
    if e.shape == SPHERE { return sample_ball(e, point, xi); }
    if e.shape == BOX {
        let l = box_local(e, point);
        let areas = facing_areas(l);
        let total = areas.x + areas.y + areas.z;
        if total == 0.0 { return NO_SAMPLE; }
        // The last face at which something of the number is left.
        var pick = xi.z * total;
        var axis = 0u;
        for (var a = 0u; a < 3u; a++) {
            if areas[a] > 0.0 && pick >= 0.0 { axis = a; }
            pick -= areas[a];
        }
        let face = box_face(l, axis, select(-1.0, 1.0, l.away[axis] > 0.0), total);
        return sample_face(e, face, point, 2.0 * xi.xy - 1.0);
    }
    let face = flat_face(e);
    var at = 2.0 * xi.xy - 1.0;
    if e.shape != RECTANGLE {
        let r = sqrt(face.hole + xi.x * (1.0 - face.hole));
        at = r * vec2(cos(TURN * xi.y), sin(TURN * xi.y));
    }
    return sample_face(e, face, point, at);
}

fn hit_ball(e: Emitter, origin: vec3<f32>, direction: vec3<f32>) -> LightHit {
    let way = e.position - origin;
    let square = dot(way, way);
    let radius = e.radius * e.radius;
    let along = dot(way, direction);
    let across = way - along * direction;
    let aside = dot(across, across);
    if square <= radius || along <= 0.0 || aside > radius { return NO_HIT; }
    let distance = along - sqrt(radius - aside);
    let normal = (distance * direction - way) / e.radius;
    return LightHit(e.radiance * sky_radiance(e.image, normal), distance, 1.0 / (TURN * ball_cap(square, radius)), true);
}

fn hit_box(e: Emitter, origin: vec3<f32>, direction: vec3<f32>) -> LightHit {
    let l = box_local(e, origin);
    let slope = direction * l.axes;
    var entry = -FAR;
    var exit = FAR;
    var axis = 0u;
    for (var a = 0u; a < 3u; a++) {
        let near = -l.half[a] - l.away[a];
        let far = l.half[a] - l.away[a];
        if slope[a] == 0.0 {
            if near > 0.0 || far < 0.0 { return NO_HIT; }
            continue;
        }
        let t0 = near / slope[a];
        let t1 = far / slope[a];
        if min(t0, t1) > entry {
            entry = min(t0, t1);
            axis = a;
        }
        exit = min(exit, max(t0, t1));
    }
    if entry <= 0.0 || entry > exit { return NO_HIT; }
    let areas = facing_areas(l);
    let place = (l.away + entry * slope) / l.half;
    let at = vec2(place[select(0u, 1u, axis == 0u)], place[select(2u, 1u, axis == 2u)]);
    let pdf = entry * entry / ((areas.x + areas.y + areas.z) * max(abs(slope[axis]), 1e-6));
    return LightHit(e.radiance * texel(e, at), entry, pdf, true);
}

fn hit_shape(e: Emitter, origin: vec3<f32>, direction: vec3<f32>) -> LightHit {
    if e.shape == SPHERE { return hit_ball(e, origin, direction); }
    if e.shape == BOX { return hit_box(e, origin, direction); }
    let face = flat_face(e);
    let facing = -dot(direction, face.normal);
    if facing == 0.0 || (facing < 0.0 && e.two_sided == 0u) { return NO_HIT; }
    let distance = dot(origin - e.position, face.normal) / facing;
    if distance <= 0.0 { return NO_HIT; }
    let place = origin + distance * direction - e.position;
    let at = vec2(dot(place, face.u) / dot(face.u, face.u), dot(place, face.v) / dot(face.v, face.v));
    let r = dot(at, at);
    let inside = select(r <= 1.0 && r >= face.hole, all(abs(at) <= vec2(1.0)), e.shape == RECTANGLE);
    if !inside { return NO_HIT; }
    return LightHit(e.radiance * texel(e, at), distance, distance * distance / (face.area * max(abs(facing), 1e-6)), true);
}
