//! Lanes: the arithmetic of a packet of rays, one instruction set per implementation.
//!
//! Every operation is a single IEEE operation on each lane (no fused multiply-add, no approximate reciprocals), so a lane
//! holds the same bits whatever the instruction set and however many lanes travel with it.

use std::ops::{Add, BitAnd, Div, Mul, Sub};

/// `N` rays side by side.
///
/// # Safety
/// Implementations for an instruction set use it without asking: they may be instantiated only in code that is compiled
/// for it and runs only where the processor has it.
pub(in crate::device::cpu) unsafe trait Lanes:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self>
{
    /// Comparison result.
    type Mask: Copy + BitAnd<Output = Self::Mask>;
    /// Integers, wide enough for the index of any value that the instruction set may gather.
    type Int: Copy;

    /// Pixels of a packet along x and y; their product is the number of lanes.
    const SHAPE: [usize; 2];
    /// Largest number of values that [`Lanes::gather`] and [`Lanes::pairs`] can address.
    const REACH: usize;

    fn splat(value: f32) -> Self;
    /// Lane i holds `f(i)`.
    fn from_fn(f: impl FnMut(usize) -> f32) -> Self;
    fn store(self, out: &mut [f32]);
    /// `self > other ? self : other`: `other` where either is NaN.
    fn max(self, other: Self) -> Self;
    /// `self < other ? self : other`: `other` where either is NaN.
    fn min(self, other: Self) -> Self;
    fn sqrt(self) -> Self;
    /// False where either is NaN.
    fn lt(self, other: Self) -> Self::Mask;
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;
    fn any(mask: Self::Mask) -> bool;
    /// Towards zero; lanes must fit an i32.
    fn trunc(self) -> Self::Int;
    fn float(int: Self::Int) -> Self;
    /// `i[0] + i[1]·stride[0] + i[2]·stride[1]`.
    fn linear(i: [Self::Int; 3], stride: [usize; 2]) -> Self::Int;
    /// 2^n for integral −126 ≤ n ≤ 0.
    fn exp2i(n: Self) -> Self;

    /// `values[index]`.
    ///
    /// # Safety
    /// Every lane of `index` is in `0..len` of the array at `values`, and `len ≤ REACH`.
    unsafe fn gather(values: *const f32, index: Self::Int) -> Self;
    /// `values[index]` and `values[index + 1]`, in half the loads of two gathers.
    ///
    /// # Safety
    /// Every lane of `index` is in `0..len − 1` of the array at `values`, and `len ≤ REACH`.
    unsafe fn pairs(values: *const f32, index: Self::Int) -> (Self, Self);
}

/// `1 − e^(−τ)` for τ ≥ 0, accurate to a few units in the last place for small τ too: Cephes' polynomial without its leading
/// 1, range reduced by ln 2 in two parts. 1 above 87.
#[inline(always)]
pub(in crate::device::cpu) fn opacity<V: Lanes>(tau: V) -> V {
    let c = |v: f32| V::splat(v);
    let round = c(12_582_912.0); // 1.5·2²³: adding it rounds to an integer
    let x = c(0.0) - tau.min(c(87.0));
    let n = (x * c(std::f32::consts::LOG2_E) + round) - round;
    let r = (x - n * c(0.693_359_4)) - n * c(-2.121_944_4e-4);
    let p = ((((c(1.987_569_1e-4) * r + c(1.398_199_9e-3)) * r + c(8.333_452e-3)) * r + c(4.166_579_6e-2)) * r
        + c(1.666_666_5e-1))
        * r
        + c(0.5);
    let grown = r * r * p + r;
    let scale = V::exp2i(n);
    (c(1.0) - scale) - scale * grown
}

/// Plain arrays: any machine, and with one lane the scalar twin.
#[derive(Clone, Copy)]
pub(in crate::device::cpu) struct Array<const N: usize>([f32; N]);

#[derive(Clone, Copy)]
pub(in crate::device::cpu) struct Flags<const N: usize>([bool; N]);

