//! Kernels: arithmetic on voxels and rays, and nothing else.
//!
//! A [`Device`] knows no scene file, no clock and no channel. Every kernel exists in Rust (`device/cpu/NAME.rs`) and in
//! WGSL (`shaders/NAME.wgsl`) under the same name, with the same equation at the top; a test runs both on the same random
//! input. What decides (which brick next, what may be skipped, when to stop) lives above, once.

use std::ops::Range;
use std::sync::Arc;

use crate::error::{Error, Result};
use crate::field::{self, Field};
use crate::frame::Frame;
use crate::grid::{BrickLayout, Grid, Region, Slab};
use crate::transfer::Table;
use convection::{Convected, Convection, Layers};
use surface::{Beauty, Hit, Occlusion, Samples, Subsurface, Surfaces};

mod behind;
mod buffer;
mod clip;
pub mod convection;
pub mod cpu;
pub mod emitter;
#[cfg(feature = "gpu")]
pub mod gpu;
mod lamp;
mod march;
mod open;
mod optic;
pub mod paged;
mod passage;
pub mod random;
mod scatter;
pub mod slices;
pub mod surface;
mod sweep;
mod trace;

pub use behind::Behind;
pub use buffer::Buffer;
pub(crate) use buffer::Storage;
pub use clip::{Clip, ClipShape};
pub(crate) use cpu::trace::bricks_ahead;
pub(crate) use lamp::Falloff;
pub use lamp::{Cone, Lamp};
pub use march::{March, Part, Phong, Ray, Rays, Term, Weight};
pub use open::open;
pub use optic::Optic;
pub use passage::Passage;
pub use scatter::{Ordinate, SourceTerm, Transport, Travel};
pub use sweep::{Edge, PointSweep, Sweep};
pub use trace::{Phase, Sampling, Surface, Tally, Trace, Traced};

/// Values over which no inner product is summed at once: see [`Device::dot_parts`].
pub const RUN: usize = 1 << 14;

/// Where kernels run.
pub trait Device: Send + Sync {
    /// Name for people: `cpu (AVX-512, 2 threads)` or the adapter's name.
    fn name(&self) -> String;

    /// Bytes of the largest buffer that kernels can work on.
    fn largest(&self) -> u64 {
        u64::MAX
    }

    /// What to go on with when this device fails or has no memory left, if anything.
    fn instead(&self) -> Option<Arc<dyn Device>> {
        None
    }

    /// A zeroed buffer of `len` values.
    fn alloc(&self, len: usize) -> Result<Buffer>;

    /// Copies host values into the start of a buffer.
    fn upload(&self, values: &[f32], into: &mut Buffer) -> Result<()>;

    /// Hands over values that fill a buffer and returns memory for the next ones: the buffer's old memory where it is the
    /// host's, so that nothing is copied, else the same memory.
    fn exchange(&self, values: Vec<f32>, with: &mut Buffer) -> Result<Vec<f32>> {
        self.upload(&values, with)?;
        Ok(values)
    }

    /// Copies the start of a buffer into host memory.
    fn download(&self, from: &Buffer, out: &mut [f32]) -> Result<()>;

    /// Takes in the data of a step on `grid`, holes marked, into a buffer. Returns the number of holes and what
    /// [`Device::brick_range`] says. `host` is memory that is used again.
    fn take(
        &self,
        grid: &Grid,
        field: &Arc<dyn Field>,
        bricks: &BrickLayout,
        host: &mut Vec<f32>,
        into: &mut Buffer,
    ) -> Result<(u64, Vec<[f32; 2]>)> {
        host.resize(grid.len(), 0.0);
        field.read(grid.region(), host)?;
        let holes = field::mark_holes(host);
        *host = self.exchange(std::mem::take(host), into)?;
        Ok((holes, self.brick_range(bricks, into)?))
    }

    /// True when volumes are worked on a slab at a time, so that nobody need hold a step's data in memory.
    fn pages(&self) -> bool {
        false
    }

