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

#[test]
fn triggers_pick_the_same_steps_after_a_restart() {
    let taken = |sets: &dyn Fn(&mut Scene), steps: std::ops::Range<u64>| {
        let out = tempfile::tempdir().unwrap();
        let mut scene = scene(out.path(), &[]);
        sets(&mut scene);
        let lit = InSitu::with(scene).sink(Box::new(Panics(u64::MAX))).open().unwrap();
        let times = |step| Timestep { time: Some(0.1 * step as f64), ..owned(step) };
        let all = steps.clone().map(|s| (s, lit.push_owned(times(s)).unwrap()));
        let taken: Vec<u64> = all.filter(|(_, t)| *t == Taken::Queued).map(|(s, _)| s).collect();
        let stats = lit.close().unwrap();
        assert_eq!((stats.lit, stats.skipped), (taken.len() as u64, steps.count() as u64 - taken.len() as u64));
        assert_eq!(rows(out.path()).len(), taken.len(), "skipped steps are no losses");
        taken
    };
    assert_eq!(taken(&|s| s.insitu.every = 4, 0..10), [0, 4, 8]);
    assert_eq!(taken(&|s| s.insitu.every = 4, 3..10), [4, 8]);
    // 0.3 is not what 3·0.1 is in binary.
    assert_eq!(taken(&|s| s.insitu.every_time = Some(0.3), 0..10), [0, 3, 6, 9]);
    assert_eq!(taken(&|s| s.insitu.every_time = Some(0.3), 6..10), [6, 9]);
}

/// The medium thickens at every third step.
#[test]
fn a_step_is_rendered_when_its_light_has_changed() {
    let out = tempfile::tempdir().unwrap();
    let run = |change| {
        let mut scene = scene(out.path(), &[]);
        scene.insitu.light_change = change;
        let lit = InSitu::with(scene).sink(Box::new(Panics(u64::MAX))).open().unwrap();
        for step in 0..8u64 {
            let density = vec![0.02 * (1 + step / 3) as f32; SIZE.iter().product()];
            lit.push(step, None, &Strided::of(&density, SIZE)).unwrap();
        }
        let stats = lit.close().unwrap();
        assert_eq!(stats.lit + stats.skipped, 8);
        rows(out.path()).iter().filter(|r| r.frames > 0).map(|r| r.step).collect::<Vec<_>>()
    };
    // Above light.tolerance: within it, light that stays the same still gets better.
    assert_eq!(run(Some(0.01)), [0, 3, 6], "the steps at which anything changes");
    assert_eq!(run(Some(0.9)), [0]);
    assert_eq!(run(None), Vec::from_iter(0..8));
}

#[test]
fn resuming_skips_what_is_complete_and_continues_the_ledger() {
    let out = tempfile::tempdir().unwrap();
    let outputs = ["a/f_{step:03}.png", "b/f_{step:03}.exr"];
    let run = |steps: std::ops::Range<u64>, resume| {
        let mut scene = scene(out.path(), &outputs);
        scene.insitu.resume = resume;
        let lit = InSitu::with(scene).open().unwrap();
        steps.for_each(|s| assert_eq!(lit.push_owned(owned(s)).unwrap(), Taken::Queued));
        let stats = lit.close().unwrap();
        (stats.lit, stats.skipped)
    };
    assert_eq!(run(0..4, false), (4, 0));
    std::fs::remove_file(out.path().join("b/f_002.exr")).unwrap();
    assert_eq!(run(1..6, true), (3, 2), "2 lacks a file, 4 and 5 are new");
    assert!(out.path().join("b/f_002.exr").exists());
    assert_eq!(rows(out.path()).iter().map(|r| r.step).collect::<Vec<_>>(), [0, 1, 2, 3, 4, 5]);
    // Without it, the steps are done again.
    assert_eq!(run(1..3, false), (2, 0));
}

