//! The digest of a scene by this very library, for whoever loads it: a test under emulation, or on a device.

use std::ffi::{CStr, c_char};
use std::path::PathBuf;

use motes_app::digest::Digest;
use motes_app::opened::Opened;
use motes_scenes::LoadOptions;

/// Digests the scene in a file into others, as `motes digest -o` does. Returns 0, or what did not work:
/// 1 the paths, 2 reading the scene, 3 computing, 4 writing.
///
/// Everything runs on the calling thread.
///
/// # Safety
/// Both are terminated strings.
// SAFETY: no other item of the program has this name.
#[unsafe(no_mangle)]
unsafe extern "C" fn motes_digest(scene: *const c_char, output: *const c_char) -> i32 {
    // Fails where it was called before: the pool is there then.
    let _ = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build_global();
    // SAFETY: the caller's promise.
    let paths = unsafe { [CStr::from_ptr(scene), CStr::from_ptr(output)] };
    let [Ok(scene), Ok(output)] = paths.map(|p| p.to_str().map(PathBuf::from)) else { return 1 };
    let report = |code: i32, error: &dyn std::fmt::Display| {
        let _ = std::fs::write(&output, error.to_string());
        code
    };
    let opened = match Opened::load(&[scene], &LoadOptions::default()) {
        Ok(opened) => opened,
        Err(error) => return report(2, &error),
    };
    let digest = match Digest::of(&opened) {
        Ok(digest) => digest,
        Err(error) => return report(3, &error),
    };
    match digest.save(&output) {
        Ok(()) => 0,
        Err(error) => report(4, &error),
    }
}
