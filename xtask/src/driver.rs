//! The Vulkan driver, layers and OpenXR runtime that tests run on.
//!
//! Tests never run on whatever GPU the machine has: images differ between drivers. They run on lavapipe of
//! a pinned version, either the system's own where it is current, or one in a prefix (see [`crate::prefix`]).
//! The libraries of a prefix need its own, newer C library; a program that was built on the host runs with
//! them through the prefix's dynamic loader, which is what the *runner* script does.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::shell::{self, Context, Failure, Result, say};
use crate::{host, prefix, workspace};

/// The oldest Mesa whose images the tests accept.
const OLDEST_MESA: (u32, u32) = (25, 0);

/// Debian's and Ubuntu's packages where the system's own Mesa is current enough.
const SYSTEM_PACKAGES: &[&str] = &[
    "mesa-vulkan-drivers",
    "libvulkan1",
    "vulkan-validationlayers",
    "libopenxr-loader1",
    "libopenxr1-monado",
    "monado-service",
    "openxr-layer-corevalidation",
];

/// A driver with everything that tests need beside it.
#[derive(Debug)]
pub struct Driver {
    /// The folder that holds `usr`: `/` for the system's own.
    root: PathBuf,
    /// Of Mesa; for people.
    version: String,
    /// The program through which test programs are started; `None` where they are started as they are.
    runner: Option<PathBuf>,
    variables: Vec<(&'static str, OsString)>,
}

impl Driver {
    /// One line for people.
    pub fn description(&self) -> String {
        let place = if self.root == Path::new("/") {
            "the system's own".into()
        } else {
            self.root.display().to_string()
        };
        format!("lavapipe, Mesa {}, {place}", self.version)
    }

    /// Sets the environment so that a program, or the tests that cargo starts, run on this driver.
    pub fn apply(&self, command: &mut Command) {
        command.envs(self.variables.iter().map(|(name, value)| (name, value)));
        if let Some(runner) = &self.runner {
            let triple =
                format!("{}-unknown-linux-gnu", std::env::consts::ARCH).to_uppercase().replace('-', "_");
            command.env(format!("CARGO_TARGET_{triple}_RUNNER"), runner);
            // Tests that start a program themselves start it through this.
            command.env("MOTES_RUNNER", runner);
        }
    }

