#![no_main]

libfuzzer_sys::fuzz_target!(|input: (u64, &str)| gloaming::fuzz::template(input.1, input.0));
