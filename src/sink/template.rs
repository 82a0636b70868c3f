//! Names of output files with places for the step and the camera.

use std::path::{Path, PathBuf};

use crate::error::{Error, Result};

/// An output path with `{step}`, `{step:06}` (or `%d`, `%06d`) and `{camera}` in it. Names carry the simulation's own
/// step number, never a private counter.
#[derive(Debug, Clone, PartialEq)]
pub struct Template {
    text: String,
    parts: Vec<Part>,
}

#[derive(Debug, Clone, PartialEq)]
enum Part {
    Text(String),
    Step { width: usize },
    Camera,
}

impl Template {
    /// Reads a path. Unknown places are errors that list the known ones.
    pub fn parse(text: &str) -> Result<Self> {
        let mut parts = Vec::new();
        let mut rest = text;
        while let Some(at) = rest.find(['{', '%']) {
            let (before, after) = rest.split_at(at);
            let place = place(after).ok_or_else(|| {
                let wrong =
                    if after.starts_with('{') { after.find('}').map_or(after, |e| &after[..=e]) } else { after };
                Error::format(text, format!("`{wrong}` is no place in a name"), "{step}, {step:06}, %06d or {camera}")
            })?;
            if !before.is_empty() {
                parts.push(Part::Text(before.into()));
            }
            parts.push(place.0);
            rest = &after[place.1..];
        }
        if !rest.is_empty() {
            parts.push(Part::Text(rest.into()));
        }
        Ok(Template { text: text.into(), parts })
    }

    /// The path as it was given.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// The path as it was given, with `place` before the extension: what to type instead.
    pub fn with(&self, place: &str) -> String {
        let dot = self.text.rfind('.').unwrap_or(self.text.len());
        format!("{}{place}{}", &self.text[..dot], &self.text[dot..])
    }

    /// True when names differ from step to step.
    pub fn has_step(&self) -> bool {
        self.parts.iter().any(|p| matches!(p, Part::Step { .. }))
    }

    /// True when names differ from camera to camera.
    pub fn has_camera(&self) -> bool {
        self.parts.contains(&Part::Camera)
    }

    /// The path of a step and a camera. Separators in the camera's name become `_`.
    pub fn path(&self, step: u64, camera: &str) -> PathBuf {
        let mut path = String::new();
        for part in &self.parts {
            match part {
                Part::Text(t) => path.push_str(t),
                Part::Step { width } => path.push_str(&format!("{step:0width$}")),
                Part::Camera => path.push_str(&camera.replace(['/', '\\'], "_")),
            }
        }
        path.into()
    }

    /// The deepest folder that is the same for all steps and cameras.
    pub fn folder(&self) -> PathBuf {
        let fixed = match self.parts.first() {
            Some(Part::Text(t)) if self.parts.len() > 1 => t.rfind('/').map_or("", |at| &t[..=at]).into(),
            Some(Part::Text(t)) => Path::new(t).parent().unwrap_or(Path::new("")).to_path_buf(),
            _ => PathBuf::new(),
        };
        if fixed.as_os_str().is_empty() { ".".into() } else { fixed }
    }

    /// The path without the step and the separators before it: where what spans all steps goes.
    /// `light_{step:06}.raw` → `light.raw`; `series` where nothing else is left of the name.
    pub fn without_step(&self) -> PathBuf {
        let mut path = String::new();
        for part in &self.parts {
            match part {
                Part::Text(t) => path.push_str(t),
                Part::Step { .. } => path.truncate(path.trim_end_matches(['_', '-', '.']).len()),
                Part::Camera => path.push_str("{camera}"),
            }
        }
        let path = PathBuf::from(path);
        // `{step}.raw` leaves `.raw`, a name without an extension.
        match (path.extension(), path.file_name()) {
            (None, Some(name)) if name.to_string_lossy().starts_with('.') => {
                path.with_file_name(format!("series{}", name.to_string_lossy()))
            }
            _ => path,
        }
    }
}

/// The place that `text` starts with, and its length.
fn place(text: &str) -> Option<(Part, usize)> {
    let zero_padded = |digits: &str| match digits {
        "" => Some(0),
        _ => digits.strip_prefix('0')?.parse().ok().filter(|w| (1..=20).contains(w)),
    };
    if let Some(inner) = text.strip_prefix('{') {
        let inner = &inner[..inner.find('}')?];
        let part = match inner {
            "camera" => Part::Camera,
            "step" => Part::Step { width: 0 },
            _ => Part::Step { width: zero_padded(inner.strip_prefix("step:")?.trim_end_matches('d'))? },
        };
        return Some((part, inner.len() + 2));
    }
    let digits = &text[1..text.find('d')?];
    Some((Part::Step { width: zero_padded(digits)? }, digits.len() + 2))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn name(template: &str, step: u64) -> String {
        Template::parse(template).unwrap().path(step, "left/eye").to_string_lossy().into_owned()
    }

    #[test]
    fn steps_and_cameras_go_into_names() {
        assert_eq!(name("out/frame_{step:06}.png", 120), "out/frame_000120.png");
        assert_eq!(name("frame_%04d.png", 7), "frame_0007.png");
        assert_eq!(name("%d.png", 123456), "123456.png");
        assert_eq!(name("{camera}/{step}.exr", 3), "left_eye/3.exr");
        assert_eq!(name("f{step:02}.png", 12345), "f12345.png");
        for wrong in ["a{stp}.png", "a%x.png", "a{step:6}.png", "a{step.png", "100%.png"] {
            let message = Template::parse(wrong).unwrap_err().to_string();
            assert!(message.contains("{step:06}") && message.contains(wrong), "{message}");
        }
    }

    #[test]
    fn folders_and_series_names() {
        let folder = |t: &str| Template::parse(t).unwrap().folder().to_string_lossy().into_owned();
        assert_eq!(folder("a/b/frame_{step}.png"), "a/b/");
        assert_eq!(folder("a/{camera}/frame_{step}.png"), "a/");
        assert_eq!(folder("{step}.png"), ".");
        assert_eq!(folder("movie.mp4"), ".");
        assert_eq!(folder("/tmp/movie.mp4"), "/tmp");
        let series = |t: &str| Template::parse(t).unwrap().without_step().to_string_lossy().into_owned();
        assert_eq!(series("o/light_{step:06}.raw"), "o/light.raw");
        assert_eq!(series("o/{step}.raw"), "o/series.raw");
        assert_eq!(series("o/{step}_light.raw"), "o/_light.raw");
    }
}
