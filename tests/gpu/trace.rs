//! Path tracing.

use gloaming::BrickLayout;
use gloaming::camera::{Camera, Lens};
use gloaming::device::emitter::{Emitter, Shape};
use gloaming::device::{Clip, ClipShape, Phase, Sampling, Surface, Tally, Trace, Traced};
use gloaming::geometry::Geometry;
use gloaming::scene::MeshKeys;
use gloaming::transfer::Graded;

use super::*;

const SIZE: [usize; 3] = [17, 24, 19];
const PICTURE: [usize; 2] = [27, 22];

/// A blob with a hole, in emitters of every kind.
struct Stage {
    grid: Grid,
    values: Vec<f32>,
    table: Table,
    emitters: Vec<Emitter>,
    images: Vec<f32>,
    camera: Camera,
}

fn stage(chromatic: [f32; 3], glow: bool) -> Stage {
    let grid = Grid { size: SIZE, spacing: [0.11, 0.07, 0.1], origin: [0.5, -2.0, 8.0] };
    let middle = Vec3::from(SIZE.map(|n| 0.5 * n as f32));
    let at = |i: usize| {
        let p = Vec3::new((i % SIZE[0]) as f32, (i / SIZE[0] % SIZE[1]) as f32, (i / (SIZE[0] * SIZE[1])) as f32);
        let r = ((p - middle) / middle).length();
        if p.distance(middle) < 1.5 { gloaming::field::EMPTY } else { (1.0 - r).max(0.0) }
    };
    let ramp = |i: usize| i as f32 / 63.0;
    let table = Table {
        chromatic,
        extinction: (0..64).map(|i| 14.0 * ramp(i)).collect(),
        albedo: (0..64).map(|i| [0.9, 0.5 + 0.4 * ramp(i), 0.7]).collect(),
        emission: if glow { (0..64).map(|i| [0.2 * ramp(i), 0.1, 0.0]).collect() } else { vec![] },
        ..table()
    };
    // An image of 2×2 with its shares.
    let images = vec![1.0, 0.5, 0.2, 0.0, 0.1, 0.4, 0.3, 0.3, 0.3, 1.0, 2.0, 0.1, 0.4, 1.0, 0.7, 1.0, 0.25, 1.0];
    let sun = Emitter { axis: Vec3::new(0.6, 0.0, -0.8), ..Emitter::new(Shape::Distant, [3.0, 2.0, 1.0]) };
    let cap = Emitter { axis: Vec3::new(0.0, 0.6, 0.8), edge: 0.8, ..Emitter::new(Shape::Distant, [1.0, 2.0, 1.0]) };
    let lamp = Emitter {
        position: Vec3::new(2.0, 1.0, 2.5),
        axis: Vec3::new(-0.6, 0.0, -0.8),
        radius: 0.2,
        edge: 0.3,
        slope: 2.0,
        ..Emitter::new(Shape::Point, [2.0; 3])
    };
    let even = Emitter { visible: true, ..Emitter::new(Shape::Environment, [0.1, 0.2, 0.3]) };
    let sky = Emitter { image: [0, 2, 2], ..Emitter::new(Shape::Environment, [1.0; 3]) };
    let emitters = [sun, cap, lamp, even, sky].map(|e| Emitter { share: 0.2, ..e }).to_vec();
    let centre = (0.5 * (grid.bounds().0 + grid.bounds().1)).as_vec3();
    let lens = Lens { radius: 0.05, focus: Some(3.0), blades: 5 };
    let camera = Camera { lens, ..Camera::look_at(centre + Vec3::new(2.0, -3.0, 1.0), centre, Vec3::Z, 35.0) };
    Stage { values: (0..grid.len()).map(at).collect(), grid, table, emitters, images, camera }
}

fn tallies(d: &dyn Device, stage: &Stage, change: impl Fn(&mut Trace)) -> Vec<Tally> {
    tallies_by(d, stage, change, |trace, tallies| d.trace(trace, PICTURE, tallies))
}

/// The same by another call.
fn tallies_by(
    d: &dyn Device,
    stage: &Stage,
    change: impl Fn(&mut Trace),
    call: impl FnOnce(&Trace, &mut [Tally]) -> gloaming::Result<Traced>,
) -> Vec<Tally> {
    let bricks = BrickLayout::new(SIZE, 8);
    let field = upload(d, &stage.values);
    let mut gradient = d.alloc(stage.values.len()).unwrap();
    d.gradient(&stage.grid, &field, &mut gradient).unwrap();
    let [values, steepness] = [&field, &gradient].map(|of| d.brick_range(&bricks, of).unwrap());
    let bound = stage.table.densest(&values, Some(&steepness));
    let majorant: Vec<f32> =
        bound.iter().map(|m| if stage.table.emission.is_empty() { *m } else { m.max(3.0) }).collect();
    let mut trace = Trace {
        grid: &stage.grid,
        field: &field,
        gradient: stage.table.graded.is_some().then_some(&gradient),
        table: &stage.table,
        surface: None,
        bricks,
        majorant: &majorant,
        emitters: &stage.emitters,
        images: &stage.images,
        camera: &stage.camera,
        focus: 3.0,
        clips: &[],
        meshes: None,
        phase: Phase::HenyeyGreenstein(0.4),
        sampling: Sampling::Both,
        depth: 8,
        seed: 5,
        samples: 3..7,
    };
    change(&mut trace);
    let mut tallies = vec![Tally::default(); PICTURE[0] * PICTURE[1]];
    assert_eq!(call(&trace, &mut tallies).unwrap().exceeded, 0);
    tallies
}

