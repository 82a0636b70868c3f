//! The coupling: what is pushed is what is shown, and nothing that goes wrong reaches the simulation.

use std::path::Path;
use std::sync::{Arc, Condvar, Mutex};

use gloaming::field::{Dense, Field, Timestep};
use gloaming::insitu::{InSitu, Opening, Policy, Strided, Taken};
use gloaming::ledger::{self, LedgerRow};
use gloaming::scene::Scene;
use gloaming::sink::{Output, Sink};
use gloaming::{Error, Grid, Region, Result};

const SIZE: [usize; 3] = [16, 14, 12];

fn scene(out: &Path, outputs: &[&str]) -> Scene {
    let sets = [
        "render.size=[32, 24]",
        "light.resolution=0.5",
        "light.directions=8",
        "field.range=[0.0, 1.0]",
        "insitu.device=cpu",
        "insitu.threads=1",
    ];
    let mut scene = Scene::load(None, &sets.map(String::from)).unwrap();
    scene.insitu.outputs = outputs.iter().map(|o| out.join(o).to_str().unwrap().into()).collect();
    scene.insitu.ledger = Some(out.join("ledger.csv"));
    scene
}

fn values(step: u64) -> Vec<f32> {
    let [nx, ny, nz] = SIZE;
    (0..nx * ny * nz).map(|i| ((i as u64 * 7 + step * 31) % 100) as f32 / 100.0).collect()
}

fn owned(step: u64) -> Timestep {
    let field = Arc::new(Dense::new(SIZE, values(step)));
    Timestep { step, time: Some(step as f64), grid: Grid::new(SIZE), field }
}

fn rows(out: &Path) -> Vec<LedgerRow> {
    let mut rows = ledger::read(&out.join("ledger.csv")).unwrap();
    rows.sort_by_key(|r| r.step);
    rows
}

#[test]
fn borrowed_strided_and_owned_steps_give_the_same_picture() {
    let frame = |push: &dyn Fn(&InSitu)| {
        let out = tempfile::tempdir().unwrap();
        let lit = InSitu::with(scene(out.path(), &["f_{step:03}.exr"])).open().unwrap();
        push(&lit);
        let stats = lit.close().unwrap();
        assert_eq!((stats.pushed, stats.lit, stats.waiting), (1, 1, 0), "{stats:?}");
        let row = &rows(out.path())[0];
        assert_eq!(row.bytes, stats.bytes);
        assert!(row.held_ms > 0.0 && row.held_ms <= stats.held_ms);
        (gloaming::sink::exr::read(&out.path().join("f_005.exr")).unwrap(), stats.bytes)
    };
    let plain = values(5);
    let (expected, copied) =
        frame(&|lit| assert_eq!(lit.push(5, Some(5.0), &Strided::of(&plain, SIZE)).unwrap(), Taken::Queued));
    assert_eq!(copied, 4 * plain.len() as u64);

    let (given, copied) = frame(&|lit| assert_eq!(lit.push_owned(owned(5)).unwrap(), Taken::Queued));
    assert!(given == expected && copied == 0, "given away: {copied} bytes copied");

    // f64, z fastest, two layers of ghosts.
    let [nx, ny, nz] = SIZE;
    let with_ghosts = SIZE.map(|n| n + 4);
    let mut wide = vec![f64::NAN; with_ghosts.iter().product()];
    for (n, v) in plain.iter().enumerate() {
        let [i, j, k] = [n % nx + 2, n / nx % ny + 2, n / (nx * ny) + 2];
        wide[(i * (ny + 4) + j) * (nz + 4) + k] = f64::from(*v);
    }
    let strides = [((ny + 4) * (nz + 4)) as isize, (nz + 4) as isize, 1];
    let shown = Region { start: [2; 3], size: SIZE };
    let (strided, copied) = frame(&|lit| {
        let block = Strided::of(&wide, with_ghosts).strides(strides).region(shown).origin([-2.0; 3]);
        lit.push(5, Some(5.0), &block).unwrap();
    });
    assert!(strided == expected && copied == 8 * plain.len() as u64);
    let block = Strided::owned(wide, with_ghosts).strides(strides).region(shown).origin([-2.0; 3]);
    let (given, copied) = frame(&|lit| {
        let field = Arc::new(block.clone());
        lit.push_owned(Timestep { step: 5, time: Some(5.0), grid: block.grid(), field }).unwrap();
    });
    assert!(given == expected && copied == 0);
}

/// A sink that holds every step until it is let go.
#[derive(Clone, Default)]
struct Gate(Arc<(Mutex<bool>, Condvar)>);

impl Gate {
    fn open(&self) {
        *self.0.0.lock().unwrap() = true;
        self.0.1.notify_all();
    }
}

