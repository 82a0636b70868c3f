//! Isosurfaces (validation.md 14): where they are, what light does at them, and how layers make a picture.

use std::f64::consts::PI;
use std::sync::Arc;

use glam::{DVec3, Vec3};
use gloaming::camera::Camera;
use gloaming::device::cpu::Cpu;
use gloaming::device::emitter::{Emitter, Shape};
use gloaming::device::surface::{
    Attenuation, Beauty, Environment, Estimator, Hit, Map, Occlusion, Samples, Subsurface, Surface, Surfaces, distances,
};
use gloaming::device::{Buffer, Device, Phase, Sampling, Tally, Trace};
use gloaming::field::{Dense, Timestep};
use gloaming::frame::Frame;
use gloaming::render::isosurface::{Weights, composite};
use gloaming::scene::{Blend, Scene};
use gloaming::session::Session;
use gloaming::transfer::Table;
use gloaming::{BrickLayout, Error, Grid};

/// A field on a grid, ready for rays.
struct World {
    cpu: Cpu,
    grid: Grid,
    values: Vec<f32>,
    field: Buffer,
    bricks: BrickLayout,
    ranges: Vec<[f32; 2]>,
    surfaces: Vec<Surface>,
    camera: Camera,
    picture: [usize; 2],
}

impl World {
    /// `field` of positions in voxels.
    fn new(grid: Grid, field: impl Fn(Vec3) -> f32, values: &[f32], camera: Camera, picture: [usize; 2]) -> Self {
        let [nx, ny, _] = grid.size;
        let at = |i: usize| Vec3::new((i % nx) as f32, (i / nx % ny) as f32, (i / (nx * ny)) as f32);
        let numbers: Vec<f32> = (0..grid.len()).map(|i| field(at(i))).collect();
        let cpu = Cpu::new(2).unwrap();
        let mut buffer = cpu.alloc(grid.len()).unwrap();
        cpu.upload(&numbers, &mut buffer).unwrap();
        let bricks = BrickLayout::new(grid.size, 8);
        let ranges = cpu.brick_range(&bricks, &buffer).unwrap();
        let surfaces = values.iter().map(|v| Surface { value: *v, ..plain() }).collect();
        World { cpu, grid, values: numbers, field: buffer, bricks, ranges, surfaces, camera, picture }
    }

    fn distances(&self) -> Vec<f32> {
        let values: Vec<f32> = self.surfaces.iter().map(|s| s.value).collect();
        distances(&self.bricks, &self.ranges, &values)
    }

    fn with<'a>(&'a self, empty: &'a [f32]) -> Surfaces<'a> {
        Surfaces {
            grid: &self.grid,
            field: &self.field,
            bricks: self.bricks,
            empty,
            surfaces: &self.surfaces,
            clips: &[],
            step: 0.5 * self.grid.mean_spacing() as f32,
            camera: &self.camera,
            picture: self.picture,
        }
    }

    fn rays(&self) -> Vec<Hit> {
        (0..(self.picture[0] * self.picture[1]) as u32).map(Hit::ray).collect()
    }

    /// The first surface along each ray that meets one.
    fn hits(&self) -> Vec<Hit> {
        let mut hits = self.rays();
        self.cpu.surface_hits(&self.with(&self.distances()), &mut hits).unwrap();
        hits.retain(|h| h.surface != Hit::NONE);
        hits
    }

    /// Trilinear in f64.
    fn trilinear(&self, p: DVec3) -> f64 {
        let last = self.grid.size.map(|n| (n - 1) as f64);
        let p = DVec3::from_array(std::array::from_fn(|a| p[a].clamp(0.0, last[a])));
        let cell = p.to_array().map(|c| c as usize);
        let cell: [usize; 3] = std::array::from_fn(|a| cell[a].min(self.grid.size[a] - 2));
        (0..8).fold(0.0, |sum, corner| {
            let mut weight = 1.0;
            let mut at = cell;
            for a in 0..3 {
                let upper = corner >> a & 1;
                let f = p[a] - cell[a] as f64;
                weight *= if upper == 1 { f } else { 1.0 - f };
                at[a] += upper;
            }
            sum + weight * f64::from(self.values[self.grid.index(at)])
        })
    }
}

fn plain() -> Surface {
    Surface {
        value: 0.0,
        diffuse: [0.8, 0.6, 0.4],
        specular: 0.2,
        exponent: 30.0,
        exponent_gradient: 0.0,
        opacity: 1.0,
        transmission: 0.0,
        spread: 1e4,
        ior: 1.5,
    }
}

fn samples(end: u32) -> Samples {
    Samples { first: 0, end }
}

/// Twice as long along y, somewhere in the world.
fn stretched(n: usize) -> Grid {
    Grid { size: [n; 3], spacing: [0.5, 1.0, 0.5], origin: [3.0, -2.0, 7.0] }
}

fn world_of(grid: &Grid, p: Vec3) -> Vec3 {
    (DVec3::from(grid.origin) + p.as_dvec3() * DVec3::from(grid.spacing)).as_vec3()
}

/// World distances from the middle, and from a ring about it: fields that are no polynomials.
fn sphere(grid: Grid) -> impl Fn(Vec3) -> f32 {
    let middle = world_of(&grid, Vec3::from(grid.size.map(|n| 0.5 * n as f32 - 0.37)));
    move |p| world_of(&grid, p).distance(middle)
}

fn torus(grid: Grid, ring: f32) -> impl Fn(Vec3) -> f32 {
    let middle = world_of(&grid, Vec3::from(grid.size.map(|n| 0.5 * n as f32 - 0.37)));
    move |p| {
        let q = world_of(&grid, p) - middle;
        let out = (q.x * q.x + q.y * q.y).sqrt() - ring;
        (out * out + q.z * q.z).sqrt()
    }
}

fn outside(grid: &Grid) -> Camera {
    let (lo, hi) = grid.bounds();
    let centre = (0.5 * (lo + hi)).as_vec3();
    Camera::look_at(centre + Vec3::new(20.0, -55.0, 31.0), centre, Vec3::Z, 20.0)
}

