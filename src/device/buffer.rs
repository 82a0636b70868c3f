//! Memory that a device works on.

/// A dense array of f32 where the device can work on it. Made by [`Device::alloc`](super::Device::alloc); used only with the device that made it.
pub struct Buffer(pub(crate) Storage);

pub(crate) enum Storage {
    Host(Vec<f32>),
    /// A file that the CPU looks at as memory.
    Mapped(super::cpu::mapped::Mapped),
    Paged(Box<super::paged::Store>),
    #[cfg(feature = "gpu")]
    Gpu {
        buffer: wgpu::Buffer,
        len: usize,
    },
}

impl Buffer {
    /// Number of values.
    pub fn len(&self) -> usize {
        match &self.0 {
            Storage::Host(v) => v.len(),
            Storage::Mapped(m) => m.values().len(),
            Storage::Paged(store) => store.len,
            #[cfg(feature = "gpu")]
            Storage::Gpu { len, .. } => *len,
        }
    }

    /// True when there are no values.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The values, when they are in host memory.
    pub fn host(&self) -> Option<&[f32]> {
        match &self.0 {
            Storage::Host(v) => Some(v),
            Storage::Mapped(m) => Some(m.values()),
            _ => None,
        }
    }
}
