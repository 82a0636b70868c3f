//! Isosurfaces in layers (Rezk-Salama 2007): a first-hit pass for each surface along the rays, then passes for beauty, ambient
//! occlusion, light of the volume, and subsurface scattering at the hits; `layers` makes the picture of them.
//!
//! Each pixel sends `antialias`² rays, among which the samples of its lobes are divided, so that smooth edges cost little. A ray ends at
//! what is opaque, which is a surface like others in the layers.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use glam::DVec3;

use crate::camera::Camera;
use crate::device::surface::{
    self, Attenuation, Beauty, Environment, Estimator, Hit, Occlusion, Samples, Subsurface, Surface, Surfaces,
};
use crate::device::{Buffer, Device, Term, Weight};
use crate::error::{Error, Result};
use crate::frame::{self, Frame};
use crate::geometry::{self, Geometry};
use crate::light::LightVolume;
use crate::lights;
use crate::medium::Medium;
use crate::render::Renderer;
use crate::render::surfaces::{self, lit};
use crate::scene::{
    AttenuationKey, BeautyKey, Blend, EstimatorKey, IsosurfaceKeys, Model, OcclusionKey, Quality, Scene, SssKey,
    SurfaceLight, ValueUnits,
};
use crate::transfer::TransferFunction;

mod layers;
mod sky;

use layers::{Picture, Sheet, Wanted};
pub use layers::{Weights, composite};
use sky::Sky;

/// Isosurfaces.
pub struct Isosurface {
    keys: IsosurfaceKeys,
    light: SurfaceLight,
    /// World length between samples in voxels.
    step: f32,
    /// The map's colours from value 0 to 1, scene-linear.
    colors: Vec<[f32; 3]>,
    sky: Option<Sky>,
    /// What is opaque.
    opaque: Option<surfaces::Surfaces>,
    /// Whether frames hold layers.
    layers: bool,
    /// True when it was said that no value of a step reaches a surface.
    said: AtomicBool,
}

/// Rays that a pixel's passes take (table 1).
struct Counts {
    diffuse: u32,
    specular: u32,
    occlusion: u32,
    steps: u32,
    primary: u32,
    secondary: u32,
}

impl Counts {
    const PREVIEW: Counts = Counts { diffuse: 8, specular: 16, occlusion: 32, steps: 10, primary: 4, secondary: 4 };
    const FINAL: Counts = Counts { diffuse: 64, specular: 128, occlusion: 128, steps: 20, primary: 64, secondary: 16 };
}

/// The sky of a scene that says nothing of light, from straight below to straight above.
const FIRST_SKY: [[f32; 3]; 3] = [[0.2, 0.17, 0.15], [0.55, 0.55, 0.55], [1.35, 1.45, 1.6]];

/// Rays worked on at a time: their hits and sums take 30 MB.
const BAND: usize = 1 << 18;

impl Isosurface {
    /// Isosurfaces as `scene.isosurface` says, up to what is opaque.
    ///
    /// # Errors
    /// Those of [`lights::resolve`]; [`Error::Scene`] when surfaces are to be lit by an environment and there is none;
    /// [`Error::Unsupported`] for `isosurface.light = "both"` in the paper's model.
    pub fn new(scene: &Scene, geometry: Option<Arc<Geometry>>) -> Result<Self> {
        let keys = scene.isosurface.clone();
        let light = keys.light.unwrap_or(match scene.light.model {
            _ if scene.lights.is_empty() => SurfaceLight::Environment,
            Model::Physical => SurfaceLight::Both,
            Model::Paper => SurfaceLight::Volume,
        });
        if light == SurfaceLight::Both && scene.light.model == Model::Paper {
            return Err(Error::Unsupported(
                "isosurface.light = \"both\" with light.model = \"paper\", whose light volume holds the environment too\n  \
                 try: isosurface.light = \"volume\" or \"environment\""
                    .into(),
            ));
        }
        let gradient = match &keys.sky {
            None if light == SurfaceLight::Environment && scene.lights.is_empty() => Some(&FIRST_SKY[..]),
            given => given.as_deref(),
        };
        let mut sky = match light {
            SurfaceLight::Volume if keys.sss == SssKey::None => None,
            _ => Sky::new(&lights::resolve(scene)?, gradient),
        };
        let wants = match light {
            SurfaceLight::Environment => Some("isosurface.light"),
            _ if keys.sss != SssKey::None => Some("isosurface.sss"),
            _ => None,
        };
        if let (None, Some(key)) = (&sky, wants) {
            return Err(Error::scene(
                key,
                "takes light from an environment, and the scene has none: add [[lights]] with kind = \"environment\", or \
                 give isosurface.sky",
            ));
        }
        if let (BeautyKey::Prefiltered, Some(sky)) = (keys.beauty, &mut sky) {
            let exponents: Vec<f32> =
                order(&keys.values).into_iter().map(|i| keys.exponent.of(i).unwrap_or(0.0)).collect();
            sky.filter(&exponents);
        }
        let hidden = keys.blend == Blend::Opacity && keys.opacity.all().iter().all(|o| *o == 1.0);
        if keys.sss != SssKey::None && hidden {
            tracing::warn!(
                "isosurface.sss is hidden beneath opaque surfaces\n  try: isosurface.blend = \"fresnel\", or an opacity below 1"
            );
        }
        let colors = TransferFunction::new(&scene.transfer)?.colors();
        let linear = |c: [f32; 3]| c.map(|v| frame::srgb_decode(f64::from(v)) as f32);
        Ok(Isosurface {
            step: scene.render.step,
            colors: colors.map(linear).to_vec(),
            sky,
            opaque: geometry.map(surfaces::Surfaces::new),
            layers: true,
            said: AtomicBool::new(false),
            light,
            keys,
        })
    }

