//! What is drawn on pictures: where it is asked for, in the right colours, and readable on any background.

use gloaming::camera::Camera;
use gloaming::frame::Frame;
use gloaming::ledger::LedgerRow;
use gloaming::scene::{Overlay, Scene};
use gloaming::sink::{Output, SinkOptions, View};
use image::RgbImage;

const SIZE: [usize; 2] = [640, 360];

fn options(overlay: &[Overlay], background: f32) -> SinkOptions {
    let mut options = SinkOptions::from(&Scene::default());
    options.overlay = overlay.to_vec();
    options.display.background = [background; 3];
    options.field = "density".into();
    options
}

fn draw(options: &SinkOptions, size: [usize; 2], range: [f64; 2], eye: [f32; 3]) -> RgbImage {
    let camera = Camera::look_at(eye.into(), glam::Vec3::ZERO, glam::Vec3::Z, 35.0);
    let axes = [camera.right, camera.up, camera.forward].map(|v| v.to_array());
    let view = View { camera: "main".into(), axes, eye, fov: 35.0, frame: Frame::new(size) };
    let (time, row) = (Some(0.25), LedgerRow::default());
    let output = Output { step: 7, time, range, frames: vec![view], light: None, row };
    options.picture(&output, &output.frames[0])
}

/// The smallest box around what differs from the picture without overlay, as [left, top, right, bottom].
fn drawn(picture: &RgbImage, background: u8) -> Option<[u32; 4]> {
    let marks = picture.enumerate_pixels().filter(|(_, _, p)| p.0 != [background; 3]);
    marks.fold(None, |bounds: Option<[u32; 4]>, (x, y, _)| {
        let [l, t, r, b] = bounds.unwrap_or([x, y, x, y]);
        Some([l.min(x), t.min(y), r.max(x), b.max(y)])
    })
}

#[test]
fn each_overlay_keeps_to_its_corner() {
    let eye = [3.0, -4.0, 2.0];
    let of = |overlay: &[Overlay]| drawn(&draw(&options(overlay, 0.0), SIZE, [0.0, 1.0], eye), 0);
    assert_eq!(of(&[]), None);
    let [_, _, right, bottom] = of(&[Overlay::Time]).unwrap();
    assert!(right < 320 && bottom < 60, "{right} {bottom}");
    let [left, top, ..] = of(&[Overlay::Axes]).unwrap();
    let [_, _, right, _] = of(&[Overlay::Axes]).unwrap();
    assert!(left > 4 && right < 160 && top > 220, "{left} {right} {top}");
    let [left, top, right, bottom] = of(&[Overlay::Colorbar]).unwrap();
    assert!(left > 480 && right < 636 && top > 30 && bottom < 330, "{left} {top} {right} {bottom}");
}

#[test]
fn the_colour_bar_has_the_map_from_bottom_to_top() {
    let mut options = options(&[Overlay::Colorbar], 0.0);
    options.colors = std::array::from_fn(|i| [1.0, i as f32 / 255.0, 0.25]);
    let picture = draw(&options, SIZE, [0.0, 1.0], [3.0, -4.0, 2.0]);
    // Blue 64 with full red is the bar's alone.
    let bar: Vec<_> = picture.enumerate_pixels().filter(|(_, _, p)| p.0[0] == 255 && p.0[2] == 64).collect();
    let column = bar.iter().map(|(x, ..)| *x).max().unwrap();
    let greens: Vec<u8> = bar.iter().filter(|(x, ..)| *x == column).map(|(_, _, p)| p.0[1]).collect();
    assert!(greens.len() > 140, "{}", greens.len());
    assert!(greens.windows(2).all(|w| w[0] >= w[1]), "darker downwards");
    assert!(greens[0] >= 253 && greens[greens.len() - 1] <= 2, "{greens:?}");
}

#[test]
fn ink_stands_out_on_dark_and_bright_backgrounds() {
    let all = [Overlay::Time, Overlay::Colorbar, Overlay::Axes];
    for (background, ink) in [(0.0f32, 230..=255u8), (0.03, 230..=255), (1.0, 0..=40)] {
        for size in [[320, 180], SIZE, [1920, 1080]] {
            let picture = draw(&options(&all[..1], background), size, [0.0, 1.0], [3.0, -4.0, 2.0]);
            let strong = picture.pixels().filter(|p| p.0.iter().all(|v| ink.contains(v))).count();
            // Two pixels of full ink a glyph of `t = 0.25000   step 7`, at least.
            assert!(strong >= 2 * 15, "{background} {size:?}: {strong}");
        }
    }
    // Over a bright picture before a dark background, the halo sets light ink off.
    let options = options(&all[..1], 0.0);
    let frame = Frame { pixels: vec![[1.0; 4]; SIZE[0] * SIZE[1]], ..Frame::new(SIZE) };
    let view = View { camera: "main".into(), axes: [[0.0; 3]; 3], eye: [0.0; 3], fov: 35.0, frame };
    let row = LedgerRow::default();
    let output = Output { step: 7, time: None, range: [0.0, 1.0], frames: vec![view], light: None, row };
    let picture = options.picture(&output, &output.frames[0]);
    let dark = picture.pixels().filter(|p| p.0[1] < 80).count();
    assert!(dark > 100, "{dark}");
}

#[test]
fn the_triad_points_where_the_world_axes_go() {
    let of = |eye| draw(&options(&[Overlay::Axes], 0.0), SIZE, [0.0, 1.0], eye);
    // Mean place of what is mostly of one channel.
    let place = |picture: &RgbImage, channel: usize| {
        let others = [(channel + 1) % 3, (channel + 2) % 3];
        let marks: Vec<_> = picture
            .enumerate_pixels()
            .filter(|(_, _, p)| others.iter().all(|&o| f32::from(p.0[channel]) > 1.3 * f32::from(p.0[o]) + 20.0))
            .map(|(x, y, _)| [x as f32, y as f32])
            .collect();
        assert!(marks.len() > 20, "channel {channel}: {}", marks.len());
        [0, 1].map(|c| marks.iter().map(|m| m[c]).sum::<f32>() / marks.len() as f32)
    };
    // From −y: x to the right, z up. From +x: y to the right.
    let front = of([0.0, -5.0, 0.0]);
    let (x, z) = (place(&front, 0), place(&front, 2));
    assert!(x[0] > z[0] + 10.0 && z[1] < x[1] - 10.0, "x at {x:?}, z at {z:?}");
    let side = of([5.0, 0.0, 0.0]);
    let (y, z) = (place(&side, 1), place(&side, 2));
    assert!(y[0] > z[0] + 10.0 && z[1] < y[1] - 10.0, "y at {y:?}, z at {z:?}");
    let back = of([0.0, 5.0, 0.0]);
    assert!(place(&back, 0)[0] < place(&back, 2)[0] - 10.0);
}

#[test]
fn nothing_goes_wrong_on_odd_ranges_and_tiny_pictures() {
    let all = [Overlay::Time, Overlay::Colorbar, Overlay::Axes];
    for range in [[0.0, 0.0], [f64::NAN, 1.0], [0.0, f64::INFINITY], [1.0, -1.0], [1e300, 1.1e300], [-1e-300, 1e-300]] {
        for size in [[1, 1], [16, 16], [40, 700], [700, 20], SIZE] {
            let picture = draw(&options(&all, 0.2), size, range, [3.0, -4.0, 2.0]);
            assert_eq!([picture.width() as usize, picture.height() as usize], size);
        }
    }
}
