//! Kernels that move light: sweeps and transport.

use gloaming::device::{Cone, Lamp, Ordinate, PointSweep, SourceTerm, Sweep, Transport, Travel};
use gloaming::{BrickLayout, Region};

use glam::DVec3;

use super::*;

/// Which bricks a sweep lists. The CPU does not compare where all of them are listed.
#[derive(Clone, Copy, PartialEq)]
enum Listed {
    All,
    AllButTheLast,
    Half,
}

fn sweep_on(
    d: &dyn Device,
    s: &Sweep,
    layout: &BrickLayout,
    [sigma, rho]: [&[f32]; 2],
    listed: Listed,
) -> [Vec<f32>; 2] {
    let mut rho = upload(d, rho);
    let fronts = layout.fronts(s.ascending());
    let mut some: Vec<&[u32]> = fronts.iter().map(|f| &f[..]).collect();
    match listed {
        Listed::All => {}
        Listed::AllButTheLast => some.truncate(fronts.len() - 1),
        Listed::Half => some.iter_mut().for_each(|f| *f = &f[f.len() / 2..]),
    }
    let changes = d.sweep(s, layout, &upload(d, sigma), &mut rho, &some).unwrap();
    [download(d, &rho), changes]
}

#[test]
fn sweeps_agree() {
    let sigma: Vec<f32> = noise(4, ODD.iter().product()).iter().map(|v| 20.0 * v * v).collect();
    let rho = noise(5, sigma.len());
    for (i, u) in directions().into_iter().enumerate() {
        let edge = [16, 31, 64][i % 3];
        let sweep = Sweep::new(&anisotropic(), u, false);
        let layout = BrickLayout::new(ODD, edge);
        let listed = if i % 2 == 0 && layout.len() > 1 { Listed::AllButTheLast } else { Listed::All };
        let [want, got] = both(|d| sweep_on(d, &sweep, &layout, [&sigma, &rho], listed));
        assert_close(&want[0], &got[0], 1e-5, &format!("light along {u}, bricks of {edge}"));
        if listed != Listed::All {
            assert_close(&want[1], &got[1], 1e-5, &format!("changes along {u}, bricks of {edge}"));
        }
    }
}

#[test]
fn sweeps_of_some_bricks_agree() {
    let sigma: Vec<f32> = noise(6, ODD.iter().product()).iter().map(|v| 10.0 * v).collect();
    let rho = noise(7, sigma.len());
    let sweep = Sweep::new(&anisotropic(), Vec3::new(-0.4, 0.8, -0.3).normalize(), false);
    let [want, got] = both(|d| sweep_on(d, &sweep, &BrickLayout::new(ODD, 16), [&sigma, &rho], Listed::Half));
    assert_close(&want[0], &got[0], 1e-5, "light");
    assert_close(&want[1], &got[1], 1e-5, "changes");
    assert!(got[0].iter().zip(&rho).any(|(a, b)| a == b), "bricks that are not listed keep their light");
}

#[test]
fn a_second_sweep_changes_nothing() {
    let sigma = noise(8, ODD.iter().product());
    let sweep = Sweep::new(&anisotropic(), Vec3::new(0.2, -0.5, 0.8).normalize(), false);
    let layout = BrickLayout::new(ODD, 16);
    let [first, _] = sweep_on(gpu(), &sweep, &layout, [&sigma, &noise(9, sigma.len())], Listed::All);
    let [second, changes] = sweep_on(gpu(), &sweep, &layout, [&sigma, &first], Listed::All);
    assert_eq!(first, second);
    assert!(changes.iter().all(|&c| c == 0.0));
}

#[test]
fn cubic_sweeps_agree() {
    let sigma: Vec<f32> = noise(10, ODD.iter().product()).iter().map(|v| 10.0 * v * v).collect();
    let rho = noise(11, sigma.len());
    for u in directions().into_iter().step_by(3) {
        let sweep = Sweep::new(&anisotropic(), u, true);
        let layout = BrickLayout::new(ODD, 16);
        let [want, got] = both(|d| sweep_on(d, &sweep, &layout, [&sigma, &rho], Listed::All));
        assert_close(&want[0], &got[0], 1e-5, &format!("light along {u}"));
    }
}