    /// The surfaces in a step's units, values ascending.
    fn surfaces(&self, medium: &Medium) -> Vec<Surface> {
        let keys = &self.keys;
        let table = &medium.table;
        let range = table.hi - table.lo;
        let each = |i: usize| {
            let value = match keys.units {
                ValueUnits::Range => table.lo + keys.values[i] as f32 * range,
                ValueUnits::Data => keys.values[i] as f32,
            };
            let of = |numbers: &crate::scene::PerSurface| numbers.of(i).unwrap_or_default();
            let mapped = || self.colors[(table.normalise(value) * (self.colors.len() - 1) as f32).round() as usize];
            let color = keys.color.as_ref().and_then(|c| c.of(i)).unwrap_or_else(mapped);
            // Steepness counts in field ranges a voxel.
            let steepness = if range > 0.0 { medium.grid.mean_spacing() as f32 / range } else { 0.0 };
            Surface {
                value,
                diffuse: color.map(|c| of(&keys.diffuse) * c),
                specular: of(&keys.specular),
                exponent: of(&keys.exponent),
                exponent_gradient: of(&keys.exponent_gradient) * steepness,
                opacity: of(&keys.opacity),
                transmission: if keys.sss == SssKey::None { 0.0 } else { of(&keys.transmission) },
                spread: of(&keys.spread),
                ior: of(&keys.ior),
            }
        };
        order(&keys.values).into_iter().map(each).collect()
    }

    /// Says, once until it changes, that no surface will be seen.
    fn look_for(&self, medium: &Medium, surfaces: &[Surface]) {
        let (lo, hi) =
            medium.ranges.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), r| (l.min(r[0]), h.max(r[1])));
        let reached = |s: &Surface| lo < s.value && s.value <= hi;
        if surfaces.iter().any(reached) {
            self.said.store(false, Ordering::Relaxed);
        } else if !self.said.swap(true, Ordering::Relaxed) {
            let values: Vec<f32> = surfaces.iter().map(|s| s.value).collect();
            let range = if lo <= hi { format!("its values go from {lo} to {hi}") } else { "it holds no values".into() };
            tracing::warn!("the isovalues {values:?} are nowhere in this step: {range}; the picture is empty");
        }
    }

    fn counts(&self) -> (Counts, usize) {
        let (counts, antialias) = match self.keys.quality {
            Quality::Preview => (Counts::PREVIEW, 1),
            Quality::Final => (Counts::FINAL, 2),
        };
        (counts, self.keys.antialias.unwrap_or(antialias))
    }
}

/// Indices that put values in ascending order.
fn order(values: &[f64]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|a, b| values[*a].total_cmp(&values[*b]));
    order
}

