//! XDMF: XML that says which parts of HDF5 or raw files make a uniform or rectilinear grid, one grid a step.
//!
//! `ORIGIN_DXDYDZ` is in Z, Y, X order, as are all dimensions: slowest axis first. `VXVYVZ` has the points along x, y and z.

use std::path::{Path, PathBuf};

use super::choose::{choose, component};
use super::expand::Files;
use super::headed::beside;
use super::raw::{Bytes, Dtype, Kind};
use super::series::{Plan, Step};
use super::values::Values;
use super::vti::place_points;
use super::xml::{Element, numbers};
use super::{Candidate, GridInfo, SeriesInfo, SourceSpec, h5, raw, shape_text};
use crate::error::{Error, Result};

/// An attribute of a grid, located.
struct Array {
    name: String,
    grid: GridInfo,
    /// Dimensions of the stored part, slowest first; three, or four with components last.
    shape: Vec<usize>,
    /// Names of the files that were referred to, for errors.
    item: Item,
    warnings: Vec<String>,
}

/// A stored array, or part of one.
struct Item {
    file: PathBuf,
    /// Dataset of an HDF5 file; `None` for a raw file.
    dataset: Option<String>,
    /// Lengths of the whole stored array.
    whole: Vec<usize>,
    /// First value of the part along each axis.
    start: Vec<usize>,
    /// Lengths of the part.
    count: Vec<usize>,
    dtype: Dtype,
    seek: u64,
}

/// Finds the attribute and its steps.
pub(crate) fn plan(files: &Files, spec: &SourceSpec) -> Result<Plan> {
    let asked = files.dataset.as_deref().or(spec.field.as_deref());
    let (mut info, mut steps): (Option<SeriesInfo>, Vec<Step>) = (None, Vec::new());
    for entry in &files.entries {
        let grids = grids(&entry.path)?;
        let count = grids.len();
        for (grid, time) in grids {
            let next = steps.len() as u64;
            let step = if count == 1 { entry.number.unwrap_or(next) } else { next };
            let arrays = arrays(&grid, &entry.path)?;
            let candidates: Vec<Candidate> = arrays.iter().map(Array::candidate).collect();
            let array = &arrays[choose(&entry.path, &candidates, asked)?];
            let values = array.values(spec, &entry.path)?;
            steps.push(Step { step, time: time.or(entry.decimal), grid: Some(array.grid.clone()), values });
            info.get_or_insert_with(|| SeriesInfo {
                layout: "XDMF".into(),
                series: files.entries.iter().map(|e| e.path.clone()).collect(),
                field: array.name.clone(),
                candidates,
                grid: array.grid.clone(),
                warnings: array.warnings.clone(),
                ..SeriesInfo::default()
            });
        }
    }
    let nothing = || Error::format(super::first_name(&[files.entries[0].path.clone()]), "XDMF without grids", "");
    Ok(Plan { info: info.ok_or_else(nothing)?, steps, start: 0.0 })
}

/// The uniform grids of a file with their times, in order.
fn grids(path: &Path) -> Result<Vec<(Element, Option<f64>)>> {
    if let Some(problem) = super::file_problem(path) {
        return Err(problem);
    }
    let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, e))?;
    let root = Element::parse(&text).map_err(|why| Error::format(path, format!("not XML: {why}"), ""))?;
    let mut found = Vec::new();
    for domain in root.all("Domain") {
        for grid in domain.all("Grid") {
            collect(grid, None, path, &mut found)?;
        }
    }
    Ok(found)
}

fn collect(grid: &Element, time: Option<f64>, path: &Path, found: &mut Vec<(Element, Option<f64>)>) -> Result<()> {
    let told = grid.child("Time").and_then(|t| t.numbers("Value")?.first().copied()).or(time);
    if !grid.attribute("GridType").is_some_and(|t| t.eq_ignore_ascii_case("Collection")) {
        found.push((grid.clone(), told));
        return Ok(());
    }
    let spatial = !grid.attribute("CollectionType").is_some_and(|t| t.eq_ignore_ascii_case("Temporal"));
    let inner: Vec<&Element> = grid.all("Grid").collect();
    if spatial && inner.len() > 1 {
        let found = format!("a spatial collection of {} grids; one grid per step is read", inner.len());
        return Err(Error::format(path, found, "a file that joins them, or one of the data files itself"));
    }
    // One list of times for the whole collection.
    let list = grid.child("Time").and_then(|t| numbers(&t.child("DataItem")?.text));
    for (n, grid) in inner.into_iter().enumerate() {
        collect(grid, list.as_ref().and_then(|l| l.get(n).copied()).or(told), path, found)?;
    }
    Ok(())
}

