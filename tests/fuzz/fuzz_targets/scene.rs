#![no_main]

use gloaming::scene::Scene;

libfuzzer_sys::fuzz_target!(|text: &str| {
    // The first line is an override, as `--set` gives one.
    let (set, file) = text.split_once('\n').unwrap_or(("", text));
    let sets: Vec<String> = set.split(' ').filter(|s| !s.is_empty()).map(String::from).collect();
    let _ = Scene::parse(file, "scene.toml", &sets);
});
