//! Two-dimensional and pre-integrated transfer functions in every renderer that takes them (validation.md 11).

use std::sync::Arc;

use gloaming::camera::Camera;
use gloaming::device::cpu::Cpu;
use gloaming::device::{Device, March, Term, Weight};
use gloaming::field::{Dense, Timestep};
use gloaming::frame::Frame;
use gloaming::grid::BrickLayout;
use gloaming::scene::Scene;
use gloaming::session::Session;
use gloaming::transfer::{Graded, Table, TransferFunction};
use gloaming::{Error, Grid};

const EDGE: usize = 20;

/// A ball with a soft edge in the middle: steep there, flat inside and outside.
fn ball() -> Vec<f32> {
    (0..EDGE * EDGE * EDGE)
        .map(|i| {
            let p = [i % EDGE, i / EDGE % EDGE, i / (EDGE * EDGE)].map(|c| c as f32 - 9.5);
            let r = (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]).sqrt();
            (0.5 + (6.0 - r) / 3.0).clamp(0.0, 1.0)
        })
        .collect()
}

fn parse(sets: &[&str]) -> gloaming::Result<Scene> {
    let common = ["render.size=[40, 32]", "light.scattering=false", "transfer.colormap=white"];
    let sets: Vec<String> = common.iter().chain(sets).map(|s| s.to_string()).collect();
    Scene::parse("", "scene", &sets)
}

fn picture(sets: &[&str]) -> Frame {
    let mut session =
        Session::new(Arc::new(Cpu::new(2).unwrap()), parse(sets).unwrap(), Some([0.0, 1.0]), false).unwrap();
    let field = Arc::new(Dense::new([EDGE; 3], ball()));
    let step = Timestep { step: 0, time: None, grid: Grid::new([EDGE; 3]), field };
    session.advance(step).unwrap().frames.remove(0).frame
}

fn table(sets: &[&str]) -> Table {
    TransferFunction::new(&parse(sets).unwrap().transfer).unwrap().table([0.0, 1.0], 1.0)
}

/// Casts rays through values on a grid with a table of any kind, lit evenly.
fn cast(grid: Grid, values: &[f32], table: &Table, step: f32) -> Vec<[f32; 4]> {
    let cpu = Cpu::new(2).unwrap();
    let upload = |values: &[f32]| {
        let mut buffer = cpu.alloc(values.len()).unwrap();
        cpu.upload(values, &mut buffer).unwrap();
        buffer
    };
    let (field, light) = (upload(values), upload(&vec![1.0; grid.len()]));
    let mut gradient = cpu.alloc(grid.len()).unwrap();
    cpu.gradient(&grid, &field, &mut gradient).unwrap();
    let terms = [Term { values: &light, grid: &grid, weight: Weight::Uniform([1.0; 3]) }];
    let camera = Camera::framed(&Default::default(), &grid, 1.25, 0).unwrap();
    let mut frame = Frame::new([40, 32]);
    let march = March {
        grid: &grid,
        field: &field,
        gradient: Some(&gradient),
        table,
        bricks: BrickLayout::new(grid.size, 8),
        majorant: &[],
        terms: &terms,
        phong: None,
        clips: &[],
        camera: &camera,
        step,
    };
    cpu.march(&march, &mut frame).unwrap();
    frame.pixels
}

/// The same rows for every gradient: to the bit what one row is, in the rays and in the light.
#[test]
fn a_table_constant_in_the_gradient_is_the_one_dimensional_table() {
    let plain = table(&[
        "transfer.opacity=[[0, 0], [0.4, 0.1], [1, 0.6]]",
        "transfer.colormap=viridis",
        "transfer.emission=[[0, 0], [1, 0.2]]",
    ]);
    let repeat = |v: &[[f32; 3]]| v.repeat(5);
    let graded = Graded {
        steepest: 0.3,
        extinction: plain.extinction.repeat(5),
        albedo: repeat(&plain.albedo),
        emission: repeat(&plain.emission),
    };
    let constant = Table { graded: Some(graded), ..plain.clone() };
    let grid = Grid::new([EDGE; 3]);
    assert_eq!(cast(grid, &ball(), &plain, 0.5), cast(grid, &ball(), &constant, 0.5));
    for (value, gradient) in [(0.0, 0.0), (0.37, 0.1), (0.9, 7.0), (-1.0, 0.2), (2.0, 0.0)] {
        assert_eq!(plain.look_up(value, gradient), constant.look_up(value, gradient));
    }
    let cpu = Cpu::new(2).unwrap();
    let mut field = cpu.alloc(grid.len()).unwrap();
    cpu.upload(&ball(), &mut field).unwrap();
    let mut gradient = cpu.alloc(grid.len()).unwrap();
    cpu.gradient(&grid, &field, &mut gradient).unwrap();
    for size in [[EDGE; 3], [9, 10, 7]] {
        let [mut one, mut two] = [0, 0].map(|_| cpu.alloc(size.iter().product()).unwrap());
        let optic = gloaming::device::Optic::Scattering { channel: 0 };
        cpu.classify(optic, &plain, grid.size, &field, size, &mut one).unwrap();
        cpu.classify_graded(optic, &constant, (grid.size, &field, &gradient), size, &mut two).unwrap();
        assert_eq!(one.host(), two.host());
    }
}

