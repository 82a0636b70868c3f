// Bricks: brick b starts at `edge` times its coordinates; the last one along an axis may be smaller.

struct Brick {
    start: vec3<u32>,
    end: vec3<u32>,
}

fn brick(size: vec3<u32>, edge: u32, number: u32) -> Brick {
    let counts = (size + edge - 1u) / edge;
    let coords = vec3(number % counts.x, number / counts.x % counts.y, number / (counts.x * counts.y));
    return Brick(coords * edge, min(coords * edge + edge, size));
}

// The brick with a halo of one value, clipped to the grid.
fn haloed(size: vec3<u32>, edge: u32, number: u32) -> Brick {
    let b = brick(size, edge, number);
    return Brick(max(b.start, vec3(1u)) - 1u, min(b.end + 1u, size));
}
