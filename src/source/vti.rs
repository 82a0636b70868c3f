//! VTK XML ImageData (`.vti`) and RectilinearGrid (`.vtr`): appended or inline values, raw, base64 or text, plain or zlib; and `.pvd` collections.

use std::io::Read;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use super::axes::Axes;
use super::coords::{self, Along};
use super::expand::{Entry, Files};
use super::headed::{Header, beside, expected, text_numbers};
use super::raw::{Bytes, Dtype, Kind, RawSpec, values};
use super::xml::Element;
use super::{GridInfo, SourceSpec};
use crate::error::{Error, Result};
use crate::grid::Region;

/// The files that a collection names, with their times.
pub(crate) fn collection(path: &Path) -> Result<Files> {
    let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, e))?;
    let root = Element::parse(&text).map_err(|why| Error::format(path, format!("not XML: {why}"), ""))?;
    let sets = root.child("Collection").map(|c| c.all("DataSet").collect::<Vec<_>>()).unwrap_or_default();
    let entry = |set: &&Element| {
        let time = set.attribute("timestep").and_then(|t| t.parse().ok());
        Some(Entry { path: beside(path, set.attribute("file")?), number: None, decimal: time })
    };
    let entries: Vec<Entry> = sets.iter().filter_map(entry).collect();
    if entries.is_empty() {
        return Err(Error::format(path, "a collection that names no files", "its .vti files, as a glob"));
    }
    Ok(Files { entries, dataset: None })
}

/// How the numbers of a file are stored.
#[derive(Clone)]
struct Storage {
    path: PathBuf,
    /// Bytes of the counts before each array: 4 or 8.
    header: usize,
    big_endian: bool,
    zlib: bool,
    base64: bool,
}

/// Where an array's numbers are.
#[derive(Clone)]
enum Place {
    /// Bytes of the file.
    Appended(u64),
    /// Text inside the element.
    Inline(String),
}

/// Reads the headers of a file's arrays.
pub(crate) fn read(path: &Path) -> Result<Vec<Header>> {
    if let Some(problem) = super::file_problem(path) {
        return Err(problem);
    }
    let fail = |found: String, remedy: &str| Error::format(path, found, remedy);
    let (text, appended) = split(path)?;
    let root = Element::parse(&text).map_err(|why| fail(format!("not XML: {why}"), ""))?;
    let kind = root.attribute("type").unwrap_or_default().to_owned();
    let rectilinear = kind == "RectilinearGrid";
    let Some(image) = root.child(&kind).filter(|_| rectilinear || kind == "ImageData") else {
        return Err(fail(
            format!("VTK XML of type `{kind}`; ImageData and RectilinearGrid are read"),
            "ParaView's filter Resample To Image",
        ));
    };
    let pieces: Vec<&Element> = image.all("Piece").collect();
    let [piece] = pieces.as_slice() else {
        return Err(fail(format!("{} pieces in one file; one is read", pieces.len()), "a file written by one process"));
    };
    let compressor = root.attribute("compressor").unwrap_or_default();
    if !["", "vtkZLibDataCompressor"].contains(&compressor) {
        return Err(fail(format!("compressed by {compressor}"), "ParaView: save with zlib, or without compression"));
    }
    let storage = Storage {
        path: path.to_owned(),
        header: if root.attribute("header_type") == Some("UInt64") { 8 } else { 4 },
        big_endian: root.attribute("byte_order") == Some("BigEndian"),
        zlib: !compressor.is_empty(),
        base64: appended.as_ref().is_some_and(|(_, base64)| *base64),
    };
    let six = |e: &Element, name: &str| e.numbers(name).filter(|v| v.len() == 6);
    let extent = six(piece, "Extent").or_else(|| six(image, "WholeExtent"));
    let extent = extent.ok_or_else(|| fail("VTK XML without an extent".into(), ""))?;
    let triple = |name: &str, default: f64| {
        image.numbers(name).filter(|v| v.len() == 3).map_or([default; 3], |v| [v[0], v[1], v[2]])
    };
    let (spacing, origin) = (triple("Spacing", 1.0), triple("Origin", 0.0));
    let base = appended.as_ref().map(|(at, _)| *at);
    let time = [&root, image].into_iter().find_map(|e| time_value(e, &storage, base));
    let lines = if rectilinear { Some(coordinates(piece, &storage, base)?) } else { None };
    let mut headers: Vec<Header> = Vec::new();
    for (place, cells) in [("PointData", false), ("CellData", true)] {
        for array in piece.child(place).iter().flat_map(|p| p.all("DataArray")) {
            let values = std::array::from_fn(|a| {
                ((extent[2 * a + 1] - extent[2 * a]).max(0.0) as usize).saturating_add(usize::from(!cells))
            });
            let half = if cells { 0.5 } else { 0.0 };
            let mut warnings = Vec::new();
            let mut grid = GridInfo {
                size: values,
                spacing,
                origin: std::array::from_fn(|a| origin[a] + (extent[2 * a] + half) * spacing[a]),
                centering: if cells { "cell" } else { "node" }.into(),
                ..GridInfo::default()
            };
            if let Some(lines) = &lines {
                place_points(&mut grid, lines, cells, path, &mut warnings)?;
            }
            let name = array.attribute("Name").unwrap_or("values").to_owned();
            let taken = headers.iter().any(|h| h.field == name);
            let field = if taken { format!("{place}/{name}") } else { name };
            if let Some((raw, bytes)) = numbers_of(array, values, &storage, base)? {
                headers.push(Header { field, raw, bytes, grid, time, warnings });
            }
        }
    }
    if headers.is_empty() { Err(fail("no arrays of numbers in this file".into(), "")) } else { Ok(headers) }
}

