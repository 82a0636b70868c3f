//! A histogram as a picture, the transfer function drawn on top: values from left to right, how often they occur above,
//! how often with which gradient below, both on logarithmic scales.

use image::{Rgb, RgbImage};

use super::Histogram;
use crate::scene::{RegionKeys, Shape, TransferKeys};
use crate::sink::overlay::{Face, Ink, Ticks};
use crate::transfer::TransferFunction;

const SIZE: [u32; 2] = [1100, 900];
const LEFT: f32 = 110.0;
const RIGHT: f32 = 1070.0;
/// Tops and bottoms of the upper and the lower plot, and of the bar of colours between them.
const UPPER: [f32; 2] = [60.0, 340.0];
const BAR: [f32; 2] = [356.0, 380.0];
const LOWER: [f32; 2] = [396.0, 826.0];

const PAPER: [u8; 3] = [255; 3];
const INK: [u8; 3] = [30; 3];
const CURVE: [u8; 3] = [200, 60, 20];

/// Draws a histogram and the transfer function that a scene's `[transfer]` describes.
pub fn plot(histogram: &Histogram, keys: &TransferKeys, transfer: &TransferFunction, title: &str) -> RgbImage {
    let mut picture = RgbImage::from_pixel(SIZE[0], SIZE[1], Rgb(PAPER));
    let face = Face::nearest(20.0);
    values(&mut picture, histogram, transfer);
    bar(&mut picture, transfer);
    joint(&mut picture, histogram, transfer);
    for region in &keys.regions {
        outline(&mut picture, region);
    }
    for [top, bottom] in [UPPER, LOWER] {
        let corners = [[LEFT, top], [RIGHT, top], [RIGHT, bottom], [LEFT, bottom], [LEFT, top]];
        corners.windows(2).for_each(|side| line(&mut picture, side[0], side[1], 0.6, INK));
    }
    let ticks = Ticks::new(histogram.range, 8);
    for (value, label) in &ticks.labels {
        let x = LEFT + share(*value, histogram.range) * (RIGHT - LEFT);
        line(&mut picture, [x, LOWER[1]], [x, LOWER[1] + 6.0], 0.6, INK);
        text(&mut picture, face, [x - 0.5 * face.width(label), LOWER[1] + 8.0], label);
    }
    let of_ten = |exponent: i32| if exponent == 0 { String::new() } else { format!(" (times 10^{exponent})") };
    let below =
        format!("value{}{}", of_ten(ticks.exponent), ticks.offset.map_or(String::new(), |o| format!(" from {o}")));
    text(&mut picture, face, [RIGHT - face.width(&below), LOWER[1] + 34.0], &below);
    for (share, label) in Ticks::new([0.0, 1.0], 5).labels {
        let at = |[top, bottom]: [f32; 2]| bottom - share as f32 * (bottom - top);
        text(&mut picture, face, [LEFT - face.width(&label) - 8.0, at(UPPER) - 0.5 * face.height()], &label);
        let steepness = format!("{}", (1e4 * share * histogram.steepest).round() / 1e4);
        text(&mut picture, face, [LEFT - face.width(&steepness) - 8.0, at(LOWER) - 0.5 * face.height()], &steepness);
    }
    let most = histogram.values.iter().copied().max().unwrap_or(0);
    text(&mut picture, face, [LEFT, 8.0], title);
    text(&mut picture, face, [LEFT, 32.0], &format!("opacity (line) and how often, logarithmic, at most {most} a bin"));
    let lower = "gradient in ranges of the values per voxel";
    text(&mut picture, face, [LEFT, LOWER[1] + 34.0], lower);
    picture
}

/// Where a value is in a range, 0..1.
fn share(value: f64, [lo, hi]: [f64; 2]) -> f32 {
    if hi > lo { ((value - lo) / (hi - lo)) as f32 } else { 0.5 }
}

/// A count on a logarithmic scale, 0..1.
fn height(count: u64, most: u64) -> f32 {
    ((count as f64).ln_1p() / (most.max(1) as f64).ln_1p()) as f32
}

fn mix(under: [u8; 3], over: [f32; 3], share: f32) -> [u8; 3] {
    std::array::from_fn(|c| (f32::from(under[c]) * (1.0 - share) + 255.0 * over[c] * share).round() as u8)
}

