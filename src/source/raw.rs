//! Headerless files: shape, element type, offset and axis order come from the settings.
//!
//! Values are read with positioned reads, not from a memory map: a file that shrinks while it is mapped ends the
//! process, one that is read ends in an error.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use super::axes::Axes;
use super::choose::component;
use super::expand::Files;
use super::series::{Plan, Step};
use super::values::Values;
use super::{Candidate, GridInfo, SeriesInfo, SourceSpec, file_problem, shape_text};
use crate::error::{Error, Result};
use crate::field::Field;
use crate::grid::Region;

/// Type of a stored number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F16,
    F32,
    F64,
}

/// Type and byte order of a stored number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Dtype {
    pub kind: Kind,
    pub big_endian: bool,
}

impl Dtype {
    /// Reads `f64le`, `u8`, `i16be`, `float32`, `f4`-like names are not taken: sizes are in bits.
    pub fn parse(text: &str) -> Option<Dtype> {
        let lower = text.to_ascii_lowercase();
        let (name, big_endian) = match (lower.strip_suffix("be"), lower.strip_suffix("le")) {
            (Some(name), _) => (name, true),
            (_, Some(name)) => (name, false),
            _ => (lower.as_str(), false),
        };
        let kind = match name {
            "u8" | "uint8" => Kind::U8,
            "i8" | "int8" => Kind::I8,
            "u16" | "uint16" => Kind::U16,
            "i16" | "int16" => Kind::I16,
            "u32" | "uint32" => Kind::U32,
            "i32" | "int32" => Kind::I32,
            "u64" | "uint64" => Kind::U64,
            "i64" | "int64" => Kind::I64,
            "f16" | "float16" | "half" => Kind::F16,
            "f32" | "float32" | "float" => Kind::F32,
            "f64" | "float64" | "double" => Kind::F64,
            _ => return None,
        };
        Some(Dtype { kind, big_endian })
    }

    /// Bytes of one number.
    pub fn bytes(self) -> usize {
        match self.kind {
            Kind::U8 | Kind::I8 => 1,
            Kind::U16 | Kind::I16 | Kind::F16 => 2,
            Kind::U32 | Kind::I32 | Kind::F32 => 4,
            Kind::U64 | Kind::I64 | Kind::F64 => 8,
        }
    }

    /// `f64le`.
    pub fn name(self) -> String {
        let kind = format!("{:?}", self.kind).to_lowercase();
        match (self.bytes(), self.big_endian) {
            (1, _) => kind,
            (_, true) => kind + "be",
            (_, false) => kind + "le",
        }
    }

    /// Decodes every `stride`-th number of `bytes`.
    fn decode<T>(self, bytes: &[u8], stride: usize, out: &mut [T], narrow: impl Fn(f64) -> T) {
        macro_rules! each {
            ($t:ty, $wide:expr) => {{
                const N: usize = size_of::<$t>();
                for (o, at) in out.iter_mut().zip((0..).step_by(stride * N)) {
                    let mut number = [0; N];
                    number.copy_from_slice(&bytes[at..at + N]);
                    let value = if self.big_endian { <$t>::from_be_bytes(number) } else { <$t>::from_le_bytes(number) };
                    *o = narrow($wide(value));
                }
            }};
        }
        match self.kind {
            Kind::U8 => each!(u8, f64::from),
            Kind::I8 => each!(i8, f64::from),
            Kind::U16 => each!(u16, f64::from),
            Kind::I16 => each!(i16, f64::from),
            Kind::U32 => each!(u32, f64::from),
            Kind::I32 => each!(i32, f64::from),
            Kind::U64 => each!(u64, |v| v as f64),
            Kind::I64 => each!(i64, |v| v as f64),
            Kind::F16 => each!(half::f16, f64::from),
            Kind::F32 => each!(f32, f64::from),
            Kind::F64 => each!(f64, |v| v),
        }
    }
}

/// A whole file in memory (what came out of a compressed one), or one that is read where it lies.
#[derive(Debug, Clone)]
pub(crate) enum Bytes {
    File(PathBuf),
    Memory(PathBuf, Arc<Vec<u8>>),
}

impl Bytes {
    fn path(&self) -> &Path {
        match self {
            Bytes::File(path) | Bytes::Memory(path, _) => path,
        }
    }
}

/// An array of three axes inside a file.
#[derive(Debug, Clone)]
pub(crate) struct Slab {
    pub bytes: Bytes,
    /// Byte at which value (0, 0, 0) is.
    pub offset: u64,
    pub dtype: Dtype,
    /// Numbers from one value to the next along x, y, z.
    pub strides: [usize; 3],
    pub size: [usize; 3],
    /// `stored·scale + intercept`.
    pub scale: [f64; 2],
}