/// The attributes of a grid.
fn arrays(grid: &Element, path: &Path) -> Result<Vec<Array>> {
    let fail = |found: String, remedy: &str| Error::format(path, found, remedy);
    let topology = grid.child("Topology").ok_or_else(|| fail("a grid without Topology".into(), ""))?;
    let kind = topology.attribute("TopologyType").or(topology.attribute("Type")).unwrap_or_default();
    let uneven = kind.eq_ignore_ascii_case("3DRectMesh");
    if !uneven && !kind.eq_ignore_ascii_case("3DCoRectMesh") {
        let found = format!("a grid of topology `{kind}`; 3DCoRectMesh and 3DRectMesh are read");
        return Err(fail(found, "a uniform or rectilinear grid"));
    }
    let lengths = topology.attribute("Dimensions").or(topology.attribute("NumberOfElements")).and_then(lengths);
    let nodes = lengths.filter(|n| n.len() == 3).ok_or_else(|| fail("Topology without three Dimensions".into(), ""))?;
    let geometry = grid.child("Geometry").ok_or_else(|| fail("a grid without Geometry".into(), ""))?;
    let kind = geometry.attribute("GeometryType").or(geometry.attribute("Type")).unwrap_or_default();
    let items: Vec<&Element> = geometry.all("DataItem").collect();
    let (origin, spacing, points) = match (kind.to_ascii_uppercase().as_str(), items.as_slice()) {
        ("ORIGIN_DXDYDZ", [o, d]) if !uneven => {
            let triple = |e: &Element| numbers(&e.text).and_then(|v| <[f64; 3]>::try_from(v).ok());
            let wrong = || fail("ORIGIN_DXDYDZ without two triples of numbers in the XML".into(), "");
            let ([oz, oy, ox], [dz, dy, dx]) = triple(o).zip(triple(d)).ok_or_else(wrong)?;
            ([ox, oy, oz], [dx, dy, dz], None)
        }
        ("VXVYVZ", [x, y, z]) if uneven => ([0.0; 3], [1.0; 3], Some([line(x, path)?, line(y, path)?, line(z, path)?])),
        _ => {
            let found = format!("Geometry `{kind}`; ORIGIN_DXDYDZ, or VXVYVZ on a 3DRectMesh, is read");
            return Err(fail(found, ""));
        }
    };
    let mut arrays = Vec::new();
    for attribute in grid.all("Attribute") {
        let name = attribute.attribute("Name").unwrap_or("values").to_owned();
        let cells = attribute.attribute("Center").is_some_and(|c| c.eq_ignore_ascii_case("Cell"));
        let Some(data) = attribute.child("DataItem") else { continue };
        let item = Item::read(data, path)?;
        // Axes of length one in front are times or records that the part selects.
        let ones = item.count.iter().take_while(|n| **n == 1).count().min(item.count.len().saturating_sub(3));
        let vector = attribute.attribute("AttributeType").is_some_and(|t| !t.eq_ignore_ascii_case("Scalar"));
        let ones = if vector { ones.min(item.count.len().saturating_sub(4)) } else { ones };
        let shape = item.count[ones..].to_vec();
        let wanted: Vec<usize> = nodes.iter().map(|n| if cells { n.saturating_sub(1) } else { *n }).collect();
        if shape.len() < 3 || shape.len() > 4 || shape[..3] != wanted[..] {
            let found = format!("`{name}` is {} where the grid has {}", shape_text(&item.count), shape_text(&wanted));
            return Err(fail(found, "Dimensions in its DataItem"));
        }
        let half = if cells { 0.5 } else { 0.0 };
        let mut grid = GridInfo {
            size: [wanted[2], wanted[1], wanted[0]],
            spacing,
            origin: std::array::from_fn(|a| origin[a] + half * spacing[a]),
            centering: if cells { "cell" } else { "node" }.into(),
            ..GridInfo::default()
        };
        let mut warnings = Vec::new();
        if let Some(points) = &points {
            place_points(&mut grid, points, cells, path, &mut warnings)?;
        }
        arrays.push(Array { name, grid, shape, item, warnings });
    }
    Ok(arrays)
}

/// The points along an axis: in the XML, or a dataset of one axis.
fn line(element: &Element, path: &Path) -> Result<Vec<f64>> {
    let fail = |found: String| Error::format(path, found, "coordinates in the XML, or in HDF5");
    if element.attribute("Format").is_none_or(|f| f.eq_ignore_ascii_case("XML")) {
        return numbers(&element.text).ok_or_else(|| fail("coordinates that are not numbers".into()));
    }
    let Item { file, dataset, .. } = Item::read(element, path)?;
    let dataset = dataset.ok_or_else(|| fail("coordinates in a raw file".into()))?;
    let stored = h5::open_dataset(&h5::open_file(&file, 0)?, &file, &dataset)?;
    h5::numbers_in(&stored).ok_or_else(|| fail(format!("{}:{dataset} does not hold coordinates", file.display())))
}

fn lengths(text: &str) -> Option<Vec<usize>> {
    text.split_whitespace().map(|n| n.parse().ok()).collect()
}

