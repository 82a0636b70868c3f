//! Axes that are uneven or run backwards: told as the file has them, shown on an even grid, holes and all.

use gloaming::source::{SourceSpec, open};
use ndarray::{Array, ArrayD, IxDyn};

use super::{all, attribute, complaint, create, own, says, spec, text_attribute, volume, write};

fn line(values: &[f64]) -> ArrayD<f64> {
    Array::from_vec(values.to_vec()).into_dyn()
}

/// A field linear in place, on points (z, y, x), of which some are holes.
fn linear(x: &[f64], y: &[f64], z: &[f64], hole: impl Fn(usize, usize, usize) -> bool) -> ArrayD<f64> {
    ArrayD::from_shape_fn(IxDyn(&[z.len(), y.len(), x.len()]), |i| {
        if hole(i[2], i[1], i[0]) { f64::NAN } else { 2.0 * x[i[2]] - y[i[1]] + 3.0 * z[i[0]] }
    })
}

fn chebyshev(n: usize) -> Vec<f64> {
    (0..n).map(|i| -(std::f64::consts::PI * (i as f64 + 0.5) / n as f64).cos()).collect()
}

#[test]
fn stretched_axes_show_values_where_they_belong() {
    let folder = tempfile::tempdir().unwrap();
    let (path, file) = create(&folder, "a.h5");
    let (x, y, z) = (vec![0.0, 0.5, 1.0, 1.5], vec![3.0, 2.0, 1.0], chebyshev(16));
    write(&file, "q", &linear(&x, &y, &z, |_, _, _| false));
    for (name, values) in [("x", &x), ("y", &y), ("z", &z)] {
        write(&file, name, &line(values));
    }
    drop(file);
    let series = open(&spec(&path)).unwrap();
    let info = series.info();
    assert_eq!(info.grid.size, [4, 3, 16]);
    assert!((info.grid.spacing[2] - (z[15] - z[0]) / 15.0).abs() < 1e-12);
    says(
        &info.warnings.join("\n"),
        &["y coordinates fall from 3 to 1", "z coordinates are uneven (0.0", "16 values", "32 even"],
    );
    let even = info.resampled.unwrap();
    assert_eq!((even.size, even.origin[0], even.origin[1], even.spacing[1]), ([4, 3, 32], 0.0, 1.0, 1.0));
    // The file's own values are untouched.
    assert_eq!(own(series.as_ref(), 0), linear(&x, &y, &z, |_, _, _| false).as_slice().unwrap());
    let step = series.timestep(0).unwrap();
    assert_eq!(step.grid, even);
    for (n, v) in all(series.as_ref(), 0).iter().enumerate() {
        let at = [n % 4, n / 4 % 3, n / 12];
        let place: Vec<f64> = (0..3).map(|a| even.origin[a] + even.spacing[a] * at[a] as f64).collect();
        // Beyond the outermost points the interpolant is flat.
        let half = 0.5 * even.spacing[2];
        if place[2] - half >= z[0] && place[2] + half <= z[15] {
            let wanted = 2.0 * place[0] - place[1] + 3.0 * place[2];
            assert!((v - wanted).abs() < 1e-12, "{v}, not {wanted} at {place:?}");
        }
    }
    // A spacing that is asked for is the mean of the uneven axis, whose values keep their places to one another.
    let set = open(&SourceSpec { spacing: Some([1.0; 3]), ..spec(&path) }).unwrap();
    let far = set.info().resampled.unwrap();
    assert_eq!((set.info().grid.spacing, far.size, far.spacing[0], far.spacing[1]), ([1.0; 3], even.size, 1.0, 1.0));
    let mean = (z[15] - z[0]) / 15.0;
    assert!((far.spacing[2] - even.spacing[2] / mean).abs() < 1e-12 && (far.origin[1] - 1.0).abs() < 1e-12, "{far:?}");
    assert!(all(set.as_ref(), 0).iter().zip(all(series.as_ref(), 0)).all(|(a, b)| (a - b).abs() < 1e-9));
    let moved = open(&SourceSpec { origin: Some([10.0, 0.0, 0.0]), ..spec(&path) }).unwrap();
    assert_eq!(moved.info().resampled.unwrap().origin[0], 10.0);
}

