//! Headerless files: shape, element type, offset and axis order come from the settings.

mod slab;

use std::path::Path;

pub(crate) use crate::dtype::{Dtype, Kind};
pub(crate) use slab::{Bytes, Slab};

use super::axes::Axes;
use super::choose::component;
use super::expand::Files;
use super::series::{Plan, Step};
use super::values::Values;
use super::{Candidate, GridInfo, SeriesInfo, SourceSpec, file_problem, shape_text};
use crate::error::{Error, Result};

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
    let (mut warnings, mut failed) = (Vec::new(), None);
    let mut steps: Vec<Step> = Vec::new();
    for entry in &files.entries {
        let next = steps.len() as u64;
        let count = match count(&raw, &entry.path, &mut warnings) {
            Ok(count) => count,
            // One file that was cut short costs its own step, not the others'.
            Err(Error::Format { path, found, remedy }) if files.entries.len() > 1 => {
                let values = Values::Broken(path.clone(), found.clone(), remedy.clone());
                steps.push(Step { step: entry.number.unwrap_or(next), time: None, grid: None, values });
                failed = failed.or(Some(Error::Format { path, found, remedy }));
                continue;
            }
            Err(why) => return Err(why),
        };
        for index in 0..count {
            let next = steps.len() as u64;
            let step = if count == 1 { entry.number.unwrap_or(next) } else { next };
            let bytes = Bytes::File(entry.path.clone());
            steps.push(Step { step, time: None, grid: None, values: values(&raw, bytes, index, count, spec)? });
        }
    }
    match failed {
        Some(why) if steps.iter().all(|s| matches!(s.values, Values::Broken(..))) => return Err(why),
        Some(why) => warnings.push(format!("a step will fail: {why}")),
        None => {}
    }
    let mut info = describe(&raw, "raw", files, warnings);
    info.why.push("--raw".into());
    Ok(Plan { info, steps, start: raw.start })
}

/// What to tell of a headerless series.
pub(crate) fn describe(raw: &RawSpec, layout: &str, files: &Files, warnings: Vec<String>) -> SeriesInfo {
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
        grid: GridInfo { size: raw.size, spacing: [1.0; 3], centering: "node".into(), ..GridInfo::default() },
        warnings,
        ..SeriesInfo::default()
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
    let believable = wanted <= fit.saturating_add(1 << 16);
    if needed > length && fit > 0 && believable && raw.steps.is_some() && raw.order.time.is_none_or(|t| t == 0) {
        warnings.push(format!("{}: {fit} of {wanted} steps are whole; the others will fail", path.display()));
        return Ok(wanted as usize);
    }
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
pub(crate) fn values(raw: &RawSpec, bytes: Bytes, index: usize, count: usize, spec: &SourceSpec) -> Result<Values> {
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
        None => (index as u64).saturating_mul(step_bytes.saturating_add(raw.gap)),
    };
    let name = bytes.path().display().to_string();
    let parts = component(&name, raw.order.component.map(|_| raw.components), spec.component.as_deref())?;
    let part = |c: &Option<usize>| {
        let skip = (c.unwrap_or(0) * component_stride * raw.dtype.bytes()) as u64;
        let offset = raw.offset.saturating_add(start).saturating_add(skip);
        Values::Raw(Slab { bytes: bytes.clone(), offset, dtype: raw.dtype, strides, size: raw.size })
    };
    Ok(Values::of(parts.iter().map(part).collect()))
}
