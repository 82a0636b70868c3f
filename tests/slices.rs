//! Half-angle slices against ray casting with the light volume, closed forms and invariances (validation.md 11, 13).

use std::sync::Arc;

use gloaming::device::cpu::Cpu;
use gloaming::field::{Dense, EMPTY, Timestep};
use gloaming::frame::Frame;
use gloaming::scene::Scene;
use gloaming::session::Session;
use gloaming::{Error, Grid};

const EDGE: usize = 24;

fn blobs() -> Vec<f32> {
    blobs_of(1)
}

/// Two soft blobs, one before the other; with `fine` values to a world length.
fn blobs_of(fine: usize) -> Vec<f32> {
    let n = EDGE * fine;
    let blob = |p: [f32; 3], c: [f32; 3], r: f32| {
        let square: f32 = (0..3).map(|a| (p[a] - c[a]).powi(2)).sum();
        (1.0 - square.sqrt() / r).max(0.0)
    };
    (0..n * n * n)
        .map(|i| {
            let p = [i % n, i / n % n, i / (n * n)].map(|c| (c as f32 + 0.5) / fine as f32 - 0.5);
            blob(p, [9.0, 8.0, 12.0], 8.0).max(blob(p, [16.0, 16.0, 11.0], 7.0))
        })
        .collect()
}

fn frame_of(values: Vec<f32>, sets: &[String]) -> gloaming::Result<Frame> {
    let fine = (values.len() as f64).cbrt().round() / EDGE as f64;
    let spacing = 1.0 / fine;
    let size = [EDGE * fine as usize; 3];
    let grid = Grid { spacing: [spacing; 3], origin: [0.5 * spacing - 0.5; 3], ..Grid::new(size) };
    let scene = Scene::parse("", "scene", sets)?;
    let mut session = Session::new(Arc::new(Cpu::new(2)?), scene, Some([0.0, 1.0]), false)?;
    let field = Arc::new(Dense::new(size, values));
    let step = Timestep { step: 0, time: None, grid, field };
    Ok(session.advance(step)?.frames.remove(0).frame)
}

fn sets(common: &[&str], more: &[&str]) -> Vec<String> {
    common.iter().chain(more).map(|s| s.to_string()).collect()
}

const COMMON: [&str; 7] = [
    "render.size=[48, 40]",
    "transfer.extinction=0.35",
    "transfer.colormap=white",
    "transfer.albedo=[0.9, 0.7, 0.5]",
    "light.scattering=false",
    "light.interpolation=cubic",
    "light.tolerance=0",
];

fn both_of(values: &[f32], common: &[&str]) -> [Frame; 2] {
    ["raycast", "slices"].map(|kind| {
        let kind = format!("render.kind={kind}");
        frame_of(values.to_vec(), &sets(common, &[&kind])).unwrap()
    })
}

/// Root mean square difference over the mean.
fn relative_rmse(a: &Frame, b: &Frame) -> f64 {
    let pixels = || a.pixels.iter().zip(&b.pixels).flat_map(|(a, b)| (0..3).map(move |c| (a[c], b[c])));
    let square: f64 = pixels().map(|(a, b)| f64::from(a - b).powi(2)).sum();
    let mean = pixels().map(|(_, b)| f64::from(b)).sum::<f64>() / pixels().count() as f64;
    (square / pixels().count() as f64).sqrt() / mean
}

/// Directions round the camera, which looks along azimuth 30° and elevation 20°: angles to the view from 0° to 180°.
fn direction(degrees: f64) -> String {
    let (azimuth, elevation) = (30f64.to_radians(), 20f64.to_radians());
    let view = [-azimuth.sin() * elevation.cos(), azimuth.cos() * elevation.cos(), -elevation.sin()];
    let right = [azimuth.cos(), azimuth.sin(), 0.0];
    let (sin, cos) = degrees.to_radians().sin_cos();
    let l: Vec<String> = (0..3).map(|a| (cos * view[a] + sin * right[a]).to_string()).collect();
    format!("lights.0.direction=[{}]", l.join(", "))
}

