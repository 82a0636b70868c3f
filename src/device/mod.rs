//! Kernels: arithmetic on voxels and rays, and nothing else.
//!
//! A [`Device`] knows no scene file, no clock and no channel. Every kernel exists in Rust (`device/cpu/NAME.rs`) and in
//! WGSL (`shaders/NAME.wgsl`) under the same name, with the same equation at the top; a test runs both on the same random
//! input. What decides (which brick next, what may be skipped, when to stop) lives above, once.

use std::ops::Range;
use std::sync::Arc;

use glam::{DVec3, Vec3};

use crate::camera::Camera;
use crate::error::Result;
use crate::field::{self, Field};
use crate::frame::Frame;
use crate::grid::{BrickLayout, Grid, Slab};
use crate::transfer::Table;
use convection::{Convected, Convection, Layers, Spread};

pub mod convection;
pub mod cpu;
#[cfg(feature = "gpu")]
pub mod gpu;
mod open;
pub mod paged;

pub use open::open;

/// A dense array of f32 where the device can work on it. Made by [`Device::alloc`]; used only with the device that made it.
pub struct Buffer(pub(crate) Storage);

pub(crate) enum Storage {
    Host(Vec<f32>),
    Paged(Box<paged::Store>),
    #[cfg(feature = "gpu")]
    Gpu {
        buffer: wgpu::Buffer,
        len: usize,
    },
}

impl Buffer {
    /// Number of values.
    pub fn len(&self) -> usize {
        match &self.0 {
            Storage::Host(v) => v.len(),
            Storage::Paged(store) => store.len,
            #[cfg(feature = "gpu")]
            Storage::Gpu { len, .. } => *len,
        }
    }

    /// True when there are no values.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The values, when they are in host memory.
    pub fn host(&self) -> Option<&[f32]> {
        match &self.0 {
            Storage::Host(v) => Some(v),
            _ => None,
        }
    }
}

/// Which optical property [`Device::classify`] computes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Optic {
    /// Extinction σ_t of direct and uncollided light, 1/world length.
    Extinction,
    /// Delta-scaled extinction `σ_t (1 − ω f)`, ω the mean over channels, f = g² (light.md, delta-Eddington).
    ScaledExtinction {
        /// Fraction of scattering that is treated as going straight on.
        f: f32,
    },
    /// Scattering coefficient `ω σ_t` of a channel.
    Scattering {
        /// 0 red, 1 green, 2 blue.
        channel: usize,
    },
    /// Emitted radiance per world length of a channel.
    Emission {
        /// 0 red, 1 green, 2 blue.
        channel: usize,
    },
}

impl Optic {
    /// The property for each entry of a transfer function; what lies between entries is linear.
    pub fn curve(self, table: &Table) -> Vec<f32> {
        (0..table.extinction.len())
            .map(|i| {
                let (sigma, albedo) = (table.extinction[i], table.albedo[i]);
                match self {
                    Optic::Extinction => sigma,
                    Optic::ScaledExtinction { f } => sigma * (1.0 - f * (albedo[0] + albedo[1] + albedo[2]) / 3.0),
                    Optic::Scattering { channel } => sigma * albedo[channel],
                    Optic::Emission { channel } => table.emission.get(i).map_or(0.0, |e| e[channel]),
                }
            })
            .collect()
    }
}

/// Geometry of one pass of short characteristics over a grid, dominant axis first (light.md, direct light).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sweep {
    /// Values along x, y, z.
    pub size: [usize; 3],
    /// The way the light travels, in index space: unit world direction divided by spacing, so that anisotropic spacing
    /// enters offsets and lengths. Only the ratios matter.
    pub direction: [f32; 3],
    /// World length of the path between two layers perpendicular to the dominant axis: `Δx_a / |u_a|`.
    pub length: f32,
    /// Foot by clamped Catmull–Rom instead of bilinear weights. Whole-grid only: `fronts` are ignored and every brick is
    /// swept, because a cubic foot reaches downstream bricks of the previous layer.
    pub cubic: bool,
    /// A slab of a larger grid: its first plane across z, the way the light travels, is the last of the slab before. Its ρ is
    /// given and stays.
    pub given: bool,
}

