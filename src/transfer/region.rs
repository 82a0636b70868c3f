//! Parts of the plane of value and gradient magnitude that are seen: rectangles, triangles, and painted pictures.

use std::path::Path;

use crate::error::Result;
use crate::lights::read_linear;
use crate::scene::{RegionKeys, Shape};

/// What is seen of a value and a gradient magnitude, both 0..1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Spot {
    /// Opacity per reference length.
    pub opacity: f32,
    /// Scene-linear.
    pub color: [f32; 3],
    /// Radiance per reference length; to be multiplied by the colour.
    pub emission: f32,
}

/// Opacity of a region, 0..1 of its largest: 1 inside, falling to 0 at its borders over `edge` of the half width.
fn cover(keys: &RegionKeys, value: f32, gradient: f32) -> f32 {
    let [low, high] = keys.gradient;
    if !(low..=high).contains(&gradient) {
        return 0.0;
    }
    let [from, to] = match keys.shape {
        Shape::Rectangle => keys.value,
        Shape::Triangle => {
            let (tip, rise) = (0.5 * (keys.value[0] + keys.value[1]), (gradient - low) / (high - low).max(1e-6));
            keys.value.map(|v| tip + rise.min(1.0) * (v - tip))
        }
    };
    if !(from..=to).contains(&value) {
        return 0.0;
    }
    // Share of the way from the border to the middle.
    let inwards =
        |v: f32, from: f32, to: f32| if to > from { 1.0 - (2.0 * v - from - to).abs() / (to - from) } else { 1.0 };
    let mut depth = inwards(value, from, to);
    if keys.shape == Shape::Rectangle {
        // A rectangle that reaches to the end of an axis goes on there.
        let open = [if low <= 0.0 { 2.0 * low - high } else { low }, if high >= 1.0 { 2.0 * high - low } else { high }];
        depth = depth.min(inwards(gradient, open[0], open[1]));
    }
    if keys.edge > 0.0 { (depth / keys.edge).clamp(0.0, 1.0) } else { 1.0 }
}

pub(super) fn spot(keys: &RegionKeys, value: f32, gradient: f32) -> Spot {
    let cover = cover(keys, value, gradient);
    Spot { opacity: cover * keys.opacity, color: keys.color, emission: cover * keys.emission }
}

/// A painted transfer function: values from left to right, gradient magnitudes from bottom to top; coverage is opacity.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Painting {
    size: [usize; 2],
    /// Linear RGBA, row by row from the top.
    pixels: Vec<[f32; 4]>,
}

impl Painting {
    pub fn read(path: &Path) -> Result<Self> {
        let wanted =
            "an OpenEXR or PNG image: value from left to right, gradient from bottom to top, coverage as opacity";
        let (size, pixels) = read_linear(path, wanted)?;
        if let Some(at) = pixels.iter().position(|p| p.iter().any(|v| *v > 1.0)) {
            let found = format!("{:?} at pixel ({}, {})", pixels[at], at % size[0], at / size[0]);
            return Err(crate::Error::format(path, found, "colours and coverage from 0 to 1"));
        }
        Ok(Painting { size, pixels })
    }

    /// Bilinear between pixels, colours by their opacity.
    pub fn spot(&self, value: f32, gradient: f32) -> Spot {
        let place = |v: f32, n: usize| {
            let at = v.clamp(0.0, 1.0) * (n - 1) as f32;
            let first = (at as usize).min(n.saturating_sub(2));
            (first, (first + 1).min(n - 1), at - first as f32)
        };
        let (left, right, u) = place(value, self.size[0]);
        let (above, below, v) = place(1.0 - gradient, self.size[1]);
        let corners = [
            (left, above, (1.0 - u) * (1.0 - v)),
            (right, above, u * (1.0 - v)),
            (left, below, (1.0 - u) * v),
            (right, below, u * v),
        ];
        let (mut opacity, mut color, mut plain) = (0.0, [0.0; 3], [0.0; 3]);
        for (x, y, weight) in corners {
            let [r, g, b, a] = self.pixels[y * self.size[0] + x];
            opacity += weight * a;
            for (c, v) in [r, g, b].into_iter().enumerate() {
                color[c] += weight * a * v;
                plain[c] += weight * v;
            }
        }
        let color = if opacity > 0.0 { color.map(|v| v / opacity) } else { plain };
        Spot { opacity, color, emission: 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triangles_and_rectangles_cover_what_they_say() {
        let rectangle = RegionKeys { value: [0.2, 0.6], gradient: [0.1, 0.5], ..Default::default() };
        let triangle = RegionKeys { shape: Shape::Triangle, ..rectangle.clone() };
        for (value, gradient, in_rectangle, in_triangle) in [
            (0.4, 0.3, true, true),
            (0.21, 0.49, true, true),
            (0.21, 0.2, true, false),
            (0.4, 0.11, true, true),
            (0.59, 0.12, true, false),
            (0.1, 0.3, false, false),
            (0.4, 0.6, false, false),
            (0.4, 0.05, false, false),
        ] {
            let opacity = |keys| spot(keys, value, gradient).opacity;
            assert_eq!(opacity(&rectangle) > 0.0, in_rectangle, "({value}, {gradient})");
            assert_eq!(opacity(&triangle) > 0.0, in_triangle, "({value}, {gradient})");
        }
        let soft = RegionKeys { edge: 0.5, ..rectangle };
        let across = |value| spot(&soft, value, 0.3).opacity;
        assert!((across(0.4) - 0.5).abs() < 1e-6 && (across(0.25) - 0.25).abs() < 1e-6 && across(0.2).abs() < 1e-6);
    }

    #[test]
    fn paintings_are_read_upside_up_and_weigh_colours_by_opacity() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("table.png");
        // Red above, where gradients are steep; nothing, painted blue, below.
        image::RgbaImage::from_fn(1, 2, |_, y| {
            if y == 0 { image::Rgba([255, 0, 0, 255]) } else { image::Rgba([0, 0, 255, 0]) }
        })
        .save(&path)
        .unwrap();
        let painting = Painting::read(&path).unwrap();
        assert_eq!(painting.spot(0.3, 1.0), Spot { opacity: 1.0, color: [1.0, 0.0, 0.0], emission: 0.0 });
        assert_eq!(painting.spot(0.3, 0.0).opacity, 0.0);
        let between = painting.spot(0.9, 0.25);
        assert!((between.opacity - 0.25).abs() < 1e-6);
        assert_eq!(between.color, [1.0, 0.0, 0.0], "what is not there has no colour");
    }
}
