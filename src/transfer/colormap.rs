//! Colour maps: the presets of colorgrad under the names matplotlib and ParaView give them, and colours point by point.

use std::sync::Arc;

use colorgrad::{Gradient, GradientBuilder, LinearGradient, preset};

use crate::error::{Error, Result};
use crate::scene::nearest;

/// Colours over normalised values 0..1.
#[derive(Clone)]
pub(super) enum Colormap {
    /// A preset, in sRGB.
    Named { gradient: Arc<dyn Gradient + Send + Sync>, reversed: bool },
    /// The same colour everywhere: white.
    White,
    /// `[value, red, green, blue]` in linear light.
    Points(Vec<[f32; 4]>),
}

impl std::fmt::Debug for Colormap {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Colormap::Named { reversed, .. } => {
                f.debug_struct("Named").field("reversed", reversed).finish_non_exhaustive()
            }
            Colormap::White => f.write_str("White"),
            Colormap::Points(points) => f.debug_tuple("Points").field(points).finish(),
        }
    }
}

type Build = fn() -> Arc<dyn Gradient + Send + Sync>;

macro_rules! presets {
    ($($name:literal $function:ident),* $(,)?) => { &[$(($name, || Arc::new(preset::$function()))),*] };
}

/// Maps that the crate has, by matplotlib's names.
const PRESETS: &[(&str, Build)] = presets![
    "viridis" viridis, "inferno" inferno, "magma" magma, "plasma" plasma, "cividis" cividis, "turbo" turbo,
    "rainbow" rainbow, "sinebow" sinebow, "cubehelix" cubehelix_default, "cool" cool, "warm" warm, "spectral" spectral,
    "BrBG" br_bg, "PRGn" pr_gn, "PiYG" pi_yg, "PuOr" pu_or, "RdBu" rd_bu, "RdGy" rd_gy, "RdYlBu" rd_yl_bu,
    "RdYlGn" rd_yl_gn, "Blues" blues, "Greens" greens, "Greys" greys, "Oranges" oranges, "Purples" purples, "Reds" reds,
    "BuGn" bu_gn, "BuPu" bu_pu, "GnBu" gn_bu, "OrRd" or_rd, "PuBu" pu_bu, "PuBuGn" pu_bu_gn, "PuRd" pu_rd, "RdPu" rd_pu,
    "YlGn" yl_gn, "YlGnBu" yl_gn_bu, "YlOrBr" yl_or_br, "YlOrRd" yl_or_rd,
];

/// Maps that are a few colours with straight lines between them.
const SIMPLE: &[(&str, &[&str])] = &[
    ("gray", &["#000", "#fff"]),
    ("hot", &["#000", "#f00 36.5%", "#ff0 74.6%", "#fff"]),
    ("jet", &["#00007f", "#00f 11%", "#007fff 25%", "#7fff7f 50%", "#ff7f00 75%", "#f00 89%", "#7f0000"]),
    ("coolwarm", &["#3b4cc0", "#8db0fe 25%", "#dddddd 50%", "#f49a7b 75%", "#b40426"]),
];

/// Other names of the same maps, without spaces, hyphens and underscores; `_r` turns a map round.
const ALIASES: &[(&str, &str)] = &[
    ("grayscale", "gray"),
    ("grey", "gray"),
    ("grays", "Greys"),
    ("xray", "gray_r"),
    ("cooltowarm", "coolwarm"),
    ("coolwarmsmooth", "coolwarm"),
    ("blackbody", "hot"),
    ("blackbodyradiation", "hot"),
];

/// All names of colour maps, without aliases. Each can be turned round by appending `_r`.
pub fn names() -> Vec<&'static str> {
    let simple = SIMPLE.iter().map(|(name, _)| *name);
    std::iter::once("white").chain(PRESETS.iter().map(|(name, _)| *name)).chain(simple).collect()
}

/// A name as it is compared: `Cool to Warm` and `RdBu` as `cooltowarm` and `rdbu`.
fn plain(name: &str) -> String {
    let name = name.to_lowercase().replace("(matplotlib)", "");
    name.chars().filter(|c| c.is_alphanumeric()).collect()
}