    /// Copies `len` values of a buffer, from `start` on, into another one, at `at`.
    fn copy(&self, from: &Buffer, start: usize, len: usize, into: &mut Buffer, at: usize) -> Result<()>;

    /// Mean of an optical property over the data voxels under each light voxel, after the transfer function, so that
    /// shadows do not depend on the light grid (validation.md 2). Both grids fill the same box; holes count as zero.
    fn classify(
        &self,
        optic: Optic,
        table: &Table,
        data: [usize; 3],
        field: &Buffer,
        size: [usize; 3],
        out: &mut Buffer,
    ) -> Result<()> {
        self.classify_slab(optic, table, &Slab::whole(data), field, &Slab::whole(size), out)
    }

    /// The same for a slab of the light grid: `field` holds a slab of the data that reaches under all of it.
    fn classify_slab(
        &self,
        optic: Optic,
        table: &Table,
        data: &Slab,
        field: &Buffer,
        light: &Slab,
        out: &mut Buffer,
    ) -> Result<()>;

    /// [`Device::classify`] for several properties on one grid: where data have to be read, reading them once may serve all.
    fn classify_each(
        &self,
        optics: &mut [(Optic, &mut Buffer)],
        table: &Table,
        data: [usize; 3],
        field: &Buffer,
        size: [usize; 3],
    ) -> Result<()> {
        optics.iter_mut().try_for_each(|(optic, out)| self.classify(*optic, table, data, field, size, out))
    }

    /// Smallest and largest value of each brick with a halo of one value, holes left out (`[+∞, −∞]` when nothing else).
    fn brick_range(&self, layout: &BrickLayout, field: &Buffer) -> Result<Vec<[f32; 2]>>;

    /// Bound on the change of optical depth across each brick, per unit spacing and for each dominant axis:
    /// `Σ_layers max|now − before|` over the brick with a halo of one value, outer layers counted half (light.md, d_sig).
    fn change(&self, layout: &BrickLayout, now: &Buffer, before: &Buffer) -> Result<Vec<[f32; 3]>>;

    /// Mean of a volume over the voxels of a coarser (or equal) grid that fills the same box.
    fn restrict(&self, size: [usize; 3], values: &Buffer, coarse: [usize; 3], out: &mut Buffer) -> Result<()> {
        self.restrict_slab(&Slab::whole(size), values, &Slab::whole(coarse), out)
    }

    /// The same for a slab of the coarser grid: `values` holds a slab of the volume that reaches under all of it.
    fn restrict_slab(&self, fine: &Slab, values: &Buffer, coarse: &Slab, out: &mut Buffer) -> Result<()>;

    /// Direct light by short characteristics over the listed bricks, front by front:
    /// `ρ = ρ_foot · exp(−½(σ_foot + σ)·length)`, ρ = 1 and σ = 0 outside; the first layer starts half a voxel inside the
    /// box. `rho` holds the previous solution. Returns, for each listed brick in order, a bound on the change of `rho` on
    /// the brick's downstream faces: 0 means that nothing downstream of it sees a difference. The bound may be infinite when
    /// all bricks are listed (nobody needs it then) and for a cubic foot.
    fn sweep(
        &self,
        sweep: &Sweep,
        layout: &BrickLayout,
        sigma: &Buffer,
        rho: &mut Buffer,
        fronts: &[&[u32]],
    ) -> Result<Vec<f32>>;

    /// Direct light from a point, the same way: `ρ = ρ_foot · exp(−½(σ_foot + σ)·length)` with feet on the ray from the light,
    /// in [`PointSweep::fronts`]. Voxels within two voxels of the light take the exact integral along their ray.
    fn sweep_point(
        &self,
        sweep: &PointSweep,
        layout: &BrickLayout,
        sigma: &Buffer,
        rho: &mut Buffer,
        fronts: &[&[u32]],
    ) -> Result<Vec<f32>>;

