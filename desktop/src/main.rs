//! The `motes` command.

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use motes_desktop::commands::compare;

/// Viewer for 3-D and 4-D Gaussian splatting scenes.
#[derive(Parser)]
#[command(version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Compare(compare::CompareArgs),
}

fn main() -> ExitCode {
    let result = match Cli::parse().command {
        Command::Compare(args) => compare::run(&args).map_err(|e| e.to_string()),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("motes: {message}");
            ExitCode::FAILURE
        }
    }
}
