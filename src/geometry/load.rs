//! Triangles from files.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{Property, PropertyAccess, PropertyAccessResult};

use crate::error::{Error, Result, panic_text};

/// Corners of triangles.
pub(super) type Triangles = Vec<[[f64; 3]; 3]>;

/// Reads a file, told by its name: OBJ, STL or PLY. Faces of more corners become fans.
///
/// # Errors
/// [`Error::Io`] for a file that cannot be read, [`Error::Format`] for one that is something else, without triangles, or with
/// corners that are no numbers or not there.
pub(super) fn triangles(path: &Path) -> Result<Triangles> {
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    let read: fn(File) -> Result<Triangles, String> = match &extension[..] {
        "obj" => obj,
        "stl" => stl,
        "ply" => ply,
        _ => return Err(Error::format(path, "not the name of a mesh", "a file that ends in .obj, .stl or .ply")),
    };
    let file = File::open(path).map_err(|e| Error::io(path, e))?;
    // Parsers of others.
    let read = std::panic::catch_unwind(|| read(file)).unwrap_or_else(|panic| Err(panic_text(&*panic)));
    let wrong = |found: String| Error::format(path, found, "the file written anew, of triangles");
    let all = read.map_err(|why| wrong(format!("no mesh that can be read: {why}")))?;
    if all.iter().flatten().flatten().any(|x| !x.is_finite()) {
        return Err(wrong("a corner of a triangle is not finite".into()));
    }
    if all.is_empty() {
        return Err(wrong("a mesh without triangles".into()));
    }
    Ok(all)
}

/// The triangles of faces.
fn of(vertices: &[[f64; 3]], faces: impl Iterator<Item = Vec<usize>>) -> Result<Triangles, String> {
    let mut all = Vec::new();
    for (n, face) in faces.enumerate() {
        let corner = |i: usize| {
            let missing = || format!("face {n} has corner {i}, and there are {}", vertices.len());
            vertices.get(i).copied().ok_or_else(missing)
        };
        for i in 2..face.len() {
            all.push([corner(face[0])?, corner(face[i - 1])?, corner(face[i])?]);
        }
    }
    Ok(all)
}

fn obj(file: File) -> Result<Triangles, String> {
    let options =
        tobj::LoadOptions { triangulate: true, ignore_points: true, ignore_lines: true, ..Default::default() };
    let without_materials = |_: &Path| Err(tobj::LoadError::OpenFileFailed);
    let (models, _) =
        tobj::load_obj_buf(&mut BufReader::new(file), &options, without_materials).map_err(|e| e.to_string())?;
    let mut all = Vec::new();
    for tobj::Model { mesh, .. } in models {
        let vertices: Vec<[f64; 3]> =
            mesh.positions.chunks_exact(3).map(|p| [p[0], p[1], p[2]].map(f64::from)).collect();
        let faces = mesh.indices.chunks_exact(3).map(|f| f.iter().map(|i| *i as usize).collect());
        all.extend(of(&vertices, faces)?);
    }
    Ok(all)
}

fn stl(file: File) -> Result<Triangles, String> {
    let mesh = stl_io::read_stl(&mut BufReader::new(file)).map_err(|e| e.to_string())?;
    let vertices: Vec<[f64; 3]> = mesh.vertices.iter().map(|v| v.0.map(f64::from)).collect();
    of(&vertices, mesh.faces.iter().map(|f| f.vertices.to_vec()))
}

struct Vertex([f64; 3]);

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Vertex([f64::NAN; 3])
    }

    fn set_property(&mut self, key: &str, property: Property) -> PropertyAccessResult {
        let Some(axis) = ["x", "y", "z"].iter().position(|name| *name == key) else {
            return PropertyAccessResult::Ignored;
        };
        self.0[axis] = match property {
            Property::Float(v) => v.into(),
            Property::Double(v) => v,
            Property::Char(v) => v.into(),
            Property::UChar(v) => v.into(),
            Property::Short(v) => v.into(),
            Property::UShort(v) => v.into(),
            Property::Int(v) => v.into(),
            Property::UInt(v) => v.into(),
            _ => return PropertyAccessResult::UnsupportedType,
        };
        PropertyAccessResult::Set
    }
}

struct Face(Vec<usize>);

impl PropertyAccess for Face {
    fn new() -> Self {
        Face(Vec::new())
    }

    fn set_property(&mut self, key: &str, property: Property) -> PropertyAccessResult {
        if !["vertex_indices", "vertex_index"].contains(&key) {
            return PropertyAccessResult::Ignored;
        }
        // A negative number is of no corner.
        let index = |i: i64| usize::try_from(i).unwrap_or(usize::MAX);
        self.0 = match property {
            Property::ListInt(v) => v.into_iter().map(|i| index(i.into())).collect(),
            Property::ListUInt(v) => v.into_iter().map(|i| i as usize).collect(),
            Property::ListShort(v) => v.into_iter().map(|i| index(i.into())).collect(),
            Property::ListUShort(v) => v.into_iter().map(usize::from).collect(),
            Property::ListChar(v) => v.into_iter().map(|i| index(i.into())).collect(),
            Property::ListUChar(v) => v.into_iter().map(usize::from).collect(),
            _ => return PropertyAccessResult::UnsupportedType,
        };
        PropertyAccessResult::Set
    }
}

/// What is in neither.
struct Other;

impl PropertyAccess for Other {
    fn new() -> Self {
        Other
    }

    fn set_property(&mut self, _: &str, _: Property) -> PropertyAccessResult {
        PropertyAccessResult::Ignored
    }
}

fn ply(file: File) -> Result<Triangles, String> {
    let mut reader = Reader::new(BufReader::new(file));
    let (vertex, face, other) = (Parser::<Vertex>::new(), Parser::<Face>::new(), Parser::<Other>::new());
    let header = vertex.read_header(&mut reader).map_err(|e| e.to_string())?;
    let (mut vertices, mut faces) = (Vec::new(), Vec::new());
    for (_, element) in &header.elements {
        let read = match element.name.as_str() {
            "vertex" => vertex.read_payload_for_element(&mut reader, element, &header).map(|all| vertices = all),
            "face" => face.read_payload_for_element(&mut reader, element, &header).map(|all| faces = all),
            _ => other.read_payload_for_element(&mut reader, element, &header).map(drop),
        };
        read.map_err(|e| e.to_string())?;
    }
    let vertices: Vec<[f64; 3]> = vertices.into_iter().map(|v| v.0).collect();
    of(&vertices, faces.into_iter().map(|f: Face| f.0))
}
