//! Environments from images, and extinction that differs between colour channels.

use std::path::Path;
use std::sync::Arc;

use glam::DVec3;
use gloaming::device::cpu::Cpu;
use gloaming::field::{Dense, Timestep};
use gloaming::lights::Panorama;
use gloaming::scene::Scene;
use gloaming::session::Session;
use gloaming::sink::Output;
use gloaming::{Error, Grid};

fn cube(n: usize) -> Grid {
    Grid { spacing: [1.0 / n as f64; 3], origin: [0.5 / n as f64; 3], ..Grid::new([n; 3]) }
}

fn blob(p: DVec3) -> f32 {
    (1.2 - 3.0 * (p - DVec3::new(0.5, 0.45, 0.55)).length()).clamp(0.0, 1.0) as f32
}

/// One cold step of a blob in a cube of 20³, `light.resolution` 1.
fn step(value: impl Fn(DVec3) -> f32, sets: &[String]) -> Output {
    let common = ["transfer.colormap=white", "transfer.extinction=6", "light.resolution=1", "render.size=[24, 24]"];
    let sets: Vec<String> = common.iter().map(|s| s.to_string()).chain(sets.iter().cloned()).collect();
    let grid = cube(20);
    let values = (0..grid.len())
        .map(|i| value((DVec3::new((i % 20) as f64, (i / 20 % 20) as f64, (i / 400) as f64) + 0.5) / 20.0))
        .collect();
    let scene = Scene::load(None, &sets).unwrap();
    let mut session = Session::new(Arc::new(Cpu::new(2).unwrap()), scene, Some([0.0, 1.0]), true).unwrap();
    let field = Arc::new(Dense::new(grid.size, values));
    session.advance(Timestep { step: 0, time: None, grid, field }).unwrap()
}

fn strings(sets: &[&str]) -> Vec<String> {
    sets.iter().map(|s| s.to_string()).collect()
}

fn fluence(output: &Output) -> Vec<[f32; 3]> {
    output.light.as_ref().unwrap().fluence.clone()
}

/// Writes an EXR whose pixel towards the middle of each cell is `radiance` of that direction.
fn write(path: &Path, [width, height]: [usize; 2], radiance: impl Fn(DVec3) -> [f32; 3]) {
    let pixel = |x: u32, y: u32| {
        let azimuth = (f64::from(x) + 0.5) / width as f64 * std::f64::consts::TAU;
        let polar = (f64::from(y) + 0.5) / height as f64 * std::f64::consts::PI;
        // The middle column faces +y, its right +x.
        let (from_y, side) = (azimuth - std::f64::consts::PI, polar.sin());
        image::Rgb(radiance(DVec3::new(side * from_y.sin(), side * from_y.cos(), polar.cos())))
    };
    image::Rgb32FImage::from_fn(width as u32, height as u32, pixel).save(path).unwrap();
}

fn environment(path: &Path) -> Vec<String> {
    strings(&["lights.0.kind=environment", "lights.0.intensity=1", &format!("lights.0.image={}", path.display())])
}

/// validation.md 8: an image of one radiance is a uniform environment, and without absorption light is the same everywhere.
#[test]
fn an_even_image_is_a_white_furnace() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("even.exr");
    write(&path, [16, 8], |_| [0.7; 3]);
    let even = [environment(&path), strings(&["transfer.albedo=1", "light.tolerance=1e-5"])].concat();
    let uniform =
        strings(&["lights.0.kind=environment", "lights.0.intensity=0.7", "transfer.albedo=1", "light.tolerance=1e-5"]);
    let (even, uniform) = (fluence(&step(blob, &even)), fluence(&step(blob, &uniform)));
    assert_eq!(even, uniform, "the same bits");
    for phi in even.iter().flatten() {
        assert!((phi / (0.7 * 4.0 * std::f32::consts::PI) - 1.0).abs() < 2e-4, "{phi}");
    }
}

