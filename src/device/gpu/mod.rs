//! wgpu adapters as devices: Vulkan, Metal and DX12 hardware, and software Vulkan for tests.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};

use encase::{ShaderType, UniformBuffer, internal::WriteInto};

use crate::device::convection::{Convected, Convection, Layers};
use crate::device::slices::Slices;
use crate::device::surface::{Beauty, Hit, Occlusion, Samples, Subsurface, Surfaces};
use crate::device::{
    Buffer, Device, Lamp, March, Optic, Part, Passage, PointSweep, Ray, Rays, SourceTerm, Storage, Sweep, Tally, Term,
    Trace, Traced, Transport,
};
use crate::error::{Error, Result};
use crate::frame::Frame;
use crate::grid::{BrickLayout, Grid, Region, Slab};
use crate::transfer::Table;

mod adapter;
mod bricks;
mod classify;
mod clip;
mod combine;
mod compose;
mod convect;
mod crop;
mod diffuse;
mod fronts;
mod gradient;
mod irradiate;
mod march;
mod matter;
mod relax;
mod sample;
pub mod shader;
mod slices;
mod source;
mod surface;
mod sweep;
mod sweep_point;
mod trace;
mod transport;

pub use adapter::{AdapterReport, adapters};
use shader::{Kernel, Shader};

/// Bytes moved between host and device at a time: bounds the staging memory of a large volume.
const STAGING: usize = 64 << 20;
/// Most workgroups along one axis of a dispatch.
const MAX_GROUPS: usize = 65_535;

/// A wgpu adapter.
pub struct Gpu {
    report: AdapterReport,
    /// Of the CPU that takes over where this device fails; 0 is one for each core.
    threads: usize,
    device: wgpu::Device,
    queue: wgpu::Queue,
    kernels: Mutex<HashMap<&'static str, Arc<Kernel>>>,
    /// Scratch of the last kernel that wanted a volume of it.
    spare: Mutex<Option<wgpu::Buffer>>,
    /// What went wrong on the device since somebody last looked; losing the device is never forgotten.
    failure: Arc<Mutex<Option<Failure>>>,
}

#[derive(Debug, Clone)]
struct Failure {
    message: String,
    lost: bool,
}

impl Gpu {
    /// Opens the best hardware adapter, or, given a name, the best one whose name, driver or backend contains it in any
    /// case (`lavapipe` and `llvmpipe` are software Vulkan).
    pub fn open(name: Option<&str>) -> Result<Self> {
        match name {
            Some(name) => Self::new(adapter::named(name)?),
            None => Self::hardware()?.ok_or_else(|| {
                let software = adapters().into_iter().map(|a| a.name).next();
                let instead = software.map(|n| format!(", or --device '{n}' (software)")).unwrap_or_default();
                Error::Device(format!("no GPU found, or no driver for it\n  try: --device cpu{instead}"))
            }),
        }
    }

    /// The best hardware adapter, opened; `None` where there is none.
    pub fn hardware() -> Result<Option<Self>> {
        adapter::hardware().map(Self::new).transpose()
    }

