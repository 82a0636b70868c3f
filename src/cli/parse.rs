//! Values of options: sizes in bytes and pixels, ranges of steps, triples.

use std::str::FromStr;
use std::time::Duration;

/// Bytes, as `512MiB`, `2G` or a plain number; K, M, G, T are powers of 1024, KB, MB, GB, TB of 1000.
pub fn bytes(text: &str) -> Result<u64, String> {
    let wrong = || format!("`{text}` is no size: write bytes, or 512MiB, 2G, 1.5GiB");
    let digits = text.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    let factor: f64 = match unit.trim().to_lowercase().as_str() {
        "" | "b" => 1.0,
        "k" | "kib" => 1024.0,
        "m" | "mib" => 1024f64.powi(2),
        "g" | "gib" => 1024f64.powi(3),
        "t" | "tib" => 1024f64.powi(4),
        "kb" => 1e3,
        "mb" => 1e6,
        "gb" => 1e9,
        "tb" => 1e12,
        _ => return Err(wrong()),
    };
    let value = number.parse::<f64>().map_err(|_| wrong())? * factor;
    if value >= 1.0 && value < u64::MAX as f64 { Ok(value as u64) } else { Err(wrong()) }
}

/// A time, as `90`, `90s`, `10min`, `2h` or `500ms`.
pub fn duration(text: &str) -> Result<Duration, String> {
    let wrong = || format!("`{text}` is no time: write seconds, or 500ms, 90s, 10min, 2h");
    let digits = text.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    let factor = match unit.trim() {
        "ms" => 1e-3,
        "" | "s" => 1.0,
        "m" | "min" => 60.0,
        "h" => 3600.0,
        _ => return Err(wrong()),
    };
    let seconds = number.parse::<f64>().map_err(|_| wrong())? * factor;
    Duration::try_from_secs_f64(seconds).ok().filter(|d| !d.is_zero()).ok_or_else(wrong)
}

/// Width and height in pixels, as `1280x720`.
pub fn pixels(text: &str) -> Result<[usize; 2], String> {
    let wrong = || format!("`{text}` is no picture size: write WIDTHxHEIGHT, such as 1280x720");
    let (w, h) = text.split_once(['x', 'X', '×']).ok_or_else(wrong)?;
    Ok([w.parse().map_err(|_| wrong())?, h.parse().map_err(|_| wrong())?])
}

/// Three numbers, as `1,2.5,-3`.
pub fn triple<T: FromStr>(text: &str) -> Result<[T; 3], String> {
    let parts: Result<Vec<T>, _> = text.split(',').map(|part| part.trim().parse()).collect();
    let wrong = || format!("`{text}` is not three numbers: write X,Y,Z without spaces");
    parts.ok().and_then(|p| p.try_into().ok()).ok_or_else(wrong)
}

/// Three finite numbers above 0.
pub fn lengths(text: &str) -> Result<[f64; 3], String> {
    let lengths: [f64; 3] = triple(text)?;
    if lengths.iter().all(|l| *l > 0.0 && l.is_finite()) { Ok(lengths) } else { Err("lengths are above 0".into()) }
}

/// Three finite numbers.
pub fn place(text: &str) -> Result<[f64; 3], String> {
    let place: [f64; 3] = triple(text)?;
    if place.iter().all(|c| c.is_finite()) { Ok(place) } else { Err("coordinates are finite".into()) }
}

/// A selection of steps by number, as `A..B`, `A..B:S`, `A..` or `..B`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Steps {
    first: u64,
    end: Option<u64>,
    stride: usize,
}

impl Steps {
    /// The step number before which the selection ends, where it does.
    pub fn end(self) -> Option<u64> {
        self.end
    }

    /// Indices of the selected steps among all step numbers: those in `A ≤ step < B`, and of them every S-th.
    pub fn select(self, numbers: impl Iterator<Item = u64>) -> Vec<usize> {
        let within = |step: u64| step >= self.first && self.end.is_none_or(|end| step < end);
        numbers.enumerate().filter(|(_, step)| within(*step)).map(|(i, _)| i).step_by(self.stride).collect()
    }
}

impl FromStr for Steps {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            format!("`{text}` is no range of steps: write A..B or A..B:S for A <= step < B; both ends may be left out")
        };
        let (range, stride) = text.split_once(':').map_or((text, Ok(1)), |(range, s)| (range, s.parse()));
        let (first, end) = range.split_once("..").ok_or_else(wrong)?;
        let number = |text: &str| text.trim().parse::<u64>().map_err(|_| wrong());
        let steps = Steps {
            first: if first.is_empty() { 0 } else { number(first)? },
            end: if end.is_empty() { None } else { Some(number(end)?) },
            stride: stride.map_err(|_| wrong())?,
        };
        match steps {
            Steps { stride: 0, .. } => Err(format!("`{text}`: every 0th step is none; S is 1 or more")),
            Steps { first, end: Some(end), .. } if first >= end => {
                Err(format!("`{text}` is empty: it takes {first} <= step < {end}"))
            }
            steps => Ok(steps),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_in_bytes() {
        let sizes =
            [("4096", 4096), ("512MiB", 512 << 20), ("2G", 2 << 30), ("1.5 GiB", 3 << 29), ("10MB", 10_000_000)];
        sizes.iter().for_each(|(text, size)| assert_eq!(bytes(text), Ok(*size), "{text}"));
        ["", "G", "-1", "0", "12 parsecs", "1e3", "99999999999T"]
            .iter()
            .for_each(|t| assert!(bytes(t).is_err(), "{t}"));
    }

    #[test]
    fn steps_are_half_open_by_number_and_strided_by_position() {
        let select = |text: &str, numbers: &[u64]| text.parse::<Steps>().unwrap().select(numbers.iter().copied());
        assert_eq!(select("2..5", &[0, 1, 2, 3, 4, 5]), [2, 3, 4]);
        assert_eq!(select("1..6:2", &[0, 1, 2, 3, 4, 5]), [1, 3, 5]);
        assert_eq!(select("100..", &[0, 50, 100, 150]), [2, 3]);
        assert_eq!(select("..100:2", &[0, 50, 99, 150]), [0, 2]);
        assert_eq!(select("7..9", &[0, 1]), [0; 0]);
        for wrong in ["", "3", "5..2", "3..3", "a..b", "0..4:0", "0..4:x", "-1..3", "1...3"] {
            assert!(wrong.parse::<Steps>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn triples_and_picture_sizes() {
        assert_eq!(triple::<usize>("1,2,3"), Ok([1, 2, 3]));
        assert_eq!(place("-1,0.5,1e3"), Ok([-1.0, 0.5, 1000.0]));
        assert_eq!(pixels("640x480"), Ok([640, 480]));
        assert!(triple::<usize>("1,2").is_err() && triple::<usize>("1,2,3,4").is_err() && place("nan,0,0").is_err());
        assert!(lengths("1,1,0").is_err() && pixels("640").is_err() && pixels("-1x2").is_err());
    }
}