/// Against the trilinear field, in f64 along the same ray with steps of a fiftieth of a voxel.
#[test]
fn hits_lie_on_the_first_crossing_of_the_trilinear_field() {
    let grid = stretched(40);
    let worlds = [
        World::new(grid, sphere(grid), &[7.3], outside(&grid), [48, 36]),
        World::new(grid, torus(grid, 7.0), &[2.6], outside(&grid), [48, 36]),
    ];
    for world in worlds {
        let iso = f64::from(world.surfaces[0].value);
        let hits = world.hits();
        assert!(hits.len() > 100, "{}", hits.len());
        let spacing = DVec3::from(grid.spacing);
        let voxel = grid.mean_spacing();
        let eye = (world.camera.eye.as_dvec3() - DVec3::from(grid.origin)) / spacing;
        let (mut head_on, mut worst) = (0, 0.0f64);
        for hit in &hits {
            let p = Vec3::from(hit.position).as_dvec3();
            // Distance to the surface: what is left of the value over the slope.
            let off = (world.trilinear(p) - iso).abs() / f64::from(hit.slope.abs()) / voxel;
            worst = worst.max(off);
            let way = ((p - eye) * spacing).normalize();
            let steep = -way.dot(Vec3::from(hit.normal).as_dvec3());
            if steep < 0.2 {
                continue;
            }
            head_on += 1;
            let at = |t: f64| world.trilinear(eye + t * way / spacing);
            let depth = f64::from(hit.depth);
            let start = depth - 6.0 * voxel;
            let before = at(start) < iso;
            let fine = 0.02 * voxel;
            let first = (1..400).map(|n| start + fine * f64::from(n)).find(|t| (at(*t) < iso) != before).unwrap();
            let (mut a, mut b) = (first - fine, first);
            for _ in 0..40 {
                let m = 0.5 * (a + b);
                if (at(m) < iso) == before { a = m } else { b = m }
            }
            assert!((depth - b).abs() < 1e-3 * voxel / steep, "{depth} {b} at {p}");
        }
        assert!(worst < 1e-3 && head_on > 80, "{worst} voxels, {head_on} rays");
        println!("{} hits, at most {worst:.1e} voxels from the surface", hits.len());
    }
}

/// Against the analytic surfaces.
#[test]
fn normals_are_those_of_the_analytic_surface_and_face_the_viewer() {
    let grid = Grid { spacing: [0.5, 0.6, 0.5], ..stretched(56) };
    let middle = world_of(&grid, Vec3::splat(28.0 - 0.37));
    let ring = 8.0;
    for (world, torus) in [
        (World::new(grid, sphere(grid), &[9.0], outside(&grid), [40, 40]), false),
        (World::new(grid, torus(grid, ring), &[4.0], outside(&grid), [40, 40]), true),
    ] {
        let hits = world.hits();
        assert!(hits.len() > 100);
        for hit in hits {
            let q = world_of(&grid, hit.position.into()) - middle;
            let nearest = if torus { Vec3::new(q.x, q.y, 0.0).normalize() * ring } else { Vec3::ZERO };
            let normal = Vec3::from(hit.normal);
            let apart = normal.angle_between(q - nearest).to_degrees();
            assert!(apart < 0.5, "{apart} degrees at {q}");
            // Distance grows outwards: the gradient faces the viewer, and its size is 1.
            assert!((hit.slope - 1.0).abs() < 0.02, "{}", hit.slope);
        }
    }
    // The other way round the gradient points away, and is turned.
    let inward = sphere(grid);
    let world = World::new(grid, move |p| -inward(p), &[-9.0], outside(&grid), [12, 12]);
    let hits = world.hits();
    assert!(!hits.is_empty() && hits.iter().all(|h| h.slope < -0.9));
}

#[test]
fn skipping_bricks_moves_no_hit_and_rays_go_on_to_what_is_behind() {
    let grid = stretched(40);
    let world = World::new(grid, sphere(grid), &[3.0, 7.0], outside(&grid), [48, 36]);
    let empty = world.distances();
    assert!(empty.contains(&0.0) && empty.iter().any(|d| *d > 0.0));
    let [mut skipping, mut all] = [world.rays(), world.rays()];
    let mut order = vec![Vec::new(); all.len()];
    for _ in 0..6 {
        world.cpu.surface_hits(&world.with(&empty), &mut skipping).unwrap();
        world.cpu.surface_hits(&world.with(&[]), &mut all).unwrap();
        assert_eq!(skipping, all);
        all.iter().filter(|h| h.surface != Hit::NONE).for_each(|h| order[h.pixel as usize].push((h.surface, h.depth)));
    }
    assert!(all.iter().all(|h| h.surface == Hit::NONE), "every ray leaves in the end");
    let mut through = 0;
    for met in &order {
        let surfaces: Vec<u32> = met.iter().map(|(s, _)| *s).collect();
        assert!(matches!(surfaces[..], [] | [1, 1] | [1, 0, 0, 1]), "{surfaces:?}");
        assert!(met.windows(2).all(|w| w[0].1 < w[1].1));
        through += usize::from(surfaces.len() == 4);
    }
    assert!(through > 20, "{through}");
}

#[test]
fn holes_have_no_surface() {
    let grid = Grid::new([32; 3]);
    let ball = |p: Vec3| if p.distance(Vec3::splat(15.5)) < 9.0 { -1e38 } else { 1.0 };
    let world = World::new(grid, ball, &[0.5], outside(&grid), [24, 24]);
    assert!(world.hits().is_empty());
}

fn open(world: &World, hits: &[Hit], occlusion: &Occlusion, rays: u32) -> Vec<[f32; 4]> {
    let mut sums = vec![[0.0; 4]; hits.len()];
    world.cpu.surface_occlusion(&world.with(&[]), occlusion, samples(rays), hits, &mut sums).unwrap();
    sums.iter().map(|s| s.map(|v| v / rays as f32)).collect()
}

#[test]
fn a_plane_is_open_and_a_cavity_is_closed() {
    for estimator in [Estimator::Normalised, Estimator::Paper] {
        let occlusion = Occlusion { radius: 12.0, steps: 20, estimator, seed: 0 };
        let grid = stretched(32);
        let tilted = |p: Vec3| world_of(&grid, p).dot(Vec3::new(0.1, 0.2, 0.95).normalize());
        let camera = outside(&grid);
        let iso = tilted(Vec3::splat(15.2));
        let plane = World::new(grid, tilted, &[iso], camera, [24, 24]);
        let hits = plane.hits();
        let sums = open(&plane, &hits, &occlusion, 64);
        assert!(hits.len() > 50 && sums.iter().all(|s| s[3] == 1.0), "{estimator:?}");
        if estimator == Estimator::Normalised {
            // Nothing bends the normal: the mean of the directions is 2/3 n.
            for (hit, sum) in hits.iter().zip(&sums) {
                let bent = Vec3::new(sum[0], sum[1], sum[2]);
                assert!((bent - 2.0 / 3.0 * Vec3::from(hit.normal)).length() < 0.03, "{bent}");
            }
        }

        // From inside a ball whose wall is nearer than a ray is long.
        let grid = Grid::new([32; 3]);
        let middle = Vec3::splat(15.5);
        let camera = Camera::look_at(middle, middle + Vec3::new(0.3, 1.0, 0.2), Vec3::Z, 70.0);
        let cavity = World::new(grid, move |p| p.distance(middle), &[5.0], camera, [16, 16]);
        let hits = cavity.hits();
        assert_eq!(hits.len(), 256);
        assert!(open(&cavity, &hits, &Occlusion { steps: 40, ..occlusion }, 64).iter().all(|s| s[3] == 0.0));
    }
}

