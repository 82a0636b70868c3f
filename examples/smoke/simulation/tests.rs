//! What the simulation's numerics promise.

use glam::Vec3A;

use super::advect::{Paths, advect};
use super::lattice::{Lattice, Place};
use super::pressure::Projection;
use super::{LEFT_OVER, Smoke, TIME_STEP, series::Series};

/// A round blob, eight cells across at half its height, that turns once about the box's axis comes back to where it was.
/// The limiter is what costs smoke's sum: without it the same turn keeps the sum to 0.1 % but leaves negative smoke.
#[test]
fn advection_keeps_smoke_and_its_shape() {
    let lattice = Lattice { cells: [40, 40, 12] };
    let middle = Vec3A::new(20.5, 20.5, 6.5);
    let blob = |here: Vec3A| (-(here - middle - Vec3A::new(8.0, 0.0, 0.0)).length_squared() / 23.0).exp();
    let mut start = lattice.zeros();
    lattice.for_each(&mut start, Place::Cell, |_, here, v| *v = blob(here));
    let mut velocity = vec![Vec3A::ZERO; lattice.len()];
    lattice.for_rows(&mut velocity, [0; 3], |at, row| {
        let y = (at % lattice.plane() / lattice.row()) as f32 - middle.y;
        for (i, v) in row.iter_mut().enumerate() {
            *v = Vec3A::new(-y, (i + 1) as f32 - middle.x, 0.0);
        }
    });

    let steps = 40;
    let paths = Paths::trace(&lattice, &velocity, std::f32::consts::TAU / steps as f32);
    let mut values = start.clone();
    for step in 1..=steps {
        advect(&lattice, &paths, &mut values, Place::Cell, Some(0.0));
        let (least, most) = values.iter().fold((f32::MAX, f32::MIN), |(lo, hi), &v| (lo.min(v), hi.max(v)));
        assert!(least >= 0.0 && most <= 1.0, "step {step}: values {least}..{most} left the range they started in");
    }

    let sum = |values: &[f32]| lattice.sum(|c| f64::from(values[c]));
    let lost = sum(&values) / sum(&start) - 1.0;
    assert!(lost.abs() < 0.02, "a turn changed the smoke by {:.2} %", 100.0 * lost);
    let difference = lattice.sum(|c| f64::from(values[c] - start[c]).powi(2));
    let error = (difference / lattice.sum(|c| f64::from(start[c]).powi(2))).sqrt();
    // One semi-Lagrangian step without the way back would leave 29 %.
    assert!(error < 0.15, "a turn changed the shape by {:.1} %", 100.0 * error);
}

/// What leaves through an open side is gone, and nothing comes in.
#[test]
fn smoke_blows_out_of_the_box() {
    let lattice = Lattice { cells: [8, 8, 8] };
    let paths = Paths::trace(&lattice, &vec![Vec3A::X; lattice.len()], 2.0);
    let mut values = vec![1.0; lattice.len()];
    (0..5).for_each(|_| advect(&lattice, &paths, &mut values, Place::Cell, Some(0.0)));
    assert_eq!(lattice.max(|c| values[c]), 0.0);
}

