//! The program as people run it: exit status, what is on stdout and what on stderr, and messages that say what to type.

use std::path::Path;
use std::process::{Command, Output};

use gloaming::ledger;
use gloaming::sink::exr;
use serde_json::Value;
use tempfile::TempDir;

fn gloaming(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_gloaming"));
    command
        .args(arguments)
        .current_dir(folder)
        .env_remove("RUST_LOG")
        .env_remove("XDG_RUNTIME_DIR")
        .output()
        .expect("the program starts")
}

fn folder() -> TempDir {
    tempfile::tempdir().unwrap()
}

fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[track_caller]
fn ends(output: &Output, status: i32) {
    assert_eq!(output.status.code(), Some(status), "stdout: {}\nstderr: {}", stdout(output), stderr(output));
}

/// Writes `steps` headerless files of 12×10×8 values: a ball that drifts along x.
fn series(folder: &Path, steps: usize) {
    for step in 0..steps {
        let value = |i: usize, j: usize, k: usize| {
            let at = |i: usize, centre: f32| (i as f32 - centre).powi(2);
            (-(at(i, 4.0 + 0.5 * step as f32) + at(j, 5.0) + at(k, 4.0)) / 6.0).exp()
        };
        let bytes = (0..8).flat_map(|k| (0..10).flat_map(move |j| (0..12).map(move |i| value(i, j, k))));
        let bytes: Vec<u8> = bytes.flat_map(f32::to_le_bytes).collect();
        std::fs::write(folder.join(format!("ball_{step:03}.raw")), bytes).unwrap();
    }
}

const RAW: [&str; 2] = ["--raw", "dims=12x10x8,dtype=f32le"];

fn render<'a>(rest: &[&'a str]) -> Vec<&'a str> {
    [&["render", "ball_*.raw", RAW[0], RAW[1], "--device", "cpu", "--size", "40x30"], rest].concat()
}

/// Writes an EXR picture of one colour.
fn picture(path: &Path, rgb: [f32; 3]) {
    ::exr::prelude::write_rgb_file(path, 4, 2, |_, _| (rgb[0], rgb[1], rgb[2])).unwrap();
}

#[test]
fn every_command_has_help_with_examples() {
    let here = folder();
    let all = gloaming(here.path(), &["--help"]);
    ends(&all, 0);
    assert!(stdout(&all).contains("Exit status"), "{}", stdout(&all));
    for command in ["render", "info", "compare", "devices"] {
        assert!(stdout(&all).contains(command));
        let help = gloaming(here.path(), &[command, "--help"]);
        ends(&help, 0);
        assert!(stdout(&help).contains(&format!("Examples:\n  gloaming {command}")), "{command}: {}", stdout(&help));
    }
}

#[test]
fn wrong_usage_is_status_2_and_says_what_is_meant() {
    let here = folder();
    series(here.path(), 2);
    std::fs::write(here.path().join("wrong.toml"), "[light]\n\ntolerence = 1e-3\n").unwrap();
    for (arguments, hint) in [
        (vec![], "Usage"),
        (vec!["rendr"], "render"),
        (vec!["render", "ball_*.raw"], "--out"),
        (vec!["render", "--out", "a.png"], "<SERIES>"),
        (render(&["--out", "a.png", "--steps", "3..1"]), "3 <= step < 1"),
        (render(&["--out", "a.png", "--steps", "one"]), "A..B"),
        (vec!["render", "ball_*.raw", "--out", "a.png", "--size", "big"], "1280x720"),
        (render(&["--out", "a.png", "--memory", "much"]), "512MiB"),
        (render(&["--out", "a.png", "--model", "exact"]), "physical"),
        (render(&["--out", "a.png", "--toleranse", "1"]), "--tolerance"),
        (render(&["--out", "a.png", "--tolerance", "-1"]), "light.tolerance"),
        (render(&["--out", "a.png", "--tolerance", "nan"]), "light.tolerance"),
        (render(&["--out", "a.png", "--set", "light.modle=paper"]), "`model`"),
        (render(&["--out", "a.png", "--scene", "wrong.toml"]), "line 3: light.tolerence"),
        (render(&["--out", "a.png", "--spacing", "1,0,1"]), "above 0"),
        (vec!["info", "ball_000.raw", "--probe", "1,2"], "X,Y,Z"),
        (vec!["compare", "a.exr"], "<B.exr>"),
        (vec!["devices", "-q", "-v"], "--quiet"),
    ] {
        let output = gloaming(here.path(), &arguments);
        ends(&output, 2);
        assert!(stderr(&output).contains(hint), "{arguments:?}: {}", stderr(&output));
        assert_eq!(stdout(&output), "", "{arguments:?}");
    }
    assert!(!here.path().join("a.png").exists());
}

