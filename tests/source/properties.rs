//! What holds for every header: values come back from where it says, and text of any kind ends in a series or an error.

use gloaming::source::{SourceSpec, open};
use proptest::prelude::*;
use proptest::sample::select;

use super::{all, spec};

/// Types of number, with how they are spelled in `--raw`, NRRD and MetaImage.
const KINDS: [(&str, &str, &str, usize); 5] = [
    ("u8", "uchar", "MET_UCHAR", 1),
    ("i16", "short", "MET_SHORT", 2),
    ("u32", "uint", "MET_UINT", 4),
    ("f32", "float", "MET_FLOAT", 4),
    ("f64", "double", "MET_DOUBLE", 8),
];

/// The bytes of a number that every type can hold.
fn number(kind: &str, value: u8, big: bool) -> Vec<u8> {
    let mut bytes = match kind {
        "u8" => vec![value],
        "i16" => i16::from(value).to_le_bytes().to_vec(),
        "u32" => u32::from(value).to_le_bytes().to_vec(),
        "f32" => f32::from(value).to_le_bytes().to_vec(),
        _ => f64::from(value).to_le_bytes().to_vec(),
    };
    if big {
        bytes.reverse();
    }
    bytes
}

/// The value at a place.
fn at([x, y, z]: [usize; 3], step: usize) -> u8 {
    (x + 7 * y + 29 * z + 101 * step) as u8
}

/// Values of a step in (z, y, x) order.
fn told(size: [usize; 3], step: usize) -> Vec<f64> {
    let places = (0..size[2]).flat_map(|z| (0..size[1]).flat_map(move |y| (0..size[0]).map(move |x| [x, y, z])));
    places.map(|place| f64::from(at(place, step))).collect()
}

/// The bytes of a step whose axes are `order`, slowest first.
fn stored(size: [usize; 3], order: [usize; 3], step: usize, kind: &str, big: bool) -> Vec<u8> {
    let mut bytes = Vec::new();
    for a in 0..size[order[0]] {
        for b in 0..size[order[1]] {
            for c in 0..size[order[2]] {
                let mut place = [0; 3];
                (place[order[0]], place[order[1]], place[order[2]]) = (a, b, c);
                bytes.extend(number(kind, at(place, step), big));
            }
        }
    }
    bytes
}

fn size() -> impl Strategy<Value = [usize; 3]> {
    [1usize..6, 1..6, 1..6]
}

/// A file of `bytes` in a folder of its own.
fn file(name: &str, bytes: &[u8]) -> (tempfile::TempDir, SourceSpec) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    (folder, spec(path))
}

/// Reads what a file offers; only panics fail this.
fn survives(name: &str, bytes: &[u8], raw: Option<&str>) {
    let (_folder, asked) = file(name, bytes);
    let Ok(series) = open(&SourceSpec { raw: raw.map(String::from), ..asked }) else { return };
    for index in 0..series.info().steps.len().min(2) {
        let Ok(step) = series.timestep(index) else { continue };
        if step.grid.len() < 1 << 16 {
            let _ = step.field.read(step.grid.region(), &mut vec![0.0; step.grid.len()]);
        }
    }
}

