//! One self-contained HTML file with plots.

use std::fmt::Write;

use plotters::coord::ranged1d::ValueFormatter;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;

use super::{Cost, Savings, Step};
use crate::error::{Error, Result};

const COLD: RGBColor = RGBColor(38, 103, 166);
const WARM: RGBColor = RGBColor(214, 93, 14);
const LIMIT: RGBColor = RGBColor(120, 120, 120);

/// A curve over the steps.
struct Curve<'a> {
    name: &'a str,
    color: RGBColor,
    value: fn(&Step) -> f64,
}

/// The report as one HTML file that needs no other.
pub(super) fn html(all: &[Savings]) -> Result<String> {
    let sections: String = all.iter().map(Savings::section).collect::<Result<_>>()?;
    Ok(format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>What the warm start saves</title>\n\
         <style>body{{font:15px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#222}}\
         table{{border-collapse:collapse;margin:1rem 0}}td,th{{padding:.2rem .9rem;text-align:right;border-bottom:1px \
         solid #ddd}}td:first-child,th:first-child{{text-align:left}}svg{{max-width:100%;height:auto}}</style>\n\
         <h1>What the warm start saves</h1>\n{sections}</html>\n"
    ))
}

impl Savings {
    /// One measurement.
    fn section(&self) -> Result<String> {
        let both = |cold: fn(&Step) -> f64, warm: fn(&Step) -> f64| {
            [Curve { name: "cold", color: COLD, value: cold }, Curve { name: "warm", color: WARM, value: warm }]
        };
        let share = |c: &Cost| c.bricks_active as f64 / c.bricks_total.max(1) as f64;
        let mut plots = String::new();
        for (title, curves) in [
            ("Iterations of scattered light", both(|s| s.cold.iterations as f64, |s| s.warm.iterations as f64)),
            (
                "Voxel updates, in millions, every pass counted",
                both(|s| s.cold.voxel_updates as f64 * 1e-6, |s| s.warm.voxel_updates as f64 * 1e-6),
            ),
            ("Seconds", both(|s| s.cold.seconds, |s| s.warm.seconds)),
            (
                "Active fraction: bricks that were swept, of all",
                both(
                    |s| s.cold.bricks_active as f64 / s.cold.bricks_total.max(1) as f64,
                    |s| s.warm.bricks_active as f64 / s.warm.bricks_total.max(1) as f64,
                ),
            ),
        ] {
            plots += &self.plot(title, &curves, None)?;
        }
        let errors = [
            Curve { name: "certified, warm", color: WARM, value: |s| s.warm.certified_error },
            Curve { name: "true, warm", color: RGBColor(152, 60, 120), value: |s| s.warm.true_error },
            Curve { name: "true, cold", color: COLD, value: |s| s.cold.true_error },
        ];
        plots += &self.plot("Error, relative; the line is the tolerance", &errors, Some(f64::from(self.tolerance)))?;
        let verdict = |r: f64| match r {
            r if r > 1.0 => "saved",
            r if r < 1.0 => "lost",
            _ => "even",
        };
        let mut rows = String::new();
        for (what, cold, warm, ratio) in [
            ("seconds", self.cold.seconds, self.warm.seconds, self.ratio.seconds),
            ("voxel updates", self.cold.voxel_updates as f64, self.warm.voxel_updates as f64, self.ratio.voxel_updates),
            ("sweeps", self.cold.sweeps, self.warm.sweeps, self.ratio.sweeps),
            ("iterations", self.cold.iterations as f64, self.warm.iterations as f64, self.ratio.iterations),
            ("bricks swept", self.cold.bricks_active as f64, self.warm.bricks_active as f64, self.ratio.bricks_active),
        ] {
            let _ = writeln!(
                rows,
                "<tr><td>{what}</td><td>{cold:.6}</td><td>{warm:.6}</td><td>{ratio:.2}</td><td>{}</td></tr>",
                verdict(ratio)
            );
        }
        let mut name = self.what.clone();
        name[..1].make_ascii_uppercase();
        Ok(format!(
            "<h2>{name}</h2>\n<p>{} steps on {}, tolerance {:e} certified for both. Cold and warm ran in \
             turns in one process; true errors are against a cold solve at tolerance {:e}. All steps count, the first \
             included.</p>\n<table><tr><th></th><th>cold</th><th>warm</th><th>cold ÷ warm</th><th></th></tr>\n{rows}\
             </table>\n<p>Largest certified error of the warm light {:.1e}, largest true error {:.1e} (cold {:.1e}); {:.0} % of \
             the bricks swept.</p>\n{plots}",
            self.steps.len(),
            self.device,
            self.tolerance,
            self.tight_tolerance,
            self.warm.certified_error,
            self.warm.true_error,
            self.cold.true_error,
            100.0 * share(&self.warm),
        ))
    }

    /// A plot over the steps as SVG.
    fn plot(&self, title: &str, curves: &[Curve], limit: Option<f64>) -> Result<String> {
        let mut svg = String::new();
        self.draw(title, curves, limit, &mut svg).map_err(|e| Error::Unsupported(format!("plot `{title}`: {e}")))?;
        Ok(svg)
    }

    fn draw(
        &self,
        title: &str,
        curves: &[Curve],
        limit: Option<f64>,
        svg: &mut String,
    ) -> std::result::Result<(), Box<dyn std::error::Error>> {
        let first = self.steps.first().map_or(0.0, |s| s.step as f64);
        let last = self.steps.last().map_or(1.0, |s| s.step as f64).max(first + 1.0);
        let values = self.steps.iter().flat_map(|s| curves.iter().map(|c| (c.value)(s)));
        let top = values.chain(limit).fold(0.0, f64::max) * 1.08;
        let root = SVGBackend::with_string(svg, (900, 260)).into_drawing_area();
        let mut chart = ChartBuilder::on(&root)
            .caption(title, ("sans-serif", 18))
            .margin(8)
            .x_label_area_size(34)
            .y_label_area_size(72)
            .build_cartesian_2d(first..last, 0.0..if top > 0.0 { top } else { 1.0 })?;
        let label = |v: &f64| if *v != 0.0 && v.abs() < 1e-2 { format!("{v:.1e}") } else { RangedCoordf64::format(v) };
        chart.configure_mesh().x_desc("step").y_label_formatter(&label).light_line_style(WHITE).draw()?;
        for curve in curves {
            let color = curve.color;
            let points = self.steps.iter().map(|s| (s.step as f64, (curve.value)(s)));
            chart
                .draw_series(LineSeries::new(points, color.stroke_width(2)))?
                .label(curve.name)
                .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 18, y)], color.stroke_width(2)));
        }
        if let Some(limit) = limit {
            chart.draw_series(LineSeries::new([(first, limit), (last, limit)], LIMIT))?;
        }
        chart.configure_series_labels().background_style(WHITE.mix(0.8)).border_style(LIMIT).draw()?;
        root.present()?;
        drop(chart);
        drop(root);
        Ok(())
    }
}
