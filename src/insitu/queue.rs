//! Steps that wait to be lit, and what is known of all of them. What the simulation does here takes no longer than a lock
//! that nobody holds for long, unless it has chosen to wait.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use crossbeam_channel::{Sender, bounded};
use serde::Serialize;

use super::{Strided, Values, say};
use crate::error::{Error, Result};
use crate::field::Timestep;
use crate::ledger::LedgerRow;
use crate::scene::{InSituKeys, Policy};

/// What has become of the steps so far. Each push is counted once: `pushed = lit + lost + dropped + skipped + waiting`, where
/// steps being lit or written count as waiting.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Stats {
    /// Steps offered.
    pub pushed: u64,
    /// Steps lit and written, to every output.
    pub lit: u64,
    /// Steps that could not be taken in, lit, or written to some output.
    pub lost: u64,
    /// Steps dropped because the queue was full.
    pub dropped: u64,
    /// Steps that no trigger asked for, whose light had not changed enough, or that were complete when resuming.
    pub skipped: u64,
    /// Steps waiting, being lit or being written.
    pub waiting: u64,
    /// Bytes copied out of the simulation's memory.
    pub bytes: u64,
    /// Time the simulation was held by pushes, in milliseconds.
    pub held_ms: f64,
    /// The longest that one push held it.
    pub longest_held_ms: f64,
    /// The latest loss or drop: step and reason.
    pub last_loss: Option<(u64, String)>,
}

/// A copy made of a simulation's values, whose memory is used again.
pub(super) type Copied = Arc<Strided<Values<f32>>>;

/// A step on its way.
pub(super) struct Arrived {
    pub step: Timestep,
    /// The copy made of the simulation's values, to be used again.
    pub copy: Option<Copied>,
    /// What the push has put in the ledger.
    pub row: LedgerRow,
}

/// What a push is told.
pub(super) enum Admission {
    /// No trigger asks for the step.
    Skipped,
    /// The queue is full.
    Dropped,
    /// There is room; the memory of an earlier copy, and how things stand.
    Room(Vec<f32>, Box<LedgerRow>),
}

/// What the lighting thread does next.
pub(super) enum Next {
    Light(Box<Arrived>),
    /// Rows of steps that never got so far.
    Note(Vec<LedgerRow>),
    /// The light of the steps lit so far is to be kept.
    Keep(Keep),
    End,
}

/// Light to be kept in a file, once the steps that came before are lit.
pub(super) struct Keep {
    pub path: PathBuf,
    /// Told how it went.
    pub told: Sender<Result<()>>,
    /// Steps that had come when it was asked for.
    after: u64,
}

/// What a row in the ledger stands for.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Became {
    /// A step written, or lost on the way.
    Written,
    /// A step whose light had not changed enough.
    Skipped,
    /// A step that was counted before: dropped or refused.
    Counted,
}

pub(super) struct Queue {
    state: Mutex<State>,
    changed: Condvar,
    depth: usize,
    policy: Policy,
    every: u64,
    every_time: Option<f64>,
}

#[derive(Default)]
struct State {
    /// With their numbers in the order of arrival.
    waiting: VecDeque<(u64, Box<Arrived>)>,
    /// Steps that have come.
    arrived: u64,
    keeps: VecDeque<Keep>,
    /// Places promised to pushes that are still copying.
    reserved: usize,
    /// Steps and notes that the writer has not finished with.
    unfinished: u64,
    notes: Vec<LedgerRow>,
    spare: Vec<Vec<f32>>,
    interval: Option<f64>,
    closing: bool,
    /// Why nothing is taken any more.
    ended: Option<String>,
    stats: Stats,
}

impl State {
    fn lose(&mut self, row: LedgerRow) {
        self.stats.last_loss = Some((row.step, row.lost.clone()));
        self.unfinished += 1;
        self.notes.push(row);
    }

