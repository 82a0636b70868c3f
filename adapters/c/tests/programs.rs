//! Programs in C, C++ and Fortran, built with the system's compilers against an installed library, and run.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

// Cargo builds a library for tests that use it.
use gloaming_c as _;

const FOLDER: &str = env!("CARGO_MANIFEST_DIR");

/// An installation under a folder with a space in its name, made once.
fn prefix() -> &'static Path {
    static PREFIX: OnceLock<tempfile::TempDir> = OnceLock::new();
    let folder = PREFIX.get_or_init(|| {
        // Cargo has built the library beside the tests.
        let built = std::env::current_exe().unwrap().parent().unwrap().to_path_buf();
        let folder = tempfile::Builder::new().prefix("gloaming installed ").tempdir().unwrap();
        let script = Path::new(FOLDER).join("install/install.sh");
        ok(Command::new("sh").arg(script).arg(&built).arg(folder.path()));
        folder
    });
    folder.path()
}

/// Runs a program that has to end with 0.
#[track_caller]
fn ok(command: &mut Command) -> Output {
    let output = command.output().unwrap_or_else(|e| {
        panic!("{:?} cannot be run: {e}\n  try: ./x test, which installs what is missing", command.get_program())
    });
    let said = format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{command:?}: {}\n{said}", output.status);
    output
}

fn pkg_config(what: &str) -> Vec<String> {
    let mut command = Command::new("pkg-config");
    command.env("PKG_CONFIG_PATH", prefix().join("lib/pkgconfig")).arg(what).arg("gloaming");
    let said = String::from_utf8(ok(&mut command).stdout).unwrap();
    // pkg-config escapes the space of the folder.
    let escaped = said.trim().replace("\\ ", "\0");
    escaped.split_whitespace().map(|word| word.replace('\0', " ")).collect()
}

/// Compiles a program; libraries are found where they are installed.
fn compile(compiler: &str, flags: &[&str], sources: &[PathBuf], out: &Path) -> PathBuf {
    let program = out.join(sources.last().unwrap().file_stem().unwrap());
    let mut command = Command::new(compiler);
    command.current_dir(out).args(flags).args(pkg_config("--cflags")).args(sources).arg("-o").arg(&program);
    command.args(pkg_config("--libs")).arg(format!("-Wl,-rpath,{}", prefix().join("lib").display())).arg("-lm");
    ok(&mut command);
    program
}

fn example(name: &str) -> PathBuf {
    Path::new(FOLDER).join("examples").join(name)
}

/// A scene file for small, quick pictures in `out`.
fn config(out: &Path, more: &str) -> PathBuf {
    let path = out.join("scene.toml");
    let text = format!(
        "field.range = [0.0, 1.0]\nlight.directions = 8\nrender.size = [48, 32]\n[insitu]\ndevice = 'cpu'\nthreads = 1\n\
         outputs = ['{0}/f_{{step:03}}.png']\nledger = '{0}/ledger.csv'\n{more}\n",
        out.display()
    );
    std::fs::write(&path, text).unwrap();
    path
}

const WARNINGS: &[&str] = &["-O2", "-Wall", "-Wextra", "-Werror"];

fn c(source: PathBuf, out: &Path) -> PathBuf {
    compile("cc", &[WARNINGS, &["-std=c11", "-D_GNU_SOURCE", "-pthread"]].concat(), &[source], out)
}

