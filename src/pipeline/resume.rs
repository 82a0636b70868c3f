//! Which steps an earlier run has done already.

use std::collections::HashSet;
use std::path::Path;

use crate::error::Result;
use crate::ledger;
use crate::sink::Sink;

/// What an earlier run left behind: a step is done when all its files are there and, where a ledger is kept, its row
/// says so.
#[derive(Default)]
pub(super) struct Done {
    sinks: Vec<Box<dyn Sink>>,
    rows: Option<HashSet<u64>>,
}

impl Done {
    /// `sinks` are asked for their files only. Outputs that take all steps into one file have none of a step's own:
    /// they are written anew, so that every step is lit again.
    pub fn of(sinks: Vec<Box<dyn Sink>>, outputs: &[String], ledger: Option<&Path>) -> Result<Done> {
        let whole: Vec<&str> = sinks
            .iter()
            .zip(outputs)
            .filter(|(sink, _)| sink.paths(0).is_empty())
            .map(|(_, output)| output.as_str())
            .collect();
        if !whole.is_empty() {
            tracing::warn!(
                "--resume: {} takes all steps into one file and is written anew, so every step is lit again; frames can be resumed: \
                 --out frame_{{step:06}}.png",
                whole.join(", ")
            );
            return Ok(Done::default());
        }
        let rows = match ledger {
            Some(path) if path.exists() => {
                Some(ledger::read(path)?.into_iter().filter(|row| row.lost.is_empty()).map(|row| row.step).collect())
            }
            Some(_) => Some(HashSet::new()),
            None => None,
        };
        Ok(Done { sinks, rows })
    }

    /// True for a step that need not be done again.
    pub fn has(&self, step: u64) -> bool {
        let there = |sink: &dyn Sink| sink.paths(step).iter().all(|path| path.exists());
        !self.sinks.is_empty()
            && self.rows.as_ref().is_none_or(|rows| rows.contains(&step))
            && self.sinks.iter().all(|sink| there(&**sink))
    }
}
