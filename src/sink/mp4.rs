//! MP4: H.264 movies, encoded and packed in this process, one file per camera.
//!
//! Frames come at a constant rate, in the order in which steps arrive: one per step, or, with seconds per time unit S given,
//! step i from frame `round(fps·S·(t_i − t_0))` to the next step's: repeated, or left out where both fall on one frame. A
//! step that is followed by a time that is missing, repeats or goes back gets one frame; the last one stays as long as the
//! one before it. Colours are BT.709 in limited range, 4:2:0. An odd
//! width or height grows by one pixel: the last column or row is repeated. A keyframe comes once a second.
//!
//! Until it is finished a movie grows as `movie.partial.mp4`, in fragments of two frames: a run that is killed leaves a file
//! that plays up to there. Finishing packs the frames anew with the index in front, as players and web pages like it
//! best, and removes the fragments.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use image::RgbImage;
use muxide::api::{MuxerBuilder, MuxerError, VideoCodec};
use muxide::codec::h264::{annexb_to_avcc, extract_avc_config};
use muxide::fragmented::{FragmentConfig, FragmentedMuxer};
use openh264::encoder::{
    BitRate, Complexity, Encoder, EncoderConfig, FrameRate, FrameType, IntraFramePeriod, QpRange, RateControlMode,
    VuiConfig,
};
use openh264::formats::YUVSlices;
use openh264::{OpenH264API, Timestamp};

use super::template::Template;
use super::yuv::Yuv;
use super::{Output, Sink, SinkOptions};
use crate::error::{Error, Result};
use crate::whole::{folder_of, partial_name, write_whole};

/// Writes one movie per camera.
pub(super) struct Mp4 {
    template: Template,
    options: SinkOptions,
    movies: BTreeMap<String, Movie>,
    pace: Pace,
}

/// Frames that one step may stand for: an hour at 30 frames a second.
const LONGEST: u64 = 108_000;

/// Which frames show a step.
#[derive(Default)]
struct Pace {
    /// Frames for a unit of time; `None` gives each step one.
    rate: Option<f64>,
    /// Time of the step in hand, and where it begins, in frames.
    last: Option<(Option<f64>, f64)>,
    /// How long the step before it stayed.
    stayed: u64,
    /// Steps without a frame.
    skipped: u64,
}

impl Pace {
    /// Frames of the step in hand, now that the time of the next one is known; 0 before the first step.
    fn next(&mut self, time: Option<f64>) -> Result<u64> {
        let Some((before, begun)) = self.last else {
            self.last = Some((time, 0.0));
            return Ok(0);
        };
        let apart = before.zip(time).map(|(a, b)| b - a).filter(|d| *d > 0.0 && d.is_finite());
        let length = apart.zip(self.rate).map_or(1.0, |(d, rate)| d * rate);
        let ends = begun + length;
        let frames = ends.round() - begun.round();
        if frames > LONGEST as f64 {
            let found = format!("a step would stay for {frames} frames");
            return Err(Error::scene("movie.seconds_per_time_unit", found + ": give fewer seconds per time unit"));
        }
        self.last = Some((time, ends));
        self.stayed = frames as u64;
        self.skipped += u64::from(self.stayed == 0);
        Ok(self.stayed)
    }
}

impl Mp4 {
    pub(super) fn new(template: Template, options: SinkOptions) -> Result<Self> {
        let SinkOptions { fps, quality, .. } = options;
        if !(fps > 0.0 && fps <= 1000.0) {
            return Err(Error::scene(
                "movie.fps",
                format!("{fps} frames per second: give a number above 0, up to 1000"),
            ));
        }
        if quality > 51 {
            return Err(Error::scene("movie.quality", format!("{quality}: give 0 (best) to 51")));
        }
        let rate = options.seconds_per_time_unit.map(|seconds| seconds * fps);
        Ok(Mp4 { template, options, movies: BTreeMap::new(), pace: Pace { rate, ..Pace::default() } })
    }
}

