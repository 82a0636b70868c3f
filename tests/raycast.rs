//! Ray casting against closed forms, invariances and the reference picture (validation.md 1, 3, 5, 11, 18).

use approx::assert_abs_diff_eq;
use glam::{DVec3, Vec3};
use gloaming::camera::Camera;
use gloaming::device::cpu::Cpu;
use gloaming::device::{Buffer, Device, March, Optic, Phong, Sweep, Term, Weight};
use gloaming::field::EMPTY;
use gloaming::frame::Frame;
use gloaming::grid::{BrickLayout, Grid};
use gloaming::transfer::Table;

/// Extinction `sigma·value` for values 0..1.
fn linear(sigma: f32, albedo: [f32; 3]) -> Table {
    let last = (Table::ENTRIES - 1) as f32;
    Table {
        chromatic: [1.0; 3],
        lo: 0.0,
        hi: 1.0,
        extinction: (0..Table::ENTRIES).map(|i| sigma * i as f32 / last).collect(),
        albedo: vec![albedo; Table::ENTRIES],
        ..Default::default()
    }
}

/// What a picture is made of.
struct Shot {
    grid: Grid,
    values: Vec<f32>,
    table: Table,
    terms: Vec<(Grid, Vec<f32>, Weight)>,
    phong: Option<Phong>,
    camera: Camera,
    /// In mean spacings.
    step: f64,
    size: [usize; 2],
}

impl Shot {
    fn homogeneous(grid: Grid, table: Table, camera: Camera) -> Self {
        Shot {
            grid,
            values: vec![1.0; grid.len()],
            table,
            terms: vec![],
            phong: None,
            camera,
            step: 0.5,
            size: [33, 25],
        }
    }

    fn take(&self) -> Vec<[f32; 4]> {
        let cpu = Cpu::new(2).unwrap();
        let upload = |values: &[f32]| {
            let mut buffer: Buffer = cpu.alloc(values.len()).unwrap();
            cpu.upload(values, &mut buffer).unwrap();
            buffer
        };
        let field = upload(&self.values);
        let buffers: Vec<Buffer> = self.terms.iter().map(|(_, values, _)| upload(values)).collect();
        let terms: Vec<Term> = self
            .terms
            .iter()
            .zip(&buffers)
            .map(|((grid, _, weight), values)| Term { values, grid, weight: *weight })
            .collect();
        let bricks = BrickLayout::new(self.grid.size, 4);
        let majorant = self.table.majorants(&cpu.brick_range(&bricks, &field).unwrap());
        let mut frame = Frame::new(self.size);
        let march = March {
            grid: &self.grid,
            field: &field,
            gradient: None,
            table: &self.table,
            bricks,
            majorant: &majorant,
            terms: &terms,
            phong: self.phong,
            camera: &self.camera,
            clips: &[],
            step: (self.step * self.grid.mean_spacing()) as f32,
        };
        cpu.march(&march, &mut frame).unwrap();
        frame.pixels
    }

    /// For each pixel, the way of its ray and the world lengths between which it is in the box (equal where it misses).
    fn rays(&self) -> Vec<(DVec3, f64, f64)> {
        let (lo, hi) = self.grid.bounds();
        let eye = self.camera.eye.as_dvec3();
        (0..self.size[0] * self.size[1])
            .map(|i| {
                let d = self.camera.ray(self.size, (i % self.size[0]) as f32, (i / self.size[0]) as f32).as_dvec3();
                let (mut near, mut far) = (0.0f64, f64::INFINITY);
                for a in 0..3 {
                    if d[a] == 0.0 {
                        if eye[a] < lo[a] || eye[a] > hi[a] {
                            far = near;
                        }
                        continue;
                    }
                    let (s, t) = ((lo[a] - eye[a]) / d[a], (hi[a] - eye[a]) / d[a]);
                    near = near.max(s.min(t));
                    far = far.min(s.max(t));
                }
                (d, near, far.max(near))
            })
            .collect()
    }

