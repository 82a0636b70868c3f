//! Working memory that starts on a cache line, so that no access to a block of values straddles two.

use std::ops::{Deref, DerefMut};

use bytemuck::{Pod, Zeroable};

use super::WIDTH;

#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C, align(64))]
struct Line([f32; WIDTH]);

/// A growable slice of f32.
#[derive(Default)]
pub(super) struct Aligned(Vec<Line>);

impl Aligned {
    /// Makes it hold at least `len` values; new ones are 0. In powers of two, so that the next box of another shape finds room.
    pub fn grow(&mut self, len: usize) {
        let lines = len.div_ceil(WIDTH);
        if lines > self.0.len() {
            self.0.resize(lines.next_power_of_two(), Line::zeroed());
        }
    }
}

impl Deref for Aligned {
    type Target = [f32];
    #[inline(always)]
    fn deref(&self) -> &[f32] {
        bytemuck::cast_slice(&self.0)
    }
}

impl DerefMut for Aligned {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut [f32] {
        bytemuck::cast_slice_mut(&mut self.0)
    }
}
