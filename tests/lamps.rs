//! Point and cone lights in whole steps: closed forms (validation.md 4), Monte Carlo, and what a change of light costs.

use std::sync::Arc;

use glam::DVec3;
use gloaming::device::cpu::Cpu;
use gloaming::field::{Dense, Timestep};
use gloaming::light::{LightSolver, LightVolume, SolveReport};
use gloaming::medium::Medium;
use gloaming::scene::Scene;
use gloaming::session::Session;
use gloaming::sink::Output;
use gloaming::transfer::TransferFunction;
use gloaming::{Grid, lights};

#[path = "common/monte_carlo.rs"]
mod monte_carlo;

/// The unit cube.
fn cube(n: usize) -> Grid {
    Grid { spacing: [1.0 / n as f64; 3], origin: [0.5 / n as f64; 3], ..Grid::new([n; 3]) }
}

fn centre(grid: &Grid, i: usize) -> DVec3 {
    let [nx, ny, _] = grid.size;
    let p = DVec3::new((i % nx) as f64, (i / nx % ny) as f64, (i / (nx * ny)) as f64);
    DVec3::from(grid.origin) + p * DVec3::from(grid.spacing)
}

fn scene(sets: &[&str]) -> Scene {
    let common = ["transfer.colormap=white", "transfer.extinction=1", "render.size=[33, 33]"];
    let sets: Vec<String> = common.iter().chain(sets).map(|s| s.to_string()).collect();
    Scene::load(None, &sets).unwrap()
}

fn timestep(grid: Grid, value: impl Fn(DVec3) -> f64) -> Timestep {
    let values = (0..grid.len()).map(|i| value(centre(&grid, i)) as f32).collect();
    Timestep { step: 0, time: None, grid, field: Arc::new(Dense::new(grid.size, values)) }
}

/// One cold step, values 0..1 being the range of the transfer function.
fn step(grid: Grid, value: impl Fn(DVec3) -> f64, sets: &[&str]) -> Output {
    let mut session = Session::new(Arc::new(Cpu::new(2).unwrap()), scene(sets), Some([0.0, 1.0]), true).unwrap();
    session.advance(timestep(grid, value)).unwrap()
}

/// Red fluence.
fn fluence(output: &Output) -> (Grid, Vec<f64>) {
    let light = output.light.as_ref().unwrap();
    (light.grid, light.fluence.iter().map(|f| f64::from(f[0])).collect())
}

const POINT: &str = "lights.0.kind=point";
const CONE: &str = "lights.0.kind=cone";

#[test]
fn a_point_light_falls_off_by_the_square_of_the_distance() {
    let sets = [POINT, "lights.0.position=[0.42, 0.5, 0.55]", "lights.0.intensity=2", "light.scattering=false"];
    for resolution in ["light.resolution=1", "light.resolution=0.5"] {
        let (grid, got) = fluence(&step(cube(32), |_| 0.0, &[&sets[..], &[resolution]].concat()));
        for (i, got) in got.iter().enumerate() {
            let r = (centre(&grid, i) - DVec3::new(0.42, 0.5, 0.55)).length();
            // Coarse voxels hold the mean over 2³; its curvature is ½·6/r⁴ per unit of mean square distance, h²/4.
            // Beside the light a voxel holds its mean, above the middle's value by a twelfth of (h/r)².
            let bound = if grid.size[0] == 32 {
                1e-5 + 0.1 * (grid.spacing[0] / r).powi(2)
            } else {
                2.0 * (grid.spacing[0] / r).powi(2)
            };
            if r > 2.0 * grid.spacing[0] {
                assert!((got * r * r / 2.0 - 1.0).abs() < bound, "{} at distance {r}", got * r * r / 2.0);
            }
        }
    }
}

