//! Reading a scene file: TOML and `key=value` overrides, with the line and the dotted key of whatever is wrong.

use std::collections::HashMap;
use std::path::Path;

use serde::de::DeserializeOwned;
use toml::de::{DeTable, DeValue};
use toml::{Table, Value};

use super::allowed::{KEYS, LISTS, allowed, keys_of, nearest, tables};
use super::{
    CameraKeys, ClipKeys, FieldKeys, InSituKeys, IsosurfaceKeys, LightKeys, MeshKeys, MovieKeys, NoiseKeys,
    PathtraceKeys, RenderKeys, Scene, SlicesKeys, SolverKeys, TransferKeys,
};
use crate::error::{Error, Result};

impl Scene {
    /// Reads a scene file, if any, applies `key=value` overrides in order, and validates the outcome.
    ///
    /// Overrides take dotted keys, with an index into `lights` and `cameras` (`cameras.0.azimuth=20`; an index one past the
    /// end adds an entry). Values are written as in TOML, where words need no quotes: `light.model=paper`,
    /// `render.overlay=[time, axes]`.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be read; [`Error::Scene`] for wrong syntax, unknown keys (naming the nearest known
    /// one) and values outside their range; [`Error::Unsupported`] for what this version does not do.
    pub fn load(path: Option<&Path>, sets: &[String]) -> Result<Scene> {
        match path {
            None => Scene::parse("", "scene", sets),
            Some(path) => {
                let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, e))?;
                let mut scene = Scene::parse(&text, &path.display().to_string(), sets)?;
                // Paths in a file start at its folder, those of overrides where the user stands.
                let lights = scene.lights.iter_mut().enumerate();
                let images = lights.map(|(i, light)| (format!("lights.{i}.image"), &mut light.image));
                for (key, image) in images.chain([
                    ("slices.spotlight".into(), &mut scene.slices.spotlight),
                    ("transfer.painting".into(), &mut scene.transfer.painting),
                ]) {
                    let overridden = sets.iter().any(|s| s.split('=').next().is_some_and(|k| k.trim() == key));
                    if let (Some(image), Some(folder), false) = (image, path.parent(), overridden) {
                        *image = folder.join(&*image);
                    }
                }
                Ok(scene)
            }
        }
    }

    /// [`Scene::load`] of text that is already in memory; `name` stands for the file in messages about its syntax.
    pub fn parse(text: &str, name: &str, sets: &[String]) -> Result<Scene> {
        let mut document = Document::parse(text, name)?;
        for set in sets {
            document.set(set)?;
        }
        let scene = document.scene()?;
        scene.validate().map_err(|e| document.locate(e))?;
        Ok(scene)
    }
}

/// A scene file's values, and where each came from.
struct Document {
    root: Table,
    /// Line of each dotted key in the file, counted from 1.
    lines: HashMap<String, usize>,
    /// Text of the keys that were overridden.
    overrides: HashMap<String, String>,
}

impl Document {
    fn parse(text: &str, name: &str) -> Result<Self> {
        let line = |offset: usize| 1 + text[..offset.min(text.len())].matches('\n').count();
        let syntax = |e: toml::de::Error| Error::Scene {
            line: e.span().map(|s| line(s.start)),
            key: name.into(),
            message: e.message().into(),
        };
        let mut lines = HashMap::new();
        record_table(DeTable::parse(text).map_err(syntax)?.get_ref(), "", &mut |key, at| {
            lines.insert(key, line(at));
        });
        Ok(Document { root: toml::from_str(text).map_err(syntax)?, lines, overrides: HashMap::new() })
    }

