//! The Android side: which toolchain compiles for it, what may be in its dependency graph, and how the
//! native library is linked, with an NDK or without one.

pub mod emulated;
pub mod graph;
pub mod linker;
pub mod manifest;
pub mod system;
pub mod toolchain;

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use crate::shell::{self, Context, Failure, Result, say};
use crate::{host, workspace};
use toolchain::{Need, Std, Toolchain};

/// The only target: every headset of the Quest family.
pub const TARGET: &str = "aarch64-linux-android";
/// The same for environment variables.
const TARGET_VARIABLE: &str = "CARGO_TARGET_AARCH64_LINUX_ANDROID";
/// The package that becomes the application.
pub const PACKAGE: &str = "motes-android";
/// Its library.
pub const LIBRARY: &str = "libmotes.so";

/// Everything Android has a target folder of its own: it may be built by another compiler.
pub fn target() -> PathBuf {
    workspace::target().join("android")
}

/// `cargo xtask android-check`: what the graph holds, and whether it compiles for Android.
pub fn check() -> Result<ExitCode> {
    host::provide(host::Purpose::Build)?;
    graph::check()?;
    let toolchain = toolchain::find(Need::Check)?;
    say(&format!("type-check for {TARGET} with {}", toolchain.description));
    shell::run(cargo(&toolchain, "check").args(["--lib", "--package", PACKAGE, "--profile", "android"]))?;
    graph::nothing_native_was_built()?;
    Ok(ExitCode::SUCCESS)
}

/// How the library is linked.
#[derive(Debug)]
pub enum Link {
    /// Against the system libraries of an NDK, by its compiler driver.
    Ndk(PathBuf),
    /// Against stubs of the system libraries, by the linker that comes with Rust.
    Stubs,
}

impl Link {
    /// The NDK that the user named, or the one that the environment names, or none.
    pub fn choose(named: Option<&Path>) -> Result<Self> {
        let from_environment = || {
            ["ANDROID_NDK_HOME", "ANDROID_NDK_ROOT"]
                .iter()
                .filter_map(std::env::var_os)
                .find(|folder| !folder.is_empty())
                .map(PathBuf::from)
        };
        match named.map(Path::to_owned).or_else(from_environment) {
            None => Ok(Self::Stubs),
            Some(folder) if folder.join("toolchains/llvm/prebuilt").is_dir() => Ok(Self::Ndk(folder)),
            Some(folder) => Err(Failure::new(format!(
                "{} is not an Android NDK: it has no toolchains/llvm/prebuilt",
                folder.display()
            ))),
        }
    }
}

/// Builds the stripped library and returns where it is.
pub fn build(link: &Link, features: &[String], minimum_api: u32) -> Result<PathBuf> {
    host::provide(host::Purpose::Build)?;
    graph::check()?;
    let toolchain = toolchain::find(match link {
        Link::Ndk(_) => Need::LinkWithNdk,
        Link::Stubs => Need::LinkWithStubs,
    })?;
    let mut flags = vec![
        // Every symbol must be found in a library that the device has.
        "-Clink-arg=-Wl,-z,defs".to_owned(),
        // Devices with pages of 16 KiB refuse libraries that are aligned to less.
        "-Clink-arg=-Wl,-z,max-page-size=16384".to_owned(),
        format!("-Clink-arg=-Wl,-soname,{LIBRARY}"),
    ];
    let mut cargo = cargo(&toolchain, "build");
    match link {
        Link::Ndk(folder) => {
            say(&format!("linking with the NDK in {}", folder.display()));
            cargo.env(format!("{TARGET_VARIABLE}_LINKER"), linker::of_ndk(folder, minimum_api)?);
        }
        Link::Stubs => {
            say("linking without an NDK: stubs of the system libraries, and the linker that comes with Rust");
            let lld = toolchain.lld()?;
            let stubs = target().join("stubs");
            system::write_stubs(&lld, &stubs, minimum_api)?;
            flags.push(format!("-Lnative={}", stubs.display()));
            cargo.env(format!("{TARGET_VARIABLE}_LINKER"), linker::front_end()?);
            cargo.env(linker::LLD, lld);
        }
    }
    cargo.env(format!("{TARGET_VARIABLE}_RUSTFLAGS"), flags.join(" "));
    cargo.args(["--lib", "--package", PACKAGE, "--profile", "android"]);
    let mut features = features.to_vec();
    if matches!(link, Link::Stubs) {
        features.push("rust-unwinder".into());
    }
    if !features.is_empty() {
        cargo.args(["--features", &features.join(",")]);
    }
    say(&format!("building for {TARGET} with {}", toolchain.description));
    shell::run(&mut cargo).map_err(|failure| match link {
        Link::Ndk(_) => failure,
        Link::Stubs => Failure::new(format!("{failure}\n{}", system::ADVICE)),
    })?;
    graph::nothing_native_was_built()?;
    let library = target().join(TARGET).join("android").join(LIBRARY);
    library.metadata().context(|| format!("the build ended well, but cannot read {}", library.display()))?;
    Ok(library)
}

/// Cargo of a toolchain, for Android.
fn cargo(toolchain: &Toolchain, command: &str) -> Command {
    let mut cargo = toolchain.cargo();
    cargo.arg(command).args(["--locked", "--target", TARGET]);
    cargo.env("CARGO_TARGET_DIR", target());
    if toolchain.std == Std::FromSource {
        // Without std's feature `backtrace`: it needs an unwinder in C, which only the NDK has. The system's
        // own crash reports hold the call stack.
        cargo.args(["-Zbuild-std=std,panic_abort", "-Zbuild-std-features="]);
        cargo.env("RUSTC_BOOTSTRAP", "1");
    }
    cargo
}
