//! Coordinates along axes, and what of them is uniform.

/// Spacing and origin of values at these coordinates along x, y, z; uneven spacing becomes its mean and is told.
/// `None` when an axis has no use as coordinates.
pub(crate) fn uniform(along: [&[f64]; 3], warnings: &mut Vec<String>) -> Option<([f64; 3], [f64; 3])> {
    let (mut spacing, mut origin) = ([1.0; 3], [0.0; 3]);
    for (a, at) in along.into_iter().enumerate() {
        let (first, last) = (*at.first()?, *at.last()?);
        if !at.iter().all(|v| v.is_finite()) {
            return None;
        }
        origin[a] = first;
        if at.len() < 2 {
            continue;
        }
        let mean = (last - first) / (at.len() - 1) as f64;
        spacing[a] = mean;
        let apart = at.windows(2).map(|w| (w[1] - w[0] - mean).abs()).fold(0.0, f64::max);
        let axis = ["x", "y", "z"][a];
        // Coordinates in single precision are off by their rounding.
        let rounding = 4.0 * f64::from(f32::EPSILON) * first.abs().max(last.abs());
        if mean < 0.0 {
            warnings
                .push(format!("{axis} coordinates fall from {first} to {last}: the picture is mirrored along {axis}"));
            spacing[a] = -mean;
            origin[a] = last;
        }
        if apart > 1e-4 * mean.abs() + rounding {
            warnings.push(format!(
                "{axis} coordinates are uneven (spacing off by up to {:.1} %): the mean spacing {} is taken",
                100.0 * apart / mean.abs(),
                mean.abs()
            ));
        }
    }
    Some((spacing, origin))
}
