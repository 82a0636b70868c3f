// A light in one place, limited to a cone: irradiance in vacuum at world offset d per unit of radiant intensity. `slope` is
// 1/(inner − outer), the cosines between which the light fades; without a cone the axis is 0 and t = 1. `cosine` is 1 where it fades
// as t itself, as a flat surface does, else 0.

fn falloff(d: vec3<f32>, axis: vec3<f32>, radius_squared: f32, outer: f32, slope: f32, cosine: f32) -> f32 {
    let square = dot(d, d);
    let r = sqrt(max(square, 1e-30));
    let t = clamp((dot(d, axis) / r - outer) * slope, 0.0, 1.0);
    return mix(t * t * (3.0 - 2.0 * t), t, cosine) / max(square, radius_squared);
}