    /// Applies one `key=value`.
    fn set(&mut self, set: &str) -> Result<()> {
        let (key, text) = set.split_once('=').ok_or_else(|| {
            Error::scene(set, "an override is key=value, such as light.tolerance=1e-4 or lights.0.intensity=5")
        })?;
        let (key, text) = (key.trim(), text.trim());
        let parts: Vec<&str> = key.split('.').collect();
        match parts[..] {
            [list, index, name] if LISTS.contains(&list) => {
                let entries = self.root.entry(list).or_insert_with(|| Value::Array(vec![]));
                let entries =
                    entries.as_array_mut().ok_or_else(|| Error::scene(list, format!("write it as [[{list}]]")))?;
                let count = entries.len();
                let index = index.parse::<usize>().ok().filter(|i| *i <= count).ok_or_else(|| {
                    Error::scene(
                        key,
                        format!("`{index}` is no entry of {list}: allowed are 0 to {count} ({count} adds one)"),
                    )
                })?;
                if index == count {
                    entries.push(Value::Table(Table::new()));
                }
                let entry = entries[index].as_table_mut();
                let entry = entry.ok_or_else(|| Error::scene(list, format!("write it as [[{list}]]")))?;
                entry.insert(name.into(), override_value(text));
            }
            [list, ..] if LISTS.contains(&list) => {
                return Err(Error::scene(key, format!("name the entry too, such as {list}.0.{}", keys_of(list)[0])));
            }
            [table, name] => {
                let entry = self.root.entry(table).or_insert_with(|| Value::Table(Table::new()));
                let entry = entry.as_table_mut();
                let entry =
                    entry.ok_or_else(|| Error::scene(table, format!("it is a table: write it as [{table}]")))?;
                entry.insert(name.into(), override_value(text));
            }
            _ => {
                let known = nearest(key, KEYS.iter().map(|(name, _)| *name)).unwrap_or_default();
                return Err(Error::scene(key, format!("keys are table.name; the nearest known key is `{known}`")));
            }
        }
        self.overrides.insert(key.into(), text.into());
        Ok(())
    }

    /// The scene, or what is wrong with the first key that is.
    fn scene(&self) -> Result<Scene> {
        for (name, value) in &self.root {
            if !tables().contains(&name.as_str()) {
                return Err(self.error(name, unknown(name, "table", &tables(), self.elsewhere(name))));
            }
            let list = LISTS.contains(&name.as_str());
            if !(if list { value.is_array() } else { value.is_table() }) {
                let written = if list { format!("[[{name}]]") } else { format!("[{name}]") };
                return Err(self.error(name, format!("write it as {written}")));
            }
        }
        Ok(Scene {
            field: self.table::<FieldKeys>("field")?,
            noise: self.table::<NoiseKeys>("noise")?,
            transfer: self.table::<TransferKeys>("transfer")?,
            lights: self.list::<LightKeys>("lights")?,
            meshes: self.list::<MeshKeys>("meshes")?,
            light: self.table::<SolverKeys>("light")?,
            clip: self.list::<ClipKeys>("clip")?,
            cameras: self.list::<CameraKeys>("cameras")?,
            render: self.table::<RenderKeys>("render")?,
            pathtrace: self.table::<PathtraceKeys>("pathtrace")?,
            slices: self.table::<SlicesKeys>("slices")?,
            isosurface: self.table::<IsosurfaceKeys>("isosurface")?,
            movie: self.table::<MovieKeys>("movie")?,
            insitu: self.table::<InSituKeys>("insitu")?,
        })
    }

    fn table<T: DeserializeOwned>(&self, name: &str) -> Result<T> {
        let empty = Table::new();
        self.keys(name, name, self.root.get(name).and_then(Value::as_table).unwrap_or(&empty))
    }

    fn list<T: DeserializeOwned>(&self, name: &str) -> Result<Vec<T>> {
        let entries = self.root.get(name).and_then(Value::as_array).map(Vec::as_slice).unwrap_or_default();
        let entry = |(i, entry): (usize, &Value)| match entry.as_table() {
            Some(table) => self.keys(&format!("{name}.{i}"), name, table),
            None => Err(self.error(name, format!("write it as [[{name}]]"))),
        };
        entries.iter().enumerate().map(entry).collect()
    }

