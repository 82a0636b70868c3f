//! Layouts with a convention, where the real files in tests/data leave something out.

use gloaming::source::{SourceSpec, open};
use hdf5::types::VarLenArray;
use hdf5::{File, Location, ObjectReference1};
use ndarray::{Array, ArrayD, IxDyn};

use super::{all, array, attribute, complaint, create, own, says, spec, text_attribute, value, volume, write};

fn texts_attribute(at: &Location, name: &str, texts: &[&str]) {
    let texts: Vec<hdf5::types::FixedAscii<8>> =
        texts.iter().map(|t| hdf5::types::FixedAscii::from_ascii(t.as_bytes()).unwrap()).collect();
    at.new_attr::<hdf5::types::FixedAscii<8>>().shape([texts.len()]).create(name).unwrap().write(&texts).unwrap();
}

fn vtkhdf(file: &File, kind: &str) -> hdf5::Group {
    let root = file.create_group("VTKHDF").unwrap();
    text_attribute(&root, "Type", kind);
    attribute(&root, "Origin", &[1.0, 2.0, 3.0]);
    attribute(&root, "Spacing", &[0.5, 1.0, 2.0]);
    attribute(&root, "WholeExtent", &[2.0, 7.0, 0.0, 4.0, 0.0, 3.0]);
    root
}

#[test]
fn vtkhdf_cells_sit_between_points() {
    let folder = tempfile::tempdir().unwrap();
    let (path, file) = create(&folder, "a.vtkhdf");
    let root = vtkhdf(&file, "ImageData");
    let (points, cells) = (root.create_group("PointData").unwrap(), root.create_group("CellData").unwrap());
    write(&cells, "q", &volume(0).into_dyn());
    write(&points, "v", &ArrayD::<f32>::zeros(IxDyn(&[4, 5, 6, 3])));
    drop((points, cells, root, file));
    let asked = |field: &str| SourceSpec { field: Some(field.into()), ..spec(&path) };
    let series = open(&asked("q")).unwrap();
    let grid = &series.info().grid;
    assert_eq!((grid.origin, grid.spacing, grid.centering.as_str()), ([2.25, 2.5, 4.0], [0.5, 1.0, 2.0], "cell"));
    assert_eq!(all(series.as_ref(), 0), volume(0).as_slice().unwrap());
    let series = open(&asked("v")).unwrap();
    let grid = &series.info().grid;
    assert_eq!((grid.size, grid.origin, grid.centering.as_str()), ([6, 5, 4], [2.0, 2.0, 3.0], "node"));
    says(&complaint(&spec(&path), None), &["v (4×5×6×3", "q (3×4×5"]);
}

#[test]
fn vtkhdf_steps_follow_their_offsets() {
    let folder = tempfile::tempdir().unwrap();
    let (path, file) = create(&folder, "a.vtkhdf");
    let root = vtkhdf(&file, "ImageData");
    write(&root.create_group("PointData").unwrap(), "q", &array("tzyx", 3, 1));
    let steps = root.create_group("Steps").unwrap();
    attribute(&steps, "NSteps", &[3.0]);
    write(&steps, "Values", &Array::from_vec(vec![0.5, 1.5, 2.5]).into_dyn());
    let offsets = steps.create_group("PointDataOffsets").unwrap();
    // A step that did not change points back at the one before.
    write(&offsets, "q", &Array::from_vec(vec![0, 0, 2]).into_dyn());
    drop((offsets, steps, root, file));
    let series = open(&spec(path)).unwrap();
    assert_eq!(series.info().steps[2].time, Some(2.5));
    let first = |n| all(series.as_ref(), n)[0];
    assert_eq!([first(0), first(1), first(2)], [0.0, 0.0, 20_000.0]);
}

#[test]
fn vtkhdf_of_another_type_says_what_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let (path, file) = create(&folder, "a.vtkhdf");
    vtkhdf(&file, "UnstructuredGrid");
    drop(file);
    says(&complaint(&spec(path), None), &["UnstructuredGrid", "Resample To Image"]);
}

