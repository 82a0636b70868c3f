//! The same bits whatever the instruction set, the bricks and the skipping.

use glam::Vec3;
use proptest::prelude::*;

use super::*;
use crate::camera::Camera;
use crate::device::{Buffer, Cone, Lamp, Phong, Storage, Term, Weight};
use crate::field::EMPTY;
use crate::grid::{BrickLayout, Grid};
use crate::transfer::Table;

fn buffer(values: Vec<f32>) -> Buffer {
    Buffer(Storage::Host(values))
}

/// Reproducible numbers in 0..1.
fn noise(seed: u32, len: usize) -> Vec<f32> {
    let mut state = seed.wrapping_mul(0x9e37_79b9) | 1;
    (0..len)
        .map(|_| {
            state ^= state << 13;
            state ^= state >> 17;
            state ^= state << 5;
            (state >> 8) as f32 / (1 << 24) as f32
        })
        .collect()
}

/// Blobs in empty space with a block of holes.
fn field(grid: &Grid, seed: u32) -> Vec<f32> {
    let at = noise(seed, 12);
    let mut values = noise(seed + 1, grid.len());
    for (i, v) in values.iter_mut().enumerate() {
        let index = [i % grid.size[0], i / grid.size[0] % grid.size[1], i / (grid.size[0] * grid.size[1])];
        let near = |blob: usize| {
            let d2: f32 = (0..3).map(|a| (index[a] as f32 - at[3 * blob + a] * grid.size[a] as f32).powi(2)).sum();
            d2 < 12.0
        };
        *v = match (near(0), near(1) || near(2)) {
            (true, _) => EMPTY,
            (_, true) => 0.3 + 0.7 * *v,
            _ => 0.0,
        };
    }
    values
}

/// Majorants by their definition: the largest entry of the table anywhere within reach of a brick with its halo.
fn majorant(bricks: &BrickLayout, grid: &Grid, values: &[f32], table: &Table) -> Vec<f32> {
    (0..bricks.len())
        .map(|b| {
            let region = bricks.region(b).grown(1, grid.size);
            let (mut lo, mut hi) = (f32::INFINITY, f32::NEG_INFINITY);
            for k in region.start[2]..region.end()[2] {
                for j in region.start[1]..region.end()[1] {
                    for i in region.start[0]..region.end()[0] {
                        let v = values[grid.index([i, j, k])];
                        if v > crate::field::HOLE {
                            (lo, hi) = (lo.min(v), hi.max(v));
                        }
                    }
                }
            }
            if lo > hi {
                return 0.0;
            }
            let last = (table.extinction.len() - 1) as f32;
            let [lo, hi] = [(table.normalise(lo) * last) as usize, (table.normalise(hi) * last).ceil() as usize];
            (lo..=hi).map(|i| table.extinction[i] + table.emission.get(i).map_or(0.0, |e| e[0])).fold(0.0, f32::max)
        })
        .collect()
}

#[derive(Debug)]
struct Case {
    grid: Grid,
    light: Grid,
    table: Table,
    camera: Camera,
    phong: Option<Phong>,
    step: f32,
    seed: u32,
}

impl Case {
    /// Renders by `cast`, skipping bricks of `edge` if any.
    fn render(&self, edge: Option<usize>, cast: impl Fn(&March, &mut Frame)) -> Vec<[u32; 4]> {
        let values = field(&self.grid, self.seed);
        let bricks = BrickLayout::new(self.grid.size, edge.unwrap_or(1));
        let majorant = edge.map_or(vec![], |_| majorant(&bricks, &self.grid, &values, &self.table));
        let values = buffer(values);
        let same = buffer(noise(self.seed + 2, self.grid.len()));
        let coarse = buffer(noise(self.seed + 3, self.light.len()));
        let direction = Vec3::new(0.3, -0.5, -0.8).normalize();
        let (lo, hi) = self.grid.bounds();
        let cone = Cone { axis: direction, outer: -0.3, inner: 0.4, cosine: false };
        let lamp = Lamp { position: lo + 0.3 * (hi - lo), radius: 0.2, cone: Some(cone) };
        let term = |values, grid, weight| Term { values, grid, weight };
        let terms = [
            term(&coarse, &self.light, Weight::Uniform([0.2, 0.1, 0.3])),
            term(&same, &self.grid, Weight::Phase { direction, irradiance: [1.0, 2.0, 3.0], g: 0.7 }),
            term(&coarse, &self.light, Weight::Lamp { lamp, intensity: [0.4, 0.5, 0.2], g: -0.4 }),
            term(&coarse, &self.light, Weight::Current { axis: 1, weight: [0.3, 0.2, -2.0] }),
        ];
        let mut frame = Frame::new([37, 21]);
        let march = March {
            grid: &self.grid,
            field: &values,
            gradient: None,
            table: &self.table,
            bricks,
            majorant: &majorant,
            terms: &terms,
            phong: self.phong,
            camera: &self.camera,
            clips: &[],
            step: self.step,
        };
        cast(&march, &mut frame);
        frame.pixels.iter().map(|p| p.map(f32::to_bits)).collect()
    }
}

