//! A series that is still being written: its steps, each once it is complete.
//!
//! The files are looked at again and again. A step is complete when a later one exists, when a marker `FILE.done`
//! stands beside its file, or when its file has kept its length and its time of change for a while; and when it opens.
//! Files are opened anew after each change, through SWMR where the writer allows that, so that nothing is seen of them
//! but what was there then.

use std::collections::{BTreeSet, HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant, SystemTime};

use super::expand::expand;
use super::{Series, SourceSpec, open};
use crate::error::{Error, Result};
use crate::field::Timestep;

/// How a growing series is followed.
pub struct Patience {
    /// Ends when nothing has changed for so long.
    pub idle: Duration,
    /// A file that has not changed for so long is complete.
    pub settled: Duration,
    /// Time between looks.
    pub poll: Duration,
}

impl Default for Patience {
    fn default() -> Self {
        Patience { idle: Duration::from_secs(300), settled: Duration::from_secs(2), poll: Duration::from_millis(250) }
    }
}

/// Which of all step numbers, in order, are wanted: their indices.
pub type Select = dyn Fn(&[u64]) -> Vec<usize> + Send;

/// See the [module](self).
pub struct Following {
    spec: SourceSpec,
    patience: Patience,
    select: Box<Select>,
    /// Steps from this number on are not waited for.
    end: Option<u64>,
    series: Option<Box<dyn Series>>,
    /// Why the series did not open last time.
    problem: Option<Error>,
    /// Files as they were seen last, and since when they have been so.
    seen: HashMap<PathBuf, (Stamp, Instant)>,
    taken: BTreeSet<u64>,
    said: HashSet<String>,
    news: Instant,
}

/// Length and time of change of a file.
type Stamp = Option<(u64, SystemTime)>;

/// A step that was taken: its number, and the step or why it cannot be opened.
pub type Taken = (u64, Result<Timestep>);

/// How a look at a step ended.
enum Look {
    Wait,
    Take(Taken),
}

impl Following {
    /// Waits until the series opens, and hands out what was found with what will follow it.
    ///
    /// # Errors
    /// What kept it from opening when nothing has changed for as long as `patience` says, or `stop` is set.
    pub fn open(
        spec: SourceSpec,
        patience: Patience,
        select: Box<Select>,
        end: Option<u64>,
        stop: &AtomicBool,
    ) -> Result<(Box<dyn Series>, Following)> {
        let mut following = Following {
            spec,
            patience,
            select,
            end,
            series: None,
            problem: None,
            seen: HashMap::new(),
            taken: BTreeSet::new(),
            said: HashSet::new(),
            news: Instant::now(),
        };
        loop {
            following.look();
            // The one that is handed out tells what is there; it must hold no file open.
            if following.series.is_some()
                && let Ok(found) = open(&following.spec)
            {
                return Ok((found, following));
            }
            if !following.rest(stop) {
                let nothing = || Error::Closed("stopped before the first step".into());
                return Err(following.problem.unwrap_or_else(nothing));
            }
        }
    }

    /// Waits for the next step that is complete; `None` when nothing has changed for as long as was said, when the last
    /// step that is wanted is done, or when `stop` is set.
    pub fn next(&mut self, stop: &AtomicBool) -> Option<Taken> {
        loop {
            if stop.load(Ordering::Relaxed) {
                return None;
            }
            self.look();
            match self.first_new() {
                Some(Look::Take(taken)) => {
                    if let Some(last) = self.taken.last().filter(|last| **last > taken.0) {
                        tracing::warn!("step {} appeared after step {last}: it is lit out of order", taken.0);
                    }
                    self.taken.insert(taken.0);
                    self.news = Instant::now();
                    return Some(taken);
                }
                Some(Look::Wait) => {}
                None if self.past_end() => return None,
                None => {}
            }
            if !self.rest(stop) {
                return None;
            }
        }
    }

