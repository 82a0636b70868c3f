//! The simulation's box of cubic cells, padded by one ghost layer, so that no stencil needs a special case at a wall.
//!
//! Every array has the padded shape, x fastest. A cell value sits at the integer position (i, j, k), cells count from 1;
//! a face value along axis a belongs to the low face of its cell, at half an index less along a.

use std::ops::{Add, Mul, Sub};

use glam::Vec3A;
use rayon::prelude::*;

/// Shape of every array of the simulation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Lattice {
    /// Cells along x, y, z, ghosts not counted.
    pub cells: [usize; 3],
}

/// What a value belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// The middle of a cell.
    Cell,
    /// The low face of a cell along an axis.
    Face(usize),
}

impl Lattice {
    pub fn row(&self) -> usize {
        self.cells[0] + 2
    }

    pub fn plane(&self) -> usize {
        self.row() * (self.cells[1] + 2)
    }

    pub fn len(&self) -> usize {
        self.plane() * (self.cells[2] + 2)
    }

    /// Distance in memory to the next cell along `axis`.
    pub fn stride(&self, axis: usize) -> usize {
        [1, self.row(), self.plane()][axis]
    }

    /// Where cell (i, j, k) is in memory; cells count from 1.
    pub fn at(&self, i: usize, j: usize, k: usize) -> usize {
        k * self.plane() + j * self.row() + i
    }

    pub fn zeros(&self) -> Vec<f32> {
        vec![0.0; self.len()]
    }

    /// Calls `update(start, row)` for every row of cells of `values` (ghosts left out, `extra` faces beyond the last cell
    /// along x, y, z included), planes in parallel. `start` is the place of `row[0]` in memory.
    pub fn for_rows<T: Send>(&self, values: &mut [T], extra: [usize; 3], update: impl Fn(usize, &mut [T]) + Sync) {
        let (row, plane) = (self.row(), self.plane());
        let [nx, ny, nz] = [0, 1, 2].map(|a| self.cells[a] + extra[a]);
        values.par_chunks_mut(plane).enumerate().skip(1).take(nz).for_each(|(k, values)| {
            for j in 1..=ny {
                update(k * plane + j * row + 1, &mut values[j * row + 1..j * row + 1 + nx]);
            }
        });
    }

    /// The same over the values at `place`, with the position of every value: `update(place in memory, position, value)`.
    pub fn for_each(&self, values: &mut [f32], place: Place, update: impl Fn(usize, Vec3A, &mut f32) + Sync) {
        let (extra, shift) = match place {
            Place::Cell => ([0; 3], Vec3A::ZERO),
            Place::Face(a) => ([0, 1, 2].map(|b| usize::from(a == b)), -0.5 * Vec3A::AXES[a]),
        };
        let (row, plane) = (self.row(), self.plane());
        self.for_rows(values, extra, |start, values| {
            let (j, k) = (start % plane / row, start / plane);
            for (i, value) in values.iter_mut().enumerate() {
                update(start + i, Vec3A::new((i + 1) as f32, j as f32, k as f32) + shift, value);
            }
        });
    }

    /// Sum of `term` over all cells, in the same order whatever the number of threads.
    pub fn sum(&self, term: impl Fn(usize) -> f64 + Sync) -> f64 {
        let [nx, ny, nz] = self.cells;
        let planes: Vec<f64> = (1..=nz)
            .into_par_iter()
            .map(|k| {
                let rows = (1..=ny).map(|j| self.at(1, j, k));
                rows.map(|start| (start..start + nx).map(&term).sum::<f64>()).sum()
            })
            .collect();
        planes.iter().sum()
    }

    /// Largest `term` over all cells.
    pub fn max(&self, term: impl Fn(usize) -> f32 + Sync) -> f32 {
        let [nx, ny, nz] = self.cells;
        let row = |j, k| (self.at(1, j, k)..self.at(1, j, k) + nx).map(&term).fold(0.0, f32::max);
        (1..=nz).into_par_iter().map(|k| (1..=ny).map(|j| row(j, k)).fold(0.0, f32::max)).reduce(|| 0.0, f32::max)
    }
}

/// The eight values around a position, and how much each counts.
pub struct Corners {
    /// Place in memory of the lowest corner.
    first: usize,
    fraction: Vec3A,
}

impl Lattice {
    /// Corners around `position`, clamped to the values that exist at `place`.
    #[inline]
    pub fn corners(&self, place: Place, position: Vec3A) -> Corners {
        let hi = Vec3A::from_array(self.cells.map(|n| n as f32));
        let (hi, position) = match place {
            Place::Cell => (hi, position),
            Place::Face(a) => (hi + Vec3A::AXES[a], position + 0.5 * Vec3A::AXES[a]),
        };
        let position = position.clamp(Vec3A::ONE, hi);
        let [i, j, k] = position.min(hi - Vec3A::ONE).to_array().map(|v| v as u32);
        let fraction = position - Vec3A::new(i as f32, j as f32, k as f32);
        Corners { first: self.at(i as usize, j as usize, k as usize), fraction }
    }

    /// The eight values, x fastest.
    #[inline]
    fn eight<T: Copy>(&self, values: &[T], corners: &Corners) -> [T; 8] {
        let pair = |at: usize| (values[at], values[at + 1]);
        let (near, far) = (corners.first, corners.first + self.plane());
        let ((a, b), (c, d)) = (pair(near), pair(near + self.row()));
        let ((e, f), (g, h)) = (pair(far), pair(far + self.row()));
        [a, b, c, d, e, f, g, h]
    }

    /// Trilinear interpolation, of numbers or vectors.
    #[inline]
    pub fn sample<T>(&self, values: &[T], corners: &Corners) -> T
    where
        T: Copy + Add<Output = T> + Sub<Output = T> + Mul<f32, Output = T>,
    {
        let [a, b, c, d, e, f, g, h] = self.eight(values, corners);
        let [x, y, z] = corners.fraction.to_array();
        let between = |from: T, to: T, fraction: f32| from + (to - from) * fraction;
        let near = between(between(a, b, x), between(c, d, x), y);
        let far = between(between(e, f, x), between(g, h, x), y);
        between(near, far, z)
    }

    /// Least and greatest of the eight values.
    #[inline]
    pub fn bounds(&self, values: &[f32], corners: &Corners) -> (f32, f32) {
        let v = self.eight(values, corners);
        v.iter().fold((v[0], v[0]), |(lo, hi), &v| (lo.min(v), hi.max(v)))
    }
}