fn case() -> impl Strategy<Value = Case> {
    (
        ([1usize..24, 1usize..24, 1usize..24], [1usize..9, 1usize..9, 1usize..9], 0u32..1 << 20),
        (0.2f32..2.0, any::<bool>(), any::<bool>(), 0usize..3),
        [-1.0f32..1.0, -1.0f32..1.0, -1.0f32..1.0],
        0.0f32..3.0,
    )
        .prop_map(|((size, light, seed), (step, glows, shiny, albedo), from, distance)| {
            let grid = Grid { size, spacing: [0.5, 1.0, 0.75], origin: [10.0, -3.0, 0.0] };
            let (lo, hi) = grid.bounds();
            let centre = (0.5 * (lo + hi)).as_vec3();
            let from = Vec3::from(from) + Vec3::new(0.01, 0.02, 0.0);
            let eye = centre + distance * (hi - lo).length() as f32 * from.normalize();
            let colour = |i: usize| match albedo {
                0 => [0.9, 0.5, 0.2],
                1 => [i as f32 / 64.0; 3],
                _ => [0.5, i as f32 / 64.0, 1.0 - i as f32 / 64.0],
            };
            Case {
                grid,
                light: grid.resized(light),
                table: Table {
                    chromatic: if seed % 3 == 0 { [0.4, 1.0, 0.0] } else { [1.0; 3] },
                    lo: 0.1,
                    hi: 0.9,
                    extinction: (0..64).map(|i| if i < 8 { 0.0 } else { 0.02 * i as f32 }).collect(),
                    albedo: (0..64).map(colour).collect(),
                    emission: if glows {
                        (0..64).map(|i| [if i == 40 { 1.0 } else { 0.0 }; 3]).collect()
                    } else {
                        vec![]
                    },
                    ..Default::default()
                },
                camera: Camera::look_at(eye, centre + Vec3::new(0.013, 0.007, 0.0), Vec3::Z, 50.0),
                phong: shiny.then_some(Phong {
                    towards_light: Vec3::new(-0.3, 0.5, 0.8).normalize(),
                    ambient: 0.3,
                    diffuse: 0.7,
                    specular: 0.2,
                    shininess: 20.0,
                }),
                step,
                seed,
            }
        })
}

fn levels() -> impl Iterator<Item = Level> {
    [Level::Portable, Level::Avx2, Level::Avx512].into_iter().filter(|&l| l <= simd::level())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn every_instruction_set_and_every_brick_size_gives_the_same_bits(case in case(), edge in 1usize..12) {
        let truth = case.render(None, march_scalar);
        prop_assert!(truth.iter().flatten().all(|&c| f32::from_bits(c).is_finite()));
        prop_assert_eq!(&truth, &case.render(Some(edge), march_scalar), "scalar, bricks of {}", edge);
        for level in levels() {
            for edge in [None, Some(edge)] {
                let picture = case.render(edge, |march, frame| {
                    let plan = Plan::new(march, None, frame.size).expect("something to see");
                    frame.pixels = cast(&plan, at_level(level));
                });
                prop_assert_eq!(&truth, &picture, "{:?}, bricks of {:?}", level, edge);
            }
        }
    }
}

#[test]
fn the_pictures_compared_show_something() {
    let grid = Grid { size: [20, 21, 22], spacing: [0.5, 1.0, 0.75], origin: [10.0, -3.0, 0.0] };
    let values = field(&grid, 5);
    assert!(values.contains(&EMPTY) && values.iter().any(|&v| v > 0.3) && values.contains(&0.0));
}
