//! What all rays of a picture share: the march in index space, with everything that does not depend on the pixel computed.

use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;

use glam::{DVec3, Vec3};

use super::empty::Distances;
use crate::device::cpu::host;
use crate::device::{Clip, Falloff, March, Part, Phong, Weight};
use crate::grid::{BrickLayout, Grid, Slab};
use crate::transfer::Table;

/// A dense array that can be interpolated: at least two values along x, so that neighbours along x are read as pairs.
pub(in crate::device::cpu) struct Volume<'a> {
    values: Cow<'a, [f32]>,
    /// Values of the whole grid before the first that is held.
    before: usize,
}

impl<'a> Volume<'a> {
    fn new(values: &'a [f32], slab: &Slab) -> Self {
        let len = slab.len();
        assert!(values.len() >= len, "{} values for {len}", values.len());
        let values = match slab.size[0] {
            1 => Cow::Owned(values[..len].iter().flat_map(|&v| [v, v]).collect()),
            _ => Cow::Borrowed(&values[..len]),
        };
        Volume { values, before: slab.planes.start * slab.size[0].max(2) * slab.size[1] }
    }

    /// Where value (0, 0, 0) of the whole grid would be.
    pub fn origin(&self) -> *const f32 {
        self.values.as_ptr().wrapping_sub(self.before)
    }
}

/// Where the values of a volume of some size are found: shared by all volumes of that size.
pub(in crate::device::cpu) struct Lattice {
    /// Indices of the first and the last value that are held along each axis: positions are clamped to them.
    pub first: [f32; 3],
    pub last: [f32; 3],
    /// Index of the last cell (pair of neighbours) that is held along each axis.
    pub last_cell: [f32; 3],
    /// Values from one row, and from one slice, to the next.
    pub stride: [usize; 2],
    /// To the neighbour along y, along z, and along both; 0 along an axis with a single value.
    pub corners: [usize; 3],
    /// Position on this lattice = scale·(position on the data's lattice) + shift.
    pub scale: [f32; 3],
    pub shift: [f32; 3],
}

impl Lattice {
    fn new(slab: &Slab, data: [usize; 3]) -> Self {
        let (size, planes) = (slab.size, &slab.planes);
        assert!(planes.len() >= size[2].min(2), "planes on both sides of a sample");
        let row = size[0].max(2);
        let stride = [row, row * size[1]];
        let [y, z] = [1, 2].map(|a| if size[a] > 1 { stride[a - 1] } else { 0 });
        let scale: [f64; 3] = std::array::from_fn(|a| size[a] as f64 / data[a] as f64);
        Lattice {
            first: [0.0, 0.0, planes.start as f32],
            last: [size[0], size[1], planes.end].map(|n| (n - 1) as f32),
            last_cell: [size[0], size[1], planes.end].map(|n| n.saturating_sub(2) as f32),
            stride,
            corners: [y, z, y + z],
            scale: scale.map(|s| s as f32),
            shift: scale.map(|s| (0.5 * s - 0.5) as f32),
        }
    }
}

/// Terms on grids of one size: they share cells and weights.
pub(super) struct Group<'a> {
    held: Slab,
    pub lattice: Lattice,
    /// The same planes of the same size as the data: the data's cell is used.
    pub with_data: bool,
    pub terms: Vec<Lit<'a>>,
}

/// A term.
pub(super) struct Lit<'a> {
    pub volume: Volume<'a>,
    pub weight: Weight,
    /// A lamp's, in the index space of the data.
    pub falloff: Option<Falloff>,
}

/// One column of the transfer function, at least two entries long.
pub(in crate::device::cpu) struct Column(Vec<f32>);

impl Column {
    fn new(entries: impl Iterator<Item = f32>) -> Self {
        let mut entries: Vec<f32> = entries.collect();
        entries.resize(entries.len().max(2), entries.last().copied().unwrap_or(0.0));
        Column(entries)
    }

    pub fn as_ptr(&self) -> *const f32 {
        self.0.as_ptr()
    }

    /// The integral from the first entry to each, where a column is linear in between.
    fn integral(&self) -> Self {
        let mut sum = 0.0f64;
        let steps = self.0.windows(2).map(|w| 0.5 * (f64::from(w[0]) + f64::from(w[1])));
        Column(
            std::iter::once(0.0)
                .chain(steps.map(|s| {
                    sum += s;
                    sum as f32
                }))
                .collect(),
        )
    }
}

/// A column, and its integral over the entries before each.
pub(in crate::device::cpu) struct Summed {
    pub values: Column,
    pub sums: Column,
}

