//! A device that fails while a simulation runs: the session goes on without it.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use gloaming::device::convection::{Convected, Convection, Layers};
use gloaming::device::cpu::Cpu;
use gloaming::device::slices::Slices;
use gloaming::device::{
    Buffer, Device, Lamp, March, Optic, Part, PointSweep, Ray, Rays, SourceTerm, Sweep, Tally, Trace, Traced, Transport,
};
use gloaming::field::{Dense, Timestep};
use gloaming::frame::Frame;
use gloaming::grid::{BrickLayout, Region, Slab};
use gloaming::insitu::{InSitu, Stats};
use gloaming::ledger::{self, LedgerRow};
use gloaming::scene::Scene;
use gloaming::transfer::Table;
use gloaming::{Error, Grid, Result};

/// What a kernel does from some step on.
#[derive(Clone, Copy, PartialEq)]
enum Fault {
    /// Says that the device is lost.
    Lost,
    /// Panics, in that step alone.
    Panic,
    /// Has no memory left, in that step alone.
    Memory,
}

struct Faulty {
    inner: Cpu,
    name: &'static str,
    /// Whether another device goes on with its work.
    replaced: bool,
    fault: Fault,
    at: u32,
    /// Steps begun: each hands over its data once.
    steps: AtomicU32,
}

impl Faulty {
    fn check(&self) -> Result<()> {
        let step = self.steps.load(Ordering::Relaxed).wrapping_sub(1);
        match self.fault {
            Fault::Lost if step >= self.at && step != u32::MAX => Err(Error::Device("the device was lost".into())),
            Fault::Panic if step == self.at => panic!("a bug in a kernel"),
            Fault::Memory if step == self.at => Err(Error::OutOfMemory { needed: 1 << 40, budget: 1 << 30 }),
            _ => Ok(()),
        }
    }
}

