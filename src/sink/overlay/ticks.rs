//! Where the ticks of a scale go, and how numbers are written on it.

/// A scale: labelled values, and what all labels have in common.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Ticks {
    /// Values and their labels, ascending.
    pub labels: Vec<(f64, String)>,
    /// Labels are to be multiplied by ten to this power; 0 when they are values themselves.
    pub exponent: i32,
    /// Labels count from this value, when values alone would differ only in their last digits.
    pub offset: Option<String>,
}

impl Ticks {
    /// At most `most` + 1 round values between two bounds, in either order. One label when the bounds are equal; none
    /// when they are not finite.
    pub fn new([a, b]: [f64; 2], most: usize) -> Self {
        let (lo, hi) = (a.min(b), a.max(b));
        if !(a.is_finite() && b.is_finite()) {
            return Ticks { labels: vec![], exponent: 0, offset: None };
        }
        let largest = lo.abs().max(hi.abs());
        let step = round_step((hi - lo) / most.max(1) as f64);
        let indices = (lo / step - 1e-6).ceil() as i64..=(hi / step + 1e-6).floor() as i64;
        // Bounds so close that f64 hardly tells them apart count as one.
        if hi - lo <= 1e-12 * largest || indices.is_empty() {
            return Ticks { labels: vec![(lo, significant(lo, 6))], exponent: 0, offset: None };
        }
        let origin = if largest / step >= 1e6 { *indices.start() } else { 0 };
        let from_origin = if origin == 0 { largest } else { hi - lo };
        let exponent = match decade(from_origin) {
            e if (-3..5).contains(&e) => 0,
            e => e.div_euclid(3) * 3,
        };
        let decimals = decimals(step / 10f64.powi(exponent));
        let labels = indices.map(|i| {
            let label = (i - origin) as f64 * step / 10f64.powi(exponent);
            (i as f64 * step, format!("{label:.decimals$}"))
        });
        let offset = (origin != 0).then(|| {
            let decimals = self::decimals(step);
            format!("{:+.decimals$}", origin as f64 * step)
        });
        Ticks { labels: labels.collect(), exponent, offset }
    }
}

/// The smallest of 1, 2, 2.5, 5 times a power of ten that is not below `step`.
fn round_step(step: f64) -> f64 {
    let unit = 10f64.powi(decade(step));
    [1.0, 2.0, 2.5, 5.0, 10.0].map(|m| m * unit).into_iter().find(|&s| s >= step * (1.0 - 1e-9)).unwrap_or(0.0)
}

/// The exponent of the leading digit.
fn decade(v: f64) -> i32 {
    if v == 0.0 { 0 } else { (v.abs().log10() + 1e-12).floor() as i32 }
}

/// Decimals that write `step` out in full.
fn decimals(step: f64) -> usize {
    (0..12)
        .find(|&d| {
            let scaled = step * 10f64.powi(d);
            scaled >= 0.5 && (scaled - scaled.round()).abs() < 1e-6 * scaled
        })
        .unwrap_or(12) as usize
}

/// A number with so many significant digits, trailing zeros kept so that it does not jump about in a movie.
pub(super) fn significant(v: f64, digits: i32) -> String {
    if v == 0.0 || !v.is_finite() {
        return v.to_string();
    }
    let decade = decade(v);
    if (-3..digits.max(6)).contains(&decade) {
        format!("{v:.*}", (digits - 1 - decade).max(0) as usize)
    } else {
        format!("{v:.*e}", (digits - 1) as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(range: [f64; 2]) -> (Vec<String>, i32, Option<String>) {
        let ticks = Ticks::new(range, 5);
        for (value, _) in &ticks.labels {
            assert!(*value >= range[0].min(range[1]) - 1e-9 && *value <= range[0].max(range[1]) * (1.0 + 1e-9) + 1e-9);
        }
        (ticks.labels.into_iter().map(|(_, l)| l).collect(), ticks.exponent, ticks.offset)
    }

    #[test]
    fn scales_read_well() {
        assert_eq!(labels([0.0, 1.0]), (["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"].map(String::from).into(), 0, None));
        let small_contrast = ["9.850", "9.852", "9.854", "9.856", "9.858", "9.860"];
        assert_eq!(labels([9.85, 9.86]), (small_contrast.map(String::from).into(), 0, None));
        assert_eq!(
            labels([0.0, 1e-6]),
            (["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"].map(String::from).into(), -6, None)
        );
        assert_eq!(labels([-2.1e-3, 9.2e-3]).0, ["0.0000", "0.0025", "0.0050", "0.0075"]);
        assert_eq!(labels([0.0, 3.2e7]), (["0", "10", "20", "30"].map(String::from).into(), 6, None));
        assert_eq!(labels([-1.0, 1.0]).0, ["-1.0", "-0.5", "0.0", "0.5", "1.0"]);
        assert_eq!(labels([1.0, -1.0]).0, ["-1.0", "-0.5", "0.0", "0.5", "1.0"]);
        let pressure = ["0.000", "0.002", "0.004", "0.006", "0.008", "0.010"];
        assert_eq!(labels([101325.0, 101325.01]), (pressure.map(String::from).into(), 0, Some("+101325.000".into())));
    }

    #[test]
    fn odd_ranges_have_a_label_or_none() {
        assert_eq!(labels([3.5, 3.5]).0, ["3.50000"]);
        assert_eq!(labels([0.0, 0.0]).0, ["0"]);
        assert_eq!(labels([1.0, 1.0 + 1e-16]).0, ["1.00000"]);
        assert_eq!(Ticks::new([f64::NAN, 1.0], 5).labels, vec![]);
        assert_eq!(Ticks::new([0.0, f64::INFINITY], 5).labels, vec![]);
    }

    #[test]
    fn numbers_keep_their_width() {
        assert_eq!(
            [3.25, 12.5, 150.0, 123456.0, 1.25e-6, 0.0].map(|v| significant(v, 5)),
            ["3.2500", "12.500", "150.00", "123456", "1.2500e-6", "0"]
        );
    }
}
