//! The scenes in a folder, looked for again and again on a thread of its own: they are pushed while the viewer runs.

use motes_app::headset::Offered;
use motes_app::opened::name_of;
use motes_app::thumbnail::Thumbnail;
use motes_scenes::{Format, looks_like_sequence};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// How often the folder is looked at.
const LOOK: Duration = Duration::from_secs(2);

/// Scenes, each with its place.
type Scenes = Vec<(PathBuf, Offered)>;

/// Watches a folder. Dropping it ends the thread.
pub(crate) struct Shelf {
    news: Receiver<Scenes>,
    /// Where the scenes that were told last are.
    paths: Vec<PathBuf>,
    /// Gone when the thread is to end.
    stop: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Shelf {
    /// Begins to watch a folder, which need not be there yet; pictures of its scenes are in `thumbnails`.
    ///
    /// # Errors
    /// The system gives no thread.
    pub fn watch(folder: &Path, thumbnails: Option<&Path>) -> std::io::Result<Self> {
        let mut watcher = Watcher {
            folder: folder.to_owned(),
            thumbnails: thumbnails.map(Path::to_owned),
            pictures: HashMap::new(),
            known: Vec::new(),
        };
        let (teller, news) = channel();
        let (stop, stopped) = channel::<()>();
        let thread = std::thread::Builder::new().name("shelf".into()).spawn(move || {
            loop {
                if let Some(scenes) = watcher.look()
                    && teller.send(scenes).is_err()
                {
                    return;
                }
                if stopped.recv_timeout(LOOK) != Err(RecvTimeoutError::Timeout) {
                    return;
                }
            }
        })?;
        Ok(Self { news, paths: Vec::new(), stop: Some(stop), thread: Some(thread) })
    }

    /// The scenes, where something has changed since. Never waits.
    pub fn news(&mut self) -> Option<Vec<Offered>> {
        let scenes = self.news.try_iter().last()?;
        let (paths, offered) = scenes.into_iter().unzip();
        self.paths = paths;
        Some(offered)
    }

    /// Where a scene is, by its place in what [`Shelf::news`] said last.
    pub fn scene(&self, index: usize) -> Option<&Path> {
        self.paths.get(index).map(PathBuf::as_path)
    }
}

impl Drop for Shelf {
    fn drop(&mut self) {
        self.stop = None;
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            log::error!("the thread that looks for scenes had panicked");
        }
    }
}

/// What the thread knows.
struct Watcher {
    folder: PathBuf,
    thumbnails: Option<PathBuf>,
    /// Pictures that were read, by their files.
    pictures: HashMap<PathBuf, Arc<Thumbnail>>,
    known: Scenes,
}

impl Watcher {
    /// Looks; the scenes, where they have changed. A folder that is not there is empty.
    fn look(&mut self) -> Option<Scenes> {
        let scenes: Scenes = scenes_in(&self.folder)
            .into_iter()
            .map(|path| {
                let picture = self.picture(&path);
                let name = name_of(&path);
                (path, Offered { name, picture })
            })
            .collect();
        if scenes == self.known {
            return None;
        }
        self.known.clone_from(&scenes);
        Some(scenes)
    }

    fn picture(&mut self, scene: &Path) -> Option<Arc<Thumbnail>> {
        let file = Thumbnail::file(self.thumbnails.as_deref()?, scene);
        if let Some(picture) = self.pictures.get(&file) {
            return Some(picture.clone());
        }
        let picture = Arc::new(Thumbnail::load(&file)?);
        self.pictures.insert(file, picture.clone());
        Some(picture)
    }
}

/// The scenes in a folder, by name: files, folders that are one scene, folders of frames. None where there is no folder.
pub fn scenes_in(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let is_scene = |path: &PathBuf| {
        let holds = |name: &str| path.join(name).is_file();
        if path.is_dir() {
            holds("meta.json") || holds("lod-meta.json") || looks_like_sequence(path)
        } else {
            Format::is_scene_name(path)
        }
    };
    let mut scenes: Vec<PathBuf> =
        entries.filter_map(|entry| Some(entry.ok()?.path())).filter(is_scene).collect();
    scenes.sort();
    scenes
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may")]
mod tests {
    use super::*;

    #[test]
    fn scenes_that_are_pushed_are_seen() {
        let folder = std::env::temp_dir().join(format!("motes-shelf-{}", std::process::id()));
        let mut watcher =
            Watcher { folder: folder.clone(), thumbnails: None, pictures: HashMap::new(), known: Vec::new() };
        assert!(watcher.look().is_none(), "there is no folder yet");
        std::fs::create_dir_all(folder.join("sog")).unwrap();
        for file in ["b.ply", "a.splat", "notes.txt", "sog/meta.json"] {
            std::fs::write(folder.join(file), "").unwrap();
        }
        let names = |scenes: &Scenes| scenes.iter().map(|(_, s)| s.name.clone()).collect::<Vec<_>>();
        assert_eq!(names(&watcher.look().unwrap()), ["a.splat", "b.ply", "sog"]);
        assert!(watcher.look().is_none(), "nothing has changed");
        let mut shelf = Shelf::watch(&folder, None).unwrap();
        let offered = loop {
            match shelf.news() {
                Some(offered) => break offered,
                None => std::thread::sleep(Duration::from_millis(1)),
            }
        };
        assert_eq!((offered.len(), shelf.scene(1)), (3, Some(&*folder.join("b.ply"))));
        assert_eq!(shelf.scene(3), None);
        std::fs::remove_dir_all(&folder).unwrap();
        assert!(watcher.look().unwrap().is_empty());
    }
}
