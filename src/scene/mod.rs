//! The scene file: what to show, lit how, seen from where. Every key is optional.
//!
//! [`Scene::load`] reads TOML and overrides, and refuses what it does not know; [`Scene::validate`] refuses what cannot be
//! done. Both name the key, the line where there is one, and the values that are allowed.

use serde::{Deserialize, Serialize};

mod allowed;
mod area;
mod clip;
mod insitu;
mod isosurface;
mod load;
mod meshes;
mod noise;
mod pathtrace;
mod regions;
mod slices;
mod solver;
mod validate;

pub(crate) use allowed::nearest;
pub use area::{TextureKind, Units};
pub use clip::{ClipKeys, ClipKind};
pub use insitu::{InSituKeys, Policy};
pub use isosurface::{
    AttenuationBy, AttenuationKey, BeautyKey, Blend, EstimatorKey, IsosurfaceKeys, OcclusionKey, PerSurface,
    PerSurfaceRgb, Quality, SssKey, SurfaceLight, ValueUnits,
};
pub use meshes::MeshKeys;
pub use noise::NoiseKeys;
pub use pathtrace::{Denoise, PathtraceKeys, PhaseKey, SamplingKey, ScatteringKey};
pub use regions::{RegionKeys, Shape};
pub use slices::SlicesKeys;
pub use solver::{
    ConvectionMethod, DiffusionMethod, Falloff, Interpolation, Model, OpacityScale, ScratchKey, SolverKeys,
};

/// A whole scene file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
pub struct Scene {
    /// Which field, and the range of its values.
    pub field: FieldKeys,
    /// Detail finer than the data.
    pub noise: NoiseKeys,
    /// How values become optical properties.
    pub transfer: TransferKeys,
    /// The light sources; none given means a key light, a weaker fill and a dim environment.
    pub lights: Vec<LightKeys>,
    /// Opaque things in the volume.
    pub meshes: Vec<MeshKeys>,
    /// Where the medium is cut away.
    pub clip: Vec<ClipKeys>,
    /// How light is solved.
    pub light: SolverKeys,
    /// The cameras; none given means one that frames the volume.
    pub cameras: Vec<CameraKeys>,
    /// How pictures are made of it.
    pub render: RenderKeys,
    /// What path tracing alone has to know.
    pub pathtrace: PathtraceKeys,
    /// Half-angle slices.
    pub slices: SlicesKeys,
    /// Isosurfaces, for `render.kind = "isosurface"`.
    pub isosurface: IsosurfaceKeys,
    /// How a movie is encoded.
    pub movie: MovieKeys,
    /// How a running simulation is coupled.
    pub insitu: InSituKeys,
}

/// `[field]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
pub struct FieldKeys {
    /// Name of the dataset or field; else the only candidate.
    pub name: Option<String>,
    /// Values that map to 0 and 1 of the transfer function.
    pub range: RangeKey,
    /// Component of a vector field: x, y, z, an index, or magnitude.
    pub component: ComponentKey,
    /// Level of refinement that a mesh is brought to, 0 the coarsest; the finest when absent.
    pub level: Option<usize>,
}

/// `field.range`
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum RangeKey {
    /// `"series"` or `"step"`.
    Over(RangeOver),
    /// `[lo, hi]`
    Fixed([f64; 2]),
}

/// Over what a range of values is taken.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RangeOver {
    /// All steps of the series: colours do not jump.
    Series,
    /// Each step for itself.
    Step,
}

impl Default for RangeKey {
    fn default() -> Self {
        RangeKey::Over(RangeOver::Series)
    }
}

/// `field.component`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum ComponentKey {
    /// Index of the component.
    Index(usize),
    /// `x`, `y`, `z` or `magnitude`.
    Name(String),
}

impl Default for ComponentKey {
    fn default() -> Self {
        ComponentKey::Name("magnitude".into())
    }
}