/// A simulation that any interference would show in: a chaotic map, pushed at every step.
fn simulate(steps: std::ops::Range<u64>, mut each: impl FnMut(u64, &[f32])) -> u64 {
    let mut values = values(0);
    for step in steps {
        let total: f32 = values.iter().sum::<f32>() / values.len() as f32;
        values.iter_mut().for_each(|v| *v = 3.7 * *v * (1.0 - *v) * (0.9 + 0.1 * total));
        each(step, &values);
    }
    values.iter().fold(0, |hash, v| (hash ^ u64::from(v.to_bits())).wrapping_mul(0x100000001b3))
}

/// Runs the simulation with a session and whatever `each` does to it, and without. It ends the same; every step has a row; what
/// is lost is counted. Returns the rows.
fn survives(opening: Opening, out: &Path, each: impl Fn(u64)) -> Vec<LedgerRow> {
    let lit = opening.open().unwrap();
    let with = simulate(0..12, |step, values| {
        each(step);
        let _ = lit.push(step, None, &Strided::of(values, SIZE));
        // Where the disk is, the next step finds it.
        let _ = lit.flush();
    });
    let _ = lit.close();
    assert_eq!(with, simulate(0..12, |_, _| ()), "the simulation came out another way");
    let (stats, rows) = (lit.stats(), rows(out));
    assert_eq!(rows.iter().map(|r| r.step).collect::<Vec<_>>(), Vec::from_iter(0..12));
    let lost = rows.iter().filter(|r| !r.lost.is_empty()).count() as u64;
    assert_eq!((stats.pushed, stats.lit, stats.lost, stats.waiting), (12, 12 - lost, lost, 0), "{stats:?}");
    rows
}

fn lost(rows: &[LedgerRow]) -> Vec<u64> {
    rows.iter().filter(|r| !r.lost.is_empty()).map(|r| r.step).collect()
}

#[test]
fn a_folder_that_becomes_unwritable_costs_the_steps_in_between() {
    let out = tempfile::tempdir().unwrap();
    let frames = out.path().join("frames");
    let rows = survives(InSitu::with(scene(out.path(), &["frames/f_{step:03}.png"])), out.path(), |step| match step {
        4 => {
            std::fs::rename(&frames, out.path().join("moved")).unwrap();
            std::fs::write(&frames, "in the way").unwrap();
        }
        7 => {
            std::fs::remove_file(&frames).unwrap();
            std::fs::rename(out.path().join("moved"), &frames).unwrap();
        }
        _ => {}
    });
    assert_eq!(lost(&rows), [4, 5, 6]);
    assert!(rows[4].lost.contains("frames"), "{}", rows[4].lost);
    assert!(frames.join("f_011.png").exists());
}

#[test]
fn what_cannot_be_written_from_the_start_is_told_at_once() {
    let open = |output: &str, ledger: Option<&str>| {
        let mut scene = Scene::parse("", "", &[]).unwrap();
        scene.insitu.outputs = vec![output.into()];
        scene.insitu.ledger = ledger.map(Into::into);
        InSitu::with(scene).open().err().unwrap()
    };
    assert!(matches!(open("/dev/null/frames/f_{step}.png", None), Error::Io { .. }));
    let out = tempfile::tempdir().unwrap();
    let fine = out.path().join("f_{step}.png").to_str().unwrap().to_string();
    assert!(matches!(open(&fine, Some("/dev/null/ledger.csv")), Error::Io { .. }));
    assert!(matches!(open("f.png", None), Error::Format { .. }), "all steps in one file");
    let nothing = InSitu::open("").err().unwrap().to_string();
    assert!(nothing.contains("insitu.outputs"), "{nothing}");
}

