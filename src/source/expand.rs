//! From what was typed to files in step order: a file, several, a directory, a glob or a pattern.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};

/// One file of a series.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Entry {
    pub path: PathBuf,
    /// Step number in the name, where the name has one.
    pub number: Option<u64>,
    /// Decimal number in the name (`ez-000012.50.h5`): a time.
    pub decimal: Option<f64>,
}

/// The files of a series, in order.
#[derive(Debug)]
pub(crate) struct Files {
    pub entries: Vec<Entry>,
    /// Dataset named outright by `FILE:/dataset`.
    pub dataset: Option<String>,
}

/// Finds the files of a series and sorts them by the numbers in their names, not by text.
pub(crate) fn expand(series: &[String]) -> Result<Files> {
    let mut dataset = None;
    let mut paths: Vec<PathBuf> = Vec::new();
    // Numbers that stand where a pattern says that the step's number stands.
    let mut told: HashMap<PathBuf, u64> = HashMap::new();
    let mut chosen_by_name = false;
    for typed in series {
        let (path, named) = split_dataset(typed);
        if let Some(named) = named {
            if dataset.as_ref().is_some_and(|d| *d != named) {
                return Err(Error::format(path, "the files of a series name different datasets", "one FILE:/dataset"));
            }
            dataset = Some(named);
        }
        let whole = Path::new(path);
        if whole.is_dir() {
            paths.extend(directory(whole)?);
        } else if whole.exists() {
            paths.push(whole.to_owned());
            continue;
        } else if let Some(pattern) = Pattern::parse(path) {
            for (path, number) in pattern.matches()? {
                told.insert(path.clone(), number);
                paths.push(path);
            }
        } else if path.contains(['*', '?', '[']) {
            paths.extend(listed(path, path)?.into_iter().filter(|p| p.is_file()));
        } else {
            return Err(missing(whole));
        }
        if paths.is_empty() {
            return Err(Error::format(path, "no file matches", "quote the pattern, and look at the folder it names"));
        }
        chosen_by_name = true;
    }
    if paths.is_empty() {
        return Err(Error::format("", "no series was given", "gloaming info FILE, or a pattern run/plt_{step:05}.h5"));
    }
    paths.sort();
    paths.dedup();
    let mut entries = numbered(paths, chosen_by_name);
    if entries.iter().all(|e| told.contains_key(&e.path)) {
        entries.iter_mut().for_each(|e| e.number = told.get(&e.path).copied());
        entries.sort_by_key(|e| e.number);
    }
    Ok(Files { entries, dataset })
}

/// `FILE:/dataset` in two; the colon of `C:/` is part of the path.
fn split_dataset(typed: &str) -> (&str, Option<String>) {
    if Path::new(typed).exists() {
        return (typed, None);
    }
    match typed.rfind(":/") {
        Some(at) if at > 1 => (&typed[..at], Some(typed[at + 1..].to_owned())),
        _ => (typed, None),
    }
}

fn missing(path: &Path) -> Error {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let nearest = std::fs::read_dir(folder).ok().and_then(|all| {
        let names = all.flatten().map(|e| e.file_name().to_string_lossy().into_owned());
        names
            .map(|n| (strsim::jaro_winkler(&n, &name), n))
            .filter(|(likeness, _)| *likeness > 0.8)
            .max_by(|a, b| a.0.total_cmp(&b.0))
    });
    let remedy = match nearest {
        Some((_, near)) => folder.join(near).display().to_string(),
        None if !folder.is_dir() => format!("the folder {} does not exist either", folder.display()),
        None => String::from("a file, a folder, a glob, or a pattern such as run/plt_{step:05}.h5"),
    };
    Error::format(path, "no such file", remedy)
}

fn listed(glob_text: &str, typed: &str) -> Result<Vec<PathBuf>> {
    let found = glob::glob(glob_text).map_err(|e| Error::format(typed, format!("not a glob: {e}"), ""))?;
    found.map(|p| p.map_err(|e| Error::io(e.path().to_owned(), std::io::Error::from(e.error().kind())))).collect()
}

