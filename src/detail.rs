//! Procedural detail: noise finer than the data (GPU Gems, chapter 39, section 39.5.2).
//!
//! The values v of a step become, on a grid finer by `refine`,
//!
//! ```text
//! v'(x) = b + (v(x + w·n⃗(x, t)) − b)·max(0, 1 + a·n₀(x, t)),      n = Σ_o g^o N(2^o (x − d_o t)/s) / √Σ g^2o,   d_o = d (1 + o/2)
//! ```
//!
//! with the keys of `[noise]`: amplitude a about the value b, warp w, scale s, octaves o with gain g, drift d. N are the four channels of
//! one small volume of noise that repeats itself, of mean 0 and variance 1, cut off at three standard deviations.
//!
//! Both ways of the chapter are here: what scales values changes the optical properties, what shifts the lookup changes the shape. They
//! work on the *data*, before anything is classified, so that light, shadows and every renderer see the same, on any device, in memory
//! or a slab at a time, without a kernel that knows of noise. Its price is the finer grid.

use std::sync::Arc;

use noise::{NoiseFn, Perlin};
use rayon::prelude::*;

use crate::error::Result;
use crate::field::{EMPTY, Field, HOLE, Timestep};
use crate::grid::{Grid, Region};
use crate::scene::NoiseKeys;

/// Samples along an edge of the volume of noise: a power of two.
const EDGE: usize = 64;

/// Features along an edge: four samples each, so that linear interpolation between them shows no corners.
const FEATURES: f64 = 16.0;

/// Noise is cut off here, in standard deviations, so that a lookup is shifted by no more than is read.
const MOST: f32 = 3.0;

/// Refined values in hand at a time, so that few of the data are.
const SLAB: usize = 4 << 20;

/// A volume of noise that repeats itself.
struct Tile(Vec<[f32; 4]>);

impl Tile {
    /// Perlin noise N made periodic, `Σ w_c N(x − c·P) / √Σ w_c²` over the eight corners c of a period P with trilinear weights w, which
    /// keeps the variance the same everywhere.
    fn new(seed: u32) -> Tile {
        let channels: [Perlin; 4] = std::array::from_fn(|c| Perlin::new(seed.wrapping_mul(4).wrapping_add(c as u32)));
        let mut values = vec![[0.0f32; 4]; EDGE * EDGE * EDGE];
        values.par_chunks_mut(EDGE).enumerate().for_each(|(row, out)| {
            let (j, k) = (row % EDGE, row / EDGE);
            for (i, out) in out.iter_mut().enumerate() {
                let part = [i, j, k].map(|n| n as f64 / EDGE as f64);
                let (mut sums, mut squares) = ([0.0; 4], 0.0);
                for corner in 0..8 {
                    let past: [bool; 3] = std::array::from_fn(|a| corner >> a & 1 == 1);
                    let weight: f64 = (0..3).map(|a| if past[a] { part[a] } else { 1.0 - part[a] }).product();
                    // Off the lattice, where Perlin noise is 0.
                    let at: [f64; 3] =
                        std::array::from_fn(|a| FEATURES * (part[a] - if past[a] { 1.0 } else { 0.0 }) + 0.37);
                    squares += weight * weight;
                    if weight > 0.0 {
                        (0..4).for_each(|c| sums[c] += weight * channels[c].get(at));
                    }
                }
                *out = sums.map(|s| (s / f64::sqrt(squares)) as f32);
            }
        });
        let count = values.len() as f64;
        for c in 0..4 {
            let mean = values.iter().map(|v| f64::from(v[c])).sum::<f64>() / count;
            let variance = values.iter().map(|v| (f64::from(v[c]) - mean).powi(2)).sum::<f64>() / count;
            let scale = 1.0 / variance.sqrt();
            values.iter_mut().for_each(|v| v[c] = ((f64::from(v[c]) - mean) * scale) as f32);
        }
        Tile(values)
    }

    /// The noise at a position in periods, trilinear.
    fn at(&self, position: [f64; 3]) -> [f32; 4] {
        let mut first = [0; 3];
        let mut upper = [0.0f32; 3];
        for a in 0..3 {
            let at = (position[a] - position[a].floor()) * EDGE as f64;
            first[a] = at as usize;
            upper[a] = (at - first[a] as f64) as f32;
        }
        let mut sum = [0.0; 4];
        for corner in 0..8 {
            let (mut index, mut weight) = (0, 1.0);
            for a in (0..3).rev() {
                let past = corner >> a & 1;
                index = index * EDGE + (first[a] + past) % EDGE;
                weight *= if past == 1 { upper[a] } else { 1.0 - upper[a] };
            }
            let value = self.0[index];
            (0..4).for_each(|c| sum[c] += weight * value[c]);
        }
        sum
    }
}