/// NaN everywhere, infinities, other sizes, nothing at all.
#[test]
fn odd_steps_do_not_end_the_session() {
    let out = tempfile::tempdir().unwrap();
    let lit = opening(out.path()).open().unwrap();
    let cells = SIZE.iter().product::<usize>();
    let dense = |v: f32| vec![v; cells];
    assert!(lit.push(0, None, &Strided::of(&dense(f32::NAN), SIZE)).is_ok());
    assert!(lit.push(1, Some(f64::INFINITY), &Strided::of(&dense(f32::INFINITY), SIZE)).is_ok());
    assert!(lit.push(2, None, &Strided::of(&dense(0.5), [4, 4, 4])).is_ok(), "the grid shrinks");
    assert!(lit.push(3, None, &Strided::of(&[0.5f32; 0], [4, 0, 4])).is_err(), "a block without values");
    assert!(lit.push(4, None, &Strided::of(&dense(0.5), SIZE)).is_ok(), "and grows again");
    assert!(lit.push(5, None, &Strided::of(&dense(0.5), SIZE).spacing([0.5, 1.0, 2.0])).is_ok());
    let empty = Timestep { grid: Grid::new([0, 3, 3]), ..owned(6) };
    assert!(lit.push_owned(empty).is_err());
    assert!(lit.push(7, None, &Strided::of(&[7u8; 27], [3; 3])).is_ok(), "few values");
    let stats = lit.close().unwrap();
    assert_eq!((stats.pushed, stats.lit, stats.lost), (8, 6, 2), "{stats:?}");
    let rows = rows(out.path());
    assert_eq!(lost(&rows), [3, 6]);
    assert_eq!((rows[0].holes, rows[1].holes), (cells as u64, cells as u64));
    assert!(rows[2].start == "cold" && rows[4].start == "cold");
    let sky = |step: u64| image::open(out.path().join(format!("f_{step:03}.png"))).unwrap().to_rgb8().into_raw();
    assert!(sky(0) == sky(1) && sky(0).iter().all(|v| *v == sky(0)[0]), "nothing to see");
    assert!(sky(4) != sky(0));
}

#[test]
fn pushes_from_several_threads_all_arrive() {
    let out = tempfile::tempdir().unwrap();
    let lit = opening(out.path()).open().unwrap();
    std::thread::scope(|scope| {
        for thread in 0..4 {
            let lit = &lit;
            scope.spawn(move || {
                for n in 0..8 {
                    let (step, values) = (10 * thread + n, values(n));
                    if n % 2 == 0 {
                        lit.push(step, None, &Strided::of(&values, SIZE)).unwrap();
                    } else {
                        lit.push_owned(owned(step)).unwrap();
                    }
                }
            });
        }
    });
    assert_eq!(lit.close().unwrap().lit, 32);
    let expected: Vec<u64> = (0..4).flat_map(|t| 10 * t..10 * t + 8).collect();
    assert_eq!(rows(out.path()).iter().map(|r| r.step).collect::<Vec<_>>(), expected);
}

/// Runs one of the ignored tests below in a process of its own, started through a shell.
fn alone(name: &str, out: &Path, shell: &str) -> std::process::Command {
    let mut command = std::process::Command::new("sh");
    command.arg("-c").arg(shell).arg("sh").arg(std::env::current_exe().unwrap());
    command.args(["--ignored", "--exact", "--nocapture", name]).env("GLOAMING_TEST_OUT", out);
    command
}

fn out_of_parent() -> std::path::PathBuf {
    std::env::var_os("GLOAMING_TEST_OUT").expect("run by another test").into()
}