#[test]
fn masks_stay_masks_through_resampling() {
    let folder = tempfile::tempdir().unwrap();
    let (path, file) = create(&folder, "a.h5");
    let (x, y) = (vec![0.0, 1.0, 2.0], vec![0.0, 1.0]);
    let z = vec![-500.0, -200.0, -80.0, -30.0, -10.0, 0.0];
    // Land: the two deepest levels at the first x, as NaN; a fill value without an attribute elsewhere.
    let mut values = linear(&x, &y, &z, |i, _, k| i == 0 && k < 2);
    values[[2, 1, 2]] = -1e34;
    write(&file, "q", &values);
    for (name, values) in [("x", &x), ("y", &y), ("z", &z)] {
        write(&file, name, &line(values));
    }
    drop(file);
    let series = open(&spec(path)).unwrap();
    let even = series.info().resampled.unwrap();
    let shown = all(series.as_ref(), 0);
    let (mut holes, mut values) = (0, 0);
    for (n, v) in shown.iter().enumerate() {
        let at = [n % 3, n / 3 % 2, n / 6];
        let depth = even.origin[2] + even.spacing[2] * at[2] as f64;
        if at[0] == 0 {
            // The border lies half-way between the deepest value and the level below it, give or take half a cell.
            let border = 0.5 * (-200.0 - 80.0);
            if (depth - border).abs() > 0.5 * even.spacing[2] {
                assert_eq!(v.is_nan(), depth < border, "{v} at {depth}");
            }
        }
        assert!(v.is_nan() || v.abs() < 2000.0, "a fill value bleeds: {v}");
        if v.is_nan() { holes += 1 } else { values += 1 }
    }
    assert!(holes > 0 && values > holes, "{holes} holes, {values} values");
}

#[test]
fn faces_tell_where_the_outermost_cells_end() {
    let folder = tempfile::tempdir().unwrap();
    let (path, file) = create(&folder, "a.h5");
    write(&file, "q", &volume(0).into_dyn());
    for (name, values) in [
        ("x", vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0]),
        ("y", vec![0.0, 1.0, 2.0, 3.0, 4.0]),
        ("z", vec![0.0, 1.0, 3.0, 9.0]),
    ] {
        write(&file, name, &line(&values));
    }
    drop(file);
    let series = open(&spec(path)).unwrap();
    let info = series.info();
    assert_eq!((info.grid.origin, info.grid.centering.as_str()), ([0.5, 0.5, 0.5], "cell"));
    let (lo, hi) = info.resampled.unwrap().bounds();
    assert!((lo.z, hi.z) == (0.0, 9.0) && (lo.x, hi.x) == (0.0, 5.0), "{lo} {hi}");
}

#[test]
fn coordinates_of_no_use_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let made = |name: &str, z: [f64; 3]| {
        let (path, file) = create(&folder, name);
        write(&file, "q", &volume(0).into_dyn());
        for (name, values) in [("x", vec![0.0, 1.0, 2.0, 3.0, 4.0]), ("y", vec![0.0, 1.0, 2.0, 3.0]), ("z", z.to_vec())]
        {
            write(&file, name, &line(&values));
        }
        path
    };
    let series = open(&spec(made("forth.h5", [0.0, 2.0, 1.0]))).unwrap();
    says(&series.info().warnings.join("\n"), &["z coordinates go back and forth", "--spacing"]);
    assert_eq!((series.info().resampled, series.info().grid.spacing), (None, [1.0; 3]));
    let series = open(&spec(made("nan.h5", [0.0, f64::NAN, 1.0]))).unwrap();
    assert_eq!((series.info().resampled, series.info().grid.spacing), (None, [1.0; 3]));
}

#[test]
fn xdmf_rectilinear_grids_take_their_points_from_the_xml_or_from_hdf5() {
    let folder = tempfile::tempdir().unwrap();
    let (_, file) = create(&folder, "a.h5");
    write(&file, "q", &volume(0).into_dyn());
    write(&file, "zs", &line(&[0.0, 1.0, 5.0]));
    drop(file);
    let grid = |z: &str, topology: &str| {
        format!(
            "<Xdmf><Domain><Grid><Topology TopologyType=\"{topology}\" Dimensions=\"3 4 5\"/><Geometry GeometryType=\"VXVYVZ\">\
             <DataItem Dimensions=\"5\">0 1 2 3 4</DataItem><DataItem Dimensions=\"4\">1 2 3 4</DataItem>{z}</Geometry>\
             <Attribute Name=\"q\"><DataItem Dimensions=\"3 4 5\" Precision=\"8\" Format=\"HDF\">a.h5:/q</DataItem></Attribute>\
             </Grid></Domain></Xdmf>"
        )
    };
    let path = folder.path().join("a.xmf");
    for z in
        ["<DataItem>0 1 5</DataItem>", "<DataItem Dimensions=\"3\" Precision=\"8\" Format=\"HDF\">a.h5:/zs</DataItem>"]
    {
        std::fs::write(&path, grid(z, "3DRectMesh")).unwrap();
        let series = open(&spec(&path)).unwrap();
        let info = series.info();
        assert_eq!((info.grid.spacing, info.grid.origin), ([1.0, 1.0, 2.5], [0.0, 1.0, 0.0]));
        says(&info.warnings.join("\n"), &["z coordinates are uneven (1 to 4 apart)"]);
        assert_eq!(own(series.as_ref(), 0), volume(0).as_slice().unwrap());
    }
    for (z, topology, thing) in [
        ("<DataItem>0 1</DataItem>", "3DRectMesh", "do not fit"),
        ("<DataItem>0 1 x</DataItem>", "3DRectMesh", "not numbers"),
        ("<DataItem>0 1 5</DataItem>", "3DCoRectMesh", "Geometry `VXVYVZ`"),
        ("", "3DRectMesh", "VXVYVZ"),
        ("<DataItem Format=\"HDF\" Dimensions=\"3\">a.h5:/gone</DataItem>", "3DRectMesh", "no such dataset"),
    ] {
        std::fs::write(&path, grid(z, topology)).unwrap();
        says(&complaint(&spec(&path), None), &[thing]);
    }
}