/// Between two parallel planes a ray meets the other one when its slope and its length suffice; transparent planes take their
/// opacity away from it.
#[test]
fn occlusion_between_planes_has_its_closed_form() {
    let (gap, radius, steps) = (6.0f64, 15.0f64, 30u32);
    let grid = Grid::new([64, 64, 17]);
    let camera = Camera::look_at(Vec3::new(31.5, 30.0, 8.0), Vec3::new(32.0, 31.0, 4.0), Vec3::Z, 30.0);
    for opacity in [1.0f32, 0.3] {
        let mut world = World::new(grid, |p| (p.z - 8.0).abs(), &[0.5 * gap as f32], camera, [8, 8]);
        world.surfaces[0].opacity = opacity;
        let hits = world.hits();
        assert_eq!(hits.len(), 64);
        for estimator in [Estimator::Normalised, Estimator::Paper] {
            let occlusion = Occlusion { radius: radius as f32, steps, estimator, seed: 3 };
            let sums = open(&world, &hits, &occlusion, 256);
            let mean = sums.iter().map(|s| f64::from(s[3])).sum::<f64>() / 64.0;
            // The last sample is at (steps − 1 + u)·radius/steps, u even in 0..1; rays start a tenth of a voxel off.
            let escape = |u: f64| {
                let least = (gap - 0.1) / ((f64::from(steps - 1) + u) * radius / f64::from(steps));
                if estimator == Estimator::Normalised { least * least } else { least }
            };
            let open = (0..1000).map(|i| escape((f64::from(i) + 0.5) / 1000.0)).sum::<f64>() / 1000.0;
            let exact = open + (1.0 - open) * (1.0 - f64::from(opacity));
            // 64 pixels of 256 rays: a standard error of 0.004 for independent draws.
            assert!((mean - exact).abs() < 0.01, "{estimator:?}: {mean} is not {exact}");
        }
    }
}

/// A map of the radiance of directions.
fn map(cpu: &Cpu, edge: usize, radiance: impl Fn(Vec3) -> Vec3 + Sync) -> (Buffer, Map) {
    let texels = Map::tabulate(edge, |at| radiance(Map::direction((at + 0.5) / edge as f32).normalize()));
    let mut buffer = cpu.alloc(texels.len()).unwrap();
    cpu.upload(&texels, &mut buffer).unwrap();
    (buffer, Map { first: 0, edge })
}

fn beauty<'a>(environment: Environment<'a>, estimator: Estimator) -> Beauty<'a> {
    Beauty { environment, diffuse: samples(64), specular: samples(128), bent: &[], estimator, seed: 1 }
}

#[test]
fn under_the_same_light_from_everywhere_a_lobe_returns_that_light() {
    let grid = stretched(40);
    let world = World::new(grid, sphere(grid), &[7.3], outside(&grid), [24, 20]);
    let hits = world.hits();
    let light = Vec3::new(0.5, 1.0, 2.0);
    let (texels, radiance) = map(&world.cpu, 2, |_| light);
    let environment = Environment { texels: &texels, radiance, filtered: None };
    let mut sums = vec![[[0.0; 3]; 2]; hits.len()];
    let normalised = beauty(environment, Estimator::Normalised);
    world.cpu.surface_beauty(&world.with(&[]), &normalised, &hits, &mut sums).unwrap();
    for [diffuse, specular] in &sums {
        // Sums of 64 and 128 terms, each rounded.
        assert!((Vec3::from(*diffuse) / 64.0 - light).abs().max_element() < 1e-5);
        assert!((Vec3::from(*specular) / 128.0 - light).abs().max_element() < 1e-5);
    }
    // The published averages: ∫ cos/2π dω = 1/2 for the diffuse lobe.
    let mut sums = vec![[[0.0; 3]; 2]; hits.len()];
    let paper = beauty(environment, Estimator::Paper);
    world.cpu.surface_beauty(&world.with(&[]), &paper, &hits, &mut sums).unwrap();
    let mean = sums.iter().map(|s| s[0][1] / 64.0).sum::<f32>() / hits.len() as f32;
    // cos even in 0..1: a standard deviation of 0.29 over 64 directions each.
    assert!((mean - 0.5).abs() < 4.0 * 0.29 / (64.0 * hits.len() as f32).sqrt(), "{mean}");
}

/// Radiance linear in a direction has closed forms: 2/3 of its slope about the normal for Lambert's cosine, (s + 1)/(s + 2) for a
/// Phong lobe.
#[test]
fn lobes_under_a_linear_sky_have_their_closed_form() {
    let grid = stretched(40);
    let world = World::new(grid, sphere(grid), &[7.3], outside(&grid), [24, 20]);
    let hits = world.hits();
    let slope = Vec3::new(0.2, -0.3, 0.5);
    let (texels, radiance) = map(&world.cpu, 128, |way| Vec3::splat(1.0 + slope.dot(way)));
    let environment = Environment { texels: &texels, radiance, filtered: None };
    let mut sums = vec![[[0.0; 3]; 2]; hits.len()];
    let of = Beauty { diffuse: samples(256), specular: samples(256), ..beauty(environment, Estimator::Normalised) };
    world.cpu.surface_beauty(&world.with(&[]), &of, &hits, &mut sums).unwrap();
    let mut compared = 0;
    for (hit, sum) in hits.iter().zip(&sums) {
        let normal = Vec3::from(hit.normal);
        let diffuse = 1.0 + 2.0 / 3.0 * slope.dot(normal);
        assert!((sum[0][0] / 256.0 - diffuse).abs() < 0.01, "{} {diffuse}", sum[0][0] / 256.0);
        let view = (world_of(&grid, hit.position.into()) - world.camera.eye).normalize();
        // Away from grazing views nothing of the lobe is mirrored at the surface.
        if -view.dot(normal) > 0.8 {
            let mirrored = view - 2.0 * view.dot(normal) * normal;
            let specular = 1.0 + 31.0 / 32.0 * slope.dot(mirrored);
            assert!((sum[1][0] / 256.0 - specular).abs() < 0.01, "{} {specular}", sum[1][0] / 256.0);
            compared += 1;
        }
    }
    assert!(compared > 30);
}