impl Sink for Mp4 {
    fn write(&mut self, output: &Output) -> Result<()> {
        let due = self.pace.next(output.time)?;
        for view in &output.frames {
            let picture = self.options.picture(output, view);
            let movie = match self.movies.get_mut(&view.camera) {
                Some(movie) => movie,
                None => {
                    let path = self.template.path(output.step, &view.camera);
                    let movie = Movie::new(path, &picture, &self.options)?;
                    self.movies.entry(view.camera.clone()).or_insert(movie)
                }
            };
            if self.pace.rate.is_none() {
                movie.add(&picture, 1)?;
                continue;
            }
            // A step's picture is held back until the next one's time tells how long it stays.
            if let Some(held) = movie.held.replace(picture) {
                movie.add(&held, due)?;
            }
        }
        Ok(())
    }

    fn wants_layers(&self) -> bool {
        false
    }

    fn finish(&mut self) -> Result<()> {
        let stayed = self.pace.stayed.max(1);
        let last = |m: &mut Movie| m.held.take().map_or(Ok(()), |held| m.add(&held, stayed));
        let added: Vec<_> = self.movies.values_mut().map(last).collect();
        if self.pace.skipped > 0 {
            tracing::warn!(
                "{} steps fall on the same frame as the next one and are not in the movie; --fps or \
                 --seconds-per-time-unit spreads them",
                self.pace.skipped
            );
        }
        // Every camera's movie is finished, whatever became of the others.
        let results: Vec<_> = std::mem::take(&mut self.movies).into_values().map(Movie::finish).collect();
        added.into_iter().chain(results).collect()
    }
}

/// A movie that is being made.
struct Movie {
    path: PathBuf,
    size: [u32; 2],
    fps: f64,
    encoder: Encoder,
    frames: Vec<Encoded>,
    fragments: Option<Fragments>,
    /// The picture of the step in hand, while it is not known how long it stays.
    held: Option<RgbImage>,
}

/// An encoded frame.
struct Encoded {
    keyframe: bool,
    bytes: Place,
}

/// Where an encoded frame is: a simulation may run for weeks, and its movie must not fill the memory.
enum Place {
    /// In the fragments, as length-prefixed units.
    File { at: u64, length: usize },
    /// In memory as the encoder gave it, until its fragment is on disk.
    Memory(Vec<u8>),
}

impl Movie {
    fn new(path: PathBuf, first: &RgbImage, options: &SinkOptions) -> Result<Self> {
        let size = [first.width(), first.height()];
        let (long, short) = (size[0].max(size[1]), size[0].min(size[1]));
        if long > 3840 || !(16..=2160).contains(&short) {
            return Err(Error::Unsupported(format!(
                "{}: a movie of {}x{}: H.264 here takes 16x16 to 3840x2160 or 2160x3840\n  try: --size 3840x2160, or PNG frames",
                path.display(),
                size[0],
                size[1]
            )));
        }
        // Constant quality: without scene changes this mode of rate control takes the quantiser from its range alone, skips
        // no frame, and the bit rate, which may not be 0, is without effect. Quantisers below 12 are taken as 12.
        // Background detection and adaptive quantisation save bits where a webcam's viewer does not look.
        let config = EncoderConfig::new()
            .rate_control_mode(RateControlMode::Bufferbased)
            .scene_change_detect(false)
            .bitrate(BitRate::from_bps(20_000_000))
            .qp(QpRange::new(options.quality.max(1), options.quality.max(1)))
            .max_frame_rate(FrameRate::from_hz(options.fps as f32))
            .intra_frame_period(IntraFramePeriod::from_num_frames(options.fps.round().max(1.0) as u32))
            .skip_frames(false)
            .adaptive_quantization(false)
            .background_detection(false)
            .complexity(Complexity::High)
            .vui(VuiConfig::bt709());
        let encoder = Encoder::with_api_config(OpenH264API::from_source(), config)
            .map_err(|e| encoding(&path, &e.to_string()))?;
        Ok(Movie { path, size, fps: options.fps, encoder, frames: vec![], fragments: None, held: None })
    }