impl Sweep {
    /// The sweep of `grid` along unit world direction `u`.
    pub fn new(grid: &Grid, u: Vec3, cubic: bool) -> Self {
        let direction: [f32; 3] = std::array::from_fn(|a| (f64::from(u[a]) / grid.spacing[a]) as f32);
        let sweep = Sweep { size: grid.size, direction, length: 0.0, cubic, given: false };
        Sweep { length: 1.0 / direction[sweep.axis()].abs(), ..sweep }
    }

    /// The dominant axis in index space; the lower one where two are equal.
    pub fn axis(&self) -> usize {
        let d = self.direction.map(f32::abs);
        if d[0] >= d[1] && d[0] >= d[2] {
            0
        } else if d[1] >= d[2] {
            1
        } else {
            2
        }
    }

    /// True along each axis where the light travels towards increasing indices (also where it does not move).
    pub fn ascending(&self) -> [bool; 3] {
        self.direction.map(|d| d >= 0.0)
    }
}

/// Geometry of one pass of short characteristics away from a point (light.md, direct light).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointSweep {
    /// Values along x, y, z.
    pub size: [usize; 3],
    /// The first index at or beyond the light along each axis.
    pub cell: [i32; 3],
    /// How far beyond, in voxels: 0 ≤ fraction < 1.
    pub fraction: [f32; 3],
    /// Length of a step of one voxel along each axis: the world's, times any factor on extinction.
    pub spacing: [f32; 3],
}

/// What lies behind the end of a brick along an axis, as its light sees it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Edge {
    /// Nothing that the brick needs.
    Downstream,
    /// A layer that an earlier front has solved, or the outside of the grid.
    Upstream,
    /// The other one of the two columns beside the light's plane: the brick solves it too.
    Ghost,
}

impl PointSweep {
    /// Farther lights, in voxels, are brought this near: their rays are parallel to a millionth.
    const FARTHEST: f64 = (1 << 20) as f64;

    /// The sweep of `grid` away from world position `position`, with extinction times `factor`.
    pub fn new(grid: &Grid, position: DVec3, factor: f32) -> Self {
        let (spacing, origin) = (DVec3::from(grid.spacing), DVec3::from(grid.origin));
        let middle = 0.5 * DVec3::from(grid.size.map(|n| n as f64 - 1.0));
        let at = (position - origin) / spacing;
        let at = middle + (at - middle).clamp_length_max(Self::FARTHEST);
        // To a millionth of a voxel, so that a light that is meant to be on a voxel is on it.
        let at = (at * Self::FARTHEST).round() / Self::FARTHEST;
        Self {
            size: grid.size,
            cell: at.ceil().as_ivec3().to_array(),
            fraction: (at.ceil() - at).as_vec3().to_array(),
            spacing: (spacing * f64::from(factor)).as_vec3().to_array(),
        }
    }

    /// Offset of index `i` from the light along an axis, in voxels.
    pub fn offset(&self, axis: usize, i: i32) -> f32 {
        let (cell, fraction) = (self.cell[axis], self.fraction[axis]);
        if i >= cell { (i - cell) as f32 + fraction } else { -((cell - 1 - i) as f32 + (1.0 - fraction)) }
    }

    /// Whole voxels between the light and index `i` along an axis.
    pub fn layer(&self, axis: usize, i: i32) -> i32 {
        if i >= self.cell[axis] { i - self.cell[axis] } else { self.near(axis)[0] - i }
    }

    /// The lowest and the highest index of layer 0: a pair unless the light is on a plane of voxels.
    fn near(&self, axis: usize) -> [i32; 2] {
        [self.cell[axis] - i32::from(self.fraction[axis] > 0.0), self.cell[axis]]
    }

    /// What lies before index `start` and behind index `end − 1` of a brick.
    pub fn edges(&self, axis: usize, start: i32, end: i32) -> [Edge; 2] {
        let [low, high] = self.near(axis);
        let ghost = |inside: bool| if inside { Edge::Ghost } else { Edge::Downstream };
        [
            if start > high { Edge::Upstream } else { ghost(start == high && low < high && start > 0) },
            if end <= low { Edge::Upstream } else { ghost(end == high && low < high && end < self.size[axis] as i32) },
        ]
    }