#[test]
fn turbulence_cutouts_have_components_last_and_their_own_coordinates() {
    let folder = tempfile::tempdir().unwrap();
    for several in [false, true] {
        let (path, file) = create(&folder, &format!("channel{several}.h5"));
        for n in [1, 11] {
            if n == 1 || several {
                let values = super::array("zyxc", 1, 3).mapv(|v| v + f64::from(n));
                write(&file, &format!("Velocity_{n:04}"), &values);
            }
        }
        write(&file, "xcoor", &line(&[0.0, 0.5, 1.0, 1.5, 2.0]));
        write(&file, "ycoor", &line(&[-1.0, -0.9, -0.6, 0.0]));
        write(&file, "zcoor", &line(&[0.0, 2.0, 4.0]));
        text_attribute(&file, "_NCProperties", "version=2");
        drop(file);
        let asked = SourceSpec { component: Some("y".into()), ..spec(path) };
        let series = open(&asked).unwrap();
        let info = series.info();
        assert_eq!((info.layout.as_str(), info.grid.size), ("JHTDB cutout", [5, 4, 3]));
        assert_eq!(info.steps.len(), if several { 2 } else { 1 });
        says(&info.warnings.join("\n"), &["y coordinates are uneven"]);
        let last = info.steps.len() - 1;
        let wanted: Vec<f64> = volume(0).iter().map(|v| v + 1000.0 + if several { 11.0 } else { 1.0 }).collect();
        assert_eq!(own(series.as_ref(), last), wanted);
    }
}

#[test]
fn an_athena_mesh_with_a_ratio_is_resampled() {
    let folder = tempfile::tempdir().unwrap();
    let (path, file) = create(&folder, "a.athdf");
    let whole = |name: &str, values: &[i32]| {
        file.new_attr::<i32>().shape([values.len()]).create(name).unwrap().write(values).unwrap();
    };
    whole("NumMeshBlocks", &[1]);
    whole("RootGridSize", &[4, 2, 2]);
    whole("MeshBlockSize", &[4, 2, 2]);
    whole("NumVariables", &[1]);
    let names = |name: &str, text: &str| {
        let text = [hdf5::types::FixedAscii::<8>::from_ascii(text.as_bytes()).unwrap()];
        file.new_attr::<hdf5::types::FixedAscii<8>>().shape([1]).create(name).unwrap().write(&text).unwrap();
    };
    names("DatasetNames", "prim");
    names("VariableNames", "rho");
    // Cells of 1, 2, 4, 8 along x: each twice as wide as the one before.
    for (n, bounds) in [[0.0, 15.0, 2.0], [0.0, 2.0, 1.0], [0.0, 2.0, 1.0]].iter().enumerate() {
        attribute(&file, &format!("RootGridX{}", n + 1), bounds);
    }
    write(&file, "LogicalLocations", &Array::from_shape_vec((1, 3), vec![0i64; 3]).unwrap().into_dyn());
    write(&file, "Levels", &Array::from_vec(vec![0]).into_dyn());
    write(&file, "prim", &ArrayD::from_shape_fn(IxDyn(&[1, 1, 2, 2, 4]), |i| i[4] as f32));
    drop(file);
    let series = open(&spec(path)).unwrap();
    let info = series.info();
    assert_eq!((info.grid.size, info.grid.origin[0]), ([4, 2, 2], 0.5));
    says(&info.warnings.join("\n"), &["x coordinates are uneven (1.5 to 6 apart): 4 values", "8 even"]);
    let (lo, hi) = info.resampled.unwrap().bounds();
    assert!(lo.x.abs() < 1e-12 && (hi.x - 15.0).abs() < 1e-12, "{lo} {hi}");
    assert_eq!(own(series.as_ref(), 0)[..4], [0.0, 1.0, 2.0, 3.0]);
    // The first cell's value, then ever slower upwards.
    let shown = all(series.as_ref(), 0);
    assert!(shown[0] < 0.7 && shown[7] == 3.0 && shown[..8].windows(2).all(|w| w[0] <= w[1]), "{:?}", &shown[..8]);
}
