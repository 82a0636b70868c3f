//! `gloaming devices`: what this machine can compute on, and the choice among it.

use std::io::Write;
use std::sync::Arc;

use clap::Args;
use gloaming::device::Device;
use gloaming::device::cpu::{Cpu, simd};
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
    let automatic = open("auto")?.name();
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

fn adapters() -> Value {
    json!([])
}

fn write_adapters(out: &mut impl Write) -> std::io::Result<()> {
    writeln!(out, "this version computes on the CPU alone")
}

/// The device that `--device` names: `auto` takes a hardware GPU where there is one, else the CPU.
pub fn open(choice: &str) -> gloaming::Result<Arc<dyn Device>> {
    match choice {
        "auto" => match hardware() {
            Some(gpu) => Ok(gpu),
            None => Ok(Arc::new(Cpu::new(0)?)),
        },
        "cpu" => Ok(Arc::new(Cpu::new(0)?)),
        "gpu" => open_gpu(None),
        name => open_gpu(Some(name)),
    }
}

fn hardware() -> Option<Arc<dyn Device>> {
    None
}

fn open_gpu(_: Option<&str>) -> gloaming::Result<Arc<dyn Device>> {
    Err(gloaming::Error::Device("this version computes on the CPU\n  try: --device cpu".into()))
}
