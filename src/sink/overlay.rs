//! What is drawn on 8-bit pictures: step and time, a colour bar, a triad of the world axes, and top right that it is a preview. Sizes follow the height of the
//! picture; light ink on a dark background and dark ink on a bright one, with a halo against what is behind.

use image::{Rgb, RgbImage};

use super::{Output, SinkOptions, View};
use crate::scene::Overlay;

mod ink;
mod ticks;

pub(crate) use ink::{Face, Ink};
pub(crate) use ticks::Ticks;
use ticks::significant;

/// Draws the overlays that the options ask for.
pub(super) fn draw(picture: &mut RgbImage, options: &SinkOptions, output: &Output, view: &View) {
    let sheet = Sheet::new(picture, options);
    if options.preview > 1 {
        let text = format!("preview: blocks of {} voxels", options.preview);
        let left = sheet.width - sheet.margin - sheet.face.width(&text);
        sheet.print(picture, sheet.face, [left, sheet.margin], &text, sheet.ink);
    }
    for overlay in &options.overlay {
        match overlay {
            Overlay::Time => time(picture, &sheet, options, output),
            Overlay::Colorbar => colorbar(picture, &sheet, options, output.range),
            Overlay::Axes => axes(picture, &sheet, view.axes),
        }
    }
}

/// Sizes and inks for a picture.
struct Sheet {
    width: f32,
    height: f32,
    face: Face,
    /// Line height.
    em: f32,
    margin: f32,
    halo: f32,
    ink: [u8; 3],
    around: [u8; 3],
}

impl Sheet {
    fn new(picture: &RgbImage, options: &SinkOptions) -> Self {
        let (width, height) = (picture.width() as f32, picture.height() as f32);
        let face = Face::nearest(height / 30.0);
        let em = face.height();
        // By the background, not by the picture: ink that changes in the middle of a movie draws the eye.
        let [r, g, b] = options.display.background.map(|v| f32::from(options.display.encode(v)));
        let bright = 0.2126 * r + 0.7152 * g + 0.0722 * b > 128.0;
        let (ink, around) = if bright { ([20; 3], [255; 3]) } else { ([240; 3], [0; 3]) };
        Sheet { width, height, face, em, margin: 0.8 * em, halo: (em / 8.0).max(3.0), ink, around }
    }

    /// Prints one line of text with its upper left corner at a point.
    fn print(&self, picture: &mut RgbImage, face: Face, [x, y]: [f32; 2], text: &str, color: [u8; 3]) {
        let mut ink = Ink::within([x, y, x + face.width(text), y + face.height()], self.halo);
        ink.text(face, x, y, text);
        ink.print(picture, color, self.around);
    }
}

/// `t = 3.2500 s  step 120`, top left.
fn time(picture: &mut RgbImage, sheet: &Sheet, options: &SinkOptions, output: &Output) {
    let step = format!("step {}", output.step);
    let text = match output.time {
        Some(t) => format!("t = {} {}", significant(t, 5), options.time_units).trim_end().to_string() + "   " + &step,
        None => step,
    };
    sheet.print(picture, sheet.face, [sheet.margin, sheet.margin], &text, sheet.ink);
}

/// The map's colours with round values of the range, right, half-way up.
fn colorbar(picture: &mut RgbImage, sheet: &Sheet, options: &SinkOptions, range: [f64; 2]) {
    let Sheet { face, em, margin, .. } = *sheet;
    let height = (0.45 * sheet.height).max(4.0 * em).min(sheet.height - 2.0 * margin).round();
    let ticks = Ticks::new(range, ((height / (2.0 * em)) as usize).clamp(1, 6));
    let labels = ticks.labels.iter().map(|(_, label)| face.width(label)).fold(0.0, f32::max);
    let (bar, tick) = ((0.8 * em).round(), (0.25 * em).round());
    let right = (sheet.width - margin - labels - 1.6 * tick).round();
    let (left, top) = (right - bar, (0.5 * (sheet.height - height)).round());
    let bottom = top + height;

    // Frame and ticks first: their halo lies under the bar.
    let line = (em / 24.0).max(0.5);
    let mut ink = Ink::within([left - line, top - line, right + tick, bottom + line], sheet.halo);
    let corners = [[left, top], [right, top], [right, bottom], [left, bottom], [left, top]];
    for side in corners.windows(2) {
        ink.line(side[0], side[1], |_| line);
    }
    let place = |value: f64| {
        let t = if range[1] == range[0] { 0.5 } else { (value - range[0]) / (range[1] - range[0]) };
        bottom - t as f32 * height
    };
    for (value, _) in &ticks.labels {
        ink.line([right, place(*value)], [right + tick, place(*value)], |_| line);
    }
    ink.print(picture, sheet.ink, sheet.around);
    for y in top as u32..bottom as u32 {
        let t = 1.0 - (y as f32 + 0.5 - top) / height;
        let color = options.colors[(t * 255.0).round() as usize].map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8);
        for x in left.max(0.0) as u32..right.max(0.0) as u32 {
            if x < picture.width() && y < picture.height() {
                picture.put_pixel(x, y, Rgb(color));
            }
        }
    }
    for (value, label) in &ticks.labels {
        let from = right + 1.6 * tick + labels - face.width(label);
        sheet.print(picture, face, [from, place(*value) - 0.5 * em], label, sheet.ink);
    }
    caption(picture, sheet, options, &ticks, [right + 1.6 * tick + labels, top - 0.5 * em]);
}