/// An openPMD file of these iterations with a vector record B, axes x, y, z slowest first, and a constant E.
fn openpmd(path: &std::path::Path, iterations: &[usize], fortran: bool) {
    let file = File::create(path).unwrap();
    text_attribute(&file, "openPMD", "1.1.0");
    text_attribute(&file, "basePath", "/data/%T/");
    text_attribute(&file, "meshesPath", "fields/");
    let data = file.create_group("data").unwrap();
    for &n in iterations {
        let iteration = data.create_group(&n.to_string()).unwrap();
        attribute(&iteration, "time", &[n as f64]);
        attribute(&iteration, "timeUnitSI", &[1e-3]);
        let fields = iteration.create_group("fields").unwrap();
        for record in ["B", "E"] {
            let group = fields.create_group(record).unwrap();
            text_attribute(&group, "geometry", "cartesian");
            let (mut labels, mut spacing) = (["x", "y", "z"], [0.5, 1.0, 2.0]);
            if fortran {
                text_attribute(&group, "dataOrder", "F");
                labels.reverse();
                spacing.reverse();
            }
            texts_attribute(&group, "axisLabels", &labels);
            attribute(&group, "gridSpacing", &spacing);
            for (c, leaf) in ["x", "y", "z"].iter().enumerate() {
                if record == "B" {
                    let values = array("txyz", n + 1, 1).index_axis_move(ndarray::Axis(0), n).mapv(|v| v + c as f64);
                    write(&group, leaf, &values.as_standard_layout().to_owned());
                } else {
                    let part = group.create_group(leaf).unwrap();
                    attribute(&part, "value", &[[2.0, 3.0, 6.0][c]]);
                    attribute(&part, "shape", &[5.0, 4.0, 3.0]);
                }
            }
        }
    }
}

#[test]
fn openpmd_vectors_constants_and_orders() {
    let folder = tempfile::tempdir().unwrap();
    for fortran in [false, true] {
        let path = folder.path().join(format!("order{fortran}.h5"));
        openpmd(&path, &[100, 20], fortran);
        let asked = |field: &str| SourceSpec { field: Some(field.into()), ..spec(&path) };
        let series = open(&asked("B/y")).unwrap();
        let info = series.info();
        assert_eq!(info.steps.iter().map(|s| (s.step, s.time.unwrap())).collect::<Vec<_>>(), [(20, 0.02), (100, 0.1)]);
        assert_eq!((info.grid.size, info.grid.spacing), ([5, 4, 3], [0.5, 1.0, 2.0]), "F: {fortran}");
        assert_eq!(all(series.as_ref(), 1)[59], value(100, 0, [4, 3, 2]) + 1.0);
        let last = value(20, 0, [4, 3, 2]);
        let length = (last.powi(2) + (last + 1.0).powi(2) + (last + 2.0).powi(2)).sqrt();
        // B is the only record that is stored, so that it need not be named.
        assert_eq!(all(open(&spec(&path)).unwrap().as_ref(), 0)[59], length);
        assert_eq!(all(open(&asked("E")).unwrap().as_ref(), 0), [7.0; 60]);
        assert_eq!(all(open(&asked("E/z")).unwrap().as_ref(), 1), [6.0; 60]);
        says(&complaint(&asked("rho"), None), &["no field `rho`", "B (5×4×3 f64le, vector)"]);
    }
}

#[test]
fn openpmd_file_per_iteration() {
    let folder = tempfile::tempdir().unwrap();
    for n in [5, 40, 300] {
        openpmd(&folder.path().join(format!("simData_{n}.h5")), &[n], false);
    }
    let pattern = folder.path().join("simData_%T.h5");
    let series = open(&SourceSpec { field: Some("B".into()), component: Some("x".into()), ..spec(pattern) }).unwrap();
    assert_eq!(series.info().steps.iter().map(|s| s.step).collect::<Vec<_>>(), [5, 40, 300]);
    assert_eq!(all(series.as_ref(), 2)[0], 3_000_000.0);
}

fn scale(file: &File, name: &str, values: &[f64]) -> hdf5::Dataset {
    let dataset = write(file, name, &Array::from_vec(values.to_vec()).into_dyn());
    text_attribute(&dataset, "CLASS", "DIMENSION_SCALE");
    dataset
}

fn along(file: &File, dataset: &hdf5::Dataset, scales: &[&str]) {
    let one = |name: &&str| VarLenArray::from_slice(&[file.reference::<ObjectReference1>(name).unwrap()]);
    let lists: Vec<VarLenArray<ObjectReference1>> = scales.iter().map(one).collect();
    let builder = dataset.new_attr::<VarLenArray<ObjectReference1>>().shape([lists.len()]);
    builder.create("DIMENSION_LIST").unwrap().write(&lists).unwrap();
}

