//! One field on a uniform mesh, as Conduit's mesh blueprint describes it, taken as a block of values.
//!
//! `dims/{i,j,k}` count vertices. A value at vertex (i, j, k) sits at `origin + (i, j, k)·spacing`; one in element (i, j, k), of which
//! there are one fewer along each axis, at `origin + (i + ½, j + ½, k + ½)·spacing`. i is fastest.

use std::sync::Arc;

use gloaming::dtype::{Dtype, Kind};
use gloaming::field::{Dense, Field};
use gloaming::insitu::Strided;
use gloaming::scene::ComponentKey;
use gloaming::{Error, Grid, Region, Result};

use crate::conduit::{Array, Node, Number};

/// A field, and the mesh that it is on.
pub struct Chosen<'host> {
    data: Node<'host>,
    field: Node<'host>,
    /// Ghost markers, with whether they are in elements.
    ghosts: Vec<Node<'host>>,
}

/// Values of a step.
pub enum Block<'host> {
    /// The simulation's, to be copied before the call returns.
    Lent(Strided<&'host [u8]>),
    /// Computed from them.
    Made(Grid, Arc<dyn Field>),
}

/// Step number and time; steps without a number continue from `next`.
pub fn moment(root: &Node, next: u64) -> (u64, Option<f64>) {
    let state = |name: &str| root.get(&format!("catalyst/state/{name}"));
    let number = state("timestep").or_else(|| state("cycle")).and_then(|n| n.integer().ok());
    let time = state("time").and_then(|n| n.number().ok()).filter(|t| t.is_finite());
    (number.and_then(|n| u64::try_from(n).ok()).unwrap_or(next), time)
}

/// Finds the field that the configuration names as `field` or `channel/field`, or the only one.
pub fn choose<'host>(root: &Node<'host>, wanted: Option<&str>) -> Result<Chosen<'host>> {
    let mut found: Vec<(String, String, Chosen)> = vec![];
    let mut refused = None;
    for (channel, node) in root.need("catalyst/channels")?.children() {
        if wanted.and_then(|w| w.split_once('/')).is_some_and(|(c, _)| c != channel) {
            continue;
        }
        match mesh_of(&node) {
            Ok(data) => {
                found.extend(fields(&node, &data).into_iter().map(|(field, chosen)| (channel.clone(), field, chosen)))
            }
            Err(e) => refused = Some(e),
        }
    }
    let known: Vec<String> = found.iter().map(|(channel, field, _)| format!("{channel}/{field}")).collect();
    if let Some(wanted) = wanted {
        found.retain(|(channel, field, _)| wanted == field || wanted == format!("{channel}/{field}"));
    }
    let path = "catalyst/channels";
    let asked = wanted.map(|w| format!("`{w}`")).unwrap_or("a field".into());
    match (found.pop(), found.is_empty()) {
        (Some((.., chosen)), true) => Ok(chosen),
        (Some(_), false) => {
            let known = known.join(", ");
            Err(Error::format(
                path,
                format!("{asked} could be several of: {known}"),
                "field.name = \"channel/field\" in the configuration",
            ))
        }
        // A channel of a kind that is not read may have had it.
        (None, _) => Err(refused.unwrap_or_else(|| match known.as_slice() {
            [] => Error::format(path, "no field on a mesh", ""),
            _ => Error::format(path, format!("no {asked}, only {}", known.join(", ")), "field.name with one of them"),
        })),
    }
}

/// The data of a channel with one uniform mesh.
fn mesh_of<'host>(channel: &Node<'host>) -> Result<Node<'host>> {
    match channel.need_text("type")?.as_str() {
        "mesh" => channel.need("data"),
        other => Err(Error::Unsupported(format!(
            "{}: a channel of type `{other}`\n  try: a channel of type `mesh`, with one uniform mesh",
            channel.path
        ))),
    }
}

/// The fields on a mesh that hold values, rather than marks.
fn fields<'host>(channel: &Node<'host>, data: &Node<'host>) -> Vec<(String, Chosen<'host>)> {
    let marks = |name: &str| {
        let of = |node: &Node| node.get(&format!("state/metadata/vtk_fields/{name}/attribute_type"))?.text();
        of(data).or_else(|| of(channel)).or_else(|| (name == "ascent_ghosts").then(|| "Ghosts".into()))
    };
    let all: Vec<_> =
        data.get("fields").iter().flat_map(Node::children).map(|(name, field)| (marks(&name), name, field)).collect();
    let ghosts: Vec<Node> =
        all.iter().filter(|(marks, ..)| marks.as_deref() == Some("Ghosts")).map(|(.., field)| field.clone()).collect();
    let is_mark = |kind: &str| ["Ghosts", "GlobalIds", "PedigreeIds", "ProcessIds"].contains(&kind);
    let plain = all.into_iter().filter(|(marks, ..)| !marks.as_deref().is_some_and(is_mark));
    plain.map(|(_, name, field)| (name, Chosen { data: data.clone(), field, ghosts: ghosts.clone() })).collect()
}

