//! Meshes of two levels in every layout that keeps them: the same mesh, written in each layout's own way.
//!
//! A value tells its place, and 1000 more on the finer level; coarse cells below finer ones hold what nobody should see.

use std::path::Path;

use gloaming::grid::Region;
use gloaming::source::{Series, SourceSpec, open, statistics_of};
use hdf5::File;
use ndarray::{Array, ArrayD, IxDyn};

use super::{attribute, complaint, says, spec, text_attribute, write};

/// Cells of level 0, its lower corner, and the length of its cells.
const ROOT: [usize; 3] = [8, 4, 4];
const CORNER: [f64; 3] = [-1.0, 0.0, 2.0];
const SPACING: [f64; 3] = [0.5, 0.5, 0.5];
/// Level, first cell in cells of the level, and size of a patch.
type Patch = (usize, [usize; 3], [usize; 3]);
const PATCHES: [Patch; 3] = [(0, [0, 0, 0], [4, 4, 4]), (0, [4, 0, 0], [4, 4, 4]), (1, [4, 0, 0], [4, 4, 4])];
const POISON: f64 = -777.0;

fn refined(level: usize, at: [usize; 3]) -> bool {
    let (_, start, size) = PATCHES[2];
    let fine = at.map(|n| n << (1 - level));
    (0..3).all(|a| (start[a]..start[a] + size[a]).contains(&fine[a]))
}

/// The value of a cell: linear in the place of its centre, so that eight finer ones have its mean.
fn cell(level: usize, at: [usize; 3], step: usize) -> f64 {
    let x: [f64; 3] = std::array::from_fn(|a| CORNER[a] + SPACING[a] / (1 << level) as f64 * (at[a] as f64 + 0.5));
    let finer = if level == 1 { 1000.0 } else { 0.0 };
    finer + 2.0 * x[0] + 3.0 * x[1] + 5.0 * x[2] + 100.0 * step as f64
}

/// The values of a patch, x fastest.
fn values(patch: usize, step: usize) -> Vec<f64> {
    let (level, start, [nx, ny, nz]) = PATCHES[patch];
    let one = |n: usize| {
        let at = [start[0] + n % nx, start[1] + n / nx % ny, start[2] + n / (nx * ny)];
        if level == 0 && refined(0, at) { POISON } else { cell(level, at, step) }
    };
    (0..nx * ny * nz).map(one).collect()
}

/// What the mesh shows on a level.
fn expected(level: usize, step: usize) -> Vec<f64> {
    let [nx, ny, nz] = ROOT.map(|n| n << level);
    let one = |n: usize| {
        let at = [n % nx, n / nx % ny, n / (nx * ny)];
        match (level, refined(level, at)) {
            (1, true) => cell(1, at, step),
            (1, false) => cell(0, at.map(|i| i / 2), step),
            (_, true) => 1000.0 + cell(0, at, step),
            (_, false) => cell(0, at, step),
        }
    };
    (0..nx * ny * nz).map(one).collect()
}

fn close(is: &[f64], was: &[f64]) -> bool {
    is.len() == was.len() && is.iter().zip(was).all(|(a, b)| (a - b).abs() <= 1e-9 * b.abs().max(1.0))
}

fn read(series: &dyn Series, index: usize, region: Option<Region>) -> Vec<f64> {
    let step = series.timestep(index).unwrap();
    let region = region.unwrap_or(step.grid.region());
    let mut out = vec![0.0; region.len()];
    step.field.read_f64(region, &mut out).unwrap();
    out
}

