//! What is declared to C and Fortran is what the library has.

use std::path::Path;

const FOLDER: &str = env!("CARGO_MANIFEST_DIR");

/// `include/gloaming.h` is what cbindgen makes of the source. `BLESS=1 cargo test -p gloaming-c --test header` writes it anew.
#[test]
fn the_header_is_current() {
    let config = cbindgen::Config::from_file(Path::new(FOLDER).join("cbindgen.toml")).unwrap();
    let bindings = ["lib.rs", "block.rs", "sessions.rs", "status.rs"]
        .iter()
        .fold(cbindgen::Builder::new().with_config(config), |b, file| {
            b.with_src(Path::new(FOLDER).join("src").join(file))
        })
        .generate()
        .unwrap();
    let mut made = Vec::new();
    bindings.write(&mut made);
    // Rules of safety are for Rust; the text above them says the same to C.
    let made = without_safety(&String::from_utf8(made).unwrap());
    let path = Path::new(FOLDER).join("include/gloaming.h");
    if std::env::var_os("BLESS").is_some() {
        std::fs::write(&path, &made).unwrap();
    }
    let checked_in = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(checked_in == made, "include/gloaming.h is not what src says: BLESS=1 writes it anew");
}

/// Turns `# Safety` headings into words that C programmers use.
fn without_safety(header: &str) -> String {
    header.replace(" * # Safety\n", " * The caller promises:\n")
}

/// The numbers of the Fortran module are those of the header.
#[test]
fn fortran_has_the_same_numbers() {
    let read = |name: &str| std::fs::read_to_string(Path::new(FOLDER).join("include").join(name)).unwrap();
    let (header, module) = (read("gloaming.h"), read("gloaming.f90"));
    let mut count = 0;
    for line in header.lines() {
        let mut words = line.split_whitespace();
        let (Some("#define"), Some(name), Some(value)) = (words.next(), words.next(), words.next()) else { continue };
        count += 1;
        let declared = module.lines().filter(|l| l.contains("parameter, public ::"));
        let mut declared = declared.flat_map(|l| l.split("::").nth(1).unwrap_or_default().split(','));
        let wanted = format!("{name} = {value}");
        assert!(declared.any(|d| d.trim() == wanted), "gloaming.f90 lacks {wanted}");
    }
    assert_eq!(count, 13 + 11, "codes and types");
}