/// The XML before appended data, and where that begins and whether it is base64.
fn split(path: &Path) -> Result<(String, Option<(u64, bool)>)> {
    let mut file = std::fs::File::open(path).map_err(|e| Error::io(path, e))?;
    let (mut bytes, mut piece) = (Vec::new(), vec![0; 1 << 16]);
    loop {
        let from = bytes.len().saturating_sub(64);
        let count = file.read(&mut piece).map_err(|e| Error::io(path, e))?;
        bytes.extend_from_slice(&piece[..count]);
        let mark = b"<AppendedData";
        let start = bytes[from..].windows(mark.len()).position(|w| w == mark).map(|at| from + at);
        if let Some(start) = start
            && let Some(underscore) =
                bytes[start..].iter().position(|b| *b == b'_').filter(|_| bytes[start..].contains(&b'>'))
        {
            let tag = String::from_utf8_lossy(&bytes[start..start + underscore]).into_owned();
            let text = String::from_utf8_lossy(&bytes[..start]).into_owned();
            return Ok((text, Some(((start + underscore + 1) as u64, tag.contains("base64")))));
        }
        if count == 0 {
            return Ok((String::from_utf8_lossy(&bytes).into_owned(), None));
        }
    }
}

/// Positions of the points of a rectilinear grid along x, y, z.
fn coordinates(piece: &Element, storage: &Storage, appended: Option<u64>) -> Result<[Vec<f64>; 3]> {
    let fail = |found: &str| Error::format(&storage.path, found, "the complete file");
    let arrays: Vec<&Element> = piece.child("Coordinates").map(|c| c.all("DataArray").collect()).unwrap_or_default();
    let [x, y, z] = arrays.as_slice() else { return Err(fail("a rectilinear grid without three Coordinates")) };
    let extent = piece.numbers("Extent").filter(|e| e.len() == 6).ok_or_else(|| fail("a piece without an extent"))?;
    let read = |array: &Element, a: usize| -> Result<Vec<f64>> {
        let count = (extent[2 * a + 1] - extent[2 * a]).clamp(0.0, 1e7) as usize + 1;
        let found = numbers_of(array, [count, 1, 1], storage, appended)?.ok_or_else(|| fail("Coordinates of text"))?;
        read_all(&found.0, found.1, count)
    };
    Ok([read(x, 0)?, read(y, 1)?, read(z, 2)?])
}

