//! Ray casting through data lit by light volumes.

use std::ops::Range;

use encase::ShaderType;
use glam::{DVec3, UVec2, UVec3, Vec3};

use super::clip::clips;
use super::matter::Matter;
use super::shader::MARCH;
use super::{Gpu, holds, uvec3};
use crate::device::{Falloff, March, Part, Ray, Term, Weight};
use crate::error::{Error, Result};
use crate::frame::Frame;
use crate::grid::Grid;

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
    rows: u32,
    steep: f32,
    per_world: Vec3,
    spacing: f32,
    towards_light: Vec3,
    ambient: f32,
    diffuse: f32,
    specular: f32,
    shininess: f32,
    chromatic: Vec3,
    picture: UVec2,
    held: UVec2,
    clips: u32,
    cells: UVec2,
}

#[derive(ShaderType)]
struct TermParams {
    size: UVec3,
    first: u32,
    weight: Vec3,
    kind: u32,
    direction: Vec3,
    g: f32,
    held: UVec2,
    position: Vec3,
    floor: f32,
    outer: f32,
    slope: f32,
    cosine: f32,
}

pub(super) fn march(gpu: &Gpu, march: &March, frame: &mut Frame) -> Result<()> {
    let mut rays = vec![Ray::FRESH; frame.pixels.len()];
    march_slab(gpu, march, &Part::whole(march), frame.size, &mut rays)?;
    frame.pixels.iter_mut().zip(&rays).for_each(|(p, r)| *p = r.pixel());
    Ok(())
}

/// All tiles but the listed ones are rays that end before their first sample.
pub(super) fn march_tiles(gpu: &Gpu, march: &March, tiles: &[u32], frame: &mut Frame) -> Result<()> {
    let ([across, down], width) = (March::tiles(frame.size), frame.size[0]);
    let mut listed = vec![false; across * down];
    tiles.iter().for_each(|t| listed[*t as usize] = true);
    let listed = |pixel: usize| listed[pixel / width / March::TILE * across + pixel % width / March::TILE];
    let spent = Ray { transmittance: [0.0; 3], ..Ray::FRESH };
    let mut rays: Vec<Ray> = (0..frame.pixels.len()).map(|p| if listed(p) { Ray::FRESH } else { spent }).collect();
    march_slab(gpu, march, &Part::whole(march), frame.size, &mut rays)?;
    let pixels = frame.pixels.iter_mut().zip(&rays).enumerate().filter(|(p, _)| listed(*p));
    pixels.for_each(|(_, (pixel, ray))| *pixel = ray.pixel());
    Ok(())
}

pub(super) fn march_slab(gpu: &Gpu, march: &March, part: &Part, picture: [usize; 2], rays: &mut [Ray]) -> Result<()> {
    let (grid, table) = (march.grid, march.table);
    if grid.is_empty() || picture.contains(&0) {
        return Ok(());
    }
    if march.terms.len() > MAX_TERMS {
        let n = march.terms.len();
        return Err(Error::Unsupported(format!("{n} light volumes in one picture on a GPU; at most {MAX_TERMS}")));
    }
    let (lo, hi) = grid.bounds();
    let samples = (hi - lo).length() / f64::from(march.step);
    gpu.rounds(samples * (march.terms.len().max(SLOTS) - SLOTS + 1) as f64, "a ray of so small a step")?;
    let matter = Matter::new(gpu, table, march.gradient, planes(grid, &part.field))?;
    let (terms, buffers) = place(gpu, march.terms, &part.terms, grid)?;
    let params = params(march, part, picture, &matter);
    let carried = gpu.storage(bytemuck::cast_slice::<Ray, f32>(rays))?;

    let params = gpu.uniform(&params)?;
    let terms = gpu.structures(&terms)?;
    let majorant = gpu.storage(march.majorant)?;
    let clips = gpu.structures(&clips(march.clips))?;
    let unused = gpu.scratch(1)?;
    let mut bindings = vec![
        ("params", &params),
        ("field", holds(march.field, planes(grid, &part.field))?),
        ("table", &matter.table),
        ("sums", &matter.sums),
        ("gradient", &matter.gradient),
        ("majorant", &majorant),
        ("terms", &terms),
        ("rays", &carried),
        ("clips", &clips),
    ];
    bindings.extend(LIGHTS.iter().enumerate().map(|(i, name)| (*name, buffers.get(i).unwrap_or(&unused))));
    let mut parts = vec![
        ("TERMS", march.terms.len() as f64),
        ("SKIP", f64::from(!march.majorant.is_empty())),
        ("SHADE", f64::from(march.phong.is_some())),
        ("LAMPS", f64::from(march.terms.iter().any(|t| matches!(t.weight, Weight::Lamp { .. })))),
    ];
    parts.extend(matter.parts());
    gpu.run_with(&MARCH, "march", &parts, &bindings, [picture[0].div_ceil(8), picture[1].div_ceil(8), 1])?;
    gpu.read(&carried, bytemuck::cast_slice_mut(rays))
}