#[test]
fn netcdf_packing_fills_axes_and_uneven_levels() {
    let folder = tempfile::tempdir().unwrap();
    let (path, file) = create(&folder, "a.nc");
    text_attribute(&file, "_NCProperties", "version=2");
    text_attribute(&scale(&file, "day", &[0.0, 1.0]), "units", "days since 2000-01-01");
    text_attribute(&scale(&file, "lon", &[10.0, 10.5, 11.0, 11.5, 12.0]), "units", "degrees_east");
    text_attribute(&scale(&file, "lat", &[-1.0, 0.0, 1.0, 2.0]), "units", "degrees_north");
    text_attribute(&scale(&file, "level", &[0.0, 1.0, 4.0]), "units", "m");
    // Axes lat, day, level, lon: only the scales tell which is which.
    let stored = array("ytzx", 2, 1).mapv(|v| (v / 10.0) as i16);
    let q = write(&file, "q", &stored);
    along(&file, &q, &["lat", "day", "level", "lon"]);
    attribute(&q, "scale_factor", &[0.5]);
    attribute(&q, "add_offset", &[3.0]);
    attribute(&q, "_FillValue", &[11.0]);
    attribute(&q, "valid_range", &[1.0, 1022.0]);
    let map = write(&file, "map", &ArrayD::<f32>::zeros(IxDyn(&[2, 4, 5])));
    along(&file, &map, &["day", "lat", "lon"]);
    drop((q, map, file));
    let series = open(&spec(path)).unwrap();
    let info = series.info();
    assert_eq!(info.candidates.iter().map(|c| c.name.as_str()).collect::<Vec<_>>(), ["q"]);
    assert_eq!((info.grid.size, info.grid.spacing, info.grid.origin), ([5, 4, 3], [0.5, 1.0, 2.0], [10.0, -1.0, 0.0]));
    assert_eq!(info.steps.iter().map(|s| s.time.unwrap()).collect::<Vec<_>>(), [0.0, 1.0]);
    says(
        &info.warnings.join("\n"),
        &["z coordinates are uneven (1 to 3 apart): 3 values", "degrees_east, degrees_north, m"],
    );
    let values = own(series.as_ref(), 0);
    // Stored (y + 10 z): 11 is a fill, 0 lies below the valid range.
    let at = |x: usize, y: usize, z: usize| values[(z * 4 + y) * 5 + x];
    assert!(at(0, 1, 1).is_nan() && at(3, 0, 0).is_nan());
    assert_eq!([at(0, 2, 1), at(4, 3, 2)], [0.5 * 12.0 + 3.0, 0.5 * 23.0 + 3.0]);
    let second = own(series.as_ref(), 1);
    assert!(second[59].is_nan(), "1023 lies above the valid range");
    assert_eq!(second[(4 + 2) * 5], 0.5 * 1012.0 + 3.0);
}

#[test]
fn meep_files_run_x_slowest_and_name_their_times() {
    let folder = tempfile::tempdir().unwrap();
    for (n, time) in ["000002.50", "000010.00"].iter().enumerate() {
        let (_, file) = create(&folder, &format!("ez-{time}.h5"));
        write(
            &file,
            "ez",
            &array("txyz", n + 1, 1).index_axis_move(ndarray::Axis(0), n).as_standard_layout().to_owned(),
        );
    }
    let series = open(&spec(folder.path())).unwrap();
    let info = series.info();
    assert_eq!((info.layout.as_str(), info.grid.size), ("Meep", [5, 4, 3]));
    assert_eq!(info.steps.iter().map(|s| (s.step, s.time.unwrap())).collect::<Vec<_>>(), [(0, 2.5), (1, 10.0)]);
    assert_eq!(all(series.as_ref(), 1), volume(1).as_slice().unwrap());
}

#[test]
fn cholla_cells_and_parts() {
    let folder = tempfile::tempdir().unwrap();
    let made = |name: &str, local: [f64; 3]| {
        let (path, file) = create(&folder, name);
        for (name, values) in [("bounds", [-1.0, 0.0, 1.0]), ("domain", [5.0, 8.0, 12.0]), ("dims", [5.0, 4.0, 3.0])] {
            attribute(&file, name, &values);
        }
        attribute(&file, "dims_local", &local);
        attribute(&file, "t", &[0.75]);
        write(&file, "density", &array("xyz", 1, 1));
        path
    };
    let series = open(&spec(made("7.h5", [5.0, 4.0, 3.0]))).unwrap();
    let info = series.info();
    assert_eq!((info.layout.as_str(), info.steps[0].time), ("Cholla", Some(0.75)));
    assert_eq!((info.grid.spacing, info.grid.origin), ([1.0, 2.0, 4.0], [-0.5, 1.0, 3.0]));
    assert_eq!(all(series.as_ref(), 0), volume(0).as_slice().unwrap());
    says(&complaint(&spec(made("part.h5", [5.0, 2.0, 3.0])), None), &["one process's part", "cat_dset_3D.py"]);
}

