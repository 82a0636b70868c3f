//! What a scene may say: ranges of values, and combinations that this version does.

use std::fmt::Debug;

use super::allowed::allowed;
use super::area;
use super::{
    AttenuationKey, CameraKeys, ClipKeys, ComponentKey, Falloff, FieldKeys, InSituKeys, LightKeys, LightKind, MeshKeys,
    Model, MovieKeys, NoiseKeys, PathtraceKeys, RangeKey, RenderKeys, RenderKind, Scene, SlicesKeys, SolverKeys,
    TextureKind, TransferKeys,
};
use crate::error::{Error, Result};
use crate::transfer::TransferFunction;

/// Smallest tolerance other than 0: about eight units in the last place of the brightest light.
const SMALLEST_TOLERANCE: f32 = 1e-6;

impl Scene {
    /// Refuses area lights where points on their surface would not do.
    fn area_lights(&self) -> Result<()> {
        if self.render.kind == RenderKind::Pathtrace {
            return Ok(());
        }
        for (i, keys) in self.lights.iter().enumerate().filter(|(_, keys)| keys.kind.is_area()) {
            let (why, instead) = if self.light.model == Model::Paper && self.light.falloff != Falloff::Physical {
                ("the paper's Gaussian does not tell how much light an area gives", "light.falloff = \"physical\", or ")
            } else if keys.kind == LightKind::Sphere && keys.texture != TextureKind::Uniform {
                ("points that stand for a textured ball would shine alike to all sides", "")
            } else {
                continue;
            };
            let kind = format!("{:?}", keys.kind).to_lowercase();
            return Err(Error::Unsupported(format!(
                "lights.{i}.kind = \"{kind}\" with these settings: {why}\n  try: {instead}render.kind = \"pathtrace\""
            )));
        }
        Ok(())
    }

    /// Refuses values outside their range ([`Error::Scene`], naming the key and the range) and what this version does not
    /// do ([`Error::Unsupported`], naming what works).
    pub fn validate(&self) -> Result<()> {
        field(&self.field)?;
        noise(&self.noise)?;
        transfer(&self.transfer)?;
        self.lights.iter().enumerate().try_for_each(|(i, keys)| light(i, keys))?;
        self.meshes.iter().enumerate().try_for_each(|(i, keys)| mesh(i, keys))?;
        if !self.meshes.is_empty() && self.light.model == Model::Paper {
            return Err(Error::Unsupported(
                "[[meshes]] in the paper's model\n  try: light.model = \"physical\"".into(),
            ));
        }
        if self.light.model == Model::Paper && self.transfer.chromatic.iter().any(|k| *k != self.transfer.chromatic[0])
        {
            return Err(Error::Unsupported(format!(
                "transfer.chromatic = {:?} in the paper's model, which has one extinction for all colours\n  try: light.model = \"physical\"",
                self.transfer.chromatic
            )));
        }
        self.area_lights()?;
        self.clip.iter().enumerate().try_for_each(|(i, keys)| clip(i, keys))?;
        solver(&self.light)?;
        self.cameras.iter().enumerate().try_for_each(|(i, keys)| camera(i, keys, self.render.kind))?;
        for (i, keys) in self.cameras.iter().enumerate() {
            let unique = self.cameras[..i].iter().all(|other| other.name != keys.name);
            require(unique, &format!("cameras.{i}.name"), &keys.name)?;
        }
        render(&self.render)?;
        pathtrace(&self.pathtrace)?;
        slices(&self.slices)?;
        let by_values =
            self.render.kind == RenderKind::Isosurface && matches!(self.isosurface.attenuation, AttenuationKey::By(_));
        if by_values && self.transfer.two_dimensional() {
            return Err(Error::Unsupported(
                "isosurface.attenuation = \"transfer\" with transfer.regions or transfer.painting\n  try: a number or [red, green, blue]"
                    .into(),
            ));
        }
        if self.render.preview > 1 && self.transfer.two_dimensional() {
            return Err(Error::Unsupported(
                "render.preview with transfer.regions or transfer.painting\n  try: render.preview = 1, or transfer.opacity alone"
                    .into(),
            ));
        }
        if self.pathtrace.replay && (self.render.target_error.is_some() || self.render.budget_ms.is_some()) {
            return Err(Error::Unsupported(
                "pathtrace.replay with render.target_error or render.budget_ms, by which steps differ in their samples\n  try: render.samples \
                 alone, or pathtrace.replay = false"
                    .into(),
            ));
        }
        self.isosurface.validate()?;
        movie(&self.movie)?;
        insitu(&self.insitu)
    }
}