#[test]
fn samples_split_over_calls_and_threads_give_the_same_sums() {
    let grid = stretched(32);
    let mut world = World::new(grid, sphere(grid), &[3.0, 6.3], outside(&grid), [16, 12]);
    world.surfaces[1].transmission = 0.4;
    world.surfaces[0].transmission = 0.2;
    let hits = world.hits();
    let (texels, radiance) = map(&world.cpu, 16, |way| Vec3::new(1.0, 1.5 + way.x, 2.0 - way.z));
    let environment = Environment { texels: &texels, radiance, filtered: None };
    let run = |cpu: &Cpu, estimator: Estimator, parts: &[u32]| {
        let surfaces = world.with(&[]);
        let mut open = vec![[0.0; 4]; hits.len()];
        let mut lobes = vec![[[0.0; 3]; 2]; hits.len()];
        let mut beneath = vec![[0.0; 3]; hits.len()];
        for part in parts.windows(2) {
            let part = Samples { first: part[0], end: part[1] };
            let occlusion = Occlusion { radius: 6.0, steps: 10, estimator, seed: 0 };
            cpu.surface_occlusion(&surfaces, &occlusion, part, &hits, &mut open).unwrap();
            let beauty = Beauty { diffuse: part, specular: part, ..beauty(environment, estimator) };
            cpu.surface_beauty(&surfaces, &beauty, &hits, &mut lobes).unwrap();
            let below = Subsurface { primary: part, ..subsurface(environment, estimator) };
            cpu.surface_subsurface(&surfaces, &below, &hits, &mut beneath).unwrap();
        }
        (open, lobes, beneath)
    };
    for estimator in [Estimator::Normalised, Estimator::Paper] {
        let whole = run(&world.cpu, estimator, &[0, 20]);
        assert_eq!(whole, run(&world.cpu, estimator, &[0, 3, 4, 20]));
        assert_eq!(whole, run(&Cpu::new(1).unwrap(), estimator, &[0, 20]));
        assert!(whole.2.iter().any(|s| s[0] > 0.0));
    }
}

fn subsurface(environment: Environment, estimator: Estimator) -> Subsurface {
    Subsurface {
        environment,
        primary: samples(4),
        secondary: 4,
        fast: false,
        refracts: false,
        attenuation: Attenuation { rate: [0.0; 3], table: None },
        estimator,
        seed: 0,
    }
}

/// Straight in through a shell of radius R to one of radius r, over the hemisphere, and out again through R.
#[test]
fn subsurface_scattering_between_concentric_shells_has_its_closed_forms() {
    let grid = Grid::new([40; 3]);
    let middle = Vec3::splat(19.5);
    let (outer, inner) = (14.0f64, 11.0f64);
    // Rays that go through the middle.
    let camera = Camera::look_at(middle + Vec3::new(0.0, -80.0, 0.0), middle, Vec3::Z, 0.5);
    let mut world = World::new(grid, move |p| p.distance(middle), &[inner as f32, outer as f32], camera, [4, 4]);
    let transmission = 0.6f64;
    world.surfaces[1].transmission = transmission as f32;
    world.surfaces[0].diffuse = [0.8, 0.5, 0.2];
    let hits = world.hits();
    assert!(hits.len() == 16 && hits.iter().all(|h| h.surface == 1));
    let light = 1.7f64;
    let (texels, radiance) = map(&world.cpu, 2, |_| Vec3::splat(light as f32));
    let environment = Environment { texels: &texels, radiance, filtered: None };
    let take = |rate: f64, fast: bool| {
        let attenuation = Attenuation { rate: [rate as f32; 3], table: None };
        let of = Subsurface {
            primary: samples(8),
            secondary: 64,
            fast,
            attenuation,
            ..subsurface(environment, Estimator::Normalised)
        };
        let mut sums = vec![[0.0; 3]; hits.len()];
        world.cpu.surface_subsurface(&world.with(&world.distances()), &of, &hits, &mut sums).unwrap();
        sums.iter().map(|s| f64::from(s[0]) / 8.0).sum::<f64>() / hits.len() as f64
    };
    let all = transmission * transmission * 0.8 * light;
    // Nothing is lost between the shells: both ways are the same, for every ray.
    assert!((take(0.0, true) - all).abs() < 1e-5 * all && (take(0.0, false) - all).abs() < 1e-5 * all);
    for rate in [0.01, 0.1] {
        let straight = (-rate * (outer - inner)).exp();
        // ∫ 2 cos sin e^(−κ l(θ)) dθ, l the way from r to R at θ off the radius.
        let n = 4000;
        let out: f64 = (0..n)
            .map(|i| {
                let theta = (f64::from(i) + 0.5) / f64::from(n) * 0.5 * PI;
                let across = inner * theta.sin();
                let length = (outer * outer - across * across).sqrt() - inner * theta.cos();
                2.0 * theta.cos() * theta.sin() * (-rate * length).exp() * 0.5 * PI / f64::from(n)
            })
            .sum();
        let (fast, accurate) = (take(rate, true), take(rate, false));
        // Interpolation puts the shells within a fiftieth of a voxel of where they are.
        assert!((fast - all * straight * straight).abs() < 0.005 * all, "{rate}: fast {fast}");
        assert!((accurate - all * straight * out).abs() < 0.005 * all, "{rate}: accurate {accurate}");
        // Published claim: little difference for shells; it is the longer way of slanted rays.
        assert!((fast - accurate).abs() < 1.6 * rate * (outer - inner) * fast, "{rate}: {fast} {accurate}");
    }
}

/// Light that goes straight through both sides of a shell around nothing is dimmed by its way.
#[test]
fn light_passes_through_a_ball_by_the_length_of_its_way() {
    let grid = Grid::new([40; 3]);
    let middle = Vec3::splat(19.5);
    let camera = Camera::look_at(middle + Vec3::new(0.0, -80.0, 0.0), middle, Vec3::Z, 0.5);
    // The wall behind reflects what comes to it.
    let mut world = World::new(grid, move |p| p.distance(middle), &[10.0], camera, [2, 2]);
    world.surfaces[0].transmission = 0.5;
    world.surfaces[0].diffuse = [1.0; 3];
    let hits = world.hits();
    let (texels, radiance) = map(&world.cpu, 2, |_| Vec3::ONE);
    let environment = Environment { texels: &texels, radiance, filtered: None };
    let rate = 0.05f64;
    let of = Subsurface {
        attenuation: Attenuation { rate: [rate as f32; 3], table: None },
        fast: true,
        ..subsurface(environment, Estimator::Normalised)
    };
    let mut sums = vec![[0.0; 3]; hits.len()];
    world.cpu.surface_subsurface(&world.with(&[]), &of, &hits, &mut sums).unwrap();
    let exact = (0.5 * (-rate * 20.0).exp()).powi(2);
    for sum in sums {
        assert!((f64::from(sum[0]) / 4.0 - exact).abs() < 0.01 * exact, "{} {exact}", sum[0] / 4.0);
    }
}

