//! Movies are taken apart and decoded again: every frame, its colours, its time.

use std::path::Path;

use gloaming::frame::{Display, Frame};
use gloaming::ledger::LedgerRow;
use gloaming::scene::{Scene, Tonemap};
use gloaming::sink::{self, Output, Sink, SinkOptions, View};
use openh264::decoder::Decoder;
use openh264::formats::YUVSource;

/// What a plain (not fragmented) MP4 with one video track holds.
struct Movie {
    size: [usize; 2],
    timescale: u32,
    duration: u32,
    /// Ticks of each frame.
    durations: Vec<u32>,
    keyframes: Vec<u32>,
    /// Frames with start codes, parameter sets before the first.
    frames: Vec<Vec<u8>>,
}

fn be32(bytes: &[u8], at: usize) -> u32 {
    u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap())
}

/// The payload of the box at a path of names (ISO 14496-12).
fn find<'a>(mut bytes: &'a [u8], path: &[&str]) -> &'a [u8] {
    'names: for name in path {
        while bytes.len() >= 8 {
            let (size, kind) = (be32(bytes, 0) as usize, &bytes[4..8]);
            if kind == name.as_bytes() {
                bytes = &bytes[8..size];
                continue 'names;
            }
            bytes = &bytes[size..];
        }
        panic!("no box {name}");
    }
    bytes
}

fn with_start_codes(mut nals: &[u8]) -> Vec<u8> {
    let mut stream = vec![];
    while !nals.is_empty() {
        let length = be32(nals, 0) as usize;
        stream.extend([0, 0, 0, 1]);
        stream.extend(&nals[4..4 + length]);
        nals = &nals[4 + length..];
    }
    stream
}

fn take_apart(path: &Path) -> Movie {
    let file = std::fs::read(path).unwrap();
    let media = find(&file, &["moov", "trak", "mdia"]);
    let header = find(media, &["mdhd"]);
    let table = |name| find(media, &["minf", "stbl", name]);
    let entry = &table("stsd")[8..];
    assert_eq!(&entry[4..8], b"avc1");
    let size = [24 + 8, 26 + 8].map(|at| usize::from(u16::from_be_bytes([entry[at], entry[at + 1]])));
    let configuration = find(&entry[86..], &["avcC"]);
    let sps = usize::from(u16::from_be_bytes([configuration[6], configuration[7]]));
    let pps_at = 8 + sps + 1;
    let pps = usize::from(u16::from_be_bytes([configuration[pps_at], configuration[pps_at + 1]]));
    let mut sets = [[0, 0, 0, 1].as_slice(), &configuration[8..8 + sps], &[0, 0, 0, 1]].concat();
    sets.extend(&configuration[pps_at + 2..pps_at + 2 + pps]);

    let mut durations = vec![];
    for run in table("stts")[8..].chunks_exact(8) {
        durations.extend(vec![be32(run, 4); be32(run, 0) as usize]);
    }
    // One chunk: samples follow each other.
    assert_eq!(be32(table("stco"), 4), 1);
    let mut at = be32(table("stco"), 8) as usize;
    let mut frames = vec![];
    for (n, length) in table("stsz")[12..].chunks_exact(4).enumerate() {
        let length = be32(length, 0) as usize;
        let frame = with_start_codes(&file[at..at + length]);
        frames.push(if n == 0 { [sets.clone(), frame].concat() } else { frame });
        at += length;
    }
    let keyframes = table("stss")[8..].chunks_exact(4).map(|k| be32(k, 0)).collect();
    Movie { size, timescale: be32(header, 12), duration: be32(header, 16), durations, keyframes, frames }
}

/// RGB of a decoded frame by BT.709, limited range, nearest chroma.
fn decode(decoder: &mut Decoder, frame: &[u8], size: [usize; 2]) -> Vec<[f64; 3]> {
    let yuv = decoder.decode(frame).unwrap().expect("a picture from every frame");
    let (w, h) = yuv.dimensions();
    assert!(w >= size[0] && h >= size[1] && w - size[0] < 2 && h - size[1] < 2, "{w}x{h}");
    let (sy, su, sv) = yuv.strides();
    let mut rgb = vec![];
    for j in 0..size[1] {
        for i in 0..size[0] {
            let y = (f64::from(yuv.y()[j * sy + i]) - 16.0) / 219.0;
            let cb = (f64::from(yuv.u()[j / 2 * su + i / 2]) - 128.0) / 224.0;
            let cr = (f64::from(yuv.v()[j / 2 * sv + i / 2]) - 128.0) / 224.0;
            let (r, b) = (y + 1.5748 * cr, y + 1.8556 * cb);
            let g = (y - 0.2126 * r - 0.0722 * b) / 0.7152;
            rgb.push([r, g, b].map(|v| (255.0 * v).clamp(0.0, 255.0)));
        }
    }
    rgb
}

