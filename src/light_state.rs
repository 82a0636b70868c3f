//! Light kept in a file, so that a later run starts from it: an HDF5 file with one dataset of f32 for each volume and an attribute
//! `about` that says, as JSON, what they are and which settings they belong to. It appears under its name only when it is whole.

use std::path::Path;

use hdf5::types::VarLenUnicode;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::scene::{LightKeys, Model, Scene, SolverKeys};
use crate::whole::{reserve, temporary_beside};

/// Format of the file; others are not read.
const VERSION: u32 = 1;

/// Bytes of an HDF5 file that are not values.
const SLACK: usize = 1 << 16;

/// Light as plain values.
#[derive(Debug, Clone, PartialEq)]
pub struct LightState {
    /// What it belongs to.
    pub about: About,
    /// What is known of the volumes, as the solver wants it back.
    pub solver: serde_json::Value,
    /// Volumes by name.
    pub volumes: Vec<(String, Vec<f32>)>,
}

/// What a [`LightState`] belongs to, and where its run was.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct About {
    /// The data's grid.
    pub grid: Grid,
    /// `[light]`.
    pub light: SolverKeys,
    /// `[[lights]]`.
    pub lights: Vec<LightKeys>,
    /// `transfer.anisotropy`.
    pub anisotropy: f32,
    /// Steps that the run had done.
    pub steps: u64,
    /// Number of the last of them.
    #[serde(default)]
    pub last: Option<u64>,
    /// Range of the values so far, where the range of the transfer function grows with the steps.
    pub seen: Option<[f64; 2]>,
}

impl About {
    /// Why light of these settings cannot be the start for `scene` on `grid`; `None` when it can. The tolerance, a budget and the
    /// transfer function may differ: what was solved is held against them.
    pub fn differs(&self, scene: &Scene, grid: &Grid) -> Option<String> {
        if self.grid != *grid {
            let said = |g: &Grid| format!("{:?} with spacing {:?} and origin {:?}", g.size, g.spacing, g.origin);
            return Some(format!("it is of a grid of {}, the data's is {}", said(&self.grid), said(grid)));
        }
        let keys = |keys: &SolverKeys| SolverKeys {
            tolerance: 0.0,
            passes: None,
            budget_ms: None,
            warm: true,
            ..keys.clone()
        };
        if keys(&self.light) != keys(&scene.light) {
            return Some("it was solved with other settings under [light]".into());
        }
        if self.lights != scene.lights {
            return Some("it was solved for other [[lights]]".into());
        }
        (self.anisotropy != scene.transfer.anisotropy)
            .then(|| format!("it was solved for transfer.anisotropy = {}", self.anisotropy))
    }
}

/// What is in the attribute.
#[derive(Serialize, Deserialize)]
struct Text {
    version: u32,
    about: About,
    solver: serde_json::Value,
    volumes: Vec<String>,
}

impl LightState {
    /// What a run of `scene` that keeps its light at `path` starts from: what an earlier one left there, if any.
    ///
    /// # Errors
    /// [`Error::Unsupported`] for the paper's model; those of [`LightState::read`].
    pub(crate) fn left_at(path: Option<&Path>, scene: &Scene) -> Result<Option<Self>> {
        if path.is_some() && scene.light.model == Model::Paper {
            return Err(Error::Unsupported(
                "keeping the light of light.model = \"paper\" in a file: \"physical\" can".into(),
            ));
        }
        path.filter(|p| p.exists()).map(Self::read).transpose()
    }

    /// The volume of a name, once.
    pub fn take(&mut self, name: &str) -> Option<Vec<f32>> {
        let at = self.volumes.iter().position(|(n, _)| n == name)?;
        Some(self.volumes.swap_remove(at).1)
    }

    /// Writes the file.
    pub fn write(&self, path: &Path) -> Result<()> {
        let temporary = temporary_beside(path)?;
        let bytes: usize = self.volumes.iter().map(|(_, v)| 4 * v.len()).sum();
        let write = || -> hdf5::Result<Option<Error>> {
            let file = hdf5::File::create(&temporary)?;
            // A full disk is found here rather than half-way.
            if let Err(e) = reserve(&temporary, file.size(), (bytes + SLACK) as u64) {
                return Ok(Some(e));
            }
            let volumes = self.volumes.iter().map(|(name, _)| name.clone()).collect();
            let text = Text { version: VERSION, about: self.about.clone(), solver: self.solver.clone(), volumes };
            let text = serde_json::to_string(&text).map_err(|e| hdf5::Error::from(e.to_string()))?;
            let text: VarLenUnicode = text.parse().map_err(|e| hdf5::Error::from(format!("{e}")))?;
            file.new_attr::<VarLenUnicode>().create("about")?.write_scalar(&text)?;
            for (name, values) in &self.volumes {
                file.new_dataset_builder().with_data(&values[..]).create(&name[..])?;
            }
            file.flush()?;
            file.close()?;
            Ok(None)
        };
        // On the disk before it has its name, so that not even a machine that stops leaves half of it.
        let sync = || std::fs::File::open(&temporary).and_then(|f| f.sync_all()).map_err(|e| Error::io(path, e));
        let failed = |e: hdf5::Error| Error::format(path, format!("the light cannot be written: {e}"), "");
        if let Some(e) = write().map_err(failed)? {
            return Err(e);
        }
        sync()?;
        temporary.persist(path).map_err(|e| Error::io(path, e.error))
    }

    /// Reads a file that [`LightState::write`] wrote.
    ///
    /// # Errors
    /// [`Error::Format`] for any other file.
    pub fn read(path: &Path) -> Result<Self> {
        std::fs::metadata(path).map_err(|e| Error::io(path, e))?;
        let wrong = |found: String| Error::format(path, found, "another --light-state FILE, or remove this one");
        let read = || -> hdf5::Result<(String, hdf5::File)> {
            let file = hdf5::File::open(path)?;
            Ok((file.attr("about")?.read_scalar::<VarLenUnicode>()?.to_string(), file))
        };
        let (text, file) = read().map_err(|e| wrong(format!("not light that gloaming kept: {e}")))?;
        let version = serde_json::from_str::<serde_json::Value>(&text).ok().and_then(|v| v.get("version")?.as_u64());
        if version != Some(VERSION.into()) {
            return Err(wrong(format!("light kept by another version of gloaming: this one reads format {VERSION}")));
        }
        let text: Text = serde_json::from_str(&text).map_err(|e| wrong(format!("damaged: {e}")))?;
        let volume = |name: &String| Ok((name.clone(), file.dataset(name)?.read_raw::<f32>()?));
        let volumes: hdf5::Result<_> = text.volumes.iter().map(volume).collect();
        let volumes = volumes.map_err(|e| wrong(format!("damaged: {e}")))?;
        Ok(LightState { about: text.about, solver: text.solver, volumes })
    }
}
