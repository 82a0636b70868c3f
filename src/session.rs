//! One timestep: classify, light, render.

use std::sync::Arc;
use std::time::Instant;

use crate::clip::clips;
use crate::detail::Detail;
use crate::device::Device;
use crate::error::{Error, Result};
use crate::field::Timestep;
use crate::geometry::Geometry;
use crate::grid::Grid;
use crate::ledger::LedgerRow;
use crate::light::{IlluminatedVolume, LightSolver, LightVolume};
use crate::light_state::{About, LightState};
use crate::lights::{self, Light};
use crate::medium::Medium;
use crate::render::reuse::Kept;
use crate::render::{self, Renderer};
use crate::scene::{RangeKey, RangeOver, RenderKind, Scene};
use crate::sink::Output;
use crate::transfer::TransferFunction;
use pictures::{Pictures, Scenery};

mod pictures;

pub(crate) use pictures::cameras;

/// Lights and renders one step after another, each starting from the light of the step before.
pub struct Session {
    device: Arc<dyn Device>,
    scene: Scene,
    transfer: TransferFunction,
    lights: Vec<Light>,
    detail: Option<Detail>,
    geometry: Option<Arc<Geometry>>,
    renderer: Box<dyn Renderer>,
    range: Option<[f64; 2]>,
    seen: Option<[f64; 2]>,
    wants_light: bool,
    steps: u64,
    /// The last step that was lit.
    last: Option<u64>,
    /// Steps passed over that are later than the light to start from.
    later: u64,
    state: Option<State>,
    /// Change of the light below which a step is not rendered, and the light of the last that was.
    news: Option<(f64, Option<Arc<IlluminatedVolume>>)>,
    /// Light to start from when the first step arrives.
    kept: Option<LightState>,
}

/// What is sized by the data's grid, made when the first step arrives.
struct State {
    /// The grid that steps come on, without detail.
    data: Grid,
    medium: Medium,
    solver: LightSolver,
    light: LightVolume,
    /// Each camera's picture of the step before, where the next may keep some of it.
    kept: Vec<Kept>,
}

impl State {
    fn new(device: &dyn Device, scene: &Scene, transfer: &TransferFunction, data: Grid) -> Result<Self> {
        let table = transfer.table([0.0, 1.0], data.mean_spacing());
        let grid = Detail::grid(&scene.noise, &data);
        let mut medium = Medium::new(device, grid, table)?;
        medium.clips = clips(&scene.clip, &grid);
        // Volumes that are read slab after slab would be read twice.
        let replays = scene.render.kind == RenderKind::Pathtrace && scene.pathtrace.replay;
        if (scene.light.warm || replays) && !device.pages() {
            medium.remember(device)?;
        }
        Ok(State {
            data,
            medium,
            solver: LightSolver::new(device, scene, &grid)?,
            light: LightVolume::default(),
            kept: vec![],
        })
    }

    /// Starts from light that was kept; says why when it cannot.
    fn start_from(
        &mut self,
        device: &dyn Device,
        scene: &Scene,
        lights: &[Light],
        kept: &mut LightState,
    ) -> Result<Option<String>> {
        if let Some(why) = kept.about.differs(scene, &self.medium.grid) {
            return Ok(Some(why));
        }
        let solver = kept.solver.clone();
        let fits = self.solver.restore(device, &solver, |name| kept.take(name), lights, &mut self.light)?;
        Ok((!fits).then(|| "its volumes are not those that these settings need".into()))
    }
}

impl Session {
    /// A session that shows `scene` on `device`. `range` are the values that map to 0 and 1 of the transfer function where
    /// the scene leaves it to the series; `None` lets the range grow with the steps seen so far.
    pub fn new(device: Arc<dyn Device>, scene: Scene, range: Option<[f64; 2]>, wants_light: bool) -> Result<Self> {
        scene.validate()?;
        let geometry = Geometry::load(&scene.meshes)?.map(Arc::new);
        let range = match scene.field.range {
            RangeKey::Fixed(range) => Some(range),
            RangeKey::Over(RangeOver::Series) => range,
            RangeKey::Over(RangeOver::Step) => None,
        };
        Ok(Session {
            transfer: TransferFunction::new(&scene.transfer)?,
            lights: lights::resolve(&scene)?,
            detail: Detail::new(&scene.noise),
            renderer: render::renderer(&scene, geometry.as_ref())?,
            geometry,
            steps: 0,
            last: None,
            later: 0,
            seen: None,
            state: None,
            news: None,
            kept: None,
            device,
            scene,
            range,
            wants_light,
        })
    }