/// `[f(0), …, f(N − 1)]` without a closure, which would be compiled without the caller's instruction set and might stay a call.
macro_rules! each {
    ($i:ident: $n:expr, $zero:expr => $value:expr) => {{
        let mut lanes = [$zero; $n];
        for $i in 0..$n {
            lanes[$i] = $value;
        }
        lanes
    }};
}

impl<const N: usize> BitAnd for Flags<N> {
    type Output = Self;
    #[inline(always)]
    fn bitand(self, other: Self) -> Self {
        Flags(each!(i: N, false => self.0[i] & other.0[i]))
    }
}

macro_rules! array_operator {
    ($($trait:ident $name:ident $op:tt),*) => {$(
        impl<const N: usize> $trait for Array<N> {
            type Output = Self;
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                Array(each!(i: N, 0.0 => self.0[i] $op other.0[i]))
            }
        }
    )*};
}
array_operator!(Add add +, Sub sub -, Mul mul *, Div div /);

// SAFETY: plain Rust, any target.
unsafe impl<const N: usize> Lanes for Array<N> {
    type Mask = Flags<N>;
    type Int = [isize; N];

    const SHAPE: [usize; 2] = match N {
        1 => [1, 1],
        4 => [2, 2],
        8 => [4, 2],
        _ => panic!("give this number of lanes a shape"),
    };
    const REACH: usize = isize::MAX as usize;