/// A file system of 96 KiB where one can be mounted, by root or in a name space of one's own; else files of at most 1 KiB.
#[test]
#[cfg(target_os = "linux")]
fn a_full_disk_costs_the_steps_that_do_not_fit() {
    let out = tempfile::tempdir().unwrap();
    let mount = r#"mount -t tmpfs -o size=96k none "$GLOAMING_TEST_OUT""#;
    let possible = |how: &str| alone("", out.path(), how).output().unwrap().status.success();
    let shell = if possible(&format!("unshare -rm sh -c '{mount}'")) {
        format!("exec unshare -rm sh -c '{mount} && exec \"$@\"' sh \"$@\"")
    } else if possible(&format!("unshare -m sh -c '{mount}'")) {
        format!("exec unshare -m sh -c '{mount} && exec \"$@\"' sh \"$@\"")
    } else {
        "trap '' XFSZ; ulimit -f 2; exec \"$@\"".into()
    };
    let limited = shell.starts_with("trap");
    let run =
        alone("disk_full", out.path(), &shell).env("GLOAMING_TEST_LIMITED", limited.to_string()).output().unwrap();
    let said = String::from_utf8_lossy(&run.stderr);
    assert!(run.status.success(), "{}{said}", String::from_utf8_lossy(&run.stdout));
    assert!(said.contains("lost: ") && (said.contains("No space left") || said.contains("too large")), "{said}");
}

#[test]
#[ignore = "run by a_full_disk_costs_the_steps_that_do_not_fit"]
fn disk_full() {
    let out = out_of_parent();
    let limited = std::env::var("GLOAMING_TEST_LIMITED").unwrap() == "true";
    let mut scene = scene(&out, &["f_{step:03}.png", "f_{step:03}.exr", "movie.mp4"]);
    (scene.render.size, scene.render.background) = ([64, 48], [0.2; 3]);
    let lit = InSitu::with(scene).open().unwrap();
    let frames = || std::fs::read_dir(&out).unwrap().map(|e| e.unwrap().path()).filter(|p| p.extension().is_some());
    let mut all_lost = false;
    let hash = simulate(0..60, |step, values| {
        lit.push(step, None, &Strided::of(values, SIZE)).unwrap();
        lit.flush().unwrap();
        if step == 50 {
            all_lost = lit.stats().lost > 0;
            // Somebody makes room.
            let pictures = frames().filter(|p| p.extension().is_some_and(|e| e == "png" || e == "exr"));
            pictures.for_each(|p| std::fs::remove_file(p).unwrap());
        }
    });
    assert_eq!(hash, simulate(0..60, |_, _| ()));
    let lit_before = lit.stats().lit;
    let closed = lit.close();
    let stats = lit.stats();
    assert!(all_lost && stats.lost > 0 && stats.lit + stats.lost == 60, "{stats:?}, {closed:?}");
    for path in frames().filter(|p| p.extension().is_some_and(|e| e == "png")) {
        image::open(&path).unwrap_or_else(|e| panic!("{} is not whole: {e}", path.display()));
    }
    for path in frames().filter(|p| p.extension().is_some_and(|e| e == "exr")) {
        gloaming::sink::exr::read(&path).unwrap();
    }
    assert!(!frames().any(|p| p.file_name().is_some_and(|n| n.to_string_lossy().starts_with(".gloaming"))));
    if !limited {
        let rows = rows(&out);
        assert_eq!(rows.len(), 60, "rows that found no room were written when there was some");
        assert!(rows[51].lost.is_empty() && lit_before > 0, "it goes on where there is room: {:?}", rows[51]);
        assert!(std::fs::metadata(out.join("movie.mp4")).unwrap().len() > 1000);
    }
}