/// All of an array of one axis.
fn read_all(raw: &RawSpec, bytes: Bytes, count: usize) -> Result<Vec<f64>> {
    let field = values(raw, bytes, 0, 1, &SourceSpec::default())?.open([count, 1, 1], &Default::default())?;
    // Opening has checked that the file holds as many.
    let mut read = vec![0.0; count];
    field.read_f64(Region { start: [0; 3], size: [count, 1, 1] }, &mut read)?;
    Ok(read)
}

/// Puts the values of points, or of the cells between them, where the points of a rectilinear grid are.
pub(crate) fn place_points(
    grid: &mut GridInfo,
    points: &[Vec<f64>; 3],
    cells: bool,
    path: &Path,
    warnings: &mut Vec<String>,
) -> Result<()> {
    let along = points.each_ref().map(|p| if cells { Along::cells(p) } else { Along::points(p) });
    let fits = (0..3).all(|a| along[a].centres.len() == grid.size[a]);
    if fits && coords::place(grid, along, warnings) {
        return Ok(());
    }
    let lengths = points.each_ref().map(Vec::len);
    let found =
        format!("coordinates of {lengths:?} points do not rise or fall, or do not fit values of {:?}", grid.size);
    Err(Error::format(path, found, "--spacing DX,DY,DZ for an even grid"))
}

/// ParaView's `TimeValue` among the field data.
fn time_value(element: &Element, storage: &Storage, appended: Option<u64>) -> Option<f64> {
    let time = element.child("FieldData")?.all("DataArray").find(|a| a.attribute("Name") == Some("TimeValue"))?;
    let (raw, bytes) = numbers_of(time, [1; 3], storage, appended).ok()??;
    read_all(&raw, bytes, 1).ok()?.first().copied()
}

fn numbers_of(
    array: &Element,
    size: [usize; 3],
    storage: &Storage,
    appended: Option<u64>,
) -> Result<Option<(RawSpec, Bytes)>> {
    let kind = match array.attribute("type").unwrap_or_default() {
        "Float32" => Kind::F32,
        "Float64" => Kind::F64,
        "Int8" => Kind::I8,
        "UInt8" => Kind::U8,
        "Int16" => Kind::I16,
        "UInt16" => Kind::U16,
        "Int32" => Kind::I32,
        "UInt32" => Kind::U32,
        "Int64" => Kind::I64,
        "UInt64" => Kind::U64,
        _ => return Ok(None),
    };
    let path = &storage.path;
    let components: usize = array.attribute("NumberOfComponents").and_then(|n| n.parse().ok()).unwrap_or(1).max(1);
    let order = Axes::parse(if components > 1 { "zyxc" } else { "zyx" }).map_err(|why| Error::format(path, why, ""))?;
    let dtype = Dtype { kind, big_endian: storage.big_endian };
    let mut raw = RawSpec { size, dtype, offset: 0, order, components, steps: Some(1), gap: 0, start: 0.0 };
    let need = expected(&raw, path)?;
    let place = match (array.attribute("format"), appended) {
        (Some("appended"), Some(base)) => {
            let offset: u64 = array.attribute("offset").and_then(|o| o.parse().ok()).unwrap_or(0);
            Place::Appended(base.saturating_add(offset))
        }
        (Some("appended"), None) => {
            return Err(Error::format(path, "its appended data is missing", "the complete file"));
        }
        (Some("ascii"), _) => {
            raw.dtype = Dtype { kind: Kind::F64, big_endian: false };
            let (text, owner, count) = (array.text.clone(), path.clone(), need as usize / dtype.bytes());
            let decode = move || text_numbers(&text, count, &owner);
            return Ok(Some((raw, Bytes::Decoded(path.clone(), Arc::new(decode)))));
        }
        _ => Place::Inline(array.text.split_whitespace().collect()),
    };
    if let (Place::Appended(at), false, false) = (&place, storage.base64, storage.zlib) {
        raw.offset = at.saturating_add(storage.header as u64);
        return Ok(Some((raw, Bytes::File(path.clone()))));
    }
    let (owner, base64) = (storage.clone(), storage.base64 || matches!(place, Place::Inline(_)));
    let decode = move || owner.decode(&place, base64, need);
    Ok(Some((raw, Bytes::Decoded(path.clone(), Arc::new(decode)))))
}

