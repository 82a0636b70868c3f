//! Pressure projection: finds p with `∇·(w∇p) = ∇·(w u)` and subtracts ∇p, so that as much flows into each cell as out of
//! it. `w` is the open fraction of a face: 0 in walls, 1 in the open, in between where a ball cuts the face (Y.-T. Ng,
//! C. Min, F. Gibou, J. Comput. Phys. 228 (2009), eq. 10). Beyond an open side the pressure is 0.
//!
//! Solved by conjugate gradients with one multigrid V-cycle as preconditioner (A. McAdams, E. Sifakis, J. Teran, "A
//! Parallel Multigrid Poisson Solver for Fluids Simulation on Large Grids", SCA 2010), started from the last pressure.

use super::lattice::Lattice;

/// Jacobi sweeps before and after the coarser level.
const SWEEPS: usize = 2;
/// Jacobi damping: 6/7 damps the rough half of the error fastest on a seven-point stencil.
const DAMPING: f32 = 6.0 / 7.0;

/// The projection of one arrangement of walls.
pub struct Projection {
    levels: Vec<Level>,
    pressure: Vec<f32>,
    direction: Vec<f32>,
    product: Vec<f32>,
}

/// One grid of the multigrid hierarchy, each half as fine as the one before.
struct Level {
    lattice: Lattice,
    /// Open fraction of the low faces along x, y, z, times area over distance.
    weights: [Vec<f32>; 3],
    diagonal: Vec<f32>,
    inverse_diagonal: Vec<f32>,
    solution: Vec<f32>,
    source: Vec<f32>,
    scratch: Vec<f32>,
}

impl Level {
    fn new(lattice: Lattice, weights: [Vec<f32>; 3]) -> Self {
        let mut diagonal = lattice.zeros();
        lattice.for_rows(&mut diagonal, [0; 3], |start, row| {
            for (c, value) in (start..).zip(row) {
                *value = (0..3).map(|a| weights[a][c] + weights[a][c + lattice.stride(a)]).sum();
            }
        });
        // A cell without an open face takes no part.
        let inverse_diagonal = diagonal.iter().map(|&d| if d > 0.0 { 1.0 / d } else { 0.0 }).collect();
        let [solution, source, scratch] = [(); 3].map(|()| lattice.zeros());
        Level { lattice, weights, diagonal, inverse_diagonal, solution, source, scratch }
    }