    fn new(adapter: wgpu::Adapter) -> Result<Self> {
        let report = adapter::report(&adapter);
        let request = adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("gloaming"),
            required_features: wgpu::Features::IMMEDIATES,
            required_limits: adapter.limits(),
            ..Default::default()
        });
        let (device, queue) = pollster::block_on(request)
            .map_err(|e| Error::Device(format!("{} cannot be opened: {e}\n  try: --device cpu", report.name)))?;
        let failure = Arc::new(Mutex::new(None));
        let slot = failure.clone();
        device.on_uncaptured_error(Arc::new(move |e| note(&slot, Failure { message: e.to_string(), lost: false })));
        let slot = failure.clone();
        device.set_device_lost_callback(move |_, message| {
            note(&slot, Failure { message: format!("the device was lost: {message}"), lost: true });
        });
        Ok(Gpu { report, threads: 0, device, queue, kernels: Mutex::default(), spare: Mutex::default(), failure })
    }

    /// Bounds the threads of the CPU that takes over where this device fails; 0 is one for each core.
    pub fn with_threads(self, threads: usize) -> Self {
        Gpu { threads, ..self }
    }

    /// What [`adapters`] says of this one.
    pub fn report(&self) -> &AdapterReport {
        &self.report
    }

    /// The error that the device has reported, if any.
    fn check(&self) -> Result<()> {
        let mut slot = self.failure.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(failure) = slot.clone() else { return Ok(()) };
        if !failure.lost {
            *slot = None;
        }
        Err(Error::Device(format!("{}: {}\n  try: --device cpu", self.report.name, failure.message)))
    }

    fn kernel(&self, shader: &Shader) -> Result<Arc<Kernel>> {
        let mut kernels = self.kernels.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(kernel) = kernels.get(shader.name) {
            return Ok(kernel.clone());
        }
        let kernel = Arc::new(Kernel::new(&self.device, shader)?);
        self.check()?;
        kernels.insert(shader.name, kernel.clone());
        Ok(kernel)
    }

    /// A zeroed buffer of `bytes`, which kernels can bind whole.
    fn raw(&self, bytes: u64, usage: wgpu::BufferUsages) -> Result<wgpu::Buffer> {
        let budget = self.largest();
        if bytes > budget {
            return Err(Error::OutOfMemory { needed: bytes, budget });
        }
        let scope = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let buffer = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            // A binding holds at least one element of the array it is bound to, used or not; copies move whole words.
            size: bytes.max(256).next_multiple_of(4),
            usage: usage | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        if pollster::block_on(scope.pop()).is_some() {
            let name = &self.report.name;
            return Err(Error::Device(format!(
                "{name}: no memory left for {bytes} bytes\n  try: a smaller --memory, or --device cpu"
            )));
        }
        self.check()?;
        Ok(buffer)
    }

    /// Scratch memory of `len` zeros.
    fn scratch(&self, len: usize) -> Result<wgpu::Buffer> {
        self.raw(4 * len as u64, wgpu::BufferUsages::STORAGE)
    }

    /// Scratch memory of at least `len` values, whatever they are, kept from call to call: one kernel at a time uses it.
    fn spare(&self, len: usize) -> Result<wgpu::Buffer> {
        let mut spare = self.spare.lock().unwrap_or_else(PoisonError::into_inner);
        match &*spare {
            Some(kept) if kept.size() >= 4 * len as u64 => Ok(kept.clone()),
            _ => Ok(spare.insert(self.scratch(len)?).clone()),
        }
    }

    /// A storage buffer that holds `values`.
    fn storage<T: bytemuck::NoUninit>(&self, values: &[T]) -> Result<wgpu::Buffer> {
        let bytes: &[u8] = bytemuck::cast_slice(values);
        let buffer = self.raw(bytes.len() as u64, wgpu::BufferUsages::STORAGE)?;
        self.queue.write_buffer(&buffer, 0, bytes);
        Ok(buffer)
    }

    /// A storage buffer that holds an array of structures, laid out for WGSL.
    fn structures<T: ShaderType>(&self, values: &[T]) -> Result<wgpu::Buffer>
    where
        for<'a> &'a [T]: ShaderType + WriteInto,
    {
        let mut bytes = encase::StorageBuffer::new(Vec::<u8>::new());
        bytes.write(&values).map_err(|e| Error::Device(format!("a storage buffer: {e}")))?;
        self.storage(&bytes.into_inner())
    }

    fn uniform<P: ShaderType + WriteInto>(&self, params: &P) -> Result<wgpu::Buffer> {
        let mut bytes = UniformBuffer::new(Vec::<u8>::new());
        bytes.write(params).map_err(|e| Error::Device(format!("a uniform: {e}")))?;
        let buffer = self.raw(bytes.as_ref().len() as u64, wgpu::BufferUsages::UNIFORM)?;
        self.queue.write_buffer(&buffer, 0, bytes.as_ref());
        Ok(buffer)
    }

    /// Refuses work that the device would silently leave undone: llvmpipe, the compiler behind software Vulkan, ends the loops
    /// of an invocation after 65535 rounds in all.
    fn rounds(&self, rounds: f64, what: &str) -> Result<()> {
        const LLVMPIPE: f64 = 65_535.0;
        if self.report.name.contains("llvmpipe") && rounds > LLVMPIPE {
            return Err(Error::Unsupported(format!(
                "{what} takes {rounds:.0} rounds of a loop; software Vulkan does {LLVMPIPE}\n  try: --device cpu"
            )));
        }
        Ok(())
    }

    fn encoder(&self) -> wgpu::CommandEncoder {
        self.device.create_command_encoder(&Default::default())
    }

    fn submit(&self, encoder: wgpu::CommandEncoder) -> Result<()> {
        self.queue.submit([encoder.finish()]);
        self.check()
    }

    /// Binds a kernel's buffers and runs one of its entry points once.
    fn run(&self, shader: &Shader, entry: &str, buffers: &[(&str, &wgpu::Buffer)], groups: [usize; 3]) -> Result<()> {
        self.run_with(shader, entry, &[], buffers, groups)
    }

    /// The same, compiled for these values of its `override` constants.
    fn run_with(
        &self,
        shader: &Shader,
        entry: &str,
        constants: &[(&str, f64)],
        buffers: &[(&str, &wgpu::Buffer)],
        groups: [usize; 3],
    ) -> Result<()> {
        let kernel = self.kernel(shader)?;
        let bound = kernel.bind(&self.device, buffers)?;
        let mut encoder = self.encoder();
        {
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(&kernel.pipeline(&self.device, entry, constants));
            pass.set_bind_group(0, &bound, &[]);
            dispatch(&mut pass, groups);
        }
        self.submit(encoder)
    }

    /// Waits for the device and copies the start of a buffer to the host.
    fn read(&self, buffer: &wgpu::Buffer, out: &mut [u8]) -> Result<()> {
        let staging = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("staging"),
            size: (out.len().min(STAGING) as u64).max(4),
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        self.check()?;
        for (i, part) in out.chunks_mut(STAGING).enumerate() {
            let bytes = part.len() as u64;
            let mut encoder = self.encoder();
            encoder.copy_buffer_to_buffer(buffer, (i * STAGING) as u64, &staging, 0, bytes);
            self.submit(encoder)?;
            // What mapping has to say also reaches `get_mapped_range`.
            staging.map_async(wgpu::MapMode::Read, 0..bytes, |_| {});
            let waited = self.device.poll(wgpu::PollType::wait_indefinitely());
            self.check()?;
            waited.map_err(|e| Error::Device(format!("{}: {e}", self.report.name)))?;
            let mapped = staging.get_mapped_range(0..bytes);
            part.copy_from_slice(&mapped.map_err(|e| Error::Device(format!("{}: {e}", self.report.name)))?);
            staging.unmap();
        }
        Ok(())
    }

    /// The first `len` values of a buffer.
    fn values<T: bytemuck::Pod>(&self, buffer: &wgpu::Buffer, len: usize) -> Result<Vec<T>> {
        let mut out = vec![T::zeroed(); len];
        self.read(buffer, bytemuck::cast_slice_mut(&mut out))?;
        Ok(out)
    }
}