/// A mesh: vertices along x, y, z and where they are.
struct Mesh {
    vertices: [usize; 3],
    spacing: [f64; 3],
    origin: [f64; 3],
}

impl Mesh {
    fn of(data: &Node, field: &Node) -> Result<Mesh> {
        let topology = data.need(&format!("topologies/{}", field.need_text("topology")?))?;
        let coordset = data.need(&format!("coordsets/{}", topology.need_text("coordset")?))?;
        for node in [&topology, &coordset] {
            let kind = node.need_text("type")?;
            if kind != "uniform" {
                return Err(Error::Unsupported(format!("{}: of type `{kind}`\n  try: a `uniform` mesh", node.path)));
            }
        }
        let mut mesh = Mesh { vertices: [0; 3], spacing: [1.0; 3], origin: [0.0; 3] };
        for (axis, (dim, along)) in ["i", "j", "k"].into_iter().zip(["x", "y", "z"]).enumerate() {
            let dim = coordset.need(&format!("dims/{dim}"))?;
            let count = dim.integer()?;
            // Far beyond any memory, and far from overflow.
            mesh.vertices[axis] =
                usize::try_from(count).ok().filter(|n| (1..=1 << 20).contains(n)).ok_or_else(|| {
                    Error::format(dim.path.clone(), format!("{count} vertices along {along}"), "1 to 1048576")
                })?;
            if let Some(spacing) = coordset.get(&format!("spacing/d{along}")) {
                mesh.spacing[axis] = spacing.number()?;
            }
            if let Some(origin) = coordset.get(&format!("origin/{along}")) {
                mesh.origin[axis] = origin.number()?;
            }
        }
        Ok(mesh)
    }

    /// Values along x, y, z: at vertices, or in elements.
    fn size(&self, elements: bool) -> [usize; 3] {
        self.vertices.map(|n| n - usize::from(elements))
    }
}

/// True for values in elements, false for values at vertices.
fn in_elements(field: &Node) -> Result<bool> {
    let association = field.need("association")?;
    match association.text().as_deref() {
        Some("element") => Ok(true),
        Some("vertex") => Ok(false),
        _ => Err(Error::format(association.path, "neither", "`vertex` or `element`")),
    }
}

/// The values of a field: ghost layers are left out, single ghosts are holes.
pub fn block<'host>(chosen: &Chosen<'host>, component: &ComponentKey) -> Result<Block<'host>> {
    let Chosen { data, field, ghosts } = chosen;
    let (mesh, elements) = (Mesh::of(data, field)?, in_elements(field)?);
    if field.get("strides").is_some() || field.get("offsets").is_some() {
        return Err(Error::Unsupported(format!("{}: strided-structured values", field.path)));
    }
    let size = mesh.size(elements);
    let half = if elements { 0.5 } else { 0.0 };
    let origin = std::array::from_fn(|a| mesh.origin[a] + half * mesh.spacing[a]);
    let shown = shown(&mesh, elements, ghosts)?;
    let mut components = components(&field.need("values")?, component)?
        .into_iter()
        .map(|(path, array)| {
            let block = strided(&path, array, size)?.region(shown.region).spacing(mesh.spacing).origin(origin);
            block.check().map(|()| block)
        })
        .collect::<Result<Vec<_>>>()?;
    if components.len() == 1 && shown.holes.is_empty() {
        return Ok(Block::Lent(components.remove(0)));
    }
    let grid = components[0].grid();
    let mut values = magnitude(&components)?;
    shown.holes.iter().for_each(|&at| values[at] = f32::NAN);
    Ok(Block::Made(grid, Arc::new(Dense::new(grid.size, values))))
}

/// √Σv², or the value itself of a scalar.
fn magnitude(components: &[Strided<&[u8]>]) -> Result<Vec<f32>> {
    let grid = components[0].grid();
    let mut values = vec![0.0; grid.len()];
    if let [one] = components {
        one.read(grid.region(), &mut values)?;
        return Ok(values);
    }
    let mut one = vec![0.0; grid.len()];
    for component in components {
        component.read(grid.region(), &mut one)?;
        values.iter_mut().zip(&one).for_each(|(sum, v)| *sum += v * v);
    }
    values.iter_mut().for_each(|sum| *sum = sum.sqrt());
    Ok(values)
}

