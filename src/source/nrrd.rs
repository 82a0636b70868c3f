//! NRRD: a text header, and raw, gzip or text values in the same file or in another (`.nhdr`). Sizes run fastest axis
//! first.

use std::path::Path;
use std::sync::Arc;

use super::GridInfo;
use super::axes::Axes;
use super::headed::{Header, beside, compressed, expected, head, text_numbers};
use super::raw::{Bytes, Dtype, Kind, RawSpec};
use super::xml::numbers;
use crate::error::{Error, Result};

/// Reads the header of a file.
pub(crate) fn read(path: &Path) -> Result<Vec<Header>> {
    let start = head(path)?;
    let length = start.windows(2).position(|w| w == b"\n\n").map(|at| at + 2);
    let length =
        length.or_else(|| start.windows(4).position(|w| w == b"\r\n\r\n").map(|at| at + 4)).unwrap_or(start.len());
    let text = String::from_utf8_lossy(&start[..length]).into_owned();
    let fail = |found: String, remedy: &str| Error::format(path, found, remedy);
    let fields: Vec<(String, &str)> = text
        .lines()
        .skip(1)
        .filter(|l| !l.starts_with('#') && !l.contains(":="))
        .filter_map(|l| l.split_once(": "))
        .map(|(k, v)| (k.to_ascii_lowercase().replace(' ', ""), v.trim()))
        .collect();
    let get = |name: &str| fields.iter().find(|(k, _)| k == name).map(|(_, v)| *v);
    let sizes: Vec<usize> = get("sizes")
        .and_then(|s| s.split_whitespace().map(|n| n.parse().ok()).collect())
        .ok_or_else(|| fail("NRRD without sizes".into(), ""))?;
    let kinds: Vec<&str> = get("kinds").unwrap_or_default().split_whitespace().collect();
    let component_first = match kinds.first() {
        Some(kind) => !["domain", "space", "time", "list", "???", "none"].contains(kind),
        None => sizes.first().is_some_and(|n| *n <= 4),
    };
    let (spelled, first, components, steps) = match (sizes.len(), component_first) {
        (3, _) => ("zyx", 0, 1, 1),
        (4, true) => ("zyxc", 1, sizes[0], 1),
        (4, false) => ("tzyx", 0, 1, sizes[3]),
        (n, _) => return Err(fail(format!("NRRD of {n} axes; 3, or 4 with components or time, are read"), "")),
    };
    let size = [sizes[first], sizes[first + 1], sizes[first + 2]];
    let big_endian = get("endian").is_some_and(|e| e.eq_ignore_ascii_case("big"));
    let kind = get("type").unwrap_or_default();
    let dtype = element(kind).map(|kind| Dtype { kind, big_endian });
    let dtype = dtype.ok_or_else(|| fail(format!("NRRD of type `{kind}`, which is not a number"), ""))?;
    if size.contains(&0) || components == 0 || steps == 0 {
        return Err(fail(format!("NRRD of sizes {}: no values", get("sizes").unwrap_or_default()), ""));
    }
    let order = Axes::parse(spelled).map_err(|why| fail(why, ""))?;
    let mut raw = RawSpec { size, dtype, offset: 0, order, components, steps: Some(steps), gap: 0, start: 0.0 };
    let need = expected(&raw, path)?;
    let (data, mut offset) = match get("datafile") {
        None => (path.to_owned(), length as u64),
        Some(name) if name.starts_with("LIST") || name.contains('%') => {
            return Err(fail("NRRD whose values are spread over several files".into(), "unu save -f nrrd -e raw"));
        }
        Some(name) => (beside(path, name), 0),
    };
    let count = |name: &str| get(name).and_then(|v| v.parse::<i64>().ok()).unwrap_or(0);
    if count("lineskip") > 0 {
        return Err(fail("NRRD with a line skip".into(), "byte skip in its header"));
    }
    let bytes = match get("encoding").unwrap_or("raw").to_ascii_lowercase().as_str() {
        "raw" => {
            let there = std::fs::metadata(&data).map_err(|e| Error::io(&data, e))?.len();
            offset = if count("byteskip") < 0 { there.saturating_sub(need) } else { offset + count("byteskip") as u64 };
            Bytes::File(data)
        }
        "gzip" | "gz" => {
            let skipped = count("byteskip").max(0) as u64;
            let unpacked = compressed(&data, offset, true, need.saturating_add(skipped));
            offset = skipped;
            unpacked
        }
        "ascii" | "text" | "txt" => {
            raw.dtype = Dtype { kind: Kind::F64, big_endian: false };
            let (values, from) = (need as usize / dtype.bytes(), offset as usize);
            offset = 0;
            let source = data.clone();
            let decode = move || -> Result<Vec<u8>> {
                let all = std::fs::read(&source).map_err(|e| Error::io(&source, e))?;
                text_numbers(&String::from_utf8_lossy(all.get(from..).unwrap_or_default()), values, &source)
            };
            Bytes::Decoded(data, Arc::new(decode))
        }
        other => {
            return Err(fail(format!("NRRD encoded as `{other}`; raw, gzip and ascii are read"), "unu save -e raw"));
        }
    };
    raw.offset = offset;
    let grid = grid(&get, first, size, sizes.len());
    let field = path.file_stem().map_or("values".into(), |s| s.to_string_lossy().into_owned());
    Ok(vec![Header {
        field: get("content").map_or(field, String::from),
        raw,
        bytes,
        grid,
        time: None,
        warnings: Vec::new(),
    }])
}

