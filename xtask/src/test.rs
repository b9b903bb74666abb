//! `cargo xtask test`, `stability` and `run-on-driver`.

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, ExitStatus};

use crate::shell::{self, Failure, Result, say};
use crate::{driver, host, workspace};

/// Runs the tests on the pinned driver; the arguments go to `cargo test`.
pub fn test(arguments: &[String]) -> Result<ExitCode> {
    host::provide(host::Purpose::Test)?;
    let driver = driver::provide()?;
    say(&format!("tests run on {}", driver.description()));
    let mut cargo = workspace::cargo();
    cargo.arg("test");
    if !names_packages(arguments) {
        cargo.arg("--workspace");
    }
    cargo.args(arguments);
    driver.apply(&mut cargo);
    scenes(&mut cargo);
    Ok(code(shell::status(&mut cargo)?))
}

/// Runs one program, or cargo with the programs that it starts, on the pinned driver.
pub fn run_on_driver(arguments: &[String]) -> Result<ExitCode> {
    let arguments = arguments.strip_prefix(&["--".to_owned()]).unwrap_or(arguments);
    let Some((name, rest)) = arguments.split_first() else {
        return Err(Failure::new("name a command, such as: cargo xtask run-on-driver -- cargo bench"));
    };
    let driver = driver::provide()?;
    let mut command = if Path::new(name).file_stem().is_some_and(|stem| stem == "cargo") {
        let mut cargo = workspace::cargo();
        driver.apply(&mut cargo);
        cargo
    } else {
        let program = if name.contains('/') { Some(PathBuf::from(name)) } else { shell::program(name) };
        let program = program.filter(|file| file.is_file());
        let program = program.ok_or_else(|| Failure::new(format!("there is no program {name:?}")))?;
        let mut command = driver.command(&program);
        workspace::without_cargo_run(&mut command);
        command
    };
    command.args(rest);
    scenes(&mut command);
    Ok(code(shell::status(&mut command)?))
}

/// Measures the hard cases on the pinned driver and writes the stability report.
pub fn stability() -> Result<ExitCode> {
    host::provide(host::Purpose::Test)?;
    let driver = driver::provide()?;
    say(&format!("measured on {}", driver.description()));
    let mut cargo = workspace::cargo();
    cargo.args(["run", "--package", "motes-tests", "--bin", "stability", "--", "docs"]);
    driver.apply(&mut cargo);
    scenes(&mut cargo);
    Ok(code(shell::status(&mut cargo)?))
}

/// Whether `cargo test` is told which packages to test.
fn names_packages(arguments: &[String]) -> bool {
    arguments.iter().take_while(|argument| *argument != "--").any(|argument| {
        let short = argument.starts_with("-p") && !argument.starts_with("--");
        let option = argument.split('=').next().unwrap_or_default();
        short || ["--package", "--workspace", "--all", "--manifest-path"].contains(&option)
    })
}

/// Says where the large sample scenes are, and tells the tests.
fn scenes(command: &mut Command) {
    const NAME: &str = "MOTES_SCENES";
    if let Some(folder) = std::env::var_os(NAME).filter(|folder| !folder.is_empty()) {
        say(&format!("sample scenes: {} ({NAME})", PathBuf::from(folder).display()));
        return;
    }
    let usual = workspace::root().join("../shared/scenes");
    match usual.canonicalize() {
        Ok(folder) => {
            say(&format!("sample scenes: {}", folder.display()));
            command.env(NAME, folder);
        }
        Err(_) => say(&format!(
            "the sample scenes are not at {}: tests that need them will fail; set {NAME} to their folder",
            usual.display()
        )),
    }
}

/// The exit code of another program as our own.
pub fn code(status: ExitStatus) -> ExitCode {
    match status.code().map(u8::try_from) {
        Some(Ok(code)) => ExitCode::from(code),
        _ => ExitCode::FAILURE,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packages_are_seen_before_the_double_dash_only() {
        let says = |line: &str| names_packages(&line.split(' ').map(str::to_owned).collect::<Vec<_>>());
        assert!(says("-p motes-scenes"));
        assert!(says("-pmotes-scenes"));
        assert!(says("--package=motes-scenes name"));
        assert!(says("--workspace"));
        assert!(!says("name -- -p x"));
        assert!(!says("--profile release"));
    }
}
