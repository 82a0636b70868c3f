//! Anderson acceleration of a fixed-point iteration (Walker & Ni 2011, problem (1.2)): the next argument is the affine
//! combination of the latest values Φ(x_i) whose residuals Φ(x_i) − x_i cancel best in the least-squares sense.

use super::coarse::Coarse;
use super::equation::State;
use crate::device::Device;
use crate::error::Result;

/// Pairs kept; each takes two volumes (eight where scattering is anisotropic).
pub(super) const DEPTH: usize = 6;

/// Latest values and residuals.
pub(super) struct Anderson {
    slots: Vec<Slot>,
    /// Values of a volume at most.
    room: usize,
    /// Slots in use, and the one to overwrite next.
    used: usize,
    next: usize,
    gram: [[f64; DEPTH]; DEPTH],
}

struct Slot {
    value: State,
    residual: State,
}

impl Anderson {
    pub fn new(room: usize) -> Self {
        Anderson { slots: vec![], room, used: 0, next: 0, gram: [[0.0; DEPTH]; DEPTH] }
    }

    /// Forgets the pairs, not the memory.
    pub fn clear(&mut self) {
        (self.used, self.next) = (0, 0);
    }

    /// Takes in a pair x, Φ(x), of any guess; with `coarse` of the equation `x = Φ(x) + e(Φ(x) − x)`, which has the same solution.
    pub fn take(&mut self, device: &dyn Device, x: &State, value: &State, coarse: Option<&mut Coarse>) -> Result<()> {
        if self.slots.len() == self.next {
            let fresh = || State::new(device, self.room, value.current.is_some());
            self.slots.push(Slot { value: fresh()?, residual: fresh()? });
        }
        let slot = &mut self.slots[self.next];
        for state in [&mut slot.value, &mut slot.residual] {
            state.resize(device, value.phi.len())?;
        }
        if coarse.is_none() || value.current.is_some() {
            slot.value.combine(device, &[(value, 1.0)])?;
        }
        slot.residual.combine(device, &[(value, 1.0), (x, -1.0)])?;
        if let Some(coarse) = coarse {
            coarse.correct(device, x, &mut slot.value, &mut slot.residual)?;
        }
        let latest = self.next;
        self.used = self.used.max(latest + 1);
        self.next = (latest + 1) % DEPTH;
        for i in 0..self.used {
            let product = self.slots[latest].residual.dot(device, &self.slots[i].residual)?;
            self.gram[latest][i] = product;
            self.gram[i][latest] = product;
        }
        Ok(())
    }

    /// Replaces x by the mixture of the pairs taken in.
    pub fn mix(&self, device: &dyn Device, x: &mut State) -> Result<()> {
        let weights = self.weights();
        let terms: Vec<_> = self.slots[..self.used].iter().zip(weights).map(|(s, w)| (&s.value, w as f32)).collect();
        x.combine(device, &terms)
    }

    /// Weights α with Σα = 1 that minimise ‖Σ α_i residual_i‖: solves `G z = 1`, α = z/Σz, by Cholesky. The diagonal is
    /// raised by what rounding of the residuals to f32 leaves undetermined.
    fn weights(&self) -> [f64; DEPTH] {
        let n = self.used;
        let mut alpha = [0.0; DEPTH];
        let scale: [f64; DEPTH] = std::array::from_fn(|i| if i < n { self.gram[i][i].sqrt().max(1e-300) } else { 1.0 });
        let mut l = [[0.0; DEPTH]; DEPTH];
        for i in 0..n {
            for j in 0..=i {
                let known: f64 = (0..j).map(|k| l[i][k] * l[j][k]).sum();
                let rounding = if i == j { 1e-9 } else { 0.0 };
                let rest = self.gram[i][j] / (scale[i] * scale[j]) + rounding - known;
                l[i][j] = if i == j { rest.max(1e-12).sqrt() } else { rest / l[j][j] };
            }
        }
        for i in 0..n {
            let sum: f64 = (0..i).map(|k| l[i][k] * alpha[k]).sum();
            alpha[i] = (1.0 / scale[i] - sum) / l[i][i];
        }
        for i in (0..n).rev() {
            let sum: f64 = (i + 1..n).map(|k| l[k][i] * alpha[k]).sum();
            alpha[i] = (alpha[i] - sum) / l[i][i];
        }
        for i in 0..n {
            alpha[i] /= scale[i];
        }
        let total: f64 = alpha.iter().sum();
        alpha.map(|a| a / total)
    }
}