fn note(slot: &Mutex<Option<Failure>>, failure: Failure) {
    let mut slot = slot.lock().unwrap_or_else(PoisonError::into_inner);
    // The first failure is the cause; losing the device outweighs it.
    if slot.as_ref().is_none_or(|f| failure.lost && !f.lost) {
        *slot = Some(failure);
    }
}

/// The device's own buffer. A buffer of another device is a bug of ours.
fn gpu(buffer: &Buffer) -> Result<&wgpu::Buffer> {
    match &buffer.0 {
        Storage::Gpu { buffer, .. } => Ok(buffer),
        _ => Err(Error::Device("a buffer of another device was given to a GPU".into())),
    }
}

/// Starts `groups` workgroups; a long row is folded, and the kernel unfolds it (`shaders/grid.wgsl`).
fn dispatch(pass: &mut wgpu::ComputePass, groups: [usize; 3]) {
    let [x, y, z] = groups;
    let [x, y] = if x > MAX_GROUPS { [MAX_GROUPS, y * x.div_ceil(MAX_GROUPS)] } else { [x, y] };
    if x * y * z > 0 {
        pass.dispatch_workgroups(x as u32, y as u32, z as u32);
    }
}

/// Sizes and indices as WGSL has them.
fn uvec3(v: [usize; 3]) -> glam::UVec3 {
    glam::UVec3::from_array(v.map(|n| n as u32))
}

/// Fails where an array of `values` is too short for a grid of `size`.
fn holds(buffer: &Buffer, values: usize) -> Result<&wgpu::Buffer> {
    if buffer.len() < values {
        return Err(Error::Device(format!("a buffer of {} values was given for {values}", buffer.len())));
    }
    gpu(buffer)
}