/// The aim is 5 % on real smoke; on these blobs the light volume's own error is under 1 % where slices are as coarse as it. Where they
/// are as fine as they choose, values are too.
#[test]
fn slices_show_what_ray_casting_shows_from_every_side_of_the_light() {
    for (values, fineness) in [(blobs(), &["slices.resolution=1.5"][..]), (blobs_of(2), &[])] {
        for degrees in [0.0, 40.0, 85.0, 95.0, 140.0, 180.0] {
            let light = direction(degrees);
            let [cast, sliced] = both_of(&values, &[&COMMON[..], &[&light], fineness].concat());
            let error = relative_rmse(&sliced, &cast);
            assert!(error < 0.02, "{degrees}°, {fineness:?}: {error}");
            let coverage = sliced.pixels.iter().zip(&cast.pixels).map(|(a, b)| (a[3] - b[3]).abs()).fold(0.0, f32::max);
            assert!(coverage < 5e-3, "{degrees}°, {fineness:?}: {coverage}");
        }
    }
}

/// The picture moves no more across l·v = 0 than it does beside it, in thin and in dense media.
#[test]
fn no_jump_where_the_order_flips() {
    for density in ["transfer.extinction=0.35", "transfer.extinction=0.7"] {
        let picture = |degrees: f64| {
            let light = direction(degrees);
            frame_of(blobs(), &sets(&COMMON, &[&light, density, "render.kind=slices"])).unwrap()
        };
        let frames = [88.5, 89.5, 90.5, 91.5].map(picture);
        let moves: Vec<f64> = frames.windows(2).map(|w| relative_rmse(&w[0], &w[1])).collect();
        assert!(moves[1] < 1.5 * moves[0].max(moves[2]), "{density}: {moves:?}");
    }
}

/// In dense media, where a voxel takes a third or half of the light, slices are still near what they converge to, whose light is path
/// tracing's in the mean; what ray casting is off by is its light volume's, whose values are a voxel apart.
#[test]
fn slices_of_dense_media_are_near_what_they_converge_to() {
    for (density, degrees) in [("0.36", 85.0), ("0.7", 180.0)] {
        let (density, light) = (format!("transfer.extinction={density}"), direction(degrees));
        let common = [&COMMON[..], &[&density, &light]].concat();
        let picture = |more: &[&str]| frame_of(blobs(), &sets(&common, more)).unwrap();
        let fine = picture(&["render.kind=slices", "render.step=0.1", "slices.resolution=8"]);
        let off = |more: &[&str]| relative_rmse(&picture(more), &fine);
        let (slices, cast) = (off(&["render.kind=slices"]), off(&["render.kind=raycast"]));
        let coarse = off(&["render.kind=slices", "slices.resolution=1.5"]);
        println!("{density} at {degrees}°: slices {slices:.4}, at 1.5 texels {coarse:.4}, ray casting {cast:.4}");
        assert!(slices < 0.01 && coarse > 2.0 * slices && cast > coarse, "{density}: {slices} {coarse} {cast}");
        let traced = picture(&["render.kind=pathtrace", "pathtrace.filter=0", "render.samples=256"]);
        let mean = |frame: &Frame| frame.pixels.iter().map(|p| f64::from(p[0])).sum::<f64>();
        // A pixel of 256 paths is off by a quarter of the mean; of 1920 pixels that leaves 0.6 %.
        assert!((mean(&fine) / mean(&traced) - 1.0).abs() < 0.02, "{} {}", mean(&fine), mean(&traced));
    }
}

/// The light buffer is finer where a voxel dims more, up to a bound.
#[test]
fn the_light_buffer_is_as_fine_as_the_medium_is_dense() {
    let picture = |density: &str, more: &[&str]| {
        let density = format!("transfer.extinction={density}");
        frame_of(blobs(), &sets(&COMMON, &[&["render.kind=slices", &density], more].concat())).unwrap()
    };
    assert!(picture("0.05", &[]) == picture("0.05", &["slices.resolution=1.5"]));
    assert!(picture("0.9", &[]) == picture("0.9", &["slices.resolution=3"]));
    assert!(picture("0.05", &[]) != picture("0.05", &["slices.resolution=3"]));
}