#[test]
fn failures_are_status_1_and_said_once() {
    let here = folder();
    series(here.path(), 2);
    for (arguments, hint) in [
        (vec!["info", "missing.h5"], "missing.h5"),
        (vec!["render", "missing.h5", "--out", "a.png"], "missing.h5"),
        (render(&["--out", "a.png", "--scene", "missing.toml"]), "missing.toml"),
        (render(&["--out", "a.png", "--steps", "7..9"]), "0 to 1"),
        (render(&["--out", "a_{step}.tiff"]), ".png"),
        (render(&["--out", "a.png"]), "{step"),
        (vec!["render", "ball_*.raw", RAW[0], RAW[1], "--out", "a_{step}.png", "--device", "no such"], "device: "),
        (render(&["--out", "a_{step}.png", "--memory", "1000"]), "--memory"),
        (
            render(&["--out", "a_{step}.png", "--set", "pathtrace.replay=true", "--set", "render.target_error=0.1"]),
            "render.samples",
        ),
        (vec!["compare", "missing.exr", "missing.exr"], "missing.exr"),
    ] {
        let arguments: Vec<_> = arguments.into_iter().collect();
        let output = gloaming(here.path(), &arguments);
        ends(&output, 1);
        let said = stderr(&output);
        assert!(said.contains(hint), "{arguments:?}: {said}");
        assert_eq!(said.matches("error:").count(), 1, "{said}");
        assert!(said.matches("No such file").count() <= 1, "{said}");
        assert!(!said.contains("panicked"), "{said}");
        assert_eq!(stdout(&output), "", "{arguments:?}");
    }
}

#[test]
fn the_memory_that_is_named_is_enough() {
    let here = folder();
    series(here.path(), 1);
    let refused = gloaming(here.path(), &render(&["--out", "a.png", "--memory", "1K"]));
    ends(&refused, 1);
    let said = stderr(&refused);
    let enough = said.split("--memory ").nth(1).and_then(|s| s.split_whitespace().next()).expect(&said);
    ends(&gloaming(here.path(), &render(&["--out", "a.png", "--memory", enough])), 0);
}

#[test]
fn devices_are_listed_for_people_and_programs() {
    let here = folder();
    let listed = gloaming(here.path(), &["devices"]);
    ends(&listed, 0);
    assert_eq!(stderr(&listed), "", "drivers are not heard either");
    assert!(stdout(&listed).contains("cpu (") && stdout(&listed).contains("threads"), "{}", stdout(&listed));
    let listed = gloaming(here.path(), &["devices", "--json"]);
    ends(&listed, 0);
    let listed: Value = serde_json::from_slice(&listed.stdout).unwrap();
    assert!(
        listed["cpu"]["threads"].as_u64().unwrap() > 0 && listed["auto"].is_string() && listed["adapters"].is_array()
    );
}

