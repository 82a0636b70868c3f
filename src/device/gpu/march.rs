//! Ray casting through data lit by light volumes.

use encase::ShaderType;
use glam::{DVec3, UVec2, UVec3, Vec3};

use super::shader::MARCH;
use super::{Gpu, gpu as raw, holds, uvec3};
use crate::device::{March, Term, Weight};
use crate::error::{Error, Result};
use crate::frame::Frame;

/// Light buffers that `shaders/march.wgsl` binds.
const SLOTS: usize = 8;
/// Terms that it keeps weights for.
const MAX_TERMS: usize = 32;
/// Names of the light buffers.
const LIGHTS: [&str; SLOTS] = ["light0", "light1", "light2", "light3", "light4", "light5", "light6", "light7"];

#[derive(ShaderType)]
pub(super) struct Params {
    size: UVec3,
    step: f32,
    eye: Vec3,
    edge: u32,
    forward: Vec3,
    lo: f32,
    right: Vec3,
    scale: f32,
    up: Vec3,
    entries: u32,
    per_world: Vec3,
    terms: u32,
    picture: UVec2,
    skip: u32,
    shade: u32,
    towards_light: Vec3,
    ambient: f32,
    diffuse: f32,
    specular: f32,
    shininess: f32,
    spacing: f32,
}

#[derive(ShaderType)]
struct Optics {
    albedo: Vec3,
    extinction: f32,
    emission: Vec3,
}

#[derive(ShaderType)]
struct TermParams {
    size: UVec3,
    slot: u32,
    weight: Vec3,
    first: u32,
    direction: Vec3,
    g: f32,
    kind: u32,
    same_grid: u32,
}

pub(super) fn march(gpu: &Gpu, march: &March, frame: &mut Frame) -> Result<()> {
    let (grid, table) = (march.grid, march.table);
    if grid.is_empty() || frame.size.contains(&0) {
        frame.pixels.fill([0.0; 4]);
        return Ok(());
    }
    if march.terms.len() > MAX_TERMS {
        let n = march.terms.len();
        return Err(Error::Unsupported(format!("{n} light volumes in one picture on a GPU; at most {MAX_TERMS}")));
    }
    let optics: Vec<Optics> = (0..table.extinction.len())
        .map(|i| Optics {
            albedo: table.albedo[i].into(),
            extinction: table.extinction[i],
            emission: table.emission.get(i).copied().unwrap_or_default().into(),
        })
        .collect();
    let (buffers, places) = place(gpu, march.terms)?;
    let terms: Vec<TermParams> = (0..march.terms.len()).map(|t| term_params(march.terms, t, places[t])).collect();
    let params = params(march, frame.size, optics.len());
    let pixels = gpu.scratch(4 * frame.pixels.len())?;

    let params = gpu.uniform(&params)?;
    let table = gpu.structures(&optics)?;
    let terms = gpu.structures(&terms)?;
    let majorant = gpu.storage(march.majorant)?;
    let unused = gpu.scratch(1)?;
    let mut bindings = vec![
        ("params", &params),
        ("field", holds(march.field, grid.len())?),
        ("table", &table),
        ("majorant", &majorant),
        ("terms", &terms),
        ("pixels", &pixels),
    ];
    bindings.extend(LIGHTS.iter().enumerate().map(|(i, name)| (*name, buffers.get(i).unwrap_or(&unused))));
    gpu.run(&MARCH, "march", &bindings, [frame.size[0].div_ceil(8), frame.size[1].div_ceil(8), 1])?;
    gpu.read(&pixels, bytemuck::cast_slice_mut(&mut frame.pixels))
}

fn params(march: &March, picture: [usize; 2], entries: usize) -> Params {
    let (grid, camera) = (march.grid, march.camera);
    let spacing = DVec3::from(grid.spacing);
    let (lo, hi) = grid.bounds();
    let aspect = picture[0] as f32 / picture[1] as f32;
    let phong = march.phong;
    Params {
        size: uvec3(grid.size),
        step: march.step.max((1e-6 * (hi - lo).length()) as f32),
        eye: ((camera.eye.as_dvec3() - DVec3::from(grid.origin)) / spacing).as_vec3(),
        edge: march.bricks.edge as u32,
        forward: camera.forward,
        lo: march.table.lo,
        right: camera.tan * aspect * camera.right,
        scale: march.table.scale(),
        up: camera.tan * camera.up,
        entries: entries as u32,
        per_world: (1.0 / spacing).as_vec3(),
        terms: march.terms.len() as u32,
        picture: UVec2::new(picture[0] as u32, picture[1] as u32),
        skip: u32::from(!march.majorant.is_empty()),
        shade: u32::from(phong.is_some()),
        towards_light: phong.map_or(Vec3::ZERO, |p| p.towards_light),
        ambient: phong.map_or(0.0, |p| p.ambient),
        diffuse: phong.map_or(0.0, |p| p.diffuse),
        specular: phong.map_or(0.0, |p| p.specular),
        shininess: phong.map_or(0.0, |p| p.shininess),
        spacing: grid.mean_spacing() as f32,
    }
}

/// Where the values of a term are: a light buffer and the first value in it.
type Place = (usize, usize);

/// Light buffers for the terms. Each has its own while there are enough; else the smallest share one, copied together.
fn place(gpu: &Gpu, terms: &[Term]) -> Result<(Vec<wgpu::Buffer>, Vec<Place>)> {
    let mut order: Vec<usize> = (0..terms.len()).collect();
    order.sort_by_key(|&t| std::cmp::Reverse(terms[t].grid.len()));
    let alone = if terms.len() <= SLOTS { terms.len() } else { SLOTS - 1 };
    let mut places = vec![(0, 0); terms.len()];
    let mut buffers = Vec::new();
    for (slot, &t) in order[..alone].iter().enumerate() {
        places[t] = (slot, 0);
        buffers.push(holds(terms[t].values, terms[t].grid.len())?.clone());
    }
    if alone < terms.len() {
        let shared = gpu.scratch(order[alone..].iter().map(|&t| terms[t].grid.len()).sum())?;
        let mut encoder = gpu.encoder();
        let mut first = 0;
        for &t in &order[alone..] {
            let len = terms[t].grid.len();
            encoder.copy_buffer_to_buffer(raw(terms[t].values)?, 0, &shared, 4 * first as u64, 4 * len as u64);
            places[t] = (alone, first);
            first += len;
        }
        gpu.submit(encoder)?;
        buffers.push(shared);
    }
    Ok((buffers, places))
}

fn term_params(terms: &[Term], t: usize, (slot, first): Place) -> TermParams {
    let term = &terms[t];
    let (kind, weight, direction, g) = match term.weight {
        Weight::Uniform(weight) => (0, weight, Vec3::ZERO, 0.0),
        Weight::Phase { direction, irradiance, g } => (1, irradiance, direction, g),
        Weight::Current { axis, weight } => (2, weight, Vec3::AXES[axis], 0.0),
    };
    TermParams {
        size: uvec3(term.grid.size),
        slot: slot as u32,
        weight: weight.into(),
        first: first as u32,
        direction,
        g,
        kind,
        same_grid: u32::from(t > 0 && terms[t - 1].grid.size == term.grid.size),
    }
}
