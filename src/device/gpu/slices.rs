//! Half-angle slicing: see [`crate::device::slices`].
//!
//! Compute kernels over the slabs rather than proxy polygons on the rasteriser: a fragment does not know how long its ray is in
//! the slab where the box cuts it, blending is neither exact (no exponential per channel) nor done in 32 bits everywhere, and
//! changing the render target twice for each slice costs more than dispatches, which take eight slabs at a time. The polygon's
//! rectangle bounds what is dispatched.

use encase::ShaderType;
use glam::{DVec3, UVec2, UVec3, Vec2, Vec3};

use super::clip::clips;
use super::matter::Matter;
use super::shader::SLICE;
use super::{Gpu, dispatch, holds, uvec3};
use crate::device::slices::{self, BATCH, Beam, Lookup, Slices, pixels};
use crate::device::{Falloff, Ray, Weight};
use crate::error::Result;

#[derive(ShaderType, Clone, Copy)]
struct Casting {
    start: Vec3,
    start_right: Vec3,
    start_down: Vec3,
    way: Vec3,
    way_right: Vec3,
    way_down: Vec3,
    axis: Vec3,
    base: Vec3,
    spacing: f32,
}

impl From<slices::Casting> for Casting {
    fn from(c: slices::Casting) -> Self {
        let slices::Casting { start, start_right, start_down, way, way_right, way_down, axis, base, spacing } = c;
        Casting { start, start_right, start_down, way, way_right, way_down, axis, base: base.into(), spacing }
    }
}

#[derive(ShaderType)]
pub(super) struct Params {
    size: UVec3,
    lo: f32,
    scale: f32,
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
    edge: u32,
    chromatic: Vec3,
    held: UVec2,
    picture: UVec2,
    eye: Casting,
    light: Casting,
    row_x: Vec3,
    row_y: Vec3,
    row_z: Vec3,
    shift: Vec3,
    factors: Vec3,
    blur: f32,
    inner: Vec2,
    texel: Vec2,
    texels: UVec2,
    clips: u32,
}

#[derive(ShaderType)]
struct Source {
    weight: Vec3,
    kind: u32,
    direction: Vec3,
    g: f32,
    position: Vec3,
    floor: f32,
    outer: f32,
    slope: f32,
    cosine: f32,
}

impl Source {
    fn new(slices: &Slices, weight: Weight) -> Self {
        let plain = |kind, weight: [f32; 3], direction, g| Source {
            weight: weight.into(),
            kind,
            direction,
            g,
            position: Vec3::ZERO,
            floor: 0.0,
            outer: 0.0,
            slope: 0.0,
            cosine: 0.0,
        };
        match weight {
            Weight::Uniform(weight) => plain(0, weight, Vec3::ZERO, 0.0),
            Weight::Phase { direction, irradiance, g } => plain(1, irradiance, direction, g),
            Weight::Lamp { lamp, intensity, g } => {
                let Falloff { position, floor, axis, outer, slope, cosine, .. } = lamp.on(slices.grid, 1);
                Source { position, floor, outer, slope, cosine, ..plain(3, intensity, axis, g) }
            }
            Weight::Current { .. } => unreachable!("a current is a light volume's"),
        }
    }
}

/// One dispatch, as the kernels take it.
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
struct Turn {
    first: u32,
    count: u32,
    layer: u32,
    half: u32,
    corner: [u32; 2],
    end: [u32; 2],
}

