//! Previews: a series seen through means over blocks of its voxels, made as it is read, so that it fits where the whole does
//! not and takes a fraction of the time.
//!
//! A block keeps its mean *extinction* (light.md: downsample after the transfer function), so that shadows and opacities are
//! right in the mean. What stands for the block is a data value of that extinction, the one nearest to the mean value weighted by
//! extinction: between the least and the largest extinction of a block there is always one. Colour and albedo are then
//! those of a value that the block may well have.

use std::sync::Arc;

use rayon::prelude::*;

use crate::device::{Optic, cpu};
use crate::error::Result;
use crate::field::{self, Field, HOLE, Timestep};
use crate::grid::{Region, Slab};
use crate::scene::Scene;
use crate::source::{Series, SeriesInfo};
use crate::transfer::{Table, TransferFunction};

/// A series on a grid that is coarser by a factor along each axis.
pub struct Preview {
    of: Box<dyn Series>,
    factor: usize,
    info: SeriesInfo,
    table: Arc<Table>,
}

/// Size of the grid whose voxels stand for blocks of `factor`³ voxels of a grid of `size`.
pub fn size(size: [usize; 3], factor: usize) -> [usize; 3] {
    size.map(|n| (n / factor).max(1))
}

impl Preview {
    /// `of`, coarser by `factor`, for a scene whose values 0 and 1 are those of `range`.
    pub fn new(of: Box<dyn Series>, factor: usize, scene: &Scene, range: [f64; 2]) -> Result<Self> {
        let mut info = of.info().clone();
        let grid = of.grid();
        let coarse = grid.resized(size(grid.size, factor));
        let table = Arc::new(TransferFunction::new(&scene.transfer)?.table(range, grid.mean_spacing()));
        (info.grid.size, info.grid.spacing, info.grid.origin) = (coarse.size, coarse.spacing, coarse.origin);
        (info.grid.stretch, info.resampled) = (None, None);
        Ok(Preview { of, factor, info, table })
    }

    /// The scene as it is on the coarser grid: lengths in voxels are fewer.
    pub fn scene(&self, scene: &Scene) -> Scene {
        let fine = self.of.grid().mean_spacing();
        let mut scene = scene.clone();
        scene.transfer.reference *= fine / self.grid().mean_spacing();
        scene
    }
}

impl Series for Preview {
    fn info(&self) -> &SeriesInfo {
        &self.info
    }

    fn timestep(&self, index: usize) -> Result<Timestep> {
        let step = self.of.timestep(index)?;
        let grid = step.grid.resized(size(step.grid.size, self.factor));
        let field = Coarse { of: step.field, fine: step.grid.size, coarse: grid.size, table: self.table.clone() };
        Ok(Timestep { grid, field: Arc::new(field), ..step })
    }
}

/// Values that stand for blocks of another field's.
struct Coarse {
    of: Arc<dyn Field>,
    fine: [usize; 3],
    coarse: [usize; 3],
    table: Arc<Table>,
}

impl Field for Coarse {
    fn read(&self, region: Region, out: &mut [f32]) -> Result<()> {
        let [nx, ny, _] = self.coarse;
        let mut extinction = vec![0.0; nx * ny];
        let mut values = Vec::new();
        for (k, out) in (region.start[2]..region.end()[2]).zip(out.chunks_exact_mut(region.size[0] * region.size[1])) {
            let light = Slab { size: self.coarse, planes: k..k + 1 };
            let data = Slab { size: self.fine, planes: light.under(self.fine[2]) };
            values.resize(data.len(), 0.0);
            field::read_planes(&*self.of, &data, &mut values, false)?;
            cpu::classify::classify(Optic::Extinction, &self.table, &data, &values, &light, &mut extinction);
            out.par_chunks_exact_mut(region.size[0]).enumerate().for_each(|(row, out)| {
                let j = region.start[1] + row;
                for (i, out) in (region.start[0]..).zip(out) {
                    *out = self.stand_in([i, j], &data, &values, extinction[j * nx + i]);
                }
            });
        }
        Ok(())
    }
}

