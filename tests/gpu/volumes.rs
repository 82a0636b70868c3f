//! Kernels on whole volumes: optics, bricks, sums.

use gloaming::BrickLayout;
use gloaming::device::Optic;
use gloaming::field::{EMPTY, HOLE};

use super::*;

/// A field with holes: single ones, and a block that fills whole bricks.
fn holey(size: [usize; 3]) -> Vec<f32> {
    let grid = Grid::new(size);
    let mut field = noise(7, grid.len());
    for i in (0..field.len()).step_by(97) {
        field[i] = EMPTY;
    }
    for k in 0..size[2].min(20) {
        for j in 0..size[1].min(20) {
            (0..size[0].min(20)).for_each(|i| field[grid.index([i, j, k])] = EMPTY);
        }
    }
    field
}

#[test]
fn classify_agrees() {
    let field = holey(ODD);
    let optics = [
        Optic::Extinction,
        Optic::ScaledExtinction { f: 0.3 },
        Optic::Scattering { channel: 1 },
        Optic::Emission { channel: 2 },
    ];
    for (optic, size) in optics.into_iter().zip([ODD, [18, 32, 25], [13, 64, 7], [3, 5, 4]]) {
        let [want, got] = both(|d| {
            let mut out = d.alloc(size.iter().product()).unwrap();
            d.classify(optic, &table(), ODD, &upload(d, &field), size, &mut out).unwrap();
            download(d, &out)
        });
        assert!(want.iter().any(|&v| v > 0.0));
        assert_close(&want, &got, 1e-5, &format!("{optic:?} on {size:?}"));
    }
}

#[test]
fn restrict_agrees() {
    let values = noise(2, ODD.iter().product());
    for coarse in [ODD, [18, 32, 25], [10, 9, 51]] {
        let [want, got] = both(|d| {
            let mut out = d.alloc(coarse.iter().product()).unwrap();
            d.restrict(ODD, &upload(d, &values), coarse, &mut out).unwrap();
            download(d, &out)
        });
        assert_close(&want, &got, 1e-5, &format!("{coarse:?}"));
    }
}

#[test]
fn brick_ranges_agree() {
    let field = holey(ODD);
    for edge in [16, 19, 64] {
        let layout = BrickLayout::new(ODD, edge);
        let [want, got] = both(|d| d.brick_range(&layout, &upload(d, &field)).unwrap());
        assert_eq!(want, got, "edge {edge}");
        assert!(got.iter().all(|r| r[0] > HOLE));
    }
    let empty = both(|d| d.brick_range(&BrickLayout::new([4; 3], 4), &upload(d, &[EMPTY; 64])).unwrap());
    assert_eq!(empty, [vec![[f32::INFINITY, f32::NEG_INFINITY]], vec![[f32::INFINITY, f32::NEG_INFINITY]]]);
}

#[test]
fn changes_agree() {
    let now = noise(3, ODD.iter().product());
    let mut before = now.clone();
    // One brick and a lone value on a face of another.
    before[0] += 0.5;
    before[(31 * ODD[1] + 40) * ODD[0] + 16] -= 0.25;
    for edge in [16, 64] {
        let layout = BrickLayout::new(ODD, edge);
        let [want, got] = both(|d| d.change(&layout, &upload(d, &now), &upload(d, &before)).unwrap());
        assert_close(want.as_flattened(), got.as_flattened(), 1e-6, &format!("edge {edge}"));
        assert!(got.iter().any(|c| c[0] > 0.0) && (edge == 64 || got.contains(&[0.0; 3])));
    }
}

#[test]
fn compose_agrees() {
    let volumes: Vec<Vec<f32>> = (0..3).map(|s| noise(20 + s, 70_001)).collect();
    let weights = [[1.0, 0.5, 0.25], [0.0, 2.0, 0.1], [0.3, 0.3, 0.3]];
    let [want, got] = both(|d| {
        let buffers: Vec<Buffer> = volumes.iter().map(|v| upload(d, v)).collect();
        let terms: Vec<(&Buffer, [f32; 3])> = buffers.iter().zip(weights).collect();
        let mut out = vec![[9.0; 3]; 70_001];
        d.compose(&terms, &mut out).unwrap();
        out
    });
    assert_close(want.as_flattened(), got.as_flattened(), 1e-6, "illuminated volume");
}

#[test]
fn combinations_agree() {
    let volumes: Vec<Vec<f32>> = (0..3).map(|s| noise(30 + s, 50_003)).collect();
    for weights in [&[][..], &[1.0], &[2.5], &[2.0, -1.0, 0.3]] {
        let [want, got] = both(|d| {
            let buffers: Vec<Buffer> = volumes.iter().map(|v| upload(d, v)).collect();
            let terms: Vec<(&Buffer, f32)> = buffers.iter().zip(weights.iter().copied()).collect();
            let mut out = upload(d, &volumes[2]);
            d.combine(&terms, &mut out).unwrap();
            download(d, &out)
        });
        assert_close(&want, &got, 1e-6, &format!("{weights:?}"));
    }
    let [want, got] = both(|d| {
        let [mut a, mut b] = [upload(d, &volumes[0]), upload(d, &volumes[1])];
        // The largest values sit at the end, behind the last whole chunk.
        let distance = d.distance(&a, &b).unwrap();
        (a, b) =
            (upload(d, &[&volumes[0][..], &[7.0, 0.0]].concat()), upload(d, &[&volumes[1][..], &[0.5, 0.0]].concat()));
        [distance, d.distance(&a, &b).unwrap(), d.largest_ratio(&b, &a).unwrap(), d.dot(&a, &b).unwrap() as f32]
    });
    assert_eq!(want[..3], got[..3]);
    assert!((want[3] - got[3]).abs() < 1e-6 * want[3], "{want:?} {got:?}");
}

/// Points inside, in the rim and far outside, also of volumes of one plane.
#[test]
fn samples_agree() {
    for size in [ODD, [1, 7, 5], [9, 1, 1]] {
        let values = noise(3, size.iter().product());
        let points: Vec<[f32; 3]> = noise(4, 3 * 1000)
            .chunks_exact(3)
            .map(|p| std::array::from_fn(|a| (1.4 * p[a] - 0.2) * size[a] as f32))
            .chain([[0.0; 3], [1e9, -1e9, 0.5], size.map(|n| (n - 1) as f32)])
            .collect();
        let [want, got] = both(|d| {
            let mut out = vec![0.0; points.len()];
            d.sample(size, &upload(d, &values), &points, &mut out).unwrap();
            out
        });
        assert_eq!(want[1002], values[values.len() - 1], "the last value at its place");
        assert_close(&want, &got, 1e-5, &format!("{size:?}"));
    }
}
