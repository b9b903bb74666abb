//! The driver prefix: a folder with one Debian release's CPU Vulkan driver, validation layers, OpenXR
//! loader, layers and runtime, unpacked without touching the system's own packages.
//!
//! Images that tests compare are reproducible on one version of the driver only, so every Debian machine
//! fetches the same one. Mirror, proxy and keys are the ones that the machine's own apt uses.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::host;
use crate::shell::{self, Context, Failure, Result, say};

/// The Debian release that the driver comes from.
pub const SUITE: &str = "trixie";
/// Version of Mesa (lavapipe) in that release, with which the golden images were recorded.
pub const MESA: &str = "25.0.7";
/// Grows when the packages or the layout below change, so that older prefixes are not taken for this one.
const LAYOUT: u32 = 1;
/// Lists what the prefix holds, one `package version` a line. Written last: where it is, the prefix is whole.
pub const VERSIONS: &str = "versions.txt";

const PACKAGES: &[&str] = &[
    "mesa-vulkan-drivers",
    "libvulkan1",
    "vulkan-validationlayers",
    "vulkan-tools",
    "libopenxr-loader1",
    "libopenxr1-monado",
    "monado-service",
    "openxr-layer-corevalidation",
    "openxr-layer-apidump",
];

/// Where the prefix of this user is or will be.
pub fn folder() -> Result<PathBuf> {
    let cache = std::env::var_os("XDG_CACHE_HOME")
        .filter(|folder| Path::new(folder).is_absolute())
        .map(PathBuf::from)
        .or_else(|| {
            std::env::var_os("HOME")
                .filter(|home| !home.is_empty())
                .map(|home| Path::new(&home).join(".cache"))
        })
        .ok_or_else(|| {
            Failure::new(
                "neither HOME nor XDG_CACHE_HOME is set: set MOTES_DRIVER to a folder for the pinned driver",
            )
        })?;
    Ok(cache.join("motes").join(format!("driver-{SUITE}-{LAYOUT}-{}", std::env::consts::ARCH)))
}

/// Whether a prefix that this module made is there and whole.
pub fn is_whole(prefix: &Path) -> bool {
    prefix.join(VERSIONS).is_file()
}

/// Makes the prefix, or waits for another run that is making it.
pub fn make(prefix: &Path) -> Result<()> {
    let parent = prefix.parent().unwrap_or(Path::new("."));
    fs::create_dir_all(parent).context(|| format!("cannot make the folder {}", parent.display()))?;
    let lock = shell::with_suffix(prefix, ".lock");
    let held = File::create(&lock).context(|| format!("cannot write {}", lock.display()))?;
    held.lock().context(|| format!("cannot lock {}", lock.display()))?;
    if is_whole(prefix) {
        return Ok(());
    }
    let unfinished = shell::with_suffix(prefix, ".unfinished");
    for old in [prefix, &unfinished] {
        if old.exists() {
            fs::remove_dir_all(old).context(|| format!("cannot remove the unfinished {}", old.display()))?;
        }
    }
    say(&format!("fetching the pinned test driver (Debian {SUITE}, about 170 MB) into {}", prefix.display()));
    fill(&unfinished)?;
    fs::rename(&unfinished, prefix).context(|| format!("cannot move {} in place", unfinished.display()))
}

