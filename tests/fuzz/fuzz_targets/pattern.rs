#![no_main]

libfuzzer_sys::fuzz_target!(|text: &str| {
    let (typed, path) = text.split_once('\n').unwrap_or((text, text));
    gloaming::fuzz::pattern(typed, path);
});