/// Frames that are there are whole, and so is the ledger, whenever the process is killed.
#[test]
#[cfg(unix)]
fn a_killed_process_leaves_whole_frames() {
    let out = tempfile::tempdir().unwrap();
    let mut child = alone("killed", out.path(), r#"exec "$@""#)
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let deadline = std::time::Instant::now() + std::time::Duration::from_secs(60);
    while !out.path().join("f_000005.png").exists() {
        assert!(std::time::Instant::now() < deadline, "no frame came");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let mut whole = 0;
    for entry in std::fs::read_dir(out.path()).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if name.starts_with("f_") {
            assert_eq!(image::open(&path).unwrap().to_rgb8().dimensions(), (640, 480), "{name}");
            whole += 1;
        }
    }
    let rows = rows(out.path()).len();
    assert!(whole >= 6 && (whole - 1..=whole).contains(&rows), "{whole} frames, {rows} rows");
    assert!(std::fs::metadata(out.path().join("movie.partial.mp4")).unwrap().len() > 1000);
}

#[test]
#[ignore = "run by a_killed_process_leaves_whole_frames"]
fn killed() {
    let mut scene = scene(&out_of_parent(), &["f_{step:06}.png", "movie.mp4"]);
    scene.render.size = [640, 480];
    let lit = InSitu::with(scene).open().unwrap();
    simulate(0..1_000_000, |step, values| {
        lit.push(step, None, &Strided::of(values, SIZE)).unwrap();
    });
}

/// 10 000 pushes of 32³ leave no memory, thread or file behind; threads are as many as were asked for, on the cores that were
/// asked for.
#[test]
#[cfg(target_os = "linux")]
fn ten_thousand_pushes_leave_nothing_behind() {
    let out = tempfile::tempdir().unwrap();
    let run = alone("leaks", out.path(), r#"exec "$@""#).output().unwrap();
    let said = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    assert!(run.status.success(), "{}{}", said(&run.stdout), said(&run.stderr));
}

#[test]
#[ignore = "run by ten_thousand_pushes_leave_nothing_behind"]
#[cfg(target_os = "linux")]
fn leaks() {
    let resident = || {
        let text = std::fs::read_to_string("/proc/self/status").unwrap();
        let line = text.lines().find(|l| l.starts_with("VmRSS")).unwrap();
        line.split_whitespace().nth(1).unwrap().parse::<i64>().unwrap()
    };
    let count = |what: &str| std::fs::read_dir(format!("/proc/self/{what}")).unwrap().count();
    let (threads, files) = (count("task"), count("fd"));
    let out = out_of_parent();
    let mut scene = scene(&out, &[]);
    (scene.light.direct_resolution, scene.light.scattering, scene.render.size) = (8.0, false, [8, 8]);
    (scene.insitu.threads, scene.insitu.cores) = (2, vec![0]);
    let lit = InSitu::with(scene).sink(Box::new(Panics(u64::MAX))).open().unwrap();
    let values: Vec<f32> = (0..32 * 32 * 32).map(|i| (i % 97) as f32 / 97.0).collect();
    let mut after_a_hundred = 0;
    for step in 0..10_000 {
        lit.push(step, None, &Strided::of(&values, [32; 3])).unwrap();
        if step == 100 {
            lit.flush().unwrap();
            after_a_hundred = resident();
            let mut ours = vec![];
            for task in std::fs::read_dir("/proc/self/task").unwrap() {
                let read = |file: &str| std::fs::read_to_string(task.as_ref().unwrap().path().join(file)).unwrap();
                let (name, status) = (read("comm"), read("status"));
                if name.starts_with("gloaming") {
                    ours.push(name.trim().to_string());
                    assert!(
                        status.lines().any(|l| l.starts_with("Cpus_allowed_list") && l.ends_with("\t0")),
                        "{status}"
                    );
                }
            }
            ours.sort();
            assert_eq!(ours, ["gloaming-0", "gloaming-1", "gloaming-light", "gloaming-write"]);
            assert_eq!(count("task"), threads + 4, "no pool but ours");
        }
    }
    lit.flush().unwrap();
    let grown = resident() - after_a_hundred;
    assert_eq!(lit.close().unwrap().lit, 10_000);
    // 8 bytes for each step's number, which the ledger needs to find one that is done again, and an allocator's whims.
    assert!(grown < 1024, "grown by {grown} KiB");
    drop(lit);
    // Rayon does not wait for the threads of a pool that is dropped.
    for _ in 0..200 {
        if count("task") == threads {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
    assert_eq!((count("task"), count("fd")), (threads, files));
}

/// A checkpointed scene: a camera that orbits and a tolerance of its own.
fn checkpointed_scene(out: &Path, name: &str, tolerance: f32) -> Scene {
    let mut scene = scene(out, &[&format!("{name}_{{step:03}}.exr")]);
    scene.insitu.ledger = Some(out.join(format!("{name}.csv")));
    scene.light.tolerance = tolerance;
    scene.cameras = vec![gloaming::scene::CameraKeys { orbit: 5.0, ..Default::default() }];
    scene
}

/// A simulation that saves the light beside its restart file and is killed later on: restarted from there it makes the frames that it
/// would have made, warm.
#[test]
#[cfg(unix)]
fn light_that_was_saved_in_between_outlives_the_process() {
    for tolerance in [0.0, 1e-3] {
        let out = tempfile::tempdir().unwrap();
        let run = |scene: Scene, steps: std::ops::Range<u64>| {
            let lit = InSitu::with(scene).open().unwrap();
            steps.for_each(|step| assert_eq!(lit.push_owned(owned(step)).unwrap(), Taken::Queued));
            lit.close().unwrap()
        };
        run(checkpointed_scene(out.path(), "whole", tolerance), 0..9);
        let mut child = alone("checkpointed", out.path(), r#"exec "$@""#)
            .env("GLOAMING_TEST_TOLERANCE", tolerance.to_string())
            .stdout(std::process::Stdio::null())
            .spawn()
            .unwrap();
        let deadline = std::time::Instant::now() + std::time::Duration::from_secs(60);
        while !out.path().join("cut_005.exr").exists() {
            assert!(std::time::Instant::now() < deadline, "no frame came");
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        child.kill().unwrap();
        child.wait().unwrap();
        // What it did after the restart file was written is done again, by the light of that moment; then all is as complete as it
        // can be, and passed over.
        for last in [7, 9] {
            let mut scene = checkpointed_scene(out.path(), "cut", tolerance);
            scene.insitu.light_state = Some(out.path().join("light.h5"));
            scene.insitu.resume = last == 9;
            if scene.insitu.resume {
                std::fs::copy(out.path().join("saved.h5"), out.path().join("light.h5")).unwrap();
            } else {
                std::fs::copy(out.path().join("light.h5"), out.path().join("saved.h5")).unwrap();
                std::fs::remove_file(out.path().join("cut_005.exr")).unwrap();
            }
            run(scene, 4..last);
            if last == 7 {
                let starts = ledger::read(&out.path().join("cut.csv")).unwrap();
                assert!(starts.iter().all(|row| row.start == "warm"), "{starts:?}");
            }
            let frame = |name: &str, step| {
                gloaming::sink::exr::read(&out.path().join(format!("{name}_{step:03}.exr"))).unwrap().pixels
            };
            // Steps that were passed over are not in the light: within the tolerance then, and to the bit at 0.
            let same = if last == 7 || tolerance == 0.0 { 0..last } else { 0..7 };
            for step in same {
                assert!(frame("cut", step) == frame("whole", step), "step {step} at tolerance {tolerance}");
            }
        }
    }
}

#[test]
#[ignore = "run by light_that_was_saved_in_between_outlives_the_process"]
fn checkpointed() {
    let out = out_of_parent();
    let tolerance: f32 = std::env::var("GLOAMING_TEST_TOLERANCE").unwrap().parse().unwrap();
    let lit = InSitu::with(checkpointed_scene(&out, "cut", tolerance)).open().unwrap();
    for step in 0.. {
        lit.push_owned(owned(step)).unwrap();
        if step == 3 {
            lit.save_light(&out.join("light.h5")).unwrap();
            assert!(out.join("cut_003.exr").exists(), "what came before is written");
        }
    }
}

#[test]
fn light_is_saved_every_so_many_steps_and_cannot_be_before_the_first() {
    let out = tempfile::tempdir().unwrap();
    let kept = out.path().join("kept.h5");
    let mut scene = checkpointed_scene(out.path(), "f", 1e-3);
    (scene.insitu.light_state, scene.insitu.light_state_every) = (Some(kept.clone()), Some(2));
    let lit = InSitu::with(scene.clone()).open().unwrap();
    let early = lit.save_light(&out.path().join("early.h5"));
    assert!(matches!(early, Err(Error::Unsupported(_))), "{early:?}");
    let about = |path: &Path| gloaming::light_state::LightState::read(path).unwrap().about;
    for step in 0..3 {
        lit.push_owned(owned(step)).unwrap();
        lit.flush().unwrap();
    }
    assert_eq!((about(&kept).steps, about(&kept).last), (2, Some(1)));
    let nowhere = lit.save_light(Path::new("/dev/null/light.h5"));
    assert!(nowhere.is_err_and(|e| e.to_string().contains("/dev/null")));
    assert_eq!(lit.close().unwrap().lit, 3, "and the session goes on");
    assert_eq!((about(&kept).steps, about(&kept).last), (3, Some(2)));
    assert!(matches!(lit.save_light(&kept), Err(Error::Closed(_))));
    scene.insitu.light_state = None;
    assert!(InSitu::with(scene).open().err().unwrap().to_string().contains("light_state_every"));
}

/// Where no light was kept, the number of frames that there are puts the camera where it belongs. At tolerance 0 a cold start is no other
/// light.
#[test]
fn a_camera_in_orbit_goes_on_from_the_frames_before() {
    let out = tempfile::tempdir().unwrap();
    let frame = |name: &str, before, steps: std::ops::Range<u64>| {
        let mut scene = checkpointed_scene(out.path(), name, 0.0);
        (scene.light.scattering, scene.insitu.steps_before) = (false, before);
        let lit = InSitu::with(scene).open().unwrap();
        let last = steps.end - 1;
        steps.for_each(|step| assert_eq!(lit.push_owned(owned(step)).unwrap(), Taken::Queued));
        lit.close().unwrap();
        gloaming::sink::exr::read(&out.path().join(format!("{name}_{last:03}.exr"))).unwrap().pixels
    };
    let whole = frame("whole", 0, 0..5);
    assert!(frame("on", 3, 3..5) == whole);
    assert!(frame("anew", 0, 3..5) != whole);
}

/// A restarted run goes on where the one before ended: warm, and with the frames of a run that was never cut.
#[test]
fn light_outlives_a_session() {
    let out = tempfile::tempdir().unwrap();
    let run = |name: &str, kept: Option<&str>, steps: std::ops::Range<u64>| {
        let mut scene = scene(out.path(), &[&format!("{name}_{{step:03}}.exr")]);
        scene.light.tolerance = 0.0;
        scene.insitu.light_state = kept.map(|file| out.path().join(file));
        let lit = InSitu::with(scene).open().unwrap();
        steps.clone().for_each(|step| assert_eq!(lit.push_owned(owned(step)).unwrap(), Taken::Queued));
        lit.close().unwrap();
        let starts: Vec<_> = rows(out.path()).iter().map(|r| r.start.clone()).collect();
        let last = out.path().join(format!("{name}_{:03}.exr", steps.end - 1));
        (starts, gloaming::sink::exr::read(&last).unwrap().pixels)
    };
    let (starts, whole) = run("whole", None, 0..4);
    assert_eq!(starts, ["cold", "warm", "warm", "warm"]);
    run("cut", Some("light.h5"), 0..3);
    let (starts, cut) = run("cut", Some("light.h5"), 3..4);
    assert_eq!(starts, ["warm"], "the light of the first run is there");
    assert!(cut == whole);

    let mut paper = scene(out.path(), &["p_{step}.png"]);
    paper.light.model = gloaming::scene::Model::Paper;
    paper.insitu.light_state = Some(out.path().join("paper.h5"));
    let message = InSitu::with(paper).open().err().expect("not kept").to_string();
    assert!(message.contains("physical"), "{message}");
}