    /// Transmittance to irradiance per unit of radiant intensity: `out = ρ · falloff(x)`, see [`Lamp`]. Within
    /// [`Lamp::NEAR`] voxels of the light along every axis the falloff is the mean of 4³ points of a voxel.
    fn irradiate(&self, lamp: &Lamp, grid: &Grid, planes: Range<usize>, rho: &Buffer, out: &mut Buffer) -> Result<()>;

    /// Source function of scattered light: see [`SourceTerm`]. `gradient` is written where `term.current` is given.
    fn source(&self, term: &SourceTerm, source: &mut Buffer, gradient: Option<[&mut Buffer; 3]>) -> Result<()>;

    /// One transport pass: see [`Transport`]. `phi` and `current` are overwritten; returns the largest change of `phi`
    /// against what it held, and the largest new value.
    fn transport(
        &self,
        transport: &Transport,
        phi: &mut Buffer,
        current: Option<[&mut Buffer; 3]>,
    ) -> Result<(f32, f32)>;

    /// Convection of parallel light layer by layer: strips of [`Convection::STRIP`] rows iterate (16) with the layer before
    /// and the strip upstream done, from what `layers` says. `before` holds the light of an earlier solve; `rho` is
    /// overwritten.
    fn convect_layers(
        &self,
        convection: &Convection,
        layers: Layers,
        sigma: &Buffer,
        before: &Buffer,
        rho: &mut Buffer,
    ) -> Result<Convected>;

    /// One iteration (16) of every voxel at once, from `before` into `rho`; returns the largest change.
    fn convect_whole(&self, convection: &Convection, sigma: &Buffer, before: &Buffer, rho: &mut Buffer) -> Result<f32>;

    /// The fixed point of convection over the listed bricks, front by front ([`Convection::fronts`]), each voxel after its
    /// upstream neighbours. Returns what [`Device::sweep`] returns.
    fn convect_ordered(
        &self,
        convection: &Convection,
        layout: &BrickLayout,
        sigma: &Buffer,
        rho: &mut Buffer,
        fronts: &[&[u32]],
    ) -> Result<Vec<f32>>;

    /// Diffusion in place, exact in time: a convolution with a symmetric kernel along x, y and z, of which `weights` hold the
    /// middle and one side; mirrors at the faces.
    fn diffuse(&self, size: [usize; 3], weights: [&[f32]; 3], values: &mut Buffer) -> Result<()>;

    /// One red-black half of a Gauss–Seidel sweep of `v − Σ_a κ_a (v_a⁻ − 2v + v_a⁺) = rhs` with mirrors at the faces: voxels
    /// whose i + j + k has the parity of `colour` (0 or 1) are solved for.
    fn relax(
        &self,
        size: [usize; 3],
        coupling: [f32; 3],
        rhs: &Buffer,
        values: &mut Buffer,
        colour: usize,
    ) -> Result<()>;

    /// Residual `rhs − A v` of the system of [`Device::relax`] into `out`; returns its largest size. Every row of A sums to 1
    /// and A is an M-matrix, so that this is a bound on the error of v.
    fn residual(
        &self,
        size: [usize; 3],
        coupling: [f32; 3],
        rhs: &Buffer,
        values: &Buffer,
        out: &mut Buffer,
    ) -> Result<f32>;

    /// Adds a coarser grid of the same box to a finer one: trilinear between its values, constant beyond the outermost.
    fn prolong(&self, coarse: [usize; 3], values: &Buffer, size: [usize; 3], into: &mut Buffer) -> Result<()> {
        self.prolong_slab(&Slab::whole(coarse), values, &Slab::whole(size), into)
    }

    /// The same for a slab of the finer grid: `values` holds a slab of the coarser one that reaches beyond all of it.
    fn prolong_slab(&self, coarse: &Slab, values: &Buffer, fine: &Slab, into: &mut Buffer) -> Result<()>;

