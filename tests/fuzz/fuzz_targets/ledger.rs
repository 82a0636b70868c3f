#![no_main]
mod file;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    for name in ["l.csv", "l.json"] {
        let path = file::place(name);
        std::fs::write(&path, bytes).expect("the file is written");
        let _ = gloaming::ledger::read(&path);
    }
});
