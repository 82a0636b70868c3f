//! The compiled part of the Python package `gloaming`: NumPy arrays in and out, nothing that Python itself does well.
//!
//! What people see is in `python/gloaming`; names and signatures here are in `python/gloaming/_gloaming.pyi`.

use pyo3::prelude::*;

mod array;
mod errors;
mod frame;
mod insitu;
mod patience;
mod series;
mod session;

#[pymodule]
mod _gloaming {
    use pyo3::prelude::*;

    #[pymodule_export]
    use super::frame::{Frame, png};
    #[pymodule_export]
    use super::insitu::InSitu;
    #[pymodule_export]
    use super::series::Series;
    #[pymodule_export]
    use super::session::Session;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        // Warnings would reach nobody without a subscriber.
        let _ = tracing_subscriber::fmt()
            .with_max_level(tracing_subscriber::filter::LevelFilter::WARN)
            .with_writer(std::io::stderr)
            .without_time()
            .try_init();
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