    /// The scene that is shown.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// From now on a step is rendered only when its light differs by more than `change` from that of the last step that was,
    /// anywhere, relative to the brightest light; the output of one that is not has no frames and no light.
    pub fn only_when_light_changes(&mut self, change: f64) {
        self.news = Some((change, None));
    }

    /// From now on frames hold no layers that are made for themselves: for outputs that have no room for them.
    pub fn leave_out_layers(&mut self) {
        self.renderer.leave_out_layers();
    }

    /// The grid of the steps so far.
    pub fn grid(&self) -> Option<Grid> {
        self.state.as_ref().map(|state| state.data)
    }

    /// Forgets the light of the steps so far: the next is lit from scratch, and may be on another grid.
    pub fn forget(&mut self) {
        self.state = None;
    }

    /// True when steps are read a slab at a time, as they are lit.
    pub fn pages(&self) -> bool {
        self.device.pages()
    }

    /// Counts steps that earlier runs have done, so that a camera in orbit stands where it would have stood.
    pub fn count_before(&mut self, steps: u64) {
        self.steps += steps;
    }

    /// Counts a step, by its number, that an earlier run has done.
    pub fn pass_over(&mut self, step: u64) {
        self.steps += 1;
        let last = self.kept.as_ref().and_then(|kept| kept.about.last);
        self.later += u64::from(last.is_some_and(|last| step > last));
    }

    /// What a later session may start from; see [`Session::start_from`].
    ///
    /// # Errors
    /// [`Error::Unsupported`] before the first step, and for the paper's model.
    pub fn light_state(&self) -> Result<LightState> {
        let none = |why: &str| Error::Unsupported(format!("keeping light {why}"));
        let state = self.state.as_ref().ok_or_else(|| none("before a step is lit"))?;
        let mut volumes = Vec::new();
        let solver = state.solver.keep(&*self.device, &state.light, &mut volumes)?;
        let solver = solver.ok_or_else(|| none("with light.model = \"paper\": \"physical\" can"))?;
        let about = About {
            grid: state.medium.grid,
            light: self.scene.light.clone(),
            lights: self.scene.lights.clone(),
            anisotropy: self.scene.transfer.anisotropy,
            steps: self.steps,
            last: self.last,
            seen: self.seen,
        };
        Ok(LightState { about, solver, volumes })
    }

    /// Goes on where the session that `kept` is of ended: its next step is warm, cameras that orbit go on, and a range that
    /// grows with the steps too. Before the first step only; where grid or settings differ that step is cold, and says why.
    pub fn start_from(&mut self, kept: LightState) {
        self.kept = Some(kept);
    }

    /// Goes on with what the device names for the case that it fails ([`Device::instead`]), from a cold start; its name.
    pub(crate) fn fall_back(&mut self) -> Option<String> {
        self.device = self.device.instead()?;
        self.state = None;
        Some(self.device.name())
    }

    /// Lights and renders one step. Where a device fails or has no memory left, another one goes on; that is said in the log.
    pub fn advance(&mut self, step: Timestep) -> Result<Output> {
        loop {
            let failed = match self.try_advance(&step) {
                Err(e @ (Error::Device(_) | Error::OutOfMemory { .. })) => e,
                done => return done,
            };
            let Some(next) = self.fall_back() else { return Err(failed) };
            tracing::warn!("step {}: {failed}\n  going on with {next}", step.step);
        }
    }

