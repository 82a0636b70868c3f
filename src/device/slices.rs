//! Half-angle slicing: what slices are cut from, where they lie, and who looks at them.
//!
//! Planes perpendicular to an axis half-way between the view and the light are seen in order by both (GPU Gems 39, section
//! 39.5.1). They cut the volume into slabs; a ray has in each slab one interval, sampled in its middle, of the exact length
//! that it has there inside the box. Front to back for the light always; for the eye too where the axis points away from it
//! (*under*, (6)), else back to front (*over*, (5)):
//!
//! ```text
//! light  I_mid = I·e^(−k a σ d/2),  I ← I·e^(−k a σ d)                         (8), with exact exponentials for (3)
//! under  C ← C + T·c,   T ← T·e^(−k σ d_v)                                     (6)
//! over   C ← c + C·e^(−k σ d_v),   T likewise                                  (5)
//! c = (1 − e^(−k σ d_v))·ω·(Σ unshadowed + weight·I_mid) + emission
//! ```
//!
//! σ is the extinction of the sample, k the factor of a colour channel, a the factor of translucency. Something opaque ends rays of
//! the eye where it is ([`Ray::end`](super::Ray)), and light in the texels whose rays meet it.

use glam::{DMat3, DVec3, Vec3};

use super::{Buffer, Clip, Phong, Weight};
use crate::camera::Camera;
use crate::grid::{BrickLayout, Grid};
use crate::transfer::Table;

/// One pass over the slices of a volume.
#[derive(Clone, Copy)]
pub struct Slices<'a> {
    /// The data grid.
    pub grid: &'a Grid,
    /// Data values; below [`crate::field::HOLE`] transparent.
    pub field: &'a Buffer,
    /// Gradient magnitudes of the data ([`super::Device::gradient`]), where the table is two-dimensional.
    pub gradient: Option<&'a Buffer>,
    /// Values to optics.
    pub table: &'a Table,
    /// Bricks of the data grid for empty-space skipping.
    pub bricks: BrickLayout,
    /// As of [`super::March`].
    pub majorant: &'a [f32],
    /// Where the planes lie.
    pub slicing: Slicing,
    /// Whether the eye meets the slabs in the same order as the light.
    pub under: bool,
    /// The eye.
    pub eye: Projection,
    /// Pixels along x and y.
    pub picture: [usize; 2],
    /// The pixels that are made, `[first, end]` along x and y; multiples of 4, or the picture's edge.
    pub window: [[usize; 2]; 2],
    /// Light that arrives everywhere undimmed.
    pub unshadowed: &'a [Weight],
    /// The light that the medium casts shadows from, if any.
    pub beam: Option<Beam<'a>>,
    /// Whether the medium's own light is part of this pass.
    pub glows: bool,
    /// Phong shading, if any.
    pub phong: Option<Phong>,
    /// Where the medium is kept.
    pub clips: &'a [Clip],
}

/// Planes at equal distances.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slicing {
    /// Unit normal, the way the light travels, or the view where none does.
    pub axis: DVec3,
    /// Where the first plane is along the axis, world length.
    pub first: f64,
    /// World length from plane to plane.
    pub spacing: f64,
    /// Number of slabs.
    pub count: usize,
}

impl Slicing {
    /// Planes across the box of `grid`, `spacing` apart; never more than a million.
    pub fn new(grid: &Grid, axis: DVec3, spacing: f64) -> Self {
        let ends = corners(grid).map(|c| axis.dot(c));
        let (lo, hi) = ends.into_iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        let spacing = spacing.max(1e-6 * (hi - lo));
        Slicing { axis, first: lo, spacing, count: ((hi - lo) / spacing).ceil().max(1.0) as usize }
    }
}

/// Corners of a grid's box.
pub fn corners(grid: &Grid) -> [DVec3; 8] {
    let (lo, hi) = grid.bounds();
    std::array::from_fn(|c| DVec3::from_array(std::array::from_fn(|a| if c >> a & 1 == 1 { hi[a] } else { lo[a] })))
}

/// A picture's rays. That of a point (qx, qy), both −1 to 1 from the upper left to the lower right, is `x(t) = start + t·way`,
/// `way = forward + qx·right + qy·down` from `origin`; parallel rays go along `forward` from `origin + qx·right + qy·down`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projection {
    /// Where rays begin.
    pub origin: DVec3,
    /// To the middle of the picture; need not be unit, nor at right angles to the others.
    pub forward: DVec3,
    /// Half a picture to the right.
    pub right: DVec3,
    /// Half a picture downwards.
    pub down: DVec3,
    /// Parallel rays.
    pub parallel: bool,
}

impl Projection {
    /// What `camera` sees on a picture.
    pub fn of(camera: &Camera, picture: [usize; 2]) -> Self {
        let tan = f64::from(camera.tan);
        Projection {
            origin: camera.eye.into(),
            forward: camera.forward.into(),
            right: tan * picture[0] as f64 / picture[1] as f64 * DVec3::from(camera.right),
            down: -tan * DVec3::from(camera.up),
            parallel: false,
        }
    }

