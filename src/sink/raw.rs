//! Raw volumes with XDMF: the illuminated volume of each step as little-endian f32 in (z, y, x, rgb) order without a header,
//! described by an `.xmf` beside it, and one `.xmf` for all steps that ParaView opens as a series:
//! `light_{step:06}.raw` makes `light_000120.raw`, `light_000120.xmf` and `light.xmf`.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

use quick_xml::Writer;
use quick_xml::events::{BytesDecl, BytesText, Event};

use super::template::Template;
use super::{IlluminatedVolume, Output, Sink};
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::whole::write_whole;

/// Writes one raw file and its description per step, and the description of the series after each.
pub(super) struct Raw {
    template: Template,
    /// Each step's grid as XML, in step order.
    grids: BTreeMap<u64, String>,
}

/// What a description says of one step.
struct Step {
    step: u64,
    time: f64,
    grid: Grid,
    raw: PathBuf,
}

impl Raw {
    pub(super) fn new(template: Template) -> Self {
        Raw { template, grids: BTreeMap::new() }
    }

    /// The description of all steps; none when there is one step, which has its own.
    fn series(&self) -> Option<PathBuf> {
        let name = self.template.without_step().with_extension("xmf");
        self.template.has_step().then(|| self.template.folder().join(name.file_name().unwrap_or_default()))
    }
}

impl Sink for Raw {
    fn write(&mut self, output: &Output) -> Result<()> {
        let Some(light) = &output.light else { return Ok(()) };
        let raw = self.template.path(output.step, "");
        write_whole(&raw, |file| write_values(file, light).map_err(|e| Error::io(&raw, e)))?;
        let time = output.time.unwrap_or(output.step as f64);
        let step = Step { step: output.step, time, grid: light.grid, raw };
        let own = step.raw.with_extension("xmf");
        describe(&own, [&step.xml(&own)?], false)?;
        let Some(series) = self.series() else { return Ok(()) };
        self.grids.insert(step.step, step.xml(&series)?);
        describe(&series, self.grids.values(), true)
    }

    fn wants_layers(&self) -> bool {
        false
    }

    fn finish(&mut self) -> Result<()> {
        Ok(())
    }

    fn resume(&mut self) -> Result<()> {
        let Some(path) = self.series().filter(|path| path.exists()) else { return Ok(()) };
        let text = std::fs::read_to_string(&path).map_err(|e| Error::io(&path, e))?;
        // As `Step::xml` writes them, none inside of another.
        for grid in text.split("<Grid Name=\"step ").skip(1) {
            let (Some((number, _)), Some((inner, _))) = (grid.split_once('"'), grid.split_once("</Grid>")) else {
                continue;
            };
            if let Ok(step) = number.parse() {
                self.grids.insert(step, format!("<Grid Name=\"step {inner}</Grid>"));
            }
        }
        Ok(())
    }

    fn wants_light(&self) -> bool {
        true
    }

    fn wants_frames(&self) -> bool {
        false
    }

    fn paths(&self, step: u64) -> Vec<PathBuf> {
        let raw = self.template.path(step, "");
        vec![raw.with_extension("xmf"), raw]
    }
}

fn write_values(file: &mut impl Write, light: &IlluminatedVolume) -> std::io::Result<()> {
    if cfg!(target_endian = "little") {
        return file.write_all(bytemuck::cast_slice(&light.fluence));
    }
    light.fluence.iter().flatten().try_for_each(|v| file.write_all(&v.to_le_bytes()))
}

impl Step {
    /// The step's grid as a file at `path` describes it.
    fn xml(&self, path: &Path) -> Result<String> {
        let mut xml = Writer::new_with_indent(Vec::new(), b' ', 2);
        write_step(&mut xml, self, path.parent().unwrap_or(Path::new(""))).map_err(|e| Error::io(path, e))?;
        Ok(String::from_utf8_lossy(&xml.into_inner()).into_owned())
    }
}

/// Writes a description of grids, as a temporal collection or of the one grid alone.
fn describe<'a>(path: &Path, grids: impl IntoIterator<Item = &'a String>, collection: bool) -> Result<()> {
    let mut inner: String = grids.into_iter().flat_map(|grid| ["\n", grid]).collect();
    inner.push('\n');
    write_whole(path, |file| {
        let mut xml = Writer::new_with_indent(file, b' ', 2);
        let inner = Event::Text(BytesText::from_escaped(inner.as_str()));
        let written = xml.write_event(Event::Decl(BytesDecl::new("1.0", None, None))).and_then(|()| {
            xml.create_element("Xdmf").with_attribute(("Version", "2.0")).write_inner_content(|xml| {
                xml.create_element("Domain").write_inner_content(|xml| {
                    if !collection {
                        return xml.write_event(inner);
                    }
                    xml.create_element("Grid")
                        .with_attributes([
                            ("Name", "light"),
                            ("GridType", "Collection"),
                            ("CollectionType", "Temporal"),
                        ])
                        .write_inner_content(|xml| xml.write_event(inner))?;
                    Ok(())
                })?;
                Ok(())
            })?;
            Ok(())
        });
        written.map_err(|e| Error::io(path, e))
    })
}

/// One grid. XDMF lists dimensions, origin and spacing z, y, x.
fn write_step<W: Write>(xml: &mut Writer<W>, step: &Step, folder: &Path) -> std::io::Result<()> {
    let reversed = |[x, y, z]: [f64; 3]| format!("{z} {y} {x}");
    let [nx, ny, nz] = step.grid.size;
    let size = format!("{nz} {ny} {nx}");
    let raw = step.raw.strip_prefix(folder).unwrap_or(&step.raw).to_string_lossy();
    let name = format!("step {}", step.step);
    xml.create_element("Grid")
        .with_attributes([("Name", name.as_str()), ("GridType", "Uniform")])
        .write_inner_content(|xml| {
            xml.create_element("Time").with_attribute(("Value", step.time.to_string().as_str())).write_empty()?;
            let topology = [("TopologyType", "3DCoRectMesh"), ("Dimensions", size.as_str())];
            xml.create_element("Topology").with_attributes(topology).write_empty()?;
            xml.create_element("Geometry").with_attribute(("GeometryType", "ORIGIN_DXDYDZ")).write_inner_content(
                |xml| {
                    for (name, values) in [("Origin", step.grid.origin), ("Spacing", step.grid.spacing)] {
                        let item = [
                            ("Name", name),
                            ("Format", "XML"),
                            ("NumberType", "Float"),
                            ("Precision", "8"),
                            ("Dimensions", "3"),
                        ];
                        let item = xml.create_element("DataItem").with_attributes(item);
                        item.write_text_content(BytesText::new(&reversed(values)))?;
                    }
                    Ok(())
                },
            )?;
            let attribute = [("Name", "fluence"), ("AttributeType", "Vector"), ("Center", "Node")];
            xml.create_element("Attribute").with_attributes(attribute).write_inner_content(|xml| {
                let dimensions = format!("{size} 3");
                let item = [
                    ("Format", "Binary"),
                    ("NumberType", "Float"),
                    ("Precision", "4"),
                    ("Endian", "Little"),
                    ("Dimensions", dimensions.as_str()),
                ];
                let item = xml.create_element("DataItem").with_attributes(item);
                item.write_text_content(BytesText::new(&raw))?;
                Ok(())
            })?;
            Ok(())
        })?;
    Ok(())
}
