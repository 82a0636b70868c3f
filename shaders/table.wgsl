// A transfer function: entry i of n stands for the normalised value i/(n − 1), linear in between, clamped outside.
// A value below HOLE is no data.

const HOLE: f32 = -1e30;

// Position of a data value in a table of n entries: entry below and fraction.
struct Entry {
    below: u32,
    fraction: f32,
}

fn entry(value: f32, lo: f32, scale: f32, n: u32) -> Entry {
    let x = clamp((value - lo) * scale, 0.0, 1.0) * f32(n - 1u);
    let below = min(u32(x), max(n, 2u) - 2u);
    return Entry(below, x - f32(below));
}