fn psnr(got: &[[f64; 3]], wanted: &[u8]) -> f64 {
    let squares: f64 = got.iter().flatten().zip(wanted).map(|(a, &b)| (a - f64::from(b)).powi(2)).sum();
    20.0 * 255f64.log10() - 10.0 * (squares / wanted.len() as f64).log10()
}

/// Smoke-like: smooth, coloured, moving.
fn cloud(size: [usize; 2], step: usize) -> Frame {
    let mut frame = Frame::new(size);
    let (w, h) = (size[0] as f32, size[1] as f32);
    for (i, pixel) in frame.pixels.iter_mut().enumerate() {
        let (x, y) = ((i % size[0]) as f32 / w - 0.5, (i / size[0]) as f32 / h - 0.5);
        let t = step as f32 * 0.05;
        let d = ((x - 0.2 * t.sin()).powi(2) + (y - 0.1 * t.cos()).powi(2)) * 12.0;
        let ripple = 0.6 + 0.4 * (14.0 * x + 3.0 * t).sin() * (11.0 * y - 2.0 * t).cos();
        let a = (-d).exp() * ripple;
        *pixel = [0.9 * a, 0.55 * a * a + 0.1 * a, 0.5 * a.powi(3) + 0.05 * a, a];
    }
    frame
}

fn output(step: u64, frames: Vec<View>) -> Output {
    Output { step, time: None, range: [0.0, 1.0], frames, light: None, row: LedgerRow::default() }
}

fn view(camera: &str, frame: Frame) -> View {
    let axes = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]];
    View { camera: camera.into(), axes, eye: [0.0; 3], fov: 35.0, frame }
}

fn options(cameras: &[&str]) -> SinkOptions {
    SinkOptions { cameras: cameras.iter().map(|c| c.to_string()).collect(), ..SinkOptions::from(&Scene::default()) }
}

fn open(folder: &Path, name: &str, options: &SinkOptions) -> Box<dyn Sink> {
    sink::open(folder.join(name).to_str().unwrap(), options).unwrap()
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> =
        std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

#[test]
fn every_frame_decodes_close_to_what_was_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let options = options(&["main"]);
    let size = [321, 181];
    let mut sink = open(folder.path(), "new/movie.mp4", &options);
    for step in 0..50 {
        sink.write(&output(step, vec![view("main", cloud(size, step as usize))])).unwrap();
        assert!(!folder.path().join("new/movie.mp4").exists(), "the final name is for the whole movie");
    }
    sink.finish().unwrap();
    assert_eq!(names(&folder.path().join("new")), ["movie.mp4"]);

    let movie = take_apart(&folder.path().join("new/movie.mp4"));
    assert_eq!(movie.size, [322, 182]);
    assert_eq!((movie.frames.len(), movie.durations.len()), (50, 50));
    assert_eq!(f64::from(movie.duration) / f64::from(movie.timescale), 50.0 / 24.0);
    assert!(movie.durations.iter().all(|&d| d == movie.timescale / 24));
    assert_eq!(movie.keyframes, [1, 25, 49], "a keyframe a second");
    let mut decoder = Decoder::new().unwrap();
    for (step, frame) in movie.frames.iter().enumerate() {
        let wanted = options.display.picture(&cloud(size, step));
        let psnr = psnr(&decode(&mut decoder, frame, size), wanted.as_raw());
        assert!(psnr > 35.0, "frame {step}: {psnr} dB");
    }
}

#[test]
fn colours_survive() {
    let folder = tempfile::tempdir().unwrap();
    let mut options = options(&["main"]);
    options.display = Display { tonemap: Tonemap::None, ..options.display };
    let size = [256, 64];
    let patches = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.5, 0.5, 0.5]];
    let mut frame = Frame::new(size);
    for (i, pixel) in frame.pixels.iter_mut().enumerate() {
        let [r, g, b] = patches[i % size[0] / 64];
        *pixel = [r, g, b, 1.0];
    }
    let mut sink = open(folder.path(), "m.mp4", &options);
    for step in 0..3 {
        sink.write(&output(step, vec![view("main", frame.clone())])).unwrap();
    }
    sink.finish().unwrap();
    let movie = take_apart(&folder.path().join("m.mp4"));
    let mut decoder = Decoder::new().unwrap();
    for coded in &movie.frames {
        let rgb = decode(&mut decoder, coded, size);
        for (n, patch) in patches.iter().enumerate() {
            let centre = rgb[32 * size[0] + 64 * n + 32];
            for c in 0..3 {
                assert!((centre[c] - 255.0 * f64::from(patch[c])).abs() <= 3.0, "patch {n}: {centre:?}");
            }
        }
    }
}

