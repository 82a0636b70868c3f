//! What is in a file: datasets that could be volumes, and which of them are one field at many steps.

use hdf5::datatype::ByteOrder;
use hdf5::types::TypeDescriptor;
use hdf5::{Dataset, File, Group, LocationType};

/// A dataset, or datasets of the same name under numbered groups, or numbered datasets.
#[derive(Debug, Clone)]
pub(crate) struct Found {
    /// Name to show and to ask for.
    pub name: String,
    /// Path of each step's dataset, with its number where it has one.
    pub members: Vec<(Option<u64>, String)>,
    /// Shape of the first member.
    pub shape: Vec<usize>,
    /// Element type, such as `f32le`; empty when it is not a number.
    pub dtype: String,
    /// Axes that may grow.
    pub unlimited: Vec<usize>,
}

/// Everything in a file that matters here.
#[derive(Debug, Default)]
pub(crate) struct Tree {
    /// Numeric datasets of three axes or more.
    pub volumes: Vec<Found>,
    /// The others, as `name shape type`, for messages.
    pub others: Vec<String>,
    /// Links that lead nowhere.
    pub dangling: Vec<String>,
    /// Datasets that this HDF5 does not open.
    pub unreadable: Vec<String>,
}

/// Groups inside groups are followed so far: deeper is a cycle of links.
const DEPTH: usize = 8;
/// Objects looked at.
const MOST: usize = 20_000;

/// Walks a file.
pub(crate) fn walk(file: &File) -> Tree {
    let mut tree = Tree::default();
    if let Ok(root) = file.group("/") {
        let mut budget = MOST;
        visit(&root, "", None, &mut tree, DEPTH, &mut budget);
    }
    gather_numbered(&mut tree.volumes);
    tree
}

/// Groups that stand for steps: the path before the number's group, and each number with its group's name.
type Steps<'a> = Option<(&'a str, &'a [(u64, String)])>;

fn visit(group: &Group, path: &str, steps: Steps, tree: &mut Tree, depth: usize, budget: &mut usize) {
    let mut names = group.member_names().unwrap_or_default();
    names.sort();
    let mut groups = Vec::new();
    for name in names {
        if *budget == 0 {
            return;
        }
        *budget -= 1;
        let full = format!("{path}/{name}");
        match group.loc_type_by_name(&name) {
            Ok(LocationType::Dataset) => match group.dataset(&name) {
                Ok(dataset) => note(&dataset, full, steps, tree),
                Err(_) => tree.unreadable.push(full),
            },
            Ok(LocationType::Group) => groups.push(name),
            Ok(_) => {}
            Err(_) => tree.dangling.push(full),
        }
    }
    if depth == 0 {
        return;
    }
    let (numbered, plain) = if steps.is_none() { split_steps(groups) } else { (Vec::new(), groups) };
    for name in plain {
        if let Ok(inner) = group.group(&name) {
            visit(&inner, &format!("{path}/{name}"), steps, tree, depth - 1, budget);
        }
    }
    if let Some((_, first)) = numbered.first()
        && let Ok(inner) = group.group(first)
    {
        visit(&inner, &format!("{path}/{first}"), Some((path, &numbered)), tree, depth - 1, budget);
    }
}

/// Groups named as steps, in order, and the others: `step_12`, `Timestep12`, `iter-12`, `t12`, or nothing but digits
/// in every one of at least two groups.
fn split_steps(groups: Vec<String>) -> (Vec<(u64, String)>, Vec<String>) {
    let digits_only = groups.len() > 1 && groups.iter().all(|g| g.bytes().all(|b| b.is_ascii_digit()));
    let number = |name: &str| -> Option<u64> {
        let stem = name.trim_end_matches(|c: char| c.is_ascii_digit());
        let word = stem.strip_suffix(['_', '-']).unwrap_or(stem).to_ascii_lowercase();
        let known = ["step", "timestep", "time_step", "iter", "iteration", "t"].contains(&word.as_str());
        (known || (digits_only && stem.is_empty())).then(|| name[stem.len()..].parse().ok()).flatten()
    };
    let (mut numbered, mut plain) = (Vec::new(), Vec::new());
    for name in groups {
        match number(&name) {
            Some(n) => numbered.push((n, name)),
            None => plain.push(name),
        }
    }
    numbered.sort();
    (numbered, plain)
}

