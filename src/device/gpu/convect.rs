//! Upwind convection: one dispatch per front.

use encase::ShaderType;
use glam::{IVec3, UVec3, Vec3};

use super::classify::groups;
use super::shader::CONVECT;
use super::sweep::strides;
use super::{Gpu, dispatch, holds, uvec3};
use crate::device::Buffer;
use crate::device::convection::{Convected, Convection, Layers, Opacity, Rays, Start};
use crate::error::{Error, Result};
use crate::grid::BrickLayout;

#[derive(ShaderType)]
pub(super) struct Params {
    size: UVec3,
    literal: u32,
    centre: IVec3,
    length: f32,
    way: Vec3,
    central: u32,
    position: Vec3,
    ball: f32,
    spacing: Vec3,
    falloff: f32,
    extent: UVec3,
    strip: u32,
    stride: UVec3,
    start: u32,
    lanes: Vec3,
    iterations: u32,
    forward: UVec3,
    tolerance: f32,
    gain: f32,
}

fn params(convection: &Convection, layers: Layers) -> Params {
    let Convection { size, rays, opacity } = *convection;
    let (literal, length) = match opacity {
        Opacity::Calibrated { length } => (0, length),
        Opacity::Literal { length } => (1, length),
    };
    let axes = convection.axes();
    let mut params = Params {
        size: uvec3(size),
        literal,
        centre: IVec3::from_array(convection.centre()),
        length,
        way: Vec3::ZERO,
        central: 0,
        position: Vec3::ZERO,
        ball: 0.0,
        spacing: Vec3::ONE,
        falloff: 0.0,
        extent: uvec3(axes.map(|a| size[a])),
        strip: Convection::STRIP as u32,
        stride: uvec3(axes.map(|a| strides(size)[a])),
        start: match layers.start {
            Start::Zero => 0,
            Start::Upstream => 1,
            Start::Best => 2,
        },
        lanes: Vec3::ZERO,
        iterations: layers.iterations,
        forward: UVec3::ONE,
        tolerance: layers.tolerance,
        gain: convection.gain(),
    };
    match rays {
        Rays::Parallel { way } => {
            params.way = Vec3::from_array(way).abs();
            params.lanes = Vec3::from_array(axes.map(|a| way[a].abs()));
            params.forward = UVec3::from_array(axes.map(|a| u32::from(way[a] >= 0.0)));
        }
        Rays::Central { position, spacing, ball, falloff } => {
            params.central = 1;
            params.position = Vec3::from_array(position);
            params.spacing = Vec3::from_array(spacing);
            (params.ball, params.falloff) = (ball, falloff);
        }
    }
    params
}

/// Runs an entry point once for each front, with its number and workgroups.
fn run(
    gpu: &Gpu,
    (entry, params): (&str, Params),
    [sigma, before, rho]: [&wgpu::Buffer; 3],
    [other, errors]: [&wgpu::Buffer; 2],
    bricks: Option<[&wgpu::Buffer; 2]>,
    fronts: &[(u32, [usize; 3])],
) -> Result<[u32; 4]> {
    let report = gpu.scratch(4)?;
    let unused = [gpu.scratch(1)?, gpu.scratch(1)?];
    let [bricks, changes] = bricks.unwrap_or(unused.each_ref());
    let kernel = gpu.kernel(&CONVECT)?;
    let bound = kernel.bind(
        &gpu.device,
        &[
            ("params", &gpu.uniform(&params)?),
            ("sigma", sigma),
            ("before", before),
            ("rho", rho),
            ("other", other),
            ("errors", errors),
            ("report", &report),
            ("bricks", bricks),
            ("changes", changes),
        ],
    )?;
    let mut encoder = gpu.encoder();
    {
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&kernel.pipeline(&gpu.device, entry, &[]));
        pass.set_bind_group(0, &bound, &[]);
        for (front, groups) in fronts {
            pass.set_immediates(0, bytemuck::bytes_of(front));
            dispatch(&mut pass, *groups);
        }
    }
    gpu.submit(encoder)?;
    let values: Vec<u32> = gpu.values(&report, 4)?;
    Ok([values[0], values[1], values[2], values[3]])
}

