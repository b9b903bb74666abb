//! The linker: the NDK's compiler driver, or a front end over the linker that comes with Rust.
//!
//! rustc speaks to a C compiler when it links for Android. Without an NDK there is none, so a copy of this
//! program under another name takes its place: it drops what is meant for a compiler and hands the rest on.

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use crate::android;
use crate::shell::{self, Context, Failure, Result};

/// The name under which this program is the linker. rustc guesses from it how to speak: it must look like a
/// C compiler's.
const NAME: &str = "motes-android-cc";
/// The environment variable that tells it where the real linker is.
pub const LLD: &str = "MOTES_ANDROID_LLD";

/// Puts a copy of this program beside the Android build and returns where.
pub fn front_end() -> Result<PathBuf> {
    let own = std::env::current_exe().context(|| "cannot find this program's own file".into())?;
    let copy = android::target().join(format!("{NAME}{}", std::env::consts::EXE_SUFFIX));
    let program = std::fs::read(&own).context(|| format!("cannot read {}", own.display()))?;
    shell::write_if_changed(&copy, program)?;
    let rights = own.metadata().context(|| format!("cannot read {}", own.display()))?.permissions();
    std::fs::set_permissions(&copy, rights)
        .context(|| format!("cannot make {} executable", copy.display()))?;
    Ok(copy)
}

/// Links, where this process was started under the linker's name.
pub fn run_if_named() -> Option<ExitCode> {
    let mut words = std::env::args();
    let name = PathBuf::from(words.next()?);
    if name.file_stem()? != NAME {
        return None;
    }
    let linked = std::env::var_os(LLD)
        .ok_or_else(|| {
            Failure::new(format!("{LLD} is not set: this program is started by `cargo xtask apk` only"))
        })
        .and_then(|lld| shell::status(Command::new(lld).args(linker_arguments(words))));
    Some(match linked {
        Ok(status) => crate::test::code(status),
        Err(failure) => {
            eprintln!("{NAME}: {failure}");
            ExitCode::FAILURE
        }
    })
}

/// Arguments for a C compiler as arguments for the linker itself.
fn linker_arguments(words: impl Iterator<Item = String>) -> Vec<String> {
    let mut arguments = vec!["-m".to_owned(), "aarch64linux".to_owned()];
    let mut words = words.peekable();
    while let Some(word) = words.next() {
        if let Some(list) = word.strip_prefix("-Wl,") {
            arguments.extend(list.split(',').map(str::to_owned));
        } else if word == "-Xlinker" {
            arguments.extend(words.next());
        } else if let Some(file) = word.strip_prefix('@') {
            // rustc uses a response file where the line would be too long; the linker reads it, but the
            // words in it are for a compiler as well.
            match std::fs::read_to_string(file) {
                Ok(text) => {
                    arguments.extend(linker_arguments(text.lines().map(unquoted)).into_iter().skip(2))
                }
                Err(_) => arguments.push(word),
            }
        } else if !is_for_a_compiler(&word) {
            arguments.push(word);
        }
    }
    arguments
}

/// rustc writes one argument a line and escapes blanks and backslashes.
fn unquoted(line: &str) -> String {
    let mut text = String::with_capacity(line.len());
    let mut characters = line.trim_matches('"').chars();
    while let Some(character) = characters.next() {
        text.extend(if character == '\\' { characters.next() } else { Some(character) });
    }
    text
}

fn is_for_a_compiler(word: &str) -> bool {
    ["-nodefaultlibs", "-nostartfiles", "-nostdlib", "-pthread", "-m64"].contains(&word)
        || word.starts_with("-fuse-ld=")
        || word.starts_with("--target=")
}

/// The NDK's compiler driver for the oldest system that the application runs on.
pub fn of_ndk(ndk: &Path, minimum_api: u32) -> Result<PathBuf> {
    let prebuilt = ndk.join("toolchains/llvm/prebuilt");
    let name = format!("aarch64-linux-android{minimum_api}-clang{}", if cfg!(windows) { ".cmd" } else { "" });
    let hosts = std::fs::read_dir(&prebuilt).context(|| format!("cannot read {}", prebuilt.display()))?;
    let found = hosts.flatten().map(|host| host.path().join("bin").join(&name)).find(|file| file.is_file());
    found.ok_or_else(|| {
        Failure::new(format!("{} has no {name}: an NDK of release 25 or newer is needed", prebuilt.display()))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn translated(line: &str) -> String {
        linker_arguments(line.split(' ').map(str::to_owned)).join(" ")
    }

    #[test]
    fn what_is_for_a_compiler_is_dropped() {
        assert_eq!(
            translated(
                "-Wl,-z,defs -nodefaultlibs a.o -Xlinker --as-needed -lc -fuse-ld=lld --target=x -o b.so"
            ),
            "-m aarch64linux -z defs a.o --as-needed -lc -o b.so"
        );
    }

    #[test]
    fn response_files_are_opened() {
        let file = std::env::temp_dir().join(format!("motes-xtask-response-{}", std::process::id()));
        std::fs::write(&file, "-Wl,-z,defs\na\\ b.o\n-nodefaultlibs\n").unwrap();
        assert_eq!(translated(&format!("@{} -lc", file.display())), "-m aarch64linux -z defs a b.o -lc");
        std::fs::remove_file(&file).unwrap();
    }
}