impl Slab {
    /// Byte after the last number.
    fn end(&self) -> Option<u64> {
        let last = (0..3).try_fold(0u64, |at, a| {
            (self.size[a] as u64).checked_sub(1)?.checked_mul(self.strides[a] as u64)?.checked_add(at)
        })?;
        last.checked_add(1)?.checked_mul(self.dtype.bytes() as u64)?.checked_add(self.offset)
    }

    /// Opens the file and checks that it is long enough.
    pub fn open(&self, size: [usize; 3]) -> Result<RawField> {
        let path = self.bytes.path();
        if size != self.size {
            let found = format!("the grid changes from {} to {}", shape_text(&size), shape_text(&self.size));
            return Err(Error::format(path, found, "--steps A..B for the steps that agree"));
        }
        let (file, length) = match &self.bytes {
            Bytes::Memory(_, bytes) => (None, bytes.len() as u64),
            Bytes::File(path) => {
                if let Some(problem) = file_problem(path) {
                    return Err(problem);
                }
                let file = File::open(path).map_err(|e| Error::io(path, e))?;
                let length = file.metadata().map_err(|e| Error::io(path, e))?.len();
                (Some(Mutex::new(file)), length)
            }
        };
        let end = self.end().unwrap_or(u64::MAX);
        if end > length {
            let found = format!("this step ends at byte {end}, but the file has {length} bytes");
            return Err(Error::format(path, found, "the complete file, or other dims, dtype, offset or steps"));
        }
        Ok(RawField { slab: self.clone(), file })
    }
}

/// An open [`Slab`].
pub(crate) struct RawField {
    slab: Slab,
    file: Option<Mutex<File>>,
}

impl RawField {
    fn bytes(&self, from: u64, length: usize, buffer: &mut Vec<u8>) -> Result<()> {
        let slab = &self.slab;
        match (&slab.bytes, &self.file) {
            (Bytes::Memory(_, all), _) => {
                buffer.clear();
                buffer.extend_from_slice(&all[from as usize..from as usize + length]);
                Ok(())
            }
            (Bytes::File(path), Some(file)) => {
                buffer.resize(length, 0);
                let mut file = file.lock().unwrap_or_else(|e| e.into_inner());
                let read = file.seek(SeekFrom::Start(from)).and_then(|_| file.read_exact(buffer));
                read.map_err(|e| Error::io(path, e))
            }
            (Bytes::File(path), None) => Err(Error::format(path, "the file is not open", "")),
        }
    }

    /// Reads one plane across the slowest axis at a time: all that the region needs of it in one piece.
    fn read_as<T: Copy>(&self, region: Region, out: &mut [T], narrow: impl Fn(f64) -> T) -> Result<()> {
        let Slab { strides, dtype, offset, scale, .. } = &self.slab;
        let (number, [scale, intercept]) = (dtype.bytes(), *scale);
        let slowest = (0..3).max_by_key(|&a| strides[a]).unwrap_or(2);
        let [inner, outer] = match slowest {
            2 => [0, 1],
            1 => [0, 2],
            _ => [1, 2],
        };
        let narrow = |v: f64| narrow(v * scale + intercept);
        let (mut buffer, mut row) = (Vec::new(), vec![narrow(0.0); region.size[inner]]);
        let along = |a: usize, n: usize| n * strides[a];
        let span = along(inner, region.size[inner] - 1) + along(outer, region.size[outer] - 1) + 1;
        let [nx, ny, _] = region.size;
        let steps = [1, nx, nx * ny];
        for s in 0..region.size[slowest] {
            let first = along(slowest, region.start[slowest] + s)
                + along(inner, region.start[inner])
                + along(outer, region.start[outer]);
            self.bytes(offset + (first * number) as u64, span * number, &mut buffer)?;
            for o in 0..region.size[outer] {
                dtype.decode(&buffer[along(outer, o) * number..], strides[inner], &mut row, narrow);
                let at = s * steps[slowest] + o * steps[outer];
                for (i, value) in row.iter().enumerate() {
                    out[at + i * steps[inner]] = *value;
                }
            }
        }
        Ok(())
    }
}

impl Field for RawField {
    fn read(&self, region: Region, out: &mut [f32]) -> Result<()> {
        if region.is_empty() { Ok(()) } else { self.read_as(region, out, |v| v as f32) }
    }

    fn read_f64(&self, region: Region, out: &mut [f64]) -> Result<()> {
        if region.is_empty() { Ok(()) } else { self.read_as(region, out, |v| v) }
    }
}