/// Holds two steps, 3 and 10 at times 1.5 and 5, against what they should be on both levels.
fn check(asked: SourceSpec, layout: &str) {
    let series = open(&asked).unwrap();
    let info = series.info();
    assert_eq!((info.layout.as_str(), info.level), (layout, Some(1)));
    assert_eq!(info.steps.iter().map(|s| (s.step, s.time)).collect::<Vec<_>>(), [(3, Some(1.5)), (10, Some(5.0))]);
    assert_eq!((info.grid.size, info.grid.spacing, info.grid.centering.as_str()), ([16, 8, 8], [0.25; 3], "cell"));
    assert_eq!(info.grid.origin, [-0.875, 0.125, 2.125]);
    says(&info.warnings.join("\n"), &["mesh of 2 levels", "finest level, 16×8×8", "--level"]);
    assert!(!info.why.is_empty());
    for step in 0..2 {
        assert!(close(&read(series.as_ref(), step, None), &expected(1, step)), "{layout} step {step}");
    }
    let region = Region { start: [3, 1, 2], size: [9, 5, 4] };
    let whole = expected(1, 1);
    let part: Vec<f64> =
        (0..region.len()).map(|n| whole[((2 + n / 45) * 8 + 1 + n / 9 % 5) * 16 + 3 + n % 9]).collect();
    assert!(close(&read(series.as_ref(), 1, Some(region)), &part), "{layout}: a region");
    // The file's own cells: 128 coarse ones less 8 that are covered, and 64 finer ones; none is read twice.
    let native = series.native(1).unwrap();
    let found = statistics_of(&native.pieces).unwrap();
    let fine = || PATCHES[2].2.iter().product::<usize>();
    assert_eq!((found.total, found.valid), (128 - 8 + fine(), 128 - 8 + fine()), "{layout}");
    let own: Vec<f64> = (0..3).flat_map(|p| values(p, 1)).filter(|v| *v != POISON).collect();
    let mean = own.iter().sum::<f64>() / own.len() as f64;
    assert!((found.mean - mean).abs() < 1e-9 && found.min == own.iter().copied().fold(f64::INFINITY, f64::min));

    let coarse = open(&SourceSpec { level: Some(0), ..asked.clone() }).unwrap();
    let grid = &coarse.info().grid;
    assert_eq!((grid.size, grid.spacing, grid.origin), (ROOT, SPACING, [-0.75, 0.25, 2.25]));
    says(&coarse.info().warnings.join("\n"), &["level 0, 8×4×4, as asked", "averaged"]);
    assert!(close(&read(coarse.as_ref(), 1, None), &expected(0, 1)), "{layout}: level 0");
    says(&complaint(&SourceSpec { level: Some(2), ..asked }, None), &["no level 2", "0 to 1"]);
}

/// (z, y, x) as an array of f64.
fn array(patch: usize, step: usize) -> ArrayD<f64> {
    let [nx, ny, nz] = PATCHES[patch].2;
    ArrayD::from_shape_vec(IxDyn(&[nz, ny, nx]), values(patch, step)).unwrap()
}

const STEPS: [(u64, f64); 2] = [(3, 1.5), (10, 5.0)];

