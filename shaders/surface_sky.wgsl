// The environment: octahedral maps (Cigolle et al. 2014) with a border of one texel, bilinear.

// RGB of each texel of the maps, one map after another.
@group(0) @binding(7) var<storage, read> texels: array<f32>;

fn texel(first: u32, edge: u32, x: u32, y: u32) -> vec3<f32> {
    let i = 3u * (first + y * (edge + 2u) + x);
    return vec3(texels[i], texels[i + 1u], texels[i + 2u]);
}

fn sky(map: vec2<u32>, way: vec3<f32>) -> vec3<f32> {
    let edge = f32(map.y);
    var p = way.xy / (abs(way.x) + abs(way.y) + abs(way.z));
    if way.z < 0.0 { p = (1.0 - abs(p.yx)) * select(vec2(-1.0), vec2(1.0), p >= vec2(0.0)); }
    let q = (0.5 * p + 0.5) * edge + 0.5;
    let base = vec2<u32>(clamp(q, vec2(0.0), vec2(edge)));
    let f = q - vec2<f32>(base);
    let top = texel(map.x, map.y, base.x, base.y) * (1.0 - f.x) + texel(map.x, map.y, base.x + 1u, base.y) * f.x;
    let bottom =
        texel(map.x, map.y, base.x, base.y + 1u) * (1.0 - f.x) + texel(map.x, map.y, base.x + 1u, base.y + 1u) * f.x;
    return top * (1.0 - f.y) + bottom * f.y;
}
