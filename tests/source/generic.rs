//! HDF5 without a convention: axes, regions, types, and where steps, times and grids are found.

use gloaming::grid::Region;
use gloaming::source::{SourceSpec, open};
use ndarray::{Array, ArrayD, IxDyn};

use super::{all, array, attribute, create, data, spec, text_attribute, value, volume, write};

/// Every order of the letters.
fn orders(letters: &str) -> Vec<String> {
    if letters.is_empty() {
        return vec![String::new()];
    }
    let without = |c: char| letters.replace(c, "");
    letters.chars().flat_map(|c| orders(&without(c)).into_iter().map(move |rest| format!("{c}{rest}"))).collect()
}

#[test]
fn permuting_the_input_axes_leaves_the_output_alone() {
    let folder = tempfile::tempdir().unwrap();
    for (n, axes) in orders("tczyx").iter().enumerate() {
        let (path, file) = create(&folder, &format!("{n}.h5"));
        let dataset = write(&file, "q", &array(axes, 2, 3));
        if n % 2 == 0 {
            text_attribute(&dataset, "axes", axes);
        }
        drop((dataset, file));
        let asked = SourceSpec { axes: (n % 2 == 1).then(|| axes.clone()), component: Some("y".into()), ..spec(path) };
        let series = open(&asked).unwrap();
        assert_eq!(series.info().steps.len(), 2, "{axes}");
        let wanted = volume(1).mapv(|v| v + 1000.0);
        assert_eq!(all(series.as_ref(), 1), wanted.as_slice().unwrap(), "{axes}");
    }
}

#[test]
fn regions_are_slices_of_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    for axes in ["tzyx", "xyzt", "yxtz"] {
        let (path, file) = create(&folder, &format!("{axes}.h5"));
        let values = array(axes, 3, 1).mapv(|v| v as i32);
        let builder = file.new_dataset_builder().chunk((2, 2, 2, 2)).shuffle().deflate(3);
        builder.with_data(values.view()).create("q").unwrap();
        drop(file);
        let series = open(&SourceSpec { axes: Some(axes.into()), ..spec(path) }).unwrap();
        let step = series.timestep(2).unwrap();
        let whole = volume(2);
        for (start, size) in
            [([0, 0, 0], [5, 4, 3]), ([1, 2, 0], [3, 2, 3]), ([4, 0, 2], [1, 4, 1]), ([2, 3, 1], [1; 3])]
        {
            let region = Region { start, size };
            let (mut wide, mut narrow) = (vec![0.0; region.len()], vec![0.0f32; region.len()]);
            step.field.read_f64(region, &mut wide).unwrap();
            step.field.read(region, &mut narrow).unwrap();
            let [x, y, z] = start;
            let [nx, ny, nz] = size;
            let wanted = whole.slice(ndarray::s![z..z + nz, y..y + ny, x..x + nx]);
            assert_eq!(wide, wanted.iter().copied().collect::<Vec<_>>(), "{axes} {region:?}");
            assert_eq!(narrow, wanted.iter().map(|v| *v as f32).collect::<Vec<_>>(), "{axes} {region:?}");
        }
    }
}

#[test]
fn every_type_and_byte_order_keeps_its_values() {
    let signed: Vec<f64> = (0..60).map(|i| f64::from(i) - 7.0).collect();
    let unsigned: Vec<f64> = (0..60).map(f64::from).collect();
    for name in ["f4be", "f8be", "i2be", "i8be", "f2", "f2be", "u1", "u4be", "scaleoffset", "nbit_shuffle_gzip"] {
        let series = open(&spec(data(&format!("odd_types.h5:/{name}")))).unwrap();
        assert_eq!(series.info().grid.size, [5, 4, 3]);
        let wanted = if name.starts_with('u') { &unsigned } else { &signed };
        assert_eq!(&all(series.as_ref(), 0), wanted, "{name}");
    }
    let types = open(&spec(data("odd_types.h5:/f2"))).unwrap().info().candidates.clone();
    let of = |name: &str| types.iter().find(|c| c.name == name).unwrap().dtype.clone();
    assert_eq!(["f4be", "i8be", "f2", "u1"].map(of), ["f32be", "i64be", "f16le", "u8"]);
}