    /// Bricks between the light and brick coordinate `c` along an axis.
    fn depth(&self, layout: &BrickLayout, axis: usize, c: usize) -> usize {
        let [low, high] = self.near(axis);
        let (start, end) = (c * layout.edge, ((c + 1) * layout.edge).min(layout.size[axis]));
        if start as i32 > high {
            c - if high < 0 { 0 } else { high as usize / layout.edge }
        } else if end as i32 <= low {
            (low as usize / layout.edge).min(layout.counts()[axis] - 1) - c
        } else {
            0
        }
    }

    /// Bricks ordered outward from the light: those of one front do not depend on each other.
    pub fn fronts(&self, layout: &BrickLayout) -> Vec<Vec<u32>> {
        let mut fronts: Vec<Vec<u32>> = Vec::new();
        for b in 0..layout.len() {
            let c = layout.coords(b);
            let depth = (0..3).map(|a| self.depth(layout, a, c[a])).sum();
            if fronts.len() <= depth {
                fronts.resize(depth + 1, Vec::new());
            }
            fronts[depth].push(b as u32);
        }
        // A light far outside leaves no gap: depths along an axis begin at 0.
        fronts
    }

    /// The bricks that brick `b` reads light from.
    pub fn upstream(&self, layout: &BrickLayout, b: usize) -> Vec<u32> {
        let coords = layout.coords(b);
        let region = layout.region(b);
        // For each axis the neighbour that may be read, and whether it is upstream.
        let beside: [Option<(usize, bool)>; 3] = std::array::from_fn(|a| {
            let [low, high] = self.edges(a, region.start[a] as i32, region.end()[a] as i32);
            let (edge, to) = match (low, high) {
                (Edge::Downstream, high) => (high, coords[a] + 1),
                (low, _) => (low, coords[a].wrapping_sub(1)),
            };
            (edge != Edge::Downstream && to < layout.counts()[a]).then_some((to, edge == Edge::Upstream))
        });
        (1..8usize)
            .filter_map(|mask| {
                let mut c = coords;
                let mut upstream = false;
                for a in 0..3 {
                    if mask >> a & 1 == 1 {
                        let (to, up) = beside[a]?;
                        c[a] = to;
                        upstream |= up;
                    }
                }
                upstream.then(|| layout.number(c) as u32)
            })
            .collect()
    }
}

/// One discrete ordinate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ordinate {
    /// Unit world direction of travel.
    pub direction: Vec3,
    /// Quadrature weight; all weights sum to 4π.
    pub weight: f32,
    /// Radiance that enters the grid along this direction.
    pub inflow: f32,
}

/// One pass of transport along every ordinate, one colour channel:
/// `I = I_up e^−τ + w₀ S + w₁ S_up`, accumulated into `φ = Σ w I` and `J = Σ w Ω I`
/// (light.md, first-collision-source ordinates). I, σ and S at the foot are bilinear in the layer before. Outside the grid
/// σ = 0 and I = S = the inflow, so that inflow and S equal to 1 give I = 1 everywhere (the white furnace); the first layer
/// is reached after half a step, with the S of the voxel itself.
pub struct Transport<'a> {
    /// The light grid.
    pub grid: &'a Grid,
    /// The directions.
    pub ordinates: &'a [Ordinate],
    /// Extinction (delta-scaled) per world length.
    pub sigma: &'a Buffer,
    /// Isotropic part of the source function S (radiance; emission per length is σS).
    pub source: &'a Buffer,
    /// Linearly anisotropic part: S(Ω) = source + Ω·gradient, clamped at 0. `None` when g = 0.
    pub gradient: Option<[&'a Buffer; 3]>,
}

