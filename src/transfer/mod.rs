//! Transfer functions: from data values to optical properties.
//!
//! A value is normalised to 0..1 over the field's range. Opacity α per reference length Δ (in voxels of the data grid, times
//! their mean spacing) becomes extinction by inverting Beer–Lambert's law, `σ_t = −ln(1 − α)/Δ`, so that the same medium
//! comes out whatever the sampling distance. The single-scattering albedo is `ω = albedo · c`, c the colour of the map in
//! scene-linear light, extinction of a colour channel is `σ_t` times its factor in `chromatic`, and emission is a curve of radiance per reference length times c.

mod colormap;
mod graded;
mod region;
mod surface;
mod table;

pub use colormap::names;
pub use graded::Graded;
pub use surface::surfaces;
pub use table::{Optics, Table};

use crate::error::Result;
use crate::scene::{RegionKeys, TransferKeys};
use colormap::Colormap;
use region::{Painting, Spot};

/// Opacity when the scene says nothing: nothing at the bottom of the range, half at the top.
const DEFAULT_OPACITY: [[f32; 2]; 2] = [[0.0, 0.0], [1.0, 0.5]];
/// Opacity 1 would be infinite extinction; beyond this, less than a millionth of the light passes a reference length.
const LARGEST_OPACITY: f64 = 1.0 - 1e-6;

/// A transfer function, independent of the range of the values and of the grid.
#[derive(Debug, Clone)]
pub struct TransferFunction {
    colors: Colormap,
    albedo: [f32; 3],
    density: Density,
    /// Factor on extinction of the channel that dims most, and of each channel against it.
    strongest: f64,
    chromatic: [f32; 3],
    /// `[value, radiance per reference length]`; empty when nothing glows.
    emission: Vec<[f32; 2]>,
    /// Reference length in mean spacings.
    reference: f64,
    /// What is seen of parts of the plane of value and gradient magnitude.
    regions: Vec<RegionKeys>,
    painting: Option<Painting>,
    /// Gradient magnitude that is 1 in that plane: ranges of values per mean spacing.
    steepest: f64,
    /// Whether the curves over values alone count beside the regions.
    plain: bool,
    preintegrated: bool,
}

#[derive(Debug, Clone)]
enum Density {
    /// `[value, opacity per reference length]`
    Opacity(Vec<[f32; 2]>),
    /// Extinction per world length at value 1, linear in the value.
    Extinction(f64),
}

impl TransferFunction {
    /// The transfer function that a scene's `[transfer]` describes.
    ///
    /// Named maps are sRGB colours and are turned into linear light; `points` are linear already, since they are read as
    /// albedos.
    ///
    /// # Errors
    /// [`Error::Scene`](crate::Error::Scene) for an unknown colour map, naming the nearest and all known. Ranges of numbers
    /// are checked by [`Scene::validate`](crate::scene::Scene::validate).
    pub fn new(keys: &TransferKeys) -> Result<Self> {
        let colors = match &keys.points {
            Some(points) => Colormap::from_points(points.clone()),
            None => Colormap::named(&keys.colormap)?,
        };
        let density = match keys.extinction {
            Some(extinction) => Density::Extinction(extinction),
            None => Density::Opacity(keys.opacity.clone().unwrap_or(DEFAULT_OPACITY.to_vec())),
        };
        let strongest = keys.chromatic.into_iter().fold(0.0, f32::max);
        let glows = keys.emission.iter().any(|p| p[1] > 0.0);
        Ok(TransferFunction {
            colors,
            albedo: keys.albedo.rgb(),
            density,
            strongest: strongest.into(),
            chromatic: keys.chromatic.map(|k| k / strongest),
            emission: if glows { keys.emission.clone() } else { vec![] },
            reference: keys.reference,
            regions: keys.regions.clone(),
            painting: keys.painting.as_deref().map(Painting::read).transpose()?,
            steepest: keys.steepest,
            plain: keys.opacity.is_some() || keys.extinction.is_some() || !keys.two_dimensional(),
            preintegrated: keys.preintegrated,
        })
    }