#[test]
fn dedalus_tasks_take_times_numbers_and_grids_from_scales() {
    let folder = tempfile::tempdir().unwrap();
    let (path, file) = create(&folder, "s1.h5");
    let scales = file.create_group("scales").unwrap();
    write(&scales, "sim_time", &Array::from_vec(vec![0.0, 0.5]).into_dyn());
    write(&scales, "iteration", &Array::from_vec(vec![0, 40]).into_dyn());
    for (name, n, step) in [("x_hash_1", 5, 0.5), ("y_hash_2", 4, 1.0), ("z_hash_3", 3, 2.0)] {
        write(&scales, name, &ArrayD::from_shape_fn(IxDyn(&[n]), |i| 1.0 + step * i[0] as f64));
    }
    let tasks = file.create_group("tasks").unwrap();
    let q = write(&tasks, "q", &array("txyz", 2, 1));
    let names = ["sim_time", "x_hash_1", "y_hash_2", "z_hash_3"].map(|n| format!("/scales/{n}"));
    along(&file, &q, &names.each_ref().map(String::as_str));
    drop((q, tasks, scales, file));
    let series = open(&spec(path)).unwrap();
    let info = series.info();
    assert_eq!((info.layout.as_str(), info.field.as_str()), ("Dedalus", "tasks/q"));
    assert_eq!(info.steps.iter().map(|s| (s.step, s.time.unwrap())).collect::<Vec<_>>(), [(0, 0.0), (40, 0.5)]);
    assert_eq!((info.grid.spacing, info.grid.origin), ([0.5, 1.0, 2.0], [1.0; 3]));
    assert_eq!(all(series.as_ref(), 1), volume(1).as_slice().unwrap());
}

/// Athena++ output on a root mesh of 4×4×2 in blocks of 2×2×2, block 0 refined when `finest` is 1.
fn athena(path: &std::path::Path, finest: u32) {
    let file = File::create(path).unwrap();
    let whole = |name: &str, values: &[i32]| {
        file.new_attr::<i32>().shape([values.len()]).create(name).unwrap().write(values).unwrap();
    };
    let levels: Vec<i32> = if finest == 0 { vec![0; 4] } else { [vec![0; 3], vec![1; 8]].concat() };
    whole("NumMeshBlocks", &[levels.len() as i32]);
    whole("MaxLevel", &[finest as i32]);
    whole("RootGridSize", &[4, 4, 2]);
    whole("MeshBlockSize", &[2, 2, 2]);
    whole("NumVariables", &[2]);
    texts_attribute(&file, "DatasetNames", &["prim"]);
    texts_attribute(&file, "VariableNames", &["rho", "press"]);
    attribute(&file, "Time", &[1.25]);
    for (n, bounds) in [[0.0, 4.0, 1.0], [0.0, 8.0, 1.0], [-1.0, 1.0, 1.0]].iter().enumerate() {
        attribute(&file, &format!("RootGridX{}", n + 1), bounds);
    }
    let mut places: Vec<[i64; 3]> = vec![[1, 0, 0], [0, 1, 0], [1, 1, 0]];
    match finest {
        0 => places.insert(0, [0, 0, 0]),
        _ => places.extend((0..8).map(|n| [n & 1, n >> 1 & 1, n >> 2])),
    }
    let flat: Vec<i64> = places.iter().flatten().copied().collect();
    write(&file, "LogicalLocations", &Array::from_shape_vec((places.len(), 3), flat).unwrap().into_dyn());
    write(&file, "Levels", &Array::from_vec(levels.clone()).into_dyn());
    // A value tells the place of its cell's lower corner in cells of its own level, and its level.
    let values = ArrayD::from_shape_fn(IxDyn(&[2, levels.len(), 2, 2, 2]), |i| {
        let at = |a: usize| 2 * places[i[1]][a] as usize + i[4 - a];
        (at(0) + 10 * at(1) + 100 * at(2) + 1000 * levels[i[1]] as usize + 10_000 * i[0]) as f32
    });
    write(&file, "prim", &values);
}

#[test]
fn athena_blocks_are_put_together() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.athdf");
    athena(&path, 0);
    let asked = SourceSpec { field: Some("press".into()), ..spec(&path) };
    let series = open(&asked).unwrap();
    let info = series.info();
    assert_eq!((info.layout.as_str(), info.grid.size, info.steps[0].time), ("Athena++", [4, 4, 2], Some(1.25)));
    assert_eq!((info.grid.spacing, info.grid.origin), ([1.0, 2.0, 1.0], [0.5, 1.0, -0.5]));
    let wanted: Vec<f64> = (0..32).map(|n| (n % 4 + 10 * (n / 4 % 4) + 100 * (n / 16) + 10_000) as f64).collect();
    assert_eq!(all(series.as_ref(), 0), wanted);
    says(&complaint(&spec(&path), None), &["rho", "press", "--field"]);
}

