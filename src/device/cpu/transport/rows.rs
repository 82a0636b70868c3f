//! Arithmetic of transport on rows of voxels. Rows of a group lie one after another, so that a loop runs over all of them; the
//! values between two rows are what is outside the grid.

use super::super::simd::exp;
use super::WIDTH;

/// How deep the steps of some rows are at most.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Depth {
    /// Nothing is there.
    Empty,
    /// Up to ½.
    Slight,
    /// Up to 2.
    Thin,
    Thick,
}

impl Depth {
    /// That of steps whose optical depth is at most `tau`.
    pub fn of(tau: f32) -> Self {
        match tau {
            0.0 => Depth::Empty,
            tau if tau <= 0.5 => Depth::Slight,
            tau if tau <= 2.0 => Depth::Thin,
            _ => Depth::Thick,
        }
    }
}

/// Largest of rows of `cols` values, `stride` apart, that are not negative.
#[inline(always)]
pub(super) fn largest(values: &[f32], stride: usize, rows: usize, cols: usize) -> f32 {
    let mut most = [0.0f32; 2 * WIDTH];
    let mut rest = 0.0f32;
    let whole = cols / most.len() * most.len();
    for row in 0..rows {
        let row = &values[row * stride..][..cols];
        for at in (0..whole).step_by(2 * WIDTH) {
            let block = &row[at..at + 2 * WIDTH];
            for i in 0..2 * WIDTH {
                most[i] = if block[i] > most[i] { block[i] } else { most[i] };
            }
        }
        for v in &row[whole..] {
            rest = if *v > rest { *v } else { rest };
        }
    }
    most.iter().fold(rest, |m, v| if *v > m { *v } else { m })
}

/// `A = 1 − e^−τ` and `B = 1 − A/τ` of steps of `length` through extinction σ. What a voxel gets does not depend on its neighbours,
/// only how many formulas are tried does.
#[inline(always)]
pub(super) fn optics(depth: Depth, length: f32, sigma: &[f32], absorbed: &mut [f32], short: &mut [f32]) {
    match depth {
        Depth::Empty => {
            absorbed.fill(0.0);
            short.fill(0.0);
        }
        Depth::Slight => optics_up_to::<{ Depth::Slight as u8 }>(length, sigma, absorbed, short),
        Depth::Thin => optics_up_to::<{ Depth::Thin as u8 }>(length, sigma, absorbed, short),
        Depth::Thick => optics_up_to::<{ Depth::Thick as u8 }>(length, sigma, absorbed, short),
    }
}

#[inline(always)]
fn optics_up_to<const DEPTH: u8>(length: f32, sigma: &[f32], absorbed: &mut [f32], short: &mut [f32]) {
    let n = sigma.len();
    let (absorbed, short) = (&mut absorbed[..n], &mut short[..n]);
    for i in 0..n {
        let tau = length * sigma[i];
        let (mut a, mut b) = thin(&SLIGHT, tau);
        if DEPTH >= Depth::Thin as u8 {
            let (c, d) = thin(&THIN, tau);
            (a, b) = if tau > 0.5 { (c, d) } else { (a, b) };
        }
        if DEPTH >= Depth::Thick as u8 {
            let c = 1.0 - exp(-tau);
            (a, b) = if tau > 2.0 { (c, 1.0 - c / tau) } else { (a, b) };
        }
        (absorbed[i], short[i]) = (a, b);
    }
}

/// `B/τ` for τ up to ½ and up to 2: polynomials through its values at Chebyshev's nodes, to 2.1e-8 and 3e-8.
const SLIGHT: [f32; 5] = [0.5, -0.166_665_63, 0.041_649_93, -0.008_238_221_5, 0.001_164_287];
const THIN: [f32; 7] =
    [0.499_999_97, -0.166_665_58, 0.041_657_96, -0.008_306_631, 0.001_349_234_5, -0.000_167_222_74, 0.000_011_712_907];

