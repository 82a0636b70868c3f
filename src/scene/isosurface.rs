//! `[isosurface]`: what `render.kind = "isosurface"` shows.

use serde::{Deserialize, Serialize};

use super::NumberOrRgb;
use super::validate::require;
use crate::error::{Error, Result};

/// `[isosurface]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct IsosurfaceKeys {
    /// The isovalues, one to eight, in `units`.
    pub values: Vec<f64>,
    /// Of isovalues: part of the field's range, as in `transfer.opacity`, or the data's own.
    pub units: ValueUnits,
    /// Scene-linear colour; a list has one for each value. Absent, the colour map's at the value.
    pub color: Option<PerSurfaceRgb>,
    /// Weight of the surface in the picture, 0 to 1.
    pub opacity: PerSurface,
    /// k_d: part of the light that is reflected diffusely, times colour.
    pub diffuse: PerSurface,
    /// k_s: part that is reflected in a lobe about the mirror direction.
    pub specular: PerSurface,
    /// Exponent s of that lobe.
    pub exponent: PerSurface,
    /// Growth of s with the steepness of the field: per field range a voxel.
    pub exponent_gradient: PerSurface,
    /// k_t: part of the light that is transmitted in a lobe, where there is subsurface scattering.
    pub transmission: PerSurface,
    /// Exponent q of that lobe.
    pub spread: PerSurface,
    /// Index of refraction, of Fresnel's weight and of the transmitted lobe's direction.
    pub ior: PerSurface,
    /// Where surfaces take their light from. Absent: with `[[lights]]` both, or the volume in the paper's model; without, a sky.
    pub light: Option<SurfaceLight>,
    /// Light from all around instead of the environment lights: colours from straight below to straight above, even in elevation.
    pub sky: Option<Vec<[f32; 3]>>,
    /// How the environment is looked up.
    pub beauty: BeautyKey,
    /// How directions are drawn.
    pub estimator: EstimatorKey,
    /// How many rays.
    pub quality: Quality,
    /// Rays along each edge of a pixel that find surfaces; 1 in preview and 2 in final quality when absent. Lobes share theirs.
    pub antialias: Option<usize>,
    /// Ambient occlusion.
    pub occlusion: OcclusionKey,
    /// Length of its rays in voxels.
    pub occlusion_radius: f64,
    /// Subsurface scattering.
    pub sss: SssKey,
    /// What the inside leaves of light per voxel of its way, or by the transfer function.
    pub attenuation: AttenuationKey,
    /// The transmitted lobe bends by Snell's law.
    pub refraction: bool,
    /// Weight of a surface over what is beneath it.
    pub blend: Blend,
    /// Transparent surfaces along a ray, at most.
    pub layers: usize,
}

impl Default for IsosurfaceKeys {
    fn default() -> Self {
        IsosurfaceKeys {
            values: vec![0.5],
            units: ValueUnits::Range,
            color: None,
            opacity: PerSurface::Same(1.0),
            diffuse: PerSurface::Same(0.7),
            specular: PerSurface::Same(0.04),
            exponent: PerSurface::Same(30.0),
            exponent_gradient: PerSurface::Same(0.0),
            transmission: PerSurface::Same(0.2),
            spread: PerSurface::Same(10.0),
            ior: PerSurface::Same(1.5),
            light: None,
            sky: None,
            beauty: BeautyKey::Sampled,
            estimator: EstimatorKey::Normalised,
            quality: Quality::Final,
            antialias: None,
            occlusion: OcclusionKey::Normal,
            occlusion_radius: 12.0,
            sss: SssKey::None,
            attenuation: AttenuationKey::PerVoxel(NumberOrRgb::Number(0.99)),
            refraction: false,
            blend: Blend::Opacity,
            layers: 4,
        }
    }
}

