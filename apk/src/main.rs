//! `motes-apk`: the packer as a program. `cargo xtask apk` calls it; it is of use alone for an APK that exists.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use motes_apk::Package;
use motes_apk::error::{Error, Result};
use motes_apk::inspect;
use motes_apk::key::Key;

const HELP: &str = "\
motes-apk pack --manifest FILE --version-name TEXT --version-code NUMBER --library FILE
               [--loader FILE] [--asset NAME=FILE]... [--key FILE] -o FILE
    Packs an APK; signs it where a key file is named (the key is made when there is no such file).
motes-apk check FILE [--asset NAME]...
    Reads an APK back, and fails where a headset would not take it.
";

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let result = match arguments.split_first() {
        Some((command, rest)) if command == "pack" => pack(rest),
        Some((command, rest)) if command == "check" => check(rest),
        _ => {
            eprint!("{HELP}");
            return ExitCode::FAILURE;
        }
    };
    match result {
        Ok(code) => code,
        Err(error) => {
            eprintln!("motes-apk: {error}");
            ExitCode::FAILURE
        }
    }
}

fn usage(problem: String) -> Error {
    Error::malformed("command line", format!("{problem}\n{HELP}"))
}

fn pack(arguments: &[String]) -> Result<ExitCode> {
    let (mut package, mut key, mut output) = (Package::default(), None, None);
    let mut words = arguments.iter();
    while let Some(option) = words.next() {
        let value = words.next().ok_or_else(|| usage(format!("{option} wants a value")))?;
        let file = || PathBuf::from(value);
        match option.as_str() {
            "--manifest" => package.manifest = file(),
            "--version-name" => package.version_name.clone_from(value),
            "--version-code" => {
                package.version_code = value.parse().map_err(|_| usage(format!("{value:?} is no number")))?;
            }
            "--library" => package.library = file(),
            "--loader" => package.loader = Some(file()),
            "--asset" => {
                let (name, file) =
                    value.split_once('=').ok_or_else(|| usage(format!("{value:?} has no `=`")))?;
                package.assets.push((name.to_owned(), file.into()));
            }
            "--key" => key = Some(file()),
            "-o" => output = Some(file()),
            other => return Err(usage(format!("there is no option {other:?}"))),
        }
    }
    let output = output.ok_or_else(|| usage("-o FILE is missing".into()))?;
    let key = key.as_deref().map(key_at).transpose()?;
    let apk = package.pack(key.as_ref())?;
    if let Some(folder) = output.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder).map_err(Error::file(folder))?;
    }
    std::fs::write(&output, apk).map_err(Error::file(&output))?;
    Ok(ExitCode::SUCCESS)
}

fn key_at(file: &Path) -> Result<Key> {
    let (key, is_new) = Key::at(file)?;
    if is_new {
        eprintln!(
            "motes-apk: made a new debug key: {}. Keep it: updates must be signed with it",
            file.display()
        );
    }
    Ok(key)
}

fn check(arguments: &[String]) -> Result<ExitCode> {
    let (mut file, mut assets) = (None, Vec::new());
    let mut words = arguments.iter();
    while let Some(word) = words.next() {
        if word == "--asset" {
            assets.push(words.next().cloned().ok_or_else(|| usage("--asset wants a name".into()))?);
        } else if file.replace(PathBuf::from(word)).is_some() {
            return Err(usage(format!("one file at a time: {word:?}")));
        }
    }
    let file = file.ok_or_else(|| usage("name an APK".into()))?;
    let apk = std::fs::read(&file).map_err(Error::file(&file))?;
    let report = inspect::check(&apk, &assets)?;
    report.facts.iter().for_each(|fact| println!("  {fact}"));
    report.problems.iter().for_each(|problem| println!("  WRONG: {problem}"));
    println!("{}: {} bytes, {} problems", file.display(), apk.len(), report.problems.len());
    Ok(if report.problems.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