impl Renderer for Isosurface {
    fn render(
        &self,
        device: &dyn Device,
        medium: &Medium,
        light: &LightVolume,
        camera: &Camera,
        size: [usize; 2],
    ) -> Result<Frame> {
        let (counts, antialias) = self.counts();
        let wanted = Wanted {
            layers: self.layers,
            environment: self.light != SurfaceLight::Volume && self.sky.is_some(),
            volume: self.light != SurfaceLight::Environment,
            sss: self.keys.sss != SssKey::None,
        };
        if medium.table.graded.is_some() && matches!(self.keys.attenuation, AttenuationKey::By(_)) && wanted.sss {
            return Err(Error::Unsupported(
                "isosurface.attenuation = \"transfer\" with a transfer function of two dimensions\n  try: a number"
                    .into(),
            ));
        }
        let solids = self.surfaces(medium);
        self.look_for(medium, &solids);
        if medium.grid.is_empty() {
            return Ok(Picture::new(size, wanted).done());
        }
        let values: Vec<f32> = solids.iter().map(|s| s.value).collect();
        let empty = match medium.ranges.len() == medium.bricks.len() {
            true => surface::distances(&medium.bricks, &medium.ranges, &values),
            false => vec![],
        };
        let texels = self.sky.as_ref().map(|sky| sky.upload(device)).transpose()?;
        let picture = size.map(|n| n * antialias);
        let surfaces = Surfaces {
            grid: &medium.grid,
            field: &medium.field,
            bricks: medium.bricks,
            empty: &empty,
            surfaces: &solids,
            clips: &medium.clips,
            step: self.step * medium.grid.mean_spacing() as f32,
            camera,
            picture,
        };
        let passes =
            Passes { of: self, device, medium, light, surfaces, counts, antialias, wanted, texels: texels.as_ref() };
        let mut seen = Picture::new(size, wanted);
        // Whole pixels at a time.
        let rows = (BAND / picture[0].max(1)).max(1).next_multiple_of(antialias);
        for first in (0..picture[1]).step_by(rows) {
            let pixels = first * picture[0]..(first + rows).min(picture[1]) * picture[0];
            let blank = || vec![Sheet::default(); pixels.len() / (antialias * antialias)];
            let mut sheets = vec![blank()];
            let ends = Ends::new(self.opaque.as_ref(), camera, picture, &pixels);
            let mut rays: Vec<Hit> = pixels.clone().map(|p| Hit::ray(p as u32)).collect();
            // Behind the last transparent surface may be something opaque.
            for k in 0..self.keys.layers + usize::from(self.opaque.is_some()) {
                match k < self.keys.layers {
                    true => device.surface_hits(&surfaces, &mut rays)?,
                    false => rays.iter_mut().for_each(|hit| hit.surface = Hit::NONE),
                }
                let ended: Vec<_> = rays.iter().filter_map(|hit| Some((hit.pixel, ends.before(hit)?))).collect();
                rays.retain(|hit| hit.surface != Hit::NONE && ends.before(hit).is_none());
                if rays.is_empty() && ended.is_empty() {
                    break;
                }
                if sheets.len() == k {
                    sheets.push(blank());
                }
                let found = passes.all(&rays, k as u32)?;
                let opaque = passes.opaque(&ended, k as u32)?;
                let met = rays.iter().map(|hit| hit.pixel).zip(&found);
                for (pixel, sheet) in met.chain(ended.iter().map(|(pixel, _)| *pixel).zip(&opaque)) {
                    let pixel = pixel as usize - pixels.start;
                    let [x, y] = [pixel % picture[0], pixel / picture[0]].map(|c| c / antialias);
                    sheets[k][y * size[0] + x].add(sheet);
                }
                let mut shows = found.iter().map(|s| s.weight < 1.0 && s.sss[3] == 0.0);
                rays.retain(|_| shows.next().unwrap_or(false));
                if rays.is_empty() {
                    break;
                }
            }
            sheets.iter_mut().flatten().for_each(|sheet| sheet.finish(antialias * antialias));
            seen.take(&sheets);
        }
        Ok(seen.done())
    }

    fn leave_out_layers(&mut self) {
        self.layers = false;
    }

    fn needs_light(&self) -> bool {
        self.light != SurfaceLight::Environment
    }

    fn needs_scattered_light(&self) -> bool {
        self.light == SurfaceLight::Volume
    }
}

/// What is opaque along the rays of a band.
struct Ends {
    first: usize,
    met: Vec<Option<geometry::Hit>>,
}

impl Ends {
    fn new(of: Option<&surfaces::Surfaces>, camera: &Camera, picture: [usize; 2], pixels: &Range<usize>) -> Self {
        let met = of.map_or(vec![], |of| of.meet(camera, picture, pixels.clone()));
        Ends { first: pixels.start, met }
    }

    /// Something opaque in the way of a ray to where it is, or anywhere along one that has left.
    fn before(&self, hit: &Hit) -> Option<geometry::Hit> {
        let met = (*self.met.get(hit.pixel as usize - self.first)?)?;
        (hit.surface == Hit::NONE || met.t <= f64::from(hit.depth)).then_some(met)
    }
}