impl Device for Faulty {
    fn name(&self) -> String {
        self.name.into()
    }
    fn instead(&self) -> Option<Arc<dyn Device>> {
        self.replaced.then(|| Arc::new(Cpu::new(1).unwrap()) as _)
    }
    fn alloc(&self, len: usize) -> Result<Buffer> {
        self.inner.alloc(len)
    }
    fn upload(&self, values: &[f32], into: &mut Buffer) -> Result<()> {
        self.inner.upload(values, into)
    }
    fn exchange(&self, values: Vec<f32>, with: &mut Buffer) -> Result<Vec<f32>> {
        self.steps.fetch_add(1, Ordering::Relaxed);
        self.inner.exchange(values, with)
    }
    fn download(&self, from: &Buffer, out: &mut [f32]) -> Result<()> {
        self.inner.download(from, out)
    }
    fn copy(&self, from: &Buffer, start: usize, len: usize, into: &mut Buffer, at: usize) -> Result<()> {
        self.inner.copy(from, start, len, into, at)
    }
    fn classify_slab(&self, o: Optic, t: &Table, d: &Slab, f: &Buffer, l: &Slab, out: &mut Buffer) -> Result<()> {
        self.inner.classify_slab(o, t, d, f, l, out)
    }
    fn brick_range(&self, layout: &BrickLayout, field: &Buffer) -> Result<Vec<[f32; 2]>> {
        self.inner.brick_range(layout, field)
    }
    fn change(&self, layout: &BrickLayout, now: &Buffer, before: &Buffer) -> Result<Vec<[f32; 3]>> {
        self.inner.change(layout, now, before)
    }
    fn restrict_slab(&self, fine: &Slab, values: &Buffer, coarse: &Slab, out: &mut Buffer) -> Result<()> {
        self.inner.restrict_slab(fine, values, coarse, out)
    }
    fn sweep(
        &self,
        sweep: &Sweep,
        layout: &BrickLayout,
        sigma: &Buffer,
        rho: &mut Buffer,
        fronts: &[&[u32]],
    ) -> Result<Vec<f32>> {
        let swept = self.inner.sweep(sweep, layout, sigma, rho, fronts);
        self.check().and(swept)
    }
    fn source(&self, term: &SourceTerm, source: &mut Buffer, gradient: Option<[&mut Buffer; 3]>) -> Result<()> {
        self.inner.source(term, source, gradient)
    }
    fn transport(&self, t: &Transport, phi: &mut Buffer, current: Option<[&mut Buffer; 3]>) -> Result<(f32, f32)> {
        self.inner.transport(t, phi, current)
    }
    fn resize(&self, buffer: &mut Buffer, len: usize) -> Result<()> {
        self.inner.resize(buffer, len)
    }
    fn crop(&self, size: [usize; 3], values: &Buffer, region: Region, out: &mut Buffer) -> Result<()> {
        self.inner.crop(size, values, region, out)
    }
    fn embed(&self, region: Region, values: &Buffer, size: [usize; 3], out: &mut Buffer) -> Result<()> {
        self.inner.embed(region, values, size, out)
    }
    // Lights in a place and the paper's model, which no test here asks for.
    fn sweep_point(
        &self,
        _: &PointSweep,
        _: &BrickLayout,
        _: &Buffer,
        _: &mut Buffer,
        _: &[&[u32]],
    ) -> Result<Vec<f32>> {
        unreachable!()
    }
    fn irradiate(&self, _: &Lamp, _: &Grid, _: Range<usize>, _: &Buffer, _: &mut Buffer) -> Result<()> {
        unreachable!()
    }
    fn convect_layers(&self, _: &Convection, _: Layers, _: &Buffer, _: &Buffer, _: &mut Buffer) -> Result<Convected> {
        unreachable!()
    }
    fn convect_whole(&self, _: &Convection, _: &Buffer, _: &Buffer, _: &mut Buffer) -> Result<f32> {
        unreachable!()
    }
    fn convect_ordered(
        &self,
        _: &Convection,
        _: &BrickLayout,
        _: &Buffer,
        _: &mut Buffer,
        _: &[&[u32]],
    ) -> Result<Vec<f32>> {
        unreachable!()
    }
    fn diffuse(&self, _: [usize; 3], _: [&[f32]; 3], _: &mut Buffer) -> Result<()> {
        unreachable!()
    }
    fn relax(&self, _: [usize; 3], _: [f32; 3], _: &Buffer, _: &mut Buffer, _: usize) -> Result<()> {
        unreachable!()
    }
    fn residual(&self, _: [usize; 3], _: [f32; 3], _: &Buffer, _: &Buffer, _: &mut Buffer) -> Result<f32> {
        unreachable!()
    }
    fn prolong_slab(&self, coarse: &Slab, values: &Buffer, fine: &Slab, into: &mut Buffer) -> Result<()> {
        self.inner.prolong_slab(coarse, values, fine, into)
    }
    fn compose(&self, terms: &[(&Buffer, [f32; 3])], out: &mut [[f32; 3]]) -> Result<()> {
        self.inner.compose(terms, out)
    }
    fn march(&self, march: &March, frame: &mut Frame) -> Result<()> {
        self.check()?;
        self.inner.march(march, frame)
    }
    fn march_slab(&self, march: &March, part: &Part, rays: &mut Rays) -> Result<()> {
        self.inner.march_slab(march, part, rays)
    }
    fn gradient(&self, grid: &Grid, field: &Buffer, out: &mut Buffer) -> Result<()> {
        self.inner.gradient(grid, field, out)
    }
    fn classify_graded(
        &self,
        optic: Optic,
        table: &Table,
        data: ([usize; 3], &Buffer, &Buffer),
        size: [usize; 3],
        out: &mut Buffer,
    ) -> Result<()> {
        self.inner.classify_graded(optic, table, data, size, out)
    }
    fn slice(&self, slices: &Slices, rays: &mut [Ray]) -> Result<()> {
        self.inner.slice(slices, rays)
    }
    fn trace(&self, trace: &Trace, picture: [usize; 2], tallies: &mut [Tally]) -> Result<Traced> {
        self.check()?;
        self.inner.trace(trace, picture, tallies)
    }
    fn trace_tiles(
        &self,
        trace: &Trace,
        tiles: &[u32],
        picture: [usize; 2],
        tallies: &mut [Tally],
        touched: &mut [u64],
    ) -> Result<Traced> {
        self.check()?;
        self.inner.trace_tiles(trace, tiles, picture, tallies, touched)
    }
}