impl Colormap {
    /// A map by any of its names.
    pub(super) fn named(name: &str) -> Result<Self> {
        let lower = name.trim().to_lowercase();
        let (stem, reversed) = lower.strip_suffix("_r").map_or((lower.as_str(), false), |stem| (stem, true));
        let stem = plain(stem);
        if let Some((_, other)) = ALIASES.iter().find(|(alias, _)| *alias == stem) {
            let map = Colormap::named(other)?;
            return Ok(if reversed { map.turned() } else { map });
        }
        if stem == "white" {
            return Ok(Colormap::White);
        }
        if let Some((_, build)) = PRESETS.iter().find(|(name, _)| plain(name) == stem) {
            return Ok(Colormap::Named { gradient: build(), reversed });
        }
        if let Some((_, stops)) = SIMPLE.iter().find(|(name, _)| plain(name) == stem) {
            let gradient = GradientBuilder::new().css(&stops.join(", ")).build::<LinearGradient>();
            let gradient = gradient.map_err(|e| Error::scene("transfer.colormap", format!("`{name}`: {e}")))?;
            return Ok(Colormap::Named { gradient: Arc::new(gradient), reversed });
        }
        let known = names();
        let like = nearest(name, known.iter().copied()).unwrap_or_default();
        Err(Error::scene(
            "transfer.colormap",
            format!("unknown colour map `{name}`; did you mean `{like}`? (known: {})", known.join(", ")),
        ))
    }

    /// A map of `[value, red, green, blue]` in linear light, values ascending.
    pub(super) fn from_points(points: Vec<[f32; 4]>) -> Self {
        Colormap::Points(points)
    }

    fn turned(self) -> Self {
        match self {
            Colormap::Named { gradient, reversed } => Colormap::Named { gradient, reversed: !reversed },
            other => other,
        }
    }

    /// Scene-linear colour of a normalised value.
    pub(super) fn linear(&self, at: f32) -> [f32; 3] {
        match self {
            Colormap::White => [1.0; 3],
            Colormap::Named { gradient, reversed } => {
                let [r, g, b, _] = gradient.at(if *reversed { 1.0 - at } else { at }).to_linear_rgba();
                [r, g, b].map(|c| c.clamp(0.0, 1.0))
            }
            Colormap::Points(points) => {
                let after = points.partition_point(|p| p[0] <= at);
                match (after.checked_sub(1).map(|i| points[i]), points.get(after)) {
                    (Some(a), Some(b)) => {
                        let t = (at - a[0]) / (b[0] - a[0]);
                        std::array::from_fn(|c| a[c + 1] + (b[c + 1] - a[c + 1]) * t)
                    }
                    (Some(p), None) => [p[1], p[2], p[3]],
                    (None, Some(p)) => [p[1], p[2], p[3]],
                    (None, None) => [1.0; 3],
                }
            }
        }
    }

    /// sRGB colour of a normalised value.
    pub(super) fn srgb(&self, at: f32) -> [f32; 3] {
        encoded(self.linear(at))
    }
}

/// sRGB of a scene-linear colour.
pub(super) fn encoded([r, g, b]: [f32; 3]) -> [f32; 3] {
    let [r, g, b, _] = colorgrad::Color::from_linear_rgba(r, g, b, 1.0).to_array();
    [r, g, b].map(|c| c.clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_listed_name_and_alias_is_a_map() {
        for name in names().into_iter().chain(ALIASES.iter().map(|(alias, _)| *alias)) {
            let map = Colormap::named(name).unwrap();
            for i in 0..=64 {
                assert!(map.linear(i as f32 / 64.0).iter().all(|c| (0.0..=1.0).contains(c)), "{name}");
            }
        }
    }

    #[test]
    fn names_of_paraview_and_matplotlib_are_understood() {
        for (name, same) in [
            ("Inferno (matplotlib)", "inferno"),
            ("Cool to Warm", "coolwarm"),
            ("X Ray", "gray_r"),
            ("rdbu", "RdBu"),
            ("Rd_Bu_r", "RdBu_r"),
            ("Black-Body Radiation", "hot"),
            ("xray_r", "gray"),
        ] {
            let (a, b) = (Colormap::named(name).unwrap(), Colormap::named(same).unwrap());
            assert_eq!([a.linear(0.1), a.linear(0.8)], [b.linear(0.1), b.linear(0.8)], "{name}");
        }
        let (map, turned) = (Colormap::named("viridis").unwrap(), Colormap::named("viridis_r").unwrap());
        assert_eq!(map.linear(0.25), turned.linear(0.75));
    }

    #[test]
    fn well_known_colours_are_right() {
        let rgb8 = |name: &str, at: f32| Colormap::named(name).unwrap().srgb(at).map(|c| (255.0 * c).round() as i32);
        let near = |a: [i32; 3], b: [i32; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 2);
        // matplotlib's first and last entries.
        assert!(near(rgb8("viridis", 0.0), [68, 1, 84]) && near(rgb8("viridis", 1.0), [253, 231, 37]));
        assert!(near(rgb8("inferno", 0.0), [0, 0, 4]) && near(rgb8("inferno", 1.0), [252, 255, 164]));
        assert!(near(rgb8("coolwarm", 0.0), [59, 76, 192]) && near(rgb8("coolwarm", 1.0), [180, 4, 38]));
        assert!(near(rgb8("gray", 0.5), [128; 3]));
        assert!(near(rgb8("hot", 0.365), [255, 0, 0]));
    }
}