/// A path with a place for the step number: `{step}`, `{step:05}`, `%d`, `%05d`, `%T`, `%06T`.
struct Pattern {
    typed: String,
    /// Literal text around the places; one more than there are places.
    literals: Vec<String>,
}

impl Pattern {
    fn parse(typed: &str) -> Option<Pattern> {
        let mut literals = vec![String::new()];
        let mut rest = typed;
        while !rest.is_empty() {
            if let Some(length) = place_length(rest) {
                literals.push(String::new());
                rest = &rest[length..];
            } else {
                let letter = rest.chars().next()?;
                literals.last_mut()?.push(letter);
                rest = &rest[letter.len_utf8()..];
            }
        }
        (literals.len() > 1).then(|| Pattern { typed: typed.to_owned(), literals })
    }

    /// The files that fit, with the number in each.
    fn matches(&self) -> Result<Vec<(PathBuf, u64)>> {
        let escaped: Vec<String> = self.literals.iter().map(|l| glob::Pattern::escape(l)).collect();
        let all = listed(&escaped.join("*"), &self.typed)?;
        let numbered = |p: PathBuf| Some((p.is_file(), self.number(&p.to_string_lossy())?, p));
        Ok(all.into_iter().filter_map(numbered).filter(|(is, ..)| *is).map(|(_, number, p)| (p, number)).collect())
    }

    /// The number in every place of the pattern, where `path` is the pattern with one number.
    fn number(&self, path: &str) -> Option<u64> {
        let typed = self.literals[0].strip_prefix("./").unwrap_or(&self.literals[0]);
        let mut rest = path.strip_prefix("./").unwrap_or(path).strip_prefix(typed)?;
        let mut number: Option<u64> = None;
        for literal in &self.literals[1..] {
            let digits = rest.bytes().take_while(u8::is_ascii_digit).count();
            let value = rest[..digits].parse().ok()?;
            if number.replace(value).is_some_and(|n| n != value) {
                return None;
            }
            rest = rest[digits..].strip_prefix(literal.as_str())?;
        }
        number.filter(|_| rest.is_empty())
    }
}

/// Length of a place for the step number at the start of `text`.
fn place_length(text: &str) -> Option<usize> {
    if let Some(inner) = text.strip_prefix("{step") {
        let close = inner.find('}')?;
        let width = &inner[..close];
        let fits = width.is_empty() || width.strip_prefix(':').is_some_and(|w| w.bytes().all(|b| b.is_ascii_digit()));
        return fits.then_some("{step".len() + close + 1);
    }
    let inner = text.strip_prefix('%')?;
    let digits = inner.bytes().take_while(u8::is_ascii_digit).count();
    matches!(inner[digits..].chars().next(), Some('d' | 'i' | 'T')).then_some(digits + 2)
}

/// Files that only accompany another and are not a series of their own.
const NOT_DATA: [&str; 16] =
    ["md", "txt", "log", "py", "toml", "json", "csv", "tsv", "png", "mp4", "exr", "sh", "par", "yml", "yaml", "tmp"];

/// What the names of a series go through, on one path that need not exist.
pub(crate) fn probe(typed: &str, path: &str) {
    let (typed, _) = split_dataset(typed);
    if let Some(pattern) = Pattern::parse(typed) {
        pattern.number(path);
    }
    numbered(vec![PathBuf::from(typed), PathBuf::from(path)], true);
}

