//! Where things are in the workspace.

use std::path::{Path, PathBuf};
use std::process::Command;

/// The workspace's root folder.
pub fn root() -> PathBuf {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    here.parent().unwrap_or(here).to_owned()
}

/// Cargo's target folder: `CARGO_TARGET_DIR` where it is set (against the root where it is relative).
pub fn target() -> PathBuf {
    match std::env::var_os("CARGO_TARGET_DIR").filter(|folder| !folder.is_empty()) {
        Some(folder) => root().join(folder),
        None => root().join("target"),
    }
}

/// The cargo that runs us, in the workspace's root, without what `cargo run` put into our environment
/// for this package alone.
pub fn cargo() -> Command {
    let mut command = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    command.current_dir(root());
    without_cargo_run(&mut command);
    command
}

/// Removes what `cargo run` adds to the environment: it speaks of xtask, and build scripts must not see it.
pub fn without_cargo_run(command: &mut Command) {
    for (name, _) in std::env::vars_os() {
        let text = name.to_string_lossy();
        if text.starts_with("CARGO_PKG_") || text.starts_with("CARGO_MANIFEST") || text == "OUT_DIR" {
            command.env_remove(&name);
        }
    }
    if let Some(path) = std::env::var_os("LD_LIBRARY_PATH") {
        let (target, home) = (target(), std::env::var_os("RUSTUP_HOME").map(PathBuf::from));
        let kept: Vec<PathBuf> = std::env::split_paths(&path)
            .filter(|folder| !folder.starts_with(&target))
            .filter(|folder| home.as_ref().is_none_or(|home| !folder.starts_with(home)))
            .filter(|folder| !folder.components().any(|part| part.as_os_str() == "rustlib"))
            .filter(|folder| !folder.components().any(|part| part.as_os_str() == "toolchains"))
            .collect();
        match std::env::join_paths(kept) {
            Ok(path) if !path.is_empty() => command.env("LD_LIBRARY_PATH", path),
            _ => command.env_remove("LD_LIBRARY_PATH"),
        };
    }
}
