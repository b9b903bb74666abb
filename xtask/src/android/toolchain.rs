//! Finds a Rust toolchain that can compile for Android.
//!
//! Android's standard library comes ready-made with rustup (`rustup target add`), or is built from its
//! source, with rustup's component `rust-src` or with Debian's packages.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::android::TARGET;
use crate::shell::{self, Failure, Result};
use crate::{host, workspace};

/// Where the standard library comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Std {
    ReadyMade,
    FromSource,
}

/// What the toolchain must be able to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    Check,
    LinkWithNdk,
    /// The ready-made standard library needs the NDK's unwinder, so here it is built from source.
    LinkWithStubs,
}

#[derive(Debug)]
pub struct Toolchain {
    /// For people.
    pub description: String,
    pub std: Std,
    /// Debian's own compiler; `None` for the toolchain that runs us.
    debian: Option<Debian>,
}

#[derive(Debug)]
struct Debian {
    cargo: &'static str,
    rustc: &'static str,
}

const DEBIAN: Debian = Debian { cargo: "/usr/bin/cargo", rustc: "/usr/bin/rustc" };
const DEBIAN_PACKAGES: &[&str] = &["rustc-web", "cargo-web", "rust-web-src"];

impl Toolchain {
    pub fn cargo(&self) -> Command {
        let Some(debian) = &self.debian else { return workspace::cargo() };
        let mut cargo = Command::new(debian.cargo);
        cargo.current_dir(workspace::root());
        workspace::without_cargo_run(&mut cargo);
        for of_rustup in ["RUSTUP_TOOLCHAIN", "CARGO", "RUSTDOC", "LD_LIBRARY_PATH"] {
            cargo.env_remove(of_rustup);
        }
        cargo.env("RUSTC", debian.rustc);
        cargo
    }

    /// The linker that comes with Rust.
    pub fn lld(&self) -> Result<PathBuf> {
        let host = format!("lib/rustlib/{}-unknown-linux-gnu/bin/gcc-ld/ld.lld", std::env::consts::ARCH);
        let ours = sysroot().map(|folder| folder.join(host)).filter(|file| file.is_file());
        ours.or_else(|| shell::program("ld.lld")).ok_or_else(|| {
            Failure::new("there is no ld.lld, neither in the Rust toolchain nor on the path: install lld")
        })
    }
}

/// Finds a toolchain for a need; installs Debian's where that is possible and nothing else is there.
pub fn find(need: Need) -> Result<Toolchain> {
    let own = own();
    let candidates = own.iter().copied().filter(|std| need != Need::LinkWithStubs || *std == Std::FromSource);
    if let Some(std) = candidates.into_iter().next() {
        let how = match std {
            Std::ReadyMade => "its ready-made standard library",
            Std::FromSource => "the standard library built from source",
        };
        return Ok(Toolchain { description: format!("the current toolchain and {how}"), std, debian: None });
    }
    if let Some(toolchain) = of_debian() {
        return Ok(toolchain);
    }
    if host::offered_version(DEBIAN_PACKAGES[0]).is_some_and(|version| is_new_enough(&version))
        && host::apt_get().is_some()
    {
        host::install(DEBIAN_PACKAGES)?;
        if let Some(toolchain) = of_debian() {
            return Ok(toolchain);
        }
    }
    let command = match need {
        Need::Check | Need::LinkWithNdk => format!("rustup target add {TARGET}"),
        Need::LinkWithStubs => "rustup component add rust-src".to_owned(),
    };
    Err(Failure::new(format!(
        "no Rust toolchain here compiles for Android. Run:\n  {command}\n(Debian 12 without rustup: apt-get \
         install {})",
        DEBIAN_PACKAGES.join(" ")
    )))
}

/// What the toolchain that runs us has, the ready-made first.
fn own() -> Vec<Std> {
    let Some(sysroot) = sysroot() else { return Vec::new() };
    let mut found = Vec::new();
    if sysroot.join("lib/rustlib").join(TARGET).join("lib").is_dir() {
        found.push(Std::ReadyMade);
    }
    if has_source(&sysroot) {
        found.push(Std::FromSource);
    }
    found
}

fn has_source(sysroot: &Path) -> bool {
    sysroot.join("lib/rustlib/src/rust/library/std/Cargo.toml").is_file()
}

/// Debian's matched compiler, cargo and source, where installed and new enough.
fn of_debian() -> Option<Toolchain> {
    DEBIAN_PACKAGES.iter().try_for_each(|package| host::installed_version(package).map(|_| ()))?;
    let version = shell::answer(Command::new(DEBIAN.rustc).arg("--version"))?;
    let version = version.strip_prefix("rustc ")?.split(' ').next()?.to_owned();
    (is_new_enough(&version) && has_source(Path::new("/usr"))).then(|| Toolchain {
        description: format!("Debian's Rust {version} and the standard library built from source"),
        std: Std::FromSource,
        debian: Some(DEBIAN),
    })
}

/// Whether a compiler version is at least what the workspace asks for.
fn is_new_enough(version: &str) -> bool {
    let minor = |text: &str| {
        let mut numbers = text.split(|c: char| !c.is_ascii_digit()).map(|digits| digits.parse::<u32>());
        Some((numbers.next()?.ok()?, numbers.next()?.ok()?))
    };
    minor(version) >= minor(env!("CARGO_PKG_RUST_VERSION"))
}

fn sysroot() -> Option<PathBuf> {
    let rustc = std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    shell::answer(Command::new(rustc).args(["--print", "sysroot"])).map(PathBuf::from)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn old_compilers_are_refused() {
        assert!(is_new_enough("1.96.0+dfsg1-1~deb12u2") && is_new_enough("1.92") && is_new_enough("2.0"));
        assert!(!is_new_enough("1.85.0+dfsg3-1") && !is_new_enough("1.9") && !is_new_enough(""));
    }
}
