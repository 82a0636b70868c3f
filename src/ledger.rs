//! The ledger: one row a step of what was done, what it cost and what was lost.
//!
//! Columns are the fields of [`LedgerRow`], in that order. A CSV has a header line and an empty cell where a value is not
//! known; a JSON file is an array of objects with `null` there and where a number is not finite.

use std::collections::HashSet;
use std::fs::File;
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::light::SolveReport;
use crate::whole::write_whole;

/// What one step cost. Times are in milliseconds.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct LedgerRow {
    /// The simulation's step number.
    pub step: u64,
    /// Physical time, where known.
    pub time: Option<f64>,
    /// Bytes of field data taken in.
    pub bytes: u64,
    /// Time the solver was held by the push (in situ).
    pub held_ms: f64,
    /// Steps waiting when this one arrived.
    pub queue_depth: u64,
    /// Steps dropped so far.
    pub drops: u64,
    /// `cold` or `warm`; `none` where nobody wanted the light.
    pub start: String,
    /// Iterations of scattered light (0 when it was not solved).
    pub iterations: u64,
    /// Sweeps over the light grid, all lights and directions, in whole-grid units.
    pub sweeps: f64,
    /// Light-voxel updates, residual, comparison and change-detection passes included.
    pub voxel_updates: u64,
    /// Bricks of direct light that were swept, all lights.
    pub bricks_active: u64,
    /// Bricks of direct light in all, all lights.
    pub bricks_total: u64,
    /// Bound on the error of the light against a cold solve, relative to the brightest light.
    pub certified_error: f64,
    /// Tiles of 16² pixels that kept the pixels of the step before, all cameras.
    pub tiles_reused: u64,
    /// Tiles in all, all cameras.
    pub tiles_total: u64,
    /// Cells that were not finite or filled; transparent.
    pub holes: u64,
    /// Reading.
    pub read_ms: f64,
    /// Classification.
    pub classify_ms: f64,
    /// Light.
    pub light_ms: f64,
    /// Rendering, all cameras.
    pub render_ms: f64,
    /// Writing, all sinks.
    pub write_ms: f64,
    /// Frames rendered, one per camera; 0 where the light had not changed enough to (in situ, on request), or the step was lost.
    pub frames: u64,
    /// Why the step was lost; empty when it was not.
    pub lost: String,
}

impl LedgerRow {
    /// What a solve says of a step; `None` when its light was not solved, as nobody wanted it.
    pub(crate) fn lit(solved: Option<&SolveReport>) -> Self {
        let Some(solved) = solved else { return LedgerRow { start: "none".into(), ..LedgerRow::default() } };
        LedgerRow {
            start: if solved.warm { "warm" } else { "cold" }.into(),
            iterations: solved.iterations,
            sweeps: solved.sweeps,
            voxel_updates: solved.voxel_updates,
            bricks_active: solved.bricks_active,
            bricks_total: solved.bricks_total,
            certified_error: solved.certified_error,
            ..LedgerRow::default()
        }
    }
}

/// A ledger file that grows by one row a step and is whole after each: an interrupted run leaves the rows of the steps
/// that it finished.
#[derive(Debug)]
pub struct Ledger {
    path: PathBuf,
    format: Format,
    /// Steps that have a row: the rows themselves would fill the memory of a long run.
    steps: HashSet<u64>,
    file: File,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Format {
    Csv,
    Json,
}

impl Format {
    fn of(path: &Path) -> Result<Self> {
        match path.extension().unwrap_or_default().to_string_lossy().to_lowercase().as_str() {
            "csv" => Ok(Format::Csv),
            "json" => Ok(Format::Json),
            other => {
                Err(Error::format(path, format!("unknown ledger format `.{other}`"), "--ledger ledger.csv or .json"))
            }
        }
    }

    /// What opens the file before the first row.
    fn start(self) -> &'static str {
        match self {
            Format::Csv => "",
            Format::Json => "[",
        }
    }

