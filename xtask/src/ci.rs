//! `cargo xtask ci`: everything that a change must pass.

use std::process::{Command, ExitCode};
use std::time::Instant;

use crate::shell::{self, Result, say};
use crate::{android, host, licences, package, test, workspace};

/// Runs every check in order of how fast it fails.
pub fn ci() -> Result<ExitCode> {
    let start = Instant::now();
    host::provide(host::Purpose::Test)?;
    step("format", workspace::cargo().args(["fmt", "--all", "--", "--check"]))?;
    step(
        "lints",
        workspace::cargo().args(["clippy", "--workspace", "--all-targets", "--", "-D", "warnings"]),
    )?;
    step(
        "documentation",
        workspace::cargo()
            .args(["doc", "--workspace", "--no-deps", "--document-private-items"])
            .env("RUSTDOCFLAGS", "-D warnings"),
    )?;
    say("licences");
    licences::check()?;
    if shell::program("cargo-deny").is_some() {
        step("dependencies (cargo-deny)", workspace::cargo().args(["deny", "check"]))?;
    } else {
        say("cargo-deny is not installed: known faults of dependencies are not looked up");
    }
    android::check()?;
    package::apk(&[])?;
    package::check_with_android_tools()?;
    android::emulated::run_where_possible()?;
    say("tests");
    let tests = test::test(&[])?;
    say(&format!("all of it took {} s", start.elapsed().as_secs()));
    Ok(tests)
}

fn step(name: &str, command: &mut Command) -> Result<()> {
    say(name);
    let start = Instant::now();
    shell::run(command)?;
    say(&format!("{name}: passed in {} s", start.elapsed().as_secs()));
    Ok(())
}