/// Index positions: between voxels, on one, on a corner of bricks, in the rim, outside.
const LIGHTS: [[f64; 3]; 6] = [
    [14.3, 30.6, 20.2],
    [16.0, 31.0, 9.0],
    [15.5, 30.5, 31.5],
    [15.5, -0.2, 15.5],
    [-7.4, 20.3, 60.7],
    [17.2, -1.4, 8.0],
];

#[test]
fn sweeps_from_a_point_agree() {
    let grid = anisotropic();
    let sigma: Vec<f32> = noise(14, grid.len()).iter().map(|v| 20.0 * v * v).collect();
    let rho = noise(15, grid.len());
    for (i, light) in LIGHTS.into_iter().enumerate() {
        let at = DVec3::from(grid.origin) + DVec3::from(light) * DVec3::from(grid.spacing);
        let sweep = PointSweep::new(&grid, at, 1.0);
        let layout = BrickLayout::new(ODD, [16, 31, 8][i % 3]);
        let fronts = sweep.fronts(&layout);
        let last = fronts.len() - usize::from(i % 2 == 0);
        let [want, got] = both(|d| {
            let mut rho = upload(d, &rho);
            let some: Vec<&[u32]> = fronts[..last].iter().map(|f| &f[..]).collect();
            let changes = d.sweep_point(&sweep, &layout, &upload(d, &sigma), &mut rho, &some).unwrap();
            [download(d, &rho), changes]
        });
        assert_close(&want[0], &got[0], 1e-5, &format!("light at {light:?}"));
        if i % 2 == 0 {
            assert_close(&want[1], &got[1], 1e-5, &format!("changes from {light:?}"));
        }
    }
}

#[test]
fn lamps_agree() {
    let grid = anisotropic();
    let rho = noise(16, grid.len());
    let (lo, hi) = grid.bounds();
    let axis = Vec3::new(0.4, -0.3, 0.8).normalize();
    for cone in [None, Some(Cone { axis, outer: 0.2, inner: 0.7, cosine: false }), Some(Cone::facing(axis))] {
        let lamp = Lamp { position: lo + 0.4 * (hi - lo), radius: 0.05, cone };
        let [want, got] = both(|d| {
            let mut out = d.alloc(grid.len()).unwrap();
            d.irradiate(&lamp, &grid, 0..grid.size[2], &upload(d, &rho), &mut out).unwrap();
            download(d, &out)
        });
        assert_close(&want, &got, 1e-5, &format!("{cone:?}"));
        assert_eq!(cone.is_some(), want.contains(&0.0));
    }
}

#[test]
fn sources_agree() {
    let grid = Grid { size: [23, 19, 23], ..anisotropic() };
    let n = grid.len();
    let sigma: Vec<f32> = noise(50, n).iter().map(|v| if *v < 0.2 { 0.0 } else { 5.0 * v }).collect();
    let volumes: Vec<Vec<f32>> = (51..58).map(|seed| noise(seed, n)).collect();
    let (lo, hi) = grid.bounds();
    let lights = [(0.7, Travel::Along(Vec3::new(0.6, 0.0, -0.8))), (2.0, Travel::From(lo + 0.3 * (hi - lo)))];
    for (glows, forward) in [(false, None), (true, Some(1.3)), (true, None)] {
        let [want, got] = both(|d| {
            let sigma = upload(d, &sigma);
            let v: Vec<Buffer> = volumes.iter().map(|v| upload(d, v)).collect();
            let first: Vec<(&Buffer, f32, Travel)> = v[..2].iter().zip(lights).map(|(v, (e, u))| (v, e, u)).collect();
            let mut out: [Buffer; 4] = std::array::from_fn(|_| d.alloc(n).unwrap());
            let [source, gradient @ ..] = out.each_mut();
            let term = SourceTerm {
                sigma: &sigma,
                scattering: &v[2],
                emission: glows.then_some(&v[3]),
                grid: &grid,
                plane: 0,
                first: &first,
                phi: &v[3],
                current: forward.map(|f| ([&v[4], &v[5], &v[6]], f)),
            };
            d.source(&term, source, forward.map(|_| gradient)).unwrap();
            out.map(|b| download(d, &b))
        });
        for (want, got) in want.iter().zip(&got) {
            assert_close(want, got, 1e-6, &format!("glows {glows}, anisotropy {forward:?}"));
        }
    }
}

