//! Reads an APK back and says whether a headset would take it.

use std::io::{Cursor, Read};

use object::read::elf::{ElfFile64, FileHeader, ProgramHeader};
use object::{Endianness, Object, ObjectSymbol, elf};
use zip::{CompressionMethod, ZipArchive};

use crate::archive::{LIBRARIES, LIBRARY_ALIGNMENT, LOADER};
use crate::axml::{self, Element, Value};
use crate::error::{Error, Result};
use crate::signing;

/// The system libraries that ours may need; every Android device has them.
pub const SYSTEM_LIBRARIES: [&str; 5] = ["libandroid.so", "libc.so", "libdl.so", "liblog.so", "libm.so"];
/// What the system (through android-activity) and android-activity look for in our library.
pub const ENTRY_POINTS: [&str; 2] = ["ANativeActivity_onCreate", "android_main"];
/// The largest our library may be, in bytes.
pub const LARGEST_LIBRARY: u64 = 12 << 20;
/// Elements that the manifest must have: tag, and attributes with their values as one would write them.
const MANIFEST: &[(&str, &[(&str, &str)])] = &[
    ("uses-feature", &[("name", "android.hardware.vr.headtracking"), ("required", "true"), ("version", "1")]),
    (
        "uses-feature",
        &[("name", "android.hardware.vulkan.version"), ("required", "true"), ("version", "0x401000")],
    ),
    ("uses-feature", &[("name", "oculus.software.handtracking"), ("required", "false")]),
    ("uses-feature", &[("name", "com.oculus.feature.PASSTHROUGH"), ("required", "false")]),
    ("uses-permission", &[("name", "com.oculus.permission.HAND_TRACKING")]),
    ("uses-permission", &[("name", "org.khronos.openxr.permission.OPENXR")]),
    ("uses-permission", &[("name", "org.khronos.openxr.permission.OPENXR_SYSTEM")]),
    (
        "provider",
        &[("authorities", "org.khronos.openxr.runtime_broker;org.khronos.openxr.system_runtime_broker")],
    ),
    ("action", &[("name", "org.khronos.openxr.OpenXRRuntimeService")]),
    ("action", &[("name", "org.khronos.openxr.OpenXRApiLayerService")]),
    ("application", &[("hasCode", "false"), ("extractNativeLibs", "false")]),
    ("uses-native-library", &[("name", "libopenxr_forwardloader.oculus.so"), ("required", "false")]),
    ("meta-data", &[("name", "com.oculus.supportedDevices"), ("value", "quest2|questpro|quest3|quest3s")]),
    ("meta-data", &[("name", "com.oculus.vr.focusaware"), ("value", "true")]),
    ("activity", &[("name", "android.app.NativeActivity"), ("exported", "true"), ("launchMode", "2")]),
    ("action", &[("name", "android.intent.action.MAIN")]),
    ("category", &[("name", "android.intent.category.LAUNCHER")]),
    ("category", &[("name", "com.oculus.intent.category.VR")]),
    ("category", &[("name", "org.khronos.openxr.intent.category.IMMERSIVE_HMD")]),
];

/// What reading an APK back showed.
#[derive(Debug, Default)]
pub struct Report {
    /// What is as it should be, and what is worth knowing.
    pub facts: Vec<String>,
    /// What is wrong. Empty: a headset would take it.
    pub problems: Vec<String>,
}

impl Report {
    fn fact(&mut self, text: impl Into<String>) {
        self.facts.push(text.into());
    }

    fn problem(&mut self, text: impl Into<String>) {
        self.problems.push(text.into());
    }

    fn require(&mut self, holds: bool, text: impl Into<String>) {
        if holds { self.fact(text) } else { self.problem(text) }
    }
}

/// A file of the archive.
struct Stored {
    name: String,
    data: Vec<u8>,
    start: u64,
    is_compressed: bool,
}

