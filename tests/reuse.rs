//! Tiles that see nothing new keep their pixels (light.md, frames): to the bit what a picture made anew would be.

use std::sync::Arc;

use gloaming::Grid;
use gloaming::device::Device;
use gloaming::device::cpu::Cpu;
use gloaming::field::{Dense, Timestep};
use gloaming::scene::Scene;
use gloaming::session::Session;
use gloaming::sink::Output;

const N: usize = 56;

/// A still fog with structure, a ball that drifts in one corner, and a hole that comes and goes.
fn step(t: usize) -> Timestep {
    let grid = Grid::new([N, N + 3, N - 2]);
    let [nx, ny, nz] = grid.size;
    let mut values = vec![0.0f32; grid.len()];
    for k in 0..nz {
        for j in 0..ny {
            for i in 0..nx {
                let p = [i, j, k].map(|v| v as f32);
                let blob = |c: [f32; 3], r: f32| {
                    (1.0 - (0..3).map(|a| (p[a] - c[a]).powi(2)).sum::<f32>().sqrt() / r).max(0.0)
                };
                let still = blob([40.0, 42.0, 14.0], 11.0);
                let moving = blob([9.0 + 0.3 * t as f32, 8.0, 44.0], 5.0);
                values[grid.index([i, j, k])] = still + moving;
            }
        }
    }
    if t % 5 == 4 {
        values[grid.index([40, 42, 14])] = f32::NAN;
    }
    Timestep { step: t as u64, time: None, grid, field: Arc::new(Dense::new(grid.size, values)) }
}

fn session(sets: &[&str], device: Arc<dyn Device>) -> Session {
    let common = ["render.size=[150, 101]", "lights.0.direction=[-0.3, -0.2, 0.9]", "field.range=[0.0, 1.0]"];
    let sets: Vec<String> = common.iter().chain(sets).map(|s| s.to_string()).collect();
    Session::new(device, Scene::load(None, &sets).unwrap(), None, false).unwrap()
}

/// The same steps with and without the light of the step before, which is also without its pictures.
fn assert_same_pictures(device: Arc<dyn Device>, sets: &[&str], steps: &[usize]) -> Vec<Output> {
    let mut reusing = session(sets, device.clone());
    let anew: Vec<&str> = sets.iter().copied().chain(["light.warm=false"]).collect();
    let mut anew = session(&anew, device);
    let output = |&t: &usize| {
        let (got, want) = (reusing.advance(step(t)).unwrap(), anew.advance(step(t)).unwrap());
        assert_eq!(want.row.tiles_reused, 0);
        for (got, want) in got.frames.iter().zip(&want.frames) {
            let bits =
                |f: &gloaming::frame::Frame| f.pixels.as_flattened().iter().map(|v| v.to_bits()).collect::<Vec<_>>();
            assert!(bits(&got.frame) == bits(&want.frame), "step {t} of {sets:?}");
            assert!(want.frame.pixels.iter().any(|p| p[3] > 0.1), "nothing to see");
        }
        got
    };
    steps.iter().map(output).collect()
}

fn cpu() -> Arc<dyn Device> {
    Arc::new(Cpu::new(2).unwrap())
}

const DIRECT: [&str; 2] = ["light.scattering=false", "light.tolerance=0"];

#[test]
fn a_local_change_renders_a_part_of_the_picture() {
    let shading = ["render.shading=phong"];
    for more in [
        &[][..],
        &shading,
        &["light.direct_resolution=0.5"],
        &["cameras.0.name=a", "cameras.1.name=b", "cameras.1.azimuth=140"],
    ] {
        let sets: Vec<&str> = DIRECT.iter().chain(more).copied().collect();
        let rows = assert_same_pictures(cpu(), &sets, &[0, 1, 2, 3, 4, 5, 5, 5, 6]);
        let reused: Vec<(u64, u64)> = rows.iter().map(|o| (o.row.tiles_reused, o.row.tiles_total)).collect();
        // Nothing can be kept before there are two pictures of a known past; what does not change is kept whole.
        assert_eq!(reused[0].0, 0);
        assert!(reused[3].0 * 4 > reused[3].1, "{more:?}: {reused:?}");
        assert!(reused[3].0 < reused[3].1, "the moving ball is seen: {reused:?}");
        assert_eq!(reused[7].0, reused[7].1, "{more:?}: {reused:?}");
    }
}

