//! Frames: scene-linear pixels as NumPy has them, and the picture that people see.

use gloaming::sink::{self, Output, SinkOptions, View};
use numpy::{IntoPyArray, PyArray3, PyArrayMethods, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::errors::raised;

/// One camera's picture of one step.
#[pyclass(frozen, module = "gloaming")]
pub struct Frame {
    /// The simulation's step number.
    #[pyo3(get)]
    step: u64,
    /// Physical time, where known.
    #[pyo3(get)]
    time: Option<f64>,
    /// Name of the camera.
    #[pyo3(get)]
    camera: String,
    /// Scene-linear radiance, premultiplied by coverage, shape (height, width, 4): red, green, blue, coverage.
    #[pyo3(get)]
    array: Py<PyArray3<f32>>,
    /// What a screen shows, shape (height, width, 3), 8-bit sRGB: over the background, exposed, tone-mapped, with overlay.
    #[pyo3(get)]
    rgb: Py<PyArray3<u8>>,
}

/// A lit view before Python has it.
pub struct Seen {
    view: View,
    picture: Vec<u8>,
    step: u64,
    time: Option<f64>,
}

impl Seen {
    /// The views of a step, drawn.
    pub fn of(mut output: Output, options: &SinkOptions) -> Vec<Seen> {
        let pictures: Vec<_> = output.frames.iter().map(|view| options.picture(&output, view).into_raw()).collect();
        let views = std::mem::take(&mut output.frames).into_iter().zip(pictures);
        views.map(|(view, picture)| Seen { view, picture, step: output.step, time: output.time }).collect()
    }
}

impl Frame {
    /// As Python has it; pixels are handed over, not copied.
    pub fn new(py: Python<'_>, seen: Seen) -> PyResult<Frame> {
        let Seen { view, picture, step, time } = seen;
        let [w, h] = view.frame.size;
        let array = view.frame.pixels.into_flattened().into_pyarray(py).reshape([h, w, 4])?;
        let rgb = picture.into_pyarray(py).reshape([h, w, 3])?;
        Ok(Frame { step, time, camera: view.camera, array: array.unbind(), rgb: rgb.unbind() })
    }
}

#[pymethods]
impl Frame {
    /// The picture as the bytes of a PNG file.
    #[getter]
    fn png<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        png(self.rgb.bind(py).readonly())
    }

    fn _repr_png_<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        self.png(py)
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let shape = self.array.bind(py).shape().to_vec();
        let time = self.time.map(|t| format!(", time {t}")).unwrap_or_default();
        format!(
            "<gloaming.Frame of step {}{time}, camera {:?}: {}×{} pixels>",
            self.step, self.camera, shape[1], shape[0]
        )
    }
}

/// The bytes of a PNG file of an 8-bit picture of shape (height, width, 3).
#[pyfunction]
pub fn png<'py>(picture: PyReadonlyArray3<'py, u8>) -> PyResult<Bound<'py, PyBytes>> {
    let py = picture.py();
    let [h, w] = [picture.shape()[0], picture.shape()[1]];
    let values: Vec<u8> = picture.as_array().iter().copied().collect();
    let bytes = py.detach(|| sink::png_bytes([w, h], &values)).map_err(|e| raised(py, e))?;
    Ok(PyBytes::new(py, &bytes))
}