/// An Enzo output: packed files share one HDF5 file, the others have one for each grid.
fn enzo(folder: &Path, packed: bool) {
    for (step, (number, time)) in STEPS.into_iter().enumerate() {
        let name = format!("DD{number:04}");
        let inside = folder.join(&name);
        std::fs::create_dir_all(&inside).unwrap();
        let parameters = format!(
            "InitialCycleNumber  = 7\nInitialTime         = {time}\nInitialCPUTime      = 0\n\nTopGridRank            = 3\n\
             TopGridDimensions   = 8 4 4\nRefineBy   = 2\nDomainLeftEdge         = -1 0 2\nDomainRightEdge        = 3 2 4\n\
             DataLabel[0]              = Density\nDataUnits[0]              = g/cm^3\n"
        );
        std::fs::write(inside.join(&name), parameters).unwrap();
        let mut hierarchy = String::new();
        let shared = packed.then(|| File::create(inside.join(format!("{name}.cpu0000"))).unwrap());
        for (n, (level, start, size)) in PATCHES.into_iter().enumerate() {
            let h = 0.5 / (1 << level) as f64;
            let edge = |at: [usize; 3]| {
                (0..3).map(|a| (CORNER[a] + h * at[a] as f64).to_string()).collect::<Vec<_>>().join(" ")
            };
            let (id, end) = (n + 1, std::array::from_fn(|a| start[a] + size[a]));
            let file = if packed { format!("{name}.cpu0000") } else { format!("{name}.grid{id:04}") };
            hierarchy += &format!(
                "\nGrid = {id}\nTask              = 0\nGridRank          = 3\nGridDimension     = 10 10 10\n\
                 GridStartIndex    = 3 3 3\nGridEndIndex      = 6 6 6\nGridLeftEdge      = {}\nGridRightEdge     = {}\n\
                 Time              = {time}\nNumberOfBaryonFields = 1\nFieldType = 0\nBaryonFileName = /where/it/ran/{file}\n\
                 Pointer: Grid[{id}]->NextGridThisLevel = 0\n",
                edge(start),
                edge(end)
            );
            match &shared {
                Some(file) => {
                    write(&file.create_group(&format!("Grid{id:08}")).unwrap(), "Density", &array(n, step));
                }
                None => {
                    write(&File::create(inside.join(file)).unwrap(), "Density", &array(n, step));
                }
            }
        }
        std::fs::write(inside.join(format!("{name}.hierarchy")), hierarchy).unwrap();
    }
}

#[test]
fn enzo_outputs_are_found_by_any_of_their_files() {
    for packed in [true, false] {
        let folder = tempfile::tempdir().unwrap();
        enzo(folder.path(), packed);
        for typed in ["DD*/DD????", "DD*/DD*.hierarchy", "DD{step:04}/DD{step:04}", ""] {
            check(spec(folder.path().join(typed)), "Enzo");
        }
        let series = open(&spec(folder.path().join("DD0003"))).unwrap();
        assert_eq!((series.info().field.as_str(), series.info().units.as_str()), ("Density", "g/cm^3"));
        if packed {
            assert_eq!(open(&spec(folder.path().join("DD0003/DD0003.cpu0000"))).unwrap().info().layout, "Enzo");
        }
    }
}

#[test]
fn enzo_outputs_with_parts_missing_lose_their_step() {
    let folder = tempfile::tempdir().unwrap();
    enzo(folder.path(), true);
    std::fs::remove_file(folder.path().join("DD0010/DD0010.cpu0000")).unwrap();
    says(&complaint(&spec(folder.path()), Some(1)), &["step 10", "DD0010.cpu0000", "missing"]);
    std::fs::remove_file(folder.path().join("DD0010/DD0010")).unwrap();
    says(&complaint(&spec(folder.path()), Some(1)), &["step 10", "no such file"]);
    let one = folder.path().join("DD0003");
    let hierarchy = std::fs::read_to_string(one.join("DD0003.hierarchy")).unwrap();
    for (was, is, things) in [
        ("GridEndIndex      = 6 6 6", "GridEndIndex      = 6 6", vec!["Grid = 1", "GridEndIndex"]),
        ("GridLeftEdge      = -1 0 2", "GridLeftEdge      = -1.1 0 2", vec!["Grid = 1", "askew"]),
        ("GridLeftEdge      = -1 0 2", "GridLeftEdge      = nan 0 2", vec!["Grid = 1", "GridLeftEdge"]),
        ("GridEndIndex      = 6 6 6", "GridEndIndex      = 1e8 6 6", vec!["Grid = 1"]),
    ] {
        std::fs::write(one.join("DD0003.hierarchy"), hierarchy.replace(was, is)).unwrap();
        says(&complaint(&spec(&one), None), &things);
    }
}

#[derive(hdf5::H5Type, Clone, Copy)]
#[repr(C)]
struct Box3 {
    lo_i: i32,
    lo_j: i32,
    lo_k: i32,
    hi_i: i32,
    hi_j: i32,
    hi_k: i32,
}