    /// What closes the file after the last row.
    fn end(self) -> &'static str {
        match self {
            Format::Csv => "",
            Format::Json => "\n]\n",
        }
    }

    /// The text of row number `index`, with what comes before it.
    fn row(self, index: usize, row: &LedgerRow) -> Result<Vec<u8>, String> {
        match self {
            Format::Csv => {
                let mut writer = csv::WriterBuilder::new().has_headers(index == 0).from_writer(vec![]);
                writer.serialize(row).map_err(|e| e.to_string())?;
                writer.into_inner().map_err(|e| e.to_string())
            }
            Format::Json => {
                let mut text = if index == 0 { b"\n".to_vec() } else { b",\n".to_vec() };
                serde_json::to_writer(&mut text, row).map_err(|e| e.to_string())?;
                Ok(text)
            }
        }
    }
}

impl Ledger {
    /// Starts a ledger at `path` (`.csv` or `.json`), instead of what is there.
    pub fn create(path: impl Into<PathBuf>) -> Result<Self> {
        Ledger::with_rows(path.into(), vec![])
    }

    /// Continues the ledger at `path`, or starts one where there is none.
    pub fn resume(path: impl Into<PathBuf>) -> Result<Self> {
        let path = path.into();
        let rows = if path.exists() { read(&path)? } else { vec![] };
        Ledger::with_rows(path, rows)
    }

    fn with_rows(path: PathBuf, rows: Vec<LedgerRow>) -> Result<Self> {
        let format = Format::of(&path)?;
        let file = rewrite(&path, format, &rows)?;
        Ok(Ledger { path, format, steps: rows.iter().map(|r| r.step).collect(), file })
    }

    /// Adds a row; a row of the same step that is there already is replaced.
    pub fn push(&mut self, row: LedgerRow) -> Result<()> {
        if self.steps.contains(&row.step) {
            let mut rows = read(&self.path)?;
            match rows.iter_mut().rfind(|r| r.step == row.step) {
                Some(same) => *same = row,
                None => rows.push(row),
            }
            self.file = rewrite(&self.path, self.format, &rows)?;
            return Ok(());
        }
        let index = self.steps.len();
        let mut text = self.format.row(index, &row).map_err(|e| Error::format(&self.path, e, ""))?;
        text.extend(self.format.end().as_bytes());
        let length = self.file.seek(SeekFrom::End(0)).map_err(|e| Error::io(&self.path, e))?;
        let at = length - self.format.end().len() as u64;
        if let Err(e) = self.put(at, &text) {
            // Give the file back as it was: a full disk must not leave half a row.
            let _ = self.file.set_len(at);
            let _ = self.put(at, self.format.end().as_bytes());
            return Err(Error::io(&self.path, e));
        }
        self.steps.insert(row.step);
        Ok(())
    }

    fn put(&mut self, at: u64, text: &[u8]) -> std::io::Result<()> {
        self.file.seek(SeekFrom::Start(at))?;
        self.file.write_all(text)
    }
}

/// Writes the whole ledger under a temporary name, renames it and opens it for more rows.
fn rewrite(path: &Path, format: Format, rows: &[LedgerRow]) -> Result<File> {
    write_whole(path, |file| {
        file.write_all(format.start().as_bytes()).map_err(|e| Error::io(path, e))?;
        for (index, row) in rows.iter().enumerate() {
            let text = format.row(index, row).map_err(|e| Error::format(path, e, ""))?;
            file.write_all(&text).map_err(|e| Error::io(path, e))?;
        }
        file.write_all(format.end().as_bytes()).map_err(|e| Error::io(path, e))
    })?;
    File::options().write(true).open(path).map_err(|e| Error::io(path, e))
}

