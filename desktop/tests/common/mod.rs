//! Starting the program, as the tests of its command line and of its window do.

use std::path::PathBuf;
use std::process::Command;

/// The `motes` program, on the driver that tests run on.
pub fn motes() -> Command {
    let program = env!("CARGO_BIN_EXE_motes");
    match std::env::var_os("MOTES_RUNNER") {
        Some(runner) => {
            let mut command = Command::new(runner);
            command.arg(program);
            command
        }
        None => Command::new(program),
    }
}

/// An empty folder of this test's own.
pub fn folder(name: &str) -> PathBuf {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    folder
}
