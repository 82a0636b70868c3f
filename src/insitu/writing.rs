//! The writing thread: every output to every sink, every row to the ledger. One sink's failure is not the others'.

use std::sync::Arc;
use std::time::Instant;

use crossbeam_channel::Receiver;

use super::queue::{Became, Queue};
use super::say;
use crate::error::{Result, guarded};
use crate::ledger::{Ledger, LedgerRow};
use crate::sink::{Output, Sink};

/// What the lighting thread hands on.
pub(super) enum Handed {
    Lit(Box<Output>),
    /// A step that could not be lit.
    Lost(LedgerRow),
    /// A step that was lit but not rendered: its light is that of the last one that was.
    Unchanged(LedgerRow),
    /// A step that was dropped or refused, which has been said and counted.
    Note(LedgerRow),
}

pub(super) struct Writing {
    sinks: Vec<Box<dyn Sink>>,
    ledger: Option<Ledger>,
    /// Rows that the ledger would not take yet: a disk may be full only for a while.
    unwritten: Vec<LedgerRow>,
    queue: Arc<Queue>,
    said: String,
    repeated: u64,
}

impl Writing {
    pub fn new(sinks: Vec<Box<dyn Sink>>, ledger: Option<Ledger>, queue: Arc<Queue>) -> Self {
        Writing { sinks, ledger, unwritten: vec![], queue, said: String::new(), repeated: 0 }
    }

    /// Writes until nothing more comes, then closes every file. What could not be closed is the result.
    pub fn run(mut self, from: &Receiver<Handed>) -> Result<()> {
        for handed in from {
            let (row, became) = match handed {
                Handed::Lit(output) => (self.write(*output), Became::Written),
                Handed::Lost(row) => (row, Became::Written),
                Handed::Unchanged(row) => (row, Became::Skipped),
                Handed::Note(row) => (row, Became::Counted),
            };
            if became == Became::Written && !row.lost.is_empty() {
                self.say_lost(&row);
            }
            self.unwritten.push(row.clone());
            self.keep();
            self.queue.finished(&row, became);
        }
        let mut outcome = Ok(());
        for sink in &mut self.sinks {
            let finished = guarded(|| sink.finish());
            if let Err(e) = &finished {
                say(&format!("not closed properly: {e}"));
            }
            outcome = outcome.and(finished);
        }
        self.keep();
        if !self.unwritten.is_empty() {
            say(&format!("the ledger lacks {} rows", self.unwritten.len()));
        }
        outcome
    }

    /// Writes to each sink; what failed is in the row.
    fn write(&mut self, mut output: Output) -> LedgerRow {
        let begun = Instant::now();
        let failed: Vec<String> = self
            .sinks
            .iter_mut()
            .filter_map(|sink| guarded(|| sink.write(&output)).err())
            .map(|e| e.to_string())
            .collect();
        output.row.write_ms = begun.elapsed().as_secs_f64() * 1e3;
        output.row.lost = failed.join("; ");
        output.row
    }

    /// Puts what is not there yet into the ledger.
    fn keep(&mut self) {
        let Some(ledger) = &mut self.ledger else {
            self.unwritten.clear();
            return;
        };
        while !self.unwritten.is_empty() {
            if let Err(e) = ledger.push(self.unwritten[0].clone()) {
                if self.unwritten.len().is_power_of_two() {
                    say(&format!("the ledger has to wait: {e}"));
                }
                return;
            }
            self.unwritten.remove(0);
        }
    }

    /// Says that a step is lost; of the same reason again and again, the 1st, 2nd, 4th, 8th… time.
    fn say_lost(&mut self, row: &LedgerRow) {
        // Names of files differ from step to step: the reason is what follows them.
        let reason = row.lost.rsplit(": ").next().unwrap_or_default();
        self.repeated = if self.said == reason { self.repeated + 1 } else { 1 };
        if self.repeated == 1 {
            self.said = reason.into();
        }
        if self.repeated.is_power_of_two() {
            let times = if self.repeated > 1 { format!(" (for the {}th time)", self.repeated) } else { String::new() };
            say(&format!("step {} lost: {}{times}", row.step, row.lost));
        }
    }
}
