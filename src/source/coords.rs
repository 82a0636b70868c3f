//! Coordinates along axes: what of them is uniform, and what has to be resampled.

use std::sync::Arc;

use super::GridInfo;
use super::stretch::{Line, Stretch};

/// Where the values along one axis sit.
#[derive(Debug, Clone, Default)]
pub(crate) struct Along {
    /// Position of each value.
    pub centres: Vec<f64>,
    /// Position of each face between cells and of the outermost two, where the file tells them.
    pub faces: Option<Vec<f64>>,
}

impl Along {
    /// Values at these positions.
    pub fn points(centres: &[f64]) -> Along {
        Along { centres: centres.to_vec(), faces: None }
    }

    /// Values in the middle of the cells between these faces.
    pub fn cells(faces: &[f64]) -> Along {
        let centres = faces.windows(2).map(|w| 0.5 * (w[0] + w[1])).collect();
        Along { centres, faces: Some(faces.to_vec()) }
    }
}

/// Sets spacing and origin of `grid` from coordinates along x, y, z. Axes that are uneven get their mean spacing and are
/// resampled when a step is taken in; axes that fall are turned round. Both are told. Returns whether the coordinates are of
/// any use: finite, and rising or falling throughout.
pub(crate) fn place(grid: &mut GridInfo, along: [Along; 3], warnings: &mut Vec<String>) -> bool {
    let (mut spacing, mut origin, mut lines) = ([1.0; 3], [0.0; 3], [None, None, None]);
    for (a, along) in along.into_iter().enumerate() {
        let axis = ["x", "y", "z"][a];
        let at = along.centres.clone();
        let (Some(&first), Some(&last)) = (at.first(), at.last()) else { return false };
        if !at.iter().chain(along.faces.iter().flatten()).all(|v| v.is_finite()) {
            return false;
        }
        origin[a] = first;
        if at.len() < 2 {
            continue;
        }
        let mean = (last - first) / (at.len() - 1) as f64;
        if !at.windows(2).all(|w| (w[1] - w[0]) * mean > 0.0) {
            warnings
                .push(format!("{axis} coordinates go back and forth: they are ignored; --spacing DX,DY,DZ sets them"));
            return false;
        }
        spacing[a] = mean.abs();
        let apart = at.windows(2).map(|w| (w[1] - w[0] - mean).abs()).fold(0.0, f64::max);
        // Coordinates in single precision are off by their rounding.
        let rounding = 4.0 * f64::from(f32::EPSILON) * first.abs().max(last.abs());
        let even = apart <= 1e-4 * mean.abs() + rounding;
        if mean < 0.0 {
            warnings.push(format!("{axis} coordinates fall from {first} to {last}: {axis} is turned round"));
        }
        if !even || mean < 0.0 {
            lines[a] = Line::new(along, even);
        }
        if let Some(line) = lines[a].as_ref().filter(|_| !even) {
            let steps = || at.windows(2).map(|w| (w[1] - w[0]).abs());
            let (least, most) = (steps().fold(f64::INFINITY, f64::min), steps().fold(0.0, f64::max));
            warnings.push(format!(
                "{axis} coordinates are uneven ({} to {} apart): {} values are resampled to {} even ones, averages over each \
                 cell of the linear interpolant",
                short(least),
                short(most),
                at.len(),
                line.count()
            ));
        }
    }
    (grid.spacing, grid.origin) = (spacing, origin);
    grid.stretch = lines.iter().any(Option::is_some).then(|| Arc::new(Stretch { lines }));
    true
}

/// Four significant digits.
fn short(v: f64) -> String {
    let rounded = format!("{v:.3e}").parse::<f64>().unwrap_or(v);
    rounded.to_string()
}
