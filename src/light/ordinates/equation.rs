//! The fixed-point equation `x = Φ(x)` of scattered light in one colour channel, x = (φ, J).

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

/// The source function while a pass runs.
pub(super) struct Work {
    source: Buffer,
    gradient: Option<[Buffer; 3]>,
}

impl Work {
    pub fn new(device: &dyn Device, len: usize, linear: bool) -> Result<Self> {
        let State { phi, current } = State::new(device, len, linear)?;
        Ok(Work { source: phi, gradient: current })
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
    /// Delta-scaled; `None`: nothing scatters or glows, S = 0.
    pub scattering: Option<&'a Buffer>,
    pub emission: Option<&'a Buffer>,
    pub first: &'a [(&'a Buffer, f32, Travel)],
    /// 3g*.
    pub linear: f32,
}

impl Equation<'_> {
    /// One pass: `out = Φ(x)`.
    pub fn apply(&self, x: &State, out: &mut State, work: &mut Work) -> Result<Residual> {
        let device = self.device;
        match self.scattering {
            Some(scattering) => {
                let term = SourceTerm {
                    sigma: self.sigma,
                    scattering,
                    emission: self.emission,
                    grid: self.grid,
                    plane: 0,
                    first: self.first,
                    phi: &x.phi,
                    current: x.current.as_ref().map(|c| (c.each_ref(), self.linear)),
                };
                device.source(&term, &mut work.source, work.gradient.as_mut().map(|g| g.each_mut()))?;
            }
            None => {
                device.combine(&[], &mut work.source)?;
                for part in work.gradient.iter_mut().flatten() {
                    device.combine(&[], part)?;
                }
            }
        }
        // The pass measures the change against what it overwrites.
        device.combine(&[(&x.phi, 1.0)], &mut out.phi)?;
        let transport = Transport {
            grid: self.grid,
            ordinates: self.ordinates,
            sigma: self.sigma,
            source: &work.source,
            gradient: work.gradient.as_ref().map(|g| g.each_ref()),
        };
        let (change, peak) = device.transport(&transport, &mut out.phi, out.current.as_mut().map(|c| c.each_mut()))?;
        let mut current = 0.0;
        for (a, b) in x.current.iter().flatten().zip(out.current.iter().flatten()) {
            current += f64::from(device.distance(a, b)?).powi(2);
        }
        let change = f64::from(change) + f64::from(self.linear.abs()) * current.sqrt();
        Ok(Residual { change, peak: f64::from(peak) })
    }
}
