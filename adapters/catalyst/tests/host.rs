//! The library as a simulation loads it: `solver.c`, an instrumented time loop, with `libcatalyst.c` in the place of Catalyst's
//! library, or with the real one where the environment variable `GLOAMING_LIBCATALYST` names it
//! (`GLOAMING_LIBCATALYST=/usr/lib/libcatalyst.so.3 cargo test -p gloaming-catalyst`).
#![cfg(target_os = "linux")]

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use gloaming::insitu::{InSitu, Strided};
use gloaming::scene::Scene;
use gloaming::{Region, ledger};
use tempfile::TempDir;

/// What the tests run: built once, and kept until all are done.
struct Built {
    folder: TempDir,
    libcatalyst: PathBuf,
}

fn built() -> &'static Built {
    static BUILT: OnceLock<Built> = OnceLock::new();
    BUILT.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let (sources, at) =
            (Path::new(env!("CARGO_MANIFEST_DIR")).join("tests"), |name: &str| folder.path().join(name));
        let compile = |arguments: &[&str], source: &str, to: &Path| {
            let cc = std::env::var("CC").unwrap_or_else(|_| "cc".into());
            let mut cc = Command::new(cc);
            // No fused operations, so that the values are those that this test computes.
            cc.args(["-std=gnu11", "-O1", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off"]).args(arguments);
            let done = cc.arg(sources.join(source)).arg("-o").arg(to).arg("-ldl").output().unwrap();
            assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        };
        compile(&[], "solver.c", &at("solver"));
        let libcatalyst = match std::env::var_os("GLOAMING_LIBCATALYST") {
            Some(real) => real.into(),
            None => {
                let stand_in = at("libcatalyst.so.3");
                compile(&["-shared", "-fPIC", "-Wl,-soname,libcatalyst.so.3"], "libcatalyst.c", &stand_in);
                stand_in
            }
        };
        let beside = std::env::current_exe().unwrap().parent().unwrap().join("libcatalyst_gloaming.so");
        std::fs::copy(&beside, at("libcatalyst-gloaming.so")).unwrap();
        Built { folder, libcatalyst }
    })
}

/// What a run of the simulation left.
struct Run {
    said: String,
    errors: String,
}

impl Run {
    /// The statuses of the calls of a name, in order.
    fn statuses(&self, call: &str) -> Vec<i32> {
        let of = |line: &str| line.split_once(call)?.1.trim().parse().ok();
        self.said.lines().filter_map(of).collect()
    }
}

/// Runs the simulation, which has to reach its end whatever happens.
fn simulate(mode: &str, scenario: &str, script: &[&str], environment: &[(&str, &str)]) -> Run {
    let Built { folder, libcatalyst } = built();
    let mut solver = Command::new(folder.path().join("solver"));
    solver.arg(libcatalyst).args([mode, scenario]).args(script);
    for name in ["GLOAMING_CONFIG", "OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "MV2_COMM_WORLD_SIZE", "SLURM_STEP_NUM_TASKS"] {
        solver.env_remove(name);
    }
    solver.env("CATALYST_IMPLEMENTATION_NAME", "gloaming").env("CATALYST_IMPLEMENTATION_PATHS", folder.path());
    let done = solver.envs(environment.iter().copied()).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let run = Run { said: text(&done.stdout), errors: text(&done.stderr) };
    assert!(done.status.success(), "{scenario}: {}\n{}\n{}", done.status, run.said, run.errors);
    run
}

/// A scene that writes to a folder.
fn config(out: &Path, range: [f64; 2], more: &str) -> String {
    let (out, [lo, hi]) = (out.display(), range);
    format!(
        "field.range = [{lo:?}, {hi:?}]\n{more}\n[render]\nsize = [40, 30]\n[light]\ndirections = 8\n\
         [insitu]\ndevice = \"cpu\"\nthreads = 1\noutputs = [\"{out}/frame_{{step:03}}.png\", \"{out}/light_{{step:03}}.raw\"]\nledger = \"{out}/ledger.csv\"\n"
    )
}

const SIZE: [usize; 3] = [12, 10, 8];

