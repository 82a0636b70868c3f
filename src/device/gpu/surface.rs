//! Isosurfaces: first hits, occlusion, beauty, subsurface scattering, and the light volume at hits.

use encase::ShaderType;
use glam::{UVec2, UVec3, Vec3};

use super::clip::clips;
use super::shader::{SURFACE_BEAUTY, SURFACE_HITS, SURFACE_LIGHT, SURFACE_OCCLUSION, SURFACE_SUBSURFACE, Shader};
use super::{Gpu, gpu, holds, uvec3};
use crate::device::surface::{
    self as args, Beauty, Environment, Estimator, Hit, Map, Occlusion, Samples, Subsurface, Surfaces,
};
use crate::device::{Falloff, Term, Weight};
use crate::error::Result;

/// Rounds of loops in one dispatch: drivers end what takes too long, and software Vulkan what takes 65535.
const ROUNDS: f64 = 60_000.0;

#[derive(ShaderType)]
pub(super) struct Params {
    size: UVec3,
    step: f32,
    eye: Vec3,
    edge: f32,
    forward: Vec3,
    mean_spacing: f32,
    right: Vec3,
    count: u32,
    up: Vec3,
    surfaces: u32,
    spacing: Vec3,
    seed: u32,
    picture: UVec2,
    samples: UVec2,
    specular_samples: UVec2,
    radiance: UVec2,
    irradiance: UVec2,
    radius: f32,
    steps: u32,
    rate: Vec3,
    lo: f32,
    scale: f32,
    entries: u32,
    secondary: u32,
    light_size: UVec3,
    kind: u32,
    weight: Vec3,
    direction: Vec3,
    position: Vec3,
    floor: f32,
    outer: f32,
    slope: f32,
    cosine: f32,
    clips: u32,
}

#[derive(ShaderType)]
struct Surface {
    diffuse: Vec3,
    value: f32,
    specular: f32,
    exponent: f32,
    exponent_gradient: f32,
    opacity: f32,
    transmission: f32,
    spread: f32,
    ior: f32,
    reflection: UVec2,
}

/// What all calls bind, and the longest way of a ray in steps.
struct Bound {
    params: Params,
    surfaces: wgpu::Buffer,
    empty: wgpu::Buffer,
    field: wgpu::Buffer,
    extinction: wgpu::Buffer,
    clips: wgpu::Buffer,
    skips: bool,
    /// Rounds of loops that a ray through the volume takes at most.
    way: f64,
}

impl Bound {
    fn new(gpu: &Gpu, s: &Surfaces, count: usize, environment: Option<&Environment>) -> Result<Self> {
        let (grid, camera) = (s.grid, s.camera);
        let (lo, hi) = grid.bounds();
        let aspect = s.picture[0] as f32 / s.picture[1] as f32;
        let step = s.step.max((1e-6 * (hi - lo).length()) as f32);
        let map = |m: &Map| UVec2::new(m.first as u32, m.edge as u32);
        let filtered = environment.and_then(|e| e.filtered);
        let surfaces: Vec<Surface> = s
            .surfaces
            .iter()
            .enumerate()
            .map(|(k, surface)| Surface {
                diffuse: surface.diffuse.into(),
                value: surface.value,
                specular: surface.specular,
                exponent: surface.exponent,
                exponent_gradient: surface.exponent_gradient,
                opacity: surface.opacity,
                transmission: surface.transmission,
                spread: surface.spread,
                ior: surface.ior,
                reflection: filtered.map_or(UVec2::ZERO, |f| map(&f.reflections[k])),
            })
            .collect();
        let params = Params {
            size: uvec3(grid.size),
            step,
            eye: s.eye(),
            edge: s.bricks.edge as f32,
            forward: camera.forward,
            mean_spacing: grid.mean_spacing() as f32,
            right: camera.tan * aspect * camera.right,
            count: count as u32,
            up: camera.tan * camera.up,
            surfaces: s.surfaces.len() as u32,
            spacing: glam::DVec3::from(grid.spacing).as_vec3(),
            seed: 0,
            picture: UVec2::new(s.picture[0] as u32, s.picture[1] as u32),
            samples: UVec2::ZERO,
            specular_samples: UVec2::ZERO,
            radiance: environment.map_or(UVec2::ZERO, |e| map(&e.radiance)),
            irradiance: filtered.map_or(UVec2::ZERO, |f| map(&f.irradiance)),
            radius: 0.0,
            steps: 0,
            rate: Vec3::ZERO,
            lo: 0.0,
            scale: 0.0,
            entries: 0,
            secondary: 0,
            light_size: UVec3::ZERO,
            kind: 0,
            weight: Vec3::ZERO,
            direction: Vec3::ZERO,
            position: Vec3::ZERO,
            floor: 0.0,
            outer: 0.0,
            slope: 0.0,
            cosine: 0.0,
            clips: s.clips.len() as u32,
        };
        // Each sample also goes through the list of surfaces.
        let sample = (1 + s.surfaces.len()) as f64;
        let bisections = (1 + s.surfaces.len()) as f64 * Surfaces::BISECTIONS as f64;
        let way = sample * (hi - lo).length() / f64::from(step) + bisections;
        gpu.rounds(way, "a ray of so small a step")?;
        Ok(Bound {
            params,
            surfaces: gpu.structures(&surfaces)?,
            empty: gpu.storage(s.empty)?,
            field: holds(s.field, grid.len())?.clone(),
            extinction: gpu.scratch(1)?,
            clips: gpu.structures(&clips(s.clips))?,
            skips: !s.empty.is_empty(),
            way,
        })
    }

