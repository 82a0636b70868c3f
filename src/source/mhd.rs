//! MetaImage: `Key = Value` lines, then raw or zlib values in the same file (`.mha`) or in another (`.mhd`).

use std::path::Path;

use super::GridInfo;
use super::axes::Axes;
use super::headed::{Header, beside, compressed, expected, head};
use super::raw::{Bytes, Dtype, Kind, RawSpec};
use super::xml::numbers;
use crate::error::{Error, Result};

/// Reads the header of a file.
pub(crate) fn read(path: &Path) -> Result<Vec<Header>> {
    let start = head(path)?;
    let fail = |found: String, remedy: &str| Error::format(path, found, remedy);
    let (mut fields, mut length): (Vec<(String, String)>, usize) = (Vec::new(), 0);
    for line in start.split_inclusive(|b| *b == b'\n') {
        length += line.len();
        let line = String::from_utf8_lossy(line);
        let Some((key, value)) = line.split_once('=') else { continue };
        let key = key.trim().to_ascii_lowercase();
        let last = key == "elementdatafile";
        fields.push((key, value.trim().to_owned()));
        if last {
            break;
        }
    }
    let get = |names: &[&str]| {
        let found = names.iter().find_map(|n| fields.iter().find(|(k, _)| k == n));
        found.map(|(_, v)| v.as_str())
    };
    let lengths: Vec<usize> = get(&["dimsize"])
        .and_then(|s| s.split_whitespace().map(|n| n.parse().ok()).collect())
        .ok_or_else(|| fail("MetaImage without DimSize".into(), ""))?;
    let channels: usize = get(&["elementnumberofchannels"]).and_then(|c| c.parse().ok()).unwrap_or(1);
    let (size, steps) = match lengths.as_slice() {
        [x, y, z] => ([*x, *y, *z], 1),
        [x, y, z, t] => ([*x, *y, *z], *t),
        other => return Err(fail(format!("MetaImage of {} axes; 3, or 4 with time, are read", other.len()), "")),
    };
    if size.contains(&0) || steps == 0 || channels == 0 {
        return Err(fail(format!("MetaImage of DimSize {}: no values", get(&["dimsize"]).unwrap_or_default()), ""));
    }
    let name = get(&["elementtype"]).unwrap_or_default();
    let kind = match name.trim_end_matches("_ARRAY") {
        "MET_CHAR" => Kind::I8,
        "MET_UCHAR" => Kind::U8,
        "MET_SHORT" => Kind::I16,
        "MET_USHORT" => Kind::U16,
        "MET_INT" | "MET_LONG" => Kind::I32,
        "MET_UINT" | "MET_ULONG" => Kind::U32,
        "MET_LONG_LONG" => Kind::I64,
        "MET_ULONG_LONG" => Kind::U64,
        "MET_FLOAT" => Kind::F32,
        "MET_DOUBLE" => Kind::F64,
        _ => return Err(fail(format!("MetaImage of ElementType `{name}`, which is not a number"), "")),
    };
    let yes = |names: &[&str]| get(names).is_some_and(|v| v.eq_ignore_ascii_case("true"));
    let dtype = Dtype { kind, big_endian: yes(&["elementbyteordermsb", "binarydatabyteordermsb"]) };
    let spelled = if channels > 1 { "tzyxc" } else { "tzyx" };
    let order = Axes::parse(spelled).map_err(|why| fail(why, ""))?;
    let mut raw =
        RawSpec { size, dtype, offset: 0, order, components: channels, steps: Some(steps), gap: 0, start: 0.0 };
    let need = expected(&raw, path)?;
    let (data, local) = match get(&["elementdatafile"]) {
        None => return Err(fail("MetaImage without ElementDataFile".into(), "")),
        Some("LOCAL") => (path.to_owned(), length as u64),
        Some(name) if name.starts_with("LIST") || name.contains('%') => {
            return Err(fail("MetaImage whose values are spread over several files".into(), "one file per volume"));
        }
        Some(name) => (beside(path, name), 0),
    };
    let skip: i64 = get(&["headersize"]).and_then(|h| h.parse().ok()).unwrap_or(0);
    let bytes = if yes(&["compresseddata"]) {
        compressed(&data, local + skip.max(0) as u64, false, need)
    } else {
        let there = std::fs::metadata(&data).map_err(|e| Error::io(&data, e))?.len();
        raw.offset = if skip < 0 { there.saturating_sub(need) } else { local + skip as u64 };
        Bytes::File(data)
    };
    let triple = |names: &[&str], default: f64| {
        let read = get(names).and_then(numbers).filter(|v| v.len() >= 3);
        read.map_or([default; 3], |v| [v[0], v[1], v[2]])
    };
    let grid = GridInfo {
        size,
        spacing: triple(&["elementspacing", "elementsize"], 1.0),
        origin: triple(&["offset", "origin", "position"], 0.0),
        centering: "node".into(),
        ..GridInfo::default()
    };
    let field = path.file_stem().map_or("values".into(), |s| s.to_string_lossy().into_owned());
    Ok(vec![Header { field, raw, bytes, grid, time: None, warnings: Vec::new() }])
}