    /// `Σ weight·values` into `out`: zeros without terms, a copy with one term of weight 1.
    fn combine(&self, terms: &[(&Buffer, f32)], out: &mut Buffer) -> Result<()> {
        let mut sum = vec![0.0; out.len()];
        let mut values = vec![0.0; out.len()];
        for (buffer, weight) in terms {
            self.download(buffer, &mut values)?;
            sum.iter_mut().zip(&values).for_each(|(s, v)| *s += weight * v);
        }
        self.upload(&sum, out)
    }

    /// Inner product, summed in f64.
    fn dot(&self, a: &Buffer, b: &Buffer) -> Result<f64> {
        Ok(self.dot_parts(a, b)?.iter().sum())
    }

    /// Largest `|a − b|`.
    fn distance(&self, a: &Buffer, b: &Buffer) -> Result<f32> {
        let [a, b] = self.both(a, b)?;
        Ok(a.iter().zip(&b).fold(0.0, |m, (a, b)| m.max((a - b).abs())))
    }

    /// Largest `a / b` over the values where b > 0; 0 where there are none.
    fn largest_ratio(&self, a: &Buffer, b: &Buffer) -> Result<f32> {
        let [a, b] = self.both(a, b)?;
        Ok(a.iter().zip(&b).fold(0.0, |m, (a, b)| if *b > 0.0 { m.max(a / b) } else { m }))
    }

    /// Both volumes on the host.
    #[doc(hidden)]
    fn both(&self, a: &Buffer, b: &Buffer) -> Result<[Vec<f32>; 2]> {
        let mut out = [vec![0.0; a.len()], vec![0.0; b.len()]];
        self.download(a, &mut out[0])?;
        self.download(b, &mut out[1])?;
        Ok(out)
    }

    /// `Σ weight_i · volume_i` per channel into interleaved RGB on the host: the illuminated volume. All volumes have
    /// `out.len()` values.
    fn compose(&self, terms: &[(&Buffer, [f32; 3])], out: &mut [[f32; 3]]) -> Result<()>;

    /// Ray casting: see [`March`]. Pixels are premultiplied by coverage.
    fn march(&self, march: &March, frame: &mut Frame) -> Result<()>;

    /// Carries the rays of a picture through a slab: see [`Part`]. Rays that come by later than the slabs that they meet
    /// first are as in [`Device::march`], to the bit. `march` differs from slab to slab in the values that are held alone.
    fn march_slab(&self, march: &March, part: &Part, rays: &mut Rays) -> Result<()>;

    /// Casts the rays of some tiles only ([`March::TILE`]); the other pixels of `frame` stay as they are. Each pixel is that
    /// of [`Device::march`] to the bit.
    fn march_tiles(&self, march: &March, tiles: &[u32], frame: &mut Frame) -> Result<()> {
        let mut whole = Frame::new(frame.size);
        self.march(march, &mut whole)?;
        for row in tiles.iter().flat_map(|tile| March::rows(*tile, frame.size)) {
            frame.pixels[row.clone()].copy_from_slice(&whole.pixels[row]);
        }
        Ok(())
    }

    /// One pass of half-angle slicing: see [`slices::Slices`]. Adds to what the rays of the window hold; there is one for each pixel
    /// of the picture.
    fn slice(&self, slices: &slices::Slices, rays: &mut [Ray]) -> Result<()>;

    /// Gradient magnitude of data on `grid`, data values per world length: central differences of neighbours (GPU Gems 39 (2)); a
    /// neighbour that is beyond the edge or a hole repeats the value itself. 0 in holes.
    fn gradient(&self, grid: &Grid, field: &Buffer, out: &mut Buffer) -> Result<()>;

    /// [`Device::classify`] by a two-dimensional table; `of` are the size of the data,
    /// the data, and their gradient magnitudes.
    fn classify_graded(
        &self,
        optic: Optic,
        table: &Table,
        of: ([usize; 3], &Buffer, &Buffer),
        size: [usize; 3],
        out: &mut Buffer,
    ) -> Result<()>;

