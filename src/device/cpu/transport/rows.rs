//! Arithmetic of transport on rows of voxels.

use super::super::simd::exp;
use super::aligned::Aligned;
use super::{Foot, Lane, WIDTH};

/// How deep the steps of a row are.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) enum Depth {
    /// Nothing is there.
    #[default]
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

/// A row at the feet: interpolated across rows, and on the way to be interpolated across columns. There are `WIDTH` values
/// of padding on both sides, the innermost of which hold what is outside the grid.
#[derive(Default)]
pub(super) struct Across {
    values: Aligned,
    /// `t_col · (values[i + 1] − values[i])`.
    step: Aligned,
    padded: usize,
}

impl Across {
    /// Makes room for rows of `padded` values.
    pub fn fit(&mut self, padded: usize) {
        self.values.grow(padded + 2 * WIDTH);
        self.step.grow(padded + WIDTH);
        self.padded = padded;
    }

    /// Zeros.
    #[inline(always)]
    pub fn clear(&mut self) {
        self.values[..self.padded + 2 * WIDTH].fill(0.0);
        self.step[..self.padded + WIDTH].fill(0.0);
    }

    /// The row itself, at no offset.
    #[inline(always)]
    pub fn here(&mut self, row: &[f32]) {
        self.values[WIDTH..][..row.len()].copy_from_slice(row);
        self.step[..self.padded + WIDTH].fill(0.0);
    }

    /// Interpolates between a row and the next one that feet lie towards, if that is inside; `factor` multiplies both.
    #[inline(always)]
    pub fn between(&mut self, foot: &Foot, factor: f32, row: &[f32], next: Option<&[f32]>, outside: f32) {
        across(row, next, foot.t_row, factor, outside, &mut self.values);
        let n = self.padded;
        let (t, values) = (foot.t_col, &self.values[WIDTH - 1..]);
        self.step[WIDTH - 1] = t * (values[1] - values[0]);
        steps(t, &values[1..], &mut self.step[WIDTH..][..n]);
    }

    /// `n` values and steps such that their difference (ascending) or sum are the values at the feet.
    #[inline(always)]
    fn feet(&self, ascending: bool, n: usize) -> (&[f32], &[f32]) {
        let shift = if ascending { 1 } else { 0 };
        (&self.values[WIDTH..][..n], &self.step[WIDTH - shift..][..n])
    }
}

#[inline(always)]
fn steps(t: f32, values: &[f32], out: &mut [f32]) {
    let n = out.len();
    let (v, next) = (&values[..n], &values[1..=n]);
    for i in 0..n {
        out[i] = t * (next[i] - v[i]);
    }
}

/// A row interpolated towards the next one (`outside` where there is none) and multiplied into the middle of `out`, with
/// `outside` beside it.
#[inline(always)]
pub(super) fn across(row: &[f32], next: Option<&[f32]>, t: f32, factor: f32, outside: f32, out: &mut [f32]) {
    let n = row.len();
    let into = &mut out[WIDTH..][..n];
    match next {
        Some(next) => mix(row, next, t, factor, into),
        None => fade(row, outside, t, factor, into),
    }
    out[WIDTH - 1] = factor * outside;
    out[WIDTH + n] = factor * outside;
}

#[inline(always)]
fn mix(a: &[f32], b: &[f32], t: f32, factor: f32, out: &mut [f32]) {
    let n = out.len();
    let (a, b) = (&a[..n], &b[..n]);
    for i in 0..n {
        out[i] = factor * (a[i] + t * (b[i] - a[i]));
    }
}

#[inline(always)]
fn fade(a: &[f32], b: f32, t: f32, factor: f32, out: &mut [f32]) {
    let n = out.len();
    let a = &a[..n];
    for i in 0..n {
        out[i] = factor * (a[i] + t * (b - a[i]));
    }
}

/// What one lane reads of a row.
pub(super) struct Step<'a> {
    pub lane: &'a Lane,
    /// Radiance of the layer before, interpolated across rows; `t_col` of the way to its neighbours are the feet.
    pub up: &'a [f32],
    pub t_col: f32,
    /// Half the step times σ, here and at the feet.
    pub depth: &'a [f32],
    pub depth_up: &'a Across,
    /// S here and at the feet.
    pub emitted: &'a [f32],
    pub emitted_up: &'a Across,
}

/// reads I, σ, S at the feet and here → writes I, adds it to φ and, where there are four sums, J.
#[inline(always)]
pub(super) fn step(step: &Step, depth: Depth, out: &mut [f32], sums: &mut [f32]) {
    let n = out.len();
    let (lane, ascending) = (step.lane, step.lane.ascending);
    let up = (&step.up[WIDTH..][..n], &step.up[if ascending { WIDTH - 1 } else { WIDTH + 1 }..][..n]);
    let (phi, current) = sums.split_at_mut(n);
    let (t, weight) = (step.t_col, lane.weight);
    if depth == Depth::Empty {
        pass_row(up, t, out, weight, phi);
    } else {
        let (depth_up, emitted_up) = (step.depth_up.feet(ascending, n), step.emitted_up.feet(ascending, n));
        let (own, emitted) = (step.depth, step.emitted);
        // Called by name: through a pointer they would not be compiled for the instruction set at hand.
        macro_rules! run {
            ($way:literal, $depth:expr) => {
                step_row::<$way, { $depth as u8 }>(up, t, depth_up, own, emitted_up, emitted, out, weight, phi)
            };
        }
        match (ascending, depth) {
            (true, Depth::Slight) => run!(true, Depth::Slight),
            (false, Depth::Slight) => run!(false, Depth::Slight),
            (true, Depth::Thin) => run!(true, Depth::Thin),
            (false, Depth::Thin) => run!(false, Depth::Thin),
            (true, _) => run!(true, Depth::Thick),
            (false, _) => run!(false, Depth::Thick),
        }
    }
    for (sum, omega) in current.chunks_exact_mut(n).zip(lane.omega) {
        add(weight * omega, out, sum);
    }
}

