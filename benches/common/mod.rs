//! The machine's copy rate, measured beside what is compared with it.

use std::time::Instant;

/// Seconds of the fastest of `n` runs.
pub fn best(n: usize, mut run: impl FnMut()) -> f64 {
    (0..n)
        .map(|_| {
            let begun = Instant::now();
            run();
            begun.elapsed().as_secs_f64()
        })
        .fold(f64::INFINITY, f64::min)
}

/// Bytes per second, read and written, of copying a large array with all cores.
pub fn copy_rate() -> f64 {
    use rayon::prelude::*;
    const LEN: usize = 1 << 26;
    let from = vec![1.0f32; LEN];
    let mut to = vec![0.0f32; LEN];
    let chunk = LEN / rayon::current_num_threads();
    let seconds =
        best(5, || to.par_chunks_mut(chunk).zip(from.par_chunks(chunk)).for_each(|(t, f)| t.copy_from_slice(f)));
    assert_eq!(to[LEN / 2], 1.0);
    8.0 * LEN as f64 / seconds
}
