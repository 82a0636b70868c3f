//! Sets of directions: Gauss–Legendre in the cosine of the polar angle, equal steps in azimuth.

use std::f64::consts::PI;

use glam::Vec3;

use crate::device::Ordinate;
use crate::error::{Error, Result};
use crate::lights::Cell;

/// The product set of `count = 2m²` directions, m Gauss–Legendre cosines × 2m azimuths: 8, 32 or 128. Weights sum to 4π;
/// radiance `inflow` enters along each.
///
/// # Errors
/// [`Error::Scene`] for any other count.
pub fn ordinates(count: usize, inflow: f32) -> Result<Vec<Ordinate>> {
    let m = match count {
        8 => 2,
        32 => 4,
        128 => 8,
        _ => {
            return Err(Error::scene(
                "light.directions",
                format!("{count} is not a set of ordinates; try 8, 32 or 128"),
            ));
        }
    };
    let mut set = Vec::with_capacity(count);
    for (mu, weight) in gauss_legendre(m) {
        for p in 0..2 * m {
            let azimuth = PI * (p as f64 + 0.5) / m as f64;
            let s = (1.0 - mu * mu).sqrt();
            let direction = Vec3::new((s * azimuth.cos()) as f32, (s * azimuth.sin()) as f32, mu as f32);
            set.push(Ordinate { direction, weight: (weight * PI / m as f64) as f32, inflow });
        }
    }
    Ok(set)
}

/// A partition of the sphere that the set of `count` directions stands for: each direction's cell, as large as its weight,
/// in the order of [`ordinates`]. Bands of z as high as the weights of the cosines, cut half-way between azimuths.
///
/// # Errors
/// [`Error::Scene`] for a number of directions that is no set.
pub fn cells(count: usize) -> Result<Vec<Cell>> {
    ordinates(count, 0.0)?;
    let m = (count as f64 / 2.0).sqrt() as usize;
    let mut all = Vec::with_capacity(count);
    let mut bottom = -1.0;
    for (_, weight) in gauss_legendre(m) {
        let top = bottom + weight;
        let azimuth = |p: usize| PI * p as f64 / m as f64;
        all.extend((0..2 * m).map(|p| Cell { z: [bottom, top], azimuth: [azimuth(p), azimuth(p + 1)] }));
        bottom = top;
    }
    Ok(all)
}

/// Nodes and weights on [−1, 1], by Newton's method on the Legendre polynomial.
fn gauss_legendre(n: usize) -> Vec<(f64, f64)> {
    // P_n and its derivative.
    let legendre = |x: f64| {
        let (mut p, mut before) = (1.0, 0.0);
        for k in 0..n {
            let k = k as f64;
            (p, before) = (((2.0 * k + 1.0) * x * p - k * before) / (k + 1.0), p);
        }
        (p, n as f64 * (x * p - before) / (x * x - 1.0))
    };
    let node = |i: usize| {
        let mut x = -(PI * (i as f64 + 0.75) / (n as f64 + 0.5)).cos();
        for _ in 0..20 {
            let (p, slope) = legendre(x);
            x -= p / slope;
        }
        let slope = legendre(x).1;
        (x, 2.0 / ((1.0 - x * x) * slope * slope))
    };
    (0..n).map(node).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_lie_in_cells_as_large_as_their_weights() {
        for count in [8, 32, 128] {
            for (cell, o) in cells(count).unwrap().iter().zip(ordinates(count, 0.0).unwrap()) {
                let area = (cell.z[1] - cell.z[0]) * (cell.azimuth[1] - cell.azimuth[0]);
                assert!((area - f64::from(o.weight)).abs() < 1e-6);
                let azimuth = f64::from(o.direction.y).atan2(o.direction.x.into()).rem_euclid(2.0 * PI);
                assert!(cell.azimuth[0] < azimuth && azimuth < cell.azimuth[1]);
                assert!((cell.z[0]..cell.z[1]).contains(&o.direction.z.into()), "{cell:?} {o:?}");
            }
        }
    }

    /// Moments of the sphere: ∫1 = 4π, ∫Ω_a = 0, ∫Ω_a Ω_b = 4π/3 δ_ab, ∫Ω_z⁴ = 4π/5 (from 4 cosines on).
    #[test]
    fn sets_integrate_low_moments_of_the_sphere() {
        for count in [8, 32, 128] {
            let set = ordinates(count, 0.0).unwrap();
            assert_eq!(set.len(), count);
            let integral =
                |f: &dyn Fn(Vec3) -> f32| set.iter().map(|o| f64::from(o.weight * f(o.direction))).sum::<f64>();
            let close =
                |got: f64, expected: f64| assert!((got - expected).abs() < 4e-6, "{count}: {got} for {expected}");
            close(integral(&|_| 1.0), 4.0 * PI);
            for a in 0..3 {
                close(integral(&|u| u[a]), 0.0);
                for b in 0..3 {
                    close(integral(&|u| u[a] * u[b]), if a == b { 4.0 * PI / 3.0 } else { 0.0 });
                }
            }
            if count > 8 {
                close(integral(&|u| u.z.powi(4)), 4.0 * PI / 5.0);
            }
        }
        assert!(ordinates(16, 0.0).is_err());
    }
}
