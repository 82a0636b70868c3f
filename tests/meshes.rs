//! Opaque meshes: what they throw back, what lies before them, and the shadows that they cast.

use std::path::Path;
use std::sync::Arc;

use glam::Vec3;
use gloaming::camera::Camera;
use gloaming::device::cpu::Cpu;
use gloaming::device::{Behind, Device, March};
use gloaming::field::{Dense, Timestep};
use gloaming::frame::Frame;
use gloaming::medium::Medium;
use gloaming::render::isosurface::{Weights, composite};
use gloaming::scene::Scene;
use gloaming::session::Session;
use gloaming::transfer::TransferFunction;
use gloaming::{BrickLayout, Error, Grid, Result};

const SIZE: usize = 32;
/// The volume's box reaches from 0 to 1.
fn grid() -> Grid {
    let h = 1.0 / SIZE as f64;
    Grid { size: [SIZE; 3], spacing: [h; 3], origin: [0.5 * h; 3] }
}

/// A square of `edge` about (x, y) at height z, facing up.
fn square(path: &Path, [x, y, z]: [f64; 3], edge: f64) {
    let e = 0.5 * edge;
    let corner = |dx: f64, dy: f64| format!("v {} {} {z}\n", x + dx, y + dy);
    let corners = corner(-e, -e) + &corner(e, -e) + &corner(e, e) + &corner(-e, e);
    std::fs::write(path, corners + "f 1 2 3 4\n").unwrap();
}

/// A picture from above of a medium of `value` everywhere, with squares as (middle, edge).
fn picture(value: f32, squares: &[([f64; 3], f64)], sets: &[&str]) -> Result<Vec<[f32; 4]>> {
    Ok(frame(|_| value, squares, sets)?.pixels)
}

/// The same of a field of world positions.
fn frame(field: impl Fn(Vec3) -> f32, squares: &[([f64; 3], f64)], sets: &[&str]) -> Result<Frame> {
    let folder = tempfile::tempdir().unwrap();
    let common = [
        "field.range=[0, 1]",
        "transfer.colormap=white",
        "transfer.extinction=2.0",
        "transfer.albedo=0",
        "light.scattering=false",
        "lights.0.kind=distant",
        "lights.0.direction=[0, 0, -1]",
        "lights.0.intensity=3",
        "cameras.0.position=[0.5, 0.5, 6]",
        "cameras.0.target=[0.5, 0.5, 0]",
        "cameras.0.up=[0, 1, 0]",
        "cameras.0.fov=10",
        "render.size=[33, 33]",
    ];
    let mut given = vec![];
    for (n, (middle, edge)) in squares.iter().enumerate() {
        let path = folder.path().join(format!("{n}.obj"));
        square(&path, *middle, *edge);
        given.push(format!("meshes.{n}.path={}", path.display()));
        given.push(format!("meshes.{n}.color=[0.5, 0.25, 1.0]"));
    }
    given.extend(common.iter().chain(sets).map(|s| s.to_string()));
    let scene = Scene::load(None, &given)?;
    let mut session = Session::new(Arc::new(Cpu::new(2)?), scene, None, false)?;
    let at = |n: usize| [n % SIZE, n / SIZE % SIZE, n / SIZE.pow(2)].map(|i| (i as f32 + 0.5) / SIZE as f32);
    let values = (0..SIZE.pow(3)).map(|n| field(Vec3::from(at(n)))).collect();
    let field = Arc::new(Dense::new([SIZE; 3], values));
    let output = session.advance(Timestep { step: 0, time: None, grid: grid(), field })?;
    Ok(output.frames[0].frame.clone())
}

fn middle(pixels: &[[f32; 4]]) -> [f32; 4] {
    pixels[16 * 33 + 16]
}

#[track_caller]
fn near(is: f32, wanted: f32, tolerance: f32) {
    assert!((is - wanted).abs() <= tolerance * wanted, "{is}, not {wanted}");
}