#[test]
fn a_cone_light_ends_at_its_angle() {
    let sets = [
        CONE,
        "lights.0.position=[0.5, 0.5, -0.3]",
        "lights.0.direction=[0.1, 0, 2]",
        "lights.0.angle=25",
        "lights.0.edge=10",
        "lights.0.intensity=1",
        "light.scattering=false",
        "light.resolution=1",
    ];
    let (grid, got) = fluence(&step(cube(32), |_| 0.0, &sets));
    let (tip, axis) = (DVec3::new(0.5, 0.5, -0.3), DVec3::new(0.1, 0.0, 2.0).normalize());
    let mut seen = [0; 3];
    for (i, got) in got.iter().enumerate() {
        let way = centre(&grid, i) - tip;
        let angle = way.angle_between(axis).to_degrees();
        let full = got * way.length_squared();
        match angle {
            a if a > 25.01 => assert_eq!(*got, 0.0, "outside, at {angle}°"),
            a if a < 14.99 => assert!((full - 1.0).abs() < 1e-5, "within, at {angle}°: {full}"),
            _ => {
                let t = (angle.to_radians().cos() - 25f64.to_radians().cos())
                    / (15f64.to_radians().cos() - 25f64.to_radians().cos());
                assert!((full - t * t * (3.0 - 2.0 * t)).abs() < 1e-4, "at the edge, {angle}°: {full}");
            }
        }
        seen[if angle > 25.01 { 0 } else { 1 + usize::from(angle < 14.99) }] += 1;
    }
    assert!(seen.iter().all(|n| *n > 100), "{seen:?}");
}

/// Fluence of area lights in vacuum: of a disk on its axis `2πL(1 − cos θ)`, its solid angle, and of all from afar as of a point
/// with a cosine.
#[test]
fn area_lights_shine_as_their_points_with_the_cosine_of_their_side() {
    let common = [
        "lights.0.position=[0.5, 0.5, -0.6]",
        "lights.0.direction=[0, 0, 1]",
        "light.scattering=false",
        "light.resolution=1",
    ];
    let with = |sets: &[&str]| fluence(&step(cube(16), |_| 0.0, &[&common[..], sets].concat()));
    let disk = ["lights.0.kind=disk", "lights.0.radius=0.5", "lights.0.intensity=2", "lights.0.samples=19"];
    let (grid, got) = with(&disk);
    for (i, got) in got.iter().enumerate() {
        let at = centre(&grid, i) - DVec3::new(0.5, 0.5, -0.6);
        if at.truncate().length() < 0.06 {
            let exact = 2.0 * std::f64::consts::TAU * (1.0 - at.z / (at.z * at.z + 0.25).sqrt());
            // 19 points for a disk as wide as 0.8 of the distance.
            assert!((got / exact - 1.0).abs() < 0.02, "{got} for {exact} at {at}");
        }
    }
    let small =
        ["lights.0.kind=rectangle", "lights.0.size=[0.02, 0.05]", "lights.0.units=intensity", "lights.0.intensity=3"];
    let (grid, got) = with(&small);
    for (i, got) in got.iter().enumerate() {
        let at = centre(&grid, i) - DVec3::new(0.5, 0.5, -0.6);
        let exact = 3.0 * at.z / at.length().powi(3);
        assert!((got / exact - 1.0).abs() < 2e-3, "{got} for {exact} at {at}");
    }
    // Nothing behind it.
    let behind = with(&[&small[..], &["lights.0.position=[0.5, 0.5, 1.5]"]].concat());
    assert!(behind.1.iter().all(|f| *f == 0.0));
}