    fn drop_step(&mut self, mut row: LedgerRow, policy: &str) {
        self.stats.dropped += 1;
        row.drops = self.stats.dropped;
        row.lost = format!("dropped: the queue was full ({policy})");
        if self.stats.dropped.is_power_of_two() {
            say(&format!("step {} {}; {} so far", row.step, row.lost, row.drops));
        }
        self.lose(row);
    }

    fn drop_waiting(&mut self, arrived: Arrived, policy: &str) {
        self.unfinished -= 1;
        self.drop_step(arrived.row, policy);
        drop(arrived.step);
        self.spare.extend(arrived.copy.and_then(Arc::into_inner).map(Strided::into_values));
    }
}

impl Queue {
    pub fn new(keys: &InSituKeys) -> Self {
        Queue {
            state: Mutex::default(),
            changed: Condvar::new(),
            depth: keys.queue,
            policy: keys.policy,
            every: keys.every,
            every_time: keys.every_time,
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wait<'a>(&self, state: MutexGuard<'a, State>) -> MutexGuard<'a, State> {
        self.changed.wait(state).unwrap_or_else(PoisonError::into_inner)
    }

    /// Asks for a place for a step; as policy has it, this waits, or other steps go.
    pub fn admit(&self, step: u64, time: Option<f64>, begun: Instant) -> Result<Admission> {
        let mut state = self.lock();
        open(&state)?;
        state.stats.pushed += 1;
        if !self.wanted(&mut state, step, time) {
            state.stats.skipped += 1;
            return Ok(Admission::Skipped);
        }
        let depth = (state.waiting.len() + state.reserved) as u64;
        let mut row = LedgerRow { step, time, queue_depth: depth, ..Default::default() };
        while state.waiting.len() + state.reserved >= self.depth {
            match self.policy {
                Policy::DropNewest => {
                    row.held_ms = held(&mut state, begun);
                    state.drop_step(row, "drop-newest");
                    self.changed.notify_all();
                    return Ok(Admission::Dropped);
                }
                Policy::DropOldest if !state.waiting.is_empty() => {
                    if let Some((_, oldest)) = state.waiting.pop_front() {
                        state.drop_waiting(*oldest, "drop-oldest");
                    }
                }
                Policy::Coalesce if !state.waiting.is_empty() => {
                    for (_, older) in std::mem::take(&mut state.waiting) {
                        state.drop_waiting(*older, "coalesce");
                    }
                }
                // All places are taken by pushes of other threads that are still copying, or the simulation would rather wait.
                _ => {
                    state = self.wait(state);
                    if let Err(e) = open(&state) {
                        state.stats.pushed -= 1;
                        return Err(e);
                    }
                }
            }
        }
        self.changed.notify_all();
        row.drops = state.stats.dropped;
        state.reserved += 1;
        state.unfinished += 1;
        let spare = state.spare.pop().unwrap_or_default();
        Ok(Admission::Room(spare, Box::new(row)))
    }

    /// True when every trigger asks for the step.
    fn wanted(&self, state: &mut State, step: u64, time: Option<f64>) -> bool {
        if !step.is_multiple_of(self.every) {
            return false;
        }
        let (Some(every), Some(time)) = (self.every_time, time) else { return true };
        // Intervals count from time 0, so that a restarted run takes the same steps; a step that ends an interval up to
        // rounding begins the next one.
        let interval = (time / every + 1e-6).floor();
        let wanted = state.interval.is_none_or(|last| interval > last || !interval.is_finite());
        if wanted {
            state.interval = Some(interval);
        }
        wanted
    }

    /// Fills a place.
    pub fn put(&self, mut arrived: Arrived, begun: Instant) {
        let mut state = self.lock();
        state.stats.bytes += arrived.row.bytes;
        arrived.row.held_ms = held(&mut state, begun);
        state.reserved -= 1;
        state.arrived += 1;
        let number = state.arrived;
        state.waiting.push_back((number, Box::new(arrived)));
        self.changed.notify_all();
    }

