//! Sinks: where lit frames, illuminated volumes and the ledger go. A format is one file here and one `match` arm.

use std::sync::Arc;

use crate::error::Result;
use crate::frame::Frame;
use crate::grid::Grid;
use crate::ledger::LedgerRow;

/// The light of one step: fluence per colour channel on the light grid.
#[derive(Debug, Clone, PartialEq)]
pub struct IlluminatedVolume {
    /// Where the values sit.
    pub grid: Grid,
    /// Fluence as (z, y, x, rgb).
    pub fluence: Vec<[f32; 3]>,
}

/// What a session made of one step.
#[derive(Debug, Clone)]
pub struct Output {
    /// The simulation's step number.
    pub step: u64,
    /// Physical time, where known.
    pub time: Option<f64>,
    /// Values that map to 0 and 1 of the transfer function.
    pub range: [f64; 2],
    /// One frame per camera, with the camera's name and the world-to-view rotation's rows (right, up, forward).
    pub frames: Vec<View>,
    /// The illuminated volume, when a sink wants it.
    pub light: Option<Arc<IlluminatedVolume>>,
    /// What it cost.
    pub row: LedgerRow,
}

/// One camera's picture of a step.
#[derive(Debug, Clone)]
pub struct View {
    /// Name of the camera.
    pub camera: String,
    /// Right, up and forward in world axes, for the axes triad and EXR attributes.
    pub axes: [[f32; 3]; 3],
    /// Eye in world space.
    pub eye: [f32; 3],
    /// Vertical field of view in degrees.
    pub fov: f32,
    /// The picture.
    pub frame: Frame,
}

/// Something that takes the output of one step after another.
pub trait Sink: Send {
    /// Takes one step. A file appears under its final name only when it is whole.
    fn write(&mut self, output: &Output) -> Result<()>;

    /// Closes what is open; the sink is not used afterwards. Called after an interruption and after errors too, so
    /// that a movie of the frames done is playable.
    fn finish(&mut self) -> Result<()>;

    /// True when the sink needs the illuminated volume.
    fn wants_light(&self) -> bool {
        false
    }

    /// True when the sink needs frames.
    fn wants_frames(&self) -> bool {
        true
    }
}
