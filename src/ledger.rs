//! The ledger: one row a step of what was done, what it cost and what was lost.

use serde::{Deserialize, Serialize};

/// What one step cost. Times are in milliseconds.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct LedgerRow {
    /// The simulation's step number.
    pub step: u64,
    /// Physical time, where known.
    pub time: Option<f64>,
    /// Bytes of field data taken in.
    pub bytes: u64,
    /// Time the solver was held by the push (in situ).
    pub held_ms: f64,
    /// Steps waiting when this one arrived.
    pub queue_depth: u64,
    /// Steps dropped so far.
    pub drops: u64,
    /// `cold` or `warm`.
    pub start: String,
    /// Iterations of scattered light (0 when it was not solved).
    pub iterations: u64,
    /// Sweeps over the light grid, all lights and directions, in whole-grid units.
    pub sweeps: f64,
    /// Light-voxel updates, residual, comparison and change-detection passes included.
    pub voxel_updates: u64,
    /// Bricks of direct light that were swept, all lights.
    pub bricks_active: u64,
    /// Bricks of direct light in all, all lights.
    pub bricks_total: u64,
    /// Bound on the error of the light against a cold solve, relative to the brightest light.
    pub certified_error: f64,
    /// Cells that were not finite or filled; transparent.
    pub holes: u64,
    /// Reading.
    pub read_ms: f64,
    /// Classification.
    pub classify_ms: f64,
    /// Light.
    pub light_ms: f64,
    /// Rendering, all cameras.
    pub render_ms: f64,
    /// Writing, all sinks.
    pub write_ms: f64,
    /// Why the step was lost; empty when it was not.
    pub lost: String,
}