/// A and B without exponential and division: `A = τ(1 − B)`.
#[inline(always)]
fn thin<const N: usize>(quotient: &[f32; N], tau: f32) -> (f32, f32) {
    let mut q = quotient[N - 1];
    for k in (0..N - 1).rev() {
        q = quotient[k] + tau * q;
    }
    let b = tau * q;
    (tau - tau * b, b)
}

/// `a + t(b − a)`.
#[inline(always)]
pub(super) fn blend(a: &[f32], b: &[f32], t: f32, out: &mut [f32]) {
    let n = out.len();
    let (a, b) = (&a[..n], &b[..n]);
    for i in 0..n {
        out[i] = a[i] + t * (b[i] - a[i]);
    }
}

/// Radiance at the feet: interpolated across rows, and `t` of the way to be gone towards the column `beside`.
#[derive(Clone, Copy)]
pub(super) struct Feet<'a> {
    pub here: &'a [f32],
    pub beside: &'a [f32],
    pub t: f32,
}

/// Radiance goes on as it came; its multiple by `weight` is added to `sum`.
#[inline(always)]
pub(super) fn pass_on(Feet { here, beside, t }: Feet, weight: f32, exit: &mut [f32], sum: &mut [f32]) {
    let n = exit.len();
    let sum = &mut sum[..n];
    let (here, beside) = (&here[..n], &beside[..n]);
    for i in 0..n {
        let entry = here[i] + t * (beside[i] - here[i]);
        exit[i] = entry;
        sum[i] += weight * entry;
    }
}

/// The same through voxels that take `absorbed` of it and give as much of their source function. The sum is of what enters.
#[inline(always)]
pub(super) fn cross(
    Feet { here, beside, t }: Feet,
    absorbed: &[f32],
    source: &[f32],
    weight: f32,
    exit: &mut [f32],
    sum: &mut [f32],
) {
    let n = exit.len();
    let sum = &mut sum[..n];
    let (here, beside, absorbed, source) = (&here[..n], &beside[..n], &absorbed[..n], &source[..n]);
    for i in 0..n {
        let entry = here[i] + t * (beside[i] - here[i]);
        exit[i] = entry + absorbed[i] * (source[i] - entry);
        sum[i] += weight * entry;
    }
}

/// Makes the sum of what enters that of means over voxels.
#[inline(always)]
pub(super) fn average(short: &[f32], source: &[f32], weight: f32, sum: &mut [f32]) {
    let n = sum.len();
    let (short, source) = (&short[..n], &source[..n]);
    for i in 0..n {
        sum[i] += short[i] * (weight * source[i] - sum[i]);
    }
}

/// Through voxels whose source function is given by its isotropic part and its gradient along `omega`. What is added to φ and J,
/// by the weights given, is the mean over each voxel.
#[inline(always)]
#[allow(clippy::too_many_arguments, reason = "so that the compiler knows that what is written overlaps nothing")]
pub(super) fn cross_towards(
    Feet { here, beside, t }: Feet,
    [absorbed, short]: [&[f32]; 2],
    omega: [f32; 3],
    [s, x, y, z]: [&[f32]; 4],
    exit: &mut [f32],
    weights: [f32; 4],
    phi: &mut [f32],
    j_x: &mut [f32],
    j_y: &mut [f32],
    j_z: &mut [f32],
) {
    let n = exit.len();
    let (phi, j_x, j_y, j_z) = (&mut phi[..n], &mut j_x[..n], &mut j_y[..n], &mut j_z[..n]);
    let (here, beside, absorbed, short) = (&here[..n], &beside[..n], &absorbed[..n], &short[..n]);
    let (s, x, y, z) = (&s[..n], &x[..n], &y[..n], &z[..n]);
    for i in 0..n {
        let entry = here[i] + t * (beside[i] - here[i]);
        let source = (s[i] + (omega[0] * x[i] + omega[1] * y[i] + omega[2] * z[i])).max(0.0);
        let gain = source - entry;
        exit[i] = entry + absorbed[i] * gain;
        let mean = entry + short[i] * gain;
        phi[i] += weights[0] * mean;
        j_x[i] += weights[1] * mean;
        j_y[i] += weights[2] * mean;
        j_z[i] += weights[3] * mean;
    }
}