    /// Asserts that every pixel is `truth(way of the ray, length in the box)`; returns how many rays met the box.
    fn must_show(&self, tolerance: f64, truth: impl Fn(DVec3, f64) -> [f64; 4]) -> usize {
        let mut met = 0;
        for (i, (pixel, (d, near, far))) in self.take().iter().zip(self.rays()).enumerate() {
            let truth = truth(d, far - near);
            met += usize::from(far > near);
            for c in 0..4 {
                let error = (f64::from(pixel[c]) - truth[c]).abs();
                assert!(error <= tolerance, "pixel {i}: {pixel:?} is not {truth:?} (length {})", far - near);
            }
        }
        met
    }
}

fn uneven() -> Grid {
    Grid { size: [24, 10, 17], spacing: [0.25, 1.0, 0.5], origin: [-3.0, 100.0, 7.0] }
}

fn from_outside(grid: &Grid) -> Camera {
    let (lo, hi) = grid.bounds();
    let centre = (0.5 * (lo + hi)).as_vec3();
    let away = 1.4 * (hi - lo).length() as f32;
    Camera::look_at(centre + away * Vec3::new(0.5, -0.75, 0.45), centre, Vec3::Z, 50.0)
}

#[test]
fn a_homogeneous_box_obeys_beer_lambert_along_every_ray_at_every_step() {
    let sigma = 0.3;
    let thin = Grid { size: [1, 10, 17], ..uneven() };
    let flat = Grid { size: [24, 10, 1], ..uneven() };
    for grid in [uneven(), thin, flat, Grid { size: [1; 3], spacing: [5.0; 3], origin: [0.0; 3] }] {
        let (lo, hi) = grid.bounds();
        let inside = Camera::look_at((0.4 * lo + 0.6 * hi).as_vec3(), lo.as_vec3(), Vec3::Z, 100.0);
        for camera in [from_outside(&grid), inside] {
            for step in [2.0, 1.0, 0.5, 0.37] {
                let shot = Shot { step, ..Shot::homogeneous(grid, linear(sigma, [0.5; 3]), camera) };
                let met = shot.must_show(4e-6, |_, length| [0.0, 0.0, 0.0, 1.0 - (-f64::from(sigma) * length).exp()]);
                assert!(met > 50, "only {met} rays met the box");
            }
        }
    }
}

#[test]
fn rays_along_axes_and_in_the_planes_of_faces_are_safe() {
    let grid = Grid::new([8; 3]);
    // A box holds its lower faces, not its upper ones.
    let crossed = 1.0 - (-1.6f32).exp();
    for (x, z, opacity) in [(3.5, 3.5, crossed), (-0.5, -0.5, crossed), (7.5, 3.0, 0.0)] {
        let eye = Vec3::new(x, -20.0, z);
        let camera = Camera::look_at(eye, eye + Vec3::Y, Vec3::Z, 60.0);
        let shot = Shot { size: [25, 25], ..Shot::homogeneous(grid, linear(0.2, [0.5; 3]), camera) };
        let pixels = shot.take();
        assert!(pixels.iter().flatten().all(|c| c.is_finite()));
        // The middle ray has two components of exactly 0; inside it crosses 8 lengths.
        assert_abs_diff_eq!(pixels[12 * 25 + 12][3], opacity, epsilon = 2e-6);
    }
    let nowhere = Camera { forward: Vec3::NAN, ..Camera::look_at(Vec3::ZERO, Vec3::Y, Vec3::Z, 60.0) };
    let shot = Shot::homogeneous(grid, linear(0.2, [0.5; 3]), nowhere);
    assert!(shot.take().iter().all(|p| *p == [0.0; 4]));
}

