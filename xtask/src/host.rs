//! What the machine must have besides Rust, and how it gets there.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::shell::{self, Failure, Result, say};

/// What the machine is asked to do; each purpose includes the ones before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Purpose {
    /// Compile every package.
    Build,
    /// Open a window.
    View,
    /// Run every test; windows are tested on a display without a screen.
    Test,
}

/// How the presence of something is seen.
#[derive(Clone, Copy, Debug)]
enum Probe {
    /// A program on the search path.
    Program(&'static str),
    /// A library that pkg-config knows.
    Development(&'static str),
    /// A shared library, by the name under which it is opened at run time.
    Library(&'static str),
}

impl Probe {
    fn is_there(self) -> bool {
        match self {
            Self::Program(name) => shell::program(name).is_some(),
            Self::Development(name) => {
                shell::answer(Command::new("pkg-config").args(["--exists", name])).is_some()
            }
            Self::Library(name) => library_folders().iter().any(|folder| folder.join(name).exists()),
        }
    }
}

struct Need {
    probe: Probe,
    /// Debian's and Ubuntu's package.
    package: &'static str,
    purpose: Purpose,
    why: &'static str,
}

const NEEDS: &[Need] = &[
    Need {
        probe: Probe::Program("g++"),
        package: "g++",
        purpose: Purpose::Build,
        why: "C++ compiler: builds the shader compiler and the FLIP image measure",
    },
    Need {
        probe: Probe::Program("pkg-config"),
        package: "pkg-config",
        purpose: Purpose::Build,
        why: "finds libudev",
    },
    Need {
        probe: Probe::Development("libudev"),
        package: "libudev-dev",
        purpose: Purpose::Build,
        why: "gamepads",
    },
    Need {
        probe: Probe::Library("libxkbcommon-x11.so.0"),
        package: "libxkbcommon-x11-0",
        purpose: Purpose::View,
        why: "keyboard of a window under X11",
    },
    Need {
        probe: Probe::Library("libXcursor.so.1"),
        package: "libxcursor1",
        purpose: Purpose::View,
        why: "mouse pointer of a window under X11",
    },
    Need {
        probe: Probe::Library("libXi.so.6"),
        package: "libxi6",
        purpose: Purpose::View,
        why: "mouse motion under X11",
    },
    Need {
        probe: Probe::Library("libX11-xcb.so.1"),
        package: "libx11-xcb1",
        purpose: Purpose::View,
        why: "a window under X11",
    },
    Need {
        probe: Probe::Program("Xvfb"),
        package: "xvfb",
        purpose: Purpose::Test,
        why: "the display on which windows are tested",
    },
    Need {
        probe: Probe::Program("xdotool"),
        package: "xdotool",
        purpose: Purpose::Test,
        why: "presses the keys in window tests",
    },
];

/// Makes sure that everything for a purpose is there; installs what is missing where it may.
pub fn provide(purpose: Purpose) -> Result<()> {
    if cfg!(not(target_os = "linux")) {
        if purpose == Purpose::Test {
            return Err(Failure::new(
                "the tests run on a pinned Linux driver: run them on Linux (a virtual machine or WSL will do)",
            ));
        }
        say("this is not Linux: a C++ compiler and a Vulkan driver are taken to be installed");
        return Ok(());
    }
    let missing = || NEEDS.iter().filter(|need| need.purpose <= purpose && !need.probe.is_there());
    let packages: Vec<&str> = missing().map(|need| need.package).collect();
    if packages.is_empty() {
        return Ok(());
    }
    for need in missing() {
        say(&format!("missing: {} ({})", need.package, need.why));
    }
    install(&packages)?;
    match missing().next() {
        None => Ok(()),
        Some(need) => Err(Failure::new(format!(
            "{} was installed, but {:?} is still not found",
            need.package, need.probe
        ))),
    }
}

/// Installs packages of Debian or Ubuntu; where that is not allowed or fails, says what the user has to do.
pub fn install(packages: &[&str]) -> Result<()> {
    let line = format!("sudo apt-get install --no-install-recommends {}", packages.join(" "));
    if shell::program("apt-get").is_none() {
        return Err(Failure::new(format!(
            "this system has no apt-get. Install, under the names that it uses, what Debian calls: {}",
            packages.join(" ")
        )));
    }
    let Some(mut refresh) = apt_get() else {
        return Err(Failure::new(format!(
            "cannot install packages as this user (neither root, nor sudo without a password). Run:\n  {line}"
        )));
    };
    say(&format!("installing with apt: {}", packages.join(" ")));
    // An old index is no reason to stop: what follows says what is wrong.
    let refreshed = shell::quietly(refresh.args(["-qq", "update"]));
    let mut install = apt_get().ok_or_else(|| Failure::new("apt-get is gone"))?;
    install.args(["-qq", "-y", "--no-install-recommends", "install"]).args(packages);
    shell::quietly(&mut install).map_err(|failure| {
        let index = refreshed.err().map(|failure| format!("\nBefore that, {failure}")).unwrap_or_default();
        Failure::new(format!("{failure}{index}\nInstall it yourself, then run this again:\n  {line}"))
    })?;
    Ok(())
}

/// `apt-get` with the right to install, where we have it.
pub fn apt_get() -> Option<Command> {
    shell::program("apt-get")?;
    let mut command = if is_root() {
        Command::new("apt-get")
    } else {
        shell::answer(Command::new("sudo").args(["-n", "true"]))?;
        let mut command = Command::new("sudo");
        command.args(["-n", "env", "DEBIAN_FRONTEND=noninteractive", "apt-get"]);
        command
    };
    command.env("DEBIAN_FRONTEND", "noninteractive");
    Some(command)
}

pub fn is_root() -> bool {
    shell::answer(Command::new("id").arg("-u")).as_deref() == Some("0")
}

/// The version of an installed package, or nothing.
pub fn installed_version(package: &str) -> Option<String> {
    let status = shell::answer(Command::new("dpkg-query").args([
        "-W",
        "-f",
        "${db:Status-Status} ${Version}\\n",
        package,
    ]))?;
    status.lines().find_map(|line| line.strip_prefix("installed ")).map(str::to_owned)
}

/// The version that apt would install, or nothing.
pub fn offered_version(package: &str) -> Option<String> {
    let policy = shell::answer(Command::new("apt-cache").env("LC_ALL", "C").args(["policy", package]))?;
    let version = policy.lines().find_map(|line| line.trim().strip_prefix("Candidate: "))?;
    (version != "(none)").then(|| version.to_owned())
}

/// Debian's name for this machine's folder of libraries, such as `x86_64-linux-gnu`.
pub fn multiarch() -> String {
    format!("{}-linux-gnu", std::env::consts::ARCH)
}

/// Where shared libraries of the system are.
pub fn library_folders() -> Vec<PathBuf> {
    let multiarch = multiarch();
    [format!("/usr/lib/{multiarch}"), format!("/lib/{multiarch}")]
        .iter()
        .map(String::as_str)
        .chain(["/usr/lib64", "/lib64", "/usr/lib", "/lib", "/usr/local/lib"])
        .map(PathBuf::from)
        .filter(|folder| folder.is_dir())
        .collect()
}

/// What `/etc/os-release` says.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Distribution {
    /// `debian`, `ubuntu`, …
    pub id: String,
    /// `bookworm`, `noble`, …; may be empty.
    pub codename: String,
    /// For people.
    pub name: String,
}

impl Distribution {
    pub fn of_this_machine() -> Self {
        Self::parse(&std::fs::read_to_string(Path::new("/etc/os-release")).unwrap_or_default())
    }

    fn parse(text: &str) -> Self {
        let value = |key: &str| {
            text.lines()
                .filter_map(|line| line.split_once('='))
                .find(|(name, _)| *name == key)
                .map(|(_, value)| value.trim().trim_matches('"').to_owned())
                .unwrap_or_default()
        };
        Self { id: value("ID"), codename: value("VERSION_CODENAME"), name: value("PRETTY_NAME") }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn os_release_is_read() {
        let text = "PRETTY_NAME=\"Debian GNU/Linux 12 (bookworm)\"\nVERSION_CODENAME=bookworm\nID=debian\n";
        let read = Distribution::parse(text);
        assert_eq!(read.id, "debian");
        assert_eq!(read.codename, "bookworm");
        assert_eq!(read.name, "Debian GNU/Linux 12 (bookworm)");
        assert_eq!(Distribution::parse(""), Distribution::default());
    }

    #[test]
    fn purposes_include_the_ones_before() {
        assert!(Purpose::Build < Purpose::View && Purpose::View < Purpose::Test);
    }

    #[test]
    fn probes_tell_there_from_missing() {
        assert!(Probe::Program("sh").is_there());
        assert!(!Probe::Program("no-such-program-anywhere").is_there());
        assert!(!Probe::Library("libnowhere.so.77").is_there());
        assert!(!Probe::Development("no-such-library-anywhere").is_there());
    }
}