/// The part of the environment's rays that escapes from a hit, and the light that diffuse and specular lobes return there.
type Around = (f32, [[f32; 3]; 2]);

/// What the passes at a set of hits share.
struct Passes<'a> {
    of: &'a Isosurface,
    device: &'a dyn Device,
    medium: &'a Medium,
    light: &'a LightVolume,
    surfaces: Surfaces<'a>,
    counts: Counts,
    antialias: usize,
    wanted: Wanted,
    texels: Option<&'a Buffer>,
}

impl Passes<'_> {
    /// The share of a ray in a pixel's samples.
    fn share(&self, count: u32) -> Samples {
        Samples { first: 0, end: count.div_ceil((self.antialias * self.antialias) as u32) }
    }

    fn estimator(&self) -> Estimator {
        match self.of.keys.estimator {
            EstimatorKey::Normalised => Estimator::Normalised,
            EstimatorKey::Paper => Estimator::Paper,
        }
    }

    fn environment(&self) -> Option<Environment<'_>> {
        self.of.sky.as_ref().zip(self.texels).map(|(sky, texels)| sky.environment(texels))
    }

    /// The terms of the light volume that are wanted of it.
    fn terms(&self) -> Vec<Term<'_>> {
        // Scattered light holds the environment's, which `both` takes from all around.
        let wanted = |term: &Term| {
            self.of.light == SurfaceLight::Volume || self.wanted.volume && !matches!(term.weight, Weight::Uniform(_))
        };
        self.light.terms().into_iter().filter(wanted).collect()
    }

    /// The environment's light at each of the hits, if it is wanted: the part of its rays that escapes, and what perfect diffuse
    /// and specular lobes return.
    fn all_around(&self, hits: &[Hit], seed: u32) -> Result<Option<Vec<Around>>> {
        let keys = &self.of.keys;
        let Some(environment) = self.environment().filter(|_| self.wanted.environment) else { return Ok(None) };
        let estimator = self.estimator();
        let mut open = Vec::new();
        let samples = self.share(self.counts.occlusion);
        if keys.occlusion != OcclusionKey::None {
            let voxels = keys.occlusion_radius * self.medium.grid.mean_spacing();
            let occlusion = Occlusion { radius: voxels as f32, steps: self.counts.steps, estimator, seed };
            open.resize(hits.len(), [0.0; 4]);
            self.device.surface_occlusion(&self.surfaces, &occlusion, samples, hits, &mut open)?;
        }
        let beauty = Beauty {
            environment,
            diffuse: self.share(self.counts.diffuse),
            specular: self.share(self.counts.specular),
            bent: if keys.occlusion == OcclusionKey::Bent { &open } else { &[] },
            estimator,
            seed,
        };
        let mut sums = vec![[[0.0; 3]; 2]; hits.len()];
        self.device.surface_beauty(&self.surfaces, &beauty, hits, &mut sums)?;
        let counts = match keys.beauty {
            BeautyKey::Sampled => [beauty.diffuse.end as f32, beauty.specular.end as f32],
            BeautyKey::Prefiltered => [1.0; 2],
        };
        let of = |(n, sum): (usize, &[[f32; 3]; 2])| {
            let escapes = open.get(n).map_or(1.0, |sum| sum[3] / samples.end as f32);
            (escapes, [0, 1].map(|lobe| sum[lobe].map(|s| s / counts[lobe])))
        };
        Ok(Some(sums.iter().enumerate().map(of).collect()))
    }

    /// What is seen of something opaque, by pixels: its light is the environment's and the light volume's, as surfaces take them.
    fn opaque(&self, met: &[(u32, geometry::Hit)], seed: u32) -> Result<Vec<Sheet>> {
        if met.is_empty() {
            return Ok(vec![]);
        }
        let grid = &self.medium.grid;
        let place = |at: DVec3| ((at - DVec3::from(grid.origin)) / DVec3::from(grid.spacing)).as_vec3();
        // At no isosurface: the first stands for all, and the side is not known.
        let hit = |(pixel, met): &(u32, geometry::Hit)| Hit {
            position: place(met.position).into(),
            normal: met.normal.as_vec3().into(),
            depth: met.t as f32,
            surface: 0,
            before: u32::MAX,
            behind: u32::MAX,
            ..Hit::ray(*pixel)
        };
        let hits: Vec<Hit> = met.iter().map(hit).collect();
        let around = self.all_around(&hits, seed)?;
        let things: Vec<geometry::Hit> = met.iter().map(|(_, met)| *met).collect();
        let volume = lit(self.device, grid, &self.terms(), &things)?;
        let sheet = |n: usize| {
            let colored = |light: [f32; 3]| std::array::from_fn(|c| things[n].color[c] * light[c].max(0.0));
            let (occlusion, [diffuse, _]) = around.as_ref().map_or((1.0, [[0.0; 3]; 2]), |around| around[n]);
            Sheet {
                cover: 1.0,
                weight: 1.0,
                opacity: 1.0,
                fresnel: 1.0,
                depth: hits[n].depth,
                normal: hits[n].normal,
                diffuse: colored(diffuse),
                occlusion,
                volume_diffuse: colored(volume[n]),
                ..Sheet::default()
            }
        };
        Ok((0..hits.len()).map(sheet).collect())
    }

    /// What is seen at each of the hits.
    fn all(&self, hits: &[Hit], seed: u32) -> Result<Vec<Sheet>> {
        if hits.is_empty() {
            return Ok(vec![]);
        }
        let keys = &self.of.keys;
        let solids = self.surfaces.surfaces;
        let mut sheets: Vec<Sheet> = hits.iter().map(|hit| self.plain(hit)).collect();
        let [diffuse, specular] = [0, 1].map(|lobe| {
            move |hit: &Hit, light: [f32; 3]| -> [f32; 3] {
                let surface = &solids[hit.surface as usize];
                let k = if lobe == 0 { surface.diffuse } else { [surface.specular; 3] };
                std::array::from_fn(|c| k[c] * light[c])
            }
        });
        let around = self.all_around(hits, seed)?;
        for ((sheet, hit), (occlusion, lobes)) in sheets.iter_mut().zip(hits).zip(around.iter().flatten()) {
            sheet.occlusion = *occlusion;
            sheet.diffuse = diffuse(hit, lobes[0]);
            sheet.specular = specular(hit, lobes[1]);
        }
        if self.wanted.volume {
            let mut sums = vec![[[0.0; 3]; 2]; hits.len()];
            for term in self.terms() {
                self.device.surface_light(&self.surfaces, &term, hits, &mut sums)?;
            }
            for ((sheet, hit), sum) in sheets.iter_mut().zip(hits).zip(&sums) {
                sheet.volume_diffuse = diffuse(hit, sum[0]);
                sheet.volume_specular = specular(hit, sum[1]);
            }
        }
        if let Some(environment) = self.environment().filter(|_| self.wanted.sss) {
            let primary = self.share(self.counts.primary);
            let subsurface = Subsurface {
                environment,
                primary,
                secondary: self.counts.secondary,
                fast: keys.sss == SssKey::Fast,
                refracts: keys.refraction,
                attenuation: self.attenuation(),
                estimator: self.estimator(),
                seed,
            };
            let mut sums = vec![[0.0; 3]; hits.len()];
            self.device.surface_subsurface(&self.surfaces, &subsurface, hits, &mut sums)?;
            for ((sheet, hit), sum) in sheets.iter_mut().zip(hits).zip(&sums) {
                let [r, g, b] = sum.map(|s| s / primary.end as f32);
                let beneath = f32::from(u8::from(solids[hit.surface as usize].transmission > 0.0));
                sheet.sss = [r, g, b, beneath];
            }
        }
        Ok(sheets)
    }

    /// What a hit tells by itself.
    fn plain(&self, hit: &Hit) -> Sheet {
        let surface = &self.surfaces.surfaces[hit.surface as usize];
        let spacing = self.medium.grid.spacing;
        let eye = self.surfaces.eye();
        let view = glam::Vec3::from_array(std::array::from_fn(|a| (hit.position[a] - eye[a]) * spacing[a] as f32));
        let fresnel = surface.fresnel(-view.normalize_or_zero().dot(hit.normal.into()));
        let weight = match self.of.keys.blend {
            Blend::Opacity => surface.opacity,
            Blend::Fresnel => fresnel,
        };
        Sheet {
            cover: 1.0,
            weight,
            opacity: surface.opacity,
            fresnel,
            depth: hit.depth,
            normal: hit.normal,
            occlusion: 1.0,
            ..Sheet::default()
        }
    }

    fn attenuation(&self) -> Attenuation<'_> {
        match self.of.keys.attenuation {
            AttenuationKey::By(_) => Attenuation { rate: self.medium.table.chromatic, table: Some(&self.medium.table) },
            AttenuationKey::PerVoxel(left) => {
                let voxel = self.medium.grid.mean_spacing() as f32;
                Attenuation { rate: left.rgb().map(|v| -v.ln() / voxel), table: None }
            }
        }
    }
}
