//! What sinks write is read back: pictures, movies, volumes, and what is left after failures.

use std::path::{Path, PathBuf};

use gloaming::frame::{Frame, Layer};
use gloaming::ledger::LedgerRow;
use gloaming::scene::Scene;
use gloaming::sink::{self, Output, Sink, SinkOptions, View};

/// A frame with structure in every channel, beyond 1, negative and partly transparent.
fn frame(size: [usize; 2], seed: f32) -> Frame {
    let mut frame = Frame::new(size);
    for (i, pixel) in frame.pixels.iter_mut().enumerate() {
        let (x, y) = ((i % size[0]) as f32 / size[0] as f32, (i / size[0]) as f32 / size[1] as f32);
        let alpha = (0.5 + 0.5 * (9.0 * x + seed).sin()).clamp(0.0, 1.0);
        *pixel = [alpha * 2.0 * x, alpha * y * y, alpha * (0.3 + 0.3 * (20.0 * y * x + seed).cos()) - 1e-4, alpha];
    }
    frame
}

fn view(camera: &str, frame: Frame) -> View {
    let axes = [[0.8, 0.6, 0.0], [0.0, 0.0, 1.0], [0.6, -0.8, 0.0]];
    View { camera: camera.into(), axes, eye: [3.0, -2.5, 1.25], fov: 35.0, frame }
}

fn output(step: u64, time: Option<f64>, frames: Vec<View>) -> Output {
    Output { step, time, range: [0.0, 1.5], frames, light: None, row: LedgerRow { step, time, ..Default::default() } }
}

fn options(cameras: &[&str], steps: usize) -> SinkOptions {
    SinkOptions {
        cameras: cameras.iter().map(|c| c.to_string()).collect(),
        steps,
        ..SinkOptions::from(&Scene::default())
    }
}

fn open(folder: &Path, name: &str, options: &SinkOptions) -> Box<dyn Sink> {
    sink::open(folder.join(name).to_str().unwrap(), options).unwrap()
}

fn refused(target: &str, options: &SinkOptions) -> String {
    match sink::open(target, options) {
        Ok(_) => panic!("{target} was accepted"),
        Err(e) => e.to_string(),
    }
}

/// All files below a folder.
fn files(folder: &Path) -> Vec<String> {
    let mut names = vec![];
    let mut folders = vec![PathBuf::from(folder)];
    while let Some(f) = folders.pop() {
        for entry in std::fs::read_dir(f).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                names.push(path.strip_prefix(folder).unwrap().to_string_lossy().into_owned());
            }
        }
    }
    names.sort();
    names
}

#[test]
fn exr_holds_every_bit_and_says_what_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let mut sink = open(folder.path(), "deep/{camera}/f_{step:06}.exr", &options(&["left", "right"], 2));
    let mut odd = frame([61, 37], 0.5);
    odd.pixels[5] = [f32::MIN_POSITIVE, f32::MAX, 1e-30, 1.0];
    sink.write(&output(7, Some(0.1), vec![view("left", odd.clone()), view("right", frame([32, 8], 2.0))])).unwrap();
    sink.finish().unwrap();
    assert_eq!(files(folder.path()), ["deep/left/f_000007.exr", "deep/right/f_000007.exr"]);
    assert_eq!(sink.paths(7).iter().filter(|p| p.exists()).count(), 2);

    let path = folder.path().join("deep/left/f_000007.exr");
    let read = sink::exr::read(&path).unwrap();
    assert_eq!(read.size, odd.size);
    let bits = |f: &Frame| f.pixels.iter().map(|p| p.map(f32::to_bits)).collect::<Vec<_>>();
    assert_eq!(bits(&read), bits(&odd));

    use exr::meta::attribute::{AttributeValue, Text};
    let header = &exr::meta::MetaData::read_from_file(&path, true).unwrap().headers[0];
    let attribute = |name: &str| header.own_attributes.other[&Text::from(name)].clone();
    assert_eq!(attribute("step"), AttributeValue::I32(7));
    assert_eq!(attribute("time"), AttributeValue::F64(0.1));
    assert_eq!(attribute("camera"), AttributeValue::Text("left".into()));
    assert_eq!(attribute("eye"), AttributeValue::FloatVec3((3.0, -2.5, 1.25)));
    assert_eq!(attribute("up"), AttributeValue::FloatVec3((0.0, 0.0, 1.0)));
    assert_eq!(attribute("verticalFov"), AttributeValue::F32(35.0));
    let software = header.own_attributes.software_name.as_ref().unwrap().to_string();
    assert_eq!(software, format!("gloaming {}", env!("CARGO_PKG_VERSION")));
}

