//! The CPU as a device: SIMD kernels over bricks and tiles on all cores. A first-class device, not a fallback.

use std::ops::Range;
use std::sync::{Mutex, PoisonError};

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

pub(crate) mod bricks;
mod characteristic;
pub(crate) mod classify;
pub(crate) mod combine;
mod compose;
mod convect;
pub(crate) mod crop;
mod diffuse;
pub mod float;
mod fronts;
pub(crate) mod gradient;
mod irradiate;
pub(crate) mod mapped;
pub mod march;
pub(crate) mod relax;
pub(crate) mod sample;
mod shared;
pub mod simd;
pub mod slices;
mod source;
mod surface;
pub(crate) mod sweep;
mod sweep_cubic;
mod sweep_point;
mod sweep_x;
pub mod trace;
pub(crate) mod transport;

/// The CPU.
pub struct Cpu {
    pool: rayon::ThreadPool,
    transport: Mutex<transport::Kept>,
}

impl Cpu {
    /// A device of `threads` threads; 0 for one per core.
    pub fn new(threads: usize) -> Result<Self> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .thread_name(|i| format!("gloaming-{i}"))
            .build()
            .map_err(|e| Error::Device(format!("cannot start threads: {e}")))?;
        Ok(Cpu { pool, transport: Mutex::default() })
    }

    /// Number of threads.
    pub fn threads(&self) -> usize {
        self.pool.current_num_threads()
    }
}

/// The values of a host buffer. A buffer of another device is a bug of ours.
fn host(buffer: &Buffer) -> &[f32] {
    buffer.host().expect("a buffer of the CPU device")
}

fn host_mut(buffer: &mut Buffer) -> &mut [f32] {
    match &mut buffer.0 {
        Storage::Host(v) => v,
        Storage::Mapped(m) => m.values_mut(),
        _ => panic!("a buffer of the CPU device"),
    }
}

impl Buffer {
    fn into_host(self) -> Vec<f32> {
        match self.0 {
            Storage::Host(v) => v,
            _ => panic!("a buffer of the CPU device"),
        }
    }
}

impl Device for Cpu {
    fn name(&self) -> String {
        let simd = match simd::level() {
            simd::Level::Portable => "portable SIMD",
            simd::Level::Avx2 => "AVX2",
            simd::Level::Avx512 => "AVX-512",
        };
        format!("cpu ({simd}, {} threads)", self.threads())
    }

    fn alloc(&self, len: usize) -> Result<Buffer> {
        // Zeroed by the system, which provides pages only when they are first written.
        let values = bytemuck::allocation::try_zeroed_vec(len);
        Ok(Buffer(Storage::Host(values.map_err(|()| Error::OutOfMemory { needed: 4 * len as u64, budget: 0 })?)))
    }

    fn upload(&self, values: &[f32], into: &mut Buffer) -> Result<()> {
        host_mut(into)[..values.len()].copy_from_slice(values);
        Ok(())
    }

    fn exchange(&self, values: Vec<f32>, with: &mut Buffer) -> Result<Vec<f32>> {
        assert_eq!(values.len(), with.len(), "values must fill the buffer");
        Ok(std::mem::replace(with, Buffer(Storage::Host(values))).into_host())
    }

    fn download(&self, from: &Buffer, out: &mut [f32]) -> Result<()> {
        out.copy_from_slice(&host(from)[..out.len()]);
        Ok(())
    }

    fn copy(&self, from: &Buffer, start: usize, len: usize, into: &mut Buffer, at: usize) -> Result<()> {
        host_mut(into)[at..at + len].copy_from_slice(&host(from)[start..start + len]);
        Ok(())
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
        self.pool.install(|| classify::classify(optic, table, data, host(field), light, host_mut(out)));
        Ok(())
    }

    fn brick_range(&self, layout: &BrickLayout, field: &Buffer) -> Result<Vec<[f32; 2]>> {
        Ok(self.pool.install(|| bricks::brick_range(layout, host(field))))
    }

    fn change(&self, layout: &BrickLayout, now: &Buffer, before: &Buffer) -> Result<Vec<[f32; 3]>> {
        Ok(self.pool.install(|| bricks::change(layout, host(now), host(before))))
    }

    fn restrict_slab(&self, fine: &Slab, values: &Buffer, coarse: &Slab, out: &mut Buffer) -> Result<()> {
        self.pool.install(|| classify::restrict(fine, host(values), coarse, host_mut(out)));
        Ok(())
    }

    fn sweep(
        &self,
        sweep: &Sweep,
        layout: &BrickLayout,
        sigma: &Buffer,
        rho: &mut Buffer,
        fronts: &[&[u32]],
    ) -> Result<Vec<f32>> {
        Ok(self.pool.install(|| sweep::sweep(sweep, layout, host(sigma), host_mut(rho), fronts)))
    }