/// `[transfer]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TransferKeys {
    /// Name of a colour map.
    pub colormap: String,
    /// Colours as `[value, r, g, b]` instead of a named map.
    pub points: Option<Vec<[f32; 4]>>,
    /// Opacity per reference length as `[value, opacity]`.
    pub opacity: Option<Vec<[f32; 2]>>,
    /// Reference length in voxels of the data grid (mean spacing).
    pub reference: f64,
    /// Extinction per world length at value 1, linear in the value, instead of `opacity`.
    pub extinction: Option<f64>,
    /// Factor on extinction per colour channel, each 0 or more and not all 0: what shadows and what lies behind the medium
    /// are tinted by.
    pub chromatic: [f32; 3],
    /// Scattered fraction of the extinction, multiplied by the map's colour.
    pub albedo: NumberOrRgb,
    /// Henyey–Greenstein g, −1 < g < 1.
    pub anisotropy: f32,
    /// Emitted radiance per reference length as `[value, radiance]`, in the map's colour.
    pub emission: Vec<[f32; 2]>,
    /// Diffuse reflection of surfaces as `[value, factor]`, a factor on the albedo (path tracing).
    pub diffuse: Vec<[f32; 2]>,
    /// Specular reflection of surfaces as `[value, factor]`, a factor on Fresnel's term (path tracing).
    pub specular: Vec<[f32; 2]>,
    /// Roughness of surfaces as `[value, roughness]`, 0 smooth to 1 matte (path tracing).
    pub roughness: Vec<[f32; 2]>,
    /// Index of refraction of surfaces as `[value, index]` (path tracing).
    pub ior: Vec<[f32; 2]>,
    /// Parts of the plane of value and gradient magnitude that are seen; beside them `opacity` and `extinction` count only where
    /// they are given.
    pub regions: Vec<RegionKeys>,
    /// Image (OpenEXR, PNG) of that plane, seen likewise: value from left to right, gradient from bottom to top, coverage as
    /// opacity per reference length.
    pub painting: Option<std::path::PathBuf>,
    /// Gradient magnitude that is 1 in that plane, in ranges of the values per voxel (mean spacing).
    pub steepest: f64,
    /// Samples take the mean over all values between those at the ends of their interval.
    pub preintegrated: bool,
}

impl TransferKeys {
    /// True when gradient magnitudes matter.
    pub fn two_dimensional(&self) -> bool {
        !self.regions.is_empty() || self.painting.is_some()
    }
}

impl Default for TransferKeys {
    fn default() -> Self {
        TransferKeys {
            colormap: "inferno".into(),
            points: None,
            opacity: None,
            reference: 1.0,
            extinction: None,
            chromatic: [1.0; 3],
            albedo: NumberOrRgb::Number(0.8),
            anisotropy: 0.0,
            emission: vec![],
            regions: vec![],
            painting: None,
            steepest: 0.25,
            preintegrated: false,
            diffuse: vec![[0.0, 1.0]],
            specular: vec![[0.0, 1.0]],
            roughness: vec![[0.0, 0.4]],
            ior: vec![[0.0, 1.5]],
        }
    }
}

/// One number for all channels, or three.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum NumberOrRgb {
    /// The same in every channel.
    Number(f32),
    /// Red, green, blue.
    Rgb([f32; 3]),
}

impl NumberOrRgb {
    /// As three channels.
    pub fn rgb(self) -> [f32; 3] {
        match self {
            NumberOrRgb::Number(v) => [v; 3],
            NumberOrRgb::Rgb(c) => c,
        }
    }
}