    /// The level of half the resolution: areas add up, distances double.
    fn coarser(&self) -> Level {
        let fine = &self.lattice;
        let lattice = Lattice { cells: fine.cells.map(|n| n.div_ceil(2)) };
        let weights = [0, 1, 2].map(|axis| {
            let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
            let mut weights = lattice.zeros();
            let mut n = lattice.cells;
            n[axis] += 1;
            for k in 1..=n[2] {
                for j in 1..=n[1] {
                    for i in 1..=n[0] {
                        let mut low = [2 * i - 1, 2 * j - 1, 2 * k - 1];
                        // An odd number of cells ends in the middle of a coarse one.
                        low[axis] = low[axis].min(fine.cells[axis] + 1);
                        let mut sum = 0.0;
                        for (db, dc) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                            let mut f = low;
                            f[b] += db;
                            f[c] += dc;
                            if f[b] <= fine.cells[b] && f[c] <= fine.cells[c] {
                                sum += self.weights[axis][fine.at(f[0], f[1], f[2])];
                            }
                        }
                        weights[lattice.at(i, j, k)] = 0.5 * sum;
                    }
                }
            }
            weights
        });
        Level::new(lattice, weights)
    }

    /// Calls `each(i, Σ w·x over the neighbours)` for the `n` cells of a row from `start` on.
    #[inline(always)]
    fn for_neighbours(&self, x: &[f32], start: usize, n: usize, mut each: impl FnMut(usize, f32)) {
        // Slices of equal length let the compiler work on several cells at once.
        let of = |start: usize| start..start + n;
        let [y, z] = [self.lattice.row(), self.lattice.plane()];
        let [wx, wy, wz] = &self.weights;
        let (w0, x0, w1, x1) = (&wx[of(start)], &x[of(start - 1)], &wx[of(start + 1)], &x[of(start + 1)]);
        let (w2, x2, w3, x3) = (&wy[of(start)], &x[of(start - y)], &wy[of(start + y)], &x[of(start + y)]);
        let (w4, x4, w5, x5) = (&wz[of(start)], &x[of(start - z)], &wz[of(start + z)], &x[of(start + z)]);
        for i in 0..n {
            each(i, w0[i] * x0[i] + w1[i] * x1[i] + w2[i] * x2[i] + w3[i] * x3[i] + w4[i] * x4[i] + w5[i] * x5[i]);
        }
    }

    /// `out = A x`.
    fn apply(&self, x: &[f32], out: &mut [f32]) {
        self.lattice.for_rows(out, [0; 3], |start, out| {
            let n = out.len();
            let (here, diagonal) = (&x[start..start + n], &self.diagonal[start..start + n]);
            self.for_neighbours(x, start, n, |i, sum| out[i] = diagonal[i] * here[i] - sum);
        });
    }

    /// One damped Jacobi sweep of `A solution = source`.
    fn smooth(&mut self) {
        let mut next = std::mem::take(&mut self.scratch);
        self.lattice.for_rows(&mut next, [0; 3], |start, next| {
            let n = next.len();
            let (here, source) = (&self.solution[start..start + n], &self.source[start..start + n]);
            let inverse = &self.inverse_diagonal[start..start + n];
            self.for_neighbours(&self.solution, start, n, |i, sum| {
                next[i] = here[i] + DAMPING * ((source[i] + sum) * inverse[i] - here[i]);
            });
        });
        self.scratch = std::mem::replace(&mut self.solution, next);
    }
}

/// Approximately solves the first level's system, starting from 0: a symmetric operation, as a preconditioner must be.
fn v_cycle(levels: &mut [Level]) {
    let (level, coarser) = levels.split_first_mut().expect("there is a finest level");
    // The first sweep from 0 is a scaling.
    let (source, inverse) = (&level.source, &level.inverse_diagonal);
    level.lattice.for_rows(&mut level.solution, [0; 3], |start, row| {
        row.iter_mut().enumerate().for_each(|(i, x)| *x = DAMPING * source[start + i] * inverse[start + i]);
    });
    let sweeps = if coarser.is_empty() { 40 } else { SWEEPS };
    (1..sweeps).for_each(|_| level.smooth());
    let Some(next) = coarser.first_mut() else { return };

    let mut residual = std::mem::take(&mut level.scratch);
    level.apply(&level.solution, &mut residual);
    let (fine, coarse, source) = (level.lattice, next.lattice, &level.source);
    coarse.for_rows(&mut next.source, [0; 3], |start, row| {
        let (j, k) = (start % coarse.plane() / coarse.row(), start / coarse.plane());
        let rows = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dj, dk)| fine.at(1, 2 * j - 1 + dj, 2 * k - 1 + dk));
        for (i, sum) in row.iter_mut().enumerate() {
            // Beyond an odd last cell lie ghosts, which hold 0.
            let pair = |c: usize| source[c] - residual[c] + (source[c + 1] - residual[c + 1]);
            *sum = rows.iter().map(|&row| pair(row + 2 * i)).sum();
        }
    });
    level.scratch = residual;

    v_cycle(coarser);

    let correction = &coarser[0].solution;
    level.lattice.for_rows(&mut level.solution, [0; 3], |start, row| {
        let (j, k) = (start % fine.plane() / fine.row(), start / fine.plane());
        let parents = coarse.at(0, j.div_ceil(2), k.div_ceil(2));
        row.iter_mut().enumerate().for_each(|(i, x)| *x += correction[parents + i / 2 + 1]);
    });
    (0..sweeps).for_each(|_| level.smooth());
}