/// Single scattering through a homogeneous box, `L = ∫ T σ_s p I/r² T_light ds`, against the integral.
#[test]
fn a_picture_of_single_scattering_is_the_integral() {
    for (g, light, cone) in [
        (0.0, DVec3::new(0.3, 0.6, 0.4), false),
        (0.6, DVec3::new(0.7, -0.4, 0.9), false),
        (-0.3, DVec3::new(0.2, 0.3, 1.4), true),
    ] {
        let position = format!("lights.0.position=[{}, {}, {}]", light.x, light.y, light.z);
        let anisotropy = format!("transfer.anisotropy={g}");
        let sets = [
            if cone { CONE } else { POINT },
            &position,
            &anisotropy,
            "lights.0.direction=[0.2, 0.1, -1]",
            "lights.0.angle=20",
            "lights.0.edge=20",
            "lights.0.intensity=1",
            "transfer.extinction=2",
            "transfer.albedo=0.9",
            "light.scattering=false",
            "render.step=0.25",
            "cameras.0.position=[3, -2, 1.5]",
            "cameras.0.target=[0.5, 0.5, 0.5]",
            "cameras.0.fov=24",
        ];
        let output = step(cube(48), |_| 1.0, &sets);
        let view = &output.frames[0];
        let [right, up, forward] = view.axes.map(|a| glam::Vec3::from(a).as_dvec3());
        let eye = glam::Vec3::from(view.eye).as_dvec3();
        let tan = (0.5 * f64::from(view.fov).to_radians()).tan();
        let (mut worst, mut brightest) = (0.0f64, 0.0f64);
        for y in (0..33).step_by(3) {
            for x in (0..33).step_by(3) {
                let at = |p: usize| 2.0 * (p as f64 + 0.5) / 33.0 - 1.0;
                let way = (forward + tan * (at(x) * right - at(y) * up)).normalize();
                let inside = |p: DVec3| p.min_element() >= 0.0 && p.max_element() <= 1.0;
                let (mut depth, mut sum) = (0.0f64, 0.0);
                let ds = 1e-3;
                for s in 0..6000 {
                    let p = eye + way * ((s as f64 + 0.5) * ds);
                    if !inside(p) {
                        continue;
                    }
                    let from = p - light;
                    let r = from.length();
                    // The part of the way from the light that lies in the box.
                    let steps = 200;
                    let within =
                        (0..steps).filter(|i| inside(light + from * ((*i as f64 + 0.5) / steps as f64))).count();
                    let lit = (-2.0 * r * within as f64 / steps as f64).exp();
                    let cos = (from / r).dot(-way);
                    let phase = (1.0 - g * g) / (4.0 * std::f64::consts::PI * (1.0 + g * g - 2.0 * g * cos).powf(1.5));
                    let axis = DVec3::new(0.2, 0.1, -1.0).normalize();
                    let t = ((from / r).dot(axis) - 20f64.to_radians().cos()) / (1.0 - 20f64.to_radians().cos());
                    let mask = if cone { t.clamp(0.0, 1.0).powi(2) * (3.0 - 2.0 * t.clamp(0.0, 1.0)) } else { 1.0 };
                    sum += (-2.0 * (depth + 0.5 * ds)).exp() * 2.0 * 0.9 * phase * mask / (r * r).max(1e-4) * lit * ds;
                    depth += ds;
                }
                let got = f64::from(view.frame.pixels[y * 33 + x][1]);
                worst = worst.max((got - sum).abs());
                brightest = brightest.max(sum);
            }
        }
        // Steps of a quarter of a voxel beside 1/r², and the light grid's error of the transmittance.
        assert!(worst < 0.02 * brightest, "g {g}, light {light}: off by {worst}, brightest {brightest}");
    }
}