/// `[[lights]]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LightKeys {
    /// distant, point, cone or environment; with a surface rectangle, disk, ring, box or sphere.
    pub kind: LightKind,
    /// The way the light travels, world axes; the way that the shining side of a flat light faces.
    pub direction: [f64; 3],
    /// Where a point or cone light is, and the middle of an area light.
    pub position: [f64; 3],
    /// Radius of the ball that a point or cone light is, world length; 0 has sharp shadows. Radius of a disk, ring or sphere.
    pub radius: f64,
    /// Radius of a ring's hole.
    pub inner_radius: f64,
    /// Edges of a rectangle, across and along `up`, or of a box, the last one along `up`; world lengths.
    pub size: Vec<f64>,
    /// The way that a flat light's height goes, as far as its direction lets it (+y where the two are parallel); that of a box's
    /// last edge, while its first stays as near to +x as it can.
    pub up: [f64; 3],
    /// A flat light shines on both sides.
    pub two_sided: bool,
    /// The camera sees the light itself (path tracing).
    pub visible: bool,
    /// What colour times intensity of an area light is: radiance, power, exitance (flux) or intensity.
    pub units: Units,
    /// Of an area light: uniform, checker, gradient or bitmap.
    pub texture: TextureKind,
    /// The other colour of a checker or gradient texture.
    pub second_color: [f32; 3],
    /// Fields of a checker texture across and upwards.
    pub tiles: [usize; 2],
    /// Half angle of a cone light in degrees, above 0, at most 90.
    pub angle: f64,
    /// Degrees inside the half angle over which a cone light fades.
    pub edge: f64,
    /// Colour per channel.
    pub color: [f32; 3],
    /// Distant: irradiance on a facing plane; point, cone: power/4π; environment: radiance; area lights: see `units`.
    pub intensity: f32,
    /// Angular radius of a distant light in degrees; 0 has sharp shadows.
    pub softness: f64,
    /// Points that stand for a light with softness, radius or surface: 1, 7 or 19. Each takes a sweep.
    pub samples: usize,
    /// Equirectangular image of an environment light (OpenEXR, Radiance HDR, PNG), times colour and intensity; see
    /// [`Panorama`](crate::lights::Panorama). Of an area light with a bitmap texture, its image. A relative path in a scene file
    /// starts at the file's folder.
    pub image: Option<std::path::PathBuf>,
    /// Colours of an environment straight down, at the horizon and straight up, times colour and intensity; linear in the
    /// height of a direction between them.
    pub gradient: Option<[[f32; 3]; 3]>,
}

impl Default for LightKeys {
    fn default() -> Self {
        LightKeys {
            kind: LightKind::Distant,
            direction: [-0.5, -1.0, -0.4],
            position: [0.0; 3],
            radius: 0.0,
            inner_radius: 0.0,
            size: vec![],
            up: [0.0, 0.0, 1.0],
            two_sided: false,
            visible: false,
            units: Units::Radiance,
            texture: TextureKind::Uniform,
            second_color: [0.0; 3],
            tiles: [8, 8],
            angle: 30.0,
            edge: 0.0,
            color: [1.0; 3],
            intensity: 3.0,
            softness: 0.0,
            samples: 7,
            image: None,
            gradient: None,
        }
    }
}

/// `lights.kind`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LightKind {
    /// Parallel rays.
    Distant,
    /// From one point in all directions.
    Point,
    /// From one point within a cone.
    Cone,
    /// From all directions.
    Environment,
    /// A flat rectangle.
    Rectangle,
    /// A flat disk.
    Disk,
    /// A disk with a hole.
    Ring,
    /// The outside of a box.
    Box,
    /// The outside of a ball.
    Sphere,
}

/// `[[cameras]]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CameraKeys {
    /// Name, for `{camera}` in output paths.
    pub name: String,
    /// Degrees about the up axis, anticlockwise seen from above; with `up` = +z, 0 looks along +y and 90 along −x.
    pub azimuth: f64,
    /// Degrees above the horizon.
    pub elevation: f64,
    /// Magnification of the framed volume.
    pub zoom: f64,
    /// Vertical field of view in degrees.
    pub fov: f64,
    /// Eye; the volume is framed when absent.
    pub position: Option<[f64; 3]>,
    /// Looked-at point; the volume's centre when absent.
    pub target: Option<[f64; 3]>,
    /// Up axis.
    pub up: [f64; 3],
    /// Degrees of azimuth added per step.
    pub orbit: f64,
    /// Diameter of the aperture, world length (path tracing).
    pub aperture: f64,
    /// Distance in focus along the view, world length (path tracing); where the middle ray meets the medium first when absent.
    pub focus: Option<f64>,
    /// Blades of the aperture, which make it a polygon; 0 for a circle (path tracing).
    pub blades: u32,
}

