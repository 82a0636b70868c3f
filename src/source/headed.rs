//! Files that tell in a header of their own what their numbers mean: one or more arrays each, one or more steps.

use std::io::Read;
use std::path::Path;
use std::sync::Arc;

use super::choose::choose;
use super::expand::Files;
use super::raw::{Bytes, RawSpec, describe, values};
use super::series::{Plan, Step};
use super::values::Values;
use super::{Candidate, GridInfo, SeriesInfo, SourceSpec};
use crate::error::{Error, Result};

/// What a header says of one array.
pub(crate) struct Header {
    pub field: String,
    pub raw: RawSpec,
    pub bytes: Bytes,
    pub grid: GridInfo,
    pub time: Option<f64>,
    pub warnings: Vec<String>,
}

/// Plans a series of files with headers; `read` reads one file's.
pub(crate) fn plan(
    files: &Files,
    spec: &SourceSpec,
    layout: &str,
    read: impl Fn(&Path) -> Result<Vec<Header>>,
) -> Result<Plan> {
    let asked = files.dataset.as_deref().or(spec.field.as_deref());
    let mut steps: Vec<Step> = Vec::new();
    let mut info: Option<SeriesInfo> = None;
    let mut failed = None;
    for entry in &files.entries {
        let header = read(&entry.path).and_then(|mut headers| {
            let candidates: Vec<Candidate> = headers.iter().map(|h| candidate(h, layout, files)).collect();
            let index = match (candidates.len(), asked) {
                // The only array of a file may bear the file's name: what was asked for is this one.
                (1, _) => 0,
                _ => choose(&entry.path, &candidates, asked)?,
            };
            Ok((headers.swap_remove(index), candidates))
        });
        let next = steps.len() as u64;
        let (header, candidates) = match header {
            Ok(found) => found,
            Err(Error::Format { path, found, remedy }) if files.entries.len() > 1 => {
                let values = Values::Broken(path.clone(), found.clone(), remedy.clone());
                steps.push(Step { step: entry.number.unwrap_or(next), time: entry.decimal, grid: None, values });
                failed = failed.or(Some(Error::Format { path, found, remedy }));
                continue;
            }
            Err(why) => return Err(why),
        };
        let count = header.raw.steps.unwrap_or(1);
        believable(&header, count)?;
        for index in 0..count {
            let next = steps.len() as u64;
            let step = if count == 1 { entry.number.unwrap_or(next) } else { next };
            let values = values(&header.raw, header.bytes.clone(), index, count, spec)?;
            let time = header.time.or(entry.decimal);
            steps.push(Step { step, time, grid: Some(header.grid.clone()), values });
        }
        info.get_or_insert_with(|| SeriesInfo {
            field: header.field.clone(),
            candidates,
            grid: header.grid.clone(),
            ..describe(&header.raw, layout, files, header.warnings.clone())
        });
    }
    match (info, failed) {
        (Some(mut info), failed) => {
            info.warnings.extend(failed.map(|why| format!("a step will fail: {why}")));
            Ok(Plan { info, steps, start: 0.0 })
        }
        (None, Some(why)) => Err(why),
        (None, None) => Err(Error::format("", "no files", "a file, a folder or a pattern")),
    }
}

/// Refuses a number of steps so far beyond what the file can hold that it is no file that was cut short.
fn believable(header: &Header, count: usize) -> Result<()> {
    const LOST: u64 = 1 << 16;
    let path = header.bytes.path();
    let length = std::fs::metadata(path).map_or(0, |about| about.len());
    // No coding that is read packs more than 1032 bytes into one.
    let most = if matches!(header.bytes, Bytes::File(_)) { length } else { length.saturating_mul(1032) };
    let held = most / header.raw.step_bytes().unwrap_or(u64::MAX).max(1);
    if count as u64 <= held.saturating_add(LOST) {
        return Ok(());
    }
    let found = format!("its header claims {count} steps, but there are {length} bytes of values");
    Err(Error::format(path, found, "the complete file"))
}

fn candidate(header: &Header, layout: &str, files: &Files) -> Candidate {
    let described = describe(&header.raw, layout, files, Vec::new()).candidates.swap_remove(0);
    Candidate { name: header.field.clone(), ..described }
}

/// Bytes compressed from byte `skip` of a file on: gzip, or zlib. No more are unpacked than are `expected`.
pub(crate) fn compressed(path: &Path, skip: u64, gzip: bool, expected: u64) -> Bytes {
    let from = path.to_owned();
    let decode = move || -> Result<Vec<u8>> {
        let fail = |e: std::io::Error| Error::format(&from, format!("its compressed values are damaged ({e})"), "");
        let mut file = std::fs::File::open(&from).map_err(|e| Error::io(&from, e))?;
        std::io::Seek::seek(&mut file, std::io::SeekFrom::Start(skip)).map_err(|e| Error::io(&from, e))?;
        let mut bytes = Vec::new();
        if gzip {
            flate2::read::MultiGzDecoder::new(file).take(expected).read_to_end(&mut bytes).map_err(fail)?;
        } else {
            flate2::read::ZlibDecoder::new(file).take(expected).read_to_end(&mut bytes).map_err(fail)?;
        }
        Ok(bytes)
    };
    Bytes::Decoded(path.to_owned(), Arc::new(decode))
}

/// Numbers as text, brought to f64le; no more than `expected`.
pub(crate) fn text_numbers(text: &str, expected: usize, path: &Path) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    for word in text.split_whitespace().take(expected) {
        let wrong = |_| Error::format(path, format!("`{word}` among its values is not a number"), "");
        bytes.extend_from_slice(&word.parse::<f64>().map_err(wrong)?.to_le_bytes());
    }
    Ok(bytes)
}

/// The first bytes of a file, at most a mebibyte: where headers are.
pub(crate) fn head(path: &Path) -> Result<Vec<u8>> {
    if let Some(problem) = super::file_problem(path) {
        return Err(problem);
    }
    let mut bytes = Vec::new();
    let file = std::fs::File::open(path).map_err(|e| Error::io(path, e))?;
    file.take(1 << 20).read_to_end(&mut bytes).map_err(|e| Error::io(path, e))?;
    Ok(bytes)
}

/// Bytes that an array needs; an error when they cannot be counted.
pub(crate) fn expected(raw: &RawSpec, path: &Path) -> Result<u64> {
    let bytes = raw.step_bytes().and_then(|b| b.checked_mul(raw.steps.unwrap_or(1) as u64));
    bytes.ok_or_else(|| Error::format(path, "its header claims more values than can be counted", ""))
}

/// Where a file that a header names lies: beside the header.
pub(crate) fn beside(header: &Path, name: &str) -> std::path::PathBuf {
    header.parent().unwrap_or(Path::new("")).join(name)
}
