//! Transport along discrete ordinates: those that share dominant axis and sign run together, layer by layer.

use std::sync::Arc;

use encase::ShaderType;
use glam::{UVec3, Vec2, Vec3};

use super::shader::{Kernel, TRANSPORT};
use super::sweep::{layers_last, strides};
use super::{Gpu, dispatch, holds, uvec3};
use crate::device::{Buffer, Passage, Sweep, Transport};
use crate::error::Result;

/// Most ordinates that a workgroup takes at once.
const ABREAST: usize = 8;

#[derive(ShaderType)]
pub(super) struct Params {
    size: UVec3,
    count: u32,
    stride: UVec3,
    values: u32,
    travel: i32,
    plane: u32,
    given: u32,
    carried: u32,
}

#[derive(ShaderType)]
struct Ordinate {
    direction: Vec3,
    weight: f32,
    foot: Vec2,
    length: f32,
    inflow: f32,
}

/// A plane that no value is in.
const NOWHERE: u32 = u32::MAX;

pub(super) fn transport(
    gpu: &Gpu,
    t: &Transport,
    phi: &mut Buffer,
    current: Option<[&mut Buffer; 3]>,
) -> Result<(f32, f32)> {
    let values = t.grid.len();
    let (sum, extremes) = (gpu.scratch(values)?, gpu.scratch(2)?);
    let passing = Passing::new(gpu, t, &sum, current)?;
    let mut encoder = gpu.encoder();
    passing.currents().iter().for_each(|c| encoder.clear_buffer(c, 0, Some(4 * values as u64)));
    passing.record(&mut encoder, None, None)?;
    passing.settle(&mut encoder, holds(phi, values)?, &extremes)?;
    gpu.submit(encoder)?;
    let extremes: Vec<f32> = gpu.values(&extremes, 2)?;
    Ok((extremes[0], extremes[1]))
}

pub(super) fn transport_slab(
    gpu: &Gpu,
    t: &Transport,
    passage: &Passage,
    (entry, exit): (&Buffer, &mut Buffer),
    phi: &mut Buffer,
    current: Option<[&mut Buffer; 3]>,
) -> Result<()> {
    let values = t.grid.len();
    let sum = holds(phi, values)?;
    let passing = Passing::new(gpu, t, sum, current)?;
    let mut encoder = gpu.encoder();
    if !passage.added {
        let sums = std::iter::once(sum).chain(passing.currents());
        sums.for_each(|s| encoder.clear_buffer(s, 0, Some(4 * values as u64)));
    }
    let carried = if exit.is_empty() { None } else { Some((super::gpu(entry)?, super::gpu(exit)?)) };
    passing.record(&mut encoder, Some(passage), carried)?;
    gpu.submit(encoder)
}

/// What the dispatches of a pass share.
struct Passing<'a> {
    gpu: &'a Gpu,
    t: &'a Transport<'a>,
    kernel: Arc<Kernel>,
    /// Gradient, φ, J; stand-ins where there are none, as a buffer that is written may be bound only once.
    gradient: [wgpu::Buffer; 3],
    sum: &'a wgpu::Buffer,
    current: [wgpu::Buffer; 3],
    sums_current: bool,
}

impl<'a> Passing<'a> {
    fn new(gpu: &'a Gpu, t: &'a Transport, sum: &'a wgpu::Buffer, current: Option<[&mut Buffer; 3]>) -> Result<Self> {
        let (values, unused) = (t.grid.len(), gpu.scratch(1)?);
        let gradient = match t.gradient {
            Some([x, y, z]) => [holds(x, values)?.clone(), holds(y, values)?.clone(), holds(z, values)?.clone()],
            None => [unused.clone(), unused.clone(), unused],
        };
        let sums_current = current.is_some();
        let current = match current {
            Some([x, y, z]) => [holds(x, values)?.clone(), holds(y, values)?.clone(), holds(z, values)?.clone()],
            None => [gpu.scratch(1)?, gpu.scratch(1)?, gpu.scratch(1)?],
        };
        Ok(Passing { gpu, t, kernel: gpu.kernel(&TRANSPORT)?, gradient, sum, current, sums_current })
    }

    /// The volumes of J, where it is wanted.
    fn currents(&self) -> &[wgpu::Buffer] {
        if self.sums_current { &self.current } else { &[] }
    }

    fn bind(
        &self,
        params: &Params,
        ordinates: &[Ordinate],
        radiance: &wgpu::Buffer,
        (phi, extremes): (&wgpu::Buffer, &wgpu::Buffer),
    ) -> Result<wgpu::BindGroup> {
        let (gpu, values) = (self.gpu, self.t.grid.len());
        self.kernel.bind(
            &gpu.device,
            &[
                ("params", &gpu.uniform(params)?),
                ("ordinates", &gpu.structures(ordinates)?),
                ("sigma", holds(self.t.sigma, values)?),
                ("source", holds(self.t.source, values)?),
                ("gradient_x", &self.gradient[0]),
                ("gradient_y", &self.gradient[1]),
                ("gradient_z", &self.gradient[2]),
                ("radiance", radiance),
                ("sum", self.sum),
                ("current_x", &self.current[0]),
                ("current_y", &self.current[1]),
                ("current_z", &self.current[2]),
                ("phi", phi),
                ("extremes", extremes),
            ],
        )
    }

