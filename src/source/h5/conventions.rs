//! Layouts that differ from generic HDF5 only in where axes, grids, times and step numbers are told.

use hdf5::File;

use super::attributes::{number, numbers};
use super::netcdf::scales;
use crate::error::{Error, Result};
use crate::source::GridInfo;
use crate::source::axes::Axes;
use crate::source::expand::Entry;

/// What a convention knows; generic detection does the rest.
pub(crate) struct Convention {
    /// Name of the layout; empty for none.
    pub name: &'static str,
    /// Axes of a dataset by its rank, slowest first.
    pub axes: fn(usize) -> Option<&'static str>,
    /// Grid of a dataset with these axes and size.
    pub grid: fn(&File, &str, &Axes, [usize; 3]) -> Option<GridInfo>,
    /// Dataset with the times of the steps in a file.
    pub times: &'static str,
    /// Dataset with their numbers.
    pub numbers: &'static str,
}

/// No convention.
pub(crate) const NONE: Convention =
    Convention { name: "", axes: |_| None, grid: |_, _, _, _| None, times: "", numbers: "" };

/// Meep: x slowest, time in the name (`ez-000012.50.h5`) or as the last axis; nothing else is told.
const MEEP: Convention = Convention {
    name: "Meep",
    axes: |rank| match rank {
        3 => Some("xyz"),
        4 => Some("xyzt"),
        _ => None,
    },
    ..NONE
};

/// Cholla: (x, y, z), cells; root attributes `bounds` (lower corner), `domain` (lengths) and `dims`.
const CHOLLA: Convention = Convention {
    name: "Cholla",
    axes: |rank| (rank == 3).then_some("xyz"),
    grid: |file, _, _, size| {
        let triple = |name: &str| numbers(file, name).and_then(|v| <[f64; 3]>::try_from(v).ok());
        let (corner, lengths, cells) = (triple("bounds")?, triple("domain")?, triple("dims")?);
        let spacing: [f64; 3] = std::array::from_fn(|a| lengths[a] / cells[a]);
        let origin = std::array::from_fn(|a| corner[a] + 0.5 * spacing[a]);
        Some(GridInfo { size, spacing, origin, units: String::new(), centering: "cell".into() })
    },
    ..NONE
};

/// Dedalus: `/tasks/<field>` (t, [component], x, y, z), positions as dimension scales, times in `/scales`.
const DEDALUS: Convention = Convention {
    name: "Dedalus",
    axes: |rank| match rank {
        3 => Some("xyz"),
        4 => Some("txyz"),
        5 => Some("tcxyz"),
        _ => None,
    },
    grid: |file, dataset, axes, size| {
        let scales = scales(file, &file.dataset(dataset).ok()?);
        let along = |a: usize| scales.get(axes.space[a])?.values.clone().filter(|v| v.len() == size[a]);
        let (x, y, z) = (along(0)?, along(1)?, along(2)?);
        let (spacing, origin) = crate::source::coords::uniform([&x, &y, &z], &mut Vec::new())?;
        Some(GridInfo { size, spacing, origin, units: String::new(), centering: "node".into() })
    },
    times: "/scales/sim_time",
    numbers: "/scales/iteration",
};

/// The convention whose marks a file bears, if one of these.
pub(crate) fn of(file: &File, entry: &Entry) -> Result<Option<&'static Convention>> {
    if file.group("tasks").is_ok() && file.dataset("scales/sim_time").is_ok() {
        return Ok(Some(&DEDALUS));
    }
    if ["bounds", "domain", "dims"].iter().all(|n| numbers(file, n).is_some_and(|v| v.len() == 3)) {
        let parts = numbers(file, "dims_local").filter(|local| numbers(file, "dims").as_ref() != Some(local));
        if parts.is_some() || number(file, "nprocs").is_some_and(|n| n > 1.0 && file.attr("offset").is_ok()) {
            let found = "one process's part of a Cholla output";
            return Err(Error::format(&entry.path, found, "cat_dset_3D.py of Cholla joins the parts"));
        }
        return Ok(Some(&CHOLLA));
    }
    let bare = file.attr_names().is_ok_and(|n| n.is_empty());
    Ok((entry.decimal.is_some() && bare).then_some(&MEEP))
}
