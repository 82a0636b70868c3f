// PCG4D (Jarzynski & Olano 2020, "Hash Functions for GPU Rendering"). The same integers as src/device/random.rs.

fn pcg4d(counters: vec4<u32>) -> vec4<u32> {
    var v = counters * 1664525u + 1013904223u;
    v.x += v.y * v.w;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    v.w += v.y * v.z;
    v ^= v >> vec4(16u);
    v.x += v.y * v.w;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    v.w += v.y * v.z;
    return v;
}

// In 0..1, 1 excluded, of 24 bits.
fn unit(bits: vec3<u32>) -> vec3<f32> {
    return vec3<f32>(bits >> vec3(8u)) * (1.0 / 16777216.0);
}