/// Columns as high as values are frequent, and the opacity of values whose gradient vanishes; of the steepest dashed, where that
/// differs.
fn values(picture: &mut RgbImage, histogram: &Histogram, transfer: &TransferFunction) {
    let [top, bottom] = UPPER;
    let most = histogram.values.iter().copied().max().unwrap_or(0);
    for x in LEFT as u32..RIGHT as u32 {
        let value = (x as f32 + 0.5 - LEFT) / (RIGHT - LEFT);
        let bin = ((value * histogram.bins[0] as f32) as usize).min(histogram.bins[0] - 1);
        let up = bottom - height(histogram.values[bin], most) * (bottom - top);
        for y in up as u32..bottom as u32 {
            picture.put_pixel(x, y, Rgb([186, 194, 206]));
        }
    }
    let opacity = |value: f32| (0..=32).map(|g| transfer.swatch(value, g as f32 / 32.0).1).fold(0.0, f32::max);
    let at = |i: usize| {
        let value = i as f32 / 480.0;
        [LEFT + value * (RIGHT - LEFT), bottom - opacity(value) * (bottom - top)]
    };
    (0..480).for_each(|i| line(picture, at(i), at(i + 1), 1.2, CURVE));
}

/// The colours of values, where they are most opaque over all gradients.
fn bar(picture: &mut RgbImage, transfer: &TransferFunction) {
    for x in LEFT as u32..RIGHT as u32 {
        let value = (x as f32 + 0.5 - LEFT) / (RIGHT - LEFT);
        let swatches = (0..=32).map(|g| transfer.swatch(value, g as f32 / 32.0));
        let (color, opacity) = swatches.max_by(|a, b| a.1.total_cmp(&b.1)).expect("33 swatches");
        for y in BAR[0] as u32..BAR[1] as u32 {
            // Above as it is, below as opaque as it is, on a chequered ground.
            let ground = if (x / 6 + y / 6) % 2 == 0 { [255; 3] } else { [215; 3] };
            let share = if (y as f32) < 0.5 * (BAR[0] + BAR[1]) && opacity > 0.0 { 1.0 } else { opacity };
            picture.put_pixel(x, y, Rgb(mix(ground, color, share)));
        }
    }
}

/// The darker, the more frequent; tinted by the transfer function.
fn joint(picture: &mut RgbImage, histogram: &Histogram, transfer: &TransferFunction) {
    let most = histogram.joint.iter().copied().max().unwrap_or(0);
    let [columns, rows] = histogram.bins;
    for y in LOWER[0] as u32..LOWER[1] as u32 {
        let gradient = (LOWER[1] - y as f32 - 0.5) / (LOWER[1] - LOWER[0]);
        let row = ((gradient * rows as f32) as usize).min(rows - 1);
        for x in LEFT as u32..RIGHT as u32 {
            let value = (x as f32 + 0.5 - LEFT) / (RIGHT - LEFT);
            let column = ((value * columns as f32) as usize).min(columns - 1);
            let dark = height(histogram.joint[row * columns + column], most);
            let gray = [(255.0 * (1.0 - 0.85 * dark)).round() as u8; 3];
            let (color, opacity) = transfer.swatch(value, gradient);
            picture.put_pixel(x, y, Rgb(mix(gray, color, 0.55 * opacity)));
        }
    }
}

/// The border of a region.
fn outline(picture: &mut RgbImage, region: &RegionKeys) {
    let place =
        |value: f32, gradient: f32| [LEFT + value * (RIGHT - LEFT), LOWER[1] - gradient * (LOWER[1] - LOWER[0])];
    let ([from, to], [low, high]) = (region.value, region.gradient);
    let corners = match region.shape {
        Shape::Rectangle => vec![place(from, low), place(to, low), place(to, high), place(from, high)],
        Shape::Triangle => vec![place(0.5 * (from + to), low), place(to, high), place(from, high)],
    };
    for (i, corner) in corners.iter().enumerate() {
        line(picture, *corner, corners[(i + 1) % corners.len()], 1.0, CURVE);
    }
}

fn line(picture: &mut RgbImage, from: [f32; 2], to: [f32; 2], half: f32, color: [u8; 3]) {
    let (left, right) = (from[0].min(to[0]), from[0].max(to[0]));
    let (top, bottom) = (from[1].min(to[1]), from[1].max(to[1]));
    let mut ink = Ink::within([left - half, top - half, right + half, bottom + half], 0.0);
    ink.line(from, to, |_| half);
    ink.print(picture, color, PAPER);
}

fn text(picture: &mut RgbImage, face: Face, [x, y]: [f32; 2], text: &str) {
    let mut ink = Ink::within([x, y, x + face.width(text), y + face.height()], 0.0);
    ink.text(face, x, y, text);
    ink.print(picture, INK, PAPER);
}