const ANY: Layers = Layers { iterations: 0, tolerance: 0.0, start: Start::Upstream };

pub(super) fn layers(
    gpu: &Gpu,
    convection: &Convection,
    layers: Layers,
    sigma: &Buffer,
    before: &Buffer,
    rho: &mut Buffer,
) -> Result<Convected> {
    if matches!(convection.rays, Rays::Central { .. }) {
        return Err(Error::Device("layers are of parallel light".into()));
    }
    let voxels = convection.size.iter().product();
    let [deep, bands] = convection.strips();
    let columns = convection.size[convection.axes()[0]];
    let rounds = (layers.iterations as usize + 4) * (Convection::STRIP * columns).div_ceil(256);
    gpu.rounds(rounds as f64, "so many iterations of a layer")?;
    let buffers = [holds(sigma, voxels)?, holds(before, voxels)?, holds(rho, voxels)?];
    let scratch = [&gpu.spare(voxels)?, &gpu.scratch(deep * bands)?];
    let fronts: Vec<_> = (0..(deep + bands - 1) as u32).map(|front| (front, [bands, 1, 1])).collect();
    let [error, iterations, rows, _] =
        run(gpu, ("strips", params(convection, layers)), buffers, scratch, None, &fronts)?;
    Ok(Convected { error: f32::from_bits(error), iterations, updates: u64::from(rows) * columns as u64 })
}

pub(super) fn whole(
    gpu: &Gpu,
    convection: &Convection,
    sigma: &Buffer,
    before: &Buffer,
    rho: &mut Buffer,
) -> Result<f32> {
    let voxels = convection.size.iter().product();
    let buffers = [holds(sigma, voxels)?, holds(before, voxels)?, holds(rho, voxels)?];
    let scratch = [&gpu.scratch(1)?, &gpu.scratch(1)?];
    let fronts = [(0, groups(convection.size))];
    Ok(f32::from_bits(run(gpu, ("whole", params(convection, ANY)), buffers, scratch, None, &fronts)?[0]))
}

pub(super) fn ordered(
    gpu: &Gpu,
    convection: &Convection,
    layout: &BrickLayout,
    sigma: &Buffer,
    rho: &mut Buffer,
    fronts: &[&[u32]],
) -> Result<Vec<f32>> {
    let voxels = convection.size.iter().product();
    let listed: Vec<u32> = fronts.concat();
    let unused = [gpu.scratch(1)?, gpu.scratch(1)?, gpu.scratch(1)?];
    let buffers = [holds(sigma, voxels)?, &unused[0], holds(rho, voxels)?];
    let scratch = [&unused[1], &unused[2]];
    if listed.len() == layout.len() {
        let planes = 0..convection.size.iter().sum::<usize>() as u32 - 2;
        let [_, ny, nz] = convection.size;
        let groups = [ny.div_ceil(8), nz.div_ceil(8), 1];
        let fronts = planes.map(|front| (front, groups)).collect::<Vec<_>>();
        run(gpu, ("ordered", params(convection, ANY)), buffers, scratch, None, &fronts)?;
        return Ok(vec![f32::INFINITY; listed.len()]);
    }
    if listed.is_empty() {
        return Ok(vec![]);
    }
    let changes = gpu.scratch(layout.len())?;
    let mut first = 0;
    let fronts: Vec<_> = fronts
        .iter()
        .map(|front| {
            first += front.len() as u32;
            (first - front.len() as u32, [front.len(), 1, 1])
        })
        .collect();
    let params = Params { strip: layout.edge as u32, ..params(convection, ANY) };
    let bricks = Some([&gpu.storage(&listed)?, &changes]);
    run(gpu, ("brick_by_brick", params), buffers, scratch, bricks, &fronts)?;
    let changes: Vec<f32> = gpu.values(&changes, layout.len())?;
    Ok(listed.iter().map(|&b| changes[b as usize]).collect())
}
