//! What layouts with one mesh a file share: every file is read for where its blocks sit, and all are brought to one level.

use std::path::Path;

use hdf5::File;

use super::{Input, Packing, Slab};
use crate::error::{Error, Result};
use crate::source::SeriesInfo;
use crate::source::mesh::{self, Found, Mesh};
use crate::source::series::Plan;
use crate::source::values::Values;

/// Plans a series of one mesh a file. `about` has the layout, the field and the candidates; `read` reads a file's mesh and
/// its time, or says what is wrong.
pub(super) fn plan(
    mut input: Input,
    about: SeriesInfo,
    read: impl Fn(&File, &Path) -> (Option<f64>, Result<Mesh, String>),
) -> Result<Plan> {
    let mut found: Vec<Found> = Vec::new();
    for entry in &input.files.entries {
        let own = super::reopen(entry, input.entry, &input.file, &mut input.warnings);
        let (time, mesh) = match &own {
            Some(file) => read(file, &entry.path),
            None => (None, Err("cannot be opened".into())),
        };
        let step = entry.number.unwrap_or(found.len() as u64);
        found.push(Found { step, time: time.or(entry.decimal), mesh, file: entry.path.clone() });
    }
    let (grid, level, steps) = mesh::steps(found, input.spec.level, &mut input.warnings)
        .map_err(|why| Error::format(&input.entry.path, why, "gloaming info without --level lists what there is"))?;
    let grid = crate::source::GridInfo { units: about.grid.units.clone(), ..grid };
    let info = SeriesInfo { series: input.paths(), grid, level: Some(level), warnings: input.warnings, ..about };
    Ok(Plan { info, steps, start: 0.0 })
}

/// One block of a dataset whose leading axes, as `fixed`, tell blocks apart.
pub(super) fn block(file: &Path, dataset: &str, fixed: Vec<(usize, usize)>) -> Values {
    let rank = 3 + fixed.len();
    Values::Hdf5(Slab {
        file: file.to_owned(),
        dataset: dataset.to_owned(),
        rank,
        space: [rank - 1, rank - 2, rank - 3],
        fixed,
        start: [0; 3],
        whole: true,
        packing: Packing::default(),
    })
}

/// The whole number that `x` is to one part in a thousand, or within a thousandth of 0.
pub(super) fn whole(x: f64) -> Option<usize> {
    let n = x.round();
    ((x - n).abs() <= 1e-3 * n.abs().max(1.0) && (0.0..1e15).contains(&n)).then_some(n as usize)
}