/// The one family of numbered files in a folder.
fn directory(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut families: Vec<(String, Vec<PathBuf>)> = Vec::new();
    let mut inner: Vec<PathBuf> = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|e| Error::io(folder, e))? {
        let path = entry.map_err(|e| Error::io(folder, e))?.path();
        // Enzo keeps each output in a folder of the output's name.
        let own = path.file_name().map(|name| path.join(name).with_extension("hierarchy"));
        inner.extend(own.filter(|own| own.is_file()));
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        if !path.is_file() || name.starts_with('.') || NOT_DATA.contains(&extension.as_str()) {
            continue;
        }
        let family = Name::of(&path).text.join("*");
        match families.iter_mut().find(|(f, _)| *f == family) {
            Some((_, members)) => members.push(path),
            None => families.push((family, vec![path])),
        }
    }
    // Headers speak for the files that they name.
    let headers = |family: &str| [".nhdr", ".mhd", ".hierarchy"].iter().any(|e| family.ends_with(e));
    if families.iter().any(|(f, _)| headers(f)) {
        families.retain(|(f, _)| headers(f));
    }
    families.sort();
    match families.len() {
        _ if !inner.is_empty() => Ok(inner),
        1 => Ok(families.swap_remove(0).1),
        0 => Err(Error::format(folder, "no data files in this folder", "the folder of the series, or its files")),
        n => {
            let names: Vec<String> = families.iter().take(8).map(|(f, m)| format!("{f} ({} files)", m.len())).collect();
            let found = format!("{n} families of files in this folder: {}", names.join(", "));
            Err(Error::format(folder, found, format!("one of them as a glob: '{}'", families[0].0)))
        }
    }
}

/// A path's text and the numbers between it, the extension left alone.
struct Name {
    text: Vec<String>,
    numbers: Vec<u64>,
}

impl Name {
    fn of(path: &Path) -> Name {
        let whole = path.to_string_lossy();
        let named = path.extension().unwrap_or_default().to_string_lossy();
        // ".50" of "ez-12.50" is an extension to the path, not to the reader; "a.h5/" has one that is not at its end.
        let is_number = named.bytes().all(|b| b.is_ascii_digit());
        let stem = whole.strip_suffix(&*named).filter(|stem| stem.ends_with('.') && !is_number);
        let (stem, extension) = whole.split_at(stem.map_or(whole.len(), |stem| stem.len() - 1));
        let (mut text, mut numbers, mut rest) = (vec![String::new()], Vec::new(), stem);
        while let Some(letter) = rest.chars().next() {
            let digits = rest.bytes().take_while(u8::is_ascii_digit).count();
            match rest[..digits].parse() {
                Ok(number) if digits > 0 => {
                    numbers.push(number);
                    text.push(String::new());
                    rest = &rest[digits..];
                }
                _ => {
                    let length = digits.max(letter.len_utf8());
                    text.last_mut().expect("never empty").push_str(&rest[..length]);
                    rest = &rest[length..];
                }
            }
        }
        text.last_mut().expect("never empty").push_str(extension);
        Name { text, numbers }
    }
}

/// Sorts by the numbers in the names and takes the step number from the last one that varies.
fn numbered(paths: Vec<PathBuf>, chosen_by_name: bool) -> Vec<Entry> {
    let mut all: Vec<(Name, PathBuf)> = paths.into_iter().map(|p| (Name::of(&p), p)).collect();
    all.sort_by(|(a, _), (b, _)| a.numbers.cmp(&b.numbers).then_with(|| a.text.cmp(&b.text)));
    let same_text = all.windows(2).all(|w| w[0].0.text == w[1].0.text);
    if !same_text {
        all.sort_by(|(a, _), (b, _)| a.text.cmp(&b.text).then_with(|| a.numbers.cmp(&b.numbers)));
    }
    let count = if same_text { all[0].0.numbers.len() } else { 0 };
    let varies = |i: usize| all.windows(2).any(|w| w[0].0.numbers[i] != w[1].0.numbers[i]);
    let varying = match all.len() {
        1 => (chosen_by_name && count > 0).then(|| count - 1),
        _ => (0..count).rev().find(|&i| varies(i)),
    };
    let mut entries: Vec<Entry> = all
        .iter()
        .map(|(name, path)| Entry {
            path: path.clone(),
            number: varying.map(|i| name.numbers[i]),
            decimal: decimal_of(path),
        })
        .collect();
    if entries.iter().all(|e| e.decimal.is_some()) {
        entries.sort_by(|a, b| a.decimal.partial_cmp(&b.decimal).unwrap_or(std::cmp::Ordering::Equal));
        entries.iter_mut().for_each(|e| e.number = None);
    } else {
        entries.iter_mut().for_each(|e| e.decimal = None);
    }
    entries
}

