//! Files with headers of their own: VTK files written by VTK 9.7.2, NRRD, MetaImage and XDMF.

use std::io::Write;

use gloaming::source::{SourceSpec, open};
use ndarray::{Array, Axis};

use super::{all, array, complaint, create, data, says, spec, value, volume, write};

fn field(path: impl Into<std::path::PathBuf>, field: &str) -> SourceSpec {
    SourceSpec { field: Some(field.into()), ..spec(path) }
}

fn bytes(step: usize) -> Vec<u8> {
    volume(step).iter().flat_map(|v| v.to_be_bytes()).collect()
}

#[test]
fn vtk_files_in_every_coding() {
    let names =
        ["ascii.vti", "inline.vti", "inline_zlib.vti", "raw.vti", "raw_zlib.vti", "base64.vti", "base64_zlib.vti"];
    for name in names.into_iter().chain(["ascii.vtk", "binary.vtk"]) {
        let path = data(&format!("vtk/{name}"));
        let series = open(&field(&path, "q")).unwrap();
        let grid = &series.info().grid;
        assert_eq!((grid.size, grid.spacing, grid.origin), ([5, 4, 3], [0.5, 1.0, 2.0], [1.0, 2.0, 3.0]), "{name}");
        assert_eq!(series.info().steps[0].time, Some(2.5), "{name}");
        assert_eq!(all(series.as_ref(), 0), volume(0).as_slice().unwrap(), "{name}");
        let asked = SourceSpec { component: Some("z".into()), ..field(&path, "v") };
        assert_eq!(all(open(&asked).unwrap().as_ref(), 0)[59], value(0, 2, [4, 3, 2]), "{name}");
        let series = open(&field(&path, "c")).unwrap();
        let grid = &series.info().grid;
        assert_eq!((grid.size, grid.origin, grid.centering.as_str()), ([4, 3, 2], [1.25, 2.5, 4.0], "cell"), "{name}");
        assert_eq!(all(series.as_ref(), 0)[23], 123.0, "{name}");
        says(&complaint(&spec(&path), None), &["3 fields could be meant"]);
    }
}

#[test]
fn a_pvd_collection_brings_its_times() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["raw.vti", "ascii.vti"] {
        std::fs::copy(data(&format!("vtk/{name}")), folder.path().join(name)).unwrap();
    }
    let path = folder.path().join("run.pvd");
    let set = |time: f64, name: &str| format!("<DataSet timestep=\"{time}\" part=\"0\" file=\"{name}\"/>");
    let sets = set(0.5, "raw.vti") + &set(1.5, "ascii.vti");
    std::fs::write(&path, format!("<VTKFile type=\"Collection\"><Collection>{sets}</Collection></VTKFile>")).unwrap();
    let series = open(&field(path, "q")).unwrap();
    assert_eq!(series.info().steps.len(), 2);
    assert_eq!(all(series.as_ref(), 1), volume(0).as_slice().unwrap());
}

#[test]
fn damaged_vtk_files_are_told() {
    let folder = tempfile::tempdir().unwrap();
    for (name, keep) in [("raw.vti", 2600), ("base64_zlib.vti", 1700), ("binary.vtk", 400)] {
        let path = folder.path().join(name);
        let whole = std::fs::read(data(&format!("vtk/{name}"))).unwrap();
        std::fs::write(&path, &whole[..keep]).unwrap();
        says(&complaint(&field(&path, if name.ends_with("vtk") { "q" } else { "v" }), Some(0)), &[name]);
    }
    let path = folder.path().join("a.vti");
    std::fs::write(&path, "<VTKFile type=\"UnstructuredGrid\"></VTKFile>").unwrap();
    says(&complaint(&spec(&path), None), &["UnstructuredGrid", "Resample To Image"]);
}