impl Item {
    fn read(element: &Element, path: &Path) -> Result<Item> {
        let fail = |found: String, remedy: &str| Error::format(path, found, remedy);
        let dimensions = element.attribute("Dimensions").and_then(lengths);
        if element.attribute("ItemType").is_some_and(|t| t.eq_ignore_ascii_case("HyperSlab")) {
            let parts: Vec<&Element> = element.all("DataItem").collect();
            let [selection, source] = parts.as_slice() else {
                return Err(fail("a HyperSlab without its two DataItems".into(), ""));
            };
            let whole = Item::read(source, path)?;
            let rank = whole.whole.len();
            let numbers = lengths(&selection.text).filter(|n| n.len() == 3 * rank);
            let numbers = numbers.ok_or_else(|| fail(format!("a HyperSlab that is not 3 times {rank} numbers"), ""))?;
            if numbers[rank..2 * rank]
                .iter()
                .zip(&numbers[2 * rank..])
                .any(|(stride, count)| *stride != 1 && *count > 1)
            {
                return Err(fail("a HyperSlab with strides".into(), "every value, with strides of 1"));
            }
            return Ok(Item { start: numbers[..rank].to_vec(), count: numbers[2 * rank..].to_vec(), ..whole });
        }
        let whole = dimensions.ok_or_else(|| fail("a DataItem without Dimensions".into(), ""))?;
        let precision = element.attribute("Precision").and_then(|p| p.parse().ok()).unwrap_or(4);
        let number = element.attribute("NumberType").or(element.attribute("DataType")).unwrap_or("Float");
        let kind = match (number.to_ascii_lowercase().as_str(), precision) {
            ("float", 4) => Kind::F32,
            ("float", 8) => Kind::F64,
            ("int", 4) => Kind::I32,
            ("int", 8) => Kind::I64,
            ("int", 2) | ("short", _) => Kind::I16,
            ("uint", 2) | ("ushort", _) => Kind::U16,
            ("uint", 4) => Kind::U32,
            ("uint", 8) => Kind::U64,
            ("char" | "int", _) => Kind::I8,
            ("uchar" | "uint", _) => Kind::U8,
            _ => {
                return Err(fail(
                    format!("numbers of type {number} with {precision} bytes"),
                    "Float with 4 or 8 bytes",
                ));
            }
        };
        let dtype =
            Dtype { kind, big_endian: element.attribute("Endian").is_some_and(|e| e.eq_ignore_ascii_case("Big")) };
        let text = element.text.trim();
        let (file, dataset) = match element.attribute("Format").unwrap_or("XML").to_ascii_uppercase().as_str() {
            "HDF" | "HDF5" => match text.rsplit_once(":/") {
                Some((file, dataset)) => (beside(path, file), Some(format!("/{dataset}"))),
                None => return Err(fail(format!("`{text}` does not name a dataset as FILE:/dataset"), "")),
            },
            "BINARY" => (beside(path, text), None),
            other => return Err(fail(format!("a DataItem of format {other}; HDF and Binary are read"), "")),
        };
        let seek = element.attribute("Seek").and_then(|s| s.parse().ok()).unwrap_or(0);
        Ok(Item { file, dataset, start: vec![0; whole.len()], count: whole.clone(), whole, dtype, seek })
    }
}

impl Array {
    fn candidate(&self) -> Candidate {
        let kind = if self.shape.len() == 4 { "vector" } else { "scalar" };
        Candidate {
            name: self.name.clone(),
            shape: self.shape.clone(),
            dtype: self.item.dtype.name(),
            kind: kind.into(),
        }
    }

    fn values(&self, spec: &SourceSpec, path: &Path) -> Result<Values> {
        let item = &self.item;
        let rank = item.whole.len();
        let vector = self.shape.len() == 4;
        let first = rank - self.shape.len();
        let space = [first + 2, first + 1, first];
        let shown = format!("{}:{}", path.display(), self.name);
        let parts = component(&shown, vector.then(|| self.shape[3]), spec.component.as_deref())?;
        let part = |c: &Option<usize>| {
            let mut fixed: Vec<(usize, usize)> = (0..first).map(|a| (a, item.start[a])).collect();
            fixed.extend(c.map(|c| (rank - 1, item.start[rank - 1].saturating_add(c))));
            let start = space.map(|a| item.start[a]);
            if let Some(dataset) = item.dataset.clone() {
                let packing = h5::Packing::default();
                let whole = item.whole == item.count && first == 0;
                return Ok(Values::Hdf5(h5::Slab {
                    file: item.file.clone(),
                    dataset,
                    rank,
                    space,
                    fixed,
                    start,
                    whole,
                    packing,
                }));
            }
            let overflow = || Error::format(&shown, "claims more values than can be counted", "");
            let mut strides = vec![1usize; rank];
            for axis in (0..rank.saturating_sub(1)).rev() {
                strides[axis] = strides[axis + 1].checked_mul(item.whole[axis + 1]).ok_or_else(overflow)?;
            }
            let places = fixed.iter().copied().chain((0..3).map(|a| (space[a], start[a])));
            let skipped = places.map(|(a, at)| at.saturating_mul(strides[a])).fold(0, usize::saturating_add);
            Ok(Values::Raw(raw::Slab {
                bytes: Bytes::File(item.file.clone()),
                offset: item.seek.saturating_add(skipped.saturating_mul(item.dtype.bytes()) as u64),
                dtype: item.dtype,
                strides: space.map(|a| strides[a]),
                size: self.grid.size,
            }))
        };
        Ok(Values::of(parts.iter().map(part).collect::<Result<_>>()?))
    }
}
