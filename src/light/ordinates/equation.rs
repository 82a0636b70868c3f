//! The fixed-point equation `x = Φ(x)` of scattered light in one colour channel, x = (φ, J).

use super::inside::Whole;
use crate::device::{Buffer, Device, Ordinate, SourceTerm, Transport, Travel};
use crate::error::Result;
use crate::grid::Grid;

/// Fluence of scattered light and, where scattering is anisotropic, its current.
pub(super) struct State {
    pub phi: Buffer,
    pub current: Option<[Buffer; 3]>,
}

impl State {
    pub fn new(device: &dyn Device, len: usize, linear: bool) -> Result<Self> {
        let current = if linear { Some([device.alloc(len)?, device.alloc(len)?, device.alloc(len)?]) } else { None };
        Ok(State { phi: device.alloc(len)?, current })
    }

    /// Makes this hold `len` values, which mean nothing yet.
    pub fn resize(&mut self, device: &dyn Device, len: usize) -> Result<()> {
        self.parts_mut().try_for_each(|part| device.resize(part, len))
    }

    /// Sets this to `Σ weight·state`; to nothing without terms.
    pub fn combine(&mut self, device: &dyn Device, terms: &[(&State, f32)]) -> Result<()> {
        let phi: Vec<_> = terms.iter().map(|(s, w)| (&s.phi, *w)).collect();
        device.combine(&phi, &mut self.phi)?;
        for (axis, out) in self.current.iter_mut().flatten().enumerate() {
            let part: Vec<_> = terms.iter().filter_map(|(s, w)| Some((&s.current.as_ref()?[axis], *w))).collect();
            device.combine(&part, out)?;
        }
        Ok(())
    }

    /// φ, then J.
    pub fn parts(&self) -> impl Iterator<Item = &Buffer> {
        std::iter::once(&self.phi).chain(self.current.iter().flatten())
    }

    /// φ, then J.
    pub fn parts_mut(&mut self) -> impl Iterator<Item = &mut Buffer> {
        std::iter::once(&mut self.phi).chain(self.current.iter_mut().flatten())
    }

    /// Inner product over φ and J.
    pub fn dot(&self, device: &dyn Device, other: &State) -> Result<f64> {
        let mut sum = device.dot(&self.phi, &other.phi)?;
        for (a, b) in self.current.iter().flatten().zip(other.current.iter().flatten()) {
            sum += device.dot(a, b)?;
        }
        Ok(sum)
    }
}

/// How far a pass moved its argument: `‖δφ‖ + 3g*·‖δJ‖` in the maximum norm, and the largest new φ.
#[derive(Debug, Clone, Copy)]
pub(super) struct Residual {
    pub change: f64,
    pub peak: f64,
}

/// Everything that [`Equation::apply`] needs to know but x.
pub(super) struct Equation<'a> {
    pub device: &'a dyn Device,
    pub grid: &'a Grid,
    pub ordinates: &'a [Ordinate],
    /// Delta-scaled.
    pub sigma: &'a Buffer,
    /// Delta-scaled.
    pub scattering: &'a Buffer,
    pub emission: Option<&'a Buffer>,
    pub first: &'a [(&'a Buffer, f32, Travel)],
    /// 3g*.
    pub linear: f32,
}

impl Equation<'_> {
    /// One pass: `out = Φ(x)`. `source` is scratch: S and its gradient.
    pub fn apply(&self, x: &State, out: &mut State, source: &mut State) -> Result<Residual> {
        self.emit(x, source)?;
        // The pass measures the change against what it overwrites.
        self.device.combine(&[(&x.phi, 1.0)], &mut out.phi)?;
        let (change, peak) = pass(self.device, (self.grid, self.ordinates), self.sigma, source, out)?;
        self.residual(f64::from(change), f64::from(peak), x, out)
    }

    /// The same pass, over the whole grid: `whole.out = Φ(x)`, of which `out` takes the part in the box.
    pub fn apply_whole(&self, x: &State, out: &mut State, source: &mut State, whole: &mut Whole) -> Result<Residual> {
        let (device, size) = (self.device, whole.grid.size);
        self.emit(x, source)?;
        whole.source.embed(device, source, whole.region, size)?;
        let (_, peak) = pass(device, (whole.grid, self.ordinates), whole.sigma, whole.source, whole.out)?;
        out.crop(device, whole.out, size, whole.region)?;
        let change = device.distance(&x.phi, &out.phi)?;
        self.residual(f64::from(change), f64::from(peak), x, out)
    }

    /// The source function and its gradient.
    fn emit(&self, x: &State, into: &mut State) -> Result<()> {
        let term = SourceTerm {
            sigma: self.sigma,
            scattering: self.scattering,
            emission: self.emission,
            grid: self.grid,
            plane: 0,
            first: self.first,
            phi: &x.phi,
            current: x.current.as_ref().map(|c| (c.each_ref(), self.linear)),
        };
        self.device.source(&term, &mut into.phi, into.current.as_mut().map(|g| g.each_mut()))
    }

    fn residual(&self, change: f64, peak: f64, x: &State, out: &State) -> Result<Residual> {
        let mut current = 0.0;
        for (a, b) in x.current.iter().flatten().zip(out.current.iter().flatten()) {
            current += f64::from(self.device.distance(a, b)?).powi(2);
        }
        Ok(Residual { change: change + f64::from(self.linear.abs()) * current.sqrt(), peak })
    }
}

/// Transport of the light that `source` (S and its gradient) gives; returns the largest change of φ against what `out` held,
/// and the largest new one.
pub(super) fn pass(
    device: &dyn Device,
    (grid, ordinates): (&Grid, &[Ordinate]),
    sigma: &Buffer,
    source: &State,
    out: &mut State,
) -> Result<(f32, f32)> {
    let gradient = source.current.as_ref().map(|g| g.each_ref());
    let transport = Transport { grid, ordinates, sigma, source: &source.phi, gradient };
    device.transport(&transport, &mut out.phi, out.current.as_mut().map(|c| c.each_mut()))
}