/// Another picture of the same step says the same of itself, also in the place of the first.
#[test]
fn an_exr_keeps_what_another_says_of_its_step() {
    let folder = tempfile::tempdir().unwrap();
    let mut sink = open(folder.path(), "f_{step}.exr", &options(&["left"], 1));
    sink.write(&output(7, Some(0.1), vec![view("left", frame([9, 5], 0.5))])).unwrap();
    let path = folder.path().join("f_7.exr");
    let header = || exr::meta::MetaData::read_from_file(&path, true).unwrap().headers[0].own_attributes.clone();
    let before = header();
    assert!(before.other.len() > 6);
    let attributes = sink::exr::Attributes::of(&path).unwrap();
    attributes.write(&path, &frame([4, 3], 2.0)).unwrap();
    assert_eq!(header(), before);
    assert_eq!(sink::exr::read(&path).unwrap(), frame([4, 3], 2.0));
}

#[test]
fn exr_holds_the_further_layers_of_a_frame() {
    let folder = tempfile::tempdir().unwrap();
    let mut sink = open(folder.path(), "f_{step}.exr", &options(&["main"], 1));
    let mut shown = frame([13, 7], 0.5);
    let layer = |name: &str, channels: &str| Layer {
        name: name.into(),
        channels: channels.into(),
        values: (0..13 * 7 * channels.len()).map(|i| (i * name.len()) as f32 - 0.5).collect(),
    };
    // Orders that the file, which sorts channels by name, does not have.
    shown.layers = vec![layer("albedo", "RGB"), layer("depth", "V"), layer("normal", "XYZ")];
    sink.write(&output(1, None, vec![view("main", shown.clone())])).unwrap();
    sink.finish().unwrap();
    assert_eq!(sink::exr::read(&folder.path().join("f_1.exr")).unwrap(), shown);
}

#[test]
fn png_is_the_frame_before_the_background_through_the_tone_map() {
    let folder = tempfile::tempdir().unwrap();
    let mut options = options(&["main"], 2);
    options.display.background = [0.1, 0.2, 0.9];
    options.display.exposure = 1.5;
    let mut sink = open(folder.path(), "f_%04d.png", &options);
    let shown = frame([50, 31], 1.0);
    sink.write(&output(12, None, vec![view("main", shown.clone())])).unwrap();
    let read = image::open(folder.path().join("f_0012.png")).unwrap().into_rgb8();
    assert_eq!((read.width(), read.height()), (50, 31));
    for (i, pixel) in shown.pixels.iter().enumerate() {
        let got = read.get_pixel(i as u32 % 50, i as u32 / 50).0;
        for c in 0..3 {
            let linear = 1.5 * (pixel[c] + (1.0 - pixel[3]) * options.display.background[c]);
            let v = f64::from(linear).clamp(0.0, 1.0);
            let s = if v <= 0.0031308 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
            assert!(
                (f64::from(got[c]) - 255.0 * s).abs() <= 0.501,
                "pixel {i} channel {c}: {} for {}",
                got[c],
                255.0 * s
            );
        }
    }
    // The same step again replaces the file.
    let again = Frame { pixels: vec![[1.0; 4]; 50 * 31], ..shown };
    sink.write(&output(12, None, vec![view("main", again)])).unwrap();
    let read = image::open(folder.path().join("f_0012.png")).unwrap().into_rgb8();
    assert!(read.as_raw().iter().all(|&v| v == 255));
    assert_eq!(files(folder.path()), ["f_0012.png"]);
}