/// What `--raw` says.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct RawSpec {
    pub size: [usize; 3],
    pub dtype: Dtype,
    pub offset: u64,
    /// Axes of one file, slowest first.
    pub order: Axes,
    pub components: usize,
    /// Steps in each file; as many as fit when absent.
    pub steps: Option<usize>,
    /// Bytes between the end of one step and the start of the next.
    pub gap: u64,
    /// Physical time of step 0.
    pub start: f64,
}

const EXAMPLE: &str = "--raw 'dims=96x96x96,dtype=f32le,offset=0,order=zyx,steps=12' (dims along x, y, z; order slowest \
                       axis first; also components, gap: bytes between steps, start: time of the first step)";

impl RawSpec {
    /// Reads `dims=32x32x32,dtype=f64le,offset=24,order=zyx,steps=12`.
    pub fn parse(text: &str) -> Result<RawSpec> {
        let fail = |why: String| Error::format(format!("--raw '{text}'"), why, EXAMPLE);
        let (mut size, mut dtype, mut order) = (None, None, String::from("zyx"));
        let (mut offset, mut gap, mut components, mut steps, mut start) = (0, 0, 1, None, 0.0);
        for pair in text.split([',', ';']).map(str::trim).filter(|p| !p.is_empty()) {
            let Some((key, value)) = pair.split_once('=') else { return Err(fail(format!("`{pair}` lacks an `=`"))) };
            let (key, value) = (key.trim(), value.trim());
            let wrong = || fail(format!("{key}={value} is not understood"));
            match key {
                "dims" => {
                    let dims: Vec<usize> = value
                        .split(['x', 'X', '*'])
                        .map(|n| n.trim().parse())
                        .collect::<Result<_, _>>()
                        .map_err(|_| wrong())?;
                    size = Some(
                        <[usize; 3]>::try_from(dims).map_err(|_| fail(format!("dims={value} needs three lengths")))?,
                    );
                }
                "dtype" => dtype = Some(Dtype::parse(value).ok_or_else(wrong)?),
                "order" => order = value.to_owned(),
                "offset" => offset = value.parse().map_err(|_| wrong())?,
                "gap" => gap = value.parse().map_err(|_| wrong())?,
                "components" => components = value.parse().ok().filter(|n| *n > 0).ok_or_else(wrong)?,
                "steps" => steps = Some(value.parse().ok().filter(|n| *n > 0).ok_or_else(wrong)?),
                "start" => start = value.parse().map_err(|_| wrong())?,
                _ => {
                    let keys = ["dims", "dtype", "offset", "order", "steps", "components", "gap", "start"];
                    let near = keys
                        .iter()
                        .max_by(|a, b| strsim::jaro_winkler(a, key).total_cmp(&strsim::jaro_winkler(b, key)));
                    return Err(fail(format!("unknown key `{key}`; the nearest is `{}`", near.unwrap_or(&"dims"))));
                }
            }
        }
        let size = size.ok_or_else(|| fail("dims is missing".into()))?;
        let dtype = dtype.ok_or_else(|| fail("dtype is missing".into()))?;
        if size.contains(&0) {
            return Err(fail("dims has a zero".into()));
        }
        let spelled = if components > 1 && !order.contains('c') { order.clone() + "c" } else { order.clone() };
        let order = Axes::parse(&spelled).map_err(|why| fail(format!("order={order}: {why}")))?;
        Ok(RawSpec { size, dtype, offset, order, components, steps, gap, start })
    }

    /// Bytes of one step; `None` when they cannot be counted.
    pub fn step_bytes(&self) -> Option<u64> {
        let lengths = self.size.iter().chain([&self.components]);
        lengths.map(|&n| n as u64).chain([self.dtype.bytes() as u64]).try_fold(1u64, u64::checked_mul)
    }
}

/// Plans a series of headerless files.
pub(crate) fn plan(files: &Files, text: &str, spec: &SourceSpec) -> Result<Plan> {
    let mut raw = RawSpec::parse(text)?;
    if let Some(axes) = &spec.axes {
        raw.order = Axes::parse(axes).map_err(|why| Error::format(format!("--axes {axes}"), why, "--axes zyx"))?;
    }
    let mut warnings = Vec::new();
    let mut steps: Vec<Step> = Vec::new();
    for entry in &files.entries {
        let count = count(&raw, &entry.path, &mut warnings)?;
        for index in 0..count {
            let next = steps.len() as u64;
            let step = if count == 1 && files.entries.len() > 1 { entry.number.unwrap_or(next) } else { next };
            let bytes = Bytes::File(entry.path.clone());
            steps.push(Step { step, time: None, grid: None, values: values(&raw, bytes, index, count, spec)? });
        }
    }
    let info = describe(&raw, "raw", files, warnings);
    Ok(Plan { info, steps, start: raw.start })
}