impl Storage {
    /// Unpacks an array of `need` bytes.
    fn decode(&self, place: &Place, base64: bool, need: u64) -> Result<Vec<u8>> {
        let coded = match place {
            Place::Inline(text) => text.clone().into_bytes(),
            Place::Appended(at) => {
                // Packed data is hardly longer than what it packs; base64 is a third longer.
                let most = need.saturating_mul(2).saturating_add(1 << 20);
                let mut file = std::fs::File::open(&self.path).map_err(|e| Error::io(&self.path, e))?;
                std::io::Seek::seek(&mut file, std::io::SeekFrom::Start(*at)).map_err(|e| Error::io(&self.path, e))?;
                let mut bytes = Vec::new();
                file.take(most).read_to_end(&mut bytes).map_err(|e| Error::io(&self.path, e))?;
                bytes
            }
        };
        let short = || Error::format(&self.path, "its values end early", "the complete file");
        if !self.zlib {
            let length = self.header + need as usize;
            let bytes = if base64 { self.base64(&coded, 0..length)?.0 } else { coded };
            return bytes.get(self.header..length).map(<[u8]>::to_vec).ok_or_else(short);
        }
        // Number of blocks, length of a block, of the last one, then each block's packed length; base64 codes these
        // counts and the blocks apart.
        let fetch = |range: Range<usize>| -> Result<(Vec<u8>, usize)> {
            if base64 {
                return self.base64(&coded, range);
            }
            let end = range.end;
            coded.get(range).map(|b| (b.to_vec(), end)).ok_or_else(short)
        };
        let count = self.counts(&fetch(0..self.header)?.0).first().copied().unwrap_or(0);
        let length = usize::try_from(count).ok().and_then(|n| n.checked_add(3)?.checked_mul(self.header));
        let length = length.filter(|&l| l <= coded.len()).ok_or_else(short)?;
        let (head, mut at) = fetch(0..length)?;
        let packed = self.counts(&head).split_off(3.min(head.len() / self.header));
        let whole = if base64 {
            self.base64(&coded[at..], 0..packed.iter().fold(0, |n: usize, l| n.saturating_add(*l as usize)))?.0
        } else {
            coded[at..].to_vec()
        };
        at = 0;
        let mut bytes = Vec::new();
        for length in packed {
            let block = whole.get(at..at.saturating_add(length as usize)).ok_or_else(short)?;
            at = at.saturating_add(length as usize);
            let left = need.saturating_sub(bytes.len() as u64);
            let damaged = |e| Error::format(&self.path, format!("its compressed values are damaged ({e})"), "");
            flate2::read::ZlibDecoder::new(block).take(left).read_to_end(&mut bytes).map_err(damaged)?;
        }
        Ok(bytes)
    }

    /// The first `range.end` bytes that base64 codes, and the length of their code.
    fn base64(&self, coded: &[u8], range: Range<usize>) -> Result<(Vec<u8>, usize)> {
        let length = range.end.div_ceil(3).saturating_mul(4);
        let wrong = |why: String| Error::format(&self.path, format!("its base64 values are damaged ({why})"), "");
        let code = coded.get(..length).ok_or_else(|| wrong("they end early".into()))?;
        let mut bytes = STANDARD.decode(code).map_err(|e| wrong(e.to_string()))?;
        bytes.truncate(range.end);
        Ok((bytes, length))
    }

    fn counts(&self, bytes: &[u8]) -> Vec<u64> {
        let count = |b: &[u8]| {
            let ordered: Vec<u8> = if self.big_endian { b.iter().rev().copied().collect() } else { b.to_vec() };
            ordered.iter().rev().fold(0u64, |n, b| n << 8 | u64::from(*b))
        };
        bytes.chunks_exact(self.header).map(count).collect()
    }
}
