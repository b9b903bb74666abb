//! `cargo xtask apk` and `apk-check`: from sources to a signed APK, and back.

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use crate::android::manifest::Manifest;
use crate::android::{self, Link};
use crate::shell::{self, Context, Failure, Result, say};
use crate::{host, workspace};

/// Where the loader is to be had; the application shows nothing without it.
const LOADER_ADVICE: &str = "\
the APK has no OpenXR loader: it starts, says so in its log, and shows nothing.
  Get it once: the file openxr_loader_for_android-VERSION.aar (1.0.34 or newer; 1.1.x is good) of the release page of
  Khronos' OpenXR-SDK-Source on GitHub, or from Maven Central as org.khronos.openxr:openxr_loader_for_android.
  Then: cargo xtask apk --openxr-loader openxr_loader_for_android-VERSION.aar";

/// Files of `scenes/samples` that the application finds among its assets: the sample, and whose work it is.
const ASSETS: [&str; 2] = ["plant.spz", "ATTRIBUTION.md"];

#[derive(Debug, Default, PartialEq, Eq)]
struct Options {
    ndk: Option<PathBuf>,
    loader: Option<PathBuf>,
    key: Option<PathBuf>,
    keystore: Option<PathBuf>,
}

impl Options {
    fn parse(arguments: &[String]) -> Result<Self> {
        let mut options = Self::default();
        let mut words = arguments.iter();
        while let Some(word) = words.next() {
            let (name, joined) =
                word.split_once('=').map_or((word.as_str(), None), |(name, value)| (name, Some(value)));
            let place = match name {
                "--ndk" => &mut options.ndk,
                "--openxr-loader" => &mut options.loader,
                "--key" => &mut options.key,
                "--keystore" => &mut options.keystore,
                _ => return Err(Failure::new(format!("apk has no option {word:?}; see cargo xtask help"))),
            };
            let value = joined.map(str::to_owned).or_else(|| words.next().cloned());
            let value = value.ok_or_else(|| Failure::new(format!("{name} wants a path")))?;
            if place.replace(absolute(&value)?).is_some() {
                return Err(Failure::new(format!("{name} is given twice")));
            }
        }
        if options.key.is_some() && options.keystore.is_some() {
            return Err(Failure::new("--key and --keystore exclude each other"));
        }
        for file in [&options.loader, &options.keystore].into_iter().flatten() {
            file.metadata().context(|| format!("cannot open {}", file.display()))?;
        }
        Ok(options)
    }
}

/// Where `cargo xtask apk` leaves the APK.
pub fn output() -> PathBuf {
    android::target().join("motes.apk")
}

/// Builds, packs, signs and checks the APK.
pub fn apk(arguments: &[String]) -> Result<ExitCode> {
    let options = Options::parse(arguments)?;
    let manifest = Manifest::read()?;
    let link = Link::choose(options.ndk.as_deref())?;
    let library = android::build(&link, &[], manifest.minimum_api)?;
    let apk = output();
    let version = env!("CARGO_PKG_VERSION");
    let mut pack = packer();
    pack.arg("pack").arg("--manifest").arg(Manifest::file()).arg("--library").arg(&library);
    pack.args(["--version-name", version, "--version-code", &version_code(version)?.to_string()]);
    if let Some(loader) = &options.loader {
        pack.arg("--loader").arg(loader);
    }
    for asset in ASSETS {
        let file = workspace::root().join("scenes/samples").join(asset);
        pack.arg("--asset").arg(format!("{asset}={}", file.display()));
    }
    match &options.keystore {
        None => {
            let key = match options.key {
                Some(key) => key,
                None => debug_key()?,
            };
            shell::run(pack.arg("--key").arg(key).arg("-o").arg(&apk))?;
        }
        Some(keystore) => {
            let unsigned = shell::with_suffix(&apk, ".unsigned");
            shell::run(pack.arg("-o").arg(&unsigned))?;
            sign_with_keystore(&unsigned, keystore, &apk)?;
        }
    }
    check_file(&apk)?;
    if options.loader.is_none() {
        say(LOADER_ADVICE);
    }
    println!("{}", apk.display());
    Ok(ExitCode::SUCCESS)
}

/// `cargo xtask apk-check FILE`.
pub fn check(arguments: &[String]) -> Result<ExitCode> {
    let [file] = arguments else {
        return Err(Failure::new("name one APK: cargo xtask apk-check FILE"));
    };
    check_file(&absolute(file)?)?;
    Ok(ExitCode::SUCCESS)
}

fn check_file(file: &Path) -> Result<()> {
    let mut check = packer();
    check.arg("check").arg(file);
    for asset in ASSETS {
        check.args(["--asset", asset]);
    }
    shell::run(&mut check)
}

/// Other programs are started in the workspace's root, so a path that a person typed is made absolute first.
fn absolute(path: &str) -> Result<PathBuf> {
    std::path::absolute(path).context(|| format!("cannot make {path:?} absolute"))
}