/// What to tell of a headerless series.
fn describe(raw: &RawSpec, layout: &str, files: &Files, warnings: Vec<String>) -> SeriesInfo {
    let mut shape = vec![raw.components; raw.order.rank() - usize::from(raw.order.time.is_some())];
    let spelled: String = raw.order.spelled().chars().filter(|c| *c != 't').collect();
    for (place, letter) in spelled.chars().enumerate() {
        if let Some(a) = "xyz".find(letter) {
            shape[place] = raw.size[a];
        }
    }
    let field = files
        .entries
        .first()
        .and_then(|e| e.path.file_stem())
        .map_or("values".into(), |s| s.to_string_lossy().into_owned());
    let kind = if raw.components > 1 { "vector" } else { "scalar" };
    SeriesInfo {
        layout: layout.into(),
        series: files.entries.iter().map(|e| e.path.clone()).collect(),
        candidates: vec![Candidate { name: field.clone(), shape, dtype: raw.dtype.name(), kind: kind.into() }],
        field,
        grid: GridInfo {
            size: raw.size,
            spacing: [1.0; 3],
            origin: [0.0; 3],
            units: String::new(),
            centering: "node".into(),
        },
        steps: Vec::new(),
        range: None,
        warnings,
    }
}

/// Steps in a file, by its length.
fn count(raw: &RawSpec, path: &Path, warnings: &mut Vec<String>) -> Result<usize> {
    if let Some(problem) = file_problem(path) {
        return Err(problem);
    }
    let length = std::fs::metadata(path).map_err(|e| Error::io(path, e))?.len();
    let size = shape_text(&raw.size);
    let Some(bytes) = raw.step_bytes() else {
        let found =
            format!("a step of {size} {} has more bytes than can be counted; the file has {length}", raw.dtype.name());
        return Err(Error::format(path, found, EXAMPLE));
    };
    let each = bytes.saturating_add(raw.gap);
    let there = length.saturating_sub(raw.offset);
    let fit = there.saturating_add(raw.gap) / each;
    let wanted = raw.steps.unwrap_or(fit.max(1) as usize) as u64;
    let needed = each.saturating_mul(wanted).saturating_sub(raw.gap).saturating_add(raw.offset);
    if needed > length {
        let found = format!(
            "{wanted} steps of {size} {} after {} bytes need {needed} bytes, but the file has {length}",
            raw.dtype.name(),
            raw.offset
        );
        return Err(Error::format(path, found, format!("steps={fit}, or other dims, dtype or offset in --raw")));
    }
    if needed < length {
        let rest = length - needed;
        if raw.steps.is_none() {
            let found =
                format!("{fit} steps of {bytes} bytes after {} bytes leave {rest} of {length} bytes over", raw.offset);
            return Err(Error::format(path, found, "offset=BYTES, gap=BYTES or steps=N in --raw"));
        }
        warnings.push(format!("{}: {rest} of {length} bytes are not read", path.display()));
    }
    Ok(wanted as usize)
}

/// The values of the `index`-th of `count` steps in a file.
fn values(raw: &RawSpec, bytes: Bytes, index: usize, count: usize, spec: &SourceSpec) -> Result<Values> {
    let step_bytes = raw.step_bytes().unwrap_or(u64::MAX);
    let time_inside = raw.order.time.filter(|&t| t != 0);
    let mut strides = [0; 3];
    let (mut stride, mut between, mut component_stride) = (1usize, 0, 0);
    for axis in (0..raw.order.rank()).rev() {
        if let Some(a) = raw.order.space.iter().position(|&s| s == axis) {
            strides[a] = stride;
            stride *= raw.size[a];
        } else if Some(axis) == raw.order.component {
            component_stride = stride;
            stride *= raw.components;
        } else if Some(axis) == time_inside {
            between = stride;
            stride *= count;
        }
    }
    let start = match time_inside {
        Some(_) => (index * between * raw.dtype.bytes()) as u64,
        None => index as u64 * (step_bytes + raw.gap),
    };
    let name = bytes.path().display().to_string();
    let parts = component(&name, raw.order.component.map(|_| raw.components), spec.component.as_deref())?;
    let part = |c: &Option<usize>| {
        let skip = (c.unwrap_or(0) * component_stride * raw.dtype.bytes()) as u64;
        let offset = raw.offset + start + skip;
        Values::Raw(Slab { bytes: bytes.clone(), offset, dtype: raw.dtype, strides, size: raw.size, scale: [1.0, 0.0] })
    };
    Ok(Values::of(parts.iter().map(part).collect()))
}