fn soft_sphere(p: DVec3) -> f64 {
    let t = ((0.5 - (p - 0.5).length()) / 0.2).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// All orders of scattering against Monte Carlo, the light inside the medium and beside it.
#[test]
fn scattered_light_of_a_point_agrees_with_monte_carlo() {
    // Deep in the medium half of the light is scattered first within two voxels, which rays from there show.
    for (g, light, bound) in [(0.0, DVec3::new(0.45, 0.5, 0.55), 0.07), (0.5, DVec3::new(0.15, 0.2, 0.8), 0.04)] {
        let n = 24;
        let medium =
            monte_carlo::Medium { extinction: &|p| 8.0 * soft_sphere(p), majorant: 8.0, albedo: 0.9, anisotropy: g };
        let lamp = monte_carlo::Lamp::Point { position: light, intensity: 1.0 };
        let reference = monte_carlo::fluence(&medium, lamp, n, 60_000, 16);
        let position = format!("lights.0.position=[{}, {}, {}]", light.x, light.y, light.z);
        let anisotropy = format!("transfer.anisotropy={g}");
        let sets = [
            POINT,
            &position,
            &anisotropy,
            "lights.0.intensity=1",
            "transfer.extinction=8",
            "transfer.albedo=0.9",
            "light.tolerance=1e-3",
        ];
        let (grid, got) = fluence(&step(cube(2 * n), soft_sphere, &sets));
        let (mut off, mut noise, mut total) = (0.0, 0.0, 0.0);
        for (i, got) in got.iter().enumerate() {
            // Beside the light one voxel outshines all others.
            if (centre(&grid, i) - light).length() < 2.5 * grid.spacing[0] {
                continue;
            }
            off += (got - reference.mean[i]).powi(2);
            noise += reference.error[i].powi(2);
            total += reference.mean[i].powi(2);
        }
        assert!(noise < 0.003 * total, "the reference is too noisy: {}", (noise / total).sqrt());
        let error = ((off - noise).max(0.0) / total).sqrt();
        println!("g = {g}: relative RMS error {error}");
        assert!(error < bound, "g = {g}: relative RMS error {error}");
    }
}

/// A ball of light half blocked by a slab: sharp without a radius, and as wide as geometry says with one.
#[test]
fn a_radius_softens_shadows_and_keeps_the_light() {
    // An opaque half plane at z = 0.5, x < 0.5, lit from z = 0 straight below its edge.
    let slab = |p: DVec3| f64::from(u8::from((p.z - 0.5).abs() < 0.03 && p.x < 0.5));
    let row = |sets: &[&str]| {
        let sets = [
            &[POINT, "lights.0.position=[0.5, 0.5, 0]", "lights.0.intensity=1", "light.scattering=false"][..],
            &["light.resolution=1", "transfer.extinction=400"],
            sets,
        ]
        .concat();
        let (grid, got) = fluence(&step(cube(64), slab, &sets));
        let at = |i: usize| grid.index([i, 32, 60]);
        let vacuum = |i: usize| (centre(&grid, at(i)) - DVec3::new(0.5, 0.5, 0.0)).length_squared();
        (0..64).map(|i| got[at(i)] * vacuum(i)).collect::<Vec<_>>()
    };
    let width = |row: &[f64]| row.iter().filter(|l| (0.1..0.9).contains(*l)).count();
    let (hard, soft) = (row(&[]), row(&["lights.0.radius=0.1", "lights.0.samples=19"]));
    for row in [&hard, &soft] {
        assert!(row[2] < 0.01 && (row[62] - 1.0).abs() < 0.02, "{row:?}");
    }
    // At z = 0.95 the penumbra reaches 0.09 to each side: about 11 voxels, of which 10 to 90 % is two thirds.
    assert!(width(&hard) <= 4 && width(&soft) >= 6 && width(&soft) <= 13, "{hard:?}\n{soft:?}");
}

/// Solves one step after another with lights of its own.
struct Solves {
    cpu: Cpu,
    medium: Medium,
    solver: LightSolver,
    volume: LightVolume,
}

impl Solves {
    fn new(sets: &[&str]) -> Self {
        let (cpu, scene, grid) = (Cpu::new(2).unwrap(), scene(sets), cube(64));
        let table = TransferFunction::new(&scene.transfer).unwrap().table([0.0, 1.0], grid.mean_spacing());
        let mut medium = Medium::new(&cpu, grid, table.clone()).unwrap();
        medium.take(&cpu, &timestep(grid, soft_sphere)).unwrap();
        medium.classify(table);
        let solver = LightSolver::new(&cpu, &scene, &grid).unwrap();
        Solves { cpu, medium, solver, volume: LightVolume::default() }
    }

    fn solve(&mut self, sets: &[&str]) -> SolveReport {
        let lights = lights::resolve(&scene(sets)).unwrap();
        self.solver.solve(&self.cpu, &self.medium, &lights, &mut self.volume).unwrap()
    }
}

#[test]
fn a_light_that_changes_costs_what_it_must() {
    let base = ["light.scattering=false", "lights.0.direction=[0.2, 0.5, -1]"];
    let point = ["lights.1.kind=point", "lights.1.position=[0.1, 0.2, 0.3]"];
    let cone = ["lights.2.kind=cone", "lights.2.position=[0.5, 0.5, 1.3]", "lights.2.direction=[0, 0, -1]"];
    let sets = |more: &[&'static str]| [&base[..], &point, &cone, more].concat();
    let mut solves = Solves::new(&sets(&[]));
    let count = |report: SolveReport| (report.bricks_active, report.bricks_total);
    let cold = solves.solve(&sets(&[]));
    let bricks = cold.bricks_total / 3;
    assert!(bricks >= 8 && cold.bricks_active == cold.bricks_total);
    assert_eq!(count(solves.solve(&sets(&[]))), (0, 3 * bricks), "nothing changes");
    let brighter = ["lights.1.intensity=9", "lights.0.color=[1, 0, 0.5]", "lights.2.angle=50", "lights.2.edge=9"];
    assert_eq!(count(solves.solve(&sets(&brighter))), (0, 3 * bricks), "strength and cone are weights");
    assert_eq!(count(solves.solve(&sets(&["lights.2.direction=[0.3, 0, -1]"]))), (0, 3 * bricks), "a cone turns");
    assert_eq!(count(solves.solve(&sets(&["lights.1.position=[0.2, 0.2, 0.3]"]))), (bricks, 3 * bricks), "one moves");
    assert_eq!(
        count(solves.solve(&sets(&["lights.0.direction=[0.2, 0.4, -1]"]))),
        (2 * bricks, 3 * bricks),
        "two move"
    );
    let without =
        [&["light.scattering=false"][..], &["lights.0.kind=point", "lights.0.position=[0.1, 0.2, 0.3]"]].concat();
    assert_eq!(count(solves.solve(&without)), (0, bricks), "a light is taken away");
}