/// A rectangle over the whole plane is its opacity at every value; regions add up as media do.
#[test]
fn regions_are_media_that_add_up() {
    let whole = "transfer.regions=[{opacity = 0.3}]";
    let (region, curve) = (picture(&[whole]), picture(&["transfer.opacity=[[0, 0.3], [1, 0.3]]"]));
    for (a, b) in region.pixels.iter().zip(&curve.pixels) {
        // The same extinction, from an opacity in f32 instead of f64.
        assert!((0..4).all(|c| (a[c] - b[c]).abs() < 1e-5), "{a:?} {b:?}");
    }
    let both = table(&["transfer.regions=[{opacity = 0.3, color = [1, 0, 0]}, {opacity = 0.3, color = [0, 1, 0]}]"]);
    let found = both.look_up(0.5, 0.1);
    assert!((found.extinction / -(0.7f32 * 0.7).ln() - 1.0).abs() < 1e-5);
    assert!((found.albedo[0] - 0.4).abs() < 1e-5 && (found.albedo[1] - 0.4).abs() < 1e-5 && found.albedo[2] == 0.0);
    let plain = table(&["transfer.regions=[{value = [0.9, 1], gradient = [0.5, 1]}]"]);
    assert_eq!(
        plain.look_up(0.5, 0.0).extinction,
        0.0,
        "without opacity of its own the curve is not seen beside regions"
    );
}

/// The gradient tells an edge from what lies on both sides of it, whoever makes the picture.
#[test]
fn a_boundary_is_seen_without_what_it_bounds() {
    // Three voxels from 0 to 1: a third of the range per voxel.
    let edge = "transfer.regions=[{gradient = [0.5, 1], opacity = 0.1, edge = 0.2}]";
    for kind in ["render.kind=raycast", "render.kind=slices"] {
        let steep = picture(&[edge, "transfer.steepest=0.4", kind]);
        let middle = steep.pixels[16 * 40 + 20][3];
        // Where rays graze the shell they see more of it than where they go through it twice.
        let rim = steep.pixels[16 * 40..17 * 40].iter().map(|p| p[3]).fold(0.0, f32::max);
        assert!(middle > 0.1 && rim > 1.15 * middle, "{kind}: {middle} {rim}");
        let gentle =
            picture(&["transfer.regions=[{gradient = [0.95, 1], opacity = 0.6}]", "transfer.steepest=2", kind]);
        assert!(gentle.pixels.iter().all(|p| p[3] == 0.0), "nothing is that steep");
    }
    // Unlit, as the light volume cannot resolve so thin a shell.
    let glowing = "transfer.regions=[{gradient = [0.5, 1], opacity = 0.1, edge = 0.2, emission = 2}]";
    let [cast, sliced] = ["render.kind=raycast", "render.kind=slices"]
        .map(|kind| picture(&[glowing, "transfer.steepest=0.4", kind, "render.step=0.1", "lights.0.intensity=0"]));
    let square: f64 = cast.pixels.iter().zip(&sliced.pixels).map(|(a, b)| f64::from(a[0] - b[0]).powi(2)).sum();
    let mean = cast.pixels.iter().map(|p| f64::from(p[0])).sum::<f64>() / 1280.0;
    assert!((square / 1280.0).sqrt() / mean < 0.02, "{}", (square / 1280.0).sqrt() / mean);
}

