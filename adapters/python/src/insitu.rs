//! A running simulation's end: arrays go in, frames and movies come out.

use std::path::PathBuf;
use std::sync::Arc;

use gloaming::Error;
use gloaming::field::Timestep;
use gloaming::insitu::{self, Policy, Taken};
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
    /// Steps that may wait, where a push then waits for room.
    room: Option<u64>,
}

#[pymethods]
impl InSitu {
    #[new]
    fn new(py: Python<'_>, scene: (String, String, Vec<String>)) -> PyResult<InSitu> {
        let (text, name, sets) = scene;
        let (session, room) = patiently(py, move || {
            let scene = Scene::parse(&text, &name, &sets)?;
            let room = (scene.insitu.policy == Policy::Block).then_some(scene.insitu.queue as u64);
            Ok((insitu::InSitu::with(scene).open()?, room))
        })?;
        Ok(InSitu { session: Arc::new(session), room })
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
        let session = self.session.clone();
        let waiting = session.stats().waiting;
        let push = move || match give {
            true => {
                block.check()?;
                session.push_owned(Timestep { step, time, grid: block.grid(), field: Arc::new(block) })
            }
            false => session.push(step, time, &block),
        };
        // A push that may wait for room does so where Ctrl-C is answered; a thread for each push would cost more than small copies.
        let taken = match self.room {
            Some(room) if waiting >= room => patiently(py, push)?,
            _ => py.detach(push).map_err(|e| raised(py, e))?,
        };
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

    /// Keeps the light of the steps so far in a file.
    fn save_light(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let session = self.session.clone();
        patiently(py, move || session.save_light(&path))
    }

    /// What has become of the steps, as JSON.
    fn stats(&self, py: Python<'_>) -> PyResult<String> {
        serde_json::to_string(&self.session.stats()).map_err(|e| raised(py, Error::Bug(e.to_string())))
    }

    /// Lights what is still waiting and closes every file.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        let session = self.session.clone();
        patiently(py, move || session.close().map(|_| ()))
    }
}
