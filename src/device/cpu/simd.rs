//! Run-time choice of instruction set, and arithmetic that vectorises.
//!
//! A kernel is written once as an `#[inline(always)]` body over plain slices and compiled for each instruction set by
//! `dispatch!`. No fused multiply-add is used in the bodies, so every instruction set gives the same bits.

use std::sync::OnceLock;

/// Instruction sets that kernels are compiled for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// Whatever the target guarantees: SSE2 on x86-64, NEON on AArch64.
    Portable,
    /// AVX2.
    Avx2,
    /// AVX-512 F, VL, BW, DQ.
    Avx512,
}

/// The best instruction set of this machine; `GLOAMING_SIMD=portable|avx2|avx512` lowers it.
pub fn level() -> Level {
    static LEVEL: OnceLock<Level> = OnceLock::new();
    *LEVEL.get_or_init(|| {
        let wanted = match std::env::var("GLOAMING_SIMD").as_deref() {
            Ok("portable") => Level::Portable,
            Ok("avx2") => Level::Avx2,
            _ => Level::Avx512,
        };
        wanted.min(supported())
    })
}

#[cfg(target_arch = "x86_64")]
fn supported() -> Level {
    let avx2 = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
    let avx512 = is_x86_feature_detected!("avx512f")
        && is_x86_feature_detected!("avx512vl")
        && is_x86_feature_detected!("avx512bw")
        && is_x86_feature_detected!("avx512dq");
    match (avx2, avx512) {
        (true, true) => Level::Avx512,
        (true, false) => Level::Avx2,
        _ => Level::Portable,
    }
}

#[cfg(not(target_arch = "x86_64"))]
fn supported() -> Level {
    Level::Portable
}