/// The names that the format gives to types of number.
fn element(name: &str) -> Option<Kind> {
    Some(match name {
        "signed char" | "int8" | "int8_t" => Kind::I8,
        "uchar" | "unsigned char" | "uint8" | "uint8_t" => Kind::U8,
        "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => Kind::I16,
        "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => Kind::U16,
        "int" | "signed int" | "int32" | "int32_t" => Kind::I32,
        "uint" | "unsigned int" | "uint32" | "uint32_t" => Kind::U32,
        "longlong"
        | "long long"
        | "long long int"
        | "signed long long"
        | "signed long long int"
        | "int64"
        | "int64_t" => Kind::I64,
        "ulonglong" | "unsigned long long" | "unsigned long long int" | "uint64" | "uint64_t" => Kind::U64,
        "float" => Kind::F32,
        "double" => Kind::F64,
        _ => return None,
    })
}

/// Spacing from `spacings`, or the lengths of `space directions`; origin from `space origin` or `axis mins`.
fn grid<'a>(get: &impl Fn(&str) -> Option<&'a str>, first: usize, size: [usize; 3], rank: usize) -> GridInfo {
    let per_axis =
        |name: &str| get(name).and_then(numbers).filter(|v| v.len() == rank).map(|v| v[first..first + 3].to_vec());
    let vectors = |text: &str| -> Vec<Vec<f64>> {
        let inside = text.split('(').skip(1).filter_map(|v| v.split_once(')')).map(|(v, _)| v.replace(',', " "));
        inside.filter_map(|v| numbers(&v)).collect()
    };
    let lengths = || {
        let directions = vectors(get("spacedirections")?);
        (directions.len() == 3)
            .then(|| directions.iter().map(|d| d.iter().map(|v| v * v).sum::<f64>().sqrt()).collect())
    };
    let spacing: Option<Vec<f64>> = per_axis("spacings").or_else(lengths);
    let origin = get("spaceorigin").and_then(|o| vectors(o).into_iter().next()).filter(|o| o.len() == 3);
    let origin = origin.or_else(|| per_axis("axismins"));
    let triple = |v: Option<Vec<f64>>, default: f64| v.map_or([default; 3], |v| [v[0], v[1], v[2]]);
    let units = get("spaceunits").and_then(|u| u.split('"').nth(1)).unwrap_or_default().to_owned();
    let cell = get("centerings").or(get("centers")).is_some_and(|c| c.contains("cell"));
    let centering = if cell { "cell" } else { "node" }.into();
    GridInfo { size, spacing: triple(spacing, 1.0), origin: triple(origin, 0.0), units, centering, stretch: None }
}