    /// Carries rays on to the next isosurface in their way, or to where they leave ([`Hit::NONE`]): see [`Surfaces`].
    fn surface_hits(&self, surfaces: &Surfaces, hits: &mut [Hit]) -> Result<()> {
        let _ = (surfaces, hits);
        Err(no_surfaces(self.name()))
    }

    /// Adds to each hit's sums of unoccluded directions and of the part of rays that escapes: see [`Occlusion`].
    fn surface_occlusion(
        &self,
        surfaces: &Surfaces,
        occlusion: &Occlusion,
        samples: Samples,
        hits: &[Hit],
        sums: &mut [[f32; 4]],
    ) -> Result<()> {
        let _ = (surfaces, occlusion, samples, hits, sums);
        Err(no_surfaces(self.name()))
    }

    /// Adds to each hit's sums of the environment through the diffuse and the specular lobe: see [`Beauty`].
    fn surface_beauty(
        &self,
        surfaces: &Surfaces,
        beauty: &Beauty,
        hits: &[Hit],
        sums: &mut [[[f32; 3]; 2]],
    ) -> Result<()> {
        let _ = (surfaces, beauty, hits, sums);
        Err(no_surfaces(self.name()))
    }

    /// Adds to each hit's sum of light scattered beneath the surface: see [`Subsurface`].
    fn surface_subsurface(
        &self,
        surfaces: &Surfaces,
        subsurface: &Subsurface,
        hits: &[Hit],
        sums: &mut [[f32; 3]],
    ) -> Result<()> {
        let _ = (surfaces, subsurface, hits, sums);
        Err(no_surfaces(self.name()))
    }

    /// Adds one term of the light volume to each hit: radiance of a white diffuse surface, `E·max(0, n·l)/π`, and of a specular
    /// lobe, `E·(s + 1)/2π·max(0, r·l)^s`; scattered light counts as even, and its current is left out.
    fn surface_light(&self, surfaces: &Surfaces, term: &Term, hits: &[Hit], sums: &mut [[[f32; 3]; 2]]) -> Result<()> {
        let _ = (surfaces, term, hits, sums);
        Err(no_surfaces(self.name()))
    }

    /// Ray casting up to what is opaque, one for each pixel of `frame`: see [`March`] and [`Behind`]. Where there is nothing opaque, the
    /// pixel is that of [`Device::march`] to the bit.
    fn march_before(&self, march: &March, behind: &[Behind], frame: &mut Frame) -> Result<()> {
        assert_eq!(behind.len(), frame.pixels.len(), "one for each pixel");
        let mut rays = Rays::new(frame.size, behind.iter().map(Behind::ray).collect());
        self.march_slab(march, &Part::whole(march), &mut rays)?;
        let pixels = behind.iter().zip(&rays.each).map(|(behind, ray)| behind.pixel(ray));
        frame.pixels.iter_mut().zip(pixels).for_each(|(to, pixel)| *to = pixel);
        Ok(())
    }

    /// The values of a volume of `size` at points in its index space, trilinear, clamped to the outermost values.
    fn sample(&self, size: [usize; 3], values: &Buffer, points: &[[f32; 3]], out: &mut [f32]) -> Result<()> {
        let mut host = vec![0.0; size.iter().product()];
        self.download(values, &mut host)?;
        cpu::sample::sample(size, &host, points, out);
        Ok(())
    }

    /// The part of [`Device::transport`] that ordinates add which cross planes of z one way, in a slab: see [`Passage`]. Buffers
    /// hold the slab's planes, and `t.grid` has their number. `faces`: what the slab before has left, if there is one, and
    /// what this one leaves; a plane for each of these ordinates, in an order of the device's own. `phi` and `current` are summed
    /// into.
    fn transport_slab(
        &self,
        _t: &Transport,
        _passage: &Passage,
        _faces: (&Buffer, &mut Buffer),
        _phi: &mut Buffer,
        _current: Option<[&mut Buffer; 3]>,
    ) -> Result<()> {
        let why = format!("scattered light a slab at a time on {}\n  try: more --memory, or --device cpu", self.name());
        Err(Error::Unsupported(why))
    }