/// Checks an APK; `assets` are names below `assets/` that it must have.
///
/// # Errors
/// When it cannot be read as an APK at all.
pub fn check(apk: &[u8], assets: &[String]) -> Result<Report> {
    let mut report = Report::default();
    let files = files(apk)?;
    signatures(apk, &mut report);
    let library = manifest(&files, &mut report)?;
    libraries(&files, &library, &mut report)?;
    for name in assets {
        let place = format!("assets/{name}");
        match files.iter().find(|file| file.name == place) {
            Some(file) => report.fact(format!("{place}: {} bytes", file.data.len())),
            None => report.problem(format!("{place} is missing")),
        }
    }
    Ok(report)
}

fn files(apk: &[u8]) -> Result<Vec<Stored>> {
    /// Nothing in an APK of ours is near this.
    const LARGEST: u64 = 1 << 30;
    let mut archive = ZipArchive::new(Cursor::new(apk)).map_err(Error::zip("APK"))?;
    let mut files = Vec::new();
    for index in 0..archive.len() {
        let file = archive.by_index(index).map_err(Error::zip("APK"))?;
        let name = file.name().map_err(Error::zip("APK"))?.into_owned();
        let start = file.data_start().ok_or_else(|| Error::malformed(&name, "has no place in the APK"))?;
        let is_compressed = file.compression() != CompressionMethod::Stored;
        let mut data = Vec::new();
        file.take(LARGEST).read_to_end(&mut data).map_err(Error::file(&name))?;
        files.push(Stored { name, data, start, is_compressed });
    }
    Ok(files)
}

fn signatures(apk: &[u8], report: &mut Report) {
    match signing::verify(apk) {
        Ok(found) => {
            report.require(found.schemes == [2, 3], format!("signed with the schemes {:?}", found.schemes));
            let how =
                if found.verified { "signature and content checked" } else { "only the content was checked" };
            report.fact(format!("signer's certificate (SHA-256): {} ({how})", found.certificate));
        }
        Err(error) => report.problem(error.to_string()),
    }
}

/// Checks the manifest; returns the file name of the library that it names.
fn manifest(files: &[Stored], report: &mut Report) -> Result<String> {
    const NAME: &str = "AndroidManifest.xml";
    let file = files.iter().find(|file| file.name == NAME);
    let file = file.ok_or_else(|| Error::malformed("APK", format!("holds no {NAME}")))?;
    let root = axml::decode(&file.data)?;
    let shown = |element: &Element, name: &str| element.attribute(name).map(Value::shown);
    for name in ["package", "versionCode", "versionName"] {
        match shown(&root, name).filter(|text| !text.is_empty()) {
            Some(text) => report.fact(format!("{name} {text}")),
            None => report.problem(format!("the manifest has no {name}")),
        }
    }
    let level = |name: &str| match root.all("uses-sdk").first().and_then(|sdk| sdk.attribute(name)) {
        Some(Value::Integer(level)) => *level,
        _ => 0,
    };
    let (oldest, target) = (level("minSdkVersion"), level("targetSdkVersion"));
    report.require(
        (29..=target).contains(&oldest),
        format!("Android API levels: {oldest} at least, made for {target}"),
    );
    let mut missing = 0;
    for (tag, attributes) in MANIFEST {
        let is_there = root.all(tag).iter().any(|element| {
            attributes.iter().all(|(name, value)| shown(element, name).as_deref() == Some(*value))
        });
        if !is_there {
            missing += 1;
            let text: Vec<String> =
                attributes.iter().map(|(name, value)| format!("{name}=\"{value}\"")).collect();
            report.problem(format!("the manifest has no <{tag} {}>", text.join(" ")));
        }
    }
    if missing == 0 {
        report.fact(format!("all {} manifest entries that a headset asks for are there", MANIFEST.len()));
    }
    let named = root
        .all("meta-data")
        .into_iter()
        .find(|element| shown(element, "name").as_deref() == Some("android.app.lib_name"))
        .and_then(|element| shown(element, "value"));
    if named.is_none() {
        report.problem("the manifest does not name the native library (android.app.lib_name)");
    }
    Ok(format!("lib{}.so", named.as_deref().unwrap_or("main")))
}