impl Coarse {
    /// The value that stands for a block of a slab of data.
    fn stand_in(&self, [i, j]: [usize; 2], data: &Slab, values: &[f32], extinction: f32) -> f32 {
        let under = |at: usize, a: usize| {
            let (fine, coarse) = (self.fine[a], self.coarse[a]);
            at * fine / coarse..((at + 1) * fine).div_ceil(coarse)
        };
        let (mut sum, mut weights) = (0.0f64, 0.0f64);
        let (mut plain, mut filled) = (0.0f64, 0u32);
        for k in 0..data.planes.len() {
            for y in under(j, 1) {
                for &v in &values[(k * self.fine[1] + y) * self.fine[0]..][under(i, 0)] {
                    if v >= HOLE {
                        let sigma = f64::from(self.table.extinction_of(v));
                        (sum, weights) = (sum + sigma * f64::from(v), weights + sigma);
                        (plain, filled) = (plain + f64::from(v), filled + 1);
                    }
                }
            }
        }
        match (filled, weights > 0.0) {
            (0, _) => f32::NAN,
            (_, true) => self.table.nearest_with(extinction, (sum / weights) as f32),
            (n, false) => (plain / f64::from(n)) as f32,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::Dense;
    use crate::scene::TransferKeys;

    /// Whatever the curve, blocks keep their mean extinction: what is between two values of a curve is taken on somewhere.
    #[test]
    fn blocks_keep_their_mean_extinction() {
        let curves = [
            vec![[0.0, 0.0], [1.0, 0.5]],
            vec![[0.0, 0.0], [0.4, 0.6], [0.5, 0.1], [0.7, 0.4], [1.0, 0.0]],
            vec![[0.0, 0.9], [1.0, 0.0]],
        ];
        let (fine, coarse) = ([13, 8, 10], [4, 4, 3]);
        let values: Vec<f32> =
            (0..1040u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 8) as f32 / 16_777_216.0).collect();
        for opacity in curves {
            let keys = TransferKeys { opacity: Some(opacity), ..Default::default() };
            let table = Arc::new(TransferFunction::new(&keys).unwrap().table([0.0, 1.0], 1.0));
            let mut mean = vec![0.0; 48];
            let whole = [Slab::whole(fine), Slab::whole(coarse)];
            cpu::classify::classify(Optic::Extinction, &table, &whole[0], &values, &whole[1], &mut mean);
            let field = Coarse { of: Arc::new(Dense::new(fine, values.clone())), fine, coarse, table: table.clone() };
            let mut out = vec![0.0; 48];
            field.read(Slab::whole(coarse).region(), &mut out).unwrap();
            for (v, mean) in out.iter().zip(mean) {
                // A value between two entries is found to within its own rounding.
                assert!((table.extinction_of(*v) - mean).abs() < 1e-4, "{v}: {} for {mean}", table.extinction_of(*v));
            }
            let mut part = vec![0.0; 2];
            field.read(Region { start: [1, 2, 1], size: [2, 1, 1] }, &mut part).unwrap();
            assert_eq!(part, out[(4 + 2) * 4 + 1..][..2]);
        }
    }

    #[test]
    fn holes_do_not_count_and_blocks_of_holes_are_holes() {
        let mut values = vec![0.5; 64];
        values[..2].fill(f32::NAN);
        values.iter_mut().enumerate().filter(|(i, _)| i % 4 > 1).for_each(|(_, v)| *v = f32::NAN);
        let table = Arc::new(TransferFunction::new(&TransferKeys::default()).unwrap().table([0.0, 1.0], 1.0));
        let field =
            Coarse { of: Arc::new(Dense::new([4; 3], values)), fine: [4; 3], coarse: [2; 3], table: table.clone() };
        let mut out = vec![0.0; 8];
        field.read(Slab::whole([2; 3]).region(), &mut out).unwrap();
        assert!(out[1].is_nan() && out[3].is_nan() && out[5].is_nan() && out[7].is_nan(), "{out:?}");
        assert!((out[2] - 0.5).abs() < 1e-6);
        // Two of eight are holes: three quarters of the extinction.
        assert!((table.extinction_of(out[0]) - 0.75 * table.extinction_of(0.5)).abs() < 1e-4);
    }
}