    fn sweep_point(
        &self,
        sweep: &PointSweep,
        layout: &BrickLayout,
        sigma: &Buffer,
        rho: &mut Buffer,
        fronts: &[&[u32]],
    ) -> Result<Vec<f32>> {
        Ok(self.pool.install(|| sweep_point::sweep_point(sweep, layout, host(sigma), host_mut(rho), fronts)))
    }

    fn irradiate(&self, lamp: &Lamp, grid: &Grid, planes: Range<usize>, rho: &Buffer, out: &mut Buffer) -> Result<()> {
        self.pool.install(|| irradiate::irradiate(lamp, grid, planes, host(rho), host_mut(out)));
        Ok(())
    }

    fn source(&self, term: &SourceTerm, source: &mut Buffer, gradient: Option<[&mut Buffer; 3]>) -> Result<()> {
        self.pool.install(|| source::source(term, host_mut(source), gradient.map(|g| g.map(host_mut))));
        Ok(())
    }

    fn transport(
        &self,
        transport: &Transport,
        phi: &mut Buffer,
        current: Option<[&mut Buffer; 3]>,
    ) -> Result<(f32, f32)> {
        let mut guard = self.transport.lock().unwrap_or_else(PoisonError::into_inner);
        let kept = &mut *guard;
        let (phi, current) = (host_mut(phi), current.map(|c| c.map(host_mut)));
        Ok(self.pool.install(|| transport::transport(transport, kept, phi, current)))
    }

    fn convect_layers(
        &self,
        convection: &Convection,
        layers: Layers,
        sigma: &Buffer,
        before: &Buffer,
        rho: &mut Buffer,
    ) -> Result<Convected> {
        let (sigma, before, rho) = (host(sigma), host(before), host_mut(rho));
        Ok(self.pool.install(|| convect::strips::convect(convection, layers, sigma, before, rho)))
    }

    fn convect_whole(&self, convection: &Convection, sigma: &Buffer, before: &Buffer, rho: &mut Buffer) -> Result<f32> {
        let (sigma, before, rho) = (host(sigma), host(before), host_mut(rho));
        Ok(self.pool.install(|| convect::whole::convect(convection, sigma, before, rho)))
    }

    fn convect_ordered(
        &self,
        convection: &Convection,
        layout: &BrickLayout,
        sigma: &Buffer,
        rho: &mut Buffer,
        fronts: &[&[u32]],
    ) -> Result<Vec<f32>> {
        let (sigma, rho) = (host(sigma), host_mut(rho));
        Ok(self.pool.install(|| convect::ordered::convect(convection, layout, sigma, rho, fronts)))
    }

    fn diffuse(&self, size: [usize; 3], weights: [&[f32]; 3], values: &mut Buffer) -> Result<()> {
        self.pool.install(|| diffuse::diffuse(size, weights, host_mut(values)));
        Ok(())
    }

    fn relax(
        &self,
        size: [usize; 3],
        coupling: [f32; 3],
        rhs: &Buffer,
        values: &mut Buffer,
        colour: usize,
    ) -> Result<()> {
        self.pool.install(|| relax::relax(size, coupling, host(rhs), host_mut(values), colour));
        Ok(())
    }

    fn residual(
        &self,
        size: [usize; 3],
        coupling: [f32; 3],
        rhs: &Buffer,
        values: &Buffer,
        out: &mut Buffer,
    ) -> Result<f32> {
        Ok(self.pool.install(|| relax::residual(size, coupling, host(rhs), host(values), host_mut(out))))
    }

    fn prolong_slab(&self, coarse: &Slab, values: &Buffer, fine: &Slab, into: &mut Buffer) -> Result<()> {
        self.pool.install(|| relax::prolong(coarse, host(values), fine, host_mut(into)));
        Ok(())
    }

    fn combine(&self, terms: &[(&Buffer, f32)], out: &mut Buffer) -> Result<()> {
        self.pool.install(|| combine::combine(terms, host_mut(out)));
        Ok(())
    }

    fn distance(&self, a: &Buffer, b: &Buffer) -> Result<f32> {
        Ok(self.pool.install(|| combine::distance(host(a), host(b))))
    }

    fn largest_ratio(&self, a: &Buffer, b: &Buffer) -> Result<f32> {
        Ok(self.pool.install(|| combine::largest_ratio(host(a), host(b))))
    }

    fn compose(&self, terms: &[(&Buffer, [f32; 3])], out: &mut [[f32; 3]]) -> Result<()> {
        self.pool.install(|| compose::compose(terms, out));
        Ok(())
    }

    fn march(&self, march: &March, frame: &mut Frame) -> Result<()> {
        self.pool.install(|| march::march(march, frame));
        Ok(())
    }

    fn sample(&self, size: [usize; 3], values: &Buffer, points: &[[f32; 3]], out: &mut [f32]) -> Result<()> {
        self.pool.install(|| sample::sample(size, host(values), points, out));
        Ok(())
    }

