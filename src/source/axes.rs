//! Which axis of a stored array is which: slowest first, spelled with x y z t c.

use crate::error::{Error, Result};

/// What one axis of a stored array runs over.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Role {
    Space(usize),
    Time,
    Component,
}

/// The place of each axis in a stored array's shape.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Axes {
    /// Array axis that runs along x, y and z.
    pub space: [usize; 3],
    /// Array axis that runs along time, if one does.
    pub time: Option<usize>,
    /// Array axis that runs over the components of a vector, if one does.
    pub component: Option<usize>,
}

impl Axes {
    /// Reads a spelling such as `tzyx`, `t z y x` or `x,y,z`, slowest axis first. The message of an error says what is
    /// wrong with it.
    pub fn parse(spelling: &str) -> Result<Axes, String> {
        let mut roles = Vec::new();
        for letter in spelling.chars().filter(|c| !c.is_whitespace() && !",;()[]".contains(*c)) {
            roles.push(match letter.to_ascii_lowercase() {
                'x' => Role::Space(0),
                'y' => Role::Space(1),
                'z' => Role::Space(2),
                't' => Role::Time,
                'c' => Role::Component,
                _ => return Err(format!("axes `{spelling}` has `{letter}`; the letters are x y z t c")),
            });
        }
        if let Some(twice) = roles.iter().enumerate().find_map(|(i, r)| roles[..i].contains(r).then_some(i)) {
            return Err(format!("axes `{spelling}` names its axis {} twice", twice + 1));
        }
        let place = |role| roles.iter().position(|&r| r == role);
        let space = [place(Role::Space(0)), place(Role::Space(1)), place(Role::Space(2))];
        let [Some(x), Some(y), Some(z)] = space else {
            return Err(format!("axes `{spelling}` lacks one of x, y, z; volumes need all three"));
        };
        Ok(Axes { space: [x, y, z], time: place(Role::Time), component: place(Role::Component) })
    }

    /// Number of axes.
    pub fn rank(&self) -> usize {
        3 + usize::from(self.time.is_some()) + usize::from(self.component.is_some())
    }

    /// The axes with time and component where given and the others as z, y, x.
    fn with(rank: usize, time: Option<usize>, component: Option<usize>) -> Axes {
        let rest: Vec<usize> = (0..rank).filter(|&a| Some(a) != time && Some(a) != component).collect();
        let time_last = time == Some(rank - 1) && component.is_none() && rank > 3;
        let space = if time_last { [rest[0], rest[1], rest[2]] } else { [rest[2], rest[1], rest[0]] };
        Axes { space, time, component }
    }

    /// Values along x, y, z of an array of `shape`.
    pub fn size(&self, shape: &[usize]) -> [usize; 3] {
        self.space.map(|a| shape[a])
    }

    /// The spelling, slowest first.
    pub fn spelled(&self) -> String {
        let mut letters = vec!['?'; self.rank()];
        for (axis, letter) in self.space.iter().zip(['x', 'y', 'z']) {
            letters[*axis] = letter;
        }
        if let Some(t) = self.time {
            letters[t] = 't';
        }
        if let Some(c) = self.component {
            letters[c] = 'c';
        }
        letters.into_iter().collect()
    }
}

/// What is known about a stored array before its axes are.
pub(crate) struct Evidence<'a> {
    /// Name to use in messages, `FILE:/dataset`.
    pub name: &'a str,
    /// Lengths of the axes.
    pub shape: &'a [usize],
    /// `--axes`.
    pub asked: Option<&'a str>,
    /// The file's own spelling.
    pub stated: Option<&'a str>,
    /// Axes that may grow.
    pub unlimited: &'a [usize],
    /// Lengths of 1-D arrays named like times.
    pub time_lengths: &'a [usize],
    /// Time already runs over files, groups or datasets.
    pub many: bool,
}

