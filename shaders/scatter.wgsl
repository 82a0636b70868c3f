// How light goes on at a collision: phase functions, and surfaces that reflect as Ashikhmin & Shirley's Fresnel blend (2000):
// f = 28/(23π) R_d (1 − F₀)(1 − (1 − n·i/2)⁵)(1 − (1 − n·o/2)⁵) + (e + 1)/(8π) (n·h)^e F(h·i) / (h·i max(n·i, n·o)).

struct Lobe {
    // Albedo, or diffuse reflection.
    colour: vec3<f32>,
    specular: f32,
    // Unit, on the side of the viewer; 0 for the phase function.
    normal: vec3<f32>,
    facing: f32,
    // Blinn's; MATTE throws light back evenly (Lambert).
    exponent: f32,
}

// What goes on from a direction, a surface's cosine included, and the density with which samples go there.
struct Worth {
    f: vec3<f32>,
    pdf: f32,
}

const HENYEY_GREENSTEIN: u32 = 0u;
const MATTE: f32 = -1.0;

fn blinn_exponent(roughness: f32) -> f32 {
    let square = max(roughness, 0.03) * max(roughness, 0.03);
    return max(2.0 / (square * square) - 2.0, 0.0);
}

fn schlick_k(g: f32) -> f32 {
    return 1.55 * g - 0.55 * g * g * g;
}

// Density at the cosine between the ways before and after.
fn phase_density(kind: u32, g: f32, cosine: f32) -> f32 {
    if kind == HENYEY_GREENSTEIN {
        let base = max(1.0 + g * g - 2.0 * g * cosine, 1e-12);
        return (1.0 - g * g) / (2.0 * TURN * base * sqrt(base));
    }
    let k = schlick_k(g);
    let base = 1.0 - k * cosine;
    return (1.0 - k * k) / max(2.0 * TURN * base * base, 1e-12);
}

fn phase_cosine(kind: u32, g: f32, xi: f32) -> f32 {
    if kind == HENYEY_GREENSTEIN {
        if abs(g) > 1e-3 {
            let s = (1.0 - g * g) / (1.0 - g + 2.0 * g * xi);
            return clamp((1.0 + g * g - s * s) / (2.0 * g), -1.0, 1.0);
        }
        let c = 2.0 * xi - 1.0;
        return c + 1.5 * g * (1.0 - c * c);
    }
    let k = schlick_k(g);
    return clamp((2.0 * xi - 1.0 + k) / (2.0 * k * xi + 1.0 - k), -1.0, 1.0);
}

fn fifth(x: f32) -> f32 {
    let square = x * x;
    return square * square * x;
}

fn unit_or_zero(v: vec3<f32>) -> vec3<f32> {
    let square = dot(v, v);
    if square < 1e-30 { return vec3(0.0); }
    return v / sqrt(square);
}

fn lobe_value(lobe: Lobe, kind: u32, g: f32, way: vec3<f32>, to: vec3<f32>) -> Worth {
    if all(lobe.normal == vec3(0.0)) {
        let p = phase_density(kind, g, dot(way, to));
        return Worth(lobe.colour * p, p);
    }
    let i = dot(lobe.normal, to);
    if lobe.exponent == MATTE {
        let p = max(i, 0.0) / PI;
        return Worth(lobe.colour * p, p);
    }
    let o = -dot(lobe.normal, way);
    if i <= 0.0 || o <= 0.0 { return Worth(vec3(0.0), 0.0); }
    let halfway = unit_or_zero(to - way);
    let h = max(dot(lobe.normal, halfway), 1e-8);
    let c = max(dot(to, halfway), 1e-6);
    let fresnel = lobe.specular * (lobe.facing + (1.0 - lobe.facing) * fifth(1.0 - c));
    let lambert = 28.0 / (23.0 * PI) * (1.0 - lobe.facing);
    let matte = lambert * (1.0 - fifth(1.0 - 0.5 * i)) * (1.0 - fifth(1.0 - 0.5 * o));
    let highlight = (lobe.exponent + 1.0) / TURN * pow(h, lobe.exponent);
    let gloss = 0.25 * highlight * fresnel / (c * max(i, o));
    return Worth((matte * lobe.colour + gloss) * i, 0.5 * i / PI + 0.5 * highlight / (4.0 * c));
}

fn lobe_sample(lobe: Lobe, kind: u32, g: f32, way: vec3<f32>, xi: vec3<f32>) -> vec3<f32> {
    if all(lobe.normal == vec3(0.0)) { return about(way, phase_cosine(kind, g, xi.x), TURN * xi.y); }
    if xi.z < 0.5 || lobe.exponent == MATTE { return about(lobe.normal, sqrt(1.0 - xi.x), TURN * xi.y); }
    let halfway = about(lobe.normal, pow(1.0 - xi.x, 1.0 / (lobe.exponent + 1.0)), TURN * xi.y);
    return unit_or_zero(way - 2.0 * dot(way, halfway) * halfway);
}
