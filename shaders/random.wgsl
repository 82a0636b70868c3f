// Numbers without pattern that depend on nothing but their counters: hashes (hash.wgsl), and sequences of points by
// multiples of 2³²/g, 2³²/g², 2³²/g³ with g⁴ = g + 1 (Roberts 2018). The same integers as src/device/random.rs.

const TAU: f32 = 6.283185307179586;

// Point i of the sequence that begins at `origin`.
fn point(origin: vec4<u32>, i: u32) -> vec3<f32> {
    return unit(origin.xyz + i * vec3(3518319155u, 2882110345u, 2360945575u));
}

// The unit direction at an angle from `axis` with this cosine, `turn` of a full turn round it (basis: Duff et al. 2017).
fn about(axis: vec3<f32>, cosine: f32, turn: f32) -> vec3<f32> {
    let side = select(1.0, -1.0, axis.z < 0.0);
    let a = -1.0 / (side + axis.z);
    let b = axis.x * axis.y * a;
    let first = vec3(1.0 + side * axis.x * axis.x * a, side * b, -side * axis.x);
    let second = vec3(b, side + axis.y * axis.y * a, -axis.y);
    let sine = sqrt(max(0.0, 1.0 - cosine * cosine));
    return sine * cos(TAU * turn) * first + sine * sin(TAU * turn) * second + cosine * axis;
}

// Draw i of the unit sphere by rejection.
fn sphere(stream: vec3<u32>, i: u32) -> vec3<f32> {
    var way = vec3(1.0, 0.0, 0.0);
    for (var attempt = 0u; attempt < 16u; attempt++) {
        let triplet = 2.0 * unit(pcg4d(vec4(stream, 16u * i + attempt)).xyz) - 1.0;
        let square = dot(triplet, triplet);
        if square > 1e-12 {
            way = triplet / sqrt(square);
            if square <= 1.0 { break; }
        }
    }
    return way;
}
