//! Packs, signs and reads back Android packages (APK), with neither SDK nor JDK.
//!
//! An APK is a zip file with a manifest in Android's binary XML ([`axml`]), native libraries that are stored
//! uncompressed and aligned so that they are mapped where they are ([`archive`]), and a signing block between the
//! entries and the directory ([`signing`]). [`inspect`] reads one back and compares it with what a headset wants.
//!
//! What is made here is checked in CI with Android's own `apksigner` and `aapt2`.

pub mod archive;
pub mod attributes;
pub mod axml;
pub mod error;
pub mod inspect;
pub mod key;
pub mod signing;

use std::path::{Path, PathBuf};

use archive::{ALIGNMENT, Entry, LIBRARIES, LIBRARY_ALIGNMENT, LOADER};
use error::{Error, Result};
use key::Key;

/// What goes into an APK.
#[derive(Clone, Debug, Default)]
pub struct Package {
    /// The manifest as XML.
    pub manifest: PathBuf,
    /// For people, such as `1.2.3`.
    pub version_name: String,
    /// For the system: an update must have a larger one.
    pub version_code: u32,
    /// Our native library; its name is kept.
    pub library: PathBuf,
    /// Where the OpenXR loader is: a library, an AAR or an APK.
    pub loader: Option<PathBuf>,
    /// Files to put below `assets/`, by name.
    pub assets: Vec<(String, PathBuf)>,
}

impl Package {
    /// The APK's bytes; signed where a key is given.
    ///
    /// # Errors
    /// When a file cannot be read, the manifest has a fault, or the loader is not found.
    pub fn pack(&self, key: Option<&Key>) -> Result<Vec<u8>> {
        let read = |file: &Path| std::fs::read(file).map_err(Error::file(file));
        let xml = std::fs::read_to_string(&self.manifest).map_err(Error::file(&self.manifest))?;
        let code = self.version_code.to_string();
        let version = [("versionName", &*self.version_name), ("versionCode", &*code)];
        let mut entries = vec![Entry {
            name: "AndroidManifest.xml".into(),
            data: axml::encode(&axml::parse(&xml, &version)?),
            alignment: ALIGNMENT,
        }];
        for (name, file) in &self.assets {
            entries.push(Entry { name: format!("assets/{name}"), data: read(file)?, alignment: ALIGNMENT });
        }
        let own = self.library.file_name().unwrap_or_default().to_string_lossy();
        let mut libraries = vec![(own.into_owned(), read(&self.library)?)];
        if let Some(loader) = &self.loader {
            libraries.push((LOADER.to_owned(), archive::loader(loader)?));
        }
        entries.extend(libraries.into_iter().map(|(name, data)| Entry {
            name: format!("{LIBRARIES}/{name}"),
            data,
            alignment: LIBRARY_ALIGNMENT,
        }));
        let zip = archive::pack(&entries)?;
        match key {
            Some(key) => signing::sign(&zip, key),
            None => Ok(zip),
        }
    }
}
