//! Iteration of `x = Φ(x)` to a given residual.

use super::anderson::Anderson;
use super::budget::Budget;
use super::coarse::Coarse;
use super::equation::{Equation, Residual, State};
use super::inside::Whole;
use crate::error::Result;

/// Passes at most.
const LIMIT: u64 = 400;

/// Passes without progress after which rounding is taken to be the reason.
const PATIENCE: u64 = 8;

/// What the residual is taken to shrink by in a pass before anything is known of it.
const USUAL: f64 = 0.5;

/// How an iteration ended.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ending {
    /// Passes, without those that the caller began with.
    pub passes: u64,
    /// How many of them went over the whole grid.
    pub whole: u64,
    pub residual: Residual,
    pub converged: bool,
}

/// What an iteration works with.
pub(super) struct Means<'a> {
    pub anderson: &'a mut Anderson,
    /// Scratch: S and its gradient.
    pub source: &'a mut State,
    pub coarse: Option<&'a mut Coarse>,
    /// Where the grid is more than the box.
    pub whole: Option<Whole<'a>>,
    pub budget: &'a mut Budget,
}

/// Iterates from the pairs that `anderson` has taken in, until the residual's change is at most `target(peak)`: then `value`
/// is Φ(x). `value` and `residual` are those of the best pair so far. With a target of 0 it goes on until rounding stops all
/// progress.
///
/// Where the budget ends first, what is left is the residual of a later step.
///
/// The last pass goes over the whole grid, where that is more than the box (`whole`): the one that is expected to be the last,
/// else one more.
///
/// Mixing from the first pass on costs a tenth of a pass each time, a coarse correction a fifth. On smoke of optical depth 30 and
/// albedo 0.9 both together take 8 passes where mixing alone takes 12 and plain iteration 39; on smoke of depth 6, 5, 6 and 9.
pub(super) fn iterate(
    equation: &Equation,
    x: &mut State,
    value: &mut State,
    mut residual: Residual,
    means: Means,
    target: impl Fn(f64) -> f64,
) -> Result<Ending> {
    let Means { anderson, source, mut coarse, mut whole, budget } = means;
    let (mut passes, mut over, mut since, mut least) = (0, 0, 0, f64::INFINITY);
    let mut before = residual.change / USUAL;
    let (mut plain, mut fresh) = (false, false);
    let mut covered = whole.is_none();
    let converged = loop {
        let goal = target(residual.peak);
        if residual.change <= goal {
            break true;
        }
        since = if residual.change < least { 0 } else { since + 1 };
        least = least.min(residual.change);
        if since >= PATIENCE && !plain && goal == 0.0 {
            // Mixing in f32 stalls above the fixed point that plain passes reach.
            (plain, since) = (true, 0);
        } else if since >= PATIENCE || passes >= LIMIT {
            break goal == 0.0 && since >= PATIENCE;
        }
        if !budget.allows(whole.is_some()) {
            break false;
        }
        if fresh && !plain {
            anderson.take(equation.device, x, value, coarse.as_deref_mut())?;
        }
        if plain {
            std::mem::swap(x, value);
        } else {
            anderson.mix(equation.device, x)?;
        }
        let expected = residual.change * (residual.change / before).min(1.0);
        before = residual.change;
        match &mut whole {
            Some(whole) if expected <= goal => {
                residual = equation.apply_whole(x, value, source, whole)?;
                (covered, over) = (true, over + 1);
            }
            _ => {
                residual = equation.apply(x, value, source)?;
                covered = whole.is_none();
            }
        }
        passes += 1;
        fresh = true;
        budget.spent();
    };
    if let (Some(whole), false) = (&mut whole, covered) {
        // Φ maps what is close to the solution closer to it still: the bound that held goes on to hold.
        std::mem::swap(x, value);
        let last = equation.apply_whole(x, value, source, whole)?;
        residual = Residual { change: last.change.min(residual.change), ..last };
        (passes, over) = (passes + 1, over + 1);
        budget.spent();
    }
    Ok(Ending { passes, whole: over, residual, converged })
}