/// No value is more visible than its brick's majorant, whatever its gradient.
#[test]
fn majorants_bound_all_gradients() {
    let table = table(&[
        "transfer.regions=[{value = [0.2, 0.4], gradient = [0.3, 0.6], opacity = 0.9}, {shape = \"triangle\", opacity = 0.4, emission = 3}]",
    ]);
    for n in 0..40 {
        let range = [n as f32 / 40.0, (n + 1) as f32 / 40.0];
        let majorant = table.majorants(&[range])[0];
        for i in 0..=10 {
            for j in 0..=30 {
                let found = table.look_up(range[0] + (range[1] - range[0]) * i as f32 / 10.0, 0.3 * j as f32 / 30.0);
                let seen = found.emission.into_iter().fold(found.extinction, f32::max);
                assert!(seen <= majorant * (1.0 + 1e-5), "{found:?} {majorant}");
            }
        }
    }
}

/// A thin shell of values in a ramp: steps over it miss it, its mean does not.
#[test]
fn pre_integration_is_dense_sampling() {
    let grid = Grid::new([24, 16, 16]);
    let ramp: Vec<f32> = (0..grid.len()).map(|i| (i % 24) as f32 / 23.0).collect();
    let spike =
        "transfer.opacity=[[0, 0], [0.49, 0], [0.495, 0.5], [0.5, 0], [0.7, 0], [0.71, 0.3], [0.72, 0], [1, 0]]";
    let color = "transfer.points=[[0, 1, 0, 0], [0.6, 0, 1, 0], [1, 0, 0, 1]]";
    for more in
        [&[spike, color][..], &[spike, color, "transfer.emission=[[0, 0], [0.49, 0], [0.495, 0.3], [0.5, 0], [1, 0]]"]]
    {
        let table = table(more);
        let means = Table { preintegrated: true, ..table.clone() };
        let truth = cast(grid, &ramp, &table, 0.005);
        let worst = |pixels: &[[f32; 4]]| {
            let each = pixels.iter().zip(&truth).flat_map(|(a, b)| (0..4).map(move |c| (a[c] - b[c]).abs()));
            each.fold(0.0f32, f32::max)
        };
        let (dense, plain, pre) =
            (worst(&truth), worst(&cast(grid, &ramp, &table, 1.0)), worst(&cast(grid, &ramp, &means, 1.0)));
        assert_eq!(dense, 0.0);
        assert!(plain > 0.1, "steps of a voxel miss the shell: {plain}");
        // What is left is the truth's own step, and colours' dimming within one interval.
        assert!(pre < 0.01, "{pre}");
    }
}

/// Where curves are gentle the mean over an interval is what its middle has.
#[test]
fn pre_integration_changes_little_where_curves_are_gentle() {
    for kind in ["render.kind=raycast", "render.kind=slices"] {
        let gentle = ["transfer.opacity=[[0, 0], [1, 0.2]]", kind];
        let plain = picture(&gentle);
        let pre = picture(&[&gentle[..], &["transfer.preintegrated=true"]].concat());
        assert_ne!(plain, pre);
        let off = plain
            .pixels
            .iter()
            .flatten()
            .zip(pre.pixels.iter().flatten())
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f32::max);
        assert!(off < 0.02, "{kind}: {off}");
    }
}

#[test]
fn what_cannot_be_is_said() {
    let message = |sets: &[&str]| match parse(sets) {
        Err(e @ (Error::Scene { .. } | Error::Unsupported(_))) => e.to_string(),
        other => panic!("{other:?}"),
    };
    for (set, named) in [
        ("transfer.regions=[{value = [0.5, 0.2]}]", "transfer.regions.0.value"),
        ("transfer.regions=[{opacity = 2}]", "transfer.regions.0.opacity"),
        ("transfer.regions=[{shape = \"circle\"}]", "transfer.regions"),
        ("transfer.steepest=0", "transfer.steepest"),
    ] {
        let said = message(&[set]);
        assert!(said.contains(named) && said.contains("allowed"), "{said}");
    }
    let region = "transfer.regions=[{opacity = 0.2}]";
    assert!(message(&[region, "transfer.preintegrated=true"]).contains("one of the two"));
    assert!(message(&[region, "render.preview=2"]).contains("preview"));
    let painted = parse(&["transfer.painting=/nowhere.png"]).unwrap();
    assert!(matches!(Session::new(Arc::new(Cpu::new(1).unwrap()), painted, None, false), Err(Error::Io { .. })));
}