    /// All layers of all ordinates, or of those of a passage, with the faces that come in and go out.
    fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        passage: Option<&Passage>,
        faces: Option<(&wgpu::Buffer, &wgpu::Buffer)>,
    ) -> Result<()> {
        let (gpu, size) = (self.gpu, self.t.grid.size);
        let plane = size[0] * size[1];
        let unused = (gpu.scratch(1)?, gpu.scratch(1)?);
        let mut params = Params {
            size: uvec3(size),
            count: 0,
            stride: UVec3::ZERO,
            values: self.t.grid.len() as u32,
            travel: 1,
            plane: plane as u32,
            given: NOWHERE,
            carried: NOWHERE,
        };
        if let Some(&Passage { ascending, given, .. }) = passage {
            let ends = if ascending { [0, size[2] - 1] } else { [size[2] - 1, 0] };
            params.given = if given { ends[0] as u32 } else { NOWHERE };
            params.carried = ends[1] as u32;
        }
        let mut passed = 0;
        for (axis, ascending) in [(0, true), (0, false), (1, true), (1, false), (2, true), (2, false)] {
            let axes = layers_last(axis);
            let group = group(self.t, axis, ascending, passage.map(|p| p.ascending));
            if group.is_empty() {
                continue;
            }
            let [b, c, layers] = axes.map(|a| size[a]);
            params.size = uvec3([b, c, layers]);
            params.count = group.len() as u32;
            params.stride = uvec3(axes.map(|a| strides(size)[a]));
            params.travel = if ascending { 1 } else { -1 };
            let parts = [
                ("LINEAR", self.t.gradient.is_some().into()),
                ("CURRENT", self.sums_current.into()),
                ("ABREAST", group.len().min(ABREAST) as f64),
            ];
            // Radiance of two layers, of the plane that is given and of the one that is carried on.
            let (layer, face) = (2 * group.len() * b * c, group.len() * plane);
            let radiance = gpu.scratch(layer + if faces.is_some() { 2 * face } else { 0 })?;
            let at = |value: usize| 4 * value as u64;
            if let Some((entry, _)) = faces.filter(|_| params.given != NOWHERE) {
                encoder.copy_buffer_to_buffer(entry, at(passed), &radiance, at(layer), at(face));
            }
            {
                let mut pass = encoder.begin_compute_pass(&Default::default());
                pass.set_pipeline(&self.kernel.pipeline(&gpu.device, "step_layer", &parts));
                pass.set_bind_group(0, &self.bind(&params, &group, &radiance, (&unused.0, &unused.1))?, &[]);
                for layer in 0..layers as u32 {
                    pass.set_immediates(0, bytemuck::bytes_of(&layer));
                    dispatch(&mut pass, [b.div_ceil(16), c.div_ceil(2), 1]);
                }
            }
            if let Some((_, exit)) = faces {
                encoder.copy_buffer_to_buffer(&radiance, at(layer + face), exit, at(passed), at(face));
            }
            passed += face;
        }
        Ok(())
    }

    /// Moves the sum into φ.
    fn settle(&self, encoder: &mut wgpu::CommandEncoder, phi: &wgpu::Buffer, extremes: &wgpu::Buffer) -> Result<()> {
        let values = self.t.grid.len();
        let nobody = Ordinate { direction: Vec3::ZERO, weight: 0.0, foot: Vec2::ZERO, length: 0.0, inflow: 0.0 };
        let params = Params {
            size: UVec3::ZERO,
            count: 0,
            stride: UVec3::ZERO,
            values: values as u32,
            travel: 1,
            plane: 0,
            given: NOWHERE,
            carried: NOWHERE,
        };
        let bound = self.bind(&params, &[nobody], &self.gpu.scratch(1)?, (phi, extremes))?;
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&self.kernel.pipeline(&self.gpu.device, "settle", &[]));
        pass.set_bind_group(0, &bound, &[]);
        dispatch(&mut pass, [values.div_ceil(256), 1, 1]);
        Ok(())
    }
}

/// The ordinates that travel mainly along `axis` the given way, in their order; of those only that cross z upwards or downwards.
fn group(t: &Transport, axis: usize, ascending: bool, upward: Option<bool>) -> Vec<Ordinate> {
    let [b, c, _] = layers_last(axis);
    t.ordinates
        .iter()
        .map(|o| (o, Sweep::new(t.grid, o.direction, false)))
        .filter(|(_, s)| s.axis() == axis && s.ascending()[axis] == ascending)
        .filter(|(_, s)| upward.is_none_or(|up| s.ascending()[2] == up))
        .map(|(o, s)| {
            let foot = |lateral: usize| (-s.direction[lateral] / s.direction[axis].abs()).clamp(-1.0, 1.0);
            Ordinate {
                direction: o.direction,
                weight: o.weight,
                foot: Vec2::new(foot(b), foot(c)),
                length: s.length,
                inflow: o.inflow,
            }
        })
        .collect()
}