impl Device for Gpu {
    fn name(&self) -> String {
        format!("{} ({})", self.report.name, self.report.backend)
    }

    fn largest(&self) -> u64 {
        self.report.max_binding.min(self.report.max_buffer)
    }

    fn instead(&self) -> Option<Arc<dyn Device>> {
        Some(Arc::new(crate::device::cpu::Cpu::new(self.threads).ok()?))
    }

    fn alloc(&self, len: usize) -> Result<Buffer> {
        Ok(Buffer(Storage::Gpu { buffer: self.scratch(len)?, len }))
    }

    fn upload(&self, values: &[f32], into: &mut Buffer) -> Result<()> {
        let buffer = holds(into, values.len())?;
        for (i, part) in values.chunks(STAGING / 4).enumerate() {
            self.queue.write_buffer(buffer, (i * STAGING) as u64, bytemuck::cast_slice(part));
            // Hands the staging memory over instead of gathering a second copy of the volume.
            self.queue.submit([]);
        }
        self.check()
    }

    fn download(&self, from: &Buffer, out: &mut [f32]) -> Result<()> {
        self.read(holds(from, out.len())?, bytemuck::cast_slice_mut(out))
    }

    fn copy(&self, from: &Buffer, start: usize, len: usize, into: &mut Buffer, at: usize) -> Result<()> {
        let (from, into) = (holds(from, start + len)?, holds(into, at + len)?);
        let mut encoder = self.encoder();
        encoder.copy_buffer_to_buffer(from, 4 * start as u64, into, 4 * at as u64, 4 * len as u64);
        self.submit(encoder)
    }

    fn classify_slab(
        &self,
        optic: Optic,
        table: &Table,
        data: &Slab,
        field: &Buffer,
        light: &Slab,
        out: &mut Buffer,
    ) -> Result<()> {
        classify::classify(self, optic, table, data, (field, None), light, out)
    }

    fn brick_range(&self, layout: &BrickLayout, field: &Buffer) -> Result<Vec<[f32; 2]>> {
        bricks::brick_range(self, layout, field)
    }

    fn change(&self, layout: &BrickLayout, now: &Buffer, before: &Buffer) -> Result<Vec<[f32; 3]>> {
        bricks::change(self, layout, now, before)
    }

    fn restrict_slab(&self, fine: &Slab, values: &Buffer, coarse: &Slab, out: &mut Buffer) -> Result<()> {
        classify::restrict(self, fine, values, coarse, out)
    }

    fn sweep(
        &self,
        sweep: &Sweep,
        layout: &BrickLayout,
        sigma: &Buffer,
        rho: &mut Buffer,
        fronts: &[&[u32]],
    ) -> Result<Vec<f32>> {
        sweep::sweep(self, sweep, layout, sigma, rho, fronts)
    }

    fn sweep_point(
        &self,
        sweep: &PointSweep,
        layout: &BrickLayout,
        sigma: &Buffer,
        rho: &mut Buffer,
        fronts: &[&[u32]],
    ) -> Result<Vec<f32>> {
        sweep_point::sweep_point(self, sweep, layout, sigma, rho, fronts)
    }

    fn irradiate(&self, lamp: &Lamp, grid: &Grid, planes: Range<usize>, rho: &Buffer, out: &mut Buffer) -> Result<()> {
        irradiate::irradiate(self, lamp, grid, planes, rho, out)
    }

    fn source(&self, term: &SourceTerm, source: &mut Buffer, gradient: Option<[&mut Buffer; 3]>) -> Result<()> {
        source::source(self, term, source, gradient)
    }

    fn transport(
        &self,
        transport: &Transport,
        phi: &mut Buffer,
        current: Option<[&mut Buffer; 3]>,
    ) -> Result<(f32, f32)> {
        transport::transport(self, transport, phi, current)
    }

    fn convect_layers(
        &self,
        convection: &Convection,
        layers: Layers,
        sigma: &Buffer,
        before: &Buffer,
        rho: &mut Buffer,
    ) -> Result<Convected> {
        convect::layers(self, convection, layers, sigma, before, rho)
    }

    fn convect_whole(&self, convection: &Convection, sigma: &Buffer, before: &Buffer, rho: &mut Buffer) -> Result<f32> {
        convect::whole(self, convection, sigma, before, rho)
    }