/// Optics by value, 0 to 1, in steps a four-thousandth wide: extinction and albedo from each value on.
fn steep(steps: &[(f32, f32, f32)]) -> Table {
    let entries = 4097;
    let at = |i: usize| {
        let value = i as f32 / (entries - 1) as f32;
        steps.iter().rev().find(|s| s.0 < value).map_or((0.0, 0.0), |s| (s.1, s.2))
    };
    Table {
        lo: 0.0,
        hi: 1.0,
        extinction: (0..entries).map(|i| at(i).0).collect(),
        albedo: (0..entries).map(|i| [at(i).1; 3]).collect(),
        ..Default::default()
    }
}

/// What the path tracer sees of a medium that has scattered light of `emitter` evenly, once.
fn traced(world: &World, table: &Table, emitter: Emitter, samples: u32) -> Vec<f64> {
    let trace = Trace {
        grid: &world.grid,
        field: &world.field,
        gradient: None,
        table,
        surface: None,
        bricks: world.bricks,
        majorant: &table.majorants(&world.ranges),
        emitters: &[Emitter { share: 1.0, visible: false, ..emitter }],
        images: &[],
        camera: &world.camera,
        focus: 1.0,
        clips: &[],
        meshes: None,
        phase: Phase::HenyeyGreenstein(0.0),
        sampling: Sampling::Both,
        depth: 1,
        seed: 5,
        samples: 0..samples,
    };
    let mut tallies = vec![Tally::default(); world.picture[0] * world.picture[1]];
    assert_eq!(world.cpu.trace(&trace, world.picture, &mut tallies).unwrap().exceeded, 0);
    tallies.iter().map(|t| t.radiance[0] / f64::from(samples)).collect()
}

/// Radiance of a half-space that scatters all light evenly, once, under a light of 1 from all of the other, seen at a cosine
/// `o`: `∫ i/(i + o) di / 2` (Lommel & Seeliger), i the cosine of the light.
fn lommel_seeliger(o: f64) -> f64 {
    0.5 * (1.0 - o * ((1.0 + o) / o).ln())
}

/// The rays that make ambient occlusion see what the path tracer sees: where a transfer function is as steep as a surface, light that
/// is scattered once comes from each direction with a weight of i/(i + o) instead of i, for both the same rays.
#[test]
fn occlusion_is_what_the_path_tracer_sees() {
    let grid = Grid::new([40; 3]);
    // A pit in a plane, smooth: gradients are taken over two voxels.
    let middle = Vec3::new(19.5, 19.5, 20.0);
    let above = move |p: Vec3| p.z - 28.0 + 20.0 * (-p.distance_squared(middle.with_z(p.z)) / 50.0).exp();
    let camera = Camera::look_at(middle + Vec3::new(0.0, -12.0, 80.0), middle, Vec3::Y, 15.0);
    let world = World::new(grid, move |p| (0.5 - above(p) / 80.0).clamp(0.0, 1.0), &[0.5], camera, [30, 30]);
    // A fortieth of a voxel into the surface, on average.
    let seen =
        traced(&world, &steep(&[(-1.0, 0.0, 1.0), (0.5, 40.0, 1.0)]), Emitter::new(Shape::Environment, [1.0; 3]), 128);
    let mut hits = world.hits();
    let facing = |hit: &Hit| f64::from(-(Vec3::from(hit.position) - camera.eye).normalize().dot(hit.normal.into()));
    hits.retain(|hit| facing(hit) > 0.4);
    // Steps of half a voxel to beyond the volume.
    let occlusion = Occlusion { radius: 80.0, steps: 160, estimator: Estimator::Normalised, seed: 2 };
    let rays = 64;
    let (mut weighed, mut open) = (vec![0.0f64; hits.len()], vec![0.0f64; hits.len()]);
    for n in 0..rays {
        // A ray at a time, which tells its direction.
        let mut sums = vec![[0.0; 4]; hits.len()];
        let one = Samples { first: n, end: n + 1 };
        world.cpu.surface_occlusion(&world.with(&[]), &occlusion, one, &hits, &mut sums).unwrap();
        for (h, (hit, sum)) in hits.iter().zip(&sums).enumerate() {
            let cosine = Vec3::new(sum[0], sum[1], sum[2]).dot(hit.normal.into());
            open[h] += f64::from(sum[3]) / f64::from(rays);
            weighed[h] += f64::from(sum[3]) / (4.0 * (f64::from(cosine) + facing(hit))) / f64::from(rays);
        }
    }
    // By other rays, so that their noise does not choose.
    let mut others = vec![[0.0; 4]; hits.len()];
    let more = Samples { first: rays, end: 2 * rays };
    world.cpu.surface_occlusion(&world.with(&[]), &occlusion, more, &hits, &mut others).unwrap();
    let mut order: Vec<usize> = (0..hits.len()).collect();
    order.sort_by(|x, y| others[*x][3].total_cmp(&others[*y][3]));
    let mean = |of: &dyn Fn(usize) -> f64, some: &[usize]| some.iter().map(|h| of(*h)).sum::<f64>() / some.len() as f64;
    let by_tracing = |h: usize| seen[hits[h].pixel as usize];
    let quarter = order.len() / 4;
    for (part, some) in [("all", &order[..]), ("most occluded", &order[..quarter]), ("open", &order[3 * quarter..])] {
        let (rays, paths) = (mean(&|h| weighed[h], some), mean(&by_tracing, some));
        let layer = mean(&|h| open[h], some);
        let ratio = mean(&|h| by_tracing(h) / lommel_seeliger(facing(&hits[h])), some);
        println!(
            "{part}: {rays:.4} by rays, {paths:.4} by paths; layer {layer:.3}, light over that of a plane {ratio:.3}"
        );
        // Means over a hundred hits or more of 64 rays and 128 paths, each of a standard deviation below its mean.
        assert!(some.len() > 80 && (rays / paths - 1.0).abs() < 0.025, "{part}: {rays} by rays, {paths} by paths");
        // The weights are different: light that grazes the surface counts for more here than by Lambert's cosine, and is hidden first.
        assert!((layer - ratio).abs() < 0.08, "{part}: {layer} and {ratio}");
    }
    let (least, most) = (mean(&|h| open[h], &order[..quarter]), mean(&|h| open[h], &order[3 * quarter..]));
    assert!(least < 0.5 && most > 0.85, "{least} {most}");
}