pub(super) fn require(holds: bool, key: &str, value: impl Debug) -> Result<()> {
    if holds { Ok(()) } else { Err(Error::scene(key, format!("{value:?} is not allowed; allowed: {}", allowed(key)))) }
}

fn unit(v: f32) -> bool {
    (0.0..=1.0).contains(&v)
}

pub(super) fn nonnegative(v: f32) -> bool {
    v >= 0.0 && v.is_finite()
}

fn finite3(v: [f64; 3]) -> bool {
    v.iter().all(|c| c.is_finite())
}

pub(super) fn direction(v: [f64; 3]) -> bool {
    finite3(v) && v.iter().any(|c| *c != 0.0)
}

fn field(keys: &FieldKeys) -> Result<()> {
    if let RangeKey::Fixed([lo, hi]) = keys.range {
        require(lo < hi && lo.is_finite() && hi.is_finite(), "field.range", [lo, hi])?;
    }
    if let ComponentKey::Name(name) = &keys.component {
        require(matches!(name.as_str(), "magnitude" | "x" | "y" | "z"), "field.component", name)?;
    }
    Ok(())
}

fn ascending<const N: usize>(points: &[[f32; N]]) -> bool {
    !points.is_empty() && points.windows(2).all(|w| w[0][0] <= w[1][0]) && points.iter().all(|p| unit(p[0]))
}

fn transfer(keys: &TransferKeys) -> Result<()> {
    require(keys.reference > 0.0 && keys.reference.is_finite(), "transfer.reference", keys.reference)?;
    if let Some(points) = &keys.points {
        require(ascending(points) && points.iter().flatten().all(|v| unit(*v)), "transfer.points", points)?;
    }
    if let Some(points) = &keys.opacity {
        require(ascending(points) && points.iter().flatten().all(|v| unit(*v)), "transfer.opacity", points)?;
    }
    if let Some(extinction) = keys.extinction {
        require(extinction >= 0.0 && extinction.is_finite(), "transfer.extinction", extinction)?;
        if keys.opacity.is_some() {
            return Err(Error::scene("transfer.extinction", "it replaces transfer.opacity: give only one of the two"));
        }
    }
    let dims = keys.chromatic.into_iter().all(nonnegative) && keys.chromatic.into_iter().any(|k| k > 0.0);
    require(dims, "transfer.chromatic", keys.chromatic)?;
    require(keys.albedo.rgb().into_iter().all(unit), "transfer.albedo", keys.albedo.rgb())?;
    require(keys.anisotropy.abs() < 1.0, "transfer.anisotropy", keys.anisotropy)?;
    if !keys.emission.is_empty() {
        let radiance = keys.emission.iter().all(|p| nonnegative(p[1]));
        require(ascending(&keys.emission) && radiance, "transfer.emission", &keys.emission)?;
    }
    require(keys.steepest > 0.0 && keys.steepest.is_finite(), "transfer.steepest", keys.steepest)?;
    for (i, region) in keys.regions.iter().enumerate() {
        let span = |[a, b]: [f32; 2]| unit(a) && unit(b) && a <= b;
        let wrong = [
            ("value", !span(region.value), "[least, largest], both 0 to 1"),
            ("gradient", !span(region.gradient), "[least, largest], both 0 to 1"),
            ("opacity", !unit(region.opacity), "a number from 0 to 1"),
            ("color", !region.color.into_iter().all(unit), "[red, green, blue], each 0 to 1"),
            ("emission", !nonnegative(region.emission), "a finite number, 0 or more"),
            ("edge", !unit(region.edge), "a number from 0 to 1"),
        ];
        if let Some((name, _, words)) = wrong.into_iter().find(|(_, wrong, _)| *wrong) {
            return Err(Error::scene(format!("transfer.regions.{i}.{name}"), format!("not allowed; allowed: {words}")));
        }
    }
    if keys.preintegrated && keys.two_dimensional() {
        return Err(Error::Unsupported(
            "transfer.preintegrated with transfer.regions or transfer.painting\n  try: one of the two".into(),
        ));
    }
    let parts = [("diffuse", &keys.diffuse), ("specular", &keys.specular), ("roughness", &keys.roughness)];
    for (name, points) in parts {
        require(ascending(points) && points.iter().all(|p| unit(p[1])), &format!("transfer.{name}"), points)?;
    }
    let ior = keys.ior.iter().all(|p| (1.0..=10.0).contains(&p[1]));
    require(ascending(&keys.ior) && ior, "transfer.ior", &keys.ior)?;
    // A painting is read when the session starts.
    TransferFunction::new(&TransferKeys { painting: None, ..keys.clone() }).map(drop)
}