/// A light in one place. Per unit of radiant intensity its irradiance in vacuum, at distance r and angle θ from the cone's
/// axis, is `t²(3 − 2t)/max(r, radius)²` with `t = (cos θ − outer)/(inner − outer)` clamped to 0..1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lamp {
    /// World position.
    pub position: DVec3,
    /// World length below which 1/r² does not grow any more; nor does it below 0.36 voxels of the grid at hand, which is
    /// what 1/r² is in the mean over a ball as large as a voxel round the light.
    pub radius: f64,
    /// The cone that it is limited to, if any.
    pub cone: Option<Cone>,
}

/// Where a [`Lamp`] shines.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cone {
    /// The way the light travels along the axis, unit.
    pub axis: Vec3,
    /// Cosine of the angle at which the light ends.
    pub outer: f32,
    /// Cosine of the angle within which it is full.
    pub inner: f32,
}

/// A [`Lamp`] in the index space of a grid, as kernels take it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Falloff {
    pub position: Vec3,
    pub spacing: Vec3,
    /// Square of the lamp's radius.
    pub floor: f32,
    pub axis: Vec3,
    pub outer: f32,
    /// 1/(inner − outer).
    pub slope: f32,
}

impl Lamp {
    /// Voxels from the light within which 1/r² in the middle of a voxel is more than a hundredth below its mean.
    pub const NEAR: f32 = 2.5;
    /// Points along an edge of such a voxel.
    pub(crate) const PARTS: usize = 4;

    /// On a grid of which each voxel stands for `parts`³ points.
    pub(crate) fn on(&self, grid: &Grid, parts: usize) -> Falloff {
        let spacing = DVec3::from(grid.spacing);
        // In a ball of radius R the mean of 1/r² is 3/R².
        let ball = (0.75 / std::f64::consts::PI * grid.spacing.iter().product::<f64>()).cbrt();
        let least = ball / 3f64.sqrt() / parts as f64;
        // Without a cone the axis is 0, and t = 1 whatever the angle.
        let cone = self.cone.unwrap_or(Cone { axis: Vec3::ZERO, outer: -1.0, inner: 0.0 });
        Falloff {
            position: ((self.position - DVec3::from(grid.origin)) / spacing).as_vec3(),
            spacing: spacing.as_vec3(),
            floor: (self.radius.max(least) * self.radius.max(least)) as f32,
            axis: cone.axis,
            outer: cone.outer,
            slope: 1.0 / (cone.inner - cone.outer).max(1e-6),
        }
    }
}

/// The way the direct light of a source travels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Travel {
    /// Everywhere along this unit direction.
    Along(Vec3),
    /// Away from this world position: `u = (x − P)/max(|x − P|, Δ)`, Δ the mean spacing, as the mean over a voxel that holds
    /// the light has no direction.
    From(DVec3),
}

/// One colour channel's part in the source function
/// `S = [σ_s*/4π · (φ + ΣE_l + 3g* Ω·(J + ΣE_l u_l)) + emission] / σ*` of [`Device::source`].
pub struct SourceTerm<'a> {
    /// Delta-scaled extinction σ*.
    pub sigma: &'a Buffer,
    /// Delta-scaled scattering coefficient of the channel, `ω (1 − f) σ_t`.
    pub scattering: &'a Buffer,
    /// Emission per world length of the channel, if any.
    pub emission: Option<&'a Buffer>,
    /// Where the values sit.
    pub grid: &'a Grid,
    /// First-collision fluence of each light on this grid, with the channel's factor on it and the light's direction.
    pub first: &'a [(&'a Buffer, f32, Travel)],
    /// Fluence of scattered light.
    pub phi: &'a Buffer,
    /// Its current J and 3g*, where scattering is anisotropic.
    pub current: Option<([&'a Buffer; 3], f32)>,
}

/// A scalar volume that lights the samples of a ray: in-scattered radiance is `ω(v) · max(0, Σ_terms weight(ray)·value(x))`.
pub struct Term<'a> {
    /// Values on `grid`.
    pub values: &'a Buffer,
    /// Where they sit: fills the same box as the data grid.
    pub grid: &'a Grid,
    /// What a value contributes to each channel.
    pub weight: Weight,
}

