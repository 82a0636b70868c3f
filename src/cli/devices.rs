//! `gloaming devices`: what this machine can compute on, and the choice among it.

use std::io::Write;

use clap::Args;
use gloaming::device::cpu::{Cpu, simd};
#[cfg(feature = "gpu")]
use gloaming::device::gpu;
use gloaming::device::{self, Device};
use serde_json::{Value, json};

/// List what this machine can compute on
#[derive(Args)]
#[command(after_help = "\
Examples:
  gloaming devices
  gloaming devices --json
  gloaming render run.h5 --out movie.mp4 --device cpu")]
pub struct DevicesArgs {
    /// JSON for programs
    #[arg(long)]
    json: bool,
}

/// Prints the devices.
pub fn run(args: &DevicesArgs) -> anyhow::Result<()> {
    let cpu = Cpu::new(0)?;
    let (name, threads) = (cpu.name(), cpu.threads());
    let automatic = device::open("auto", 0)?.name();
    let mut out = std::io::stdout().lock();
    if args.json {
        let level = format!("{:?}", simd::level()).to_lowercase();
        let cpu = json!({ "name": name, "simd": level, "threads": threads });
        let all = json!({ "auto": automatic, "cpu": cpu, "adapters": adapters() });
        writeln!(out, "{all:#}")?;
        return Ok(());
    }
    writeln!(out, "{name}")?;
    write_adapters(&mut out)?;
    writeln!(out, "--device auto takes {automatic}")?;
    Ok(())
}

#[cfg(feature = "gpu")]
fn adapters() -> Value {
    json!(gpu::adapters())
}

#[cfg(not(feature = "gpu"))]
fn adapters() -> Value {
    json!([])
}

#[cfg(feature = "gpu")]
fn write_adapters(out: &mut impl Write) -> std::io::Result<()> {
    let adapters = gpu::adapters();
    if adapters.is_empty() {
        writeln!(out, "no GPU, or no driver for it")?;
    }
    for a in adapters {
        let kind = if a.hardware { "hardware" } else { "software" };
        writeln!(out, "{} ({}, {kind}, {})", a.name, a.backend, a.driver)?;
        let mib = |bytes: u64| bytes >> 20;
        writeln!(out, "  buffers up to {} MiB, bound up to {} MiB", mib(a.max_buffer), mib(a.max_binding))?;
        if let Some(lacks) = a.lacks {
            writeln!(out, "  cannot be used: lacks {lacks}")?;
        }
    }
    Ok(())
}

#[cfg(not(feature = "gpu"))]
fn write_adapters(out: &mut impl Write) -> std::io::Result<()> {
    writeln!(out, "built without GPU support (feature `gpu`)")
}

/// Starts the program anew with `XDG_RUNTIME_DIR` set where it is not, as in batch jobs and containers: Vulkan loaders
/// complain on stderr about its absence, in a line that reads like an error of ours. (A process cannot safely change its own
/// environment.)
#[cfg(all(feature = "gpu", unix))]
pub fn silence_loaders() {
    use std::os::unix::process::CommandExt;
    const NEEDED: &str = "XDG_RUNTIME_DIR";
    if std::env::var_os(NEEDED).is_some() {
        return;
    }
    let arguments = std::env::args_os().skip(1);
    let Ok(program) = std::env::current_exe() else { return };
    let why = std::process::Command::new(program).args(arguments).env(NEEDED, std::env::temp_dir()).exec();
    tracing::debug!("cannot start anew: {why}");
}

/// Nothing to silence here.
#[cfg(not(all(feature = "gpu", unix)))]
pub fn silence_loaders() {}
