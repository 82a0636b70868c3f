//! Opaque meshes: what they throw back, what lies before them, and the shadows that they cast.

use std::path::Path;
use std::sync::Arc;

use gloaming::camera::Camera;
use gloaming::device::cpu::Cpu;
use gloaming::device::{Behind, Device, March};
use gloaming::field::{Dense, Timestep};
use gloaming::frame::Frame;
use gloaming::medium::Medium;
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
    let mut sets: Vec<String> = common.iter().chain(sets).map(|s| s.to_string()).collect();
    for (n, (middle, edge)) in squares.iter().enumerate() {
        let path = folder.path().join(format!("{n}.obj"));
        square(&path, *middle, *edge);
        sets.push(format!("meshes.{n}.path={}", path.display()));
        sets.push(format!("meshes.{n}.color=[0.5, 0.25, 1.0]"));
    }
    let scene = Scene::load(None, &sets)?;
    let mut session = Session::new(Arc::new(Cpu::new(2)?), scene, None, false)?;
    let field = Arc::new(Dense::new([SIZE; 3], vec![value; SIZE.pow(3)]));
    let output = session.advance(Timestep { step: 0, time: None, grid: grid(), field })?;
    Ok(output.frames[0].frame.pixels.clone())
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