/// In vacuum `L = ρ/π · E cos θ`, from a light above and from one aside; beside the square there is nothing.
#[test]
fn a_surface_throws_back_its_share_of_the_light() {
    let pi = std::f32::consts::PI;
    for (light, cos) in [("[0, 0, -1]", 1.0), ("[0.6, 0, -0.8]", 0.8)] {
        let pixels = picture(0.0, &[([0.5, 0.5, 0.3], 0.4)], &[&format!("lights.0.direction={light}")]).unwrap();
        let [r, g, b, a] = middle(&pixels);
        near(r, 0.5 * 3.0 * cos / pi, 1e-4);
        near(g, 0.25 * 3.0 * cos / pi, 1e-4);
        near(b, 3.0 * cos / pi, 1e-4);
        assert_eq!(a, 1.0);
        assert_eq!(pixels[0], [0.0; 4]);
    }
    // Light from behind leaves it dark.
    let [r, .., a] = middle(&picture(0.0, &[([0.5, 0.5, 0.3], 0.4)], &["lights.0.direction=[0, 0, 1]"]).unwrap());
    assert_eq!((r, a), (0.0, 1.0));
}

/// Through an absorbing medium light loses e^(−σ d) on its way down and again on its way up.
#[test]
fn the_medium_before_a_surface_dims_it_twice() {
    let [r, _, _, a] = middle(&picture(1.0, &[([0.5, 0.5, 0.3], 0.6)], &[]).unwrap());
    // Light is taken a voxel and a half in front, where it has 1.5/32 less to go.
    let wanted = 0.5 * 3.0 / std::f32::consts::PI * (-2.0f32 * (0.7 + 0.7 - 1.5 / 32.0)).exp();
    near(r, wanted, 0.01);
    assert_eq!(a, 1.0);
}

/// A smaller square above a larger one: its shadow is where it is, and nowhere else.
#[test]
fn meshes_cast_shadows_on_each_other() {
    // Seen from below the roof, so that it hides nothing of the floor.
    let sets = [
        "cameras.0.position=[0.5, -4, 1.0]",
        "cameras.0.target=[0.5, 0.5, 0.2]",
        "cameras.0.up=[0, 0, 1]",
        "cameras.0.fov=14",
        "render.size=[99, 99]",
    ];
    let floor = ([0.5, 0.5, 0.2], 0.9);
    let lit = picture(0.0, &[floor], &sets).unwrap();
    let dark = picture(0.0, &[floor, ([0.5, 0.5, 0.8], 0.4)], &sets).unwrap();
    let brightest = lit.iter().map(|p| p[0]).fold(0.0, f32::max);
    let (mut shadow, mut same, mut darkest) = (0, 0, brightest);
    for (lit, dark) in lit.iter().zip(&dark).filter(|(l, _)| l[3] == 1.0) {
        darkest = darkest.min(dark[0]);
        shadow += u32::from(dark[0] < 0.5 * lit[0]);
        same += u32::from(dark[0] > 0.98 * lit[0]);
    }
    let floor = lit.iter().filter(|p| p[3] == 1.0).count() as f64;
    // A fifth of the floor lies below the roof, half of it behind the blur of a voxel.
    let (shadow, same) = (f64::from(shadow) / floor, f64::from(same) / floor);
    assert!((0.12..0.24).contains(&shadow) && same > 0.7, "{shadow} in shadow, {same} in full light of {floor} pixels");
    assert!(darkest < 1e-3 * brightest, "{darkest} of {brightest}");
}

/// And into the medium: below an opaque square a scattering medium is dark.
#[test]
fn meshes_cast_shadows_into_the_medium() {
    let sets = [
        "transfer.albedo=0.9",
        "transfer.extinction=1.0",
        "cameras.0.position=[0.5, -4, 0.3]",
        "cameras.0.target=[0.5, 0.5, 0.3]",
        "cameras.0.up=[0, 0, 1]",
        "cameras.0.fov=4",
    ];
    let lit = middle(&picture(1.0, &[], &sets).unwrap())[0];
    // So wide that all of the medium that is seen lies below it.
    let dark = middle(&picture(1.0, &[([0.5, 0.5, 0.8], 3.0)], &sets).unwrap())[0];
    assert!(lit > 0.03 && dark < 1e-3 * lit, "{dark} below the square, {lit} without");
}

/// Under an even sky a surface looks like its share of it, `L = ρ L_sky`.
#[test]
fn an_even_sky_lights_a_surface_evenly() {
    let sky = ["lights.0.kind=environment", "lights.0.intensity=2", "lights.0.color=[1, 1, 1]"];
    let pixels = picture(0.0, &[([0.5, 0.5, 0.5], 0.98)], &[&sky[..], &["light.directions=32"]].concat());
    let [r, _, b, _] = middle(&pixels.unwrap());
    near(r, 0.5 * 2.0, 0.1);
    near(b, 2.0, 0.1);
}