/// The decimal number at the end of a file's stem, `12.5` for `ez-000012.50.h5`.
fn decimal_of(path: &Path) -> Option<f64> {
    let stem = path.file_stem()?.to_string_lossy().into_owned();
    let number = stem.rsplit(|c: char| !c.is_ascii_digit() && c != '.').next()?;
    (number.contains('.')).then(|| number.parse().ok()).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn touch(names: &[&str]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for name in names {
            let path = folder.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, b"x").unwrap();
        }
        folder
    }

    fn found(folder: &tempfile::TempDir, typed: &str) -> Vec<(String, Option<u64>)> {
        let typed = format!("{}/{typed}", folder.path().display());
        let files = expand(&[typed]).unwrap();
        let name = |e: &Entry| e.path.strip_prefix(folder.path()).unwrap().display().to_string();
        files.entries.iter().map(|e| (name(e), e.number)).collect()
    }

    #[test]
    fn numbers_sort_as_numbers() {
        let folder = touch(&["a64_9.h5", "a64_10.h5", "a64_100.h5", "notes.txt"]);
        let all = [("a64_9.h5", Some(9)), ("a64_10.h5", Some(10)), ("a64_100.h5", Some(100))];
        let all = all.map(|(n, s)| (n.to_owned(), s));
        for typed in ["", "a64_*.h5", "a64_{step}.h5", "a64_%d.h5", "*.h5"] {
            assert_eq!(found(&folder, typed), all, "{typed}");
        }
    }

    #[test]
    fn a_pattern_matches_only_numbers_and_the_same_one_everywhere() {
        let folder = touch(&["r1/o1.h5", "r2/o2.h5", "r2/o3.h5", "r2/ox.h5"]);
        let all = [("r1/o1.h5".to_owned(), Some(1)), ("r2/o2.h5".to_owned(), Some(2))];
        assert_eq!(found(&folder, "r{step:01}/o{step:01}.h5"), all);
        assert!(expand(&[format!("{}/q{{step}}.h5", folder.path().display())]).is_err());
        // The number is the one in the place, whatever else varies or stands in the name.
        let folder = touch(&["s10_v2.h5", "s9_v3.h5"]);
        assert_eq!(found(&folder, "s{step}_v3.h5"), [("s9_v3.h5".to_owned(), Some(9))]);
    }

    #[test]
    fn decimals_are_times_and_datasets_split_off() {
        let folder = touch(&["ez-000002.50.h5", "ez-000010.00.h5", "ez-000002.00.h5"]);
        let files = expand(&[format!("{}/ez-*.h5:/ez", folder.path().display())]).unwrap();
        assert_eq!(files.dataset.as_deref(), Some("/ez"));
        assert_eq!(files.entries.iter().map(|e| e.decimal.unwrap()).collect::<Vec<_>>(), [2.0, 2.5, 10.0]);
        assert_eq!(decimal_of(Path::new("läufe/ε½2.5.h5")), Some(2.5));
        assert_eq!(Name::of(Path::new("läufe/ε.½ü7/")).numbers, [7]);
    }

    #[test]
    fn a_folder_of_several_families_lists_them() {
        let folder = touch(&["a_1.h5", "a_2.h5", "b_1.h5"]);
        let text = expand(&[folder.path().display().to_string()]).unwrap_err().to_string();
        assert!(text.contains("a_*.h5 (2 files)") && text.contains("b_*.h5 (1 files)"), "{text}");
    }

    #[test]
    fn a_missing_file_suggests_its_neighbour() {
        let folder = touch(&["smoke.h5"]);
        let text = expand(&[format!("{}/smok.h5", folder.path().display())]).unwrap_err().to_string();
        assert!(text.contains("no such file") && text.contains("smoke.h5"), "{text}");
    }
}
