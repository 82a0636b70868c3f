//! The paper's model (Zhang & Ma 2013): known answers of convection, (6)–(21).

use glam::{DVec3, Vec3};
use gloaming::device::convection::{Convected, Convection, Layers, Opacity, Rays, Start};
use gloaming::device::cpu::Cpu;
use gloaming::device::{Buffer, Device};
use gloaming::{BrickLayout, Grid};

fn cpu() -> &'static Cpu {
    static CPU: std::sync::OnceLock<Cpu> = std::sync::OnceLock::new();
    CPU.get_or_init(|| Cpu::new(2).unwrap())
}

fn upload(values: &[f32]) -> Buffer {
    let mut buffer = cpu().alloc(values.len()).unwrap();
    cpu().upload(values, &mut buffer).unwrap();
    buffer
}

fn download(buffer: &Buffer) -> Vec<f32> {
    let mut out = vec![0.0; buffer.len()];
    cpu().download(buffer, &mut out).unwrap();
    out
}

fn largest_difference(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

fn layers(light: &Convection, pass: Layers, sigma: &[f32], before: &[f32]) -> (Vec<f32>, Convected) {
    let mut rho = upload(&vec![f32::NAN; sigma.len()]);
    let done = cpu().convect_layers(light, pass, &upload(sigma), &upload(before), &mut rho).unwrap();
    (download(&rho), done)
}

fn ordered(light: &Convection, sigma: &[f32]) -> Vec<f32> {
    in_bricks(cpu(), light, sigma, 16, 0)
}

/// Ordered convection brick by brick, the last `apart` fronts in a call of their own, so that the device sees a part of the bricks.
fn in_bricks(device: &Cpu, light: &Convection, sigma: &[f32], edge: usize, apart: usize) -> Vec<f32> {
    let layout = BrickLayout::new(light.size, edge);
    let fronts = light.fronts(&layout);
    let fronts: Vec<&[u32]> = fronts.iter().map(|f| &f[..]).collect();
    let mut rho = upload(&vec![f32::NAN; sigma.len()]);
    let (some, rest) = fronts.split_at(fronts.len() - apart);
    for fronts in [some, rest] {
        device.convect_ordered(light, &layout, &upload(sigma), &mut rho, fronts).unwrap();
    }
    download(&rho)
}

/// Iterates all voxels from nothing until a change of `stop`; how many iterations that took.
fn whole(light: &Convection, sigma: &[f32], stop: f32) -> (Vec<f32>, usize) {
    let sigma = upload(sigma);
    let (mut now, mut next) = (upload(&vec![0.0; sigma.len()]), upload(&vec![0.0; sigma.len()]));
    for n in 1..5000 {
        let change = cpu().convect_whole(light, &sigma, &now, &mut next).unwrap();
        std::mem::swap(&mut now, &mut next);
        if change <= stop {
            return (download(&now), n);
        }
    }
    panic!("no end to the iterations of {light:?}");
}

/// Soft blobs and a slab that is nearly opaque.
fn medium(grid: &Grid) -> Vec<f32> {
    (0..grid.len())
        .map(|at| {
            let [nx, ny, _] = grid.size;
            let p = [at % nx, at / nx % ny, at / (nx * ny)];
            let q = Vec3::from_array(std::array::from_fn(|a| p[a] as f32 / grid.size[a] as f32));
            let blob = |c: [f32; 3], r: f32| (1.0 - (q - Vec3::from(c)).length() / r).max(0.0);
            let slab = if (0.6..0.7).contains(&q.z) && q.x < 0.5 { 4.0 } else { 0.0 };
            1.5 * blob([0.3, 0.4, 0.3], 0.25) + 0.6 * blob([0.7, 0.6, 0.6], 0.35) + slab
        })
        .collect()
}

fn uneven() -> Grid {
    Grid { size: [21, 34, 19], spacing: [1.0, 0.8, 1.3], origin: [-3.0, 1.0, 0.5] }
}

const CALIBRATED: Opacity = Opacity::Calibrated { length: 0.8 };
const LITERAL: Opacity = Opacity::Literal { length: 0.5 };

fn distant_lights() -> Vec<Vec3> {
    [[0.3, 0.5, -0.8], [-0.9, 0.3, 0.2], [0.2, -0.9, 0.4], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
        .map(|u| Vec3::from(u).normalize())
        .to_vec()
}

/// Inside between voxels, on a voxel, in the rim of the box, and outside.
fn places() -> [[f64; 3]; 4] {
    [[7.3, 12.6, 9.1], [5.0, 17.0, 4.0], [-0.3, 20.0, 9.0], [-12.0, 40.0, 8.0]]
}

fn from_place(grid: &Grid, place: [f64; 3], width: Option<f64>, opacity: Opacity) -> Convection {
    let world = DVec3::from_array(std::array::from_fn(|a| grid.origin[a] + place[a] * grid.spacing[a]));
    Convection::central(grid, world, width, opacity)
}

/// validation.md 1: along an axis a slab dims light by T^n, T = (1 − σ_a)/(1 + σ_a), to rounding.
#[test]
fn a_slab_along_an_axis_dims_by_the_nth_power() {
    let grid = Grid::new([5, 6, 40]);
    let opacity = 0.1f64;
    let sigma = vec![-(1.0 - opacity).ln() as f32; grid.len()];
    let light = Convection::distant(&grid, Vec3::Z, Opacity::Literal { length: 1.0 });
    let transmitted = (1.0 - opacity) / (1.0 + opacity);
    let rho = ordered(&light, &sigma);
    for k in 0..40 {
        let exact = transmitted.powi(k as i32 + 1);
        let got = f64::from(rho[grid.index([2, 3, k])]);
        assert!((got / exact - 1.0).abs() < 1e-5, "layer {k}: {got} instead of {exact}");
    }
}

/// Calibrated opacity: T = e^(−τ/s), so along an axis n voxels dim by e^(−nτ) (validation.md 2: σ → T → τ is the identity).
#[test]
fn calibrated_opacity_gives_back_the_optical_depth() {
    for (n, spacing) in [(10, 1.0), (20, 0.5), (40, 0.25)] {
        let grid = Grid { size: [3, 4, n], spacing: [spacing; 3], origin: [0.0; 3] };
        let opacity = Opacity::Calibrated { length: spacing as f32 };
        let rho = ordered(&Convection::distant(&grid, Vec3::NEG_Z, opacity), &vec![0.35; grid.len()]);
        let got = f64::from(rho[grid.index([1, 1, 0])]);
        let exact = (-0.35f64 * 10.0).exp();
        assert!((got / exact - 1.0).abs() < 2e-5, "{n} layers: {got} instead of {exact}");
        // The literal scheme has no such invariance: its shadow doubles in depth with the resolution.
        let literal = Convection::distant(&grid, Vec3::NEG_Z, Opacity::Literal { length: 1.0 });
        let depth = -f64::from(ordered(&literal, &vec![0.35; grid.len()])[grid.index([1, 1, 0])]).ln();
        let per_voxel = ((1.0 + 0.2953) / (1.0 - 0.2953f64)).ln();
        assert!((depth / (n as f64 * per_voxel) - 1.0).abs() < 1e-3, "literal, {n} layers: depth {depth}");
    }
}

/// validation.md 15.
#[test]
fn five_iterations_cross_empty_layers_only_from_the_layer_upstream() {
    let grid = Grid::new([6, 7, 64]);
    let nothing = vec![0.0; grid.len()];
    let light = Convection::distant(&grid, Vec3::Z, CALIBRATED);
    let last = |start| {
        let pass = Layers { iterations: 5, tolerance: 0.0, start };
        layers(&light, pass, &nothing, &nothing).0[grid.index([3, 3, 63])]
    };
    assert_eq!(last(Start::Upstream), 1.0);
    assert!((last(Start::Zero) - (31.0f32 / 32.0).powi(64)).abs() < 1e-5, "{}", last(Start::Zero));
    assert!((last(Start::Zero) - 0.131).abs() < 5e-4);
}

/// Layer by layer, all voxels at once, and one ordered pass: the same fixed point, within the bounds that each certifies.
#[test]
fn three_ways_lead_to_the_same_light() {
    let grid = uneven();
    let sigma = medium(&grid);
    for opacity in [CALIBRATED, LITERAL] {
        for u in distant_lights() {
            let light = Convection::distant(&grid, u, opacity);
            let exact = ordered(&light, &sigma);
            let (volume, _) = whole(&light, &sigma, 1e-7);
            let apart = largest_difference(&exact, &volume);
            assert!(apart <= light.whole_gain() * 1e-7 + 2e-6, "along {u}: all at once is off by {apart}");
            for tolerance in [1e-2, 1e-4] {
                let pass = Layers { iterations: 10_000, tolerance, start: Start::Upstream };
                let (rho, done) = layers(&light, pass, &sigma, &exact);
                let apart = largest_difference(&exact, &rho);
                assert!(done.error <= tolerance, "along {u}: certified {}", done.error);
                assert!(apart <= done.error + 2e-6, "along {u}: off by {apart}, certified {}", done.error);
            }
        }
        for place in places() {
            let light = from_place(&grid, place, Some(20.0), opacity);
            let apart = largest_difference(&ordered(&light, &sigma), &whole(&light, &sigma, 1e-7).0);
            assert!(apart < 1e-5, "from {place:?}: off by {apart}");
        }
    }
}

/// An unfinished layer says so: the bound holds for few iterations too.
#[test]
fn the_bound_holds_for_any_number_of_iterations() {
    let grid = uneven();
    let sigma = medium(&grid);
    for u in distant_lights() {
        let light = Convection::distant(&grid, u, CALIBRATED);
        let exact = ordered(&light, &sigma);
        let mut last = f32::INFINITY;
        for iterations in [1, 2, 5, 20] {
            let pass = Layers { iterations, tolerance: 0.0, start: Start::Upstream };
            let (rho, done) = layers(&light, pass, &sigma, &sigma);
            let apart = largest_difference(&exact, &rho);
            assert!(apart <= done.error + 2e-6, "{iterations} along {u}: off by {apart}, certified {}", done.error);
            assert!(apart <= last + 1e-6, "{iterations} along {u}: off by {apart}, before by {last}");
            last = apart;
        }
        assert!(last < 5e-3, "along {u}: off by {last} after 20 iterations");
    }
}

/// (6), (7): light enters by all the faces that look at it and by no other.
#[test]
fn all_three_lit_faces_are_lit() {
    let grid = uneven();
    for signs in 0..8 {
        let sign = |a: usize| if signs >> a & 1 == 0 { 1.0 } else { -1.0f32 };
        let u = Vec3::new(0.6 * sign(0), 0.5 * sign(1), 0.7 * sign(2)).normalize();
        let light = Convection::distant(&grid, u, CALIBRATED);
        let rho = ordered(&light, &vec![0.0; grid.len()]);
        assert!(rho.iter().all(|v| (v - 1.0).abs() < 1e-5), "vacuum is not all lit along {u}");
        // What is downstream never alters what is upstream: a medium in the last layer along each axis.
        for axis in 0..3 {
            let last = if u[axis] > 0.0 { grid.size[axis] - 1 } else { 0 };
            let wall: Vec<f32> = (0..grid.len())
                .map(|at| {
                    let [nx, ny, _] = grid.size;
                    let p = [at % nx, at / nx % ny, at / (nx * ny)];
                    if p[axis] == last { 5.0 } else { 0.0 }
                })
                .collect();
            let walled = ordered(&light, &wall);
            for (at, w) in wall.iter().enumerate() {
                assert!(*w > 0.0 || walled[at] == rho[at], "voxel {at} changed");
            }
        }
    }
}

/// validation.md 4: ρ is constant along rays in vacuum, so with G = 1 it is 1 everywhere, and the ball is never updated.
#[test]
fn point_light_fills_vacuum_and_keeps_its_ball() {
    let grid = uneven();
    let nothing = vec![0.0; grid.len()];
    for place in places() {
        let rho = ordered(&from_place(&grid, place, None, CALIBRATED), &nothing);
        assert!(rho.iter().all(|v| (v - 1.0).abs() < 1e-4), "from {place:?}");
    }
    let width = 2.5;
    let light = from_place(&grid, places()[0], Some(width), CALIBRATED);
    let Rays::Central { ball, .. } = light.rays else { panic!() };
    assert!(ball > 0.0);
    let opaque = vec![50.0; grid.len()];
    let (iterated, _) = whole(&light, &opaque, 0.0);
    for (at, (one, other)) in ordered(&light, &opaque).iter().zip(&iterated).enumerate() {
        let [nx, ny, _] = grid.size;
        let p = [at % nx, at / nx % ny, at / (nx * ny)];
        let square: f64 = (0..3).map(|a| ((p[a] as f64 - places()[0][a]) * grid.spacing[a]).powi(2)).sum();
        let expected =
            if square.sqrt() < 2.0 * grid.mean_spacing() { (-0.5 * square / (width * width)).exp() } else { 0.0 };
        assert!((f64::from(*one) - expected).abs() < 1e-5 && (one - other).abs() < 1e-6, "voxel {p:?}: {one}");
    }
}

/// (8): what enters from a light outside is G on the faces that look at it.
#[test]
fn light_from_outside_enters_as_its_gaussian() {
    let grid = Grid::new([15, 16, 17]);
    let (place, width) = ([-6.0, 7.0, 8.0], 9.0);
    let light = from_place(&grid, place, Some(width), CALIBRATED);
    let rho = ordered(&light, &vec![0.0; grid.len()]);
    // Straight ahead of the light nothing mixes: the whole row has the value at its face.
    let face = (-0.5 * (5.5f64 / width).powi(2)).exp();
    for i in 0..15 {
        assert!((f64::from(rho[grid.index([i, 7, 8])]) - face).abs() < 1e-5);
    }
    assert!(rho[grid.index([3, 15, 8])] < 0.9 * rho[grid.index([3, 7, 8])], "falls off to the side");
}

/// Permuting the axes permutes the light (validation.md 18), and strips along any of them give the same.
#[test]
fn axes_are_equal() {
    let grid = Grid::new([12, 12, 12]);
    let sigma = medium(&grid);
    let turned: Vec<f32> = (0..grid.len()).map(|at| sigma[grid.index([at / 144, at % 12, at / 12 % 12])]).collect();
    let u = Vec3::new(0.3, -0.5, 0.8).normalize();
    let turned_u = Vec3::new(u.y, u.z, u.x);
    let pass = Layers { iterations: 4, tolerance: 0.0, start: Start::Upstream };
    let run = |u, sigma: &[f32]| {
        let light = Convection::distant(&grid, u, CALIBRATED);
        [ordered(&light, sigma), layers(&light, pass, sigma, sigma).0]
    };
    let (plain, other) = (run(u, &sigma), run(turned_u, &turned));
    for (plain, other) in plain.iter().zip(&other) {
        let back: Vec<f32> = (0..grid.len()).map(|at| plain[grid.index([at / 144, at % 12, at / 12 % 12])]).collect();
        assert!(largest_difference(&back, other) < 1e-6, "{}", largest_difference(&back, other));
    }
}

/// The number of threads changes nothing, bit for bit.
#[test]
fn threads_do_not_matter() {
    let grid = Grid::new([37, 70, 40]);
    let sigma = medium(&grid);
    let one = Cpu::new(1).unwrap();
    for u in distant_lights() {
        let light = Convection::distant(&grid, u, CALIBRATED);
        let pass = Layers { iterations: 5, tolerance: 1e-3, start: Start::Best };
        let before = ordered(&light, &sigma.iter().map(|v| 1.1 * v).collect::<Vec<_>>());
        let (two, done) = layers(&light, pass, &sigma, &before);
        let mut rho = one.alloc(sigma.len()).unwrap();
        let alone = one.convect_layers(&light, pass, &upload(&sigma), &upload(&before), &mut rho).unwrap();
        assert_eq!(done, alone);
        assert_eq!(two, download(&rho));
        assert_eq!(ordered(&light, &sigma), in_bricks(&one, &light, &sigma, 16, 0));
    }
}

/// validation.md 16: bricks of any size, or none, give the same light bit for bit; a light on a corner of bricks too.
#[test]
fn bricks_do_not_matter() {
    let grid = uneven();
    let sigma = medium(&grid);
    let far = distant_lights().into_iter().map(|u| Convection::distant(&grid, u, CALIBRATED));
    let near = places().into_iter().chain([[8.0, 16.0, 8.0], [7.5, 15.5, 7.5]]);
    for light in far.chain(near.map(|p| from_place(&grid, p, Some(20.0), LITERAL))) {
        let whole = ordered(&light, &sigma);
        for (edge, apart) in [(4, 1), (8, 2), (5, 3), (64, 0)] {
            assert_eq!(whole, in_bricks(cpu(), &light, &sigma, edge, apart), "bricks of {edge}, {light:?}");
        }
    }
}

/// A warm start from a medium that was nearly the same needs fewer iterations than a cold one for the same certified error.
#[test]
fn the_best_guess_saves_iterations() {
    let grid = uneven();
    let sigma = medium(&grid);
    let earlier: Vec<f32> = sigma.iter().map(|v| 1.02 * v).collect();
    for u in distant_lights() {
        let light = Convection::distant(&grid, u, CALIBRATED);
        let pass = |start| Layers { iterations: 1000, tolerance: 1e-3, start };
        let before = ordered(&light, &earlier);
        let (_, cold) = layers(&light, pass(Start::Upstream), &sigma, &before);
        let (rho, warm) = layers(&light, pass(Start::Best), &sigma, &before);
        assert!(largest_difference(&rho, &ordered(&light, &sigma)) <= warm.error + 2e-6 && warm.error <= 1e-3);
        assert!(3 * warm.updates < 2 * cold.updates, "along {u}: {} against {}", warm.updates, cold.updates);
    }
}

mod model {
    //! The whole model: composition, diffusion, shading, and what is done again from step to step.

    use std::sync::Arc;

    use gloaming::field::{Dense, Timestep};
    use gloaming::light::{LightSolver, LightVolume, SolveReport};
    use gloaming::lights::{self, Light};
    use gloaming::medium::Medium;
    use gloaming::scene::Scene;
    use gloaming::transfer::TransferFunction;

    use super::*;

    /// A scene of the paper's model over data on `grid`.
    struct Lit {
        grid: Grid,
        medium: Medium,
        solver: LightSolver,
        lights: Vec<Light>,
        volume: LightVolume,
        transfer: TransferFunction,
    }

    impl Lit {
        fn new(grid: Grid, sets: &[&str]) -> Self {
            let usual = ["light.model=paper", "light.resolution=1", "transfer.extinction=1", "light.tolerance=1e-4"];
            // Lights are given as a file has them, the rest as overrides.
            let (lights, sets): (Vec<&str>, Vec<&str>) =
                usual.iter().chain(sets).partition(|s| s.starts_with("lights=["));
            let sets: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
            let scene = Scene::parse(&lights.concat(), "test", &sets).unwrap();
            let transfer = TransferFunction::new(&scene.transfer).unwrap();
            Lit {
                medium: Medium::new(cpu(), grid, transfer.table([0.0, 1.0], 1.0)).unwrap(),
                solver: LightSolver::new(cpu(), &scene, &grid).unwrap(),
                lights: lights::resolve(&scene).unwrap(),
                volume: LightVolume::default(),
                transfer,
                grid,
            }
        }

        fn show(&mut self, values: &[f32]) -> (SolveReport, Vec<[f32; 3]>) {
            self.show_over(values, [0.0, 1.0])
        }

        fn show_over(&mut self, values: &[f32], range: [f64; 2]) -> (SolveReport, Vec<[f32; 3]>) {
            let field = Arc::new(Dense::new(self.grid.size, values.to_vec()));
            self.medium.take(cpu(), &Timestep { step: 0, time: None, grid: self.grid, field }).unwrap();
            self.medium.classify(self.transfer.table(range, 1.0));
            let report = self.solver.solve(cpu(), &self.medium, &self.lights, &mut self.volume).unwrap();
            (report, self.solver.illuminated(cpu(), &self.volume).unwrap().fluence)
        }
    }

    fn apart(a: &[[f32; 3]], b: &[[f32; 3]]) -> f32 {
        largest_difference(a.as_flattened(), b.as_flattened())
    }

    const RED: &str = "lights=[{direction=[0.3, 0.5, -0.8], color=[1, 0, 0], intensity=2}]";
    const BOTH: &str = "lights=[{direction=[0.3, 0.5, -0.8], color=[1, 0, 0], intensity=2}, \
                        {direction=[-0.9, 0.1, 0.2], color=[0, 0.5, 1], intensity=1}]";

    fn drifting(grid: &Grid, step: usize) -> Vec<f32> {
        let shift = 0.02 * step as f32;
        (0..grid.len())
            .map(|at| {
                let [nx, ny, _] = grid.size;
                let q = Vec3::from_array(std::array::from_fn(|a| {
                    [at % nx, at / nx % ny, at / (nx * ny)][a] as f32 / grid.size[a] as f32
                }));
                let blob = |c: [f32; 3], r: f32| (1.0 - (q - Vec3::from(c)).length() / r).max(0.0);
                (blob([0.3 + shift, 0.4, 0.4], 0.3) + 0.5 * blob([0.7, 0.6 - shift, 0.6], 0.3)).min(1.0)
            })
            .collect()
    }

    /// (22): the light of two sources is the sum of theirs.
    #[test]
    fn lights_add_up() {
        let grid = uneven();
        let values = drifting(&grid, 0);
        let sets = ["light.convection=ordered", "light.sigma_s=[2, 2, 2]"];
        let run = |lights: &str| Lit::new(grid, &[sets[0], sets[1], lights]).show(&values).1;
        let blue = "lights=[{direction=[-0.9, 0.1, 0.2], color=[0, 0.5, 1], intensity=1}]";
        let (red, blue, both) = (run(RED), run(blue), run(BOTH));
        for ((r, b), both) in red.iter().zip(&blue).zip(&both) {
            (0..3).for_each(|c| assert!((r[c] + b[c] - both[c]).abs() < 1e-5));
        }
        assert!(red.iter().all(|v| v[1] == 0.0 && v[2] == 0.0) && red.iter().any(|v| v[0] > 1.5));
    }

    /// (23) changes each channel by its own coefficient, keeps the sum of the light, and leaves σ_s = 0 alone.
    #[test]
    fn diffusion_is_per_channel_and_keeps_the_light() {
        let grid = uneven();
        let values = drifting(&grid, 0);
        let white = "lights=[{direction=[0.3, 0.5, -0.8]}]";
        let run = |sigma_s: &str, method: &str| {
            Lit::new(grid, &[white, "light.convection=ordered", sigma_s, method]).show(&values).1
        };
        let plain = run("light.sigma_s=[0, 0, 0]", "light.diffusion=exact");
        let sum = |v: &[[f32; 3]], c: usize| v.iter().map(|v| f64::from(v[c])).sum::<f64>();
        for method in ["exact", "gauss-seidel", "multigrid"] {
            let method = format!("light.diffusion={method}");
            let mixed = run("light.sigma_s=[0, 1, 10]", &method);
            for c in 0..3 {
                let ratio = sum(&mixed, c) / sum(&plain, c);
                assert!((ratio - 1.0).abs() < 2e-5, "{method}, channel {c}: {ratio}");
            }
            assert!(mixed.iter().zip(&plain).all(|(m, p)| (m[0] - p[0]).abs() < 1e-6), "{method}");
            let alone = run("light.sigma_s=[1, 1, 1]", &method);
            assert!(mixed.iter().zip(&alone).all(|(m, a)| (m[1] - a[1]).abs() < 1e-3), "{method}: channels mix");
        }
    }

    /// Both implicit methods solve the same system, within what they certify.
    #[test]
    fn gauss_seidel_and_multigrid_agree() {
        let grid = uneven();
        let values = drifting(&grid, 0);
        let run = |method: &str| {
            let method = format!("light.diffusion={method}");
            Lit::new(grid, &["light.convection=ordered", "light.sigma_s=[10, 10, 10]", &method]).show(&values)
        };
        let ((slow, a), (fast, b)) = (run("gauss-seidel"), run("multigrid"));
        assert!(slow.converged && fast.converged, "{slow:?} {fast:?}");
        let brightest = a.as_flattened().iter().fold(0.0f32, |m, v| m.max(*v));
        assert!(apart(&a, &b) <= 2e-4 * brightest.max(20.0), "{}", apart(&a, &b));
        assert!(4 * fast.iterations < slow.iterations, "{} against {}", fast.iterations, slow.iterations);
    }

    /// The kernel of the exact method is the heat kernel (variance 2σ_s t), that of the implicit ones Yukawa's
    /// e^(−r/√σ)/(4πσr) (validation.md 6): both seen from a bright ball round a light in an opaque medium.
    #[test]
    fn kernels_are_those_of_heat_and_of_yukawa() {
        let n = 49;
        let grid = Grid::new([n; 3]);
        // A voxel that stands alone: ρ of the lit voxel in an opaque box.
        let place = "lights=[{kind=\"point\", position=[24, 24, 24]}]";
        let opaque = vec![1.0; grid.len()];
        let shine = |sigma: f32, method: &str| {
            let sigma_s = format!("light.sigma_s=[{sigma}, {sigma}, {sigma}]");
            let method = format!("light.diffusion={method}");
            let sets = [place, "transfer.extinction=80", "light.width=100", "light.tolerance=1e-6", &sigma_s, &method];
            Lit::new(grid, &sets).show(&opaque).1
        };
        let moment = |v: &[[f32; 3]]| {
            let (mut mass, mut second) = (0.0, 0.0);
            for (at, v) in v.iter().enumerate() {
                let z = (at / (n * n)) as f64 - 24.0;
                mass += f64::from(v[0]);
                second += z * z * f64::from(v[0]);
            }
            (mass, second / mass)
        };
        let ball = shine(0.0, "exact");
        for (sigma, method) in [(1.0, "exact"), (4.0, "exact"), (4.0, "multigrid")] {
            let spread = shine(sigma, method);
            let ((mass, before), (kept, after)) = (moment(&ball), moment(&spread));
            assert!((kept / mass - 1.0).abs() < 1e-4, "{method}: mass {}", kept / mass);
            let variance = (after - before) / (2.0 * f64::from(sigma));
            assert!((variance - 1.0).abs() < 0.02, "{method}, σ_s = {sigma}: variance {variance} of 2σ_s");
            // Mirror symmetry about the light.
            for at in 0..grid.len() {
                assert!((spread[at][0] - spread[grid.len() - 1 - at][0]).abs() < 1e-5);
            }
        }
        // Far from the ball Yukawa's kernel falls by e^(−Δr/√σ)·r/(r + Δr), times what discrete steps change.
        let yukawa = shine(4.0, "multigrid");
        let along = |r: usize| f64::from(yukawa[grid.index([24, 24, 24 + r])][0]);
        let expected = (-4.0f64 / 2.0).exp() * 10.0 / 14.0;
        assert!((along(14) / along(10) / expected - 1.0).abs() < 0.05, "{} {expected}", along(14) / along(10));
    }

    /// At tolerance 0 a warm series is a cold one, bit for bit, and what did not change is not done again.
    #[test]
    fn tolerance_zero_is_cold_to_the_bit() {
        let grid = uneven();
        for (method, diffusion) in [("layers", "exact"), ("ordered", "multigrid"), ("volume", "exact")] {
            let keys = [format!("light.convection={method}"), format!("light.diffusion={diffusion}")];
            let sets = [BOTH, "light.tolerance=0", &keys[0], &keys[1]];
            let mut warm = Lit::new(grid, &sets);
            let cold = [&sets[..], &["light.warm=false"]].concat();
            for step in [0, 1, 1] {
                let values = drifting(&grid, step);
                assert_eq!(warm.show(&values).1, Lit::new(grid, &cold).show(&values).1, "{method}, {diffusion}");
            }
        }
    }

    /// Over a drift, within the certified error of a tight solve; and cheaper than cold for the same tolerance.
    #[test]
    fn warm_starts_are_certified_and_save_work() {
        let grid = Grid::new([32, 30, 34]);
        let sets = [BOTH, "light.iterations=1000", "light.tolerance=1e-3", "light.sigma_s=[1, 1, 1]"];
        let mut warm = Lit::new(grid, &sets);
        let (mut work, mut cold_work) = (0, 0);
        for step in 0..8 {
            let values: Vec<f32> = drifting(&grid, 0).iter().map(|v| v * (1.0 + 0.003 * step as f32)).collect();
            let (report, light) = warm.show(&values);
            let (cold_report, _) = Lit::new(grid, &sets).show(&values);
            let exact = Lit::new(grid, &[BOTH, "light.convection=ordered"]).show(&values).1;
            // Relative to the unattenuated light, 2 + 1.
            assert!(report.certified_error <= 1e-3 && report.converged, "{report:?}");
            assert!(f64::from(apart(&light, &exact)) <= 3.0 * report.certified_error + 1e-5, "step {step}");
            if step > 0 {
                work += report.voxel_updates;
                cold_work += cold_report.voxel_updates;
            }
        }
        assert!(work < cold_work, "{work} against {cold_work}");
    }

    /// Few iterations a step: a still series comes nearer the light with each step, and says how near it is.
    #[test]
    fn unfinished_light_goes_on_in_the_next_step() {
        let grid = uneven();
        let values = drifting(&grid, 0);
        let exact = Lit::new(grid, &[BOTH, "light.convection=ordered"]).show(&values).1;
        for method in ["light.convection=layers", "light.convection=volume"] {
            let mut lit = Lit::new(grid, &[BOTH, "light.iterations=2", method]);
            let (mut first, mut last) = (f32::INFINITY, f32::INFINITY);
            let mut steps = 0;
            loop {
                let (report, light) = lit.show(&values);
                let error = apart(&light, &exact);
                assert!(f64::from(error) <= 3.0 * report.certified_error + 2e-5, "{method}: {error}, {report:?}");
                assert!(error <= last + 1e-5, "{method}: {error} after {last}");
                (first, last) = (first.min(error).max(if steps == 0 { error } else { first }), error);
                steps += 1;
                if report.converged {
                    break;
                }
                assert!(steps < 500, "{method}: {report:?}");
            }
            assert!(steps > 2 && last < 1e-3 && first > last, "{method}: {steps} steps, {first} to {last}");
            // Then there is nothing left to do but look.
            let (report, _) = lit.show(&values);
            assert_eq!((report.bricks_active, report.voxel_updates), (0, grid.len() as u64), "{method}");
        }
    }

    /// Algorithm 1: a colour recomposes, a direction re-convects its light alone, a transfer function all.
    #[test]
    fn only_what_changed_is_done_again() {
        let grid = uneven();
        let values = drifting(&grid, 0);
        let sets = [BOTH, "light.convection=ordered"];
        let mut lit = Lit::new(grid, &sets);
        let boxes = lit.show(&values).0.bricks_total / 2;
        assert_eq!(lit.show(&values).0.bricks_active, 0);
        let Light::Distant { irradiance, .. } = &mut lit.lights[0] else { panic!() };
        *irradiance = [0.0, 0.0, 3.0];
        let (report, light) = lit.show(&values);
        assert_eq!(report.bricks_active, 0);
        assert!(light.iter().all(|v| v[0] == 0.0));
        let Light::Distant { direction, .. } = &mut lit.lights[1] else { panic!() };
        *direction = Vec3::Y;
        let (report, light) = lit.show(&values);
        assert_eq!(report.bricks_active, boxes);
        let mut fresh = Lit::new(grid, &sets);
        fresh.lights = lit.lights.clone();
        assert_eq!(light, fresh.show(&values).1);
        let (report, light) = lit.show_over(&values, [0.0, 2.0]);
        assert!(report.bricks_active > boxes && report.bricks_active <= 2 * boxes, "{report:?}");
        assert_eq!(light, fresh.show_over(&values, [0.0, 2.0]).1);
    }

    /// Ordered light leaves alone the bricks whose medium and inflow are the same, whatever kind of light, and is the cold
    /// light to the bit.
    #[test]
    fn ordered_light_leaves_alone_what_did_not_change() {
        let grid = Grid::new([48, 40, 44]);
        let corner = |step: usize| {
            let mut values = drifting(&grid, 0);
            for (at, v) in values.iter_mut().enumerate() {
                let p = [at % 48, at / 48 % 40, at / 1920];
                if p.iter().all(|p| (2..8).contains(p)) {
                    *v = 0.2 * (step % 3) as f32;
                }
            }
            values
        };
        let away = "lights=[{direction=[-0.5, -0.6, -0.4]}]";
        let place = "lights=[{kind=\"point\", position=[30, 21, 25]}]";
        let outside = "lights=[{kind=\"point\", position=[70, 60, 30]}]";
        for lights in [away, place, outside] {
            let sets = [lights, "light.convection=ordered"];
            let mut warm = Lit::new(grid, &sets);
            for step in 0..4 {
                let values = corner(step);
                let (report, light) = warm.show(&values);
                assert_eq!(light, Lit::new(grid, &sets).show(&values).1, "{lights}, step {step}");
                let most = if step == 0 { report.bricks_total } else { report.bricks_total / 3 };
                assert!((1..=most).contains(&report.bricks_active), "{lights}, step {step}: {report:?}");
            }
        }
    }

    /// However short the time, a step lights something, and the rest follows.
    #[test]
    fn a_budget_in_time_is_kept_and_carried_on() {
        let grid = uneven();
        let values = drifting(&grid, 0);
        let exact = Lit::new(grid, &[BOTH, "light.convection=ordered"]).show(&values).1;
        let mut lit = Lit::new(grid, &[BOTH, "light.budget_ms=0.001", "light.iterations=3"]);
        let (report, _) = lit.show(&values);
        assert!(!report.converged && report.certified_error >= 0.3, "one light waits: {report:?}");
        let steps = (0..200).find(|_| lit.show(&values).0.converged).expect("converges");
        assert!(steps > 2);
        assert!(apart(&lit.show(&values).1, &exact) < 1e-3);
        // With time enough one step is all it takes.
        let (report, light) = Lit::new(grid, &[BOTH, "light.budget_ms=10000"]).show(&values);
        assert!(report.converged && apart(&light, &exact) < 1e-3, "{report:?}");
    }

    /// An environment is even, whatever the medium; a lone one has nothing to convect.
    #[test]
    fn an_environment_adds_its_fluence() {
        let grid = uneven();
        let (report, light) =
            Lit::new(grid, &["lights=[{kind=\"environment\", intensity=0.5}]"]).show(&drifting(&grid, 0));
        let fluence = 4.0 * std::f32::consts::PI * 0.5;
        assert!(light.iter().flatten().all(|v| (v / fluence - 1.0).abs() < 1e-5));
        assert_eq!((report.bricks_total, report.certified_error), (0, 0.0));
    }

    /// 1/r² in vacuum, and nothing outside a cone.
    #[test]
    fn physical_falloff_and_cones() {
        let grid = Grid::new([31, 31, 31]);
        let nothing = vec![0.0; grid.len()];
        let usual = ["light.falloff=physical", "light.sigma_s=[0, 0, 0]"];
        let point = "lights=[{kind=\"point\", position=[15, 15, 15], intensity=4}]";
        let light = Lit::new(grid, &[point, usual[0], usual[1]]).show(&nothing).1;
        for p in [[15, 15, 20], [3, 15, 15], [20, 11, 15], [15, 15, 30]] {
            let square: f32 = p.iter().map(|v| (*v as f32 - 15.0).powi(2)).sum();
            let got = light[grid.index(p)][0];
            assert!((got * square / 4.0 - 1.0).abs() < 1e-3, "{p:?}: {got}");
        }
        let cone =
            "lights=[{kind=\"cone\", position=[15, 15, -10], direction=[0, 0, 1], angle=20, edge=0, intensity=4}]";
        let light = Lit::new(grid, &[cone, usual[0], usual[1]]).show(&nothing).1;
        for (at, v) in light.iter().enumerate() {
            let p = [at % 31, at / 31 % 31, at / 961].map(|v| v as f32);
            let off = ((p[0] - 15.0).powi(2) + (p[1] - 15.0).powi(2)).sqrt();
            let angle = off.atan2(p[2] + 10.0).to_degrees();
            assert!(v[0] == 0.0 || angle < 20.01, "{p:?} at {angle}° is lit");
            assert!(v[0] > 0.0 || angle > 19.99, "{p:?} at {angle}° is dark");
        }
    }
}
