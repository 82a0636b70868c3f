//! Kernels of the paper's model: convection and diffusion.

use glam::DVec3;
use gloaming::BrickLayout;
use gloaming::device::convection::{Convection, Layers, Opacity, Start};

use super::*;

const LITERAL: Opacity = Opacity::Literal { length: 0.02 };
const CALIBRATED: Opacity = Opacity::Calibrated { length: 0.015 };

fn extinction(seed: u32) -> Vec<f32> {
    noise(seed, ODD.iter().product()).iter().map(|v| if *v < 0.3 { 0.0 } else { 20.0 * v * v }).collect()
}

/// Distant lights of all kinds and places inside, on a plane of voxels, in the rim and outside.
fn lights() -> Vec<Convection> {
    let grid = anisotropic();
    let world = |p: [f64; 3]| DVec3::from_array(std::array::from_fn(|a| grid.origin[a] + p[a] * grid.spacing[a]));
    let places = [[17.3, 20.6, 30.1], [10.0, 5.5, 60.0], [-0.4, 30.0, 20.0], [-9.0, 80.0, 25.0]];
    let far = directions().into_iter().step_by(4);
    far.map(|u| Convection::distant(&grid, u, CALIBRATED))
        .chain(places.into_iter().enumerate().map(|(i, p)| {
            let opacity = if i % 2 == 0 { LITERAL } else { CALIBRATED };
            Convection::central(&grid, world(p), (i != 1).then_some(0.5), opacity)
        }))
        .collect()
}

#[test]
fn ordered_convection_agrees() {
    let sigma = extinction(80);
    for light in lights() {
        let layout = BrickLayout::new(ODD, 16);
        let fronts = light.fronts(&layout);
        let all: Vec<&[u32]> = fronts.iter().map(|f| &f[..]).collect();
        // All bricks, and then those of the last two fronts alone, through another medium.
        let [want, got] = both(|d| {
            let mut rho = d.alloc(sigma.len()).unwrap();
            d.convect_ordered(&light, &layout, &upload(d, &sigma), &mut rho, &all).unwrap();
            let whole = download(d, &rho);
            let sigma: Vec<f32> = sigma.iter().map(|v| 1.3 * v).collect();
            let last = &all[all.len() - 2..];
            let changes = d.convect_ordered(&light, &layout, &upload(d, &sigma), &mut rho, last).unwrap();
            [whole, download(d, &rho), changes]
        });
        assert!(want[0].iter().any(|v| *v > 0.0) && want[2].iter().any(|v| *v > 0.0));
        for (part, (want, got)) in want.iter().zip(&got).enumerate() {
            assert_close(want, got, 2e-5, &format!("part {part}, {light:?}"));
        }
    }
}

#[test]
fn iterations_of_all_voxels_agree() {
    let (sigma, before) = (extinction(81), noise(82, ODD.iter().product()));
    for light in lights() {
        let [want, got] = both(|d| {
            let mut rho = d.alloc(sigma.len()).unwrap();
            let change = d.convect_whole(&light, &upload(d, &sigma), &upload(d, &before), &mut rho).unwrap();
            [download(d, &rho), vec![change]]
        });
        assert_close(&want[0], &got[0], 2e-6, &format!("{light:?}"));
        assert_close(&want[1], &got[1], 1e-5, &format!("change, {light:?}"));
    }
}

#[test]
fn iterations_of_layers_agree() {
    let sigma = extinction(83);
    let before: Vec<f32> = noise(84, sigma.len());
    for (i, u) in directions().into_iter().enumerate() {
        let opacity = if i % 3 == 0 { LITERAL } else { CALIBRATED };
        let light = Convection::distant(&anisotropic(), u, opacity);
        let start = [Start::Upstream, Start::Zero, Start::Best][i % 3];
        // With a tolerance the two may stop one iteration apart.
        let layers = Layers { iterations: [1, 4, 3][i % 3], tolerance: 0.0, start };
        let [(want, told), (got, heard)] = both(|d| {
            let mut rho = d.alloc(sigma.len()).unwrap();
            let done = d.convect_layers(&light, layers, &upload(d, &sigma), &upload(d, &before), &mut rho).unwrap();
            (download(d, &rho), done)
        });
        let what = format!("light along {u}, from {start:?}");
        assert_close(&want, &got, 1e-5, &what);
        assert_eq!((told.iterations, told.updates), (heard.iterations, heard.updates), "{what}");
        assert_close(&[told.error], &[heard.error], 1e-3, &what);
    }
}

#[test]
fn diffusion_agrees() {
    let values = noise(86, ODD.iter().product());
    let long: Vec<f32> = (0..90).map(|n| if n == 0 { 0.5 } else { 0.5 / (2.0 * 89.0) }).collect();
    let short = [0.4, 0.2, 0.1];
    for weights in [[&short[..], &short, &short], [&[1.0], &short, &long], [&long, &[1.0], &[1.0]]] {
        let [want, got] = both(|d| {
            let mut buffer = upload(d, &values);
            d.diffuse(ODD, weights, &mut buffer).unwrap();
            download(d, &buffer)
        });
        assert_close(&want, &got, 2e-6, &format!("{:?} weights", weights.map(|w| w.len())));
    }
}

#[test]
fn relaxation_agrees() {
    let (rhs, values) = (noise(87, ODD.iter().product()), noise(88, ODD.iter().product()));
    let coupling = [1.5, 0.7, 3.0];
    let coarse = [19, 32, 25];
    let correction = noise(89, coarse.iter().product());
    let [want, got] = both(|d| {
        let (rhs, mut x, mut r) = (upload(d, &rhs), upload(d, &values), d.alloc(rhs.len()).unwrap());
        d.relax(ODD, coupling, &rhs, &mut x, 0).unwrap();
        let half = download(d, &x);
        d.relax(ODD, coupling, &rhs, &mut x, 1).unwrap();
        let largest = d.residual(ODD, coupling, &rhs, &x, &mut r).unwrap();
        let whole = download(d, &x);
        d.prolong(coarse, &upload(d, &correction), ODD, &mut x).unwrap();
        [half, whole, download(d, &r), vec![largest], download(d, &x)]
    });
    for (part, (want, got)) in want.iter().zip(&got).enumerate() {
        assert_close(want, got, 5e-6, &format!("part {part}"));
    }
    assert!(
        want[0].iter().zip(&values).filter(|(a, b)| a == b).count() * 2 + 1 >= values.len(),
        "one colour at a time"
    );
}