#[test]
fn compare_measures_a_known_difference() {
    let here = folder();
    picture(&here.path().join("a.exr"), [1.5, 2.0, 4.0]);
    picture(&here.path().join("b.exr"), [1.0, 2.0, 3.0]);
    let compared = gloaming(here.path(), &["compare", "a.exr", "b.exr", "--json", "--diff", "d.png"]);
    ends(&compared, 0);
    let figures: Value = serde_json::from_slice(&compared.stdout).unwrap();
    let rmse = (1.25f64 / 3.0).sqrt();
    assert!((figures["rmse"].as_f64().unwrap() - rmse).abs() < 1e-6, "{figures}");
    assert!((figures["relative_rmse"].as_f64().unwrap() - rmse / 2.0).abs() < 1e-6, "{figures}");
    assert_eq!(figures["max"].as_f64(), Some(1.0));
    // 0.25/(1 + 0.04) and 1/(9 + 0.04) of three values each.
    let relative = (0.25 / 1.04 + 1.0 / 9.04) / 3.0;
    assert!((figures["relative_mse"].as_f64().unwrap() - relative).abs() < 1e-6, "{figures}");
    assert!(figures["ssim"].is_null() && figures.get("z_test").is_none(), "a picture smaller than a window: {figures}");
    assert!((figures["psnr"].as_f64().unwrap() - 20.0 * (3.0 / rmse).log10()).abs() < 1e-4, "{figures}");
    assert_eq!(image::image_dimensions(here.path().join("d.png")).unwrap(), (4, 2));

    let same = gloaming(here.path(), &["compare", "b.exr", "b.exr", "--json"]);
    ends(&same, 0);
    let figures: Value = serde_json::from_slice(&same.stdout).unwrap();
    assert_eq!((figures["rmse"].as_f64(), &figures["psnr"]), (Some(0.0), &Value::Null));
}

/// Writes a picture of 16×16 pixels with a layer of variances and one of depths.
fn sampled(path: &Path, value: impl Fn(usize) -> f32, variance: f32) {
    use ::exr::prelude::*;
    let plane = |name: &str, of: &dyn Fn(usize) -> f32| {
        AnyChannel::new(Text::new_or_panic(name), FlatSamples::F32((0..256).map(of).collect()))
    };
    let channels = ["R", "G", "B"].map(|c| plane(c, &value)).into_iter();
    let variances = ["variance.R", "variance.G", "variance.B"].map(|c| plane(c, &|_| variance)).into_iter();
    let depth = [plane("depth.V", &|i| i as f32)].into_iter();
    let channels = AnyChannels::sort(channels.chain(variances).chain(depth).collect());
    Image::from_channels((16, 16), channels).write().to_file(path).unwrap();
}

#[test]
fn compare_looks_at_layers_and_tells_noise_from_bias() {
    let here = folder();
    let path = |name: &str| here.path().join(name);
    // Deviations of 0.1 to both sides; the variance of the difference is the sum of both.
    let noise = |i: usize| if ((i * 31 + i / 16) % 7).is_multiple_of(2) { 0.1 } else { -0.1 };
    sampled(&path("a.exr"), |i| 1.0 + noise(i), 0.006);
    sampled(&path("b.exr"), |_| 1.0, 0.004);
    picture(&path("plain.exr"), [1.0; 3]);
    let figures = |arguments: &[&str]| -> Value {
        let compared = gloaming(here.path(), &[&["compare", "--json"], arguments].concat());
        ends(&compared, 0);
        serde_json::from_slice(&compared.stdout).unwrap()
    };
    let found = figures(&["a.exr", "b.exr", "--variance"]);
    assert!((found["z_test"]["mean_square"].as_f64().unwrap() - 1.0).abs() < 1e-4, "{found}");
    assert_eq!((found["z_test"]["values"].as_u64(), found["z_test"]["beyond_3"].as_f64()), (Some(768), Some(0.0)));
    assert!(found["ssim"].as_f64().unwrap() < 1.0 && found["rmse"].as_f64().unwrap() > 0.09, "{found}");
    let depths = figures(&["a.exr", "b.exr", "--layer", "depth"]);
    assert_eq!((depths["rmse"].as_f64(), depths["mean_a"].as_f64()), (Some(0.0), Some(127.5)));
    for (arguments, says) in [
        (["plain.exr", "plain.exr", "--variance"], "render.kind = \"pathtrace\""),
        (["a.exr", "b.exr", "--layer=normal"], "no layer `normal`; it has"),
    ] {
        let refused = gloaming(here.path(), &[&["compare"], &arguments[..]].concat());
        ends(&refused, 1);
        assert!(stderr(&refused).contains(says), "{}", stderr(&refused));
    }
    let said = stdout(&gloaming(here.path(), &["compare", "a.exr", "b.exr", "--variance"]));
    for figure in ["relative mse", "ssim", "z of the mean", "mean of z²"] {
        assert!(said.contains(figure), "{said}");
    }
}