    /// The table for values in `range` on a grid with `mean_spacing` (world length, [`Grid::mean_spacing`](crate::Grid)).
    ///
    /// Its [`Table::ENTRIES`] entries resolve a thousandth of the range: where a curve jumps, the table climbs within one
    /// entry, and a peak narrower than that keeps its height at the nearest entry.
    pub fn table(&self, range: [f64; 2], mean_spacing: f64) -> Table {
        let length = self.reference * mean_spacing;
        let extinction = match &self.density {
            Density::Extinction(largest) => normalised().map(|v| (v * largest * self.strongest) as f32).collect(),
            Density::Opacity(points) => {
                let sigma = |alpha| (self.strongest * extinction(alpha) / length) as f32;
                tabulate(points).into_iter().map(sigma).collect()
            }
        };
        let colors: Vec<[f32; 3]> = normalised().map(|v| self.colors.linear(v as f32)).collect();
        let emission = match self.emission.is_empty() {
            true => vec![],
            false => (tabulate(&self.emission).into_iter().zip(&colors))
                .map(|(radiance, c)| c.map(|c| (radiance / length) as f32 * c))
                .collect(),
        };
        let albedo = colors.iter().map(|c| std::array::from_fn(|i| self.albedo[i] * c[i])).collect();
        let (lo, hi) = (range[0] as f32, range[1] as f32);
        let table = Table {
            lo,
            hi,
            extinction,
            chromatic: self.chromatic,
            albedo,
            emission,
            graded: None,
            preintegrated: self.preintegrated,
        };
        if self.regions.is_empty() && self.painting.is_none() {
            return table;
        }
        let graded = self.graded(&table, length, (self.steepest * (range[1] - range[0]) / mean_spacing) as f32);
        let (extinction, albedo, emission) = graded.envelope();
        Table { extinction, albedo, emission, graded: Some(graded), ..table }
    }

    /// The plane of value and gradient magnitude: what is seen of the curves, of each region and of the painting adds up as media
    /// do, each with its own albedo.
    fn graded(&self, curves: &Table, length: f64, steepest: f32) -> Graded {
        let (width, height) = (Table::ENTRIES, Graded::ROWS);
        let mut graded = Graded {
            steepest,
            extinction: Vec::with_capacity(width * height),
            albedo: Vec::with_capacity(width * height),
            emission: Vec::with_capacity(width * height),
        };
        for j in 0..height {
            let gradient = j as f32 / (height - 1) as f32;
            for i in 0..width {
                let value = i as f32 / (width - 1) as f32;
                let spots = self.regions.iter().map(|keys| region::spot(keys, value, gradient));
                let painted = self.painting.iter().map(|painting| painting.spot(value, gradient));
                let base = if self.plain { curves.extinction[i] } else { 0.0 };
                let (mut sigma, mut scattering) = (base, curves.albedo[i].map(|a| base * a));
                let mut glow = curves.emission.get(i).copied().unwrap_or_default();
                for Spot { opacity, color, emission } in spots.chain(painted) {
                    let more = (self.strongest * extinction(opacity.into()) / length) as f32;
                    sigma += more;
                    for c in 0..3 {
                        scattering[c] += more * self.albedo[c] * color[c];
                        glow[c] += (f64::from(emission) / length) as f32 * color[c];
                    }
                }
                graded.extinction.push(sigma);
                let albedo = if sigma == base { curves.albedo[i] } else { scattering.map(|s| s / sigma) };
                graded.albedo.push(albedo.map(|a: f32| a.min(1.0)));
                graded.emission.push(glow);
            }
        }
        graded::spread_colors(&graded.extinction, &mut graded.albedo);
        if graded.emission.iter().flatten().all(|e| *e == 0.0) {
            graded.emission.clear();
        }
        graded
    }

    /// Colour, sRGB in 0..1, and opacity per reference length of a value and a gradient magnitude, both 0..1, as pictures of the
    /// transfer function show them.
    pub fn swatch(&self, value: f32, gradient: f32) -> ([f32; 3], f32) {
        let spots = self.regions.iter().map(|keys| region::spot(keys, value, gradient));
        let spots = spots.chain(self.painting.iter().map(|painting| painting.spot(value, gradient)));
        let curve = match &self.density {
            _ if !self.plain => 0.0,
            Density::Opacity(points) => interpolate(points, value.into()) as f32,
            // Per mean spacing of 1.
            Density::Extinction(largest) => -(-(f64::from(value) * largest * self.reference)).exp_m1() as f32,
        };
        let (mut clear, mut color, mut weight) = (1.0 - curve, self.colors.linear(value).map(|c| c * curve), curve);
        for Spot { opacity, color: of, .. } in spots {
            clear *= 1.0 - opacity;
            weight += opacity;
            (0..3).for_each(|c| color[c] += opacity * of[c]);
        }
        (colormap::encoded(color.map(|v| if weight > 0.0 { v / weight } else { 0.0 })), 1.0 - clear)
    }

