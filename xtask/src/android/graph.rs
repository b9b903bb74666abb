//! Nothing of C or C++ may be in the application: it could not be linked without an NDK.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use crate::android::{PACKAGE, TARGET, target};
use crate::shell::{self, Context, Failure, Result, say};
use crate::workspace;

/// Crates that build scripts use to compile or find C and C++.
const NATIVE_BUILDERS: &[&str] =
    &["cc", "cmake", "bindgen", "pkg-config", "vcpkg", "autotools", "meson-next"];

/// Crates whose build script could compile C++ but does not with the features that are on here, and why.
const EXCEPTIONS: &[(&str, &str)] =
    &[("android-activity", "compiles C++ only with its feature game-activity; we use native-activity")];

/// Looks through the dependency graph.
///
/// The shader compiler (glslang, C++) is a dependency of `motes-shaders`' *build script*: it runs on the
/// machine that builds and leaves only SPIR-V words in the application, so what is below it does not count.
pub fn check() -> Result<()> {
    let application = tree(&["--edges", "normal,no-proc-macro"], PACKAGE)?;
    let mut culprits = Vec::new();
    for builder in NATIVE_BUILDERS {
        // Those who depend on the builder directly. Not all builders occur; cargo calls that an error.
        let Ok(users) = tree(&["--edges", "normal,build", "--depth", "1", "--invert", builder], PACKAGE)
        else {
            continue;
        };
        culprits.extend(
            forbidden(&application, &users).into_iter().map(|user| format!("{user} (uses {builder})")),
        );
    }
    if culprits.is_empty() {
        say(&format!(
            "none of the {} crates in the Android application is built from C or C++",
            application.len()
        ));
        return Ok(());
    }
    Err(Failure::new(format!(
        "in the application for Android there are crates that compile C or C++:\n  {}\nLeave them out, or choose \
         features that need none. `cargo tree -p {PACKAGE} --target {TARGET} -i CRATE` shows who asks for them",
        culprits.join("\n  ")
    )))
}

/// The users of a native builder that are part of the application and no exceptions.
fn forbidden(application: &BTreeSet<String>, users: &BTreeSet<String>) -> Vec<String> {
    users
        .iter()
        .filter(|user| !NATIVE_BUILDERS.contains(&user.as_str()) && application.contains(*user))
        .filter(|user| !EXCEPTIONS.iter().any(|(name, _)| name == user))
        .cloned()
        .collect()
}

/// The names in a `cargo tree`.
fn tree(options: &[&str], package: &str) -> Result<BTreeSet<String>> {
    let mut cargo = workspace::cargo();
    cargo.args(["tree", "--locked", "--package", package, "--target", TARGET, "--prefix", "none"]);
    cargo.args(["--format", "{p}"]).args(options);
    let output = shell::quietly(&mut cargo)?;
    Ok(names(&String::from_utf8_lossy(&output.stdout)))
}

fn names(listed: &str) -> BTreeSet<String> {
    listed
        .lines()
        .filter_map(|line| line.split(' ').next())
        .filter(|name| !name.is_empty())
        .map(str::to_owned)
        .collect()
}

/// What the build scripts of crates in the application left behind: no object, no archive. This holds whatever
/// a build script says about itself.
pub fn nothing_native_was_built() -> Result<()> {
    let folder = target().join(TARGET).join("android/build");
    let mut found = Vec::new();
    collect_native(&folder, &mut found)?;
    match found.first() {
        None => Ok(()),
        Some(file) => Err(Failure::new(format!(
            "a build script compiled native code for Android: {}\nThe application must be Rust alone",
            file.display()
        ))),
    }
}

fn collect_native(folder: &Path, found: &mut Vec<PathBuf>) -> Result<()> {
    if !folder.is_dir() {
        return Ok(());
    }
    for entry in fs::read_dir(folder).context(|| format!("cannot read {}", folder.display()))? {
        let path = entry.context(|| format!("cannot read {}", folder.display()))?.path();
        if path.is_dir() {
            collect_native(&path, found)?;
        } else if path.extension().is_some_and(|kind| kind == "o" || kind == "a" || kind == "so") {
            found.push(path);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_crate_with_c_in_the_application_is_found() {
        let application =
            names("motes-android v0.1.0 (/x)\nzstd-sys v2\nandroid-activity v0.6.1\nmotes-shaders v0.1.0\n");
        let users = names("cc v1\nzstd-sys v2\nglslang-sys v0.9\nandroid-activity v0.6.1\n");
        assert_eq!(forbidden(&application, &users), ["zstd-sys"]);
        let harmless = names("cc v1\nglslang-sys v0.9\n");
        assert!(forbidden(&application, &harmless).is_empty());
    }

    #[test]
    fn the_exception_does_not_use_its_c() {
        let features = {
            let mut cargo = workspace::cargo();
            cargo.args([
                "tree",
                "--package",
                PACKAGE,
                "--target",
                TARGET,
                "--prefix",
                "none",
                "--format",
                "{p} {f}",
            ]);
            String::from_utf8(shell::quietly(&mut cargo).unwrap().stdout).unwrap()
        };
        let lines: Vec<&str> =
            features.lines().filter(|line| line.starts_with("android-activity ")).collect();
        assert!(!lines.is_empty());
        for line in lines {
            assert!(line.contains("native-activity") && !line.contains("game-activity"), "{line}");
        }
    }

    #[test]
    fn native_files_are_found_at_any_depth() {
        let folder = std::env::temp_dir().join(format!("motes-xtask-native-{}", std::process::id()));
        fs::create_dir_all(folder.join("a/out")).unwrap();
        fs::write(folder.join("a/out/x.rs"), "").unwrap();
        let mut found = Vec::new();
        collect_native(&folder, &mut found).unwrap();
        assert!(found.is_empty());
        fs::write(folder.join("a/out/libx.a"), "").unwrap();
        collect_native(&folder, &mut found).unwrap();
        assert_eq!(found, [folder.join("a/out/libx.a")]);
        fs::remove_dir_all(&folder).unwrap();
    }
}