/// The solver's values in step `n`.
fn values(n: usize) -> Vec<f64> {
    let at = |i: usize, centre: f64| (i as f64 - centre) / 4.0;
    let [nx, ny, nz] = SIZE;
    let places = (0..nx * ny * nz).map(|p| [p % nx, p / nx % ny, p / (nx * ny)]);
    places
        .map(|[i, j, k]| {
            let [x, y, z] = [at(i, 6.0 + n as f64), at(j, 5.0), at(k, 4.0)];
            1.0 / (1.0 + x * x + y * y + z * z)
        })
        .collect()
}

/// The bytes of a step's frame and illuminated volume, and the text that says where and when that is.
fn frame(out: &Path, step: u64) -> [Vec<u8>; 3] {
    [format!("frame_{step:03}.png"), format!("light_{step:03}.raw"), format!("light_{step:03}.xmf")].map(|name| {
        let path = out.join(name);
        std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
    })
}

/// Runs a scenario, and the same through the Rust interface: the frames are the same files.
fn compare(
    mode: &str,
    scenario: &str,
    steps: [u64; 3],
    range: [f64; 2],
    push: impl Fn(&InSitu, u64, Option<f64>, Vec<f64>),
) {
    let here = tempfile::tempdir().unwrap();
    let (theirs, ours) = (here.path().join("theirs"), here.path().join("ours"));
    let script = here.path().join("scene.toml");
    std::fs::write(&script, config(&theirs, range, "")).unwrap();
    let run = simulate(mode, scenario, &[script.to_str().unwrap()], &[]);
    assert_eq!(run.statuses("catalyst_initialize"), [0], "{}", run.errors);
    assert_eq!(run.statuses("catalyst_execute"), [0, 0, 0], "{}", run.errors);
    assert_eq!(run.statuses("catalyst_finalize"), [0], "{}", run.errors);
    assert!(run.said.contains("pushed some\ncatalyst_about 0\nimplementation gloaming\n"), "{}", run.said);

    let lit = InSitu::with(Scene::parse(&config(&ours, range, ""), "test", &[]).unwrap()).open().unwrap();
    for (n, step) in steps.into_iter().enumerate() {
        let time = (scenario != "no_state").then_some(0.5 * n as f64);
        push(&lit, step, time, values(n));
    }
    lit.close().unwrap();
    for step in steps {
        assert!(frame(&theirs, step) == frame(&ours, step), "{scenario}, step {step}: the frames differ");
    }
    let rows = ledger::read(&theirs.join("ledger.csv")).unwrap();
    assert_eq!(
        rows.iter().map(|r| (r.step, r.lost.as_str())).collect::<Vec<_>>(),
        steps.map(|s| (s, "")),
        "{scenario}"
    );
}

fn as_is(lit: &InSitu, step: u64, time: Option<f64>, values: Vec<f64>) {
    lit.push(step, time, &Strided::of(&values, SIZE)).unwrap();
}

#[test]
fn blocks_give_the_frames_of_the_rust_interface() {
    compare("global", "vertex", [0, 10, 20], [0.0, 1.0], as_is);
    compare("global", "strided", [0, 10, 20], [0.0, 1.0], as_is);
    compare("global", "packed", [0, 10, 20], [0.0, 1.0], as_is);
    compare("global", "cycle", [0, 10, 20], [0.0, 1.0], as_is);
    compare("global", "no_state", [0, 1, 2], [0.0, 1.0], as_is);
}

#[test]
fn a_library_that_was_loaded_for_the_simulation_alone_is_found() {
    compare("local", "vertex", [0, 10, 20], [0.0, 1.0], as_is);
}

#[test]
fn elements_sit_between_vertices() {
    compare("global", "element", [0, 10, 20], [0.0, 1.0], |lit, step, time, values| {
        let values: Vec<f32> = values.iter().map(|v| *v as f32).collect();
        // Half a spacing beyond the first vertex; spacing along z is 1 by default.
        let block = Strided::of(&values, SIZE).spacing([0.5, 0.25, 1.0]).origin([-3.0 + 0.25, 0.5 + 0.125, 2.0 + 0.5]);
        lit.push(step, time, &block).unwrap();
    });
}

#[test]
fn integers_are_taken_as_they_are() {
    compare("global", "int16", [0, 10, 20], [0.0, 1000.0], |lit, step, time, values| {
        let values: Vec<i16> = values.iter().map(|v| (v * 1000.0) as i16).collect();
        lit.push(step, time, &Strided::of(&values, SIZE)).unwrap();
    });
    compare("global", "uint8", [0, 10, 20], [0.0, 255.0], |lit, step, time, values| {
        let values: Vec<u8> = values.iter().map(|v| (v * 255.0) as u8).collect();
        lit.push(step, time, &Strided::of(&values, SIZE)).unwrap();
    });
}