    /// Gives a place back: the step could not be taken in.
    pub fn refuse(&self, mut row: LedgerRow, why: &Error, begun: Instant) {
        let mut state = self.lock();
        row.held_ms = held(&mut state, begun);
        row.lost = why.to_string();
        say(&format!("step {} lost: {}", row.step, row.lost));
        state.reserved -= 1;
        state.unfinished -= 1;
        state.stats.lost += 1;
        state.lose(row);
        self.changed.notify_all();
    }

    /// Waits for something to do.
    pub fn next(&self) -> Next {
        let mut state = self.lock();
        loop {
            if !state.notes.is_empty() {
                return Next::Note(std::mem::take(&mut state.notes));
            }
            let next = state.waiting.front().map(|(number, _)| *number);
            if let Some(keep) = state.keeps.pop_front_if(|keep| next.is_none_or(|next| next > keep.after)) {
                return Next::Keep(keep);
            }
            if let Some((_, arrived)) = state.waiting.pop_front() {
                self.changed.notify_all();
                return Next::Light(arrived);
            }
            if state.closing && state.reserved == 0 {
                return Next::End;
            }
            state = self.wait(state);
        }
    }

    /// Takes back the memory of a copy.
    pub fn recycle(&self, copy: Option<Copied>) {
        if let Some(copy) = copy.and_then(Arc::into_inner) {
            self.lock().spare.push(copy.into_values());
        }
    }

    /// The writer is done with a row.
    pub fn finished(&self, row: &LedgerRow, became: Became) {
        let mut state = self.lock();
        state.unfinished -= 1;
        match became {
            Became::Counted => {}
            Became::Skipped => state.stats.skipped += 1,
            Became::Written if row.lost.is_empty() => state.stats.lit += 1,
            Became::Written => {
                state.stats.lost += 1;
                state.stats.last_loss = Some((row.step, row.lost.clone()));
            }
        }
        self.changed.notify_all();
    }

    /// A step was found complete: nothing is written.
    pub fn passed_over(&self) {
        let mut state = self.lock();
        state.unfinished -= 1;
        state.stats.skipped += 1;
        self.changed.notify_all();
    }

    /// Waits until nothing waits.
    pub fn flush(&self) -> Result<()> {
        let mut state = self.lock();
        while state.unfinished > 0 {
            open(&state)?;
            state = self.wait(state);
        }
        open(&state)
    }

    /// Asks for the light of the steps that have come to be kept, and waits until it is.
    pub fn keep(&self, path: PathBuf) -> Result<()> {
        let (told, tells) = bounded(1);
        {
            let mut state = self.lock();
            open(&state)?;
            let after = state.arrived;
            state.keeps.push_back(Keep { path, told, after });
            self.changed.notify_all();
        }
        tells.recv().unwrap_or_else(|_| Err(Error::Closed("the session ended; close() tells why".into())))
    }

    /// Takes no more steps.
    pub fn close(&self) {
        self.lock().closing = true;
        self.changed.notify_all();
    }

    /// The lighting thread is gone, for this reason; whoever waits is told.
    pub fn end(&self, why: &str) {
        let mut state = self.lock();
        state.ended.get_or_insert_with(|| why.into());
        state.waiting.clear();
        state.keeps.clear();
        state.spare.clear();
        self.changed.notify_all();
    }

    pub fn stats(&self) -> Stats {
        let state = self.lock();
        let done = |s: &Stats| s.lit + s.lost + s.dropped + s.skipped;
        Stats { waiting: state.stats.pushed.saturating_sub(done(&state.stats)), ..state.stats.clone() }
    }
}

fn open(state: &State) -> Result<()> {
    match (&state.ended, state.closing) {
        (Some(why), _) => Err(Error::Closed(why.clone())),
        (None, true) => Err(Error::Closed("the session was closed".into())),
        (None, false) => Ok(()),
    }
}

/// Notes how long a push has held the simulation.
fn held(state: &mut State, begun: Instant) -> f64 {
    let held = begun.elapsed().as_secs_f64() * 1e3;
    state.stats.held_ms += held;
    state.stats.longest_held_ms = state.stats.longest_held_ms.max(held);
    held
}
