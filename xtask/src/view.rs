//! `cargo xtask view`: a scene on the screen, from nothing but a checkout.

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use crate::shell::{self, Context, Failure, Result, say};
use crate::{driver, host, test, workspace};

/// Pictures that are rendered where there is no display.
const PICTURES: &str = "4";

/// Opens a window on scenes (the sample that is built in when none is named), or renders pictures of them where
/// there is no display. Arguments after the first that begins with `-` are motes' own.
pub fn view(arguments: &[String]) -> Result<ExitCode> {
    let mut words = arguments.to_vec();
    let options = words.iter().position(|word| word.starts_with('-')).unwrap_or(words.len());
    let options = words.split_off(options);
    let scenes: Vec<PathBuf> = words
        .iter()
        .map(|scene| {
            let place = std::path::absolute(scene).context(|| format!("cannot make {scene:?} absolute"))?;
            place.metadata().context(|| format!("cannot open the scene {}", place.display()))?;
            Ok(place)
        })
        .collect::<Result<_>>()?;
    host::provide(host::Purpose::View)?;
    say("building motes (the first time takes some minutes)");
    shell::run(workspace::cargo().args([
        "build",
        "--release",
        "--package",
        "motes-desktop",
        "--bin",
        "motes",
    ]))?;
    let program = workspace::target().join("release").join(format!("motes{}", std::env::consts::EXE_SUFFIX));
    let mut motes = on_best_driver(&program)?;
    if has_display() {
        return Ok(test::code(shell::status(motes.args(&scenes).args(&options))?));
    }
    let folder = workspace::target().join("view");
    say(
        "there is no display (neither DISPLAY nor WAYLAND_DISPLAY is set): rendering pictures instead of a window",
    );
    remove_pictures(&folder)?;
    std::fs::create_dir_all(&folder).context(|| format!("cannot make the folder {}", folder.display()))?;
    motes.arg("render").args(&scenes).args(["--turntable", PICTURES]).args(&options).arg("-o").arg(&folder);
    shell::run(&mut motes)?;
    let pictures = pictures(&folder)?;
    if pictures.is_empty() {
        return Err(Failure::new(format!("motes rendered nothing into {}", folder.display())));
    }
    pictures.iter().for_each(|picture| println!("{}", picture.display()));
    Ok(ExitCode::SUCCESS)
}

/// The system's driver where there is a GPU, else the CPU driver that tests run on.
fn on_best_driver(program: &Path) -> Result<Command> {
    if cfg!(not(target_os = "linux")) || has_gpu() {
        return Ok(Command::new(program));
    }
    let driver = driver::provide()?;
    say(&format!("no GPU with a Vulkan driver here: drawing on the CPU ({}), slowly", driver.description()));
    let mut command = driver.command(program);
    workspace::without_cargo_run(&mut command);
    Ok(command)
}

/// Whether the kernel offers a GPU and a Vulkan driver other than a CPU one is installed; a driver that the
/// environment names is the user's choice.
fn has_gpu() -> bool {
    const DEVICES: [&str; 3] = ["renderD", "nvidia0", "dxg"];
    let has_device = ["/dev/dri", "/dev"]
        .iter()
        .flat_map(|folder| names(Path::new(folder)))
        .any(|name| DEVICES.iter().any(|device| name.starts_with(device)));
    let home = std::env::var_os("HOME").map(|home| Path::new(&home).join(".local/share"));
    let has_driver = ["/usr/share", "/usr/local/share", "/etc"]
        .iter()
        .map(PathBuf::from)
        .chain(home)
        .flat_map(|place| names(&place.join("vulkan/icd.d")))
        .any(|name| name.ends_with(".json") && !name.starts_with("lvp"));
    has_device && has_driver || ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"].iter().any(|name| is_set(name))
}

fn is_set(name: &str) -> bool {
    std::env::var_os(name).is_some_and(|value| !value.is_empty())
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect()
}

fn has_display() -> bool {
    cfg!(not(target_os = "linux")) || is_set("DISPLAY") || is_set("WAYLAND_DISPLAY")
}

fn pictures(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut found: Vec<PathBuf> = std::fs::read_dir(folder)
        .context(|| format!("cannot read {}", folder.display()))?
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "png"))
        .collect();
    found.sort();
    Ok(found)
}

/// Pictures of an earlier run must not be taken for this one's.
fn remove_pictures(folder: &Path) -> Result<()> {
    if folder.is_dir() {
        for picture in pictures(folder)? {
            std::fs::remove_file(&picture).context(|| format!("cannot remove {}", picture.display()))?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_pictures_are_listed_and_removed() {
        let folder = std::env::temp_dir().join(format!("motes-xtask-view-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        for name in ["b.png", "a.png", "note.txt"] {
            std::fs::write(folder.join(name), "").unwrap();
        }
        assert_eq!(pictures(&folder).unwrap(), [folder.join("a.png"), folder.join("b.png")]);
        remove_pictures(&folder).unwrap();
        assert!(pictures(&folder).unwrap().is_empty());
        assert!(folder.join("note.txt").exists());
        std::fs::remove_dir_all(&folder).unwrap();
        remove_pictures(&folder).unwrap();
    }

    #[test]
    fn a_scene_that_is_not_there_is_named_before_anything_is_built() {
        let text = view(&["/nowhere/garden.ply".to_owned()]).unwrap_err().to_string();
        assert!(text.contains("/nowhere/garden.ply"), "{text}");
    }
}
