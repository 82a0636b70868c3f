//! How light goes on at a collision: phase functions, and surfaces that reflect as Ashikhmin & Shirley's Fresnel blend (2000,
//! isotropic), a matte base under a glossy coat:
//!
//! `f = 28/(23π) R_d (1 − F₀)(1 − (1 − n·i/2)⁵)(1 − (1 − n·o/2)⁵) + (e + 1)/(8π) (n·h)^e F(h·i) / (h·i max(n·i, n·o))`,
//!
//! `F(c) = R_s (F₀ + (1 − F₀)(1 − c)⁵)` (Schlick 1994), `F₀ = ((η − 1)/(η + 1))²`, and Blinn's exponent `e = 2/r⁴ − 2` of roughness r.

use std::f32::consts::{PI, TAU};

use glam::Vec3;

use super::emitter::about;
use crate::device::Phase;

/// What happens to light at a collision.
#[derive(Debug, Clone, Copy)]
pub enum Lobe {
    /// It is scattered.
    Phase {
        /// The phase function.
        phase: Phase,
        /// Part of the light per channel that goes on.
        albedo: Vec3,
    },
    /// It is reflected.
    Surface {
        /// Unit, on the side of the viewer.
        normal: Vec3,
        /// R_d per channel.
        diffuse: Vec3,
        /// R_s.
        specular: f32,
        /// F₀.
        facing: f32,
        /// Blinn's exponent.
        exponent: f32,
    },
    /// It is thrown back evenly (Lambert).
    Matte {
        /// Unit, on the side of the viewer.
        normal: Vec3,
        /// Part of the light per channel that goes on.
        albedo: Vec3,
    },
}

/// Blinn's exponent of a roughness in 0..1.
#[inline]
pub fn exponent(roughness: f32) -> f32 {
    // Smoother than this, f32 cannot tell a highlight from a mirror.
    let square = roughness.max(0.03) * roughness.max(0.03);
    (2.0 / (square * square) - 2.0).max(0.0)
}

/// A phase function's density at the cosine between the ways before and after.
#[inline]
pub fn phase(phase: Phase, cosine: f32) -> f32 {
    match phase {
        Phase::HenyeyGreenstein(g) => {
            let base = (1.0 + g * g - 2.0 * g * cosine).max(1e-12);
            (1.0 - g * g) / (2.0 * TAU * base * base.sqrt())
        }
        Phase::Schlick(g) => {
            let k = schlick(g);
            let base = 1.0 - k * cosine;
            (1.0 - k * k) / (2.0 * TAU * base * base).max(1e-12)
        }
    }
}

/// A cosine that is distributed as a phase function's.
#[inline]
pub fn cosine(phase: Phase, xi: f32) -> f32 {
    match phase {
        Phase::HenyeyGreenstein(g) if g.abs() > 1e-3 => {
            let s = (1.0 - g * g) / (1.0 - g + 2.0 * g * xi);
            ((1.0 + g * g - s * s) / (2.0 * g)).clamp(-1.0, 1.0)
        }
        // To first order in g.
        Phase::HenyeyGreenstein(g) => {
            let c = 2.0 * xi - 1.0;
            c + 1.5 * g * (1.0 - c * c)
        }
        Phase::Schlick(g) => {
            let k = schlick(g);
            ((2.0 * xi - 1.0 + k) / (2.0 * k * xi + 1.0 - k)).clamp(-1.0, 1.0)
        }
    }
}

#[inline]
fn schlick(g: f32) -> f32 {
    1.55 * g - 0.55 * g * g * g
}

#[inline]
fn fifth(x: f32) -> f32 {
    let square = x * x;
    square * square * x
}

impl Lobe {
    /// What comes from `to` and goes on against `way`, the cosine of a surface included, and the density with which
    /// [`Lobe::sample`] goes there. Both unit; `way` is the ray's from the eye.
    #[inline]
    pub fn value(&self, way: Vec3, to: Vec3) -> (Vec3, f32) {
        match *self {
            Lobe::Phase { phase: of, albedo } => {
                // Paths go against the light, so that both ways are turned round.
                let p = phase(of, way.dot(to));
                (albedo * p, p)
            }
            Lobe::Matte { normal, albedo } => {
                let p = normal.dot(to).max(0.0) / PI;
                (albedo * p, p)
            }
            Lobe::Surface { normal, diffuse, specular, facing, exponent } => {
                let (i, o) = (normal.dot(to), -normal.dot(way));
                if i <= 0.0 || o <= 0.0 {
                    return (Vec3::ZERO, 0.0);
                }
                let half = (to - way).normalize_or_zero();
                let (h, c) = (normal.dot(half).max(0.0), to.dot(half).max(1e-6));
                let fresnel = specular * (facing + (1.0 - facing) * fifth(1.0 - c));
                let lambert = 28.0 / (23.0 * PI) * (1.0 - facing);
                let matte = lambert * (1.0 - fifth(1.0 - 0.5 * i)) * (1.0 - fifth(1.0 - 0.5 * o));
                let highlight = (exponent + 1.0) / TAU * h.powf(exponent);
                let gloss = 0.25 * highlight * fresnel / (c * i.max(o));
                let pdf = 0.5 * i / PI + 0.5 * highlight / (4.0 * c);
                ((matte * diffuse + gloss) * i, pdf)
            }
        }
    }