/// A lamp inside the volume is divided among passes, whose outermost rays cross slices at up to 80 degrees: samples are closer, so
/// that along them they are still half a voxel apart. Three values to a world length, since the light volume's feet are bilinear
/// round a lamp, and a cone's border is a voxel or two wide.
#[test]
fn lamps_outside_and_inside_the_volume_are_those_of_the_light_volume() {
    let (point, cone) = ("lights.0.kind=point", "lights.0.kind=cone");
    let inside = ["render.step=0.3", "lights.0.intensity=200"];
    let values = blobs_of(3);
    for more in [
        &[point, "lights.0.intensity=3000", "lights.0.position=[40, -20, 30]"][..],
        &[
            cone,
            "lights.0.intensity=900",
            "lights.0.position=[-14, 11, 13]",
            "lights.0.direction=[1, 0, 0]",
            "lights.0.angle=20",
            "lights.0.edge=4",
        ],
        &[&inside[..], &[point, "lights.0.position=[11.3, 12.2, 22.1]"]].concat(),
        &[
            &inside[..],
            &[cone, "lights.0.position=[11.3, 22.2, 11.1]", "lights.0.direction=[0, -1, 0.1]"],
            &["lights.0.angle=75", "lights.0.edge=10"],
        ]
        .concat(),
    ] {
        let [cast, sliced] = both_of(&values, &[&COMMON, more].concat());
        let error = relative_rmse(&sliced, &cast);
        assert!(error < 0.04, "{more:?}: {error}");
    }
}

/// Many lights add up, each with a pass of its own; emission and even light are counted once.
#[test]
fn lights_add_up() {
    let glow = "transfer.emission=[[0, 0], [1, 0.05]]";
    let lights = [
        vec!["lights.0.direction=[1, 0.2, 0]"],
        vec!["lights.0.direction=[0, -1, -1]"],
        vec!["lights.0.kind=environment", "lights.0.intensity=0.5"],
    ];
    let mut sum = [0.0f64; 3];
    let mut alone = vec![];
    for light in &lights {
        alone.push(frame_of(blobs(), &sets(&COMMON, &[&["render.kind=slices"][..], light].concat())).unwrap());
    }
    let dark = frame_of(blobs(), &sets(&COMMON, &["render.kind=slices", glow, "lights.0.intensity=0"])).unwrap();
    let together: Vec<String> = lights
        .iter()
        .enumerate()
        .flat_map(|(i, l)| l.iter().map(move |s| s.replace("lights.0", &format!("lights.{i}"))))
        .collect();
    let together: Vec<&str> = together.iter().map(String::as_str).chain(["render.kind=slices", glow]).collect();
    let all = frame_of(blobs(), &sets(&COMMON, &together)).unwrap();
    for (i, pixel) in all.pixels.iter().enumerate() {
        for c in 0..3 {
            let parts: f32 = alone.iter().chain([&dark]).map(|f| f.pixels[i][c]).sum();
            // Each part is cut along slices of its own: the sums are those of other samples.
            assert!((pixel[c] - parts).abs() < 0.03 * (parts + 0.05), "pixel {i}: {} {parts}", pixel[c]);
            sum[c] += f64::from(pixel[c]);
        }
    }
    assert!(sum[0] > sum[1] && sum[1] > sum[2], "albedo is redder");
}

/// Exact exponentials: a homogeneous medium dims what lies behind it the same whatever the distance of slices, also seen from inside
/// (validation.md 11, invariance of opacity correction).
#[test]
fn opacity_does_not_depend_on_the_distance_of_slices() {
    let even = || vec![0.6; EDGE * EDGE * EDGE];
    for position in ["cameras.0.zoom=1", "cameras.0.position=[12, 11, 10]"] {
        for degrees in [30.0, 120.0] {
            let light = direction(degrees);
            let picture = |step: &str| {
                let more =
                    [&light, step, position, "render.kind=slices", "cameras.0.fov=60", "transfer.extinction=0.1"];
                frame_of(even(), &sets(&COMMON, &more)).unwrap()
            };
            let [fine, coarse] = ["render.step=0.25", "render.step=3.1"].map(picture);
            let off = fine.pixels.iter().zip(&coarse.pixels).map(|(a, b)| (a[3] - b[3]).abs()).fold(0.0, f32::max);
            assert!(off < 2e-5, "{off}");
            assert!(fine.pixels.iter().any(|p| p[3] > 0.5));
        }
    }
}

