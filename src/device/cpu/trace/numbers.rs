//! Random numbers without a state, in integers that WGSL has too.
//!
//! Independent ones are the hash [`pcg4d`] of pixel, sample, count and seed. Pairs for the first dimensions of a
//! path are the first two dimensions of Sobol's sequence with its order and digits scrambled (Owen 1995; Laine & Karras's hash with
//! Vegdahl's constants, as by Burley 2020): each pair is stratified over any 2^k samples of a pixel, and pairs are independent.

use crate::device::random::{pcg4d, unit};

/// Owen's scrambling of the binary digits of a number, both in reverse order.
#[inline]
fn scramble(mut x: u32, seed: u32) -> u32 {
    x ^= x.wrapping_mul(0x3d20_adea);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul((seed >> 16) | 1);
    x ^= x.wrapping_mul(0x0552_6c56);
    x ^ x.wrapping_mul(0x53a2_2864)
}

/// The second dimension of Sobol's sequence, in reverse order: Pascal's triangle modulo 2.
#[inline]
fn pascal(mut x: u32) -> u32 {
    x ^= (x >> 16) & 0x0000_ffff;
    x ^= (x >> 8) & 0x00ff_00ff;
    x ^= (x >> 4) & 0x0f0f_0f0f;
    x ^= (x >> 2) & 0x3333_3333;
    x ^ ((x >> 1) & 0x5555_5555)
}

/// Pairs that are spread evenly over the samples of a pixel.
pub const PAIRS: usize = 5;

/// The numbers of one path after another of a pixel.
#[derive(Debug, Clone)]
pub struct Numbers {
    pixel: u32,
    sample: u32,
    seed: u32,
    count: u32,
    block: [u32; 4],
    /// For each pair the scrambling of the order of samples and of both numbers.
    scramblings: [[u32; 4]; PAIRS],
}

impl Numbers {
    /// Of the samples of a pixel; [`Numbers::begin`] comes before each.
    #[inline]
    pub fn new(pixel: u32, seed: u32) -> Self {
        let scramblings = std::array::from_fn(|pair| pcg4d([pixel, !(pair as u32), 0x5bd1_e995, seed]));
        Numbers { pixel, sample: 0, seed, count: 0, block: [0; 4], scramblings }
    }

    /// Begins a sample.
    #[inline]
    pub fn begin(&mut self, sample: u32) {
        (self.sample, self.count) = (sample, 0);
    }

    /// The next independent number.
    #[inline]
    pub fn draw(&mut self) -> f32 {
        let at = (self.count & 3) as usize;
        if at == 0 {
            self.block = pcg4d([self.pixel, self.sample, self.count >> 2, self.seed]);
        }
        self.count += 1;
        unit(self.block[at])
    }

    /// One of the [`PAIRS`].
    #[inline]
    pub fn pair(&self, pair: usize) -> [f32; 2] {
        self.spread(pair, self.sample)
    }

    /// The same of any sample.
    #[inline]
    pub fn spread(&self, pair: usize, sample: u32) -> [f32; 2] {
        let [order, x, y, _] = self.scramblings[pair];
        let i = scramble(sample.reverse_bits(), order).reverse_bits();
        [unit(scramble(i, x).reverse_bits()), unit(scramble(pascal(i), y).reverse_bits())]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Any 2^k samples put one point into each box of area 2^−k, whatever its shape.
    #[test]
    fn pairs_are_stratified_at_every_shape() {
        for (pixel, dimension) in [(0, 0), (7, 1), (123_456, 4)] {
            for k in 0..8u32 {
                let n = 1u32 << k;
                for start in [0, n, 5 * n] {
                    let points: Vec<_> =
                        (start..start + n).map(|s| Numbers::new(pixel, 9).spread(dimension, s)).collect();
                    for wide in 0..=k {
                        let (columns, rows) = (1usize << wide, 1usize << (k - wide));
                        let mut seen = vec![0; n as usize];
                        for [x, y] in &points {
                            seen[(*x * columns as f32) as usize * rows + (*y * rows as f32) as usize] += 1;
                        }
                        assert!(seen.iter().all(|c| *c == 1), "{k} {wide} {start}");
                    }
                }
            }
        }
    }

    /// Independent numbers are even, and uncorrelated from one to the next, from sample to sample and from pixel to pixel.
    #[test]
    fn hashes_are_even_and_uncorrelated() {
        let n = 1 << 14;
        let draw = |pixel, sample, skip: usize| {
            let mut numbers = Numbers::new(pixel, 3);
            numbers.begin(sample);
            (0..=skip).map(|_| numbers.draw()).last().unwrap()
        };
        let series: [Box<dyn Fn(u32) -> f32>; 3] =
            [Box::new(|i| draw(0, 0, i as usize % 512)), Box::new(|i| draw(5, i, 1)), Box::new(|i| draw(i, 5, 2))];
        for (kind, number) in series.iter().enumerate() {
            let n = if kind == 0 { 512 } else { n };
            let values: Vec<f64> = (0..n).map(|i| f64::from(number(i)) - 0.5).collect();
            let mean = values.iter().sum::<f64>() / f64::from(n);
            let lag = values.windows(2).map(|w| w[0] * w[1]).sum::<f64>() / f64::from(n);
            // Standard errors are 0.289/√n and 1/12/√n.
            assert!(mean.abs() < 4.0 * 0.289 / f64::from(n).sqrt(), "{kind} {mean}");
            assert!(lag.abs() < 4.0 / 12.0 / f64::from(n).sqrt(), "{kind} {lag}");
        }
    }
}
