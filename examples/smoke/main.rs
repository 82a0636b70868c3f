//! gloaming linked into a simulation's output loop: `cargo run --release --example smoke [OUT [SIZE [STEPS]]]`.
//!
//! What the coupling takes is in `coupling.rs`; `simulation/` is a small solver of its own that knows nothing of gloaming.

mod coupling;
mod simulation;

use std::path::PathBuf;

use anyhow::{Context, Result};

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let out = PathBuf::from(arguments.next().unwrap_or("smoke".into()));
    let mut number = |default| match arguments.next() {
        Some(text) => text.parse().with_context(|| format!("{text}: not a number")),
        None => Ok(default),
    };
    let (size, steps) = (number(64)?, number(96)?);

    let stats = coupling::run(&out, size, steps, |done| eprintln!("step {done} of {steps}"))?;
    println!("{} steps lit, {} lost; see {}", stats.lit, stats.lost, out.display());
    Ok(())
}
