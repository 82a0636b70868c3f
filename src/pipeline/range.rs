//! The range of values over a series: what the scene or the file says, else from a pass over the steps.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;

use super::{OnProgress, Progress, Stage, resident};
use crate::error::{Error, Result};
use crate::field::{self, Timestep};
use crate::grid::Slab;
use crate::ledger::LedgerRow;
use crate::scene::{RangeKey, RangeOver, Scene};
use crate::source::Series;

/// A range, and the steps that were read for it and kept, by index.
#[derive(Default)]
pub(super) struct Pass {
    pub range: Option<[f64; 2]>,
    pub kept: HashMap<usize, Timestep>,
}

/// The range that is known without reading values; `None` where there is none, and inside of it where none is wanted.
pub(super) fn known(series: &dyn Series, scene: &Scene) -> Option<Option<[f64; 2]>> {
    if scene.field.range != RangeKey::Over(RangeOver::Series) {
        return Some(None);
    }
    let (range, source) = series.info().range.as_ref()?;
    tracing::info!("values {}..{} from {source}", range[0], range[1]);
    Some(Some(*range))
}

/// Bytes of a step that are held at a time where it is not kept.
const AT_A_TIME: usize = 32 << 20;

/// Reads the steps `indices` for their range; the first of them are kept, up to `keep` bytes.
pub(super) fn pass(
    series: &dyn Series,
    indices: &[usize],
    keep: u64,
    stop: &AtomicBool,
    progress: &mut OnProgress<'_>,
) -> Result<Pass> {
    let mut pass = Pass::default();
    let (mut room, mut values) = (keep, Vec::new());
    for (n, &i) in indices.iter().enumerate() {
        if stop.load(Ordering::Relaxed) {
            break;
        }
        let row = LedgerRow { step: series.info().steps[i].step, ..Default::default() };
        progress(Progress { stage: Stage::Range, finished: n, total: Some(indices.len()), row: &row });
        // A step that cannot be read is reported when its turn comes.
        let Ok(step) = series.timestep(i) else { continue };
        let bytes = 4 * step.grid.len() as u64;
        let (step, kept) = match bytes <= room {
            true => match resident(step) {
                Ok(step) => (step, true),
                Err(_) => continue,
            },
            false => (step, false),
        };
        let [nx, ny, nz] = step.grid.size;
        let deep = (AT_A_TIME / (4 * nx * ny).max(1)).clamp(1, nz.max(1));
        values.resize(nx * ny * deep, 0.0);
        let mut range = pass.range;
        let read = (0..nz).step_by(deep).try_for_each(|z| {
            let slab = Slab { size: step.grid.size, planes: z..(z + deep).min(nz) };
            field::read_planes(&*step.field, &slab, &mut values, false)?;
            range = widest(range, range_of(&values[..slab.len()]));
            Ok::<_, Error>(())
        });
        if read.is_ok() {
            pass.range = range;
            if kept {
                room -= bytes;
                pass.kept.insert(i, step);
            }
        }
    }
    if let Some([lo, hi]) = pass.range {
        tracing::info!("values {lo}..{hi} from a pass over {} steps; field.range = [lo, hi] saves it", indices.len());
    }
    Ok(pass)
}

/// The range of values that are no holes.
fn range_of(values: &[f32]) -> Option<[f64; 2]> {
    let none = || [f32::INFINITY, f32::NEG_INFINITY];
    let take = |[lo, hi]: [f32; 2], v: &f32| if *v >= field::HOLE { [lo.min(*v), hi.max(*v)] } else { [lo, hi] };
    let both = |a: [f32; 2], b: [f32; 2]| [a[0].min(b[0]), a[1].max(b[1])];
    let range = values.par_chunks(1 << 16).map(|part| part.iter().fold(none(), take)).reduce(none, both);
    (range[0] <= range[1]).then_some(range.map(f64::from))
}

fn widest(a: Option<[f64; 2]>, b: Option<[f64; 2]>) -> Option<[f64; 2]> {
    match (a, b) {
        (Some(a), Some(b)) => Some([a[0].min(b[0]), a[1].max(b[1])]),
        (one, None) | (None, one) => one,
    }
}
