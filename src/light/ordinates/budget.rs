//! What a step may spend on passes: their number, and the time until when.

use std::time::{Duration, Instant};

/// Passes and time that are left.
pub(super) struct Budget {
    passes: Option<u64>,
    until: Option<Instant>,
    /// When the latest pass ended, and how long it took.
    latest: Instant,
    pace: Duration,
    /// What a pass over the grid takes in passes over the box.
    whole: f64,
}

impl Budget {
    /// `passes` and the time `until` when they may go on; `whole` is how many times the box fits into the grid.
    pub fn new(passes: Option<u64>, until: Option<Instant>, whole: f64) -> Self {
        Budget { passes, until, latest: Instant::now(), pace: Duration::ZERO, whole }
    }

    /// A part of it for something that comes first.
    pub fn part(&self, share: f64) -> Self {
        let now = Instant::now();
        let until = self.until.map(|until| now + until.saturating_duration_since(now).mul_f64(share));
        let passes = self.passes.map(|passes| (passes as f64 * share) as u64);
        Budget { passes, until, latest: now, pace: Duration::ZERO, whole: self.whole }
    }

    /// A pass has ended.
    pub fn spent(&mut self) {
        let now = Instant::now();
        self.pace = now - std::mem::replace(&mut self.latest, now);
        self.passes = self.passes.map(|p| p.saturating_sub(1));
    }

    /// True while there is enough for one more pass and, where that is still to come (`last`), one over the grid.
    pub fn allows(&self, last: bool) -> bool {
        let more = 1.0 + if last { self.whole } else { 0.0 };
        let in_time = self.until.is_none_or(|until| Instant::now() + self.pace.mul_f64(more) < until);
        in_time && self.passes.is_none_or(|passes| passes > u64::from(last))
    }
}
