//! A volume at points: `Σ weight·value` over the eight values round each, trilinear, positions clamped to the outermost values.

use rayon::prelude::*;

/// reads values, points → writes the values there. `size` is that of the volume; a point is (x, y, z) in its index space.
pub(crate) fn sample(size: [usize; 3], values: &[f32], points: &[[f32; 3]], out: &mut [f32]) {
    assert_eq!(points.len(), out.len(), "a value for each point");
    out.par_iter_mut().zip(points).with_min_len(1 << 10).for_each(|(out, point)| *out = at(size, values, *point));
}

fn at(size: [usize; 3], values: &[f32], point: [f32; 3]) -> f32 {
    let (mut first, mut next, mut upper) = ([0; 3], [0; 3], [0.0; 3]);
    for a in 0..3 {
        let last = size[a] - 1;
        // `max` first: it turns a NaN into a number.
        let clamped = point[a].max(0.0).min(last as f32);
        first[a] = (clamped as usize).min(last.saturating_sub(1));
        next[a] = (first[a] + 1).min(last);
        upper[a] = clamped - first[a] as f32;
    }
    let value = |i: usize, j: usize, k: usize| values[(k * size[1] + j) * size[0] + i];
    let row = |j, k| value(first[0], j, k) * (1.0 - upper[0]) + value(next[0], j, k) * upper[0];
    let plane = |k| row(first[1], k) * (1.0 - upper[1]) + row(next[1], k) * upper[1];
    plane(first[2]) * (1.0 - upper[2]) + plane(next[2]) * upper[2]
}