/// Values of some planes of a grid.
fn planes(grid: &Grid, held: &Range<usize>) -> usize {
    grid.size[0] * grid.size[1] * held.len()
}

/// First and last plane.
fn ends(held: &Range<usize>) -> UVec2 {
    UVec2::new(held.start as u32, held.end as u32 - 1)
}

fn params(march: &March, part: &Part, picture: [usize; 2], matter: &Matter) -> Params {
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
        entries: matter.entries,
        rows: matter.rows,
        steep: matter.steep,
        per_world: (1.0 / spacing).as_vec3(),
        spacing: grid.mean_spacing() as f32,
        towards_light: phong.map_or(Vec3::ZERO, |p| p.towards_light),
        ambient: phong.map_or(0.0, |p| p.ambient),
        diffuse: phong.map_or(0.0, |p| p.diffuse),
        specular: phong.map_or(0.0, |p| p.specular),
        shininess: phong.map_or(0.0, |p| p.shininess),
        chromatic: march.table.chromatic.into(),
        picture: UVec2::new(picture[0] as u32, picture[1] as u32),
        held: ends(&part.field),
        clips: march.clips.len() as u32,
        cells: UVec2::new(part.cells.start as u32, part.cells.end as u32),
    }
}

/// The terms as the kernel takes them, largest first, and their light buffers: one for each term, but the last is shared,
/// its terms copied together, where there are more.
fn place(
    gpu: &Gpu,
    terms: &[Term],
    held: &[Range<usize>],
    data: &Grid,
) -> Result<(Vec<TermParams>, Vec<wgpu::Buffer>)> {
    let mut order: Vec<(&Term, &Range<usize>)> = terms.iter().zip(held).collect();
    order.sort_by_key(|(t, held)| std::cmp::Reverse((t.grid.len(), t.grid.size, held.start)));
    let mut placed: Vec<TermParams> = order.iter().map(|(t, held)| term_params(t, held, data)).collect();
    let alone = if terms.len() <= SLOTS { terms.len() } else { SLOTS - 1 };
    let mut buffers = Vec::new();
    for (term, held) in &order[..alone] {
        buffers.push(holds(term.values, planes(term.grid, held))?.clone());
    }
    if alone < terms.len() {
        let shared = gpu.scratch(order[alone..].iter().map(|(t, held)| planes(t.grid, held)).sum())?;
        let mut encoder = gpu.encoder();
        let mut first = 0;
        for ((term, held), placed) in order[alone..].iter().zip(&mut placed[alone..]) {
            let len = planes(term.grid, held);
            encoder.copy_buffer_to_buffer(holds(term.values, len)?, 0, &shared, 4 * first as u64, 4 * len as u64);
            placed.first = first as u32;
            first += len;
        }
        gpu.submit(encoder)?;
        buffers.push(shared);
    }
    Ok((placed, buffers))
}

fn term_params(term: &Term, held: &Range<usize>, data: &Grid) -> TermParams {
    let plain = |kind, weight: [f32; 3], direction, g| TermParams {
        size: uvec3(term.grid.size),
        first: 0,
        weight: weight.into(),
        kind,
        direction,
        g,
        held: ends(held),
        position: Vec3::ZERO,
        floor: 0.0,
        outer: 0.0,
        slope: 0.0,
        cosine: 0.0,
    };
    match term.weight {
        Weight::Uniform(weight) => plain(0, weight, Vec3::ZERO, 0.0),
        Weight::Phase { direction, irradiance, g } => plain(1, irradiance, direction, g),
        Weight::Current { axis, weight } => plain(2, weight, Vec3::AXES[axis], 0.0),
        Weight::Lamp { lamp, intensity, g } => {
            let Falloff { position, floor, axis, outer, slope, cosine, .. } = lamp.on(data, 1);
            TermParams { position, floor, outer, slope, cosine, ..plain(3, intensity, axis, g) }
        }
    }
}
