//! Keys of `[[lights]]` that area lights take.

use serde::{Deserialize, Serialize};

use super::validate::{direction, nonnegative, require};
use super::{LightKeys, LightKind};
use crate::error::{Error, Result};

/// `lights.units`: what `color` times `intensity` of an area light is, per channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Units {
    /// Radiance of its surface: a larger light is brighter as a whole.
    Radiance,
    /// Power of the whole light: π · area · radiance, of all sides that shine.
    Power,
    /// Power per area (flux): π · radiance.
    #[serde(alias = "flux")]
    Exitance,
    /// Radiant intensity: along its direction for flat lights, area · radiance; in the mean over all directions, power/4π, for
    /// boxes and spheres. From far away it is as a point light of that intensity there.
    Intensity,
}

/// `lights.texture`: how the surface of an area light varies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TextureKind {
    /// `color` everywhere.
    Uniform,
    /// Fields of `color` and `second_color`, `tiles` of them.
    Checker,
    /// From `color` at the lower edge to `second_color` at the upper one.
    Gradient,
    /// `image`, times `color`.
    Bitmap,
}

impl LightKind {
    /// True for lights with a surface.
    pub fn is_area(self) -> bool {
        matches!(self, Self::Rectangle | Self::Disk | Self::Ring | Self::Box | Self::Sphere)
    }
}

/// Refuses what an area light cannot be, and keys of area lights elsewhere.
pub(super) fn validate(i: usize, keys: &LightKeys) -> Result<()> {
    let key = |name: &str| format!("lights.{i}.{name}");
    let kind = keys.kind;
    let (area, flat) = (kind.is_area(), matches!(kind, LightKind::Rectangle | LightKind::Disk | LightKind::Ring));
    let plain = LightKeys::default();
    // A key that would be ignored is a mistake.
    let takes = |takes: bool, name: &str, given: bool, who: &str| match given && !takes {
        true => Err(Error::scene(key(name), format!("a {kind:?} light does not take it; {who} do").to_lowercase())),
        false => Ok(()),
    };
    let textured = |kinds: &[TextureKind]| area && kinds.contains(&keys.texture);
    takes(area, "units", keys.units != plain.units, "area lights")?;
    takes(area, "texture", keys.texture != plain.texture, "area lights")?;
    takes(area, "up", keys.up != plain.up, "area lights")?;
    takes(flat, "two_sided", keys.two_sided, "rectangles, disks and rings")?;
    let sized = matches!(kind, LightKind::Rectangle | LightKind::Box);
    takes(sized, "size", !keys.size.is_empty(), "rectangles and boxes")?;
    takes(kind == LightKind::Ring, "inner_radius", keys.inner_radius != 0.0, "rings")?;
    let second = textured(&[TextureKind::Checker, TextureKind::Gradient]);
    takes(second, "second_color", keys.second_color != plain.second_color, "textures \"checker\" and \"gradient\"")?;
    takes(textured(&[TextureKind::Checker]), "tiles", keys.tiles != plain.tiles, "textures \"checker\"")?;
    takes(kind == LightKind::Environment, "gradient", keys.gradient.is_some(), "environments")?;
    let pictured = kind == LightKind::Environment || textured(&[TextureKind::Bitmap]);
    require(keys.image.is_none() || pictured, &key("image"), &keys.image)?;
    if let (Some(colors), image) = (keys.gradient, &keys.image) {
        require(colors.into_iter().flatten().all(nonnegative), &key("gradient"), colors)?;
        require(image.is_none(), &key("gradient"), "with an image")?;
    }
    if !area {
        return Ok(());
    }
    if sized {
        let lengths = if kind == LightKind::Box { 3 } else { 2 };
        let fits = keys.size.len() == lengths && keys.size.iter().all(|v| *v > 0.0 && v.is_finite());
        require(fits, &key("size"), &keys.size)?;
    } else {
        // 0, the default of a point light, has no surface.
        let message = format!("{} is not allowed; a {kind:?} needs a world length above 0", keys.radius);
        if keys.radius == 0.0 {
            return Err(Error::scene(key("radius"), message.to_lowercase()));
        }
    }
    if kind == LightKind::Ring {
        let fits = (0.0..keys.radius).contains(&keys.inner_radius);
        require(fits, &key("inner_radius"), keys.inner_radius)?;
    }
    require(direction(keys.up), &key("up"), keys.up)?;
    require(keys.second_color.into_iter().all(nonnegative), &key("second_color"), keys.second_color)?;
    require(keys.tiles.into_iter().all(|n| (1..=4096).contains(&n)), &key("tiles"), keys.tiles)?;
    if keys.texture == TextureKind::Bitmap && keys.image.is_none() {
        return Err(Error::scene(
            key("image"),
            "texture = \"bitmap\" needs the path of an OpenEXR, Radiance HDR or PNG image",
        ));
    }
    Ok(())
}
