//! The `motes` command.

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use motes_desktop::commands::{bench, compare, golden, info, render};

/// Viewer for 3-D and 4-D Gaussian splatting scenes.
#[derive(Parser)]
#[command(version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Info(info::InfoArgs),
    Render(render::RenderArgs),
    Compare(compare::CompareArgs),
    Bench(bench::BenchArgs),
    Golden(golden::GoldenArgs),
}

fn main() -> ExitCode {
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or("error")).init();
    let result = match Cli::parse().command {
        Command::Info(args) => info::run(&args).map_err(|e| e.to_string()),
        Command::Render(args) => render::run(&args).map_err(|e| e.to_string()),
        Command::Compare(args) => compare::run(&args).map_err(|e| e.to_string()),
        Command::Bench(args) => bench::run(&args).map_err(|e| e.to_string()),
        Command::Golden(args) => golden::run(&args).map_err(|e| e.to_string()),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("motes: {message}");
            ExitCode::FAILURE
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    /// Two options of one name would only be found when somebody uses the command.
    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }
}
