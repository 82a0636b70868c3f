//! Progress on stderr: a bar on a terminal, a line a step elsewhere.

use std::io::{IsTerminal, Write};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use gloaming::ledger::LedgerRow;
use gloaming::pipeline::{Progress, Stage};
use indicatif::{HumanDuration, MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};

/// Log messages that do not disturb a progress bar: they are printed above it.
pub fn above(bars: MultiProgress) -> impl Fn() -> Above {
    move || Above(bars.clone())
}

/// See [`above`].
pub struct Above(MultiProgress);

impl Write for Above {
    fn write(&mut self, text: &[u8]) -> std::io::Result<usize> {
        self.0.suspend(|| std::io::stderr().write(text))
    }

    fn flush(&mut self) -> std::io::Result<()> {
        std::io::stderr().flush()
    }
}

/// Shows how far a run is.
pub struct Report {
    bar: Option<ProgressBar>,
    quiet: bool,
    begun: Instant,
    /// When the first step came to be lit, if there was a pass before.
    lit: OnceLock<Instant>,
}

const STEPS: &str = "{bar:24.cyan} {pos}/{len} steps  {per_sec}  ETA {eta}  {msg}";
const GROWING: &str = "{spinner:.cyan} {pos} steps  {per_sec}  {msg}";

impl Report {
    /// A report on `steps` steps; `None` while it is not known how many will come.
    pub fn new(steps: Option<usize>, quiet: bool, bars: &MultiProgress) -> Self {
        let shown = !quiet && std::io::stderr().is_terminal();
        let bar = shown.then(|| {
            let style = ProgressStyle::with_template(if steps.is_some() { STEPS } else { GROWING });
            let bar = ProgressBar::with_draw_target(steps.map(|n| n as u64), ProgressDrawTarget::hidden());
            let bar = bars.add(bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar())));
            bar.enable_steady_tick(Duration::from_millis(500));
            bar
        });
        Report { bar, quiet, begun: Instant::now(), lit: OnceLock::new() }
    }

    /// Shows a step that is finished, or how far the pass for the range of values is.
    pub fn step(&self, progress: &Progress) {
        let Progress { stage, finished, total, row } = *progress;
        let begun = match stage {
            Stage::Range => self.begun,
            Stage::Light => *self.lit.get_or_init(|| {
                self.bar.iter().for_each(ProgressBar::reset_eta);
                Instant::now()
            }),
        };
        let said = match stage {
            Stage::Range => format!("reading step {} for the range of values", row.step),
            Stage::Light => figures(row),
        };
        match &self.bar {
            Some(bar) => {
                bar.set_length(total.unwrap_or(0) as u64);
                bar.set_position(finished as u64);
                bar.set_message(said);
            }
            None if self.quiet => {}
            // A line now and then is enough for what is no result.
            None if stage == Stage::Range && finished % 16 != 0 => {}
            None => {
                let seconds = begun.elapsed().as_secs_f64();
                let rate = finished as f64 / seconds.max(1e-9);
                let Some(total) = total else {
                    eprintln!("{finished} steps, {rate:.2}/s: {said}");
                    return;
                };
                let left = total.saturating_sub(finished) as f64 / rate;
                let eta = Duration::try_from_secs_f64(left).map_or("?".into(), |left| HumanDuration(left).to_string());
                let what = if stage == Stage::Range { "for the range" } else { "steps" };
                eprintln!("{finished}/{total} {what}, {rate:.2}/s, ETA {eta}: {said}");
            }
        }
    }

    /// Takes the bar away.
    pub fn finish(self) -> Duration {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
        self.begun.elapsed()
    }
}

/// What a step cost, in a line.
fn figures(row: &LedgerRow) -> String {
    let step = row.step;
    if !row.lost.is_empty() {
        return format!("step {step} lost: {}", row.lost);
    }
    let mut said = format!("step {step} {}", row.start);
    if row.bricks_total > 0 {
        said += &format!(", {}/{} bricks", row.bricks_active, row.bricks_total);
    }
    if row.iterations > 0 {
        said += &format!(", {} iterations", row.iterations);
    }
    if row.tiles_reused > 0 {
        said += &format!(", {}/{} tiles kept", row.tiles_reused, row.tiles_total);
    }
    said +=
        &format!(", error ≤ {:.1e}, light {:.0} ms, render {:.0} ms", row.certified_error, row.light_ms, row.render_ms);
    said
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_tells_warm_from_cold_and_what_was_lost() {
        let warm = LedgerRow {
            step: 7,
            start: "warm".into(),
            bricks_active: 3,
            bricks_total: 64,
            iterations: 2,
            ..Default::default()
        };
        assert_eq!(figures(&warm), "step 7 warm, 3/64 bricks, 2 iterations, error ≤ 0.0e0, light 0 ms, render 0 ms");
        let lost = LedgerRow { step: 8, lost: "truncated".into(), ..Default::default() };
        assert_eq!(figures(&lost), "step 8 lost: truncated");
    }
}