/// Downloads with a private apt state and unpacks.
fn fill(prefix: &Path) -> Result<()> {
    for tool in ["apt-get", "apt-config", "dpkg-deb"] {
        if shell::program(tool).is_none() {
            return Err(Failure::new(format!(
                "{tool} is missing: the pinned driver can be fetched on Debian only"
            )));
        }
    }
    let (apt, root) = (prefix.join("apt"), prefix.join("root"));
    let archives = apt.join("cache/archives");
    for folder in [&apt.join("lists/partial"), &archives.join("partial"), &apt.join("empty"), &root] {
        fs::create_dir_all(folder).context(|| format!("cannot make the folder {}", folder.display()))?;
    }
    let source = Source::of_this_machine()?;
    let settings = settings(&apt, &shell::answer(Command::new("apt-config").arg("dump")).unwrap_or_default());
    shell::write_if_changed(&apt.join("status"), "")?;
    shell::write_if_changed(&apt.join("sources.list"), source.line())?;
    shell::write_if_changed(&apt.join("apt.conf"), settings)?;

    let apt_get = || {
        let mut command = Command::new("apt-get");
        command.env("APT_CONFIG", apt.join("apt.conf")).args(["-qq", "-y"]);
        command
    };
    let advice = |failure: Failure| {
        Failure::new(format!(
            "cannot fetch the pinned driver: {failure}\nThe tests need Debian {SUITE}'s {}.\n\
             Without a network, copy {} from a machine that has it, or set MOTES_DRIVER to such a folder.",
            PACKAGES.join(", "),
            prefix.with_extension("").display(),
        ))
    };
    shell::quietly(apt_get().arg("update")).map_err(advice)?;
    shell::quietly(apt_get().args(["--download-only", "install"]).args(PACKAGES)).map_err(advice)?;

    let mut versions = Vec::new();
    for entry in fs::read_dir(&archives).context(|| format!("cannot read {}", archives.display()))? {
        let archive = entry.context(|| format!("cannot read {}", archives.display()))?.path();
        if archive.extension().is_none_or(|extension| extension != "deb") {
            continue;
        }
        shell::quietly(Command::new("dpkg-deb").arg("-x").arg(&archive).arg(&root))?;
        let fields = ["-f"].map(std::ffi::OsStr::new).into_iter().chain([archive.as_os_str()]);
        let control = shell::answer(Command::new("dpkg-deb").args(fields)).unwrap_or_default();
        let field = |key: &str| control.lines().find_map(|line| line.strip_prefix(key)).unwrap_or("?").trim();
        versions.push(format!("{} {}\n", field("Package:"), field("Version:")));
    }
    for unneeded in ["usr/share/doc", "usr/share/man", "usr/share/locale"] {
        let folder = root.join(unneeded);
        if folder.is_dir() {
            fs::remove_dir_all(&folder).context(|| format!("cannot remove {}", folder.display()))?;
        }
    }
    fs::remove_dir_all(&apt).context(|| format!("cannot remove {}", apt.display()))?;
    versions.sort();
    shell::write_if_changed(&prefix.join(VERSIONS), versions.concat())
}

/// Where packages of [`SUITE`] come from.
#[derive(Debug, PartialEq, Eq)]
struct Source {
    mirror: String,
    /// A key file, or nothing where apt's trusted keys do.
    keys: Option<String>,
}

impl Source {
    fn of_this_machine() -> Result<Self> {
        const KEYS: &str = "/usr/share/keyrings/debian-archive-keyring.gpg";
        let usual = Path::new(KEYS).is_file().then(|| KEYS.to_owned());
        if let Ok(mirror) = std::env::var("MOTES_DEBIAN_MIRROR") {
            if usual.is_none() {
                return Err(Failure::new(format!(
                    "MOTES_DEBIAN_MIRROR is set, but Debian's keys are not at {KEYS}: install debian-archive-keyring"
                )));
            }
            return Ok(Self { mirror, keys: usual });
        }
        let system = host::Distribution::of_this_machine();
        let listed = (system.id == "debian")
            .then(|| {
                shell::answer(Command::new("apt-get").args([
                    "indextargets",
                    "--format",
                    "$(CODENAME) $(REPO_URI) $(SIGNED_BY)",
                    "Created-By: Packages",
                ]))
            })
            .flatten()
            .unwrap_or_default();
        let mut source = Self::in_index(&listed, &system.codename).ok_or_else(|| {
            Failure::new(format!(
                "no driver for the tests: this system ({}) has neither Mesa 25.0 or newer nor a Debian mirror in \
                 its apt sources.\nEither install a Mesa of 25.0 or newer with lavapipe, the Vulkan validation layers \
                 and Monado;\nor install debian-archive-keyring, and set MOTES_DEBIAN_MIRROR to the address of a \
                 Debian mirror;\nor set MOTES_DRIVER to a driver folder from another machine.",
                if system.name.is_empty() { "unknown" } else { &system.name }
            ))
        })?;
        source.keys = source.keys.or(usual);
        Ok(source)
    }