/// Name and unit of the field, and what the labels have in common, in lines above the bar that end at `[right, bottom]`.
fn caption(picture: &mut RgbImage, sheet: &Sheet, options: &SinkOptions, ticks: &Ticks, [right, bottom]: [f32; 2]) {
    let Sheet { face, em, .. } = *sheet;
    let units = if options.units.is_empty() { String::new() } else { format!("[{}]", options.units) };
    let name = format!("{} {units}", options.field).trim().to_string();
    let mut above = bottom;
    if ticks.exponent != 0 || ticks.offset.is_some() {
        let small = Face::nearest(0.7 * em);
        let power = if ticks.exponent == 0 { String::new() } else { ticks.exponent.to_string() };
        let times = if ticks.exponent == 0 { "" } else { "×10" };
        let offset = ticks.offset.as_deref().unwrap_or("");
        let widths = [face.width(times), small.width(&power), if times.is_empty() { 0.0 } else { 0.4 * em }];
        let left = right - widths.iter().sum::<f32>() - face.width(offset);
        above -= em;
        sheet.print(picture, face, [left, above], times, sheet.ink);
        sheet.print(picture, small, [left + widths[0], above - 0.15 * em], &power, sheet.ink);
        sheet.print(picture, face, [right - face.width(offset), above], offset, sheet.ink);
    }
    above -= 1.1 * em;
    // A long name goes on to the left of the bar, and as far as half the picture.
    let most = (0.5 * sheet.width / face.width("m")) as usize;
    let name = if name.chars().count() > most {
        name.chars().take(most.saturating_sub(3)).collect::<String>() + "..."
    } else {
        name
    };
    sheet.print(picture, face, [right - face.width(&name), above], &name, sheet.ink);
}

/// The world axes as the camera sees them, bottom left; what points away is drawn first.
fn axes(picture: &mut RgbImage, sheet: &Sheet, [right, up, forward]: [[f32; 3]; 3]) {
    let Sheet { face, em, margin, .. } = *sheet;
    let length = 2.2 * em;
    let centre = [margin + length + 0.8 * em, sheet.height - margin - length - 0.8 * em];
    let colors = match sheet.around[0] {
        0 => [[255, 110, 95], [120, 215, 105], [110, 160, 255]],
        _ => [[190, 30, 20], [20, 125, 25], [25, 70, 200]],
    };
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| forward[b].total_cmp(&forward[a]));
    for axis in order {
        let direction = [right[axis], -up[axis]];
        let tip = [centre[0] + length * direction[0], centre[1] + length * direction[1]];
        let name = ["x", "y", "z"][axis];
        // Beyond the tip; an axis towards the eye has its name beside the dot that it is.
        let shown = direction[0].hypot(direction[1]);
        let away = if shown > 0.15 { direction.map(|d| d / shown) } else { [-0.7, 0.7] };
        let at = [tip[0] + 0.55 * em * away[0] - 0.5 * face.width(name), tip[1] + 0.55 * em * away[1] - 0.5 * em];
        let bounds = [
            centre[0].min(tip[0]).min(at[0]) - 0.2 * em,
            centre[1].min(tip[1]).min(at[1]) - 0.2 * em,
            centre[0].max(tip[0]).max(at[0] + face.width(name)) + 0.2 * em,
            centre[1].max(tip[1]).max(at[1] + em) + 0.2 * em,
        ];
        let mut ink = Ink::within(bounds, sheet.halo);
        // A shaft, and a head over the last third that ends in a point.
        let (shaft, head) = ((em / 18.0).max(0.7), em / 6.5);
        ink.line(centre, tip, |t| if t < 0.68 { shaft } else { head * (1.0 - t) / 0.32 });
        ink.text(face, at[0], at[1], name);
        ink.print(picture, colors[axis], sheet.around);
    }
}