#[derive(hdf5::H5Type, Clone, Copy)]
#[repr(C)]
struct Vect3 {
    intvecti: i32,
    intvectj: i32,
    intvectk: i32,
}

/// How a Chombo-like file is written.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    /// As Chombo does, with a ghost cell all round and a domain that begins at cell (2, −4, 1).
    Chombo,
    /// Without the list of offsets.
    Old,
    /// As AMReX does, all components in one dataset.
    Amrex,
    /// As AMReX does, one dataset for each component.
    Apart,
}

/// Boxes of two components; the second is the one to read.
fn chombo(path: &Path, step: usize, kind: Kind) {
    let file = File::create(path).unwrap();
    let amrex = matches!(kind, Kind::Amrex | Kind::Apart);
    let (low, ghosts) = if kind == Kind::Chombo { ([2, -4, 1], 1) } else { ([0; 3], 0) };
    let integer =
        |at: &hdf5::Location, name: &str, v: i32| at.new_attr::<i32>().create(name).unwrap().write_scalar(&v).unwrap();
    integer(&file.create_group("Chombo_global").unwrap(), "SpaceDim", 3);
    integer(&file, "num_components", 2);
    integer(&file, "num_levels", 2);
    text_attribute(&file, "component_0", "pressure");
    text_attribute(&file, "component_1", "density");
    attribute(&file, "time", &[STEPS[step].1]);
    if amrex {
        text_attribute(&file, "plotfile_type", "VanillaHDF5");
        integer(&file, "coordinate_system", 0);
    }
    for level in 0..2 {
        let group = file.create_group(&format!("level_{level}")).unwrap();
        let h = 0.5 / (1 << level) as f64;
        attribute(&group, "dx", &[h]);
        integer(&group, "ref_ratio", if level == 0 { 2 } else { 1 });
        let boxed = |start: [usize; 3], size: [usize; 3]| {
            let lo: [i32; 3] = std::array::from_fn(|a| start[a] as i32 + (low[a] << level));
            let hi: [i32; 3] = std::array::from_fn(|a| lo[a] + size[a] as i32 - 1);
            Box3 { lo_i: lo[0], lo_j: lo[1], lo_k: lo[2], hi_i: hi[0], hi_j: hi[1], hi_k: hi[2] }
        };
        let domain = boxed([0; 3], ROOT.map(|n| n << level));
        group.new_attr::<Box3>().create("prob_domain").unwrap().write_scalar(&domain).unwrap();
        attribute(&group, "prob_lo", &CORNER);
        let attributes = group.create_group("data_attributes").unwrap();
        let ghost = Vect3 { intvecti: ghosts as i32, intvectj: ghosts as i32, intvectk: ghosts as i32 };
        attributes.new_attr::<Vect3>().create("outputGhost").unwrap().write_scalar(&ghost).unwrap();
        let (mut boxes, mut flat, mut alone, mut offsets) = (Vec::new(), Vec::new(), Vec::new(), vec![0i64]);
        for (n, (l, start, size)) in PATCHES.into_iter().enumerate() {
            if l != level {
                continue;
            }
            boxes.push(boxed(start, size));
            let [sx, sy, sz] = size.map(|n| n + 2 * ghosts);
            let inner = values(n, step);
            let mut stored = vec![f64::NAN; sx * sy * sz];
            for (i, v) in inner.iter().enumerate() {
                let (x, y, z) =
                    (i % size[0] + ghosts, i / size[0] % size[1] + ghosts, i / (size[0] * size[1]) + ghosts);
                stored[(z * sy + y) * sx + x] = *v;
            }
            if kind != Kind::Apart {
                flat.extend(vec![-5.0; stored.len()]);
                offsets.push((flat.len() + stored.len()) as i64);
                flat.extend(stored);
            } else {
                alone.extend(vec![-5.0; stored.len()]);
                flat.extend(stored);
                offsets.push(flat.len() as i64);
            }
        }
        group.new_dataset_builder().with_data(&boxes).create("boxes").unwrap();
        let one = |v: Vec<f64>| Array::from_vec(v).into_dyn();
        if kind == Kind::Apart {
            write(&group, "data:datatype=0", &one(alone));
            write(&group, "data:datatype=1", &one(flat));
        } else {
            write(&group, "data:datatype=0", &one(flat));
        }
        if kind != Kind::Old {
            write(&group, "data:offsets=0", &Array::from_vec(offsets).into_dyn());
        }
    }
}