#[test]
fn opacity_of_a_sphere_is_that_of_its_chord() {
    let (n, radius, sigma) = (64, 0.4, 5.0f32);
    let grid = Grid { size: [n; 3], spacing: [1.0 / n as f64; 3], origin: [0.5 / n as f64; 3] };
    // A distance field, and a transfer function that is a step at the surface.
    let values = (0..grid.len())
        .map(|i| {
            let at = DVec3::new((i % n) as f64, (i / n % n) as f64, (i / n / n) as f64) + 0.5;
            (radius - (at / n as f64 - 0.5).length()) as f32
        })
        .collect();
    let mut table = linear(0.0, [0.5; 3]);
    (table.lo, table.hi) = (-0.1, 0.1);
    table.extinction.iter_mut().skip(Table::ENTRIES / 2).for_each(|s| *s = sigma);
    let eye = Vec3::new(0.5, -3.0, 0.9);
    let camera = Camera::look_at(eye, Vec3::splat(0.5), Vec3::Z, 18.0);
    let shot = Shot { values, step: 0.1, ..Shot::homogeneous(grid, table, camera) };
    let mut compared = 0;
    for (pixel, (d, ..)) in shot.take().iter().zip(shot.rays()) {
        let to_centre = DVec3::splat(0.5) - eye.as_dvec3();
        let b2 = to_centre.length_squared() - to_centre.dot(d).powi(2);
        let chord = 2.0 * (radius * radius - b2).max(0.0).sqrt();
        let truth = 1.0 - (-f64::from(sigma) * chord).exp();
        // Where the ray grazes the surface a shift of the surface by h²/R matters most.
        let tolerance = if (b2.sqrt() - radius).abs() < 0.02 { 0.15 } else { 0.006 };
        assert!((f64::from(pixel[3]) - truth).abs() < tolerance, "{} is not {truth} at b² = {b2}", pixel[3]);
        compared += usize::from(chord > 0.0);
    }
    assert!(compared > 200);
}

#[test]
fn emission_and_constant_light_have_their_closed_forms() {
    let grid = uneven();
    let glow = [0.7, 0.2, 0.05];
    let albedo = [0.9, 0.5, 0.1];
    for sigma in [0.0f32, 1e-5, 0.3, 40.0] {
        let table = Table { emission: vec![glow; Table::ENTRIES], ..linear(sigma, albedo) };
        let shot = Shot::homogeneous(grid, table, from_outside(&grid));
        let sigma = f64::from(sigma);
        let covered = |s: f64| -(-sigma * s).exp_m1();
        shot.must_show(2e-4 * f64::from(glow[0]) + 1e-5, |_, s| {
            let path = if sigma == 0.0 { s } else { covered(s) / sigma };
            [f64::from(glow[0]) * path, f64::from(glow[1]) * path, f64::from(glow[2]) * path, covered(s)]
        });
    }

    // In-scattering: ω·Σ weight·value·(1 − e^(−σs)), for each kind of weight, on grids of their own.
    let (sigma, g) = (0.3, 0.6);
    let travel = Vec3::new(0.3, 0.5, -0.7).normalize();
    let of = |grid: Grid, value: f32, weight| (grid, vec![value; grid.len()], weight);
    let shot = Shot {
        terms: vec![
            of(grid.resized([5, 4, 3]), 0.25, Weight::Uniform([1.0, 2.0, 3.0])),
            of(grid, 0.5, Weight::Phase { direction: travel, irradiance: [4.0, 5.0, 6.0], g }),
            of(grid.resized([1, 1, 1]), 2.0, Weight::Current { axis: 2, weight: [0.1, -0.1, -9.0] }),
        ],
        ..Shot::homogeneous(grid, linear(sigma as f32, albedo), from_outside(&grid))
    };
    shot.must_show(1e-5, |d, s| {
        let covered = -(-sigma * s).exp_m1();
        let cos = -d.dot(travel.as_dvec3());
        let g = f64::from(g);
        let p = (1.0 - g * g) / (4.0 * std::f64::consts::PI * (1.0 + g * g - 2.0 * g * cos).powf(1.5));
        let rgb: [f64; 3] = std::array::from_fn(|c| {
            let source = 0.25 * [1.0, 2.0, 3.0][c] + 0.5 * p * [4.0, 5.0, 6.0][c] + 2.0 * [0.1, -0.1, -9.0][c] * -d.z;
            f64::from(albedo[c]) * source.max(0.0) * covered
        });
        [rgb[0], rgb[1], rgb[2], covered]
    });
}