    /// The same on the device at hand only.
    pub(crate) fn try_advance(&mut self, step: &Timestep) -> Result<Output> {
        self.begin(step.grid)?;
        let (device, state) = (&*self.device, self.state.as_mut().expect("just begun"));

        let mut clock = Clock::start();
        // Pictures of the step before are gone with a step that fails: then nobody knows what changed since.
        let before = std::mem::take(&mut state.kept);
        // Values in voxels of the data, such as lengths of opacity, stay what they are.
        let spacing = step.grid.mean_spacing();
        let detailed = self.detail.as_ref().map(|detail| detail.apply(step));
        let step = detailed.as_ref().unwrap_or(step);
        let (holes, seen) = state.medium.take(device, step)?;
        let range = self.range.unwrap_or_else(|| running(self.scene.field.range, &mut self.seen, seen));
        state.medium.classify(self.transfer.table(range, spacing));
        let classify_ms = clock.lap();

        // Surfaces are lit also where their medium is transparent.
        let lit = self.wants_light || self.news.is_some();
        let behind_nothing = self.scene.render.kind == RenderKind::Raycast && self.geometry.is_none();
        state.solver.only_visible(!lit && behind_nothing);
        state.solver.only_direct(!lit && !self.renderer.needs_scattered_light());
        let solved = match lit || self.renderer.needs_light() {
            true => Some(state.solver.solve(device, &state.medium, &self.lights, &mut state.light)?),
            false => None,
        };
        let light = if lit { Some(Arc::new(state.solver.illuminated(device, &state.light)?)) } else { None };
        let shown = is_news(&mut self.news, light.as_ref());
        let light_ms = clock.lap();

        let scenery =
            Scenery { scene: &self.scene, renderer: &*self.renderer, medium: &state.medium, light: &state.light };
        let pictures = if shown { scenery.pictures(device, self.steps, before)? } else { Pictures::default() };
        let render_ms = clock.lap();

        self.steps += u64::from(shown);
        state.kept = pictures.kept;
        self.last = Some(step.step);
        let row = LedgerRow {
            step: step.step,
            time: step.time,
            bytes: 4 * step.grid.len() as u64,
            tiles_reused: pictures.tiles_reused,
            tiles_total: pictures.tiles_total,
            holes,
            classify_ms,
            light_ms,
            render_ms,
            frames: pictures.views.len() as u64,
            ..LedgerRow::lit(solved.as_ref())
        };
        let light = light.filter(|_| self.wants_light && shown);
        Ok(Output { step: step.step, time: step.time, range, frames: pictures.views, light, row })
    }

    /// Makes what the first step on a grid needs, from light that was kept where there is some.
    fn begin(&mut self, grid: Grid) -> Result<()> {
        if self.state.is_some() {
            return Ok(());
        }
        let device = &*self.device;
        let mut state = State::new(device, &self.scene, &self.transfer, grid)?;
        if let Some(geometry) = &self.geometry {
            geometry.check(&grid)?;
            state.solver.block(device, geometry)?;
        }
        if let Some(mut kept) = self.kept.take() {
            match state.start_from(device, &self.scene, &self.lights, &mut kept)? {
                // A run that is taken up again has counted the steps that it passed over, those of the run that left the light
                // among them.
                None => {
                    self.steps = self.steps.max(kept.about.steps + self.later);
                    self.seen = kept.about.seen;
                }
                Some(why) => tracing::warn!("the light that was kept is not used, the start is cold: {why}"),
            }
        }
        self.state = Some(state);
        Ok(())
    }
}

/// True when the light has changed enough since the last that was shown, which this one then is.
fn is_news(news: &mut Option<(f64, Option<Arc<IlluminatedVolume>>)>, light: Option<&Arc<IlluminatedVolume>>) -> bool {
    let (Some((threshold, shown)), Some(light)) = (news, light) else { return true };
    if shown.as_ref().is_some_and(|before| change(before, light) <= *threshold) {
        return false;
    }
    *shown = Some(light.clone());
    true
}

/// Largest change of the light between two steps, relative to the brightest light of the later one; infinite from one grid to
/// another.
fn change(before: &IlluminatedVolume, now: &IlluminatedVolume) -> f64 {
    if before.grid != now.grid {
        return f64::INFINITY;
    }
    let values = || before.fluence.iter().flatten().zip(now.fluence.iter().flatten());
    let (largest, brightest) =
        values().fold((0.0f32, 0.0f32), |(d, b), (was, is)| (d.max((is - was).abs()), b.max(*is)));
    if largest > 0.0 { f64::from(largest) / f64::from(brightest) } else { 0.0 }
}

/// The range of values where neither the scene nor the series tells: this step's, or over all steps so far, so that it only
/// grows.
fn running(over: RangeKey, before: &mut Option<[f64; 2]>, now: Option<[f32; 2]>) -> [f64; 2] {
    let now = now.map(|r| r.map(f64::from));
    if over == RangeKey::Over(RangeOver::Step) {
        return now.unwrap_or([0.0, 1.0]);
    }
    *before = match (*before, now) {
        (Some(b), Some(n)) => Some([b[0].min(n[0]), b[1].max(n[1])]),
        (known, None) | (None, known) => known,
    };
    before.unwrap_or([0.0, 1.0])
}

/// Milliseconds between laps.
struct Clock(Instant);

impl Clock {
    fn start() -> Self {
        Clock(Instant::now())
    }

    fn lap(&mut self) -> f64 {
        let lap = self.0.elapsed().as_secs_f64() * 1e3;
        self.0 = Instant::now();
        lap
    }
}
