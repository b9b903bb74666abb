//! The Android application: a `NativeActivity` whose native library this is.
//!
//! There is nothing here for other systems: the crate is empty when it is compiled for them.
//!
//! What it does so far: it starts, sends the log and every panic to logcat (panics also to a file that the
//! user can pull), follows the activity's life cycle, and ends with it. It shows nothing yet: the session
//! in the headset is not connected.

#[cfg(target_os = "android")]
mod activity;
#[cfg(target_os = "android")]
mod report;

// Linked for the symbols that it exports to the standard library.
#[cfg(all(target_os = "android", feature = "rust-unwinder"))]
extern crate unwinding as _;
