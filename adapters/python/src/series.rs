//! Series of files, read step by step.

use std::sync::Arc;

use gloaming::Error;
use gloaming::source::{self, SourceSpec};
use numpy::{IntoPyArray, PyArray3, PyArrayMethods};
use pyo3::prelude::*;

use crate::errors::raised;
use crate::patience::patiently;

/// A series of timesteps in files.
#[pyclass(frozen, module = "gloaming._gloaming")]
pub struct Series {
    series: Arc<dyn source::Series>,
}

#[pymethods]
impl Series {
    #[new]
    fn new(
        py: Python<'_>,
        series: Vec<String>,
        field: Option<String>,
        component: Option<String>,
        axes: Option<String>,
        place: (Option<[f64; 3]>, Option<[f64; 3]>, Option<f64>),
        raw: Option<String>,
        level: Option<usize>,
    ) -> PyResult<Series> {
        let (spacing, origin, time_step) = place;
        let spec = SourceSpec { series, field, component, axes, spacing, origin, time_step, raw, level, memory: None };
        Ok(Series { series: patiently(py, move || source::open(&spec))?.into() })
    }

    /// What was found, as JSON.
    fn info(&self, py: Python<'_>) -> PyResult<String> {
        serde_json::to_string(self.series.info()).map_err(|e| raised(py, Error::Bug(e.to_string())))
    }

    /// The values of the `index`-th step as f32, (z, y, x), with where the first of them sits.
    fn read<'py>(&self, py: Python<'py>, index: usize) -> PyResult<(Bound<'py, PyArray3<f32>>, [f64; 3])> {
        let series = self.series.clone();
        let (grid, values) = patiently(py, move || {
            let step = series.timestep(index)?;
            let mut values = vec![0.0; step.grid.len()];
            step.field.read(step.grid.region(), &mut values)?;
            Ok((step.grid, values))
        })?;
        Ok((shaped(py, values, grid.size)?, grid.origin))
    }

    /// The same as f64.
    fn read_f64<'py>(&self, py: Python<'py>, index: usize) -> PyResult<(Bound<'py, PyArray3<f64>>, [f64; 3])> {
        let series = self.series.clone();
        let (grid, values) = patiently(py, move || {
            let step = series.timestep(index)?;
            let mut values = vec![0.0; step.grid.len()];
            step.field.read_f64(step.grid.region(), &mut values)?;
            Ok((step.grid, values))
        })?;
        Ok((shaped(py, values, grid.size)?, grid.origin))
    }
}

fn shaped<T: numpy::Element>(
    py: Python<'_>,
    values: Vec<T>,
    [nx, ny, nz]: [usize; 3],
) -> PyResult<Bound<'_, PyArray3<T>>> {
    values.into_pyarray(py).reshape([nz, ny, nx])
}
