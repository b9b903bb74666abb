//! The zip file that an APK is, and the one in which the OpenXR loader comes.

use std::io::{Cursor, Read, Write};
use std::path::Path;

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

use crate::error::{Error, Result};

/// Where the system looks for native libraries.
pub const LIBRARIES: &str = "lib/arm64-v8a";
/// The name under which the OpenXR loader is in the APK.
pub const LOADER: &str = "libopenxr_loader.so";
/// Alignment in the file of libraries, in bytes: they are mapped from the APK itself, on devices with pages of
/// up to 16 KiB.
pub const LIBRARY_ALIGNMENT: u16 = 16 * 1024;
/// Alignment of everything else, in bytes.
pub const ALIGNMENT: u16 = 4;

/// A file in the archive, stored uncompressed.
#[derive(Debug)]
pub struct Entry {
    /// Its path.
    pub name: String,
    /// Its content.
    pub data: Vec<u8>,
    /// The position of its content in the archive is a multiple of this many bytes.
    pub alignment: u16,
}

/// Packs entries in their order. The result depends on nothing but them.
///
/// # Errors
/// When a name occurs twice or the archive grows too large.
pub fn pack(entries: &[Entry]) -> Result<Vec<u8>> {
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    for entry in entries {
        let options = SimpleFileOptions::DEFAULT
            .compression_method(CompressionMethod::Stored)
            .with_alignment(entry.alignment);
        writer.start_file(&*entry.name, options).map_err(Error::zip(&entry.name))?;
        writer.write_all(&entry.data).map_err(Error::file(&entry.name))?;
    }
    Ok(writer.finish().map_err(Error::zip("APK"))?.into_inner())
}

/// Reads the OpenXR loader for arm64 from a library, or from an AAR or APK that holds one.
///
/// # Errors
/// When the file is neither, or holds no loader for arm64.
pub fn loader(file: &Path) -> Result<Vec<u8>> {
    /// A loader has about 2 MB; nothing near this is one.
    const LARGEST: u64 = 64 << 20;
    let bytes = std::fs::read(file).map_err(Error::file(file))?;
    if bytes.starts_with(b"\x7fELF") {
        return Ok(bytes);
    }
    let name = file.display().to_string();
    let mut archive = ZipArchive::new(Cursor::new(bytes)).map_err(Error::zip(&name))?;
    // In Khronos' AAR the loader is in the prefab folder; in others it is where an APK has it.
    let place = archive
        .file_names()
        .flatten()
        .find(|place| place.ends_with(LOADER) && (place.contains("arm64-v8a") || place.contains("aarch64")))
        .map(|place| place.into_owned())
        .ok_or_else(|| Error::malformed(&name, format!("holds no {LOADER} for arm64-v8a")))?;
    let entry = archive.by_name(&place).map_err(Error::zip(format!("{name}, {place}")))?;
    let mut library = Vec::new();
    entry.take(LARGEST).read_to_end(&mut library).map_err(Error::file(file))?;
    Ok(library)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn content_is_aligned_and_the_archive_reproducible() {
        let entry =
            |name: &str, size: usize, alignment| Entry { name: name.into(), data: vec![7; size], alignment };
        let entries = [
            entry("AndroidManifest.xml", 1001, ALIGNMENT),
            entry("lib/arm64-v8a/liba.so", 70_001, LIBRARY_ALIGNMENT),
            entry("lib/arm64-v8a/libb.so", 3, LIBRARY_ALIGNMENT),
            entry("assets/sample", 5, ALIGNMENT),
        ];
        let packed = pack(&entries).unwrap();
        assert_eq!(packed, pack(&entries).unwrap());
        let mut archive = ZipArchive::new(Cursor::new(&packed)).unwrap();
        for entry in &entries {
            let file = archive.by_name(&entry.name).unwrap();
            let start = file.data_start().unwrap();
            assert_eq!(start % u64::from(entry.alignment), 0, "{}", entry.name);
            assert_eq!(file.compression(), CompressionMethod::Stored);
            let start = start as usize;
            assert_eq!(packed[start..start + entry.data.len()], entry.data[..]);
        }
        assert!(pack(&[entry("a", 1, 4), entry("a", 1, 4)]).is_err());
    }

    #[test]
    fn the_loader_is_found_in_an_aar() {
        let folder = std::env::temp_dir().join(format!("motes-apk-aar-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let file = folder.join("loader.aar");
        let write = |names: &[&str]| {
            let mut writer = ZipWriter::new(std::fs::File::create(&file).unwrap());
            for name in names {
                writer
                    .start_file(
                        *name,
                        SimpleFileOptions::DEFAULT.compression_method(CompressionMethod::Deflated),
                    )
                    .unwrap();
                writer.write_all(name.as_bytes()).unwrap();
            }
            writer.finish().unwrap();
        };
        let place = "prefab/modules/openxr_loader/libs/android.arm64-v8a/libopenxr_loader.so";
        write(&[
            "classes.jar",
            "prefab/modules/openxr_loader/libs/android.x86_64/libopenxr_loader.so",
            place,
        ]);
        assert_eq!(loader(&file).unwrap(), place.as_bytes());
        write(&["lib/armeabi-v7a/libopenxr_loader.so"]);
        let text = loader(&file).unwrap_err().to_string();
        assert!(text.contains("arm64-v8a") && text.contains("loader.aar"), "{text}");
        std::fs::write(&file, "nothing").unwrap();
        assert!(loader(&file).is_err());
        std::fs::write(&file, b"\x7fELFxyz").unwrap();
        assert_eq!(loader(&file).unwrap(), b"\x7fELFxyz");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