/// Layers are weighed anew without rendering: a picture of the same step and camera that says so.
#[test]
fn composite_weighs_layers_and_keeps_what_the_file_says() {
    let here = folder();
    series(here.path(), 2);
    let isosurface = ["--set", "render.kind=isosurface", "--out", "f_{step}.exr", "--quiet"];
    ends(&gloaming(here.path(), &render(&isosurface)), 0);
    let weighed =
        ["composite", "f_1.exr", "--diffuse", "0", "--specular", "0", "--out", "dark.exr", "--out", "dark.png"];
    ends(&gloaming(here.path(), &weighed), 0);
    let said = |name: &str| {
        let file = ::exr::meta::MetaData::read_from_file(here.path().join(name), true).unwrap();
        file.headers[0].own_attributes.clone()
    };
    assert!(said("f_1.exr").other.len() > 6);
    assert_eq!(said("f_1.exr"), said("dark.exr"));
    let [before, dark] = ["f_1.exr", "dark.exr"].map(|name| exr::read(&here.path().join(name)).unwrap());
    assert_eq!(before.layers, dark.layers);
    assert!(before.pixels.iter().any(|p| p[0] > 0.0) && dark.pixels.iter().all(|p| p[0] == 0.0));
    assert!(here.path().join("dark.png").exists());
    let nothing = gloaming(here.path(), &["composite", "f_1.exr"]);
    ends(&nothing, 1);
    assert!(stderr(&nothing).contains("--out"), "{}", stderr(&nothing));
}

#[test]
fn render_writes_frames_a_movie_and_a_ledger() {
    let here = folder();
    series(here.path(), 4);
    let arguments = render(&[
        "--out",
        "frames/f_{step:03}.png",
        "--out",
        "f_{step}.exr",
        "--out",
        "movie.mp4",
        "--ledger",
        "ledger.csv",
        "--steps",
        "1..4:2",
    ]);
    let output = gloaming(here.path(), &arguments);
    ends(&output, 0);
    assert_eq!(stdout(&output), "");
    let said = stderr(&output);
    assert!(
        said.contains("2/2 steps") && said.contains("warm") && said.contains("cold") && said.contains("ETA"),
        "{said}"
    );
    for (file, there) in [
        ("frames/f_001.png", true),
        ("frames/f_003.png", true),
        ("f_1.exr", true),
        ("movie.mp4", true),
        ("f_2.exr", false),
    ] {
        assert_eq!(here.path().join(file).exists(), there, "{file}");
    }
    assert_eq!(image::image_dimensions(here.path().join("frames/f_001.png")).unwrap(), (40, 30));
    let frame = exr::read(&here.path().join("f_3.exr")).unwrap();
    assert!(
        frame.pixels.iter().any(|p| p[3] > 0.1) && frame.pixels[0] == [0.0; 4],
        "the ball is seen, its surroundings are not"
    );
    let rows = ledger::read(&here.path().join("ledger.csv")).unwrap();
    assert_eq!(rows.iter().map(|r| (r.step, r.start.as_str())).collect::<Vec<_>>(), [(1, "cold"), (3, "warm")]);
}