/// What Android's own tools say of the APK that was packed, where they are there or can be installed.
pub fn check_with_android_tools() -> Result<()> {
    const TOOLS: [(&str, &str); 2] = [("apksigner", "apksigner"), ("aapt2", "aapt")];
    let missing: Vec<&str> = TOOLS
        .iter()
        .filter(|(tool, _)| shell::program(tool).is_none())
        .map(|(_, package)| *package)
        .collect();
    if !missing.is_empty()
        && let Err(failure) = host::install(&missing)
    {
        say(&format!(
            "the APK is NOT checked with Android's own tools, which cannot be installed here: {failure}"
        ));
        return Ok(());
    }
    let apk = output();
    let manifest = Manifest::read()?;
    // As Android 7 sees it, which knows scheme 2 only, and as ours do, which take scheme 3.
    for (level, scheme) in [("24", "v2"), ("32", "v3")] {
        let mut apksigner = Command::new("apksigner");
        apksigner.args(["verify", "--verbose", "--min-sdk-version", level]).arg(&apk);
        let output = shell::quietly(&mut apksigner)?;
        let text = String::from_utf8_lossy(&output.stdout);
        let line = format!("Verified using {scheme} scheme (APK Signature Scheme {scheme}): true");
        if !text.contains(&line) {
            return Err(Failure::new(format!("apksigner does not say `{line}`, but:\n{text}")));
        }
    }
    let output = shell::quietly(Command::new("aapt2").args(["dump", "badging"]).arg(&apk))?;
    let text = String::from_utf8_lossy(&output.stdout);
    for expected in [
        format!("package: name='{}'", manifest.package),
        format!("sdkVersion:'{}'", manifest.minimum_api),
        "launchable-activity: name='android.app.NativeActivity'".into(),
        "uses-feature: name='android.hardware.vr.headtracking'".into(),
        "native-code: 'arm64-v8a'".into(),
    ] {
        if !text.contains(&expected) {
            return Err(Failure::new(format!(
                "aapt2 does not find {expected} in {}, but:\n{text}",
                apk.display()
            )));
        }
    }
    say("Android's apksigner and aapt2 agree with the APK");
    Ok(())
}

/// The packer; cargo builds it where needed.
fn packer() -> Command {
    let mut cargo = workspace::cargo();
    cargo.args(["run", "--quiet", "--package", "motes-apk", "--"]);
    cargo
}

/// `1.2.3` becomes 10203.
fn version_code(version: &str) -> Result<u32> {
    let numbers: Option<Vec<u32>> = version.split('.').map(|part| part.parse().ok()).collect();
    match numbers.as_deref() {
        Some([major, minor, patch]) if *minor < 100 && *patch < 100 && *major < 100_000 => {
            Ok((major * 100 + minor) * 100 + patch)
        }
        _ => {
            Err(Failure::new(format!("the version {version:?} is not three numbers, the last two below 100")))
        }
    }
}

/// The key that is made once for a user: a headset takes an update only from the same signer.
fn debug_key() -> Result<PathBuf> {
    let home = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let data = home("XDG_DATA_HOME")
        .or_else(|| home("HOME").map(|home| home.join(".local/share")))
        .or_else(|| home("APPDATA"));
    let data = data
        .ok_or_else(|| Failure::new("there is no home folder to keep a debug key in: name one with --key"))?;
    Ok(data.join("motes").join("android-debug-key.pem"))
}

/// Java keystores are read by Android's own tool. The password is asked for, or taken from the environment.
fn sign_with_keystore(unsigned: &Path, keystore: &Path, apk: &Path) -> Result<()> {
    const PASSWORD: &str = "MOTES_KEYSTORE_PASSWORD";
    if shell::program("apksigner").is_none() {
        host::install(&["apksigner"])?;
    }
    let mut apksigner = Command::new("apksigner");
    // The level makes it sign with scheme 2 as well.
    apksigner.args(["sign", "--v1-signing-enabled", "false", "--min-sdk-version", "24"]);
    apksigner.arg("--ks").arg(keystore).arg("--out").arg(apk);
    if std::env::var_os(PASSWORD).is_some() {
        apksigner.arg("--ks-pass").arg(format!("env:{PASSWORD}"));
    }
    shell::run(apksigner.arg(unsigned))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(line: &str) -> Result<Options> {
        Options::parse(&line.split_whitespace().map(str::to_owned).collect::<Vec<_>>())
    }

    #[test]
    fn options_are_read() {
        let options = parse("--ndk /n --key=/k.pem").unwrap();
        assert_eq!(options.ndk.as_deref(), Some(Path::new("/n")));
        assert_eq!(options.key.as_deref(), Some(Path::new("/k.pem")));
        assert_eq!(parse("").unwrap(), Options::default());
    }

    #[test]
    fn wrong_options_are_named() {
        let failure = |line: &str| parse(line).unwrap_err().to_string();
        assert!(failure("--loader x").contains("--loader"));
        assert!(failure("--ndk").contains("wants a path"));
        assert!(failure("--ndk a --ndk b").contains("twice"));
        assert!(failure("--openxr-loader /nowhere/loader.aar").contains("/nowhere/loader.aar"));
        assert!(failure("--key a --keystore b").contains("exclude"));
    }

    #[test]
    fn versions_ascend() {
        assert_eq!(version_code("0.1.0").unwrap(), 100);
        assert_eq!(version_code("1.2.3").unwrap(), 10203);
        assert!(version_code("0.2.0").unwrap() > version_code("0.1.99").unwrap());
        assert!(
            version_code("0.1.100").is_err()
                && version_code("1.2").is_err()
                && version_code("a.b.c").is_err()
        );
        version_code(env!("CARGO_PKG_VERSION")).unwrap();
    }
}