    /// Adds a picture as so many frames.
    fn add(&mut self, picture: &RgbImage, frames: u64) -> Result<()> {
        if [picture.width(), picture.height()] != self.size {
            let found = format!("a frame of {}x{} after frames of {:?}", picture.width(), picture.height(), self.size);
            return Err(Error::format(&self.path, found, "one --size for all steps of a movie"));
        }
        let yuv = Yuv::from_rgb(picture);
        (0..frames).try_for_each(|_| self.encode(&yuv))
    }

    fn encode(&mut self, yuv: &Yuv) -> Result<()> {
        let [w, h] = yuv.size;
        let planes = YUVSlices::new((&yuv.y, &yuv.u, &yuv.v), (w, h), (w, w / 2, w / 2));
        let milliseconds = (1000.0 * self.frames.len() as f64 / self.fps).round() as u64;
        let encoded = self
            .encoder
            .encode_at(&planes, Timestamp::from_millis(milliseconds))
            .map_err(|e| encoding(&self.path, &e.to_string()))?;
        let keyframe = matches!(encoded.frame_type(), FrameType::IDR | FrameType::I);
        let bytes = encoded.to_vec();
        if bytes.is_empty() {
            return Err(encoding(&self.path, "the encoder left a frame out"));
        }
        if self.fragments.is_none() {
            self.fragments = Some(Fragments::new(&self.path, [w as u32, h as u32], self.fps, &bytes)?);
        }
        let fragments = self.fragments.as_mut().expect("made above");
        let added = fragments.add(&bytes, keyframe);
        // In memory the frame is safe even when the disk was full for its fragment.
        self.frames.push(Encoded { keyframe, bytes: Place::Memory(bytes) });
        let latest = self.frames.iter_mut().rev();
        for (frame, (at, length)) in latest.zip(added?.into_iter().rev()) {
            frame.bytes = Place::File { at, length };
        }
        Ok(())
    }

    fn finish(self) -> Result<()> {
        let Some(mut fragments) = self.fragments else { return Ok(()) };
        let packed = write_whole(&self.path, |file| {
            let [w, h] = fragments.size;
            let failed = |e: MuxerError| match e {
                MuxerError::Io(e) => Error::io(&self.path, e),
                e => encoding(&self.path, &e.to_string()),
            };
            let mut muxer = MuxerBuilder::new(file).video(VideoCodec::H264, w, h, self.fps).build().map_err(failed)?;
            for (n, Encoded { keyframe, bytes }) in self.frames.into_iter().enumerate() {
                let bytes = match bytes {
                    Place::Memory(bytes) => bytes,
                    Place::File { at, length } => fragments.read(at, length)?,
                };
                muxer.write_video(n as f64 / self.fps, &bytes, keyframe).map_err(failed)?;
            }
            muxer.finish().map_err(failed)
        });
        match packed {
            Ok(()) => fragments.remove(),
            // No room for a second copy, or more than the 4 GiB of a plain MP4: the fragments play as well.
            Err(e) => fragments.keep(&self.path, e),
        }
    }
}

fn encoding(path: &Path, reason: &str) -> Error {
    Error::format(path, format!("encoding failed: {reason}"), "PNG frames: --out frame_{step:06}.png")
}

/// A fragmented MP4 beside the movie.
struct Fragments {
    path: PathBuf,
    size: [u32; 2],
    file: File,
    muxer: FragmentedMuxer,
    added: u64,
    /// Frames in the file.
    written: u64,
    /// Lengths of the frames that are not, as they will be there.
    waiting: Vec<usize>,
    /// A write failed: what would follow has no place.
    broken: bool,
}

impl Fragments {
    /// Media ticks of a frame.
    const TICKS: u64 = 1000;