/// Rays end where something opaque is, `L = T R`, and are the same to the bit where there is nothing.
#[test]
fn rays_end_at_what_is_behind() {
    let cpu = Cpu::new(2).unwrap();
    let scene = Scene::load(None, &["transfer.extinction=2.0".into()]).unwrap();
    let grid = grid();
    let table = TransferFunction::new(&scene.transfer).unwrap().table([0.0, 1.0], grid.mean_spacing());
    let mut medium = Medium::new(&cpu, grid, table.clone()).unwrap();
    let field = Arc::new(Dense::new([SIZE; 3], vec![1.0; SIZE.pow(3)]));
    medium.take(&cpu, &Timestep { step: 0, time: None, grid, field }).unwrap();
    medium.classify(table);
    let camera = Camera::look_at([0.5, 0.5, 3.0].into(), [0.5, 0.5, 0.0].into(), [0.0, 1.0, 0.0].into(), 30.0);
    let march = March {
        grid: &grid,
        field: &medium.field,
        gradient: None,
        table: &medium.table,
        bricks: BrickLayout::new(grid.size, 8),
        majorant: &medium.majorant,
        terms: &[],
        phong: None,
        clips: &[],
        camera: &camera,
        step: 0.01,
    };
    let mut plain = Frame::new([17, 17]);
    cpu.march(&march, &mut plain).unwrap();
    let mut open = Frame::new([17, 17]);
    cpu.march_before(&march, &[Behind::NOTHING; 289], &mut open).unwrap();
    assert!(plain.pixels == open.pixels);
    // The middle ray enters at a distance of 2 and is 1 inside.
    for (end, inside) in [(2.5f32, 0.5f32), (2.123, 0.123), (1.5, 0.0), (9.0, 1.0)] {
        let mut frame = Frame::new([17, 17]);
        cpu.march_before(&march, &[Behind { end, radiance: [4.0, 2.0, 1.0] }; 289], &mut frame).unwrap();
        let pixel = frame.pixels[144];
        near(pixel[0], 4.0 * (-2.0 * inside).exp(), 1e-4);
        near(pixel[2], (-2.0 * inside).exp(), 1e-4);
        assert_eq!(pixel[3], 1.0);
    }
}

/// A ball of radius ¼ in the middle as an isosurface, red in an even light of 1; squares have their own colour in it.
const BALL: [&str; 11] = [
    "render.kind=isosurface",
    "isosurface.values=[0.5]",
    "isosurface.color=[1, 0, 0]",
    "isosurface.diffuse=1",
    "isosurface.specular=0",
    "isosurface.occlusion=none",
    "isosurface.light=environment",
    "isosurface.sky=[[1, 1, 1], [1, 1, 1]]",
    "isosurface.antialias=1",
    "isosurface.quality=preview",
    "transfer.extinction=0",
];
const SQUARE: [f32; 4] = [0.5, 0.25, 1.0, 1.0];

fn ball(squares: &[([f64; 3], f64)], sets: &[&str]) -> Frame {
    let frame = frame(|p| 1.0 - 2.0 * p.distance(Vec3::splat(0.5)), squares, &[&BALL[..], sets].concat()).unwrap();
    // The layers hold what is opaque too.
    assert!(composite(&frame, &Weights::default()).unwrap().pixels == frame.pixels);
    frame
}

#[track_caller]
fn same(is: [f32; 4], wanted: [f32; 4]) {
    assert!((0..4).all(|c| (is[c] - wanted[c]).abs() < 1e-4), "{is:?}, not {wanted:?}");
}