fn light(i: usize, keys: &LightKeys) -> Result<()> {
    area::validate(i, keys)?;
    let key = |name: &str| format!("lights.{i}.{name}");
    require(direction(keys.direction), &key("direction"), keys.direction)?;
    require(finite3(keys.position), &key("position"), keys.position)?;
    require(keys.radius >= 0.0 && keys.radius.is_finite(), &key("radius"), keys.radius)?;
    require(keys.angle > 0.0 && keys.angle <= 90.0, &key("angle"), keys.angle)?;
    require((0.0..=keys.angle).contains(&keys.edge), &key("edge"), keys.edge)?;
    require(keys.color.into_iter().all(nonnegative), &key("color"), keys.color)?;
    require(nonnegative(keys.intensity), &key("intensity"), keys.intensity)?;
    require((0.0..=90.0).contains(&keys.softness), &key("softness"), keys.softness)?;
    require(matches!(keys.samples, 1 | 7 | 19), &key("samples"), keys.samples)
}

fn clip(i: usize, keys: &ClipKeys) -> Result<()> {
    let key = |name: &str| format!("clip.{i}.{name}");
    require((0..3).all(|a| keys.min[a] < keys.max[a]), &key("max"), keys.max)?;
    require(finite3(keys.point), &key("point"), keys.point)?;
    require(direction(keys.normal), &key("normal"), keys.normal)
}

fn solver(keys: &SolverKeys) -> Result<()> {
    for (key, value) in [("light.resolution", keys.resolution), ("light.direct_resolution", keys.direct_resolution)] {
        let fraction = value > 0.0 && value <= 1.0;
        require(fraction || ((2.0..=4096.0).contains(&value) && value.fract() == 0.0), key, value)?;
    }
    require(matches!(keys.directions, 8 | 32 | 128), "light.directions", keys.directions)?;
    require(keys.sigma_s.into_iter().all(nonnegative), "light.sigma_s", keys.sigma_s)?;
    require((1..=10_000).contains(&keys.iterations), "light.iterations", keys.iterations)?;
    if let Some(passes) = keys.passes {
        require((2..=10_000).contains(&passes), "light.passes", passes)?;
    }
    if let Some(budget) = keys.budget_ms {
        require(budget > 0.0 && budget.is_finite(), "light.budget_ms", budget)?;
    }
    if let Some(width) = keys.width {
        require(width > 0.0 && width.is_finite(), "light.width", width)?;
    }
    let tolerance = keys.tolerance;
    require(tolerance == 0.0 || (SMALLEST_TOLERANCE..=1.0).contains(&tolerance), "light.tolerance", tolerance)
}

fn camera(i: usize, keys: &CameraKeys, kind: RenderKind) -> Result<()> {
    let key = |name: &str| format!("cameras.{i}.{name}");
    require(!keys.name.is_empty() && !keys.name.contains(['/', '\\']), &key("name"), &keys.name)?;
    require(keys.azimuth.is_finite(), &key("azimuth"), keys.azimuth)?;
    require((-90.0..=90.0).contains(&keys.elevation), &key("elevation"), keys.elevation)?;
    require(keys.zoom > 0.0 && keys.zoom.is_finite(), &key("zoom"), keys.zoom)?;
    require((1.0..=170.0).contains(&keys.fov), &key("fov"), keys.fov)?;
    require(direction(keys.up), &key("up"), keys.up)?;
    require(keys.orbit.is_finite(), &key("orbit"), keys.orbit)?;
    require(keys.target.is_none_or(finite3), &key("target"), keys.target)?;
    require(keys.position.is_none_or(finite3), &key("position"), keys.position)?;
    if let (Some(position), Some(target)) = (keys.position, keys.target) {
        let view = glam::DVec3::from(target) - glam::DVec3::from(position);
        require(view.length() > 0.0, &key("position"), position)?;
        let across = view.normalize().cross(glam::DVec3::from(keys.up).normalize());
        require(across.length() > 1e-6, &key("up"), keys.up)?;
    }
    require(keys.aperture >= 0.0 && keys.aperture.is_finite(), &key("aperture"), keys.aperture)?;
    require(keys.focus.is_none_or(|f| f > 0.0 && f.is_finite()), &key("focus"), keys.focus)?;
    require(matches!(keys.blades, 0 | 3..=64), &key("blades"), keys.blades)?;
    if keys.aperture > 0.0 && kind != RenderKind::Pathtrace {
        return Err(Error::Unsupported(format!(
            "{} = {}: depth of field needs render.kind = \"pathtrace\"\n  try: that, or leave it 0",
            key("aperture"),
            keys.aperture
        )));
    }
    Ok(())
}