    /// Where the ray of a point of the picture begins.
    pub fn start(&self, q: [f64; 2]) -> DVec3 {
        self.origin + if self.parallel { q[0] * self.right + q[1] * self.down } else { DVec3::ZERO }
    }

    /// Unit direction of the ray of a point of the picture.
    pub fn way(&self, q: [f64; 2]) -> DVec3 {
        let aside = if self.parallel { DVec3::ZERO } else { q[0] * self.right + q[1] * self.down };
        (self.forward + aside).normalize()
    }

    /// (qx·c, qy·c, c) of a world position, c its depth in lengths of `forward`; of parallel rays (qx, qy, c).
    pub fn inverse(&self) -> DMat3 {
        DMat3::from_cols(self.right, self.down, self.forward).inverse()
    }

    /// Where a world position is on the picture; `None` behind the origin of rays that part from it.
    pub fn project(&self, x: DVec3) -> Option<[f64; 2]> {
        let p = self.inverse() * (x - self.origin);
        match self.parallel {
            true => Some([p.x, p.y]),
            false => (p.z > 1e-9).then(|| [p.x / p.z, p.y / p.z]),
        }
    }

    /// The rectangle `[least, largest]` (qx, qy) in which a slab of a grid's box lies, cut by planes at these distances along an
    /// axis: that of its proxy polygons. Everything where part of it is behind the origin.
    pub(crate) fn extent(&self, grid: &Grid, axis: DVec3, [from, to]: [f64; 2]) -> [[f64; 2]; 2] {
        let corners = corners(grid);
        let at = corners.map(|c| axis.dot(c));
        let mut extent = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
        let mut include = |x: DVec3| match self.project(x) {
            Some(q) => (0..2).for_each(|a| {
                extent[0][a] = extent[0][a].min(q[a]);
                extent[1][a] = extent[1][a].max(q[a]);
            }),
            None => extent = [[f64::NEG_INFINITY; 2], [f64::INFINITY; 2]],
        };
        for c in 0..8 {
            if (from..=to).contains(&at[c]) {
                include(corners[c]);
            }
            for a in 0..3 {
                let other = c | 1 << a;
                for plane in [from, to].into_iter().filter(|p| other != c && (at[c] - p) * (at[other] - p) < 0.0) {
                    include(corners[c].lerp(corners[other], (plane - at[c]) / (at[other] - at[c])));
                }
            }
        }
        extent
    }
}

/// The light buffer of a light, and what it does on its way.
#[derive(Clone, Copy)]
pub struct Beam<'a> {
    /// What one unit of the buffer adds: [`Weight::Phase`] or [`Weight::Lamp`].
    pub weight: Weight,
    /// The light's view.
    pub view: Projection,
    /// Texels along x and y, multiples of [`Beam::ALIGN`].
    pub size: [usize; 2],
    /// Part of the picture, −1 to 1, that this light is for; beyond it other passes are. Infinite where none is.
    pub inner: [f64; 2],
    /// The buffer before the first slice, row by row; 1 when absent.
    pub start: Option<&'a [[f32; 3]]>,
    /// World length from where each texel's ray begins to where it first and last meets something opaque, infinite where it does not:
    /// there no light is left. Empty where nothing is opaque.
    pub opaque: &'a [[f32; 2]],
    /// Factor on the extinction of light per channel (translucency).
    pub attenuation: [f32; 3],
    /// Variance, along each axis across the light, by which a world length of its way blurs it: world length.
    pub blur: f64,
}

impl Beam<'_> {
    /// Texels that rows and columns of a light buffer come in.
    pub const ALIGN: usize = 16;

    /// Half the width within which a part of a picture fades where another pass takes over, −1 to 1 being the picture.
    pub const FADE: f32 = 1e-4;

    /// Factor on extinction of each channel that the buffer holds: one where all are the same.
    pub(crate) fn factors(&self, chromatic: [f32; 3]) -> Vec<f32> {
        let each: [f32; 3] = std::array::from_fn(|c| self.attenuation[c] * chromatic[c]);
        let even = |c: [f32; 3]| c[0] == c[1] && c[1] == c[2];
        let alike = even(each) && self.start.is_none_or(|s| s.iter().all(|c| even(*c)));
        if alike { vec![each[0]] } else { each.to_vec() }
    }
}

/// Slabs that are worked on before the other side has its turn: how many layers of the light buffer are kept.
pub(crate) const BATCH: usize = 8;

/// A [`Projection`] as kernels take it: rays in index space, distances along them in world length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Casting {
    /// Index space.
    pub start: Vec3,
    pub start_right: Vec3,
    pub start_down: Vec3,
    /// World; to be made unit.
    pub way: Vec3,
    pub way_right: Vec3,
    pub way_down: Vec3,
    /// Unit.
    pub axis: Vec3,
    /// From where a ray starts to plane 0, along the axis.
    pub base: [f32; 3],
    /// Plane to plane.
    pub spacing: f32,
}

