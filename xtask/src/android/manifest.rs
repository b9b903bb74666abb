//! The application's manifest, as far as the tools must know it.

use std::path::PathBuf;

use crate::shell::{Context, Failure, Result};
use crate::workspace;

/// The namespace of the attributes that Android defines.
const NAMESPACE: &str = "http://schemas.android.com/apk/res/android";
const FILE: &str = "android/AndroidManifest.xml";

#[derive(Debug)]
pub struct Manifest {
    /// The application's identifier.
    pub package: String,
    /// The oldest API level on which it runs.
    pub minimum_api: u32,
}

impl Manifest {
    pub fn read() -> Result<Self> {
        let file = Self::file();
        Self::parse(&std::fs::read_to_string(&file).context(|| format!("cannot read {}", file.display()))?)
    }

    pub fn file() -> PathBuf {
        workspace::root().join(FILE)
    }

    fn parse(text: &str) -> Result<Self> {
        let document = roxmltree::Document::parse(text).context(|| format!("{FILE} is not XML"))?;
        let root = document.root_element();
        let missing = |what: &str| Failure::new(format!("{FILE}: {what} is missing"));
        let package =
            root.attribute("package").ok_or_else(|| missing("the attribute package of <manifest>"))?;
        let minimum_api = root
            .children()
            .find(|child| child.has_tag_name("uses-sdk"))
            .and_then(|sdk| sdk.attribute((NAMESPACE, "minSdkVersion"))?.parse().ok())
            .ok_or_else(|| missing("a number in android:minSdkVersion of <uses-sdk>"))?;
        Ok(Self { package: package.to_owned(), minimum_api })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_projects_own_manifest_is_read() {
        let manifest = Manifest::read().unwrap();
        assert!(manifest.minimum_api >= 29, "{}", manifest.minimum_api);
        assert!(manifest.package.contains('.'));
    }

    #[test]
    fn what_is_missing_is_named() {
        let failure = |text: &str| Manifest::parse(text).unwrap_err().to_string();
        assert!(failure("<manifest package='a.b'/>").contains("minSdkVersion"));
        assert!(failure("<manifest/>").contains("package"));
        assert!(failure("<manifest").contains("not XML"));
    }
}