/// Weight of a [`Term`]; constant along a ray but for a lamp.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Weight {
    /// The same for every ray: `φ/4π` of a colour channel, say.
    Uniform([f32; 3]),
    /// Direct light: `irradiance · p(cos θ)` with Henyey–Greenstein p, θ between the light's travel and the way to the eye.
    Phase {
        /// The way the light travels, unit.
        direction: Vec3,
        /// Irradiance per channel.
        irradiance: [f32; 3],
        /// Henyey–Greenstein g.
        g: f32,
    },
    /// Direct light of a lamp at x: `intensity · falloff(x) · p(cos θ)`, θ between x − P and the way to the eye.
    Lamp {
        /// Where it is and how its light falls off.
        lamp: Lamp,
        /// Radiant intensity per channel.
        intensity: [f32; 3],
        /// Henyey–Greenstein g.
        g: f32,
    },
    /// One component of a current J: `weight · Ω[axis]`, Ω the way to the eye.
    Current {
        /// 0 x, 1 y, 2 z.
        axis: usize,
        /// Per channel.
        weight: [f32; 3],
    },
}

/// Blinn–Phong shading by the gradient of extinction, gated by its magnitude (Zhang & Ma (24), GPU Gems 39 (2), (4)).
///
/// In-scattered radiance is multiplied by `1 + s·(ambient + diffuse·max(0, n·l) + specular·max(0, n·h)^shininess − 1)`,
/// where ∇σ_t comes from central differences one value apart (positions clamped to the outermost values; holes count 0),
/// `n = −∇σ_t/|∇σ_t|`, h halves the angle between l and the way to the eye, and `s = |∇σ_t|·Δ/(|∇σ_t|·Δ + σ_t)` with Δ the
/// mean spacing: no shading where the gradient vanishes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Phong {
    /// Towards the light, unit; the first light's.
    pub towards_light: Vec3,
    /// Strengths.
    pub ambient: f32,
    /// Lambert.
    pub diffuse: f32,
    /// Highlight.
    pub specular: f32,
    /// Exponent of the highlight.
    pub shininess: f32,
}

/// Ray casting through data lit by light volumes: `L = ∫ T σ_t [ω ΣTerms + j/σ_t] ds`.
///
/// - A ray is cut into intervals `[n·step, min((n+1)·step, length)]` from where it enters the volume's box (or from the eye
///   inside it), and sampled in the middle of each, so that a homogeneous medium has its exact optical depth at any step.
/// - A sample of length `ds` has opacity `α = 1 − e^(−σ_t ds)`; it adds `T·(α·ω·max(0, Σ weight·value) + j·α/σ_t)`, the last
///   factor being `ds` where σ_t = 0.
/// - Where extinction differs between colour channels each has its own α and T; a pixel's coverage is `1 − T` with the mean T.
/// - Data and terms are trilinear between values and clamped in the rim of half a value.
/// - Skipping empty bricks never moves a sample: the picture is the same to the bit with and without it.
/// - A ray ends when its transmittance, in every channel, falls below [`March::OPAQUE`].
pub struct March<'a> {
    /// The data grid.
    pub grid: &'a Grid,
    /// Data values; below [`crate::field::HOLE`] transparent.
    pub field: &'a Buffer,
    /// Values to optics.
    pub table: &'a Table,
    /// Bricks of the data grid for empty-space skipping.
    pub bricks: BrickLayout,
    /// Largest extinction or emission in each brick with a halo of one value; 0 where nothing can be seen. Empty: no
    /// brick is skipped.
    pub majorant: &'a [f32],
    /// Lights; may be empty (emission only).
    pub terms: &'a [Term<'a>],
    /// Phong shading, if any.
    pub phong: Option<Phong>,
    /// The camera.
    pub camera: &'a Camera,
    /// World length between samples; at least a millionth of the box's diagonal is taken.
    pub step: f32,
}

impl March<'_> {
    /// Transmittance below which a ray ends: what lies behind can add at most this fraction of its radiance, less than
    /// a twentieth of a level of an 8-bit picture.
    pub const OPAQUE: f32 = 1e-4;

    /// Pixels along the edge of a tile. Tiles are numbered row by row from the upper left; those at the right and lower
    /// edges of a picture may be cut.
    pub const TILE: usize = 16;

    /// Tiles along x and y of a picture.
    pub fn tiles(picture: [usize; 2]) -> [usize; 2] {
        picture.map(|n| n.div_ceil(Self::TILE))
    }
}