#[test]
fn athena_refined_blocks_are_brought_to_the_finest_level() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.athdf");
    athena(&path, 1);
    let series = open(&SourceSpec { field: Some("rho".into()), ..spec(&path) }).unwrap();
    assert_eq!(series.info().grid.size, [8, 8, 4]);
    says(&series.info().warnings.join("\n"), &["2 levels", "8×8×4"]);
    let values = all(series.as_ref(), 0);
    let at = |x: usize, y: usize, z: usize| values[(z * 8 + y) * 8 + x];
    // Cells of the refined corner, then coarse ones, each eight times.
    assert_eq!([at(0, 0, 0), at(3, 2, 1)], [1000.0, 1123.0]);
    assert_eq!([at(4, 0, 0), at(5, 1, 1), at(6, 7, 3)], [2.0, 2.0, 133.0]);
    let step = series.timestep(0).unwrap();
    let region = gloaming::grid::Region { start: [3, 1, 1], size: [4, 5, 2] };
    let mut part = vec![0.0; region.len()];
    step.field.read_f64(region, &mut part).unwrap();
    let wanted = (0..40).map(|n| at(3 + n % 4, 1 + n / 4 % 5, 1 + n / 20));
    assert_eq!(part, wanted.collect::<Vec<_>>());
}

#[derive(hdf5::H5Type, Clone, Copy)]
#[repr(C)]
struct Scalar {
    name: hdf5::types::FixedAscii<80>,
    value: f64,
}

#[test]
fn flash_leaves_are_put_together_on_the_finest_level() {
    let folder = tempfile::tempdir().unwrap();
    let (path, file) = create(&folder, "run_hdf5_plt_cnt_0003");
    // A parent on the left with eight fine leaves inside, one coarse leaf on the right.
    let mut boxes = vec![[0.0, 2.0, 0.0, 2.0, 0.0, 2.0], [2.0, 4.0, 0.0, 2.0, 0.0, 2.0]];
    for n in 0..8 {
        let at = [n & 1, n >> 1 & 1, n >> 2].map(|i| i as f64);
        boxes.push([at[0], at[0] + 1.0, at[1], at[1] + 1.0, at[2], at[2] + 1.0]);
    }
    let blocks = boxes.len();
    let flat: Vec<f64> = boxes.concat();
    write(&file, "bounding box", &Array::from_shape_vec((blocks, 3, 2), flat).unwrap().into_dyn());
    let kinds: Vec<i32> = (0..blocks).map(|b| if b == 0 { 2 } else { 1 }).collect();
    write(&file, "node type", &Array::from_vec(kinds).into_dyn());
    write(&file, "unknown names", &ArrayD::<u8>::zeros(IxDyn(&[1, 1])));
    let name = hdf5::types::FixedAscii::from_ascii(format!("{:<79}", "time").as_bytes()).unwrap();
    let table = [Scalar { name, value: 0.125 }];
    file.new_dataset_builder().with_data(&table).create("real scalars").unwrap();
    let dens =
        ArrayD::from_shape_fn(IxDyn(&[blocks, 2, 2, 2]), |i| (i[0] * 1000 + i[3] + 10 * i[2] + 100 * i[1]) as f32);
    write(&file, "dens", &dens);
    drop(file);
    let series = open(&spec(path)).unwrap();
    let info = series.info();
    assert_eq!((info.layout.as_str(), info.field.as_str(), info.steps[0].time), ("FLASH", "dens", Some(0.125)));
    assert_eq!((info.grid.size, info.grid.spacing, info.grid.origin), ([8, 4, 4], [0.5; 3], [0.25; 3]));
    says(&info.warnings.join("\n"), &["finest level, 8×4×4", "2 times"]);
    let values = all(series.as_ref(), 0);
    let at = |x: usize, y: usize, z: usize| values[(z * 4 + y) * 8 + x];
    assert_eq!([at(0, 0, 0), at(3, 1, 0), at(1, 2, 3)], [2000.0, 3011.0, 8101.0]);
    assert_eq!([at(4, 0, 0), at(5, 1, 1), at(7, 3, 2)], [1000.0, 1000.0, 1111.0]);
}
