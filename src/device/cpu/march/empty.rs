//! Empty space: how many bricks a ray may cross at once (Chebyshev distance maps, Deakin & Knoll 2019).

use crate::grid::BrickLayout;

/// For each brick, the Chebyshev distance in bricks to the nearest brick in which something can be seen: 0 in such a brick;
/// `d > 0` says that the cube of bricks closer than `d` is empty.
pub(in crate::device::cpu) struct Distances {
    /// `(z, y, x)`, like the bricks.
    pub values: Vec<f32>,
    /// Bricks from one row, and from one slice, to the next.
    pub stride: [usize; 2],
    /// Values along the edge of a brick.
    pub edge: f32,
    /// Its reciprocal.
    pub per_edge: f32,
}

impl Distances {
    /// Empty space farther away than this many bricks is crossed in several jumps.
    const FARTHEST: usize = 32;

    /// `None` when nothing can be skipped.
    pub fn new(bricks: &BrickLayout, majorant: &[f32]) -> Option<Self> {
        if majorant.iter().all(|&m| m > 0.0) {
            return None;
        }
        let counts = bricks.counts();
        assert_eq!(majorant.len(), bricks.len(), "one majorant per brick");
        let mut values: Vec<f32> =
            majorant.iter().map(|&m| if m > 0.0 { 0.0 } else { Self::FARTHEST as f32 }).collect();
        let mut line = vec![0.0; counts.into_iter().max().unwrap_or(0)];
        let mut stride = 1;
        for count in counts {
            for start in (0..values.len()).filter(|i| i / stride % count == 0) {
                let line = &mut line[..count];
                for (k, v) in line.iter_mut().enumerate() {
                    *v = values[start + k * stride];
                }
                for k in 0..count {
                    let mut nearest = line[k];
                    let mut reach = 1;
                    while (reach as f32) < nearest && (reach <= k || k + reach < count) {
                        let below = k.checked_sub(reach).map_or(nearest, |i| line[i]);
                        let above = line.get(k + reach).copied().unwrap_or(nearest);
                        nearest = nearest.min(below.min(above).max(reach as f32));
                        reach += 1;
                    }
                    values[start + k * stride] = nearest;
                }
            }
            stride *= count;
        }
        let edge = bricks.edge as f32;
        Some(Distances { values, stride: [counts[0], counts[0] * counts[1]], edge, per_edge: 1.0 / edge })
    }

    pub fn as_ptr(&self) -> *const f32 {
        self.values.as_ptr()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn distances_are_those_of_a_search(
            counts in [1usize..9, 1usize..9, 1usize..9],
            seen in proptest::collection::vec(0usize..512, 0..6),
        ) {
            let bricks = BrickLayout::new(counts.map(|n| 4 * n), 4);
            let mut majorant = vec![0.0; bricks.len()];
            seen.iter().for_each(|s| majorant[s % bricks.len()] = 1.0);
            let Some(distances) = Distances::new(&bricks, &majorant) else { return Ok(()) };
            for b in 0..bricks.len() {
                let at = bricks.coords(b);
                let nearest = (0..bricks.len())
                    .filter(|&o| majorant[o] > 0.0)
                    .map(|o| (0..3).map(|a| at[a].abs_diff(bricks.coords(o)[a])).max().unwrap())
                    .min()
                    .unwrap_or(Distances::FARTHEST);
                prop_assert_eq!(distances.values[b], nearest as f32);
            }
        }
    }
}
