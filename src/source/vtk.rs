//! Legacy VTK files of STRUCTURED_POINTS and RECTILINEAR_GRID: a text header, then big-endian or text values of points or
//! cells.

use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::Arc;

use super::GridInfo;
use super::axes::Axes;
use super::headed::{Header, text_numbers};
use super::raw::{Bytes, Dtype, Kind, RawSpec};
use super::vti::place_points;
use crate::error::{Error, Result};

/// Reads the headers of a file's arrays.
pub(crate) fn read(path: &Path) -> Result<Vec<Header>> {
    if let Some(problem) = super::file_problem(path) {
        return Err(problem);
    }
    let file = std::fs::File::open(path).map_err(|e| Error::io(path, e))?;
    let mut lines = Lines { reader: BufReader::new(file), path, at: 0 };
    let fail = |found: String, remedy: &str| Error::format(path, found, remedy);
    let (_, _, coding, dataset) = (lines.next()?, lines.next()?, lines.next()?, lines.next()?);
    let ascii = coding.as_deref() == Some("ASCII");
    let rectilinear = dataset.as_deref() == Some("DATASET RECTILINEAR_GRID");
    if !rectilinear && dataset.as_deref() != Some("DATASET STRUCTURED_POINTS") {
        let found = format!(
            "legacy VTK with `{}`; DATASET STRUCTURED_POINTS and RECTILINEAR_GRID are read",
            dataset.unwrap_or_default()
        );
        return Err(fail(found, "ParaView's filter Resample To Image"));
    }
    let (mut points, mut spacing, mut origin) = ([1usize; 3], [1.0; 3], [0.0; 3]);
    let (mut cells, mut time, mut headers) = (false, None, Vec::new());
    let mut along: [Vec<f64>; 3] = Default::default();
    while let Some(line) = lines.next()? {
        let words: Vec<&str> = line.split_whitespace().collect();
        let three = || -> Option<[f64; 3]> {
            let numbers: Option<Vec<f64>> = words.get(1..4)?.iter().map(|w| w.parse().ok()).collect();
            numbers?.try_into().ok()
        };
        let count = |i: usize| words.get(i).and_then(|w| w.parse::<usize>().ok());
        let (name, kind, components, values) = match words.first().copied().unwrap_or_default() {
            "DIMENSIONS" => {
                let lengths = three().ok_or_else(|| fail(format!("`{line}` is not understood"), ""))?;
                points = lengths.map(|n| n as usize);
                continue;
            }
            "SPACING" | "ASPECT_RATIO" => {
                spacing = three().unwrap_or(spacing);
                continue;
            }
            "ORIGIN" => {
                origin = three().unwrap_or(origin);
                continue;
            }
            "X_COORDINATES" | "Y_COORDINATES" | "Z_COORDINATES" => {
                let a = usize::from(words[0].as_bytes()[0] - b'X');
                let kind = words.get(2).and_then(|w| element(w)).zip(count(1));
                let (kind, count) = kind.ok_or_else(|| fail(format!("`{line}` is not understood"), ""))?;
                along[a] = lines.list(Dtype { kind, big_endian: true }, count, ascii)?;
                continue;
            }
            "POINT_DATA" | "CELL_DATA" => {
                cells = words[0] == "CELL_DATA";
                continue;
            }
            "SCALARS" if words.len() >= 3 => {
                let (name, kind, components) = (words[1].to_owned(), words[2].to_owned(), count(3).unwrap_or(1));
                lines.next()?; // LOOKUP_TABLE
                (name, kind, components, None)
            }
            "VECTORS" | "NORMALS" if words.len() >= 3 => (words[1].to_owned(), words[2].to_owned(), 3, None),
            "FIELD" | "METADATA" | "NAME" | "DATA" | "" => continue,
            // Inside a FIELD: name, components, tuples, type.
            _ if words.len() == 4 && count(1).is_some() && count(2).is_some() => {
                (words[0].to_owned(), words[3].to_owned(), count(1).unwrap_or(1), count(2))
            }
            _ => continue,
        };
        let Some(kind) = element(&kind) else { break };
        let size = if cells { points.map(|n| n.saturating_sub(1).max(1)) } else { points };
        let dtype = Dtype { kind, big_endian: true };
        let lengths = size.iter().chain([&components]).try_fold(1usize, |n, &l| n.checked_mul(l));
        let numbers = values.and_then(|v| v.checked_mul(components)).or(lengths);
        let Some((numbers, bytes)) = numbers.and_then(|n| Some((n, n.checked_mul(dtype.bytes())?))) else {
            return Err(fail(format!("`{line}` claims more values than can be counted"), ""));
        };
        let at = lines.at;
        let text = if ascii { Some(lines.numbers(numbers)?) } else { None };
        if ["TIME", "TimeValue"].contains(&name.as_str()) && numbers == 1 {
            time = match &text {
                Some(text) => text.trim().parse().ok(),
                None => Some(lines.number(dtype)?),
            };
            continue;
        }
        if !ascii {
            lines.skip(bytes as u64)?;
        }
        // Field data of another length is no volume.
        if lengths != Some(numbers) {
            continue;
        }
        let spelled = if components > 1 { "zyxc" } else { "zyx" };
        let order = Axes::parse(spelled).map_err(|why| fail(why, ""))?;
        let mut raw = RawSpec { size, dtype, offset: at, order, components, steps: Some(1), gap: 0, start: 0.0 };
        let bytes = match text {
            None => Bytes::File(path.to_owned()),
            Some(text) => {
                (raw.dtype, raw.offset) = (Dtype { kind: Kind::F64, big_endian: false }, 0);
                let owner = path.to_owned();
                Bytes::Decoded(path.to_owned(), Arc::new(move || text_numbers(&text, numbers, &owner)))
            }
        };
        let half = if cells { 0.5 } else { 0.0 };
        let mut grid = GridInfo {
            size,
            spacing,
            origin: std::array::from_fn(|a| origin[a] + half * spacing[a]),
            centering: if cells { "cell" } else { "node" }.into(),
            ..GridInfo::default()
        };
        let mut warnings = Vec::new();
        if rectilinear {
            place_points(&mut grid, &along, cells, path, &mut warnings)?;
        }
        headers.push(Header { field: name, raw, bytes, grid, time, warnings });
    }
    headers.iter_mut().for_each(|h| h.time = time);
    if headers.is_empty() { Err(fail("no arrays of numbers in this file".into(), "")) } else { Ok(headers) }
}