/// The same slices composited front to back (6) and back to front (5) give the same picture (validation.md 11).
#[test]
fn over_is_under() {
    use gloaming::device::slices::{Projection, Slices, Slicing};
    use gloaming::device::{Device, Ray, Weight};
    use gloaming::grid::BrickLayout;
    let cpu = Cpu::new(2).unwrap();
    let grid = Grid::new([EDGE; 3]);
    let mut field = cpu.alloc(grid.len()).unwrap();
    cpu.upload(&blobs(), &mut field).unwrap();
    let scene = Scene::parse("", "scene", &sets(&COMMON, &[])).unwrap();
    let table = gloaming::transfer::TransferFunction::new(&scene.transfer).unwrap().table([0.0, 1.0], 1.0);
    let camera = gloaming::camera::Camera::framed(&Default::default(), &grid, 1.2, 0).unwrap();
    let view = glam::DVec3::from(camera.forward);
    // A multiple of the spacing, so that the planes are the same from either side.
    let pass = |axis: glam::DVec3, under| {
        let slicing = Slicing { axis, first: -32.0, spacing: 0.5, count: 128 };
        let mut rays = vec![Ray::FRESH; 48 * 40];
        let slices = Slices {
            grid: &grid,
            field: &field,
            gradient: None,
            table: &table,
            bricks: BrickLayout::new(grid.size, 8),
            majorant: &[],
            slicing,
            under,
            eye: Projection::of(&camera, [48, 40]),
            picture: [48, 40],
            window: [[0, 48], [0, 40]],
            unshadowed: &[Weight::Uniform([1.0; 3])],
            beam: None,
            glows: true,
            phong: None,
            clips: &[],
        };
        cpu.slice(&slices, &mut rays).unwrap();
        rays
    };
    let (under, over) = (pass(view, true), pass(-view, false));
    assert!(under.iter().any(|r| r.transmittance[0] < 0.2));
    for (a, b) in under.iter().zip(&over) {
        for c in 0..3 {
            // Sums of a hundred terms in another order; under also ends where less than 1e-4 passes.
            assert!((a.radiance[c] - b.radiance[c]).abs() < 2e-6 + 1e-4 * b.radiance[c], "{a:?} {b:?}");
        }
    }
}

/// Nothing to see, the same everywhere, no values: pictures are finite.
#[test]
fn degenerate_volumes_give_finite_pictures() {
    let n = EDGE * EDGE * EDGE;
    let mut holes = blobs();
    holes.iter_mut().step_by(97).for_each(|v| *v = f32::NAN);
    holes.iter_mut().step_by(61).for_each(|v| *v = EMPTY);
    for (values, seen) in [(vec![0.0; n], false), (vec![0.7; n], true), (vec![f32::NAN; n], false), (holes, true)] {
        for more in [
            &["lights.0.direction=[1, 0, 0]"][..],
            &["lights.0.kind=point", "lights.0.position=[12, 12, 12]"],
            &["lights.0.direction=[-1, 0.3, 0]", "slices.blur=60", "slices.attenuation=[0.5, 0.3, 0.2]"],
            &["slices.shadows=false", "render.shading=phong"],
        ] {
            let frame = frame_of(values.clone(), &sets(&COMMON, &[more, &["render.kind=slices"]].concat())).unwrap();
            assert!(frame.pixels.iter().flatten().all(|v| v.is_finite() && *v >= 0.0));
            assert_eq!(frame.pixels.iter().any(|p| p[3] > 0.0), seen);
        }
    }
}

