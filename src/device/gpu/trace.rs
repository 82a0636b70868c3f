//! Path tracing: one sample of every pixel a dispatch.

use encase::ShaderType;
use glam::{DVec3, UVec2, UVec3, Vec3, Vec4};

use super::clip::clips;
use super::shader::TRACE;
use super::{Gpu, holds, uvec3};
use crate::device::emitter::Emitter;
use crate::device::{Phase, Sampling, Tally, Trace, Traced};
use crate::error::Result;
use crate::geometry::Node;

/// Sums of a pixel in `shaders/trace.wgsl`.
const SUMS: usize = 15;
/// Samples that are summed in f32 before they join the others.
const BATCH: usize = 16;

#[derive(ShaderType)]
pub(super) struct Params {
    size: UVec3,
    edge: u32,
    bricks: UVec3,
    entries: u32,
    per_length: Vec3,
    lo: f32,
    eye: Vec3,
    scale: f32,
    forward: Vec3,
    focus: f32,
    right: Vec3,
    radius: f32,
    up: Vec3,
    blades: u32,
    unit_right: Vec3,
    g: f32,
    unit_up: Vec3,
    phase: u32,
    chromatic: Vec3,
    emitters: u32,
    picture: UVec2,
    sample: u32,
    seed: u32,
    depth: u32,
    sampling: u32,
    factor: f32,
    reference: f32,
    clips: u32,
    rows: u32,
    steep: f32,
    walls: u32,
    lift: f32,
}

/// A node of the tree of triangles: see [`crate::geometry::Node`].
#[derive(ShaderType)]
struct Wall {
    lower: Vec3,
    skip: u32,
    upper: Vec3,
    mesh: u32,
    edge: Vec3,
}

#[derive(ShaderType)]
struct Optics {
    albedo: Vec3,
    extinction: f32,
    emission: Vec3,
}

#[derive(ShaderType)]
struct EmitterParams {
    position: Vec3,
    shape: u32,
    axis: Vec3,
    radius: f32,
    u: Vec3,
    inner: f32,
    v: Vec3,
    edge: f32,
    radiance: Vec3,
    slope: f32,
    image: UVec3,
    share: f32,
    two_sided: u32,
    visible: u32,
}

pub(super) fn trace(gpu: &Gpu, trace: &Trace, picture: [usize; 2], tallies: &mut [Tally]) -> Result<Traced> {
    if trace.grid.is_empty() || picture.contains(&0) {
        return Ok(Traced::default());
    }
    let (nodes, colours) = walls(trace);
    refuse(gpu, trace, nodes.len())?;
    let table = trace.table;
    let (extinction, albedo, emission) = table.columns();
    let optics: Vec<Optics> = (0..extinction.len())
        .map(|i| Optics {
            albedo: albedo[i].into(),
            extinction: extinction[i],
            emission: emission.get(i).copied().unwrap_or_default().into(),
        })
        .collect();
    let gradient = match trace.gradient.filter(|_| table.graded.is_some()) {
        Some(gradient) => holds(gradient, trace.grid.len())?.clone(),
        None => gpu.scratch(1)?,
    };
    let surfaces: Vec<Vec4> =
        trace.surface.map_or(vec![], |s| s.columns.iter().map(|c| Vec4::from_array(*c)).collect());
    let table = gpu.structures(&optics)?;
    let surfaces = gpu.structures(&surfaces)?;
    let emitters = gpu.structures(&trace.emitters.iter().map(emitter).collect::<Vec<_>>())?;
    let clips = gpu.structures(&clips(trace.clips))?;
    let (walls, wall_colours) = (gpu.structures(&nodes)?, gpu.structures(&colours)?);
    let (majorant, images) = (gpu.storage(trace.majorant)?, gpu.storage(trace.images)?);
    let parts = [
        ("GLOW", f64::from(!trace.table.emission.is_empty())),
        ("WALLS", f64::from(trace.meshes.is_some())),
        ("GRADED", f64::from(trace.table.graded.is_some())),
        ("CHROMATIC", f64::from(trace.table.chromatic != [1.0; 3])),
        ("SURFACES", trace.surface.map_or(0.0, |s| if s.factor.is_some() { 1.0 } else { 2.0 })),
    ];
    let groups = [picture[0].div_ceil(8), picture[1].div_ceil(8), 1];
    let mut traced = Traced::default();
    let samples: Vec<u32> = trace.samples.clone().collect();
    for batch in samples.chunks(BATCH) {
        let sums = gpu.scratch(SUMS * tallies.len())?;
        for &sample in batch {
            let params = gpu.uniform(&params(trace, picture, sample, nodes.len()))?;
            let bindings = [
                ("params", &params),
                ("field", holds(trace.field, trace.grid.len())?),
                ("gradient", &gradient),
                ("table", &table),
                ("surfaces", &surfaces),
                ("majorant", &majorant),
                ("emitters", &emitters),
                ("images", &images),
                ("clips", &clips),
                ("walls", &walls),
                ("wall_colours", &wall_colours),
                ("sums", &sums),
            ];
            gpu.run_with(&TRACE, "trace", &parts, &bindings, groups)?;
        }
        let values: Vec<[f32; SUMS]> = gpu.values(&sums, tallies.len())?;
        for (tally, sums) in tallies.iter_mut().zip(&values) {
            tally.samples += batch.len() as u32;
            for c in 0..3 {
                tally.radiance[c] += f64::from(sums[c]);
                tally.squares[c] += f64::from(sums[3 + c]);
                tally.albedo[c] += sums[7 + c];
                tally.normal[c] += sums[10 + c];
            }
            tally.coverage += f64::from(sums[6]);
            tally.depth += sums[13];
            traced.exceeded += sums[14] as u64;
        }
    }
    Ok(traced)
}