impl Summed {
    fn new(entries: impl Iterator<Item = f32>) -> Self {
        let values = Column::new(entries);
        Summed { sums: values.integral(), values }
    }
}

/// Rows of a two-dimensional table.
pub(in crate::device::cpu) struct Rows {
    /// Entries of a row.
    pub width: usize,
    /// Rows per unit of gradient magnitude.
    pub scale: f32,
    /// The last row.
    pub last: f32,
}

/// Pre-integration (Engel, Kraus & Ertl 2001, by integral functions): what means over values are made of.
pub(in crate::device::cpu) struct Means {
    pub extinction: Summed,
    /// Extinction times albedo.
    pub scattering: [Summed; 3],
    pub emission: Option<[Summed; 3]>,
}

/// Albedo as it is looked up.
pub(in crate::device::cpu) enum Albedo {
    Constant([f32; 3]),
    Gray(Column),
    Rgb([Column; 3]),
}

/// The transfer function as columns.
pub(in crate::device::cpu) struct Optics {
    pub lo: f32,
    /// Entries per unit of value.
    pub scale: f32,
    /// Last entry.
    pub last: f32,
    pub extinction: Column,
    /// Factor on extinction per channel, where they differ.
    pub chromatic: Option<[f32; 3]>,
    pub albedo: Albedo,
    pub emission: Option<[Column; 3]>,
    /// Of a two-dimensional table: all columns hold one row after another.
    pub rows: Option<Rows>,
    pub means: Option<Means>,
}

impl Optics {
    fn new(table: &Table) -> Self {
        let (extinction, albedo, emission) = table.columns();
        let width = table.extinction.len();
        let columns = |rgb: &[[f32; 3]]| {
            // Shorter columns than the extinction's would be read beyond their end.
            assert_eq!(rgb.len(), extinction.len(), "columns of a table have one length");
            std::array::from_fn(|c| Column::new(rgb.iter().map(|e| e[c])))
        };
        let albedos = match table.constant_albedo() {
            Some(albedo) => Albedo::Constant(albedo),
            None => {
                let rgb: [Column; 3] = columns(albedo);
                if albedo.iter().all(|a| a[0] == a[1] && a[1] == a[2]) {
                    Albedo::Gray(rgb.into_iter().next().expect("three columns"))
                } else {
                    Albedo::Rgb(rgb)
                }
            }
        };
        let glows = emission.iter().flatten().any(|&e| e != 0.0);
        let rows = table.graded.as_ref().map(|graded| {
            assert!(width >= 2 && extinction.len() % width == 0 && extinction.len() > width, "whole rows, two or more");
            Rows { width, scale: graded.scale(), last: (extinction.len() / width - 1) as f32 }
        });
        let means = (table.preintegrated && rows.is_none()).then(|| {
            let scattered = |c: usize| Summed::new(extinction.iter().zip(albedo).map(move |(s, a)| s * a[c]));
            Means {
                extinction: Summed::new(extinction.iter().copied()),
                scattering: std::array::from_fn(scattered),
                emission: glows.then(|| std::array::from_fn(|c| Summed::new(emission.iter().map(|e| e[c])))),
            }
        });
        let last = (width.max(2) - 1) as f32;
        Optics {
            lo: table.lo,
            scale: table.scale() * last,
            last,
            extinction: Column::new(extinction.iter().copied()),
            chromatic: (table.chromatic != [1.0; 3]).then_some(table.chromatic),
            albedo: albedos,
            emission: glows.then(|| columns(emission)),
            rows,
            means,
        }
    }
}

/// The planes that are held of a grid.
fn slab(size: [usize; 3], planes: Option<&Range<usize>>) -> Slab {
    Slab { size, planes: planes.cloned().unwrap_or(0..size[2]) }
}

/// Data and what they look like, in index space: what samples of any kind read.
pub(in crate::device::cpu) struct Matter<'a> {
    /// Index length of a world length, along each axis.
    pub per_length: Vec3,
    /// Upper corner of the box in index space; the lower one is −½.
    pub top: [f32; 3],
    pub lattice: Lattice,
    pub data: Volume<'a>,
    /// Gradient magnitudes, where the table is two-dimensional.
    pub gradient: Option<Volume<'a>>,
    pub optics: Optics,
    pub empty: Option<Arc<Distances>>,
    /// Index of the last cell of the whole grid along each axis.
    pub last_cell: [f32; 3],
    /// Mean spacing.
    pub spacing: f32,
    /// The longest array that a packet addresses.
    pub reach: usize,
}

