//! A small simulation to light: hot smoke rises in turning jets under a ball, billows round it and leaves through the top.
//!
//! Incompressible flow on staggered faces: `∂u/∂t + u·∇u = −∇p + b·heat·ẑ + ε(N×ω)`, `∇·u = 0`, smoke and heat carried
//! along. The box is one unit wide; a floor below, open elsewhere. Buoyancy and confinement of vorticity after R. Fedkiw,
//! J. Stam, H. W. Jensen, "Visual Simulation of Smoke", SIGGRAPH 2001, eqs. 8 and 11. The same steps come out whatever the
//! number of threads.

mod advect;
mod lattice;
mod pressure;
pub mod series;

use glam::Vec3A;

use advect::{Paths, advect};
use lattice::{Lattice, Place};
use pressure::Projection;

/// Time between steps.
pub const TIME_STEP: f64 = 1.0 / 24.0;
/// Height of the box in widths.
const HEIGHT: f32 = 1.5;
/// Acceleration of smoke of heat 1, widths per unit time squared.
const BUOYANCY: f32 = 1.8;
/// Heat lost per unit time.
const COOLING: f32 = 0.12;
/// Smoke lost per unit time, so that old smoke thins out.
const FADING: f32 = 0.06;
/// ε of the confinement of vorticity, in cells.
const CONFINEMENT: f32 = 0.30;
/// Middle and radius of the ball.
const BALL: (Vec3A, f32) = (Vec3A::new(0.5, 0.5, 0.52), 0.115);
/// Radius of the inlet in the floor, and speed of what enters.
const INLET: (f32, f32) = (0.11, 0.5);
/// Share of the divergence that a projection leaves.
const LEFT_OVER: f64 = 1e-3;
/// Cells that the fastest smoke may cross at a time; a step is divided when it would cross more.
const REACH: f32 = 3.0;

/// The state of the simulation.
pub struct Smoke {
    lattice: Lattice,
    /// Velocity through the low faces along x, y, z, cells per unit time.
    velocity: [Vec<f32>; 3],
    density: Vec<f32>,
    heat: Vec<f32>,
    /// Part of each cell outside the ball.
    open: Vec<f32>,
    projection: Projection,
    time: f64,
}

impl Smoke {
    /// Still air in a box of `size`×`size`×1.5·`size` cells.
    pub fn new(size: usize) -> Self {
        let lattice = Lattice { cells: [size, size, (HEIGHT * size as f32).round() as usize] };
        let open_at = |here: Vec3A| {
            let distance = here.distance(size as f32 * BALL.0 + 0.5) - size as f32 * BALL.1;
            (0.5 + distance).clamp(0.0, 1.0)
        };
        let mut open = lattice.zeros();
        lattice.for_each(&mut open, Place::Cell, |_, here, open| *open = open_at(here));
        let faces = [0, 1, 2].map(|axis| {
            let mut faces = lattice.zeros();
            lattice.for_each(&mut faces, Place::Face(axis), |_, here, face| {
                let floor = axis == 2 && here.z < 1.0;
                // Slivers between ball and face make the pressure ill-conditioned and let nothing through.
                *face = if floor || open_at(here) < 0.05 { 0.0 } else { open_at(here) };
            });
            faces
        });
        Smoke {
            lattice,
            velocity: [lattice.zeros(), lattice.zeros(), lattice.zeros()],
            density: lattice.zeros(),
            heat: lattice.zeros(),
            open,
            projection: Projection::new(lattice, faces),
            time: 0.0,
        }
    }

    /// Cells along x, y, z.
    pub fn size(&self) -> [usize; 3] {
        self.lattice.cells
    }

    /// Width of a cell.
    pub fn spacing(&self) -> f64 {
        1.0 / self.lattice.cells[0] as f64
    }

    /// Time passed since the start.
    pub fn time(&self) -> f64 {
        self.time
    }

    /// Density of smoke, 0 to 1, in (z, y, x) order.
    pub fn density(&self) -> Vec<f32> {
        let [nx, ny, nz] = self.lattice.cells;
        let mut values = Vec::with_capacity(nx * ny * nz);
        for k in 1..=nz {
            for start in (1..=ny).map(|j| self.lattice.at(1, j, k)) {
                values.extend((start..start + nx).map(|c| self.density[c] * self.open[c]));
            }
        }
        values
    }

    /// Advances by [`TIME_STEP`].
    pub fn step(&mut self) {
        let fastest = self.velocity.iter().map(|u| self.lattice.max(|c| u[c].abs())).fold(0.0, f32::max);
        let parts = (fastest * TIME_STEP as f32 / REACH).ceil().max(1.0);
        for _ in 0..parts as usize {
            self.advance(TIME_STEP as f32 / parts);
            self.time += TIME_STEP / f64::from(parts);
        }
    }

