//! Path tracing on the CPU.

pub mod emitter;
pub mod shapes;
