//! `gloaming histogram`: counts, pictures, and what it refuses.

use std::path::Path;
use std::process::{Command, Output};

/// Two steps of a ramp of 0 to 1 along x, 16 × 8 × 8, as a headerless file.
fn ramp(folder: &Path) {
    let values: Vec<u8> = (0..2 * 16 * 64).flat_map(|i| ((i % 16) as f32 / 15.0).to_le_bytes()).collect();
    std::fs::write(folder.join("ramp.raw"), values).unwrap();
}

fn histogram(folder: &Path, args: &[&str]) -> Output {
    let layout = ["ramp.raw", "--raw", "dims=16x8x8,dtype=f32le,steps=2"];
    Command::new(env!("CARGO_BIN_EXE_gloaming"))
        .arg("histogram")
        .args(layout)
        .args(args)
        .current_dir(folder)
        .output()
        .unwrap()
}

#[test]
fn counts_and_pictures_are_written() {
    let folder = tempfile::tempdir().unwrap();
    ramp(folder.path());
    let region = "transfer.regions=[{shape = \"triangle\", value = [0.2, 0.8], opacity = 0.7, color = [1, 0, 0]}]";
    let set = ["--set", region, "--set", "transfer.steepest=0.1"];
    let out = histogram(folder.path(), &[&["--out", "h.png", "--out", "-", "--bins", "16,8"][..], &set].concat());
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let counts: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    let numbers =
        |key: &str| -> Vec<u64> { counts[key].as_array().unwrap().iter().map(|v| v.as_u64().unwrap()).collect() };
    assert_eq!((counts["steps"].as_u64(), counts["holes"].as_u64()), (Some(2), Some(0)));
    assert_eq!(numbers("values"), vec![128; 16]);
    // A fifteenth of the range per voxel is 0.67 of the axis; half of it at the two ends.
    let joint = numbers("joint");
    let row = |r: usize| joint[16 * r..][..16].iter().sum::<u64>();
    assert_eq!((row(5), row(2), joint.iter().sum::<u64>()), (14 * 128, 2 * 128, 2048));
    let picture = image::open(folder.path().join("h.png")).unwrap().into_rgb8();
    // Inside of the triangle the paper is tinted; beside it, it is not.
    let at = |value: f32, gradient: f32| {
        picture.get_pixel((110.0 + 960.0 * value) as u32, (826.0 - 430.0 * gradient) as u32).0
    };
    let (inside, beside) = (at(0.5, 0.9), at(0.05, 0.9));
    assert!(inside[0] > inside[1] + 40, "{inside:?}");
    assert!(beside[0].abs_diff(beside[1]) < 4, "{beside:?}");
}

#[test]
fn what_it_cannot_do_it_says() {
    let folder = tempfile::tempdir().unwrap();
    ramp(folder.path());
    for (args, words) in [
        (&["--out", "h.jpg"][..], ".png and .json"),
        (&["--out", "h.png", "--bins", "16"], "two integers"),
        (&["--out", "h.png", "--steps", "7..9"], "no step"),
    ] {
        let out = histogram(folder.path(), args);
        let said = String::from_utf8_lossy(&out.stderr);
        assert!(!out.status.success() && said.contains(words), "{args:?}: {said}");
    }
}
