//! Running other programs, and saying what happens.

use std::ffi::OsStr;
use std::fmt;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Output, Stdio};

/// What went wrong and what to do about it, in one text for a person.
#[derive(Debug)]
pub struct Failure(String);

impl Failure {
    pub fn new(text: impl Into<String>) -> Self {
        Self(text.into())
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.0)
    }
}

impl std::error::Error for Failure {}

pub type Result<T, E = Failure> = std::result::Result<T, E>;

/// Adds to a system error what was being done when it happened.
pub trait Context<T> {
    fn context(self, doing: impl FnOnce() -> String) -> Result<T>;
}

impl<T, E: fmt::Display> Context<T> for std::result::Result<T, E> {
    fn context(self, doing: impl FnOnce() -> String) -> Result<T> {
        self.map_err(|error| Failure::new(format!("{}: {error}", doing())))
    }
}

/// One line for the person who waits. Standard output stays free for what a command returns.
pub fn say(text: &str) {
    eprintln!("xtask: {text}");
}

/// The command as a person would type it.
pub fn shown(command: &Command) -> String {
    let mut words = vec![command.get_program().to_string_lossy().into_owned()];
    words.extend(command.get_args().map(|word| {
        let word = word.to_string_lossy();
        if word.is_empty() || word.contains(|c: char| c.is_whitespace() || "'\"$&|;<>()".contains(c)) {
            format!("'{}'", word.replace('\'', "'\\''"))
        } else {
            word.into_owned()
        }
    }));
    words.join(" ")
}

/// Runs with the terminal's own input and output.
pub fn status(command: &mut Command) -> Result<ExitStatus> {
    command.status().context(|| format!("cannot start `{}`", shown(command)))
}

/// Runs with the terminal's own input and output; anything but success is a failure.
pub fn run(command: &mut Command) -> Result<()> {
    let status = status(command)?;
    if status.success() {
        return Ok(());
    }
    Err(Failure::new(format!("`{}` ended with {status}", shown(command))))
}

/// Runs silently; on failure the last lines that the program printed are part of the message.
pub fn quietly(command: &mut Command) -> Result<Output> {
    let output =
        command.stdin(Stdio::null()).output().context(|| format!("cannot start `{}`", shown(command)))?;
    if output.status.success() {
        return Ok(output);
    }
    let mut text = String::from_utf8_lossy(&output.stdout).into_owned();
    text.push_str(&String::from_utf8_lossy(&output.stderr));
    let lines: Vec<&str> = text.lines().filter(|line| !line.trim().is_empty()).collect();
    let last = lines[lines.len().saturating_sub(15)..].join("\n  ");
    Err(Failure::new(format!("`{}` ended with {}:\n  {last}", shown(command), output.status)))
}

/// What the program prints on standard output, without the final newline; `None` where it is missing or fails.
pub fn answer(command: &mut Command) -> Option<String> {
    let output = command.stdin(Stdio::null()).stderr(Stdio::null()).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| text.trim_end().to_owned())
}

/// Where a program is on the search path.
pub fn program(name: &str) -> Option<PathBuf> {
    let path = std::env::var_os("PATH")?;
    std::env::split_paths(&path).map(|folder| folder.join(name)).find(|file| is_executable(file))
}

#[cfg(unix)]
fn is_executable(file: &Path) -> bool {
    use std::os::unix::fs::PermissionsExt;
    file.metadata().is_ok_and(|data| data.is_file() && data.permissions().mode() & 0o111 != 0)
}

#[cfg(not(unix))]
fn is_executable(file: &Path) -> bool {
    file.is_file() || file.with_extension("exe").is_file()
}

/// Writes a file only where its content changes, and whole or not at all, since several runs may share it.
pub fn write_if_changed(file: &Path, content: impl AsRef<[u8]>) -> Result<()> {
    let content = content.as_ref();
    if std::fs::read(file).is_ok_and(|old| old == content) {
        return Ok(());
    }
    let beside = with_suffix(file, format!(".{}", std::process::id()));
    let write = || -> std::io::Result<()> {
        if let Some(folder) = file.parent() {
            std::fs::create_dir_all(folder)?;
        }
        std::fs::write(&beside, content)?;
        std::fs::rename(&beside, file)
    };
    write().context(|| format!("cannot write {}", file.display()))
}

/// `a/b.so` and `.new` make `a/b.so.new`.
pub fn with_suffix(file: &Path, suffix: impl AsRef<OsStr>) -> PathBuf {
    let mut name = file.as_os_str().to_owned();
    name.push(suffix);
    name.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_is_shown_as_one_would_type_it() {
        let mut command = Command::new("cargo");
        command.args(["test", "--", "a b", "it's"]);
        assert_eq!(shown(&command), r"cargo test -- 'a b' 'it'\''s'");
    }

    #[test]
    #[cfg(unix)]
    fn a_failing_program_is_quoted_in_the_message() {
        let mut command = Command::new("sh");
        command.args(["-c", "echo out; echo no room >&2; exit 3"]);
        let text = quietly(&mut command).unwrap_err().to_string();
        assert!(text.contains("no room") && text.contains("out") && text.contains('3'), "{text}");
        assert!(quietly(Command::new("sh").args(["-c", "exit 0"])).is_ok());
        assert_eq!(answer(Command::new("sh").args(["-c", "echo yes"])).as_deref(), Some("yes"));
        assert_eq!(answer(Command::new("sh").args(["-c", "echo yes; exit 1"])), None);
        assert_eq!(answer(&mut Command::new("no-such-program-anywhere")), None);
    }
}
