//! Files as they come from outside: each is told apart, and says what to do.

use gloaming::source::{SourceSpec, open};
use ndarray::{ArrayD, IxDyn};

use super::{array, attribute, complaint, create, data, says, spec, volume, write};

#[test]
fn files_that_are_not_what_they_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.h5");
    for (bytes, things) in [
        (&b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n"[..], vec!["LFS", "git lfs pull"]),
        (b"", vec!["empty"]),
        (b"CDF\x02\0\0\0\0\0\0", vec!["netCDF", "nccopy -k nc4"]),
        (b"not a data file at all", vec!["not HDF5", "--raw"]),
    ] {
        std::fs::write(&path, bytes).unwrap();
        let message = complaint(&spec(&path), None);
        says(&message, &things);
        says(&message, &["a.h5"]);
    }
    says(&complaint(&spec(folder.path().join("b.h5")), None), &["no such file"]);
    says(&complaint(&spec(folder.path().join("b*.h5")), None), &["no file matches"]);
}

#[test]
fn a_truncated_file_costs_its_own_step() {
    let folder = tempfile::tempdir().unwrap();
    for n in 0..3 {
        let (_, file) = create(&folder, &format!("a{n}.h5"));
        write(&file, "q", &volume(n).into_dyn());
    }
    let whole = std::fs::read(folder.path().join("a1.h5")).unwrap();
    std::fs::write(folder.path().join("a1.h5"), &whole[..whole.len() / 2]).unwrap();
    let series = open(&spec(folder.path())).unwrap();
    says(&series.info().warnings.join("\n"), &["a1.h5", "step will fail"]);
    assert!(series.timestep(2).is_ok());
    says(&complaint(&spec(folder.path()), Some(1)), &["step 1", "a1.h5", "truncated"]);
    says(&complaint(&spec(folder.path().join("a1.h5")), None), &["a1.h5", "truncated", "complete file"]);
    // The first file is no better than the others.
    std::fs::copy(folder.path().join("a1.h5"), folder.path().join("a0.h5")).unwrap();
    says(&complaint(&spec(folder.path()), Some(0)), &["step 0", "a0.h5"]);
}

#[test]
fn a_grid_that_changes_names_both_grids_and_the_step() {
    let folder = tempfile::tempdir().unwrap();
    for (n, spacing, shape) in [(7, 1.0, [3, 4, 5]), (8, 1.0, [3, 4, 6]), (9, 2.0, [3, 4, 5])] {
        let (_, file) = create(&folder, &format!("a_{n}.h5"));
        let dataset = write(&file, "q", &ArrayD::<f32>::zeros(IxDyn(&shape)));
        attribute(&dataset, "spacing", &[spacing; 3]);
    }
    let (_, file) = create(&folder, "a_10.h5");
    write(&file, "q", &ArrayD::<f32>::zeros(IxDyn(&[4, 5])));
    drop(file);
    let (_, file) = create(&folder, "a_11.h5");
    write(&file, "other", &ArrayD::<f32>::zeros(IxDyn(&[3, 4, 5])));
    drop(file);
    let asked = spec(folder.path());
    says(&complaint(&asked, Some(1)), &["step 8", "5×4×3", "6×4×3", "--steps"]);
    says(&complaint(&asked, Some(2)), &["step 9", "spacing 1 1 1", "spacing 2 2 2"]);
    says(&complaint(&asked, Some(3)), &["step 10", "4×5", "2 axes where 3"]);
    says(&complaint(&asked, Some(4)), &["step 11", "a_11.h5:/q", "no such dataset"]);
    assert!(open(&asked).unwrap().timestep(0).is_ok());
    assert!(open(&asked).unwrap().timestep(99).is_err());
    // A spacing that is set holds for every step.
    let set = SourceSpec { spacing: Some([1.0; 3]), ..asked };
    assert!(open(&set).unwrap().timestep(2).is_ok());
}