/// What the shader cannot do.
fn refuse(gpu: &Gpu, trace: &Trace, nodes: usize) -> Result<()> {
    // Rounds of a path: bricks on its way, tentative collisions, and nodes of a tree of surfaces that are seen edge on, there and
    // towards a light, for each of its scatterings.
    let (lo, hi) = trace.grid.bounds();
    let densest = trace.majorant.iter().fold(0.0f32, |m, v| m.max(*v));
    let across = trace.bricks.counts().iter().sum::<usize>() as f64;
    let rounds = across + f64::from(densest) * (hi - lo).length() + 4.0 * (nodes as f64).sqrt();
    gpu.rounds(rounds * 2.0 * f64::from(trace.depth.clamp(1, 16)), "a path through so dense a medium")
}

/// The tree of opaque surfaces, relative to value (0, 0, 0), and their colours.
fn walls(trace: &Trace) -> (Vec<Wall>, Vec<Vec3>) {
    let Some(meshes) = trace.meshes else { return (vec![], vec![]) };
    let wall = |Node { lower, skip, upper, mesh, edge }| Wall { lower, skip, upper, mesh, edge };
    let nodes = meshes.nodes(DVec3::from(trace.grid.origin)).into_iter().map(wall).collect();
    (nodes, meshes.colors().iter().map(|c| Vec3::from(*c)).collect())
}

fn params(trace: &Trace, picture: [usize; 2], sample: u32, walls: usize) -> Params {
    let (grid, table, camera) = (trace.grid, trace.table, trace.camera);
    let aspect = picture[0] as f32 / picture[1] as f32;
    let (phase, g) = match trace.phase {
        Phase::HenyeyGreenstein(g) => (0, g),
        Phase::Schlick(g) => (1, g),
    };
    Params {
        size: uvec3(grid.size),
        edge: trace.bricks.edge as u32,
        bricks: uvec3(trace.bricks.counts()),
        entries: table.extinction.len() as u32,
        per_length: Vec3::from(grid.spacing.map(|s| (1.0 / s) as f32)),
        lo: table.lo,
        eye: (camera.eye.as_dvec3() - DVec3::from(grid.origin)).as_vec3(),
        scale: table.scale(),
        forward: camera.forward,
        focus: trace.focus,
        right: camera.tan * aspect * camera.right,
        radius: camera.lens.radius,
        up: camera.tan * camera.up,
        blades: camera.lens.blades,
        unit_right: camera.right,
        g,
        unit_up: camera.up,
        phase,
        chromatic: table.chromatic.into(),
        emitters: trace.emitters.len() as u32,
        picture: UVec2::new(picture[0] as u32, picture[1] as u32),
        sample,
        seed: trace.seed,
        depth: trace.depth,
        sampling: match trace.sampling {
            Sampling::Both => 0,
            Sampling::Lights => 1,
            Sampling::Scattering => 2,
        },
        factor: trace.surface.and_then(|s| s.factor).unwrap_or(0.0),
        reference: trace.surface.map_or(0.0, |s| s.reference),
        clips: trace.clips.len() as u32,
        rows: table.graded.as_ref().map_or(1, |g| g.rows() as u32),
        steep: table.graded.as_ref().map_or(0.0, |g| g.scale()),
        walls: walls as u32,
        lift: (1e-3 * grid.mean_spacing()) as f32,
    }
}

fn emitter(e: &Emitter) -> EmitterParams {
    EmitterParams {
        position: e.position,
        shape: e.shape as u32,
        axis: e.axis,
        radius: e.radius,
        u: e.u,
        inner: e.inner,
        v: e.v,
        edge: e.edge,
        radiance: e.radiance,
        slope: e.slope,
        image: e.image.into(),
        share: e.share,
        two_sided: e.two_sided.into(),
        visible: e.visible.into(),
    }
}