/// The numbers to show: those of a scalar, or the components of a vector that are asked for.
fn components<'host>(values: &Node<'host>, wanted: &ComponentKey) -> Result<Vec<(String, Array<'host>)>> {
    if !values.is_object() {
        return Ok(vec![(values.path.clone(), values.array()?)]);
    }
    let mut all = values.children();
    let known = all.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>().join(", ");
    let at = match wanted {
        ComponentKey::Name(name) if name == "magnitude" => None,
        ComponentKey::Name(name) => {
            let named = all.iter().position(|(n, _)| n == name);
            Some(named.or_else(|| ["x", "y", "z"].iter().position(|n| n == name)).unwrap_or(usize::MAX))
        }
        ComponentKey::Index(index) => Some(*index),
    };
    if let Some(at) = at {
        if at >= all.len() {
            let found = format!("components {known}");
            return Err(Error::format(
                values.path.clone(),
                found,
                "field.component with one of them, an index, or magnitude",
            ));
        }
        all = vec![all.swap_remove(at)];
    }
    if all.is_empty() {
        return Err(Error::format(values.path.clone(), "no components", ""));
    }
    all.into_iter().map(|(_, node)| Ok((node.path.clone(), node.array()?))).collect()
}

/// An array of the host's as a block of `size`.
fn strided<'host>(path: &str, array: Array<'host>, size: [usize; 3]) -> Result<Strided<&'host [u8]>> {
    let needed: usize = size.iter().product();
    if array.count != needed {
        let [nx, ny, nz] = size;
        let found = format!("{} values, where the mesh has {nx}×{ny}×{nz} = {needed}", array.count);
        return Err(Error::format(path, found, "dims count vertices; elements are one fewer along each axis"));
    }
    let kind = match array.number {
        Number::Int(1) => Kind::I8,
        Number::Int(2) => Kind::I16,
        Number::Int(4) => Kind::I32,
        Number::Int(_) => Kind::I64,
        Number::Uint(1) => Kind::U8,
        Number::Uint(2) => Kind::U16,
        Number::Uint(4) => Kind::U32,
        Number::Uint(_) => Kind::U64,
        Number::Float(4) => Kind::F32,
        Number::Float(_) => Kind::F64,
    };
    let (bytes, first) = array.bytes();
    let [nx, ny, _] = size.map(|n| n as isize);
    let strides = [array.stride, array.stride * nx, array.stride * nx * ny];
    Ok(Strided::new(bytes, Dtype::native(kind), size).byte_strides(strides).first(first))
}

/// What ghosts leave.
struct Shown {
    /// The smallest box that holds every value that is no ghost.
    region: Region,
    /// Ghosts inside of it, by their place in it.
    holes: Vec<usize>,
}

fn shown(mesh: &Mesh, elements: bool, ghosts: &[Node]) -> Result<Shown> {
    let size = mesh.size(elements);
    let whole = Region { start: [0; 3], size };
    let mut ghost = vec![];
    for marks in ghosts {
        let of_elements = in_elements(marks)?;
        let values = marks.need("values")?;
        let array = values.array()?;
        // Only the number of marks is of interest here.
        strided(&values.path, array, mesh.size(of_elements))?;
        let marked = |at: [usize; 3]| array.get(Grid::new(mesh.size(of_elements)).index(at)) != 0.0;
        ghost.resize(whole.len(), false);
        for (at, place) in places(size).enumerate() {
            ghost[at] |= match (of_elements, elements) {
                (true, true) | (false, false) => marked(place),
                // A value is a ghost when everything of the other kind round it is.
                (true, false) => around(place, mesh.size(true), true).all(marked),
                (false, true) => around(place, mesh.size(false), false).all(marked),
            };
        }
    }
    if !ghost.contains(&true) {
        return Ok(Shown { region: whole, holes: vec![] });
    }
    let (mut low, mut high) = ([usize::MAX; 3], [0; 3]);
    for (place, _) in places(size).zip(&ghost).filter(|(_, ghost)| !**ghost) {
        for a in 0..3 {
            low[a] = low[a].min(place[a]);
            high[a] = high[a].max(place[a] + 1);
        }
    }
    if low[0] == usize::MAX {
        return Err(Error::Unsupported(format!(
            "{}: every value is a ghost: there is nothing to light",
            ghosts[0].path
        )));
    }
    let region = Region { start: low, size: std::array::from_fn(|a| high[a] - low[a]) };
    let is_ghost = |[i, j, k]: [usize; 3]| ghost[Grid::new(size).index([i + low[0], j + low[1], k + low[2]])];
    let holes = places(region.size).enumerate().filter(|(_, place)| is_ghost(*place)).map(|(at, _)| at).collect();
    Ok(Shown { region, holes })
}

/// Indices in memory order.
fn places([nx, ny, nz]: [usize; 3]) -> impl Iterator<Item = [usize; 3]> {
    (0..nx * ny * nz).map(move |at| [at % nx, at / nx % ny, at / (nx * ny)])
}

/// The elements (`below`: those that begin up to one before) or vertices round a place, inside of `size`.
fn around(place: [usize; 3], size: [usize; 3], below: bool) -> impl Iterator<Item = [usize; 3]> {
    (0..8usize).filter_map(move |corner| {
        let mut at = [0; 3];
        for a in 0..3 {
            let up = corner >> a & 1;
            at[a] = if below { (place[a] + up).checked_sub(1)? } else { place[a] + up };
        }
        (0..3).all(|a| at[a] < size[a]).then_some(at)
    })
}