#[test]
fn fields_that_could_be_several_or_none_are_listed() {
    let folder = tempfile::tempdir().unwrap();
    let (path, file) = create(&folder, "a.h5");
    write(&file, "density", &volume(0).into_dyn());
    write(&file.create_group("flow").unwrap(), "heat", &array("tzyx", 2, 1));
    write(&file.create_group("old").unwrap(), "heat", &array("tzyx", 3, 1));
    write(&file, "map", &ArrayD::<f32>::zeros(IxDyn(&[4, 5])));
    drop(file);
    let asked = |field: &str| SourceSpec { field: Some(field.into()), ..spec(&path) };
    says(&complaint(&spec(&path), None), &["density (3×4×5 f64le", "flow/heat (2×3×4×5", "--field"]);
    says(&complaint(&asked("densty"), None), &["no field `densty`", "--field density"]);
    says(&complaint(&asked("heat"), None), &["flow/heat", "old/heat", "any of"]);
    says(&complaint(&asked("map"), None), &["a.h5:/map", "4×5", "plane"]);
    says(&complaint(&asked("flow"), None), &["no field `flow`"]);
    assert_eq!(open(&asked("old/heat")).unwrap().info().steps.len(), 3);
    let wrong = SourceSpec { axes: Some("tzyxc".into()), ..asked("flow/heat") };
    says(&complaint(&wrong, None), &["names 5 axes", "2×3×4×5"]);
    let wrong = SourceSpec { component: Some("w".into()), axes: Some("czyx".into()), ..asked("flow/heat") };
    says(&complaint(&wrong, None), &["no component `w`", "there are 2"]);
    let (path, file) = create(&folder, "maps.h5");
    write(&file, "map", &ArrayD::<f32>::zeros(IxDyn(&[4, 5])));
    drop(file);
    says(&complaint(&spec(path), None), &["no volume", "/map 4×5 f32le"]);
}

#[test]
fn links_that_lead_nowhere_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let (path, file) = create(&folder, "a.h5");
    file.link_soft("/gone", "soft").unwrap();
    file.link_external("gone.h5", "/q", "external").unwrap();
    drop(file);
    says(&complaint(&spec(&path), None), &["no volume", "/soft (a link that leads nowhere)"]);
    let asked = SourceSpec { field: Some("external".into()), ..spec(&path) };
    says(&complaint(&asked, None), &["a.h5:external", "leads nowhere", "beside this one"]);
    // A link that leads somewhere is followed.
    let (_, file) = create(&folder, "gone.h5");
    write(&file, "q", &volume(0).into_dyn());
    drop(file);
    assert_eq!(open(&asked).unwrap().info().grid.size, [5, 4, 3]);
}

#[test]
fn no_steps_no_values_and_claims_beyond_reason() {
    let folder = tempfile::tempdir().unwrap();
    let made = |name: &str, shape: &[usize]| {
        let (path, file) = create(&folder, name);
        file.new_dataset::<f32>().chunk(vec![1; shape.len()]).shape(shape).create("q").unwrap();
        path
    };
    says(&complaint(&spec(made("none.h5", &[0, 3, 4, 5])), None), &["none.h5:q", "no steps"]);
    says(&complaint(&spec(made("flat.h5", &[3, 0, 5])), None), &["no values along y"]);
    let huge = made("huge.h5", &[1 << 20, 1 << 20, 1 << 20]);
    says(&complaint(&spec(huge), None), &["1048576×1048576×1048576", "more than any machine"]);
    says(&complaint(&spec(made("six.h5", &[1, 2, 3, 4, 5, 6])), None), &["6 axes", "1×2×3×4×5×6"]);
    std::fs::create_dir(folder.path().join("empty")).unwrap();
    says(&complaint(&spec(folder.path().join("empty")), None), &["no data files"]);
}

#[test]
fn values_that_are_text() {
    says(&complaint(&spec(data("odd_types.h5:/fixed")), None), &["not numbers"]);
}

#[test]
fn a_header_that_claims_steps_beyond_reason() {
    let folder = tempfile::tempdir().unwrap();
    let nrrd = "NRRD0004\ntype: short\ndimension: 4\nsizes: 5 4 4 300000000000\nencoding: raw\n\n";
    let meta = "NDims = 4\nDimSize = 4 2 2 211111111111111\nElementType = MET_UCHAR\nElementDataFile = LOCAL\n";
    for (name, text, steps) in [("a.nrrd", nrrd, "300000000000"), ("a.mha", meta, "211111111111111")] {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        says(&complaint(&spec(&path), None), &[name, "claims", steps, "complete file"]);
    }
    let vtk =
        "# vtk DataFile Version 5.1\n\nBINARY\nDATASET STRUCTURED_POINTS\nFIELD F 1\nq 99999 1 double\n\0\0\0\0\n";
    let path = folder.path().join("a.vtk");
    std::fs::write(&path, vtk).unwrap();
    says(&complaint(&spec(&path), None), &["99999 components"]);
}

