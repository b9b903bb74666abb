//! The attributes of Android's own namespace that our manifest uses.
//!
//! In a binary manifest an attribute is known by a number, and its value has a type. Both are fixed for ever in
//! the framework's `public.xml` and `attrs_manifest.xml`; listed here is what Motes needs. An attribute that is
//! not listed is refused when the manifest is encoded, never passed on without its number: the system would
//! ignore it silently.

/// What the text of an attribute means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Text.
    Text,
    /// Text, but `true`, `false` and numbers become values (the `value` of meta-data).
    Any,
    /// `true` or `false`.
    Boolean,
    /// A decimal or `0x` number.
    Integer,
    /// One of these names.
    Enumeration(&'static [(&'static str, u32)]),
    /// Names joined with `|`.
    Flags(&'static [(&'static str, u32)]),
    /// One of the framework's own resources.
    Reference(&'static [(&'static str, u32)]),
}

/// An attribute of the namespace `http://schemas.android.com/apk/res/android`.
#[derive(Clone, Copy, Debug)]
pub struct Attribute {
    /// Its name in XML.
    pub name: &'static str,
    /// Its resource number.
    pub id: u32,
    /// What its text means.
    pub kind: Kind,
}

const fn attribute(name: &'static str, id: u32, kind: Kind) -> Attribute {
    Attribute { name, id, kind }
}

/// The attribute of this name.
#[must_use]
pub fn by_name(name: &str) -> Option<&'static Attribute> {
    ATTRIBUTES.iter().find(|attribute| attribute.name == name)
}

static ATTRIBUTES: &[Attribute] = &[
    attribute("theme", 0x0101_0000, Kind::Reference(THEMES)),
    attribute("label", 0x0101_0001, Kind::Text),
    attribute("name", 0x0101_0003, Kind::Text),
    attribute("hasCode", 0x0101_000c, Kind::Boolean),
    attribute("debuggable", 0x0101_000f, Kind::Boolean),
    attribute("exported", 0x0101_0010, Kind::Boolean),
    attribute("excludeFromRecents", 0x0101_0017, Kind::Boolean),
    attribute("authorities", 0x0101_0018, Kind::Text),
    attribute("launchMode", 0x0101_001d, Kind::Enumeration(LAUNCH_MODES)),
    attribute("screenOrientation", 0x0101_001e, Kind::Enumeration(ORIENTATIONS)),
    attribute("configChanges", 0x0101_001f, Kind::Flags(CONFIG_CHANGES)),
    attribute("value", 0x0101_0024, Kind::Any),
    attribute("minSdkVersion", 0x0101_020c, Kind::Integer),
    attribute("versionCode", 0x0101_021b, Kind::Integer),
    attribute("versionName", 0x0101_021c, Kind::Text),
    attribute("targetSdkVersion", 0x0101_0270, Kind::Integer),
    attribute("allowBackup", 0x0101_0280, Kind::Boolean),
    attribute("required", 0x0101_028e, Kind::Boolean),
    attribute("installLocation", 0x0101_02b7, Kind::Enumeration(INSTALL_LOCATIONS)),
    attribute("extractNativeLibs", 0x0101_04ea, Kind::Boolean),
    attribute("resizeableActivity", 0x0101_04f6, Kind::Boolean),
    attribute("version", 0x0101_0519, Kind::Integer),
];

static THEMES: &[(&str, u32)] = &[("@android:style/Theme.Black.NoTitleBar.Fullscreen", 0x0103_000a)];

static LAUNCH_MODES: &[(&str, u32)] =
    &[("standard", 0), ("singleTop", 1), ("singleTask", 2), ("singleInstance", 3)];

static ORIENTATIONS: &[(&str, u32)] = &[("landscape", 0), ("portrait", 1), ("user", 2)];

static INSTALL_LOCATIONS: &[(&str, u32)] = &[("auto", 0), ("internalOnly", 1), ("preferExternal", 2)];

static CONFIG_CHANGES: &[(&str, u32)] = &[
    ("mcc", 0x1),
    ("mnc", 0x2),
    ("locale", 0x4),
    ("touchscreen", 0x8),
    ("keyboard", 0x10),
    ("keyboardHidden", 0x20),
    ("navigation", 0x40),
    ("orientation", 0x80),
    ("screenLayout", 0x100),
    ("uiMode", 0x200),
    ("screenSize", 0x400),
    ("smallestScreenSize", 0x800),
    ("density", 0x1000),
    ("layoutDirection", 0x2000),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_ascend_and_occur_once() {
        assert!(ATTRIBUTES.windows(2).all(|pair| pair[0].id < pair[1].id));
    }
}