    /// Notes what has changed, and opens the series anew after a change.
    fn look(&mut self) {
        let now = Instant::now();
        let files = expand(&self.spec.series).map(|files| files.entries).unwrap_or_default();
        let mut changed = false;
        let mut seen = HashMap::new();
        for path in files.into_iter().map(|entry| entry.path).chain(self.stored_in()) {
            let stamp = std::fs::metadata(&path).ok().and_then(|about| Some((about.len(), about.modified().ok()?)));
            let before = self.seen.get(&path).filter(|(before, _)| *before == stamp);
            changed |= before.is_none();
            let since = before.map_or(now, |(_, since)| *since);
            seen.insert(path, (stamp, since));
        }
        changed |= seen.len() != self.seen.len();
        self.seen = seen;
        if changed {
            self.news = now;
        }
        if !changed && self.series.is_some() {
            return;
        }
        // HDF5 shares what it knows of a file among all who have it open: it must be closed to be seen anew.
        self.series = None;
        match open(&self.spec) {
            Ok(series) => {
                for warning in &series.info().warnings {
                    if self.said.insert(warning.clone()) && !self.taken.is_empty() {
                        tracing::warn!("{warning}");
                    }
                }
                self.series = Some(series);
            }
            Err(why) => self.problem = Some(why),
        }
    }

    /// The files in which the steps are stored, where those are not the ones that were named (an XDMF file's HDF5
    /// file).
    fn stored_in(&self) -> BTreeSet<PathBuf> {
        let Some(series) = &self.series else { return BTreeSet::new() };
        (0..series.info().steps.len()).filter_map(|i| series.file(i).map(Path::to_owned)).collect()
    }

    /// The first wanted step that was not taken, if there is one.
    fn first_new(&self) -> Option<Look> {
        let series = self.series.as_ref()?;
        let numbers: Vec<u64> = series.info().steps.iter().map(|s| s.step).collect();
        let index = (self.select)(&numbers).into_iter().find(|&i| !self.taken.contains(&numbers[i]))?;
        let settled = self.since(series.file(index)).is_none_or(|since| since.elapsed() >= self.patience.settled);
        let later = index + 1 < numbers.len();
        if !(later || settled || series.file(index).is_some_and(marked)) {
            return Some(Look::Wait);
        }
        let step = series.timestep(index);
        // What does not open may be a file that its writer still holds, or has not got round to yet.
        let patience = 4 * self.patience.settled;
        if step.is_err() && self.since(series.file(index)).is_some_and(|since| since.elapsed() < patience) {
            return Some(Look::Wait);
        }
        Some(Look::Take((numbers[index], step)))
    }

    /// Since when a file has been as it is.
    fn since(&self, file: Option<&Path>) -> Option<Instant> {
        self.seen.get(file?).map(|(_, since)| *since)
    }

    /// True when no step can come that is wanted.
    fn past_end(&self) -> bool {
        let Some(end) = self.end else { return false };
        let numbers = self.series.as_ref().map(|s| s.info().steps.iter().map(|s| s.step).max());
        self.taken.last().is_some_and(|last| last + 1 >= end) || numbers.flatten().is_some_and(|last| last >= end)
    }

    /// Sleeps until the next look; false when it is time to end.
    fn rest(&self, stop: &AtomicBool) -> bool {
        let slice = Duration::from_millis(20).min(self.patience.poll);
        let begun = Instant::now();
        while begun.elapsed() < self.patience.poll {
            if stop.load(Ordering::Relaxed) {
                return false;
            }
            std::thread::sleep(slice);
        }
        self.news.elapsed() < self.patience.idle
    }
}

/// True when a marker beside a file says that it is complete: `plt_7.h5.done` or `plt_7.done`.
fn marked(file: &Path) -> bool {
    let mut appended = file.as_os_str().to_owned();
    appended.push(".done");
    Path::new(&appended).exists() || file.with_extension("done").exists()
}