#[test]
fn light_from_behind_a_slab_scatters_as_the_integral_says() {
    // Light along −y meets rays along +y: ∫ e^(−σs)·e^(−σ(ℓ−s))·σ ds = σℓ·e^(−σℓ).
    let (n, sigma) = (64, 0.05);
    let grid = Grid::new([n; 3]);
    let transmittance =
        (0..grid.len()).map(|i| (-sigma * (n as f64 - 0.5 - (i / n % n) as f64)).exp() as f32).collect();
    let far = Camera::look_at(Vec3::new(31.5, -4000.0, 31.5), Vec3::new(31.5, 0.0, 31.5), Vec3::Z, 1.0);
    let shot = Shot {
        terms: vec![(grid, transmittance, Weight::Phase { direction: -Vec3::Y, irradiance: [8.0; 3], g: 0.0 })],
        ..Shot::homogeneous(grid, linear(sigma as f32, [0.5; 3]), far)
    };
    let length = n as f64;
    let truth = 0.5 * 8.0 / (4.0 * std::f64::consts::PI) * sigma * length * (-sigma * length).exp();
    let middle = shot.take()[12 * 33 + 16];
    // Light that is linear between values overestimates a convex exponential by σ²/12 of itself, in the mean.
    let excess = (f64::from(middle[0]) / truth - 1.0) / (sigma * sigma / 12.0);
    assert!((0.7..1.4).contains(&excess), "{} is not {truth}: {excess} of the expected excess", middle[0]);
}

#[test]
fn pictures_converge_with_the_step() {
    let n = 32;
    let grid = Grid { size: [n; 3], spacing: [1.0 / n as f64; 3], origin: [0.5 / n as f64; 3] };
    let wave = |i: usize, f: f64| (0.5 + 0.5 * (f * i as f64 / n as f64).sin()) as f32;
    let values: Vec<f32> =
        (0..grid.len()).map(|i| wave(i % n, 9.0) * wave(i / n % n, 7.0) * wave(i / n / n, 8.0)).collect();
    let camera = Camera::look_at(Vec3::new(1.5, -2.0, 1.2), Vec3::splat(0.5), Vec3::Z, 30.0);
    let picture = |step: f64| {
        let terms = vec![(grid, values.clone(), Weight::Uniform([1.0; 3]))];
        Shot { values: values.clone(), step, terms, ..Shot::homogeneous(grid, linear(6.0, [0.8; 3]), camera) }.take()
    };
    let fine = picture(1.0 / 32.0);
    let errors = [1.0, 0.5, 0.25].map(|step| {
        let squares: f32 =
            picture(step).iter().flatten().zip(fine.iter().flatten()).map(|(a, b)| (a - b).powi(2)).sum();
        (squares / (4 * fine.len()) as f32).sqrt()
    });
    assert!(errors[0] < 2e-3, "opacity is not corrected for the step: {errors:?}");
    assert!(errors[1] < 0.4 * errors[0] && errors[2] < 0.4 * errors[1], "not of second order: {errors:?}");
}

#[test]
fn holes_are_transparent_and_never_seen() {
    let n = 16;
    let grid = Grid::new([n; 3]);
    let camera = Camera::look_at(Vec3::new(-900.0, 7.5, 7.5), Vec3::splat(7.5), Vec3::Z, 0.5);
    let table = Table { emission: vec![[1.0, 2.0, 3.0]; Table::ENTRIES], ..linear(0.1, [0.9; 3]) };
    let solid = Shot { step: 0.01, ..Shot::homogeneous(grid, table, camera) };
    let values = (0..grid.len()).map(|i| if i % n >= 10 { EMPTY } else { 1.0 }).collect();
    let middle = Shot { values, ..solid }.take()[12 * 33 + 16];
    // Values 0..=9 are left: matter from −½ to 9, beyond which every interpolation touches a hole.
    let truth = 1.0 - (-0.1f32 * 9.5).exp();
    assert!((middle[3] - truth).abs() < 1e-3, "{} is not {truth}", middle[3]);

    let table = Table { emission: vec![[1.0, 2.0, 3.0]; Table::ENTRIES], ..linear(0.1, [0.9; 3]) };
    let nothing = Shot { values: vec![EMPTY; grid.len()], ..Shot::homogeneous(grid, table, camera) };
    assert!(nothing.take().iter().all(|p| *p == [0.0; 4]));
}

