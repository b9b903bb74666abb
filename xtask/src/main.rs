//! `cargo xtask`: everything around the program that is not the program itself.
//!
//! It sets a machine up, shows a scene, runs the tests on the pinned driver, and packs the Android
//! application. `cargo xtask help` lists the commands. It builds with nothing but Rust and a C linker,
//! because it is what installs the rest.

mod android;
mod ci;
mod driver;
mod host;
mod licences;
mod package;
mod prefix;
mod quest;
mod shell;
mod test;
mod view;
mod workspace;

use std::process::ExitCode;

use shell::{Failure, Result};

const HELP: &str = "\
cargo xtask COMMAND

  setup                       find and install what building, viewing and testing need
  view [SCENE...] [OPTIONS]   show scenes (without any: the sample that is built in) in a window, or render
                              pictures of them where there is no display; options are those of motes
  test [CARGO TEST OPTIONS]   run the tests on the pinned CPU driver (all packages unless -p is given)
  run-on-driver -- COMMAND    run COMMAND (a program, or cargo) on the pinned driver
  stability                   measure the hard cases and write docs/stability.md with its plots (some minutes)
  android-check               what the application for Android is made of, and whether it compiles
  android-run                 run the application's arm64 code on an emulated processor (Python's emulite), and compare
                              what it computes with this machine
  apk [OPTIONS]               build the application for Quest headsets: target/android/motes.apk
      --ndk DIR                 link with an Android NDK (else ANDROID_NDK_HOME; without one, stubs are made)
      --openxr-loader FILE      pack the OpenXR loader for arm64: libopenxr_loader.so, or the AAR that holds it
      --key FILE                sign with this key (PEM: PKCS #8 on P-256 and certificate; default: a debug key)
      --keystore FILE           sign with a Java keystore instead, by Android's apksigner
  apk-check FILE              read an APK back, and say whether a headset would take it
  quest [SCENE...]            install the APK on a headset on USB, push scenes, start, and show its log
  ci                          everything that a change must pass: format, lints, documentation, tests, Android

Environment
  MOTES_DRIVER=DIR            use the driver prefix in DIR instead of making one in the user's cache
  MOTES_SCENES=DIR            where the large sample scenes are (default: ../shared/scenes beside the project)
  MOTES_DEBIAN_MIRROR=URL     where to fetch the pinned driver from, on a system without Debian's own mirror
";

fn main() -> ExitCode {
    if let Some(code) = android::linker::run_if_named() {
        return code;
    }
    let mut arguments = std::env::args().skip(1);
    let command = arguments.next().unwrap_or_else(|| "help".into());
    match dispatch(&command, &arguments.collect::<Vec<_>>()) {
        Ok(code) => code,
        Err(failure) => {
            eprintln!("xtask {command}: {failure}");
            ExitCode::FAILURE
        }
    }
}

fn dispatch(command: &str, arguments: &[String]) -> Result<ExitCode> {
    match command {
        "setup" => {
            no_arguments(command, arguments)?;
            host::provide(host::Purpose::Test)?;
            let driver = driver::provide()?;
            shell::say(&format!("everything is there. Driver for tests: {}", driver.description()));
            Ok(ExitCode::SUCCESS)
        }
        "view" => view::view(arguments),
        "test" => test::test(arguments),
        "run-on-driver" => test::run_on_driver(arguments),
        "stability" => {
            no_arguments(command, arguments)?;
            test::stability()
        }
        "android-check" => {
            no_arguments(command, arguments)?;
            android::check()
        }
        "android-run" => {
            no_arguments(command, arguments)?;
            android::emulated::run()
        }
        "apk" => package::apk(arguments),
        "apk-check" => package::check(arguments),
        "quest" => quest::quest(arguments),
        "ci" => {
            no_arguments(command, arguments)?;
            ci::ci()
        }
        "help" | "--help" | "-h" => {
            print!("{HELP}");
            Ok(ExitCode::SUCCESS)
        }
        other => Err(Failure::new(format!("there is no such command: {other:?}\n\n{HELP}"))),
    }
}

fn no_arguments(command: &str, arguments: &[String]) -> Result<()> {
    match arguments.first() {
        None => Ok(()),
        Some(extra) => Err(Failure::new(format!("{command} takes no arguments, but got {extra:?}"))),
    }
}
