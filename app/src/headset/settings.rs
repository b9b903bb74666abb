//! The headset's settings file: comfort, and what runtimes call bindings.

use super::Comfort;
use crate::governor::Budget;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// A settings file longer than this is none.
const MAX_LENGTH: u64 = 1 << 20;

/// What a user can set for the headset. `B` is the bindings' form, which belongs to who reads controllers.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HeadsetSettings<B> {
    /// Comfort options.
    pub comfort: Comfort,
    /// What a frame may take, such as `"18"` (layers per pixel) or `"9ms"`; nothing is held without.
    pub budget: Option<Budget>,
    /// Frames a second that the display is asked for, of the rates that it offers the nearest; what it chooses without.
    pub refresh_rate: Option<f32>,
    /// Tells the compositor how far away pixels are, where it wants to know.
    pub depth_layer: bool,
    /// Lets the budget be held by coarser rims of the images, where headset and device offer that.
    pub foveation: bool,
    /// Changes to what buttons do.
    pub bindings: B,
}

/// A settings file that cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{}: {problem}. Correct it, or delete the file to start from the defaults", path.display())]
pub struct SettingsError {
    /// The file.
    pub path: PathBuf,
    /// What is wrong, and where.
    pub problem: String,
}

impl<B: Default + for<'de> Deserialize<'de>> HeadsetSettings<B> {
    /// Reads a file; the defaults where there is none.
    ///
    /// # Errors
    /// The file cannot be read, or says what is not possible.
    pub fn load(path: &Path) -> Result<Self, SettingsError> {
        let error = |problem: String| SettingsError { path: path.to_owned(), problem };
        let length = match std::fs::metadata(path) {
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Self::default()),
            metadata => metadata.map_err(|e| error(e.to_string()))?.len(),
        };
        if length > MAX_LENGTH {
            return Err(error(format!("{length} bytes are too many for settings")));
        }
        let text = std::fs::read_to_string(path).map_err(|e| error(e.to_string()))?;
        let settings: Self = serde_json::from_str(&text).map_err(|e| error(e.to_string()))?;
        settings.comfort.check().map_err(error)?;
        if let Some(rate) = settings.refresh_rate
            && !(1.0..=1000.0).contains(&rate)
        {
            return Err(error(format!("refresh_rate must be 1 to 1000 Hz, not {rate}")));
        }
        Ok(settings)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may")]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    type Settings = HeadsetSettings<BTreeMap<String, String>>;

    fn load(text: &str) -> Result<Settings, SettingsError> {
        let file = std::env::temp_dir().join(format!("motes-headset-{}.json", std::process::id()));
        std::fs::write(&file, text).unwrap();
        let settings = Settings::load(&file);
        std::fs::remove_file(&file).unwrap();
        settings
    }

    #[test]
    fn a_file_changes_what_it_names() {
        assert_eq!(Settings::load(Path::new("/nowhere/headset.json")).unwrap(), Settings::default());
        let text = r#"{"comfort": {"snap_degrees": 45, "left_handed": true}, "budget": "18",
            "depth_layer": true, "refresh_rate": 90, "bindings": {"a": "b"}}"#;
        let settings = load(text).unwrap();
        let expected = Comfort { snap_degrees: 45.0, left_handed: true, ..Default::default() };
        assert_eq!(settings.comfort, expected);
        assert_eq!(settings.bindings["a"], "b");
        assert_eq!(settings.budget, Some(Budget::Layers(18.0)));
        assert_eq!(settings.refresh_rate, Some(90.0));
        assert!(settings.depth_layer && !Settings::default().depth_layer);
    }

    #[test]
    fn a_file_that_cannot_be_used_says_why() {
        for (text, part) in [
            ("{", "line 1"),
            (r#"{"comfrt": {}}"#, "comfrt"),
            (r#"{"budget": "much"}"#, "is no budget"),
            (r#"{"refresh_rate": 0}"#, "refresh_rate must be 1 to 1000 Hz, not 0"),
            (r#"{"comfort": {"snap_degrees": -3}}"#, "snap_degrees must be 0 to 180"),
        ] {
            let error = load(text).unwrap_err().to_string();
            assert!(error.contains(part) && error.contains("motes-headset"), "{error}");
        }
    }
}