/// Largest size of a value.
#[inline(always)]
pub(super) fn largest(values: &[f32]) -> f32 {
    let mut most = [0.0f32; WIDTH];
    for values in values.chunks(WIDTH) {
        for (m, v) in most.iter_mut().zip(values) {
            *m = if v.abs() > *m { v.abs() } else { *m };
        }
    }
    most.into_iter().fold(0.0, f32::max)
}

#[inline(always)]
fn add(weight: f32, values: &[f32], sum: &mut [f32]) {
    sum.iter_mut().zip(values).for_each(|(s, v)| *s += weight * v);
}

/// Radiance that nothing is taken from and nothing added to.
#[inline(always)]
fn pass_row((here, beside): (&[f32], &[f32]), t: f32, out: &mut [f32], weight: f32, phi: &mut [f32]) {
    let n = out.len();
    let (here, beside, phi) = (&here[..n], &beside[..n], &mut phi[..n]);
    for i in 0..n {
        let radiance = here[i] + t * (beside[i] - here[i]);
        out[i] = radiance;
        phi[i] += weight * radiance;
    }
}

/// The mutable rows are arguments of their own, so that the compiler knows that they overlap nothing.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn step_row<const ASCENDING: bool, const DEPTH: u8>(
    (up_here, up_beside): (&[f32], &[f32]),
    t: f32,
    (depth_up, depth_step): (&[f32], &[f32]),
    depth: &[f32],
    (emitted_up, emitted_step): (&[f32], &[f32]),
    emitted: &[f32],
    out: &mut [f32],
    weight: f32,
    phi: &mut [f32],
) {
    let n = out.len();
    let (up_here, up_beside, phi) = (&up_here[..n], &up_beside[..n], &mut phi[..n]);
    let (depth_up, depth_step, depth) = (&depth_up[..n], &depth_step[..n], &depth[..n]);
    let (emitted_up, emitted_step, emitted) = (&emitted_up[..n], &emitted_step[..n], &emitted[..n]);
    for i in 0..n {
        let foot = |value: f32, step: f32| if ASCENDING { value - step } else { value + step };
        let up = up_here[i] + t * (up_beside[i] - up_here[i]);
        let tau = foot(depth_up[i], depth_step[i]) + depth[i];
        let s_up = foot(emitted_up[i], emitted_step[i]);
        let (gain, slope) = (s_up - up, emitted[i] - s_up);
        let radiance = up
            + if DEPTH == Depth::Slight as u8 {
                thin(&SLIGHT, tau, gain, slope)
            } else if DEPTH == Depth::Thin as u8 {
                thin(&THIN, tau, gain, slope)
            } else {
                thick(tau, gain, slope)
            };
        out[i] = radiance;
        phi[i] += weight * radiance;
    }
}

/// `(1 − e^−τ)·gain + w₀·slope`; the weights by their series where differences would cancel.
#[inline(always)]
fn thick(tau: f32, gain: f32, slope: f32) -> f32 {
    let absorbed = 1.0 - exp(-tau);
    let weight = 1.0 - absorbed / tau;
    let small = tau.min(0.125);
    let series =
        small * (0.5 - small * (1.0 / 6.0 - small * (1.0 / 24.0 - small * (1.0 / 120.0 - small * (1.0 / 720.0)))));
    let thin = tau < 0.125;
    let (absorbed, weight) = (if thin { tau * (1.0 - series) } else { absorbed }, if thin { series } else { weight });
    absorbed * gain + weight * slope
}

/// `w₀/τ` for τ up to ½ and up to 2: polynomials through its values at Chebyshev's nodes, to 2.1e-8 and 3e-8.
const SLIGHT: [f32; 5] = [0.5, -0.166_665_63, 0.041_649_93, -0.008_238_221_5, 0.001_164_287];
const THIN: [f32; 7] =
    [0.499_999_97, -0.166_665_58, 0.041_657_96, -0.008_306_631, 0.001_349_234_5, -0.000_167_222_74, 0.000_011_712_907];

/// The same without exponential and division: with `q = w₀/τ` it is `τ·[gain + q·(slope − τ·gain)]`.
#[inline(always)]
fn thin<const N: usize>(quotient: &[f32; N], tau: f32, gain: f32, slope: f32) -> f32 {
    let mut q = quotient[N - 1];
    for k in (0..N - 1).rev() {
        q = quotient[k] + tau * q;
    }
    tau * (gain + q * (slope - tau * gain))
}

/// S towards a direction from its isotropic part and its gradient.
#[inline(always)]
pub(super) fn towards(omega: &[f32; 3], [s, x, y, z]: [&[f32]; 4], out: &mut [f32]) {
    let n = s.len();
    let (out, x, y, z) = (&mut out[..n], &x[..n], &y[..n], &z[..n]);
    for i in 0..n {
        out[i] = (s[i] + (omega[0] * x[i] + omega[1] * y[i] + omega[2] * z[i])).max(0.0);
    }
}