/// Translucency of factor 1 without blur is plain shadows; less of it lets more light through, most in the channel of the least; the
/// picture does not depend on the distance of slices.
#[test]
fn translucency_lets_light_through() {
    let light = direction(100.0);
    let picture = |more: &[&str]| {
        frame_of(
            blobs(),
            &sets(&COMMON, &[&[light.as_str(), "render.kind=slices", "transfer.albedo=0.9"], more].concat()),
        )
        .unwrap()
    };
    let mean = |frame: &Frame, c: usize| frame.pixels.iter().map(|p| f64::from(p[c])).sum::<f64>();
    let plain = picture(&[]);
    assert_eq!(plain, picture(&["slices.attenuation=1", "slices.blur=0"]));
    let through = picture(&["slices.attenuation=[0.2, 0.5, 1]"]);
    assert!(mean(&through, 0) > 1.05 * mean(&through, 1) && mean(&through, 1) > 1.05 * mean(&through, 2));
    assert!((mean(&through, 2) / mean(&plain, 2) - 1.0).abs() < 1e-5);
    let blurred = ["render.step=0.25", "render.step=0.5"].map(|step| picture(&["slices.blur=100", step]));
    assert!(relative_rmse(&blurred[0], &blurred[1]) < 0.02);
    let seen = relative_rmse(&blurred[0], &plain);
    assert!(seen > 0.02, "blur is seen: {seen}");
}

/// An even image of a spotlight's is no image; half of it black leaves half of the light.
#[test]
fn spotlights_throw_their_image() {
    let folder = tempfile::tempdir().unwrap();
    let picture = |name: &str, left: u8| {
        let path = folder.path().join(name);
        image::RgbImage::from_fn(8, 8, |x, _| image::Rgb([if x < 4 { left } else { 255 }; 3])).save(&path).unwrap();
        let spotlight = format!("slices.spotlight={}", path.display());
        let more = [
            "render.kind=slices",
            "lights.0.kind=cone",
            "lights.0.position=[11.5, -20, 11.5]",
            "lights.0.direction=[0, 1, 0]",
            "lights.0.angle=25",
            "lights.0.intensity=900",
            "cameras.0.azimuth=0",
            "cameras.0.elevation=0",
            &spotlight,
        ];
        frame_of(vec![0.3; EDGE * EDGE * EDGE], &sets(&COMMON, &more)).unwrap()
    };
    let (even, half) = (picture("even.png", 255), picture("half.png", 0));
    let side = |frame: &Frame, right: bool| {
        let of = frame.pixels.iter().enumerate().filter(|(i, _)| (i % 48 >= 24) == right);
        of.map(|(_, p)| f64::from(p[0])).sum::<f64>()
    };
    assert!((side(&even, true) / side(&even, false) - 1.0).abs() < 0.01);
    assert!((side(&half, true) / side(&even, true) - 1.0).abs() < 0.05, "the right half is as it was");
    assert!(side(&half, false) < 0.05 * side(&even, false), "the left half is dark");
}

/// The light volume is not solved for slices.
#[test]
fn no_light_volume_is_solved_for_slices() {
    let scene = Scene::parse("", "scene", &sets(&COMMON, &["render.kind=slices"])).unwrap();
    let mut session = Session::new(Arc::new(Cpu::new(2).unwrap()), scene, Some([0.0, 1.0]), false).unwrap();
    let field = Arc::new(Dense::new([EDGE; 3], blobs()));
    let out = session.advance(Timestep { step: 0, time: None, grid: Grid::new([EDGE; 3]), field }).unwrap();
    assert_eq!((out.row.sweeps, out.row.voxel_updates, out.row.start.as_str()), (0.0, 0, "none"));
}

#[test]
fn wrong_keys_are_named() {
    for (set, key) in [
        ("slices.resolution=0", "slices.resolution"),
        ("slices.blur=200", "slices.blur"),
        ("slices.attenuation=-1", "slices.attenuation"),
        ("slices.resolutoin=1", "slices.resolutoin"),
    ] {
        match Scene::parse("", "scene", &[set.to_string()]) {
            Err(Error::Scene { key: k, message, .. }) => {
                assert!(k == key && (message.contains("known: ") || message.contains("allowed: ")), "{message}")
            }
            other => panic!("{set}: {other:?}"),
        }
    }
    let scene =
        Scene::parse("", "scene", &["slices.spotlight=/nowhere.png".into(), "render.kind=slices".into()]).unwrap();
    assert!(matches!(Session::new(Arc::new(Cpu::new(1).unwrap()), scene, None, false), Err(Error::Io { .. })));
}