/// Both devices draw the same integers, so that nearly every path is the same: but for those that rounding sends another way, sums
/// agree pixel by pixel. They agree in the mean.
fn agree(stage: &Stage, change: impl Fn(&mut Trace) + Copy) {
    let [want, got] = both(|d| tallies(d, stage, change));
    let mut apart = 0;
    let (mut sums, mut variance) = ([0.0; 2], 0.0);
    for (w, g) in want.iter().zip(&got) {
        assert_eq!(w.samples, g.samples);
        let close = |a: f64, b: f64| (a - b).abs() <= 2e-3 * (0.1 + a.abs().max(b.abs()));
        let same = (0..3).all(|c| close(w.radiance[c], g.radiance[c]) && close(w.squares[c], g.squares[c]))
            && w.coverage == g.coverage
            && close(w.depth.into(), g.depth.into())
            && (0..3).all(|c| close(w.normal[c].into(), g.normal[c].into()))
            && (0..3).all(|c| close(w.albedo[c].into(), g.albedo[c].into()));
        apart += usize::from(!same);
        sums = [sums[0] + w.radiance[1], sums[1] + g.radiance[1]];
        variance += w.squares[1];
    }
    assert!(sums[0] > 0.0);
    assert!(apart * 20 < want.len(), "{apart} of {} pixels differ", want.len());
    assert!((sums[0] - sums[1]).abs() < variance.sqrt(), "{sums:?}");
}

#[test]
fn paths_agree() {
    let gray = stage([1.0; 3], false);
    agree(&gray, |_| ());
    agree(&gray, |t| (t.phase, t.sampling) = (Phase::Schlick(-0.3), Sampling::Scattering));
    agree(&gray, |t| (t.depth, t.sampling) = (1, Sampling::Lights));
}

#[test]
fn paths_through_coloured_glowing_media_agree() {
    agree(&stage([1.0, 0.6, 0.3], true), |_| ());
}

#[test]
fn paths_through_values_and_gradients_agree() {
    let mut stage = stage([1.0; 3], true);
    let (rows, width) = (5, Table::ENTRIES);
    let at = |i: usize| ((i % width) as f32 / (width - 1) as f32, (i / width) as f32 / (rows - 1) as f32);
    let each = || (0..rows * width).map(at);
    // Steep places are dense, red and dark.
    let graded = Graded {
        steepest: 6.0,
        extinction: each().map(|(v, g)| 14.0 * v * (0.2 + g)).collect(),
        albedo: each().map(|(v, g)| [0.9, 0.5 + 0.4 * v, 1.0 - g]).collect(),
        emission: each().map(|(v, g)| [0.2 * v, 0.3 * (1.0 - g), 0.0]).collect(),
    };
    let rows_of_0 = Table {
        extinction: graded.extinction[(rows - 1) * width..].to_vec(),
        albedo: graded.albedo[..width].to_vec(),
        emission: graded.emission[..width].to_vec(),
        ..stage.table
    };
    stage.table = Table { graded: Some(graded), ..rows_of_0 };
    agree(&stage, |_| ());
    stage.table.chromatic = [1.0, 0.6, 0.3];
    agree(&stage, |t| t.surface = Some(Surface { factor: Some(0.7), columns: &WIDE, reference: 0.1 }));
}

