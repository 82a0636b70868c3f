// Where the medium is kept: between two corners, or where a · x ≥ b.x, in index space.

struct Clip {
    a: vec3<f32>,
    plane: u32,
    b: vec3<f32>,
    invert: u32,
}

// True where the first `count` of `clips` keep the medium.
fn kept(position: vec3<f32>, count: u32) -> bool {
    for (var c = 0u; c < count; c++) {
        let clip = clips[c];
        var inside = all(position >= clip.a) && all(position <= clip.b);
        if clip.plane == 1u { inside = dot(clip.a, position) >= clip.b.x; }
        if inside == (clip.invert == 1u) { return false; }
    }
    return true;
}