#[test]
fn metaimage_in_one_file_or_two() {
    for name in ["plain.mha", "zlib.mha", "detached.mhd"] {
        let series = open(&spec(data(&format!("vtk/{name}")))).unwrap();
        let info = series.info();
        assert_eq!((info.layout.as_str(), info.grid.spacing), ("MetaImage", [0.5, 1.0, 2.0]), "{name}");
        assert_eq!(info.grid.origin, [1.0, 2.0, 3.0], "{name}");
        assert_eq!(all(series.as_ref(), 0), volume(0).as_slice().unwrap(), "{name}");
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mha");
    let header =
        "ObjectType = Image\nNDims = 3\nDimSize = 500 400 300\nElementType = MET_DOUBLE\nElementDataFile = LOCAL\n";
    std::fs::write(&path, header).unwrap();
    says(&complaint(&spec(&path), Some(0)), &["a.mha", "480000", "bytes"]);
    std::fs::write(&path, header.replace("500", "99999999999").replace("400", "99999999999")).unwrap();
    says(&complaint(&spec(&path), None), &["a.mha"]);
}

#[test]
fn nrrd_raw_gzip_text_detached_and_several_steps() {
    let folder = tempfile::tempdir().unwrap();
    let head = |coding: &str, more: &str| {
        format!(
            "NRRD0004\n# made by hand\ntype: double\ndimension: 3\nsizes: 5 4 3\nendian: big\nencoding: {coding}\n\
             space directions: (0.5,0,0) (0,1,0) (0,0,2)\nspace origin: (1,2,3)\n{more}\n"
        )
    };
    let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    packed.write_all(&bytes(0)).unwrap();
    let words: Vec<String> = volume(0).iter().map(f64::to_string).collect();
    let path = |name: &str| folder.path().join(name);
    std::fs::write(path("raw.nrrd"), [head("raw", "").into_bytes(), bytes(0)].concat()).unwrap();
    std::fs::write(path("gzip.nrrd"), [head("gzip", "").into_bytes(), packed.finish().unwrap()].concat()).unwrap();
    std::fs::write(path("text.nrrd"), head("ascii", "") + &words.join(" ")).unwrap();
    std::fs::write(path("values.bin"), [vec![1, 2, 3], bytes(0)].concat()).unwrap();
    std::fs::write(path("detached.nhdr"), head("raw", "data file: values.bin\nbyte skip: -1")).unwrap();
    for name in ["raw.nrrd", "gzip.nrrd", "text.nrrd", "detached.nhdr"] {
        let series = open(&spec(path(name))).unwrap();
        let grid = &series.info().grid;
        assert_eq!((grid.size, grid.spacing, grid.origin), ([5, 4, 3], [0.5, 1.0, 2.0], [1.0, 2.0, 3.0]), "{name}");
        assert_eq!(all(series.as_ref(), 0), volume(0).as_slice().unwrap(), "{name}");
    }
    let four = "NRRD0004\ntype: double\ndimension: 4\nsizes: 5 4 3 2\nkinds: domain domain domain time\nendian: big\nencoding: raw\n\n";
    std::fs::write(path("time.nrrd"), [four.into(), bytes(0), bytes(1)].concat()).unwrap();
    assert_eq!(all(open(&spec(path("time.nrrd"))).unwrap().as_ref(), 1), volume(1).as_slice().unwrap());
    std::fs::write(path("short.nrrd"), [head("raw", "").into_bytes(), vec![0; 100]].concat()).unwrap();
    says(&complaint(&spec(path("short.nrrd")), Some(0)), &["short.nrrd", "ends at byte", "bytes"]);
    std::fs::write(path("block.nrrd"), head("raw", "").replace("double", "block")).unwrap();
    says(&complaint(&spec(path("block.nrrd")), None), &["type `block`"]);
}

/// A temporal XDMF file of two grids over these DataItems.
fn xdmf(items: [&str; 2], center: &str, nodes: &str) -> String {
    let grid = |n: usize| {
        format!(
            "<Grid GridType=\"Uniform\"><Time Value=\"{}\"/><Topology TopologyType=\"3DCoRectMesh\" Dimensions=\"{nodes}\"/>\
             <Geometry GeometryType=\"ORIGIN_DXDYDZ\"><DataItem Dimensions=\"3\">3 2 1</DataItem>\
             <DataItem Dimensions=\"3\">2 1 0.5</DataItem></Geometry>\
             <Attribute Name=\"q\" Center=\"{center}\" AttributeType=\"Scalar\">{}</Attribute></Grid>",
            n as f64 / 2.0,
            items[n]
        )
    };
    format!(
        "<?xml version=\"1.0\"?><Xdmf Version=\"3.0\"><Domain><Grid GridType=\"Collection\" CollectionType=\"Temporal\">\
         {}{}</Grid></Domain></Xdmf>",
        grid(0),
        grid(1)
    )
}

#[test]
fn xdmf_over_hdf5_hyperslabs_and_raw_files() {
    let folder = tempfile::tempdir().unwrap();
    let (_, file) = create(&folder, "a.h5");
    write(&file, "all", &array("tzyx", 2, 1));
    for n in 0..2 {
        write(&file, &format!("q{n}"), &volume(n).into_dyn());
    }
    drop(file);
    let stored: Vec<u8> = array("tzyx", 2, 1).iter().flat_map(|v| v.to_be_bytes()).collect();
    std::fs::write(folder.path().join("a.raw"), stored).unwrap();
    let whole =
        |n: usize| format!("<DataItem Dimensions=\"3 4 5\" Precision=\"8\" Format=\"HDF\">a.h5:/q{n}</DataItem>");
    let part = |n: usize| {
        format!(
            "<DataItem ItemType=\"HyperSlab\" Dimensions=\"1 3 4 5\"><DataItem Dimensions=\"3 4\">{n} 0 0 0 1 1 1 1 1 3 4 5\
             </DataItem><DataItem Dimensions=\"2 3 4 5\" Precision=\"8\" Format=\"HDF\">a.h5:/all</DataItem></DataItem>"
        )
    };
    let raw = |n: usize| {
        let (seek, more) = (n * 480, "Precision=\"8\" Endian=\"Big\" Format=\"Binary\"");
        format!("<DataItem Dimensions=\"3 4 5\" Seek=\"{seek}\" {more}>a.raw</DataItem>")
    };
    let path = folder.path().join("a.xmf");
    for item in [&whole as &dyn Fn(usize) -> String, &part, &raw] {
        for (center, nodes, origin) in [("Node", "3 4 5", [1.0, 2.0, 3.0]), ("Cell", "4 5 6", [1.25, 2.5, 4.0])] {
            std::fs::write(&path, xdmf([&item(0), &item(1)], center, nodes)).unwrap();
            let series = open(&spec(&path)).unwrap();
            let info = series.info();
            assert_eq!((info.grid.size, info.grid.spacing, info.grid.origin), ([5, 4, 3], [0.5, 1.0, 2.0], origin));
            assert_eq!(info.steps[1].time, Some(0.5));
            assert_eq!(all(series.as_ref(), 1), volume(1).as_slice().unwrap(), "{}", item(1));
        }
    }
    std::fs::write(&path, xdmf([&whole(0), &whole(9)], "Node", "3 4 5")).unwrap();
    says(&complaint(&spec(&path), Some(1)), &["step 1", "a.h5:/q9", "no such dataset"]);
    std::fs::write(&path, xdmf([&whole(0), &whole(1)], "Node", "3 4 6")).unwrap();
    says(&complaint(&spec(&path), None), &["`q` is 3×4×5 where the grid has 3×4×6"]);
    std::fs::write(&path, xdmf([&whole(0), &whole(1)], "Node", "3 4 5").replace("3DCoRectMesh", "3DSMesh")).unwrap();
    says(&complaint(&spec(&path), None), &["3DSMesh"]);
}

#[test]
fn a_file_of_a_series_that_is_damaged_costs_its_step() {
    let folder = tempfile::tempdir().unwrap();
    for n in 0..3 {
        std::fs::copy(data("vtk/raw.vti"), folder.path().join(format!("a_{n}.vti"))).unwrap();
    }
    std::fs::write(folder.path().join("a_1.vti"), "<VTKFile type=\"ImageData\">").unwrap();
    let asked = field(folder.path(), "q");
    says(&complaint(&asked, Some(1)), &["step 1", "a_1.vti"]);
    let series = open(&asked).unwrap();
    assert_eq!(all(series.as_ref(), 2), volume(0).as_slice().unwrap());
    says(&series.info().warnings.join("\n"), &["a_1.vti", "will fail"]);
}

#[test]
fn what_is_read_stays_when_slabs_are_read_apart() {
    let series = open(&field(data("vtk/base64_zlib.vti"), "q")).unwrap();
    let step = series.timestep(0).unwrap();
    let region = gloaming::grid::Region { start: [1, 2, 1], size: [3, 1, 2] };
    let mut part = vec![0.0; region.len()];
    step.field.read_f64(region, &mut part).unwrap();
    let whole: Array<f64, _> = volume(0);
    let wanted = whole.slice(ndarray::s![1..3, 2..3, 1..4]).index_axis_move(Axis(1), 0);
    assert_eq!(part, wanted.iter().copied().collect::<Vec<_>>());
}
