//! How light is solved: the table `[light]`.

use serde::{Deserialize, Serialize};

/// `[light]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SolverKeys {
    /// physical or paper.
    pub model: Model,
    /// Light voxels per data voxel along an axis (a fraction), or a size (an integer above 1), for scattered light.
    pub resolution: f64,
    /// The same for direct light in the physical model.
    pub direct_resolution: f64,
    /// Foot of the characteristic.
    pub interpolation: Interpolation,
    /// Multiple scattering.
    pub scattering: bool,
    /// Ordinates: 8, 32 or 128.
    pub directions: usize,
    /// Diffusion per channel, paper model.
    pub sigma_s: [f32; 3],
    /// calibrated or literal, paper model.
    pub opacity_scale: OpacityScale,
    /// How convection is solved, paper model.
    pub convection: ConvectionMethod,
    /// Iterations per layer and step at most (of the whole volume in `convection = "volume"`), paper model.
    pub iterations: usize,
    /// Passes of scattered light at most for each step and colour channel, at least 2, physical model; what is left goes on
    /// in the next step.
    pub passes: Option<usize>,
    /// Time for the light of a step in milliseconds: iterations go on until the tolerance holds or the time is used up, and in
    /// the next step from there. In the physical model it ends scattered light alone, of which two passes are always made.
    pub budget_ms: Option<f64>,
    /// How diffusion is solved, paper model.
    pub diffusion: DiffusionMethod,
    /// How point and cone lights fall off, paper model.
    pub falloff: Falloff,
    /// Width (standard deviation) of that Gaussian, world length; the distance from the light to the farthest corner of the
    /// box when absent.
    pub width: Option<f64>,
    /// Largest certified error of the light, relative to the brightest light.
    pub tolerance: f32,
    /// Start each solve from the previous step's light.
    pub warm: bool,
    /// Numbers that direct light is kept in where it does not fit into memory.
    pub scratch: ScratchKey,
}

impl Default for SolverKeys {
    fn default() -> Self {
        SolverKeys {
            model: Model::Physical,
            resolution: 0.5,
            direct_resolution: 1.0,
            interpolation: Interpolation::Bilinear,
            scattering: true,
            directions: 32,
            sigma_s: [1.0; 3],
            opacity_scale: OpacityScale::Calibrated,
            convection: ConvectionMethod::Layers,
            iterations: 5,
            passes: None,
            budget_ms: None,
            diffusion: DiffusionMethod::Exact,
            falloff: Falloff::Gaussian,
            width: None,
            tolerance: 1e-3,
            warm: true,
            scratch: ScratchKey::F32,
        }
    }
}

impl SolverKeys {
    /// Size of the light grid that a resolution key asks for, over data of size `data`, along x, y, z.
    ///
    /// A value up to 1 is light voxels per data voxel; an integer from 2 on is the size along the longest axis. The data's
    /// aspect is kept, rounded to whole voxels, and every axis has at least one.
    ///
    /// ```
    /// use gloaming::scene::SolverKeys;
    /// assert_eq!(SolverKeys::grid_size(0.5, [128, 64, 3]), [64, 32, 2]);
    /// assert_eq!(SolverKeys::grid_size(96.0, [128, 64, 3]), [96, 48, 2]);
    /// ```
    pub fn grid_size(value: f64, data: [usize; 3]) -> [usize; 3] {
        let longest = data.into_iter().max().unwrap_or(1).max(1) as f64;
        let factor = if value > 1.0 { value / longest } else { value };
        data.map(|n| (n as f64 * factor).round().max(1.0) as usize)
    }
}

/// `light.model`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Model {
    /// Short characteristics and discrete ordinates.
    Physical,
    /// Convection and diffusion as Zhang & Ma published them.
    Paper,
}

/// `light.interpolation`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Interpolation {
    /// The certified one: errors never grow.
    Bilinear,
    /// Catmull–Rom clamped to the four nearest values: sharper shadows.
    Cubic,
}

/// `light.scratch`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ScratchKey {
    /// As it is computed.
    F32,
    /// Half the room on the disk; off by at most 2⁻¹¹ of each value, or 2⁻²⁵ where there is next to no light.
    F16,
}

/// `light.opacity_scale`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum OpacityScale {
    /// Optical depth per voxel as the medium has it.
    Calibrated,
    /// Opacity as the paper has it: about twice the extinction.
    Literal,
}

/// `light.convection`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ConvectionMethod {
    /// Layer by layer along a distant light, `iterations` each from the layer upstream or from the step before, as
    /// published. Point and cone lights are solved as by `ordered`.
    Layers,
    /// All voxels at once, `iterations` a step: the reference.
    Volume,
    /// The same light in one pass, each voxel after those that light it: exact.
    Ordered,
}

/// `light.diffusion`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DiffusionMethod {
    /// The solution at t = 1: no iterations, nothing left to converge, and faster than any iteration.
    Exact,
    /// One implicit step, red-black Gauss–Seidel: as published.
    GaussSeidel,
    /// The same step by multigrid.
    Multigrid,
}

/// `light.falloff`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Falloff {
    /// A Gaussian of the distance where light enters the volume, constant along rays from there: as published.
    Gaussian,
    /// 1/r² from the light.
    Physical,
}
