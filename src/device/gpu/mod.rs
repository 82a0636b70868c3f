//! wgpu adapters as devices.