    /// A way on, drawn by three numbers in 0..1; `value` tells what it is worth.
    #[inline]
    pub fn sample(&self, way: Vec3, xi: [f32; 3]) -> Vec3 {
        match *self {
            Lobe::Phase { phase, .. } => about(way, cosine(phase, xi[0]), TAU * xi[1]),
            Lobe::Matte { normal, .. } => about(normal, (1.0 - xi[0]).sqrt(), TAU * xi[1]),
            Lobe::Surface { normal, .. } if xi[2] < 0.5 => about(normal, (1.0 - xi[0]).sqrt(), TAU * xi[1]),
            Lobe::Surface { normal, exponent, .. } => {
                let half = about(normal, (1.0 - xi[0]).powf(1.0 / (exponent + 1.0)), TAU * xi[1]);
                (way - 2.0 * way.dot(half) * half).normalize_or_zero()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Evenly spread numbers.
    fn numbers(n: usize) -> impl Iterator<Item = [f32; 3]> {
        let r = [0.819_172_5, 0.671_043_6, 0.549_700_5];
        (0..n).map(move |i| r.map(|r| (0.5 + r * i as f64).fract() as f32))
    }

    /// validation.md 9: the sampled cosines fall into 32 bins as the integral of the phase function says (χ², 31 degrees of freedom,
    /// 61.1 is exceeded once in a thousand), and their mean is g.
    #[test]
    fn sampled_phase_functions_are_the_analytic_ones() {
        for g in [-0.7f32, -0.0005, 0.0, 0.3, 0.85] {
            for of in [Phase::HenyeyGreenstein(g), Phase::Schlick(g)] {
                let (n, bins) = (100_000, 32);
                let mut draw = super::super::numbers::Numbers::new(1, 3);
                let mut counts = vec![0.0f64; bins];
                let mut mean = 0.0f64;
                for _ in 0..n {
                    let c = f64::from(cosine(of, draw.draw()));
                    mean += c / f64::from(n);
                    counts[((0.5 + 0.5 * c) * bins as f64).min(bins as f64 - 1.0) as usize] += 1.0;
                }
                let share = |bin: usize| {
                    let fine = 400;
                    let at = |i: usize| -1.0 + 2.0 * (bin as f64 + (i as f64 + 0.5) / fine as f64) / bins as f64;
                    let sum: f64 = (0..fine).map(|i| f64::from(phase(of, at(i) as f32))).sum();
                    sum * std::f64::consts::TAU * 2.0 / bins as f64 / fine as f64
                };
                let shares: Vec<f64> = (0..bins).map(share).collect();
                assert!((shares.iter().sum::<f64>() - 1.0).abs() < 1e-3, "{of:?} integrates to 1");
                let chi: f64 = (counts.iter().zip(&shares))
                    .map(|(seen, share)| (seen - share * f64::from(n)).powi(2) / (share * f64::from(n)))
                    .sum();
                assert!(chi < 61.1, "{of:?}: {chi}");
                if let Phase::HenyeyGreenstein(g) = of {
                    // The standard error of a cosine's mean is at most 1/√(3n).
                    assert!((mean - f64::from(g)).abs() < 4.0 / (3.0 * f64::from(n)).sqrt(), "{mean} {g}");
                }
            }
        }
    }

    fn surface(roughness: f32) -> Lobe {
        let (specular, facing) = (1.0, 0.2);
        Lobe::Surface { normal: Vec3::Z, diffuse: Vec3::splat(0.9), specular, facing, exponent: exponent(roughness) }
    }

    /// The density is that of the samples: it integrates to the share of samples above the surface, and the light that is reflected is
    /// the same by scattering and by even directions. No more comes back than went in, and both ways are alike.
    #[test]
    fn a_surface_reflects_no_more_than_it_gets_and_is_reciprocal() {
        for roughness in [1.0, 0.5, 0.3] {
            for cosine in [1.0f32, 0.5, 0.1] {
                let lobe = surface(roughness);
                let way = -about(Vec3::Z, cosine, 1.0);
                let (n, mut sampled, mut even, mut above, mut density) = (1 << 17, 0.0f64, 0.0f64, 0.0f64, 0.0f64);
                for xi in numbers(n) {
                    let to = lobe.sample(way, xi);
                    let (f, p) = lobe.value(way, to);
                    if p > 0.0 {
                        above += 1.0 / n as f64;
                        sampled += f64::from(f.x / p) / n as f64;
                    }
                    let to = about(Vec3::Z, xi[0], TAU * xi[1]);
                    let (f, p) = lobe.value(way, to);
                    even += f64::from(f.x * TAU) / n as f64;
                    density += f64::from(p * TAU) / n as f64;
                    // f includes the cosine of the way to the light; without it both ways are alike.
                    let (back, _) = lobe.value(-to, -way);
                    let (a, b) = (f.x / to.z.max(1e-3), back.x / -way.z);
                    assert!(to.z < 1e-3 || (a - b).abs() < 1e-3 * a.max(b) + 1e-6, "{a} {b}");
                }
                // Evenly spread directions find highlights of some tenths of a radian to a hundredth.
                assert!((sampled - even).abs() < 0.01, "{roughness} {cosine}: {sampled} {even}");
                assert!((above - density).abs() < 0.01, "{roughness} {cosine}: {above} {density}");
                assert!(sampled < 1.0, "{roughness} {cosine}: {sampled}");
            }
        }
    }
}