fn render(keys: &RenderKeys) -> Result<()> {
    require(keys.size.iter().all(|n| (1..=16384).contains(n)), "render.size", keys.size)?;
    require(keys.step > 0.0 && keys.step <= 16.0, "render.step", keys.step)?;
    require((1..=64).contains(&keys.preview), "render.preview", keys.preview)?;
    require(keys.samples > 0, "render.samples", keys.samples)?;
    let above_zero = |v: f64| v > 0.0 && v.is_finite();
    require(keys.target_error.is_none_or(above_zero), "render.target_error", keys.target_error)?;
    require(keys.budget_ms.is_none_or(above_zero), "render.budget_ms", keys.budget_ms)?;
    require(nonnegative(keys.ambient), "render.ambient", keys.ambient)?;
    require(nonnegative(keys.diffuse), "render.diffuse", keys.diffuse)?;
    require(nonnegative(keys.specular), "render.specular", keys.specular)?;
    require(nonnegative(keys.shininess) && keys.shininess > 0.0, "render.shininess", keys.shininess)?;
    require(keys.background.into_iter().all(nonnegative), "render.background", keys.background)?;
    require(nonnegative(keys.exposure) && keys.exposure > 0.0, "render.exposure", keys.exposure)
}

fn pathtrace(keys: &PathtraceKeys) -> Result<()> {
    require(keys.depth.is_none_or(|d| (1..=100_000).contains(&d)), "pathtrace.depth", keys.depth)?;
    require(unit(keys.gradient_factor), "pathtrace.gradient_factor", keys.gradient_factor)?;
    require((0.0..=8.0).contains(&keys.filter), "pathtrace.filter", keys.filter)
}

fn slices(keys: &SlicesKeys) -> Result<()> {
    if let Some(resolution) = keys.resolution {
        require(resolution > 0.0 && resolution <= 8.0, "slices.resolution", resolution)?;
    }
    require(keys.attenuation.rgb().into_iter().all(nonnegative), "slices.attenuation", keys.attenuation.rgb())?;
    require((0.0..=120.0).contains(&keys.blur), "slices.blur", keys.blur)
}

fn movie(keys: &MovieKeys) -> Result<()> {
    require(keys.fps > 0.0 && keys.fps <= 1000.0, "movie.fps", keys.fps)?;
    if let Some(seconds) = keys.seconds_per_time_unit {
        require(seconds > 0.0 && seconds.is_finite(), "movie.seconds_per_time_unit", seconds)?;
    }
    require(keys.quality <= 51, "movie.quality", keys.quality)
}

fn mesh(i: usize, keys: &MeshKeys) -> Result<()> {
    let key = |name: &str| format!("meshes.{i}.{name}");
    require(!keys.path.as_os_str().is_empty(), &key("path"), &keys.path)?;
    require(keys.color.into_iter().all(unit), &key("color"), keys.color)?;
    require(keys.scale > 0.0 && keys.scale.is_finite(), &key("scale"), keys.scale)?;
    require(finite3(keys.rotate), &key("rotate"), keys.rotate)?;
    require(finite3(keys.position), &key("position"), keys.position)
}

fn noise(keys: &NoiseKeys) -> Result<()> {
    let from_zero = |v: f64| v >= 0.0 && v.is_finite();
    require(from_zero(keys.amplitude), "noise.amplitude", keys.amplitude)?;
    require(keys.about.is_finite(), "noise.about", keys.about)?;
    require((0.0..=64.0).contains(&keys.warp), "noise.warp", keys.warp)?;
    require(from_zero(keys.scale) && keys.scale > 0.0, "noise.scale", keys.scale)?;
    require((1..=16).contains(&keys.octaves), "noise.octaves", keys.octaves)?;
    require((0.0..=1.0).contains(&keys.gain), "noise.gain", keys.gain)?;
    require(finite3(keys.drift), "noise.drift", keys.drift)?;
    require((1..=8).contains(&keys.refine), "noise.refine", keys.refine)
}

fn insitu(keys: &InSituKeys) -> Result<()> {
    require(keys.threads <= 4096, "insitu.threads", keys.threads)?;
    require(keys.cores.iter().all(|c| *c < 1024), "insitu.cores", &keys.cores)?;
    require((1..=1024).contains(&keys.queue), "insitu.queue", keys.queue)?;
    require(keys.every > 0, "insitu.every", keys.every)?;
    let often = keys.light_state_every.is_none_or(|n| n > 0 && keys.light_state.is_some());
    require(often, "insitu.light_state_every", keys.light_state_every.unwrap_or(0))?;
    let above_zero = |v: f64| v > 0.0 && v.is_finite();
    require(keys.every_time.is_none_or(above_zero), "insitu.every_time", keys.every_time)?;
    require(keys.light_change.is_none_or(above_zero), "insitu.light_change", keys.light_change)
}