    /// The map's colours from value 0 to 1, sRGB in 0..1, as a colour bar shows them.
    pub fn colors(&self) -> [[f32; 3]; 256] {
        std::array::from_fn(|i| self.colors.srgb(i as f32 / 255.0))
    }
}

/// Optical depth of a reference length with opacity `alpha`.
fn extinction(alpha: f64) -> f64 {
    -(-alpha.min(LARGEST_OPACITY)).ln_1p()
}

/// Normalised values of a table's entries.
fn normalised() -> impl Iterator<Item = f64> {
    (0..Table::ENTRIES).map(|i| i as f64 / (Table::ENTRIES - 1) as f64)
}

/// A piecewise linear curve at the entries of a table. Peaks between entries move to the nearest one, so that a feature
/// narrower than an entry is not lost.
fn tabulate(points: &[[f32; 2]]) -> Vec<f64> {
    let mut entries: Vec<f64> = normalised().map(|v| interpolate(points, v)).collect();
    for (i, &[at, height]) in points.iter().enumerate() {
        let before = i.checked_sub(1).map_or(height, |i| points[i][1]);
        let after = points.get(i + 1).map_or(height, |p| p[1]);
        if height >= before && height >= after {
            let entry = &mut entries[(f64::from(at) * (Table::ENTRIES - 1) as f64).round() as usize];
            *entry = entry.max(f64::from(height));
        }
    }
    entries
}

