//! The Android application: a `NativeActivity` whose native library this is.
//!
//! There is nothing here for other systems: the crate is empty when it is compiled for them.
//!
//! It sends the log and every panic to logcat (panics also to a file that the user can pull), and shows in the headset
//! the first scene of the folder that scenes are pushed to, or the sample. It follows the activity's life cycle, and
//! ends with it.

#[cfg(target_os = "android")]
mod activity;
#[cfg(target_os = "android")]
mod digest;
#[cfg(target_os = "android")]
mod report;

// Linked for the symbols that it exports to the standard library.
#[cfg(all(target_os = "android", feature = "rust-unwinder"))]
extern crate unwinding as _;
