//! Iteration of `x = Φ(x)` to a given residual.

use super::anderson::Anderson;
use super::equation::{Equation, Residual, State, Work};
use crate::error::Result;

/// Passes at most.
const LIMIT: u64 = 400;

/// Passes without progress after which rounding is taken to be the reason.
const PATIENCE: u64 = 8;

/// Plain passes still to come above which acceleration pays for its inner products and mixtures.
const ACCELERATE_ABOVE: f64 = 4.0;

/// How an iteration ended.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ending {
    /// Passes, without the one that the caller began with.
    pub passes: u64,
    pub residual: Residual,
    pub converged: bool,
}

/// Iterates from x, Φ(x) and its residual until the residual's change is at most `target(peak)`: then `value` is Φ(x). With
/// a target of 0 it goes on until rounding stops all progress.
pub(super) fn iterate(
    equation: &Equation,
    x: &mut State,
    value: &mut State,
    mut residual: Residual,
    (anderson, work): (&mut Anderson, &mut Work),
    target: impl Fn(f64) -> f64,
) -> Result<Ending> {
    let (mut passes, mut since, mut least) = (0, 0, f64::INFINITY);
    let mut before: Option<f64> = None;
    let mut accelerated = false;
    loop {
        let goal = target(residual.peak);
        if residual.change <= goal {
            return Ok(Ending { passes, residual, converged: true });
        }
        since = if residual.change < least { 0 } else { since + 1 };
        least = least.min(residual.change);
        if since >= PATIENCE && accelerated && goal == 0.0 {
            // Mixing in f32 stalls above the fixed point that plain passes reach.
            (accelerated, since) = (false, 0);
        } else if since >= PATIENCE || passes >= LIMIT {
            return Ok(Ending { passes, residual, converged: goal == 0.0 && since >= PATIENCE });
        } else if let Some(before) = before.filter(|_| !accelerated && since == 0) {
            let rate = residual.change / before;
            if rate >= 1.0 || (goal / residual.change).ln() / rate.ln() > ACCELERATE_ABOVE {
                accelerated = true;
                anderson.clear();
            }
        }
        before = Some(residual.change);
        if accelerated {
            anderson.step(equation.device, x, value)?;
        } else {
            std::mem::swap(x, value);
        }
        residual = equation.apply(x, value, work)?;
        passes += 1;
    }
}
