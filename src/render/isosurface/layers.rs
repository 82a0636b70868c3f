//! Layers of a picture of isosurfaces, and how they make the picture (Rezk-Salama 2007, section 6.4).
//!
//! Surfaces along a ray are numbered from the eye: the first has the layers below, the second the same with a 2 behind their
//! names, and so on. Over the part of a pixel that surface k covers,
//! `R_k = w·(A·(D + S) + V_D + V_S) + (1 − w)·(a·B + (1 − a)·(c_{k+1}/c_k)·R_{k+1})`
//! with w the weight, A occlusion, D and S the environment's diffuse and specular light, V the light volume's, B light from
//! beneath and a whether there is any, c cover. The picture is `c_1·R_1`, its coverage the same with 1 for every light.
//!
//! | layer | channels | what |
//! | --- | --- | --- |
//! | `cover` | V | part of the pixel |
//! | `weight` | V | `opacity` or `fresnel`, as `isosurface.blend` says |
//! | `opacity`, `fresnel` | V | the two |
//! | `depth` | V | world distance from the eye |
//! | `normal` | XYZ | towards the viewer, world axes |
//! | `diffuse`, `specular` | RGB | the environment, before occlusion |
//! | `occlusion` | V | part of the rays that escape; 1 without |
//! | `volume_diffuse`, `volume_specular` | RGB | the light volume |
//! | `sss` | RGBA | light from beneath; A where there is any |
//!
//! All but `cover` are means over what is covered; layers that a scene does not ask for are left out.

use crate::error::{Error, Result};
use crate::frame::{Frame, Layer};
use crate::scene::Blend;

/// Factors on the layers of a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weights {
    /// On diffuse light.
    pub diffuse: f32,
    /// On specular light.
    pub specular: f32,
    /// On the environment's light.
    pub environment: f32,
    /// On the light volume's.
    pub volume: f32,
    /// Strength of occlusion: 0 is none, 1 as rendered.
    pub occlusion: f32,
    /// On light from beneath.
    pub sss: f32,
    /// What weighs a surface against what is beneath it; as rendered when absent.
    pub blend: Option<Blend>,
}

impl Default for Weights {
    fn default() -> Self {
        Weights { diffuse: 1.0, specular: 1.0, environment: 1.0, volume: 1.0, occlusion: 1.0, sss: 1.0, blend: None }
    }
}

/// The names of a surface's layers.
const NAMES: [(&str, &str); 12] = [
    ("cover", "V"),
    ("weight", "V"),
    ("opacity", "V"),
    ("fresnel", "V"),
    ("depth", "V"),
    ("normal", "XYZ"),
    ("diffuse", "RGB"),
    ("specular", "RGB"),
    ("occlusion", "V"),
    ("volume_diffuse", "RGB"),
    ("volume_specular", "RGB"),
    ("sss", "RGBA"),
];

/// What is known of a pixel's surface: sums while rays come in, means afterwards.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Sheet {
    pub cover: f32,
    pub weight: f32,
    pub opacity: f32,
    pub fresnel: f32,
    pub depth: f32,
    pub normal: [f32; 3],
    pub diffuse: [f32; 3],
    pub specular: [f32; 3],
    pub occlusion: f32,
    pub volume_diffuse: [f32; 3],
    pub volume_specular: [f32; 3],
    pub sss: [f32; 4],
}

impl Sheet {
    /// Values in the order of [`NAMES`].
    const LEN: usize = 25;

    fn values(&self) -> [f32; Sheet::LEN] {
        let mut values = [0.0; Sheet::LEN];
        [self.cover, self.weight, self.opacity, self.fresnel, self.depth]
            .iter()
            .chain(&self.normal)
            .chain(&self.diffuse)
            .chain(&self.specular)
            .chain(&[self.occlusion])
            .chain(&self.volume_diffuse)
            .chain(&self.volume_specular)
            .chain(&self.sss)
            .zip(&mut values)
            .for_each(|(from, to)| *to = *from);
        values
    }

    fn from_values(v: [f32; Sheet::LEN]) -> Self {
        let three = |i: usize| [v[i], v[i + 1], v[i + 2]];
        Sheet {
            cover: v[0],
            weight: v[1],
            opacity: v[2],
            fresnel: v[3],
            depth: v[4],
            normal: three(5),
            diffuse: three(8),
            specular: three(11),
            occlusion: v[14],
            volume_diffuse: three(15),
            volume_specular: three(18),
            sss: [v[21], v[22], v[23], v[24]],
        }
    }

    /// Takes in a ray.
    pub fn add(&mut self, ray: &Sheet) {
        let sums = self.values();
        let mut of = ray.values().into_iter();
        *self = Sheet::from_values(sums.map(|sum| sum + of.next().unwrap_or(0.0)));
    }

    /// From sums over the rays of a pixel, of which there are `rays`, to means.
    pub fn finish(&mut self, rays: usize) {
        let hits = self.cover;
        if hits == 0.0 {
            return;
        }
        *self = Sheet::from_values(self.values().map(|sum| sum / hits));
        self.cover = hits / rays as f32;
        let length = self.normal.iter().map(|c| c * c).sum::<f32>().sqrt();
        if length > 0.0 {
            self.normal = self.normal.map(|c| c / length);
        }
    }
}

/// Whether there are layers, and which of them are left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Wanted {
    pub layers: bool,
    pub environment: bool,
    pub volume: bool,
    pub sss: bool,
}

impl Wanted {
    fn holds(self, name: &str) -> bool {
        match name {
            "diffuse" | "specular" | "occlusion" => self.environment,
            "volume_diffuse" | "volume_specular" => self.volume,
            "sss" => self.sss,
            _ => true,
        }
    }
}

