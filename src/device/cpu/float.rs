//! The floating-point environment: gloaming's arithmetic wants the default one, and the program it is linked into wants its
//! own back.
//!
//! A solver may trap on NaN (`-ffpe-trap=invalid`), flush subnormal numbers or round in another direction. New threads
//! inherit that from the thread that starts them.

use std::marker::PhantomData;

/// Default rounding, no traps, no flushing, as long as it lives; what was there before comes back with it, exception flags
/// included. Of this thread alone.
#[must_use = "the environment is the default one only while this lives"]
pub struct DefaultFloat {
    before: u64,
    _this_thread: PhantomData<*const ()>,
}

impl DefaultFloat {
    /// Takes over this thread's environment.
    pub fn enter() -> Self {
        let before = control();
        set_control(DEFAULT);
        DefaultFloat { before, _this_thread: PhantomData }
    }
}

impl Drop for DefaultFloat {
    fn drop(&mut self) {
        set_control(self.before);
    }
}

/// MXCSR after a reset: all exceptions masked, round to nearest.
#[cfg(target_arch = "x86_64")]
const DEFAULT: u64 = 0x1f80;
#[cfg(not(target_arch = "x86_64"))]
const DEFAULT: u64 = 0;

/// The control register; 0 where there is none that we know.
fn control() -> u64 {
    #[cfg(target_arch = "x86_64")]
    {
        let mut mxcsr = 0u32;
        // SAFETY: writes four bytes to a place of ours; every x86-64 has SSE.
        unsafe { std::arch::asm!("stmxcsr [{}]", in(reg) &raw mut mxcsr, options(nostack, preserves_flags)) };
        u64::from(mxcsr)
    }
    #[cfg(target_arch = "aarch64")]
    {
        let fpcr: u64;
        // SAFETY: reads a register that user programs may read.
        unsafe { std::arch::asm!("mrs {}, fpcr", out(reg) fpcr, options(nomem, nostack, preserves_flags)) };
        fpcr
    }
    #[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
    0
}

fn set_control(value: u64) {
    #[cfg(target_arch = "x86_64")]
    {
        let mxcsr = value as u32;
        // SAFETY: reads four bytes of ours, which hold what `stmxcsr` gave or the value after a reset: no reserved bit is set.
        unsafe { std::arch::asm!("ldmxcsr [{}]", in(reg) &raw const mxcsr, options(nostack, preserves_flags)) };
    }
    #[cfg(target_arch = "aarch64")]
    // SAFETY: sets a register that user programs may set, to what it held or to its value after a reset.
    unsafe {
        std::arch::asm!("msr fpcr, {}", in(reg) value, options(nomem, nostack, preserves_flags))
    };
    #[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
    let _ = value;
}

#[cfg(all(test, target_arch = "x86_64"))]
mod tests {
    use super::*;

    /// Rounding downwards, subnormals flushed: neither is seen inside, both are back afterwards.
    #[test]
    fn the_callers_environment_comes_back() {
        let own = DEFAULT | 0x2000 | 0x8000;
        let outer = DefaultFloat::enter();
        set_control(own);
        // 1/3 lies nearer to the float above it.
        let third = || std::hint::black_box(std::hint::black_box(1.0f32) / std::hint::black_box(3.0f32));
        let downwards = third();
        let inside = {
            let _default = DefaultFloat::enter();
            third()
        };
        // The quotient has raised "inexact" outside, which stays raised; nothing else may differ.
        assert_eq!(control() & !0x3f, own);
        drop(outer);
        assert!(downwards < inside, "{downwards} {inside}");
    }
}