#[test]
fn files_sort_by_number_and_bring_their_times() {
    let folder = tempfile::tempdir().unwrap();
    for (n, step) in [9, 10, 100].into_iter().enumerate() {
        let (_, file) = create(&folder, &format!("plt_{step}.h5"));
        let dataset = write(&file.create_group("run").unwrap(), "q", &volume(n).into_dyn());
        attribute(&dataset, "spacing", &[0.5, 1.0, 2.0]);
        attribute(&file.group("run").unwrap(), "origin", &[-1.0, 0.0, 1.0]);
        attribute(&file, "time", &[f64::from(step) / 4.0]);
    }
    for typed in ["", "plt_{step}.h5", "plt_%d.h5:/run/q", "plt_*.h5:/run/q"] {
        let series = open(&spec(format!("{}/{typed}", folder.path().display()))).unwrap();
        let info = series.info();
        let steps: Vec<_> = info.steps.iter().map(|s| (s.step, s.time.unwrap())).collect();
        assert_eq!(steps, [(9, 2.25), (10, 2.5), (100, 25.0)], "{typed}");
        assert_eq!((info.grid.spacing, info.grid.origin), ([0.5, 1.0, 2.0], [-1.0, 0.0, 1.0]));
        assert_eq!((info.field.as_str(), info.layout.as_str()), ("run/q", "hdf5 file per step"));
        assert_eq!(all(series.as_ref(), 2), volume(2).as_slice().unwrap());
    }
    let set = SourceSpec { time_step: Some(0.5), spacing: Some([3.0; 3]), ..spec(folder.path()) };
    let series = open(&set).unwrap();
    assert_eq!(series.info().steps[2].time, Some(50.0));
    assert_eq!(series.timestep(1).unwrap().grid.spacing, [3.0; 3]);
}

#[test]
fn numbered_groups_and_datasets_are_steps() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["step_", "Timestep", "iter-", "Step", "t", ""] {
        let (path, file) = create(&folder, &format!("groups{name}.h5"));
        for (n, step) in [2, 10, 1].into_iter().enumerate() {
            let group = file.create_group(&format!("{name}{step}")).unwrap();
            write(&group, "q", &volume(n).into_dyn());
            attribute(&group, "time", &[f64::from(step) * 0.5]);
        }
        drop(file);
        let series = open(&spec(path)).unwrap();
        let steps: Vec<_> = series.info().steps.iter().map(|s| (s.step, s.time.unwrap())).collect();
        assert_eq!(steps, [(1, 0.5), (2, 1.0), (10, 5.0)], "{name}");
        assert_eq!((series.info().field.as_str(), series.info().layout.as_str()), ("q", "hdf5 group per step"));
        assert_eq!(all(series.as_ref(), 1), volume(0).as_slice().unwrap(), "{name}");
    }
    let (path, file) = create(&folder, "datasets.h5");
    for step in [3, 20] {
        write(&file, &format!("q_{step:04}"), &volume(step).into_dyn());
    }
    drop(file);
    let series = open(&SourceSpec { field: Some("q".into()), ..spec(path) }).unwrap();
    assert_eq!(series.info().steps.iter().map(|s| s.step).collect::<Vec<_>>(), [3, 20]);
    assert_eq!(all(series.as_ref(), 1), volume(20).as_slice().unwrap());
}

