//! The WGSL kernels: each parses, has the layout that the host believes, and computes what its twin in Rust computes.
//!
//! They run on software Vulkan unless `GLOAMING_TEST_DEVICE` names another adapter.
#![cfg(feature = "gpu")]

use std::sync::OnceLock;

use glam::Vec3;
use gloaming::camera::Camera;
use gloaming::device::gpu::{Gpu, adapters, shader};
use gloaming::device::{
    Buffer, Device, March, Optic, Ordinate, Phong, SourceTerm, Sweep, Term, Transport, Weight, cpu::Cpu,
};
use gloaming::field::{EMPTY, HOLE};
use gloaming::frame::Frame;
use gloaming::transfer::Table;
use gloaming::{BrickLayout, Error, Grid};
use wgpu::naga;

/// Prime to bricks and workgroups on every axis.
const ODD: [usize; 3] = [37, 64, 51];

fn gpu() -> &'static Gpu {
    static GPU: OnceLock<Gpu> = OnceLock::new();
    GPU.get_or_init(|| {
        let name = std::env::var("GLOAMING_TEST_DEVICE").unwrap_or("llvmpipe".into());
        Gpu::open(Some(&name)).unwrap_or_else(|e| {
            panic!("{e}\nThese tests want software Vulkan: apt-get install mesa-vulkan-drivers libvulkan1")
        })
    })
}

fn cpu() -> &'static Cpu {
    static CPU: OnceLock<Cpu> = OnceLock::new();
    CPU.get_or_init(|| Cpu::new(0).unwrap())
}

/// Numbers in 0..1 without pattern.
fn noise(seed: u32, n: usize) -> Vec<f32> {
    let mut state = seed.wrapping_mul(2_654_435_761).wrapping_add(0x9e37_79b9);
    (0..n)
        .map(|_| {
            state ^= state << 13;
            state ^= state >> 17;
            state ^= state << 5;
            (state >> 8) as f32 / 16_777_216.0
        })
        .collect()
}

fn upload(device: &dyn Device, values: &[f32]) -> Buffer {
    let mut buffer = device.alloc(values.len()).unwrap();
    device.upload(values, &mut buffer).unwrap();
    buffer
}

fn download(device: &dyn Device, buffer: &Buffer) -> Vec<f32> {
    let mut out = vec![0.0; buffer.len()];
    device.download(buffer, &mut out).unwrap();
    out
}

/// Runs the same on both devices.
fn both<T>(run: impl Fn(&dyn Device) -> T) -> [T; 2] {
    [run(cpu()), run(gpu())]
}

/// Fails unless `got` is within `tolerance` of `want`, relative to the largest value wanted.
fn assert_close(want: &[f32], got: &[f32], tolerance: f32, what: &str) {
    assert_eq!(want.len(), got.len(), "{what}");
    let scale = want.iter().filter(|v| v.is_finite()).fold(f32::MIN_POSITIVE, |m, v| m.max(v.abs()));
    for (i, (w, g)) in want.iter().zip(got).enumerate() {
        assert!(w == g || (w - g).abs() <= tolerance * scale, "{what}: value {i}: {w} on the CPU, {g} on the GPU");
    }
}

/// A smooth transfer function with colour and glow.
fn table() -> Table {
    let at = |i: usize| i as f32 / (Table::ENTRIES - 1) as f32;
    Table {
        lo: 0.1,
        hi: 0.8,
        extinction: (0..Table::ENTRIES).map(|i| 9.0 * at(i) * at(i)).collect(),
        albedo: (0..Table::ENTRIES).map(|i| [0.9, 0.5 + 0.4 * at(i), 0.8 - 0.3 * at(i)]).collect(),
        emission: (0..Table::ENTRIES).map(|i| [at(i), 0.0, 0.5 * at(i)]).collect(),
    }
}

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

fn module(s: &shader::Shader) -> naga::Module {
    naga::front::wgsl::parse_str(s.source).unwrap_or_else(|e| panic!("{}", e.emit_to_string(s.source)))
}