    #[inline(always)]
    fn splat(value: f32) -> Self {
        Array([value; N])
    }
    #[inline(always)]
    fn from_fn(mut f: impl FnMut(usize) -> f32) -> Self {
        Array(each!(i: N, 0.0 => f(i)))
    }
    #[inline(always)]
    fn store(self, out: &mut [f32]) {
        out[..N].copy_from_slice(&self.0);
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Array(each!(i: N, 0.0 => if self.0[i] > other.0[i] { self.0[i] } else { other.0[i] }))
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Array(each!(i: N, 0.0 => if self.0[i] < other.0[i] { self.0[i] } else { other.0[i] }))
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Array(each!(i: N, 0.0 => self.0[i].sqrt()))
    }
    #[inline(always)]
    fn lt(self, other: Self) -> Flags<N> {
        Flags(each!(i: N, false => self.0[i] < other.0[i]))
    }
    #[inline(always)]
    fn select(mask: Flags<N>, yes: Self, no: Self) -> Self {
        Array(each!(i: N, 0.0 => if mask.0[i] { yes.0[i] } else { no.0[i] }))
    }
    #[inline(always)]
    fn any(mask: Flags<N>) -> bool {
        let mut any = false;
        for flag in mask.0 {
            any |= flag;
        }
        any
    }
    #[inline(always)]
    fn trunc(self) -> [isize; N] {
        // SAFETY: lanes fit an i32, by the contract of `trunc`; callers clamp, and clamping maps NaN into the range.
        each!(i: N, 0 => unsafe { self.0[i].to_int_unchecked::<i32>() as isize })
    }
    #[inline(always)]
    fn float(int: [isize; N]) -> Self {
        Array(each!(i: N, 0.0 => int[i] as i32 as f32))
    }
    #[inline(always)]
    fn linear(i: [[isize; N]; 3], stride: [usize; 2]) -> [isize; N] {
        each!(l: N, 0 => i[0][l] + i[1][l] * stride[0] as isize + i[2][l] * stride[1] as isize)
    }
    #[inline(always)]
    fn exp2i(n: Self) -> Self {
        // SAFETY: 1 ≤ n + 127 ≤ 127, by the contract of `exp2i`.
        Array(each!(i: N, 0.0 => f32::from_bits(unsafe { (n.0[i] + 127.0).to_int_unchecked::<i32>() as u32 } << 23)))
    }
    #[inline(always)]
    unsafe fn gather(values: *const f32, index: [isize; N]) -> Self {
        // SAFETY: indices are inside the array, by this function's contract.
        Array(each!(i: N, 0.0 => unsafe { *values.offset(index[i]) }))
    }
    #[inline(always)]
    unsafe fn pairs(values: *const f32, index: [isize; N]) -> (Self, Self) {
        // SAFETY: indices and their successors are inside the array, by this function's contract.
        unsafe { (Self::gather(values, index), Self::gather(values.add(1), index)) }
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::*;
    use std::ops::{Add, BitAnd, Div, Mul, Sub};

    use super::Lanes;

    macro_rules! operator {
        ($lanes:ident: $($trait:ident $name:ident $intrinsic:ident),*) => {$(
            impl $trait for $lanes {
                type Output = Self;
                #[inline(always)]
                fn $name(self, other: Self) -> Self {
                    // SAFETY: the instruction set is there, by the contract of `Lanes`.
                    $lanes(unsafe { $intrinsic(self.0, other.0) })
                }
            }
        )*};
    }

    /// 16 lanes of AVX-512.
    #[derive(Clone, Copy)]
    pub(in crate::device::cpu) struct Avx512(__m512);

    operator!(Avx512: Add add _mm512_add_ps, Sub sub _mm512_sub_ps, Mul mul _mm512_mul_ps, Div div _mm512_div_ps);

    // SAFETY: instantiated only by `march::avx512`, which is compiled for AVX-512 F and DQ.
    unsafe impl Lanes for Avx512 {
        type Mask = __mmask16;
        type Int = __m512i;

        const SHAPE: [usize; 2] = [4, 4];
        const REACH: usize = i32::MAX as usize;

        #[inline(always)]
        fn splat(value: f32) -> Self {
            // SAFETY: the instruction set is there, by the contract of `Lanes`; so in all that follows.
            Avx512(unsafe { _mm512_set1_ps(value) })
        }
        #[inline(always)]
        fn from_fn(f: impl FnMut(usize) -> f32) -> Self {
            let lanes: [f32; 16] = std::array::from_fn(f);
            // SAFETY: as above; 16 values are readable.
            Avx512(unsafe { _mm512_loadu_ps(lanes.as_ptr()) })
        }
        #[inline(always)]
        fn store(self, out: &mut [f32]) {
            let out = &mut out[..16];
            // SAFETY: as above; 16 values are writable.
            unsafe { _mm512_storeu_ps(out.as_mut_ptr(), self.0) }
        }
        #[inline(always)]
        fn max(self, other: Self) -> Self {
            // SAFETY: as above.
            Avx512(unsafe { _mm512_max_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn min(self, other: Self) -> Self {
            // SAFETY: as above.
            Avx512(unsafe { _mm512_min_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn sqrt(self) -> Self {
            // SAFETY: as above.
            Avx512(unsafe { _mm512_sqrt_ps(self.0) })
        }
        #[inline(always)]
        fn lt(self, other: Self) -> __mmask16 {
            // SAFETY: as above.
            unsafe { _mm512_cmp_ps_mask::<_CMP_LT_OQ>(self.0, other.0) }
        }
        #[inline(always)]
        fn select(mask: __mmask16, yes: Self, no: Self) -> Self {
            // SAFETY: as above.
            Avx512(unsafe { _mm512_mask_blend_ps(mask, no.0, yes.0) })
        }
        #[inline(always)]
        fn any(mask: __mmask16) -> bool {
            mask != 0
        }
        #[inline(always)]
        fn trunc(self) -> __m512i {
            // SAFETY: as above.
            unsafe { _mm512_cvttps_epi32(self.0) }
        }
        #[inline(always)]
        fn float(int: __m512i) -> Self {
            // SAFETY: as above.
            Avx512(unsafe { _mm512_cvtepi32_ps(int) })
        }
        #[inline(always)]
        fn linear(i: [__m512i; 3], stride: [usize; 2]) -> __m512i {
            // SAFETY: as above.
            unsafe {
                let y = _mm512_mullo_epi32(i[1], _mm512_set1_epi32(stride[0] as i32));
                let z = _mm512_mullo_epi32(i[2], _mm512_set1_epi32(stride[1] as i32));
                _mm512_add_epi32(i[0], _mm512_add_epi32(y, z))
            }
        }
        #[inline(always)]
        fn exp2i(n: Self) -> Self {
            // SAFETY: as above.
            unsafe {
                let biased = _mm512_cvttps_epi32(_mm512_add_ps(n.0, _mm512_set1_ps(127.0)));
                Avx512(_mm512_castsi512_ps(_mm512_slli_epi32::<23>(biased)))
            }
        }
        #[inline(always)]
        unsafe fn gather(values: *const f32, index: __m512i) -> Self {
            // SAFETY: as above; indices are inside the array, by this function's contract.
            Avx512(unsafe { _mm512_i32gather_ps::<4>(index, values) })
        }
        #[inline(always)]
        unsafe fn pairs(values: *const f32, index: __m512i) -> (Self, Self) {
            // SAFETY: as above; indices and their successors are inside the array, by this function's contract.
            unsafe {
                let values = values.cast::<f64>();
                let lo = _mm512_i32gather_pd::<4>(_mm512_castsi512_si256(index), values);
                let hi = _mm512_i32gather_pd::<4>(_mm512_extracti64x4_epi64::<1>(index), values);
                let (lo, hi) = (_mm512_castpd_ps(lo), _mm512_castpd_ps(hi));
                let even = _mm512_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
                let odd = _mm512_setr_epi32(1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23, 25, 27, 29, 31);
                (Avx512(_mm512_permutex2var_ps(lo, even, hi)), Avx512(_mm512_permutex2var_ps(lo, odd, hi)))
            }
        }
    }

    /// 8 lanes of AVX2.
    #[derive(Clone, Copy)]
    pub(in crate::device::cpu) struct Avx2(__m256);
    #[derive(Clone, Copy)]
    pub(in crate::device::cpu) struct Avx2Mask(__m256);

    impl BitAnd for Avx2Mask {
        type Output = Self;
        #[inline(always)]
        fn bitand(self, other: Self) -> Self {
            // SAFETY: the instruction set is there, by the contract of `Lanes`.
            Avx2Mask(unsafe { _mm256_and_ps(self.0, other.0) })
        }
    }

    operator!(Avx2: Add add _mm256_add_ps, Sub sub _mm256_sub_ps, Mul mul _mm256_mul_ps, Div div _mm256_div_ps);

    // SAFETY: instantiated only by `march::avx2`, which is compiled for AVX2.
    unsafe impl Lanes for Avx2 {
        type Mask = Avx2Mask;
        type Int = __m256i;

        const SHAPE: [usize; 2] = [4, 2];
        const REACH: usize = i32::MAX as usize;

        #[inline(always)]
        fn splat(value: f32) -> Self {
            // SAFETY: the instruction set is there, by the contract of `Lanes`; so in all that follows.
            Avx2(unsafe { _mm256_set1_ps(value) })
        }
        #[inline(always)]
        fn from_fn(f: impl FnMut(usize) -> f32) -> Self {
            let lanes: [f32; 8] = std::array::from_fn(f);
            // SAFETY: as above; 8 values are readable.
            Avx2(unsafe { _mm256_loadu_ps(lanes.as_ptr()) })
        }
        #[inline(always)]
        fn store(self, out: &mut [f32]) {
            let out = &mut out[..8];
            // SAFETY: as above; 8 values are writable.
            unsafe { _mm256_storeu_ps(out.as_mut_ptr(), self.0) }
        }
        #[inline(always)]
        fn max(self, other: Self) -> Self {
            // SAFETY: as above.
            Avx2(unsafe { _mm256_max_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn min(self, other: Self) -> Self {
            // SAFETY: as above.
            Avx2(unsafe { _mm256_min_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn sqrt(self) -> Self {
            // SAFETY: as above.
            Avx2(unsafe { _mm256_sqrt_ps(self.0) })
        }
        #[inline(always)]
        fn lt(self, other: Self) -> Avx2Mask {
            // SAFETY: as above.
            Avx2Mask(unsafe { _mm256_cmp_ps::<_CMP_LT_OQ>(self.0, other.0) })
        }
        #[inline(always)]
        fn select(mask: Avx2Mask, yes: Self, no: Self) -> Self {
            // SAFETY: as above.
            Avx2(unsafe { _mm256_blendv_ps(no.0, yes.0, mask.0) })
        }
        #[inline(always)]
        fn any(mask: Avx2Mask) -> bool {
            // SAFETY: as above.
            unsafe { _mm256_movemask_ps(mask.0) != 0 }
        }
        #[inline(always)]
        fn trunc(self) -> __m256i {
            // SAFETY: as above.
            unsafe { _mm256_cvttps_epi32(self.0) }
        }
        #[inline(always)]
        fn float(int: __m256i) -> Self {
            // SAFETY: as above.
            Avx2(unsafe { _mm256_cvtepi32_ps(int) })
        }
        #[inline(always)]
        fn linear(i: [__m256i; 3], stride: [usize; 2]) -> __m256i {
            // SAFETY: as above.
            unsafe {
                let y = _mm256_mullo_epi32(i[1], _mm256_set1_epi32(stride[0] as i32));
                let z = _mm256_mullo_epi32(i[2], _mm256_set1_epi32(stride[1] as i32));
                _mm256_add_epi32(i[0], _mm256_add_epi32(y, z))
            }
        }
        #[inline(always)]
        fn exp2i(n: Self) -> Self {
            // SAFETY: as above.
            unsafe {
                let biased = _mm256_cvttps_epi32(_mm256_add_ps(n.0, _mm256_set1_ps(127.0)));
                Avx2(_mm256_castsi256_ps(_mm256_slli_epi32::<23>(biased)))
            }
        }
        #[inline(always)]
        unsafe fn gather(values: *const f32, index: __m256i) -> Self {
            // SAFETY: as above; indices are inside the array, by this function's contract.
            Avx2(unsafe { _mm256_i32gather_ps::<4>(values, index) })
        }
        #[inline(always)]
        unsafe fn pairs(values: *const f32, index: __m256i) -> (Self, Self) {
            // SAFETY: as above; indices and their successors are inside the array, by this function's contract.
            unsafe {
                let values = values.cast::<f64>();
                let lo = _mm256_i32gather_pd::<4>(values, _mm256_castsi256_si128(index));
                let hi = _mm256_i32gather_pd::<4>(values, _mm256_extracti128_si256::<1>(index));
                let (lo, hi) = (_mm256_castpd_ps(lo), _mm256_castpd_ps(hi));
                let even = _mm256_castps_pd(_mm256_shuffle_ps::<0b10_00_10_00>(lo, hi));
                let odd = _mm256_castps_pd(_mm256_shuffle_ps::<0b11_01_11_01>(lo, hi));
                let even = _mm256_castpd_ps(_mm256_permute4x64_pd::<0b11_01_10_00>(even));
                let odd = _mm256_castpd_ps(_mm256_permute4x64_pd::<0b11_01_10_00>(odd));
                (Avx2(even), Avx2(odd))
            }
        }
    }
}
#[cfg(target_arch = "x86_64")]
pub(in crate::device::cpu) use x86::{Avx2, Avx512};

#[cfg(test)]
mod tests {
    use super::*;

    fn opacity_of(tau: f32) -> f32 {
        opacity(Array([tau])).0[0]
    }

    #[test]
    fn opacity_keeps_its_digits_however_thin_the_sample() {
        assert_eq!(opacity_of(0.0), 0.0);
        assert_eq!(opacity_of(1e9), 1.0);
        let worst = (0..4000)
            .map(|i| {
                let tau = 10f32.powf(-30.0 + 0.008 * i as f32);
                let exact = -(-f64::from(tau)).exp_m1();
                (f64::from(opacity_of(tau)) - exact).abs() / exact
            })
            .fold(0.0, f64::max);
        assert!(worst < 2.5e-7, "relative error {worst}");
    }
}