#[test]
fn chombo_and_amrex_boxes_are_put_together() {
    for kind in [Kind::Chombo, Kind::Old, Kind::Amrex, Kind::Apart] {
        let folder = tempfile::tempdir().unwrap();
        for (step, (number, _)) in STEPS.into_iter().enumerate() {
            chombo(&folder.path().join(format!("plt{number:05}.h5")), step, kind);
        }
        let amrex = matches!(kind, Kind::Amrex | Kind::Apart);
        let asked = SourceSpec { field: Some("density".into()), ..spec(folder.path()) };
        check(asked, if amrex { "AMReX plotfile in HDF5" } else { "Chombo" });
        says(&complaint(&spec(folder.path()), None), &["pressure (4×4×8 f64le", "density"]);
    }
}

#[test]
fn chombo_files_that_lie_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.h5");
    let asked = SourceSpec { field: Some("density".into()), ..spec(&path) };
    let spoil = |spoil: &dyn Fn(&File)| {
        chombo(&path, 0, Kind::Amrex);
        spoil(&File::open_rw(&path).unwrap());
    };
    let boxes = |file: &File, hi_i: i32| {
        let group = file.group("level_1").unwrap();
        group.unlink("boxes").unwrap();
        let one = [Box3 { lo_i: 4, lo_j: 0, lo_k: 0, hi_i, hi_j: 3, hi_k: 3 }];
        group.new_dataset_builder().with_data(&one).create("boxes").unwrap();
    };
    spoil(&|file| boxes(file, i32::MAX));
    says(&complaint(&asked, None), &["a.h5", "level 1", "outside of the mesh"]);
    spoil(&|file| boxes(file, 3));
    says(&complaint(&asked, None), &["level_1/boxes: box 0 is empty"]);
    spoil(&|file| {
        let group = file.group("level_1").unwrap();
        group.unlink("data:datatype=0").unwrap();
        write(&group, "data:datatype=0", &ArrayD::<f64>::zeros(IxDyn(&[100])));
    });
    says(&complaint(&asked, Some(0)), &["a.h5:level_1/data:datatype=0", "does not fit into 100 numbers"]);
    spoil(&|file| {
        let group = file.group("level_1").unwrap();
        group.unlink("boxes").unwrap();
        group.new_dataset::<Box3>().shape([1 << 40]).chunk([1 << 10]).create("boxes").unwrap();
    });
    says(&complaint(&asked, None), &["claims 1099511627776 boxes"]);
    spoil(&|file| {
        file.group("Chombo_global")
            .unwrap()
            .delete_attr("SpaceDim")
            .and_then(|()| file.group("Chombo_global").unwrap().new_attr::<i32>().create("SpaceDim")?.write_scalar(&2))
            .unwrap()
    });
    says(&complaint(&asked, None), &["2 axes", "three dimensions"]);
}

