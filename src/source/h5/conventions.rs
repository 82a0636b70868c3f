//! Layouts that differ from generic HDF5 only in where axes, grids, times and step numbers are told.

use hdf5::File;

use super::attributes::{number, numbers};
use super::netcdf::scales;
use crate::error::{Error, Result};
use crate::source::GridInfo;
use crate::source::axes::Axes;
use crate::source::coords::{self, Along};
use crate::source::expand::Entry;

/// What a convention knows; generic detection does the rest.
pub(crate) struct Convention {
    /// Name of the layout; empty for none.
    pub name: &'static str,
    /// Axes of a dataset by its rank, slowest first.
    pub axes: fn(usize) -> Option<&'static str>,
    /// Grid of a dataset with these axes and size.
    pub grid: TellGrid,
    /// Dataset with the times of the steps in a file.
    pub times: &'static str,
    /// Dataset with their numbers.
    pub numbers: &'static str,
}

/// The grid of a dataset, by its file, path, axes and size; what looks wrong is added to the warnings.
type TellGrid = fn(&File, &str, &Axes, [usize; 3], &mut Vec<String>) -> Option<GridInfo>;

/// No convention.
pub(crate) const NONE: Convention =
    Convention { name: "", axes: |_| None, grid: |_, _, _, _, _| None, times: "", numbers: "" };

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
    grid: |file, _, _, size, _| {
        let triple = |name: &str| numbers(file, name).and_then(|v| <[f64; 3]>::try_from(v).ok());
        let (corner, lengths, cells) = (triple("bounds")?, triple("domain")?, triple("dims")?);
        let spacing: [f64; 3] = std::array::from_fn(|a| lengths[a] / cells[a]);
        let origin = std::array::from_fn(|a| corner[a] + 0.5 * spacing[a]);
        Some(GridInfo { size, spacing, origin, centering: "cell".into(), ..GridInfo::default() })
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
    grid: |file, dataset, axes, size, warnings| {
        let spectral = file.dataset(dataset).ok()?.attr("grid_space").ok().and_then(|a| a.read_raw::<bool>().ok());
        if spectral.is_some_and(|on_grid| on_grid.contains(&false)) {
            warnings
                .push(format!("{dataset}: grid_space says that these are spectral coefficients, not values in space"));
        }
        let scales = scales(file, &file.dataset(dataset).ok()?);
        let along = |a: usize| scales.get(axes.space[a])?.values.clone().filter(|v| v.len() == size[a]);
        let along = [Along::points(&along(0)?), Along::points(&along(1)?), Along::points(&along(2)?)];
        let mut grid = GridInfo { size, centering: "node".into(), ..GridInfo::default() };
        coords::place(&mut grid, along, warnings).then_some(grid)
    },
    times: "/scales/sim_time",
    numbers: "/scales/iteration",
};

/// ADIOS2's HDF5 engine: `/Step0/<variable>`, `/Step1/…`, and how many steps there are.
const ADIOS2: Convention = Convention { name: "ADIOS2 in HDF5", ..NONE };

/// Cutouts of the Johns Hopkins turbulence databases: `<variable>_0001` (z, y, x, component) for each time, positions in
/// `xcoor`, `ycoor`, `zcoor`.
pub(crate) const JHTDB: Convention = Convention {
    name: "JHTDB cutout",
    axes: |rank| match rank {
        3 => Some("zyx"),
        4 => Some("zyxc"),
        _ => None,
    },
    ..NONE
};

/// Whether a file is a cutout of a turbulence database.
pub(crate) fn is_cutout(file: &File) -> bool {
    ["xcoor", "ycoor", "zcoor"].iter().all(|n| file.link_exists(n))
}

/// The convention whose marks a file bears, if one of these, and the marks.
pub(crate) fn of(file: &File, entry: &Entry) -> Result<(&'static Convention, &'static str)> {
    if file.group("tasks").is_ok() && file.dataset("scales/sim_time").is_ok() {
        return Ok((&DEDALUS, "group /tasks and dataset /scales/sim_time"));
    }
    if file.attr("NumSteps").is_ok() && file.link_exists("Step0") {
        return Ok((&ADIOS2, "root attribute NumSteps and group /Step0"));
    }
    if is_cutout(file) {
        return Ok((&JHTDB, "datasets xcoor, ycoor, zcoor"));
    }
    if ["bounds", "domain", "dims"].iter().all(|n| numbers(file, n).is_some_and(|v| v.len() == 3)) {
        let parts = numbers(file, "dims_local").filter(|local| numbers(file, "dims").as_ref() != Some(local));
        if parts.is_some() || number(file, "nprocs").is_some_and(|n| n > 1.0 && file.attr("offset").is_ok()) {
            let found = "one process's part of a Cholla output";
            return Err(Error::format(&entry.path, found, "cat_dset_3D.py of Cholla joins the parts"));
        }
        return Ok((&CHOLLA, "root attributes bounds, domain and dims"));
    }
    let bare = file.attr_names().is_ok_and(|n| n.is_empty());
    let meep = entry.decimal.is_some() && bare;
    Ok(if meep {
        (&MEEP, "a time in the file's name, and no attributes")
    } else {
        (&NONE, "no marks of another layout")
    })
}
