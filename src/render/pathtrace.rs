//! Path tracing (Kroes et al. 2012): pictures that converge to the truth as `n^−½`, which everything faster is held against.

use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::camera::{Camera, Lens};
use crate::device::emitter::Emitter;
use crate::device::{Device, Phase, Sampling, Surface, Tally, Trace};
use crate::error::Result;
use crate::frame::{Display, Frame, Layer};
use crate::geometry::Geometry;
use crate::light::LightVolume;
use crate::lights::Emitters;
use crate::medium::Medium;
use crate::render::Renderer;
use crate::render::denoise::{self, Guides};
use crate::render::film::{Film, Moments, Stop};
use crate::render::replay::{self, Paths};
use crate::scene::{PathtraceKeys, PhaseKey, RenderKeys, SamplingKey, ScatteringKey, Scene};
use crate::transfer::surfaces;

/// Path tracing.
pub struct Pathtrace {
    keys: PathtraceKeys,
    render: RenderKeys,
    emitters: Emitters,
    depth: u32,
    phase: Phase,
    /// Reference length of opacity in voxels, and surfaces for each entry of the table.
    reference: f64,
    surfaces: Vec<[f32; 4]>,
    meshes: Option<Arc<Geometry>>,
}

impl Pathtrace {
    /// More scatterings matter to no picture: paths end at random long before.
    const DEEPEST: u32 = 100_000;
    /// Samples between two looks at the error and the clock.
    const BATCH: u32 = 16;
    /// Samples that find what to focus on.
    const FOCUS: u32 = 256;

    /// Path tracing as a scene says, with what is opaque in it.
    ///
    /// # Errors
    /// Those of [`Emitters::new`].
    pub fn new(scene: &Scene, meshes: Option<Arc<Geometry>>) -> Result<Self> {
        let g = scene.transfer.anisotropy;
        Ok(Pathtrace {
            keys: scene.pathtrace.clone(),
            render: scene.render.clone(),
            emitters: Emitters::new(scene)?,
            depth: scene.pathtrace.depth.unwrap_or(if scene.light.scattering { Self::DEEPEST } else { 1 }),
            phase: match scene.pathtrace.phase {
                PhaseKey::HenyeyGreenstein => Phase::HenyeyGreenstein(g),
                PhaseKey::Schlick => Phase::Schlick(g),
            },
            reference: scene.transfer.reference,
            surfaces: surfaces(&scene.transfer),
            meshes,
        })
    }

    /// Everything but which samples of which picture.
    fn scene<'a>(
        &'a self,
        medium: &'a Medium,
        majorant: &'a [f32],
        emitters: &'a [Emitter],
        camera: &'a Camera,
    ) -> Trace<'a> {
        let factor = match self.keys.scattering {
            ScatteringKey::Phase => None,
            ScatteringKey::Hybrid => Some(Some(self.keys.gradient_factor)),
            ScatteringKey::Brdf => Some(None),
        };
        let reference = (self.reference * medium.grid.mean_spacing()) as f32;
        Trace {
            grid: &medium.grid,
            field: &medium.field,
            gradient: medium.gradient.as_ref(),
            table: &medium.table,
            surface: factor.map(|factor| Surface { factor, columns: &self.surfaces, reference }),
            bricks: medium.bricks,
            majorant,
            emitters,
            images: self.emitters.images(),
            camera,
            focus: camera.lens.focus.unwrap_or(1.0),
            clips: &medium.clips,
            meshes: self.meshes.as_deref(),
            phase: self.phase,
            sampling: match self.keys.sampling {
                SamplingKey::Both => Sampling::Both,
                SamplingKey::Lights => Sampling::Lights,
                SamplingKey::Scattering => Sampling::Scattering,
            },
            depth: self.depth,
            seed: self.keys.seed,
            samples: 0..0,
        }
    }

    /// Takes samples until there are enough.
    fn expose(&self, device: &dyn Device, mut trace: Trace, size: [usize; 2]) -> Result<Vec<Tally>> {
        let stop = Stop {
            samples: self.samples(),
            budget: self.render.budget_ms.map(|ms| Duration::from_secs_f64(1e-3 * ms)),
            error: self.render.target_error,
        };
        let mut tallies = vec![Tally::default(); size[0] * size[1]];
        let mut film = Film::new(size);
        let (begun, mut exceeded) = (Instant::now(), 0);
        loop {
            let more = stop.more(&film, begun.elapsed(), Self::BATCH);
            if more == 0 {
                break;
            }
            trace.samples = trace.samples.end..trace.samples.end + more;
            exceeded += device.trace(&trace, size, &mut tallies)?.exceeded;
            film.pixels.iter_mut().zip(&tallies).for_each(|(pixel, tally)| *pixel = moments(tally));
        }
        warn(exceeded);
        Ok(tallies)
    }

    /// Samples of each pixel at most.
    fn samples(&self) -> u32 {
        u32::try_from(self.render.samples).unwrap_or(u32::MAX)
    }

    /// The picture that `expose` finds the sums of.
    fn picture(
        &self,
        device: &dyn Device,
        medium: &Medium,
        camera: &Camera,
        size: [usize; 2],
        expose: impl FnOnce(Trace) -> Result<Vec<Tally>>,
    ) -> Result<Frame> {
        let emitters = self.emitters.on(&medium.grid);
        let majorant = majorants(device, medium)?;
        let mut trace = self.scene(medium, &majorant, &emitters, camera);
        if camera.lens.radius > 0.0 && camera.lens.focus.is_none() {
            trace.focus = focus(device, &trace)?;
        }
        let tallies = expose(trace)?;
        let film = Film { pixels: tallies.iter().map(moments).collect(), ..Film::new(size) };

        let estimate = film.estimate();
        let per_sample = |tally: &Tally, v: f32| v / tally.samples.max(1) as f32;
        let albedo: Vec<[f32; 3]> = tallies.iter().map(|t| t.albedo.map(|v| per_sample(t, v))).collect();
        let normal: Vec<[f32; 3]> = tallies.iter().map(|t| t.normal.map(|v| per_sample(t, v))).collect();
        let depth: Vec<f32> = tallies.iter().map(|t| per_sample(t, t.depth)).collect();
        let guides = Guides { albedo: &albedo, normal: &normal, depth: &depth };
        let display = Display::from(&self.render);
        let mut finished = None;
        device.on_threads(&mut || {
            finished = Some(denoise::finished(&estimate, &guides, self.keys.denoise, self.keys.filter, &display));
        });
        let finished = finished.expect("the work was done");

        let layer = |name: &str, channels: &str, values| Layer { name: name.into(), channels: channels.into(), values };
        let layers = vec![
            layer("albedo", "RGB", albedo.into_flattened()),
            layer("normal", "XYZ", normal.into_flattened()),
            layer("depth", "V", tallies.iter().map(|t| t.depth / t.coverage.max(1.0) as f32).collect()),
            finished.layer(),
            film.layer(),
        ];
        Ok(Frame { size, pixels: finished.pixels, layers })
    }
}

