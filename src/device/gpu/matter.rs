//! Data and their optics as kernels bind them: see `shaders/matter.wgsl`.

use encase::ShaderType;
use glam::Vec3;

use super::{Gpu, holds};
use crate::device::Buffer;
use crate::error::{Error, Result};
use crate::transfer::Table;

#[derive(ShaderType)]
struct Optics {
    albedo: Vec3,
    extinction: f32,
    emission: Vec3,
}

#[derive(ShaderType)]
struct Sums {
    scattering: Vec3,
    extinction: f32,
    emission: Vec3,
}

/// A table and gradient magnitudes on the device.
pub(super) struct Matter {
    pub table: wgpu::Buffer,
    pub sums: wgpu::Buffer,
    pub gradient: wgpu::Buffer,
    /// Entries of a row, rows, and rows per unit of gradient magnitude.
    pub entries: u32,
    pub rows: u32,
    pub steep: f32,
    graded: bool,
    means: bool,
    chromatic: bool,
    glows: bool,
}

impl Matter {
    /// `gradient` is of `values` values.
    pub fn new(gpu: &Gpu, table: &Table, gradient: Option<&Buffer>, values: usize) -> Result<Self> {
        let (extinction, albedo, emission) = table.columns();
        let optics: Vec<Optics> = (0..extinction.len())
            .map(|i| Optics {
                albedo: albedo[i].into(),
                extinction: extinction[i],
                emission: emission.get(i).copied().unwrap_or_default().into(),
            })
            .collect();
        let (graded, means) = (table.graded.is_some(), table.preintegrated && table.graded.is_none());
        let gradient = match (graded, gradient) {
            (true, Some(gradient)) => holds(gradient, values)?.clone(),
            (true, None) => return Err(Error::Device("a two-dimensional table without gradients".into())),
            (false, _) => gpu.scratch(1)?,
        };
        Ok(Matter {
            table: gpu.structures(&optics)?,
            sums: gpu.structures(&if means { sums(&optics) } else { sums(&optics[..1]) })?,
            gradient,
            entries: table.extinction.len() as u32,
            rows: (extinction.len() / table.extinction.len()) as u32,
            steep: table.graded.as_ref().map_or(0.0, |graded| graded.scale()),
            graded,
            means,
            chromatic: table.chromatic != [1.0; 3],
            glows: emission.as_flattened().iter().any(|e| *e != 0.0),
        })
    }

    /// What kernels are compiled for.
    pub fn parts(&self) -> [(&'static str, f64); 4] {
        [
            ("GRADED", f64::from(self.graded)),
            ("MEANS", f64::from(self.means)),
            ("CHROMATIC", f64::from(self.chromatic)),
            ("GLOW", f64::from(self.glows)),
        ]
    }
}

/// Integrals by the trapezoidal rule up to each entry.
fn sums(optics: &[Optics]) -> Vec<Sums> {
    let mut total = [0.0f64; 7];
    let columns = |o: &Optics| {
        let scattering = o.extinction * o.albedo;
        [scattering.x, scattering.y, scattering.z, o.extinction, o.emission.x, o.emission.y, o.emission.z]
            .map(f64::from)
    };
    let entry = |t: [f64; 7]| {
        let [a, b, c, extinction, x, y, z] = t.map(|v| v as f32);
        Sums { scattering: Vec3::new(a, b, c), extinction, emission: Vec3::new(x, y, z) }
    };
    let mut all = vec![entry(total)];
    for pair in optics.windows(2) {
        let (a, b) = (columns(&pair[0]), columns(&pair[1]));
        total = std::array::from_fn(|c| total[c] + 0.5 * (a[c] + b[c]));
        all.push(entry(total));
    }
    all
}