/// Light from beneath is transport where nothing scatters between the surfaces, and there it is the path tracer's: an absorbing shell
/// dims what a white core throws back by the same factor, but for the weights of directions, whose closed forms are known.
#[test]
fn light_from_beneath_is_dimmed_as_the_path_tracer_has_it() {
    let grid = Grid::new([44; 3]);
    let middle = Vec3::splat(21.5);
    let (outer, inner) = (16.0f64, 10.0f64);
    let value = |r: f64| 1.0 - r / 24.0;
    let camera = Camera::look_at(middle + Vec3::new(0.0, -90.0, 0.0), middle, Vec3::Z, 1.0);
    let values = [value(outer) as f32, value(inner) as f32];
    let mut world = World::new(grid, move |p| (1.0 - p.distance(middle) / 24.0).max(0.0), &values, camera, [6, 6]);
    (world.surfaces[0].transmission, world.surfaces[0].ior) = (1.0, 1.0);
    world.surfaces[1].diffuse = [1.0; 3];
    let hits = world.hits();
    assert!(hits.len() == 36 && hits.iter().all(|h| h.surface == 0));
    let beneath = |world: &World, rate: f32, sky: &(dyn Fn(Vec3) -> Vec3 + Sync)| {
        let (texels, radiance) = map(&world.cpu, 32, sky);
        let environment = Environment { texels: &texels, radiance, filtered: None };
        let attenuation = Attenuation { rate: [rate; 3], table: None };
        let of = Subsurface {
            primary: samples(8),
            secondary: 64,
            attenuation,
            ..subsurface(environment, Estimator::Normalised)
        };
        let mut sums = vec![[0.0; 3]; hits.len()];
        world.cpu.surface_subsurface(&world.with(&world.distances()), &of, &hits, &mut sums).unwrap();
        sums.iter().map(|s| f64::from(s[0]) / 8.0).sum::<f64>() / hits.len() as f64
    };
    let even = |_: Vec3| Vec3::ONE;
    let mean = |seen: Vec<f64>| seen.iter().sum::<f64>() / seen.len() as f64;
    let medium = |rate: f32, albedo: f32| steep(&[(values[0], rate, 0.0), (values[1], 40.0, albedo)]);
    let sky = Emitter::new(Shape::Environment, [1.0; 3]);
    let clear = (beneath(&world, 0.0, &even), mean(traced(&world, &medium(0.0, 1.0), sky, 512)));
    assert!((clear.0 - 1.0).abs() < 1e-4, "{}", clear.0);
    for rate in [0.01f64, 0.05] {
        // ∫ w e^(−κ l) dθ / ∫ w dθ, l the way from the core to the outer surface.
        let dimmed = |weight: &dyn Fn(f64) -> f64| {
            let n = 4000;
            let (mut sum, mut weights) = (0.0, 0.0);
            for theta in (0..n).map(|i| (f64::from(i) + 0.5) / f64::from(n) * 0.5 * PI) {
                let way = (outer * outer - (inner * theta.sin()).powi(2)).sqrt() - inner * theta.cos();
                let weight = weight(theta.cos()) * theta.sin();
                sum += weight * (-rate * way).exp();
                weights += weight;
            }
            (-rate * (outer - inner)).exp() * sum / weights
        };
        let (lambert, seeliger) = (dimmed(&|i| i), dimmed(&|i| i / (i + 1.0)));
        let layer = beneath(&world, rate as f32, &even) / clear.0;
        let traced = mean(traced(&world, &medium(rate as f32, 1.0), sky, 512)) / clear.1;
        println!("{rate}: layer {layer:.4} of {lambert:.4}, paths {traced:.4} of {seeliger:.4}");
        assert!((layer / lambert - 1.0).abs() < 0.005, "{layer} {lambert}");
        // 36 pixels of 512 paths, half of which see the sky: a standard error of 0.7 %, twice.
        assert!((traced / seeliger - 1.0).abs() < 0.03, "{traced} {seeliger}");
        assert!((layer / traced - 1.0).abs() < (lambert / seeliger - 1.0).abs() + 0.03, "{layer} {traced}");
    }
    // Nothing comes from a black core, through a thick shell, or from a light behind the core.
    assert!(mean(traced(&world, &medium(0.05, 0.0), sky, 64)) == 0.0);
    assert!(mean(traced(&world, &medium(1.5, 1.0), sky, 64)) < 1e-3 && beneath(&world, 1.5, &even) < 1e-3);
    let behind = Emitter { axis: Vec3::NEG_Y, ..Emitter::new(Shape::Distant, [1.0; 3]) };
    assert!(mean(traced(&world, &medium(0.01, 1.0), behind, 64)) < 1e-6);
    assert!(beneath(&world, 0.01, &|way: Vec3| Vec3::splat(if way.y > 0.2 { 1.0 } else { 0.0 })) < 1e-3);
    world.surfaces[1].diffuse = [0.0; 3];
    assert!(beneath(&world, 0.05, &even) == 0.0);
}

fn scene(text: &str) -> Scene {
    let text = format!("[render]\nkind = \"isosurface\"\nsize = [48, 40]\n{text}");
    Scene::parse(&text, "test", &[]).unwrap_or_else(|e| panic!("{e}"))
}

fn step(grid: Grid, field: impl Fn(Vec3) -> f32) -> Timestep {
    let [nx, ny, _] = grid.size;
    let at = |i: usize| Vec3::new((i % nx) as f32, (i / nx % ny) as f32, (i / (nx * ny)) as f32);
    let values = (0..grid.len()).map(|i| field(at(i))).collect();
    Timestep { step: 0, time: None, grid, field: Arc::new(Dense::new(grid.size, values)) }
}

fn render(scene: Scene, step: &Timestep, wants_light: bool) -> (Frame, gloaming::ledger::LedgerRow) {
    let device = Arc::new(Cpu::new(2).unwrap());
    let mut session = Session::new(device, scene, Some([0.0, 1.0]), wants_light).unwrap();
    let output = session.advance(step.clone()).unwrap();
    (output.frames[0].frame.clone(), output.row)
}

/// A ball of falling values with another one beside it.
fn balls(n: usize) -> Timestep {
    let n = n as f32;
    step(Grid::new([n as usize; 3]), move |p| {
        let ball = |x: f32, y: f32, z: f32, r: f32| 1.0 - p.distance(n * Vec3::new(x, y, z)) / (r * n);
        ball(0.4, 0.5, 0.55, 0.4).max(ball(0.75, 0.4, 0.4, 0.3)).max(0.0)
    })
}

const EVERYTHING: &str = "[isosurface]\nvalues = [0.3, 0.6]\nopacity = [0.4, 1]\nquality = \"preview\"\nantialias = 2\n\
    light = \"both\"\ntransmission = [0.2, 0]\nsss = \"accurate\"\nocclusion = \"bent\"\nblend = \"fresnel\"\nior = 2.5\n\
    [light]\nscattering = false\n[[lights]]\n[[lights]]\nkind = \"environment\"\ncolor = [0.3, 0.4, 0.5]\n";