#[test]
fn options_override_the_scene_file() {
    let here = folder();
    series(here.path(), 2);
    std::fs::write(here.path().join("scene.toml"), "[render]\nsize = [9, 9]\n[light]\nwarm = true\n").unwrap();
    let arguments = render(&["--scene", "scene.toml", "--out", "f_{step}.png", "--cold", "--ledger", "l.csv"]);
    ends(&gloaming(here.path(), &arguments), 0);
    assert_eq!(image::image_dimensions(here.path().join("f_1.png")).unwrap(), (40, 30));
    assert!(!std::fs::read_to_string(here.path().join("l.csv")).unwrap().contains("warm"));
}

#[test]
fn warm_and_cold_write_the_same_frame_at_tolerance_0() {
    let here = folder();
    series(here.path(), 3);
    let fixed = ["--tolerance", "0", "--set", "light.scattering=false", "--set", "field.range=[0,1]"];
    ends(&gloaming(here.path(), &render(&[&["--out", "warm_{step}.exr"], &fixed[..]].concat())), 0);
    ends(&gloaming(here.path(), &render(&[&["--out", "cold_{step}.exr", "--cold"], &fixed[..]].concat())), 0);
    let read = |name: &str| exr::read(&here.path().join(name)).unwrap().pixels;
    assert!(read("warm_2.exr") == read("cold_2.exr"));
    assert!(read("warm_2.exr") != read("warm_0.exr"));
}

/// Writes three steps with checksums into one file and damages the values of step 1.
fn damaged(path: &Path) {
    let file = hdf5::File::create(path).unwrap();
    let steps =
        file.new_dataset::<f32>().shape((3, 4, 4, 4)).chunk((1, 4, 4, 4)).fletcher32().create("density").unwrap();
    let values: Vec<f32> = (0..192).map(|i| if i / 64 == 1 { 0.7512 } else { i as f32 / 192.0 }).collect();
    steps.write_raw(&values).unwrap();
    drop((steps, file));
    let mut bytes = std::fs::read(path).unwrap();
    let at = bytes.windows(4).position(|w| w == 0.7512f32.to_le_bytes()).unwrap();
    bytes[at] ^= 1;
    std::fs::write(path, bytes).unwrap();
}

#[test]
fn a_step_that_cannot_be_read_is_a_loss_and_the_others_are_done() {
    let here = folder();
    damaged(&here.path().join("run.h5"));
    let arguments =
        ["render", "run.h5", "--device", "cpu", "--size", "16x16", "--out", "f_{step}.png", "--ledger", "l.csv", "-q"];
    let output = gloaming(here.path(), &arguments);
    ends(&output, 3);
    assert!(stderr(&output).contains("step 1") && stderr(&output).contains("run.h5"), "{}", stderr(&output));
    for (file, there) in [("f_0.png", true), ("f_1.png", false), ("f_2.png", true)] {
        assert_eq!(here.path().join(file).exists(), there, "{file}");
    }
    let rows = ledger::read(&here.path().join("l.csv")).unwrap();
    assert_eq!(
        rows.iter().map(|r| (r.step, r.lost.contains("run.h5"))).collect::<Vec<_>>(),
        [(0, false), (1, true), (2, false)]
    );
}