    fn convect_ordered(
        &self,
        convection: &Convection,
        layout: &BrickLayout,
        sigma: &Buffer,
        rho: &mut Buffer,
        fronts: &[&[u32]],
    ) -> Result<Vec<f32>> {
        convect::ordered(self, convection, layout, sigma, rho, fronts)
    }

    fn diffuse(&self, size: [usize; 3], weights: [&[f32]; 3], values: &mut Buffer) -> Result<()> {
        diffuse::diffuse(self, size, weights, values)
    }

    fn relax(
        &self,
        size: [usize; 3],
        coupling: [f32; 3],
        rhs: &Buffer,
        values: &mut Buffer,
        colour: usize,
    ) -> Result<()> {
        relax::relax(self, size, coupling, rhs, values, colour)
    }

    fn residual(
        &self,
        size: [usize; 3],
        coupling: [f32; 3],
        rhs: &Buffer,
        values: &Buffer,
        out: &mut Buffer,
    ) -> Result<f32> {
        relax::residual(self, size, coupling, rhs, values, out)
    }

    fn prolong_slab(&self, coarse: &Slab, values: &Buffer, fine: &Slab, into: &mut Buffer) -> Result<()> {
        relax::prolong(self, coarse, values, fine, into)
    }

    fn combine(&self, terms: &[(&Buffer, f32)], out: &mut Buffer) -> Result<()> {
        combine::combine(self, terms, out)
    }

    fn dot_parts(&self, a: &Buffer, b: &Buffer) -> Result<Vec<f64>> {
        combine::dot_parts(self, a, b)
    }

    fn transport_slab(
        &self,
        t: &Transport,
        passage: &Passage,
        faces: (&Buffer, &mut Buffer),
        phi: &mut Buffer,
        current: Option<[&mut Buffer; 3]>,
    ) -> Result<()> {
        transport::transport_slab(self, t, passage, faces, phi, current)
    }

    fn distance(&self, a: &Buffer, b: &Buffer) -> Result<f32> {
        combine::distance(self, a, b)
    }

    fn largest_ratio(&self, a: &Buffer, b: &Buffer) -> Result<f32> {
        combine::largest_ratio(self, a, b)
    }

    fn resize(&self, buffer: &mut Buffer, len: usize) -> Result<()> {
        match &mut buffer.0 {
            Storage::Gpu { buffer, len: held } if buffer.size() >= 4 * len as u64 => *held = len,
            _ => *buffer = self.alloc(len)?,
        }
        Ok(())
    }

    fn crop(&self, size: [usize; 3], values: &Buffer, region: Region, out: &mut Buffer) -> Result<()> {
        crop::crop(self, size, values, region, out)
    }

    fn embed(&self, region: Region, values: &Buffer, size: [usize; 3], out: &mut Buffer) -> Result<()> {
        crop::embed(self, region, values, size, out)
    }

    fn compose(&self, terms: &[(&Buffer, [f32; 3])], out: &mut [[f32; 3]]) -> Result<()> {
        compose::compose(self, terms, out)
    }

    fn sample(&self, size: [usize; 3], values: &Buffer, points: &[[f32; 3]], out: &mut [f32]) -> Result<()> {
        sample::sample(self, size, values, points, out)
    }

    fn march(&self, march: &March, frame: &mut Frame) -> Result<()> {
        march::march(self, march, frame)
    }

    fn march_tiles(&self, march: &March, tiles: &[u32], frame: &mut Frame) -> Result<()> {
        march::march_tiles(self, march, tiles, frame)
    }

    fn slice(&self, slices: &Slices, rays: &mut [Ray]) -> Result<()> {
        slices::slice(self, slices, rays)
    }

    fn gradient(&self, grid: &Grid, field: &Buffer, out: &mut Buffer) -> Result<()> {
        gradient::gradient(self, grid, field, out)
    }

    fn classify_graded(
        &self,
        optic: Optic,
        table: &Table,
        (data, field, gradient): ([usize; 3], &Buffer, &Buffer),
        size: [usize; 3],
        out: &mut Buffer,
    ) -> Result<()> {
        let (data, light) = (Slab::whole(data), Slab::whole(size));
        classify::classify(self, optic, table, &data, (field, Some(gradient)), &light, out)
    }

    fn march_slab(&self, march: &March, part: &Part, rays: &mut Rays) -> Result<()> {
        march::march_slab(self, march, part, rays.picture, &mut rays.each)
    }