fn gdf(path: &Path, step: usize, ordering: i32) {
    let file = File::create(path).unwrap();
    text_attribute(&file.create_group("gridded_data_format").unwrap(), "data_software", "a test");
    let run = file.create_group("simulation_parameters").unwrap();
    let integers = |name: &str, values: &[i64]| {
        let attr = run.new_attr::<i64>();
        match values {
            [one] => attr.create(name).unwrap().write_scalar(one).unwrap(),
            _ => attr.shape([values.len()]).create(name).unwrap().write(values).unwrap(),
        }
    };
    integers("refine_by", &[2]);
    integers("dimensionality", &[3]);
    integers("domain_dimensions", &[8, 4, 4]);
    integers("num_ghost_zones", &[0]);
    integers("field_ordering", &[i64::from(ordering)]);
    attribute(&run, "domain_left_edge", &CORNER);
    attribute(&run, "domain_right_edge", &[3.0, 2.0, 4.0]);
    attribute(&run, "current_time", &[STEPS[step].1]);
    let kinds = file.create_group("field_types").unwrap().create_group("density").unwrap();
    text_attribute(&kinds, "field_units", "g/cm**3");
    let data = file.create_group("data").unwrap();
    for n in 0..PATCHES.len() {
        let array = array(n, step);
        let turned = if ordering == 1 { array } else { array.reversed_axes().as_standard_layout().to_owned() };
        write(&data.create_group(&format!("grid_{n:010}")).unwrap(), "density", &turned);
    }
    let lists = |pick: fn(&Patch) -> [usize; 3]| {
        let flat: Vec<i64> = PATCHES.iter().flat_map(pick).map(|n| n as i64).collect();
        Array::from_shape_vec((PATCHES.len(), 3), flat).unwrap().into_dyn()
    };
    write(&file, "grid_left_index", &lists(|p| p.1));
    write(&file, "grid_dimensions", &lists(|p| p.2));
    write(&file, "grid_level", &Array::from_vec(PATCHES.iter().map(|p| p.0 as i64).collect::<Vec<_>>()).into_dyn());
}

