#![no_main]
mod file;

libfuzzer_sys::fuzz_target!(|text: &str| file::read("a.raw", &[0x3c; 4096], Some(text)));