    /// Inner products over runs of values, of which [`RUN`] is a multiple: their sum, in order, is [`Device::dot`].
    fn dot_parts(&self, a: &Buffer, b: &Buffer) -> Result<Vec<f64>> {
        let [a, b] = self.both(a, b)?;
        Ok(vec![a.iter().zip(&b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()])
    }

    /// [`Device::sweep`] of all bricks for several lights: where extinction has to be read, one reading may serve all.
    fn sweep_each(&self, lights: &mut [(Sweep, &mut Buffer)], layout: &BrickLayout, sigma: &Buffer) -> Result<()> {
        lights.iter_mut().try_for_each(|(sweep, rho)| {
            let fronts = layout.fronts(sweep.ascending());
            let fronts: Vec<&[u32]> = fronts.iter().map(|f| &f[..]).collect();
            self.sweep(sweep, layout, sigma, rho, &fronts).map(drop)
        })
    }

    /// Sets all values.
    fn fill(&self, value: f32, into: &mut Buffer) -> Result<()> {
        self.upload(&vec![value; into.len()], into)
    }

    /// Path tracing: adds samples to the sums of a picture's pixels, row by row. See [`Trace`].
    fn trace(&self, trace: &Trace, picture: [usize; 2], tallies: &mut [Tally]) -> Result<Traced>;

    /// Runs work of the host on the threads that this device computes on, where it has some of its own.
    fn on_threads(&self, work: &mut (dyn FnMut() + Send)) {
        work();
    }

    /// Path tracing of some tiles only ([`March::TILE`]); the other pixels' sums stay as they are. `touched` has
    /// `trace.bricks.len().div_ceil(64)` words for each of the tiles and takes a bit for each brick that paths depended on: while these
    /// bricks, their bounds, values in a halo of two and how many empty ones lie ahead of them stay what they are, the tile's samples
    /// do, to the bit.
    fn trace_tiles(
        &self,
        trace: &Trace,
        tiles: &[u32],
        picture: [usize; 2],
        tallies: &mut [Tally],
        touched: &mut [u64],
    ) -> Result<Traced> {
        // Of paths that nobody has followed, any may have been anywhere.
        touched.fill(u64::MAX);
        if tiles.is_empty() {
            return Ok(Traced::default());
        }
        let mut whole = tallies.to_vec();
        let traced = self.trace(trace, picture, &mut whole)?;
        for row in tiles.iter().flat_map(|tile| March::rows(*tile, picture)) {
            tallies[row.clone()].copy_from_slice(&whole[row]);
        }
        Ok(traced)
    }

    /// Makes a buffer hold `len` values, which mean nothing yet. Within the number that it was made for, memory is not taken anew.
    fn resize(&self, buffer: &mut Buffer, len: usize) -> Result<()> {
        if buffer.len() != len {
            *buffer = self.alloc(len)?;
        }
        Ok(())
    }

    /// The values of a region of a volume of `size`, as a volume of their own.
    fn crop(&self, size: [usize; 3], values: &Buffer, region: Region, out: &mut Buffer) -> Result<()> {
        let (mut host, mut cropped) = (vec![0.0; size.iter().product()], vec![0.0; region.len()]);
        self.download(values, &mut host)?;
        cpu::crop::crop(size, &host, region, &mut cropped);
        self.upload(&cropped, out)
    }

    /// The way back from [`Device::crop`]: a volume of `size` that is 0 outside the region.
    fn embed(&self, region: Region, values: &Buffer, size: [usize; 3], out: &mut Buffer) -> Result<()> {
        let (mut host, mut whole) = (vec![0.0; region.len()], vec![0.0; size.iter().product()]);
        self.download(values, &mut host)?;
        cpu::crop::embed(region, &host, size, &mut whole);
        self.upload(&whole, out)
    }
}

fn no_surfaces(device: String) -> Error {
    Error::Unsupported(format!("render.kind = \"isosurface\" on {device}\n  try: --device cpu"))
}