/// Places the axes of an array: what was asked for, else what the file states, else by rank: three axes are z, y, x;
/// of four, time is the unlimited one, else the one as long as a list of times, else the leading one. Arrays with
/// time last are taken as x, y, z, t. An axis of length 2 to 4, last or first, is taken for components only when the
/// rank leaves no other reading. Guesses are added to `warnings`; what decided comes with the axes.
pub(crate) fn place(e: &Evidence, warnings: &mut Vec<String>) -> Result<(Axes, &'static str)> {
    let rank = e.shape.len();
    let shape = super::shape_text(e.shape);
    let fail = |found: String| Err(Error::format(e.name, found, "--axes ORDER, slowest axis first, such as tzyx"));
    if let Some(asked) = e.asked {
        let axes = Axes::parse(asked)
            .map_err(|why| Error::format(e.name, why, "--axes tzyx (slowest axis first, of x y z t c)"))?;
        if axes.rank() != rank {
            return fail(format!("--axes {asked} names {} axes, but the array is {shape}, {rank} axes", axes.rank()));
        }
        return Ok((axes, "--axes"));
    }
    if let Some(stated) = e.stated {
        match Axes::parse(stated) {
            Ok(axes) if axes.rank() == rank => return Ok((axes, "told by the file")),
            Ok(_) => warnings.push(format!("{}: its axes attribute `{stated}` does not fit {shape}: ignored", e.name)),
            Err(why) => warnings.push(format!("{}: its axes attribute is ignored: {why}", e.name)),
        }
    }
    let small = |a: usize| (2..=4).contains(&e.shape[a]);
    let evident = match e.unlimited {
        [one] => Some(*one),
        _ => (0..rank).find(|&a| e.shape[a] > 1 && e.time_lengths.contains(&e.shape[a])),
    };
    let reason = match (rank, evident, e.unlimited) {
        (3, ..) => "z, y, x when nothing else is told",
        (_, Some(_), [_]) => "time is the axis that may grow",
        (_, Some(_), _) => "time is the axis as long as a list of times",
        _ => "by rank and length",
    };
    let axes = match rank {
        3 => match evident.filter(|_| !e.many) {
            None => Axes::with(3, None, None),
            Some(time) if e.unlimited.len() == 1 && !e.time_lengths.contains(&e.shape[time]) => {
                warnings.push(format!(
                    "{}: {shape} is taken for one volume, but its axis {} may grow: a series of maps has no volume",
                    e.name,
                    time + 1
                ));
                Axes::with(3, None, None)
            }
            Some(time) => {
                let found =
                    format!("{shape} looks like a series of maps: axis {} is as long as a list of times", time + 1);
                return Err(Error::format(e.name, found, "--axes zyx if it is a volume all the same"));
            }
        },
        4 => match evident {
            Some(time) => Axes::with(4, Some(time), None),
            _ if e.many && e.shape[0] == 1 => Axes::with(4, Some(0), None),
            _ if e.many && small(3) => Axes::with(4, None, Some(3)),
            _ if e.many && small(0) => Axes::with(4, None, Some(0)),
            _ => {
                if small(3) {
                    warnings.push(format!(
                        "{}: the leading axis of {shape} is taken for time; --axes zyxc if the last one holds components",
                        e.name
                    ));
                }
                Axes::with(4, Some(0), None)
            }
        },
        5 => {
            let time = evident.unwrap_or(0);
            let first = usize::from(time == 0);
            let last = if time == 4 { 3 } else { 4 };
            match (small(last), small(first)) {
                (true, _) => Axes::with(5, Some(time), Some(last)),
                (_, true) => Axes::with(5, Some(time), Some(first)),
                _ => return fail(format!("{shape}: none of its five axes looks like components")),
            }
        }
        2 => return fail(format!("{shape} is a plane, or a series of lines; volumes have three axes in space")),
        _ => {
            return fail(format!("{shape} has {rank} axes; 3 (a volume), 4 (and time) or 5 (and components) are read"));
        }
    };
    if axes.time == Some(rank - 1) {
        warnings.push(format!(
            "{}: time is the last axis of {shape}; the others are taken as x, y, z (--axes {} says so, --axes zyxt the \
             opposite)",
            e.name,
            axes.spelled()
        ));
    }
    Ok((axes, reason))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn evidence(shape: &[usize]) -> Evidence<'_> {
        Evidence { name: "a.h5:/q", shape, asked: None, stated: None, unlimited: &[], time_lengths: &[], many: false }
    }

    fn placed(e: &Evidence) -> String {
        place(e, &mut Vec::new()).unwrap().0.spelled()
    }

    #[test]
    fn time_is_the_unlimited_axis_then_the_one_as_long_as_the_times_then_the_leading_one() {
        let e = evidence(&[8, 9, 10, 11]);
        assert_eq!(placed(&e), "tzyx");
        assert_eq!(placed(&Evidence { time_lengths: &[9], ..evidence(e.shape) }), "ztyx");
        assert_eq!(placed(&Evidence { time_lengths: &[9], unlimited: &[3], ..evidence(e.shape) }), "xyzt");
        assert_eq!(placed(&Evidence { asked: Some("xtyz"), unlimited: &[3], ..evidence(e.shape) }), "xtyz");
        assert_eq!(placed(&Evidence { stated: Some("z y x t"), unlimited: &[0], ..evidence(e.shape) }), "zyxt");
    }

    #[test]
    fn a_short_axis_holds_components_only_when_rank_demands_it() {
        assert_eq!(placed(&evidence(&[20, 20, 3])), "zyx");
        let maps = Evidence { time_lengths: &[7], ..evidence(&[7, 20, 20]) };
        assert!(place(&maps, &mut Vec::new()).unwrap_err().to_string().contains("series of maps"));
        assert_eq!(placed(&Evidence { asked: Some("zyx"), ..maps }), "zyx");
        assert_eq!(placed(&evidence(&[20, 20, 20, 3])), "tzyx");
        assert_eq!(placed(&Evidence { many: true, ..evidence(&[20, 20, 20, 3]) }), "zyxc");
        assert_eq!(placed(&Evidence { many: true, ..evidence(&[3, 20, 20, 20]) }), "czyx");
        assert_eq!(placed(&evidence(&[7, 20, 20, 20, 3])), "tzyxc");
        assert_eq!(placed(&evidence(&[7, 2, 20, 20, 20])), "tczyx");
    }

    #[test]
    fn misspelt_axes_say_what_is_wrong() {
        assert!(Axes::parse("tzyq").unwrap_err().contains("`q`"));
        assert!(Axes::parse("tzzx").unwrap_err().contains("twice"));
        assert!(Axes::parse("tyx").unwrap_err().contains("lacks"));
        let wrong = place(&Evidence { asked: Some("zyx"), ..evidence(&[2, 3, 4, 5]) }, &mut Vec::new()).unwrap_err();
        assert!(wrong.to_string().contains("names 3 axes") && wrong.to_string().contains("2×3×4×5"), "{wrong}");
    }
}
