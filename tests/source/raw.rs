//! Headerless files: every type, order and placement, and lengths that do not add up.

use gloaming::source::{SourceSpec, open};

use super::{all, array, complaint, says, spec, value, volume};

fn raw(path: &std::path::Path, raw: &str) -> SourceSpec {
    SourceSpec { raw: Some(raw.into()), ..spec(path) }
}

/// The bytes of an array, encoded one number at a time.
fn bytes<const N: usize>(axes: &str, steps: usize, components: usize, encode: impl Fn(f64) -> [u8; N]) -> Vec<u8> {
    array(axes, steps, components).iter().flat_map(|v| encode(*v)).collect()
}

#[test]
fn every_type_and_byte_order_is_decoded() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.raw");
    let cases: [(&str, Vec<u8>); 8] = [
        ("f64be", bytes("zyx", 1, 1, |v| v.to_be_bytes())),
        ("f32le", bytes("zyx", 1, 1, |v| (v as f32).to_le_bytes())),
        ("f16be", bytes("zyx", 1, 1, |v| half::f16::from_f64(v).to_be_bytes())),
        ("i64le", bytes("zyx", 1, 1, |v| (v as i64).to_le_bytes())),
        ("u32be", bytes("zyx", 1, 1, |v| (v as u32).to_be_bytes())),
        ("i16le", bytes("zyx", 1, 1, |v| (v as i16).to_le_bytes())),
        ("uint16", bytes("zyx", 1, 1, |v| (v as u16).to_le_bytes())),
        ("u8", bytes("zyx", 1, 1, |v| [v as u8])),
    ];
    for (dtype, bytes) in cases {
        std::fs::write(&path, bytes).unwrap();
        let series = open(&raw(&path, &format!("dims=5x4x3,dtype={dtype}"))).unwrap();
        assert_eq!(all(series.as_ref(), 0), volume(0).as_slice().unwrap(), "{dtype}");
    }
}

#[test]
fn orders_steps_gaps_and_components_are_placed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.raw");
    for order in ["zyx", "xyz", "yxz", "tzyx", "xyzt", "zyxc", "ctyzx"] {
        let (steps, components) = (if order.contains('t') { 3 } else { 1 }, if order.contains('c') { 2 } else { 1 });
        let mut all_bytes = vec![7; 11];
        all_bytes.extend(bytes(order, steps, components, |v| v.to_le_bytes()));
        // Time as the second axis of five is beyond what one file's steps can be cut into.
        std::fs::write(&path, &all_bytes).unwrap();
        let text = format!("dims=5x4x3,dtype=f64le,offset=11,order={order},steps={steps},components={components}");
        let last = components - 1;
        let series = open(&SourceSpec { component: Some(last.to_string()), ..raw(&path, &text) }).unwrap();
        let found = all(series.as_ref(), steps - 1);
        assert_eq!(found[59], value(steps - 1, last, [4, 3, 2]), "{order}");
        assert_eq!(found[5], value(steps - 1, last, [0, 1, 0]), "{order}");
    }
    let step = |n| bytes("zyx", 1, 1, |v| (v + f64::from(n)).to_le_bytes());
    std::fs::write(&path, [step(1), vec![0; 8], step(2), vec![0; 8], step(3)].concat()).unwrap();
    let series = open(&raw(&path, "dims=5x4x3,dtype=f64le,gap=8")).unwrap();
    assert_eq!(series.info().steps.len(), 3);
    assert_eq!(all(series.as_ref(), 2)[0], 3.0);
}

#[test]
fn one_file_a_step_takes_its_number_from_the_name() {
    let folder = tempfile::tempdir().unwrap();
    for step in [5, 50, 500] {
        let bytes = bytes("zyx", 1, 1, |v| (v + f64::from(step)).to_le_bytes());
        std::fs::write(folder.path().join(format!("a{step}.raw")), bytes).unwrap();
    }
    let series = open(&raw(&folder.path().join("a%d.raw"), "dims=5x4x3,dtype=f64")).unwrap();
    assert_eq!(series.info().steps.iter().map(|s| s.step).collect::<Vec<_>>(), [5, 50, 500]);
    assert_eq!(all(series.as_ref(), 1)[0], 50.0);
}