#[test]
fn gdf_grids_are_put_together_in_both_orders() {
    for ordering in [0, 1] {
        let folder = tempfile::tempdir().unwrap();
        for (step, (number, _)) in STEPS.into_iter().enumerate() {
            gdf(&folder.path().join(format!("out_{number:04}.gdf")), step, ordering);
        }
        check(spec(folder.path()), "Grid Data Format");
        assert_eq!(open(&spec(folder.path())).unwrap().info().units, "g/cm**3");
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.gdf");
    gdf(&path, 0, 1);
    let file = File::open_rw(&path).unwrap();
    file.unlink("grid_level").unwrap();
    write(&file, "grid_level", &Array::from_vec(vec![0i64, 0]).into_dyn());
    drop(file);
    says(&complaint(&spec(&path), None), &["a.gdf", "2 grid_level", "do not agree"]);
}

/// One file of openPMD with records `rho` and `rho_lvl1`, the finer one over its patch alone; positions in millimetres.
fn openpmd(path: &Path, step: usize, position: f64) {
    let file = File::create(path).unwrap();
    for (name, text) in
        [("openPMD", "1.1.0"), ("basePath", "/data/%T/"), ("meshesPath", "fields/"), ("iterationEncoding", "fileBased")]
    {
        text_attribute(&file, name, text);
    }
    let (number, time) = STEPS[step];
    let iteration = file.create_group("data").unwrap().create_group(&number.to_string()).unwrap();
    attribute(&iteration, "time", &[time]);
    let fields = iteration.create_group("fields").unwrap();
    let coarse: Vec<f64> = (0..128)
        .map(|n| {
            let at = [n % 8, n / 8 % 4, n / 32];
            if refined(0, at) { POISON } else { cell(0, at, step) }
        })
        .collect();
    let coarse = ArrayD::from_shape_vec(IxDyn(&[4, 4, 8]), coarse).unwrap();
    for (level, name, values) in [(0, "rho", coarse), (1, "rho_lvl1", array(2, step))] {
        let dataset = write(&fields, name, &values);
        let h = 0.5 / (1 << level) as f64;
        let labels: Vec<_> = ["z", "y", "x"].map(|l| hdf5::types::FixedAscii::<2>::from_ascii(l).unwrap()).into();
        dataset
            .new_attr::<hdf5::types::FixedAscii<2>>()
            .shape([3])
            .create("axisLabels")
            .unwrap()
            .write(&labels)
            .unwrap();
        let start = if level == 0 { [0; 3] } else { PATCHES[2].1 };
        let corner: Vec<f64> = (0..3).rev().map(|a| 1000.0 * (CORNER[a] + h * start[a] as f64)).collect();
        attribute(&dataset, "gridSpacing", &[1000.0 * h; 3]);
        attribute(&dataset, "gridGlobalOffset", &corner);
        attribute(&dataset, "gridUnitSI", &[1e-3]);
        attribute(&dataset, "position", &[position; 3]);
    }
}

#[test]
fn openpmd_records_of_finer_levels_belong_to_the_coarse_one() {
    let folder = tempfile::tempdir().unwrap();
    for (step, (number, _)) in STEPS.into_iter().enumerate() {
        openpmd(&folder.path().join(format!("diag_{number}.h5")), step, 0.5);
    }
    let series = open(&spec(folder.path())).unwrap();
    let info = series.info();
    assert_eq!((info.layout.as_str(), info.field.as_str(), info.level), ("openPMD fileBased", "rho", Some(1)));
    assert_eq!(info.candidates.len(), 2);
    assert!(
        close(&info.grid.spacing, &[0.25; 3]) && close(&info.grid.origin, &[-0.875, 0.125, 2.125]),
        "{:?}",
        info.grid
    );
    for (step, (_, time)) in STEPS.into_iter().enumerate() {
        assert_eq!(info.steps[step].time, Some(time));
        assert!(close(&read(series.as_ref(), step, None), &expected(1, step)), "step {step}");
    }
    let coarse = open(&SourceSpec { level: Some(0), ..spec(folder.path()) }).unwrap();
    assert!(close(&read(coarse.as_ref(), 1, None), &expected(0, 1)));
    // One level is a field of its own, which has no levels.
    let finer = open(&SourceSpec { field: Some("rho_lvl1".into()), ..spec(folder.path()) }).unwrap();
    assert_eq!((finer.info().grid.size, finer.info().level), ([4, 4, 4], None));
    let path = folder.path().join("nodes.h5");
    openpmd(&path, 0, 0.0);
    let told = open(&spec(path)).unwrap().info().clone();
    assert_eq!((told.grid.size, told.level), ([8, 4, 4], None));
    says(&told.warnings.join("\n"), &["rho_lvl1 refine the field but are not on cells"]);
}

/// The texts of an Enzo output are changed byte by byte and cut short: nothing that follows may panic or run away.
#[test]
fn damaged_enzo_texts_end_in_errors() {
    let folder = tempfile::tempdir().unwrap();
    enzo(folder.path(), true);
    let inside = folder.path().join("DD0003");
    let mut state = 7u64;
    let mut random = move |below: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below
    };
    for name in ["DD0003", "DD0003.hierarchy"] {
        let path = inside.join(name);
        let whole = std::fs::read(&path).unwrap();
        for _ in 0..200 {
            let mut bytes = whole.clone();
            for _ in 0..1 + random(4) {
                let at = random(bytes.len());
                bytes[at] = b"0123456789-.e= \n\xff"[random(17)];
            }
            if random(4) == 0 {
                bytes.truncate(random(whole.len()));
            }
            std::fs::write(&path, &bytes).unwrap();
            let Ok(series) = open(&spec(inside.join("DD0003.hierarchy"))) else { continue };
            let Ok(step) = series.timestep(0) else { continue };
            if step.grid.len() < 1 << 20 {
                let _ = step.field.read(step.grid.region(), &mut vec![0.0; step.grid.len()]);
            }
        }
        std::fs::write(&path, whole).unwrap();
    }
}

#[test]
fn a_level_is_asked_only_of_meshes() {
    let folder = tempfile::tempdir().unwrap();
    let (path, file) = super::create(&folder, "a.h5");
    write(&file, "q", &super::volume(0).into_dyn());
    drop(file);
    says(&complaint(&SourceSpec { level: Some(0), ..spec(path) }, None), &["--level", "no levels of refinement"]);
}
