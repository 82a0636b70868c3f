//! Layouts with a convention, where the real files in tests/data leave something out.

use gloaming::source::{SourceSpec, open};
use hdf5::types::VarLenArray;
use hdf5::{File, Location, ObjectReference1};
use ndarray::{Array, ArrayD, IxDyn};

use super::{all, array, attribute, complaint, create, says, spec, text_attribute, value, volume, write};

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
    says(&info.warnings.join("\n"), &["z coordinates are uneven", "degrees_east, degrees_north, m"]);
    let values = all(series.as_ref(), 0);
    // Stored (y + 10 z): 11 is a fill, 0 lies below the valid range.
    let at = |x: usize, y: usize, z: usize| values[(z * 4 + y) * 5 + x];
    assert!(at(0, 1, 1).is_nan() && at(3, 0, 0).is_nan());
    assert_eq!([at(0, 2, 1), at(4, 3, 2)], [0.5 * 12.0 + 3.0, 0.5 * 23.0 + 3.0]);
    let second = all(series.as_ref(), 1);
    assert!(second[59].is_nan(), "1023 lies above the valid range");
    assert_eq!(second[(4 + 2) * 5], 0.5 * 1012.0 + 3.0);
}