    fn run(
        &self,
        gpu: &Gpu,
        shader: &Shader,
        constants: &[(&str, bool)],
        buffers: &[(&str, &wgpu::Buffer)],
    ) -> Result<()> {
        let params = gpu.uniform(&self.params)?;
        let mut bindings = vec![
            ("params", &params),
            ("field", &self.field),
            ("empty", &self.empty),
            ("surfaces", &self.surfaces),
            ("extinction", &self.extinction),
            ("clips", &self.clips),
        ];
        bindings.extend_from_slice(buffers);
        let cut = f64::from(self.params.clips > 0);
        let mut given = vec![("SKIP", f64::from(self.skips)), ("CUT", cut), ("TRANSFER", 0.0), ("PAPER", 0.0)];
        for (name, value) in constants {
            match given.iter_mut().find(|(n, _)| n == name) {
                Some(known) => known.1 = f64::from(*value),
                None => given.push((name, f64::from(*value))),
            }
        }
        let groups = (self.params.count as usize).div_ceil(64);
        gpu.run_with(shader, shader.name, &given, &bindings, [groups, 1, 1])
    }

    /// Runs a kernel for parts of a range of samples, each of which takes `rounds` rounds of loops.
    fn in_parts(&mut self, rounds: f64, samples: Samples, mut run: impl FnMut(&Self) -> Result<()>) -> Result<()> {
        let most = (ROUNDS / rounds).max(1.0) as u32;
        for first in (samples.first..samples.end).step_by(most as usize) {
            self.params.samples = UVec2::new(first, samples.end.min(first + most));
            run(self)?;
        }
        Ok(())
    }
}

fn paper(estimator: Estimator) -> (&'static str, bool) {
    ("PAPER", estimator == Estimator::Paper)
}

pub(super) fn hits(gpu: &Gpu, surfaces: &Surfaces, hits: &mut [Hit]) -> Result<()> {
    if hits.is_empty() {
        return Ok(());
    }
    let bound = Bound::new(gpu, surfaces, hits.len(), None)?;
    let carried = gpu.storage(hits)?;
    bound.run(gpu, &SURFACE_HITS, &[], &[("hits", &carried)])?;
    gpu.read(&carried, bytemuck::cast_slice_mut(hits))
}

pub(super) fn occlusion(
    gpu: &Gpu,
    surfaces: &Surfaces,
    occlusion: &Occlusion,
    samples: Samples,
    hits: &[Hit],
    sums: &mut [[f32; 4]],
) -> Result<()> {
    if hits.is_empty() {
        return Ok(());
    }
    let mut bound = Bound::new(gpu, surfaces, hits.len(), None)?;
    bound.params.seed = occlusion.seed;
    bound.params.radius = occlusion.radius;
    bound.params.steps = occlusion.steps;
    let [rays, carried] = [gpu.storage(hits)?, gpu.storage(sums)?];
    let rounds = f64::from(occlusion.steps) * (1 + 2 * surfaces.surfaces.len()) as f64 + 17.0;
    bound.in_parts(rounds, samples, |bound| {
        bound.run(gpu, &SURFACE_OCCLUSION, &[paper(occlusion.estimator)], &[("hits", &rays), ("sums", &carried)])
    })?;
    gpu.read(&carried, bytemuck::cast_slice_mut(sums))
}