#[test]
fn time_is_the_unlimited_axis_or_the_one_as_long_as_the_times() {
    let folder = tempfile::tempdir().unwrap();
    let (path, file) = create(&folder, "unlimited.h5");
    let values = array("xyzt", 2, 1);
    let grows = file.new_dataset::<f64>().chunk((5, 4, 3, 1)).shape((5, 4, 3, 2..));
    grows.create("q").unwrap().write(values.view()).unwrap();
    drop(file);
    let series = open(&spec(path)).unwrap();
    assert_eq!(all(series.as_ref(), 1), volume(1).as_slice().unwrap());
    assert!(series.info().warnings.iter().any(|w| w.contains("--axes xyzt")), "{:?}", series.info().warnings);

    let (path, file) = create(&folder, "times.h5");
    write(&file, "q", &array("ztyx", 7, 1));
    write(&file, "time", &ArrayD::from_shape_fn(IxDyn(&[7]), |i| i[0] as f64 * 0.25));
    drop(file);
    let series = open(&spec(path)).unwrap();
    assert_eq!(series.info().steps[6].time, Some(1.5));
    assert_eq!(all(series.as_ref(), 6), volume(6).as_slice().unwrap());
}

#[test]
fn vectors_are_read_by_component_or_length() {
    let folder = tempfile::tempdir().unwrap();
    for axes in ["zyxc", "czyx"] {
        for n in 0..2 {
            let (_, file) = create(&folder, &format!("{axes}_{n}.h5"));
            write(&file, "v", &array(axes, 1, 3));
        }
        let pattern = folder.path().join(format!("{axes}_{{step}}.h5"));
        let of = |component: Option<&str>| {
            let asked = SourceSpec { component: component.map(String::from), ..spec(&pattern) };
            all(open(&asked).unwrap().as_ref(), 1)
        };
        let at = [4, 3, 2];
        let parts = [0, 1, 2].map(|c| value(0, c, at));
        let length = parts.iter().map(|v| v * v).sum::<f64>().sqrt();
        assert_eq!(["x", "1", "z"].map(|c| of(Some(c))[59]), parts, "{axes}");
        assert_eq!([of(None)[59], of(Some("magnitude"))[59]], [length; 2], "{axes}");
    }
}

#[test]
fn packed_values_are_unpacked_and_fills_are_nan() {
    let folder = tempfile::tempdir().unwrap();
    let (path, file) = create(&folder, "packed.h5");
    let stored = Array::from_shape_fn((3, 4, 5), |(z, y, x)| (x + 10 * y + 100 * z) as i16).into_dyn();
    let dataset = write(&file, "q", &stored);
    attribute(&dataset, "scale_factor", &[0.5]);
    attribute(&dataset, "add_offset", &[-20.0]);
    attribute(&dataset, "_FillValue", &[111.0]);
    attribute(&dataset, "valid_range", &[0.0, 240.0]);
    drop((dataset, file));
    let series = open(&spec(path)).unwrap();
    let values = all(series.as_ref(), 0);
    assert!(values[20 + 5 + 1].is_nan());
    assert_eq!(values[59], 0.5 * 234.0 - 20.0);
    let found = gloaming::source::statistics(&series.timestep(0).unwrap()).unwrap();
    assert_eq!((found.valid, found.max), (59, 97.0));
    // The valid range is in stored numbers; the range is in values.
    assert_eq!(series.info().range, Some(([-20.0, 100.0], "attribute valid_range".into())));
}

#[test]
fn grids_come_from_coordinates_where_there_are_any() {
    let folder = tempfile::tempdir().unwrap();
    let (path, file) = create(&folder, "coordinates.h5");
    write(&file, "q", &volume(0).into_dyn());
    for (name, n, from, step) in [("x", 5, 1.0, 0.5), ("y", 4, -2.0, 1.0), ("z", 3, 0.0, 0.25)] {
        write(&file, name, &ArrayD::from_shape_fn(IxDyn(&[n]), |i| from + step * i[0] as f64));
    }
    drop(file);
    let series = open(&spec(path)).unwrap();
    assert_eq!(series.info().grid.spacing, [0.5, 1.0, 0.25]);
    assert_eq!(series.info().grid.origin, [1.0, -2.0, 0.0]);
    assert_eq!(series.info().warnings, Vec::<String>::new());
}

#[test]
fn a_series_can_be_read_from_another_thread() {
    let series = open(&spec(data("smoke.h5"))).unwrap();
    let found = std::thread::spawn(move || all(series.as_ref(), 7).len()).join().unwrap();
    assert_eq!(found, 96 * 96 * 96);
}
