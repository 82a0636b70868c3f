//! Iteration of `x = Φ(x)` to a given residual.

use super::anderson::Anderson;
use super::equation::{Equation, Residual, State, Work};
use crate::error::Result;

/// Passes at most.
const LIMIT: u64 = 400;

/// Passes without progress after which rounding is taken to be the reason.
const PATIENCE: u64 = 8;

/// How an iteration ended.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ending {
    /// Passes, without the one that the caller began with.
    pub passes: u64,
    pub residual: Residual,
    pub converged: bool,
}

/// Iterates from the pairs that `anderson` has taken in, until the residual's change is at most `target(peak)`: then `value`
/// is Φ(x). `value` and `residual` are those of the best pair so far. With a target of 0 it goes on until rounding stops all
/// progress.
///
/// Mixing from the first pass on costs a tenth of a pass each time. On smoke of optical depth 30 and albedo 0.9 it takes 13
/// passes where plain iteration takes 39, on smoke of depth 6 six for nine.
pub(super) fn iterate(
    equation: &Equation,
    x: &mut State,
    value: &mut State,
    mut residual: Residual,
    (anderson, work): (&mut Anderson, &mut Work),
    target: impl Fn(f64) -> f64,
) -> Result<Ending> {
    let (mut passes, mut since, mut least) = (0, 0, f64::INFINITY);
    let mut plain = false;
    loop {
        let goal = target(residual.peak);
        if residual.change <= goal {
            return Ok(Ending { passes, residual, converged: true });
        }
        since = if residual.change < least { 0 } else { since + 1 };
        least = least.min(residual.change);
        if since >= PATIENCE && !plain && goal == 0.0 {
            // Mixing in f32 stalls above the fixed point that plain passes reach.
            (plain, since) = (true, 0);
        } else if since >= PATIENCE || passes >= LIMIT {
            return Ok(Ending { passes, residual, converged: goal == 0.0 && since >= PATIENCE });
        }
        if plain {
            std::mem::swap(x, value);
        } else {
            anderson.mix(equation.device, x)?;
        }
        residual = equation.apply(x, value, work)?;
        passes += 1;
        if !plain {
            anderson.take(equation.device, x, value)?;
        }
    }
}
