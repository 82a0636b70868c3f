//! Numbers without pattern that depend on nothing but their counters, so that a picture is the same for any number of threads,
//! on any device, and however its samples are split over calls.
//!
//! Integers come from PCG4D (Jarzynski & Olano 2020, "Hash Functions for GPU Rendering"); sequences of points add multiples of
//! the powers of the plastic number's relatives (Roberts 2018, R₃) to them, modulo 1: they fill the cube evenly from the first
//! point on. `shaders/random.wgsl` has the same integers.

use glam::Vec3;

/// Four 32-bit numbers for four counters.
#[inline(always)]
pub fn pcg4d(counters: [u32; 4]) -> [u32; 4] {
    let [mut x, mut y, mut z, mut w] = counters.map(|c| c.wrapping_mul(1_664_525).wrapping_add(1_013_904_223));
    for pass in 0..2 {
        x = x.wrapping_add(y.wrapping_mul(w));
        y = y.wrapping_add(z.wrapping_mul(x));
        z = z.wrapping_add(x.wrapping_mul(y));
        w = w.wrapping_add(y.wrapping_mul(z));
        if pass == 0 {
            [x, y, z, w] = [x, y, z, w].map(|v| v ^ (v >> 16));
        }
    }
    [x, y, z, w]
}

/// The number in 0..1, 1 excluded, of 24 bits.
#[inline(always)]
pub fn unit(bits: u32) -> f32 {
    (bits >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// 2³²/g, 2³²/g², 2³²/g³ with g⁴ = g + 1.
const STEPS: [u32; 3] = [3_518_319_155, 2_882_110_345, 2_360_945_575];

/// Point `i` of the sequence that begins at `origin`, in 0..1 along each axis.
#[inline(always)]
pub fn point(origin: [u32; 4], i: u32) -> [f32; 3] {
    [0, 1, 2].map(|a| unit(origin[a].wrapping_add(i.wrapping_mul(STEPS[a]))))
}

/// A point of the unit sphere by rejection (Rezk-Salama 2007, section 4): triplets in the cube until one is in the ball. `draw`
/// numbers the point; after sixteen triplets, which happens once in 140000 points, the last one is taken.
#[inline(always)]
pub fn sphere(stream: [u32; 3], draw: u32) -> Vec3 {
    let mut way = Vec3::X;
    for attempt in 0..16 {
        let [a, b] = [stream[0], stream[1]];
        let r = pcg4d([a, b, stream[2], draw.wrapping_mul(16).wrapping_add(attempt)]);
        let triplet = Vec3::new(unit(r[0]), unit(r[1]), unit(r[2])) * 2.0 - 1.0;
        let square = triplet.length_squared();
        if square > 1e-12 {
            way = triplet / square.sqrt();
            if square <= 1.0 {
                break;
            }
        }
    }
    way
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn integers_are_those_of_the_published_function() {
        assert_eq!(pcg4d([1, 2, 3, 4]), [908_250_390, 4_044_648_920, 3_775_961_919, 45_698_095]);
        assert_eq!(pcg4d([0; 4]), [251_852_841, 760_645_481, 850_445_371, 3_542_436_074]);
    }

    #[test]
    fn the_steps_are_the_powers_of_the_root() {
        let g: f64 = 1.220_744_084_605_759_5;
        assert!((g.powi(4) - g - 1.0).abs() < 1e-14);
        for (power, step) in (1..).zip(STEPS) {
            assert!((f64::from(step) - 2f64.powi(32) / g.powi(power)).abs() < 1.0, "{step}");
        }
    }

    #[test]
    fn points_fill_the_cube_evenly() {
        let origin = pcg4d([7, 1, 2, 3]);
        let mut counts = [0; 64];
        for i in 0..6400 {
            let p = point(origin, i).map(|c| (4.0 * c) as usize);
            counts[p[0] + 4 * p[1] + 16 * p[2]] += 1;
        }
        // Independent draws would leave each count ±10; these points less than half of that.
        assert!(counts.iter().all(|c| (85..=115).contains(c)), "{counts:?}");
    }

    #[test]
    fn the_sphere_is_covered_evenly() {
        let n = 20_000;
        let (mut mean, mut square) = (Vec3::ZERO, Vec3::ZERO);
        for i in 0..n {
            let p = sphere([3, 1, 4], i);
            assert!((p.length() - 1.0).abs() < 1e-5);
            mean += p / n as f32;
            square += p * p / n as f32;
        }
        // Standard errors: √(1/3n) = 0.0041 and √(4/45n) = 0.0021; four of them.
        assert!(mean.abs().max_element() < 0.017, "{mean}");
        assert!((square - 1.0 / 3.0).abs().max_element() < 0.0085, "{square}");
    }
}