/// `dispatch! { pub fn kernel(a: &[f32], b: &mut [f32]) = body; }` defines `kernel`, which calls `body` compiled for the best
/// instruction set. `body` must be `#[inline(always)]`.
macro_rules! dispatch {
    ($(#[$meta:meta])* $vis:vis fn $name:ident($($arg:ident: $ty:ty),* $(,)?) $(-> $ret:ty)? = $body:path;) => {
        $(#[$meta])*
        #[allow(clippy::too_many_arguments)]
        $vis fn $name($($arg: $ty),*) $(-> $ret)? {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2,fma,bmi2,lzcnt,popcnt")]
                #[allow(clippy::too_many_arguments)]
                fn avx2($($arg: $ty),*) $(-> $ret)? { $body($($arg),*) }
                #[target_feature(enable = "avx512f,avx512vl,avx512bw,avx512dq,avx2,fma,bmi2,lzcnt,popcnt")]
                #[allow(clippy::too_many_arguments)]
                fn avx512($($arg: $ty),*) $(-> $ret)? { $body($($arg),*) }
                match $crate::device::cpu::simd::level() {
                    // SAFETY: `level` has checked that the processor has these features.
                    $crate::device::cpu::simd::Level::Avx512 => return unsafe { avx512($($arg),*) },
                    // SAFETY: as above.
                    $crate::device::cpu::simd::Level::Avx2 => return unsafe { avx2($($arg),*) },
                    $crate::device::cpu::simd::Level::Portable => {}
                }
            }
            $body($($arg),*)
        }
    };
}
pub(crate) use dispatch;

/// Asks for the cache line of an address, if there is one. Rows of a brick are too short for the hardware to see a
/// stream: without this a brick waits for memory most of the time.
#[inline(always)]
pub fn prefetch(at: *const f32) {
    #[cfg(target_arch = "x86_64")]
    // SAFETY: a prefetch reads nothing and faults nowhere.
    unsafe {
        std::arch::x86_64::_mm_prefetch::<{ std::arch::x86_64::_MM_HINT_T1 }>(at.cast());
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = at;
}

/// `to[j·to_stride + i] = from[i·from_stride + j]` for i < rows, j < cols: rows of memory become columns.
///
/// # Safety
/// Every address above must lie in memory that may be read (`from`) or written (`to`), and the two must not overlap.
#[inline(always)]
pub unsafe fn transpose(
    from: *const f32,
    from_stride: isize,
    rows: usize,
    cols: usize,
    to: *mut f32,
    to_stride: isize,
) {
    #[cfg(target_arch = "x86_64")]
    if rows == 16 && cols == 16 && level() == Level::Avx512 {
        // SAFETY: the caller vouches for the addresses; `level` has seen the instruction set.
        unsafe { transpose_16(from, from_stride, to, to_stride) };
        return;
    }
    let (block_rows, block_cols) = if cfg!(target_arch = "x86_64") { (rows / 4 * 4, cols / 4 * 4) } else { (0, 0) };
    // SAFETY: the caller vouches for the addresses; SSE is part of every x86-64.
    unsafe {
        #[cfg(target_arch = "x86_64")]
        for i in (0..block_rows).step_by(4) {
            use std::arch::x86_64::{_MM_TRANSPOSE4_PS, _mm_loadu_ps, _mm_storeu_ps};
            for j in (0..block_cols).step_by(4) {
                let at = from.offset(i as isize * from_stride).add(j);
                let [mut a, mut b, mut c, mut d] = [0, 1, 2, 3].map(|k| _mm_loadu_ps(at.offset(k * from_stride)));
                _MM_TRANSPOSE4_PS(&mut a, &mut b, &mut c, &mut d);
                let at = to.offset(j as isize * to_stride).add(i);
                for (k, column) in [a, b, c, d].into_iter().enumerate() {
                    _mm_storeu_ps(at.offset(k as isize * to_stride), column);
                }
            }
        }
        for i in 0..rows {
            let first = if i < block_rows { block_cols } else { 0 };
            for j in first..cols {
                *to.offset(j as isize * to_stride).add(i) = *from.offset(i as isize * from_stride).add(j);
            }
        }
    }
}

/// [`transpose`] of 16 × 16 values: four rows a quarter of the block apart share a register, so that turning 4 × 4 in each
/// quarter makes whole columns.
///
/// # Safety
/// As for [`transpose`].
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f")]
unsafe fn transpose_16(from: *const f32, from_stride: isize, to: *mut f32, to_stride: isize) {
    use std::arch::x86_64::*;
    // SAFETY: the caller vouches for the addresses.
    unsafe {
        for j in (0..16).step_by(4) {
            // A macro, for a closure might be compiled by itself.
            macro_rules! quarters {
                ($i:literal) => {{
                    let from = from.add(j).offset($i * from_stride);
                    let all = _mm512_castps128_ps512(_mm_loadu_ps(from));
                    let all = _mm512_insertf32x4::<1>(all, _mm_loadu_ps(from.offset(4 * from_stride)));
                    let all = _mm512_insertf32x4::<2>(all, _mm_loadu_ps(from.offset(8 * from_stride)));
                    _mm512_insertf32x4::<3>(all, _mm_loadu_ps(from.offset(12 * from_stride)))
                }};
            }
            let (a, b, c, d) = (quarters!(0), quarters!(1), quarters!(2), quarters!(3));
            let (ab, cd) = (_mm512_unpacklo_ps(a, b), _mm512_unpacklo_ps(c, d));
            let (ab_high, cd_high) = (_mm512_unpackhi_ps(a, b), _mm512_unpackhi_ps(c, d));
            let columns = [
                _mm512_shuffle_ps::<0x44>(ab, cd),
                _mm512_shuffle_ps::<0xee>(ab, cd),
                _mm512_shuffle_ps::<0x44>(ab_high, cd_high),
                _mm512_shuffle_ps::<0xee>(ab_high, cd_high),
            ];
            for (k, column) in columns.into_iter().enumerate() {
                _mm512_storeu_ps(to.offset((j + k) as isize * to_stride), column);
            }
        }
    }
}

/// e^x for x ≤ 0 to 2 units in the last place, 0 below −87; `exp(0) = 1` exactly. Cephes' polynomial, range reduced by ln 2
/// in two parts; branch-free so that loops vectorise.
#[inline(always)]
pub fn exp(x: f32) -> f32 {
    const ROUND: f32 = 12_582_912.0; // 1.5·2²³: adding it rounds to an integer
    let clamped = x.max(-87.0);
    let shifted = clamped * std::f32::consts::LOG2_E + ROUND;
    let n = shifted - ROUND;
    let r = (clamped - n * 0.693_359_4) - n * -2.121_944_4e-4;
    let p = ((((1.987_569_1e-4 * r + 1.398_199_9e-3) * r + 8.333_452e-3) * r + 4.166_579_6e-2) * r + 1.666_666_5e-1)
        * r
        + 0.5;
    let y = r * r * p + r + 1.0;
    let scaled = f32::from_bits(y.to_bits().wrapping_add(shifted.to_bits() << 23));
    if x < -87.0 { 0.0 } else { scaled }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp_is_accurate() {
        assert_eq!(exp(0.0), 1.0);
        assert_eq!(exp(-100.0), 0.0);
        let worst = (0..870_000)
            .map(|i| {
                let x = -1e-4 * i as f32;
                let exact = f64::from(x).exp();
                (f64::from(exp(x)) - exact).abs() / exact
            })
            .fold(0.0, f64::max);
        assert!(worst < 2.5e-7, "relative error {worst}");
    }
}
