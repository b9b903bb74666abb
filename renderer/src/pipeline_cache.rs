//! Pipelines kept on disk, so that a headset does not compile its shaders at every start.
//!
//! One file a device and driver: named by vendor, device, and the driver's own identity of its cache, so that another
//! driver never sees it. Drivers are known to trust what they are given, therefore the file carries a checksum of its own:
//! one that is cut or changed is announced, and replaced when the renderer goes.

use crate::gpu::{During, Gpu, GpuError};
use ash::vk;
use std::fs;
use std::path::{Path, PathBuf};

/// First bytes of a file.
const MAGIC: &[u8; 8] = b"MOTESPC1";
/// Magic, length of the data, checksum of the data.
const HEADER: usize = 24;
/// Larger than any cache of these few pipelines.
const LARGEST: u64 = 256 << 20;

/// What was found on disk.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Kept {
    /// Nothing: pipelines are made, and kept at the end.
    Nothing,
    /// So many bytes of pipelines, for this device and driver.
    Pipelines(usize),
    /// A file that is not used, for this reason; it will be replaced.
    Damaged(String),
}

/// Where caches belong for the person who runs the program: `motes/pipelines` in the cache folder of the system. `None`
/// where the system names none (Android: the application knows its own).
pub fn default_folder() -> Option<PathBuf> {
    let variable = |name| std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
    let folder = if cfg!(windows) {
        variable("LOCALAPPDATA")
    } else if cfg!(target_os = "android") {
        None
    } else {
        variable("XDG_CACHE_HOME")
            .filter(|f| f.is_absolute())
            .or_else(|| Some(variable("HOME")?.join(".cache")))
    };
    Some(folder?.join("motes").join("pipelines"))
}

/// The file of a device and driver.
pub fn file_for(gpu: &Gpu, folder: &Path) -> PathBuf {
    // SAFETY: the physical device belongs to the instance.
    let p = unsafe { gpu.instance().get_physical_device_properties(gpu.physical()) };
    let driver: String = p.pipeline_cache_uuid.iter().map(|b| format!("{b:02x}")).collect();
    folder.join(format!("{:04x}-{:04x}-{driver}.pipelines", p.vendor_id, p.device_id))
}

/// FNV-1a, 64 bits: against accidents, not against forgery.
fn checksum(data: &[u8]) -> u64 {
    data.iter().fold(0xcbf2_9ce4_8422_2325, |h, &b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3))
}

/// The data of a file, or why it is none; `Ok(None)` where there is no file.
fn read(file: &Path) -> Result<Option<Vec<u8>>, String> {
    let size = match fs::metadata(file) {
        Ok(m) => m.len(),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(e) => return Err(e.to_string()),
    };
    if size > LARGEST {
        return Err(format!("{size} bytes are more than pipelines take"));
    }
    let bytes = fs::read(file).map_err(|e| e.to_string())?;
    let word = |at: usize| {
        bytes.get(at..at + 8).and_then(|b| b.try_into().ok()).map(u64::from_le_bytes).unwrap_or_default()
    };
    match bytes.get(HEADER..) {
        Some(data) if bytes.starts_with(MAGIC) && word(8) == data.len() as u64 => {
            if word(16) == checksum(data) {
                Ok(Some(data.to_vec()))
            } else {
                Err("its checksum is wrong".into())
            }
        }
        _ => Err("it is cut short, or no cache of pipelines".into()),
    }
}

/// Loads the pipelines that are kept in a folder.
pub(crate) fn load(gpu: &Gpu, folder: &Path) -> Result<(vk::PipelineCache, Kept), GpuError> {
    let file = file_for(gpu, folder);
    let (data, kept) = match read(&file) {
        Ok(None) => {
            log::info!("pipelines will be kept in {}", file.display());
            (Vec::new(), Kept::Nothing)
        }
        Ok(Some(data)) => {
            log::info!("{}: {} bytes of pipelines", file.display(), data.len());
            let kept = Kept::Pipelines(data.len());
            (data, kept)
        }
        Err(problem) => {
            log::warn!("{}: {problem}; pipelines are made anew, and the file is replaced", file.display());
            (Vec::new(), Kept::Damaged(problem))
        }
    };
    let info = vk::PipelineCacheCreateInfo::default().initial_data(&data);
    // SAFETY: the data is what this driver wrote, by its checksum and its name.
    let cache = unsafe { gpu.device().create_pipeline_cache(&info, None) }.during("vkCreatePipelineCache")?;
    Ok((cache, kept))
}

/// Keeps a cache's pipelines in a folder. What cannot be written is announced; nothing depends on it.
pub(crate) fn store(gpu: &Gpu, folder: &Path, cache: vk::PipelineCache) {
    let file = file_for(gpu, folder);
    // SAFETY: the cache belongs to the device.
    let data = match unsafe { gpu.device().get_pipeline_cache_data(cache) } {
        Ok(data) => data,
        Err(e) => return log::warn!("pipelines are not kept: {e}"),
    };
    let mut bytes = Vec::with_capacity(HEADER + data.len());
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&(data.len() as u64).to_le_bytes());
    bytes.extend_from_slice(&checksum(&data).to_le_bytes());
    bytes.extend_from_slice(&data);
    // Written aside and renamed, so that two programs, or a cut, leave a whole file.
    let partial = file.with_extension(format!("{}.part", std::process::id()));
    let written = fs::create_dir_all(folder)
        .and_then(|()| fs::write(&partial, &bytes))
        .and_then(|()| fs::rename(&partial, &file));
    if let Err(e) = written {
        let _ = fs::remove_file(&partial);
        log::warn!("{}: {e}; pipelines are not kept", file.display());
    }
}