#[test]
fn layers_make_the_picture_to_the_bit_also_from_a_file() {
    let (frame, _) = render(scene(EVERYTHING), &balls(24), false);
    assert!(frame.pixels.iter().any(|p| p[3] > 0.9) && frame.pixels.iter().any(|p| p[3] == 0.0));
    let bits = |f: &Frame| f.pixels.iter().map(|p| p.map(f32::to_bits)).collect::<Vec<_>>();
    let again = composite(&frame, &Weights::default()).unwrap();
    assert_eq!(bits(&frame), bits(&again));

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("layers.exr");
    gloaming::sink::exr::write_frame(&path, &frame).unwrap();
    let read = gloaming::sink::exr::read(&path).unwrap();
    assert_eq!(bits(&frame), bits(&composite(&read, &Weights::default()).unwrap()));

    // Weights do what they say.
    let lit = |weights: Weights| composite(&read, &weights).unwrap().pixels;
    let only_beneath = lit(Weights { diffuse: 0.0, specular: 0.0, ..Weights::default() });
    let doubled = lit(Weights { diffuse: 0.0, specular: 0.0, sss: 2.0, ..Weights::default() });
    assert!(only_beneath.iter().any(|p| p[0] > 0.0));
    for (one, two) in only_beneath.iter().zip(&doubled) {
        assert!((2.0 * one[1] - two[1]).abs() <= 1e-6 * two[1] && one[3] == two[3]);
    }
    let sum = |pixels: &[[f32; 4]]| pixels.iter().map(|p| f64::from(p[0])).sum::<f64>();
    let none = lit(Weights { occlusion: 0.0, ..Weights::default() });
    assert!(sum(&none) > sum(&frame.pixels));
    let opaque = lit(Weights { blend: Some(Blend::Opacity), ..Weights::default() });
    assert!(sum(&opaque) != sum(&frame.pixels));

    let bare = Frame { layers: vec![], ..frame };
    let e = composite(&bare, &Weights::default()).unwrap_err().to_string();
    assert!(e.contains("isosurface"), "{e}");
}

/// Without layers the picture is the same to the bit; they are left out where no output takes them.
#[test]
fn layers_are_made_for_those_who_want_them() {
    let frame = |without: bool| {
        let mut session =
            Session::new(Arc::new(Cpu::new(2).unwrap()), scene(EVERYTHING), Some([0.0, 1.0]), false).unwrap();
        if without {
            session.leave_out_layers();
        }
        session.advance(balls(16)).unwrap().frames.remove(0).frame
    };
    let (with, without) = (frame(false), frame(true));
    assert!(with.layer("sss").is_some() && without.layers.is_empty());
    let bits = |f: &Frame| f.pixels.iter().map(|p| p.map(f32::to_bits)).collect::<Vec<_>>();
    assert_eq!(bits(&with), bits(&without));

    let folder = tempfile::tempdir().unwrap();
    let options = gloaming::sink::SinkOptions { steps: 1, ..Default::default() };
    for (name, takes) in [("a.exr", true), ("a.png", false), ("a.mp4", false), ("a.vtkhdf", false), ("a.raw", false)] {
        let path = folder.path().join(name).display().to_string();
        assert_eq!(gloaming::sink::open(&path, &options).unwrap().wants_layers(), takes, "{name}");
    }
}

/// The environment times albedo, over a plane that nothing shades.
#[test]
fn a_plane_under_an_even_sky_has_the_closed_form() {
    let plane = step(Grid::new([32; 3]), |p| p.z / 31.0);
    let text = "[isosurface]\nlight = \"environment\"\ncolor = [0.2, 0.5, 1.0]\ndiffuse = 0.6\nspecular = 0.3\n\
        [[lights]]\nkind = \"environment\"\ncolor = [2, 2, 2]\nintensity = 1\n[[cameras]]\nelevation = 60\nzoom = 3";
    let (frame, row) = render(scene(text), &plane, false);
    assert_eq!((row.sweeps, row.voxel_updates), (0.0, 0), "nobody needs the light volume");
    let middle = frame.pixels[20 * 48 + 24];
    for (c, color) in [0.2, 0.5, 1.0].into_iter().enumerate() {
        let exact = 2.0 * (0.6 * color + 0.3);
        assert!((middle[c] - exact).abs() < 1e-4, "{} {exact}", middle[c]);
    }
    assert_eq!(middle[3], 1.0);
    let depth = frame.layer("depth").unwrap();
    assert_eq!((&*depth.channels, depth.values.len()), ("V", 48 * 40));
    let normal = frame.layer("normal").unwrap();
    let at = 3 * (20 * 48 + 24);
    assert!((normal.values[at + 2] - 1.0).abs() < 1e-5, "{:?}", &normal.values[at..at + 3]);
}

/// Lit straight from above through a medium of even extinction: `k_d/π · E · e^(−σ d)`, d the depth of the surface below the top.
#[test]
fn surfaces_in_the_light_volume_are_dimmed_by_beer_and_lambert() {
    let n = 32;
    let plane = step(Grid::new([n; 3]), |p| p.z / 31.0);
    let sigma = -(0.95f64.ln());
    for value in [0.25, 0.5, 0.75] {
        let text = format!(
            "[isosurface]\nvalues = [{value}]\nlight = \"volume\"\ncolor = [1, 1, 1]\ndiffuse = 0.8\nspecular = 0\n\
             [transfer]\nopacity = [[0, 0.05], [1, 0.05]]\nalbedo = 0\n[light]\nscattering = false\n\
             [[lights]]\ndirection = [0, 0, -1]\nintensity = 3\n[[cameras]]\nelevation = 70\nzoom = 4"
        );
        let (frame, _) = render(scene(&text), &plane, false);
        let depth = 31.5 - value * 31.0;
        let exact = 0.8 / PI * 3.0 * (-sigma * depth).exp();
        let middle = f64::from(frame.pixels[20 * 48 + 24][1]);
        // Transmittance is linear between voxels: up to σ²/8 off.
        assert!((middle - exact).abs() < 1e-3 * exact, "{value}: {middle} {exact}");
    }
}

/// The shadow that one ball throws on another is the medium's between them, which no environment map knows.
#[test]
fn the_shadow_side_is_darker_under_the_light_volume() {
    let text = "[isosurface]\nvalues = [0.2]\nlight = \"volume\"\n[transfer]\nopacity = [[0, 0], [0.2, 0.2], [1, 0.2]]\n\
        [light]\nscattering = false\n[[lights]]\ndirection = [1, 0, 0]\n[[cameras]]\nazimuth = 0\nelevation = 0";
    let (frame, _) = render(scene(text), &balls(32), false);
    let row = &frame.pixels[20 * 48..21 * 48];
    let seen: Vec<f32> = row.iter().filter(|p| p[3] > 0.99).map(|p| p[0]).collect();
    let (lit, shaded) = (seen[1], seen[seen.len() - 2]);
    assert!(lit > 20.0 * shaded && shaded >= 0.0, "{lit} {shaded}");
}

