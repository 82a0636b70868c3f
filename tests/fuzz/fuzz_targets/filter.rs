#![no_main]

libfuzzer_sys::fuzz_target!(|input: (u8, u16, &[u8])| gloaming::fuzz::filter(input.0, input.1, input.2));