#[test]
fn paths_that_lose_pictures_are_refused_with_the_path_to_type() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    for extension in ["png", "exr"] {
        let message = refused(&at(&format!("a.{extension}")), &options(&["main"], 3));
        assert!(message.contains("3 steps") && message.contains(&format!("a_{{step:06}}.{extension}")), "{message}");
        // How many steps will come is not known when following a run.
        refused(&at(&format!("a.{extension}")), &options(&["main"], 0));
        sink::open(&at(&format!("a.{extension}")), &options(&["main"], 1)).unwrap();
        let message = refused(&at(&format!("a_{{step}}.{extension}")), &options(&["top", "side"], 3));
        assert!(
            message.contains("top, side") && message.contains(&format!("a_{{step}}_{{camera}}.{extension}")),
            "{message}"
        );
    }
    let message = refused(&at("{camera}_{step}.png"), &options(&["top", "top"], 3));
    assert!(message.contains("cameras.name") && message.contains("top"), "{message}");
    for name in ["a.gif", "a"] {
        let message = refused(&at(name), &options(&["main"], 3));
        assert!(message.contains(".png") && message.contains(".exr") && message.contains(name), "{message}");
    }
    assert_eq!(files(folder.path()), [""; 0]);
}

#[test]
fn a_folder_that_cannot_be_written_is_found_at_once() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("file"), "").unwrap();
    let target = folder.path().join("file/frame_{step}.png");
    let message = refused(target.to_str().unwrap(), &options(&["main"], 3));
    assert!(message.contains("file"), "{message}");
}

/// With file sizes limited (as with a full disk, writing fails half-way), sinks return errors that name the file and leave
/// neither half a file under its final name nor anything temporary. The test runs itself under the limit.
#[test]
fn a_full_disk_leaves_nothing_half_written() {
    const FOLDER: &str = "GLOAMING_TEST_LIMITED_FOLDER";
    if let Ok(folder) = std::env::var(FOLDER) {
        let folder = Path::new(&folder);
        for name in ["f_{step}.png", "f_{step}.exr"] {
            let mut sink = open(folder, name, &options(&["main"], 3));
            sink.write(&output(1, None, vec![view("main", frame([4, 4], 0.0))])).unwrap();
            let message =
                sink.write(&output(2, None, vec![view("main", frame([640, 480], 0.0))])).unwrap_err().to_string();
            assert!(message.contains("f_2."), "{message}");
            let _ = sink.finish();
        }
        // A movie whose first frames fit and whose next does not: what fits is kept, in fragments.
        let noise = |n: u32| Frame {
            pixels: (0..320 * 240u32).map(|i| [(i.wrapping_mul(2654435761 + n) >> 24) as f32 / 255.0; 4]).collect(),
            ..Frame::new([320, 240])
        };
        for (name, fit) in [("none.mp4", 0), ("some.mp4", 4)] {
            let mut sink = open(folder, name, &options(&["main"], 8));
            for step in 0..fit {
                sink.write(&output(step, None, vec![view("main", Frame::new([320, 240]))])).unwrap();
            }
            let failed = (0..4).find_map(|n| sink.write(&output(fit, None, vec![view("main", noise(n))])).err());
            assert!(failed.expect("a full disk").to_string().contains(".partial.mp4"));
            assert_eq!(sink.finish().is_ok(), fit > 0);
        }
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let run = std::process::Command::new("bash")
        .args(["-c", r#"trap "" XFSZ; ulimit -f 8; exec "$@""#, "limited"])
        .arg(std::env::current_exe().unwrap())
        .args(["--exact", "a_full_disk_leaves_nothing_half_written", "--nocapture"])
        .env(FOLDER, folder.path())
        .output()
        .unwrap();
    assert!(run.status.success(), "{}{}", String::from_utf8_lossy(&run.stdout), String::from_utf8_lossy(&run.stderr));
    assert_eq!(files(folder.path()), ["f_1.exr", "f_1.png", "some.mp4"]);
    // Whole boxes to the last byte.
    let movie = std::fs::read(folder.path().join("some.mp4")).unwrap();
    let (mut at, mut fragments) = (0, 0);
    while at < movie.len() {
        fragments += usize::from(&movie[at + 4..at + 8] == b"mdat");
        at += u32::from_be_bytes(movie[at..at + 4].try_into().unwrap()) as usize;
    }
    assert_eq!((at, fragments), (movie.len(), 2));
}
