//! The `motes` command.

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use motes_desktop::commands::{
    animate, bench, compare, device, digest, golden, info, label, lod, optimize, render, view, xr,
};

/// Viewer for 3-D and 4-D Gaussian splatting scenes.
#[derive(Parser)]
#[command(version, args_conflicts_with_subcommands = true)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    view: view::ViewArgs,
}

#[derive(Subcommand)]
enum Command {
    Info(info::InfoArgs),
    Render(Box<render::RenderArgs>),
    Animate(animate::AnimateArgs),
    Compare(compare::CompareArgs),
    Bench(bench::BenchArgs),
    Golden(golden::GoldenArgs),
    Digest(digest::DigestArgs),
    Device(device::DeviceReportArgs),
    Label(label::LabelArgs),
    Lod(lod::LodArgs),
    Optimize(optimize::OptimizeArgs),
    Xr(xr::XrArgs),
}

fn main() -> ExitCode {
    let Cli { command, view } = Cli::parse();
    // Which runtime, headset and extensions are in use is what users of a headset need to tell.
    let filter = match command {
        Some(Command::Xr(_)) => {
            "warn,motes_xr=info,motes_app::governor=info,motes_renderer::pipeline_cache=info"
        }
        None => "error,motes_app::governor=info,motes_renderer::pipeline_cache=warn",
        Some(_) => "error",
    };
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or(filter)).init();
    let result = match command {
        None => view::run(&view).map_err(|e| e.to_string()),
        Some(Command::Info(args)) => info::run(&args).map_err(|e| e.to_string()),
        Some(Command::Render(args)) => render::run(&args).map_err(|e| e.to_string()),
        Some(Command::Animate(args)) => animate::run(&args).map_err(|e| e.to_string()),
        Some(Command::Compare(args)) => compare::run(&args).map_err(|e| e.to_string()),
        Some(Command::Bench(args)) => bench::run(&args).map_err(|e| e.to_string()),
        Some(Command::Device(args)) => device::run(&args).map_err(|e| e.to_string()),
        Some(Command::Digest(args)) => digest::run(&args).map_err(|e| e.to_string()),
        Some(Command::Golden(args)) => golden::run(&args).map_err(|e| e.to_string()),
        Some(Command::Label(args)) => label::run(&args).map_err(|e| e.to_string()),
        Some(Command::Lod(args)) => lod::run(&args).map_err(|e| e.to_string()),
        Some(Command::Optimize(args)) => optimize::run(&args).map_err(|e| e.to_string()),
        Some(Command::Xr(args)) => match xr::run(&args) {
            Ok(xr::Outcome::Shown) => Ok(()),
            Ok(xr::Outcome::Window(reason)) => {
                eprintln!("motes: {reason}. A window opens instead");
                xr::open_window(&args).map_err(|e| e.to_string())
            }
            Err(e) => Err(e.to_string()),
        },
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
