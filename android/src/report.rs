//! Where messages go: the `log` facade to logcat, and panics to logcat and to a file.

use std::fs::OpenOptions;
use std::io::Write;
use std::path::PathBuf;

use android_logger::Config;
use log::LevelFilter;

/// The tag of every line in logcat: `adb logcat -s motes`.
const TAG: &str = "motes";

/// Appended to by every panic; in the app's external files, where `adb pull` reaches it.
const PANIC_FILE: &str = "panic.txt";

/// Sends the log to logcat, and panics to logcat and to `panic.txt` in `folder`.
///
/// May be called again when the activity is started again in the same process: the logger stays, the folder
/// is the new one.
pub fn start(folder: Option<PathBuf>) {
    android_logger::init_once(Config::default().with_max_level(LevelFilter::Info).with_tag(TAG));
    std::panic::set_hook(Box::new(move |panic| {
        let thread = std::thread::current();
        let text = format!("version {}, thread {:?}: {panic}", env!("CARGO_PKG_VERSION"), thread.name());
        log::error!("{text}");
        let Some(folder) = &folder else { return };
        let written = std::fs::create_dir_all(folder)
            .and_then(|()| OpenOptions::new().create(true).append(true).open(folder.join(PANIC_FILE)))
            .and_then(|mut file| writeln!(file, "{text}"));
        if let Err(error) = written {
            log::error!("cannot write {}: {error}", folder.join(PANIC_FILE).display());
        }
    }));
}