#[test]
fn quality_is_the_quantiser_and_fractional_rates_keep_time() {
    let folder = tempfile::tempdir().unwrap();
    let size = [320, 180];
    let mut sizes = vec![];
    for quality in [12, 23, 36, 51] {
        let options = SinkOptions { quality, fps: 23.976, ..options(&["main"]) };
        let mut sink = open(folder.path(), "q.mp4", &options);
        for step in 0..48 {
            sink.write(&output(step, vec![view("main", cloud(size, step as usize))])).unwrap();
        }
        sink.finish().unwrap();
        let movie = take_apart(&folder.path().join("q.mp4"));
        let seconds = f64::from(movie.duration) / f64::from(movie.timescale);
        assert!((seconds - 48.0 / 23.976).abs() < 1e-4, "{seconds}");
        assert!(movie.durations.iter().all(|d| d.abs_diff(3754) <= 1), "a constant rate: {:?}", movie.durations);
        sizes.push(std::fs::metadata(folder.path().join("q.mp4")).unwrap().len());
    }
    assert!(sizes.windows(2).all(|w| w[0] as f64 > 1.5 * w[1] as f64), "{sizes:?}");
}

#[test]
fn cameras_have_their_own_movies_and_an_early_end_leaves_them_playable() {
    let folder = tempfile::tempdir().unwrap();
    let mut sink = open(folder.path(), "{camera}.mp4", &options(&["top", "side"]));
    for step in 0..3 {
        let frames = vec![view("top", cloud([64, 48], step)), view("side", cloud([64, 48], step + 20))];
        sink.write(&output(step as u64, frames)).unwrap();
    }
    sink.finish().unwrap();
    assert_eq!(names(folder.path()), ["side.mp4", "top.mp4"]);
    for name in ["side.mp4", "top.mp4"] {
        let movie = take_apart(&folder.path().join(name));
        let mut decoder = Decoder::new().unwrap();
        assert_eq!(movie.frames.iter().map(|f| decode(&mut decoder, f, [64, 48])).count(), 3);
    }
    // No step at all: no file.
    let mut sink = open(folder.path(), "none.mp4", &options(&["main"]));
    sink.finish().unwrap();
    assert_eq!(names(folder.path()), ["side.mp4", "top.mp4"]);
}

#[test]
fn a_killed_run_leaves_fragments_that_play() {
    let folder = tempfile::tempdir().unwrap();
    let size = [64, 48];
    let mut sink = open(folder.path(), "m.mp4", &options(&["main"]));
    for step in 0..7 {
        sink.write(&output(step, vec![view("main", cloud(size, step as usize))])).unwrap();
    }
    // Dropped without `finish`, as a kill would.
    drop(sink);
    assert_eq!(names(folder.path()), ["m.partial.mp4"]);
    let file = std::fs::read(folder.path().join("m.partial.mp4")).unwrap();
    let mut decoder = Decoder::new().unwrap();
    let (mut at, mut played, mut lengths) = (0, 0, vec![]);
    while at < file.len() {
        let size_of_box = be32(&file, at) as usize;
        match &file[at + 4..at + 8] {
            b"moof" => {
                // trun: samples, data offset, then (duration, size, flags, …) for each.
                let run = find(&file[at + 8..at + size_of_box], &["traf", "trun"]);
                let (flags, count) = (be32(run, 0), be32(run, 4) as usize);
                let fields = (flags >> 8 & 0xf).count_ones() as usize;
                assert_eq!(flags & 0x301, 0x301, "offset, durations and sizes");
                for n in 0..count {
                    assert_eq!(be32(run, 12 + 4 * fields * n), 1000);
                    lengths.push(be32(run, 12 + 4 * fields * n + 4) as usize);
                }
            }
            b"mdat" => {
                let mut from = at + 8;
                for length in lengths.drain(..) {
                    decode(&mut decoder, &with_start_codes(&file[from..from + length]), size);
                    from += length;
                    played += 1;
                }
            }
            _ => {}
        }
        at += size_of_box;
    }
    assert_eq!(played, 6, "all but the last, which waits for its pair");
}

