//! The system libraries of an Android device, as far as the application may use them.
//!
//! Without an NDK there is nothing to link against, so stubs are made: shared libraries that have the symbols
//! of `android/system-symbols.txt` and no code. The list carries the API level since which each symbol exists,
//! so a link that succeeds says more than with an NDK: nothing newer than the oldest supported device is used.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use crate::shell::{self, Context, Failure, Result};
use crate::workspace;

/// Where the list is, from the workspace's root.
const LIST: &str = "android/system-symbols.txt";

/// What to do when the linker misses a symbol.
pub const ADVICE: &str = "If the linker says `undefined symbol`: the application uses something of Android that is \
     not in android/system-symbols.txt.\nAdd it there with the API level since which the system has it, if that is \
     at most the minSdkVersion of android/AndroidManifest.xml; otherwise find it with dlsym at run time, or do \
     without.";

/// Symbols by library, of systems up to a level.
type Libraries = BTreeMap<String, Vec<String>>;

fn list() -> Result<String> {
    let file = workspace::root().join(LIST);
    std::fs::read_to_string(&file).context(|| format!("cannot read {}", file.display()))
}

/// Writes the stubs for devices of an API level.
pub fn write_stubs(lld: &Path, folder: &Path, minimum_api: u32) -> Result<()> {
    // Rust's standard library asks for the NDK's unwinder by this name; `unwinding` takes its place.
    let nothing = folder.join("libunwind.a");
    shell::write_if_changed(&nothing, "!<arch>\n")?;
    for (library, symbols) in parse(&list()?, minimum_api)? {
        let script = folder.join(&library).with_extension("ld");
        let content: String = symbols.iter().map(|name| format!("{name} = 0;\n")).collect();
        shell::write_if_changed(&script, content)?;
        let mut link = Command::new(lld);
        link.args(["-m", "aarch64linux", "-shared", "-soname", &library, "-o"]).arg(folder.join(&library));
        shell::quietly(link.arg(&nothing).arg(&script))?;
    }
    Ok(())
}

fn parse(list: &str, up_to: u32) -> Result<Libraries> {
    let mut libraries = Libraries::new();
    for (number, line) in list.lines().enumerate() {
        let mut words = line.split_whitespace();
        let Some(library) = words.next().filter(|word| !word.starts_with('#')) else { continue };
        let level: u32 = words.next().and_then(|word| word.parse().ok()).ok_or_else(|| {
            Failure::new(format!("{LIST}:{}: after the library comes an API level, a number", number + 1))
        })?;
        let symbols = libraries.entry(library.to_owned()).or_default();
        if level <= up_to {
            symbols.extend(words.map(str::to_owned));
        }
    }
    Ok(libraries)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn newer_symbols_are_left_out() {
        let text = "# libx.so 1 no\nlibc.so 23 abort close\nlibc.so 30 statx\n\nliblog.so 21 w\n";
        let old = parse(text, 29).unwrap();
        assert_eq!(old["libc.so"], ["abort", "close"]);
        assert_eq!(parse(text, 30).unwrap()["libc.so"], ["abort", "close", "statx"]);
        assert_eq!(old.keys().collect::<Vec<_>>(), ["libc.so", "liblog.so"]);
    }

    #[test]
    fn a_line_without_a_level_is_named() {
        let text = parse("libc.so 23 a\nlibc.so abort\n", 30).unwrap_err().to_string();
        assert!(text.contains(":2:"), "{text}");
    }

    #[test]
    fn the_list_names_the_five_libraries_and_no_symbol_twice() {
        let all = parse(&list().unwrap(), u32::MAX).unwrap();
        assert!(all.keys().eq(["libandroid.so", "libc.so", "libdl.so", "liblog.so", "libm.so"]));
        let mut names: Vec<&String> = all.values().flatten().collect();
        let count = names.len();
        names.sort();
        names.dedup();
        assert_eq!(names.len(), count, "a symbol is listed twice");
    }
}