/// In vacuum the fluence is the integral of the image, whatever it shows.
#[test]
fn no_radiance_of_an_image_is_lost() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sky.exr");
    let sky = |d: DVec3| [(2.0 * d.z).max(0.0) as f32, if d.x > 0.3 { 5.0 } else { 0.1 }, (1.0 + d.y) as f32];
    write(&path, [64, 32], sky);
    let image = Panorama::read(&path).unwrap();
    let mut exact = [0.0f64; 3];
    for y in 0..32 {
        let edge = |y: usize| (std::f64::consts::PI * y as f64 / 32.0).cos();
        for x in 0..64 {
            let (azimuth, polar) = ((x as f64 + 0.5) / 32.0 * std::f64::consts::PI, (y as f64 + 0.5) / 32.0);
            let (sin, cos) = (std::f64::consts::PI * polar).sin_cos();
            let d = DVec3::new(-sin * azimuth.sin(), -sin * azimuth.cos(), cos);
            let solid = (edge(y) - edge(y + 1)) * std::f64::consts::PI / 32.0;
            (0..3).for_each(|c| exact[c] += solid * f64::from(image.radiance(d)[c]));
        }
    }
    for directions in ["light.directions=8", "light.directions=32"] {
        let sets = [environment(&path), strings(&[directions, "lights.0.color=[1, 2, 0.5]"])].concat();
        for phi in fluence(&step(|_| 0.0, &sets)) {
            for c in 0..3 {
                let expected = exact[c] * [1.0, 2.0, 0.5][c];
                assert!((f64::from(phi[c]) / expected - 1.0).abs() < 1e-4, "{directions}: {phi:?} for {exact:?}");
            }
        }
    }
}

#[test]
fn light_comes_from_where_the_image_is_bright() {
    let folder = tempfile::tempdir().unwrap();
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            let path = folder.path().join("sun.exr");
            write(&path, [32, 16], |d| [if sign * d[axis] > 0.7 { 1.0 } else { 0.0 }; 3]);
            let sets = [environment(&path), strings(&["light.scattering=false"])].concat();
            let phi = fluence(&step(|_| 1.0, &sets));
            let at = |i: usize| {
                let mut p = [10; 3];
                p[axis] = i;
                phi[cube(20).index(p)][0]
            };
            let (lit, dark) = if sign > 0.0 { (at(18), at(1)) } else { (at(1), at(18)) };
            assert!(lit > 20.0 * dark, "axis {axis}, {sign}: {lit} {dark}");
        }
    }
}

#[test]
fn images_are_read_in_linear_light() {
    let folder = tempfile::tempdir().unwrap();
    let [exr, hdr, png] = ["a.exr", "a.hdr", "a.png"].map(|name| folder.path().join(name));
    // 188 of 255 is 0.5029 in linear light.
    let pixels = |r: f32| image::Rgb32FImage::from_pixel(4, 2, image::Rgb([r, 0.25, 0.0]));
    pixels(0.502_886_5).save(&exr).unwrap();
    pixels(0.502_886_5).save(&hdr).unwrap();
    image::RgbImage::from_pixel(4, 2, image::Rgb([188, 137, 0])).save(&png).unwrap();
    for (path, bound) in [(exr, 1e-6), (hdr, 4e-3), (png, 1e-2)] {
        let image = Panorama::read(&path).unwrap();
        assert_eq!(image.size(), [4, 2]);
        let got = image.radiance(DVec3::Y);
        for (g, e) in got.iter().zip([0.502_886_5, 0.25, 0.0]) {
            assert!((g - e).abs() < bound, "{}: {got:?}", path.display());
        }
    }
}

