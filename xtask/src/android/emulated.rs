//! Runs the arm64 library's own code here: on an emulated processor, with Android's C library.
//!
//! There is no Vulkan there. What the processor computes (reading, examining, ordering, packing and projecting a scene)
//! is digested by the library of the APK and by `motes digest` on this machine, and compared.

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use crate::android::manifest::Manifest;
use crate::android::{self, Link};
use crate::shell::{self, Context, Failure, Result, say};
use crate::workspace;

/// The emulator, as pip installs it. Alpha software: its version is pinned.
const EMULATOR: &str = "emulite==0.4.0";
/// What drives it.
const SCRIPT: &str = include_str!("emulated.py");
/// How far values may differ, as a part of the larger one: exponentials and sines are the system's own.
const WITHIN: &str = "1e-6";

/// `cargo xtask android-run`: builds the library and compares its digest of the sample scene with this machine's.
pub fn run() -> Result<ExitCode> {
    let python = python()?;
    let manifest = Manifest::read()?;
    // The emulator has stubs beside it whatever the library was linked with.
    let library = android::build(&Link::Stubs, &[], manifest.minimum_api)?;
    compare(&python, &library)?;
    Ok(ExitCode::SUCCESS)
}

/// The same in CI, with the library that was just built; without the emulator it says so, loudly, and goes on.
pub fn run_where_possible() -> Result<()> {
    match python() {
        Ok(python) => {
            compare(&python, &android::target().join(android::TARGET).join("android").join(android::LIBRARY))
        }
        Err(failure) => {
            say(&format!("the arm64 code is NOT run here: {failure}"));
            Ok(())
        }
    }
}

fn compare(python: &Path, library: &Path) -> Result<()> {
    let folder = android::target().join("emulated");
    let create = |folder: &Path| {
        std::fs::create_dir_all(folder).context(|| format!("cannot make {}", folder.display()))
    };
    create(&folder)?;
    let script = folder.join("emulated.py");
    shell::write_if_changed(&script, SCRIPT)?;
    // Of the system's libraries it lacks the one that no computation needs.
    let libraries = folder.join("libraries");
    create(&libraries)?;
    let stub = android::target().join("stubs/libandroid.so");
    let copied = libraries.join("libandroid.so");
    std::fs::copy(&stub, &copied).context(|| format!("cannot copy {}", stub.display()))?;

    say("building motes for this machine");
    shell::run(workspace::cargo().args(["build", "--quiet", "--workspace", "--bin", "motes"]))?;
    let motes = workspace::target().join("debug").join(format!("motes{}", std::env::consts::EXE_SUFFIX));
    let sample = workspace::root().join("scenes/samples/plant.spz");
    let moving = folder.join("moving.ply");
    shell::quietly(
        Command::new(&motes).arg("animate").arg(&sample).args(["--fleeting", "0.3", "-o"]).arg(&moving),
    )?;
    for scene in [&sample, &moving] {
        let digest = folder.join("digest.json");
        say(&format!("{}: arm64 code with Android's C library, emulated", scene.display()));
        shell::run(Command::new(python).arg(&script).arg(library).arg(&libraries).arg(scene).arg(&digest))?;
        let mut against = Command::new(&motes);
        against.arg("digest").arg(scene).arg("--against").arg(&digest).args(["--within", WITHIN]);
        shell::run(&mut against)?;
    }
    Ok(())
}

/// A Python with the emulator: the system's, or one in the target folder, made where that is possible.
fn python() -> Result<PathBuf> {
    let has_emulator =
        |python: &Path| shell::quietly(Command::new(python).args(["-c", "import emulite"])).is_ok();
    let system = ["python3", "python"].iter().find_map(|name| shell::program(name));
    let system = system.ok_or_else(|| Failure::new("it needs Python 3.10 or newer, which is not there"))?;
    if has_emulator(&system) {
        return Ok(system);
    }
    let folder = android::target().join("python");
    let own = folder.join(if cfg!(windows) { "Scripts/python.exe" } else { "bin/python" });
    if !(own.is_file() && has_emulator(&own)) {
        say(&format!("installing the emulator {EMULATOR} (about 120 MB) into {}", folder.display()));
        let make = || -> Result<()> {
            shell::quietly(Command::new(&system).args(["-m", "venv"]).arg(&folder))?;
            let install = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", EMULATOR];
            shell::quietly(Command::new(&own).args(install))?;
            Ok(())
        };
        make().map_err(|failure| {
            Failure::new(format!(
                "the emulator {EMULATOR} cannot be installed with {}: {failure}",
                system.display()
            ))
        })?;
    }
    Ok(own)
}