impl IsosurfaceKeys {
    /// Refuses what cannot be done: see [`Scene::validate`](super::Scene::validate).
    pub(super) fn validate(&self) -> Result<()> {
        let keys = self;
        let count = keys.values.len();
        let known = |v: &f64| v.is_finite() && (keys.units == ValueUnits::Data || (0.0..=1.0).contains(v));
        let different = (1..count).all(|i| !keys.values[..i].contains(&keys.values[i]));
        let values = (1..=8).contains(&count) && keys.values.iter().all(known) && different;
        require(values, "isosurface.values", &keys.values)?;
        let numbers: [(&str, &PerSurface, f32, f32); 8] = [
            ("opacity", &keys.opacity, 0.0, 1.0),
            ("diffuse", &keys.diffuse, 0.0, 1.0),
            ("specular", &keys.specular, 0.0, 1.0),
            ("exponent", &keys.exponent, 0.0, 1e4),
            ("exponent_gradient", &keys.exponent_gradient, 0.0, f32::MAX),
            ("transmission", &keys.transmission, 0.0, 1.0),
            ("spread", &keys.spread, 0.0, 1e4),
            ("ior", &keys.ior, 1.0, 4.0),
        ];
        let one_each = |key: &str, written: usize| match written == count {
            true => Ok(()),
            false => {
                Err(Error::scene(key, format!("{written} for {count} isovalues: give one for each, or one for all")))
            }
        };
        for (name, numbers, least, most) in numbers {
            let key = format!("isosurface.{name}");
            require(numbers.all().iter().all(|v| (least..=most).contains(v)), &key, numbers.all())?;
            if let PerSurface::Each(each) = numbers {
                one_each(&key, each.len())?;
            }
        }
        if let Some(color) = &keys.color {
            require(color.all().iter().flatten().all(|v| (0.0..=1.0).contains(v)), "isosurface.color", color.all())?;
            if let PerSurfaceRgb::Each(each) = color {
                one_each("isosurface.color", each.len())?;
            }
        }
        for (i, value) in keys.values.iter().enumerate() {
            let transmission = if keys.sss == SssKey::None { 0.0 } else { keys.transmission.of(i).unwrap_or(0.0) };
            let [diffuse, specular] = [&keys.diffuse, &keys.specular].map(|k| k.of(i).unwrap_or(0.0));
            // A part in ten thousand forgives rounding.
            if diffuse + specular + transmission > 1.0001 {
                return Err(Error::scene(
                    "isosurface.diffuse",
                    format!(
                        "the surface at {value} gives back more light than it gets: diffuse {diffuse} + specular {specular} + \
                         transmission {transmission} is above 1"
                    ),
                ));
            }
        }
        if let Some(sky) = &keys.sky {
            require(sky.len() >= 2 && sky.iter().flatten().all(|v| *v >= 0.0 && v.is_finite()), "isosurface.sky", sky)?;
        }
        if keys.beauty == BeautyKey::Prefiltered && keys.exponent_gradient.all().iter().any(|v| *v > 0.0) {
            return Err(Error::Unsupported(
                "isosurface.beauty = \"prefiltered\" with isosurface.exponent_gradient: a map is filtered for one exponent\n  \
                 try: isosurface.beauty = \"sampled\""
                    .into(),
            ));
        }
        require(keys.antialias.is_none_or(|n| (1..=4).contains(&n)), "isosurface.antialias", keys.antialias)?;
        let radius = keys.occlusion_radius;
        require(radius > 0.0 && radius.is_finite(), "isosurface.occlusion_radius", radius)?;
        if let AttenuationKey::PerVoxel(left) = keys.attenuation {
            require(left.rgb().iter().all(|v| *v > 0.0 && *v <= 1.0), "isosurface.attenuation", left.rgb())?;
        }
        require((1..=8).contains(&keys.layers), "isosurface.layers", keys.layers)
    }
}

/// A number for all surfaces, or one for each.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum PerSurface {
    /// The same for all.
    Same(f32),
    /// In the order of `values`.
    Each(Vec<f32>),
}

impl PerSurface {
    /// That of surface `i`, if there is one.
    pub fn of(&self, i: usize) -> Option<f32> {
        match self {
            PerSurface::Same(v) => Some(*v),
            PerSurface::Each(v) => v.get(i).copied(),
        }
    }

    /// The numbers that are written.
    pub fn all(&self) -> &[f32] {
        match self {
            PerSurface::Same(v) => std::slice::from_ref(v),
            PerSurface::Each(v) => v,
        }
    }
}

/// A colour for all surfaces, or one for each.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum PerSurfaceRgb {
    /// The same for all.
    Same([f32; 3]),
    /// In the order of `values`.
    Each(Vec<[f32; 3]>),
}

impl PerSurfaceRgb {
    /// That of surface `i`, if there is one.
    pub fn of(&self, i: usize) -> Option<[f32; 3]> {
        match self {
            PerSurfaceRgb::Same(c) => Some(*c),
            PerSurfaceRgb::Each(c) => c.get(i).copied(),
        }
    }

    /// The colours that are written.
    pub fn all(&self) -> &[[f32; 3]] {
        match self {
            PerSurfaceRgb::Same(c) => std::slice::from_ref(c),
            PerSurfaceRgb::Each(c) => c,
        }
    }
}

/// `isosurface.units`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ValueUnits {
    /// 0 to 1 of the field's range.
    Range,
    /// The data's own.
    Data,
}

/// `isosurface.light`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SurfaceLight {
    /// The environment, dimmed by occlusion nearby; no light is solved.
    Environment,
    /// The light volume: shadows of the medium, and scattered light.
    Volume,
    /// The environment, and all other lights by the light volume.
    Both,
}

/// `isosurface.beauty`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BeautyKey {
    /// By many directions of each lobe.
    Sampled,
    /// Once, in maps that were filtered by the lobes.
    Prefiltered,
}

/// `isosurface.estimator`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum EstimatorKey {
    /// By the lobes' densities.
    Normalised,
    /// Averages without densities, as published.
    Paper,
}

/// `isosurface.quality`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Quality {
    /// A pixel takes 8 + 16 directions for beauty, 32 rays of 10 steps for occlusion, 4 · 4 for subsurface scattering.
    Preview,
    /// 64 + 128, 128 of 20, 64 · 16.
    Final,
}

/// `isosurface.occlusion`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum OcclusionKey {
    /// Dims the light of the environment.
    Normal,
    /// Also turns the normal of diffuse light to where it is open.
    Bent,
    /// Not at all.
    None,
}

/// `isosurface.sss`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SssKey {
    /// Nothing is seen beneath a surface but what shows through it.
    None,
    /// Light leaves the way it came.
    Fast,
    /// Light is followed on its way out.
    Accurate,
}

/// `isosurface.attenuation`
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum AttenuationKey {
    /// What is left of light after a voxel's length (mean spacing).
    PerVoxel(NumberOrRgb),
    /// As extinction says.
    By(AttenuationBy),
}

/// Words for `isosurface.attenuation`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AttenuationBy {
    /// The transfer function's.
    Transfer,
}

/// `isosurface.blend`
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Blend {
    /// By `opacity`.
    Opacity,
    /// By Fresnel's reflectance: looked at head-on a surface shows what is beneath.
    Fresnel,
}