pub(super) fn slice(gpu: &Gpu, slices: &Slices, rays: &mut [Ray]) -> Result<()> {
    let grid = slices.grid;
    if grid.is_empty() || rays.is_empty() {
        return Ok(());
    }
    let matter = Matter::new(gpu, slices.table, slices.gradient, grid.len())?;
    let factors = slices.beam.as_ref().map_or(vec![1.0], |beam| beam.factors(slices.table.chromatic));
    let size = slices.beam.as_ref().map_or([Beam::ALIGN; 2], |beam| beam.size);
    let len = size[0] * size[1] * factors.len();
    let fronts = gpu.storage(&beginning(slices, size, factors.len()))?;
    let layers = gpu.scratch(BATCH * len)?;
    let carried = gpu.storage(bytemuck::cast_slice::<Ray, f32>(rays))?;
    let beams = slices.beam.iter().map(|beam| beam.weight);
    let mut sources: Vec<Source> =
        slices.unshadowed.iter().copied().chain(beams).map(|w| Source::new(slices, w)).collect();
    if sources.is_empty() {
        sources.push(Source::new(slices, Weight::Uniform([0.0; 3])));
    }
    let meets = slices.beam.as_ref().map_or(&[][..], |beam| beam.opaque);
    let kernel = gpu.kernel(&SLICE)?;
    let bound = kernel.bind(
        &gpu.device,
        &[
            ("params", &gpu.uniform(&params(slices, &matter, size, &factors))?),
            ("field", holds(slices.field, grid.len())?),
            ("gradient", &matter.gradient),
            ("table", &matter.table),
            ("sums", &matter.sums),
            ("majorant", &gpu.storage(slices.majorant)?),
            ("sources", &gpu.structures(&sources)?),
            ("fronts", &fronts),
            ("layers", &layers),
            ("meets", &gpu.storage(meets)?),
            ("clips", &gpu.structures(&clips(slices.clips))?),
            ("rays", &carried),
        ],
    )?;
    let blurs = slices.beam.as_ref().is_some_and(|beam| beam.blur > 0.0);
    let mut parts = vec![
        ("LIT", f64::from(slices.beam.is_some())),
        ("PARALLEL", f64::from(slices.beam.as_ref().is_none_or(|beam| beam.view.parallel))),
        ("UNDER", f64::from(slices.under)),
        ("SKIP", f64::from(!slices.majorant.is_empty())),
        ("SHADE", f64::from(slices.phong.is_some())),
        ("BLUR", f64::from(blurs)),
        ("OPAQUE", f64::from(!meets.is_empty())),
        ("CHANNELS", factors.len() as f64),
        ("SOURCES", slices.unshadowed.len() as f64),
    ];
    parts.extend(matter.parts().map(|(name, on)| (name, if name == "GLOW" && !slices.glows { 0.0 } else { on })));
    let [light, eye] = ["light", "eye"].map(|entry| kernel.pipeline(&gpu.device, entry, &parts));
    let slicing = &slices.slicing;
    let mut half = 0;
    let mut encoder = gpu.encoder();
    {
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_bind_group(0, &bound, &[]);
        for first in (0..slicing.count).step_by(BATCH) {
            let end = (first + BATCH).min(slicing.count);
            if slices.beam.is_some() {
                pass.set_pipeline(&light);
                // A blurred slab needs its neighbours' light of the slab before.
                for part in (first..end).step_by(if blurs { 1 } else { BATCH }) {
                    let count = if blurs { 1 } else { end - first } as u32;
                    let layer = (part - first) as u32;
                    let turn = Turn { first: part as u32, count, layer, half, corner: [0; 2], end: [0; 2] };
                    pass.set_immediates(0, bytemuck::bytes_of(&turn));
                    dispatch(&mut pass, [size[0].div_ceil(8), size[1].div_ceil(8), 1]);
                    half = 1 - half;
                }
            }
            let planes = [first, end].map(|i| slicing.first + i as f64 * slicing.spacing);
            let seen = pixels(slices.eye.extent(grid, slicing.axis, planes), slices.picture);
            let of = |a: usize| [seen[a][0].max(slices.window[a][0]), seen[a][1].min(slices.window[a][1])];
            let ([left, right], [top, bottom]) = (of(0), of(1));
            if left >= right || top >= bottom {
                continue;
            }
            let turn = Turn {
                first: first as u32,
                count: (end - first) as u32,
                layer: 0,
                half,
                corner: [left as u32, top as u32],
                end: [right as u32, bottom as u32],
            };
            pass.set_pipeline(&eye);
            pass.set_immediates(0, bytemuck::bytes_of(&turn));
            dispatch(&mut pass, [(right - left).div_ceil(8), (bottom - top).div_ceil(8), 1]);
        }
    }
    gpu.submit(encoder)?;
    gpu.read(&carried, bytemuck::cast_slice_mut(rays))
}

/// The light buffer before the first slice, and room for it behind one.
fn beginning(slices: &Slices, [width, height]: [usize; 2], channels: usize) -> Vec<f32> {
    let mut fronts = vec![1.0; 2 * width * height * channels];
    if let Some(start) = slices.beam.as_ref().and_then(|beam| beam.start) {
        for (i, texel) in start.iter().enumerate() {
            for (c, value) in texel.iter().take(channels).enumerate() {
                fronts[(i / width * channels + c) * width + i % width] = *value;
            }
        }
    }
    fronts
}

fn params(slices: &Slices, matter: &Matter, size: [usize; 2], factors: &[f32]) -> Params {
    let (grid, phong) = (slices.grid, slices.phong);
    let eye = slices::Casting::new(&slices.eye, &slices.slicing, grid);
    let beam = slices.beam.as_ref();
    let light = beam.map_or(eye, |beam| slices::Casting::new(&beam.view, &slices.slicing, grid));
    let lookup = beam.map(|beam| Lookup::new(beam, grid));
    let row = |a: usize| lookup.map_or(Vec3::ZERO, |l| l.rows[a]);
    Params {
        size: uvec3(grid.size),
        lo: slices.table.lo,
        scale: slices.table.scale(),
        entries: matter.entries,
        rows: matter.rows,
        steep: matter.steep,
        per_world: (1.0 / DVec3::from(grid.spacing)).as_vec3(),
        spacing: grid.mean_spacing() as f32,
        towards_light: phong.map_or(Vec3::ZERO, |p| p.towards_light),
        ambient: phong.map_or(0.0, |p| p.ambient),
        diffuse: phong.map_or(0.0, |p| p.diffuse),
        specular: phong.map_or(0.0, |p| p.specular),
        shininess: phong.map_or(0.0, |p| p.shininess),
        edge: slices.bricks.edge as u32,
        chromatic: slices.table.chromatic.into(),
        held: UVec2::new(0, grid.size[2] as u32 - 1),
        picture: UVec2::new(slices.picture[0] as u32, slices.picture[1] as u32),
        eye: eye.into(),
        light: light.into(),
        row_x: row(0),
        row_y: row(1),
        row_z: row(2),
        shift: lookup.map_or(Vec3::ZERO, |l| l.shift),
        factors: Vec3::from_array(std::array::from_fn(|c| factors.get(c).copied().unwrap_or(factors[0]))),
        blur: beam.map_or(0.0, |beam| beam.blur as f32),
        inner: lookup.map_or(Vec2::ZERO, |l| l.inner.into()),
        texel: lookup.map_or(Vec2::ONE, |l| l.texel.into()),
        texels: UVec2::new(size[0] as u32, size[1] as u32),
        clips: slices.clips.len() as u32,
    }
}
