//! Two-dimensional transfer functions: value and gradient magnitude (Kniss et al. 2002; GPU Gems 39).

use super::table::Table;

/// The rows of a two-dimensional table: row `j` of `n` stands for the gradient magnitude `steepest·j/(n−1)`; in between it is
/// linear, and steeper gradients are as the last row. The columns of the [`Table`] itself hold what bounds all rows.
#[derive(Debug, Clone, PartialEq)]
pub struct Graded {
    /// Gradient magnitude of the last row: data values per world length.
    pub steepest: f32,
    /// Extinction: [`Table::ENTRIES`] values of the first row, then those of the next.
    pub extinction: Vec<f32>,
    /// Single-scattering albedo.
    pub albedo: Vec<[f32; 3]>,
    /// Emitted radiance per world length; empty when nothing glows.
    pub emission: Vec<[f32; 3]>,
}

impl Graded {
    /// Rows of the tables that transfer functions make.
    pub const ROWS: usize = 64;

    /// Number of rows, at least 2.
    pub fn rows(&self) -> usize {
        self.extinction.len() / Table::ENTRIES
    }

    /// Rows per unit of gradient magnitude.
    pub fn scale(&self) -> f32 {
        if self.steepest > 0.0 { (self.rows() - 1) as f32 / self.steepest } else { 0.0 }
    }

    /// The largest extinction and emission of any row, and the albedo of the row that dims most.
    pub(super) fn envelope(&self) -> (Vec<f32>, Vec<[f32; 3]>, Vec<[f32; 3]>) {
        let entry = |i: usize| (0..self.rows()).map(move |j| j * Table::ENTRIES + i);
        let densest =
            |i: usize| entry(i).max_by(|a, b| self.extinction[*a].total_cmp(&self.extinction[*b])).expect("rows");
        let extinction = (0..Table::ENTRIES).map(|i| self.extinction[densest(i)]).collect();
        let albedo = (0..Table::ENTRIES).map(|i| self.albedo[densest(i)]).collect();
        let brightest =
            |i: usize| entry(i).fold([0.0f32; 3], |m, e| std::array::from_fn(|c| m[c].max(self.emission[e][c])));
        let emission = if self.emission.is_empty() { vec![] } else { (0..Table::ENTRIES).map(brightest).collect() };
        (extinction, albedo, emission)
    }
}

/// Gives entries at which nothing dims the albedo of a neighbour at which something does, so that colours do not fade towards
/// what is not there: interpolated colour is weighted by opacity.
pub(super) fn spread_colors(extinction: &[f32], albedo: &mut [[f32; 3]]) {
    let (width, height) = (Table::ENTRIES, extinction.len() / Table::ENTRIES);
    let before = albedo.to_vec();
    for e in (0..extinction.len()).filter(|e| extinction[*e] == 0.0) {
        let (i, j) = ((e % width) as isize, (e / width) as isize);
        let (mut sum, mut weight) = ([0.0; 3], 0.0);
        for (di, dj) in [(-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1)] {
            let (x, y) = (i + di, j + dj);
            if x < 0 || y < 0 || x >= width as isize || y >= height as isize {
                continue;
            }
            let n = y as usize * width + x as usize;
            weight += extinction[n];
            (0..3).for_each(|c| sum[c] += extinction[n] * before[n][c]);
        }
        if weight > 0.0 {
            albedo[e] = sum.map(|s| s / weight);
        }
    }
}