/// With scattered light everything changes when anything does, but a still step costs no ray.
#[test]
fn a_still_step_with_scattered_light_keeps_the_picture() {
    let sets = ["light.tolerance=0", "light.directions=8", "light.resolution=0.25"];
    let rows = assert_same_pictures(cpu(), &sets, &[0, 1, 1, 1, 2]);
    let reused: Vec<u64> = rows.iter().map(|o| o.row.tiles_reused).collect();
    assert_eq!((reused[1], reused[3], reused[4]), (0, rows[3].row.tiles_total, 0));
}

/// The camera moves, or the transfer function's range does: nothing is kept.
#[test]
fn a_camera_or_a_transfer_function_that_changes_keeps_nothing() {
    for more in ["cameras.0.orbit=3", "field.range=step"] {
        let mut scene = session(&DIRECT, cpu()).scene().clone();
        let sets = ["render.size=[150, 101]", "lights.0.direction=[-0.3, -0.2, 0.9]"];
        let sets: Vec<String> = sets.iter().chain(&DIRECT).chain(&[more]).map(|s| s.to_string()).collect();
        if more.starts_with("field") {
            scene = Scene::load(None, &sets).unwrap();
        } else {
            scene.cameras = Scene::load(None, &sets).unwrap().cameras;
        }
        let mut session = Session::new(cpu(), scene, None, false).unwrap();
        for t in [0, 1, 2, 3] {
            let mut step = step(t);
            if more.starts_with("field") {
                let mut values = vec![0.0; step.grid.len()];
                step.field.read(step.grid.region(), &mut values).unwrap();
                values.iter_mut().for_each(|v| *v *= 1.0 + 0.1 * t as f32);
                step.field = Arc::new(Dense::new(step.grid.size, values));
            }
            assert_eq!(session.advance(step).unwrap().row.tiles_reused, 0, "{more}");
        }
    }
}

/// Direct light where nobody can see it is left out, unless the illuminated volume is wanted; the pictures are the same to the
/// bit, also when something turns up where no light was solved.
#[test]
fn light_that_nobody_sees_is_not_solved() {
    for more in [&[][..], &["light.interpolation=cubic"], &["light.direct_resolution=0.5"]] {
        let sets: Vec<String> =
            ["render.size=[120, 90]", "lights.0.direction=[0.9, 0.2, 0.1]", "field.range=[0.0, 1.0]"]
                .iter()
                .chain(&DIRECT)
                .chain(more)
                .map(|s| s.to_string())
                .collect();
        let scene = Scene::load(None, &sets).unwrap();
        let session = |wants_light| Session::new(cpu(), scene.clone(), None, wants_light).unwrap();
        let (mut seen, mut all) = (session(false), session(true));
        let size = [72, 40, 40];
        let mut culled = 0;
        for t in 0..8 {
            let grid = Grid::new(size);
            let ball = |i: usize, c: [f32; 3], r: f32| {
                let p = [i % size[0], i / size[0] % size[1], i / (size[0] * size[1])].map(|v| v as f32);
                (1.0 - (0..3).map(|a| (p[a] - c[a]).powi(2)).sum::<f32>().sqrt() / r).max(0.0)
            };
            // From the fourth step on there is a second ball far downstream, and in the last two a third.
            let values = (0..grid.len()).map(|i| {
                ball(i, [10.0 + 0.4 * t as f32, 9.0, 9.0], 7.0)
                    + if t >= 3 { ball(i, [56.0, 22.0, 14.0], 6.0) } else { 0.0 }
                    + if t >= 6 { ball(i, [60.0, 32.0, 34.0], 5.0) } else { 0.0 }
            });
            let field = Arc::new(Dense::new(size, values.collect()));
            let step = Timestep { step: t as u64, time: None, grid, field };
            let (seen, all) = (seen.advance(step.clone()).unwrap(), all.advance(step).unwrap());
            assert!(seen.frames[0].frame == all.frames[0].frame, "step {t}, {more:?}");
            culled += all.row.bricks_active - seen.row.bricks_active;
        }
        // A cubic foot reads downstream bricks too: it is swept whole.
        assert_eq!(culled > 0, more != ["light.interpolation=cubic"], "{more:?}");
    }
}