/// Reads the rows of a ledger file.
pub fn read(path: &Path) -> Result<Vec<LedgerRow>> {
    let wrong =
        |e: String| Error::format(path, format!("not a ledger: {e}"), "another --ledger file, or remove this one");
    let text = std::fs::read(path).map_err(|e| Error::io(path, e))?;
    match Format::of(path)? {
        Format::Csv => {
            let mut reader = csv::Reader::from_reader(&text[..]);
            let columns = reader.headers().map_err(|e| wrong(e.to_string()))?;
            if !columns.is_empty() && !columns.iter().any(|c| c == "step") {
                return Err(wrong("no column `step`".into()));
            }
            reader.deserialize().map(|row| row.map_err(|e| wrong(e.to_string()))).collect()
        }
        Format::Json => {
            let rows: Vec<serde_json::Map<_, _>> = serde_json::from_slice(&text).map_err(|e| wrong(e.to_string()))?;
            rows.into_iter().map(|row| json_row(row).map_err(|e| wrong(e.to_string()))).collect()
        }
    }
}

/// JSON has no number for an error without a bound: `null` stands for it.
fn json_row(mut row: serde_json::Map<String, serde_json::Value>) -> serde_json::Result<LedgerRow> {
    let unbounded = row.get("certified_error").is_some_and(serde_json::Value::is_null);
    row.retain(|_, value| !value.is_null());
    let row: LedgerRow = serde_json::from_value(row.into())?;
    Ok(LedgerRow { certified_error: if unbounded { f64::INFINITY } else { row.certified_error }, ..row })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(step: u64, time: Option<f64>) -> LedgerRow {
        LedgerRow { step, time, start: "warm".into(), iterations: 7, certified_error: 1.25e-4, ..Default::default() }
    }

    #[test]
    fn every_row_is_on_disk_as_soon_as_it_is_pushed() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["deep/ledger.csv", "ledger.json"] {
            let path = folder.path().join(name);
            let mut ledger = Ledger::create(&path).unwrap();
            assert_eq!(read(&path).unwrap(), vec![]);
            let mut lost = row(30, None);
            lost.lost = "run_30.h5: truncated, \"really\"".into();
            lost.certified_error = f64::INFINITY;
            let rows = [row(10, Some(0.1)), row(20, Some(1.0 / 3.0)), lost];
            for (n, row) in rows.iter().enumerate() {
                ledger.push(row.clone()).unwrap();
                assert_eq!(read(&path).unwrap(), &rows[..=n], "{name}");
            }
            // A step done again replaces its row.
            ledger.push(row(20, Some(5.0))).unwrap();
            ledger.push(row(40, None)).unwrap();
            drop(ledger);
            let mut ledger = Ledger::resume(&path).unwrap();
            ledger.push(row(50, None)).unwrap();
            let steps: Vec<_> = read(&path).unwrap().iter().map(|r| (r.step, r.time)).collect();
            assert_eq!(steps, [(10, Some(0.1)), (20, Some(5.0)), (30, None), (40, None), (50, None)]);
            Ledger::create(&path).unwrap();
            assert_eq!(read(&path).unwrap(), &[]);
        }
    }

    #[test]
    fn the_header_names_the_columns() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("l.csv");
        Ledger::create(&path).unwrap().push(row(3, None)).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.starts_with("step,time,bytes,held_ms,"), "{text}");
        assert!(text.contains("\n3,,0,0.0,"), "{text}");
    }

    #[test]
    fn errors_say_what_to_type() {
        let folder = tempfile::tempdir().unwrap();
        let message = Ledger::create(folder.path().join("l.xlsx")).unwrap_err().to_string();
        assert!(message.contains("ledger.csv"), "{message}");
        let path = folder.path().join("l.csv");
        std::fs::write(&path, "a,b\n1\n").unwrap();
        let message = Ledger::resume(&path).unwrap_err().to_string();
        assert!(message.contains("not a ledger") && message.contains("l.csv"), "{message}");

        std::fs::write(&path, "a,b\n1,2\n").unwrap();
        assert!(Ledger::resume(&path).unwrap_err().to_string().contains("no column `step`"));
    }
}