impl Sink for Gate {
    fn write(&mut self, _: &Output) -> Result<()> {
        let mut open = self.0.0.lock().unwrap();
        while !*open {
            open = self.0.1.wait(open).unwrap();
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<()> {
        Ok(())
    }
}

/// A slow disk and a full queue: each policy drops the steps it should, and says so.
#[test]
fn a_full_queue_does_what_the_policy_says() {
    let run = |policy| {
        let out = tempfile::tempdir().unwrap();
        let mut scene = scene(out.path(), &[]);
        scene.insitu.policy = policy;
        let gate = Gate::default();
        let lit = InSitu::with(scene).sink(Box::new(gate.clone())).open().unwrap();
        // Held: one step is being written, two wait for the writer, one is lit and has no place; then two wait.
        let mut taken = vec![];
        for step in 0..4 {
            taken.push(lit.push_owned(owned(step)).unwrap());
            std::thread::sleep(std::time::Duration::from_millis(150));
        }
        let waiter = (policy == Policy::Block).then(|| {
            let gate = gate.clone();
            std::thread::spawn(move || {
                std::thread::sleep(std::time::Duration::from_millis(300));
                gate.open();
            })
        });
        for step in 4..10 {
            taken.push(lit.push_owned(owned(step)).unwrap());
        }
        gate.open();
        let stats = lit.close().unwrap();
        waiter.map(|w| w.join());
        let rows = rows(out.path());
        let steps: Vec<u64> = rows.iter().map(|r| r.step).collect();
        assert_eq!(steps, Vec::from_iter(0..10), "every step has a row");
        let dropped: Vec<u64> = rows.iter().filter(|r| r.lost.contains("queue was full")).map(|r| r.step).collect();
        assert_eq!((stats.dropped, stats.lit + stats.dropped, stats.lost), (dropped.len() as u64, 10, 0), "{stats:?}");
        assert_eq!(rows.iter().map(|r| r.drops).max(), Some(stats.dropped));
        let refused: Vec<u64> = (0..).zip(&taken).filter(|(_, t)| **t == Taken::Dropped).map(|(s, _)| s).collect();
        assert_eq!(refused, if policy == Policy::DropNewest { dropped.clone() } else { vec![] });
        (dropped, stats)
    };
    assert_eq!(run(Policy::DropNewest).0, [6, 7, 8, 9]);
    assert_eq!(run(Policy::DropOldest).0, [4, 5, 6, 7]);
    assert_eq!(run(Policy::Coalesce).0, [4, 5, 6, 7]);
    let (dropped, stats) = run(Policy::Block);
    assert!(dropped.is_empty() && stats.longest_held_ms > 100.0, "{stats:?}");
}

struct Panics(u64);

impl Sink for Panics {
    fn write(&mut self, output: &Output) -> Result<()> {
        assert!(output.step != self.0, "a bug in a sink");
        Ok(())
    }

    fn finish(&mut self) -> Result<()> {
        Ok(())
    }
}

struct Broken;

impl Field for Broken {
    fn read(&self, _: Region, _: &mut [f32]) -> Result<()> {
        panic!("a bug in a field")
    }
}

fn opening(out: &Path) -> Opening {
    InSitu::with(scene(out, &["f_{step:03}.png"]))
}

#[test]
fn a_panic_costs_its_step_alone() {
    let out = tempfile::tempdir().unwrap();
    let lit = opening(out.path()).sink(Box::new(Panics(1))).open().unwrap();
    for step in 0..6 {
        let field: Arc<dyn Field> = if step == 3 { Arc::new(Broken) } else { owned(step).field };
        lit.push_owned(Timestep { field, ..owned(step) }).unwrap();
    }
    let stats = lit.close().unwrap();
    assert_eq!((stats.lit, stats.lost), (4, 2), "{stats:?}");
    let rows = rows(out.path());
    let lost: Vec<_> = rows.iter().map(|r| !r.lost.is_empty()).collect();
    assert_eq!(lost, [false, true, false, true, false, false]);
    assert!(rows[1].lost.contains("a bug in a sink") && rows[3].lost.contains("a bug in a field"));
    assert_eq!((&rows[2].start[..], &rows[4].start[..], &rows[5].start[..]), ("warm", "cold", "warm"));
    // The other output has the step whose sink panicked.
    let frames: Vec<u64> = (0..6).filter(|s| out.path().join(format!("f_{s:03}.png")).exists()).collect();
    assert_eq!(frames, [0, 1, 2, 4, 5]);
}

#[test]
fn pushing_after_close_is_refused() {
    let out = tempfile::tempdir().unwrap();
    let lit = opening(out.path()).open().unwrap();
    lit.push_owned(owned(0)).unwrap();
    lit.flush().unwrap();
    assert_eq!(lit.stats().lit, 1);
    let stats = lit.close().unwrap();
    assert!(matches!(lit.push_owned(owned(1)), Err(Error::Closed(_))));
    assert!(matches!(lit.flush(), Err(Error::Closed(_))));
    assert_eq!(lit.close().unwrap(), stats);
}