impl Renderer for Pathtrace {
    fn render(
        &self,
        device: &dyn Device,
        medium: &Medium,
        _: &LightVolume,
        camera: &Camera,
        size: [usize; 2],
    ) -> Result<Frame> {
        self.picture(device, medium, camera, size, |trace| self.expose(device, trace, size))
    }

    fn replay(
        &self,
        device: &dyn Device,
        medium: &Medium,
        camera: &Camera,
        size: [usize; 2],
        paths: &mut Option<Paths>,
    ) -> Result<(Frame, usize)> {
        let mut kept = 0;
        let frame = self.picture(device, medium, camera, size, |trace| {
            let trace = Trace { samples: 0..self.samples(), ..trace };
            let replayed = replay::replay(device, medium, &trace, size, paths)?;
            warn(replayed.exceeded);
            kept = replayed.kept;
            Ok(replayed.tallies)
        })?;
        Ok((frame, kept))
    }

    fn replays(&self) -> bool {
        self.keys.replay
    }

    fn needs_light(&self) -> bool {
        false
    }
}

/// Says when bounds did not hold.
fn warn(exceeded: u64) {
    if exceeded > 0 {
        tracing::warn!("extinction was above its bound in {exceeded} collisions: the picture is too bright there");
    }
}

/// What a film keeps of a pixel's sums.
fn moments(tally: &Tally) -> Moments {
    let n = f64::from(tally.samples.max(1));
    let mean = tally.radiance.map(|sum| sum / n);
    Moments {
        count: tally.samples,
        mean: [mean[0] as f32, mean[1] as f32, mean[2] as f32, (tally.coverage / n) as f32],
        squares: std::array::from_fn(|c| (tally.squares[c] - n * mean[c] * mean[c]).max(0.0) as f32),
    }
}

/// A bound on extinction in each brick, above 0 also where something glows, so that paths look there: at least once in two voxels.
fn majorants(device: &dyn Device, medium: &Medium) -> Result<Vec<f32>> {
    let glows = !medium.table.emission.is_empty();
    let steepness =
        medium.gradient.as_ref().map(|gradient| device.brick_range(&medium.bricks, gradient)).transpose()?;
    let extinction = medium.table.densest(&medium.ranges, steepness.as_deref());
    let least = (0.5 / medium.grid.mean_spacing()) as f32;
    let bound = |(sigma, seen): (f32, &f32)| if glows && *seen > 0.0 { sigma.max(least) } else { sigma };
    Ok(extinction.into_iter().zip(&medium.majorant).map(bound).collect())
}

/// Where the middle ray meets the medium, in the mean over its paths; the middle of the volume where it meets none.
fn focus(device: &dyn Device, trace: &Trace) -> Result<f32> {
    // A picture of one pixel that is a point.
    let camera = Camera { tan: 1e-6, lens: Lens::PINHOLE, ..*trace.camera };
    let ray = Trace { camera: &camera, depth: 0, samples: 0..Pathtrace::FOCUS, ..*trace };
    let mut tally = [Tally::default()];
    device.trace(&ray, [1, 1], &mut tally)?;
    let (lo, hi) = trace.grid.bounds();
    let middle = (0.5 * (lo + hi) - camera.eye.as_dvec3()).as_vec3().dot(camera.forward);
    let met = tally[0].depth / tally[0].coverage.max(1.0) as f32;
    Ok(if tally[0].coverage > 0.0 { met } else { middle.max(f32::MIN_POSITIVE) })
}