fn libraries(files: &[Stored], own: &str, report: &mut Report) -> Result<()> {
    let own_place = format!("{LIBRARIES}/{own}");
    let loader_place = format!("{LIBRARIES}/{LOADER}");
    if !files.iter().any(|file| file.name == own_place) {
        report.problem(format!("{own_place} is missing"));
    }
    if !files.iter().any(|file| file.name == loader_place) {
        report.fact(format!(
            "NOTE: there is no {LOADER}: the application starts, says so in its log, and cannot show anything"
        ));
    }
    for file in files.iter().filter(|file| file.name.starts_with("lib/")) {
        let name = &file.name;
        report.require(
            name.starts_with(LIBRARIES)
                && !file.is_compressed
                && file.start % u64::from(LIBRARY_ALIGNMENT) == 0,
            format!("{name}: for arm64, uncompressed, at a multiple of 16 KiB ({:#x})", file.start),
        );
        let elf = ElfFile64::<Endianness>::parse(&*file.data)
            .map_err(|error| Error::malformed(name, format!("not a 64-bit ELF library: {error}")))?;
        let endian = elf.endian();
        let header = elf.elf_header();
        report.require(
            header.e_machine(endian) == elf::EM_AARCH64 && header.e_type(endian) == elf::ET_DYN,
            format!("{name}: a shared library for AArch64"),
        );
        let smallest = elf
            .elf_program_headers()
            .iter()
            .filter(|segment| segment.p_type(endian) == elf::PT_LOAD)
            .map(|segment| segment.p_align(endian))
            .min()
            .unwrap_or(0);
        let aligned = smallest >= u64::from(LIBRARY_ALIGNMENT) && smallest.is_power_of_two();
        if *name == own_place {
            report.require(aligned, format!("{name}: segments aligned to {smallest:#x}"));
            own_library(&elf, file, report)?;
        } else if aligned {
            report.fact(format!("{name}: segments aligned to {smallest:#x}, {} bytes", file.data.len()));
        } else {
            report.fact(format!(
                "NOTE: {name}: segments aligned to {smallest:#x} only: a system with pages of 16 KiB refuses it"
            ));
        }
    }
    Ok(())
}

fn own_library(elf: &ElfFile64<'_, Endianness>, file: &Stored, report: &mut Report) -> Result<()> {
    let name = &file.name;
    let size = file.data.len() as u64;
    report.require(size <= LARGEST_LIBRARY, format!("{name}: {size} bytes of at most {LARGEST_LIBRARY}"));
    let exported: Vec<&str> = elf
        .dynamic_symbols()
        .filter(|symbol| symbol.is_definition() && symbol.is_global())
        .filter_map(|symbol| symbol.name().ok())
        .collect();
    for entry in ENTRY_POINTS {
        report.require(exported.contains(&entry), format!("{name}: exports {entry}"));
    }
    let needed = needed(elf).map_err(|error| Error::malformed(name, error.to_string()))?;
    let unexpected: Vec<&String> =
        needed.iter().filter(|library| !SYSTEM_LIBRARIES.contains(&library.as_str())).collect();
    report.require(unexpected.is_empty(), format!("{name}: needs {}", needed.join(", ")));
    report.require(elf.symbols().next().is_none(), format!("{name}: stripped"));
    Ok(())
}

/// The libraries that the dynamic linker must load first (`DT_NEEDED`).
fn needed(elf: &ElfFile64<'_, Endianness>) -> object::Result<Vec<String>> {
    let (endian, data) = (elf.endian(), elf.data());
    let sections = elf.elf_section_table();
    let Some((dynamic, link)) = sections.dynamic(endian, data)? else { return Ok(Vec::new()) };
    let strings = sections.strings(endian, data, link)?;
    let mut names = Vec::new();
    for entry in dynamic {
        if entry.d_tag.get(endian) == elf::DT_NEEDED {
            let at = u32::try_from(entry.d_val.get(endian)).unwrap_or(u32::MAX);
            names.push(String::from_utf8_lossy(strings.get(at).unwrap_or(b"?")).into_owned());
        }
    }
    names.sort();
    Ok(names)
}