    /// The first entry of the release `codename` in apt's list of index targets.
    fn in_index(listed: &str, codename: &str) -> Option<Self> {
        listed.lines().find_map(|line| {
            let mut words = line.split_whitespace();
            let (release, mirror) = (words.next()?, words.next()?);
            let keys = words.next().filter(|keys| keys.starts_with('/')).map(str::to_owned);
            (release == codename && !codename.is_empty()).then(|| Self { mirror: mirror.to_owned(), keys })
        })
    }

    fn line(&self) -> String {
        let signed = self.keys.as_ref().map(|keys| format!("[signed-by={keys}] ")).unwrap_or_default();
        format!("deb {signed}{} {SUITE} main\n", self.mirror)
    }
}

/// Settings for an apt with a state of its own. Of the machine's settings only those about how to fetch
/// (proxies, time-outs) are kept: hooks of the system must not run.
fn settings(apt: &Path, dump: &str) -> String {
    let mut text: String = dump
        .lines()
        .filter(|line| line.starts_with("Acquire::") && !line.starts_with("Acquire::IndexTargets"))
        .filter(|line| !line.starts_with("Acquire::Languages"))
        .map(|line| format!("{line}\n"))
        .collect();
    let apt = apt.display();
    let architecture = match std::env::consts::ARCH {
        "x86_64" => "amd64",
        "aarch64" => "arm64",
        other => other,
    };
    for (key, value) in [
        ("Dir::State::Lists", format!("{apt}/lists")),
        ("Dir::State::status", format!("{apt}/status")),
        ("Dir::Cache", format!("{apt}/cache")),
        ("Dir::Etc::SourceList", format!("{apt}/sources.list")),
        ("Dir::Etc::SourceParts", format!("{apt}/empty")),
        ("Dir::Etc::PreferencesParts", format!("{apt}/empty")),
        ("Dir::Etc::Preferences", "/dev/null".into()),
        ("Dir::Etc::Parts", format!("{apt}/empty")),
        ("Dir::Etc::Main", "/dev/null".into()),
        ("APT::Architecture", architecture.into()),
        ("APT::Architectures", architecture.into()),
        ("APT::Install-Recommends", "false".into()),
        ("Acquire::Languages", "none".into()),
        // A lock of our own guards this state; the system's package database is not touched.
        ("Debug::NoLocking", "true".into()),
    ] {
        text.push_str(&format!("{key} \"{value}\";\n"));
    }
    if host::is_root() {
        text.push_str("APT::Sandbox::User \"root\";\n");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mirror_is_the_machines_own() {
        let listed = "bookworm-security http://mirror.example/security/ /k.gpg\n\
                      bookworm http://mirror.example/debian/ /usr/share/keyrings/k.gpg\n";
        let source = Source::in_index(listed, "bookworm").unwrap();
        assert_eq!(source.mirror, "http://mirror.example/debian/");
        assert_eq!(
            source.line(),
            format!("deb [signed-by=/usr/share/keyrings/k.gpg] http://mirror.example/debian/ {SUITE} main\n")
        );
        let bare = Source::in_index("sid http://mirror.example/debian/ \n", "sid").unwrap();
        assert_eq!(bare.keys, None);
        assert_eq!(bare.line(), format!("deb http://mirror.example/debian/ {SUITE} main\n"));
        assert_eq!(Source::in_index(listed, "trixie"), None);
        assert_eq!(Source::in_index(" http://mirror.example/debian/\n", ""), None);
    }

    #[test]
    fn only_fetching_is_taken_from_the_machines_settings() {
        let dump = "APT::Update::Post-Invoke:: \"rm -f /x\";\nAcquire::http::Proxy \"http://proxy.example:1\";\n\
                    Acquire::IndexTargets::deb::Packages \"\";\nDir \"/\";\n";
        let text = settings(Path::new("/p/apt"), dump);
        assert!(text.contains("Acquire::http::Proxy \"http://proxy.example:1\";"));
        assert!(
            !text.contains("Post-Invoke") && !text.contains("IndexTargets") && !text.contains("Dir \"/\"")
        );
        assert!(text.contains("Dir::State::Lists \"/p/apt/lists\";"));
    }
}