#[test]
fn paths_among_meshes_agree() {
    let mut stage = stage([1.0; 3], false);
    let (lo, hi) = stage.grid.bounds();
    let middle = 0.5 * (lo + hi);
    let folder = tempfile::tempdir().unwrap();
    // A ball of triangles, and a square that reaches out of the volume.
    let ball = folder.path().join("ball.obj");
    let (round, high) = (12, 8);
    let corner = |i: usize| {
        let (a, b) = ((i % round) as f64 / round as f64, ((i / round) as f64 + 0.5) / high as f64);
        let (turn, tilt) = (std::f64::consts::TAU * a, std::f64::consts::PI * b);
        format!("v {} {} {}\n", turn.cos() * tilt.sin(), turn.sin() * tilt.sin(), tilt.cos())
    };
    let face = |i: usize| {
        let next = if i % round + 1 == round { i + 1 - round } else { i + 1 };
        format!("f {} {} {} {}\n", i + 1, next + 1, next + round + 1, i + round + 1)
    };
    let (corners, faces): (String, String) =
        ((0..round * high).map(corner).collect(), (0..round * (high - 1)).map(face).collect());
    std::fs::write(&ball, corners + &faces).unwrap();
    let square = folder.path().join("square.obj");
    std::fs::write(&square, "v -1 -1 0\nv 1 -1 0.3\nv 1 1 0\nv -1 1 -0.2\nf 1 2 3 4\n").unwrap();
    let position = [middle.x + 0.3, middle.y - 0.2, middle.z + 0.1];
    let below = [middle.x, middle.y, lo.z + 0.2];
    let geometry = Geometry::load(&[
        MeshKeys { path: ball, color: [0.9, 0.6, 0.3], scale: 0.4, rotate: [10.0, 20.0, 30.0], position },
        MeshKeys { path: square, color: [0.5, 0.7, 0.9], scale: 1.5, position: below, ..Default::default() },
    ]);
    // What a closure puts into any trace has to outlive them all.
    let geometry: &'static Geometry = Box::leak(Box::new(geometry.unwrap().unwrap()));
    agree(&stage, |t| t.meshes = Some(geometry));
    let disk =
        Emitter { visible: true, share: 0.2, position: Vec3::new(1.0, 0.8, 3.0), axis: -Vec3::Z, ..stage.emitters[2] };
    stage.emitters[2] = Emitter { shape: Shape::Disk, u: 0.8 * Vec3::X, v: 0.8 * Vec3::Y, ..disk };
    agree(&stage, |t| (t.meshes, t.depth) = (Some(geometry), 2));
}

/// Tiles alone are traced as they are among all; where nobody follows paths, all bricks count as met.
#[test]
fn tiles_are_traced_alone() {
    let stage = stage([1.0; 3], false);
    let counts = gloaming::device::March::tiles(PICTURE);
    let words = BrickLayout::new(SIZE, 8).len().div_ceil(64);
    let whole = both(|d| tallies(d, &stage, |_| ()));
    let tiles = [1, 2];
    let some = both(|d| {
        let mut touched = vec![0; tiles.len() * words];
        let sums = tallies_by(d, &stage, |_| (), |t, sums| d.trace_tiles(t, &tiles, PICTURE, sums, &mut touched));
        (sums, touched)
    });
    for (whole, (some, touched)) in whole.iter().zip(&some) {
        for (n, (w, s)) in whole.iter().zip(some).enumerate() {
            let tile = n / PICTURE[0] / 16 * counts[0] + n % PICTURE[0] / 16;
            assert_eq!(*s, if tiles.contains(&(tile as u32)) { *w } else { Tally::default() });
        }
        assert!(touched.iter().any(|t| *t != 0));
    }
}

#[test]
fn paths_to_surfaces_that_shine_agree() {
    let mut stage = stage([1.0; 3], false);
    let (lo, hi) = stage.grid.bounds();
    let reach = (0.5 * (hi - lo)).as_vec3();
    // Relative to the first value, as emitters are placed.
    let middle = (0.5 * (lo + hi)).as_vec3() - Vec3::from(stage.grid.origin.map(|o| o as f32));
    stage.images = (0..3 * 12).map(|i| (i % 5) as f32).collect();
    let turn = glam::Quat::from_euler(glam::EulerRot::XYZ, 0.4, -0.7, 1.1);
    let shapes = [Shape::Rectangle, Shape::Disk, Shape::Ring, Shape::Box, Shape::Sphere];
    let lights = shapes.into_iter().enumerate().map(|(i, shape)| {
        let angle = 1.3 * i as f32;
        let away = Vec3::new(angle.cos(), angle.sin(), 0.5 * (i as f32 - 2.0));
        Emitter {
            position: middle + 1.6 * reach.length() * away,
            axis: turn * Vec3::Z,
            u: turn * Vec3::X * 0.6,
            v: turn * Vec3::Y * 0.6,
            radius: 0.5,
            inner: 0.4,
            image: if i % 2 == 0 { [0, 4, 3] } else { [0; 3] },
            two_sided: i < 3,
            visible: true,
            share: 0.2,
            ..Emitter::new(shape, [3.0, 2.0, 1.0])
        }
    });
    stage.emitters = lights.collect();
    for sampling in [Sampling::Both, Sampling::Lights, Sampling::Scattering] {
        agree(&stage, |t| t.sampling = sampling);
    }
}

static COLUMNS: [[f32; 4]; 64] = [[0.9, 1.0, 0.3, 1.6]; 64];
static WIDE: [[f32; 4]; Table::ENTRIES] = [[0.9, 1.0, 0.3, 1.6]; Table::ENTRIES];
static CLIPS: [Clip; 2] = [
    Clip { shape: ClipShape::Plane { normal: Vec3::new(1.0, 0.4, 0.2), offset: 9.0 }, invert: false },
    Clip { shape: ClipShape::Box { low: Vec3::splat(8.0), high: Vec3::splat(12.0) }, invert: true },
];

#[test]
fn paths_among_surfaces_and_cuts_agree() {
    let stage = stage([1.0; 3], false);
    for factor in [Some(0.7), None] {
        agree(&stage, |t| {
            t.surface = Some(Surface { factor, columns: &COLUMNS, reference: 0.1 });
            t.clips = &CLIPS;
        });
    }
}
