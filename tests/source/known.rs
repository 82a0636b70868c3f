//! Figures of real files against STATS.tsv, which NumPy worked out.

use std::collections::HashMap;

use gloaming::grid::Region;
use gloaming::source::{Series, SourceSpec, open, statistics};

use super::{data, spec};

/// One line of STATS.tsv: figures worked out independently with NumPy.
struct Known {
    step: u64,
    time: Option<f64>,
    size: [usize; 3],
    figures: [f64; 4],
    valid: usize,
    probe: f64,
}

fn known() -> HashMap<String, Vec<Known>> {
    let text = std::fs::read_to_string(data("STATS.tsv")).unwrap();
    let mut all: HashMap<String, Vec<Known>> = HashMap::new();
    for line in text.lines().skip(1) {
        let cells: Vec<&str> = line.split('\t').collect();
        let number = |i: usize| cells[i].parse::<f64>().unwrap();
        all.entry(cells[0].to_owned()).or_default().push(Known {
            step: cells[1].parse().unwrap(),
            time: cells[2].parse().ok(),
            size: [3, 4, 5].map(|i| number(i) as usize),
            figures: [6, 7, 8, 9].map(number),
            valid: number(10) as usize,
            probe: number(11),
        });
    }
    all
}

/// Every step's number, time, size, figures and probe agree with STATS.tsv to 1e-6 of the value, or of the range for
/// means that cancel.
fn agrees(name: &str, series: &dyn Series) {
    let known = known();
    let known = &known[name];
    assert_eq!(series.info().steps.len(), known.len(), "{name}");
    for (index, line) in known.iter().enumerate() {
        let step = series.native(index).unwrap().step;
        assert_eq!((step.step, step.grid.size), (line.step, line.size), "{name}");
        match (step.time, line.time) {
            (Some(is), Some(was)) => assert!((is - was).abs() <= 1e-6 * was.abs(), "{name}: time {is}, not {was}"),
            (is, was) => assert_eq!(is, was, "{name} step {}", line.step),
        }
        let found = statistics(&step).unwrap();
        let reach = 1e-9 * (line.figures[1] - line.figures[0]).abs();
        let close = |is: f64, was: f64| (is - was).abs() <= 1e-6 * was.abs() + reach;
        for (is, was) in [found.min, found.max, found.mean, found.std].into_iter().zip(line.figures) {
            assert!(close(is, was), "{name} step {}: {is}, not {was}", line.step);
        }
        assert_eq!(found.valid, line.valid, "{name}");
        let [nx, ny, nz] = line.size;
        let at = Region { start: [nx / 5, 2 * ny / 5, 7 * nz / 10], size: [1; 3] };
        let (mut probe, mut narrow) = ([0.0], [0.0]);
        step.field.read_f64(at, &mut probe).unwrap();
        step.field.read(at, &mut narrow).unwrap();
        assert!(close(probe[0], line.probe), "{name} step {}: probe {}, not {}", line.step, probe[0], line.probe);
        assert_eq!(narrow[0], probe[0] as f32);
    }
}

#[test]
fn smoke_agrees_with_the_known_figures() {
    let series = open(&spec(data("smoke.h5"))).unwrap();
    assert_eq!((series.info().field.as_str(), series.info().layout.as_str()), ("density", "hdf5 4-D dataset"));
    assert_eq!(series.info().warnings, Vec::<String>::new());
    agrees("smoke.h5:/density", series.as_ref());
}

#[test]
fn meep_agrees_with_the_known_figures_with_and_without_axes() {
    for axes in [Some("xyzt".to_owned()), None] {
        let asked = SourceSpec { axes, ..spec(data("meep_ez.h5:/ez")) };
        agrees("meep_ez.h5:/ez", open(&asked).unwrap().as_ref());
    }
}

#[test]
fn raw_agrees_with_the_known_figures() {
    let raw = Some("dims=32x32x32,dtype=f64le,offset=24,order=zyx,steps=12,start=150".to_owned());
    let asked = SourceSpec { raw, time_step: Some(150.0), ..spec(data("gray_scott_32.raw")) };
    agrees("gray_scott_32.raw", open(&asked).unwrap().as_ref());
}

#[test]
fn vtkhdf_agrees_with_the_known_figures() {
    let series = open(&spec(data("smoke.vtkhdf"))).unwrap();
    assert_eq!(series.info().layout, "vtkhdf ImageData, temporal");
    agrees("smoke.vtkhdf:density", series.as_ref());
}

#[test]
fn openpmd_agrees_with_the_known_figures() {
    let series = open(&spec(data("openpmd_gray_scott.h5"))).unwrap();
    let info = series.info();
    assert_eq!((info.layout.as_str(), info.field.as_str()), ("openPMD groupBased", "U"));
    // gridSpacing 0.5 0.5 0.25 along z, y, x, gridGlobalOffset -1 0 2, position 0.5, in 1e-6 m.
    let close = |is: [f64; 3], was: [f64; 3]| is.iter().zip(was).all(|(a, b)| (a - b).abs() < 1e-15);
    assert!(close(info.grid.spacing, [0.25e-6, 0.5e-6, 0.5e-6]), "{:?}", info.grid);
    assert!(close(info.grid.origin, [2.125e-6, 0.25e-6, -0.75e-6]), "{:?}", info.grid);
    assert_eq!((info.grid.units.as_str(), info.grid.centering.as_str()), ("m", "cell"));
    assert!(info.warnings.iter().any(|w| w.contains("unitSI = 2")), "{:?}", info.warnings);
    agrees("openpmd_gray_scott.h5:U", series.as_ref());
}

#[test]
fn netcdf_agrees_with_the_known_figures() {
    for (field, levels) in [("T", 16), ("u", 16), ("w", 17)] {
        let asked = SourceSpec { field: Some(field.into()), ..spec(data("oceananigans_thermal_bubble.nc")) };
        let series = open(&asked).unwrap();
        let info = series.info();
        assert_eq!((info.layout.as_str(), info.field.as_str(), info.grid.size[2]), ("netCDF-4", field, levels));
        assert_eq!(info.grid.units, "m");
        agrees(&format!("oceananigans_thermal_bubble.nc:{field}"), series.as_ref());
    }
}
