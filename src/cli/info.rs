//! `gloaming info`: what is in a series, and its figures.

use std::io::Write;

use anyhow::{Context as _, bail};
use gloaming::field::Timestep;
use gloaming::grid::{Grid, Region};
use gloaming::source::{Series, SeriesInfo, SourceSpec, Statistics, statistics_of};
use serde_json::{Value, json};

/// Figures of one step: with `--stats`, and the value at the `--probe`.
struct Figures {
    statistics: Option<Statistics>,
    probe: Option<f64>,
}

/// Prints what is in a series: JSON for programs, or a table. `stats` reads all values; `probe` is a voxel index.
///
/// # Errors
/// When the series cannot be opened or read, or the probe lies outside of the grid.
pub fn run(spec: &SourceSpec, stats: bool, probe: Option<[usize; 3]>, json: bool) -> anyhow::Result<()> {
    let series = gloaming::source::open(spec)?;
    let mut figures = Vec::new();
    let mut warnings = series.info().warnings.clone();
    for index in 0..series.info().steps.len() {
        figures.push(figures_of(series.as_ref(), index, stats, probe, &mut warnings)?);
    }
    let mut out = std::io::stdout().lock();
    if json {
        serde_json::to_writer_pretty(&mut out, &report(series.info(), &figures, &warnings))?;
        writeln!(out)?;
    } else {
        table(&mut out, series.info(), &figures, &warnings)?;
    }
    Ok(())
}

fn figures_of(
    series: &dyn Series,
    index: usize,
    stats: bool,
    probe: Option<[usize; 3]>,
    warnings: &mut Vec<String>,
) -> anyhow::Result<Figures> {
    if !stats && probe.is_none() {
        return Ok(Figures { statistics: None, probe: None });
    }
    let number = series.info().steps[index].step;
    let read = || -> anyhow::Result<Figures> {
        let native = series.native(index)?;
        let found = stats.then(|| statistics_of(&native.pieces)).transpose()?;
        Ok(Figures { statistics: found, probe: probe.map(|at| value_at(&native.step, at)).transpose()? })
    };
    match read() {
        Ok(figures) => {
            if let Some(odd) = figures.statistics.map(|s| s.total - s.valid).filter(|&n| n > 0) {
                warnings.push(format!("step {number}: {odd} values are NaN, infinite or fill: empty"));
            }
            Ok(figures)
        }
        // One bad step of many is told beside the others' figures; alone it is the whole answer.
        Err(why) if series.info().steps.len() > 1 && probe_fits(series, probe) => {
            warnings.push(format!("step {number} cannot be read: {why}"));
            Ok(Figures { statistics: None, probe: None })
        }
        Err(why) => Err(why).with_context(|| format!("step {number}")),
    }
}

fn probe_fits(series: &dyn Series, probe: Option<[usize; 3]>) -> bool {
    probe.is_none_or(|at| (0..3).all(|a| at[a] < series.info().grid.size[a]))
}

fn value_at(step: &Timestep, at: [usize; 3]) -> anyhow::Result<f64> {
    if (0..3).any(|a| at[a] >= step.grid.size[a]) {
        let [nx, ny, nz] = step.grid.size;
        bail!("--probe {},{},{} lies outside of the grid of {nx}×{ny}×{nz} values", at[0], at[1], at[2]);
    }
    let mut value = [0.0];
    step.field.read_f64(Region { start: at, size: [1; 3] }, &mut value)?;
    Ok(value[0])
}

/// The JSON form; figures that were not asked for, or are not finite, are null.
fn report(info: &SeriesInfo, figures: &[Figures], warnings: &[String]) -> Value {
    let steps: Vec<Value> = info
        .steps
        .iter()
        .zip(figures)
        .map(|(step, figures)| {
            let s = figures.statistics;
            json!({
                "step": step.step, "time": step.time,
                "min": s.map(|s| s.min), "max": s.map(|s| s.max), "mean": s.map(|s| s.mean), "std": s.map(|s| s.std),
                "valid": s.map(|s| s.valid), "probe": figures.probe,
            })
        })
        .collect();
    let range = info.range.as_ref().map(|([lo, hi], source)| json!({ "min": lo, "max": hi, "source": source }));
    json!({
        "layout": info.layout, "why": info.why, "series": info.series, "field": info.field, "units": info.units,
        "candidates": info.candidates, "others": info.others, "grid": info.grid, "resampled": info.resampled,
        "level": info.level, "time_units": info.time_units, "steps": steps, "range": range, "warnings": warnings,
    })
}