    fn march_slab(&self, march: &March, part: &Part, rays: &mut Rays) -> Result<()> {
        self.pool.install(|| march::march_slab(march, part, rays));
        Ok(())
    }

    fn march_tiles(&self, march: &March, tiles: &[u32], frame: &mut Frame) -> Result<()> {
        self.pool.install(|| march::march_tiles(march, tiles, frame));
        Ok(())
    }

    fn slice(&self, slices: &Slices, rays: &mut [Ray]) -> Result<()> {
        self.pool.install(|| slices::slice(slices, rays));
        Ok(())
    }

    fn gradient(&self, grid: &Grid, field: &Buffer, out: &mut Buffer) -> Result<()> {
        self.pool.install(|| gradient::gradient(grid, host(field), host_mut(out)));
        Ok(())
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
        self.pool.install(|| {
            classify::classify_graded(optic, table, &data, [host(field), host(gradient)], &light, host_mut(out));
        });
        Ok(())
    }

    fn surface_hits(&self, surfaces: &Surfaces, hits: &mut [Hit]) -> Result<()> {
        self.pool.install(|| surface::hits(surfaces, hits));
        Ok(())
    }

    fn surface_occlusion(
        &self,
        surfaces: &Surfaces,
        occlusion: &Occlusion,
        samples: Samples,
        hits: &[Hit],
        sums: &mut [[f32; 4]],
    ) -> Result<()> {
        self.pool.install(|| surface::occlusion(surfaces, occlusion, samples, hits, sums));
        Ok(())
    }

    fn surface_beauty(
        &self,
        surfaces: &Surfaces,
        beauty: &Beauty,
        hits: &[Hit],
        sums: &mut [[[f32; 3]; 2]],
    ) -> Result<()> {
        self.pool.install(|| surface::beauty(surfaces, beauty, hits, sums));
        Ok(())
    }

    fn surface_subsurface(
        &self,
        surfaces: &Surfaces,
        subsurface: &Subsurface,
        hits: &[Hit],
        sums: &mut [[f32; 3]],
    ) -> Result<()> {
        self.pool.install(|| surface::subsurface(surfaces, subsurface, hits, sums));
        Ok(())
    }

    fn surface_light(&self, surfaces: &Surfaces, term: &Term, hits: &[Hit], sums: &mut [[[f32; 3]; 2]]) -> Result<()> {
        self.pool.install(|| surface::light(surfaces, term, hits, sums));
        Ok(())
    }

    fn transport_slab(
        &self,
        transport: &Transport,
        passage: &Passage,
        (entry, exit): (&Buffer, &mut Buffer),
        phi: &mut Buffer,
        current: Option<[&mut Buffer; 3]>,
    ) -> Result<()> {
        let mut guard = self.transport.lock().unwrap_or_else(PoisonError::into_inner);
        let kept = &mut *guard;
        let faces = (host(entry), host_mut(exit));
        let (phi, current) = (host_mut(phi), current.map(|c| c.map(host_mut)));
        self.pool.install(|| transport::transport_slab(transport, passage, kept, faces, phi, current));
        Ok(())
    }

    fn dot_parts(&self, a: &Buffer, b: &Buffer) -> Result<Vec<f64>> {
        Ok(self.pool.install(|| combine::dot_parts(host(a), host(b))))
    }

    fn trace(&self, trace: &Trace, picture: [usize; 2], tallies: &mut [Tally]) -> Result<Traced> {
        Ok(self.pool.install(|| trace::trace(trace, (host(trace.field), trace.gradient.map(host)), picture, tallies)))
    }

    fn trace_tiles(
        &self,
        trace: &Trace,
        tiles: &[u32],
        picture: [usize; 2],
        tallies: &mut [Tally],
        touched: &mut [u64],
    ) -> Result<Traced> {
        let data = (host(trace.field), trace.gradient.map(host));
        Ok(self.pool.install(|| trace::trace_tiles(trace, data, tiles, picture, tallies, touched)))
    }

    fn on_threads(&self, work: &mut (dyn FnMut() + Send)) {
        self.pool.install(work);
    }

    fn fill(&self, value: f32, into: &mut Buffer) -> Result<()> {
        host_mut(into).fill(value);
        Ok(())
    }

    fn resize(&self, buffer: &mut Buffer, len: usize) -> Result<()> {
        match &mut buffer.0 {
            Storage::Host(values) => values.resize(len, 0.0),
            _ => *buffer = self.alloc(len)?,
        }
        Ok(())
    }

    fn crop(&self, size: [usize; 3], values: &Buffer, region: Region, out: &mut Buffer) -> Result<()> {
        self.pool.install(|| crop::crop(size, host(values), region, host_mut(out)));
        Ok(())
    }

    fn embed(&self, region: Region, values: &Buffer, size: [usize; 3], out: &mut Buffer) -> Result<()> {
        self.pool.install(|| crop::embed(region, host(values), size, host_mut(out)));
        Ok(())
    }
}
