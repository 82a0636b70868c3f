// Random numbers without a state: the hash pcg4d (hash.wgsl) of pixel, sample, count and seed; pairs from Sobol's sequence,
// Owen-scrambled by Laine & Karras's hash with Vegdahl's constants. The same integers as on the CPU.

fn scramble(y: u32, seed: u32) -> u32 {
    var x = reverseBits(y);
    x ^= x * 0x3d20adeau;
    x += seed;
    x *= (seed >> 16u) | 1u;
    x ^= x * 0x05526c56u;
    x ^= x * 0x53a22864u;
    return reverseBits(x);
}

// The second dimension of Sobol's sequence: Pascal's triangle modulo 2.
fn pascal(y: u32) -> u32 {
    var x = y;
    x ^= (x >> 16u) & 0x0000ffffu;
    x ^= (x >> 8u) & 0x00ff00ffu;
    x ^= (x >> 4u) & 0x0f0f0f0fu;
    x ^= (x >> 2u) & 0x33333333u;
    x ^= (x >> 1u) & 0x55555555u;
    return reverseBits(x);
}

// Pixel, sample, seed and count of the path at hand, and the hashes that are not used up.
var<private> number_key: vec3<u32>;
var<private> number_count: u32;
var<private> number_block: vec4<u32>;

fn begin_numbers(pixel: u32, sample: u32, seed: u32) {
    number_key = vec3(pixel, sample, seed);
    number_count = 0u;
}

// The next independent number.
fn next_number() -> f32 {
    let at = number_count & 3u;
    if at == 0u {
        number_block = pcg4d(vec4(number_key.xy, number_count >> 2u, number_key.z));
    }
    number_count++;
    return unit(vec3(number_block[at])).x;
}

// A pair that is spread evenly over the samples of the pixel.
fn number_pair(dimension: u32) -> vec2<f32> {
    let seeds = pcg4d(vec4(number_key.x, ~dimension, 0x5bd1e995u, number_key.z));
    let i = scramble(number_key.y, seeds.x);
    return unit(vec3(scramble(reverseBits(i), seeds.y), scramble(pascal(i), seeds.z), 0u)).xy;
}