/// Ordinates in all octants with unequal weights, some with inflow, more than a workgroup takes at once.
fn ordinates() -> Vec<Ordinate> {
    let steep =
        [Vec3::new(0.1, 0.2, 0.95), Vec3::new(-0.2, 0.3, 0.9), Vec3::new(0.05, -0.3, 0.8)].map(|u| u.normalize());
    directions()
        .into_iter()
        .chain(steep)
        .zip(noise(60, 64))
        .enumerate()
        .map(|(i, (direction, weight))| Ordinate { direction, weight, inflow: if i % 4 == 0 { 0.3 } else { 0.0 } })
        .collect()
}

#[test]
fn transport_agrees() {
    let (grid, ordinates) = (Grid { size: [19, 32, 25], ..anisotropic() }, ordinates());
    let n = grid.len();
    // From vacuum through thin, where w₀ is a series, to thick.
    let sigma: Vec<f32> = noise(61, n).iter().map(|v| if *v < 0.3 { 0.0 } else { 200.0 * v.powi(6) }).collect();
    let source = noise(62, n);
    let gradient: [Vec<f32>; 3] = std::array::from_fn(|a| noise(63 + a as u32, n).iter().map(|v| v - 0.5).collect());
    for linear in [false, true] {
        let [want, got] = both(|d| {
            let (sigma, source) = (upload(d, &sigma), upload(d, &source));
            let gradient = gradient.each_ref().map(|g| upload(d, g));
            let mut phi = upload(d, &noise(66, n));
            let mut current: [Buffer; 3] = std::array::from_fn(|a| upload(d, &noise(67 + a as u32, n)));
            let transport = Transport {
                grid: &grid,
                ordinates: &ordinates,
                sigma: &sigma,
                source: &source,
                gradient: linear.then(|| gradient.each_ref()),
            };
            let extremes = d.transport(&transport, &mut phi, linear.then(|| current.each_mut())).unwrap();
            let [x, y, z] = current.map(|c| download(d, &c));
            [vec![extremes.0, extremes.1], download(d, &phi), x, y, z]
        });
        for (part, (want, got)) in want.iter().zip(&got).enumerate() {
            assert_close(want, got, 1e-5, &format!("part {part}, linear {linear}"));
        }
    }
}

/// A box of a grid is taken out and put back, to the bit; a buffer that is made smaller holds what a smaller one does.
#[test]
fn crops_agree() {
    let values = noise(71, ODD.iter().product());
    for region in [Region { start: [3, 0, 50], size: [20, 64, 1] }, Region { start: [0; 3], size: ODD }] {
        let [want, got] = both(|d| {
            let mut cropped = d.alloc(values.len()).unwrap();
            d.resize(&mut cropped, region.len()).unwrap();
            d.crop(ODD, &upload(d, &values), region, &mut cropped).unwrap();
            let mut back = upload(d, &values);
            d.embed(region, &cropped, ODD, &mut back).unwrap();
            let sum = d.dot(&cropped, &cropped).unwrap() as f32;
            [download(d, &cropped), download(d, &back), vec![sum]]
        });
        assert!(want[..2] == got[..2], "{region:?}");
        assert_close(&want[2], &got[2], 1e-5, "sum of squares");
    }
}

/// Inflow and source 1 give radiance 1 wherever, whatever σ (the white furnace).
#[test]
fn transport_is_a_white_furnace() {
    let grid = Grid { size: [19, 32, 25], ..anisotropic() };
    let ordinates: Vec<Ordinate> = ordinates().into_iter().map(|o| Ordinate { inflow: 1.0, ..o }).collect();
    let total: f32 = ordinates.iter().map(|o| o.weight).sum();
    let d = gpu();
    let sigma: Vec<f32> = noise(70, grid.len()).iter().map(|v| 100.0 * v * v).collect();
    let (sigma, source) = (upload(d, &sigma), upload(d, &vec![1.0; grid.len()]));
    let mut phi = d.alloc(grid.len()).unwrap();
    let t = Transport { grid: &grid, ordinates: &ordinates, sigma: &sigma, source: &source, gradient: None };
    let (change, most) = d.transport(&t, &mut phi, None).unwrap();
    assert!(download(d, &phi).iter().all(|p| (p / total - 1.0).abs() < 1e-5));
    assert!((change / total - 1.0).abs() < 1e-5 && change == most);
}