    /// `first` is the first encoded frame, which carries the parameter sets.
    fn new(movie: &Path, size: [u32; 2], fps: f64, first: &[u8]) -> Result<Self> {
        let path = partial_name(movie);
        let sets = extract_avc_config(first).ok_or_else(|| encoding(movie, "no parameter sets in the first frame"))?;
        let mut config = FragmentConfig::new(size[0], size[1], (fps * Self::TICKS as f64).round() as u32);
        (config.sps, config.pps) = (sets.sps, sets.pps);
        let mut muxer = FragmentedMuxer::new(config).map_err(|e| encoding(movie, &e.to_string()))?;
        let folder = folder_of(&path);
        std::fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, e))?;
        let file = File::options().create(true).truncate(true).read(true).write(true).open(&path);
        let mut file = file.map_err(|e| Error::io(&path, e))?;
        if let Err(e) = file.write_all(&muxer.init_segment()) {
            let _ = std::fs::remove_file(&path);
            return Err(Error::io(path, e));
        }
        Ok(Fragments { path, size, file, muxer, added: 0, written: 0, waiting: vec![], broken: false })
    }

    /// Adds a frame. Where this completes a fragment: the places of its frames in the file.
    fn add(&mut self, bytes: &[u8], keyframe: bool) -> Result<Vec<(u64, usize)>> {
        let at = self.added * Self::TICKS;
        let units = annexb_to_avcc(bytes);
        self.muxer.write_video(at, at, &units, keyframe).map_err(|e| encoding(&self.path, &e.to_string()))?;
        self.added += 1;
        self.waiting.push(units.len());
        // The muxer takes a frame's duration from the next one's time: a fragment needs two.
        if self.added - self.written >= 2 { self.flush() } else { Ok(vec![]) }
    }

    fn flush(&mut self) -> Result<Vec<(u64, usize)>> {
        let Some(segment) = self.muxer.flush_segment() else { return Ok(vec![]) };
        let lengths = std::mem::take(&mut self.waiting);
        if self.broken {
            return Ok(vec![]);
        }
        let at = self.file.stream_position().map_err(|e| Error::io(&self.path, e))?;
        if let Err(e) = self.file.write_all(&segment) {
            // Half a fragment would be the end of the movie for some players.
            self.broken = true;
            let _ = self.file.set_len(at);
            return Err(Error::io(&self.path, e));
        }
        self.written = self.added;
        // A fragment ends with its frames, one after the other.
        let mut from = at + segment.len() as u64 - lengths.iter().sum::<usize>() as u64;
        let place = |length| {
            from += length as u64;
            (from - length as u64, length)
        };
        Ok(lengths.into_iter().map(place).collect())
    }

    /// A frame from the file, as the encoder gave it.
    fn read(&mut self, at: u64, length: usize) -> Result<Vec<u8>> {
        let mut bytes = vec![0; length];
        let read = self.file.seek(SeekFrom::Start(at)).and_then(|_| self.file.read_exact(&mut bytes));
        read.map_err(|e| Error::io(&self.path, e))?;
        let mut unit = 0;
        while let Some(prefix) = bytes.get_mut(unit..unit + 4) {
            let length = u32::from_be_bytes([prefix[0], prefix[1], prefix[2], prefix[3]]);
            prefix.copy_from_slice(&[0, 0, 0, 1]);
            unit += 4 + length as usize;
        }
        Ok(bytes)
    }

    fn remove(self) -> Result<()> {
        std::fs::remove_file(&self.path).map_err(|e| Error::io(&self.path, e))
    }

    /// Makes the fragments the movie, because packing failed for `reason`.
    fn keep(mut self, movie: &Path, reason: Error) -> Result<()> {
        // Reading has moved the place at which the last frame goes.
        let flushed = self.file.seek(SeekFrom::End(0)).map_err(|e| Error::io(&self.path, e)).and_then(|_| self.flush());
        if self.written == 0 {
            self.remove()?;
            return Err(reason);
        }
        std::fs::rename(&self.path, movie).map_err(|e| Error::io(movie, e))?;
        flushed?;
        tracing::warn!("{reason}; {} keeps its {} frames in fragments, which plays", movie.display(), self.written);
        Ok(())
    }
}