/// Linear between points, constant beyond the first and last; the later point where two share a value.
fn interpolate(points: &[[f32; 2]], at: f64) -> f64 {
    let after = points.partition_point(|p| f64::from(p[0]) <= at);
    match (after.checked_sub(1).map(|i| points[i]), points.get(after)) {
        (Some([x0, y0]), Some(&[x1, y1])) => {
            let [x0, y0, x1, y1] = [x0, y0, x1, y1].map(f64::from);
            y0 + (y1 - y0) * (at - x0) / (x1 - x0)
        }
        (Some(p), None) => f64::from(p[1]),
        (None, Some(p)) => f64::from(p[1]),
        (None, None) => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;
    use approx::assert_relative_eq;
    use proptest::prelude::*;

    fn function(change: impl FnOnce(&mut TransferKeys)) -> TransferFunction {
        let mut keys = TransferKeys {
            colormap: "white".into(),
            albedo: crate::scene::NumberOrRgb::Number(1.0),
            ..Default::default()
        };
        change(&mut keys);
        TransferFunction::new(&keys).unwrap()
    }

    proptest! {
        /// validation.md 2 and 11: opacity → extinction → opacity is the identity, and the same medium comes out whatever
        /// the reference length, its opacity corrected by `1 − (1 − α)^n`.
        #[test]
        fn opacity_survives_the_way_through_extinction(alpha in 0.0f32..0.999, reference in 0.1f64..20.0, spacing in 0.01f64..50.0) {
            let table = function(|k| { k.opacity = Some(vec![[0.0, alpha]]); k.reference = reference; }).table([0.0, 1.0], spacing);
            let sigma = f64::from(table.extinction[517]);
            prop_assert!((1.0 - (-sigma * reference * spacing).exp() - f64::from(alpha)).abs() < 1e-6);
            let twice = 1.0 - (1.0 - f64::from(alpha)).powi(2);
            let longer = function(|k| { k.opacity = Some(vec![[0.0, twice as f32]]); k.reference = 2.0 * reference; }).table([0.0, 1.0], spacing);
            // What rounding to f32 does to an opacity, on its way through the logarithm.
            let rounding = 2f64.powi(-24) * twice / (1.0 - twice) / -(1.0 - twice).ln();
            prop_assert!((f64::from(longer.extinction[517]) / sigma.max(1e-30) - 1.0).abs() < 1e-6 + rounding || sigma * reference * spacing < 1e-4);
        }
    }

    #[test]
    fn extinction_is_linear_in_the_value_and_ignores_the_grid() {
        let table = function(|k| k.extinction = Some(30.0)).table([-2.0, 2.0], 7.0);
        for i in [0, 1, 511, 1023] {
            assert_relative_eq!(table.extinction[i], 30.0 * i as f32 / 1023.0, max_relative = 1e-6);
        }
        assert_eq!((table.lo, table.hi), (-2.0, 2.0));
    }

    #[test]
    fn full_opacity_is_finite_and_black_to_a_millionth() {
        let table = function(|k| k.opacity = Some(vec![[0.0, 1.0]])).table([0.0, 1.0], 1.0);
        assert_relative_eq!((-table.extinction[3]).exp(), 1e-6, max_relative = 1e-3);
    }

    #[test]
    fn the_default_opacity_halves_the_light_per_voxel_at_the_top() {
        let table = function(|_| ()).table([0.0, 1.0], 0.25);
        assert_eq!(table.extinction[0], 0.0);
        assert_relative_eq!(table.extinction[1023], std::f32::consts::LN_2 / 0.25, max_relative = 1e-6);
    }

    #[test]
    fn jumps_take_one_entry_and_narrow_peaks_keep_their_height() {
        let step =
            function(|k| k.opacity = Some(vec![[0.0, 0.0], [0.4, 0.0], [0.4, 0.5], [1.0, 0.5]])).table([0.0, 1.0], 1.0);
        let rising = step.extinction.windows(2).filter(|w| w[0] != w[1]).count();
        assert_eq!(rising, 1, "a jump takes one entry");
        assert_eq!(step.extinction[408], 0.0);
        assert_relative_eq!(step.extinction[410], std::f32::consts::LN_2, max_relative = 1e-6);

        let peak = vec![[0.0, 0.0], [0.6003, 0.0], [0.6004, 0.5], [0.6005, 0.0], [1.0, 0.0]];
        let peak = function(|k| k.opacity = Some(peak)).table([0.0, 1.0], 1.0);
        assert_relative_eq!(peak.extinction[614], std::f32::consts::LN_2, max_relative = 1e-6);
        assert_eq!(peak.extinction.iter().filter(|s| **s > 0.0).count(), 1);
    }

    #[test]
    fn emission_is_per_reference_length_in_the_maps_colour() {
        let red_to_blue = vec![[0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 1.0]];
        let table = function(|k| {
            k.points = Some(red_to_blue);
            k.emission = vec![[0.0, 6.0], [1.0, 12.0]];
            k.reference = 2.0;
        })
        .table([0.0, 1.0], 1.5);
        assert_eq!(table.emission[0], [2.0, 0.0, 0.0]);
        assert_eq!(table.emission[1023], [0.0, 0.0, 4.0]);
        assert!(function(|k| k.emission = vec![[0.0, 0.0], [1.0, 0.0]]).table([0.0, 1.0], 1.0).emission.is_empty());
    }

    #[test]
    fn albedo_is_the_key_times_the_linear_colour() {
        let gray = function(|k| {
            k.colormap = "gray".into();
            k.albedo = crate::scene::NumberOrRgb::Rgb([1.0, 0.5, 0.25]);
        });
        let table = gray.table([0.0, 1.0], 1.0);
        assert_eq!(table.albedo[1023], [1.0, 0.5, 0.25]);
        // The sRGB curve at 512/1023: ((v + 0.055)/1.055)^2.4.
        let linear = ((512.0f32 / 1023.0 + 0.055) / 1.055).powf(2.4);
        assert_relative_eq!(table.albedo[512][0], linear, max_relative = 1e-3);
        assert_eq!(function(|_| ()).table([0.0, 1.0], 1.0).constant_albedo(), Some([1.0; 3]));
        assert!(gray.colors()[51].iter().all(|c| (c - 0.2).abs() < 1e-3));
    }

    #[test]
    fn an_unknown_map_names_the_nearest_and_all_known() {
        let error =
            TransferFunction::new(&TransferKeys { colormap: "infernal".into(), ..Default::default() }).unwrap_err();
        let Error::Scene { key, message, .. } = &error else { panic!("{error}") };
        assert_eq!(key, "transfer.colormap");
        assert!(message.contains("`inferno`") && message.contains("viridis") && message.contains("turbo"), "{message}");
    }
}