#[test]
fn times_and_numbers_that_look_wrong_are_told() {
    let folder = tempfile::tempdir().unwrap();
    for (step, time) in [(10, 0.0), (20, 1.0), (30, 1.0), (50, 0.5), (60, f64::NAN), (70, 3.0)] {
        let (_, file) = create(&folder, &format!("a{step}.h5"));
        write(&file, "q", &volume(0).into_dyn());
        attribute(&file, "time", &[time]);
    }
    let series = open(&spec(folder.path())).unwrap();
    let told = series.info().warnings.join("\n");
    says(
        &told,
        &["numbers are missing: 40", "repeats at step 30", "goes back at step 50", "NaN or infinite at step 60"],
    );
    assert_eq!(series.info().steps[4].time, None);
}

#[test]
fn a_virtual_dataset_tells_which_part_is_missing() {
    let folder = tempfile::tempdir().unwrap();
    let (path, file) = create(&folder, "whole.h5");
    let builder = file.new_dataset::<f64>().shape((3, 4, 5));
    builder.virtual_map("part.h5", "q", (3, 4, 5), .., (3, 4, 5), ..).create("q").unwrap();
    drop(file);
    says(&open(&spec(path)).unwrap().info().warnings.join("\n"), &["part.h5", "virtual"]);
}

/// Reads whatever a file offers; only panics fail this.
fn read_all(path: &std::path::Path, raw: Option<&str>) {
    for field in [None, Some("q"), Some("v"), Some("c")] {
        let asked = SourceSpec { raw: raw.map(String::from), field: field.map(String::from), ..spec(path) };
        let Ok(series) = open(&asked) else { continue };
        for index in 0..series.info().steps.len().min(4) {
            let Ok(step) = series.timestep(index) else { continue };
            if step.grid.len() < 1 << 20 {
                let _ = step.field.read(step.grid.region(), &mut vec![0.0; step.grid.len()]);
            }
        }
    }
}

/// Headers are changed byte by byte and cut short: nothing that follows may panic or run away.
#[test]
fn damage_anywhere_ends_in_errors() {
    let folder = tempfile::tempdir().unwrap();
    let mut state = 0x9e37_79b9_7f4a_7c15u64;
    let mut random = move |below: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below
    };
    let nrrd = "NRRD0004\ntype: short\ndimension: 4\nsizes: 2 5 4 3\nencoding: raw\nspacings: nan 1 2 3\n\n";
    let xdmf = "<Xdmf><Domain><Grid><Time Value=\"1\"/><Topology TopologyType=\"3DCoRectMesh\" Dimensions=\"3 4 5\"/><Geometry \
                GeometryType=\"ORIGIN_DXDYDZ\"><DataItem>0 0 0</DataItem><DataItem>1 1 1</DataItem></Geometry><Attribute Name=\"q\">\
                <DataItem ItemType=\"HyperSlab\" Dimensions=\"1 3 4 5\"><DataItem>1 0 0 0 1 1 1 1 1 3 4 5</DataItem><DataItem \
                Dimensions=\"2 3 4 5\" Format=\"Binary\">a.xmf</DataItem></DataItem></Attribute></Grid></Domain></Xdmf>";
    let mut wholes: Vec<(&str, Vec<u8>)> =
        ["raw.vti", "base64_zlib.vti", "ascii.vti", "binary.vtk", "ascii.vtk", "zlib.mha"]
            .map(|name| (name, std::fs::read(data(&format!("vtk/{name}"))).unwrap()))
            .into();
    wholes.push(("a.nrrd", [nrrd.as_bytes(), &[1; 240]].concat()));
    wholes.push(("a.xmf", xdmf.as_bytes().to_vec()));
    for (name, whole) in wholes {
        let path = folder.path().join(name);
        for _ in 0..150 {
            let mut bytes = whole.clone();
            for _ in 0..1 + random(3) {
                let at = random(bytes.len().min(2000));
                bytes[at] = b"0123456789-.e<>\"= \n\xff"[random(20)];
            }
            if random(4) == 0 {
                bytes.truncate(random(whole.len()));
            }
            std::fs::write(&path, &bytes).unwrap();
            read_all(&path, None);
        }
    }
    // HDF5 guards its own structures; what is checked is what becomes of its errors.
    let (path, file) = create(&folder, "whole.h5");
    write(&file, "q", &array("tzyx", 3, 1));
    drop(file);
    let whole = std::fs::read(&path).unwrap();
    for n in 1..40 {
        let path = folder.path().join(format!("cut{n}.h5"));
        std::fs::write(&path, &whole[..whole.len() * n / 40]).unwrap();
        read_all(&path, None);
    }
}