#[test]
fn pictures_do_not_depend_on_who_else_wants_the_light() {
    let text = EVERYTHING.replace("scattering = false", "directions = 8");
    let [alone, shared] = [false, true].map(|wants| render(scene(&text), &balls(16), wants));
    assert_eq!(alone.0, shared.0);
    assert!(alone.1.iterations == 0 && shared.1.iterations > 0, "scattered light is solved only for who wants it");
}

#[test]
fn prefiltered_maps_are_near_the_sampled_lobes() {
    let text = |beauty: &str| {
        format!(
            "[isosurface]\nvalues = [0.3]\nlight = \"environment\"\nbeauty = \"{beauty}\"\nexponent = 12\n\
             sky = [[0.1, 0.1, 0.1], [1, 0.8, 0.6], [0.5, 1, 2]]\nantialias = 1"
        )
    };
    let [sampled, filtered] = ["sampled", "prefiltered"].map(|b| render(scene(&text(b)), &balls(24), false).0);
    for name in ["diffuse", "specular"] {
        let [a, b] = [&sampled, &filtered].map(|f| &f.layer(name).unwrap().values);
        let largest = a.iter().copied().fold(0.0, f32::max);
        let apart = a.iter().zip(b).map(|(a, b)| (a - b).abs() / largest).collect::<Vec<_>>();
        let mean = apart.iter().sum::<f32>() / apart.iter().filter(|v| **v > 0.0).count() as f32;
        assert!(largest > 0.05 && mean < 0.02, "{name}: {mean} of {largest}");
    }
}

#[test]
fn flat_empty_and_broken_fields_give_finite_pictures() {
    let fields: [Box<dyn Fn(Vec3) -> f32>; 5] = [
        Box::new(|_| 0.5),
        Box::new(|_| 0.0),
        Box::new(|_| f32::NAN),
        Box::new(|p| if (p.x as usize).is_multiple_of(3) { f32::NAN } else { p.y / 11.0 }),
        Box::new(|p| if p.z > 6.0 { 1.0 } else { 0.0 }),
    ];
    for (i, field) in fields.into_iter().enumerate() {
        for grid in [Grid::new([12; 3]), Grid::new([12, 1, 12]), Grid::new([1, 12, 12])] {
            let (frame, _) = render(scene(EVERYTHING), &step(grid, &field), false);
            let layers = frame.layers.iter().flat_map(|l| &l.values);
            assert!(frame.pixels.iter().flatten().chain(layers).all(|v| v.is_finite()), "field {i} on {:?}", grid.size);
            if i < 3 {
                assert!(frame.pixels.iter().all(|p| *p == [0.0; 4]), "nothing is there in field {i}");
            }
        }
    }
}

#[test]
fn transparent_surfaces_show_what_is_behind_and_cover_by_their_opacity() {
    let shells = step(Grid::new([24; 3]), |p| 1.0 - p.distance(Vec3::splat(11.5)) / 12.0);
    let text = |opacity: &str| {
        format!(
            "[isosurface]\nvalues = [0.2, 0.6]\nopacity = {opacity}\ncolor = [[1, 0, 0], [0, 1, 0]]\nspecular = 0\n\
             occlusion = \"none\"\ndiffuse = 1\nlight = \"environment\"\nsky = [[1, 1, 1], [1, 1, 1]]\nlayers = 8"
        )
    };
    let middle = |opacity: &str| render(scene(&text(opacity)), &shells, false).0.pixels[20 * 48 + 24];
    let near = |a: [f32; 4], b: [f32; 4]| assert!((0..4).all(|c| (a[c] - b[c]).abs() < 1e-4), "{a:?} is not {b:?}");
    near(middle("[1, 1]"), [1.0, 0.0, 0.0, 1.0]);
    near(middle("[0.25, 1]"), [0.25, 0.75, 0.0, 1.0]);
    near(middle("[0, 1]"), [0.0, 1.0, 0.0, 1.0]);
    // Through all four walls: red over green over green over red.
    near(middle("[0.5, 0.5]"), [0.5 + 0.0625, 0.25 + 0.125, 0.0, 1.0 - 0.0625]);
}

#[test]
fn what_cannot_be_shown_is_said_by_key() {
    let refused = |text: &str| {
        let text = format!("[render]\nkind = \"isosurface\"\n{text}");
        let scene = match Scene::parse(&text, "test", &[]) {
            Ok(scene) => scene,
            Err(e) => return e,
        };
        Session::new(Arc::new(Cpu::new(1).unwrap()), scene, None, false).err().unwrap_or_else(|| panic!("{text}"))
    };
    for (text, key, says) in [
        ("values = []", "isosurface.values", "1 to 8"),
        ("values = [1.5]", "isosurface.values", "units"),
        ("values = [0.2, 0.2]", "isosurface.values", "different"),
        ("values = [0.2, 0.4]\nopacity = [0.1]", "isosurface.opacity", "one for each"),
        ("opacity = 2", "isosurface.opacity", "0 to 1"),
        ("diffuse = 0.8\nspecular = 0.3", "isosurface.diffuse", "above 1"),
        ("ior = 0.5", "isosurface.ior", "1 to 4"),
        ("attenuation = 0", "isosurface.attenuation", "above 0"),
        ("quality = \"best\"", "isosurface.quality", "preview"),
        ("light = \"environment\"\n[[lights]]", "isosurface.light", "isosurface.sky"),
        ("sss = \"fast\"\n[[lights]]", "isosurface.sss", "environment"),
    ] {
        match refused(&format!("[isosurface]\n{text}")) {
            Error::Scene { key: found, message, .. } => {
                assert_eq!(found, key, "{text}");
                assert!(message.contains(says), "{text}: {message}");
            }
            other => panic!("{text}: {other}"),
        }
    }
    let both = refused("[isosurface]\nlight = \"both\"\n[light]\nmodel = \"paper\"").to_string();
    assert!(both.contains("isosurface.light"), "{both}");
    let steep = refused("[isosurface]\nbeauty = \"prefiltered\"\nexponent_gradient = 100").to_string();
    assert!(steep.contains("sampled"), "{steep}");
    let missing = "[isosurface]\nlight = \"environment\"\n[[lights]]\nkind = \"environment\"\nimage = \"nowhere.exr\"";
    assert!(refused(missing).to_string().contains("nowhere.exr"));
}