/// Gives steps their detail.
#[derive(Clone)]
pub struct Detail {
    keys: NoiseKeys,
    tile: Arc<Tile>,
}

impl Detail {
    /// What `[noise]` asks for; `None` where it leaves the data as they are.
    pub fn new(keys: &NoiseKeys) -> Option<Detail> {
        let wanted = keys.amplitude > 0.0 || keys.warp > 0.0;
        wanted.then(|| Detail { keys: keys.clone(), tile: Arc::new(Tile::new(keys.seed)) })
    }

    /// The grid that steps on `grid` have with detail.
    pub fn grid(keys: &NoiseKeys, grid: &Grid) -> Grid {
        let refine = if keys.amplitude > 0.0 || keys.warp > 0.0 { keys.refine } else { 1 };
        if refine == 1 { *grid } else { grid.resized(grid.size.map(|n| n.saturating_mul(refine))) }
    }

    /// A step with detail. The field is computed as it is read; without a time, the step's number counts.
    pub fn apply(&self, step: &Timestep) -> Timestep {
        let grid = Detail::grid(&self.keys, &step.grid);
        let time = step.time.unwrap_or(step.step as f64);
        let field = Arc::new(Detailed { detail: self.clone(), of: step.field.clone(), data: step.grid, grid, time });
        Timestep { grid, field, ..*step }
    }

    /// The noise at a world position.
    fn noise(&self, x: [f64; 3], size: f64, time: f64) -> [f32; 4] {
        let NoiseKeys { octaves, gain, drift, .. } = self.keys;
        let (mut sum, mut strength, mut squares, mut often) = ([0.0; 4], 1.0, 0.0, 1.0);
        for octave in 0..octaves {
            let pace = time * (1.0 + 0.5 * f64::from(octave));
            let at = self.tile.at(std::array::from_fn(|a| (x[a] - drift[a] * pace) * often / (size * FEATURES)));
            (0..4).for_each(|c| sum[c] += strength as f32 * at[c]);
            squares += strength * strength;
            (strength, often) = (strength * gain, 2.0 * often);
        }
        let scale = (1.0 / f64::sqrt(squares)) as f32;
        sum.map(|s| (s * scale).clamp(-MOST, MOST))
    }
}

/// A field with detail.
struct Detailed {
    detail: Detail,
    of: Arc<dyn Field>,
    data: Grid,
    grid: Grid,
    time: f64,
}

impl Field for Detailed {
    fn read(&self, region: Region, out: &mut [f32]) -> Result<()> {
        let mut rest = out;
        for slab in region.slabs(SLAB) {
            let (out, after) = rest.split_at_mut(slab.len());
            rest = after;
            let under = self.under(slab);
            let mut data = vec![0.0; under.len()];
            self.of.read(under, &mut data)?;
            let [nx, ny, _] = slab.size;
            out.par_chunks_exact_mut(nx).enumerate().for_each(|(row, out)| {
                let (j, k) = (slab.start[1] + row % ny, slab.start[2] + row / ny);
                out.iter_mut().enumerate().for_each(|(i, o)| *o = self.value([slab.start[0] + i, j, k], under, &data));
            });
        }
        Ok(())
    }
}

impl Detailed {
    /// Where a voxel lies among those of the data.
    fn place(&self, a: usize, index: usize) -> f64 {
        (index as f64 + 0.5) * self.data.size[a] as f64 / self.grid.size[a] as f64 - 0.5
    }

    /// The data that a region may look up.
    fn under(&self, region: Region) -> Region {
        let far = f64::from(MOST) * self.detail.keys.warp;
        let within = |a: usize, at: f64| at.clamp(0.0, (self.data.size[a] - 1) as f64);
        let start = std::array::from_fn(|a| within(a, (self.place(a, region.start[a]) - far).floor()) as usize);
        let size = std::array::from_fn(|a| {
            let last = within(a, (self.place(a, region.end()[a] - 1) + far).floor() + 1.0);
            last as usize + 1 - start[a]
        });
        Region { start, size }
    }

