//! `[insitu]`: how a running simulation is coupled. `gloaming render` takes no notice of it, so that one file serves both.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

/// `[insitu]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct InSituKeys {
    /// What to write, as `--out` takes it.
    pub outputs: Vec<String>,
    /// Ledger file (`.csv` or `.json`).
    pub ledger: Option<PathBuf>,
    /// Where to compute: `auto`, `cpu`, `gpu` or part of an adapter's name.
    pub device: String,
    /// Threads that light and render; 0 for one per core, or one for each of `cores` where they are given. Writing takes
    /// one more.
    pub threads: usize,
    /// Cores that gloaming's threads stay on; empty for any (Linux).
    pub cores: Vec<usize>,
    /// Steps that may wait while one is lit.
    pub queue: usize,
    /// What happens to a step that finds the queue full.
    pub policy: Policy,
    /// Takes the steps whose number is a multiple of this.
    pub every: u64,
    /// Takes the first step in each interval of this much simulation time.
    pub every_time: Option<f64>,
    /// Renders and writes a step only when the light has changed by more than this since the last one that was, anywhere,
    /// relative to the brightest light. Choose it above `light.tolerance`: within that, the light of a medium at rest still
    /// gets better.
    pub light_change: Option<f64>,
    /// Skips steps whose files are all there, and continues the ledger.
    pub resume: bool,
    /// File from which the light is loaded at the start, when it is there, and to which it is saved at the end.
    pub light_state: Option<PathBuf>,
    /// Saves the light there also after every so many lit steps.
    pub light_state_every: Option<u64>,
    /// Frames that earlier runs have made: cameras that orbit go on from there. A `light_state` tells by itself.
    pub steps_before: u64,
}

impl Default for InSituKeys {
    fn default() -> Self {
        InSituKeys {
            outputs: vec![],
            ledger: None,
            device: "auto".into(),
            threads: 0,
            cores: vec![],
            queue: 2,
            policy: Policy::Block,
            every: 1,
            every_time: None,
            light_change: None,
            resume: false,
            light_state: None,
            light_state_every: None,
            steps_before: 0,
        }
    }
}

/// `insitu.policy`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Policy {
    /// The simulation waits until there is room.
    Block,
    /// The new step is dropped.
    DropNewest,
    /// The step that has waited longest is dropped.
    DropOldest,
    /// All waiting steps are dropped: only the newest waits.
    Coalesce,
}