    fn surface_hits(&self, surfaces: &Surfaces, hits: &mut [Hit]) -> Result<()> {
        surface::hits(self, surfaces, hits)
    }

    fn surface_occlusion(
        &self,
        surfaces: &Surfaces,
        occlusion: &Occlusion,
        samples: Samples,
        hits: &[Hit],
        sums: &mut [[f32; 4]],
    ) -> Result<()> {
        surface::occlusion(self, surfaces, occlusion, samples, hits, sums)
    }

    fn surface_beauty(
        &self,
        surfaces: &Surfaces,
        beauty: &Beauty,
        hits: &[Hit],
        sums: &mut [[[f32; 3]; 2]],
    ) -> Result<()> {
        surface::beauty(self, surfaces, beauty, hits, sums)
    }

    fn surface_subsurface(
        &self,
        surfaces: &Surfaces,
        subsurface: &Subsurface,
        hits: &[Hit],
        sums: &mut [[f32; 3]],
    ) -> Result<()> {
        surface::subsurface(self, surfaces, subsurface, hits, sums)
    }

    fn surface_light(&self, surfaces: &Surfaces, term: &Term, hits: &[Hit], sums: &mut [[[f32; 3]; 2]]) -> Result<()> {
        surface::light(self, surfaces, term, hits, sums)
    }

    fn trace(&self, trace: &Trace, picture: [usize; 2], tallies: &mut [Tally]) -> Result<Traced> {
        trace::trace(self, trace, picture, tallies)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A step goes on where the device that it was lit on is gone, and comes out as on what it goes on with.
    #[test]
    fn a_step_outlives_its_device() {
        use crate::field::{Dense, Timestep};
        use crate::{grid::Grid, scene::Scene, session::Session};
        let gpu = Gpu::open(Some("lavapipe")).expect("software Vulkan: apt-get install mesa-vulkan-drivers libvulkan1");
        gpu.device.destroy();
        let grid = Grid::new([12, 9, 10]);
        let values: Vec<f32> = (0..grid.len()).map(|i| (i % 12) as f32 / 12.0).collect();
        let field = Arc::new(Dense::new(grid.size, values));
        let scene = Scene::load(None, &["render.size=[16, 16]".into(), "light.scattering=false".into()]).unwrap();
        let step = Timestep { step: 3, time: None, grid, field };
        let paged = crate::device::paged::Paged::new(Arc::new(gpu), 1 << 20, &std::env::temp_dir());
        let light = |device: Arc<dyn Device>| {
            let mut session = Session::new(device, scene.clone(), Some([0.0, 1.0]), true).unwrap();
            let [first, second] = [0, 1].map(|_| session.advance(step.clone()).unwrap());
            assert_eq!(first.frames[0].frame, second.frames[0].frame);
            first.frames[0].frame.clone()
        };
        let frame = light(Arc::new(paged));
        assert!(frame.pixels.iter().any(|p| p[3] > 0.1));
        assert_eq!(frame, light(Arc::new(crate::device::cpu::Cpu::new(0).unwrap())));
    }

    /// A device that is gone answers every call with an error that says so, from the first one on that waits for it.
    #[test]
    fn a_lost_device_is_an_error() {
        let gpu = Gpu::open(Some("lavapipe")).expect("software Vulkan: apt-get install mesa-vulkan-drivers libvulkan1");
        let mut buffer = gpu.alloc(64).unwrap();
        let mut coarse = gpu.alloc(8).unwrap();
        gpu.upload(&[1.0; 64], &mut buffer).unwrap();
        gpu.device.destroy();
        let mut out = [0.0; 64];
        let results = [
            gpu.download(&buffer, &mut out),
            gpu.upload(&out, &mut buffer),
            gpu.alloc(64).map(|_| ()),
            gpu.restrict([4; 3], &buffer, [2; 3], &mut coarse),
            gpu.compose(&[(&buffer, [1.0; 3])], &mut [[0.0; 3]; 64]),
            gpu.brick_range(&BrickLayout::new([4; 3], 4), &buffer).map(|_| ()),
        ];
        for (call, result) in results.into_iter().enumerate() {
            match result {
                Err(Error::Device(message)) => assert!(message.contains("--device cpu"), "{message}"),
                other => panic!("call {call}: {other:?}"),
            }
        }
    }
}