#[test]
fn what_cannot_be_encoded_is_said_with_a_way_out() {
    let folder = tempfile::tempdir().unwrap();
    let mut sink = open(folder.path(), "m.mp4", &options(&["main"]));
    let message = sink.write(&output(0, vec![view("main", Frame::new([4096, 64]))])).unwrap_err().to_string();
    assert!(message.contains("4096x64") && message.contains("3840x2160") && message.contains("m.mp4"), "{message}");
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    let refused = |name: &str, options: &SinkOptions| match sink::open(&at(name), options) {
        Ok(_) => panic!("{name} was accepted"),
        Err(e) => e.to_string(),
    };
    assert!(refused("m_{step:04}.mp4", &options(&["main"])).contains("m.mp4"));
    assert!(refused("m.mp4", &options(&["a", "b"])).contains("m_{camera}.mp4"));
    assert!(refused("m.mp4", &SinkOptions { fps: 0.0, ..options(&["main"]) }).contains("movie.fps"));
    assert!(refused("m.mp4", &SinkOptions { quality: 52, ..options(&["main"]) }).contains("movie.quality"));
}

/// A grey frame, brighter with each step.
fn grey(step: usize) -> Frame {
    Frame { pixels: vec![[0.02 * (step * step) as f32 + 0.01; 4]; 64 * 64], ..Frame::new([64, 64]) }
}

/// Writes steps at these times and tells which step each frame of the movie shows, by its brightness.
fn shown(folder: &Path, options: &SinkOptions, times: &[Option<f64>]) -> Vec<usize> {
    let mut sink = open(folder, "paced.mp4", options);
    for (step, &time) in times.iter().enumerate() {
        let step = output(step as u64, vec![view("main", grey(step))]);
        sink.write(&Output { time, ..step }).unwrap();
    }
    sink.finish().unwrap();
    let drawn: Vec<f64> = (0..times.len()).map(|s| f64::from(options.display.picture(&grey(s)).as_raw()[0])).collect();
    let movie = take_apart(&folder.join("paced.mp4"));
    let mut decoder = Decoder::new().unwrap();
    let nearest = |frame: &Vec<u8>| {
        let is = decode(&mut decoder, frame, movie.size)[0][0];
        (0..drawn.len()).min_by(|&a, &b| (drawn[a] - is).abs().total_cmp(&(drawn[b] - is).abs())).unwrap()
    };
    movie.frames.iter().map(nearest).collect()
}

#[test]
fn seconds_per_time_unit_paces_steps_by_repeating_and_leaving_out_frames() {
    let folder = tempfile::tempdir().unwrap();
    let paced =
        |seconds: f64, fps: f64| SinkOptions { seconds_per_time_unit: Some(seconds), fps, ..options(&["main"]) };
    let times = |t: &[f64]| t.iter().map(|t| Some(*t)).collect::<Vec<_>>();
    // Ten frames a unit of time: the second step stays three times as long as the first; the last as long as that.
    let shown = |options: &SinkOptions, times: &[Option<f64>]| shown(folder.path(), options, times);
    assert_eq!(shown(&paced(1.0, 10.0), &times(&[5.0, 5.1, 5.4])), [0, 1, 1, 1, 2, 2, 2]);
    // Two and a half frames a unit: begins at frames 0, 2.5, 5, 7.5.
    assert_eq!(shown(&paced(0.25, 10.0), &times(&[0.0, 1.0, 2.0, 3.0])), [0, 0, 0, 1, 1, 2, 2, 2, 3, 3, 3]);
    // A third of a frame a unit: steps fall on the same frame as the next, but for two.
    assert_eq!(shown(&paced(1.0 / 3.0, 1.0), &times(&[0.0, 1.0, 2.0, 3.0, 4.0])).len(), 2);
    // Times that are missing, repeat or go back give a frame each, and do not disturb what follows.
    let odd = [Some(0.0), Some(0.2), None, Some(0.1), Some(0.1), Some(0.3)];
    assert_eq!(shown(&paced(1.0, 10.0), &odd), [0, 0, 1, 2, 3, 4, 4, 5, 5]);
    // Without a pace every step has one frame, whatever its time.
    assert_eq!(shown(&options(&["main"]), &odd), [0, 1, 2, 3, 4, 5]);
    let mut sink = open(folder.path(), "long.mp4", &paced(1e9, 30.0));
    for step in 0..2 {
        let mut output = output(step, vec![view("main", cloud([64, 64], 0))]);
        output.time = Some(step as f64);
        match sink.write(&output) {
            Ok(()) => assert_eq!(step, 0),
            Err(e) => assert!(step == 1 && e.to_string().contains("movie.seconds_per_time_unit"), "{e}"),
        }
    }
    sink.finish().unwrap();
}