#[test]
fn lengths_that_do_not_add_up_say_both_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.raw");
    std::fs::write(&path, vec![0; 1000]).unwrap();
    says(&complaint(&raw(&path, "dims=50x4x3,dtype=f64le,steps=3"), None), &["14400 bytes", "1000", "steps=0"]);
    says(&complaint(&raw(&path, "dims=5x4x3,dtype=f64le"), None), &["40 of 1000 bytes over", "offset="]);
    says(&complaint(&raw(&path, "dims=5000x4000x3000,dtype=f64le"), None), &["480000000000 bytes", "1000"]);
    let huge = format!("dims={0}x{0}x{0},dtype=f64le", u32::MAX);
    says(&complaint(&raw(&path, &huge), None), &["more bytes than can be counted", "1000"]);
    let odd = open(&raw(&path, "dims=5x4x3,dtype=f64le,steps=2")).unwrap();
    assert!(odd.info().warnings.iter().any(|w| w.contains("40 of 1000 bytes are not read")));
}

#[test]
fn misspelt_settings_name_the_nearest() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.raw");
    std::fs::write(&path, vec![0; 480]).unwrap();
    for (text, things) in [
        ("dim=5x4x3,dtype=f64", vec!["unknown key `dim`", "`dims`"]),
        ("dims=5x4,dtype=f64", vec!["three lengths"]),
        ("dims=5x4x3", vec!["dtype is missing", "dtype=f32le"]),
        ("dims=5x4x3,dtype=f12", vec!["dtype=f12"]),
        ("dims=5x4x3,dtype=f64,order=zzx", vec!["order=zzx", "twice"]),
        ("dims=5x0x3,dtype=f64", vec!["zero"]),
        ("5x4x3", vec!["lacks an `=`"]),
    ] {
        says(&complaint(&raw(&path, text), None), &things);
    }
    says(&complaint(&spec(&path), None), &["no known kind of file (480 bytes)", "--raw"]);
}

#[test]
fn a_file_that_shrinks_between_steps_fails_its_step() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.raw");
    std::fs::write(&path, vec![0; 960]).unwrap();
    let series = open(&raw(&path, "dims=5x4x3,dtype=f64le")).unwrap();
    std::fs::write(&path, vec![0; 900]).unwrap();
    assert!(series.timestep(0).is_ok());
    says(&series.timestep(1).err().unwrap().to_string(), &["step 1", "byte 960", "900 bytes"]);
}

#[test]
fn a_file_that_was_cut_short_costs_its_own_steps() {
    let folder = tempfile::tempdir().unwrap();
    for (step, length) in [(0, 480), (1, 471), (2, 480), (3, 0)] {
        std::fs::write(folder.path().join(format!("a{step}.raw")), vec![0; length]).unwrap();
    }
    let asked = raw(folder.path(), "dims=5x4x3,dtype=f64le");
    let series = open(&asked).unwrap();
    says(&series.info().warnings.join("\n"), &["a step will fail", "a1.raw"]);
    assert!(series.timestep(0).is_ok() && series.timestep(2).is_ok());
    says(&complaint(&asked, Some(1)), &["step 1", "a1.raw", "480 bytes", "471"]);
    says(&complaint(&asked, Some(3)), &["step 3", "a3.raw", "empty"]);
    // Of several steps in one file, those that are whole are read.
    let path = folder.path().join("three");
    std::fs::write(&path, vec![0; 1000]).unwrap();
    let asked = raw(&path, "dims=5x4x3,dtype=f64le,steps=3");
    says(&open(&asked).unwrap().info().warnings.join("\n"), &["2 of 3 steps are whole"]);
    assert!(open(&asked).unwrap().timestep(1).is_ok());
    says(&complaint(&asked, Some(2)), &["step 2", "byte 1440", "1000 bytes"]);
}