/// In depth what is nearer hides the other, whichever it is, pixel by pixel; layers say how far it is.
#[test]
fn meshes_and_isosurfaces_hide_each_other() {
    let (red, none) = ([1.0, 0.0, 0.0, 1.0], [0.0; 4]);
    // The eye is at a height of 6; beside the ball is pixel (16, 27), whose ray leaves the middle by 10.67/16.5·tan 5°.
    let depth = |frame: &Frame, name: &str, pixel: usize| frame.layer(name).map(|layer| layer.values[pixel]);
    let (centre, aside) = (16 * 33 + 16, 27 * 33 + 16);
    let slant = |depth: f32| {
        let tan = 5f32.to_radians().tan() * (2.0 * 27.5 / 33.0 - 1.0);
        depth * (1.0 + tan * tan).sqrt()
    };
    for (height, shown, far) in [(0.9, SQUARE, 5.1), (0.6, red, 5.25), (0.2, red, 5.25)] {
        let frame = ball(&[([0.5, 0.5, height], 0.8)], &[]);
        same(frame.pixels[centre], shown);
        same(frame.pixels[aside], SQUARE);
        assert_eq!(frame.pixels[0], none);
        near(depth(&frame, "depth", centre).unwrap(), far, 1e-3);
        near(depth(&frame, "depth", aside).unwrap(), slant(6.0 - height as f32), 1e-3);
        // Nothing shows behind what is opaque.
        assert!(frame.layer("cover2").is_none());
    }
    // A square over the right half only.
    let half = ball(&[([0.71, 0.5, 0.9], 0.4)], &[]);
    for x in 13..20 {
        same(half.pixels[16 * 33 + x], if x >= 17 { SQUARE } else { red });
    }
    // Where the eye is between them, the ball is in front of nothing.
    let below = ["cameras.0.position=[0.5, 0.5, -5]", "cameras.0.target=[0.5, 0.5, 0]"];
    same(ball(&[([0.5, 0.5, 0.9], 0.9)], &below).pixels[centre], red);
}

/// Through transparent surfaces a mesh is seen weighed by what they leave, also behind the last of them that is looked for.
#[test]
fn transparent_isosurfaces_lie_over_meshes() {
    let over = |weight: f32, walls: i32| {
        let through = (1.0 - weight).powi(walls);
        [1.0 - through + through * SQUARE[0], through * SQUARE[1], through * SQUARE[2], 1.0]
    };
    let centre = 16 * 33 + 16;
    for (height, walls, layers) in [(0.2, 2, 4), (0.5, 1, 4), (0.2, 1, 1), (0.9, 0, 4)] {
        let layers = format!("isosurface.layers={layers}");
        let frame = ball(&[([0.5, 0.5, height], 0.9)], &["isosurface.opacity=0.25", &layers]);
        same(frame.pixels[centre], over(0.25, walls));
        let last = if walls == 0 { "depth".into() } else { format!("depth{}", walls + 1) };
        near(frame.layer(&last).unwrap().values[centre], 6.0 - height as f32, 1e-3);
        if walls == 2 {
            near(frame.layer("depth").unwrap().values[centre], 5.25, 1e-3);
            near(frame.layer("depth2").unwrap().values[centre], 5.75, 1e-3);
        }
    }
    // By Fresnel's weight too something opaque is opaque.
    let fresnel = ball(&[([0.5, 0.5, 0.2], 0.9)], &["isosurface.blend=fresnel"]);
    let weight = (0.5f32 / 2.5).powi(2);
    same(fresnel.pixels[centre], over(weight, 2));
}

/// The light volume lights meshes among isosurfaces as it does in ray casting.
#[test]
fn meshes_among_isosurfaces_are_lit_by_the_light_volume() {
    let square = [([0.5, 0.5, 0.9], 0.9)];
    let lit = ball(&square, &["isosurface.light=volume"]).pixels[16 * 33 + 16];
    let wanted = picture(0.0, &square, &[]).unwrap()[16 * 33 + 16];
    same(lit, wanted);
    near(lit[2], 3.0 / std::f32::consts::PI, 1e-4);
}