#[test]
fn shaders_are_valid() {
    for s in shader::shaders() {
        let capabilities = naga::valid::Capabilities::IMMEDIATES;
        let mut validator = naga::valid::Validator::new(naga::valid::ValidationFlags::all(), capabilities);
        let checked = validator.validate(&module(s));
        assert!(checked.is_ok(), "{}: {}", s.name, checked.unwrap_err().emit_to_string(s.source));
    }
}

#[test]
fn uniforms_have_the_layout_of_the_host() {
    for s in shader::shaders() {
        let module = module(s);
        let uniform = module.global_variables.iter().find(|(_, v)| v.space == naga::AddressSpace::Uniform);
        let span = uniform.map(|(_, v)| u64::from(module.types[v.ty].inner.size(module.to_ctx())));
        assert_eq!(s.params, span, "{}", s.name);
    }
}

#[test]
fn values_come_back() {
    let values = noise(1, 12_345);
    assert_eq!(download(gpu(), &upload(gpu(), &values)), values);
    assert!(download(gpu(), &gpu().alloc(999).unwrap()).iter().all(|&v| v == 0.0));
    assert!(gpu().alloc(0).unwrap().is_empty());
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

/// All octants, each axis dominant, exactly along axes, and along a diagonal where the foot is a voxel.
fn directions() -> Vec<Vec3> {
    let mut all: Vec<Vec3> = Vec::new();
    for (i, lengths) in [[0.9f32, 0.35, 0.2], [0.3, 0.8, 0.5], [0.1, 0.4, 0.7]].iter().enumerate() {
        for octant in 0..8 {
            // Two of three octants for each dominant axis keep the test short.
            if (octant + i) % 3 != 0 {
                let sign = |a: usize| if octant >> a & 1 == 0 { 1.0 } else { -1.0 };
                all.push(Vec3::new(sign(0) * lengths[0], sign(1) * lengths[1], sign(2) * lengths[2]).normalize());
            }
        }
    }
    all.extend([Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z]);
    all.extend([Vec3::new(1.0, -1.0, 1.0).normalize(), Vec3::new(0.0, 1.0, -1.0).normalize()]);
    all
}

fn anisotropic() -> Grid {
    Grid { size: ODD, spacing: [0.02, 0.015, 0.03], origin: [1.0, -2.0, 0.5] }
}

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
        let [want, got] = both(|d| sweep_on(d, &sweep, &BrickLayout::new(ODD, 16), [&sigma, &rho], Listed::All));
        assert_close(&want[0], &got[0], 1e-5, &format!("light along {u}"));
        assert_close(&want[1], &got[1], 1e-5, &format!("changes along {u}"));
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

#[test]
fn extensions_agree() {
    let sigma: Vec<f32> = noise(33, ODD.iter().product()).iter().map(|v| if *v < 0.9 { 0.0 } else { *v }).collect();
    let values: Vec<f32> = sigma.iter().zip(noise(34, sigma.len())).map(|(s, v)| s * v).collect();
    let [want, got] = both(|d| {
        let mut out = d.alloc(sigma.len()).unwrap();
        d.extend(ODD, &upload(d, &sigma), &upload(d, &values), &mut out).unwrap();
        download(d, &out)
    });
    assert_close(&want, &got, 1e-6, "all");
    // The continuation is far below the values: compare it on its own.
    let faint = |v: &[f32]| v.iter().zip(&sigma).map(|(v, s)| if *s > 0.0 { 0.0 } else { *v }).collect::<Vec<_>>();
    assert!(faint(&want).iter().any(|v| *v > 0.0));
    assert_close(&faint(&want), &faint(&got), 1e-5, "continued");
}

#[test]
fn sources_agree() {
    let n = 10_007;
    let sigma: Vec<f32> = noise(50, n).iter().map(|v| if *v < 0.2 { 0.0 } else { 5.0 * v }).collect();
    let volumes: Vec<Vec<f32>> = (51..58).map(|seed| noise(seed, n)).collect();
    let lights = [(0.7, Vec3::new(0.6, 0.0, -0.8)), (2.0, Vec3::NEG_Y)];
    for (glows, forward) in [(false, None), (true, Some(1.3)), (true, None)] {
        let [want, got] = both(|d| {
            let sigma = upload(d, &sigma);
            let v: Vec<Buffer> = volumes.iter().map(|v| upload(d, v)).collect();
            let first: Vec<(&Buffer, f32, Vec3)> = v[..2].iter().zip(lights).map(|(v, (e, u))| (v, e, u)).collect();
            let mut out: [Buffer; 4] = std::array::from_fn(|_| d.alloc(n).unwrap());
            let [source, gradient @ ..] = out.each_mut();
            let term = SourceTerm {
                sigma: &sigma,
                scattering: &v[2],
                emission: glows.then_some(&v[3]),
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

/// Two blobs in empty space, one with a hole.
fn blobs(size: [usize; 3]) -> Vec<f32> {
    let grid = Grid::new(size);
    let mut field = vec![0.0; grid.len()];
    for (i, value) in field.iter_mut().enumerate() {
        let at = Vec3::new((i % size[0]) as f32, (i / size[0] % size[1]) as f32, (i / (size[0] * size[1])) as f32);
        let (a, b) = (at.distance(Vec3::new(12.0, 20.0, 14.0)), at.distance(Vec3::new(28.0, 50.0, 40.0)));
        *value = if a < 2.5 { EMPTY } else { (1.1 - a / 9.0).max(1.0 - b / 7.0).max(0.0) };
    }
    field
}

/// Renders the blobs with and without skipping; both pictures of a device must be the same to the bit.
fn picture(d: &dyn Device, camera: &Camera, weights: &[(Weight, bool)], phong: Option<Phong>) -> Vec<[f32; 4]> {
    let (grid, field) = (anisotropic(), blobs(ODD));
    let coarse = grid.resized([18, 32, 25]);
    let bricks = BrickLayout::new(ODD, 8);
    let field = upload(d, &field);
    let ranges = d.brick_range(&bricks, &field).unwrap();
    let majorant: Vec<f32> = ranges.iter().map(|r| if r[1] > table().lo { 1.0 } else { 0.0 }).collect();
    assert!(majorant.contains(&0.0) && majorant.contains(&1.0));
    let volumes: Vec<(Buffer, &Grid)> = (40..)
        .zip(weights)
        .map(|(seed, (_, fine))| if *fine { (seed, &grid) } else { (seed, &coarse) })
        .map(|(seed, grid)| (upload(d, &noise(seed, grid.len())), grid))
        .collect();
    let terms: Vec<Term> = volumes
        .iter()
        .zip(weights)
        .map(|((values, grid), (weight, _))| Term { values, grid, weight: *weight })
        .collect();
    let [skipping, plain] = [&majorant[..], &[]].map(|majorant| {
        let mut frame = Frame::new([61, 43]);
        let table = table();
        let grid = &grid;
        d.march(
            &March { grid, field: &field, table: &table, bricks, majorant, terms: &terms, phong, camera, step: 0.011 },
            &mut frame,
        )
        .unwrap();
        frame.pixels
    });
    assert_eq!(skipping, plain, "skipping empty bricks moves a sample on {}", d.name());
    skipping
}

fn cameras() -> [Camera; 3] {
    let centre = Vec3::new(1.37, -1.52, 1.25);
    let from = |eye: Vec3| Camera::look_at(eye, centre, Vec3::Z, 40.0);
    [from(Vec3::new(2.6, -4.0, 2.0)), from(Vec3::new(1.1, -1.8, 0.6)), from(Vec3::new(-2.0, -1.52, 1.25))]
}

fn phase(direction: [f32; 3], g: f32) -> Weight {
    Weight::Phase { direction: Vec3::from(direction).normalize(), irradiance: [3.0, 2.0, 1.0], g }
}

#[test]
fn marches_agree() {
    let weights = [
        (Weight::Uniform([0.2, 0.1, 0.3]), false),
        (phase([0.3, -0.5, -0.8], 0.6), true),
        (Weight::Current { axis: 1, weight: [0.3, 0.2, -0.4] }, false),
    ];
    let towards_light = Vec3::new(-0.3, 0.5, 0.8).normalize();
    let phong = Phong { towards_light, ambient: 0.3, diffuse: 0.7, specular: 0.4, shininess: 20.0 };
    for (camera, phong) in cameras().iter().zip([None, Some(phong), None]) {
        for weights in [&weights[..], &[]] {
            let [want, got] = both(|d| picture(d, camera, weights, phong));
            assert!(want.iter().any(|p| p[3] > 0.5));
            assert_close(want.as_flattened(), got.as_flattened(), 2e-5, &format!("{camera:?}"));
        }
    }
}

/// More light volumes than a kernel binds: the smaller ones are copied together.
#[test]
fn many_lights_agree() {
    let mut weights: Vec<(Weight, bool)> =
        (0..9).map(|i| (Weight::Current { axis: i % 3, weight: [0.1 * i as f32, 0.2, 0.3] }, i == 4)).collect();
    weights.push((phase([1.0, 0.0, 0.0], -0.3), true));
    weights.push((Weight::Uniform([0.5, 0.4, 0.3]), false));
    let [want, got] = both(|d| picture(d, &cameras()[0], &weights, None));
    assert_close(want.as_flattened(), got.as_flattened(), 2e-5, "11 lights");
}

#[test]
fn too_much_is_an_error() {
    let budget = gpu().report().max_binding;
    match gpu().alloc((budget / 4 + 1) as usize) {
        Err(Error::OutOfMemory { needed, budget: b }) => assert!(needed == budget + 4 && b == budget),
        other => panic!("{:?}", other.map(|b| b.len())),
    }
}

#[test]
fn foreign_and_short_buffers_are_errors() {
    let mut out = gpu().alloc(8).unwrap();
    let mut coarse = |values: &Buffer| gpu().restrict([4; 3], values, [2; 3], &mut out);
    assert!(matches!(coarse(&upload(cpu(), &[0.0; 64])), Err(Error::Device(_))));
    assert!(matches!(coarse(&upload(gpu(), &[0.0; 63])), Err(Error::Device(_))));
    assert!(coarse(&upload(gpu(), &[0.0; 64])).is_ok());
}

#[test]
fn unknown_adapters_are_named_errors() {
    let Err(e) = Gpu::open(Some("no such adapter")) else { panic!("opened") };
    let message = e.to_string();
    assert!(message.contains("no such adapter") && message.contains("try:"), "{message}");
    assert!(adapters().iter().any(|a| message.contains(&a.name)), "{message}");
}

/// In a process of its own, as a driver is looked for once.
#[test]
fn without_a_driver_there_are_no_adapters() {
    const CHILD: &str = "GLOAMING_TEST_WITHOUT_DRIVER";
    if std::env::var_os(CHILD).is_none() {
        let child = std::process::Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "without_a_driver_there_are_no_adapters", "--nocapture"])
            .env(CHILD, "1")
            .env("WGPU_BACKEND", "vulkan")
            .env("VK_ICD_FILENAMES", "/nowhere.json")
            .env("VK_DRIVER_FILES", "/nowhere.json")
            .output()
            .unwrap();
        assert!(child.status.success(), "{}", String::from_utf8_lossy(&child.stdout));
        return;
    }
    assert_eq!(adapters(), []);
    assert!(Gpu::hardware().unwrap().is_none());
    for name in [None, Some("llvmpipe")] {
        let Err(e) = Gpu::open(name) else { panic!("opened {name:?}") };
        assert!(e.to_string().contains("--device cpu"), "{e}");
    }
}
