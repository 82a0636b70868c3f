//! A running simulation's end: arrays go in, frames and movies come out.

use std::sync::Arc;

use gloaming::field::Timestep;
use gloaming::insitu::{self, Taken};
use gloaming::scene::Scene;
use numpy::PyUntypedArray;
use pyo3::prelude::*;

use crate::array::block;
use crate::errors::raised;
use crate::patience::patiently;

/// An open session.
#[pyclass(frozen, module = "gloaming._gloaming")]
pub struct InSitu {
    session: Arc<insitu::InSitu>,
}

#[pymethods]
impl InSitu {
    #[new]
    fn new(py: Python<'_>, scene: (String, String, Vec<String>)) -> PyResult<InSitu> {
        let (text, name, sets) = scene;
        let session = patiently(py, move || insitu::InSitu::with(Scene::parse(&text, &name, &sets)?).open())?;
        Ok(InSitu { session: Arc::new(session) })
    }

    /// Copies an array (z, y, x) into the queue, or takes it as it is when it is given: `queued`, `dropped` or `skipped`.
    fn push(
        &self,
        py: Python<'_>,
        array: &Bound<'_, PyUntypedArray>,
        step: u64,
        time: Option<f64>,
        spacing: [f64; 3],
        origin: [f64; 3],
        give: bool,
    ) -> PyResult<&'static str> {
        let block = block(array, spacing, origin).map_err(|e| raised(py, e))?;
        let pushed = py.detach(|| {
            if give {
                block.check()?;
                self.session.push_owned(Timestep { step, time, grid: block.grid(), field: Arc::new(block) })
            } else {
                self.session.push(step, time, &block)
            }
        });
        let taken = pushed.map_err(|e| raised(py, e))?;
        // A policy of waiting may have held us for long.
        py.check_signals()?;
        Ok(match taken {
            Taken::Queued => "queued",
            Taken::Dropped => "dropped",
            Taken::Skipped => "skipped",
        })
    }

    /// Waits until every step so far is lit and written.
    fn flush(&self, py: Python<'_>) -> PyResult<()> {
        let session = self.session.clone();
        patiently(py, move || session.flush())
    }

    /// What has become of the steps, as JSON.
    fn stats(&self) -> String {
        serde_json::to_string(&self.session.stats()).unwrap_or_default()
    }

    /// Lights what is still waiting and closes every file.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        let session = self.session.clone();
        patiently(py, move || session.close().map(|_| ()))
    }
}