impl Projection {
    /// Prepares the hierarchy for the given open fractions of the low faces along x, y, z.
    pub fn new(lattice: Lattice, open: [Vec<f32>; 3]) -> Self {
        let mut levels = vec![Level::new(lattice, open)];
        while levels[levels.len() - 1].lattice.cells.iter().all(|&n| n > 4) {
            levels.push(levels[levels.len() - 1].coarser());
        }
        let zeros = lattice.zeros();
        Projection { levels, pressure: zeros.clone(), direction: zeros.clone(), product: zeros }
    }

    /// Makes `velocity` (low faces along x, y, z) free of divergence, to `tolerance` times its divergence before (root mean
    /// squares). Returns the iterations that took.
    pub fn project(&mut self, velocity: &mut [Vec<f32>; 3], tolerance: f64) -> usize {
        let lattice = self.levels[0].lattice;
        let divergence = self.divergence(velocity);
        let norm = |values: &[f32]| lattice.sum(|c| f64::from(values[c]).powi(2)).sqrt();
        let before = norm(&divergence);

        // −∇·(w∇p) = −∇·(w u): the matrix is positive definite. The source becomes the residual of the last pressure.
        let level = &mut self.levels[0];
        level.apply(&self.pressure, &mut self.product);
        let mut residual = lattice.zeros();
        let product = &self.product;
        lattice.for_rows(&mut residual, [0; 3], |start, row| {
            for (i, r) in row.iter_mut().enumerate() {
                *r = -divergence[start + i] - product[start + i];
            }
        });

        let (mut iterations, mut old) = (0, 0.0);
        while norm(&residual) > tolerance * before && iterations < 100 {
            self.levels[0].source.copy_from_slice(&residual);
            v_cycle(&mut self.levels);
            let level = &self.levels[0];
            let preconditioned = &level.solution;
            let new = lattice.sum(|c| f64::from(residual[c]) * f64::from(preconditioned[c]));
            let beta = if iterations == 0 { 0.0 } else { (new / old) as f32 };
            lattice.for_rows(&mut self.direction, [0; 3], |start, row| {
                row.iter_mut().enumerate().for_each(|(i, d)| *d = preconditioned[start + i] + beta * *d);
            });
            level.apply(&self.direction, &mut self.product);
            let (direction, product) = (&self.direction, &self.product);
            let curvature = lattice.sum(|c| f64::from(direction[c]) * f64::from(product[c]));
            if curvature <= 0.0 {
                break;
            }
            let alpha = (new / curvature) as f32;
            lattice.for_rows(&mut self.pressure, [0; 3], |start, row| {
                row.iter_mut().enumerate().for_each(|(i, p)| *p += alpha * direction[start + i]);
            });
            lattice.for_rows(&mut residual, [0; 3], |start, row| {
                row.iter_mut().enumerate().for_each(|(i, r)| *r -= alpha * product[start + i]);
            });
            old = new;
            iterations += 1;
        }

        for (axis, velocity) in velocity.iter_mut().enumerate() {
            let (open, pressure, stride) = (&self.levels[0].weights[axis], &self.pressure, lattice.stride(axis));
            lattice.for_rows(velocity, [0, 1, 2].map(|a| usize::from(a == axis)), |start, row| {
                for (i, u) in row.iter_mut().enumerate() {
                    let c = start + i;
                    *u = if open[c] > 0.0 { *u - (pressure[c] - pressure[c - stride]) } else { 0.0 };
                }
            });
        }
        iterations
    }

    /// What flows out of each cell less what flows in, per unit time.
    pub fn divergence(&self, velocity: &[Vec<f32>; 3]) -> Vec<f32> {
        let Level { lattice, weights, inverse_diagonal, .. } = &self.levels[0];
        let mut divergence = lattice.zeros();
        lattice.for_rows(&mut divergence, [0; 3], |start, row| {
            for (i, value) in row.iter_mut().enumerate() {
                let c = start + i;
                let flux = |a: usize, c: usize| weights[a][c] * velocity[a][c];
                if inverse_diagonal[c] > 0.0 {
                    *value = (0..3).map(|a| flux(a, c + lattice.stride(a)) - flux(a, c)).sum();
                }
            }
        });
        divergence
    }
}