/// A ball that is cut shows its inside, where the cut is a disk of radius √(R² − h²), and its outside around that; of what is cut away
/// nothing is met.
#[test]
fn a_cut_isosurface_shows_its_inside() {
    let plane = ["clip.0.kind=plane", "clip.0.normal=[0, 0, -1]"];
    let size = 199;
    for height in [0.0f64, 0.1037] {
        let point = format!("clip.0.point=[0, 0, {}]", 0.5 + height);
        let sets = ["render.size=[199, 199]", "cameras.0.fov=7", "isosurface.antialias=1", &point];
        let whole = ball(&[], &sets[..3]);
        let cut = ball(&[], &[&plane[..], &sets].concat());
        let tan = 3.5f64.to_radians().tan();
        let depth = &cut.layer("depth").unwrap().values;
        let normal = &cut.layer("normal").unwrap().values;
        let (mut inside, mut rim) = (0.0, 0.0);
        for (n, t) in depth.iter().enumerate().filter(|(n, _)| cut.pixels[*n][3] > 0.0) {
            let at = [n % size, n / size].map(|i| (2.0 * (i as f64 + 0.5) / size as f64 - 1.0) * tan);
            let way = 1.0 / (1.0 + at[0] * at[0] + at[1] * at[1]).sqrt();
            let below = 6.0 - f64::from(*t) * way - 0.5;
            assert!(below < height + 1e-4, "{below} above the cut at {height}");
            // The normal faces the viewer: inside, it points towards the middle of the ball.
            let up = f64::from(normal[3 * n + 2]);
            if below < 0.0 && up > 0.0 && (up + below / 0.25).abs() < 0.1 {
                inside += 1.0;
            } else {
                rim += 1.0;
            }
        }
        let pixel = 2.0 * tan / size as f64;
        // Of a disk at a height above the middle, as the eye sees it.
        let disk = |radius: f64, h: f64| std::f64::consts::PI * (radius / (5.5 - h) / pixel).powi(2);
        let opening = disk((0.0625 - height * height).sqrt(), height);
        // A pixel's width of the outline is either's.
        let edge = 2.0 * (std::f64::consts::PI * opening).sqrt();
        assert!((inside - opening).abs() < 0.3 * edge, "{inside} pixels show the inside, not {opening} ± {edge}");
        let outline = whole.pixels.iter().filter(|p| p[3] > 0.0).count() as f64;
        assert!((inside + rim - outline).abs() < 0.3 * edge, "{inside} + {rim} of {outline}");
    }
    // An eighth cut out of it by a box: the wall below is seen through the opening, and a square before it.
    let corner = ["clip.0.kind=box", "clip.0.min=[0.5, 0.5, 0.5]", "clip.0.invert=true"];
    let opened = ball(&[([0.5, 0.5, 0.45], 0.2)], &corner);
    let depth = |x: usize, y: usize| opened.layer("depth").unwrap().values[y * 33 + x];
    // Rows go down, y up: the opening is at the upper right.
    near(depth(18, 14), 6.0 - 0.45, 1e-3);
    near(depth(20, 14), 5.7117, 1e-3);
    assert!(depth(14, 18) < 5.3);
}

/// Slices end at what is opaque, in both orders: `L = ωE/8π·(1 − e^(−2σd))` of light along the view through even medium, and none where
/// the light comes from behind the square; what the square throws back is dimmed twice.
#[test]
fn slices_end_at_meshes() {
    let sets = ["render.kind=slices", "transfer.albedo=0.9", "slices.resolution=4"];
    let black = [&sets[..], &["meshes.0.color=[0, 0, 0]"]].concat();
    let square = [([0.5, 0.5, 0.3], 0.8)];
    let [r, .., a] = middle(&frame(|_| 1.0, &square, &black).unwrap().pixels);
    let seen = 0.9 * 3.0 / (8.0 * std::f32::consts::PI);
    // The slab before the square is lit at its middle.
    near(r, seen * (1.0 - (-4.0f32 * 0.7).exp()), 0.01);
    assert_eq!(a, 1.0);
    let behind = [&black[..], &["lights.0.direction=[0, 0, 1]"]].concat();
    let [dark, .., a] = middle(&frame(|_| 1.0, &square, &behind).unwrap().pixels);
    assert!(dark < 1e-6 && a == 1.0, "{dark} before the square in its own shadow");
    let [lit, ..] =
        middle(&frame(|_| 1.0, &[], &[&sets[..], &["lights.0.direction=[0, 0, 1]"]].concat()).unwrap().pixels);
    assert!(lit > 0.01, "{lit}");
    // Its own light, as ray casting shows it. The sky's counts as undimmed in slices; ray casting has ordinates for it, and takes half their
    // fluence a voxel and a half before the square.
    let both = |more: &[&str], value: f32| {
        ["raycast", "slices"].map(|kind| {
            let kind = format!("render.kind={kind}");
            let sets = [&[kind.as_str(), "light.directions=32", "transfer.albedo=0.2"], more].concat();
            middle(&picture(value, &square, &sets).unwrap())[2]
        })
    };
    let sky = ["lights.0.kind=environment", "lights.0.intensity=2"];
    for (more, value) in [
        (vec![], 0.2),
        (vec!["lights.0.direction=[0.6, 0, -0.8]"], 0.2),
        ([&sky[..], &["light.resolution=1"]].concat(), 0.0),
    ] {
        let [cast, sliced] = both(&more, value);
        near(sliced, cast, 0.02);
    }
    // At half the resolution that is farther from the square, and 0.20 of the sky beneath is seen past its edges: the mean of
    // sin(atan(h/r)) round it, with h = 1.5/16 and r the way to the edge.
    let [cast, sliced] = both(&sky, 0.0);
    assert!((sliced..1.21 * sliced).contains(&cast), "{cast}, not {sliced}");
}