pub(super) fn beauty(
    gpu: &Gpu,
    surfaces: &Surfaces,
    beauty: &Beauty,
    hits: &[Hit],
    sums: &mut [[[f32; 3]; 2]],
) -> Result<()> {
    if hits.is_empty() {
        return Ok(());
    }
    let environment = &beauty.environment;
    let mut bound = Bound::new(gpu, surfaces, hits.len(), Some(environment))?;
    bound.params.seed = beauty.seed;
    let range = |s: Samples| UVec2::new(s.first, s.end);
    (bound.params.samples, bound.params.specular_samples) = (range(beauty.diffuse), range(beauty.specular));
    let [rays, carried, bent] = [gpu.storage(hits)?, gpu.storage(sums)?, gpu.storage(beauty.bent)?];
    let constants =
        [paper(beauty.estimator), ("BENT", !beauty.bent.is_empty()), ("FILTERED", environment.filtered.is_some())];
    let texels = texels(environment)?;
    bound.run(
        gpu,
        &SURFACE_BEAUTY,
        &constants,
        &[("hits", &rays), ("sums", &carried), ("texels", texels), ("bent", &bent)],
    )?;
    gpu.read(&carried, bytemuck::cast_slice_mut(sums))
}

fn texels<'a>(environment: &Environment<'a>) -> Result<&'a wgpu::Buffer> {
    gpu(environment.texels)
}

pub(super) fn subsurface(
    gpu: &Gpu,
    surfaces: &Surfaces,
    subsurface: &Subsurface,
    hits: &[Hit],
    sums: &mut [[f32; 3]],
) -> Result<()> {
    if hits.is_empty() {
        return Ok(());
    }
    let mut bound = Bound::new(gpu, surfaces, hits.len(), Some(&subsurface.environment))?;
    bound.params.seed = subsurface.seed;
    bound.params.secondary = subsurface.secondary;
    bound.params.rate = subsurface.attenuation.rate.into();
    if let Some(table) = subsurface.attenuation.table {
        bound.extinction = gpu.storage(&table.extinction)?;
        bound.params.lo = table.lo;
        bound.params.scale = table.scale();
        bound.params.entries = table.extinction.len() as u32;
    }
    let [rays, carried] = [gpu.storage(hits)?, gpu.storage(sums)?];
    let constants = [
        paper(subsurface.estimator),
        ("TRANSFER", subsurface.attenuation.table.is_some()),
        ("FAST", subsurface.fast),
        ("REFRACTS", subsurface.refracts),
    ];
    let outwards = f64::from(subsurface.secondary) * if subsurface.fast { 17.0 } else { bound.way + 17.0 };
    let texels = texels(&subsurface.environment)?;
    bound.in_parts(bound.way + outwards, subsurface.primary, |bound| {
        bound.run(gpu, &SURFACE_SUBSURFACE, &constants, &[("hits", &rays), ("sums", &carried), ("texels", texels)])
    })?;
    gpu.read(&carried, bytemuck::cast_slice_mut(sums))
}

pub(super) fn light(
    gpu: &Gpu,
    surfaces: &Surfaces,
    term: &Term,
    hits: &[Hit],
    sums: &mut [[[f32; 3]; 2]],
) -> Result<()> {
    if hits.is_empty() {
        return Ok(());
    }
    let mut bound = Bound::new(gpu, surfaces, hits.len(), None)?;
    let params = &mut bound.params;
    params.light_size = uvec3(term.grid.size);
    match term.weight {
        Weight::Uniform(weight) => params.weight = weight.into(),
        Weight::Phase { direction, irradiance, .. } => {
            (params.kind, params.weight, params.direction) = (1, irradiance.into(), direction);
        }
        Weight::Lamp { lamp, intensity, .. } => {
            let Falloff { position, floor, axis, outer, slope, cosine, .. } = lamp.on(surfaces.grid, 1);
            (params.kind, params.weight, params.direction) = (2, intensity.into(), axis);
            (params.position, params.floor) = (position, floor);
            (params.outer, params.slope, params.cosine) = (outer, slope, cosine);
        }
        Weight::Current { .. } => return Ok(()),
    }
    let [rays, carried] = [gpu.storage(hits)?, gpu.storage(sums)?];
    let light = holds(term.values, term.grid.len())?;
    bound.run(gpu, &SURFACE_LIGHT, &[], &[("hits", &rays), ("sums", &carried), ("light", light)])?;
    gpu.read(&carried, bytemuck::cast_slice_mut(sums))
}

const _: () = assert!(size_of::<Hit>() == 48 && args::Surface::SHARPEST == 1e4);