fn note(dataset: &Dataset, path: String, steps: Steps, tree: &mut Tree) {
    let shape = dataset.shape();
    let dtype = type_name(dataset);
    if shape.len() < 3 || dtype.is_empty() {
        let kind = if dtype.is_empty() { "not a number" } else { &dtype };
        tree.others.push(format!("{path} {} {kind}", super::super::shape_text(&shape)));
        return;
    }
    let maxima = dataset.space().map(|s| s.maxdims()).unwrap_or_default();
    let unlimited = maxima.iter().enumerate().filter(|(_, m)| m.is_none()).map(|(a, _)| a).collect();
    let (name, members) = match steps {
        None => (path[1..].to_owned(), vec![(None, path)]),
        Some((before, numbered)) => {
            let rest = &path[before.len() + 1..];
            let inner = rest.split_once('/').map_or("", |(_, inner)| inner);
            let at = |(n, group): &(u64, String)| (Some(*n), format!("{before}/{group}/{inner}"));
            (inner.to_owned(), numbered.iter().map(at).collect())
        }
    };
    tree.volumes.push(Found { name, members, shape, dtype, unlimited });
}

/// Datasets `density_0001`, `density_0002`, … of the same shape and type become one field.
fn gather_numbered(volumes: &mut Vec<Found>) {
    let split = |f: &Found| -> Option<(String, u64)> {
        let stem = f.name.trim_end_matches(|c: char| c.is_ascii_digit());
        let number = f.name[stem.len()..].parse().ok()?;
        (f.members[0].0.is_none() && !stem.is_empty() && !stem.ends_with('/')).then(|| (stem.to_owned(), number))
    };
    let mut gathered: Vec<Found> = Vec::new();
    for found in volumes.iter() {
        let Some((stem, number)) = split(found) else {
            gathered.push(found.clone());
            continue;
        };
        let same = |other: &&Found| {
            other.shape == found.shape && other.dtype == found.dtype && split(other).is_some_and(|(s, _)| s == stem)
        };
        if volumes.iter().filter(same).count() == 1 {
            gathered.push(found.clone());
            continue;
        }
        let (name, member) = (stem.trim_end_matches(['_', '-']), (Some(number), found.members[0].1.clone()));
        match gathered.iter_mut().find(|g| g.name == name && g.shape == found.shape && g.dtype == found.dtype) {
            Some(family) => family.members.push(member),
            None => gathered.push(Found { name: name.to_owned(), members: vec![member], ..found.clone() }),
        }
    }
    gathered.iter_mut().for_each(|f| f.members.sort());
    *volumes = gathered;
}

/// `f32le`, `u8`, `i16be`, …; empty when the elements are not numbers.
pub(crate) fn type_name(dataset: &Dataset) -> String {
    let Ok(dtype) = dataset.dtype() else { return String::new() };
    let bits = 8 * dtype.size();
    let kind = match dtype.to_descriptor() {
        Ok(TypeDescriptor::Integer(_)) => 'i',
        Ok(TypeDescriptor::Unsigned(_)) => 'u',
        Ok(TypeDescriptor::Float(_)) => 'f',
        // Sizes of float that Rust has no type for convert all the same.
        Err(_) if dtype.conv_to::<f64>().is_some() => 'f',
        _ => return String::new(),
    };
    let order = match dtype.byte_order() {
        _ if bits == 8 => "",
        ByteOrder::BigEndian => "be",
        _ => "le",
    };
    format!("{kind}{bits}{order}")
}