/// Datasets beside the volumes that the table names.
const OTHERS: usize = 8;

/// Eight significant digits at most, in powers of ten where plain digits would be many.
fn short(value: f64) -> String {
    let size = value.abs();
    if value == 0.0 || (1e-3..1e7).contains(&size) {
        let digits = (7 - size.max(1e-3).log10().floor() as i32).clamp(0, 10) as usize;
        let plain = format!("{value:.digits$}");
        let plain = if plain.contains('.') { plain.trim_end_matches('0').trim_end_matches('.') } else { &plain };
        return plain.to_owned();
    }
    format!("{value:.7e}")
}

fn table(out: &mut impl Write, info: &SeriesInfo, figures: &[Figures], warnings: &[String]) -> std::io::Result<()> {
    let files = match info.series.as_slice() {
        [] => String::new(),
        [one] => one.display().to_string(),
        [first, .., last] => format!("{} … {} ({} files)", first.display(), last.display(), info.series.len()),
    };
    let ([nx, ny, nz], [dx, dy, dz], [x, y, z]) = (info.grid.size, info.grid.spacing, info.grid.origin);
    writeln!(out, "layout    {}", info.layout)?;
    writeln!(out, "because   {}", info.why.join("; "))?;
    writeln!(out, "series    {files}")?;
    let units = if info.units.is_empty() { String::new() } else { format!(" [{}]", info.units) };
    writeln!(out, "field     {}{units}", info.field)?;
    for other in info.candidates.iter().filter(|c| info.candidates.len() > 1 || c.name != info.field) {
        let shape: Vec<String> = other.shape.iter().map(usize::to_string).collect();
        writeln!(out, "  there is {}  {} {} {}", other.name, shape.join("×"), other.dtype, other.kind)?;
    }
    for other in info.others.iter().take(OTHERS) {
        writeln!(out, "  also    {other}")?;
    }
    if info.others.len() > OTHERS {
        writeln!(
            out,
            "  also    {} more datasets that are no volumes (--json lists them)",
            info.others.len() - OTHERS
        )?;
    }
    let units = if info.grid.units.is_empty() { String::new() } else { format!(" {}", info.grid.units) };
    writeln!(
        out,
        "grid      {nx}×{ny}×{nz}  spacing {dx} {dy} {dz}{units}  origin {x} {y} {z}  {}",
        info.grid.centering
    )?;
    if let Some(Grid { size: [nx, ny, nz], spacing: [dx, dy, dz], origin: [x, y, z] }) = info.resampled {
        writeln!(out, "shown as  {nx}×{ny}×{nz}  spacing {dx} {dy} {dz}{units}  origin {x} {y} {z}")?;
    }
    if let Some(([lo, hi], source)) = &info.range {
        writeln!(out, "range     {lo} to {hi} ({source})")?;
    }
    writeln!(out, "steps     {}", info.steps.len())?;
    let told = figures.iter().any(|f| f.statistics.is_some() || f.probe.is_some());
    let head = ["time", "min", "max", "mean", "std", "valid", "probe"];
    if told {
        writeln!(out, "{:>10}{}", "step", head.map(|h| format!("{h:>15}")).concat())?;
        for (step, figures) in info.steps.iter().zip(figures) {
            let number = |v: Option<f64>| format!("{:>15}", v.map_or("-".into(), short));
            let s = figures.statistics;
            let cells = [step.time, s.map(|s| s.min), s.map(|s| s.max), s.map(|s| s.mean), s.map(|s| s.std)];
            let valid = s.map_or(format!("{:>15}", "-"), |s| format!("{:>15}", s.valid));
            let cells = cells.map(number).concat();
            writeln!(out, "{:>10}{cells}{valid}{}", step.step, number(figures.probe))?;
        }
    } else if let (Some(first), Some(last)) = (info.steps.first(), info.steps.last()) {
        let time = |t: Option<f64>| {
            t.map_or(String::from("unknown"), |t| format!("{t} {}", info.time_units).trim().to_owned())
        };
        writeln!(
            out,
            "          {} (time {}) to {} (time {})",
            first.step,
            time(first.time),
            last.step,
            time(last.time)
        )?;
    }
    for warning in warnings {
        writeln!(out, "warning   {warning}")?;
    }
    Ok(())
}
