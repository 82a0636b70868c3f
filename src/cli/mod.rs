//! The command line: commands, exit status, and how errors and messages are printed.
//!
//! Results go to stdout, everything else to stderr. Each command is one file here.

use std::io::IsTerminal;
use std::panic::AssertUnwindSafe;
use std::process::ExitCode;

use clap::{Args, Parser, Subcommand};
use gloaming::Error;

mod compare;
mod composite;
mod demo;
mod devices;
mod histogram;
mod info;
mod parse;
mod progress;
mod render;
mod savings;
mod series;

/// Physically lit movies of time-varying volumes: each light solve starts from the previous step's light.
#[derive(Parser)]
#[command(name = "gloaming", version, max_term_width = 110, arg_required_else_help = true, after_help = AFTER_HELP)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    loudness: Loudness,
}

const AFTER_HELP: &str = "\
Examples:
  gloaming demo
  gloaming devices
  gloaming render run/plt_*.h5 --out movie.mp4

Exit status: 0 done; 1 failed; 2 wrong usage, also by a scene file; 3 done with losses (steps that
could not be read or lit, or an interruption: listed on stderr and in the ledger).";

#[derive(Subcommand)]
enum Command {
    Render(Box<render::RenderArgs>),
    Info(InfoArgs),
    Savings(Box<savings::SavingsArgs>),
    Histogram(Box<histogram::HistogramArgs>),
    Compare(compare::CompareArgs),
    Composite(composite::CompositeArgs),
    Demo(demo::DemoArgs),
    Devices(devices::DevicesArgs),
}

/// Show what is in a series: layout, fields, grid, steps
#[derive(Args)]
#[command(after_help = "\
Examples:
  gloaming info run.h5
  gloaming info run/plt_*.h5 --field density --stats
  gloaming info run.h5 --probe 12,40,7 --json
  gloaming info dump_*.raw --raw dims=96x96x96,dtype=f64le")]
struct InfoArgs {
    #[command(flatten)]
    series: series::SeriesArgs,
    /// Read the values: least, greatest, mean, standard deviation, and how many are valid
    #[arg(long)]
    stats: bool,
    /// Value at a voxel, counted from 0
    #[arg(long, value_name = "X,Y,Z", value_parser = parse::triple::<usize>)]
    probe: Option<[usize; 3]>,
    /// JSON for programs
    #[arg(long)]
    json: bool,
}

/// How much is said on stderr.
#[derive(Args, Clone, Copy)]
struct Loudness {
    /// Say nothing but errors and losses
    #[arg(short, long, global = true, conflicts_with = "verbose", display_order = 1000)]
    quiet: bool,
    /// Say more; -vv says even more
    #[arg(short, long, global = true, action = clap::ArgAction::Count, display_order = 1001)]
    verbose: u8,
}

impl Loudness {
    /// The filter of log messages; `RUST_LOG` overrides it.
    fn filter(self) -> tracing_subscriber::EnvFilter {
        let level = match (self.quiet, self.verbose) {
            (true, _) => "error",
            (false, 0) => "gloaming=info,warn",
            (false, 1) => "gloaming=debug,info",
            (false, _) => "gloaming=trace,debug",
        };
        tracing_subscriber::EnvFilter::try_from_default_env().unwrap_or_else(|_| level.into())
    }
}

/// How a command ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Done {
    /// Everything was done.
    Whole,
    /// Some of it was lost; what and why has been said.
    WithLosses,
}

/// Runs the program.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    if matches!(cli.command, Command::Render(_) | Command::Savings(_) | Command::Devices(_)) {
        devices::silence_loaders();
    }
    let bars = indicatif::MultiProgress::new();
    tracing_subscriber::fmt()
        .with_env_filter(cli.loudness.filter())
        .with_writer(progress::above(bars.clone()))
        .with_ansi(std::io::stderr().is_terminal())
        .without_time()
        .with_target(false)
        .init();
    // What a panic says comes back as an error that names the step; where it happened is for those who ask.
    std::panic::set_hook(Box::new(|panic| tracing::debug!("{panic}")));
    let done = std::panic::catch_unwind(AssertUnwindSafe(|| match cli.command {
        Command::Render(args) => render::run(*args, cli.loudness.quiet, bars),
        Command::Info(args) => info::run(&args.series.spec(), args.stats, args.probe, args.json).map(|()| Done::Whole),
        Command::Savings(args) => savings::run(*args, cli.loudness.quiet, &bars),
        Command::Histogram(args) => histogram::run(*args),
        Command::Compare(args) => compare::run(&args).map(|()| Done::Whole),
        Command::Composite(args) => composite::run(&args).map(|()| Done::Whole),
        Command::Demo(args) => demo::run(&args, cli.loudness.quiet, &bars),
        Command::Devices(args) => devices::run(&args).map(|()| Done::Whole),
    }));
    let bug = |_| Err(Error::Bug("gloaming panicked; -v says where".into()).into());
    match done.unwrap_or_else(bug) {
        Ok(Done::Whole) => ExitCode::SUCCESS,
        Ok(Done::WithLosses) => ExitCode::from(3),
        Err(e) if reader_left(&e) => ExitCode::SUCCESS,
        Err(e) => {
            eprintln!("error: {}", chain(&e));
            ExitCode::from(status(&e))
        }
    }
}

/// True when stdout was closed by whoever read it, `head` for instance.
fn reader_left(e: &anyhow::Error) -> bool {
    e.downcast_ref::<std::io::Error>().is_some_and(|e| e.kind() == std::io::ErrorKind::BrokenPipe)
}

/// 2 for what the user wrote, 1 for everything else.
fn status(e: &anyhow::Error) -> u8 {
    if matches!(e.downcast_ref::<Error>(), Some(Error::Scene { .. })) { 2 } else { 1 }
}

/// An error and its causes, each said once: some messages quote their cause already.
fn chain(e: &anyhow::Error) -> String {
    e.chain().map(ToString::to_string).fold(String::new(), |said, cause| match said.as_str() {
        "" => cause,
        so_far if so_far.contains(&cause) => said,
        so_far => format!("{so_far}: {cause}"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn a_cause_that_was_quoted_is_not_repeated() {
        let inner = Error::io("a/b.toml", std::io::Error::from(std::io::ErrorKind::NotFound));
        let said = chain(&anyhow::Error::new(inner).context("reading the scene"));
        assert_eq!(said, "reading the scene: a/b.toml: entity not found");
    }

    #[test]
    fn what_the_user_wrote_is_wrong_usage_even_inside_a_context() {
        assert_eq!(status(&anyhow::Error::new(Error::scene("light.model", "no")).context("reading")), 2);
        assert_eq!(status(&Error::Device("none".into()).into()), 1);
    }
}
