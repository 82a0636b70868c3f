// Diffusion with mirrors at the faces (Zhang & Ma 2013, (23)), exact in time, along one axis:
// out(i) = w₀ v(i) + Σ w_n (v(i−n) + v(i+n)), indices reflected (−1 is 0).
// values, weights → out

struct Params {
    size: vec3<u32>,
    axis: u32,
    radius: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> values: array<f32>;
@group(0) @binding(2) var<storage, read> weights: array<f32>;
@group(0) @binding(3) var<storage, read_write> out: array<f32>;

fn reflected(i: i32, n: i32) -> u32 {
    let period = 2 * n;
    let j = ((i % period) + period) % period;
    return u32(select(period - 1 - j, j, j < n));
}

@compute @workgroup_size(8, 8)
fn diffuse(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id >= params.size) { return; }
    let here = index(params.size, id);
    let n = i32(params.size[params.axis]);
    let i = i32(id[params.axis]);
    var low = id;
    var high = id;
    var sum = weights[0] * values[here];
    for (var r = 1; r <= i32(params.radius); r++) {
        low[params.axis] = reflected(i - r, n);
        high[params.axis] = reflected(i + r, n);
        sum += weights[r] * (values[index(params.size, low)] + values[index(params.size, high)]);
    }
    out[here] = sum;
}
