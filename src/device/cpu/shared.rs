//! Memory that threads write disjoint parts of.

/// Values shared between threads that write disjoint parts of them.
#[derive(Clone, Copy)]
pub(in crate::device::cpu) struct Shared(*mut f32, usize);
// SAFETY: only `row` gives access, and its callers vouch that nobody else writes those values.
unsafe impl Send for Shared {}
// SAFETY: as above.
unsafe impl Sync for Shared {}

impl Shared {
    pub(in crate::device::cpu) fn new(values: &mut [f32]) -> Self {
        Shared(values.as_mut_ptr(), values.len())
    }

    /// Values that are only read.
    pub(in crate::device::cpu) fn reading(values: &[f32]) -> Self {
        Shared(values.as_ptr().cast_mut(), values.len())
    }

    /// One value that nobody writes now.
    #[inline(always)]
    pub(in crate::device::cpu) fn get(self, at: usize) -> f32 {
        self.check(at, 1);
        // SAFETY: in bounds; fronts order reads after writes.
        unsafe { *self.0.add(at) }
    }

    /// `n` values from `at` on that nobody writes while the slice lives.
    #[inline(always)]
    pub(in crate::device::cpu) fn read<'a>(self, at: usize, n: usize) -> &'a [f32] {
        self.check(at, n);
        // SAFETY: in bounds; fronts order reads after writes.
        unsafe { std::slice::from_raw_parts(self.0.add(at), n) }
    }

    /// `n` values from `at` on.
    ///
    /// # Safety
    /// No other thread reads or writes them while the slice lives, and no other slice of them lives in this thread.
    #[inline(always)]
    #[allow(clippy::mut_from_ref)]
    pub(in crate::device::cpu) unsafe fn row<'a>(self, at: usize, n: usize) -> &'a mut [f32] {
        self.check(at, n);
        // SAFETY: in bounds; the caller vouches for the rest.
        unsafe { std::slice::from_raw_parts_mut(self.0.add(at), n) }
    }

    /// Panics unless `n` values from `at` on exist.
    #[inline(always)]
    pub(in crate::device::cpu) fn check(self, at: usize, n: usize) {
        assert!(at + n <= self.1, "a row beyond the grid");
    }

    /// Address of a value.
    #[inline(always)]
    pub(in crate::device::cpu) fn at(self, at: usize) -> *mut f32 {
        self.0.wrapping_add(at)
    }
}