    fn value(&self, index: [usize; 3], under: Region, data: &[f32]) -> f32 {
        let NoiseKeys { amplitude, about, warp, scale, .. } = self.detail.keys;
        let x = std::array::from_fn(|a| self.grid.origin[a] + index[a] as f64 * self.grid.spacing[a]);
        let noise = self.detail.noise(x, scale * self.data.mean_spacing(), self.time);
        let (mut first, mut next, mut upper) = ([0; 3], [0; 3], [0.0f32; 3]);
        for a in 0..3 {
            let last = self.data.size[a] - 1;
            let at = (self.place(a, index[a]) + warp * f64::from(noise[a + 1])).clamp(0.0, last as f64);
            let low = (at as usize).min(last);
            upper[a] = (at - low as f64) as f32;
            (first[a], next[a]) = (low - under.start[a], (low + 1).min(last).min(under.end()[a] - 1) - under.start[a]);
        }
        let (mut sum, mut weights) = (0.0f32, 0.0f32);
        for corner in 0..8 {
            let (mut n, mut weight) = (0, 1.0);
            for a in (0..3).rev() {
                let past = corner >> a & 1 == 1;
                n = n * under.size[a] + if past { next[a] } else { first[a] };
                weight *= if past { upper[a] } else { 1.0 - upper[a] };
            }
            let value = data[n];
            if weight > 0.0 && (HOLE..=f32::MAX).contains(&value) {
                (sum, weights) = (sum + weight * value, weights + weight);
            }
        }
        if weights < 0.5 {
            return EMPTY;
        }
        let about = about as f32;
        let value = if weights < 1.0 { sum / weights } else { sum };
        about + (value - about) * (1.0 + amplitude as f32 * noise[0]).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::Dense;

    fn keys() -> NoiseKeys {
        NoiseKeys { amplitude: 0.3, scale: 4.0, octaves: 3, refine: 2, ..NoiseKeys::default() }
    }

    fn step(size: [usize; 3], f: impl Fn([f64; 3]) -> f32) -> Timestep {
        let grid = Grid { size, spacing: [0.5, 0.4, 0.6], origin: [1.0, -2.0, 3.0] };
        let at = |n: usize| [n % size[0], n / size[0] % size[1], n / (size[0] * size[1])].map(|i| i as f64);
        let values = (0..grid.len()).map(|n| f(at(n))).collect();
        Timestep { step: 3, time: None, grid, field: Arc::new(Dense::new(size, values)) }
    }

    fn read(step: &Timestep, region: Region) -> Vec<f32> {
        let mut out = vec![0.0; region.len()];
        step.field.read(region, &mut out).unwrap();
        out
    }

    fn detailed(keys: &NoiseKeys, step: &Timestep) -> Vec<f32> {
        let step = Detail::new(keys).unwrap().apply(step);
        read(&step, step.grid.region())
    }

    #[test]
    fn the_tile_has_no_seam_no_mean_and_unit_variance() {
        let tile = Tile::new(7);
        for c in 0..4 {
            let value = |i: usize, j: usize, k: usize| tile.0[(k * EDGE + j) * EDGE + i][c];
            let count = tile.0.len() as f32;
            let mean = tile.0.iter().map(|v| v[c]).sum::<f32>() / count;
            let variance = tile.0.iter().map(|v| v[c] * v[c]).sum::<f32>() / count;
            assert!(mean.abs() < 1e-3 && (variance - 1.0).abs() < 1e-2, "{mean} {variance}");
            // Steps across the seam are as large as steps elsewhere.
            let across = |i: usize, i2: usize| -> f32 {
                let all =
                    (0..EDGE * EDGE).map(|n| (value(i, n % EDGE, n / EDGE) - value(i2, n % EDGE, n / EDGE)).powi(2));
                all.sum::<f32>() / (EDGE * EDGE) as f32
            };
            let inside = (0..EDGE - 1).map(|i| across(i, i + 1)).sum::<f32>() / (EDGE - 1) as f32;
            let seam = across(EDGE - 1, 0);
            assert!(seam < 2.0 * inside && seam > 0.3 * inside, "{seam} at the seam, {inside} inside");
        }
        assert!(tile.0 == Tile::new(7).0 && tile.0 != Tile::new(8).0);
    }

    #[test]
    fn without_noise_there_is_nothing_to_do() {
        assert!(Detail::new(&NoiseKeys::default()).is_none());
        let grid = Grid::new([3, 4, 5]);
        assert_eq!(Detail::grid(&NoiseKeys::default(), &grid), grid);
        let fine = Detail::grid(&keys(), &grid);
        assert_eq!((fine.size, fine.bounds()), ([6, 8, 10], grid.bounds()));
    }

    #[test]
    fn values_are_scaled_about_the_one_that_stays() {
        let one = step([24; 3], |_| 1.0);
        let values = detailed(&keys(), &one);
        let count = values.len() as f64;
        let mean = values.iter().map(|v| f64::from(*v)).sum::<f64>() / count;
        let std = (values.iter().map(|v| (f64::from(*v) - mean).powi(2)).sum::<f64>() / count).sqrt();
        // The volume holds few of the largest features, whose mean is not that of all.
        assert!((mean - 1.0).abs() < 0.05 && (std / 0.3 - 1.0).abs() < 0.2, "{mean} ± {std}");
        assert!(detailed(&NoiseKeys { about: 1.0, ..keys() }, &one).iter().all(|v| *v == 1.0));
        let none = step([8; 3], |_| 0.0);
        assert!(detailed(&NoiseKeys { warp: 2.0, ..keys() }, &none).iter().all(|v| *v == 0.0));
        assert!(values != detailed(&NoiseKeys { seed: 1, ..keys() }, &one));
    }

    /// A shifted lookup of a ramp moves its values by the shift, whose size is that of the key.
    #[test]
    fn lookups_are_shifted_by_the_warp() {
        let ramp = step([40, 12, 12], |[x, _, _]| x as f32);
        let warped = NoiseKeys { amplitude: 0.0, warp: 0.8, ..keys() };
        let fine = Detail::new(&warped).unwrap().apply(&ramp);
        let inside = Region { start: [10, 0, 0], size: [60, 24, 24] };
        let values = read(&fine, inside);
        let shift = |n: usize| f64::from(values[n]) - ((n % 60 + 10) as f64 / 2.0 - 0.25);
        let all: Vec<f64> = (0..values.len()).map(shift).collect();
        let rms = (all.iter().map(|s| s * s).sum::<f64>() / all.len() as f64).sqrt();
        assert!((rms / 0.8 - 1.0).abs() < 0.25 && all.iter().all(|s| s.abs() <= 2.4 + 1e-4), "{rms}");
    }

    #[test]
    fn any_region_is_part_of_the_whole_and_holes_stay_holes() {
        let step = step([9, 7, 8], |[x, y, z]| if x > 6.0 { f32::NAN } else { (x * y + z) as f32 });
        let fine = Detail::new(&NoiseKeys { warp: 1.5, refine: 3, ..keys() }).unwrap().apply(&step);
        let whole = read(&fine, fine.grid.region());
        assert!(
            whole.iter().any(|v| *v < HOLE) && whole.iter().any(|v| *v > 1.0) && whole.iter().all(|v| v.is_finite())
        );
        for region in [
            Region { start: [0; 3], size: [1; 3] },
            Region { start: [5, 4, 3], size: [9, 8, 7] },
            Region { start: [26, 20, 23], size: [1, 1, 1] },
        ] {
            for (n, v) in read(&fine, region).into_iter().enumerate() {
                let at =
                    [n % region.size[0], n / region.size[0] % region.size[1], n / (region.size[0] * region.size[1])];
                let at = std::array::from_fn(|a| region.start[a] + at[a]);
                assert_eq!(v.to_bits(), whole[fine.grid.index(at)].to_bits());
            }
        }
    }

    /// One octave moves as a whole: after a period it is where it was, and what it was is found downstream.
    #[test]
    fn noise_drifts_with_time() {
        let keys = NoiseKeys { octaves: 1, refine: 1, drift: [0.5, 0.0, 0.0], ..keys() };
        let at = |time: f64| detailed(&keys, &Timestep { time: Some(time), ..step([16, 8, 8], |_| 1.0) });
        let (now, next) = (at(0.0), at(1.0));
        assert!(now != next);
        for row in 0..64 {
            for i in 0..15 {
                // The spacing along x is 0.5.
                assert!((next[row * 16 + i + 1] - now[row * 16 + i]).abs() < 1e-4);
            }
        }
        let period = 16.0 * 4.0 * 0.5 / 0.5;
        let again = at(period);
        assert!(now.iter().zip(&again).all(|(a, b)| (a - b).abs() < 1e-4), "the tile repeats");
        assert!(at(0.5 * period).iter().zip(&now).any(|(a, b)| (a - b).abs() > 0.1));
    }
}