    /// Deserialises the table at `path`, key by key, so that an error knows its key.
    fn keys<T: DeserializeOwned>(&self, path: &str, table: &str, values: &Table) -> Result<T> {
        let mut accepted = Table::new();
        for (name, value) in values {
            let key = format!("{path}.{name}");
            let known = keys_of(table);
            if !known.contains(&name.as_str()) {
                return Err(self.error(&key, unknown(name, "key", &known, self.elsewhere(name))));
            }
            let takes = |value: &Value| T::deserialize(Table::from_iter([(name.clone(), value.clone())]));
            let word = self.overrides.get(&key).map(|text| Value::String(text.clone()));
            match (takes(value), word) {
                (Ok(_), _) => accepted.insert(name.clone(), value.clone()),
                // A name that happens to read as a number or a date.
                (Err(_), Some(word)) if takes(&word).is_ok() => accepted.insert(name.clone(), word),
                (Err(_), _) => {
                    return Err(self.error(&key, format!("{value} is not allowed; allowed: {}", allowed(&key))));
                }
            };
        }
        T::deserialize(accepted).map_err(|e| self.error(path, e.message().into()))
    }

    /// Where else a key exists, for people who put it in the wrong table.
    fn elsewhere(&self, name: &str) -> Option<&'static str> {
        KEYS.iter().map(|(key, _)| *key).find(|key| key.split_once('.').is_some_and(|(_, k)| k == name))
    }

    fn error(&self, key: &str, message: String) -> Error {
        self.locate(Error::Scene { line: None, key: key.into(), message })
    }

    /// Adds the line of the key, or of the nearest table around it; overrides have none.
    fn locate(&self, error: Error) -> Error {
        match error {
            Error::Scene { line: None, key, message } if self.overrides.contains_key(&key) => {
                Error::Scene { line: None, key, message: format!("{message} (as overridden)") }
            }
            Error::Scene { line: None, key, message } => {
                let mut at = key.as_str();
                while !self.lines.contains_key(at) && at.contains('.') {
                    at = at.rsplit_once('.').map_or("", |(parent, _)| parent);
                }
                Error::Scene { line: self.lines.get(at).copied(), key, message }
            }
            other => other,
        }
    }
}

fn unknown(name: &str, what: &str, known: &[&str], elsewhere: Option<&str>) -> String {
    let hint = match elsewhere {
        Some(key) => format!("did you mean `{key}`, in another table?"),
        None => format!("did you mean `{}`?", nearest(name, known.iter().copied()).unwrap_or_default()),
    };
    format!("unknown {what}; {hint} (known: {})", known.join(", "))
}

/// Calls `found` with each dotted key and its offset in the text.
fn record_table(table: &DeTable, path: &str, found: &mut impl FnMut(String, usize)) {
    for (key, value) in table {
        let path = if path.is_empty() { key.get_ref().to_string() } else { format!("{path}.{}", key.get_ref()) };
        found(path.clone(), key.span().start);
        match value.get_ref() {
            DeValue::Table(inner) => record_table(inner, &path, found),
            DeValue::Array(entries) => {
                for (i, entry) in entries.iter().enumerate() {
                    if let DeValue::Table(inner) = entry.get_ref() {
                        let path = format!("{path}.{i}");
                        found(path.clone(), entry.span().start);
                        record_table(inner, &path, found);
                    }
                }
            }
            _ => {}
        }
    }
}

/// The value of an override: TOML, where bare words stand for strings.
fn override_value(text: &str) -> Value {
    let parsed = |text: &str| toml::from_str::<Table>(&format!("v = {text}")).ok().and_then(|mut t| t.remove("v"));
    match parsed(text) {
        Some(Value::Datetime(_)) => Value::String(text.into()),
        Some(value) => value,
        None if text.starts_with('[') => parsed(&quote_words(text)).unwrap_or_else(|| Value::String(text.into())),
        None => Value::String(text.into()),
    }
}

/// Puts quotes around the words of a list.
fn quote_words(list: &str) -> String {
    let is_word = |c: char| !matches!(c, '[' | ']' | ',' | ' ' | '"' | '\'');
    let mut out = String::new();
    let mut rest = list;
    while let Some(first) = rest.chars().next() {
        let end = rest.find(|c| is_word(c) != is_word(first)).unwrap_or(rest.len());
        let (run, tail) = rest.split_at(end);
        let bare = is_word(first) && run.parse::<f64>().is_err() && !matches!(run, "true" | "false");
        if bare && !out.ends_with(['"', '\'']) {
            out.extend(["\"", run, "\""]);
        } else {
            out.push_str(run);
        }
        rest = tail;
    }
    out
}