const SIZE: [usize; 3] = [12, 14, 16];

/// Eight steps on a device that fails at step 3: figures, rows, and the pictures of a session without a fault to hold against.
fn run(name: &'static str, replaced: bool, fault: Fault) -> (Stats, Vec<LedgerRow>, Vec<(bool, bool)>) {
    let session = |device: Arc<dyn Device>| {
        let out = tempfile::tempdir().unwrap();
        let mut scene = Scene::parse(
            "field.range = [0.0, 1.0]\nlight.directions = 8\nrender.size = [24, 20]\ninsitu.threads = 1",
            "test",
            &[],
        )
        .unwrap();
        scene.insitu.outputs = vec![out.path().join("f_{step}.png").to_str().unwrap().into()];
        scene.insitu.ledger = Some(out.path().join("ledger.json"));
        let lit = InSitu::with(scene).device(device).open().unwrap();
        for step in 0..8u64 {
            let values = (0..SIZE.iter().product::<usize>() as u64).map(|i| ((i * 13 + step * 7) % 50) as f32 / 50.0);
            let field = Arc::new(Dense::new(SIZE, values.collect()));
            lit.push_owned(Timestep { step, time: None, grid: Grid::new(SIZE), field }).unwrap();
        }
        (lit.close().unwrap(), out)
    };
    let inner = Cpu::new(1).unwrap();
    let (stats, out) = session(Arc::new(Faulty { inner, name, replaced, fault, at: 3, steps: AtomicU32::new(0) }));
    let (_, sound) = session(Arc::new(Cpu::new(1).unwrap()));
    let same = |step: u64| {
        let read = |folder: &tempfile::TempDir| std::fs::read(folder.path().join(format!("f_{step}.png"))).ok();
        (read(&out).is_some(), read(&out) == read(&sound))
    };
    let mut rows = ledger::read(&out.path().join("ledger.json")).unwrap();
    rows.sort_by_key(|r| r.step);
    (stats, rows, (0..8).map(same).collect())
}

/// The step in hand is lit again on the CPU: nothing is lost.
#[test]
fn a_lost_device_is_replaced_by_the_cpu() {
    for fault in [Fault::Lost, Fault::Panic, Fault::Memory] {
        let (stats, rows, frames) = run("a GPU", true, fault);
        assert_eq!((stats.lit, stats.lost), (8, 0), "{stats:?}");
        let starts: String = rows.iter().map(|r| &r.start[..1]).collect();
        assert_eq!(starts, "cwwcwwww", "the step that failed is lit from scratch, the next ones from it");
        assert!(frames.iter().all(|(there, _)| *there));
        assert!(frames[..3].iter().all(|(_, same)| *same), "{frames:?}");
    }
}

/// There is nothing to replace the CPU by: the step is lost, alone.
#[test]
fn a_kernel_that_fails_costs_its_step() {
    for (fault, why) in [(Fault::Panic, "a bug in a kernel"), (Fault::Memory, "out of memory")] {
        let (stats, rows, frames) = run("cpu (faulty)", false, fault);
        assert_eq!((stats.lit, stats.lost), (7, 1), "{stats:?}");
        assert!(rows[3].lost.contains(why), "{}", rows[3].lost);
        let there: Vec<bool> = frames.iter().map(|f| f.0).collect();
        assert_eq!(there, [true, true, true, false, true, true, true, true]);
        assert_eq!(rows[4].start, "cold", "nothing is built on half a step's light");
    }
}
