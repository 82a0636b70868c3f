//! Whole steps: classified, lit, kept warm and rendered on either device.

use gloaming::scene::Scene;
use gloaming::session::Session;
use gloaming::sink::Output;
use gloaming::source::{self, SourceSpec};

use super::*;

const SMOKE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/smoke.h5");

fn steps(device: Arc<dyn Device>, sets: &[&str]) -> Vec<Output> {
    let common = ["render.size=[96, 64]", "light.resolution=0.25", "light.directions=8"];
    let sets: Vec<String> = common.iter().chain(sets).map(|s| s.to_string()).collect();
    let mut session = Session::new(device, Scene::load(None, &sets).unwrap(), Some([0.0, 1.0]), true).unwrap();
    let series = source::open(&SourceSpec { series: vec![SMOKE.into()], ..Default::default() }).unwrap();
    (20..23).map(|i| session.advance(series.timestep(i).unwrap()).unwrap()).collect()
}

fn assert_same_steps(sets: &[&str], tolerance: f32) {
    let (want, got) = (steps(Arc::new(Cpu::new(0).unwrap()), sets), steps(shared().clone(), sets));
    for (step, (want, got)) in want.iter().zip(&got).enumerate() {
        let [a, b] = [want, got].map(|o| o.frames[0].frame.pixels.as_flattened());
        assert!(a.iter().any(|v| *v > 0.01), "step {step} shows something");
        assert_close(a, b, tolerance, &format!("picture {step}"));
        let [a, b] = [want, got].map(|o| o.light.as_ref().unwrap().fluence.as_flattened());
        assert_close(a, b, tolerance, &format!("light {step}"));
        assert_eq!(want.row.start, got.row.start);
    }
}

#[test]
fn direct_light_agrees() {
    assert_same_steps(&["light.scattering=false"], 1e-4);
}

/// Both devices iterate to the scene's tolerance; where they stop differs by rounding.
#[test]
fn scattered_light_agrees() {
    assert_same_steps(&["transfer.anisotropy=0.5", "light.tolerance=1e-3"], 2e-3);
}

/// The paper's model, with lights of all its kinds.
#[test]
fn the_papers_model_agrees() {
    assert_same_steps(
        &[
            "light.model=paper",
            "light.diffusion=multigrid",
            "lights.0.kind=distant",
            "lights.1.kind=point",
            "lights.1.position=[40, 20, 30]",
            "lights.2.kind=cone",
            "lights.2.position=[90, -30, 100]",
            "lights.2.direction=[-0.4, 0.6, -0.7]",
        ],
        1e-3,
    );
    assert_same_steps(&["light.model=paper", "light.falloff=physical", "lights.0.kind=point"], 1e-3);
}

#[test]
fn point_and_cone_lights_agree() {
    let sets = [
        "transfer.anisotropy=0.4",
        "light.scattering=false",
        "lights.0.kind=point",
        "lights.0.position=[40, 50, 60]",
        "lights.0.intensity=5000",
        "lights.1.kind=cone",
        "lights.1.position=[-50, 48, 20]",
        "lights.1.intensity=20000",
        "lights.1.direction=[1, 0, 0.1]",
        "lights.1.edge=5",
        "lights.1.radius=5",
    ];
    assert_same_steps(&sets, 1e-4);
}

#[test]
fn coloured_extinction_agrees() {
    let sets = ["light.scattering=false", "transfer.chromatic=[0.2, 1, 3]", "transfer.emission=[[0, 0], [1, 0.1]]"];
    assert_same_steps(&sets, 1e-4);
}