#[test]
fn ghost_layers_are_left_out_and_single_ghosts_are_holes() {
    compare("global", "ghosts", [0, 10, 20], [0.0, 1.0], |lit, step, time, mut values| {
        values[(4 * SIZE[1] + 5) * SIZE[0] + 6] = f64::NAN;
        let shown = Region { start: [2, 1, 0], size: [9, 9, 6] };
        lit.push(step, time, &Strided::of(&values, SIZE).region(shown)).unwrap();
    });
}

#[test]
fn what_is_wrong_with_one_step_is_a_status_and_the_next_goes_on() {
    let here = tempfile::tempdir().unwrap();
    let out = here.path().join("out");
    let script = here.path().join("scene.toml");
    std::fs::write(&script, config(&out, [0.0, 1.0], "")).unwrap();
    let run = simulate("global", "faults", &[script.to_str().unwrap()], &[]);
    let (format, unsupported) = (102, 104);
    let expected = [
        ("no_channels", format),
        ("listed", format),
        ("multimesh", unsupported),
        ("amr", unsupported),
        ("rectilinear", unsupported),
        ("no_dims", format),
        ("text_dims", format),
        ("negative_dims", format),
        ("no_field", format),
        ("no_topology", format),
        ("text_values", format),
        ("short", format),
        ("no_values", format),
        ("two_fields", format),
        ("two_channels", format),
        ("null", format),
    ];
    for (fault, status) in expected {
        assert!(
            run.said.contains(&format!("{fault}: catalyst_execute {status}\n")),
            "{fault}\n{}\n{}",
            run.said,
            run.errors
        );
    }
    assert_eq!(run.statuses("catalyst_execute").iter().filter(|s| **s == 0).count(), expected.len(), "{}", run.said);
    // Each says what was wrong where, and what would help.
    for said in [
        "catalyst/channels: missing",
        "a channel of type `multimesh`",
        "a channel of type `amrmesh`",
        "coordsets/coords: of type `rectilinear`",
        "coords/dims/j: missing",
        "dims/j: a string, not numbers",
        "-8 vertices along z",
        "topologies/elsewhere: missing",
        "values: a string, not numbers",
        "959 values, where the mesh has 12×10×8 = 960",
        "density/values: missing",
        "grid/density, grid/pressure",
        "grid/density, other/density",
        "field.name = \"channel/field\"",
    ] {
        assert!(run.errors.contains(said), "{said} is not in\n{}", run.errors);
    }
    assert_eq!(run.statuses("catalyst_finalize"), [110]);
    assert!(run.said.contains("error step "), "{}", run.said);

    let rows = ledger::read(&out.join("ledger.csv")).unwrap();
    let lost: Vec<_> = rows.iter().filter(|r| !r.lost.is_empty()).map(|r| r.step).collect();
    assert_eq!(lost.len(), expected.len(), "{lost:?}");
    for n in 0..expected.len() as u64 {
        frame(&out, 10 * n);
    }
}

#[test]
fn a_field_is_picked_by_name() {
    let here = tempfile::tempdir().unwrap();
    for (scenario, name, status) in [
        ("two_fields", "density", 0),
        ("two_fields", "grid/pressure", 0),
        ("two_fields", "other/density", 102),
        ("two_channels", "other/density", 0),
        ("two_channels", "density", 102),
        ("vertex", "temperature", 102),
    ] {
        let script = here.path().join("scene.toml");
        std::fs::write(&script, config(&here.path().join("out"), [0.0, 1.0], &format!("field.name = \"{name}\"")))
            .unwrap();
        let run = simulate("global", scenario, &[script.to_str().unwrap()], &[]);
        assert_eq!(run.statuses("catalyst_execute"), [status; 3], "{scenario}, {name}: {}", run.errors);
    }
}