fn element(name: &str) -> Option<Kind> {
    Some(match name {
        "unsigned_char" => Kind::U8,
        "char" => Kind::I8,
        "unsigned_short" => Kind::U16,
        "short" => Kind::I16,
        "unsigned_int" => Kind::U32,
        "int" => Kind::I32,
        "unsigned_long" | "vtktypeuint64" => Kind::U64,
        "long" | "vtktypeint64" | "vtkIdType" => Kind::I64,
        "float" => Kind::F32,
        "double" => Kind::F64,
        _ => return None,
    })
}

/// Lines of text between blocks of numbers.
struct Lines<'a> {
    reader: BufReader<std::fs::File>,
    path: &'a Path,
    at: u64,
}

impl Lines<'_> {
    /// The next line without its end; `None` at the end of the file.
    fn next(&mut self) -> Result<Option<String>> {
        let mut line = Vec::new();
        // No header line is as long: a file without line ends is not one of these.
        let count = (&mut self.reader).take(1 << 16).read_until(b'\n', &mut line);
        let count = count.map_err(|e| Error::io(self.path, e))?;
        self.at += count as u64;
        Ok((count > 0).then(|| String::from_utf8_lossy(&line).trim().to_owned()))
    }

    /// Lines until they hold `count` numbers.
    fn numbers(&mut self, count: usize) -> Result<String> {
        let (mut text, mut found) = (String::new(), 0);
        while found < count {
            let Some(line) = self.next()? else { break };
            found += line.split_whitespace().count();
            text.push_str(&line);
            text.push('\n');
        }
        Ok(text)
    }

    /// `count` numbers.
    fn list(&mut self, dtype: Dtype, count: usize, ascii: bool) -> Result<Vec<f64>> {
        let path = self.path;
        let short = || Error::format(path, format!("ends before {count} coordinates"), "the complete file");
        if ascii {
            let text = self.numbers(count)?;
            let read: Option<Vec<f64>> = text.split_whitespace().take(count).map(|w| w.parse().ok()).collect();
            return read.filter(|v| v.len() == count).ok_or_else(short);
        }
        let bytes = (count as u64).checked_mul(dtype.bytes() as u64).ok_or_else(short)?;
        let mut held = Vec::new();
        (&mut self.reader).take(bytes).read_to_end(&mut held).map_err(|e| Error::io(self.path, e))?;
        if held.len() as u64 != bytes {
            return Err(short());
        }
        self.at += bytes;
        let mut values = vec![0.0; count];
        dtype.decode(&held, 0, dtype.bytes() as isize, &mut values, |v| v);
        Ok(values)
    }

    /// One number as it is stored.
    fn number(&mut self, dtype: Dtype) -> Result<f64> {
        let (mut bytes, mut value) = (vec![0; dtype.bytes()], [0.0]);
        self.reader.read_exact(&mut bytes).map_err(|e| Error::io(self.path, e))?;
        self.at += bytes.len() as u64;
        dtype.decode(&bytes, 0, dtype.bytes() as isize, &mut value, |v| v);
        Ok(value[0])
    }

    fn skip(&mut self, bytes: u64) -> Result<()> {
        self.at = self.at.saturating_add(bytes);
        self.reader.seek(SeekFrom::Start(self.at)).map(|_| ()).map_err(|e| Error::io(self.path, e))
    }
}