    fn advance(&mut self, dt: f32) {
        let lattice = self.lattice;
        let paths = Paths::trace(&lattice, &self.at_cells(), dt);
        advect(&lattice, &paths, &mut self.density, Place::Cell, Some(0.0));
        advect(&lattice, &paths, &mut self.heat, Place::Cell, Some(0.0));
        for (axis, velocity) in self.velocity.iter_mut().enumerate() {
            advect(&lattice, &paths, velocity, Place::Face(axis), None);
        }
        decay(&mut self.heat, COOLING * dt);
        decay(&mut self.density, FADING * dt);
        self.feed(dt);
        self.push(dt);
        self.projection.project(&mut self.velocity, LEFT_OVER);
    }

    /// Smoke and heat enter through the inlet, in puffs that turn about its middle.
    fn feed(&mut self, dt: f32) {
        let width = self.lattice.cells[0] as f32;
        let (radius, speed) = INLET;
        let t = self.time as f32;
        // 0 to 1: how much of the inlet's own this place holds, and the way from the inlet's middle.
        let inlet = move |here: Vec3A| {
            if here.z > 0.5 + 0.07 * width {
                return (0.0, Vec3A::ZERO);
            }
            let wander = 0.025 * Vec3A::new((1.3 * t).sin(), (1.7 * t).cos(), 0.0);
            let from = (here - 0.5) / width - Vec3A::new(0.5, 0.5, 0.0) - wander;
            let reach = from.truncate().length() / radius;
            let angle = from.y.atan2(from.x);
            let ragged = 1.0 + 0.18 * (3.0 * angle + 2.9 * t).sin() + 0.12 * (5.0 * angle - 4.3 * t).sin();
            let inside = ((ragged - reach) * 6.0).clamp(0.0, 1.0) * ((0.05 - from.z) * 60.0).clamp(0.0, 1.0);
            (inside, from / radius)
        };
        let share = 1.0 - (-dt * 30.0).exp();
        for values in [&mut self.density, &mut self.heat] {
            self.lattice.for_each(values, Place::Cell, |_, here, value| {
                *value += share * inlet(here).0 * (1.0 - *value);
            });
        }
        for (axis, velocity) in self.velocity.iter_mut().enumerate() {
            self.lattice.for_each(velocity, Place::Face(axis), |_, here, value| {
                let (inside, from) = inlet(here);
                let gust = 1.0 + 0.25 * (2.3 * t + 4.0 * from.x).sin();
                let wanted = speed * width * [-0.6 * from.y, 0.6 * from.x, gust][axis];
                *value += share * inside * (wanted - *value);
            });
        }
    }

    /// Buoyancy, and confinement of vorticity.
    fn push(&mut self, dt: f32) {
        let lattice = self.lattice;
        let velocity = self.at_cells();
        let mut vorticity = vec![Vec3A::ZERO; lattice.len()];
        let slope = |values: &[Vec3A], c: usize, axis: usize| {
            0.5 * (values[c + lattice.stride(axis)] - values[c - lattice.stride(axis)])
        };
        lattice.for_rows(&mut vorticity, [0; 3], |start, row| {
            for (i, value) in row.iter_mut().enumerate() {
                let [dx, dy, dz] = [0, 1, 2].map(|a| slope(&velocity, start + i, a));
                *value = Vec3A::new(dy.z - dz.y, dz.x - dx.z, dx.y - dy.x);
            }
        });
        let mut force = vec![Vec3A::ZERO; lattice.len()];
        lattice.for_rows(&mut force, [0; 3], |start, row| {
            for (i, value) in row.iter_mut().enumerate() {
                let c = start + i;
                let strength = |c: usize| vorticity[c].length();
                let rise = [0, 1, 2].map(|a| strength(c + lattice.stride(a)) - strength(c - lattice.stride(a)));
                *value = CONFINEMENT * Vec3A::from_array(rise).normalize_or_zero().cross(vorticity[c]);
                value.z += BUOYANCY * lattice.cells[0] as f32 * self.heat[c];
                // Ghosts and walls have no part in it: the neighbours' differences would be those to still air.
                *value *= self.open[c];
            }
        });
        for (axis, velocity) in self.velocity.iter_mut().enumerate() {
            let stride = lattice.stride(axis);
            lattice.for_rows(velocity, [0; 3], |start, row| {
                for (i, value) in row.iter_mut().enumerate() {
                    *value += dt * 0.5 * (force[start + i][axis] + force[start + i - stride][axis]);
                }
            });
        }
    }

    /// Velocity in the middle of the cells.
    fn at_cells(&self) -> Vec<Vec3A> {
        let mut velocity = vec![Vec3A::ZERO; self.lattice.len()];
        self.lattice.for_rows(&mut velocity, [0; 3], |start, row| {
            for (i, value) in row.iter_mut().enumerate() {
                let mean = |a: usize| {
                    0.5 * (self.velocity[a][start + i] + self.velocity[a][start + i + self.lattice.stride(a)])
                };
                *value = Vec3A::new(mean(0), mean(1), mean(2));
            }
        });
        velocity
    }
}

/// `q' = −rate·q`, backward Euler.
fn decay(values: &mut [f32], rate: f32) {
    values.iter_mut().for_each(|v| *v /= 1.0 + rate);
}

#[cfg(test)]
mod tests;