#[test]
fn the_configuration_comes_from_a_script_or_the_environment() {
    let here = tempfile::tempdir().unwrap();
    let out = here.path().join("out");
    let script = here.path().join("scene.toml");
    let text = config(&out, [0.0, 1.0], "");
    std::fs::write(&script, &text).unwrap();
    let script = script.to_str().unwrap();

    // {filename, args}: the arguments override keys.
    let run = simulate("global", "vertex", &[script, "insitu.every=20"], &[]);
    assert_eq!(run.statuses("catalyst_execute"), [0; 3], "{}", run.errors);
    assert!(out.join("frame_020.png").exists() && !out.join("frame_010.png").exists());
    std::fs::remove_dir_all(&out).unwrap();

    // The simulation knows only of another implementation's script.
    let run = simulate("global", "vertex", &["pipeline.py"], &[("GLOAMING_CONFIG", script)]);
    assert_eq!(run.statuses("catalyst_execute"), [0; 3], "{}", run.errors);
    frame(&out, 10);

    let fails = |scripts: &[&str], environment: &[(&str, &str)], status: i32, said: &str| {
        let run = simulate("global", "vertex", scripts, environment);
        assert_eq!(run.statuses("catalyst_initialize"), [status], "{}", run.errors);
        assert_eq!(run.statuses("catalyst_execute"), [107; 3], "{}", run.errors);
        assert_eq!(run.statuses("catalyst_finalize"), [107], "{}", run.errors);
        assert!(run.errors.contains(said), "{said} is not in\n{}", run.errors);
    };
    fails(&[], &[], 102, "no configuration");
    fails(&["pipeline.py"], &[], 102, "no .toml file, only pipeline.py");
    fails(&["nowhere.toml"], &[], 101, "nowhere.toml");
    fails(&[script, "light.directons=8"], &[], 103, "directions");

    // Several processes would write the same files.
    let mpi = [("OMPI_COMM_WORLD_SIZE", "2"), ("OMPI_COMM_WORLD_RANK", "1")];
    fails(&[script], &mpi, 104, "{rank}");
    std::fs::write(script, text.replace("out/", "out/rank{rank}_")).unwrap();
    let run = simulate("global", "vertex", &[script], &mpi);
    assert_eq!(run.statuses("catalyst_finalize"), [0], "{}", run.errors);
    assert!(out.join("rank1_frame_010.png").exists());
}

/// A path in what is executed: the light of the steps so far is in the file when the call returns.
#[test]
fn light_is_saved_where_the_simulation_says() {
    let here = tempfile::tempdir().unwrap();
    let (script, light) = (here.path().join("scene.toml"), here.path().join("light.h5"));
    std::fs::write(&script, config(&here.path().join("out"), [0.0, 1.0], "")).unwrap();
    let run = simulate("global", "checkpoint", &[script.to_str().unwrap()], &[("LIGHT", light.to_str().unwrap())]);
    // The last one is no path: the step is taken all the same.
    assert_eq!(run.statuses("catalyst_execute"), [0, 0, 102], "{}", run.errors);
    assert!(run.errors.contains("catalyst/gloaming/save_light"), "{}", run.errors);
    let about = gloaming::light_state::LightState::read(&light).unwrap().about;
    assert_eq!((about.steps, about.last), (2, Some(10)));
    assert_eq!(run.statuses("catalyst_finalize"), [0], "{}", run.errors);
}

#[test]
fn calls_out_of_order_are_told() {
    let here = tempfile::tempdir().unwrap();
    let script = here.path().join("scene.toml");
    std::fs::write(&script, config(&here.path().join("out"), [0.0, 1.0], "")).unwrap();
    let run = simulate("global", "twice", &[script.to_str().unwrap()], &[]);
    // The second time it may be the loader that refuses.
    assert!(matches!(run.statuses("catalyst_initialize")[..], [0, 107 | 1..=99]), "{}", run.said);
    assert_eq!(run.statuses("catalyst_execute"), [0; 3], "{}", run.errors);
    assert!(matches!(run.statuses("catalyst_finalize")[..], [0, 107 | 1..=99]), "{}", run.said);
}

#[test]
fn a_full_disk_or_a_folder_that_cannot_be_written_does_not_stop_the_simulation() {
    let here = tempfile::tempdir().unwrap();
    let script = here.path().join("scene.toml");
    // A file stands where the folder should be.
    std::fs::write(here.path().join("out"), "").unwrap();
    std::fs::write(&script, config(&here.path().join("out"), [0.0, 1.0], "")).unwrap();
    let run = simulate("global", "vertex", &[script.to_str().unwrap()], &[]);
    assert_eq!(run.statuses("catalyst_initialize"), [101], "{}", run.errors);
    assert!(run.said.contains("simulated 3 steps"), "{}", run.said);
}