/// Frames are whole, are not all one colour and are as many as steps; the solver's result is what it is without gloaming.
fn with_and_without(program: &Path, out: &Path, copied: bool) {
    let steps = 6;
    let arguments = ["20".to_string(), steps.to_string()];
    let without = ok(Command::new(program).args(&arguments)).stdout;
    assert!(without.len() > 8, "a result: {without:?}");
    let run = ok(Command::new(program).args(&arguments).arg(config(out, "")));
    let said = String::from_utf8_lossy(&run.stderr);
    assert!(run.stdout == without, "another result with gloaming\n{said}");
    assert!(said.contains("6") && said.contains("steps lit") && said.contains("ratio"), "{said}");
    for step in 0..steps {
        let frame = image::open(out.join(format!("f_{step:03}.png"))).unwrap().to_rgb8();
        // The first steps of a source are faint.
        if step < 3 {
            continue;
        }
        let (dark, light) = frame.pixels().fold((255, 0), |(d, l), p| (p[0].min(d), p[0].max(l)));
        assert!(light > dark + 10, "step {step} shows nothing: {dark} to {light}");
    }
    let rows: Vec<csv::StringRecord> =
        csv::Reader::from_path(out.join("ledger.csv")).unwrap().records().map(|r| r.unwrap()).collect();
    assert_eq!(rows.len(), steps);
    assert!(rows.iter().all(|r| (&r[2] != "0") == copied), "bytes copied: {rows:?}");
}

#[test]
fn heat_in_c() {
    let out = tempfile::tempdir().unwrap();
    with_and_without(&c(example("heat.c"), out.path()), out.path(), true);
}

#[test]
fn waves_in_cpp_are_given_away() {
    let out = tempfile::tempdir().unwrap();
    let program = compile("c++", &[WARNINGS, &["-std=c++14"]].concat(), &[example("wave.cpp")], out.path());
    with_and_without(&program, out.path(), false);
}

/// The solver traps on NaN, and gloaming's threads must not; the installed module is compiled with it.
#[test]
fn advection_in_fortran() {
    let out = tempfile::tempdir().unwrap();
    let module = PathBuf::from(pkg_config("--variable=fortran").concat());
    assert!(module.starts_with(prefix().canonicalize().unwrap()) || module.exists(), "{}", module.display());
    let flags = ["-O2", "-Wall", "-ffpe-trap=invalid,zero,overflow"];
    let program = compile("gfortran", &flags, &[module, example("advect.f90")], out.path());
    with_and_without(&program, out.path(), true);
}

/// The readme's program stands there as it is here, is short, and makes a movie.
#[test]
fn the_readme_program_makes_a_movie() {
    let source = std::fs::read_to_string(example("minimal.c")).unwrap();
    assert!(source.lines().count() < 30);
    let readme = std::fs::read_to_string(Path::new(FOLDER).join("../../README.md")).unwrap();
    assert!(readme.contains(&source), "the readme's C program is not examples/minimal.c");
    let out = tempfile::tempdir().unwrap();
    // Smaller, so that the test does not take as long as the movie.
    let small = out.path().join("small.c");
    let quick = source
        .replace("#define N 64", "#define N 16")
        .replace("step < 48", "step < 4")
        .replace("\"[insitu]\\n\"", "\"render.size = [64, 48]\\n[insitu]\\ndevice = 'cpu'\\n\"");
    assert!(quick != source && quick.contains("64, 48"));
    std::fs::write(&small, quick).unwrap();
    ok(Command::new(c(small, out.path())).current_dir(out.path()));
    let movie = std::fs::read(out.path().join("movie.mp4")).unwrap();
    assert!(&movie[4..8] == b"ftyp" && movie.len() > 500);
    assert_eq!(std::fs::read_to_string(out.path().join("ledger.csv")).unwrap().lines().count(), 5);
}