#[test]
fn permuting_the_axes_of_everything_changes_nothing() {
    let grid = uneven();
    let value = |[i, j, k]: [usize; 3]| ((i * 7 + j * 13 + k * 29) % 17) as f32 / 17.0;
    let camera = from_outside(&grid);
    let light = Vec3::new(0.2, 0.5, -0.9).normalize();
    // Axis a of the turned scene is axis (a + turn) % 3 of the first: a rotation of the world.
    let picture = |turn: usize| {
        let old = |a: usize| (a + turn) % 3;
        let vec = |v: Vec3| Vec3::from_array(std::array::from_fn(|a| v[old(a)]));
        let turned = Grid {
            size: std::array::from_fn(|a| grid.size[old(a)]),
            spacing: std::array::from_fn(|a| grid.spacing[old(a)]),
            origin: std::array::from_fn(|a| grid.origin[old(a)]),
        };
        let values: Vec<f32> = (0..grid.len())
            .map(|i| {
                let [nx, ny, _] = turned.size;
                let index = [i % nx, i / nx % ny, i / (nx * ny)];
                let mut first = [0; 3];
                (0..3).for_each(|a| first[old(a)] = index[a]);
                value(first)
            })
            .collect();
        let Camera { eye, forward, right, up, tan, lens } = camera;
        Shot {
            terms: vec![(
                turned,
                values.clone(),
                Weight::Phase { direction: vec(light), irradiance: [3.0; 3], g: 0.5 },
            )],
            phong: Some(Phong {
                towards_light: vec(-light),
                ambient: 0.3,
                diffuse: 0.7,
                specular: 0.2,
                shininess: 20.0,
            }),
            values,
            ..Shot::homogeneous(
                turned,
                linear(0.4, [0.9, 0.6, 0.3]),
                Camera { eye: vec(eye), forward: vec(forward), right: vec(right), up: vec(up), tan, lens },
            )
        }
        .take()
    };
    let first = picture(0);
    assert!(first.iter().any(|p| p[3] > 0.5));
    for turn in [1, 2] {
        for (a, b) in first.iter().flatten().zip(picture(turn).iter().flatten()) {
            assert_abs_diff_eq!(*a, *b, epsilon = 2e-5);
        }
    }
}

#[test]
fn phong_shades_by_the_gradient_and_not_where_there_is_none() {
    let grid = Grid::new([32; 3]);
    let phong =
        Phong { towards_light: Vec3::new(0.6, -0.8, 0.0), ambient: 0.2, diffuse: 0.5, specular: 0.4, shininess: 8.0 };
    let camera = Camera::look_at(Vec3::new(15.5, -3000.0, 15.5), Vec3::splat(15.5), Vec3::Z, 0.6);
    let term = || vec![(grid, vec![1.0; grid.len()], Weight::Uniform([1.0; 3]))];
    let even = |phong| Shot { terms: term(), phong, ..Shot::homogeneous(grid, linear(0.05, [1.0; 3]), camera) };
    assert_eq!(even(Some(phong)).take(), even(None).take());

    // Extinction k·y: the gradient points along +y, the normal towards the eye.
    let values: Vec<f32> = (0..grid.len()).map(|i| (i / 32 % 32) as f32 / 31.0).collect();
    let ramp = Shot { values, phong: Some(phong), step: 0.1, ..even(None) };
    let middle = ramp.take()[12 * 33 + 16];
    let k = 0.05 / 31.0f64;
    let lit = |steepness: f64, sigma: f64| {
        let half = (DVec3::new(0.6, -0.8, 0.0) - DVec3::Y).normalize();
        let lit = 0.2 + 0.5 * 0.8 + 0.4 * half.dot(-DVec3::Y).powf(8.0);
        1.0 + steepness / (steepness + sigma) * (lit - 1.0)
    };
    let (mut radiance, mut transmittance) = (0.0, 1.0);
    let steps = 32_000;
    for n in 0..steps {
        let y = (n as f64 + 0.5) * 32.0 / f64::from(steps) - 0.5;
        let sigma = k * y.clamp(0.0, 31.0);
        let steepness = k * 0.5 * ((y + 1.0).clamp(0.0, 31.0) - (y - 1.0).clamp(0.0, 31.0));
        let alpha = 1.0 - (-sigma * 32.0 / f64::from(steps)).exp();
        radiance += transmittance * alpha * lit(steepness, sigma);
        transmittance *= 1.0 - alpha;
    }
    assert!((f64::from(middle[0]) - radiance).abs() < 2e-3 * radiance, "{} is not {radiance}", middle[0]);
}

