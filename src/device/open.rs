//! The choice of a device by name.

use std::sync::Arc;

use super::Device;
use super::cpu::Cpu;
#[cfg(feature = "gpu")]
use super::gpu::Gpu;
use crate::error::Result;

/// The device of a name: `auto` takes a hardware GPU where there is one, else the CPU; `cpu` and `gpu` insist; anything else
/// is part of an adapter's name. `threads` bounds the CPU's threads; 0 is one for each core.
///
/// # Errors
/// [`Error::Device`](crate::Error::Device) when there is no such device, naming what there is.
pub fn open(name: &str, threads: usize) -> Result<Arc<dyn Device>> {
    match name {
        "auto" => match hardware(threads) {
            Some(gpu) => Ok(gpu),
            None => Ok(Arc::new(Cpu::new(threads)?)),
        },
        "cpu" => Ok(Arc::new(Cpu::new(threads)?)),
        "gpu" => open_gpu(None, threads),
        name => open_gpu(Some(name), threads),
    }
}

#[cfg(feature = "gpu")]
fn hardware(threads: usize) -> Option<Arc<dyn Device>> {
    match Gpu::hardware() {
        Ok(gpu) => gpu.map(|gpu| Arc::new(gpu.with_threads(threads)) as Arc<dyn Device>),
        Err(e) => {
            tracing::debug!("{e}");
            None
        }
    }
}

#[cfg(not(feature = "gpu"))]
fn hardware(_: usize) -> Option<Arc<dyn Device>> {
    None
}

#[cfg(feature = "gpu")]
fn open_gpu(name: Option<&str>, threads: usize) -> Result<Arc<dyn Device>> {
    Ok(Arc::new(Gpu::open(name)?.with_threads(threads)))
}

#[cfg(not(feature = "gpu"))]
fn open_gpu(_: Option<&str>, _: usize) -> Result<Arc<dyn Device>> {
    Err(crate::Error::Device("built without GPU support (feature `gpu`)\n  try: --device cpu".into()))
}