#[test]
fn a_path_starts_at_the_scene_files_folder_and_errors_name_it() {
    let folder = tempfile::tempdir().unwrap();
    write(&folder.path().join("sky.exr"), [4, 2], |_| [1.0; 3]);
    let file = folder.path().join("scene.toml");
    let text = |name: &str| format!("[[lights]]\nkind = \"environment\"\nimage = \"{name}\"\n");
    std::fs::write(&file, text("sky.exr")).unwrap();
    assert!(gloaming::lights::resolve(&Scene::load(Some(&file), &[]).unwrap()).is_ok());
    std::fs::write(&file, text("gone.exr")).unwrap();
    let error = gloaming::lights::resolve(&Scene::load(Some(&file), &[]).unwrap()).unwrap_err();
    assert!(matches!(error, Error::Io { .. }) && error.to_string().contains("gone.exr"), "{error}");
    std::fs::write(folder.path().join("text.exr"), "no image").unwrap();
    std::fs::write(&file, text("text.exr")).unwrap();
    let error = gloaming::lights::resolve(&Scene::load(Some(&file), &[]).unwrap()).unwrap_err();
    assert!(error.to_string().contains("text.exr") && error.to_string().contains("equirectangular"), "{error}");
    write(&folder.path().join("nan.exr"), [4, 2], |d| [if d.z > 0.0 { f32::NAN } else { 1.0 }; 3]);
    let error = Panorama::read(&folder.path().join("nan.exr")).unwrap_err();
    assert!(error.to_string().contains("nan.exr") && error.to_string().contains("(0, 0)"), "{error}");
    let error = Scene::load(None, &strings(&["lights.0.image=sky.exr"])).unwrap_err();
    assert!(matches!(&error, Error::Scene { key, .. } if key == "lights.0.image"), "{error}");
}

/// A colour channel sees the medium that a gray scene of its own extinction has.
#[test]
fn each_channel_is_dimmed_by_its_own_extinction() {
    let lights = [
        "lights.0.direction=[0.4, 0.6, -1]",
        "lights.0.intensity=3",
        "lights.1.kind=point",
        "lights.1.position=[0.1, 0.3, 0.2]",
        "lights.2.kind=environment",
        "lights.2.intensity=0.2",
        "light.tolerance=1e-5",
        "transfer.anisotropy=0.3",
        "transfer.emission=[[0, 0], [1, 0.02]]",
        "transfer.albedo=0.8",
    ];
    let chromatic = step(blob, &strings(&[&lights[..], &["transfer.chromatic=[0.3, 1, 2]"]].concat()));
    for (c, factor) in [0.3, 1.0, 2.0].into_iter().enumerate() {
        let gray = format!("transfer.extinction={}", 6.0 * factor);
        let gray = step(blob, &strings(&[&lights[..], &[&gray]].concat()));
        let close = |a: f32, b: f32, most: f32, what: &str| {
            assert!((a - b).abs() < 1e-3 * most, "{what} of channel {c}: {a} {b}");
        };
        let [a, b] = [&chromatic, &gray].map(fluence);
        let most = b.iter().fold(0.0, |m: f32, f| m.max(f[c]));
        a.iter().zip(&b).for_each(|(a, b)| close(a[c], b[c], most, "fluence"));
        let [a, b] = [&chromatic, &gray].map(|o| &o.frames[0].frame.pixels);
        let most = b.iter().fold(0.0, |m: f32, p| m.max(p[c]));
        a.iter().zip(b).for_each(|(a, b)| close(a[c], b[c], most, "radiance"));
    }
    // Coverage is one less the mean transmittance: between that of the clearest and of the densest channel.
    let [clear, dense] = ["transfer.extinction=1.8", "transfer.extinction=12"]
        .map(|e| step(blob, &strings(&[&lights[..], &[e]].concat())));
    let alpha = |o: &Output, i: usize| o.frames[0].frame.pixels[i][3];
    for i in 0..24 * 24 {
        assert!(alpha(&clear, i) <= alpha(&chromatic, i) + 1e-6 && alpha(&chromatic, i) <= alpha(&dense, i) + 1e-6);
    }
    assert!(alpha(&dense, 12 * 24 + 12) > alpha(&clear, 12 * 24 + 12) + 0.1);
}

#[test]
fn a_factor_for_all_channels_is_a_factor_on_extinction() {
    let with = |sets: &[&str]| step(blob, &strings(&[&["light.tolerance=1e-3"], sets].concat()));
    let (a, b) = (with(&["transfer.chromatic=[2, 2, 2]"]), with(&["transfer.extinction=12"]));
    assert_eq!(fluence(&a), fluence(&b));
    assert_eq!(a.frames[0].frame.pixels, b.frames[0].frame.pixels);
    let error = Scene::load(None, &strings(&["transfer.chromatic=[0, 0, 0]"])).unwrap_err();
    assert!(error.to_string().contains("transfer.chromatic") && error.to_string().contains("not all 0"), "{error}");
}