/// A picture as its bands come in, and the layers that it is made of where somebody wants them.
pub(super) struct Picture {
    frame: Frame,
    wanted: Wanted,
    /// Number of the next pixel.
    next: usize,
}

impl Picture {
    pub fn new(size: [usize; 2], wanted: Wanted) -> Self {
        let mut picture = Picture { frame: Frame::new(size), wanted, next: 0 };
        picture.layers(0);
        picture
    }

    /// Adds the layers of a surface along the rays, if they are wanted.
    fn layers(&mut self, surface: usize) {
        let pixels = self.frame.pixels.len();
        let wanted = NAMES.iter().filter(|(name, _)| self.wanted.layers && self.wanted.holds(name));
        self.frame.layers.extend(wanted.map(|(name, channels)| Layer {
            name: numbered(name, surface),
            channels: (*channels).into(),
            values: vec![0.0; pixels * channels.len()],
        }));
    }

    /// Takes in the next pixels: for each surface along the rays a sheet for each of them.
    pub fn take(&mut self, sheets: &[Vec<Sheet>]) {
        let pixels = blend(sheets, &Weights::default());
        let wanted = if self.wanted.layers { sheets } else { &[] };
        for (k, sheet) in wanted.iter().enumerate() {
            if self.frame.layer(&numbered(NAMES[0].0, k)).is_none() {
                self.layers(k);
            }
            let mut first = 0;
            for (name, channels) in NAMES {
                let (width, name) = (channels.len(), numbered(name, k));
                if let Some(layer) = self.frame.layers.iter_mut().find(|layer| layer.name == name) {
                    let values = layer.values[width * self.next..].chunks_exact_mut(width);
                    values.zip(sheet).for_each(|(to, s)| to.copy_from_slice(&s.values()[first..first + width]));
                }
                first += width;
            }
        }
        self.frame.pixels[self.next..self.next + pixels.len()].copy_from_slice(&pixels);
        self.next += pixels.len();
    }

    pub fn done(self) -> Frame {
        self.frame
    }
}

fn numbered(name: &str, surface: usize) -> String {
    if surface == 0 { name.into() } else { format!("{name}{}", surface + 1) }
}

/// Makes a picture of the layers of one: with the weights as rendered the same to the bit.
///
/// # Errors
/// [`Error::Unsupported`] when `frame` does not hold the layers of isosurfaces.
pub fn composite(frame: &Frame, weights: &Weights) -> Result<Frame> {
    let mut sheets = Vec::new();
    while frame.layer(&numbered("cover", sheets.len())).is_some() {
        sheets.push(sheet(frame, sheets.len())?);
    }
    if sheets.is_empty() {
        let names: Vec<&str> = frame.layers.iter().map(|l| &*l.name).collect();
        return Err(Error::Unsupported(format!(
            "a composite of a picture without the layers of isosurfaces (it has {}); render.kind = \"isosurface\" with an \
             .exr as --out writes them",
            if names.is_empty() { "none".into() } else { names.join(", ") }
        )));
    }
    let pixels = blend(&sheets, weights);
    Ok(Frame { pixels, ..frame.clone() })
}

/// One surface's sheet from its layers; what was left out is 0.
fn sheet(frame: &Frame, surface: usize) -> Result<Vec<Sheet>> {
    let pixels = frame.pixels.len();
    let mut values = vec![[0.0; Sheet::LEN]; pixels];
    let mut first = 0;
    for (name, channels) in NAMES {
        let width = channels.len();
        if let Some(layer) = frame.layer(&numbered(name, surface)) {
            if layer.channels != channels || layer.values.len() != width * pixels {
                let found = &layer.channels;
                let name = &layer.name;
                return Err(Error::Unsupported(format!(
                    "layer {name} with channels {found}; it should have {channels}"
                )));
            }
            for (to, from) in values.iter_mut().zip(layer.values.chunks_exact(width)) {
                to[first..first + width].copy_from_slice(from);
            }
        }
        first += width;
    }
    Ok(values.into_iter().map(Sheet::from_values).collect())
}

/// The equation above.
fn blend(sheets: &[Vec<Sheet>], weights: &Weights) -> Vec<[f32; 4]> {
    (0..sheets[0].len())
        .map(|pixel| {
            // Radiance and coverage of what is behind, over the part that it covers, and that part.
            let (mut behind, mut part) = ([0.0f32; 4], 0.0f32);
            for s in sheets.iter().rev().map(|sheet| &sheet[pixel]) {
                if s.cover == 0.0 {
                    continue;
                }
                let weight = match weights.blend {
                    None => s.weight,
                    Some(Blend::Opacity) => s.opacity,
                    Some(Blend::Fresnel) => s.fresnel,
                };
                let open = 1.0 + weights.occlusion * (s.occlusion - 1.0);
                let beneath = s.sss[3];
                let share = part / s.cover;
                let light = |c: usize| {
                    let all_around = weights.diffuse * s.diffuse[c] + weights.specular * s.specular[c];
                    let volume = weights.diffuse * s.volume_diffuse[c] + weights.specular * s.volume_specular[c];
                    let own = open * weights.environment * all_around + weights.volume * volume;
                    let through = weights.sss * s.sss[c] + (1.0 - beneath) * (share * behind[c]);
                    weight * own + (1.0 - weight) * through
                };
                let coverage = weight + (1.0 - weight) * (beneath + (1.0 - beneath) * (share * behind[3]));
                (behind, part) = ([light(0), light(1), light(2), coverage], s.cover);
            }
            behind.map(|v| part * v)
        })
        .collect()
}