/// A header with a few places changed.
fn damaged(whole: &'static [u8]) -> impl Strategy<Value = Vec<u8>> {
    let change = (any::<prop::sample::Index>(), select(&b"0123456789-.e<>\"'=/{}[]: \n\xff\0"[..]));
    (prop::collection::vec(change, 0..6), any::<prop::sample::Index>(), any::<bool>()).prop_map(
        move |(changes, end, cut)| {
            let mut bytes = whole.to_vec();
            for (place, byte) in changes {
                let place = place.index(bytes.len());
                bytes[place] = byte;
            }
            if cut {
                bytes.truncate(end.index(whole.len()));
            }
            bytes
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..Default::default() })]

    #[test]
    fn raw_values_come_from_where_the_settings_say(
        size in size(), kind in select(&KINDS[..]), big: bool, steps in 1usize..4, offset in 0usize..20, gap in 0usize..9,
        (spelled, order) in select(&[("zyx", [2, 1, 0]), ("xyz", [0, 1, 2]), ("yxz", [1, 0, 2]), ("zxy", [2, 0, 1])][..]),
    ) {
        let mut bytes = vec![0xaa; offset];
        for step in 0..steps {
            bytes.extend(stored(size, order, step, kind.0, big));
            if step + 1 < steps {
                bytes.extend(vec![0xbb; gap]);
            }
        }
        let [nx, ny, nz] = size;
        let end = if big { "be" } else { "le" };
        let text = format!("dims={nx}x{ny}x{nz},dtype={}{end},offset={offset},gap={gap},order={spelled},steps={steps}", kind.0);
        let (_folder, asked) = file("a.raw", &bytes);
        let series = open(&SourceSpec { raw: Some(text), ..asked }).unwrap();
        for step in 0..steps {
            prop_assert_eq!(all(series.as_ref(), step), told(size, step));
        }
    }

    #[test]
    fn nrrd_values_come_from_where_the_header_says(
        size in size(), kind in select(&KINDS[..]), big: bool, text: bool, steps in 1usize..4, skip in 0usize..9,
    ) {
        let [nx, ny, nz] = size;
        // Four sizes of which the first is small would be components: kinds tell.
        let (dims, sizes, kinds) = (4, format!("{nx} {ny} {nz} {steps}"), "domain domain domain time");
        let (encoding, end) = (if text { "ascii" } else { "raw" }, if big { "big" } else { "little" });
        let skip = if text { 0 } else { skip };
        let header = format!(
            "NRRD0004\ntype: {}\ndimension: {dims}\nsizes: {sizes}\nkinds: {kinds}\nendian: {end}\nbyte skip: {skip}\nencoding: {encoding}\n\n",
            kind.1
        );
        let mut bytes = [header.as_bytes(), &vec![0xaa; skip]].concat();
        for step in 0..steps {
            if text {
                let words: Vec<String> = told(size, step).iter().map(f64::to_string).collect();
                bytes.extend((words.join(" ") + "\n").into_bytes());
            } else {
                bytes.extend(stored(size, [2, 1, 0], step, kind.0, big));
            }
        }
        let (_folder, asked) = file("a.nrrd", &bytes);
        let series = open(&asked).unwrap();
        for step in 0..steps {
            prop_assert_eq!(all(series.as_ref(), step), told(size, step));
        }
    }

    #[test]
    fn metaimage_values_come_from_where_the_header_says(size in size(), kind in select(&KINDS[..]), big: bool) {
        let [nx, ny, nz] = size;
        let msb = if big { "True" } else { "False" };
        let header = format!(
            "ObjectType = Image\nNDims = 3\nBinaryDataByteOrderMSB = {msb}\nDimSize = {nx} {ny} {nz}\nElementType = {}\nElementDataFile = LOCAL\n",
            kind.2
        );
        let bytes = [header.into_bytes(), stored(size, [2, 1, 0], 0, kind.0, big)].concat();
        let (_folder, asked) = file("a.mha", &bytes);
        prop_assert_eq!(all(open(&asked).unwrap().as_ref(), 0), told(size, 0));
    }

    #[test]
    fn numbers_in_names_are_the_steps_in_their_order(
        numbers in prop::collection::btree_set(0u64..100_000, 1..6), width in 0usize..7,
    ) {
        let folder = tempfile::tempdir().unwrap();
        for n in &numbers {
            std::fs::write(folder.path().join(format!("v2_{n:0width$}_x.raw")), [*n as u8; 8]).unwrap();
        }
        let asked = SourceSpec { raw: Some("dims=2x2x2,dtype=u8".into()), ..spec(folder.path().join("v2_{step}_x.raw")) };
        let series = open(&asked).unwrap();
        let found: Vec<u64> = series.info().steps.iter().map(|s| s.step).collect();
        prop_assert_eq!(&found, &numbers.iter().copied().collect::<Vec<_>>());
        for (i, n) in found.into_iter().enumerate() {
            prop_assert_eq!(all(series.as_ref(), i), vec![f64::from(n as u8); 8]);
        }
    }

    #[test]
    fn any_text_is_survived(text in "(?s).{0,200}", step: u64, bytes in prop::collection::vec(any::<u8>(), 0..300), which: u8) {
        survives("a.raw", &[1; 64], Some(&text));
        for start in ["NRRD0004\n", "NDims = 3\nElementType", "# vtk DataFile Version 5.1\n", "<VTKFile", "<Xdmf"] {
            survives("a", &[start.as_bytes(), text.as_bytes()].concat(), None);
        }
        gloaming::fuzz::pattern(&text, &text);
        gloaming::fuzz::template(&text, step);
        gloaming::fuzz::filter(which, 256, &bytes);
    }

    #[test]
    fn damaged_headers_are_survived(
        nrrd in damaged(include_bytes!("../fuzz/seeds/nrrd/ascii")),
        meta in damaged(include_bytes!("../fuzz/seeds/metaimage/four")),
        vtk in damaged(include_bytes!("../fuzz/seeds/vtk/ascii.vtk")),
        vti in damaged(include_bytes!("../fuzz/seeds/vti/ascii.vti")),
        xdmf in damaged(include_bytes!("../fuzz/seeds/xdmf/collection")),
        raw in damaged(include_bytes!("../fuzz/seeds/raw/vector")),
        pattern in damaged(include_bytes!("../fuzz/seeds/pattern/percent")),
        template in damaged(b"out/{camera}/frame_{step:06}_%04d.png"),
        filter in damaged(include_bytes!("../fuzz/seeds/filter/blosc2_blosclz_bytes_f4")),
    ) {
        for (name, bytes) in [("a.nrrd", nrrd), ("a.mha", meta), ("a.vtk", vtk), ("a.vti", vti), ("a.xmf", xdmf)] {
            survives(name, &bytes, None);
        }
        survives("a.raw", &[1; 64], Some(&String::from_utf8_lossy(&raw)));
        let pattern = String::from_utf8_lossy(&pattern);
        let (typed, path) = pattern.split_once('\n').unwrap_or((&pattern, &pattern));
        gloaming::fuzz::pattern(typed, path);
        gloaming::fuzz::template(&String::from_utf8_lossy(&template), 7);
        gloaming::fuzz::filter(6, 224, &filter[3.min(filter.len())..]);
    }
}
