//! What is told before any value is read: marks, other contents, units, and how little of a file that takes.

use gloaming::source::open;
use ndarray::{Array, ArrayD, IxDyn};

use super::{array, attribute, complaint, create, data, says, spec, text_attribute, volume, write};

/// Bytes that this thread has asked the operating system for.
#[cfg(target_os = "linux")]
fn bytes_read() -> u64 {
    let told = std::fs::read_to_string("/proc/thread-self/io").unwrap();
    told.lines().find_map(|l| l.strip_prefix("rchar: ")).unwrap().parse().unwrap()
}

/// A series of 100 steps opens without its field being read: by bytes, not by time, which says more of the machine.
#[cfg(target_os = "linux")]
#[test]
fn detection_reads_no_field() {
    let folder = tempfile::tempdir().unwrap();
    let field = ArrayD::<f32>::from_elem(IxDyn(&[48, 48, 48]), 1.5);
    let one = 4 * field.len() as u64;
    std::fs::create_dir(folder.path().join("files")).unwrap();
    for n in 0..100 {
        let (_, file) = create(&folder, &format!("files/a_{n:03}.h5"));
        write(&file, "q", &field);
        attribute(&file, "time", &[f64::from(n)]);
    }
    let (path, file) = create(&folder, "whole.h5");
    let whole = file.new_dataset::<f32>().shape((100, 48, 48, 48)).chunk((1, 48, 48, 48)).create("q").unwrap();
    for n in 0..100 {
        whole.write_slice(&field, (n, .., .., ..)).unwrap();
    }
    drop((whole, file));
    for path in [folder.path().join("files"), path] {
        let before = bytes_read();
        let series = open(&spec(&path)).unwrap();
        let read = bytes_read() - before;
        assert_eq!(series.info().steps.len(), 100);
        // Less than a tenth of a step for each of the files.
        assert!(read < 10 * one, "{} reads {read} bytes of {}", path.display(), 100 * one);
        series.timestep(50).unwrap().field.read(series.grid().region(), &mut vec![0.0; field.len()]).unwrap();
        assert!(bytes_read() - before > one, "the count counts nothing");
    }
}

#[test]
fn marks_and_other_contents_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let (path, file) = create(&folder, "a.h5");
    let q = write(&file, "q", &array("tzyx", 7, 1));
    text_attribute(&q, "units", "kg/m^3");
    let times = write(&file, "time", &Array::from_vec((0..7).map(f64::from).collect::<Vec<_>>()).into_dyn());
    text_attribute(&times, "units", "ms");
    drop((q, times, file));
    let info = open(&spec(path)).unwrap().info().clone();
    says(&info.why.join("\n"), &["HDF5", "no marks of another layout", "axes tzyx of 7×3×4×5", "a list of times"]);
    says(&info.others.join("\n"), &["/time 7 f64le"]);
    assert_eq!((info.units.as_str(), info.time_units.as_str()), ("kg/m^3", "ms"));
    for (name, mark) in [
        ("smoke.vtkhdf", "group /VTKHDF"),
        ("openpmd_gray_scott.h5", "openPMD"),
        ("oceananigans_thermal_bubble.nc:/T", "_NCProperties"),
        ("vtk/raw.vti:q", "<VTKFile"),
        ("vtk/plain.mha", "ElementType"),
    ] {
        let (file, field) = name.split_once(':').map_or((name, None), |(file, field)| (file, Some(field.into())));
        let asked = gloaming::source::SourceSpec { field, ..spec(data(file)) };
        says(&open(&asked).unwrap().info().why.join("\n"), &[mark]);
    }
}