/// Below an opaque square slices are dark, beside it as without: on its shadow's edge to a texel or two.
#[test]
fn meshes_cast_shadows_in_slices() {
    let sets = [
        "render.kind=slices",
        "transfer.albedo=0.9",
        "transfer.extinction=0.3",
        "cameras.0.position=[0.5, -4, 0.3]",
        "cameras.0.target=[0.5, 0.5, 0.3]",
        "cameras.0.up=[0, 0, 1]",
        "cameras.0.fov=8",
    ];
    for blur in ["slices.blur=0", "slices.blur=60"] {
        let sets = [&sets[..], &[blur]].concat();
        let lit = picture(1.0, &[], &sets).unwrap();
        // Over the left half of the volume, all of its depth, and another below it.
        let half = [([-0.1, 0.5, 0.9], 1.2), ([-0.1, 0.5, 0.85], 1.2)];
        let dark = picture(1.0, &half, &sets).unwrap();
        let share = |x: usize| dark[16 * 33 + x][0] / lit[16 * 33 + x][0];
        // A pixel is about half a voxel.
        assert!(share(30) > 0.97, "{blur}: {} far beside the shadow", share(30));
        if blur.ends_with("=0") {
            assert!(share(12) < 1e-3 && share(20) > 0.99, "{} in the shadow, {} beside it", share(12), share(20));
        } else {
            assert!(
                share(14) > 1e-3 && share(2) < 0.2,
                "{} by the edge, {} deep in it: blur softens",
                share(14),
                share(2)
            );
        }
    }
}

/// Cuts take the medium from slices: `L = ωE/8π·(1 − e^(−2σd))` of what is left.
#[test]
fn slices_are_cut() {
    let sets = ["render.kind=slices", "transfer.albedo=0.9", "render.step=0.25", "clip.0.max=[2, 2, 0.4]"];
    for light in ["[0, 0, -1]", "[0, 0, 1]"] {
        let light = format!("lights.0.direction={light}");
        let frame = frame(|_| 1.0, &[], &[&sets[..], &[light.as_str()]].concat()).unwrap();
        let [r, _, _, a] = middle(&frame.pixels);
        let seen = 0.9 * 3.0 / (4.0 * std::f32::consts::PI);
        let wanted = match light.ends_with("-1]") {
            true => seen * 0.5 * (1.0 - (-4.0f32 * 0.4).exp()),
            false => seen * 2.0 * 0.4 * (-2.0f32 * 0.4).exp(),
        };
        // Half a slab, 1/256, is on either side of the cut.
        near(a, 1.0 - (-2.0f32 * 0.4).exp(), 0.01);
        near(r, wanted, 0.015);
    }
}

#[test]
fn meshes_that_cannot_be_shown_are_refused() {
    let why = |squares: &[([f64; 3], f64)], sets: &[&str]| picture(0.0, squares, sets).unwrap_err();
    let far = why(&[([0.5, 0.5, 30.0], 1.0)], &[]);
    assert!(matches!(&far, Error::Scene { key, .. } if key == "meshes.0.position"), "{far}");
    assert!(why(&[], &["meshes.0.path=/no/such.obj"]).to_string().contains("/no/such.obj"));
    assert!(why(&[], &["meshes.0.color=[1, 1, 1]"]).to_string().contains("meshes.0.path"));
    assert!(why(&[], &["meshes.0.path=a.obj", "meshes.0.color=[2, 0, 0]"]).to_string().contains("each 0 to 1"));
    assert!(why(&[], &["meshes.0.size=3"]).to_string().contains("scale"));
    let paper = why(&[([0.5; 3], 1.0)], &["light.model=paper"]).to_string();
    assert!(paper.contains("physical"), "{paper}");
}