    /// A command that runs a program on this driver.
    pub fn command(&self, program: &Path) -> Command {
        let mut command = match &self.runner {
            Some(runner) => {
                let mut command = Command::new(runner);
                command.arg(program);
                command
            }
            None => Command::new(program),
        };
        self.apply(&mut command);
        command
    }
}

/// Finds the driver, or fetches it.
pub fn provide() -> Result<Driver> {
    if let Some(named) = std::env::var_os("MOTES_DRIVER").filter(|folder| !folder.is_empty()) {
        let named = PathBuf::from(named);
        return in_prefix(&named).map_err(|failure| {
            Failure::new(format!(
                "MOTES_DRIVER={} is not a driver prefix: {failure}\nUnset it to have one made.",
                named.display()
            ))
        });
    }
    let folder = prefix::folder()?;
    if prefix::is_whole(&folder) {
        return in_prefix(&folder);
    }
    if let Some(driver) = of_system()? {
        return Ok(driver);
    }
    prefix::make(&folder)?;
    in_prefix(&folder)
}

/// The system's own driver, where it is or can be made current enough.
fn of_system() -> Result<Option<Driver>> {
    const MESA: &str = "mesa-vulkan-drivers";
    let current =
        |version: &Option<String>| version.as_deref().is_some_and(|text| release(text) >= OLDEST_MESA);
    let installed = host::installed_version(MESA);
    if !current(&installed) && !current(&host::offered_version(MESA)) {
        return Ok(None);
    }
    let missing: Vec<&str> = SYSTEM_PACKAGES
        .iter()
        .copied()
        .filter(|package| {
            host::installed_version(package).is_none() || *package == MESA && !current(&installed)
        })
        .collect();
    if !missing.is_empty() {
        host::install(&missing)?;
    }
    let version = host::installed_version(MESA).unwrap_or_default();
    in_root(Path::new("/"), None, version).map(Some)
}

/// `25.0.7-2` and `1:25.0.7` are release (25, 0).
fn release(version: &str) -> (u32, u32) {
    let upstream = version.split_once(':').map_or(version, |(_, rest)| rest);
    let mut numbers =
        upstream.split(|c: char| !c.is_ascii_digit()).map(|digits| digits.parse().unwrap_or_default());
    (numbers.next().unwrap_or_default(), numbers.next().unwrap_or_default())
}

fn in_prefix(folder: &Path) -> Result<Driver> {
    let folder = folder.canonicalize().context(|| format!("cannot open {}", folder.display()))?;
    let root = folder.join("root");
    let loader = ["usr/lib64/ld-linux-x86-64.so.2", "usr/lib/ld-linux-aarch64.so.1"]
        .iter()
        .map(|name| root.join(name))
        .find(|file| file.exists())
        .ok_or_else(|| Failure::new(format!("there is no dynamic loader below {}", root.display())))?;
    let listed = fs::read_to_string(folder.join(prefix::VERSIONS)).unwrap_or_default();
    let version = listed
        .lines()
        .find_map(|line| line.strip_prefix("mesa-vulkan-drivers "))
        .unwrap_or("(unknown version)")
        .to_owned();
    if listed.is_empty() {
        say(&format!("{} does not say which versions it holds", folder.display()));
    } else if !version.starts_with(prefix::MESA) {
        say(&format!("the golden images were recorded with Mesa {}, but this is {version}", prefix::MESA));
    }
    let libraries = root.join("usr/lib").join(host::multiarch());
    let mut path = vec![libraries.clone(), root.join("usr/lib")];
    path.extend(["pulseaudio", "blas", "lapack"].map(|folder| libraries.join(folder)));
    // After the prefix's own: what the host has alone, such as the libraries of a window.
    path.extend(host::library_folders());
    let path: Vec<String> = path.iter().map(|folder| folder.display().to_string()).collect();
    let script =
        format!("#!/bin/sh\nexec '{}' --library-path '{}' \"$@\"\n", loader.display(), path.join(":"));
    let runner = workspace::target().join("driver/run");
    shell::write_if_changed(&runner, script)?;
    make_executable(&runner)?;
    in_root(&root, Some(runner), version)
}

#[cfg(unix)]
fn make_executable(file: &Path) -> Result<()> {
    use std::os::unix::fs::PermissionsExt;
    fs::set_permissions(file, fs::Permissions::from_mode(0o755))
        .context(|| format!("cannot make {} executable", file.display()))
}

#[cfg(not(unix))]
fn make_executable(_: &Path) -> Result<()> {
    Ok(())
}

/// The driver below a root folder. Its manifests name libraries by places that hold only when the root is
/// `/`, so copies with the true places are written into the target folder.
fn in_root(root: &Path, runner: Option<PathBuf>, version: String) -> Result<Driver> {
    let share = root.join("usr/share");
    let target = workspace::target().join("driver");
    let drivers = manifests(&share.join("vulkan/icd.d"), root, &target.join("vulkan-drivers"))?;
    let driver = drivers
        .iter()
        .find(|file| file.file_name().is_some_and(|name| name.to_string_lossy().starts_with("lvp_icd")))
        .ok_or_else(|| {
            Failure::new(format!(
                "there is no lavapipe (lvp_icd*.json) below {}/vulkan/icd.d",
                share.display()
            ))
        })?;
    let layers = target.join("vulkan-layers");
    let found = manifests(&share.join("vulkan/explicit_layer.d"), root, &layers)?;
    if !found.iter().any(|file| file.ends_with("VkLayer_khronos_validation.json")) {
        return Err(Failure::new(format!("there are no Vulkan validation layers below {}", share.display())));
    }
    let runtimes = manifests(&share.join("openxr/1"), root, &target.join("openxr"))?;
    let runtime = runtimes.iter().find(|file| file.ends_with("openxr_monado.json")).ok_or_else(|| {
        Failure::new(format!("there is no OpenXR runtime (Monado) below {}", share.display()))
    })?;
    let xr_layers = target.join("openxr-layers");
    manifests(&share.join("openxr/1/api_layers/explicit.d"), root, &xr_layers)?;
    let service = root.join("usr/bin/monado-service");
    if !service.is_file() {
        return Err(Failure::new(format!("{} is missing", service.display())));
    }
    Ok(Driver {
        variables: vec![
            ("VK_DRIVER_FILES", driver.into()),
            // Its older name, for loaders before 1.3.207.
            ("VK_ICD_FILENAMES", driver.into()),
            ("VK_LAYER_PATH", layers.into()),
            // Overlays and recorders that a machine has installed for every program stay out of the tests.
            ("VK_LOADER_LAYERS_DISABLE", "~implicit~".into()),
            ("XR_RUNTIME_JSON", runtime.into()),
            ("XR_API_LAYER_PATH", xr_layers.into()),
            // The OpenXR service that tests start, through MOTES_RUNNER where that is set.
            ("MOTES_MONADO_SERVICE", service.into()),
        ],
        root: root.to_owned(),
        version,
        runner,
    })
}

/// Copies the JSON manifests of a folder with absolute library paths; returns the copies.
fn manifests(from: &Path, root: &Path, to: &Path) -> Result<Vec<PathBuf>> {
    let mut copies = Vec::new();
    let Ok(entries) = fs::read_dir(from) else { return Ok(copies) };
    for entry in entries {
        let file = entry.context(|| format!("cannot read {}", from.display()))?.path();
        if file.extension().is_none_or(|extension| extension != "json") {
            continue;
        }
        let text = fs::read_to_string(&file).context(|| format!("cannot read {}", file.display()))?;
        let copy = to.join(file.file_name().unwrap_or_default());
        shell::write_if_changed(&copy, with_absolute_library(&text, root))?;
        copies.push(copy);
    }
    copies.sort();
    Ok(copies)
}

/// A manifest's `library_path` is a bare name (searched for by the dynamic loader), relative to the manifest,
/// or absolute; only the first and the last occur in Debian's packages.
fn with_absolute_library(manifest: &str, root: &Path) -> String {
    const KEY: &str = "\"library_path\"";
    let Some(key) = manifest.find(KEY) else { return manifest.to_owned() };
    let after = key + KEY.len();
    let Some(open) = manifest[after..].find('"').map(|at| after + at + 1) else { return manifest.to_owned() };
    let Some(close) = manifest[open..].find('"').map(|at| open + at) else { return manifest.to_owned() };
    let library = &manifest[open..close];
    let absolute = match library.strip_prefix('/') {
        Some(below) => root.join(below),
        None if library.contains('/') => return manifest.to_owned(),
        None => root.join("usr/lib").join(host::multiarch()).join(library),
    };
    format!("{}{}{}", &manifest[..open], absolute.display(), &manifest[close..])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn releases_are_compared_as_numbers() {
        assert_eq!(release("25.0.7-2"), (25, 0));
        assert_eq!(release("1:25.10.7-2"), (25, 10));
        assert_eq!(release("22.3.6-1+deb12u2"), (22, 3));
        assert!(release("22.3.6") < OLDEST_MESA && release("25.0.7-2") >= OLDEST_MESA);
        assert!(release("100.0") >= OLDEST_MESA && release("") < OLDEST_MESA);
    }

    #[test]
    fn libraries_are_found_below_the_prefix() {
        let libraries = format!("/p/root/usr/lib/{}", host::multiarch());
        let root = Path::new("/p/root");
        assert_eq!(
            with_absolute_library(r#"{"library_path": "libvulkan_lvp.so", "x": 1}"#, root),
            format!(r#"{{"library_path": "{libraries}/libvulkan_lvp.so", "x": 1}}"#)
        );
        assert_eq!(
            with_absolute_library(r#"{"library_path":"/usr/lib/a/libx.so"}"#, root),
            r#"{"library_path":"/p/root/usr/lib/a/libx.so"}"#
        );
        for untouched in [r#"{"library_path": "../libx.so"}"#, "{}", r#"{"library_path": "#] {
            assert_eq!(with_absolute_library(untouched, root), untouched);
        }
    }

    #[test]
    fn a_folder_without_a_driver_is_named() {
        let text = in_prefix(Path::new("/nowhere/at/all")).unwrap_err().to_string();
        assert!(text.contains("/nowhere/at/all"), "{text}");
        let text = in_root(Path::new("/nowhere"), None, String::new()).unwrap_err().to_string();
        assert!(text.contains("lvp_icd") && text.contains("/nowhere"), "{text}");
    }
}