/// A ray on its way, between two slabs.
#[derive(Debug, Clone, Copy, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct Ray {
    /// Radiance so far, from the eye on.
    pub radiance: [f32; 3],
    /// Transmittance so far, per channel.
    pub transmittance: [f32; 3],
    /// Number of the next sample.
    pub next: f32,
}

impl Ray {
    /// A ray that has not met anything.
    pub const FRESH: Ray = Ray { radiance: [0.0; 3], transmittance: [1.0; 3], next: 0.0 };

    /// What the ray has gathered: radiance and coverage.
    pub fn pixel(&self) -> [f32; 4] {
        let [r, g, b] = self.radiance;
        let [x, y, z] = self.transmittance;
        let passed = if x == y && y == z { x } else { (x + y + z) * (1.0 / 3.0) };
        [r, g, b, 1.0 - passed]
    }
}

/// A slab of what rays are cast through: `field` and the values of the terms hold only these planes.
#[derive(Debug, Clone, PartialEq)]
pub struct Part {
    /// Samples are taken whose lower neighbours along z are in these planes of the data.
    pub cells: Range<usize>,
    /// Planes of the data that are held: `cells` and one above; with shading one more on both sides.
    pub field: Range<usize>,
    /// Planes that each term holds, on its own grid.
    pub terms: Vec<Range<usize>>,
}

/// Extinction just outside the medium (see [`Device::extend`]), per world length: far too little to dim anything in a
/// volume of up to 10¹⁰ world lengths, and far above what f32 cannot hold.
pub const FAINT: f32 = 1e-18;

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
    fn irradiate(&self, lamp: &Lamp, grid: &Grid, rho: &Buffer, out: &mut Buffer) -> Result<()>;

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

    /// `out = ρ · cone · 1/r²` of a light from one place: see [`Spread`].
    fn spread(&self, size: [usize; 3], spread: &Spread, rho: &Buffer, out: &mut Buffer) -> Result<()>;

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
    fn prolong(&self, coarse: [usize; 3], values: &Buffer, size: [usize; 3], into: &mut Buffer) -> Result<()>;

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
        let [a, b] = self.both(a, b)?;
        Ok(a.iter().zip(&b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum())
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

    /// Continues a coefficient of the medium (scattering, emission, extinction itself) past the medium's edges in
    /// proportion to its extinction: where σ = 0 but some of the 26 neighbours have σ > 0, `out = Σvalues/Σσ ·`
    /// [`FAINT`] over them; elsewhere `out = values`. So S = values/σ is defined wherever it is interpolated.
    fn extend(&self, size: [usize; 3], sigma: &Buffer, values: &Buffer, out: &mut Buffer) -> Result<()> {
        let [sigma, values] = self.both(sigma, values)?;
        let mut extended = vec![0.0; out.len()];
        cpu::extend::extend(size, &sigma, &values, &mut extended);
        self.upload(&extended, out)
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
    /// first are as in [`Device::march`], to the bit.
    fn march_slab(&self, march: &March, part: &Part, picture: [usize; 2], rays: &mut [Ray]) -> Result<()>;

    /// Casts the rays of some tiles only ([`March::TILE`]); the other pixels of `frame` stay as they are. Each pixel is that
    /// of [`Device::march`] to the bit.
    fn march_tiles(&self, march: &March, tiles: &[u32], frame: &mut Frame) -> Result<()> {
        let mut whole = Frame::new(frame.size);
        self.march(march, &mut whole)?;
        let [across, _] = March::tiles(frame.size);
        for &tile in tiles {
            let [x, y] = [tile as usize % across, tile as usize / across].map(|t| t * March::TILE);
            for y in y..(y + March::TILE).min(frame.size[1]) {
                let row = y * frame.size[0] + x..y * frame.size[0] + (x + March::TILE).min(frame.size[0]);
                frame.pixels[row.clone()].copy_from_slice(&whole.pixels[row]);
            }
        }
        Ok(())
    }
}