/// A reproducible velocity without any order.
fn noise(lattice: &Lattice) -> [Vec<f32>; 3] {
    let hash = |c: usize, axis: usize| {
        let mixed = (c * 3 + axis + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        ((mixed ^ (mixed >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9) >> 40) as f32 / (1 << 23) as f32 - 1.0
    };
    [0, 1, 2].map(|axis| {
        let mut faces = lattice.zeros();
        lattice.for_each(&mut faces, Place::Face(axis), |c, _, v| *v = hash(c, axis));
        faces
    })
}

fn root_sum(values: &[f32]) -> f64 {
    values.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt()
}

/// Odd numbers of cells, a floor, and a ball that cuts cells.
#[test]
fn projection_leaves_a_thousandth_of_the_divergence() {
    let mut smoke = Smoke::new(27);
    let mut velocity = noise(&smoke.lattice);
    let before = root_sum(&smoke.projection.divergence(&velocity));
    let iterations = smoke.projection.project(&mut velocity, LEFT_OVER);
    let left = root_sum(&smoke.projection.divergence(&velocity)) / before;
    // The residual that stops the solver is f32 arithmetic away from the divergence of what comes out.
    assert!(left <= 1.1 * LEFT_OVER, "{left} of the divergence is left");
    assert!(iterations <= 12, "{iterations} iterations: the preconditioner does not do its work");

    let ball = smoke.lattice.at(14, 14, (0.52 * 27.0) as usize + 1);
    for (axis, faces) in velocity.iter().enumerate() {
        assert_eq!(faces[ball], 0.0, "the flow enters the ball along axis {axis}");
    }
    assert_eq!(velocity[2][smoke.lattice.at(5, 5, 1)], 0.0, "the flow enters the floor");
}

/// The flow out of a potential has nothing to keep; a flow free of divergence stays.
#[test]
fn projection_takes_the_gradient_and_nothing_else() {
    let lattice = Lattice { cells: [16, 16, 16] };
    let open = || {
        [0, 1, 2].map(|axis| {
            let mut faces = lattice.zeros();
            lattice.for_each(&mut faces, Place::Face(axis), |_, _, w| *w = 1.0);
            faces
        })
    };
    let mut potential = lattice.zeros();
    lattice
        .for_each(&mut potential, Place::Cell, |_, here, v| *v = (here.x * 0.7).sin() * (here.y - 0.3 * here.z).cos());
    let mut gradient = [0, 1, 2].map(|axis| {
        let mut faces = lattice.zeros();
        let stride = lattice.stride(axis);
        lattice.for_each(&mut faces, Place::Face(axis), |c, _, u| *u = potential[c] - potential[c - stride]);
        faces
    });
    Projection::new(lattice, open()).project(&mut gradient, 1e-5);
    let left = gradient.iter().flatten().fold(0.0f32, |m, u| m.max(u.abs()));
    assert!(left < 1e-3, "{left} of a gradient is left");

    let mut turning = [lattice.zeros(), lattice.zeros(), lattice.zeros()];
    lattice.for_each(&mut turning[0], Place::Face(0), |_, here, u| *u = -(here.y - 8.5));
    lattice.for_each(&mut turning[1], Place::Face(1), |_, here, u| *u = here.x - 8.5);
    let before = turning.clone();
    Projection::new(lattice, open()).project(&mut turning, 1e-5);
    let change = turning.iter().flatten().zip(before.iter().flatten()).fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
    assert!(change < 1e-4, "a flow free of divergence changed by {change}");
}

#[test]
fn steps_do_not_depend_on_the_number_of_threads() {
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut smoke = Smoke::new(20);
            (0..6).for_each(|_| smoke.step());
            smoke.density()
        })
    };
    let one = run(1);
    assert!(one.iter().any(|&v| v > 0.5), "no smoke came in");
    assert!(one == run(3));
}

/// Hot smoke rises and spreads, the ball stays free of it, and densities stay densities.
#[test]
fn smoke_rises_round_the_ball() {
    let mut smoke = Smoke::new(24);
    let height = |values: &[f32]| {
        let (mut weighted, mut sum) = (0.0, 0.0);
        for (c, v) in values.iter().enumerate() {
            weighted += f64::from(*v) * (c / (24 * 24)) as f64;
            sum += f64::from(*v);
        }
        weighted / sum
    };
    let mut last = 0.0;
    for _ in 0..4 {
        (0..8).for_each(|_| smoke.step());
        let values = smoke.density();
        assert!(values.iter().all(|v| (0.0..=1.0).contains(v)));
        assert!(height(&values) > last, "the smoke does not rise");
        last = height(&values);
        assert_eq!(values[(12 * 24 + 12) * 24 + 12], 0.0, "smoke inside the ball");
    }
    assert!((smoke.time() - 32.0 * TIME_STEP).abs() < 1e-9);
}

#[test]
fn the_series_holds_what_was_appended() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("series.h5");
    let steps = [0.25, 0.5].map(|time| (time, (0..24).map(|v| v as f32 * time as f32).collect::<Vec<_>>()));
    let mut series = Series::create(&path, [4, 3, 2], 0.25).unwrap();
    for (time, values) in &steps {
        series.append(*time, values).unwrap();
    }
    drop(series);

    let file = hdf5::File::open(&path).unwrap();
    let density = file.dataset("density").unwrap();
    assert_eq!(density.shape(), [2, 2, 3, 4]);
    assert_eq!(density.read_raw::<f32>().unwrap(), [&steps[0].1[..], &steps[1].1].concat());
    assert_eq!(file.dataset("time").unwrap().read_raw::<f64>().unwrap(), [0.25, 0.5]);
    assert_eq!(density.attr("spacing").unwrap().read_raw::<f64>().unwrap(), [0.25; 3]);
    assert_eq!(density.attr("origin").unwrap().read_raw::<f64>().unwrap(), [0.125; 3]);
}
