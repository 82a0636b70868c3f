//! One step after another, each lit from the light of the one before.

use std::sync::{Arc, Mutex, PoisonError};

use gloaming::field::Timestep;
use gloaming::scene::{RangeKey, RangeOver, Scene};
use gloaming::sink::SinkOptions;
use gloaming::transfer::TransferFunction;
use gloaming::{Error, device, session};
use numpy::{IntoPyArray, PyArray4, PyArrayMethods, PyUntypedArray};
use pyo3::prelude::*;

use crate::array::block;
use crate::errors::raised;
use crate::frame::{Frame, Seen};
use crate::patience::patiently;

/// Frames of a step, and its fluence.
type Lit<'py> = (Vec<Frame>, Option<Bound<'py, PyArray4<f32>>>);

/// Lights one step after another.
#[pyclass(frozen, module = "gloaming._gloaming")]
pub struct Session {
    /// With a thread while a step is being lit.
    lit: Mutex<Option<session::Session>>,
    options: Arc<SinkOptions>,
    wants_light: bool,
}

#[pymethods]
impl Session {
    #[new]
    fn new(
        py: Python<'_>,
        scene: (String, String, Vec<String>),
        range: Option<[f64; 2]>,
        device: String,
        threads: usize,
        light: bool,
    ) -> PyResult<Session> {
        let (text, name, sets) = scene;
        let open = move || {
            let scene = Scene::parse(&text, &name, &sets)?;
            let options = Arc::new(SinkOptions {
                colors: TransferFunction::new(&scene.transfer)?.colors(),
                ..SinkOptions::from(&scene)
            });
            let session = session::Session::new(device::open(&device, threads)?, scene, range, light)?;
            Ok((session, options))
        };
        let (session, options) = patiently(py, open)?;
        Ok(Session { lit: Mutex::new(Some(session)), options, wants_light: light })
    }

    /// True when the scene wants one range for all steps, which has to be known before the first.
    #[staticmethod]
    fn wants_range(py: Python<'_>, scene: (String, String, Vec<String>)) -> PyResult<bool> {
        let (text, name, sets) = scene;
        let scene = Scene::parse(&text, &name, &sets).map_err(|e| raised(py, e))?;
        Ok(scene.field.range == RangeKey::Over(RangeOver::Series))
    }

    /// Lights an array (z, y, x): its frames, and its fluence of shape (z, y, x, 3) where that was asked for.
    fn advance<'py>(
        &self,
        py: Python<'py>,
        array: &Bound<'py, PyUntypedArray>,
        step: u64,
        time: Option<f64>,
        spacing: [f64; 3],
        origin: [f64; 3],
    ) -> PyResult<Lit<'py>> {
        let block = block(array, spacing, origin).and_then(|b| b.check().map(|()| b)).map_err(|e| raised(py, e))?;
        let slot = || self.lit.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(mut session) = slot().take() else {
            return Err(raised(py, Error::Closed("another thread lights a step, or one was interrupted".into())));
        };
        let options = self.options.clone();
        let work = move || {
            let step = Timestep { step, time, grid: block.grid(), field: Arc::new(block) };
            let output = session.advance(step);
            let output = output.map(|mut output| (output.light.take(), Seen::of(output, &options)));
            Ok((session, output))
        };
        let (session, output) = patiently(py, work)?;
        *slot() = Some(session);
        let (light, seen) = output.map_err(|e| raised(py, e))?;
        let frames = seen.into_iter().map(|seen| Frame::new(py, seen)).collect::<PyResult<_>>()?;
        let light = light.filter(|_| self.wants_light).map(|light| {
            let [nx, ny, nz] = light.grid.size;
            let fluence = Arc::unwrap_or_clone(light).fluence;
            fluence.into_flattened().into_pyarray(py).reshape([nz, ny, nx, 3])
        });
        Ok((frames, light.transpose()?))
    }
}
