//! Advection `∂q/∂t + u·∇q = 0` by the MacCormack scheme: a semi-Lagrangian step, the same step back, half of what the two
//! lost added again, and the result limited by the values it came from.
//!
//! A. Selle, R. Fedkiw, B. Kim, Y. Liu, J. Rossignac, "An Unconditionally Stable MacCormack Method", J. Sci. Comput. 35
//! (2008), eqs. 6–8.

use glam::Vec3A;

use super::lattice::{Lattice, Place};

/// Where the flow carries every cell within a time step, and where it came from; second-order Runge–Kutta.
pub struct Paths {
    /// Displacement in cells from a cell's middle to where its content comes from.
    back: Vec<Vec3A>,
    /// Displacement to where its content goes.
    forth: Vec<Vec3A>,
}

impl Paths {
    /// Paths through the velocity at cells, in cells per unit time.
    pub fn trace(lattice: &Lattice, velocity: &[Vec3A], dt: f32) -> Self {
        let trace = |dt: f32| {
            let mut path = vec![Vec3A::ZERO; lattice.len()];
            lattice.for_rows(&mut path, [0; 3], |start, path| {
                let (j, k) = (start % lattice.plane() / lattice.row(), start / lattice.plane());
                for (i, path) in path.iter_mut().enumerate() {
                    let here = Vec3A::new((i + 1) as f32, j as f32, k as f32);
                    let halfway = lattice.corners(Place::Cell, here + 0.5 * dt * velocity[start + i]);
                    *path = dt * lattice.sample(velocity, &halfway);
                }
            });
            path
        };
        Paths { back: trace(-dt), forth: trace(dt) }
    }

    /// The displacement of a value at `place`: that of its cell, or the mean of the two cells that share the face.
    #[inline]
    fn shift(path: &[Vec3A], lattice: &Lattice, place: Place, c: usize) -> Vec3A {
        match place {
            Place::Cell => path[c],
            Place::Face(a) => 0.5 * (path[c] + path[c - lattice.stride(a)]),
        }
    }
}

/// Carries `values` along `paths`. What enters through an open side is `outside` when given, else as it is at the side.
pub fn advect(lattice: &Lattice, paths: &Paths, values: &mut Vec<f32>, place: Place, outside: Option<f32>) {
    let hi = Vec3A::from_array(lattice.cells.map(|n| n as f32 + 0.5));
    let beyond = |p: Vec3A| p.cmplt(Vec3A::splat(0.5)).any() || p.cmpgt(hi).any();

    let mut carried = lattice.zeros();
    lattice.for_each(&mut carried, place, |c, here, carried| {
        let origin = here + Paths::shift(&paths.back, lattice, place, c);
        *carried = match outside {
            Some(outside) if beyond(origin) => outside,
            _ => lattice.sample(values, &lattice.corners(place, origin)),
        };
    });

    let mut corrected = lattice.zeros();
    lattice.for_each(&mut corrected, place, |c, here, corrected| {
        if outside == Some(carried[c]) && values[c] == carried[c] {
            *corrected = carried[c];
            return;
        }
        let origin = here + Paths::shift(&paths.back, lattice, place, c);
        let target = here + Paths::shift(&paths.forth, lattice, place, c);
        // Next to an open side one of the two steps would read values that are not there.
        if beyond(origin) || beyond(target) {
            *corrected = carried[c];
            return;
        }
        let returned = lattice.sample(&carried, &lattice.corners(place, target));
        let (lo, hi) = lattice.bounds(values, &lattice.corners(place, origin));
        *corrected = (carried[c] + 0.5 * (values[c] - returned)).clamp(lo, hi);
    });
    *values = corrected;
}