impl Default for CameraKeys {
    fn default() -> Self {
        CameraKeys {
            name: "main".into(),
            azimuth: 30.0,
            elevation: 20.0,
            zoom: 1.0,
            fov: 35.0,
            position: None,
            target: None,
            up: [0.0, 0.0, 1.0],
            orbit: 0.0,
            aperture: 0.0,
            focus: None,
            blades: 0,
        }
    }
}

/// `[render]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RenderKeys {
    /// raycast, pathtrace, isosurface or slices.
    pub kind: RenderKind,
    /// Width and height in pixels.
    pub size: [usize; 2],
    /// Sampling distance in data voxels.
    pub step: f32,
    /// Samples per pixel at most (path tracing).
    pub samples: usize,
    /// Mean standard error of a pixel over the mean radiance at which path tracing stops.
    pub target_error: Option<f64>,
    /// Milliseconds that path tracing may sample for each frame; its pictures then depend on the machine.
    pub budget_ms: Option<f64>,
    /// none or phong.
    pub shading: Shading,
    /// Phong: light that reaches every surface.
    pub ambient: f32,
    /// Phong: light by Lambert's cosine.
    pub diffuse: f32,
    /// Phong: strength of the highlight.
    pub specular: f32,
    /// Phong: exponent of the highlight.
    pub shininess: f32,
    /// Colour behind the volume, scene-linear.
    pub background: [f32; 3],
    /// Factor on radiance before the tone map; its divisor in `tonemap = "exposure"`.
    pub exposure: f32,
    /// srgb, exposure or none.
    pub tonemap: Tonemap,
    /// Drawn on PNG and MP4: time, colorbar, axes.
    pub overlay: Vec<Overlay>,
    /// Show means over blocks of so many voxels along each axis, marked as a preview; 1 shows the data.
    pub preview: usize,
}

impl Default for RenderKeys {
    fn default() -> Self {
        RenderKeys {
            kind: RenderKind::Raycast,
            size: [1280, 720],
            step: 0.5,
            samples: 64,
            target_error: None,
            budget_ms: None,
            shading: Shading::None,
            ambient: 0.3,
            diffuse: 0.7,
            specular: 0.2,
            shininess: 20.0,
            background: [0.0; 3],
            exposure: 1.0,
            tonemap: Tonemap::Srgb,
            overlay: vec![],
            preview: 1,
        }
    }
}

/// `render.kind`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RenderKind {
    /// Ray casting lit by the light volume.
    Raycast,
    /// Stochastic path tracing.
    Pathtrace,
    /// Isosurface layers.
    Isosurface,
    /// Half-angle slices.
    Slices,
}

/// `render.shading`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Shading {
    /// The phase function alone.
    None,
    /// Phong by gradient, gated by its magnitude.
    Phong,
}

/// `render.tonemap`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Tonemap {
    /// Clipped at 1, sRGB transfer curve.
    Srgb,
    /// 1 − e^(−L/exposure), then the sRGB curve.
    Exposure,
    /// Clipped at 1, linear.
    None,
}

/// `render.overlay`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Overlay {
    /// Step and physical time.
    Time,
    /// The transfer function's colours with its range.
    Colorbar,
    /// A triad of the world axes.
    Axes,
}

/// `[movie]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MovieKeys {
    /// Frames per second.
    pub fps: f64,
    /// Seconds of movie for a unit of physical time; absent, each step gets one frame. Frames stay evenly spaced: a step is
    /// repeated until the next one is due, and left out when that is due within the same frame.
    pub seconds_per_time_unit: Option<f64>,
    /// Constant quality, 0 (best) to 51: the quantiser of H.264, in which 6 more halves the file; below 12 is as 12.
    pub quality: u8,
}

impl Default for MovieKeys {
    fn default() -> Self {
        MovieKeys { fps: 24.0, seconds_per_time_unit: None, quality: 23 }
    }
}
