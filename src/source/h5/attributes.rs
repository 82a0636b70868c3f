//! Attributes of any numeric or string type, looked up on a dataset, then outwards on the groups round it.

use hdf5::types::{FixedAscii, FixedUnicode, TypeDescriptor, VarLenAscii, VarLenUnicode};
use hdf5::{Container, File, Location};

/// Longest fixed-length string that is read.
const LONGEST: usize = 1024;

/// The numbers in a dataset or attribute; `None` when it holds something else.
pub(crate) fn numbers_in(container: &Container) -> Option<Vec<f64>> {
    // A list of numbers that describes a grid or times is short; whatever is longer is data.
    (container.size() <= 1 << 24).then(|| container.read_raw::<f64>().ok()).flatten()
}

/// The numbers in an attribute.
pub(crate) fn numbers(at: &Location, name: &str) -> Option<Vec<f64>> {
    numbers_in(&*at.attr(name).ok()?)
}

/// The only number in an attribute.
pub(crate) fn number(at: &Location, name: &str) -> Option<f64> {
    match numbers(at, name)?.as_slice() {
        [one] => Some(*one),
        _ => None,
    }
}

/// The strings in an attribute, padding taken off.
pub(crate) fn texts(at: &Location, name: &str) -> Option<Vec<String>> {
    let attribute = at.attr(name).ok()?;
    let all = |texts: Vec<&str>| texts.into_iter().map(|t| t.trim_end_matches(['\0', ' ']).to_owned()).collect();
    match attribute.dtype().ok()?.to_descriptor().ok()? {
        TypeDescriptor::FixedAscii(_) => {
            let read = attribute.read_raw::<FixedAscii<LONGEST>>().ok()?;
            Some(all(read.iter().map(|s| s.as_str()).collect()))
        }
        TypeDescriptor::FixedUnicode(_) => {
            let read = attribute.read_raw::<FixedUnicode<LONGEST>>().ok()?;
            Some(all(read.iter().map(|s| s.as_str()).collect()))
        }
        TypeDescriptor::VarLenAscii => {
            let read = attribute.read_raw::<VarLenAscii>().ok()?;
            Some(all(read.iter().map(|s| s.as_str()).collect()))
        }
        TypeDescriptor::VarLenUnicode => {
            let read = attribute.read_raw::<VarLenUnicode>().ok()?;
            Some(all(read.iter().map(|s| s.as_str()).collect()))
        }
        _ => None,
    }
}

/// The strings in an attribute, joined by spaces.
pub(crate) fn text(at: &Location, name: &str) -> Option<String> {
    texts(at, name).map(|t| t.join(" "))
}

/// A dataset, then the groups round it from the inside out, the root last.
pub(crate) fn outwards(file: &File, dataset: &str) -> Vec<Location> {
    let mut places = Vec::new();
    if let Ok(inner) = file.dataset(dataset) {
        places.push((**inner).clone());
    }
    let mut path = dataset.trim_end_matches('/');
    while let Some((group, _)) = path.rsplit_once('/') {
        if group.is_empty() {
            break;
        }
        if let Ok(group) = file.group(group) {
            places.push((*group).clone());
        }
        path = group;
    }
    if let Ok(root) = file.group("/") {
        places.push((*root).clone());
    }
    places
}

/// The first attribute of `names` with `count` numbers, innermost place first.
pub(crate) fn first(places: &[Location], names: &[&str], count: usize) -> Option<Vec<f64>> {
    let fits = |v: &Vec<f64>| v.len() == count;
    places.iter().find_map(|p| names.iter().find_map(|n| numbers(p, n).filter(fits)))
}

/// The first attribute of `names` that is a string, innermost place first.
pub(crate) fn first_text(places: &[Location], names: &[&str]) -> Option<String> {
    places.iter().find_map(|p| names.iter().find_map(|n| text(p, n)))
}
