//! Random numbers without a state, in integers that WGSL has too.
//!
//! Independent ones are the hash [`pcg4d`] of pixel, sample, count and seed. Pairs for the first dimensions of a
//! path are the first two dimensions of Sobol's sequence with its order and digits scrambled (Owen 1995; Laine & Karras's hash with
//! Vegdahl's constants, as by Burley 2020): each pair is stratified over any 2^k samples of a pixel, and pairs are independent.

use crate::device::random::{pcg4d, unit};

/// Owen's scrambling of the binary digits of a number.
#[inline]
fn scramble(x: u32, seed: u32) -> u32 {
    let mut x = x.reverse_bits();
    x ^= x.wrapping_mul(0x3d20_adea);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul((seed >> 16) | 1);
    x ^= x.wrapping_mul(0x0552_6c56);
    x ^= x.wrapping_mul(0x53a2_2864);
    x.reverse_bits()
}

/// The second dimension of Sobol's sequence: Pascal's triangle modulo 2.
#[inline]
fn pascal(mut x: u32) -> u32 {
    x ^= (x >> 16) & 0x0000_ffff;
    x ^= (x >> 8) & 0x00ff_00ff;
    x ^= (x >> 4) & 0x0f0f_0f0f;
    x ^= (x >> 2) & 0x3333_3333;
    x ^= (x >> 1) & 0x5555_5555;
    x.reverse_bits()
}

/// The numbers of one path.
#[derive(Debug, Clone)]
pub struct Numbers {
    pixel: u32,
    sample: u32,
    seed: u32,
    count: u32,
    block: [u32; 4],
}

impl Numbers {
    /// Of a sample of a pixel.
    #[inline]
    pub fn new(pixel: u32, sample: u32, seed: u32) -> Self {
        Numbers { pixel, sample, seed, count: 0, block: [0; 4] }
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

    /// A pair that is spread evenly over the samples of the pixel.
    #[inline]
    pub fn pair(&self, dimension: u32) -> [f32; 2] {
        let [order, x, y, _] = pcg4d([self.pixel, !dimension, 0x5bd1_e995, self.seed]);
        let i = scramble(self.sample, order);
        [unit(scramble(i.reverse_bits(), x)), unit(scramble(pascal(i), y))]
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
                        (start..start + n).map(|s| Numbers::new(pixel, s, 9).pair(dimension)).collect();
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
            let mut numbers = Numbers::new(pixel, sample, 3);
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