/// RMSE against the reference picture of direct light with the given foot.
fn error_of_the_reference_picture(cubic: bool) -> f64 {
    let data = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data");
    let density: ndarray::Array3<f32> =
        hdf5::File::open(format!("{data}/plume_128.h5")).unwrap().dataset("density").unwrap().read().unwrap();
    let npy = std::fs::read(format!("{data}/single_256.npy")).unwrap();
    let truth: &[u8] = &npy[npy.len() - 4 * 256 * 256..];

    let grid = Grid { size: [128; 3], spacing: [1.0 / 128.0; 3], origin: [1.0 / 256.0; 3] };
    let cpu = Cpu::new(2).unwrap();
    let table = linear(30.0, [0.8; 3]);
    let mut field = cpu.alloc(grid.len()).unwrap();
    cpu.upload(density.as_slice().unwrap(), &mut field).unwrap();
    let mut sigma = cpu.alloc(grid.len()).unwrap();
    cpu.classify(Optic::Extinction, &table, grid.size, &field, grid.size, &mut sigma).unwrap();
    let direction = Vec3::new(0.6, 0.4, -0.7).normalize();
    let sweep = Sweep::new(&grid, direction, cubic);
    let layout = BrickLayout::new(grid.size, BrickLayout::EDGE);
    let fronts = layout.fronts(sweep.ascending());
    let fronts: Vec<&[u32]> = fronts.iter().map(Vec::as_slice).collect();
    let mut light = cpu.alloc(grid.len()).unwrap();
    cpu.sweep(&sweep, &layout, &sigma, &mut light, &fronts).unwrap();

    let bricks = BrickLayout::new(grid.size, 8);
    let majorant = table.majorants(&cpu.brick_range(&bricks, &field).unwrap());
    let irradiance = [std::f32::consts::PI; 3];
    let march = March {
        grid: &grid,
        field: &field,
        gradient: None,
        table: &table,
        bricks,
        majorant: &majorant,
        terms: &[Term { values: &light, grid: &grid, weight: Weight::Phase { direction, irradiance, g: 0.0 } }],
        phong: None,
        camera: &Camera::look_at(Vec3::new(0.5, -2.0, 0.55), Vec3::splat(0.5), Vec3::Z, 28.0),
        clips: &[],
        step: 1.0 / 256.0,
    };
    let mut frame = Frame::new([256, 256]);
    cpu.march(&march, &mut frame).unwrap();
    let squares: f64 = frame
        .pixels
        .iter()
        .zip(truth.chunks_exact(4))
        .map(|(p, t)| f64::from(p[0] - f32::from_le_bytes(t.try_into().unwrap())).powi(2))
        .sum();
    let error = (squares / (256.0 * 256.0)).sqrt();
    println!("cubic {cubic}: RMSE {error:.2e}");
    error
}

#[test]
fn the_reference_picture_is_met() {
    assert!(error_of_the_reference_picture(false) <= 6.5e-4);
    assert!(error_of_the_reference_picture(true) <= 2.5e-4);
}