#[cfg(unix)]
#[test]
fn an_interruption_finishes_the_step_closes_the_movie_and_is_a_loss() {
    let here = folder();
    series(here.path(), 300);
    let arguments = render(&["--out", "movie.mp4", "--ledger", "l.csv", "--size", "320x240"]);
    let mut command = Command::new(env!("CARGO_BIN_EXE_gloaming"));
    let child = command.args(&arguments).current_dir(here.path()).stderr(std::process::Stdio::piped()).spawn().unwrap();
    let begun = std::time::Instant::now();
    while std::fs::read_to_string(here.path().join("l.csv")).unwrap_or_default().lines().count() < 3 {
        assert!(begun.elapsed().as_secs() < 60, "no step in a minute");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    ends(&output, 3);
    assert!(
        stderr(&output).contains("interrupted: ") && stderr(&output).contains("of 300 steps done"),
        "{}",
        stderr(&output)
    );
    let movie = std::fs::read(here.path().join("movie.mp4")).unwrap();
    assert_eq!(&movie[4..8], b"ftyp", "the movie has its final name and is whole");
}

#[test]
fn a_run_follows_a_series_that_grows_and_another_takes_it_up() {
    let here = folder();
    let at = here.path().to_owned();
    let writer = std::thread::spawn(move || {
        std::fs::create_dir(at.join("later")).unwrap();
        series(&at.join("later"), 4);
        for step in 0..4 {
            std::thread::sleep(std::time::Duration::from_millis(100));
            std::fs::rename(at.join(format!("later/ball_{step:03}.raw")), at.join(format!("ball_{step:03}.raw")))
                .unwrap();
        }
    });
    let rest = ["--out", "f_{step}.png", "--ledger", "l.csv", "--steps", "0..4", "--set", "field.range=[0,1]"];
    let followed = gloaming(here.path(), &render(&[&rest[..], &["--follow", "--idle-timeout", "1min"]].concat()));
    writer.join().unwrap();
    ends(&followed, 0);
    assert!(stderr(&followed).contains("4 steps,") && !stderr(&followed).contains("ETA"), "{}", stderr(&followed));
    assert!((0..4).all(|step| here.path().join(format!("f_{step}.png")).exists()));

    std::fs::remove_file(here.path().join("f_2.png")).unwrap();
    let resumed = gloaming(here.path(), &render(&[&rest[..], &["--resume"]].concat()));
    ends(&resumed, 0);
    assert!(
        stderr(&resumed).contains("1 steps in") && stderr(&resumed).contains("3 done before"),
        "{}",
        stderr(&resumed)
    );
    assert_eq!(ledger::read(&here.path().join("l.csv")).unwrap().len(), 4);

    let nothing = ["render", "none_{step}.h5", "--out", "f_{step}.png", "--follow", "--idle-timeout", "300ms"];
    let nothing = gloaming(here.path(), &nothing);
    ends(&nothing, 1);
    assert!(stderr(&nothing).contains("no file matches"), "{}", stderr(&nothing));
    ends(&gloaming(here.path(), &render(&["--out", "a.png", "--idle-timeout", "1min"])), 2);
    ends(&gloaming(here.path(), &render(&["--out", "a.png", "--follow", "--idle-timeout", "soon"])), 2);
}

/// A raw file that was cut short among whole ones costs its own step.
#[test]
fn a_file_that_was_cut_short_is_a_loss() {
    let here = folder();
    series(here.path(), 3);
    let whole = std::fs::read(here.path().join("ball_001.raw")).unwrap();
    std::fs::write(here.path().join("ball_001.raw"), &whole[..1000]).unwrap();
    let output = gloaming(here.path(), &render(&["--out", "f_{step}.png", "-q"]));
    ends(&output, 3);
    assert!(stderr(&output).contains("step 1 lost") && stderr(&output).contains("ball_001.raw"), "{}", stderr(&output));
    assert!(here.path().join("f_2.png").exists() && !here.path().join("f_1.png").exists());
}

#[test]
fn quiet_says_nothing_and_info_reads_what_render_reads() {
    let here = folder();
    series(here.path(), 1);
    let output = gloaming(here.path(), &render(&["--out", "f.png", "-q"]));
    ends(&output, 0);
    assert_eq!(stderr(&output), "");
    let info =
        gloaming(here.path(), &["info", "ball_000.raw", RAW[0], RAW[1], "--json", "--stats", "--probe", "4,5,4"]);
    ends(&info, 0);
    let info: Value = serde_json::from_slice(&info.stdout).unwrap();
    assert_eq!(info["grid"]["size"], serde_json::json!([12, 10, 8]));
    assert_eq!(info["steps"][0]["probe"].as_f64(), Some(1.0));
}