impl<'a> Matter<'a> {
    /// Of values of which `held` are there; the largest visibility in each brick tells what may be skipped.
    pub fn new(
        grid: &Grid,
        held: &Slab,
        (field, gradient): (&'a [f32], Option<&'a [f32]>),
        table: &Table,
        (bricks, majorant): (&BrickLayout, &[f32]),
    ) -> Self {
        Matter {
            per_length: DVec3::from(grid.spacing).recip().as_vec3(),
            top: grid.size.map(|n| n as f32 - 0.5),
            lattice: Lattice::new(held, grid.size),
            data: Volume::new(field, held),
            gradient: table.graded.is_some().then(|| Volume::new(gradient.expect("gradients of the data"), held)),
            optics: Optics::new(table),
            empty: Distances::new(bricks, majorant).map(Arc::new),
            last_cell: grid.size.map(|n| n.saturating_sub(2) as f32),
            spacing: grid.mean_spacing() as f32,
            reach: doubled(grid.size),
        }
    }
}

/// Values of a volume whose rows have at least two.
fn doubled(size: [usize; 3]) -> usize {
    size[0].max(2) * size[1] * size[2]
}

/// A march, ready for rays.
pub(super) struct Plan<'a> {
    /// Pixels along x and y.
    pub picture: [usize; 2],
    /// Eye in index space.
    pub eye: Vec3,
    pub forward: Vec3,
    /// Half a picture to the right, and upwards.
    pub right: Vec3,
    pub up: Vec3,
    pub step: f32,
    pub matter: Matter<'a>,
    pub groups: Vec<Group<'a>>,
    pub terms: usize,
    /// Cells along z in which samples are taken lie between these two; `None`: everywhere.
    pub window: Option<[f32; 2]>,
    pub clips: &'a [Clip],
    pub phong: Option<Phong>,
}

impl<'a> Plan<'a> {
    /// True where some of the cells from one to another along z are sampled.
    pub fn meets(&self, [lowest, highest]: [f32; 2]) -> bool {
        self.window.is_none_or(|[above, below]| above < highest && lowest < below)
    }

    /// `None` when there is nothing to see: no values, no pixels. Of a part, with the empty space of the whole.
    pub fn new(march: &'a March, part: Option<(&Part, Option<Arc<Distances>>)>, picture: [usize; 2]) -> Option<Self> {
        let grid = march.grid;
        if grid.is_empty() || picture.contains(&0) {
            return None;
        }
        let (spacing, origin) = (DVec3::from(grid.spacing), DVec3::from(grid.origin));
        let (lo, hi) = grid.bounds();
        let camera = march.camera;
        let tan = camera.tan * Vec3::new(picture[0] as f32 / picture[1] as f32, 1.0, 0.0);

        let (part, empty) = part.unzip();
        let data = slab(grid.size, part.map(|p| &p.field));
        let mut groups: Vec<Group> = Vec::new();
        let mut matter = Matter::new(
            grid,
            &data,
            (host(march.field), march.gradient.map(host)),
            march.table,
            (&march.bricks, if part.is_some() { &[] } else { march.majorant }),
        );
        matter.empty = empty.unwrap_or(matter.empty);
        for (n, term) in march.terms.iter().enumerate() {
            let held = slab(term.grid.size, part.map(|p| &p.terms[n]));
            matter.reach = matter.reach.max(doubled(held.size));
            let falloff = match term.weight {
                Weight::Lamp { lamp, .. } => Some(lamp.on(grid, 1)),
                _ => None,
            };
            let entry = Lit { volume: Volume::new(host(term.values), &held), weight: term.weight, falloff };
            match groups.iter_mut().find(|g| g.held == held) {
                Some(group) => group.terms.push(entry),
                None => groups.push(Group {
                    lattice: Lattice::new(&held, grid.size),
                    with_data: held == data,
                    terms: vec![entry],
                    held,
                }),
            }
        }

        Some(Plan {
            picture,
            eye: ((camera.eye.as_dvec3() - origin) / spacing).as_vec3(),
            forward: camera.forward,
            right: camera.right * tan.x,
            up: camera.up * tan.y,
            step: march.step.max((1e-6 * (hi - lo).length()) as f32),
            matter,
            groups,
            terms: march.terms.len(),
            window: part.map(|p| [p.cells.start, p.cells.end].map(|c| c as f32 - 0.5)),
            clips: march.clips,
            phong: march.phong,
        })
    }
}