impl Casting {
    pub fn new(view: &Projection, slicing: &Slicing, grid: &Grid) -> Self {
        let (spacing, origin) = (DVec3::from(grid.spacing), DVec3::from(grid.origin));
        let aside = if view.parallel { [view.right, view.down] } else { [DVec3::ZERO; 2] };
        let apart = if view.parallel { [DVec3::ZERO; 2] } else { [view.right, view.down] };
        let along = |v: DVec3| slicing.axis.dot(v);
        Casting {
            start: ((view.origin - origin) / spacing).as_vec3(),
            start_right: (aside[0] / spacing).as_vec3(),
            start_down: (aside[1] / spacing).as_vec3(),
            way: view.forward.as_vec3(),
            way_right: apart[0].as_vec3(),
            way_down: apart[1].as_vec3(),
            axis: slicing.axis.as_vec3(),
            base: [slicing.first - along(view.origin), -along(aside[0]), -along(aside[1])].map(|b| b as f32),
            spacing: slicing.spacing as f32,
        }
    }
}

/// Where the eye's samples find their light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Lookup {
    /// Rows that take an index position to (qx·c, qy·c, c).
    pub rows: [Vec3; 3],
    pub shift: Vec3,
    pub parallel: bool,
    pub inner: [f32; 2],
    /// World sizes of a texel at depth 1 (at any, where rays are parallel).
    pub texel: [f32; 2],
}

impl Lookup {
    pub fn new(beam: &Beam, grid: &Grid) -> Self {
        let inverse = beam.view.inverse();
        let shift = inverse * (DVec3::from(grid.origin) - beam.view.origin);
        let rows = inverse.transpose();
        let texel = |v: DVec3, n: usize| (2.0 * v.length() / n as f64) as f32;
        Lookup {
            rows: [rows.x_axis, rows.y_axis, rows.z_axis].map(|r| (r * DVec3::from(grid.spacing)).as_vec3()),
            shift: shift.as_vec3(),
            parallel: beam.view.parallel,
            inner: beam.inner.map(|v| v.min(f64::from(f32::MAX)) as f32),
            texel: [texel(beam.view.right, beam.size[0]), texel(beam.view.down, beam.size[1])],
        }
    }
}

/// The part of a picture, `[first, end]` along x and y, that shows a rectangle of (qx, qy), and a pixel around it.
pub(crate) fn pixels(extent: [[f64; 2]; 2], picture: [usize; 2]) -> [[usize; 2]; 2] {
    std::array::from_fn(|a| {
        let n = picture[a] as f64;
        let at = |q: f64| (0.5 * (q + 1.0) * n).clamp(0.0, n);
        [(at(extent[0][a]).floor() - 1.0).max(0.0) as usize, (at(extent[1][a]).ceil() as usize + 1).min(picture[a])]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn projections_find_their_rays_again() {
        let perspective = Projection {
            origin: DVec3::new(1.0, 2.0, 3.0),
            forward: DVec3::new(0.2, 0.9, 0.1),
            right: DVec3::new(0.5, 0.0, 0.1),
            down: DVec3::new(0.0, 0.1, -0.4),
            parallel: false,
        };
        for view in [perspective, Projection { parallel: true, ..perspective }] {
            for q in [[0.0, 0.0], [-0.7, 0.4], [1.0, -1.0]] {
                let found = view.project(view.start(q) + 3.7 * view.way(q)).unwrap();
                assert!((0..2).all(|a| (found[a] - q[a]).abs() < 1e-12), "{found:?} {q:?}");
            }
        }
        assert!(perspective.project(perspective.origin - perspective.forward).is_none());
    }

    /// Points of the box between two planes lie in the slab's rectangle, which is no larger than the box's.
    #[test]
    fn a_slab_lies_in_its_proxy_rectangle() {
        let grid = Grid { size: [9, 6, 7], spacing: [0.5, 1.0, 0.3], origin: [-2.0, 1.0, 0.0] };
        let camera = Camera::look_at(Vec3::new(3.0, -9.0, 4.0), Vec3::new(0.0, 3.5, 1.0), Vec3::Z, 40.0);
        let view = Projection::of(&camera, [40, 30]);
        let slicing = Slicing::new(&grid, DVec3::new(0.3, 0.8, -0.4).normalize(), 0.7);
        let (lo, hi) = grid.bounds();
        for i in 0..slicing.count {
            let planes = [i, i + 1].map(|p| slicing.first + p as f64 * slicing.spacing);
            let [least, largest] = view.extent(&grid, slicing.axis, planes);
            let mut met = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
            for n in 0..24usize.pow(3) {
                let at = DVec3::new((n % 24) as f64, (n / 24 % 24) as f64, (n / 576) as f64) / 23.0;
                let x = lo + at * (hi - lo);
                if (planes[0]..=planes[1]).contains(&slicing.axis.dot(x)) {
                    let q = view.project(x).unwrap();
                    (0..2).for_each(|a| {
                        assert!(least[a] - 1e-9 <= q[a] && q[a] <= largest[a] + 1e-9);
                        met[0][a] = met[0][a].min(q[a]);
                        met[1][a] = met[1][a].max(q[a]);
                    });
                }
            }
            if (1..slicing.count - 1).contains(&i) {
                assert!((0..2).all(|a| largest[a] - least[a] < met[1][a] - met[0][a] + 0.15), "slab {i} is tight");
            }
        }
    }
}