#[test]
fn adios2_steps_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let (path, file) = create(&folder, "gs.h5");
    file.new_attr::<u32>().create("NumSteps").unwrap().write_scalar(&11).unwrap();
    for n in 0..11 {
        let group = file.create_group(&format!("Step{n}")).unwrap();
        write(&group, "U", &volume(n).into_dyn());
        write(&group, "step", &Array::from_elem(IxDyn(&[1]), n as i32));
    }
    drop(file);
    let series = open(&spec(&path)).unwrap();
    let info = series.info();
    assert_eq!((info.layout.as_str(), info.field.as_str(), info.steps.len()), ("ADIOS2 in HDF5", "U", 11));
    // Step10 comes after Step9, not after Step1.
    assert_eq!(super::all(series.as_ref(), 10), volume(10).as_slice().unwrap());
    assert!(info.warnings.is_empty(), "{:?}", info.warnings);
    drop(series);
    let file = hdf5::File::open_rw(&path).unwrap();
    file.unlink("Step10").unwrap();
    drop(file);
    says(&open(&spec(path)).unwrap().info().warnings.join("\n"), &["NumSteps says 11 steps, but there are 10"]);
}

#[test]
fn series_of_maps_are_not_taken_for_volumes() {
    let folder = tempfile::tempdir().unwrap();
    let (path, file) = create(&folder, "maps.h5");
    write(&file, "map", &ArrayD::<f32>::zeros(IxDyn(&[12, 20, 30])));
    write(&file, "time", &Array::from_vec((0..12).map(f64::from).collect::<Vec<_>>()).into_dyn());
    drop(file);
    says(&complaint(&spec(&path), None), &["maps.h5:/map", "series of maps", "axis 1", "--axes zyx"]);
    let asked = gloaming::source::SourceSpec { axes: Some("zyx".into()), ..spec(path) };
    assert_eq!(open(&asked).unwrap().info().grid.size, [30, 20, 12]);
}

#[test]
fn grids_one_cell_thick_constant_fields_and_bad_blocks_are_read() {
    let folder = tempfile::tempdir().unwrap();
    for shape in [[1, 4, 5], [3, 1, 5], [3, 4, 1], [1, 1, 1]] {
        let (path, file) = create(&folder, "thin.h5");
        write(&file, "q", &ArrayD::from_elem(IxDyn(&shape), 2.5f32));
        drop(file);
        let series = open(&spec(path)).unwrap();
        assert_eq!(series.info().grid.size, [shape[2], shape[1], shape[0]]);
        let found = gloaming::source::statistics(&series.timestep(0).unwrap()).unwrap();
        assert_eq!((found.min, found.max, found.mean, found.std), (2.5, 2.5, 2.5, 0.0));
    }
    let (path, file) = create(&folder, "bad.h5");
    let mut values = volume(0);
    values.slice_mut(ndarray::s![0..2, 0..2, ..]).fill(f64::NAN);
    (values[[2, 3, 4]], values[[2, 3, 3]]) = (f64::INFINITY, f64::NEG_INFINITY);
    write(&file, "q", &values.into_dyn());
    drop(file);
    let found = gloaming::source::statistics(&open(&spec(path)).unwrap().timestep(0).unwrap()).unwrap();
    assert_eq!((found.total, found.valid, found.max), (60, 60 - 20 - 2, 232.0));
}

#[test]
fn a_type_that_changes_part_way_keeps_its_values() {
    let folder = tempfile::tempdir().unwrap();
    let (_, file) = create(&folder, "a_1.h5");
    write(&file, "q", &volume(1).into_dyn());
    let (_, file2) = create(&folder, "a_2.h5");
    write(&file2, "q", &volume(2).mapv(|v| v as i32).into_dyn());
    drop((file, file2));
    let series = open(&spec(folder.path())).unwrap();
    for n in 0..2 {
        assert_eq!(super::all(series.as_ref(), n), volume(n + 1).as_slice().unwrap());
    }
}

#[test]
fn missing_times_are_told_by_step() {
    let folder = tempfile::tempdir().unwrap();
    for (step, time) in [(1, Some(0.0)), (2, None), (3, Some(2.0)), (4, None)] {
        let (_, file) = create(&folder, &format!("a_{step}.h5"));
        write(&file, "q", &volume(0).into_dyn());
        if let Some(time) = time {
            attribute(&file, "time", &[time]);
        }
    }
    let series = open(&spec(folder.path())).unwrap();
    says(&series.info().warnings.join("\n"), &["time is missing at step 2, 4", "--time-step"]);
    assert_eq!(series.info().steps.iter().map(|s| s.step).collect::<Vec<_>>(), [1, 2, 3, 4]);
}
