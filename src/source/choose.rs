//! Which field, and which part of a vector, is meant.

use std::path::Path;

use super::{Candidate, shape_text};
use crate::error::{Error, Result};

/// Whether `asked` names the field `name`: the whole path, or its last parts.
pub(crate) fn matches(name: &str, asked: &str) -> bool {
    let (name, asked) = (name.trim_start_matches('/'), asked.trim_start_matches('/'));
    name == asked || name.strip_suffix(asked).is_some_and(|before| before.ends_with('/'))
}

/// Index of the field asked for, else of the only one. An error lists all that there are.
pub(crate) fn choose(path: &Path, candidates: &[Candidate], asked: Option<&str>) -> Result<usize> {
    let list = |indices: &[usize]| -> String {
        let line = |&i: &usize| {
            let c = &candidates[i];
            format!("{} ({} {}, {})", c.name, shape_text(&c.shape), c.dtype, c.kind)
        };
        let more = if indices.len() > 24 { format!(" and {} more", indices.len() - 24) } else { String::new() };
        format!("{}{more}", indices.iter().take(24).map(line).collect::<Vec<_>>().join(", "))
    };
    let all: Vec<usize> = (0..candidates.len()).collect();
    let Some(asked) = asked else {
        return match candidates.len() {
            0 => Err(Error::format(path, "no fields in this file", "a file with at least one volume")),
            1 => Ok(0),
            n => {
                let found = format!("{n} fields could be meant: {}", list(&all));
                Err(Error::format(path, found, format!("--field {}", candidates[0].name)))
            }
        };
    };
    let exactly = |c: &Candidate| c.name.trim_start_matches('/') == asked.trim_start_matches('/');
    if let Some(index) = candidates.iter().position(exactly) {
        return Ok(index);
    }
    let some: Vec<usize> = all.iter().copied().filter(|&i| matches(&candidates[i].name, asked)).collect();
    match some.as_slice() {
        [one] => Ok(*one),
        [] => {
            let likeness = |c: &Candidate| strsim::jaro_winkler(c.name.rsplit('/').next().unwrap_or(""), asked);
            let nearest = candidates.iter().max_by(|a, b| likeness(a).total_cmp(&likeness(b)));
            let remedy = nearest.map_or(String::new(), |c| format!("--field {}", c.name));
            Err(Error::format(path, format!("no field `{asked}`; there are {}", list(&all)), remedy))
        }
        several => {
            let found = format!("`{asked}` could be any of {}", list(several));
            Err(Error::format(path, found, format!("--field {}", candidates[several[0]].name)))
        }
    }
}

/// Which components to read of a vector of `count`: one, or all of them for the magnitude. A scalar has `[None]`.
pub(crate) fn component(name: &str, count: Option<usize>, asked: Option<&str>) -> Result<Vec<Option<usize>>> {
    let Some(count) = count else { return Ok(vec![None]) };
    // No vector has as many; a damaged header may claim any number.
    const MOST: usize = 4096;
    if count > MOST {
        let found = format!("{count} components, of which no more than {MOST} are read");
        return Err(Error::format(name, found, "--axes, if its axes were taken for others"));
    }
    let index = match asked.unwrap_or("magnitude") {
        "magnitude" => return Ok((0..count).map(Some).collect()),
        "x" => Some(0),
        "y" => Some(1),
        "z" => Some(2),
        other => other.parse().ok(),
    };
    match index {
        Some(i) if i < count => Ok(vec![Some(i)]),
        _ => {
            let found = format!("no component `{}`; there are {count}", asked.unwrap_or_default());
            Err(Error::format(name, found, "field.component = \"x\" | \"y\" | \"z\" | an index | \"magnitude\""))
        }
    }
}
