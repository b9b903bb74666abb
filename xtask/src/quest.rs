//! `cargo xtask quest`: the APK on a headset on USB.

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use crate::android::manifest::Manifest;
use crate::package;
use crate::shell::{self, Context, Failure, Result, say};

/// Installs the APK, pushes scenes, starts the application and shows its log until it is interrupted.
pub fn quest(arguments: &[String]) -> Result<ExitCode> {
    let scenes: Vec<PathBuf> = arguments.iter().map(PathBuf::from).collect();
    for scene in &scenes {
        scene.metadata().context(|| format!("cannot open the scene {}", scene.display()))?;
    }
    let apk = package::output();
    if !apk.is_file() {
        return Err(Failure::new(format!("{} is not there yet: run cargo xtask apk first", apk.display())));
    }
    let adb = adb()?;
    let listed = shell::quietly(Command::new(&adb).arg("devices"))?;
    let serial = device(&String::from_utf8_lossy(&listed.stdout))?;
    let adb = || {
        let mut command = Command::new(&adb);
        command.args(["-s", &serial]);
        command
    };
    let package = Manifest::read()?.package;
    say(&format!("installing on {serial}"));
    shell::quietly(adb().args(["install", "-r"]).arg(&apk))
        .map_err(|failure| explained(failure, &package))?;
    if !scenes.is_empty() {
        let folder = format!("/sdcard/Android/data/{package}/files/scenes/");
        shell::quietly(adb().args(["shell", "mkdir", "-p", &folder]))?;
        for scene in &scenes {
            say(&format!("pushing {}", scene.display()));
            shell::run(adb().arg("push").arg(scene).arg(&folder))?;
        }
    }
    shell::quietly(adb().args(["logcat", "-c"]))?;
    shell::quietly(adb().args([
        "shell",
        "am",
        "start",
        "-n",
        &format!("{package}/android.app.NativeActivity"),
    ]))?;
    say("started: put the headset on. Its log follows; Ctrl+C ends the log, not the application");
    Ok(crate::test::code(shell::status(adb().args([
        "logcat",
        "-v",
        "time",
        "-s",
        "motes",
        "OpenXR-Loader",
        "DEBUG",
    ]))?))
}

/// Where adb is: on the path, or in the SDK that the environment names.
fn adb() -> Result<PathBuf> {
    let in_sdk = ["ANDROID_HOME", "ANDROID_SDK_ROOT"]
        .iter()
        .filter_map(std::env::var_os)
        .map(|sdk| {
            Path::new(&sdk).join("platform-tools").join(format!("adb{}", std::env::consts::EXE_SUFFIX))
        })
        .find(|file| file.is_file());
    shell::program("adb").or(in_sdk).ok_or_else(|| {
        Failure::new(
            "adb, which speaks to the headset, is not there. Install Debian's package adb, or Google's \
             \"SDK Platform Tools\", and put it on the PATH",
        )
    })
}

/// The one device that `adb devices` lists and that lets us in.
fn device(listed: &str) -> Result<String> {
    let devices: Vec<(&str, &str)> =
        listed.lines().skip(1).filter_map(|line| line.trim().split_once(char::is_whitespace)).collect();
    let named = std::env::var("ANDROID_SERIAL").ok();
    let ready: Vec<&str> = devices
        .iter()
        .filter(|(serial, state)| {
            state.trim() == "device" && named.as_deref().is_none_or(|named| named == *serial)
        })
        .map(|(serial, _)| *serial)
        .collect();
    match (ready.as_slice(), devices.as_slice()) {
        ([serial], _) => Ok((*serial).to_owned()),
        ([], []) => Err(Failure::new(
            "no headset is connected. Turn on developer mode in the phone app, connect a USB cable that carries \
             data, and wake the headset up",
        )),
        ([], [(serial, state), ..]) => Err(Failure::new(format!(
            "the headset {serial} is {}: put it on, and allow USB debugging in the question that it shows",
            state.trim()
        ))),
        (several, _) => Err(Failure::new(format!(
            "several devices are connected: name one, as ANDROID_SERIAL={}",
            several.join(" or ANDROID_SERIAL=")
        ))),
    }
}

/// Adds what to do to what `adb install` says.
fn explained(failure: Failure, package: &str) -> Failure {
    let text = failure.to_string();
    if text.contains("INSTALL_FAILED_UPDATE_INCOMPATIBLE") {
        return Failure::new(format!(
            "{text}\nThe application on the headset was signed with another key. Remove it (its scenes too) with\n  \
             adb uninstall {package}\nand run this again"
        ));
    }
    failure
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ready_device_is_taken_and_others_are_explained() {
        let failure = |listed: &str| device(listed).unwrap_err().to_string();
        assert_eq!(device("List of devices attached\n1WMHH0\tdevice\n\n").unwrap(), "1WMHH0");
        assert!(failure("List of devices attached\n\n").contains("developer mode"));
        assert!(failure("List of devices attached\n1W\tunauthorized\n").contains("allow USB debugging"));
        assert!(
            failure("List of devices attached\na\tdevice\nb\tdevice\n")
                .contains("ANDROID_SERIAL=a or ANDROID_SERIAL=b")
        );
    }

    #[test]
    fn another_signer_is_explained() {
        let text = explained(Failure::new("INSTALL_FAILED_UPDATE_INCOMPATIBLE"), "a.b").to_string();
        assert!(text.contains("adb uninstall a.b"));
        assert_eq!(explained(Failure::new("other"), "a.b").to_string(), "other");
    }
}