/// Pictures that cannot be made leave the simulation as it is: it ends with 0 and the same result, and says what is missing.
#[test]
#[cfg(unix)]
fn a_simulation_ends_the_same_whatever_befalls_its_pictures() {
    let out = tempfile::tempdir().unwrap();
    let heat = c(example("heat.c"), out.path());
    let run = |limits: &str, config: Option<&str>| {
        let scene = out.path().join("scene.toml");
        let mut command = Command::new("sh");
        command
            .current_dir(out.path())
            .arg("-c")
            .arg(format!("{limits} exec \"$@\""))
            .arg("sh")
            .arg(&heat)
            .args(["16", "5"]);
        if let Some(config) = config {
            std::fs::write(&scene, config).unwrap();
            command.arg(&scene);
        }
        let output = ok(&mut command);
        (output.stdout, String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let (undisturbed, _) = run("", None);
    let small = "field.range = [0.0, 1.0]\nlight.directions = 8\nrender.size = [160, 120]\n[insitu]\ndevice = 'cpu'\nthreads = 1\n";
    for (limits, keys, said) in [
        ("", "outputs = ['/dev/null/f_{step}.png']", "without pictures: /dev/null"),
        ("", "outputs = ['movie.mp4']\npolicy = 'never'", "drop-oldest"),
        ("", "outputs = ['f_{step}.bmp']", "unknown output format"),
        ("", "outputs = ['movie.mp4']\nledger = '/dev/full'", "without pictures"),
        // Files of 1 KiB at most.
        ("trap '' XFSZ; ulimit -f 2;", "outputs = ['f_{step}.exr', 'movie.mp4']", "0 of 5 steps lit, 5 lost"),
        ("", "outputs = ['f_{step}.png']\npolicy = 'drop-newest'\nqueue = 1", "steps lit"),
    ] {
        let (result, stderr) = run(limits, Some(&format!("{small}{keys}\n")));
        assert!(stderr.contains(said), "{keys}: {stderr}");
        assert!(result == undisturbed, "{keys}: another result");
    }
}

#[test]
fn faults_of_c_programs_are_refused() {
    let out = tempfile::tempdir().unwrap();
    let program = c(Path::new(FOLDER).join("tests/faults.c"), out.path());
    let run = ok(Command::new(&program).arg(config(out.path(), "")));
    assert_eq!(String::from_utf8_lossy(&run.stdout), "faults survived\n");
    let ledger = std::fs::read_to_string(out.path().join("ledger.csv")).unwrap();
    for (step, why) in
        [(1, "type 77"), (2, "strides"), (3, "nothing to light"), (5, "start + size"), (9, "nothing to light")]
    {
        let row = ledger.lines().find(|l| l.starts_with(&format!("{step},"))).unwrap_or_default();
        assert!(row.contains(why) || ledger.contains(why), "step {step}: {row}");
        assert!(String::from_utf8_lossy(&run.stderr).contains(&format!("step {step} lost")), "step {step} on stderr");
    }
}

/// Nothing hangs in a forked process, and the light is in its file when the call returns.
#[test]
#[cfg(unix)]
fn forked_processes_are_refused() {
    let out = tempfile::tempdir().unwrap();
    let program = c(Path::new(FOLDER).join("tests/forked.c"), out.path());
    let light = out.path().join("light.h5");
    let run = ok(Command::new(&program).arg(config(out.path(), "")).arg(&light));
    assert_eq!(String::from_utf8_lossy(&run.stdout), "fork survived\n");
    assert!(String::from_utf8_lossy(&run.stderr).contains("forked from"));
    assert_eq!(gloaming::light_state::LightState::read(&light).unwrap().about.steps, 4);
}

/// What the readme says is typed as it stands there, by a user in a folder of his own.
#[test]
fn the_readmes_commands_build_against_what_was_installed() {
    let out = tempfile::tempdir().unwrap();
    let installed = out.path().join("installed");
    std::os::unix::fs::symlink(prefix(), &installed).unwrap();
    let readme = std::fs::read_to_string(Path::new(FOLDER).join("../../README.md")).unwrap();
    for name in ["heat.c", "held.h", "wave.cpp", "advect.f90"] {
        std::fs::copy(example(name), out.path().join(name)).unwrap();
    }
    let shorter = |program: &str| program.replace("#define N 64", "#define N 12").replace("step < 48", "step < 2");
    std::fs::write(out.path().join("minimal.c"), shorter(&std::fs::read_to_string(example("minimal.c")).unwrap()))
        .unwrap();
    let block = |kind: &str, has: &str| {
        let fence = format!("```{kind}\n");
        let blocks = readme.split(&fence).skip(1).filter_map(|b| b.split("```").next());
        let found = blocks.filter(|b| b.contains(has)).collect::<Vec<_>>();
        assert_eq!(found.len(), 1, "blocks of {kind} with {has}");
        found[0].to_string()
    };
    std::fs::write(out.path().join("CMakeLists.txt"), block("cmake", "find_package(gloaming")).unwrap();
    let typed = block("sh", "PKG_CONFIG_PATH=DIR").replace("DIR", installed.to_str().unwrap());
    assert!(["cc ", "gfortran ", "cmake "].iter().all(|tool| typed.contains(tool)));
    ok(Command::new("sh").current_dir(out.path()).arg("-euc").arg(&typed));
    assert!(std::fs::metadata(out.path().join("movie.mp4")).unwrap().len() > 500);
    for program in ["./advect", "build/wave", "build/heat"] {
        let with_config = ["12", "2", config(out.path(), "").to_str().unwrap()].map(String::from);
        let mut command = Command::new("sh");
        let line = format!("export LD_LIBRARY_PATH=installed/lib; exec {program} \"$@\"");
        let run = ok(command.current_dir(out.path()).arg("-c").arg(line).arg("sh").args(with_config));
        assert!(String::from_utf8_lossy(&run.stderr).contains("steps lit"), "{program}");
    }
}

/// No read or write outside of what was allocated, no use after a release, nothing definitely lost.
#[test]
#[cfg(target_os = "linux")]
fn valgrind_finds_nothing() {
    let out = tempfile::tempdir().unwrap();
    let program = c(Path::new(FOLDER).join("tests/faults.c"), out.path());
    let options = [
        "--quiet",
        "--error-exitcode=9",
        "--leak-check=full",
        "--show-leak-kinds=definite",
        "--errors-for-leak-kinds=definite",
        "--fair-sched=yes",
    ];
    let run = ok(Command::new("valgrind").args(options).arg(&program).arg(config(out.path(), "")));
    assert_eq!(String::from_utf8_lossy(&run.stdout), "faults survived\n");
}

/// `find_package(gloaming)` builds every example, Fortran's too.
#[test]
fn cmake_finds_what_was_installed() {
    let out = tempfile::tempdir().unwrap();
    let build = out.path().join("build");
    let prefix = format!("-DCMAKE_PREFIX_PATH={}", prefix().display());
    ok(Command::new("cmake").arg("-S").arg(Path::new(FOLDER).join("examples")).arg("-B").arg(&build).arg(prefix));
    ok(Command::new("cmake").arg("--build").arg(&build));
    let run = ok(Command::new(build.join("heat")).args(["12", "2"]).arg(config(out.path(), "")));
    assert!(String::from_utf8_lossy(&run.stderr).contains("2 of 2 steps lit"));
    ok(Command::new(build.join("advect")).args(["12", "2"]));
}

/// The static library needs nothing but what gloaming.pc says.
#[test]
fn the_static_library_links() {
    let out = tempfile::tempdir().unwrap();
    let program = out.path().join("heat");
    let private = {
        let text = std::fs::read_to_string(prefix().join("lib/pkgconfig/gloaming.pc")).unwrap();
        let line = text.lines().find_map(|l| l.strip_prefix("Libs.private: ")).unwrap().to_string();
        line.split_whitespace().map(String::from).collect::<Vec<_>>()
    };
    let mut command = Command::new("cc");
    command.args(["-O2", "-std=c11", "-D_GNU_SOURCE"]).arg("-I").arg(prefix().join("include")).arg(example("heat.c"));
    ok(command.arg(prefix().join("lib/libgloaming.a")).args(private).arg("-o").arg(&program));
    let run = ok(Command::new(&program).args(["12", "2"]).arg(config(out.path(), "")));
    assert!(String::from_utf8_lossy(&run.stderr).contains("2 of 2 steps lit"));
}
